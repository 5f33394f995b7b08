//! What the comments of a mesh file say of its unit and axes.

use super::text::name;
use crate::error::Notes;
use crate::space::{Axis, Evidence, Known, Space, Unit};

/// Comments that are looked at; some exporters write one per face.
const MOST: usize = 200;

/// The comments at the head of a file.
#[derive(Default)]
pub(super) struct Remarks(Vec<String>);

impl Remarks {
    /// Takes one comment, without its sign.
    pub(super) fn add(&mut self, comment: &[u8]) {
        if self.0.len() < MOST {
            self.0.push(name(&comment[..comment.len().min(500)]));
        }
    }

    /// Unit, up and forward axis as far as a comment states them alone: `metres, Z up, faces -Y`, `units: mm`, `up axis = Y`.
    ///
    /// A clause counts only if it says nothing else, so `0.5 mm noise` is no unit. Contradictions are noted and nothing is taken.
    pub(super) fn space(&self, notes: &mut Notes) -> Space {
        let clauses: Vec<String> =
            self.0.iter().flat_map(|text| text.split([',', ';', '|'])).map(str::to_ascii_lowercase).collect();
        let unit = agreed(clauses.iter().filter_map(|c| unit(c)), "unit", notes);
        let up = agreed(clauses.iter().filter_map(|c| up(c)), "up axis", notes);
        let forward = agreed(clauses.iter().filter_map(|c| forward(c)), "facing direction", notes);
        let across = |f: &Axis| up.is_some_and(|up: Axis| up.index != f.index);
        Space {
            unit: unit.map(|u| Known::new(u, Evidence::File)),
            up: up.map(|u| Known::new(u, Evidence::File)),
            forward: forward.filter(across).map(|f| Known::new(f.vector(), Evidence::File)),
        }
    }
}

/// What [`Remarks`] would read `space` from, as far as it comes from a file.
pub(crate) fn statements(space: &Space) -> Vec<String> {
    let from_file = |how| how == Evidence::File;
    let axis = |a: Axis| format!("{}{}", if a.negative { '-' } else { '+' }, ['X', 'Y', 'Z'][a.index]);
    let unit = space.unit.filter(|u| from_file(u.how)).map(|u| format!("units: {}", u.value));
    let up = space.up.filter(|u| from_file(u.how)).map(|u| format!("up axis: {}", axis(u.value)));
    let forward = space.forward.filter(|f| from_file(f.how)).map(|f| (f.value, Axis::nearest(f.value)));
    let forward =
        forward.filter(|(vector, nearest)| nearest.vector() == *vector).map(|(_, a)| format!("forward axis: {}", axis(a)));
    [unit, up, forward].into_iter().flatten().collect()
}

/// The one value that all statements agree on.
fn agreed<T: PartialEq + Copy>(mut values: impl Iterator<Item = T>, what: &str, notes: &mut Notes) -> Option<T> {
    let first = values.next()?;
    if values.any(|v| v != first) {
        notes.warn(format!("the comments of the file state more than one {what}: none is believed"));
        return None;
    }
    Some(first)
}

/// Splits `key: value`, `key = value`, `key value` if the clause begins with the key.
fn after<'a>(clause: &'a str, key: &str) -> Option<&'a str> {
    let rest = clause.trim().strip_prefix(key)?;
    let value = rest.trim_start_matches([' ', '\t', ':', '=']);
    (value.len() < rest.len()).then(|| value.trim())
}

fn unit(clause: &str) -> Option<Unit> {
    let stated =
        ["file units", "file unit", "unit of length", "length unit", "units", "unit"].iter().find_map(|key| after(clause, key));
    if let Some(value) = stated {
        let value = value
            .strip_prefix("are ")
            .or_else(|| value.strip_prefix("is "))
            .or_else(|| value.strip_prefix("in "))
            .unwrap_or(value);
        return value.parse().ok();
    }
    let word = clause.trim();
    // Full names only: a lone 'm' or 'in' may mean anything.
    (word.len() >= 4).then(|| word.parse().ok()).flatten()
}

fn up(clause: &str) -> Option<Axis> {
    let clause = clause.trim();
    let axis = clause.strip_suffix(" up").or_else(|| clause.strip_suffix("-up")).or_else(|| clause.strip_suffix(" is up"));
    axis.or_else(|| ["up axis", "up-axis", "upaxis", "up_axis", "up"].iter().find_map(|key| after(clause, key)))?.parse().ok()
}

fn forward(clause: &str) -> Option<Axis> {
    ["faces", "facing", "forward axis", "forward", "front"].iter().find_map(|key| after(clause, key))?.parse().ok()
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use glam::DVec3;

    fn space_of(comments: &[&str]) -> (Space, Notes) {
        let mut remarks = Remarks::default();
        comments.iter().for_each(|c| remarks.add(c.as_bytes()));
        let mut notes = Notes::default();
        (remarks.space(&mut notes), notes)
    }

    #[test]
    fn plain_statements_are_believed() {
        let (space, notes) = space_of(&[" CC0 1.0; source base.obj", " metres, Z up, faces -Y, A-pose"]);
        assert_eq!(space.unit.unwrap().value, Unit::Metre);
        assert_eq!(space.up.unwrap().value, "+Z".parse().unwrap());
        assert_eq!(space.forward.unwrap().value, -DVec3::Y);
        assert!(notes.is_empty());
        assert_eq!(space_of(&["Units: mm"]).0.unit.unwrap().value, Unit::Millimetre);
        assert_eq!(space_of(&["unit = inches"]).0.unit.unwrap().value, Unit::Inch);
        assert_eq!(space_of(&["up axis: Y"]).0.up.unwrap().value, "Y".parse().unwrap());
    }

    #[test]
    fn statements_read_back() {
        for comment in ["mm, Z up, faces -Y", "units: mm, Z up, faces -Y", "metres", "Y up"] {
            let (space, _) = space_of(&[comment]);
            let written = statements(&space);
            assert_eq!(space_of(&written.iter().map(String::as_str).collect::<Vec<_>>()).0, space);
        }
    }

    #[test]
    fn other_words_are_not() {
        let (space, notes) =
            space_of(&["0.5 mm noise", "m", "faces: 69451", "Faces -Y turned by +7 degrees", "cleaned up", "generated"]);
        assert_eq!(space, Space::default());
        assert!(notes.is_empty());
        let (space, notes) = space_of(&["metres", "units: mm"]);
        assert_eq!(space.unit, None);
        assert!(!notes.is_empty());
    }
}
