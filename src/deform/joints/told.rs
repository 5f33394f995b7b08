//! How well handles tell how a joint is turned: near a singular pose, in which a limb lies along an axis, and where handles are gone, not at all.
//!
//! Steps are damped there and hardly elsewhere, as inverse kinematics does it (Nakamura, Hanafusa: *Inverse kinematic solutions with singularity
//! robustness for robot manipulator control*, 1986), each axis by what handles on both sides of it tell.

use super::model::Model;
use super::rows::{Hold, Pose};
use crate::disjoint::DisjointSets;
use crate::joints::Kind;
use crate::linalg::eigen;
use glam::{DMat3, DVec3};

/// A joint is told how it is turned by a handle of full weight that is farther from its axis than this, in diagonals.
const ARM: f64 = 0.1;

/// An axis about which a joint turns, in the frame of `a` at rest, and the share of the drag that it feels.
pub(super) type Axis = (DVec3, f64);

/// What handles tell of each joint.
#[derive(Debug)]
pub(super) struct Told {
    /// On which side each handle is once a joint is cut, 0 that of `a` and 1 that of `b`, also of all where the joint closes a loop; `None`: on another thing.
    sides: Vec<Vec<Option<usize>>>,
    /// Axes of each joint.
    pub(super) axes: Vec<[Axis; 3]>,
}

impl Told {
    /// For the handles of a model.
    pub(super) fn new(model: &Model, holds: &[Hold]) -> Self {
        let carrier = |hold: &Hold| hold.iter().max_by(|p, q| p.1.abs().total_cmp(&q.1.abs())).map_or(0, |h| h.0 as u32);
        let side = |k: usize| {
            let mut sets = DisjointSets::new(model.variables());
            let others = model.links.iter().enumerate().filter(|(other, _)| *other != k).map(|(_, l)| (l.a, l.b));
            let strains = model.strains.iter().map(|s| (s.a, s.b));
            others.chain(strains).for_each(|(a, b)| sets.unite(a as u32, b as u32));
            let [a, b] = [model.links[k].a, model.links[k].b].map(|v| sets.find(v as u32));
            let mut side = |hold: &Hold| match sets.find(carrier(hold)) {
                set if set == b => Some(1),
                set if set == a => Some(0),
                _ => None,
            };
            holds.iter().map(&mut side).collect()
        };
        Self { sides: (0..model.links.len()).map(side).collect(), axes: vec![[(DVec3::X, 0.0); 3]; model.links.len()] }
    }

    /// Measures in a pose. Joints that are told well feel the share `light` of the drag, those that are not all of it.
    pub(super) fn measure(&mut self, model: &Model, holds: &[Hold], betas: &[f64], presence: &[f64], pose: &Pose, light: f64) {
        for ((link, side), axes) in model.links.iter().zip(&self.sides).zip(&mut self.axes) {
            let turn = pose.turns[link.a];
            let centre = pose.point(model, link.a, link.centre);
            let mut sides = [DMat3::ZERO; 2];
            for (k, hold) in holds.iter().enumerate() {
                let Some(side) = side[k] else { continue };
                // Rows of directions have no place: their shares sum to zero.
                let share: f64 = hold.iter().map(|h| h.1).sum();
                let arm = turn.transpose() * (pose.hold(hold) - centre * share);
                let about = DMat3::from_diagonal(DVec3::splat(arm.length_squared())) - outer(arm);
                sides[side] += about * (betas[k] * presence[k]);
            }
            let told =
                |axis: DVec3| sides.map(|side| axis.dot(side * axis)).into_iter().fold(f64::INFINITY, f64::min) / (ARM * ARM);
            let drag = |axis: DVec3| (axis, light + (1.0 - light) / (1.0 + told(axis).powi(2)));
            let none = (DVec3::X, 0.0);
            *axes = match link.kind {
                Kind::Revolute | Kind::Cylinder => [drag(link.frame.x_axis), none, none],
                Kind::Plane => [drag(link.frame.z_axis), none, none],
                Kind::Ball => principal(&sides).map(drag),
                Kind::Prismatic | Kind::Fixed => [none; 3],
            };
        }
    }
}

