//! Names of joints → what they mean: the dictionary of joint names.

use crate::binding::segments::Side;
use serde::Deserialize;
use serde::de::IntoDeserializer;
use std::collections::BTreeMap;
use std::fmt;
use std::str::FromStr;
use std::sync::LazyLock;

/// What the dictionary takes a joint's name for. `SomeShoulder` and `SomeHip` mean one joint or another, after the rest of the side.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum Word {
    Pelvis,
    SpineLow,
    SpineMid,
    Chest,
    Neck,
    Head,
    HeadEnd,
    Clavicle,
    SomeShoulder,
    Shoulder,
    Elbow,
    Wrist,
    HandEnd,
    SomeHip,
    Hip,
    Knee,
    Ankle,
    Toe,
    ToeEnd,
}

/// What a person says that a joint is: `left elbow`, `pelvis`, `spine_mid`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Role {
    text: String,
    word: Word,
    side: Side,
}

impl fmt::Display for Role {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.text)
    }
}

impl FromStr for Role {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let (side, rest) = match text.split_once(' ') {
            Some(("left", rest)) => (Side::Left, rest),
            Some(("right", rest)) => (Side::Right, rest),
            _ => (Side::Middle, text),
        };
        type Plain = serde::de::value::Error;
        let word = Word::deserialize(IntoDeserializer::<Plain>::into_deserializer(rest)).map_err(|e| format!("'{rest}': {e}"))?;
        let sided = DICTIONARY.sided.values().any(|&w| w == word);
        if sided != (side != Side::Middle) {
            let form = if sided { "left or right before it" } else { "no side before it" };
            return Err(format!("'{text}': {rest} has {form}"));
        }
        Ok(Self { text: text.to_owned(), word, side })
    }
}

/// A name that the dictionary knows.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Meaning {
    pub word: Word,
    pub side: Side,
    /// The word itself, without prefix and side.
    pub core: String,
}

/// Meanings of names; `None` where the dictionary knows none. `swap` exchanges left and right; `roles` are the user's own.
pub(super) fn read(names: &[&str], swap: bool, roles: &BTreeMap<String, Role>) -> Vec<Option<Meaning>> {
    let table = &*DICTIONARY;
    let mut out: Vec<Option<Meaning>> = names.iter().map(|name| table.look_up(name)).collect();
    if swap {
        for meaning in out.iter_mut().flatten() {
            meaning.side = meaning.side.other();
        }
    }
    for (name, meaning) in names.iter().zip(&mut out) {
        if let Some(role) = roles.get(*name) {
            *meaning = Some(Meaning { word: role.word, side: role.side, core: String::new() });
        }
    }
    // Of several joints of one meaning the user's is the one.
    for role in roles.values() {
        for (name, meaning) in names.iter().zip(&mut out) {
            if !roles.contains_key(*name) && meaning.as_ref().is_some_and(|m| m.word == role.word && m.side == role.side) {
                *meaning = None;
            }
        }
    }
    out
}

/// Share of a family's names that must be there.
const FAMILY_SHARE: f64 = 0.85;

/// The family of skeletons with most of its names among these, if there is one.
pub(super) fn family(names: &[&str]) -> Option<&'static str> {
    let bare: Vec<String> = names.iter().map(|name| normalised(name)).collect();
    let table = &*DICTIONARY;
    let has = |word: &String| bare.iter().any(|name| name == word || table.without_prefix(name).any(|rest| rest == word));
    let mut best: Option<(f64, &'static str)> = None;
    for (family, words) in &table.families {
        let share = words.iter().filter(|w| has(w)).count() as f64 / words.len().max(1) as f64;
        if share >= FAMILY_SHARE && best.is_none_or(|(s, _)| share > s) {
            best = Some((share, family));
        }
    }
    best.map(|(_, family)| family)
}

/// Without namespace, separators and capitals.
fn normalised(name: &str) -> String {
    let bare = name.rsplit([':', '|']).next().unwrap_or(name);
    bare.chars().filter(|c| !c.is_whitespace() && !matches!(c, '_' | '.' | '-')).flat_map(char::to_lowercase).collect()
}

struct Dictionary {
    sided: BTreeMap<String, Word>,
    middle: BTreeMap<String, Word>,
    /// Longest first.
    prefixes: Vec<String>,
    families: Vec<(&'static str, Vec<String>)>,
}

/// Words before letters, so that `left…` is not read as `l` + `eft…`.
const SIDES: [(&str, Side); 4] = [("left", Side::Left), ("right", Side::Right), ("l", Side::Left), ("r", Side::Right)];

impl Dictionary {
    fn look_up(&self, name: &str) -> Option<Meaning> {
        let name = normalised(name);
        std::iter::once(name.as_str()).chain(self.without_prefix(&name)).find_map(|rest| self.word(rest))
    }

    fn without_prefix<'a>(&'a self, name: &'a str) -> impl Iterator<Item = &'a str> {
        self.prefixes.iter().filter_map(move |prefix| name.strip_prefix(prefix.as_str())).filter(|rest| !rest.is_empty())
    }

