//! The surface in a frame and an order of its own: the proxy does not depend on how the scan's vertices are numbered, and a scan that is
//! mirrored, or lies along other axes, has the mirrored or turned proxy.
//!
//! Decimation and tetrahedralization decide by rounding between what is equally good, so alike surfaces need the same bits. Positions are
//! brought onto a fine grid, the axes are ordered and signed by moments of the points, which are exact in integers, and vertices and triangles are
//! sorted. Where moments leave a choice, the frame with the first sorted surface is taken; a surface that is its own mirror image looks the same in both.

use super::Proxy;
use glam::DVec3;
use rayon::prelude::*;

/// Bits of a coordinate on the grid; its step is two thousandths of the distance at which vertices are welded.
const BITS: i32 = 30;

/// A surface in its own frame.
pub(super) struct Canonical {
    /// The frame.
    pub(super) frame: Frame,
    /// Positions, sorted along a curve that fills space, no two of them the same.
    pub(super) points: Vec<DVec3>,
    /// Triangles in order, each with its smallest vertex first.
    pub(super) triangles: Vec<[u32; 3]>,
    /// Triangles left out because a coordinate is not a finite number.
    pub(super) not_finite: usize,
}

impl Canonical {
    pub(super) fn of(points: &[DVec3], triangles: &[[u32; 3]]) -> Self {
        let finite = |t: &&[u32; 3]| t.iter().all(|&v| points[v as usize].is_finite());
        let mut used = vec![false; points.len()];
        let mut kept = 0;
        for t in triangles.iter().filter(finite) {
            kept += 1;
            t.iter().for_each(|&v| used[v as usize] = true);
        }
        let vertices: Vec<u32> = (0..points.len() as u32).filter(|&v| used[v as usize]).collect();
        let grid = Grid::of(vertices.iter().map(|&v| points[v as usize]));
        let cells: Vec<[i64; 3]> = vertices.iter().map(|&v| grid.cell(points[v as usize])).collect();
        let mut place = vec![u32::MAX; points.len()];
        vertices.iter().zip(0..).for_each(|(&v, i)| place[v as usize] = i);
        let mut corners: Vec<[u32; 3]> = Vec::with_capacity(kept);
        corners.extend(triangles.iter().filter(finite).map(|t| t.map(|v| place[v as usize])));

        let best = Sorted::first(&cells, &corners);
        Self {
            frame: best.frame,
            points: best.first.iter().map(|&i| best.frame.enter(grid.point(cells[i as usize]))).collect(),
            triangles: best.triangles(&corners),
            not_finite: triangles.len() - kept,
        }
    }
}

/// The frame of a surface whose vertices are all used, and their places in its order.
pub(crate) struct Order {
    frame: Frame,
    /// Of each vertex; those on one cell of the grid share one.
    pub(crate) rank: Vec<u32>,
}

impl Order {
    /// Shapes: `triangles` over `points`, which are finite.
    pub(crate) fn of(points: &[DVec3], triangles: &[[u32; 3]]) -> Self {
        let grid = Grid::of(points.iter().copied());
        let cells: Vec<[i64; 3]> = points.iter().map(|p| grid.cell(*p)).collect();
        let Sorted { frame, rank, .. } = Sorted::first(&cells, triangles);
        Self { frame, rank }
    }

    /// Points, on a grid of their own, in the frame.
    pub(crate) fn enter(&self, points: &[DVec3]) -> Vec<DVec3> {
        let grid = Grid::of(points.iter().copied());
        points.iter().map(|p| self.frame.enter(grid.point(grid.cell(*p)))).collect()
    }

    /// Triangles with the first of their corners, by numbers in the order, first, and in order; counter-clockwise in the frame where they are so outside.
    pub(crate) fn enter_triangles(&self, triangles: &mut [[u32; 3]]) {
        for t in triangles.iter_mut() {
            if self.frame.mirrors() {
                t.swap(1, 2);
            }
            let first = (0..3).min_by_key(|&k| t[k]).unwrap_or(0);
            t.rotate_left(first);
        }
        triangles.sort_unstable();
    }

