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
/// Skin up to this share of the way to where the other leg begins is a leg's own: no two legs are quite alike.
const TOUCHING: f64 = 1.1;
/// Where skin of its own is missing, a place of a leg is at most this share of that way off the bone.
const WITHIN: f64 = 0.7;

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
    let border = match place.part {
        Part::Thigh | Part::Shank => {
            let other = body.bone(place.segment().opposite());
            half_way(other.origin.lerp(other.end, place.t) - from, direction)
        }
        _ => f64::INFINITY,
    };
    from + direction * leave(tree, from, direction, reach * height, SHEET_GAP * height, border)
}

/// How far in a direction what is `away` is as near as where one comes from.
fn half_way(away: DVec3, direction: DVec3) -> f64 {
    let along = away.dot(direction);
    if along > 0.0 { 0.5 * away.length_squared() / along } else { f64::INFINITY }
}

/// Distance at which a ray leaves the part of the body that its origin lies in; of stacked sheets (lips, clothes) the outermost. `border`: where what is
/// beside begins, as when thighs have melted into each other.
fn leave(tree: &TriangleTree, from: DVec3, direction: DVec3, reach: f64, gap: f64, border: f64) -> f64 {
    let reach = reach.min(TOUCHING * border);
    let mut last = None;
    for hit in tree.hits(from, direction) {
        if hit.distance > reach || last.is_some_and(|d| hit.distance - d > gap) {
            break;
        }
        last = Some(hit.distance);
    }
    last.unwrap_or_else(|| tree.closest(from).map_or(reach, |c| c.distance.min(reach)).min(WITHIN * border))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_ray_ends_where_the_other_leg_begins() {
        let corner = |i: u32| DVec3::new(f64::from(i & 1), f64::from(i >> 1 & 1), f64::from(i >> 2)) * 2.0 - DVec3::ONE;
        let points: Vec<DVec3> = (0..8).map(corner).collect();
        let sides = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
        let faces: Vec<[u32; 3]> = sides.iter().flat_map(|[a, b, c, d]| [[*a, *b, *c], [*a, *c, *d]]).collect();
        let tree = TriangleTree::new(&points, &faces);
        let end = |border: f64| leave(&tree, DVec3::new(0.0, 0.1, 0.2), DVec3::X, 5.0, 0.1, border);
        assert_eq!([f64::INFINITY, 0.95].map(end), [1.0; 2]);
        // What is hit behind it is the other leg's.
        assert_eq!(end(0.5), 0.5 * WITHIN);
        assert_eq!(half_way(DVec3::new(2.0, 0.0, 0.0), DVec3::X), 1.0);
        assert_eq!(half_way(DVec3::new(-2.0, 1.0, 0.0), DVec3::X), f64::INFINITY);
    }
}
