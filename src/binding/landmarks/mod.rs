//! The joints of a human scan, found from its shape alone.
//!
//! A solid graph of voxels, its five ends told apart by their distances through the body, medial curves from the ends inwards, and
//! joints on these curves by section area, bends and the proportions of people (Winter, Biomechanics and Motor Control of Human
//! Movement). Nothing is learnt and no axis need be known. Arms that touch the trunk are found from the side, with less certainty, and
//! a floor that has grown together with the feet is left out.

mod axes;
#[cfg(test)]
mod corpus;
mod doubts;
mod extremities;
mod floor;
mod frame;
mod geodesic;
mod hanging;
mod limbs;
mod medial;
mod pieces;
mod skeleton;
#[cfg(test)]
mod tests;
mod told;
mod voxels;

pub use floor::Floor;
pub use told::told;

use extremities::{End, Extremities};
use glam::DVec3;
use serde::{Deserialize, Serialize};
use skeleton::Reach;
use voxels::{Filled, RESOLUTION, Solid};

/// The joints and their list.
macro_rules! joints {
    ($($joint:ident)*) => {
        /// The places of a body that the binding needs. Left and right are the body's own.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
        #[serde(rename_all = "snake_case")]
        #[allow(missing_docs)]
        pub enum Joint {
            $($joint),*
        }

        impl Joint {
            /// All joints in order.
            pub const ALL: [Joint; Self::COUNT] = [$(Joint::$joint),*];

            /// Number of joints; `joint as usize` is its index.
            pub const COUNT: usize = [$(Joint::$joint),*].len();
        }
    };
}

joints! {
    MidHip Neck Head Crown
    LeftShoulder LeftElbow LeftWrist LeftHandTip
    RightShoulder RightElbow RightWrist RightHandTip
    LeftHip LeftKnee LeftAnkle LeftToe
    RightHip RightKnee RightAnkle RightToe
}

/// Where the arms are.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Arms {
    /// Clear of the trunk, and followed from the finger tips.
    #[default]
    Apart,
    /// Along the trunk: their joints are known less well.
    Hanging,
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
    /// Where they are.
    pub arms: Arms,
    /// What it stands on and has grown together with.
    pub floor: Option<Floor>,
}

/// Margins below this are no person as far as can be told.
const LEAST_MARGIN: f64 = 0.15;
/// Costs above this are no person, however clear the labelling.
const MOST_COST: f64 = 0.45;
/// A person fills about 25 000 voxels; more than this has no limbs to speak of.
const MOST_VOXELS: usize = 80_000;

/// Arms whose wrists are both nearer to the body's axis than this, in statures, may hide their armpits (arms 60 degrees down reach 0.26):
/// the shoulders are looked for from the side too, and taken from there when they differ by more than a share of stature (a heavy body with
/// arms 72 degrees down: 0.06; others 0.02 or less).
const CLOSE: f64 = 0.26;
const MISLED: f64 = 0.04;
/// Voxels along the longest side where the widths of hanging arms are measured.
const FINE: f64 = 220.0;

/// Finds the body in a scan, or says why not.
///
/// Shapes: `points` in the unit box; `triangles` over them (holes, flipped faces and several shells do not matter).
/// The person stands; best with arms and legs apart (T pose, A pose and between).
pub fn find(points: &[DVec3], triangles: &[[u32; 3]]) -> Result<Body, NotHuman> {
    let triangles = pieces::without_debris(points, triangles);
    let empty = || NotHuman::because("the mesh encloses nothing");
    let mut filled = Filled::of(points, &triangles, RESOLUTION).ok_or_else(empty)?;
    let solid = Solid::of(&filled);
    if solid.len() > MOST_VOXELS {
        return Err(NotHuman::because("the shape is too compact: it has no arms and legs apart from a trunk"));
    }
    search(&solid, points, &triangles, None).or_else(|refusal| {
        let Some(floor) = Floor::of(&filled, points, &triangles) else { return Err(refusal) };
        filled.keep(|p| !floor.holds(p));
        search(&Solid::of(&filled), points, &triangles, Some(floor)).map_err(|_| refusal)
    })
}

/// Looks for a person with the arms apart, then for one with the arms down.
fn search(solid: &Solid, points: &[DVec3], triangles: &[[u32; 3]], floor: Option<Floor>) -> Result<Body, NotHuman> {
    let ends = extremities::ends(solid);
    let hanging = || {
        let slender = extremities::label_slender(&ends, solid)?;
        let mut fine = Filled::of(points, triangles, FINE)?;
        if let Some(floor) = floor {
            fine.keep(|p| !floor.holds(p));
        }
        hanging(solid, &slender, &fine, points)
    };
    let body = match apart(solid, &ends, points) {
        Ok(body) if wrists_are_close(&body) => match hanging() {
            Some(seen) => with_shoulders(body, &seen),
            None => body,
        },
        Ok(body) => body,
        Err(refusal) => hanging().ok_or(refusal)?,
    };
    Ok(Body { floor, ..body })
}

fn wrists_are_close(body: &Body) -> bool {
    let left = body.up.cross(body.forward);
    let aside = |j: Joint| (body.joints[j as usize] - body.joints[Joint::Neck as usize]).dot(left).abs();
    [Joint::LeftWrist, Joint::RightWrist].into_iter().all(|wrist| aside(wrist) < CLOSE * body.stature)
}

/// The body with shoulders and elbows seen from the side where an armpit that is not seen has misled its own.
fn with_shoulders(mut body: Body, seen: &Body) -> Body {
    use Joint::{LeftElbow, LeftShoulder, RightElbow, RightShoulder};
    let off = |j: Joint| body.joints[j as usize].distance(seen.joints[j as usize]) / body.stature;
    if off(LeftShoulder).max(off(RightShoulder)) > MISLED {
        for joint in [LeftShoulder, LeftElbow, RightShoulder, RightElbow] {
            body.joints[joint as usize] = seen.joints[joint as usize];
        }
        body.arm_elevation = seen.arm_elevation;
    }
    body
}

fn apart(solid: &Solid, ends: &[End], points: &[DVec3]) -> Result<Body, NotHuman> {
    let found = ends.len();
    let (ends, hands) = extremities::label(ends)
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
    let body = skeleton::body(solid, &ends, &Reach::Apart(&hands), points)
        .ok_or_else(|| refuse("a limb cannot be followed to the trunk".into()))?;
    match doubts::about(&body) {
        Some(doubt) => Err(refuse(doubt)),
        None => Ok(body),
    }
}

/// A person with the arms down.
fn hanging(solid: &Solid, ends: &Extremities, fine: &Filled, points: &[DVec3]) -> Option<Body> {
    if ends.cost > MOST_COST || ends.margin < LEAST_MARGIN {
        return None;
    }
    let body = skeleton::body(solid, ends, &Reach::Hanging(fine), points)?;
    doubts::about(&body).is_none().then_some(body)
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
        let reason =
            format!("looked for a standing person (arms and legs apart as in T and A poses, or the arms down), but {found}");
        Self { reason, margin_and_cost: None }
    }
}
