//! A captured surface on a scan of about its shape, by closest points alone.
//!
//! From many turns at once, each of the two surfaces is drawn to the nearest points of the other: drawn one way only, with its size free, a
//! surface shrinks into a corner of the other. At the end, where size and turn are nearly right, the capture alone is drawn to the scan,
//! whose surface is known between its points too.
//!
//! Source: Besl and McKay 1992; the farthest points are left out as in Chetverikov et al. 2002.

use super::similarity::{Held, Similarity, rigid, turn_between, upright};
use super::track::Track;
use crate::scan::{SurfaceMesh, UnitBox};
use crate::spatial::{PointTree, TriangleTree};
use crate::statistics::quantile;
use glam::{DQuat, DVec3};
use rayon::prelude::*;
use std::f64::consts::{FRAC_PI_2, TAU};

/// Frames that are tried at most, and tries of a frame with a turn.
const FRAMES: usize = 24;
const TRIES: usize = 400;
/// Points and rounds that tell frame and turn apart.
const COARSE: Effort = Effort { points: 150, rounds: 15 };
/// The same for the turns of the chosen frame.
const MEDIUM: Effort = Effort { points: 500, rounds: 40 };
/// The same at the end.
const FINE: Effort = Effort { points: 1500, rounds: 60 };
/// Share of the points that counts: others may lie on what the other surface does not have.
const KEPT: f64 = 0.9;
/// Turns about the up axis.
const YAWS: usize = 8;
/// How much the size may change: against where it starts, and at the end.
const SIZE: f64 = 1.6;
const SIZE_AT_END: f64 = 1.05;
/// Turns farther apart than this, in radians, are two ways to place the capture.
const APART: f64 = 0.75;

#[derive(Clone, Copy)]
struct Effort {
    points: usize,
    rounds: usize,
}

/// What is known of a placement before the shapes are looked at.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Given {
    /// Up axes of capture and scan; they are made parallel.
    pub ups: Option<(DVec3, DVec3)>,
    /// Turn about them and size.
    pub held: Held,
}

/// A placement of a captured surface.
#[derive(Clone, Copy, Debug)]
pub(super) struct Registration {
    /// Frame in which it was found.
    pub frame: usize,
    /// From the unmirrored capture into the unit box.
    pub placement: Similarity,
    /// Root mean square distance of the surfaces both ways, in diagonals of the scan.
    pub residual: f64,
    /// Angle in degrees to the next best way to turn the capture, and how many times as far apart the surfaces then are.
    pub rival: Option<(f64, f64)>,
}

/// The surface of a scan as points on it, and what they are near to.
pub(super) struct Target<'a> {
    tree: &'a TriangleTree,
    /// Any number of the first is spread evenly.
    points: Vec<DVec3>,
}

impl<'a> Target<'a> {
    pub(super) fn new(mesh: &SurfaceMesh, tree: &'a TriangleTree, unit_box: UnitBox) -> Self {
        Self { tree, points: on_surface(mesh, unit_box, FINE.points) }
    }

    /// The best placement in one of `frames`; `None` where no frame has a surface.
    pub(super) fn register(&self, track: &Track<'_>, frames: &[usize], given: &Given) -> Option<Registration> {
        let starts = starts(given);
        let step = frames.len().div_ceil(FRAMES.min(TRIES / starts.len())).max(1);
        let moved: Vec<Moved> = frames.iter().step_by(step).filter_map(|&f| Moved::of(track, f)).collect();
        let tried: Vec<(usize, DQuat)> = (0..moved.len()).flat_map(|m| starts.iter().map(move |&start| (m, start))).collect();
        let costs: Vec<f64> = tried
            .par_iter()
            .map(|&(m, start)| {
                let placed = self.start(&moved[m], start, given).and_then(|p| self.draw(&moved[m], p, given, COARSE, true));
                placed.map_or(f64::INFINITY, |p| self.apart(&moved[m], &p, COARSE))
            })
            .collect();
        let best = (0..tried.len()).min_by(|&a, &b| costs[a].total_cmp(&costs[b]))?;
        let here = &moved[tried[best].0];

        let mut ways: Vec<(f64, Similarity)> = starts
            .par_iter()
            .filter_map(|&start| {
                let placed = self.start(here, start, given).and_then(|p| self.draw(here, p, given, MEDIUM, true))?;
                Some((self.apart(here, &placed, MEDIUM), placed))
            })
            .collect();
        ways.sort_by(|a, b| a.0.total_cmp(&b.0));
        let &(least, way) = ways.first()?;
        let angle = |p: &Similarity| p.rotation.angle_between(way.rotation);
        let rival = ways.iter().find(|(_, p)| angle(p) > APART);
        let placement = self.draw(here, way, given, FINE, false).unwrap_or(way);
        Some(Registration {
            frame: here.frame,
            placement,
            residual: self.apart(here, &placement, FINE),
            rival: rival.map(|(cost, p)| (angle(p).to_degrees(), cost / least.max(f64::MIN_POSITIVE))),
        })
    }

