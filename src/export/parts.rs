//! Parts of a scan by name, for formats that list their faces: one per material, one per group.

use crate::scan::{Group, NONE, Scan};
use std::collections::HashSet;

/// Faces that belong together.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Part {
    /// The scan's own name.
    pub(super) name: String,
    /// Index into the materials or groups.
    pub(super) index: usize,
    /// Its faces, ascending.
    pub(super) faces: Vec<u32>,
}

/// The faces of every material that has any, in the materials' order.
pub(super) fn materials(scan: &Scan) -> Vec<Part> {
    parts(&scan.look.face_materials, scan.look.materials.len(), |m| scan.look.materials[m].name.clone())
}

/// The faces of every object and group that has any, in the groups' order.
pub(super) fn groups(scan: &Scan) -> Vec<Part> {
    let name = |g: usize| {
        let Group { object, group } = &scan.look.groups[g];
        [object, group].into_iter().flatten().map(String::as_str).collect::<Vec<_>>().join(" ")
    };
    parts(&scan.look.face_groups, scan.look.groups.len(), name)
}

fn parts(of_face: &[u32], count: usize, name: impl Fn(usize) -> String) -> Vec<Part> {
    let mut parts: Vec<Part> = (0..count).map(|index| Part { name: name(index), index, faces: Vec::new() }).collect();
    for (face, &part) in of_face.iter().enumerate().filter(|(_, part)| **part != NONE) {
        if let Some(part) = parts.get_mut(part as usize) {
            part.faces.push(face as u32);
        }
    }
    parts.retain(|part| !part.faces.is_empty());
    parts
}

/// Makes identifiers of names: ASCII letters, digits and `_`, no digit first, and none of them twice.
#[derive(Debug, Default)]
pub(super) struct Identifiers(HashSet<String>);

impl Identifiers {
    /// The identifier of a name; of a later one of the same spelling it ends in a number.
    pub(super) fn of(&mut self, name: &str) -> String {
        let mut plain: String = name.chars().map(|c| if c.is_ascii_alphanumeric() { c } else { '_' }).collect();
        if !plain.starts_with(|c: char| c.is_ascii_alphabetic() || c == '_') {
            plain.insert(0, '_');
        }
        let mut free = plain.clone();
        let mut number = 2;
        while !self.0.insert(free.clone()) {
            free = format!("{plain}_{number}");
            number += 1;
        }
        free
    }
}

/// Texture coordinates per corner as the caches hold them: values and one index per corner. Corners without any share a value (0, 0) at the
/// end. `None` where the scan has none.
pub(super) fn corner_uvs(scan: &Scan) -> Option<(Vec<[f32; 2]>, Vec<u32>)> {
    let look = &scan.look;
    if look.uvs.is_empty() || look.corner_uvs.is_empty() {
        return None;
    }
    let (mut values, mut indices) = (look.uvs.clone(), look.corner_uvs.clone());
    if indices.contains(&NONE) {
        let without = values.len() as u32;
        values.push([0.0; 2]);
        indices.iter_mut().filter(|i| **i == NONE).for_each(|i| *i = without);
    }
    Some((values, indices))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_become_identifiers_that_differ() {
        let mut identifiers = Identifiers::default();
        let names = ["skin tone", "skin-tone", "3d", "", "Größe", "skin_tone_2"];
        let made = names.map(|n| identifiers.of(n));
        assert_eq!(made, ["skin_tone", "skin_tone_2", "_3d", "_", "Gr__e", "skin_tone_2_2"]);
    }

    #[test]
    fn parts_hold_the_faces_in_order() {
        let mut scan = Scan::default();
        scan.look.groups = vec![
            Group { object: Some("o".into()), group: Some("g".into()) },
            Group::default(),
            Group { object: None, group: Some("h".into()) },
        ];
        scan.look.face_groups = vec![2, 0, NONE, 2];
        let expected = [("o g", 0, vec![1]), ("h", 2, vec![0, 3])];
        let found: Vec<(String, usize, Vec<u32>)> = groups(&scan).into_iter().map(|p| (p.name, p.index, p.faces)).collect();
        assert_eq!(found, expected.map(|(name, index, faces)| (name.to_owned(), index, faces)));
        assert!(materials(&scan).is_empty());
    }
}
