//! `--picture`: the scan from four sides, with what the binding found on it, or what there is to bind where it found nothing.

use crate::binding::landmarks::{Body, Joint};
use crate::binding::{Binding, BoundMarker, Segment};
use crate::capture::{Capture, Motion};
use crate::error::Result;
use crate::export::files::Pending;
use crate::picture::{self, CLAY, Colors, Mark, Picture, Shape, Sheet, Stroke, Surface, View};
use crate::scan::Scan;
use crate::space::Axis;
use crate::spatial::PointTree;
use glam::DVec3;
use std::path::Path;

/// Colours of what is left, right and in the middle of the body.
const LEFT: [u8; 3] = [34, 96, 190];
const RIGHT: [u8; 3] = [200, 62, 34];
const MIDDLE: [u8; 3] = [30, 124, 84];
const BONE: [u8; 3] = [90, 84, 110];
/// Colour of skin by which parts are still joined that only touch.
const DOUBTFUL: [u8; 3] = [236, 120, 20];
/// Distance from such places up to which the skin is coloured, and where the colour has gone, in diagonals.
const DOUBTFUL_REACH: [f64; 2] = [0.008, 0.02];
/// Markers farther from their attachments than this, in diagonals, are not drawn: they would make the scan small.
const FARTHEST: f64 = 0.6;

/// What the picture is made from, all in the unit box.
pub(super) struct Bound<'a> {
    /// What stands above the views.
    pub(super) heading: Vec<String>,
    pub(super) scan: &'a Scan,
    pub(super) points: &'a [DVec3],
    pub(super) triangles: &'a [[u32; 3]],
    pub(super) binding: &'a Binding,
    /// The capture that holds the reference frame.
    pub(super) reference: &'a Capture,
    /// Places where the proxy joins parts that only touch.
    pub(super) joined: &'a [DVec3],
}

/// A scan that nothing is bound to.
pub(super) struct Unbound<'a> {
    /// What stands above the views.
    pub(super) heading: Vec<String>,
    pub(super) scan: &'a Scan,
    pub(super) points: &'a [DVec3],
    pub(super) triangles: &'a [[u32; 3]],
    /// The person in it, where one was found.
    pub(super) body: Option<&'a Body>,
}

/// Writes a picture.
///
/// Errors: a file that cannot be written.
pub(super) fn write(path: &Path, picture: &Picture) -> Result<()> {
    let bytes = picture.png()?;
    let mut file = Pending::create(path)?;
    file.write(&bytes)?;
    file.finish().map(drop)
}

/// The scan with the landmarks of the person in it.
pub(super) fn landmarks(unbound: Unbound<'_>) -> Picture {
    from_sides(unbound, 4)
}

/// The first so many views of [`landmarks`].
fn from_sides(unbound: Unbound<'_>, sides: usize) -> Picture {
    let space = &unbound.scan.space;
    let up = unbound.body.map(|b| b.up).or(space.up.map(|up| up.value.vector()));
    let forward = unbound.body.map(|b| b.forward).or(space.forward.map(|f| f.value));
    let mut sheet = Sheet {
        surfaces: vec![Surface { points: unbound.points, triangles: unbound.triangles, colors: Colors::Plain }],
        views: views(up, forward).into_iter().take(sides).collect(),
        heading: unbound.heading,
        ..Sheet::default()
    };
    let Some(body) = unbound.body else {
        sheet.legend.push((Shape::Square, BONE, "no person was recognised".to_owned()));
        return picture::draw(&sheet);
    };
    for (from, to) in BONES {
        let [from, to] = [from, to].map(|joint| body.joints[joint as usize]);
        sheet.strokes.push(Stroke { from, to, color: BONE, width: 2.0, opacity: 0.55 });
    }
    for joint in Joint::ALL {
        let name = joint_words(joint);
        let color = if name.starts_with("left") {
            LEFT
        } else if name.starts_with("right") {
            RIGHT
        } else {
            MIDDLE
        };
        sheet.marks.push(Mark { at: body.joints[joint as usize], name, color, shape: Shape::Square, through: true });
    }
    for (color, words) in [(LEFT, "landmark of the scan, left"), (RIGHT, "right"), (MIDDLE, "middle")] {
        sheet.legend.push((Shape::Square, color, words.to_owned()));
    }
    picture::draw(&sheet)
}

