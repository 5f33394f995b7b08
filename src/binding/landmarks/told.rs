//! Joints that the user gives.

use super::{Arms, Body, Joint, NotHuman};
use crate::space::Axis;
use glam::DVec3;
use std::collections::BTreeMap;

/// What a body cannot be made without; tips, toes, head and the middle of the hips follow from it.
const NEEDED: [Joint; 14] = {
    use Joint::*;
    [
        Neck,
        Crown,
        LeftShoulder,
        LeftElbow,
        LeftWrist,
        RightShoulder,
        RightElbow,
        RightWrist,
        LeftHip,
        LeftKnee,
        LeftAnkle,
        RightHip,
        RightKnee,
        RightAnkle,
    ]
};
/// Length of a hand from wrist to tip, of a foot from ankle to toes, in statures; and where the head turns, from neck to crown.
const HAND: f64 = 0.10;
const FOOT: f64 = 0.12;
const HEAD: f64 = 0.2;
/// Cosine from which the way from the feet to the neck is a file axis: 10 degrees.
const SNAP: f64 = 0.985;

/// The body that was found, with the user's joints in it; or, where none was, the body that the user's joints make.
///
/// Shapes: `places`: in the unit box; `points`: of the scan, in the unit box.
///
/// # Errors
/// Why no body was found, with the joints that would make one.
pub fn told(found: Result<Body, NotHuman>, places: &BTreeMap<Joint, DVec3>, points: &[DVec3]) -> Result<Body, NotHuman> {
    if places.is_empty() {
        return found;
    }
    let mut body = match found {
        Ok(body) => body,
        Err(reason) => made(places, points).map_err(|missing| {
            let reason = format!("{}; of [landmarks] there lack {}", reason.reason, missing.join(", "));
            NotHuman { reason, margin_and_cost: None }
        })?,
    };
    for (&joint, &place) in places {
        body.joints[joint as usize] = place;
    }
    if !places.contains_key(&Joint::MidHip) && (places.contains_key(&Joint::LeftHip) || places.contains_key(&Joint::RightHip)) {
        body.joints[Joint::MidHip as usize] =
            body.joints[Joint::LeftHip as usize].lerp(body.joints[Joint::RightHip as usize], 0.5);
    }
    Ok(body)
}

fn made(places: &BTreeMap<Joint, DVec3>, points: &[DVec3]) -> Result<Body, Vec<String>> {
    use Joint::*;
    let missing: Vec<String> = NEEDED.iter().filter(|j| !places.contains_key(j)).map(|j| word(*j)).collect();
    if !missing.is_empty() {
        return Err(missing);
    }
    let at = |joint: Joint| places.get(&joint).copied().unwrap_or_default();
    let rise = at(Neck) - (at(LeftAnkle) + at(RightAnkle)) * 0.5;
    let up = rise.try_normalize().ok_or_else(|| vec!["a neck above the ankles".to_owned()])?;
    let axis = Axis::nearest(up).vector();
    let up = if axis.dot(up) > SNAP { axis } else { up };
    let left = at(LeftHip) - at(RightHip);
    let forward = left.cross(up).try_normalize().ok_or_else(|| vec!["hips beside each other".to_owned()])?;
    let lowest = points.iter().map(|p| p.dot(up)).fold(f64::INFINITY, f64::min);
    let stature = at(Crown).dot(up) - lowest;
    if stature.is_nan() || stature <= 0.0 {
        return Err(vec!["a crown above the feet".to_owned()]);
    }
    let mut joints = [DVec3::ZERO; Joint::COUNT];
    for joint in NEEDED {
        joints[joint as usize] = at(joint);
    }
    joints[MidHip as usize] = (at(LeftHip) + at(RightHip)) * 0.5;
    joints[Head as usize] = at(Neck).lerp(at(Crown), HEAD);
    let mut arm_elevation = [0.0; 2];
    let arms = [(LeftShoulder, LeftElbow, LeftWrist, LeftHandTip), (RightShoulder, RightElbow, RightWrist, RightHandTip)];
    for (side, (shoulder, elbow, wrist, tip)) in arms.into_iter().enumerate() {
        joints[tip as usize] = at(wrist) + (at(wrist) - at(elbow)).normalize_or(-up) * (HAND * stature);
        let arm = (at(wrist) - at(shoulder)).normalize_or(-up);
        arm_elevation[side] = arm.dot(up).clamp(-1.0, 1.0).asin().to_degrees();
    }
    for (ankle, toe) in [(LeftAnkle, LeftToe), (RightAnkle, RightToe)] {
        let sole = at(ankle) + up * (lowest - at(ankle).dot(up));
        joints[toe as usize] = sole + forward * (FOOT * stature);
    }
    Ok(Body {
        joints,
        up,
        forward,
        facing_ratio: f64::INFINITY,
        margin: 1.0,
        cost: 0.0,
        stature,
        arm_elevation,
        arms: Arms::Apart,
        floor: None,
    })
}

/// A joint as the rig file calls it.
fn word(joint: Joint) -> String {
    let mut out = String::new();
    for c in format!("{joint:?}").chars() {
        if c.is_uppercase() && !out.is_empty() {
            out.push('_');
        }
        out.extend(c.to_lowercase());
    }
    out
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;
    use crate::binding::tests::person;

    #[test]
    fn the_joints_of_a_person_make_the_body_that_was_found() {
        let person = person(0.6);
        let places: BTreeMap<Joint, DVec3> = NEEDED.into_iter().map(|j| (j, person.body.joints[j as usize])).collect();
        let points = [person.body.joints[Joint::LeftToe as usize] - DVec3::Y * 0.01];
        let nobody = NotHuman { reason: "no ends".to_owned(), margin_and_cost: None };
        let body = told(Err(nobody.clone()), &places, &points).unwrap();
        assert!(body.up.dot(person.body.up) > 0.999 && body.forward.dot(person.body.forward) > 0.99);
        for joint in Joint::ALL {
            let far = body.joints[joint as usize].distance(person.body.joints[joint as usize]) / person.body.stature;
            assert!(far < 0.06, "{joint:?}: {far}");
        }
        let mut few = places;
        few.remove(&Joint::LeftKnee);
        let lack = told(Err(nobody), &few, &points).unwrap_err();
        assert!(lack.reason.contains("left_knee"), "{}", lack.reason);
    }

    #[test]
    fn a_joint_of_the_user_wins_over_the_one_that_was_found() {
        let person = person(0.6);
        let place = person.body.joints[Joint::LeftHip as usize] + DVec3::X * 0.02;
        let body = told(Ok(person.body.clone()), &BTreeMap::from([(Joint::LeftHip, place)]), &[]).unwrap();
        assert_eq!(body.joints[Joint::LeftHip as usize], place);
        let middle = body.joints[Joint::MidHip as usize] - person.body.joints[Joint::MidHip as usize];
        assert!((middle.length() - 0.01).abs() < 1e-12);
    }
}
