//! Marker labels → places on a body: the dictionary of marker names.

use super::Marker;
use super::segments::{Segment, Side, Skeleton};
use glam::DVec3;
use serde::Deserialize;
use std::collections::BTreeMap;
use std::sync::LazyLock;

/// A stretch of the body as the dictionary names it; `Shoulder` is the joint, which moves with the trunk.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub(crate) enum Part {
    Pelvis,
    Trunk,
    Head,
    Shoulder,
    #[serde(rename = "uarm")]
    UpperArm,
    #[serde(rename = "farm")]
    Forearm,
    Hand,
    Thigh,
    Shank,
    Foot,
}

/// Where a marker sits on any body: a point of a segment's axis and a ray from there to the skin.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Place {
    /// The landmark, or the label in a set with places of its own.
    pub landmark: &'static str,
    pub part: Part,
    pub side: Side,
    /// Position along the axis: 0 at the proximal joint, 1 at the distal one.
    pub t: f64,
    /// Out (away from the mid plane; of a place without a side: to the left), forward, along.
    pub ray: DVec3,
    /// Trust in the place: 1 for a bony point, 0.5 for a soft one.
    pub weight: f64,
    /// Where the user says that it is on the scan, in the unit box.
    pub at: Option<DVec3>,
}

impl Place {
    /// The segment that the place moves with.
    pub(crate) fn segment(&self) -> Segment {
        let sided = |left, right| if self.side == Side::Right { right } else { left };
        match self.part {
            Part::Pelvis => Segment::Pelvis,
            Part::Trunk | Part::Shoulder => Segment::Trunk,
            Part::Head => Segment::Head,
            Part::UpperArm => sided(Segment::LeftUpperArm, Segment::RightUpperArm),
            Part::Forearm => sided(Segment::LeftForearm, Segment::RightForearm),
            Part::Hand => sided(Segment::LeftHand, Segment::RightHand),
            Part::Thigh => sided(Segment::LeftThigh, Segment::RightThigh),
            Part::Shank => sided(Segment::LeftShank, Segment::RightShank),
            Part::Foot => sided(Segment::LeftFoot, Segment::RightFoot),
        }
    }
}

impl Place {
    /// Whether a bone runs from this place, at the near joint of a segment, to the other at its far joint.
    pub(crate) fn is_bone_with(&self, far: &Place) -> bool {
        let near = match self.part {
            Part::Shoulder => far.part == Part::UpperArm,
            Part::UpperArm => far.part == Part::Forearm && self.t >= 0.9,
            Part::Thigh => far.part == Part::Shank && self.t >= 0.9,
            _ => false,
        };
        near && self.side == far.side && far.t >= 0.9
    }
}

/// The labels of a take with their places.
#[derive(Clone, Debug, Default)]
pub(crate) struct Names {
    /// Place per marker; `None` for labels that the dictionary does not know and for further copies of a landmark.
    pub places: Vec<Option<Place>>,
    /// The marker set that the labels belong to, where one is recognised.
    pub set: Option<&'static str>,
}

impl Names {
    /// Number of markers with a place.
    pub(crate) fn count(&self) -> usize {
        self.places.iter().flatten().count()
    }

    /// Markers with a place, by index.
    pub(crate) fn iter(&self) -> impl Iterator<Item = (usize, &Place)> {
        self.places.iter().enumerate().filter_map(|(i, p)| p.as_ref().map(|p| (i, p)))
    }
}

/// Finds the places of labels. `coverage` is the number of frames in which each marker is present: where two labels mean one landmark, the
/// fuller one takes it. `swap` exchanges left and right.
pub(crate) fn name(labels: &[String], coverage: &[usize], swap: bool) -> Names {
    let table = &*DICTIONARY;
    let stripped = strip(labels);
    let set = table.set_of(&stripped);
    let own = set.filter(|set| !set.places.is_empty());
    let mut places: Vec<Option<Place>> = stripped
        .iter()
        .map(|label| match own {
            Some(set) => set.places.get(last_word(label)).cloned(),
            None => table.look_up(label),
        })
        .collect();
    if swap {
        for place in places.iter_mut().flatten() {
            place.side = place.side.other();
            if place.side == Side::Middle {
                place.ray.x = -place.ray.x;
            }
        }
    }
    for i in 0..places.len() {
        let Some(place) = places[i].clone() else { continue };
        let rival = (0..i)
            .find(|&j| places[j].as_ref().is_some_and(|other| other.landmark == place.landmark && other.side == place.side));
        if let Some(j) = rival {
            let loser = if coverage[i] > coverage[j] { j } else { i };
            places[loser] = None;
        }
    }
    Names { places, set: set.map(|set| set.name) }
}

