//! Queries against points: the nearest few, all within a radius.

use glam::DVec3;
use std::ops::Range;

/// A k-d tree over points, balanced by medians.
#[derive(Clone, Debug, Default)]
pub struct PointTree {
    /// In the order of the tree: the middle of a range is its node, the halves beside it are the children.
    points: Vec<DVec3>,
    ids: Vec<u32>,
    /// Axis that a node splits.
    axes: Vec<u8>,
}

/// A point found by a query.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Neighbour {
    /// Index of the point.
    pub point: usize,
    /// Distance from the query.
    pub distance: f64,
}

impl PointTree {
    /// Builds the tree; the points are copied.
    pub fn new(points: &[DVec3]) -> Self {
        let mut ids: Vec<u32> = (0..points.len() as u32).collect();
        let mut axes = vec![0u8; points.len()];
        arrange(points, &mut ids, &mut axes);
        Self { points: ids.iter().map(|&id| points[id as usize]).collect(), ids, axes }
    }

    /// All points no further than `radius`, in ascending order of their index. `found` is cleared first.
    pub fn within(&self, query: DVec3, radius: f64, found: &mut Vec<Neighbour>) {
        found.clear();
        let mut reach = radius * radius;
        self.visit(0..self.points.len(), query, &mut reach, &mut |k, squared, reach| {
            if squared <= *reach {
                found.push(Neighbour { point: self.ids[k] as usize, distance: squared.sqrt() });
            }
        });
        found.sort_unstable_by_key(|n| n.point);
    }

    /// The `count` nearest points (fewer if there are fewer), nearest first, ties by index. `found` is cleared first.
    pub fn nearest(&self, query: DVec3, count: usize, found: &mut Vec<Neighbour>) {
        found.clear();
        if count == 0 {
            return;
        }
        // Squared distances until the end.
        self.visit(0..self.points.len(), query, &mut { f64::INFINITY }, &mut |k, distance, reach| {
            let new = Neighbour { point: self.ids[k] as usize, distance };
            let at = found.partition_point(|n| (n.distance, n.point) < (new.distance, new.point));
            if at < count {
                found.truncate(count - 1);
                found.insert(at, new);
                if found.len() == count {
                    *reach = found[count - 1].distance;
                }
            }
        });
        for n in found {
            n.distance = n.distance.sqrt();
        }
    }

    /// Calls `meet(entry, squared distance, reach)` for the nodes of a range, nearer side first; it may shorten the squared reach.
    fn visit(&self, range: Range<usize>, query: DVec3, reach: &mut f64, meet: &mut impl FnMut(usize, f64, &mut f64)) {
        if range.is_empty() {
            return;
        }
        let middle = range.start + range.len() / 2;
        meet(middle, query.distance_squared(self.points[middle]), reach);
        let axis = self.axes[middle] as usize;
        let across = query[axis] - self.points[middle][axis];
        let (below, above) = (range.start..middle, middle + 1..range.end);
        let (near, far) = if across < 0.0 { (below, above) } else { (above, below) };
        self.visit(near, query, reach, meet);
        if across * across <= *reach {
            self.visit(far, query, reach, meet);
        }
    }
}

/// Puts the median of the longest axis in the middle, and so on in both halves.
fn arrange(points: &[DVec3], ids: &mut [u32], axes: &mut [u8]) {
    if ids.is_empty() {
        return;
    }
    let (lo, hi) = ids
        .iter()
        .map(|&id| points[id as usize])
        .fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(lo, hi), p| (lo.min(p), hi.max(p)));
    let axis = (hi - lo).max_position();
    let middle = ids.len() / 2;
    let along = |id: &u32| points[*id as usize][axis];
    ids.select_nth_unstable_by(middle, |a, b| along(a).total_cmp(&along(b)).then(a.cmp(b)));
    axes[middle] = axis as u8;
    let (below, above) = ids.split_at_mut(middle);
    let (axes_below, axes_above) = axes.split_at_mut(middle);
    arrange(points, below, axes_below);
    arrange(points, &mut above[1..], &mut axes_above[1..]);
}
