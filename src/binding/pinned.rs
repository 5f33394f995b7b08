//! Captures on animals and things: no body says where their markers belong, so the places that the user gives for some of them place all.

use super::raw;
use super::reference;
use super::rig::Frozen;
use super::similarity::{Similarity, rigid};
use super::take::Take;
use super::{Align, Binding, Options, Reference, ScanShape, refuse};
use crate::capture::Motion;
use crate::error::{Error, Notes, Result};
use glam::DVec3;

/// Places that determine a similarity.
const FEWEST: usize = 3;
/// How far one of them must be from the line through the two farthest apart, as a share of their distance.
const OFF_LINE: f64 = 0.05;
/// Root mean square distance of the placed markers from their places, in diagonals of the scan: fine up to the first, refused beyond the
/// second.
const MISSES: (f64, f64) = (0.04, 0.10);
/// Share of the most places seen at once from which a frame is looked at: one marker hidden in the scan's pose is no reason to take another pose.
const SEEN: f64 = 0.75;
/// Coordinates that a similarity fits whatever they are.
const FREEDOM: f64 = 7.0;
/// Frames looked at.
const SAMPLES: usize = 300;

/// The similarity of a frame, and by how much it misses the places.
struct Placed {
    placement: Similarity,
    frame: usize,
    rms: f64,
    /// The same per coordinate that the similarity leaves free, so that few markers do not fit better than many for being few.
    error: f64,
    /// Farthest marker, with its distance.
    worst: (String, f64),
}

/// Binds a capture by the places of the rig file: one scale, turn and shift for the take, from the frame that comes nearest to them.
/// `None` where the user gives none for this capture.
pub(super) fn bind(scan: &ScanShape<'_>, take: &Take<'_>, options: &Options) -> Option<Result<Binding>> {
    let labels = &take.track.take.labels;
    let pins: Vec<(usize, DVec3)> =
        labels.iter().enumerate().filter_map(|(i, label)| Some((i, options.pinned(label)?))).collect();
    (!pins.is_empty()).then(|| by_places(scan, take, &pins, options))
}

fn by_places(scan: &ScanShape<'_>, take: &Take<'_>, pins: &[(usize, DVec3)], options: &Options) -> Result<Binding> {
    let file = &take.capture.source;
    let frames = match options.reference {
        Reference::Auto => take.track.sample(SAMPLES),
        Reference::Frame(number) => vec![reference::frame_index(take.capture, &take.track, number)?],
    };
    let seen = |frame: usize| pins.iter().filter(|p| take.track.point(frame, p.0).is_some()).count();
    let most = frames.iter().map(|&f| seen(f)).max().unwrap_or(0);
    let enough = frames.into_iter().filter(|&f| seen(f) as f64 >= SEEN * most as f64);
    let placed = enough.filter_map(|frame| placed(take, pins, frame, options.scale.map(|s| s / scan.unit_box.diagonal)));
    let placed = placed.min_by(|a, b| a.error.total_cmp(&b.error)).ok_or_else(|| {
        Error::refused(format!(
            "[markers] of the rig file gives {most} places of markers that are there at once, or they lie on a line"
        ))
        .file(file)
        .expected(format!("places of {FEWEST} or more markers, far apart and not on a line: no human body places the others"))
    })?;
    let mut notes = Notes::default();
    let words = format!(
        "the markers do not fit their places of the rig file: {:.1} % of the scan's diagonal off, {} {:.1} %",
        100.0 * placed.rms,
        placed.worst.0,
        100.0 * placed.worst.1
    );
    if placed.rms > MISSES.1 {
        let error = Error::refused(words)
            .file(file)
            .expected("up to 10 %")
            .hint("other places, or --ref N with a frame in the scan's pose");
        refuse(error, options, &mut notes)?;
    } else if placed.rms > MISSES.0 {
        notes.warn(words);
    }
    let mut binding = raw::bind_placed(scan, None, take, (placed.placement, placed.frame), options)?;
    binding.decisions.align = Align::Similarity;
    binding.decisions.scale = placed.placement.scale * scan.unit_box.diagonal;
    notes.iter().for_each(|text| binding.notes.warn(text));
    if matches!(take.capture.motion, Motion::Markers(_)) {
        binding.frozen = Some(Frozen::of(&binding, take, None, placed.frame, None, options));
    }
    Ok(binding)
}

/// Least-squares similarity from the markers of a frame to their places. `None` where they do not determine it.
fn placed(take: &Take<'_>, pins: &[(usize, DVec3)], frame: usize, scale: Option<f64>) -> Option<Placed> {
    let there: Vec<(usize, DVec3, DVec3)> =
        pins.iter().filter_map(|&(marker, place)| Some((marker, take.track.point(frame, marker)?, place))).collect();
    let pairs: Vec<(DVec3, DVec3)> = there.iter().map(|&(_, a, b)| (a, b)).collect();
    let (from, to): (Vec<DVec3>, Vec<DVec3>) = pairs.iter().copied().unzip();
    if pairs.len() < FEWEST || !spread(&from) || !spread(&to) {
        return None;
    }
    let (rotation, _) = rigid(&pairs)?;
    let count = pairs.len() as f64;
    let (a, b) = (from.iter().sum::<DVec3>() / count, to.iter().sum::<DVec3>() / count);
    let along: f64 = pairs.iter().map(|&(x, y)| (rotation * (x - a)).dot(y - b)).sum();
    let size: f64 = from.iter().map(|&x| (x - a).length_squared()).sum();
    let scale = scale.unwrap_or(along / size);
    let placement = Similarity { mirror: false, scale, rotation, translation: b - rotation * a * scale };
    let misses = || there.iter().map(|&(marker, x, y)| (marker, placement.apply(x).distance(y)));
    let worst = misses().max_by(|a, b| a.1.total_cmp(&b.1))?;
    let rms = (misses().map(|m| m.1 * m.1).sum::<f64>() / count).sqrt();
    let placement = Similarity { mirror: take.track.mirror, ..placement };
    let error = rms * (3.0 * count / (3.0 * count - FREEDOM)).sqrt();
    (scale > 0.0 && rms.is_finite()).then(|| Placed {
        placement,
        frame,
        rms,
        error,
        worst: (take.label(worst.0).to_owned(), worst.1),
    })
}

/// Whether points do not lie on a line.
fn spread(points: &[DVec3]) -> bool {
    let pairs = points.iter().enumerate().flat_map(|(i, &a)| points[i + 1..].iter().map(move |&b| (a, b)));
    let Some((a, b)) = pairs.max_by(|x, y| x.0.distance_squared(x.1).total_cmp(&y.0.distance_squared(y.1))) else { return false };
    let line = b - a;
    points.iter().any(|&p| (p - a).cross(line).length() > OFF_LINE * line.length_squared())
}