    /// Triangles of the frame as they are outside.
    pub(crate) fn leave_triangles(&self, triangles: &mut [[u32; 3]]) {
        if self.frame.mirrors() {
            triangles.iter_mut().for_each(|t| t.swap(1, 2));
        }
    }
}

/// Cells of a power of two, so that going there and back is exact.
struct Grid {
    step: f64,
}

impl Grid {
    fn of(points: impl Iterator<Item = DVec3>) -> Self {
        let (lo, hi) = points.fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(lo, hi), p| (lo.min(p), hi.max(p)));
        let extent = (hi - lo).max_element();
        let step =
            if extent > 0.0 && extent.is_finite() { (extent.log2().ceil() as i32 - BITS).clamp(-1000, 1000) } else { -BITS };
        Self { step: 2f64.powi(step) }
    }

    fn cell(&self, p: DVec3) -> [i64; 3] {
        // Ties to even: the mirror image of a cell is the cell of the mirror image.
        p.to_array().map(|x| (x / self.step).round_ties_even() as i64)
    }

    fn point(&self, cell: [i64; 3]) -> DVec3 {
        DVec3::from_array(cell.map(|x| x as f64 * self.step))
    }
}

/// Axes in another order and direction.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Frame {
    /// Of each axis of the frame: the axis outside, and whether it runs backwards.
    axes: [(usize, bool); 3],
}

impl Default for Frame {
    fn default() -> Self {
        Self { axes: [(0, false), (1, false), (2, false)] }
    }
}

impl Frame {
    /// Frames that the moments of the points do not tell apart: one, unless the points are symmetric or have no extent.
    fn candidates(cells: &[[i64; 3]]) -> Vec<Self> {
        let moments = [0, 1, 2].map(|axis| moments(cells.iter().map(|c| c[axis])));
        let orders = [[0, 1, 2], [0, 2, 1], [1, 0, 2], [1, 2, 0], [2, 0, 1], [2, 1, 0]];
        let mut frames = Vec::new();
        for order in orders {
            if order.windows(2).any(|pair| moments[pair[0]].0 < moments[pair[1]].0) {
                continue;
            }
            for signs in 0..8u8 {
                let backwards = |k: usize| signs >> k & 1 == 1;
                let against = |k: usize| if backwards(k) { moments[order[k]].1 > 0 } else { moments[order[k]].1 < 0 };
                if !(0..3).any(against) {
                    frames.push(Self { axes: [0, 1, 2].map(|k| (order[k], backwards(k))) });
                }
            }
        }
        frames
    }

    /// From outside into the frame.
    fn enter(&self, p: DVec3) -> DVec3 {
        DVec3::from_array(self.axes.map(|(axis, backwards)| if backwards { -p[axis] } else { p[axis] }))
    }

    /// From the frame to the outside; exact.
    pub(super) fn leave(&self, p: DVec3) -> DVec3 {
        let mut out = DVec3::ZERO;
        for (k, (axis, backwards)) in self.axes.into_iter().enumerate() {
            out[axis] = if backwards { -p[k] } else { p[k] };
        }
        out
    }

    /// A proxy from the frame to the outside.
    pub(super) fn leave_with(&self, proxy: &mut Proxy) {
        proxy.rest.iter_mut().for_each(|p| *p = self.leave(*p));
        if self.mirrors() {
            proxy.tets.iter_mut().for_each(|t| t.swap(2, 3));
            proxy.boundary.iter_mut().for_each(|t| t.swap(1, 2));
        }
    }

    /// Whether what is on the left outside is on the right in the frame.
    pub(super) fn mirrors(&self) -> bool {
        let [a, b, c] = self.axes;
        let odd = (b.0 + 3 - a.0) % 3 != 1;
        odd ^ a.1 ^ b.1 ^ c.1
    }
}

/// Second and third moment about the middle, in half cells.
fn moments(coordinates: impl Iterator<Item = i64> + Clone) -> (i128, i128) {
    let (lo, hi) = coordinates.clone().fold((i64::MAX, i64::MIN), |(lo, hi), x| (lo.min(x), hi.max(x)));
    // At most 2³² points, each within 2³¹ half cells.
    coordinates.fold((0, 0), |(second, third), x| {
        let x = i128::from(2 * x - lo - hi);
        (second + x * x, third + x * x * x)
    })
}

