//! What a marker take says of its own space: up, unit, facing, sides.

use super::labels::{self, Names, Part, Place};
use super::segments::Side;
use super::track::Track;
use super::{Options, refuse};
use crate::capture::Capture;
use crate::error::{Error, Notes, Result};
use crate::space::{Axis, Evidence, Known, Space, Unit};
use crate::statistics::quantile;
use glam::DVec3;

/// The captured person as the markers show it.
#[derive(Clone, Debug)]
pub(crate) struct Actor {
    pub up: Known<Axis>,
    pub unit: Option<Known<Unit>>,
    /// Height in the capture's unit.
    pub stature: Option<f64>,
    /// Cosine between the named left and the left that follows from up and facing: 1 right, −1 mirrored or swapped.
    pub sides: Option<f64>,
    /// Share of facing votes that agree with their mean.
    pub facing_agreement: f64,
}

/// What the markers of a capture say of their space, and by what.
#[derive(Clone, Debug)]
pub struct ActorSpace {
    /// Unit and up axis.
    pub space: Space,
    /// Height of the person in the capture's unit, where the markers show one.
    pub stature: Option<f64>,
    /// What was doubtful.
    pub notes: Notes,
}

/// Reads unit and up axis of a capture off its file and its markers, as the binding does.
pub fn actor_space(capture: &Capture) -> ActorSpace {
    let options = Options { accept_doubtful: true, ..Options::default() };
    let take = capture.motion.points();
    let track = Track { take, mirror: false };
    let names = labels::name(&take.labels, &track.coverage(), false);
    let mut notes = Notes::default();
    let mut space = capture.space.clone();
    let actor = if names.iter().next().is_some() { read(&track, &names, &space, &options, &mut notes).ok() } else { None };
    if let Some(actor) = &actor {
        (space.up, space.unit) = (Some(actor.up), actor.unit.or(space.unit));
    }
    ActorSpace { space, stature: actor.and_then(|a| a.stature), notes }
}

/// Shares of stature by landmark, surest first.
const HEIGHTS: [(&str, f64); 12] = [
    ("head_top", 1.0),
    ("head_front_side", 0.95),
    ("head_back_side", 0.95),
    ("head_front", 0.95),
    ("c7", 0.85),
    ("clav", 0.82),
    ("acromion", 0.82),
    ("strn", 0.72),
    ("asis", 0.56),
    ("psis", 0.56),
    ("sacrum", 0.55),
    ("trochanter", 0.52),
];
/// Share of stature of a head marker of unknown place.
const HEAD: f64 = 0.95;
/// Statures of people, in metres.
const PEOPLE: std::ops::RangeInclusive<f64> = 0.9..=2.4;
/// Frames looked at.
const SAMPLES: usize = 300;

/// Reads the actor off the motion. Errors are refusals that name the option which decides.
pub(crate) fn read(track: &Track<'_>, names: &Names, space: &Space, options: &Options, notes: &mut Notes) -> Result<Actor> {
    let frames = track.sample(SAMPLES);
    let up = find_up(track, names, &frames, space, options, notes)?;
    let vector = up.value.vector();
    let stature = find_stature(track, names, &frames, vector);
    let unit = find_unit(stature, space, options, notes);
    let mut actor = Actor { up, unit, stature, sides: None, facing_agreement: 0.0 };
    (actor.sides, actor.facing_agreement) = find_sides(track, names, &frames, vector);
    Ok(actor)
}