/// All landmarks of the dictionary, those with a side on both.
pub(crate) fn all_places() -> Vec<Place> {
    let mut out: Vec<Place> = Vec::new();
    let sided = DICTIONARY.sided.values().flat_map(|p| [Side::Left, Side::Right].map(|side| Place { side, ..p.clone() }));
    for place in DICTIONARY.whole.values().cloned().chain(sided) {
        if !out.iter().any(|other| other.landmark == place.landmark && other.side == place.side) {
            out.push(place);
        }
    }
    out
}

/// Whether the dictionary knows a label.
pub(crate) fn is_known(label: &str) -> bool {
    DICTIONARY.look_up(label).is_some()
}

impl Names {
    /// Takes what the user says of labels: other meanings, places on the scan, and none.
    pub(crate) fn correct(&mut self, labels: &[String], markers: &BTreeMap<String, Marker>, body: Option<&Skeleton>) {
        for (label, place) in labels.iter().zip(&mut self.places) {
            match markers.get(label) {
                None => {}
                Some(Marker::Ignored) => *place = None,
                Some(Marker::As(word)) => *place = DICTIONARY.look_up(word),
                Some(Marker::At(at)) => match (place, body) {
                    (Some(place), _) => place.at = Some(*at),
                    (place, Some(body)) => *place = Some(Place::pinned(*at, body)),
                    (_, None) => {}
                },
            }
        }
    }
}

/// Landmark of a place that only the user gives.
const PINNED: &str = "pinned";

impl Place {
    /// Whether it is known by nothing but its place.
    pub(crate) fn is_nameless(&self) -> bool {
        self.landmark == PINNED
    }

    /// A place on the segment of the body that is nearest to a point.
    fn pinned(at: DVec3, body: &Skeleton) -> Self {
        let distance = |segment: Segment| {
            let bone = body.bone(segment);
            let along = ((at - bone.origin).dot(bone.axis) / bone.length).clamp(0.0, 1.0);
            at.distance(bone.origin + bone.axis * bone.length * along)
        };
        let nearest = Segment::ALL.into_iter().min_by(|a, b| distance(*a).total_cmp(&distance(*b))).unwrap_or(Segment::Pelvis);
        use Segment::*;
        let (part, side) = match nearest {
            Pelvis => (Part::Pelvis, Side::Middle),
            Trunk => (Part::Trunk, Side::Middle),
            Head => (Part::Head, Side::Middle),
            LeftUpperArm => (Part::UpperArm, Side::Left),
            LeftForearm => (Part::Forearm, Side::Left),
            LeftHand => (Part::Hand, Side::Left),
            LeftThigh => (Part::Thigh, Side::Left),
            LeftShank => (Part::Shank, Side::Left),
            LeftFoot => (Part::Foot, Side::Left),
            RightUpperArm => (Part::UpperArm, Side::Right),
            RightForearm => (Part::Forearm, Side::Right),
            RightHand => (Part::Hand, Side::Right),
            RightThigh => (Part::Thigh, Side::Right),
            RightShank => (Part::Shank, Side::Right),
            RightFoot => (Part::Foot, Side::Right),
        };
        Self { landmark: PINNED, part, side, t: 0.5, ray: DVec3::ZERO, weight: 1.0, at: Some(at) }
    }
}

/// Drops subject prefixes: everything up to the last `:`, and a `Word_` or `Word.` that most labels share.
fn strip(labels: &[String]) -> Vec<String> {
    let mut out: Vec<String> = labels.iter().map(|l| l.rsplit(':').next().unwrap_or(l).trim().to_owned()).collect();
    for separator in ['_', '.'] {
        let mut counts = BTreeMap::<&str, usize>::new();
        for label in &out {
            if let Some((head, _)) = label.split_once(separator) {
                *counts.entry(head).or_default() += 1;
            }
        }
        let shared = counts.into_iter().max_by_key(|&(_, n)| n);
        // One letter is a side (`L_IAS`), not a subject.
        if let Some((head, n)) = shared
            && n * 10 >= out.len() * 6
            && head.len() > 1
        {
            let prefix = format!("{head}{separator}");
            out = out.iter().map(|l| l.strip_prefix(&prefix).unwrap_or(l).to_owned()).collect();
        }
    }
    out
}

