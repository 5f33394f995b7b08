//! Where the landmarks of the dictionary lie on the skin of this scan.

use super::labels::{Part, Place};
use super::segments::{Segment, Side, Skeleton};
use crate::spatial::TriangleTree;
use glam::DVec3;

/// Height of the ankle joint over the sole, in statures.
const ANKLE_HEIGHT: f64 = 0.025;
/// The head joint lies low in the skull: `t` counts to a little under the crown.
const SKULL: f64 = 0.9;
/// Two sheets of skin farther apart than this, in statures, are not one part of the body (an arm beside the trunk).
const SHEET_GAP: f64 = 0.03;

/// The point where the place's ray from the segment axis leaves the scan, in the unit box.
pub(crate) fn on_skin(place: &Place, body: &Skeleton, tree: &TriangleTree) -> DVec3 {
    if let Some(at) = place.at {
        return at;
    }
    let height = body.stature;
    let sign = if place.side == Side::Right { -1.0 } else { 1.0 };
    let (out, fwd, along) = (place.ray.x, place.ray.y, place.ray.z);
    let upright = body.left * sign * out + body.forward * fwd + body.up * along;
    let bone = body.bone(place.segment());
    let (from, direction, reach) = match place.part {
        Part::Pelvis | Part::Trunk => {
            let hips = body.bone(Segment::Pelvis).origin;
            (hips.lerp(body.neck, place.t), upright, 0.16)
        }
        Part::Head => (bone.origin.lerp(bone.end, place.t * SKULL), upright, 0.12),
        Part::Shoulder => (body.shoulders[usize::from(place.side == Side::Right)], upright, 0.075),
        Part::Foot => {
            let sole = bone.origin - body.up * ANKLE_HEIGHT * height;
            let from = sole + bone.forward * place.t * bone.length;
            // A place without a direction is the top of the foot.
            let up = if place.ray == DVec3::ZERO { body.up } else { DVec3::ZERO };
            (from, bone.out * out + bone.forward * fwd + up, 0.06)
        }
        Part::UpperArm | Part::Forearm | Part::Hand | Part::Thigh | Part::Shank => {
            let reach = match place.part {
                Part::UpperArm => 0.06,
                Part::Forearm => 0.045,
                Part::Hand => 0.04,
                Part::Thigh => 0.085,
                _ => 0.06,
            };
            let from = bone.origin.lerp(bone.end, place.t);
            (from, bone.out * out + bone.forward * fwd + bone.axis * along, reach)
        }
    };
    let direction = direction.normalize_or(body.up);
    from + direction * leave(tree, from, direction, reach * height, SHEET_GAP * height)
}

/// Distance at which a ray leaves the part of the body that its origin lies in; of stacked sheets (lips, clothes) the outermost.
fn leave(tree: &TriangleTree, from: DVec3, direction: DVec3, reach: f64, gap: f64) -> f64 {
    let mut last = None;
    for hit in tree.hits(from, direction) {
        if hit.distance > reach || last.is_some_and(|d| hit.distance - d > gap) {
            break;
        }
        last = Some(hit.distance);
    }
    last.unwrap_or_else(|| tree.closest(from).map_or(reach, |c| c.distance.min(reach)))
}