/// The axes of the side that tells less.
fn principal(sides: &[DMat3; 2]) -> [DVec3; 3] {
    let trace = |m: &DMat3| m.x_axis.x + m.y_axis.y + m.z_axis.z;
    let less = if trace(&sides[0]) < trace(&sides[1]) { &sides[0] } else { &sides[1] };
    eigen::symmetric(less.to_cols_array_2d()).1.map(DVec3::from)
}

fn outer(a: DVec3) -> DMat3 {
    DMat3::from_cols(a * a.x, a * a.y, a * a.z)
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::super::model::{Body, JointSpec, Part, Side};
    use super::*;

    fn block(name: &str, at: DVec3) -> Part {
        let points = (0..8).map(|k| at + DVec3::from([k & 1, k >> 1 & 1, k >> 2].map(f64::from)) * 0.2).collect();
        Part { name: name.into(), points, body: Body::Rigid }
    }

    /// Shares of the drag about the axes of a joint along Z between two blocks: three handles on the first, some on the second.
    fn shares(kind: Kind, places: &[DVec3], weight: f64) -> Vec<Axis> {
        let joint = JointSpec {
            name: "joint".into(),
            kind,
            a: Side::Part(0),
            b: Side::Part(1),
            centre: DVec3::new(0.1, 0.1, 0.25),
            frame: DMat3::from_cols(DVec3::Z, DVec3::X, DVec3::Y),
            angle: None,
            slide: None,
            cone: None,
            region: None,
        };
        let model = Model::new(vec![block("a", DVec3::ZERO), block("b", DVec3::Z * 0.3)], &[], &[joint]).unwrap();
        let corners = [DVec3::ZERO, DVec3::X * 0.2, DVec3::Y * 0.2].map(|p| (0, p));
        let all = corners.into_iter().chain(places.iter().map(|p| (1, *p)));
        let holds: Vec<Hold> = all.map(|(part, p)| Model::holds(&model.row(part, p))).collect();
        let rest = Pose { turns: vec![DMat3::IDENTITY; 2], places: model.origins.clone() };
        let mut told = Told::new(&model, &holds);
        let presence: Vec<f64> = (0..holds.len()).map(|k| if k < 3 { 1.0 } else { weight }).collect();
        told.measure(&model, &holds, &vec![1.0; holds.len()], &presence, &rest, 0.1);
        told.axes[0].iter().copied().filter(|a| a.1 > 0.0).collect()
    }

    #[test]
    fn a_handle_on_the_axis_or_without_weight_tells_nothing_and_one_beside_it_does() {
        let axis = |p: DVec3, weight: f64| shares(Kind::Revolute, &[p], weight)[0].1;
        let on_axis = DVec3::new(0.1, 0.1, 0.5);
        assert!(axis(on_axis, 1.0) > 0.99 && axis(on_axis + DVec3::X * 0.01, 1.0) > 0.99);
        assert!(axis(on_axis + DVec3::X * 0.4, 1.0) < 0.13);
        assert!(axis(on_axis + DVec3::X * 0.4, 1e-4) > 0.99, "it has almost let go");
        assert_eq!(shares(Kind::Prismatic, &[on_axis], 1.0), []);
    }

    #[test]
    fn a_ball_is_told_how_it_swings_by_a_handle_that_does_not_tell_its_twist() {
        let along = DVec3::new(0.1, 0.1, 0.7);
        for (axis, share) in shares(Kind::Ball, &[along], 1.0) {
            let twist = axis.dot(DVec3::Z).abs();
            assert!(if twist > 0.9 { share > 0.99 } else { twist < 1e-6 && share < 0.13 }, "{axis} {share}");
        }
        assert!(shares(Kind::Ball, &[along, along + DVec3::X * 0.4], 1.0).iter().all(|a| a.1 < 0.2));
    }
}
