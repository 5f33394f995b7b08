//! Scan → components: objects and groups by their names, pieces that hang together where there are none.

use super::part::Part;
use crate::scan::{Group, NONE, Scan};
use glam::DVec3;
use std::collections::{BTreeMap, HashMap};

/// A component of a scan.
#[derive(Clone, Debug, PartialEq)]
pub struct Component {
    /// Its name, of which there is one in the scan.
    pub name: String,
    /// Vertices of the scan that its faces use, ascending.
    pub vertices: Vec<u32>,
    /// Its triangles, over the scan's vertices.
    pub triangles: Vec<[u32; 3]>,
}

impl Component {
    fn new(name: String, triangles: Vec<[u32; 3]>) -> Self {
        let mut vertices: Vec<u32> = triangles.iter().flatten().copied().collect();
        vertices.sort_unstable();
        vertices.dedup();
        Self { name, vertices, triangles }
    }

    /// Several as one.
    pub fn merged(name: &str, components: &[&Component]) -> Self {
        Self::new(name.to_owned(), components.iter().flat_map(|c| c.triangles.iter().copied()).collect())
    }

    /// The part that it is; `points` are the scan's.
    pub fn part(&self, points: &[DVec3], size: f64) -> Part {
        Part::new(&self.name, points, &self.triangles, size)
    }
}

/// The components of a scan. With more than one object or group, these are the components; otherwise the pieces that hang together, vertices in one place
/// being one, largest first.
pub fn components(scan: &Scan) -> Vec<Component> {
    let mut of_group: BTreeMap<u32, Vec<[u32; 3]>> = BTreeMap::new();
    let triangles = triangles_with_faces(scan);
    for (face, triangle) in &triangles {
        let group = scan.look.face_groups.get(*face).copied().unwrap_or(NONE);
        of_group.entry(group).or_default().push(*triangle);
    }
    if of_group.len() > 1 {
        let mut names = Names::default();
        let name = |group: u32| match scan.look.groups.get(group as usize) {
            Some(Group { object: Some(name), .. } | Group { group: Some(name), .. }) => name.clone(),
            _ => "rest".to_owned(),
        };
        return of_group.into_iter().map(|(group, triangles)| Component::new(names.free(&name(group)), triangles)).collect();
    }
    let all: Vec<[u32; 3]> = triangles.into_iter().map(|t| t.1).collect();
    pieces(&scan.mesh.positions, &all)
        .into_iter()
        .zip(1..)
        .map(|(triangles, k)| Component::new(format!("part_{k}"), triangles))
        .collect()
}

fn triangles_with_faces(scan: &Scan) -> Vec<(usize, [u32; 3])> {
    let triangles = scan.mesh.triangulate();
    let vertex = |corner: u32| scan.mesh.faces.corners[corner as usize];
    triangles.faces.iter().zip(&triangles.corners).map(|(&face, corners)| (face as usize, corners.map(vertex))).collect()
}

/// Pieces of triangles that hang together, largest area first.
fn pieces(points: &[DVec3], triangles: &[[u32; 3]]) -> Vec<Vec<[u32; 3]>> {
    let mut of_place: HashMap<[u64; 3], usize> = HashMap::new();
    let mut parent: Vec<usize> = (0..points.len()).collect();
    let root = |parent: &mut Vec<usize>, mut x: usize| {
        while parent[x] != x {
            parent[x] = parent[parent[x]];
            x = parent[x];
        }
        x
    };
    for t in triangles {
        for &v in t {
            let v = v as usize;
            let key = points[v].to_array().map(|x| (x + 0.0).to_bits());
            let twin = *of_place.entry(key).or_insert(v);
            for other in [twin, t[0] as usize] {
                let (a, b) = (root(&mut parent, v), root(&mut parent, other));
                parent[a.max(b)] = a.min(b);
            }
        }
    }
    let mut of_root: BTreeMap<usize, (f64, Vec<[u32; 3]>)> = BTreeMap::new();
    for t in triangles {
        let [a, b, c] = t.map(|v| points[v as usize]);
        let piece = of_root.entry(root(&mut parent, t[0] as usize)).or_default();
        piece.0 += (b - a).cross(c - a).length();
        piece.1.push(*t);
    }
    let mut pieces: Vec<(f64, Vec<[u32; 3]>)> = of_root.into_values().collect();
    pieces.sort_by(|a, b| b.0.total_cmp(&a.0));
    pieces.into_iter().map(|p| p.1).collect()
}

/// Names that are taken.
#[derive(Default)]
struct Names(Vec<String>);

impl Names {
    /// The name, with a number behind it where it is taken.
    fn free(&mut self, name: &str) -> String {
        let mut free = name.to_owned();
        let mut number = 2;
        while self.0.contains(&free) {
            free = format!("{name}_{number}");
            number += 1;
        }
        self.0.push(free.clone());
        free
    }
}