fn last_word(label: &str) -> &str {
    label.rsplit('_').next().unwrap_or(label)
}

struct Set {
    name: &'static str,
    labels: Vec<&'static str>,
    /// Own places by label; empty in sets whose labels name landmarks.
    places: BTreeMap<&'static str, Place>,
}

struct Dictionary {
    /// Core of the label → landmark, with a side around it.
    sided: BTreeMap<&'static str, Place>,
    /// Whole label → landmark.
    whole: BTreeMap<&'static str, Place>,
    sets: Vec<Set>,
}

/// Share of a set's labels that must be there: sets with places of their own use names that others give to other points.
const SET_SHARE: f64 = 0.8;

impl Dictionary {
    fn look_up(&self, label: &str) -> Option<Place> {
        let core: String =
            label.chars().filter(|c| !c.is_whitespace() && !matches!(c, '_' | '.' | '-')).flat_map(char::to_lowercase).collect();
        let bare = core.strip_prefix('p');
        let whole = |word: &str| self.whole.get(word).cloned();
        if let Some(place) = whole(&core).or_else(|| bare.and_then(whole)) {
            return Some(place);
        }
        let sided = |core: &str, side: Side| self.sided.get(core).map(|p| Place { side, ..p.clone() });
        for word in [Some(core.as_str()), bare].into_iter().flatten() {
            for (mark, side) in SIDES {
                if let Some(place) = word.strip_prefix(mark).and_then(|rest| sided(rest, side)) {
                    return Some(place);
                }
            }
        }
        for (mark, side) in SIDES {
            if let Some(place) = core.strip_suffix(mark).and_then(|rest| sided(rest, side)) {
                return Some(place);
            }
            for stem in ["waist", "head", "back"] {
                let rest = core.strip_prefix(stem).and_then(|rest| rest.strip_prefix(mark));
                if let Some(place) = rest.and_then(|rest| sided(&format!("{stem}{rest}"), side)) {
                    return Some(place);
                }
            }
        }
        None
    }

    fn set_of(&self, labels: &[String]) -> Option<&Set> {
        let share = |set: &Set| {
            let there = set.labels.iter().filter(|l| labels.iter().any(|x| last_word(x) == **l || x == **l)).count();
            there as f64 / set.labels.len().max(1) as f64
        };
        self.sets
            .iter()
            .map(|set| (set, share(set)))
            .filter(|&(_, share)| share >= SET_SHARE)
            .max_by(|a, b| a.1.total_cmp(&b.1))
            .map(|(set, _)| set)
    }
}

/// Words before letters, so that `left…` is not read as `l` + `eft…`.
const SIDES: [(&str, Side); 4] = [("left", Side::Left), ("right", Side::Right), ("l", Side::Left), ("r", Side::Right)];

static DICTIONARY: LazyLock<Dictionary> = LazyLock::new(|| {
    let file: &'static File =
        Box::leak(Box::new(toml::from_str(include_str!("markers.toml")).expect("the table is part of this crate and tested")));
    let mut sided = BTreeMap::new();
    let mut whole = BTreeMap::new();
    for (landmark, entry) in &file.landmark {
        let place = Place {
            landmark,
            part: entry.segment,
            side: Side::Middle,
            t: entry.t,
            ray: entry.ray.into(),
            weight: entry.weight,
            at: None,
        };
        let map = if entry.sided { &mut sided } else { &mut whole };
        for name in &entry.names {
            map.insert(name.as_str(), place.clone());
        }
    }
    let sets = file
        .set
        .iter()
        .map(|(name, entry)| Set {
            name,
            labels: entry.labels.iter().map(String::as_str).collect(),
            places: entry
                .place
                .iter()
                .map(|(label, p)| {
                    let place = Place {
                        landmark: label,
                        part: p.segment,
                        side: p.side,
                        t: p.t,
                        ray: p.ray.into(),
                        weight: entry.weight,
                        at: None,
                    };
                    (label.as_str(), place)
                })
                .collect(),
        })
        .collect();
    Dictionary { sided, whole, sets }
});

