//! Whether position channels take the place of a joint's OFFSET or are added to it: the format does not say, and files differ.

use super::counted;
use super::hierarchy::{Channel, Hierarchy, Node};
use crate::error::Notes;
use glam::DVec3;

/// Positions nearer to OFFSET, or to zero, than this share of its length speak for the one or the other reading.
const NEAR: f64 = 0.25;
/// Components of an OFFSET that are smaller than this share of its largest one have no vote.
const SMALL: f64 = 0.1;

/// Whether each joint's position channels are added to its OFFSET; the others replace it.
///
/// Below the roots all joints are read alike: where more positions are near zero than near OFFSET they are changes of it, else they
/// repeat it. A root is read as the joints below it if those have positions; else component by component. Where nothing speaks for
/// either reading, positions replace OFFSET, as most programs have it.
pub(super) fn added(hierarchy: &Hierarchy, values: &[f64], notes: &mut Notes) -> Vec<bool> {
    let nodes = &hierarchy.nodes;
    let mut added = vec![false; nodes.len()];
    let (mut near_offset, mut near_zero, mut moved) = (0, 0, 0);
    let below = |node: &Node| node.parent.is_some() && has_position(node) && node.offset != DVec3::ZERO;
    for node in nodes.iter().filter(|n| below(n)) {
        let (mean, reach) = (mean(node, hierarchy.columns, values), NEAR * node.offset.length());
        moved += 1;
        near_offset += usize::from(mean.distance(node.offset) < reach);
        near_zero += usize::from(mean.length() < reach);
    }
    if moved > 0 {
        let add = near_zero > near_offset;
        let joints = counted(moved, "joint");
        notes.warn(if add {
            format!("positions of {joints} are near zero: they are added to OFFSET")
        } else if near_offset > 0 {
            format!("positions of {joints} repeat OFFSET: they replace it")
        } else {
            format!("positions of {joints} are near neither OFFSET nor zero: they replace OFFSET (assumed)")
        });
        nodes.iter().zip(&mut added).for_each(|(node, added)| *added = add && has_position(node));
        if near_zero + near_offset > 0 {
            return added;
        }
    }
    for (node, added) in
        nodes.iter().zip(&mut added).filter(|(n, _)| n.parent.is_none() && has_position(n) && n.offset != DVec3::ZERO)
    {
        let mean = mean(node, hierarchy.columns, values);
        let least = SMALL * node.offset.abs().max_element();
        let (mut zero, mut repeated) = (false, false);
        for axis in (0..3).filter(|&axis| node.offset[axis].abs() > least) {
            let reach = NEAR * node.offset[axis].abs();
            repeated |= (mean[axis] - node.offset[axis]).abs() < reach;
            zero |= mean[axis].abs() < reach;
        }
        *added = zero && !repeated;
        let name = &node.name;
        notes.warn(match (zero, repeated) {
            (true, false) => format!("positions of root '{name}' are near zero: they are added to its OFFSET"),
            (false, true) => format!("positions of root '{name}' repeat its OFFSET: they replace it"),
            _ => format!("positions of root '{name}' replace its OFFSET (assumed)"),
        });
    }
    added
}

fn has_position(node: &Node) -> bool {
    node.channels.iter().any(|c| matches!(c, Channel::Position(_)))
}

/// Mean of a joint's positions over all rows; components without a channel are those of OFFSET.
fn mean(node: &Node, columns: usize, values: &[f64]) -> DVec3 {
    let mut mean = node.offset;
    for (k, channel) in node.channels.iter().enumerate() {
        if let Channel::Position(axis) = *channel {
            let column = values.iter().skip(node.column + k).step_by(columns).filter(|v| !v.is_nan());
            let (sum, n) = column.fold((0.0, 0usize), |(sum, n), v| (sum + v, n + 1));
            mean[axis] = sum / n.max(1) as f64;
        }
    }
    mean
}
