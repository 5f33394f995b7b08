//! Frames by what surrounds a point: the affine map that fits the proxy's vertices there best.

use super::{HandleRows, MapKind, Proxy, wendland};
use crate::linalg::SparseRow;
use glam::{DMat3, DVec3};

/// Least radius of the surroundings, in diagonals.
const LEAST: f64 = 0.025;
/// Their radius for a point inside of the body, in depths below the skin: the skin around it is held too.
const REACH: f64 = 1.75;
/// Surroundings with fewer vertices grow.
const FEWEST: usize = 12;
/// So do those that are flatter: the determinant of their second moments over that of a ball with the same trace.
const FLAT: f64 = 1e-3;
const GROWTH: f64 = 1.3;

/// Builds the rows of frames.
#[derive(Clone, Debug)]
pub struct Surroundings<'a> {
    proxy: &'a Proxy,
    rows: HandleRows,
    /// Volume that belongs to each vertex.
    masses: Vec<f64>,
    /// Neighbours of each vertex along edges.
    starts: Vec<u32>,
    neighbours: Vec<u32>,
}

impl<'a> Surroundings<'a> {
    /// Prepares the queries against `proxy`.
    pub fn new(proxy: &'a Proxy) -> Self {
        let mut masses = vec![0.0; proxy.rest.len()];
        let mut edges = Vec::with_capacity(12 * proxy.tets.len());
        for tet in &proxy.tets {
            let [a, b, c, d] = tet.map(|v| proxy.rest[v as usize]);
            let quarter = (b - a).cross(c - a).dot(d - a).abs() / 24.0;
            for &v in tet {
                masses[v as usize] += quarter;
                edges.extend(tet.iter().filter(|&&w| w != v).map(|&w| (v, w)));
            }
        }
        edges.sort_unstable();
        edges.dedup();
        let mut starts = vec![0; proxy.rest.len() + 1];
        edges.iter().for_each(|&(v, _)| starts[v as usize + 1] += 1);
        for v in 0..proxy.rest.len() {
            starts[v + 1] += starts[v];
        }
        let neighbours = edges.into_iter().map(|(_, w)| w).collect();
        Self { proxy, rows: HandleRows::new(proxy, MapKind::Ring), masses, starts, neighbours }
    }

    /// Rows of a point inside, on or outside the body and of the ends of three axes along x, y, z: the points go with the affine map that fits the motion
    /// of the surroundings best. Applied to the rest pose they give the points; each sums to 1.
    ///
    /// The surroundings of a point inside reach to the skin on all sides; those of a point outside lie round the point of the skin that is nearest to it.
    /// They are connected: what is near through the air does not belong to them.
    pub fn frame(&self, point: DVec3) -> [SparseRow; 4] {
        let (mut centre, mut radius, mut seeds) = (point, LEAST, Vec::new());
        if let Some(foot) = self.rows.closest(point) {
            let depth = -self.rows.distance(point);
            if depth > 0.0 {
                radius = radius.max(REACH * depth);
            } else {
                centre = foot.point;
            }
            seeds.extend(self.proxy.boundary[foot.triangle]);
        }
        loop {
            let all = self.connected(&seeds, centre, radius);
            let patch = Patch::new(self, &all, centre, radius);
            let whole = all.len() == self.proxy.rest.len() || radius > 2.0;
            if whole || all.len() >= FEWEST && patch.roundness() > FLAT {
                return patch.frame(point);
            }
            radius *= GROWTH;
        }
    }

    /// Vertices in a ball that hang together with `seeds` inside of it, rising; the seeds too.
    fn connected(&self, seeds: &[u32], centre: DVec3, radius: f64) -> Vec<u32> {
        let mut found = seeds.to_vec();
        let mut seen = vec![false; self.proxy.rest.len()];
        seeds.iter().for_each(|&v| seen[v as usize] = true);
        let mut next = 0;
        while let Some(&v) = found.get(next) {
            next += 1;
            for &w in &self.neighbours[self.starts[v as usize] as usize..self.starts[v as usize + 1] as usize] {
                if !seen[w as usize] && self.proxy.rest[w as usize].distance(centre) < radius {
                    seen[w as usize] = true;
                    found.push(w);
                }
            }
        }
        found.sort_unstable();
        found
    }
}

/// Vertices with weights, their mean and second moments.
struct Patch<'a> {
    rest: &'a [DVec3],
    vertices: Vec<u32>,
    /// Sum to 1.
    weights: Vec<f64>,
    mean: DVec3,
    moments: DMat3,
}

