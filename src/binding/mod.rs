//! (Scan, Proxy, Capture) → Binding: space, landmarks, labels, placement, handles.

mod actor;
mod bind;
mod chase;
mod checks;
mod clusters;
#[cfg(test)]
#[allow(clippy::unwrap_used, clippy::print_stderr)]
mod corpus;
mod decisions;
pub(crate) mod driven;
mod fit;
pub(crate) mod grown;
mod labels;
pub mod landmarks;
mod limbs;
mod pinned;
mod places;
mod plant;
mod raw;
mod reference;
pub mod regions;
mod registration;
mod retarget;
pub mod rig;
mod segments;
pub mod select;
mod shape;
mod sides;
mod similarity;
mod skeletons;
mod skin;
mod surfaces;
mod take;
#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests;
mod track;
mod unlabelled;

pub use actor::{ActorSpace, actor_space};
pub use bind::bind;
pub use decisions::{Decisions, Slip};
pub use driven::Turning;
pub use limbs::Limbs;
pub use regions::{Regions, Rules};
pub use segments::Segment;
pub use shape::unit_of_body;
pub use similarity::Similarity;
pub use skeletons::{Role, person};

use crate::capture::resample::Sampling;
use crate::capture::{Capture, MarkerTake};
use crate::error::{Error, Notes, Result};
use crate::scan::{SurfaceMesh, UnitBox};
use crate::space::{Axis, Space, Unit};
use crate::spatial::TriangleTree;
use glam::DVec3;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::sync::Arc;

/// How the capture is brought onto the scan.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Align {
    /// The plainest of the others that the data allow.
    #[default]
    Auto,
    /// The capture is in the scan's space already; only the unit is converted.
    None,
    /// One scale, turn and shift for the take; markers are attached where they lie in the reference frame.
    Similarity,
    /// The same for the targets; attachment points are found through the pose of the actor in the reference frame.
    Pose,
    /// Every segment of the scan turns as the actor's, on the scan's own lengths.
    Retarget,
}

impl std::fmt::Display for Align {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Align::Auto => "auto",
            Align::None => "none",
            Align::Similarity => "similarity",
            Align::Pose => "pose",
            Align::Retarget => "retarget",
        })
    }
}

/// The frame in which the actor stands most like the scan.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Reference {
    /// Searched for.
    #[default]
    Auto,
    /// This frame, in the capture's own numbering.
    Frame(i64),
}

/// Is told after each frame how many of how many of a long take are posed; its error ends the work.
pub type Watch<'a> = &'a (dyn Fn(usize, usize) -> Result<()> + Sync);

/// What the user decides about the binding; the default decides everything from the data.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Options {
    /// How the capture is brought onto the scan.
    pub align: Align,
    /// Turn of the capture about the scan's up axis in degrees, counter-clockwise from above.
    pub yaw: Option<f64>,
    /// Whether the scan faces the other way than its shape suggests.
    pub flip: bool,
    /// Size of the scan against the actor, units converted.
    pub scale: Option<f64>,
    /// The reference frame, of the reference capture where there is one.
    pub reference: Reference,
    /// Whether retargeted feet slide as they come; without, what rests on the floor is held.
    pub free_feet: bool,
    /// Refusals for doubtful input become warnings.
    pub accept_doubtful: bool,
    /// Whether the capture's axes are mirrored.
    pub mirror: bool,
    /// Whether left and right are exchanged in the labels.
    pub swap_sides: bool,
    /// Unit of the scan.
    pub scan_unit: Option<Unit>,
    /// Up axis of the scan.
    pub scan_up: Option<Axis>,
    /// Unit of the capture.
    pub capture_unit: Option<Unit>,
    /// Up axis of the capture.
    pub capture_up: Option<Axis>,
    /// Markers whose places or meanings the user gives, by label.
    pub markers: BTreeMap<String, Marker>,
    /// Joints of a skeleton take whose meanings the user gives, by name.
    pub joints: BTreeMap<String, Role>,
    /// The decisions of another run.
    pub frozen: Option<Arc<rig::Frozen>>,
}

/// What the user says of a marker.
#[derive(Clone, Debug, PartialEq)]
pub enum Marker {
    /// Where it sits on the scan, in the unit box.
    At(DVec3),
    /// It is what this label of the dictionary says.
    As(String),
    /// It pulls nothing.
    Ignored,
}

impl Options {
    /// Where the user says that a marker sits, in the unit box.
    fn pinned(&self, label: &str) -> Option<DVec3> {
        match self.markers.get(label) {
            Some(Marker::At(place)) => Some(*place),
            _ => None,
        }
    }

    /// Frames per second, where feet that rest are to be held.
    fn feet(&self, capture: &Capture) -> Option<f64> {
        (!self.free_feet).then_some(capture.rate)
    }

    /// Whether the user leaves a marker out.
    fn is_ignored(&self, label: &str) -> bool {
        self.markers.get(label) == Some(&Marker::Ignored)
    }
}

/// What the binding needs to know of a scan.
#[derive(Clone, Copy, Debug)]
pub struct ScanShape<'a> {
    /// Its triangles, in the unit box.
    pub tree: &'a TriangleTree,
    /// From its own space into the unit box.
    pub unit_box: UnitBox,
    /// What its file says of unit and axes.
    pub space: &'a Space,
    /// Its vertices and faces in its own space, for captures of the same mesh.
    pub mesh: Option<&'a SurfaceMesh>,
}

