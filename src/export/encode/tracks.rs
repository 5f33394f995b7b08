//! Transforms of all joints in all frames.

use super::motion::{FitPoints, Motion};
use super::rigid::{Packed, Rigid};
use super::table::{Growing, Table};
use crate::error::Result;

/// Transforms of joints, the root's motion taken out.
pub type Tracks = Table<Packed>;

impl Tracks {
    /// Number of joints.
    pub fn joints(&self) -> usize {
        self.columns()
    }

    /// All joints of a frame.
    pub fn motions(&self, frame: usize) -> Result<Vec<Rigid>> {
        Ok(self.frame(frame)?.iter().map(Rigid::unpack).collect())
    }

    /// Rigid fit of each group of points in every frame; a group of fewer than four stays.
    pub fn of_groups(motion: &Motion<'_>, points: &FitPoints, groups: &[Vec<u32>]) -> Result<Self> {
        let mut tracks = Growing::new(motion.spool.folder(), groups.len())?;
        let fit = |_, pose: Vec<glam::DVec3>| -> Vec<Packed> {
            let joint = |g: &Vec<u32>| Rigid::fit_some(&points.rest, &pose, g).unwrap_or(Rigid::IDENTITY).pack();
            groups.iter().map(joint).collect()
        };
        motion.each_frame(points, fit, |_, joints| tracks.push(&joints))?;
        tracks.finish()
    }

    /// These joints and those of `other` after them.
    pub fn with(&self, other: &Self) -> Result<Self> {
        let mut both = Growing::new(self.folder(), self.joints() + other.joints())?;
        for f in 0..self.frames() {
            let mut row = self.frame(f)?;
            row.extend(other.frame(f)?);
            both.push(&row)?;
        }
        both.finish()
    }
}