fn find_up(
    track: &Track<'_>,
    names: &Names,
    frames: &[usize],
    space: &Space,
    options: &Options,
    notes: &mut Notes,
) -> Result<Known<Axis>> {
    let high = |p: &Place| matches!(p.part, Part::Head | Part::Trunk | Part::Shoulder | Part::Pelvis);
    let low = |p: &Place| matches!(p.part, Part::Shank | Part::Foot);
    let mut sum = DVec3::ZERO;
    let mut count = 0;
    for &frame in frames {
        let mean = |wanted: &dyn Fn(&Place) -> bool| {
            let points: Vec<DVec3> = names.iter().filter(|(_, p)| wanted(p)).filter_map(|(i, _)| track.point(frame, i)).collect();
            (!points.is_empty()).then(|| points.iter().sum::<DVec3>() / points.len() as f64)
        };
        if let (Some(top), Some(bottom)) = (mean(&high), mean(&low))
            && let Some(direction) = (top - bottom).try_normalize()
        {
            sum += direction;
            count += 1;
        }
    }
    let measured = (count > 0).then(|| {
        let mean = sum / f64::from(count);
        let axis = Axis::nearest(mean);
        (axis, mean.dot(axis.vector()))
    });
    if let Some(axis) = options.capture_up {
        return Ok(Known::new(axis, Evidence::User));
    }
    let Some((axis, confidence)) = measured else {
        return Ok(space.up.unwrap_or(Known::new(Axis { index: 2, negative: false }, Evidence::Default)));
    };
    check_up((axis, confidence), "trunk", "+Z", options, notes)?;
    let how = match space.up {
        Some(file) if file.value == axis => file.how,
        Some(file) => {
            notes.warn(format!("the capture file says {} is up, its markers say {axis}: the markers are believed", file.value));
            Evidence::Shape
        }
        None => Evidence::Shape,
    };
    Ok(Known::new(axis, how))
}

fn find_stature(track: &Track<'_>, names: &Names, frames: &[usize], up: DVec3) -> Option<f64> {
    // Without a marker near the floor there is nothing to measure the height from.
    if !names.iter().any(|(_, p)| matches!(p.part, Part::Shank | Part::Foot)) {
        return None;
    }
    let by_landmark = HEIGHTS.iter().find_map(|&(landmark, share)| {
        let markers: Vec<usize> = names.iter().filter(|(_, p)| p.landmark == landmark).map(|(i, _)| i).collect();
        (!markers.is_empty()).then_some((markers, share))
    });
    let (markers, share) = match by_landmark {
        Some(found) => found,
        None => {
            let head: Vec<usize> = names.iter().filter(|(_, p)| p.part == Part::Head).map(|(i, _)| i).collect();
            (!head.is_empty()).then_some((head, HEAD))?
        }
    };
    let mut heights: Vec<f64> = frames
        .iter()
        .filter_map(|&f| {
            let tops: Vec<f64> = markers.iter().filter_map(|&i| track.point(f, i)).map(|p| p.dot(up)).collect();
            let low = names.iter().filter_map(|(i, _)| track.point(f, i)).map(|p| p.dot(up)).reduce(f64::min)?;
            (!tops.is_empty()).then(|| tops.iter().sum::<f64>() / tops.len() as f64 - low)
        })
        .collect();
    let stature = quantile(&mut heights, 0.9)? / share;
    (stature > 0.0).then_some(stature)
}

fn find_unit(stature: Option<f64>, space: &Space, options: &Options, notes: &mut Notes) -> Option<Known<Unit>> {
    if let Some(unit) = options.capture_unit {
        return Some(Known::new(unit, Evidence::User));
    }
    let Some(stature) = stature else { return space.unit };
    match unit_of_stature(stature, space.unit) {
        Some(known) => {
            if let Some(file) = space.unit
                && file.value != known.value
            {
                notes.warn(format!(
                    "the capture file says {}, but then the actor would be {:.3} m tall: {} is believed (--capture-unit sets it)",
                    file.value,
                    stature * file.value.metres(),
                    known.value
                ));
            }
            Some(known)
        }
        None => space.unit,
    }
}

/// The unit in which a height is a person's; the file's own unit where it fits.
pub(crate) fn unit_of_stature(stature: f64, file: Option<Known<Unit>>) -> Option<Known<Unit>> {
    let fits = |unit: Unit| PEOPLE.contains(&(stature * unit.metres()));
    if let Some(known) = file
        && fits(known.value)
    {
        return Some(known);
    }
    // Captures in inches say so, if there are any: a guess is a power of ten.
    [Unit::Millimetre, Unit::Centimetre, Unit::Decimetre, Unit::Metre]
        .into_iter()
        .find(|&unit| fits(unit))
        .map(|unit| Known::new(unit, Evidence::Size))
}