impl<'a> Patch<'a> {
    fn new(around: &Surroundings<'a>, vertices: &[u32], centre: DVec3, radius: f64) -> Self {
        let rest = around.proxy.rest.as_slice();
        let weight = |&v: &u32| around.masses[v as usize] * wendland(rest[v as usize].distance(centre) / radius);
        let kept: Vec<(u32, f64)> = vertices.iter().map(|v| (*v, weight(v))).filter(|(_, w)| *w > 0.0).collect();
        let total: f64 = kept.iter().map(|(_, w)| w).sum();
        let (vertices, weights): (Vec<u32>, Vec<f64>) = kept.into_iter().map(|(v, w)| (v, w / total)).unzip();
        let terms = || vertices.iter().zip(&weights).map(|(&v, &w)| (rest[v as usize], w));
        let mean = terms().map(|(p, w)| p * w).sum::<DVec3>();
        let mut moments = DMat3::ZERO;
        for (p, w) in terms() {
            let d = p - mean;
            moments += DMat3::from_cols(d * d.x, d * d.y, d * d.z) * w;
        }
        Self { rest, vertices, weights, mean, moments }
    }

    fn third_of_trace(&self) -> f64 {
        (self.moments.x_axis.x + self.moments.y_axis.y + self.moments.z_axis.z) / 3.0
    }

    /// 1 for moments alike in all directions, 0 for points in a plane.
    fn roundness(&self) -> f64 {
        self.moments.determinant() / self.third_of_trace().powi(3)
    }

    /// The axes are as long as the vertices are from their mean, so that turns are held as hard as places.
    fn frame(&self, point: DVec3) -> [SparseRow; 4] {
        let inverse = self.moments.inverse();
        let axis = self.third_of_trace().sqrt();
        [DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::Z].map(|end| {
            let along = inverse * (point + end * axis - self.mean);
            let value = |(&v, &w): (&u32, &f64)| w * (1.0 + (self.rest[v as usize] - self.mean).dot(along));
            SparseRow { indices: self.vertices.clone(), values: self.vertices.iter().zip(&self.weights).map(value).collect() }
        })
    }
}

#[cfg(test)]
mod tests {
    use super::super::bodies;
    use super::*;

    /// A block with a slot from its far end: two arms.
    fn fork() -> Proxy {
        let block = bodies::bar([24, 5, 3], DVec3::new(1.0, 0.3, 0.15), 0.1);
        let centre = |t: &[u32; 4]| t.iter().map(|&v| block.rest[v as usize]).sum::<DVec3>() / 4.0;
        let tets = block.tets.iter().filter(|t| centre(t).x < -0.3 || centre(t).y.abs() > 0.03).copied().collect();
        bodies::body(block.rest.clone(), tets)
    }

    #[test]
    fn rows_are_exact_on_affine_maps_inside_on_and_outside() {
        let proxy = fork();
        let moved: Vec<DVec3> = proxy.rest.iter().map(|p| bodies::affine(*p)).collect();
        let around = Surroundings::new(&proxy);
        for point in [DVec3::new(-0.4, 0.0, 0.0), DVec3::new(0.3, 0.09, 0.075), DVec3::new(0.3, 0.3, 0.2)] {
            let rows = around.frame(point);
            let rest = rows.each_ref().map(|row| row.apply(&proxy.rest));
            assert!(rest[0].distance(point) < 1e-12, "{point}");
            for (k, (row, end)) in rows.iter().zip(rest).enumerate() {
                assert!(row.apply(&moved).distance(bodies::affine(end)) < 1e-11, "{point}");
                let axis = end - point;
                assert!(k == 0 || axis[k - 1] > 0.005 && (axis.length() - axis[k - 1]).abs() < 1e-12, "{point}: {axis}");
            }
        }
    }

    #[test]
    fn a_frame_outside_takes_what_is_round_the_skin_nearest_to_it() {
        let proxy = fork();
        let around = Surroundings::new(&proxy);
        // Straight above the flat top, farther and farther out.
        let foot = DVec3::new(-0.42, 0.02, 0.075);
        for height in [0.0, 0.01, 0.1, 0.4] {
            let rows = around.frame(foot + DVec3::Z * height);
            let far = |&v: &u32| proxy.rest[v as usize].distance(foot);
            let farthest = rows[0].indices.iter().map(far).fold(0.0, f64::max);
            assert!(farthest < 0.12, "{height}: {farthest}");
        }
    }

    #[test]
    fn a_frame_takes_what_hangs_together_and_no_more() {
        let proxy = fork();
        let around = Surroundings::new(&proxy);
        let (upper, middle) = (around.frame(DVec3::new(0.3, 0.04, 0.0)), around.frame(DVec3::new(0.3, 0.09, 0.0)));
        for row in [&upper[0], &middle[0]] {
            assert!(row.indices.len() >= FEWEST);
            let of_other_arm = row.indices.iter().filter(|&&v| proxy.rest[v as usize].y < 0.0).count();
            assert_eq!(of_other_arm, 0, "the other arm is near, but only through the air");
        }
        // From the middle of the arm all of its sides are held.
        let reach =
            |pick: fn(&DVec3) -> f64| middle[1].indices.iter().map(|&v| pick(&proxy.rest[v as usize])).fold(f64::MIN, f64::max);
        assert!(reach(|p| p.z) > 0.06 && reach(|p| -p.z) > 0.06 && reach(|p| p.y) > 0.13 && reach(|p| -p.y) > -0.04);
    }
}
