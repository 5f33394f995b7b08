//! A skeleton take as a person, for bodies that are no person's: which joint is what, where up and the front are.

use super::rig::{Pose, Rig};
use super::{recognise, stance};
use crate::binding::Options;
use crate::capture::{Capture, SkeletonTake};
use crate::error::{Notes, Result};
use crate::space::{Axis, Known, Unit};
use glam::{DQuat, DVec3};

/// The joints of a person, by index in the take; left before right.
#[derive(Clone, Debug, PartialEq)]
#[allow(missing_docs)]
pub struct Person {
    pub pelvis: usize,
    pub chest: usize,
    pub neck: Option<usize>,
    pub head: Option<usize>,
    /// Shoulder, elbow, wrist.
    pub arms: [[usize; 3]; 2],
    /// Hip, knee, ankle.
    pub legs: [[usize; 3]; 2],
    pub toes: [Option<usize>; 2],
    /// Direction up in the capture.
    pub up: Known<Axis>,
    pub unit: Option<Known<Unit>>,
    /// Hip to ankle along the bones, in the capture's unit.
    pub leg: f64,
}

/// Who the joints of a take are.
///
/// # Errors
/// Refusals: not a human skeleton, an unclear up axis.
pub fn person(capture: &Capture, take: &SkeletonTake, options: &Options, notes: &mut Notes) -> Result<Person> {
    let rig = Rig { take, mirror: options.mirror };
    let (cast, lengths) = recognise(&rig, options, notes)?;
    let stance = stance::read(&rig, &cast, &lengths, &capture.space, options, notes)?;
    Ok(Person {
        pelvis: cast.pelvis(),
        chest: cast.chest(),
        neck: cast.neck,
        head: cast.head,
        arms: cast.arms.map(|a| [a.shoulder, a.elbow, a.wrist]),
        legs: cast.legs.map(|l| [l.hip, l.knee, l.ankle]),
        toes: cast.legs.map(|l| l.toe),
        up: stance.up,
        unit: stance.unit,
        leg: stance.leg,
    })
}

/// Places and turns of the joints of a take, mirrored where the user says so.
#[derive(Clone, Copy, Debug)]
pub struct Joints<'a>(Rig<'a>);

impl<'a> Joints<'a> {
    /// Of a take.
    pub fn of(take: &'a SkeletonTake, options: &Options) -> Self {
        Self(Rig { take, mirror: options.mirror })
    }

    /// Where a joint is in a frame, or at rest.
    pub fn place(&self, frame: Option<usize>, joint: usize) -> Option<DVec3> {
        self.0.place(frame.map_or(Pose::Rest, Pose::Frame), joint)
    }

    /// How it has turned from rest.
    pub fn turn(&self, frame: usize, joint: usize) -> Option<DQuat> {
        Some(self.0.turn(Pose::Frame(frame), joint)? * self.0.turn(Pose::Rest, joint)?.inverse())
    }
}
