//! A skeleton take as the binding reads it: positions and turns with mirrored axes undone, and the tree.

use crate::capture::SkeletonTake;
use glam::{DQuat, DVec3};

/// A pose of a rig: its rest, or a frame of the take.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Pose {
    Rest,
    /// Counted from 0.
    Frame(usize),
}

/// A skeleton take, mirrored where its axes are.
#[derive(Clone, Copy, Debug)]
pub(super) struct Rig<'a> {
    pub take: &'a SkeletonTake,
    pub mirror: bool,
}

impl Rig<'_> {
    pub(super) fn frames(&self) -> usize {
        self.take.origins.frames()
    }

    /// At most `count` frames, evenly spread over the take.
    pub(super) fn sample(&self, count: usize) -> Vec<usize> {
        let frames = self.frames();
        let n = frames.min(count);
        (0..n).map(|k| if n < 2 { 0 } else { k * (frames - 1) / (n - 1) }).collect()
    }

    /// Where a joint is; `None` where it is missing.
    pub(super) fn place(&self, pose: Pose, joint: usize) -> Option<DVec3> {
        let p = match pose {
            Pose::Rest => self.take.joints[joint].rest,
            Pose::Frame(frame) => self.take.origins.point(frame, joint)?,
        };
        p.is_finite().then(|| if self.mirror { DVec3::new(-p.x, p.y, p.z) } else { p })
    }

    /// How a joint is turned.
    pub(super) fn turn(&self, pose: Pose, joint: usize) -> Option<DQuat> {
        let q = match pose {
            Pose::Rest => self.take.joints[joint].rest_turn,
            Pose::Frame(frame) => {
                let [x, y, z, w] = self.take.rotations[frame * self.take.joints.len() + joint].map(f64::from);
                DQuat::from_xyzw(x, y, z, w)
            }
        };
        let length = q.length();
        // The mirror image of a turn about an axis is the opposite turn about the mirrored axis.
        let q = if self.mirror { DQuat::from_xyzw(q.x, -q.y, -q.z, q.w) } else { q };
        (length.is_finite() && length > 1e-3).then(|| q / length)
    }

    /// Whether two joints are in one place, in the first frame that shows both.
    pub(super) fn coincide(&self, a: usize, b: usize) -> bool {
        let poses = self.sample(20).into_iter().map(Pose::Frame);
        let gap = |pose: Pose| Some((self.place(pose, a)? - self.place(pose, b)?, self.place(pose, a)?));
        poses.chain([Pose::Rest]).find_map(gap).is_some_and(|(gap, place)| gap.length() <= 1e-5 * (1.0 + place.length()))
    }

    /// Whether the joints have no hierarchy.
    pub(super) fn is_flat(&self) -> bool {
        self.take.joints.iter().all(|j| j.parent.is_none())
    }

    /// Whether `joint` hangs on `above`, directly or not.
    pub(super) fn is_above(&self, above: usize, joint: usize) -> bool {
        self.ancestors(joint).any(|a| a == above)
    }

    /// Parent, its parent, and so on.
    pub(super) fn ancestors(&self, joint: usize) -> impl Iterator<Item = usize> {
        let parent = |j: usize| self.take.joints[j].parent;
        std::iter::successors(parent(joint), move |&j| parent(j))
    }

    /// The last joint that both hang on.
    pub(super) fn common(&self, a: usize, b: usize) -> Option<usize> {
        let (mut a, mut b) = (self.take.joints[a].parent?, self.take.joints[b].parent?);
        // Parents come before their children: the later one of two is not above the other.
        while a != b {
            let later = if a > b { &mut a } else { &mut b };
            *later = self.take.joints[*later].parent?;
        }
        Some(a)
    }

    /// The joints from pelvis to chest, both included; where the chest does not hang on the pelvis, from below their common joint.
    pub(super) fn spine(&self, pelvis: usize, chest: usize) -> Vec<usize> {
        let mut spine = vec![chest];
        if pelvis != chest {
            let below: Vec<usize> = self.ancestors(pelvis).collect();
            spine.extend(self.ancestors(chest).take_while(|j| *j != pelvis && !below.contains(j)));
            spine.push(pelvis);
            spine.reverse();
        }
        spine
    }
}
