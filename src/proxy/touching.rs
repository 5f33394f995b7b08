//! Bodies whose limbs touch or overlap, with known answer: poses of our own making, and a heavy man with his arms inside his hips.

#![allow(clippy::unwrap_used, clippy::print_stderr)]

use super::contacts::Skin;
use super::corpus::shared;
use super::decimate::decimate;
use super::edges::double_area;
use super::tests::assert_consistent;
use super::tetrahedra::volume;
use super::weld::weld;
use super::*;
use crate::scan::{self, UnitBox};
use crate::spatial::PointTree;
use glam::DQuat;
use std::path::Path;

/// Corners of a tetrahedron that are this much further apart before the limbs were turned were joined by the pose; of the diagonal.
const TORN: f64 = 0.04;

/// A person of height 1 on the ground, upright along Y, left side at +X. So few vertices that all of them become vertices of the proxy.
struct Figure {
    points: Vec<DVec3>,
    triangles: Vec<[u32; 3]>,
    /// Share of each vertex in the turn of the left and right arm.
    arms: [Vec<f64>; 2],
}

/// What a pose made of a figure.
struct Outcome {
    built: Built,
    /// Tetrahedra whose corners are far apart in the figure's own pose.
    torn: usize,
    /// Tetrahedra with corners on an arm and on the body.
    mixed: usize,
    /// Volume relative to what the surface encloses, overlaps counted twice.
    volume: f64,
}

fn smooth(x: f64) -> f64 {
    let x = x.clamp(0.0, 1.0);
    x * x * (3.0 - 2.0 * x)
}

fn bounds(points: &[DVec3]) -> (DVec3, DVec3) {
    points.iter().fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(lo, hi), p| (lo.min(*p), hi.max(*p)))
}

impl Figure {
    fn read(path: &Path, turn: DQuat) -> Self {
        let mesh = scan::read(path).unwrap().mesh;
        let unit_box = UnitBox::of(&mesh).unwrap();
        let points: Vec<DVec3> = mesh.positions.iter().map(|p| turn * unit_box.enter(*p)).collect();
        let welded = weld(&points, &mesh.vertex_triangles(), 1e-6);
        let (mut points, mut triangles) = (welded.points, welded.triangles);
        decimate(&mut points, &mut triangles, 2950);
        let (lo, hi) = bounds(&points);
        points.iter_mut().for_each(|p| *p = DVec3::new(p.x, p.y - lo.y, p.z) / (hi.y - lo.y));
        let skin = Skin::new(&points, &triangles, 1.0);
        let top = (0..points.len()).max_by(|a, b| points[*a].y.total_cmp(&points[*b].y)).unwrap();
        let from_top = skin.ways(top as u32, f64::INFINITY);
        let arms = [1.0, -1.0].map(|side| {
            // A finger tip is further from the head than all around it, which no place on the leg is at that height.
            let farthest = |v: usize| skin.around[v].iter().all(|&(w, _)| from_top[w as usize] <= from_top[v]);
            let hand = |v: &usize| (0.36..0.65).contains(&points[*v].y) && points[*v].x * side > 0.06 && farthest(*v);
            let tip = (0..points.len()).filter(hand).max_by(|a, b| from_top[*a].total_cmp(&from_top[*b])).unwrap();
            skin.ways(tip as u32, f64::INFINITY).iter().map(|way| smooth((0.42 - way) / 0.1)).collect()
        });
        Self { points, triangles, arms }
    }

    /// Arms turned to `arm` degrees off the vertical, legs turned in by `leg` degrees.
    fn posed(&self, arm: f64, leg: f64) -> Vec<DVec3> {
        let mut posed = self.points.clone();
        for (side, weights) in [1.0, -1.0].into_iter().zip(&self.arms) {
            let centre = |select: &dyn Fn(f64) -> bool| {
                let chosen: Vec<DVec3> = weights.iter().zip(&self.points).filter(|(w, _)| select(**w)).map(|(_, p)| *p).collect();
                chosen.iter().sum::<DVec3>() / chosen.len() as f64
            };
            let (shoulder, limb) = (centre(&|w| w > 0.2 && w < 0.8), centre(&|w| w == 1.0));
            let (s, c) = f64::to_radians(arm).sin_cos();
            let turn = DQuat::from_rotation_arc((limb - shoulder).normalize(), DVec3::new(side * s, -c, 0.0));
            let hip = DVec3::new(side * 0.05, 0.5, 0.0);
            for (v, rest) in self.points.iter().enumerate() {
                if weights[v] > 0.0 {
                    posed[v] = shoulder + DQuat::IDENTITY.slerp(turn, weights[v]) * (rest - shoulder);
                } else if rest.x * side > 0.0 && self.arms[0][v].max(self.arms[1][v]) == 0.0 {
                    let share = smooth((0.5 - rest.y) / 0.06) * smooth(rest.x.abs() / 0.01);
                    posed[v] = hip + DQuat::from_rotation_z(-side * leg.to_radians() * share) * (rest - hip);
                }
            }
        }
        posed
    }

