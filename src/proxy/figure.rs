//! A person in poses of our own making whose limbs touch or overlap: what belongs to which limb is known, and so is where it would be in the A pose.

#![allow(clippy::unwrap_used, clippy::print_stderr)]

use super::contacts::Skin;
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
pub(crate) struct Figure {
    pub(crate) points: Vec<DVec3>,
    triangles: Vec<[u32; 3]>,
    /// Share of each vertex in the turn of the left and right arm, and in that of the forearm alone.
    pub(crate) arms: [Vec<f64>; 2],
    forearms: [Vec<f64>; 2],
    /// The skin as it was read, in the same pose: points, triangles, and for each point the three nearest vertices with their shares.
    pub(crate) skin: Vec<DVec3>,
    pub(crate) skin_triangles: Vec<[u32; 3]>,
    near: Vec<[(usize, f64); 3]>,
    /// Share of each point of the skin in the arms, by the way along the skin: the nearest vertex may lie on the other side of an overlap.
    pub(crate) limbs: [Vec<f64>; 2],
}

/// Angles off the A pose.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Pose {
    /// Of the arms off the vertical, degrees; negative: into the trunk.
    pub(crate) arm: f64,
    /// By which the legs are turned in, degrees.
    pub(crate) leg: f64,
    /// Where the hands are put, each on its side, by bending the elbows.
    pub(crate) hand: Option<DVec3>,
}

/// What a pose made of a figure.
pub(crate) struct Outcome {
    pub(crate) built: Built,
    /// Vertex of the figure for each of the proxy, none for those inside.
    pub(crate) vertices: Vec<Option<usize>>,
    /// The skin in the pose and the space of the proxy.
    pub(crate) skin: Vec<DVec3>,
    /// Diagonal of the figure in the pose: 1 in the space of the proxy.
    pub(crate) diagonal: f64,
    /// Tetrahedra whose corners are far apart in the figure's own pose.
    pub(crate) torn: usize,
    /// Tetrahedra with corners on an arm and on the body.
    pub(crate) mixed: usize,
    /// Volume relative to what the surface encloses, overlaps counted twice.
    pub(crate) volume: f64,
}

fn smooth(x: f64) -> f64 {
    let x = x.clamp(0.0, 1.0);
    x * x * (3.0 - 2.0 * x)
}

fn bounds(points: &[DVec3]) -> (DVec3, DVec3) {
    points.iter().fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(lo, hi), p| (lo.min(*p), hi.max(*p)))
}

impl Figure {
    pub(crate) fn read(path: &Path, turn: DQuat) -> Self {
        let mesh = scan::read(path).unwrap().mesh;
        let unit_box = UnitBox::of(&mesh).unwrap();
        let points: Vec<DVec3> = mesh.positions.iter().map(|p| turn * unit_box.enter(*p)).collect();
        let welded = weld(&points, &mesh.vertex_triangles(), 1e-6);
        let (mut skin, skin_triangles) = (welded.points, welded.triangles);
        let (mut points, mut triangles) = (skin.clone(), skin_triangles.clone());
        decimate(&mut points, &mut triangles, 2950);
        let (lo, hi) = bounds(&points);
        for p in points.iter_mut().chain(&mut skin) {
            *p = DVec3::new(p.x, p.y - lo.y, p.z) / (hi.y - lo.y);
        }
        let graph = Skin::new(&points, &triangles, 1.0);
        let top = (0..points.len()).max_by(|a, b| points[*a].y.total_cmp(&points[*b].y)).unwrap();
        let from_top = graph.ways(top as u32, f64::INFINITY);
        let tips = [1.0, -1.0].map(|side| {
            // A finger tip is further from the head than all around it, which no place on the leg is at that height.
            let farthest = |v: usize| graph.around[v].iter().all(|&(w, _)| from_top[w as usize] <= from_top[v]);
            let hand = |v: &usize| (0.36..0.65).contains(&points[*v].y) && points[*v].x * side > 0.06 && farthest(*v);
            (0..points.len()).filter(hand).max_by(|a, b| from_top[*a].total_cmp(&from_top[*b])).unwrap()
        });
        let ways = tips.map(|tip| graph.ways(tip as u32, f64::INFINITY));
        let shares = |from: f64, over: f64| ways.each_ref().map(|w| w.iter().map(|way| smooth((from - way) / over)).collect());
        let (arms, forearms) = (shares(0.42, 0.1), shares(0.27, 0.05));
        let mut found = Vec::new();
        let (on_skin, graph) = (PointTree::new(&skin), Skin::new(&skin, &skin_triangles, 1.0));
        let limbs = tips.map(|tip| {
            on_skin.nearest(points[tip], 1, &mut found);
            let ways = graph.ways(found[0].point as u32, f64::INFINITY);
            ways.into_iter().map(|way| smooth((0.42 - way) / 0.1)).collect()
        });
        let tree = PointTree::new(&points);
        let near = skin.iter().map(|p| {
            tree.nearest(*p, 3, &mut found);
            let near = [0, 1, 2].map(|k| (found[k].point, 1.0 / (found[k].distance + 1e-9)));
            let total: f64 = near.iter().map(|n| n.1).sum();
            near.map(|(v, share)| (v, share / total))
        });
        let near = near.collect();
        Self { points, triangles, arms, forearms, skin, skin_triangles, near, limbs }
    }