/// The points in the order of a frame.
#[derive(Default)]
struct Sorted {
    frame: Frame,
    /// Different positions, ascending.
    keys: Vec<u128>,
    /// One of the vertices at each position.
    first: Vec<u32>,
    /// Position of each vertex.
    rank: Vec<u32>,
}

impl Sorted {
    /// In the frame, of those that the moments do not tell apart, in which the surface comes first.
    fn first(cells: &[[i64; 3]], corners: &[[u32; 3]]) -> Self {
        let frames = Frame::candidates(cells);
        let mut sorted = frames.iter().map(|&frame| Self::of(frame, cells));
        let mut best = sorted.next().unwrap_or_default();
        for other in sorted {
            let order = other.keys.cmp(&best.keys).then_with(|| other.sides(corners).cmp(&best.sides(corners)));
            if order.is_lt() {
                best = other;
            }
        }
        best
    }

    fn of(frame: Frame, cells: &[[i64; 3]]) -> Self {
        let enter = |cell: &[i64; 3]| frame.axes.map(|(axis, backwards)| if backwards { -cell[axis] } else { cell[axis] });
        let least = cells.iter().map(enter).fold([i64::MAX; 3], |m, c| [0, 1, 2].map(|k| m[k].min(c[k])));
        let key = |cell: &[i64; 3]| {
            let c = enter(cell);
            interleave([0, 1, 2].map(|k| (c[k] - least[k]) as u64))
        };
        let mut sorted: Vec<(u128, u32)> = cells.par_iter().map(key).zip(0..cells.len() as u32).collect();
        sorted.par_sort_unstable();
        let (mut keys, mut first, mut rank): (Vec<u128>, Vec<u32>, _) = (Vec::new(), Vec::new(), vec![0; cells.len()]);
        for (key, i) in sorted {
            if keys.last() != Some(&key) {
                keys.push(key);
                first.push(i);
            }
            rank[i as usize] = keys.len() as u32 - 1;
        }
        Self { frame, keys, first, rank }
    }

    /// The triangles whichever way they face, in order.
    fn sides(&self, corners: &[[u32; 3]]) -> Vec<[u32; 3]> {
        let mut sides: Vec<[u32; 3]> = corners.iter().map(|t| t.map(|i| self.rank[i as usize])).collect();
        sides.iter_mut().for_each(|t| t.sort_unstable());
        sides.par_sort_unstable();
        sides
    }

    fn triangles(&self, corners: &[[u32; 3]]) -> Vec<[u32; 3]> {
        let mirrors = self.frame.mirrors();
        let turned = |t: &[u32; 3]| {
            let [a, b, c] = t.map(|i| self.rank[i as usize]);
            let [a, b, c] = if mirrors { [a, c, b] } else { [a, b, c] };
            if a <= b && a <= c {
                [a, b, c]
            } else if b <= c {
                [b, c, a]
            } else {
                [c, a, b]
            }
        };
        let mut triangles: Vec<[u32; 3]> = corners.iter().map(turned).collect();
        // Whichever way they face: a scan with faces turned over has the same proxy.
        triangles.par_sort_unstable_by_key(|&[a, b, c]| ([a, b.min(c), b.max(c)], b));
        triangles
    }
}

