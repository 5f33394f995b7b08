//! How a part of the scan is called: one grammar for the command line and for files.
//!
//! | WHAT | selects |
//! |---|---|
//! | `group:NAME` | OBJ groups and objects of this name; `*` stands for any letters, `?` for one |
//! | `color:#rrggbb[~TOLERANCE]` | vertex colour, every channel within TOLERANCE of 255 (default 10) |
//! | `sphere:X,Y,Z,R` | a ball, in the scan's coordinates and unit |
//! | `near:HANDLE[,HANDLE…]` | what is nearer to these handles than to any other |
//! | `part:WORD`, or the word alone | a part of a body: `ends` (head, hands and feet), `head`, `trunk`, `pelvis`, `hands`, `left_hand`, … |
//!
//! Joints stay free: of a part of a body, what lies within [`ROUND_JOINTS`] statures of a joint to another part is left out.

use super::Segment;
use glam::DVec3;
use std::fmt;
use std::str::FromStr;

/// Radius round joints that stays outside of body parts, in statures.
pub const ROUND_JOINTS: f64 = 0.06;
/// Difference of colour channels that is the same colour, of 255: what a lossy texture adds.
const SAME_COLOR: f64 = 10.0;
/// Stiffness factors that the solver takes without losing its precision.
const FACTORS: (f64, f64) = (1e-3, 1e4);

/// A part of the scan, as it was written.
#[derive(Clone, Debug, PartialEq)]
pub struct Selector {
    text: String,
    /// What it means.
    pub what: What,
}

/// The kinds of parts.
#[derive(Clone, Debug, PartialEq)]
pub enum What {
    /// Groups and objects whose name matches.
    Group(String),
    /// Vertices of a colour.
    Color {
        /// Red, green, blue, 0 to 255.
        rgb: [u8; 3],
        /// Largest difference of a channel.
        tolerance: f64,
    },
    /// A ball in the scan's coordinates and unit.
    Sphere {
        /// Its centre.
        centre: DVec3,
        /// Its radius.
        radius: f64,
    },
    /// What is nearer to these handles than to others.
    Near(Vec<String>),
    /// Parts of a body: each set of segments is one part.
    Part(&'static [&'static [Segment]]),
}

/// The words for parts of a body. Pairs are two parts each, which move on their own.
const PARTS: [(&str, &[&[Segment]]); 29] = {
    use Segment::*;
    [
        ("head", &[&[Head]]),
        ("trunk", &[&[Trunk]]),
        ("pelvis", &[&[Pelvis]]),
        ("hands", &[&[LeftHand], &[RightHand]]),
        ("feet", &[&[LeftFoot], &[RightFoot]]),
        ("upper_arms", &[&[LeftUpperArm], &[RightUpperArm]]),
        ("forearms", &[&[LeftForearm], &[RightForearm]]),
        ("thighs", &[&[LeftThigh], &[RightThigh]]),
        ("shanks", &[&[LeftShank], &[RightShank]]),
        ("arms", &[&[LeftUpperArm, LeftForearm, LeftHand], &[RightUpperArm, RightForearm, RightHand]]),
        ("legs", &[&[LeftThigh, LeftShank, LeftFoot], &[RightThigh, RightShank, RightFoot]]),
        ("torso", &[&[Pelvis, Trunk]]),
        ("left_hand", &[&[LeftHand]]),
        ("left_foot", &[&[LeftFoot]]),
        ("left_upper_arm", &[&[LeftUpperArm]]),
        ("left_forearm", &[&[LeftForearm]]),
        ("left_thigh", &[&[LeftThigh]]),
        ("left_shank", &[&[LeftShank]]),
        ("left_arm", &[&[LeftUpperArm, LeftForearm, LeftHand]]),
        ("left_leg", &[&[LeftThigh, LeftShank, LeftFoot]]),
        ("right_hand", &[&[RightHand]]),
        ("right_foot", &[&[RightFoot]]),
        ("right_upper_arm", &[&[RightUpperArm]]),
        ("right_forearm", &[&[RightForearm]]),
        ("right_thigh", &[&[RightThigh]]),
        ("right_shank", &[&[RightShank]]),
        ("right_arm", &[&[RightUpperArm, RightForearm, RightHand]]),
        ("right_leg", &[&[RightThigh, RightShank, RightFoot]]),
        ("ends", &[&[Head], &[LeftHand], &[RightHand], &[LeftFoot], &[RightFoot]]),
    ]
};

const KINDS: [&str; 5] = ["group", "color", "sphere", "near", "part"];