/// A marker that pulls the scan.
#[derive(Clone, Debug, PartialEq)]
pub struct BoundMarker {
    /// Its label.
    pub label: String,
    /// Its index in the take, or in [`Binding::trajectories`].
    pub marker: usize,
    /// Where it sits on, in or outside the scan at rest, in the unit box.
    pub attachment: DVec3,
    /// The segment that it moves with; `None` in captures that are bound as they are.
    pub segment: Option<Segment>,
    /// Hardness for the deformer: 1, or 0.1 for a doubtful marker.
    pub beta: f64,
}

/// Between the name of a joint and that of a point which moves with it; no name of a user has it.
const OF_JOINT: &str = " \u{203a} ";

impl BoundMarker {
    /// Label of a point that moves with a joint.
    fn held_by(joint: &str, point: &str) -> String {
        format!("{joint}{OF_JOINT}{point}")
    }

    /// The name by which the user knows it: the joint that it moves with, or its label.
    pub fn known_as(&self) -> &str {
        self.label.rsplit_once(OF_JOINT).map_or(&self.label, |(joint, _)| joint)
    }
}

/// A segment of the scan at rest, for rigid groups, stiffness and names.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SegmentPlace {
    /// Which it is.
    pub segment: Segment,
    /// Its proximal joint, in the unit box.
    pub from: DVec3,
    /// Its distal joint or tip.
    pub to: DVec3,
}

/// A capture on a scan.
#[derive(Clone, Debug)]
pub struct Binding {
    /// From the capture's space into the unit box.
    pub placement: Similarity,
    /// The markers that pull, in the order of the take.
    pub handles: Vec<BoundMarker>,
    /// The markers that do not, with the reason.
    pub unbound: Vec<(String, String)>,
    /// Parts of the body; empty where no body was needed.
    pub segments: Vec<SegmentPlace>,
    /// The trajectories that the handles follow, in the space of `placement`, where they are not the capture's own.
    pub trajectories: Option<MarkerTake>,
    /// Handles that turn what they hold, with their places in every frame.
    pub turning: Turning,
    /// All decisions, with their words.
    pub decisions: Decisions,
    /// The same for the rig file, where they can be kept.
    pub frozen: Option<rig::Frozen>,
    /// What was doubtful.
    pub notes: Notes,
}

impl Binding {
    /// The trajectories that the handles follow: those of `capture`, or the binding's own.
    pub fn take<'a>(&'a self, capture: &'a Capture) -> &'a MarkerTake {
        self.trajectories.as_ref().unwrap_or_else(|| capture.motion.points())
    }

    /// Brings the trajectories that the handles follow to other frames, where they are the binding's own.
    pub fn resample(&mut self, sampling: &Sampling) {
        if let Some(take) = &mut self.trajectories {
            *take = sampling.markers(take);
        }
        self.turning.resample(sampling);
    }

    /// Targets of all handles in one frame of the take.
    ///
    /// Shapes: `take`: [`Binding::take`]; `frame`: counted from 0; `positions`, `present`: one entry per handle, overwritten; the
    /// position of a missing marker is left as it was.
    pub fn targets(&self, take: &MarkerTake, frame: usize, positions: &mut Vec<DVec3>, present: &mut Vec<bool>) {
        positions.resize(self.handles.len(), DVec3::ZERO);
        present.resize(self.handles.len(), false);
        for ((handle, position), present) in self.handles.iter().zip(positions).zip(present) {
            let p = take.point(frame, handle.marker);
            *present = p.is_some();
            if let Some(p) = p {
                *position = self.placement.apply(p);
            }
        }
    }

    /// Named places of the body, in the unit box: the middle of each segment.
    pub fn places(&self) -> impl Iterator<Item = (&'static str, DVec3)> {
        self.segments.iter().map(|s| (s.segment.name(), s.from.lerp(s.to, 0.5)))
    }

    /// Name of the part of the body nearest to a place at rest, in the unit box; `None` where no body was needed.
    pub fn part_at(&self, place: DVec3) -> Option<&'static str> {
        let distance = |s: &SegmentPlace| {
            let bone = s.to - s.from;
            let along = ((place - s.from).dot(bone) / bone.length_squared().max(f64::MIN_POSITIVE)).clamp(0.0, 1.0);
            place.distance_squared(s.from + bone * along)
        };
        self.segments.iter().min_by(|a, b| distance(a).total_cmp(&distance(b))).map(|s| s.segment.name())
    }
}

/// Ends the warnings that stand in place of a refusal.
pub const ACCEPTED: &str = "(accepted as it is)";

/// Refuses, or warns where the user accepts doubtful input.
fn refuse(error: Error, options: &Options, notes: &mut Notes) -> Result<()> {
    if options.accept_doubtful {
        notes.warn(format!("{} {ACCEPTED}", error.found));
        return Ok(());
    }
    let hint = match &error.hint {
        Some(hint) => format!("{hint}, or --accept-doubtful"),
        None => "--accept-doubtful".to_owned(),
    };
    Err(error.hint(hint))
}
