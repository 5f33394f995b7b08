//! Acclaim: a skeleton (ASF) and its motion (AMC) in two files.
//!
//! A bone becomes a joint at its start, with an end (`BONE_End`) where no other bone follows. With C a bone's axes at rest and M the turn
//! of the motion in them, it turns by C·M·C⁻¹ under its parent (J. Lander, "Working with Motion Capture File Formats", 1998).

mod amc;
mod asf;
mod lines;
mod partner;

use super::skeleton::{Frames, SkeletonFile};
use super::{Joint, Rest, source};
use crate::error::{Error, Notes, Result};
use crate::space::{Evidence, Known, Space};
use crate::words;
use amc::Amc;
use asf::{Asf, Freedom};
use glam::{DQuat, DVec3};
use std::path::Path;

/// The format has no rate; the large collections in it are of this one.
const ASSUMED_RATE: f64 = 120.0;
/// Angles beyond one turn in radians, as a share of all above which they are in degrees whatever the file says.
const TOO_MANY_TURNS: f64 = 0.05;

/// Reads a pair of files of which one is given; `skeleton` is the other one, `rate` their frames per second.
///
/// # Errors
/// As [`partner::pair`], [`asf::read`] and [`amc::read`], each with its file.
pub(super) fn open(path: &Path, skeleton: Option<&Path>, rate: Option<f64>) -> Result<SkeletonFile> {
    let mut notes = Notes::default();
    let (skeleton, motion) = partner::pair(path, skeleton, &mut notes)?;
    let in_file = |file: &Path| {
        let file = file.to_owned();
        move |e: Error| e.file(&file).hint_for_broken_file()
    };
    let asf = source::load(&skeleton).and_then(|bytes| asf::read(&bytes)).map_err(in_file(&skeleton))?;
    let mut file = source::load(&motion).and_then(|bytes| read(asf, &bytes, rate)).map_err(in_file(&motion))?;
    notes.extend(std::mem::take(&mut file.notes));
    file.notes = notes;
    file.name = Some(source::stem(&motion));
    Ok(file)
}

/// Reads a pair of files from their bytes.
#[cfg(any(test, fuzzing))]
pub(super) fn parse(skeleton: &[u8], motion: &[u8]) -> Result<SkeletonFile> {
    asf::read(skeleton).and_then(|asf| read(asf, motion, None))
}

/// The motion in `bytes` of the skeleton.
fn read(mut asf: Asf, bytes: &[u8], rate: Option<f64>) -> Result<SkeletonFile> {
    let mut amc = amc::read(bytes, &asf.bones)?;
    let mut notes = std::mem::take(&mut asf.notes);
    notes.extend(std::mem::take(&mut amc.notes));
    let radians = radians(&asf, &amc, &mut notes);
    let moving = moving(&asf, &amc, &mut notes);

    let mut ends = vec![true; asf.bones.len()];
    asf.bones.iter().filter_map(|b| b.parent).for_each(|p| ends[p] = false);
    let joints = joints(&asf, &ends);
    let (numbers, span) = numbered(&amc, &mut notes);
    let mut frames = Frames::new(joints.len(), span, bytes.len())?;
    let mut pose = vec![(DVec3::ZERO, DQuat::IDENTITY); asf.bones.len()];
    let mut filled = 0;
    for (frame, &number) in numbers.iter().enumerate() {
        for _ in filled..number {
            (0..joints.len()).for_each(|_| frames.push(DVec3::NAN, DQuat::NAN));
        }
        filled = number + 1;
        place(&asf, &amc, frame, radians, &moving, &mut pose);
        for (n, &(start, turn)) in pose.iter().enumerate() {
            frames.push(start, turn);
            if ends[n] {
                frames.push(start + turn * asf.bones[n].along, turn);
            }
        }
    }
    let wanted = moving.iter().filter(|m| **m).count();
    let open = (0..numbers.len()).filter(|&f| amc.entries(f).len() < wanted).count();
    if open > 0 {
        notes.warn(format!("{} without all bones: these and what hangs on them are missing there", words::plural(open, "frame")));
    }
    if rate.is_none() {
        notes.warn(format!("the files do not say their rate: {ASSUMED_RATE} frames per second are assumed"));
    }
    let rate = rate.unwrap_or(ASSUMED_RATE);
    let space = Space { unit: asf.unit.map(|u| Known::new(u, Evidence::File)), ..Space::default() };
    let first_frame = amc.frames[0].0;
    Ok(SkeletonFile { take: frames.take(joints, Rest::Hierarchy), rate, first_frame, space, name: asf.name, notes })
}