    /// Turned, and brought to the scan's size and place by mean and spread.
    fn start(&self, moved: &Moved, rotation: DQuat, given: &Given) -> Option<Similarity> {
        let (to, size) = spread(&self.points);
        let (from, own) = spread(&moved.points);
        let scale = given.held.scale.unwrap_or(size / own);
        let scaled = Similarity { mirror: false, scale, rotation, translation: to - rotation * from * scale };
        (scale.is_finite() && scale > 0.0).then_some(scaled)
    }

    /// Draws the capture to the scan, and, if `both`, the scan to the capture.
    fn draw(&self, moved: &Moved, start: Similarity, given: &Given, effort: Effort, both: bool) -> Option<Similarity> {
        let mut placed = start;
        let room = if both { SIZE } else { SIZE_AT_END };
        for _ in 0..effort.rounds {
            let mut pairs = self.to_scan(moved, &placed, effort.points);
            if both {
                pairs.extend(self.to_capture(moved, &placed, effort.points));
            }
            let next = solve(&pairs, given, start.scale / room..=start.scale * room)?;
            let moves = (next.scale / placed.scale).ln().abs()
                + next.rotation.angle_between(placed.rotation)
                + (next.translation - placed.translation).length();
            placed = next;
            if moves < 1e-7 {
                break;
            }
        }
        Some(placed)
    }

    /// Points of the capture with the nearest ones of the scan.
    fn to_scan(&self, moved: &Moved, placed: &Similarity, most: usize) -> Vec<(DVec3, DVec3)> {
        let pair = |&p: &DVec3| self.tree.closest(placed.apply(p)).map(|c| (c.distance, (p, c.point)));
        nearest(moved.points.iter().take(most).filter_map(pair).collect())
    }

    /// The nearest points of the capture with those of the scan.
    fn to_capture(&self, moved: &Moved, placed: &Similarity, most: usize) -> Vec<(DVec3, DVec3)> {
        let mut near = Vec::new();
        let mut pair = |&to: &DVec3| {
            moved.tree.nearest(placed.undo(to), 1, &mut near);
            near.first().map(|n| (n.distance, (moved.points[n.point], to)))
        };
        nearest(self.points.iter().take(most).filter_map(&mut pair).collect())
    }

    /// Root mean square distance both ways. Between its points the capture's surface is not known: half their spacing does not count.
    fn apart(&self, moved: &Moved, placed: &Similarity, effort: Effort) -> f64 {
        let gap = 0.5 * moved.spacing * placed.scale;
        let square = |pairs: &[(DVec3, DVec3)], gap: f64| {
            let far = |(p, q): &(DVec3, DVec3)| (placed.apply(*p).distance(*q) - gap).max(0.0).powi(2);
            pairs.iter().map(far).sum::<f64>() / pairs.len().max(1) as f64
        };
        let (a, b) = (self.to_scan(moved, placed, effort.points), self.to_capture(moved, placed, effort.points));
        ((square(&a, 0.0) + square(&b, gap)) / 2.0).sqrt()
    }
}

/// A captured surface in a frame.
struct Moved {
    frame: usize,
    points: Vec<DVec3>,
    tree: PointTree,
    /// Median distance of a point from the next.
    spacing: f64,
}

impl Moved {
    /// `None` where fewer than four points are there, or in one place.
    fn of(track: &Track<'_>, frame: usize) -> Option<Self> {
        let points: Vec<DVec3> = (0..track.take.markers()).filter_map(|i| track.point(frame, i)).collect();
        let tree = PointTree::new(&points);
        let mut near = Vec::new();
        let mut gap = |p: &DVec3| {
            tree.nearest(*p, 2, &mut near);
            near.last().map_or(0.0, |n| n.distance)
        };
        let mut gaps: Vec<f64> = points.iter().map(&mut gap).collect();
        let spacing = quantile(&mut gaps, 0.5)?;
        (points.len() >= 4 && spread(&points).1 > 0.0).then_some(Self { frame, points, tree, spacing })
    }
}

/// Mean, and root mean square distance from it.
fn spread(points: &[DVec3]) -> (DVec3, f64) {
    let n = points.len().max(1) as f64;
    let mean = points.iter().sum::<DVec3>() / n;
    (mean, (points.iter().map(|p| p.distance_squared(mean)).sum::<f64>() / n).sqrt())
}

