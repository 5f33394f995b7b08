//! The joints as a tree: poses from joint coordinates, and the last step that makes joints exact.

use super::coordinates::Coordinates;
use super::model::{Link, Model};
use super::rows::Pose;
use crate::joints::Kind;
use glam::{DMat3, DQuat, DVec3};
use std::collections::VecDeque;

/// A spanning forest of the joints, parents first.
#[derive(Clone, Debug, Default)]
pub(super) struct Tree {
    /// Link, parent, child.
    branches: Vec<(usize, usize, usize)>,
    /// Variables whose whole connected set is rigid, so that the tree may be made exact.
    rigid: Vec<bool>,
    /// Links that close a loop.
    pub(super) loops: usize,
}

impl Tree {
    /// From these variables first, then from any that are left.
    pub(super) fn new(model: &Model, roots: impl Iterator<Item = usize>) -> Self {
        let count = model.variables();
        let mut of_variable = vec![Vec::new(); count];
        for (k, link) in model.links.iter().enumerate() {
            of_variable[link.a].push((k, link.b));
            of_variable[link.b].push((k, link.a));
        }
        let mut tree = Self { rigid: vec![true; count], ..Self::default() };
        let (mut reached, mut used) = (vec![false; count], vec![false; model.links.len()]);
        let strained: Vec<usize> = model.strains.iter().flat_map(|s| [s.a, s.b]).collect();
        for root in roots.chain(0..count) {
            if reached[root] {
                continue;
            }
            reached[root] = true;
            let mut members = vec![root];
            let mut queue = VecDeque::from([root]);
            while let Some(parent) = queue.pop_front() {
                for &(link, child) in &of_variable[parent] {
                    if !reached[child] {
                        (reached[child], used[link]) = (true, true);
                        tree.branches.push((link, parent, child));
                        members.push(child);
                        queue.push_back(child);
                    }
                }
            }
            if members.iter().any(|m| strained.contains(m)) {
                members.iter().for_each(|&m| tree.rigid[m] = false);
            }
        }
        tree.loops = used.iter().filter(|u| !**u).count();
        tree
    }

    /// Puts the children where joint coordinates have them.
    pub(super) fn forward(&self, model: &Model, pose: &mut Pose, angle: impl Fn(&Link) -> f64) {
        for &(link, parent, child) in &self.branches {
            let link = &model.links[link];
            let turn = match link.kind {
                Kind::Revolute | Kind::Cylinder => DMat3::from_axis_angle(link.frame.x_axis, angle(link)),
                _ => DMat3::IDENTITY,
            };
            place(model, link, pose, parent, child, turn, DVec3::ZERO);
        }
    }

    /// Rebuilds every child from its parent with its joint coordinates brought within what the joint allows. Sets with soft cells stay as they were solved,
    /// and so do joints that close a loop.
    pub(super) fn snap(&self, model: &Model, pose: &mut Pose, angles: &[f64], solved: &Pose) {
        for &(k, parent, child) in &self.branches {
            if !self.rigid[child] {
                continue;
            }
            let link = &model.links[k];
            // As solved: the parent may have been moved already.
            let at = Coordinates::of(link, model, solved, angles[k]);
            let [x, y, z] = [link.frame.x_axis, link.frame.y_axis, link.frame.z_axis];
            let clamped = |value: f64, range: Option<(f64, f64)>| range.map_or(value, |(lo, hi)| value.clamp(lo, hi));
            let slide = x * clamped(at.slide, link.slide);
            let about_x = || DMat3::from_axis_angle(x, clamped(at.angle, link.angle));
            let (turn, offset) = match link.kind {
                Kind::Revolute => (about_x(), DVec3::ZERO),
                Kind::Cylinder => (about_x(), slide),
                Kind::Prismatic => (DMat3::IDENTITY, slide),
                Kind::Plane => {
                    let angle = (y.dot(at.turn * x) - x.dot(at.turn * y)).atan2(x.dot(at.turn * x) + y.dot(at.turn * y));
                    (DMat3::from_axis_angle(z, angle), at.offset - z * at.offset.dot(z))
                }
                Kind::Ball | Kind::Fixed => {
                    let over = link.cone.map_or(0.0, |cone| (at.swing - cone).max(0.0));
                    let axis = x.cross(at.turn * x).normalize_or(x.any_orthonormal_vector());
                    (DMat3::from_axis_angle(axis, -over) * at.turn, DVec3::ZERO)
                }
            };
            place(model, link, pose, parent, child, turn, offset);
        }
        for turn in &mut pose.turns {
            *turn = DMat3::from_quat(DQuat::from_mat3(turn).normalize());
        }
    }
}

/// Puts one side of a joint where the other, the turn of `b` against `a` and the offset in the frame of `a` have it.
fn place(model: &Model, link: &Link, pose: &mut Pose, parent: usize, child: usize, turn: DMat3, offset: DVec3) {
    let arm = |v: usize| link.centre - model.origins[v];
    if child == link.b {
        pose.turns[child] = pose.turns[parent] * turn;
        let anchor = pose.point(model, parent, link.centre) + pose.turns[parent] * offset;
        pose.places[child] = anchor - pose.turns[child] * arm(child);
    } else {
        pose.turns[child] = pose.turns[parent] * turn.transpose();
        let anchor = pose.point(model, parent, link.centre) - pose.turns[child] * offset;
        pose.places[child] = anchor - pose.turns[child] * arm(child);
    }
}
