//! The points by which joints hold the scan: joints inside of it, and rings of points on the skin round its parts.

use super::puppet::{Part, Puppet};
use crate::binding::labels::{Part as Stretch, Place};
use crate::binding::segments::{Segment, Side, Skeleton};
use crate::binding::{BoundMarker, places};
use crate::spatial::TriangleTree;
use glam::DVec3;

/// A point of the scan at rest that moves with a part.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Grip {
    pub label: String,
    /// In the unit box.
    pub rest: DVec3,
    pub part: Part,
    pub segment: Segment,
}

/// Shares of the way from hips to neck at which the trunk is held, and whether at its sides too: beside the chest the skin goes with the
/// arms, below the waist with the thighs.
const TRUNK: [(f64, bool); 4] = [(0.18, true), (0.42, true), (0.66, false), (0.86, false)];

/// Across a bone: outwards, inwards, to the front, to the back.
const ACROSS: [(&str, [f64; 3]); 4] =
    [("out", [1.0, 0.0, 0.0]), ("in", [-1.0, 0.0, 0.0]), ("front", [0.0, 1.0, 0.0]), ("back", [0.0, -1.0, 0.0])];

struct Builder<'a> {
    body: &'a Skeleton,
    tree: &'a TriangleTree,
    grips: Vec<Grip>,
}

impl Builder<'_> {
    fn inside(&mut self, label: String, rest: DVec3, part: Part, segment: Segment) {
        self.grips.push(Grip { label, rest, part, segment });
    }

    /// Points on the skin round a segment's axis at `t`.
    fn ring(&mut self, name: &str, stretch: Stretch, side: Side, t: f64, part: Part, directions: &[(&str, [f64; 3])]) {
        for (word, ray) in directions {
            let place = Place { landmark: "", part: stretch, side, t, ray: DVec3::from(*ray), weight: 1.0, at: None };
            let rest = places::on_skin(&place, self.body, self.tree);
            self.inside(format!("{name} {:.0} {word}", 100.0 * t), rest, part, place.segment());
        }
    }
}

/// All grips on a scan.
pub(super) fn all(puppet: &Puppet<'_>, body: &Skeleton, tree: &TriangleTree) -> Vec<Grip> {
    let mut b = Builder { body, tree, grips: Vec::new() };
    let sides = [("left", Side::Left), ("right", Side::Right)];
    let round = [ACROSS[2], ACROSS[3], ("left", [1.0, 0.0, 0.0]), ("right", [-1.0, 0.0, 0.0])];
    for (t, sides) in TRUNK {
        let stretch = if t < 0.2 { Stretch::Pelvis } else { Stretch::Trunk };
        b.ring("trunk", stretch, Side::Middle, t, puppet.trunk_at(t), if sides { &round } else { &round[..2] });
    }
    let middle = body.bone(Segment::Pelvis).origin.lerp(body.neck, 0.75);
    b.inside("chest".to_owned(), middle, puppet.trunk_at(0.75), Segment::Trunk);
    b.inside("neck".to_owned(), body.neck, Part::Neck, Segment::Trunk);
    b.ring("head", Stretch::Head, Side::Middle, 0.5, Part::Head, &round);
    b.ring("head", Stretch::Head, Side::Middle, 0.9, Part::Head, &[("top", [0.0, 0.0, 1.0])]);
    for (s, (word, side)) in sides.into_iter().enumerate() {
        let pick = |left, right| if s == 0 { left } else { right };
        let name = |part: &str| format!("{word} {part}");
        let upper = pick(Segment::LeftUpperArm, Segment::RightUpperArm);
        let fore = pick(Segment::LeftForearm, Segment::RightForearm);
        let hand = pick(Segment::LeftHand, Segment::RightHand);
        let bone = *body.bone(upper);
        b.inside(name("shoulder"), bone.origin, Part::UpperArm(s), upper);
        b.inside(name("upper arm"), bone.origin.lerp(bone.end, 0.38), Part::UpperArm(s), upper);
        b.ring(&name("upper arm"), Stretch::UpperArm, side, 0.68, Part::UpperArm(s), &ACROSS);
        b.inside(name("elbow"), body.bone(fore).origin, Part::Forearm(s), fore);
        b.ring(&name("forearm"), Stretch::Forearm, side, 0.32, Part::Forearm(s), &ACROSS);
        b.ring(&name("forearm"), Stretch::Forearm, side, 0.82, Part::Cuff(s), &ACROSS);
        b.ring(&name("hand"), Stretch::Hand, side, 0.4, Part::Hand(s), &ACROSS);
        b.inside(name("wrist"), body.bone(hand).origin, Part::Hand(s), hand);
        b.inside(name("hand tip"), body.bone(hand).origin.lerp(body.bone(hand).end, 0.9), Part::Hand(s), hand);
        let thigh = pick(Segment::LeftThigh, Segment::RightThigh);
        let shank = pick(Segment::LeftShank, Segment::RightShank);
        let foot = pick(Segment::LeftFoot, Segment::RightFoot);
        let bone = *body.bone(thigh);
        b.inside(name("hip"), bone.origin, Part::Thigh(s), thigh);
        b.inside(name("thigh"), bone.origin.lerp(bone.end, 0.35), Part::Thigh(s), thigh);
        b.ring(&name("thigh"), Stretch::Thigh, side, 0.68, Part::Thigh(s), &ACROSS);
        b.inside(name("knee"), body.bone(shank).origin, Part::Shank(s), shank);
        b.ring(&name("shank"), Stretch::Shank, side, 0.32, Part::Shank(s), &ACROSS);
        b.ring(&name("shank"), Stretch::Shank, side, 0.78, Part::Shank(s), &ACROSS);
        b.inside(name("ankle"), body.bone(foot).origin, Part::Foot(s), foot);
        b.ring(&name("foot"), Stretch::Foot, side, 0.0, Part::Foot(s), &[ACROSS[0], ACROSS[1], ACROSS[3]]);
        b.ring(&name("foot"), Stretch::Foot, side, 0.6, Part::Foot(s), &[ACROSS[0], ACROSS[1]]);
        b.ring(&name("toes"), Stretch::Foot, side, 0.85, Part::Toes(s), &[ACROSS[0], ACROSS[1], ACROSS[2]]);
    }
    for grip in &mut b.grips {
        grip.label = BoundMarker::held_by(puppet.joint(grip.part), &grip.label);
    }
    b.grips
}