/// The same from two sides, and beside it the markers of the first frame that shows most of them, with their numbers and names. `up`: in the capture.
pub(super) fn not_bound(unbound: Unbound<'_>, capture: &Capture, up: DVec3) -> Picture {
    let take = capture.motion.points();
    let seen = |frame: usize| (0..take.markers()).filter(|&m| take.point(frame, m).is_some()).count();
    // The first of the best.
    let frame = (0..take.frames()).rev().max_by_key(|&f| seen(f)).unwrap_or(0);
    let level = up.any_orthonormal_vector();
    // The letters have no minus sign but the hyphen.
    let title = |toward| format!("from {}", Axis::nearest(toward)).replace('\u{2212}', "-");
    let sides = [level, up.cross(level)].map(|toward| View { title: title(toward), toward, up });
    let mut sheet = Sheet { views: sides.into(), heading: vec![String::new(); unbound.heading.len()], ..Sheet::default() };
    let common = common_prefix(take.labels.iter().map(String::as_str));
    for (m, label) in take.labels.iter().enumerate() {
        if let Some(at) = (take.frames() > 0).then(|| take.point(frame, m)).flatten() {
            let name = format!("{} {}", m + 1, &label[common..]);
            sheet.marks.push(Mark { at, name, color: MIDDLE, shape: Shape::Ring, through: true });
        }
    }
    let number = capture.first_frame + frame as i64;
    sheet.legend.push((Shape::Ring, MIDDLE, format!("marker in frame {number}: number and label")));
    from_sides(unbound, 2).beside(&picture::draw(&sheet))
}

/// Lines between landmarks.
const BONES: [(Joint, Joint); 18] = {
    use Joint::*;
    [
        (Crown, Head),
        (Head, Neck),
        (Neck, MidHip),
        (LeftShoulder, RightShoulder),
        (LeftShoulder, LeftElbow),
        (LeftElbow, LeftWrist),
        (LeftWrist, LeftHandTip),
        (RightShoulder, RightElbow),
        (RightElbow, RightWrist),
        (RightWrist, RightHandTip),
        (LeftHip, MidHip),
        (LeftHip, LeftKnee),
        (LeftKnee, LeftAnkle),
        (LeftAnkle, LeftToe),
        (RightHip, MidHip),
        (RightHip, RightKnee),
        (RightKnee, RightAnkle),
        (RightAnkle, RightToe),
    ]
};

/// `left hand tip`.
fn joint_words(joint: Joint) -> String {
    let mut words = String::new();
    for c in format!("{joint:?}").chars() {
        if c.is_uppercase() && !words.is_empty() {
            words.push(' ');
        }
        words.extend(c.to_lowercase());
    }
    words
}

/// The scan with what is bound to it.
pub(super) fn bound(bound: &Bound<'_>) -> Picture {
    let colors = colors(bound.points, bound.joined);
    let colors = if bound.joined.is_empty() { Colors::Plain } else { Colors::PerVertex(&colors) };
    let (decisions, space) = (&bound.binding.decisions, &bound.scan.space);
    let up = decisions.scan_up.map(|up| up.value).or(space.up.map(|up| up.value.vector()));
    let mut sheet = Sheet {
        surfaces: vec![Surface { points: bound.points, triangles: bound.triangles, colors }],
        views: views(up, decisions.scan_forward.or(space.forward).map(|f| f.value)),
        heading: bound.heading.clone(),
        ..Sheet::default()
    };
    // Of a skeleton the user knows the joints, not the points that move with them.
    let of_joints = bound.binding.trajectories.is_some();
    skeleton(bound.binding, !of_joints, &mut sheet);
    let rings = if of_joints {
        sheet.marks.extend(joints(&bound.binding.handles, &depths(bound.reference)));
        false
    } else {
        markers(bound, &mut sheet)
    };
    let mut explain = |shape, color, words: &str| sheet.legend.push((shape, color, words.to_owned()));
    if of_joints {
        explain(Shape::Ring, MIDDLE, "joint of the capture");
        explain(Shape::Dot, MIDDLE, "point that moves with it");
        if !bound.binding.segments.is_empty() {
            explain(Shape::Square, BONE, "joint of the scan");
        }
    } else if bound.binding.segments.is_empty() {
        explain(Shape::Dot, MIDDLE, "attachment");
    } else {
        explain(Shape::Dot, LEFT, "attachment, left");
        explain(Shape::Dot, RIGHT, "right");
        explain(Shape::Dot, MIDDLE, "middle");
        explain(Shape::Square, BONE, "joint of the scan");
    }
    if rings {
        explain(Shape::Ring, MIDDLE, &format!("marker in frame {}", bound.binding.decisions.reference_frame));
    }
    if !bound.joined.is_empty() {
        explain(Shape::Dot, DOUBTFUL, "parts that touch here still move together");
    }
    picture::draw(&sheet)
}