impl fmt::Display for Selector {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.text)
    }
}

impl Selector {
    /// The fewest words for some segments of a body, each a part of its own.
    pub(super) fn of_segments(mut segments: Vec<Segment>) -> Vec<Self> {
        let mut words: Vec<_> = PARTS.iter().filter(|(_, sets)| sets.iter().all(|set| set.len() == 1)).collect();
        words.sort_by_key(|(_, sets)| std::cmp::Reverse(sets.len()));
        let mut found = Vec::new();
        for (word, sets) in words {
            let all = sets.iter().flat_map(|set| set.iter());
            if all.clone().all(|s| segments.contains(s)) {
                segments.retain(|s| !all.clone().any(|other| other == s));
                found.push(Self { text: (*word).to_owned(), what: What::Part(sets) });
            }
        }
        found
    }
}

impl FromStr for Selector {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let text = text.trim();
        let what = match text.split_once(':') {
            Some((kind, rest)) => match kind.trim().to_ascii_lowercase().as_str() {
                "group" => group(rest)?,
                "color" | "colour" => color(rest)?,
                "sphere" => sphere(rest)?,
                "near" => near(rest)?,
                "part" => part(rest)?,
                other => return Err(format!("unknown kind '{other}:'{}", instead(other, KINDS.into_iter(), ":"))),
            },
            None => part(text)?,
        };
        Ok(Self { text: text.to_owned(), what })
    }
}

fn group(name: &str) -> Result<What, String> {
    if name.trim().is_empty() {
        return Err("group: lacks a name, for example group:shoes or group:armor_*".into());
    }
    Ok(What::Group(name.trim().to_owned()))
}

fn color(text: &str) -> Result<What, String> {
    let (digits, tolerance) = match text.split_once('~') {
        Some((digits, tolerance)) => (digits, number(tolerance, "a tolerance from 0 to 255")?),
        None => (text, SAME_COLOR),
    };
    let expected =
        || format!("'{text}' is not a colour: expected six hexadecimal digits, for example color:#ff8000 or color:#ff8000~20");
    let digits = digits.trim().trim_start_matches('#');
    if digits.len() != 6 || !digits.bytes().all(|b| b.is_ascii_hexdigit()) {
        return Err(expected());
    }
    if !(0.0..=255.0).contains(&tolerance) {
        return Err(format!("tolerance {tolerance}: expected 0 to 255"));
    }
    let packed = u32::from_str_radix(digits, 16).map_err(|_| expected())?;
    let [_, r, g, b] = packed.to_be_bytes();
    Ok(What::Color { rgb: [r, g, b], tolerance })
}

fn sphere(text: &str) -> Result<What, String> {
    let expected = "X,Y,Z,R in the scan's unit, for example sphere:0,1.6,0.05,0.15";
    let numbers = text.split(',').map(|n| number(n, expected)).collect::<Result<Vec<f64>, String>>()?;
    match numbers[..] {
        [x, y, z, radius] if radius > 0.0 => Ok(What::Sphere { centre: DVec3::new(x, y, z), radius }),
        [_, _, _, radius] => Err(format!("radius {radius}: expected a positive number")),
        _ => Err(format!("'{text}' has {} numbers: expected {expected}", numbers.len())),
    }
}

fn near(text: &str) -> Result<What, String> {
    let names: Vec<String> = text.split(',').map(|n| n.trim().to_owned()).collect();
    if names.iter().any(String::is_empty) {
        return Err("near: expects names of handles, for example near:LFIN,LWRA".into());
    }
    Ok(What::Near(names))
}

fn part(text: &str) -> Result<What, String> {
    let word = text.trim().to_ascii_lowercase().replace([' ', '-'], "_");
    PARTS.iter().find(|(name, _)| *name == word).map(|(_, sets)| What::Part(sets)).ok_or_else(|| {
        let words = || PARTS.iter().map(|(name, _)| *name).chain(KINDS.into_iter().filter(|_| !text.is_empty()));
        format!("unknown part '{}'{}", text.trim(), instead(&word, words(), ""))
    })
}

fn number(text: &str, expected: &str) -> Result<f64, String> {
    match text.trim().parse::<f64>() {
        Ok(x) if x.is_finite() => Ok(x),
        _ => Err(format!("'{}' is not a number: expected {expected}", text.trim())),
    }
}

/// The nearest known word as advice, or the first few where none is near.
fn instead<'a>(word: &str, known: impl Iterator<Item = &'a str>, ending: &str) -> String {
    let known: Vec<&str> = known.collect();
    match nearest(word, known.iter().copied()) {
        Some(near) => format!(": did you mean '{near}{ending}'?"),
        None => format!(": expected one of {}", some_of(known.into_iter().map(|k| format!("{k}{ending}")))),
    }
}

