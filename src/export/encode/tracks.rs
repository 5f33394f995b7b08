//! Transforms of all joints in all frames.

use super::motion::{FitPoints, Motion};
use super::rigid::{Packed, Rigid};
use super::start::fit_group;
use crate::error::Result;

/// Transforms of joints, frame after frame, the root's motion taken out.
#[derive(Clone, Debug)]
pub struct Tracks {
    joints: usize,
    values: Vec<Packed>,
}

impl Tracks {
    /// No frames yet.
    pub fn new(joints: usize) -> Self {
        Self { joints, values: Vec::new() }
    }

    /// Number of joints.
    pub fn joints(&self) -> usize {
        self.joints
    }

    /// Number of frames.
    pub fn frames(&self) -> usize {
        self.values.len() / self.joints
    }

    /// Appends a frame.
    pub fn push(&mut self, joints: &[Packed]) {
        assert_eq!(joints.len(), self.joints);
        self.values.extend_from_slice(joints);
    }

    /// One transform.
    pub fn at(&self, frame: usize, joint: usize) -> Rigid {
        Rigid::unpack(&self.values[frame * self.joints + joint])
    }

    /// All joints of a frame.
    pub fn frame(&self, frame: usize) -> Vec<Rigid> {
        self.values[frame * self.joints..(frame + 1) * self.joints].iter().map(Rigid::unpack).collect()
    }

    /// Rigid fit of each group of points in every frame; a group of fewer than four stays.
    pub fn of_groups(motion: &Motion<'_>, points: &FitPoints, groups: &[Vec<u32>]) -> Result<Self> {
        let mut tracks = Self::new(groups.len());
        let fit = |_, pose: Vec<glam::DVec3>| -> Vec<Packed> {
            let joint = |g: &Vec<u32>| fit_group(&points.rest, &pose, g).unwrap_or(Rigid::IDENTITY).pack();
            groups.iter().map(joint).collect()
        };
        motion.each_frame(points, fit, |_, joints| tracks.push(&joints))?;
        Ok(tracks)
    }

    /// These joints and those of `other` after them.
    pub fn with(&self, other: &Self) -> Self {
        let mut both = Self::new(self.joints + other.joints);
        for f in 0..self.frames() {
            both.values.extend_from_slice(&self.values[f * self.joints..(f + 1) * self.joints]);
            both.values.extend_from_slice(&other.values[f * other.joints..(f + 1) * other.joints]);
        }
        both
    }
}