/// The pairs without those that are farthest apart.
fn nearest(mut pairs: Vec<(f64, (DVec3, DVec3))>) -> Vec<(DVec3, DVec3)> {
    pairs.sort_by(|a, b| a.0.total_cmp(&b.0));
    let kept = (pairs.len() as f64 * KEPT).ceil() as usize;
    pairs.into_iter().take(kept).map(|p| p.1).collect()
}

/// Turns to begin with: about up where it is known, else the 24 of a cube and these between its axes.
fn starts(given: &Given) -> Vec<DQuat> {
    if let Some((from, up)) = given.ups {
        let about = |yaw: f64| DQuat::from_axis_angle(up, yaw) * turn_between(from, up);
        return match given.held.yaw {
            Some(yaw) => vec![about(yaw)],
            None => (0..YAWS).map(|k| about(k as f64 * TAU / YAWS as f64)).collect(),
        };
    }
    let faces = [DVec3::X, -DVec3::X, DVec3::Y, -DVec3::Y, DVec3::Z, -DVec3::Z].map(|axis| turn_between(DVec3::Z, axis));
    let quarter = |k: usize| DQuat::from_rotation_z(k as f64 * FRAC_PI_2 / 2.0);
    faces.into_iter().flat_map(|face| (0..8).map(move |k| face * quarter(k))).collect()
}

/// The similarity that takes the first points nearest to the second, of a size in `sizes`.
fn solve(pairs: &[(DVec3, DVec3)], given: &Given, sizes: std::ops::RangeInclusive<f64>) -> Option<Similarity> {
    let size = |scale: f64| scale.clamp(*sizes.start(), *sizes.end());
    if let Some((from, up)) = given.ups {
        let pairs: Vec<_> = pairs.iter().map(|&(a, b)| (a, b, 1.0)).collect();
        let found = upright(&pairs, from, up, given.held)?.placement;
        if given.held.scale.is_some() || sizes.contains(&found.scale) {
            return Some(found);
        }
        return Some(upright(&pairs, from, up, Held { scale: Some(size(found.scale)), ..given.held })?.placement);
    }
    let (rotation, _) = rigid(pairs)?;
    let n = pairs.len() as f64;
    let (from, to) = (pairs.iter().map(|p| p.0).sum::<DVec3>() / n, pairs.iter().map(|p| p.1).sum::<DVec3>() / n);
    let (mut along, mut own) = (0.0, 0.0);
    for &(a, b) in pairs {
        along += (rotation * (a - from)).dot(b - to);
        own += (a - from).length_squared();
    }
    let scale = given.held.scale.unwrap_or_else(|| size(along / own));
    let placed = Similarity { mirror: false, scale, rotation, translation: to - rotation * from * scale };
    (scale.is_finite() && scale > 0.0).then_some(placed)
}