    fn build(&self, name: &str, posed: &[DVec3]) -> Outcome {
        let (lo, hi) = bounds(posed);
        let (centre, diagonal) = ((lo + hi) * 0.5, (hi - lo).length());
        let posed: Vec<DVec3> = posed.iter().map(|p| (*p - centre) / diagonal).collect();
        let built = build(&posed, &self.triangles, &BuildOptions::default(), &|| Ok(())).unwrap();
        assert_consistent(&built.proxy);
        let (proxy, s) = (&built.proxy, &built.summary);
        let (tree, mut found) = (PointTree::new(&posed), Vec::new());
        let mut vertex = |p: &DVec3| {
            tree.nearest(*p, 1, &mut found);
            (found[0].distance < 1e-9).then_some(found[0].point)
        };
        let vertices: Vec<Option<usize>> = proxy.rest.iter().map(&mut vertex).collect();
        assert!(vertices.iter().flatten().count() * 20 > posed.len() * 19, "the vertices of the figure are in the proxy");
        let any = |t: &[u32; 4], joined: &dyn Fn(usize, usize) -> bool| {
            let known: Vec<usize> = t.iter().filter_map(|&v| vertices[v as usize]).collect();
            known.iter().any(|&a| known.iter().any(|&b| joined(a, b)))
        };
        let torn = |a: usize, b: usize| self.points[a].distance(self.points[b]) / diagonal - posed[a].distance(posed[b]) > TORN;
        let arm = |v: usize| self.arms[0][v].max(self.arms[1][v]);
        let third = |t: &[u32; 3]| posed[t[0] as usize].dot(double_area(&posed, *t)) / 6.0;
        let outcome = Outcome {
            torn: proxy.tets.iter().filter(|t| any(t, &torn)).count(),
            mixed: proxy.tets.iter().filter(|t| any(t, &|a, b| arm(a) > 0.9 && arm(b) == 0.0)).count(),
            volume: proxy.tets.iter().map(|t| volume(&proxy.rest, *t)).sum::<f64>()
                / self.triangles.iter().map(third).sum::<f64>(),
            built: built.clone(),
        };
        eprintln!(
            "{name}: torn {} · mixed {} · volume {:.4} · touching {} · overlap {:.2} % · joined {} · flat {} · {} · {} · {:?}",
            outcome.torn,
            outcome.mixed,
            outcome.volume,
            s.touching,
            100.0 * s.overlap,
            s.joined,
            s.flat,
            s.size(),
            s.remarks(),
            built.notes.iter().collect::<Vec<_>>()
        );
        outcome
    }
}

#[test]
fn arms_and_legs_that_touch_stay_apart() {
    let Some(folder) = shared("bodies") else { return };
    let figure = Figure::read(&folder.join("makehuman_male_body_apose_quads.obj.gz"), DQuat::IDENTITY);
    for (arm, leg, touches) in
        [(30.0, 0.0, false), (8.0, 7.0, false), (0.0, 10.0, false), (-4.0, 11.0, true), (-8.0, 12.0, true), (-12.0, 13.0, true)]
    {
        let Outcome { built, torn, mixed, volume } = figure.build(&format!("arms {arm}°, legs {leg}°"), &figure.posed(arm, leg));
        assert_eq!(built.summary.touching > 0, touches);
        assert_eq!((built.summary.pieces, built.summary.joined), (1, built.joined.len()));
        assert!(torn <= 50 && mixed <= 5 && volume > 0.985, "{torn} {mixed} {volume}");
    }
}

#[test]
fn arms_inside_the_hips_are_parted_from_them() {
    let Some(folder) = shared("bodies") else { return };
    let up = DQuat::from_rotation_x(-std::f64::consts::FRAC_PI_2);
    let figure = Figure::read(&folder.join("makehuman_heavy_armsdown_soup_mm_zup.stl"), up);
    let Outcome { built, mixed, volume, .. } = figure.build("heavy", &figure.points);
    assert_eq!(built.summary.pieces, 1);
    assert!(built.summary.overlap > 0.03 && mixed <= 20 && volume > 0.98, "{mixed} {volume}");
}
