//! What must hold before and after a capture is bound: enough labels, the same actor, distances along bones.

use super::labels::{Names, Part, Place};
use super::landmarks::{Arms, Body, NotHuman};
use super::segments::Segment;
use super::take::Take;
use super::{BoundMarker, Options, refuse};
use crate::error::{Error, Kind, Notes, Result};
use crate::statistics::quantile;
use glam::DVec3;

/// Named markers below which no body can be recognised.
const FEWEST_NAMED: usize = 10;

/// How far feet have to stick out to the front, against the back, to tell where a scan faces (people: 4 to 21).
const WEAK_FACING: f64 = 2.0;

/// The refusal of a scan that is no person.
pub(super) fn no_body(reason: &NotHuman) -> Error {
    let expected = match reason.margin_and_cost {
        Some((margin, cost)) => format!(
            "an upright person, best with arms and legs apart: margin 0.15 or more (it is {margin:.2}), cost up to 0.45 (it is {cost:.2})"
        ),
        None => "an upright person, best with arms and legs apart".to_owned(),
    };
    Error::refused(format!("no human body is recognised in the scan: {}", reason.reason)).expected(expected).hint(
        "a scan in T or A pose; places on the scan of three or more markers in [markers] of a rig file, which place the others; \
             or --align none if the scan lies where the capture's markers are",
    )
}

/// A scan that is clearly a person, facing clearly.
pub(super) fn body(body: &Body, options: &Options, notes: &mut Notes) -> Result<()> {
    if body.margin < 0.15 || body.cost > 0.45 {
        let error = Error::refused(format!(
            "the scan is hardly a person as far as its shape tells (margin {:.2}, cost {:.2})",
            body.margin, body.cost
        ))
        .expected("margin 0.15 or more, cost up to 0.45")
        .hint("--align none when the scan is where the capture's markers are");
        refuse(error, options, notes)?;
    } else if body.margin < 0.25 {
        notes.warn(format!("head, hands and feet of the scan are told apart by a small margin ({:.2})", body.margin));
    }
    let hanging = body.arms == Arms::Hanging;
    if hanging {
        notes
            .warn("the arms touch the body: their joints are seen from the sides only (to about 4 % of height, finger tips 6 %)");
    }
    if hanging && body.facing_ratio < WEAK_FACING && !options.flip {
        let error = Error::new(
            Kind::Ambiguous,
            format!("arms along the trunk and feet that stick out by {:.1} to the front against the back do not tell where the scan faces", body.facing_ratio),
        )
        .expected(format!("{WEAK_FACING} or more"))
        .hint("--flip turns it");
        refuse(error, options, notes)?;
    } else if body.facing_ratio < WEAK_FACING && !options.flip {
        notes.warn(format!(
            "facing of the scan from its feet is weak ({:.1}): check the result, --flip turns it",
            body.facing_ratio
        ));
    }
    Ok(())
}

/// Whether enough labels are known, and enough of them on the trunk.
pub(super) fn are_told(take: &Take<'_>) -> bool {
    take.names.count() >= FEWEST_NAMED && on_core(take) >= 4
}

fn on_core(take: &Take<'_>) -> usize {
    take.names.iter().filter(|(_, p)| matches!(p.segment(), Segment::Pelvis | Segment::Trunk)).count()
}

/// The refusal of a take whose labels say too little; `why` their places do not help.
pub(super) fn few_labels(take: &Take<'_>, why: &str) -> Error {
    let unknown: Vec<&str> =
        (0..take.track.take.markers()).filter(|&i| take.names.places[i].is_none()).take(6).map(|i| take.label(i)).collect();
    let unknown = if unknown.is_empty() { String::new() } else { format!(" (unknown: {})", unknown.join(", ")) };
    Error::refused(format!(
        "{} of {} labels name a place on the body, {} of them on trunk and pelvis{unknown}; {why}",
        take.names.count(),
        take.track.take.markers(),
        on_core(take),
    ))
    .file(&take.capture.source)
    .expected(format!("{FEWEST_NAMED} known labels, 4 of them on trunk and pelvis"))
}

/// The same for a reference capture, whose markers must have names.
pub(super) fn labels(take: &Take<'_>) -> Result<()> {
    if are_told(take) {
        return Ok(());
    }
    Err(few_labels(take, "a static trial has to have them").hint("a static trial of the same marker set, or none"))
}

/// Distances inside segments must agree between take and reference capture.
pub(super) fn same_actor(take: &Take<'_>, still: &Take<'_>) -> Result<()> {
    let typical = |t: &Take<'_>, i: usize, j: usize| {
        let mut lengths: Vec<f64> =
            t.track.sample(30).into_iter().filter_map(|f| Some((t.track.point(f, i)? - t.track.point(f, j)?).length())).collect();
        quantile(&mut lengths, 0.5)
    };
    let mut ratios = Vec::new();
    for (i, a) in take.names.iter() {
        for (j, _) in take.names.iter().filter(|&(j, b)| j > i && b.segment() == a.segment()) {
            if let (Some(k), Some(l)) = (take.twin(i, still), take.twin(j, still))
                && let (Some(here), Some(there)) = (typical(take, i, j), typical(still, k, l))
                && here > 0.0
            {
                ratios.push(there / here);
            }
        }
    }
    match quantile(&mut ratios, 0.5) {
        Some(ratio) if (0.93..=1.07).contains(&ratio) => Ok(()),
        Some(ratio) => Err(Error::refused(format!("the reference capture is {ratio:.3} times the size of the take"))
            .file(&still.capture.source)
            .expected("the same actor in the same unit (0.93 to 1.07)")
            .hint("another --ref-file, or none")),
        None => Err(Error::refused("the reference capture shares no two labels of one segment with the take")
            .file(&still.capture.source)
            .hint("a --ref-file of the same marker set")),
    }
}

/// Median and 95th percentile of the relative difference between distances of targets and of attachments, over pairs that a body keeps
/// apart by a bone: on one segment but for the shoulders on the trunk, or at the two ends of a limb's segment. `target`: of a handle in a frame, in the unit box.
pub(super) fn strain(
    names: &Names,
    handles: &[BoundMarker],
    target: impl Fn(usize, usize) -> Option<DVec3>,
    frames: &[usize],
    stature: f64,
) -> Option<(f64, f64)> {
    let is_shoulder = |place: &Option<Place>| place.as_ref().is_some_and(|p| p.part == Part::Shoulder);
    let mut values = Vec::new();
    for (i, a) in handles.iter().enumerate() {
        for (j, b) in handles.iter().enumerate().skip(i + 1) {
            let (Some(s), Some(t)) = (a.segment, b.segment) else { continue };
            let rest = (a.attachment - b.attachment).length();
            let (p, q) = (&names.places[a.marker], &names.places[b.marker]);
            let ends = match (p, q) {
                (Some(p), Some(q)) => p.is_bone_with(q) || q.is_bone_with(p),
                _ => false,
            };
            // Between shoulder and trunk the collar bone moves.
            let girdle = s == t && is_shoulder(p) != is_shoulder(q);
            if s != t && !ends || girdle || rest < 0.05 * stature {
                continue;
            }
            for &f in frames {
                if let (Some(p), Some(q)) = (target(f, i), target(f, j)) {
                    values.push(((p - q).length() / rest - 1.0).abs());
                }
            }
        }
    }
    let p95 = quantile(&mut values, 0.95)?;
    Some((quantile(&mut values, 0.5)?, p95))
}
