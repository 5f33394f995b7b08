//! Scan surface → clean triangles: coincident vertices merged, degenerate and doubled triangles dropped.

use super::edges::compact;
use glam::DVec3;
use rayon::prelude::*;
use std::collections::HashMap;
use std::hash::{BuildHasherDefault, Hasher};

/// What remains of the input, and what was dropped.
pub(super) struct Welded {
    /// Positions, in the order of the input's vertices.
    pub(super) points: Vec<DVec3>,
    /// Triangles, each with its smallest vertex first.
    pub(super) triangles: Vec<[u32; 3]>,
}

/// Merges vertices within `tolerance` of each other; those of triangles are finite.
///
/// The result depends neither on the direction in which a triangle is listed nor on its first vertex (up to the direction itself).
pub(super) fn weld(points: &[DVec3], triangles: &[[u32; 3]], tolerance: f64) -> Welded {
    let mut used = vec![false; points.len()];
    for &v in triangles.iter().flatten() {
        used[v as usize] = true;
    }
    let representative = merge(points, &used, tolerance);
    let mut welded = Vec::with_capacity(triangles.len());
    for t in triangles {
        let t = smallest_first(t.map(|v| representative[v as usize]));
        if t[0] != t[1] && t[1] != t[2] && t[0] != t[2] {
            welded.push(t);
        }
    }
    drop_doubles(&mut welded);
    let points = compact(points, &mut welded);
    Welded { points, triangles: welded }
}

/// For each used vertex, the earlier vertex that stands for it (or itself).
fn merge(points: &[DVec3], used: &[bool], tolerance: f64) -> Vec<u32> {
    let mut representative = vec![u32::MAX; points.len()];
    let selected = || points.iter().zip(used).filter(|(_, used)| **used).map(|(p, _)| *p);
    let origin = selected().fold(DVec3::INFINITY, DVec3::min);
    let size = 4.0 * tolerance;
    let cell = |p: DVec3| ((p - origin) / size).floor().to_array().map(|x| x as i64);
    let key = |x: i64, y: i64, z: i64| (x as u64).wrapping_add((y as u64) << 21).wrapping_add((z as u64) << 42);
    let mut first: HashMap<u64, u32, BuildHasherDefault<CellHasher>> =
        HashMap::with_capacity_and_hasher(points.len(), Default::default());
    let mut next = vec![u32::MAX; points.len()];
    for (v, &p) in points.iter().enumerate().filter(|(v, _)| used[*v]) {
        let (lo, hi) = (cell(p - DVec3::splat(tolerance)), cell(p + DVec3::splat(tolerance)));
        let mut found = u32::MAX;
        for z in lo[2]..=hi[2] {
            for y in lo[1]..=hi[1] {
                for x in lo[0]..=hi[0] {
                    let mut candidate = first.get(&key(x, y, z)).copied().unwrap_or(u32::MAX);
                    while candidate != u32::MAX {
                        if points[candidate as usize].distance_squared(p) <= tolerance * tolerance {
                            found = found.min(candidate);
                        }
                        candidate = next[candidate as usize];
                    }
                }
            }
        }
        if found == u32::MAX {
            found = v as u32;
            let [x, y, z] = cell(p);
            let head = first.entry(key(x, y, z)).or_insert(u32::MAX);
            next[v] = std::mem::replace(head, v as u32);
        }
        representative[v] = found;
    }
    representative
}

/// Of triangles with the same three vertices only the first is kept.
fn drop_doubles(triangles: &mut Vec<[u32; 3]>) {
    let mut keys: Vec<([u32; 3], u32)> = triangles.iter().enumerate().map(|(i, t)| (sorted(*t), i as u32)).collect();
    keys.par_sort_unstable();
    let mut double = vec![false; triangles.len()];
    for pair in keys.windows(2).filter(|pair| pair[0].0 == pair[1].0) {
        double[pair[1].1 as usize] = true;
    }
    let mut i = 0;
    triangles.retain(|_| {
        i += 1;
        !double[i - 1]
    });
}

fn smallest_first(t: [u32; 3]) -> [u32; 3] {
    let k = (0..3).min_by_key(|&k| t[k]).unwrap_or(0);
    [t[k], t[(k + 1) % 3], t[(k + 2) % 3]]
}

fn sorted<const N: usize>(mut face: [u32; N]) -> [u32; N] {
    face.sort_unstable();
    face
}

/// Multiplicative hash of one `u64`; cells are spread well enough and it is several times faster than the default.
#[derive(Default)]
struct CellHasher(u64);

impl Hasher for CellHasher {
    fn finish(&self) -> u64 {
        self.0
    }

    fn write(&mut self, bytes: &[u8]) {
        for &b in bytes {
            self.write_u64(u64::from(b));
        }
    }

    fn write_u64(&mut self, value: u64) {
        let mixed = (self.0 ^ value).wrapping_mul(0x9E37_79B9_7F4A_7C15);
        self.0 = mixed ^ (mixed >> 32);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_soup_becomes_one_surface_and_bad_triangles_go() {
        let p = |x: f64, y: f64| DVec3::new(x, y, 0.0);
        let points = [p(0.0, 0.0), p(1.0, 0.0), p(0.0, 1.0), p(1.0, 1e-9), p(1.0, 1.0), p(1e-9, 1.0)];
        let triangles = [[2, 0, 1], [3, 4, 5], [5, 4, 3], [1, 3, 4]];
        let welded = weld(&points, &triangles, 1e-6);
        assert_eq!(welded.triangles, [[0, 1, 2], [1, 3, 2]]);
        assert_eq!(welded.points, [points[0], points[1], points[2], points[4]]);
    }

    #[test]
    fn vertices_meet_across_cell_borders() {
        // 200 pairs along a line with steps unrelated to the cell size: some pairs straddle a border.
        let points: Vec<DVec3> =
            (0..200).flat_map(|i| [0.0, 0.9e-3].map(|d| DVec3::new(f64::from(i) * 0.0377 + d, 0.0, 0.0))).collect();
        let representative = merge(&points, &vec![true; points.len()], 1e-3);
        assert!((0..200).all(|i| representative[2 * i] == 2 * i as u32 && representative[2 * i + 1] == 2 * i as u32));
    }
}
