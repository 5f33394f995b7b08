//! Cells of a part: one for a rigid part, a grid over its box for a soft one, and the weights by which its surface follows them.

use crate::linalg::eigen;
use glam::DVec3;
use std::collections::BTreeMap;

/// Reach of a cell's weight, in diagonals of a cell.
const REACH: f64 = 1.5;

/// Cells of one part.
#[derive(Clone, Debug, PartialEq)]
pub struct Cells {
    /// Corners of each.
    pub corners: Vec<[DVec3; 8]>,
    /// Pairs that share a face.
    pub neighbours: Vec<[u32; 2]>,
    /// Distance at which weights end; infinite for a single cell.
    reach: f64,
}

impl Cells {
    /// The box of a rigid part.
    pub fn single(points: &[DVec3]) -> Self {
        Self { reach: f64::INFINITY, ..Self::grid(points, [1; 3]) }
    }

    /// A grid over the box of a part along its principal axes, longest first; cells without a point are left out.
    pub fn grid(points: &[DVec3], counts: [u32; 3]) -> Self {
        let (centre, axes) = principal_axes(points);
        let local = |p: &DVec3| DVec3::from(axes.map(|a| a.dot(*p - centre)));
        let (lo, hi) =
            points.iter().map(local).fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(lo, hi), p| (lo.min(p), hi.max(p)));
        let counts = counts.map(|c| c.max(1));
        let count = DVec3::from(counts.map(f64::from));
        // A flat part has cells all the same.
        let step = (hi - lo).max(DVec3::splat(1e-9 * (hi - lo).length().max(1e-9))) / count;
        let cell = |p: &DVec3| {
            let k = ((local(p) - lo) / step).floor().max(DVec3::ZERO).min(count - 1.0);
            k.to_array().map(|x| x as u32)
        };
        let mut numbers: BTreeMap<[u32; 3], u32> = points.iter().map(|p| (cell(p), 0)).collect();
        numbers.values_mut().zip(0..).for_each(|(number, n)| *number = n);
        let world = |q: DVec3| centre + axes[0] * q.x + axes[1] * q.y + axes[2] * q.z;
        let corners = numbers.keys().map(|k| {
            std::array::from_fn(|c| {
                let corner = [k[0] + (c as u32 >> 2 & 1), k[1] + (c as u32 >> 1 & 1), k[2] + (c as u32 & 1)];
                world(lo + DVec3::from(corner.map(f64::from)) * step)
            })
        });
        let corners = corners.collect();
        let beside = |k: &[u32; 3], axis: usize| {
            let mut next = *k;
            next[axis] += 1;
            numbers.get(&next).copied()
        };
        let neighbours = numbers.iter().flat_map(|(k, &n)| (0..3).filter_map(move |axis| Some([n, beside(k, axis)?]))).collect();
        Self { corners, neighbours, reach: REACH * step.length() }
    }

    /// Middle of a cell.
    pub fn centre(&self, cell: usize) -> DVec3 {
        self.corners[cell].iter().sum::<DVec3>() / 8.0
    }

    /// The cell whose middle is nearest.
    pub fn at(&self, point: DVec3) -> usize {
        let distance = |&c: &usize| self.centre(c).distance_squared(point);
        (0..self.corners.len()).min_by(|a, b| distance(a).total_cmp(&distance(b))).unwrap_or(0)
    }

    /// Cells and their weights at a point: Wendland's function of the distance of their middles, so that neighbouring cells that move alike carry what is
    /// between them along. The weights sum to 1.
    pub fn weights(&self, point: DVec3) -> Vec<(usize, f64)> {
        let falloff = |c: usize| {
            let d = self.centre(c).distance(point) / self.reach;
            if d < 1.0 { (1.0 - d).powi(4) * (4.0 * d + 1.0) } else { 0.0 }
        };
        let mut weights: Vec<(usize, f64)> = if self.corners.len() == 1 {
            vec![(0, 1.0)]
        } else {
            (0..self.corners.len()).map(|c| (c, falloff(c))).filter(|w| w.1 > 0.0).collect()
        };
        let sum: f64 = weights.iter().map(|w| w.1).sum();
        if sum < 1e-12 {
            return vec![(self.at(point), 1.0)];
        }
        weights.iter_mut().for_each(|w| w.1 /= sum);
        weights
    }

    /// Cells that meet a box.
    pub fn within(&self, lo: DVec3, hi: DVec3) -> Vec<usize> {
        let meets = |&c: &usize| {
            let corners = &self.corners[c];
            let (l, h) = corners.iter().fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(l, h), p| (l.min(*p), h.max(*p)));
            l.cmple(hi).all() && h.cmpge(lo).all()
        };
        (0..self.corners.len()).filter(meets).collect()
    }

    /// Cells whose middle is in a box.
    pub fn inside(&self, lo: DVec3, hi: DVec3) -> Vec<usize> {
        let within = |p: DVec3| p.cmpge(lo).all() && p.cmple(hi).all();
        (0..self.corners.len()).filter(|&c| within(self.centre(c))).collect()
    }
}

/// Mean and principal axes of points, longest first, right-handed.
fn principal_axes(points: &[DVec3]) -> (DVec3, [DVec3; 3]) {
    let centre = points.iter().sum::<DVec3>() / points.len().max(1) as f64;
    let mut matrix = [[0.0; 3]; 3];
    for p in points {
        let d = (*p - centre).to_array();
        for i in 0..3 {
            for j in 0..3 {
                matrix[i][j] += d[i] * d[j];
            }
        }
    }
    let (_, axes) = eigen::symmetric(matrix);
    let [x, y] = [DVec3::from(axes[2]), DVec3::from(axes[1])];
    (centre, [x, y, x.cross(y)])
}
