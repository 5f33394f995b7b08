//! Faces → triangles over glTF vertices, which have one texture coordinate and one normal each.

use crate::disjoint::DisjointSets;
use crate::scan::{NONE, Scan, Triangles};
use crate::surface::NormalVertices;
use std::ops::Range;

/// Triangles of one material, and of one rigid part where there are any.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Primitive {
    /// Index of the scan's material, or [`NONE`].
    pub(crate) material: u32,
    /// Index of the rigid part; 0 without parts.
    pub(crate) part: u16,
    /// Its glTF vertices.
    pub(crate) vertices: Range<usize>,
    /// Its indices, which count from the first of its vertices.
    pub(crate) indices: Range<usize>,
    /// Whether some corner has a texture coordinate.
    pub(crate) textured: bool,
}

/// One vertex per distinct scan vertex, texture coordinate and normal in each primitive.
///
/// The order is stable: first each scan vertex once, in the scan's order, then the further copies in the scan's order. So the vertices of a scan
/// with one material are the scan's own, with the copies of seams after them.
#[derive(Clone, Debug, Default)]
pub(crate) struct Geometry {
    /// Primitives in the order of their materials; faces without one come last.
    pub(crate) primitives: Vec<Primitive>,
    /// Scan vertex of each glTF vertex.
    pub(crate) vertices: Vec<u32>,
    /// Normal vertex of each glTF vertex.
    pub(crate) normals: Vec<u32>,
    /// Texture coordinate of each glTF vertex, origin at the top left; (0, 0) where the file has none.
    pub(crate) uvs: Vec<[f32; 2]>,
    /// Three per triangle.
    pub(crate) indices: Vec<u32>,
}

/// What tells glTF vertices of one scan vertex apart.
#[derive(Clone, Copy, PartialEq, Eq)]
struct Key {
    normal: u32,
    uv: Option<[u32; 2]>,
}

struct Copy {
    vertex: u32,
    key: Key,
    /// The copy of the same vertex found before this one.
    next: u32,
    first: bool,
}

impl Geometry {
    /// Splits the scan's vertices.
    pub(crate) fn of(scan: &Scan, normals: &NormalVertices) -> Self {
        Self::of_parts(scan, normals, |_| 0)
    }

    /// The same, part by part; `part` tells that of a scan vertex.
    pub(crate) fn of_parts(scan: &Scan, normals: &NormalVertices, part: impl Fn(u32) -> u16) -> Self {
        let Triangles { corners: triangles, faces } = scan.mesh.triangulate();
        let look = &scan.look;
        let material = |face: u32| look.face_materials.get(face as usize).copied().unwrap_or(NONE);
        let mut order: Vec<u32> = (0..triangles.len() as u32).collect();
        let sort = |&t: &u32| (part(scan.mesh.faces.corners[triangles[t as usize][0] as usize]), material(faces[t as usize]));
        order.sort_by_key(sort);
        let key = |corner: usize| Key { normal: normals.corners[corner], uv: uv_bits(scan, corner) };
        let mut geometry = Self::default();
        let mut heads = vec![NONE; scan.mesh.positions.len()];
        for group in order.chunk_by(|a, b| sort(a) == sort(b)) {
            let mut copies: Vec<Copy> = Vec::new();
            let corners = group.iter().flat_map(|&t| triangles[t as usize]).map(|c| c as usize);
            let found: Vec<u32> =
                corners.map(|corner| find_copy(&mut heads, &mut copies, scan.mesh.faces.corners[corner], key(corner))).collect();
            for copy in &copies {
                heads[copy.vertex as usize] = NONE;
            }
            geometry.append(sort(&group[0]), &copies, &found);
        }
        geometry
    }

    fn append(&mut self, (part, material): (u16, u32), copies: &[Copy], found: &[u32]) {
        let mut order: Vec<u32> = (0..copies.len() as u32).collect();
        order.sort_by_key(|&c| (!copies[c as usize].first, copies[c as usize].vertex, c));
        let mut place = vec![0u32; copies.len()];
        let (vertex_start, index_start) = (self.vertices.len(), self.indices.len());
        let mut textured = false;
        for (at, &c) in order.iter().enumerate() {
            let copy = &copies[c as usize];
            place[c as usize] = at as u32;
            self.vertices.push(copy.vertex);
            self.normals.push(copy.key.normal);
            self.uvs.push(copy.key.uv.map_or([0.0; 2], |bits| bits.map(f32::from_bits)));
            textured |= copy.key.uv.is_some();
        }
        self.indices.extend(found.iter().map(|&c| place[c as usize]));
        self.primitives.push(Primitive {
            material,
            part,
            vertices: vertex_start..self.vertices.len(),
            indices: index_start..self.indices.len(),
            textured,
        });
    }

    /// Pieces of the surface that do not touch each other, the largest first, as places among [`Self::scan_vertices`].
    pub(crate) fn pieces(&self, vertices: &[u32], places: &[u32]) -> Vec<Vec<u32>> {
        let mut sets = DisjointSets::new(vertices.len());
        for primitive in &self.primitives {
            for triangle in self.indices[primitive.indices.clone()].chunks_exact(3) {
                let place = |k: usize| places[self.vertices[primitive.vertices.start + triangle[k] as usize] as usize];
                for k in 1..3 {
                    sets.unite(place(0), place(k));
                }
            }
        }
        let (labels, count) = sets.labels();
        let mut pieces: Vec<Vec<u32>> = vec![Vec::new(); count];
        (0..).zip(labels).for_each(|(v, label)| pieces[label as usize].push(v));
        pieces.sort_by_key(|piece| std::cmp::Reverse(piece.len()));
        pieces
    }

