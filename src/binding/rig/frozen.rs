//! The decisions of one run, kept so that other runs need not decide anew: where the capture lies, where its markers sit on the scan, and
//! how the actor of the reference frame stood.

mod again;

use super::Written;
use crate::binding::fit::{Fit, RATIOS, SIZE};
use crate::binding::landmarks::{Arms, Body, Floor, Joint};
use crate::binding::retarget::{self, Retargeting, Seen};
use crate::binding::segments::{Segment, Skeleton};
use crate::binding::shape::segment_places;
use crate::binding::similarity::{Held, Similarity};
use crate::binding::take::Take;
use crate::binding::track::Track;
use crate::binding::{
    Align, Binding, BoundMarker, Decisions, Options, Reference, ScanShape, Turning, Watch, checks, places, raw, reference,
};
use crate::capture::Capture;
use crate::error::{Error, Notes, Result};
use crate::scan::SurfaceMesh;
use crate::space::{Axis, Evidence, Known, Unit};
use glam::{DQuat, DVec3};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

type Triple = [f64; 3];
/// A rotation as x, y, z, w.
type Turn = [f64; 4];

/// `[frozen]`: the decisions of a run on a marker take. Places are in the unit box of the scan: from its centre, in diagonals.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Frozen {
    scan: Print,
    /// Name of the capture that it was made from, its file, and how many frames it has.
    capture: String,
    file: String,
    frames: usize,
    align: Align,
    #[serde(default, skip_serializing_if = "super::is_default")]
    on_skin: bool,
    reference_frame: i64,
    reference_range: [i64; 2],
    #[serde(default, skip_serializing_if = "super::is_default")]
    reference_capture: Option<String>,
    /// The frame of the capture that is nearest to the reference.
    start: i64,
    scale: f64,
    yaw: f64,
    #[serde(default, skip_serializing_if = "super::is_default")]
    scan_unit: Option<Written<Unit>>,
    #[serde(default, skip_serializing_if = "super::is_default")]
    capture_unit: Option<Written<Unit>>,
    #[serde(default, skip_serializing_if = "super::is_default")]
    capture_up: Option<Written<Axis>>,
    #[serde(default, skip_serializing_if = "super::is_default")]
    actor_height: Option<f64>,
    #[serde(default, skip_serializing_if = "super::is_default")]
    residual: Option<[f64; 2]>,
    /// From the capture into the unit box; of a retargeted take, at the actor's own size.
    placement: Placement,
    #[serde(default, skip_serializing_if = "super::is_default")]
    body: Option<FrozenBody>,
    #[serde(default, skip_serializing_if = "super::is_default")]
    actor: Option<FrozenActor>,
    #[serde(default, skip_serializing_if = "super::is_default")]
    joints: Option<FrozenJoints>,
    #[serde(rename = "marker", default, skip_serializing_if = "super::is_default")]
    markers: Vec<FrozenMarker>,
}

/// How the joints of a skeleton carry the parts of the scan.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(in crate::binding) struct FrozenJoints {
    /// Whether turns are read against the file's rest.
    pub rest: bool,
    /// From the capture's axes into the scan's.
    pub turn: Turn,
    pub scale: f64,
    pub shift: Triple,
    /// Shares of the way from hips to neck at which the parts of the trunk begin.
    pub begins: Vec<f64>,
    #[serde(default, skip_serializing_if = "super::is_default")]
    pub left_shoulder: Option<Triple>,
    #[serde(default, skip_serializing_if = "super::is_default")]
    pub right_shoulder: Option<Triple>,
    pub spine: Vec<Turn>,
    pub neck: Turn,
    pub head: Turn,
    pub arms: [[Turn; 3]; 2],
    pub legs: [[Turn; 4]; 2],
}

impl FrozenJoints {
    fn is_sound(&self) -> bool {
        let unit = |turn: &Turn| (DQuat::from_array(*turn).length() - 1.0).abs() < 1e-6;
        let numbers = self.begins.iter().chain(&self.shift).chain(self.left_shoulder.iter().flatten());
        numbers.chain(self.right_shoulder.iter().flatten()).all(|x| x.is_finite())
            && self.scale > 0.0
            && self.scale.is_finite()
            && !self.spine.is_empty()
            && self.begins.len() == self.spine.len()
            && [&self.turn, &self.neck, &self.head].into_iter().all(unit)
            && self.spine.iter().chain(self.arms.iter().flatten()).chain(self.legs.iter().flatten()).all(unit)
    }
}