    /// The vertices in a pose, and the skin.
    pub(crate) fn posed(&self, pose: Pose) -> [Vec<DVec3>; 2] {
        let on_skin =
            |of: &[f64]| -> Vec<f64> { self.near.iter().map(|n| n.iter().map(|(v, share)| of[*v] * share).sum()).collect() };
        let [mut coarse, mut fine] = [self.points.clone(), self.skin.clone()];
        let body: Vec<f64> = self.arms[0].iter().zip(&self.arms[1]).map(|(a, b)| a.max(*b)).collect();
        for (side, (arm, forearm)) in [1.0, -1.0].into_iter().zip(self.arms.iter().zip(&self.forearms)) {
            let centre = |points: &[DVec3], shares: &[f64], select: &dyn Fn(f64) -> bool| {
                let chosen: Vec<DVec3> = shares.iter().zip(points).filter(|(w, _)| select(**w)).map(|(_, p)| *p).collect();
                chosen.iter().sum::<DVec3>() / chosen.len() as f64
            };
            let between = |w: f64| w > 0.2 && w < 0.8;
            let (shoulder, limb) = (centre(&self.points, arm, &between), centre(&self.points, arm, &|w| w == 1.0));
            let (s, c) = pose.arm.to_radians().sin_cos();
            let turn = DQuat::from_rotation_arc((limb - shoulder).normalize(), DVec3::new(side * s, -c, 0.0));
            let hip = DVec3::new(side * 0.05, 0.5, 0.0);
            let place = |p: DVec3, arm: f64, body: f64| {
                if arm > 0.0 {
                    shoulder + DQuat::IDENTITY.slerp(turn, arm) * (p - shoulder)
                } else if p.x * side > 0.0 && body == 0.0 {
                    let share = smooth((0.5 - p.y) / 0.06) * smooth(p.x.abs() / 0.01);
                    hip + DQuat::from_rotation_z(-side * pose.leg.to_radians() * share) * (p - hip)
                } else {
                    p
                }
            };
            let (fine_arm, fine_body, fine_forearm) = (on_skin(arm), on_skin(&body), on_skin(forearm));
            // What is on neither side of this arm stays as the other side put it.
            let mine = |p: DVec3, arm: f64| arm > 0.0 || p.x * side > 0.0;
            for (v, p) in self.points.iter().enumerate().filter(|(v, p)| mine(**p, arm[*v])) {
                if arm[v] > 0.0 || body[v] == 0.0 {
                    coarse[v] = place(*p, arm[v], body[v]);
                }
            }
            for (v, p) in self.skin.iter().enumerate().filter(|(v, p)| mine(**p, fine_arm[*v])) {
                if fine_arm[v] > 0.0 || fine_body[v] == 0.0 {
                    fine[v] = place(*p, fine_arm[v], fine_body[v]);
                }
            }
            if let Some(hand) = pose.hand {
                let elbow = centre(&coarse, forearm, &between);
                let now = centre(&coarse, forearm, &|w| w == 1.0) - elbow;
                let wanted = DVec3::new(hand.x * side, hand.y, hand.z) - elbow;
                let turn = DQuat::from_rotation_arc(now.normalize(), wanted.normalize());
                let bend = |p: &mut DVec3, share: f64| *p = elbow + DQuat::IDENTITY.slerp(turn, share) * (*p - elbow);
                coarse.iter_mut().zip(forearm).filter(|(_, w)| **w > 0.0).for_each(|(p, w)| bend(p, *w));
                fine.iter_mut().zip(&fine_forearm).filter(|(_, w)| **w > 0.0).for_each(|(p, w)| bend(p, *w));
            }
        }
        [coarse, fine]
    }

    /// Builds the proxy of a pose, and prints what came of it.
    pub(crate) fn build(&self, name: &str, [posed, skin]: &[Vec<DVec3>; 2]) -> Outcome {
        let (lo, hi) = bounds(posed);
        let (centre, diagonal) = ((lo + hi) * 0.5, (hi - lo).length());
        let enter = |points: &[DVec3]| -> Vec<DVec3> { points.iter().map(|p| (*p - centre) / diagonal).collect() };
        let (posed, skin) = (enter(posed), enter(skin));
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
            vertices,
            skin,
            diagonal,
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