/// Front and left coordinates of a place on the body, comparable within one part; limbs have no front.
fn chart(place: &Place) -> (Option<f64>, f64) {
    let ray = place.ray.normalize_or_zero();
    let sign = if place.side == Side::Right { -1.0 } else { 1.0 };
    match place.part {
        Part::Pelvis | Part::Trunk | Part::Head => (Some(ray.y), sign * ray.x),
        Part::Foot => (Some(2.0 * place.t), sign),
        _ => (None, sign),
    }
}

fn same_piece(a: &Place, b: &Place) -> bool {
    a.part == b.part && (a.part != Part::Foot || a.side == b.side)
}

/// Directions across `up` from markers at the back to markers at the front of one piece of the body.
fn front_votes(track: &Track<'_>, names: &Names, frame: usize, up: DVec3) -> Vec<DVec3> {
    let mut votes = Vec::new();
    for (i, a) in names.iter() {
        for (j, b) in names.iter() {
            if let ((Some(fa), _), (Some(fb), _)) = (chart(a), chart(b))
                && same_piece(a, b)
                && fa - fb >= 0.95
            {
                votes.extend(level(track, frame, i, j, up));
            }
        }
    }
    votes
}

fn left_votes(track: &Track<'_>, names: &Names, frame: usize, up: DVec3) -> Vec<DVec3> {
    let mut votes = Vec::new();
    for (i, a) in names.iter() {
        for (j, b) in names.iter() {
            let mates = a.part == b.part && chart(a).1 - chart(b).1 >= 0.95;
            let comparable = a.landmark == b.landmark || matches!(a.part, Part::Pelvis | Part::Trunk | Part::Head);
            if mates && comparable {
                votes.extend(level(track, frame, i, j, up));
            }
        }
    }
    votes
}

/// Unit vector from marker `j` to marker `i` across `up`.
fn level(track: &Track<'_>, frame: usize, i: usize, j: usize, up: DVec3) -> Option<DVec3> {
    let d = track.point(frame, i)? - track.point(frame, j)?;
    (d - up * d.dot(up)).try_normalize()
}

fn find_sides(track: &Track<'_>, names: &Names, frames: &[usize], up: DVec3) -> (Option<f64>, f64) {
    let (mut cosines, mut agreeing, mut votes_cast) = (Vec::new(), 0usize, 0usize);
    for &frame in frames {
        let votes = front_votes(track, names, frame, up);
        let Some(forward) = votes.iter().sum::<DVec3>().try_normalize() else { continue };
        votes_cast += votes.len();
        agreeing += votes.iter().filter(|v| v.dot(forward) > 0.3).count();
        if let Some(left) = left_votes(track, names, frame, up).iter().sum::<DVec3>().try_normalize() {
            cosines.push(up.cross(forward).dot(left));
        }
    }
    let mean = (!cosines.is_empty()).then(|| cosines.iter().sum::<f64>() / cosines.len() as f64);
    (mean, if votes_cast == 0 { 0.0 } else { agreeing as f64 / votes_cast as f64 })
}

/// Doubts an axis that is up by little more than others, or refuses it. `trunk`: what points up from the feet; `likely`: the axis that is most often up
/// in such files.
pub(super) fn check_up(
    (axis, confidence): (Axis, f64),
    trunk: &str,
    likely: &str,
    options: &Options,
    notes: &mut Notes,
) -> Result<()> {
    if confidence < 0.5 {
        let error = Error::refused(format!(
            "which way is up in the capture is unclear: feet and {trunk} agree on {axis} by {confidence:.2} only"
        ))
        .expected("0.5 or more (1 = upright throughout)")
        .hint(format!("--capture-up {likely} (or the axis that points up)"));
        refuse(error, options, notes)?;
    } else if confidence < 0.8 {
        notes.warn(format!(
            "the actor is not upright for much of the take ({axis} up by {confidence:.2}); --capture-up sets the axis"
        ));
    }
    Ok(())
}