#[derive(Deserialize)]
struct File {
    landmark: BTreeMap<String, LandmarkEntry>,
    set: BTreeMap<String, SetEntry>,
}

#[derive(Deserialize)]
struct LandmarkEntry {
    sided: bool,
    segment: Part,
    t: f64,
    ray: [f64; 3],
    weight: f64,
    names: Vec<String>,
}

#[derive(Deserialize)]
struct SetEntry {
    labels: Vec<String>,
    #[serde(default)]
    weight: f64,
    #[serde(default)]
    place: BTreeMap<String, PlaceEntry>,
}

#[derive(Deserialize)]
struct PlaceEntry {
    segment: Part,
    #[serde(default)]
    side: Side,
    #[serde(default)]
    t: f64,
    ray: [f64; 3],
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    fn names(labels: &[&str]) -> Names {
        let labels: Vec<String> = labels.iter().map(|&l| l.to_owned()).collect();
        name(&labels, &vec![10; labels.len()], false)
    }

    #[test]
    fn labels_of_many_makers_find_their_landmark_and_side() {
        use Side::{Left, Middle, Right};
        for (label, landmark, side) in [
            ("LASI", "asis", Left),
            ("L_IAS", "asis", Left),
            ("R.ASIS", "asis", Right),
            ("r asis", "asis", Right),
            ("LeftHeel", "heel", Left),
            ("WaistLFront", "asis", Left),
            ("WaistRBack", "psis", Right),
            ("pRightASI", "asis", Right),
            ("pC7SpinalProcess", "c7", Middle),
            ("Matt:LFHD", "head_front_side", Left),
            ("LWRB", "wrist_pinky", Left),
            ("RTHI", "thigh", Right),
            ("CLAV", "clav", Middle),
            ("L_CLAV", "clav_side", Left),
            ("HeadL", "head_side", Left),
            ("V.Sacral", "sacrum", Middle),
            ("r should", "acromion", Right),
            ("l mall", "ankle_out", Left),
            ("RBAC", "back_side", Right),
            ("LMT5", "toe_out", Left),
            ("R_FM1", "toe_in", Right),
        ] {
            let place = names(&[label]).places[0].clone().unwrap_or_else(|| panic!("{label} has no place"));
            assert_eq!((place.landmark, place.side), (landmark, side), "{label}");
        }
    }

    #[test]
    fn words_that_name_nothing_have_no_place() {
        for label in ["", "prop", "RBAC-1", "LF01", "Hip1", "RFT1", "sword tip"] {
            assert!(names(&[label]).places[0].is_none(), "{label}");
        }
    }

    #[test]
    fn the_fuller_of_two_copies_takes_the_landmark() {
        let labels = ["LTHI".to_owned(), "LThigh".to_owned(), "RTHI".to_owned()];
        let named = name(&labels, &[10, 90, 90], false);
        assert!(named.places[0].is_none());
        assert_eq!(named.places[1].as_ref().unwrap().landmark, "thigh");
    }

    #[test]
    fn every_set_of_landmarks_is_known_label_by_label() {
        for set in &DICTIONARY.sets {
            // OptiTrack's one HeadSide has no side.
            let known = |l: &str| l == "HeadSide" || DICTIONARY.look_up(l).is_some();
            let unknown: Vec<_> = set.labels.iter().filter(|l| set.places.is_empty() && !known(l)).collect();
            assert!(unknown.is_empty(), "{}: {unknown:?}", set.name);
        }
    }

    #[test]
    fn arena_labels_need_most_of_their_set() {
        let set = DICTIONARY.sets.iter().find(|s| s.name == "optitrack-arena").unwrap();
        let labels: Vec<String> = set.labels.iter().map(|l| format!("Skeleton_{l}")).collect();
        let named = name(&labels, &vec![1; labels.len()], false);
        assert_eq!(named.set, Some("optitrack-arena"));
        assert_eq!(named.count(), 36);
        let few: Vec<String> = labels[..20].to_vec();
        assert_eq!(name(&few, &[1; 20], false).set, None);
    }

    #[test]
    fn swapped_sides_change_places() {
        let named = name(&["LASI".to_owned(), "C7".to_owned()], &[1, 1], true);
        assert_eq!(named.places[0].as_ref().unwrap().side, Side::Right);
        assert_eq!(named.places[1].as_ref().unwrap().side, Side::Middle);
    }
}