/// Whether angles of the motion are in radians: what the motion says, else the skeleton, unless the angles cannot be.
fn radians(asf: &Asf, amc: &Amc, notes: &mut Notes) -> bool {
    let said = amc.radians.unwrap_or(asf.radians);
    let (mut large, mut all) = (0usize, 0usize);
    for &(bone, start) in &amc.entries {
        let numbers = asf.bones[bone].freedoms.iter().zip(&amc.values[start..]);
        for (_, value) in numbers.filter(|(f, _)| matches!(f, Freedom::Rotation(_))) {
            all += 1;
            large += usize::from(value.abs() > std::f64::consts::TAU);
        }
    }
    let degrees = said && large as f64 > TOO_MANY_TURNS * all as f64;
    if degrees {
        notes.warn(format!("the file says radians, but {large} of {all} angles are beyond a turn: taken for degrees"));
    }
    said && !degrees
}

/// Which bones have numbers in some frame; the others stay at rest.
fn moving(asf: &Asf, amc: &Amc, notes: &mut Notes) -> Vec<bool> {
    let mut moving = vec![false; asf.bones.len()];
    amc.entries.iter().for_each(|&(bone, _)| moving[bone] = true);
    let still = asf.bones.iter().zip(&moving).filter(|(b, m)| !**m && !b.freedoms.is_empty()).count();
    if still > 0 {
        notes.warn(format!("{} in no frame: at rest", words::plural(still, "bone")));
    }
    let lengths = asf.bones.iter().filter(|b| b.freedoms.contains(&Freedom::Length)).count();
    if lengths > 0 {
        notes.warn(format!("changes of length of {} are not used", words::plural(lengths, "bone")));
    }
    moving
}

/// For each frame of the file its place in time, from 0, and how many places there are. Numbers that leave some out make gaps; numbers
/// that do not rise are not believed.
fn numbered(amc: &Amc, notes: &mut Notes) -> (Vec<usize>, usize) {
    let count = amc.frames.len();
    let first = amc.frames[0].0;
    if !amc.frames.is_sorted_by(|a, b| a.0 < b.0) {
        notes.warn("the numbers of the frames do not rise: the frames are taken one after another");
        return ((0..count).collect(), count);
    }
    let places: Vec<usize> =
        amc.frames.iter().map(|f| usize::try_from(i128::from(f.0) - i128::from(first)).unwrap_or(usize::MAX)).collect();
    let span = places[count - 1].saturating_add(1);
    if span > count {
        notes.warn(format!(
            "frames {first} to {} without {}: missing",
            amc.frames[count - 1].0,
            words::plural(span - count, "frame")
        ));
    }
    (places, span)
}

/// Starts and turns of all bones in a frame.
fn place(asf: &Asf, amc: &Amc, frame: usize, radians: bool, moving: &[bool], pose: &mut [(DVec3, DQuat)]) {
    // What moves in other frames and has no numbers in this one is missing; they are overwritten below.
    let mut own: Vec<(DVec3, DQuat)> =
        moving.iter().map(|&m| if m { (DVec3::ZERO, DQuat::NAN) } else { (DVec3::ZERO, DQuat::IDENTITY) }).collect();
    for &(n, start) in amc.entries(frame) {
        let bone = &asf.bones[n];
        let (mut shift, mut angles) = (DVec3::ZERO, [0.0; 3]);
        for (freedom, &value) in bone.freedoms.iter().zip(&amc.values[start..]) {
            match *freedom {
                Freedom::Translation(axis) => shift[axis] = value,
                Freedom::Rotation(axis) => angles[axis] = value,
                Freedom::Length => {}
            }
        }
        own[n] = (shift, asf::compose(bone.order, angles, radians));
    }
    for (n, bone) in asf.bones.iter().enumerate() {
        let (shift, turn) = own[n];
        pose[n] = match bone.parent {
            None => (asf.origin + bone.axes * shift, bone.axes * turn),
            Some(p) => {
                let (start, parent) = pose[p];
                let start = start + parent * (asf.bones[p].along + bone.axes * shift);
                (start, parent * (bone.axes * turn * bone.axes.conjugate()))
            }
        };
    }
}

/// The joints with all angles zero.
fn joints(asf: &Asf, ends: &[bool]) -> Vec<Joint> {
    let mut joints: Vec<Joint> = Vec::new();
    let mut of_bone: Vec<usize> = Vec::new();
    for (n, bone) in asf.bones.iter().enumerate() {
        let parent = bone.parent.map(|p| of_bone[p]);
        let rest = parent
            .map_or(asf.origin, |p| joints[p].rest + joints[p].rest_turn * asf.bones[bone.parent.unwrap_or_default()].along);
        let rest_turn = parent.map_or(bone.axes, |p| joints[p].rest_turn);
        of_bone.push(joints.len());
        joints.push(Joint { name: bone.name.clone(), parent, rest, rest_turn, end: false });
        if ends[n] {
            let rest = rest + rest_turn * bone.along;
            joints.push(Joint { name: format!("{}_End", bone.name), parent: Some(of_bone[n]), rest, rest_turn, end: true });
        }
    }
    crate::words::unique(joints.iter_mut().map(|j| &mut j.name), "joint");
    joints
}

#[cfg(test)]
mod tests;