/// Points on a surface in its unit box, in proportion to area; any number of the first is spread over all of it.
fn on_surface(mesh: &SurfaceMesh, unit_box: UnitBox, count: usize) -> Vec<DVec3> {
    // Multiples of these fill the line and the square evenly (Roberts 2018).
    const LINE: f64 = 0.618_033_988_749_894_9;
    const SQUARE: [f64; 2] = [0.754_877_666_246_692_7, 0.569_840_290_998_053_3];
    let place = |corner: u32| unit_box.enter(mesh.positions[mesh.faces.corners[corner as usize] as usize]);
    let mut triangles = Vec::new();
    let mut total = 0.0;
    for [a, b, c] in mesh.triangulate().corners.into_iter().map(|t| t.map(place)) {
        let area = 0.5 * (b - a).cross(c - a).length();
        if area > 0.0 {
            total += area;
            triangles.push((total, [a, b, c]));
        }
    }
    let fraction = |i: usize, step: f64| ((i + 1) as f64 * step).fract();
    let point = |i: usize| {
        let at = triangles.partition_point(|t| t.0 <= fraction(i, LINE) * total);
        let [a, b, c] = triangles[at.min(triangles.len() - 1)].1;
        let (u, v) = (fraction(i, SQUARE[0]), fraction(i, SQUARE[1]));
        let (u, v) = if u + v > 1.0 { (1.0 - u, 1.0 - v) } else { (u, v) };
        a + (b - a) * u + (c - a) * v
    };
    if triangles.is_empty() { Vec::new() } else { (0..count).map(point).collect() }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;
    use crate::capture::MarkerTake;
    use crate::scan::Faces;

    fn tree(mesh: &SurfaceMesh, unit_box: UnitBox) -> TriangleTree {
        let points = unit_box.enter_all(&mesh.positions);
        let vertices = |corner: u32| mesh.faces.corners[corner as usize];
        let triangles: Vec<[u32; 3]> = mesh.triangulate().corners.into_iter().map(|t| t.map(vertices)).collect();
        TriangleTree::new(&points, &triangles)
    }

    /// A take of some vertices of a mesh, which `truth` brings into its unit box.
    fn take(mesh: &SurfaceMesh, unit_box: UnitBox, truth: &Similarity) -> (Vec<DVec3>, MarkerTake) {
        // In an order that spreads the first of them over the mesh.
        let count = mesh.positions.len();
        let places: Vec<DVec3> = (0..count.min(1900)).map(|i| unit_box.enter(mesh.positions[i * 7919 % count])).collect();
        let from = places.iter().map(|&p| truth.undo(p).to_array().map(|x| x as f32)).collect();
        let labels = (0..places.len()).map(|i| format!("v{i}")).collect();
        (places, MarkerTake { labels, points: from, ..MarkerTake::default() })
    }

    fn body() -> SurfaceMesh {
        let path = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("fixtures/scan.obj");
        crate::scan::read(&path).unwrap().mesh
    }

    #[test]
    fn a_body_of_another_size_and_turn_finds_its_place() {
        let mesh = body();
        let unit_box = UnitBox::of(&mesh).unwrap();
        let tree = tree(&mesh, unit_box);
        let target = Target::new(&mesh, &tree, unit_box);
        let lying = DQuat::from_scaled_axis(DVec3::new(1.1, -0.4, 1.7));
        let upright = DQuat::from_rotation_y(2.5) * turn_between(DVec3::Z, DVec3::Y);
        for (rotation, ups) in [(lying, None), (upright, Some((DVec3::Z, DVec3::Y))), (upright, None)] {
            let truth = Similarity { mirror: false, scale: 4.3e-4, rotation, translation: DVec3::new(0.7, -3.0, 1.1) };
            let (places, take) = take(&mesh, unit_box, &truth);
            let given = Given { ups, held: Held::default() };
            let found = target.register(&Track { take: &take, mirror: false }, &[0], &given).unwrap();
            let far = |(i, p): (usize, &DVec3)| found.placement.apply(take.point(0, i).unwrap()).distance(*p);
            let worst = places.iter().enumerate().map(far).fold(0.0, f64::max);
            // The vertices that were taken are not spread evenly: some of the scan is farther from them than half their spacing.
            assert!(worst < 3e-4 && found.residual < 3e-3, "{ups:?}: {worst:.2e} {:.2e}", found.residual);
            assert!(found.rival.unwrap().1 > 2.5, "{ups:?}: {:?}", found.rival);
        }
    }

    #[test]
    fn what_is_given_is_kept() {
        let mesh = body();
        let unit_box = UnitBox::of(&mesh).unwrap();
        let tree = tree(&mesh, unit_box);
        let target = Target::new(&mesh, &tree, unit_box);
        let truth = Similarity { mirror: false, scale: 1.0, rotation: DQuat::from_rotation_y(0.4), translation: DVec3::ZERO };
        let (_, take) = take(&mesh, unit_box, &truth);
        let held = Held { yaw: Some(0.1), scale: Some(1.07) };
        let given = Given { ups: Some((DVec3::Y, DVec3::Y)), held };
        let found = target.register(&Track { take: &take, mirror: false }, &[0], &given).unwrap();
        assert_eq!((found.placement.scale, found.rival), (1.07, None));
        assert!(found.placement.rotation.angle_between(DQuat::from_rotation_y(0.1)) < 1e-9);
    }

    #[test]
    fn a_thing_that_is_round_fits_in_many_ways() {
        let mut mesh = SurfaceMesh { positions: Vec::new(), faces: Faces::default() };
        for ring in 0..60u32 {
            for side in 0..24u32 {
                let (sin, cos) = (f64::from(side) * TAU / 24.0).sin_cos();
                mesh.positions.push(DVec3::new(cos, f64::from(ring) * 0.1, sin));
                if ring > 0 {
                    let (a, b) = (24 * ring + side, 24 * ring + (side + 1) % 24);
                    mesh.faces.push([a, b, b - 24, a - 24]);
                }
            }
        }
        let unit_box = UnitBox::of(&mesh).unwrap();
        let tree = tree(&mesh, unit_box);
        let (_, take) = take(&mesh, unit_box, &Similarity { scale: 0.2, ..Similarity::IDENTITY });
        let given = Given { ups: Some((DVec3::Y, DVec3::Y)), held: Held::default() };
        let target = Target::new(&mesh, &tree, unit_box);
        let found = target.register(&Track { take: &take, mirror: false }, &[0], &given).unwrap();
        assert!(found.rival.unwrap().1 < 1.2, "{:?}", found.rival);
    }
}