/// Front, left side, back and right side, as far as they are known.
fn views(up: Option<DVec3>, forward: Option<DVec3>) -> Vec<View> {
    let up = up.unwrap_or(DVec3::Y);
    let usual = if up.y.abs() > 0.7 { DVec3::Z } else { -DVec3::Y };
    let forward = forward.unwrap_or(usual);
    let forward = (forward - up * forward.dot(up)).try_normalize().unwrap_or_else(|| up.any_orthonormal_vector());
    let left = up.cross(forward);
    [("front", forward), ("left side", left), ("back", -forward), ("right side", -left)]
        .map(|(title, toward)| View { title: title.to_owned(), toward, up })
        .into()
}

fn side(segment: Option<Segment>) -> [u8; 3] {
    match segment.map(Segment::name) {
        Some(name) if name.starts_with("left") => LEFT,
        Some(name) if name.starts_with("right") => RIGHT,
        _ => MIDDLE,
    }
}

/// The joint at which a segment begins.
fn joint(segment: Segment) -> Option<&'static str> {
    use Segment::*;
    Some(match segment {
        Pelvis | Trunk => return None,
        Head => "head",
        LeftUpperArm | RightUpperArm => "shoulder",
        LeftForearm | RightForearm => "elbow",
        LeftHand | RightHand => "wrist",
        LeftThigh | RightThigh => "hip",
        LeftShank | RightShank => "knee",
        LeftFoot | RightFoot => "ankle",
    })
}

/// The bones of the scan, and its joints, which are named where they are on one side only once.
fn skeleton(binding: &Binding, named: bool, sheet: &mut Sheet<'_>) {
    for place in &binding.segments {
        sheet.strokes.push(Stroke { from: place.from, to: place.to, color: BONE, width: 2.0, opacity: 0.55 });
        if let Some(name) = joint(place.segment) {
            let name = if !named || side(Some(place.segment)) == RIGHT { String::new() } else { name.to_owned() };
            sheet.marks.push(Mark { at: place.from, name, color: BONE, shape: Shape::Square, through: true });
        }
    }
}

/// Joints with names at most; of more, those nearest to the root have one.
const NAMED: usize = 40;

/// Names of the joints of a skeleton, each with its distance from the root.
fn depths(capture: &Capture) -> Vec<(&str, usize)> {
    let Motion::Skeleton(take) = &capture.motion else { return Vec::new() };
    let mut depths: Vec<(&str, usize)> = Vec::with_capacity(take.joints.len());
    for joint in &take.joints {
        depths.push((&joint.name, joint.parent.map_or(0, |parent| depths[parent].1 + 1)));
    }
    depths
}

/// The points that move with joints: one of each joint a ring with its name, the others dots without.
fn joints(handles: &[BoundMarker], depths: &[(&str, usize)]) -> Vec<Mark> {
    let mut first: Vec<(&str, usize)> = Vec::new();
    let mut seen = std::collections::HashSet::new();
    for (h, handle) in handles.iter().enumerate() {
        if seen.insert(handle.known_as()) {
            first.push((handle.known_as(), h));
        }
    }
    let depths: std::collections::HashMap<&str, usize> = depths.iter().copied().collect();
    first.sort_by_key(|(name, _)| depths.get(name).copied().unwrap_or(0));
    let common = common_prefix(first.iter().map(|(name, _)| *name));
    let mut marks: Vec<Mark> = handles
        .iter()
        .map(|h| Mark { at: h.attachment, name: String::new(), color: side(h.segment), shape: Shape::Dot, through: false })
        .collect();
    for (rank, (name, h)) in first.into_iter().enumerate() {
        let name = if rank < NAMED { name[common..].to_owned() } else { String::new() };
        marks[h] = Mark { name, shape: Shape::Ring, through: true, ..marks[h].clone() };
    }
    marks
}

/// Attachments with their names, and the markers where they are in the reference frame. Whether there are any of these.
fn markers(bound: &Bound<'_>, sheet: &mut Sheet<'_>) -> bool {
    let take = bound.reference.motion.points();
    let frame = usize::try_from(bound.binding.decisions.reference_frame - bound.reference.first_frame);
    let mut any = false;
    let mut dots = Vec::new();
    let common = common_prefix(bound.binding.handles.iter().map(|h| h.label.as_str()));
    for handle in &bound.binding.handles {
        let color = side(handle.segment);
        let marker = take.labels.iter().position(|label| *label == handle.label);
        let there = frame.ok().filter(|f| *f < take.frames()).zip(marker).and_then(|(f, m)| take.point(f, m));
        let there = there.map(|p| bound.binding.placement.apply(p)).filter(|p| p.distance(handle.attachment) < FARTHEST);
        if let Some(there) = there {
            sheet.strokes.push(Stroke { from: handle.attachment, to: there, color, width: 1.0, opacity: 0.5 });
            sheet.marks.push(Mark { at: there, name: String::new(), color, shape: Shape::Ring, through: false });
            any = true;
        }
        dots.push(Mark {
            at: handle.attachment,
            name: handle.label[common..].to_owned(),
            color,
            shape: Shape::Dot,
            through: false,
        });
    }
    sheet.marks.extend(dots);
    any
}

