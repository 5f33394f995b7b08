//! The joints of a human scan, found from its shape alone.

use glam::DVec3;

/// The places of a body that the binding needs. Left and right are the body's own.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
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

/// Finds the body in a scan, or says why not.
///
/// Shapes: `points` in the unit box; `triangles` over them (holes, flipped faces and several shells do not matter).
pub fn find(points: &[DVec3], triangles: &[[u32; 3]]) -> Result<Body, NotHuman> {
    let _ = (points, triangles);
    unimplemented!()
}

/// Why no body was found.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct NotHuman {
    /// In words: what was looked for and what was found instead.
    pub reason: String,
    /// Margin and cost of the best labelling, if there was one.
    pub margin_and_cost: Option<(f64, f64)>,
}
