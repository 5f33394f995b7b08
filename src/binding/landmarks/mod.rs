//! The joints of a human scan, found from its shape alone.
//!
//! A solid graph of voxels, its five ends told apart by their distances through the body, medial curves from the ends inwards, and
//! joints on these curves by section area, bends and the proportions of people (Winter, Biomechanics and Motor Control of Human
//! Movement). Nothing is learnt and no axis need be known; the arms have to be clear of the trunk.

mod axes;
#[cfg(test)]
mod corpus;
mod doubts;
mod extremities;
mod geodesic;
mod limbs;
mod medial;
mod pieces;
mod skeleton;
#[cfg(test)]
mod tests;
mod told;
mod voxels;

pub use told::told;

use glam::DVec3;
use serde::{Deserialize, Serialize};
use voxels::Solid;

/// The places of a body that the binding needs. Left and right are the body's own.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[allow(missing_docs)]
pub enum Joint {
    MidHip,
    Neck,
    Head,
    Crown,
    LeftShoulder,
    LeftElbow,
    LeftWrist,
    LeftHandTip,
    RightShoulder,
    RightElbow,
    RightWrist,
    RightHandTip,
    LeftHip,
    LeftKnee,
    LeftAnkle,
    LeftToe,
    RightHip,
    RightKnee,
    RightAnkle,
    RightToe,
}

impl Joint {
    /// Number of joints; `joint as usize` is its index.
    pub const COUNT: usize = 20;

    /// All joints in order.
    pub const ALL: [Joint; Self::COUNT] = {
        use Joint::*;
        [
            MidHip,
            Neck,
            Head,
            Crown,
            LeftShoulder,
            LeftElbow,
            LeftWrist,
            LeftHandTip,
            RightShoulder,
            RightElbow,
            RightWrist,
            RightHandTip,
            LeftHip,
            LeftKnee,
            LeftAnkle,
            LeftToe,
            RightHip,
            RightKnee,
            RightAnkle,
            RightToe,
        ]
    };
}

/// A human body as its scan shows it, in the unit box of the scan.
#[derive(Clone, Debug)]
pub struct Body {
    /// Positions by `Joint as usize`.
    pub joints: [DVec3; Joint::COUNT],
    /// Unit vector from the feet to the neck; snapped to a file axis when within 10 degrees.
    pub up: DVec3,
    /// Unit vector across `up` that the body faces.
    pub forward: DVec3,
    /// How far the toes stick out against the heels; below 2 the facing is weak.
    pub facing_ratio: f64,
    /// Second-best labelling minus best: 0.25 is sure, below 0.15 is not a person as far as can be told.
    pub margin: f64,
    /// Cost of the best labelling.
    pub cost: f64,
    /// Height from soles to crown, in diagonals.
    pub stature: f64,
    /// Elevation of the arms against the horizontal in degrees, negative below, left and right.
    pub arm_elevation: [f64; 2],
}

/// Margins below this are no person as far as can be told.
const LEAST_MARGIN: f64 = 0.15;
/// Costs above this are no person, however clear the labelling.
const MOST_COST: f64 = 0.45;
/// A person fills about 25 000 voxels; more than this has no limbs to speak of.
const MOST_VOXELS: usize = 80_000;

/// Finds the body in a scan, or says why not.
///
/// Shapes: `points` in the unit box; `triangles` over them (holes, flipped faces and several shells do not matter).
/// The person stands, with arms and legs apart (T pose, A pose and between).
pub fn find(points: &[DVec3], triangles: &[[u32; 3]]) -> Result<Body, NotHuman> {
    let triangles = pieces::without_debris(points, triangles);
    let solid = Solid::of(points, &triangles).ok_or_else(|| NotHuman::because("the mesh encloses nothing"))?;
    if solid.len() > MOST_VOXELS {
        return Err(NotHuman::because("the shape is too compact: it has no arms and legs apart from a trunk"));
    }
    let ends = extremities::ends(&solid);
    let found = ends.len();
    let ends = extremities::label(ends)
        .ok_or_else(|| NotHuman::because(format!("the shape has {found} ends instead of head, two hands and two feet")))?;
    let refuse = |reason: String| NotHuman { margin_and_cost: Some((ends.margin, ends.cost)), ..NotHuman::because(reason) };
    if ends.cost > MOST_COST {
        return Err(refuse(format!("its proportions are not those of a person (cost {:.2}, at most {MOST_COST})", ends.cost)));
    }
    if ends.margin < LEAST_MARGIN {
        return Err(refuse(format!(
            "head, hands and feet cannot be told apart (margin {:.2}, at least {LEAST_MARGIN})",
            ends.margin
        )));
    }
    let body = skeleton::body(&solid, &ends, points).ok_or_else(|| refuse("a limb cannot be followed to the trunk".into()))?;
    match doubts::about(&body) {
        Some(doubt) => Err(refuse(doubt)),
        None => Ok(body),
    }
}

/// Why no body was found.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct NotHuman {
    /// In words: what was looked for and what was found instead.
    pub reason: String,
    /// Margin and cost of the best labelling, if there was one.
    pub margin_and_cost: Option<(f64, f64)>,
}

impl NotHuman {
    fn because(found: impl std::fmt::Display) -> Self {
        let reason = format!("looked for a standing person with arms and legs apart (T or A pose), but {found}");
        Self { reason, margin_and_cost: None }
    }
}