/// Length of what all labels begin with, up to the last `_` or `:`; 0 where there is only one.
fn common_prefix<'a>(mut labels: impl Iterator<Item = &'a str>) -> usize {
    let Some(first) = labels.next() else { return 0 };
    let mut common = None;
    for label in labels {
        let same = first.bytes().zip(label.bytes()).take_while(|(a, b)| a == b).count();
        common = Some(common.unwrap_or(usize::MAX).min(same));
    }
    first.as_bytes()[..common.unwrap_or(0)].iter().rposition(|b| matches!(b, b'_' | b':')).map_or(0, |at| at + 1)
}

fn colors(points: &[DVec3], joined: &[DVec3]) -> Vec<[u8; 3]> {
    if joined.is_empty() {
        return Vec::new();
    }
    let (tree, mut found) = (PointTree::new(joined), Vec::new());
    let [near, gone] = DOUBTFUL_REACH;
    let color = |p: &DVec3| {
        tree.nearest(*p, 1, &mut found);
        let distance = found.first().map_or(f64::INFINITY, |n| n.distance);
        let share = ((gone - distance) / (gone - near)).clamp(0.0, 1.0);
        [0, 1, 2].map(|c| (f64::from(CLAY[c]) + (f64::from(DOUBTFUL[c]) - f64::from(CLAY[c])) * share).round() as u8)
    };
    points.iter().map(color).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_all_labels_begin_with_is_left_out() {
        assert_eq!(common_prefix(["Skeleton_Head1", "Skeleton_Hip", "Skeleton_Head2"].into_iter()), 9);
        assert_eq!(common_prefix(["walk:LASI", "walk:LASIS"].into_iter()), 5);
        assert_eq!(common_prefix(["LFWT", "LFHD"].into_iter()), 0);
        assert_eq!(common_prefix(["A_B"].into_iter()), 0);
        assert_eq!(common_prefix(["Ä_x", "Ä_y"].into_iter()), 3);
    }

    #[test]
    fn joints_are_named_once_and_their_points_not() {
        let labels = ["rig:Hips", "rig:Hips \u{203a} x", "rig:Arm \u{203a} middle", "rig:Arm \u{203a} side"];
        let handle = |(marker, label): (usize, &str)| BoundMarker {
            label: label.to_owned(),
            marker,
            attachment: DVec3::X * marker as f64,
            segment: None,
            beta: 1.0,
        };
        let handles: Vec<BoundMarker> = labels.into_iter().enumerate().map(handle).collect();
        let marks = joints(&handles, &[("rig:Hips", 0), ("rig:Arm", 1)]);
        let told: Vec<(&str, Shape, f64)> = marks.iter().map(|m| (m.name.as_str(), m.shape, m.at.x)).collect();
        use Shape::{Dot, Ring};
        assert_eq!(told, [("Hips", Ring, 0.0), ("", Dot, 1.0), ("Arm", Ring, 2.0), ("", Dot, 3.0)]);
        // Of very many joints those far from the root have no names.
        let many: Vec<String> = (0..NAMED + 5).map(|k| format!("J{k}")).collect();
        let handles: Vec<BoundMarker> = many.iter().map(String::as_str).enumerate().map(handle).collect();
        let deep: Vec<(&str, usize)> = many.iter().map(String::as_str).zip((0..many.len()).rev()).collect();
        let marks = joints(&handles, &deep);
        assert!(marks[..5].iter().all(|m| m.name.is_empty()) && marks[5..].iter().all(|m| !m.name.is_empty()));
    }

    #[test]
    fn landmarks_have_words() {
        assert_eq!(joint_words(Joint::LeftHandTip), "left hand tip");
        let ends: std::collections::HashSet<Joint> = BONES.into_iter().flat_map(|(a, b)| [a, b]).collect();
        assert_eq!(ends.len(), Joint::COUNT, "each landmark is at the end of a line");
    }

    #[test]
    fn the_skin_is_coloured_at_doubtful_places_only() {
        let points = [DVec3::ZERO, DVec3::X * 0.014, DVec3::X * 0.1];
        let [at, near, far] = colors(&points, &[DVec3::Y * 0.001])[..] else { panic!("a colour for each point") };
        assert_eq!((at, far), (DOUBTFUL, CLAY));
        assert!(near[2] > DOUBTFUL[2] && near[2] < CLAY[2]);
        assert!(colors(&points, &[]).is_empty());
    }
}