    /// Scan vertices that are in the file, ascending.
    pub(crate) fn scan_vertices(&self) -> Vec<u32> {
        let mut used = self.vertices.clone();
        used.sort_unstable();
        used.dedup();
        used
    }
}

fn find_copy(heads: &mut [u32], copies: &mut Vec<Copy>, vertex: u32, key: Key) -> u32 {
    let head = heads[vertex as usize];
    let mut at = head;
    while at != NONE {
        if copies[at as usize].key == key {
            return at;
        }
        at = copies[at as usize].next;
    }
    let new = copies.len() as u32;
    copies.push(Copy { vertex, key, next: head, first: head == NONE });
    heads[vertex as usize] = new;
    new
}

/// The flipped coordinate of a corner as bits, so that equal values make no seam whatever their indices are.
fn uv_bits(scan: &Scan, corner: usize) -> Option<[u32; 2]> {
    let index = *scan.look.corner_uvs.get(corner)?;
    let [u, v] = *scan.look.uvs.get(index as usize)?;
    // Adding zero makes −0 and 0 the same.
    (u.is_finite() && v.is_finite()).then(|| [(u + 0.0).to_bits(), (1.0 - v).to_bits()])
}

/// Whether the surface is closed and its faces turn outwards, so that nobody ever sees their backs.
pub(crate) fn is_solid(scan: &Scan) -> bool {
    let faces = &scan.mesh.faces;
    let mut edges: Vec<(u32, u32, bool)> = Vec::with_capacity(faces.corners.len());
    let mut volume = 0.0;
    let origin = scan.mesh.positions.first().copied().unwrap_or_default();
    for face in faces.iter().filter(|f| f.len() > 2) {
        for (k, &a) in face.iter().enumerate() {
            let b = face[(k + 1) % face.len()];
            if a != b {
                edges.push((a.min(b), a.max(b), a < b));
            }
        }
        let p = |k: usize| scan.mesh.positions[face[k] as usize] - origin;
        volume += (1..face.len() - 1).map(|k| p(0).dot(p(k).cross(p(k + 1)))).sum::<f64>();
    }
    edges.sort_unstable();
    let mut pairs = edges.chunks_exact(2);
    let paired = pairs.all(|e| e[0].0 == e[1].0 && e[0].1 == e[1].1 && e[0].2 != e[1].2);
    paired && edges.len().is_multiple_of(2) && volume > 0.0
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scan::{Appearance, Faces, SurfaceMesh};
    use glam::DVec3;

    fn tetrahedron() -> Scan {
        let mut faces = Faces::default();
        for f in [[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]] {
            faces.push(f);
        }
        let positions = vec![DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::Z];
        Scan { mesh: SurfaceMesh { positions, faces }, ..Scan::default() }
    }

    fn plain(scan: &Scan) -> NormalVertices {
        NormalVertices {
            vertices: (0..scan.mesh.positions.len() as u32).collect(),
            corners: scan.mesh.faces.corners.clone(),
            twins: Vec::new(),
        }
    }

    #[test]
    fn a_plain_scan_keeps_its_vertices() {
        let scan = tetrahedron();
        let geometry = Geometry::of(&scan, &plain(&scan));
        assert_eq!(geometry.vertices, [0, 1, 2, 3]);
        assert_eq!(geometry.indices, scan.mesh.faces.corners);
        assert!(!geometry.primitives[0].textured);
    }

    #[test]
    fn seams_add_copies_after_the_scan_s_vertices_and_materials_are_separate() {
        let mut scan = tetrahedron();
        scan.look = Appearance {
            uvs: vec![[0.0, 0.0], [1.0, 0.25], [0.5, 1.0], [0.5, 1.0]],
            // Vertex 0 has uv 0 in the first face, 1 in the second; uv 2 and 3 are equal.
            corner_uvs: vec![0, 2, 2, 1, 2, 3, 2, 2, 2, 2, 0, 3],
            face_materials: vec![1, 1, 0, NONE],
            ..Appearance::default()
        };
        let geometry = Geometry::of(&scan, &plain(&scan));
        let materials: Vec<u32> = geometry.primitives.iter().map(|p| p.material).collect();
        assert_eq!(materials, [0, 1, NONE]);
        let second = &geometry.primitives[1];
        assert_eq!(geometry.vertices[second.vertices.clone()], [0, 1, 2, 3, 0]);
        assert_eq!(geometry.uvs[second.vertices.clone()][4], [1.0, 0.75]);
        assert_eq!(geometry.indices[second.indices.clone()], [0, 2, 1, 4, 1, 3]);
        assert_eq!(geometry.scan_vertices(), [0, 1, 2, 3]);
    }

    #[test]
    fn solid_means_closed_and_outwards() {
        let mut scan = tetrahedron();
        assert!(is_solid(&scan));
        scan.mesh.faces.corners.reverse();
        assert!(!is_solid(&scan), "inside out");
        scan.mesh.faces = tetrahedron().mesh.faces;
        scan.mesh.faces.starts.pop();
        scan.mesh.faces.corners.truncate(9);
        assert!(!is_solid(&scan), "open");
    }
}
