//! Joints that no standing person has.

use super::{Arms, Body, Joint};
use glam::DVec3;

/// Trunk against legs in degrees; people in T and A poses measure 0 to 11, a horse 89.
const MOST_HIP_BEND: f64 = 30.0;
/// Thigh against shank in degrees; 2 to 17 when standing.
const MOST_KNEE_BEND: f64 = 40.0;
/// Arms lower than this many degrees touch the trunk: the armpit is not seen and the shoulder errs by 7 % of stature.
const LOWEST_ARM: f64 = -80.0;
/// Lengths in shares of the leg from hip to ankle; in brackets what people measure.
const RANGES: [(&str, [f64; 2]); 5] = [
    ("arms", [0.35, 0.80]),          // 0.45 to 0.67
    ("trunk", [0.40, 1.15]),         // 0.53 to 0.91
    ("shoulders", [0.12, 0.75]),     // 0.17 to 0.53
    ("hips", [0.10, 0.45]),          // 0.15 to 0.29
    ("neck and head", [0.13, 0.70]), // 0.19 to 0.41
];

/// The first thing that does not fit a standing person, in words.
pub(super) fn about(body: &Body) -> Option<String> {
    let at = |joint: Joint| body.joints[joint as usize];
    let bend = |a: DVec3, b: DVec3| a.angle_between(b).to_degrees();
    let ankles = (at(Joint::LeftAnkle) + at(Joint::RightAnkle)) * 0.5;
    let trunk = at(Joint::Neck) - at(Joint::MidHip);
    let hip_bend = bend(trunk, at(Joint::MidHip) - ankles);
    if hip_bend > MOST_HIP_BEND {
        return Some(format!("it bends {hip_bend:.0} degrees between trunk and legs (at most {MOST_HIP_BEND})"));
    }
    let legs = [
        [Joint::LeftHip, Joint::LeftKnee, Joint::LeftAnkle].map(at),
        [Joint::RightHip, Joint::RightKnee, Joint::RightAnkle].map(at),
    ];
    let knee_bend = legs.map(|[hip, knee, ankle]| bend(hip - knee, knee - ankle)).into_iter().fold(0.0, f64::max);
    if knee_bend > MOST_KNEE_BEND {
        return Some(format!("a knee is bent by {knee_bend:.0} degrees (at most {MOST_KNEE_BEND})"));
    }
    let apart = body.arms == Arms::Apart;
    if let Some(low) = body.arm_elevation.into_iter().find(|a| apart && *a < LOWEST_ARM) {
        return Some(format!("an arm hangs along the trunk ({:.0} degrees below level, at most {:.0})", -low, -LOWEST_ARM));
    }
    let chain = |[a, b, c]: [DVec3; 3]| a.distance(b) + b.distance(c);
    let leg = 0.5 * (chain(legs[0]) + chain(legs[1]));
    let arms = [
        [Joint::LeftShoulder, Joint::LeftElbow, Joint::LeftWrist].map(at),
        [Joint::RightShoulder, Joint::RightElbow, Joint::RightWrist].map(at),
    ];
    let lengths = [
        0.5 * (chain(arms[0]) + chain(arms[1])),
        trunk.length(),
        at(Joint::LeftShoulder).distance(at(Joint::RightShoulder)),
        at(Joint::LeftHip).distance(at(Joint::RightHip)),
        at(Joint::Neck).distance(at(Joint::Crown)),
    ];
    RANGES.iter().zip(lengths).find_map(|((part, [low, high]), length)| {
        let share = length / leg;
        (!(low..=high).contains(&&share)).then(|| format!("its {part} measure {share:.2} of its legs (people: {low} to {high})"))
    })
}
