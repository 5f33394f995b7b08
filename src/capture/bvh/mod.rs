//! BVH text (Biovision hierarchy): a skeleton and its motion.
//!
//! Nothing in a BVH file says its unit, its axes, or whether positions replace OFFSETs; what was assumed is in the notes. Read are: any
//! order of channels, positions and scales on any joint, several roots, leaves without an end site, names with blanks and colons, rows
//! that are wrapped, any line ends, byte-order mark, comments, decimal commas, words in any case, wrong counts.

mod hierarchy;
mod motion;
mod placing;
mod text;

use super::skeleton::{self, Frames, SkeletonFile};
use super::{Joint, Rest, number, turns};
use crate::error::{Notes, Result};
use crate::space::Space;
use crate::words;
use glam::{DQuat, DVec3};
use hierarchy::{Channel, Hierarchy, Node};
use text::Text;

/// Shares of round angles, and of angles of zero, in a first row that no motion has: see [`rest_row`].
const ROUND_IN_REST: f64 = 0.9;
const ZERO_IN_REST: f64 = 0.5;
/// Share of round angles in the second row above which the whole file is of round angles.
const ROUND_IN_MOTION: f64 = 0.5;

/// Reads a file.
///
/// Joints have the names of the file; an end site is called `PARENT_End`. Frames are counted from 1. `fallback` is the rate of a file
/// without a frame time that can be used.
///
/// # Errors
/// With the line: whatever is not BVH; see [`hierarchy::read`] and [`motion::read`].
pub(super) fn read(bytes: &[u8], fallback: Option<f64>) -> Result<SkeletonFile> {
    let mut notes = Notes::default();
    let mut text = Text::new(bytes);
    let hierarchy = hierarchy::read(&mut text)?;
    if hierarchy.columns == 0 {
        return Err(skeleton::no_frames("no joint has CHANNELS: nothing moves"));
    }
    let rows = motion::read(&mut text, hierarchy.columns, fallback, &mut notes)?;
    let values = &rows.values;
    said_once(&hierarchy, values, &mut notes);
    let added = placing::added(&hierarchy, values, &mut notes);

    let mut joints = rest(&hierarchy.nodes);
    let renamed = crate::words::unique(joints.iter_mut().map(|j| &mut j.name), "joint");
    if renamed > 0 {
        notes.warn(format!("{} had the name of another: renamed", counted(renamed, "joint")));
    }
    let mut frames = Frames::new(joints.len(), values.len() / hierarchy.columns, bytes.len())?;
    let mut pose = vec![(DVec3::ZERO, DQuat::IDENTITY); joints.len()];
    for row in values.chunks_exact(hierarchy.columns) {
        place(&hierarchy.nodes, &added, row, &mut pose);
        pose.iter().for_each(|&(place, turn)| frames.push(place, turn));
    }
    let mut from = Rest::Hierarchy;
    if rest_row(&hierarchy, values) {
        place(&hierarchy.nodes, &added, &values[..hierarchy.columns], &mut pose);
        joints.iter_mut().zip(&pose).for_each(|(joint, &(place, turn))| (joint.rest, joint.rest_turn) = (place, turn));
        from = Rest::FirstFrame;
        notes.warn("row 1 is a rest pose that was put before the motion: the motion begins with row 2");
    }
    Ok(SkeletonFile {
        take: frames.take(joints, from),
        rate: rows.rate,
        first_frame: 1,
        space: Space::default(),
        name: None,
        notes,
    })
}

/// Places and turns of all joints in the axes of the file.
fn place(nodes: &[Node], added: &[bool], row: &[f64], pose: &mut [(DVec3, DQuat)]) {
    for (n, node) in nodes.iter().enumerate() {
        let mut offset = node.offset;
        let mut turn = DQuat::IDENTITY;
        let mut first = true;
        for (channel, &value) in node.channels.iter().zip(&row[node.column..]) {
            match *channel {
                Channel::Position(axis) if added[n] => offset[axis] += value,
                Channel::Position(axis) => offset[axis] = value,
                Channel::Rotation(axis) => {
                    let about = turns::about(axis, value);
                    turn = if first { about } else { turn * about };
                    first = false;
                }
                Channel::Scale(_) => {}
            }
        }
        pose[n] = match node.parent.map(|p| pose[p]) {
            None => (offset, turn),
            Some((place, parent)) => (place + parent * offset, if first { parent } else { parent * turn }),
        };
    }
}

/// The joints with all angles zero and all OFFSETs as they are.
fn rest(nodes: &[Node]) -> Vec<Joint> {
    let mut joints: Vec<Joint> = Vec::with_capacity(nodes.len());
    for node in nodes {
        let parent = node.parent.map(|p| &joints[p]);
        let name = match parent {
            Some(parent) if node.end => format!("{}_End", parent.name),
            _ => node.name.clone(),
        };
        let rest = parent.map_or(DVec3::ZERO, |p| p.rest) + node.offset;
        joints.push(Joint { name, parent: node.parent, rest, rest_turn: DQuat::IDENTITY, end: node.end });
    }
    joints
}

/// Whether the first row is a rest pose that an exporter put before the motion: its angles are whole
/// numbers and mostly zero, the second row's are not.
fn rest_row(hierarchy: &Hierarchy, values: &[f64]) -> bool {
    let angles: Vec<usize> = hierarchy
        .nodes
        .iter()
        .flat_map(|n| n.channels.iter().zip(n.column..))
        .filter_map(|(channel, column)| matches!(channel, Channel::Rotation(_)).then_some(column))
        .collect();
    let share = |row: &[f64], like: fn(f64) -> bool| {
        angles.iter().filter(|&&column| like(row[column])).count() as f64 / angles.len().max(1) as f64
    };
    let round = |v: f64| v.fract() == 0.0;
    let mut rows = values.chunks_exact(hierarchy.columns);
    let (Some(first), Some(second)) = (rows.next(), rows.next()) else { return false };
    share(first, round) >= ROUND_IN_REST && share(first, |v| v == 0.0) >= ZERO_IN_REST && share(second, round) <= ROUND_IN_MOTION
}

/// Warns of what is read but not used.
fn said_once(hierarchy: &Hierarchy, values: &[f64], notes: &mut Notes) {
    let scaled = |n: &&Node| {
        n.channels.iter().enumerate().any(|(k, c)| {
            let mut column = values.iter().skip(n.column + k).step_by(hierarchy.columns);
            matches!(c, Channel::Scale(_)) && column.any(|v| (v - 1.0).abs() > 1e-6)
        })
    };
    let scaled = hierarchy.nodes.iter().filter(scaled).count();
    if scaled > 0 {
        notes.warn(format!("scales of {} are not used", counted(scaled, "joint")));
    }
    let roots: Vec<&str> = hierarchy.nodes.iter().filter(|n| n.parent.is_none()).map(|n| n.name.as_str()).collect();
    if roots.len() > 1 {
        let shown = roots[..roots.len().min(5)].join(", ");
        notes.warn(format!("{} roots ({shown}): all of them are used", roots.len()));
    }
}

/// A number in a word, with or without a comma or semicolon behind it.
fn number(word: &[u8]) -> Option<f64> {
    number::parse(word).or_else(|| number::parse(word.strip_suffix(b",").or_else(|| word.strip_suffix(b";"))?))
}

fn counted(n: usize, noun: &str) -> String {
    words::plural(n, noun)
}

#[cfg(test)]
mod tests;