/// The bits of three numbers below 2³² in turn (Morton 1966): neighbours in the order are neighbours in space.
fn interleave(cell: [u64; 3]) -> u128 {
    (0..32).rev().fold(0, |key, bit| cell.iter().fold(key, |key, x| key << 1 | u128::from(x >> bit & 1)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::splitmix::{mix, unit};

    fn surface() -> (Vec<DVec3>, Vec<[u32; 3]>) {
        let at = |k: u64| unit(mix(k)) - 0.5;
        let points = (0..60).map(|i| DVec3::new(at(3 * i), 0.5 * at(3 * i + 1), 0.7 * at(3 * i + 2))).collect();
        let triangle = |t: u32| {
            let corner = (mix(u64::from(t) + 1_000_000) % 60) as u32;
            [0, 1 + t % 20, 30 + t % 20].map(|k| (corner + k) % 60)
        };
        (points, (0..100).map(triangle).collect())
    }

    fn same(a: &Canonical, b: &Canonical) -> bool {
        a.points == b.points && a.triangles == b.triangles
    }

    #[test]
    fn numbering_mirroring_quarter_turns_and_rounding_do_not_matter() {
        let (points, triangles) = surface();
        let here = Canonical::of(&points, &triangles);
        let backwards: Vec<DVec3> = points.iter().rev().copied().collect();
        let renumbered: Vec<[u32; 3]> = triangles.iter().rev().map(|&[a, b, c]| [59 - b, 59 - c, 59 - a]).collect();
        assert!(same(&here, &Canonical::of(&backwards, &renumbered)));
        let flipped: Vec<[u32; 3]> = triangles.iter().map(|&[a, b, c]| [a, c, b]).collect();
        let mirrored: Vec<DVec3> = points.iter().map(|p| DVec3::new(-p.x, p.y, p.z)).collect();
        assert!(same(&here, &Canonical::of(&mirrored, &flipped)));
        let turned: Vec<DVec3> = points.iter().map(|p| DVec3::new(p.y, -p.x, p.z)).collect();
        assert!(same(&here, &Canonical::of(&turned, &triangles)));
        let rounded: Vec<DVec3> = points.iter().map(|p| *p * 1000.0 / 1000.0).collect();
        assert!(same(&here, &Canonical::of(&rounded, &triangles)));
        // A different mirror image: the triangles keep their direction, as seen from the points.
        assert!(!same(&here, &Canonical::of(&mirrored, &triangles)));
    }

    #[test]
    fn a_frame_is_left_as_it_was_entered() {
        let cube: Vec<[i64; 3]> = (0..8).map(|i| [i & 1, i >> 1 & 1, i >> 2]).collect();
        let frames = Frame::candidates(&cube);
        assert_eq!(frames.len(), 48);
        assert_eq!(frames.iter().filter(|f| f.mirrors()).count(), 24);
        let [a, b, c] = [DVec3::new(1.0, 2.0, 3.0), DVec3::new(-4.0, 1.0, 5.0), DVec3::new(2.0, 2.0, -1.0)];
        for frame in frames {
            assert_eq!(frame.leave(frame.enter(a)), a);
            let volume = frame.enter(a).cross(frame.enter(b)).dot(frame.enter(c)) / a.cross(b).dot(c);
            assert_eq!(volume < 0.0, frame.mirrors());
        }
    }

    #[test]
    fn where_moments_are_equal_the_triangles_decide() {
        // Two triangles over a square: the diagonal is the only thing that is not symmetric.
        let square = [DVec3::ZERO, DVec3::X, DVec3::X + DVec3::Y, DVec3::Y].map(|p| p - DVec3::new(0.5, 0.5, 0.0));
        let here = Canonical::of(&square, &[[0, 1, 2], [0, 2, 3]]);
        let there = Canonical::of(&square, &[[0, 1, 3], [1, 2, 3]]);
        let diagonal = |c: &Canonical| (0..4).filter(|v| c.triangles.iter().all(|t| t.contains(v))).collect::<Vec<_>>();
        assert_eq!(here.points, there.points);
        assert_eq!(diagonal(&here), diagonal(&there));
    }

    #[test]
    fn what_is_not_finite_is_counted_and_left_out() {
        let points = [DVec3::X, DVec3::Y, DVec3::Z, DVec3::NAN, DVec3::X];
        let found = Canonical::of(&points, &[[0, 1, 2], [1, 2, 3], [4, 1, 2]]);
        assert_eq!((found.points.len(), found.triangles.len(), found.not_finite), (3, 2, 1));
        let nothing = Canonical::of(&points, &[[3, 3, 3]]);
        assert!(nothing.points.is_empty() && nothing.triangles.is_empty());
    }
}
