//! Sides, sizes and connection of tetrahedra.

use crate::disjoint::DisjointSets;
use glam::DVec3;

/// Corners of the face opposite each corner, seen from outside counter-clockwise when the volume is positive.
pub(super) const FACES: [[usize; 3]; 4] = [[1, 2, 3], [0, 3, 2], [0, 1, 3], [0, 2, 1]];

/// Six times the volume is the determinant of the edges from the first corner.
pub(super) fn volume(points: &[DVec3], tet: [u32; 4]) -> f64 {
    let [a, b, c, d] = tet.map(|v| points[v as usize]);
    (b - a).dot((c - a).cross(d - a)) / 6.0
}

/// Volume relative to the regular tetrahedron of the same root-mean-square edge: 1 at best, 0 when flat, negative when inverted.
pub(super) fn quality(points: &[DVec3], tet: [u32; 4]) -> f64 {
    let p = tet.map(|v| points[v as usize]);
    let squares: f64 = (0..4).flat_map(|i| (0..i).map(move |j| (i, j))).map(|(i, j)| p[i].distance_squared(p[j])).sum();
    6.0 * 2f64.sqrt() * volume(points, tet) / (squares / 6.0).powf(1.5)
}

/// One side of one tetrahedron.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct Side {
    /// Its vertices in ascending order.
    pub(super) key: [u32; 3],
    /// The tetrahedron.
    pub(super) tet: u32,
    /// The corner opposite the side.
    pub(super) corner: u8,
}

impl Side {
    /// Its vertices, counter-clockwise from outside.
    pub(super) fn face(&self, tets: &[[u32; 4]]) -> [u32; 3] {
        FACES[self.corner as usize].map(|k| tets[self.tet as usize][k])
    }
}

/// All sides in ascending order: those of one face stand together.
pub(super) fn sides(tets: &[[u32; 4]]) -> Vec<Side> {
    let mut sides = Vec::with_capacity(4 * tets.len());
    for (tet, t) in (0u32..).zip(tets) {
        for (corner, face) in (0u8..).zip(FACES) {
            let mut key = face.map(|k| t[k]);
            key.sort_unstable();
            sides.push(Side { key, tet, corner });
        }
    }
    sides.sort_unstable();
    sides
}

/// The sides of each face: one on the boundary, two inside, more where tetrahedra overlap.
pub(super) fn faces(sides: &[Side]) -> impl Iterator<Item = &[Side]> {
    sides.chunk_by(|a, b| a.key == b.key)
}

/// The sides that belong to one tetrahedron only, ordered by tetrahedron.
pub(super) fn boundary(tets: &[[u32; 4]]) -> Vec<Side> {
    let all = sides(tets);
    let mut found: Vec<Side> = faces(&all).filter(|face| face.len() == 1).map(|face| face[0]).collect();
    found.sort_unstable_by_key(|side| (side.tet, side.corner));
    found
}

/// Component of each tetrahedron, connected across faces, and how many there are.
pub(super) fn components_by_faces(tets: &[[u32; 4]]) -> (Vec<u32>, usize) {
    let mut sets = DisjointSets::new(tets.len());
    let all = sides(tets);
    for face in faces(&all) {
        face.windows(2).for_each(|pair| sets.unite(pair[0].tet, pair[1].tet));
    }
    sets.labels()
}

/// Component of each tetrahedron, connected by common vertices, numbered in the order of tetrahedra.
pub(super) fn components_by_vertices(tets: &[[u32; 4]], vertices: usize) -> Vec<u32> {
    let mut first = vec![u32::MAX; vertices];
    let mut sets = DisjointSets::new(tets.len());
    for (i, t) in (0u32..).zip(tets) {
        for &v in t {
            if first[v as usize] == u32::MAX {
                first[v as usize] = i;
            }
            sets.unite(first[v as usize], i);
        }
    }
    sets.labels().0
}