    fn word(&self, name: &str) -> Option<Meaning> {
        if let Some(&word) = self.middle.get(name) {
            return Some(Meaning { word, side: Side::Middle, core: name.to_owned() });
        }
        let ends = |(mark, side): (&str, Side)| {
            let cores = [name.strip_prefix(mark), name.strip_suffix(mark)];
            cores
                .into_iter()
                .flatten()
                .find_map(|core| self.sided.get(core).map(|&word| Meaning { word, side, core: core.to_owned() }))
        };
        SIDES.into_iter().find_map(ends)
    }
}

static DICTIONARY: LazyLock<Dictionary> = LazyLock::new(|| {
    let file: &'static File =
        Box::leak(Box::new(toml::from_str(include_str!("../joints.toml")).expect("the table is part of this crate and tested")));
    let (mut sided, mut middle) = (BTreeMap::new(), BTreeMap::new());
    for (&word, entry) in &file.joint {
        let map = if entry.sided { &mut sided } else { &mut middle };
        map.extend(entry.names.iter().map(|name| (normalised(name), word)));
    }
    let mut prefixes: Vec<String> = file.prefixes.iter().map(|p| normalised(p)).collect();
    prefixes.sort_by(|a, b| b.len().cmp(&a.len()).then(a.cmp(b)));
    let words = |entry: &FamilyEntry| entry.joints.iter().map(|name| normalised(name)).collect();
    let families = file.family.iter().map(|(name, entry)| (name.as_str(), words(entry))).collect();
    Dictionary { sided, middle, prefixes, families }
});

#[derive(Deserialize)]
struct File {
    prefixes: Vec<String>,
    joint: BTreeMap<Word, JointEntry>,
    family: BTreeMap<String, FamilyEntry>,
}

#[derive(Deserialize)]
struct JointEntry {
    sided: bool,
    names: Vec<String>,
}

#[derive(Deserialize)]
struct FamilyEntry {
    joints: Vec<String>,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_of_many_makers_find_their_word_and_side() {
        use Side::{Left, Middle, Right};
        for (name, word, side) in [
            ("mixamorig:LeftForeArm", Word::Elbow, Left),
            ("Bip01 L Thigh", Word::Hip, Left),
            ("Bip001_R_UpperArm", Word::Shoulder, Right),
            ("ValveBiped.Bip01_R_Calf", Word::Knee, Right),
            ("upperarm_l", Word::Shoulder, Left),
            ("lowerleg01.R", Word::Knee, Right),
            ("Character1_LeftHand", Word::Wrist, Left),
            ("J_Bip_L_UpperLeg", Word::Hip, Left),
            ("joint_Root", Word::Pelvis, Middle),
            ("Shoulder_L", Word::SomeShoulder, Left),
            ("l_larm", Word::Elbow, Left),
            ("LArm", Word::Shoulder, Left),
            ("rfemur", Word::Hip, Right),
            ("LHipJoint", Word::SomeHip, Left),
            ("lHip", Word::Hip, Left),
            ("Hips", Word::Pelvis, Middle),
            ("Neck1", Word::Neck, Middle),
            ("Subject 1:RightToeBase", Word::Toe, Right),
            ("RightFoot_End", Word::Toe, Right),
            ("LeftHand_End", Word::HandEnd, Left),
        ] {
            let meaning = read(&[name], false, &BTreeMap::new()).pop().flatten();
            assert_eq!(meaning.map(|m| (m.word, m.side)), Some((word, side)), "{name}");
        }
    }

    #[test]
    fn words_that_name_no_joint_of_the_body_mean_nothing() {
        for name in ["", "LeftHandThumb1", "tail_02", "b", "left", "Bone.003", "orbicularis03.L", "LeftEye"] {
            assert_eq!(read(&[name], false, &BTreeMap::new()), [None], "{name}");
        }
    }

    #[test]
    fn every_joint_of_every_family_has_a_meaning() {
        for (family, joints) in &DICTIONARY.families {
            let unknown: Vec<&String> = joints.iter().filter(|name| DICTIONARY.look_up(name).is_none()).collect();
            // Thumbs tell the family, but move no segment.
            let unknown: Vec<_> = unknown.into_iter().filter(|name| !name.contains("thumb")).collect();
            assert!(unknown.is_empty(), "{family}: {unknown:?}");
        }
    }

    #[test]
    fn a_family_needs_most_of_its_names() {
        let mixamo = ["Hips", "Spine", "Spine1", "Spine2", "Neck", "Head", "LeftShoulder", "LeftArm", "LeftForeArm", "LeftHand"];
        let legs = ["LeftUpLeg", "LeftLeg", "LeftFoot", "LeftToeBase"];
        let prefixed: Vec<String> = mixamo.iter().chain(&legs).map(|name| format!("mixamorig:{name}")).collect();
        let names: Vec<&str> = prefixed.iter().map(String::as_str).collect();
        assert!(family(&names).is_some_and(|f| f.starts_with("mixamo")));
        assert_eq!(family(&names[..7]), None);
    }

    #[test]
    fn swapped_sides_change_places() {
        let meaning = read(&["LeftHand"], true, &BTreeMap::new()).pop().flatten();
        assert_eq!(meaning.map(|m| m.side), Some(Side::Right));
    }
}
