//! The edges of a triangle mesh.

use glam::DVec3;

/// Edges in ascending order of their ends, each with the corners on it. Corner `3 t + k` stands for the side of triangle `t` from its vertex `k` to the next.
pub(super) struct Edges {
    ends: Vec<[u32; 2]>,
    starts: Vec<u32>,
    corners: Vec<u32>,
}

impl Edges {
    /// Collects the edges of `triangles` over `vertices` vertices.
    pub(super) fn of(triangles: &[[u32; 3]], vertices: usize) -> Self {
        let mut bucket = vec![0u32; vertices + 1];
        let sides = || triangles.iter().flat_map(|t| [[t[0], t[1]], [t[1], t[2]], [t[2], t[0]]]);
        for [a, b] in sides() {
            bucket[a.min(b) as usize + 1] += 1;
        }
        for v in 0..vertices {
            bucket[v + 1] += bucket[v];
        }
        let mut fill = bucket.clone();
        let mut entries = vec![(0u32, 0u32); 3 * triangles.len()];
        for (corner, [a, b]) in sides().enumerate() {
            let slot = &mut fill[a.min(b) as usize];
            entries[*slot as usize] = (a.max(b), corner as u32);
            *slot += 1;
        }
        let mut edges = Self { ends: Vec::new(), starts: Vec::new(), corners: Vec::with_capacity(entries.len()) };
        for v in 0..vertices {
            let around = &mut entries[bucket[v] as usize..bucket[v + 1] as usize];
            around.sort_unstable();
            for &(w, corner) in around.iter() {
                if edges.ends.last() != Some(&[v as u32, w]) {
                    edges.ends.push([v as u32, w]);
                    edges.starts.push(edges.corners.len() as u32);
                }
                edges.corners.push(corner);
            }
        }
        edges.starts.push(edges.corners.len() as u32);
        edges
    }

    /// Number of edges.
    pub(super) fn len(&self) -> usize {
        self.ends.len()
    }

    /// Ends (smaller index first) and corners of each edge.
    pub(super) fn iter(&self) -> impl Iterator<Item = ([u32; 2], &[u32])> {
        (0..self.len()).map(|e| (self.ends[e], &self.corners[self.starts[e] as usize..self.starts[e + 1] as usize]))
    }

    /// The sides that belong to one triangle only, in the direction of that triangle.
    pub(super) fn open_sides(&self, triangles: &[[u32; 3]]) -> Vec<[u32; 2]> {
        self.iter().filter(|(_, corners)| corners.len() == 1).map(|(_, corners)| side(triangles, corners[0])).collect()
    }
}

/// The directed side that a corner stands for.
pub(super) fn side(triangles: &[[u32; 3]], corner: u32) -> [u32; 2] {
    let (t, k) = (triangles[corner as usize / 3], corner as usize % 3);
    [t[k], t[(k + 1) % 3]]
}

/// Twice the area of a triangle times its unit normal.
pub(super) fn double_area(points: &[DVec3], t: [u32; 3]) -> DVec3 {
    let [a, b, c] = t.map(|v| points[v as usize]);
    (b - a).cross(c - a)
}

/// Keeps the vertices that `triangles` use, in their order, and renumbers the triangles.
pub(super) fn compact(points: &[DVec3], triangles: &mut [[u32; 3]]) -> Vec<DVec3> {
    renumber(triangles, points.len()).into_iter().map(|v| points[v as usize]).collect()
}

/// Renumbers the triangles so that only used vertices count; returns the old number of each, in ascending order.
pub(super) fn renumber(triangles: &mut [[u32; 3]], vertices: usize) -> Vec<u32> {
    let mut number = vec![u32::MAX; vertices];
    for &v in triangles.iter().flatten() {
        number[v as usize] = 0;
    }
    let mut kept = Vec::new();
    for (v, n) in (0u32..).zip(&mut number).filter(|(_, n)| **n == 0) {
        *n = kept.len() as u32;
        kept.push(v);
    }
    for v in triangles.iter_mut().flatten() {
        *v = number[*v as usize];
    }
    kept
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn edges_come_in_order_with_their_corners() {
        let triangles = [[2, 0, 1], [1, 3, 2]];
        let edges = Edges::of(&triangles, 4);
        let found: Vec<_> = edges.iter().map(|(e, c)| (e, c.to_vec())).collect();
        assert_eq!(found, [([0, 1], vec![1]), ([0, 2], vec![0]), ([1, 2], vec![2, 5]), ([1, 3], vec![3]), ([2, 3], vec![4])]);
        assert_eq!(edges.open_sides(&triangles), [[0, 1], [2, 0], [1, 3], [3, 2]]);
    }

    #[test]
    fn compacting_keeps_the_order_of_the_used_vertices() {
        let points: Vec<DVec3> = (0..6).map(|i| DVec3::splat(f64::from(i))).collect();
        let mut triangles = [[5, 1, 3]];
        assert_eq!(compact(&points, &mut triangles), [DVec3::splat(1.0), DVec3::splat(3.0), DVec3::splat(5.0)]);
        assert_eq!(triangles, [[2, 0, 1]]);
    }
}