/// What tells one scan from another.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Print {
    vertices: usize,
    hash: String,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Placement {
    scale: f64,
    rotation: Turn,
    translation: Triple,
    #[serde(default, skip_serializing_if = "super::is_default")]
    mirror: bool,
    #[serde(default, skip_serializing_if = "super::is_default")]
    swap_sides: bool,
}

/// The scan's body, as [`Body`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct FrozenBody {
    up: Triple,
    forward: Triple,
    stature: f64,
    arm_elevation: [f64; 2],
    #[serde(default, skip_serializing_if = "super::is_default")]
    arms: Arms,
    #[serde(default, skip_serializing_if = "super::is_default")]
    floor: Option<FrozenFloor>,
    facing_ratio: f64,
    margin: f64,
    cost: f64,
    joints: BTreeMap<Joint, Triple>,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct FrozenFloor {
    up: Triple,
    height: f64,
}

/// The actor's pose and proportions in the reference frame, as [`Fit`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct FrozenActor {
    size: f64,
    ratios: Vec<f64>,
    clavicles: [Triple; 2],
    rotations: Vec<Turn>,
    origins: Vec<Triple>,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct FrozenMarker {
    label: String,
    /// On, in or beside the scan at rest.
    attachment: Triple,
    #[serde(default, skip_serializing_if = "super::is_default")]
    segment: Option<Segment>,
    #[serde(default = "one", skip_serializing_if = "is_one")]
    hardness: f64,
    /// In the reference frame.
    #[serde(default, skip_serializing_if = "super::is_default")]
    seen: Option<Triple>,
    #[serde(default, skip_serializing_if = "super::is_default")]
    shoulder: Option<usize>,
    #[serde(default = "one", skip_serializing_if = "is_one")]
    weight: f64,
}

fn one() -> f64 {
    1.0
}

fn is_one(x: &f64) -> bool {
    *x == 1.0
}

