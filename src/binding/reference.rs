//! The frame of a take in which the actor stands most like the scan.

use super::segments::Skeleton;
use super::similarity::{Held, Upright, upright};
use super::track::Track;
use super::{Options, Reference};
use crate::capture::Capture;
use crate::error::{Error, Kind, Result};
use glam::DVec3;

/// A marker with its landmark on the scan.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Landed {
    pub marker: usize,
    /// On the skin at rest, in the unit box.
    pub place: DVec3,
    pub weight: f64,
}

/// A frame and the upright placement of its markers on the landmarks of the scan.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Chosen {
    /// Counted from 0.
    pub frame: usize,
    pub upright: Upright,
    /// Root mean square of the placement in statures.
    pub rms: f64,
}

/// Frames looked at.
const SAMPLES: usize = 300;
/// Share of the best marker count that a reference frame shows.
const COMPLETE: f64 = 0.92;

/// The frame that the user names; or frames with most markers, the nearest to the scan's pose first. At least one.
pub(crate) fn candidates(
    capture: &Capture,
    track: &Track<'_>,
    capture_up: DVec3,
    body: &Skeleton,
    landed: &[Landed],
    held: Held,
    options: &Options,
) -> Result<Vec<Chosen>> {
    if let Reference::Frame(number) = options.reference {
        let frame = frame_index(capture, track, number)?;
        return placed(track, frame, capture_up, body, landed, held).map(|chosen| vec![chosen]).ok_or_else(|| {
            Error::refused("fewer than three named markers are there in the reference frame")
                .file(&capture.source)
                .at(format!("frame {number}"))
                .hint("another --ref, or --ref auto")
        });
    }
    let mut frames = track.sample(SAMPLES);
    let count = |&f: &usize| landed.iter().filter(|l| track.point(f, l.marker).is_some()).count();
    let most = frames.iter().map(count).max().unwrap_or(0);
    frames.retain(|f| count(f) as f64 >= COMPLETE * most as f64);
    let mut all: Vec<Chosen> = frames.into_iter().filter_map(|f| placed(track, f, capture_up, body, landed, held)).collect();
    all.sort_by(|a, b| a.rms.total_cmp(&b.rms));
    if all.is_empty() {
        return Err(
            Error::new(Kind::Refused, "no frame shows three named markers that spread over the body").file(&capture.source)
        );
    }
    Ok(all)
}

/// Index of a frame given in the capture's own numbering.
pub(crate) fn frame_index(capture: &Capture, track: &Track<'_>, number: i64) -> Result<usize> {
    let frames = track.take.frames();
    usize::try_from(number - capture.first_frame).ok().filter(|&i| i < frames).ok_or_else(|| {
        Error::new(Kind::Usage, format!("the reference frame {number} is not in the take"))
            .file(&capture.source)
            .expected(format!("{} to {}", capture.first_frame, capture.first_frame + frames as i64 - 1))
    })
}

fn placed(track: &Track<'_>, frame: usize, capture_up: DVec3, body: &Skeleton, landed: &[Landed], held: Held) -> Option<Chosen> {
    let pairs: Vec<_> = landed.iter().filter_map(|l| Some((track.point(frame, l.marker)?, l.place, l.weight))).collect();
    let upright = upright(&pairs, capture_up, body.up, held)?;
    Some(Chosen { frame, upright, rms: upright.rms / body.stature })
}
