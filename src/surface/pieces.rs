//! Loose pieces of a scan: hair strips, lashes, buttons, debris.

use crate::disjoint::DisjointSets;
use crate::scan::Faces;
use glam::DVec3;

/// Pieces with a smaller box than this share of the unit box's diagonal move as one.
const SMALL: f64 = 0.05;
/// A piece is loose when its vertices are on average further off the body than this: patches of the skin itself, cut apart by seams or
/// by an exporter, have to keep following it vertex by vertex, or the cuts would open.
const OFF: f64 = 0.005;

/// Vertices of each small piece that lies off the body. Vertices in the same place are connected. `distance`: of a vertex, from the body.
pub(super) fn loose_pieces(points: &[DVec3], faces: &Faces, distance: impl Fn(usize) -> f64) -> Vec<Vec<u32>> {
    let mut sets = DisjointSets::new(points.len());
    let mut in_face = vec![false; points.len()];
    for face in faces.iter().filter(|f| !f.is_empty()) {
        face.iter().for_each(|&v| {
            in_face[v as usize] = true;
            sets.unite(face[0], v);
        });
    }
    let key = |v: u32| points[v as usize].to_array().map(|x| (x + 0.0).to_bits());
    let mut by_place: Vec<u32> = (0..points.len() as u32).filter(|&v| in_face[v as usize]).collect();
    by_place.sort_unstable_by_key(|&v| (key(v), v));
    by_place.windows(2).filter(|w| key(w[0]) == key(w[1])).for_each(|w| sets.unite(w[0], w[1]));

    let mut by_root: Vec<(u32, u32)> = by_place.into_iter().map(|v| (sets.find(v), v)).collect();
    by_root.sort_unstable();
    by_root
        .chunk_by(|a, b| a.0 == b.0)
        .map(|piece| piece.iter().map(|&(_, v)| v).collect::<Vec<u32>>())
        .filter(|piece| {
            let of = |v: &u32| points[*v as usize];
            let (lo, hi) =
                piece.iter().map(of).fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(lo, hi), p| (lo.min(p), hi.max(p)));
            let off = piece.iter().map(|&v| distance(v as usize)).sum::<f64>() / piece.len() as f64;
            (hi - lo).length() < SMALL && off > OFF
        })
        .collect()
}