impl Frozen {
    /// Keeps a binding of a marker take. `start`: frame of the capture, counted from 0, from which the poses go out.
    pub(in crate::binding) fn of(
        binding: &Binding,
        take: &Take<'_>,
        body: Option<&Body>,
        start: usize,
        retargeted: Option<(&Retargeting<'_>, &[Seen])>,
        options: &Options,
    ) -> Self {
        let placement = retargeted.map_or(binding.placement, |(r, _)| r.placement);
        let markers = binding.handles.iter().enumerate().take(binding.decisions.bound).map(|(i, handle)| {
            let seen = retargeted.map(|(_, seen)| seen[i]);
            FrozenMarker {
                label: handle.label.clone(),
                attachment: handle.attachment.to_array(),
                segment: handle.segment,
                hardness: handle.beta,
                seen: seen.map(|s| s.at.to_array()),
                shoulder: seen.and_then(|s| s.shoulder),
                weight: seen.map_or(1.0, |s| s.weight),
            }
        });
        Self {
            placement: Placement::of(&placement, options),
            actor: retargeted.map(|(r, _)| FrozenActor {
                size: r.fit.size,
                ratios: r.fit.ratios.to_vec(),
                clavicles: r.clavicles.map(|c| c.to_array()),
                rotations: r.fit.rotations.map(|q| q.to_array()).to_vec(),
                origins: r.fit.origins.map(|o| o.to_array()).to_vec(),
            }),
            markers: markers.collect(),
            ..Self::of_decisions(&binding.decisions, take.capture, body, start)
        }
    }

    /// Keeps the binding of a skeleton take.
    pub(in crate::binding) fn of_joints(
        decisions: &Decisions,
        capture: &Capture,
        body: &Body,
        start: usize,
        joints: FrozenJoints,
        options: &Options,
    ) -> Self {
        Self {
            joints: Some(joints),
            placement: Placement::of(&Similarity::IDENTITY, options),
            ..Self::of_decisions(decisions, capture, Some(body), start)
        }
    }

    fn of_decisions(d: &Decisions, capture: &Capture, body: Option<&Body>, start: usize) -> Self {
        Self {
            scan: Print { vertices: 0, hash: String::new() },
            capture: capture.name.clone(),
            file: stem(capture),
            frames: capture.motion.points().frames(),
            align: d.align,
            on_skin: d.on_skin,
            reference_frame: d.reference_frame,
            reference_range: [d.reference_range.0, d.reference_range.1],
            reference_capture: d.reference_capture.clone(),
            start: capture.first_frame + start as i64,
            scale: d.scale,
            yaw: d.yaw,
            scan_unit: d.scan_unit.map(|u| Written(u.value)),
            capture_unit: d.capture_unit.map(|u| Written(u.value)),
            capture_up: d.capture_up.map(|u| Written(u.value)),
            actor_height: d.actor_height,
            residual: d.residual.map(|(median, p90)| [median, p90]),
            placement: Placement::of(&Similarity::IDENTITY, &Options::default()),
            body: body.map(FrozenBody::of),
            actor: None,
            joints: None,
            markers: Vec::new(),
        }
    }

    /// How the joints of a skeleton take carry the scan; `None` of other takes.
    pub(in crate::binding) fn joints(&self) -> Option<&FrozenJoints> {
        self.joints.as_ref()
    }

    /// Whether the capture's axes are mirrored.
    pub(in crate::binding) fn mirror(&self) -> bool {
        self.placement.mirror
    }

    /// Whether left and right of its labels are exchanged.
    pub(in crate::binding) fn swap_sides(&self) -> bool {
        self.placement.swap_sides
    }

    /// Says where the scan is not the one that the decisions are for.
    pub(in crate::binding) fn check_scan(&self, scan: &ScanShape<'_>, notes: &mut Notes) {
        if let Some(mesh) = scan.mesh
            && Print::of(mesh) != self.scan
        {
            let same = mesh.positions.len() == self.scan.vertices;
            let what = if same { "its vertices lie elsewhere" } else { "it has other vertices" };
            notes.warn(format!("the rig file was made for another state of the scan: {what}"));
        }
    }

    /// The decisions on a capture.
    pub(in crate::binding) fn decisions(&self, scan: &ScanShape<'_>, capture: &Capture) -> Decisions {
        let known = |v: Triple| Some(Known::new(DVec3::from(v), Evidence::Rig));
        let body = self.body.as_ref();
        Decisions {
            align: self.align,
            noun: capture.motion.noun(),
            on_skin: self.on_skin,
            reference_frame: self.reference_frame,
            reference_range: (self.reference_range[0], self.reference_range[1]),
            reference_capture: match &self.reference_capture {
                Some(name) => Some(name.clone()),
                None => (!self.is_of(capture)).then(|| self.file.clone()),
            },
            reference_rest: self.joints.as_ref().is_some_and(|j| j.rest),
            scale: self.scale,
            yaw: self.yaw,
            scan_unit: self.scan_unit.as_ref().map(|u| Known::new(u.0, Evidence::Rig)),
            scan_up: body.and_then(|b| known(b.up)),
            scan_forward: body.and_then(|b| known(b.forward)),
            scan_height: body.map(|b| b.stature * scan.unit_box.diagonal),
            capture_unit: self.capture_unit.as_ref().map(|u| Known::new(u.0, Evidence::Rig)),
            capture_up: self.capture_up.as_ref().map(|u| Known::new(u.0, Evidence::Rig)),
            actor_height: self.actor_height,
            set: None,
            named: 0,
            markers: 0,
            bound: 0,
            off_surface: None,
            residual: self.residual.map(|[median, p90]| (median, p90)),
            proportions: Vec::new(),
            strain: None,
            feet: None,
        }
    }

    /// The same, made for this scan.
    pub fn for_scan(mut self, mesh: &SurfaceMesh) -> Self {
        self.scan = Print::of(mesh);
        self
    }

    /// The body of the scan, where one was needed.
    pub fn body(&self) -> Option<Body> {
        self.body.as_ref().map(FrozenBody::body)
    }

    /// Refuses values that no run writes.
    pub(super) fn check(&self) -> Result<()> {
        let wrong =
            |what: &str, expected: &str| Err(Error::malformed(what.to_owned()).at("[frozen]").expected(expected.to_owned()));
        let is_unit = |v: Triple| (DVec3::from(v).length() - 1.0).abs() < 1e-6;
        let finite = |values: &[f64]| values.iter().all(|x| x.is_finite());
        let unit = |turn: &Turn| finite(turn) && (DQuat::from_array(*turn).length() - 1.0).abs() < 1e-6;
        if !(self.placement.scale.is_finite() && self.placement.scale > 0.0 && self.scale.is_finite() && self.yaw.is_finite()) {
            return wrong("a scale or yaw is no usable number", "scales above 0");
        }
        if !unit(&self.placement.rotation) || !finite(&self.placement.translation) {
            return wrong("the placement is no rotation and shift", "a unit quaternion x, y, z, w and three numbers");
        }
        if let Some(body) = &self.body
            && (body.joints.len() != Joint::COUNT
                || !body.joints.values().all(|p| finite(p))
                || !is_unit(body.up)
                || !is_unit(body.forward)
                || !finite(&[body.facing_ratio.min(0.0), body.margin, body.cost])
                || !finite(&body.arm_elevation)
                || body.floor.as_ref().is_some_and(|f| !is_unit(f.up) || !f.height.is_finite())
                || !(body.stature > 0.0 && body.stature.is_finite()))
        {
            return wrong("the body lacks joints or has unusable numbers", "all joints, as a run writes them");
        }
        if let Some(actor) = &self.actor {
            let complete = actor.rotations.len() == Segment::COUNT
                && actor.origins.len() == Segment::COUNT
                && actor.ratios.len() == RATIOS
                && actor.rotations.iter().all(unit)
                && actor.origins.iter().chain(&actor.clavicles).all(|p| finite(p))
                && actor.ratios.iter().all(|&r| r > 0.0 && r.is_finite())
                && actor.size > 0.0
                && actor.size.is_finite();
            if !complete {
                return wrong(
                    "the actor lacks segments or has unusable numbers",
                    "15 segments and 9 ratios, as a run writes them",
                );
            }
        }
        if self.joints.as_ref().is_some_and(|joints| !joints.is_sound() || self.body.is_none()) {
            return wrong(
                "the joints have unusable numbers",
                "turns as unit quaternions, as a run writes them, and [frozen.body]",
            );
        }
        if (self.align == Align::Retarget) != (self.actor.is_some() || self.joints.is_some())
            || self.actor.is_some() && self.body.is_none()
        {
            return wrong(
                "align, actor and body do not go together",
                "align = \"retarget\" with [frozen.actor] and [frozen.body]",
            );
        }
        for marker in &self.markers {
            let good = finite(&marker.attachment)
                && marker.hardness > 0.0
                && marker.hardness.is_finite()
                && marker.weight >= 0.0
                && marker.weight.is_finite()
                && marker.shoulder.is_none_or(|s| s < 2)
                && marker.seen.is_none_or(|p| finite(&p))
                && (self.actor.is_none() || marker.seen.is_some() && marker.segment.is_some());
            if !good {
                return wrong(&format!("marker {} has unusable values", marker.label), "numbers as a run writes them");
            }
        }
        Ok(())
    }
}

/// The file of a capture without folder and ending.
fn stem(capture: &Capture) -> String {
    capture.source.file_stem().map_or_else(String::new, |name| name.to_string_lossy().into_owned())
}

impl Placement {
    fn of(placement: &Similarity, options: &Options) -> Self {
        Self {
            scale: placement.scale,
            rotation: placement.rotation.to_array(),
            translation: placement.translation.to_array(),
            mirror: options.mirror,
            swap_sides: options.swap_sides,
        }
    }
}

impl Print {
    fn of(mesh: &SurfaceMesh) -> Self {
        // Over the bits of the coordinates: the same on every machine.
        let hash =
            mesh.positions.iter().flat_map(|p| p.to_array()).fold(0xcbf2_9ce4_8422_2325_u64, |hash, x| {
                (hash ^ x.to_bits()).wrapping_mul(0x0000_0100_0000_01b3).rotate_left(17)
            });
        Self { vertices: mesh.positions.len(), hash: format!("{hash:016x}") }
    }
}

impl FrozenBody {
    fn of(body: &Body) -> Self {
        Self {
            up: body.up.to_array(),
            forward: body.forward.to_array(),
            stature: body.stature,
            arm_elevation: body.arm_elevation,
            arms: body.arms,
            floor: body.floor.map(|f| FrozenFloor { up: f.up.to_array(), height: f.height }),
            facing_ratio: body.facing_ratio,
            margin: body.margin,
            cost: body.cost,
            joints: Joint::ALL.into_iter().map(|joint| (joint, body.joints[joint as usize].to_array())).collect(),
        }
    }

    fn body(&self) -> Body {
        Body {
            joints: Joint::ALL.map(|joint| self.joints.get(&joint).map_or(DVec3::ZERO, |&p| DVec3::from(p))),
            up: DVec3::from(self.up),
            forward: DVec3::from(self.forward),
            facing_ratio: self.facing_ratio,
            margin: self.margin,
            cost: self.cost,
            stature: self.stature,
            arm_elevation: self.arm_elevation,
            arms: self.arms,
            floor: self.floor.as_ref().map(|f| Floor { up: DVec3::from(f.up), height: f.height }),
        }
    }
}

impl FrozenActor {
    fn fit(&self) -> Fit {
        let mut ratios = [1.0; RATIOS];
        ratios.copy_from_slice(&self.ratios);
        Fit {
            rotations: Segment::ALL.map(|s| DQuat::from_array(self.rotations[s as usize])),
            origins: Segment::ALL.map(|s| DVec3::from(self.origins[s as usize])),
            size: self.size,
            ratios,
            residuals: Vec::new(),
        }
    }
}