/// Up to a dozen words of a list.
pub(crate) fn some_of(words: impl Iterator<Item = String>) -> String {
    const SHOWN: usize = 12;
    let mut words: Vec<String> = words.take(SHOWN + 1).collect();
    if words.len() > SHOWN {
        words[SHOWN] = "…".into();
    }
    words.join(", ")
}

/// The known word with the fewest changed letters, when no more than half of them change; of equals one that only goes on, then the first.
pub(crate) fn nearest<'a>(word: &str, known: impl Iterator<Item = &'a str>) -> Option<&'a str> {
    let letters = |word: &str| word.to_lowercase().chars().collect::<Vec<char>>();
    let word = letters(word);
    let measured = known.map(|k| {
        let other = letters(k);
        (changed_letters(&word, &other), !other.starts_with(&word), k)
    });
    let (changes, _, found) = measured.min_by_key(|(changes, other, _)| (*changes, *other))?;
    (2 * changes <= word.len().max(2)).then_some(found)
}

/// Letters to insert, delete, replace or exchange with the next (Damerau-Levenshtein, each letter in one change).
fn changed_letters(a: &[char], b: &[char]) -> usize {
    let width = b.len() + 1;
    let mut changes = vec![0; (a.len() + 1) * width];
    for i in 0..=a.len() {
        for j in 0..=b.len() {
            let at = |i: usize, j: usize| changes[i * width + j];
            let mut least = match (i, j) {
                (0, _) => j,
                (_, 0) => i,
                _ => (at(i - 1, j) + 1).min(at(i, j - 1) + 1).min(at(i - 1, j - 1) + usize::from(a[i - 1] != b[j - 1])),
            };
            if i > 1 && j > 1 && a[i - 1] == b[j - 2] && a[i - 2] == b[j - 1] {
                least = least.min(at(i - 2, j - 2) + 1);
            }
            changes[i * width + j] = least;
        }
    }
    changes[a.len() * width + b.len()]
}

/// Whether a name matches a pattern with `*` and `?`.
pub(super) fn matches(pattern: &str, name: &str) -> bool {
    let (pattern, name): (Vec<char>, Vec<char>) = (pattern.chars().collect(), name.chars().collect());
    let (mut p, mut n) = (0, 0);
    let mut star: Option<(usize, usize)> = None;
    while n < name.len() {
        match pattern.get(p) {
            Some('*') => {
                star = Some((p, n));
                p += 1;
            }
            Some(&c) if c == '?' || c == name[n] => {
                p += 1;
                n += 1;
            }
            _ => {
                let Some((at, from)) = star else { return false };
                star = Some((at, from + 1));
                p = at + 1;
                n = from + 1;
            }
        }
    }
    pattern[p..].iter().all(|&c| c == '*')
}

/// `WHAT=X`: a part and how stiff it is against the rest of the body.
#[derive(Clone, Debug, PartialEq)]
pub struct Stiffness {
    /// The part.
    pub what: Selector,
    /// Its stiffness; the body's is 1.
    pub factor: f64,
}

impl FromStr for Stiffness {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        // Names of groups may hold an equals sign, numbers do not.
        let (what, factor) = text.rsplit_once('=').ok_or("expected WHAT=X, for example upper_arms=10")?;
        let factor = number(factor, "a stiffness against the body's, for example upper_arms=10")?;
        if !(FACTORS.0..=FACTORS.1).contains(&factor) {
            return Err(format!("stiffness {factor}: expected {} to {}", FACTORS.0, FACTORS.1));
        }
        Ok(Self { what: what.parse()?, factor })
    }
}

/// `NAME=WHAT`: a handle and the part that it holds.
#[derive(Clone, Debug, PartialEq)]
pub struct Hold {
    /// Name of the handle.
    pub handle: String,
    /// The part.
    pub what: Selector,
}

impl FromStr for Hold {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let (handle, what) = text.split_once('=').ok_or("expected NAME=WHAT, for example tip=sphere:0,1.6,0.05,0.15")?;
        if handle.trim().is_empty() {
            return Err("expected the name of a handle before the equals sign".into());
        }
        Ok(Self { handle: handle.trim().to_owned(), what: what.parse()? })
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    #[test]
    fn the_first_equals_sign_parts_handle_and_what() {
        let hold: Hold = " left hand =group:a=b".parse().unwrap();
        assert_eq!((hold.handle.as_str(), hold.what.what), ("left hand", What::Group("a=b".into())));
        for (text, word) in [("tip", "NAME=WHAT"), ("=head", "name of a handle"), ("tip=hnads", "'hands'")] {
            let error = text.parse::<Hold>().unwrap_err();
            assert!(error.contains(word), "{text}: {error}");
        }
    }

    #[test]
    fn segments_are_told_by_the_fewest_words() {
        use Segment::*;
        let words =
            |segments: &[Segment]| Selector::of_segments(segments.to_vec()).iter().map(Selector::to_string).collect::<Vec<_>>();
        assert_eq!(words(&[Head, RightHand, LeftHand, LeftFoot, RightFoot]), ["ends"]);
        assert_eq!(words(&[RightHand, LeftHand, LeftFoot]), ["hands", "left_foot"]);
        assert!(words(&[]).is_empty());
        assert_eq!(Segment::ALL.iter().map(|&s| words(&[s]).len()).sum::<usize>(), Segment::COUNT);
    }

    #[test]
    fn every_kind_is_read() {
        let what = |text: &str| text.parse::<Selector>().unwrap().what;
        assert_eq!(what("group:armor_*"), What::Group("armor_*".into()));
        assert_eq!(what("group: two words "), What::Group("two words".into()));
        assert_eq!(what("color:#ff8000"), What::Color { rgb: [255, 128, 0], tolerance: 10.0 });
        assert_eq!(what("Colour:0A0b0C~2.5"), What::Color { rgb: [10, 11, 12], tolerance: 2.5 });
        assert_eq!(what("sphere:1, -2.5,3e1,.5"), What::Sphere { centre: DVec3::new(1.0, -2.5, 30.0), radius: 0.5 });
        assert_eq!(what("near:LFIN, LWRA"), What::Near(vec!["LFIN".into(), "LWRA".into()]));
        assert_eq!(what("part:left_hand"), What::Part(&[&[Segment::LeftHand]]));
        assert_eq!(what("Upper-Arms"), What::Part(&[&[Segment::LeftUpperArm], &[Segment::RightUpperArm]]));
        assert_eq!("  part:head ".parse::<Selector>().unwrap().to_string(), "part:head");
    }

    #[test]
    fn mistakes_are_told_with_the_nearest_word_or_the_form() {
        for (text, word) in [
            ("hand", "'hands'"),
            ("hnads", "'hands'"),
            ("part:left_hnad", "'left_hand'"),
            ("grup:shoes", "'group:'"),
            ("xyzzyx:1", "group:, color:, sphere:, near:, part:"),
            ("part:", "expected one of head, trunk"),
            ("group:", "group:shoes"),
            ("color:#12345", "six hexadecimal digits"),
            ("color:#12345g", "six hexadecimal digits"),
            ("color:#+12345", "six hexadecimal digits"),
            ("color:#123456~300", "0 to 255"),
            ("color:#123456~x", "'x' is not a number"),
            ("sphere:1,2,3", "3 numbers"),
            ("sphere:1,2,3,4,5", "5 numbers"),
            ("sphere:1,2,x,4", "'x' is not a number"),
            ("sphere:1,2,nan,4", "'nan' is not a number"),
            ("sphere:1,2,3,0", "positive"),
            ("near:", "names of handles"),
            ("near:a,,b", "names of handles"),
        ] {
            let error = text.parse::<Selector>().unwrap_err();
            assert!(error.contains(word), "{text}: {error}");
        }
    }

    #[test]
    fn the_last_equals_sign_parts_what_and_stiffness() {
        let rule: Stiffness = "group:a=b=0.5".parse().unwrap();
        assert_eq!((rule.what.what, rule.factor), (What::Group("a=b".into()), 0.5));
        for (text, word) in [("hands", "WHAT=X"), ("hands=", "not a number"), ("hands=0", "0.001 to"), ("hnds=3", "'hands'")] {
            let error = text.parse::<Stiffness>().unwrap_err();
            assert!(error.contains(word), "{text}: {error}");
        }
    }

    #[test]
    fn patterns_match_whole_names() {
        for (pattern, name, expected) in [
            ("shoes", "shoes", true),
            ("shoes", "shoes2", false),
            ("shoe?", "shoes", true),
            ("shoe?", "shoe", false),
            ("*", "", true),
            ("a*b*c", "a12b3bc", true),
            ("a*b*c", "a12b3bd", false),
            ("*arm*", "left armour", true),
        ] {
            assert_eq!(matches(pattern, name), expected, "{pattern} {name}");
        }
    }
}
