//! Captures that are in the scan's space already.

use super::landmarks::Body;
use super::rig::Frozen;
use super::segments::Skeleton;
use super::shape::{outside, scan_unit, unit_factor};
use super::similarity::Similarity;
use super::take::Take;
use super::{Align, Binding, BoundMarker, Decisions, Options, Reference, ScanShape, SegmentPlace, Turning, places, reference};
use crate::capture::Motion;
use crate::error::{Error, Notes, Result};
use crate::space::{Evidence, Known, Unit};
use crate::statistics::quantile;
use glam::{DQuat, DVec3};

/// Median and 90th percentile of the distance from the skin, in diagonals, of markers that were put there.
const ON_SKIN: (f64, f64) = (0.012, 0.03);
/// Least extent of the markers, in diagonals of the scan: a small cluster lies near something anywhere.
const EXTENT: f64 = 0.5;
/// Mean distance of named markers from their landmarks, in statures, that still is the right way round.
const RIGHT_WAY: f64 = 0.06;
/// Frames looked at.
const SAMPLES: usize = 40;

/// A frame in which the capture lies on the scan as it is.
#[derive(Clone, Copy, Debug)]
pub(super) struct Found {
    frame: usize,
    /// Scan units per unit of the capture.
    factor: f64,
}

/// Whether the markers of some frame lie on the scan with nothing but the unit converted. With a body, named markers must also lie near
/// their landmarks: a person turned round would pass otherwise.
pub(super) fn lies_on(scan: &ScanShape<'_>, take: &Take<'_>, body: Option<&Skeleton>, options: &Options) -> Option<Found> {
    let scan_unit = options.scan_unit.or(scan.space.unit.map(|u| u.value));
    let capture_unit = options.capture_unit.or(take.capture.space.unit.map(|u| u.value));
    let factor = match (capture_unit, scan_unit) {
        (Some(a), Some(b)) => a.metres() / b.metres(),
        _ => 1.0,
    };
    let mut factors = vec![1.0];
    if let (Some(capture), None) = (capture_unit, scan_unit) {
        factors.extend([Unit::Metre, Unit::Centimetre, Unit::Millimetre].map(|u| capture.metres() / u.metres()));
    } else if factor != 1.0 {
        factors.push(factor);
    }
    let landed: Vec<(usize, DVec3)> =
        body.map_or(Vec::new(), |body| take.names.iter().map(|(i, p)| (i, places::on_skin(p, body, scan.tree))).collect());
    let mut best: Option<(f64, Found)> = None;
    for factor in factors {
        let placement = as_it_is(scan, factor, options);
        for frame in take.track.sample(SAMPLES) {
            let points: Vec<DVec3> = (0..take.track.take.markers())
                .filter_map(|i| take.track.take.point(frame, i))
                .map(|p| placement.apply(p))
                .collect();
            let lo = points.iter().copied().fold(DVec3::INFINITY, DVec3::min);
            let hi = points.iter().copied().fold(DVec3::NEG_INFINITY, DVec3::max);
            if points.len() < 4 || (hi - lo).length() < EXTENT || lo.min_element() < -0.6 || hi.max_element() > 0.6 {
                continue;
            }
            let mut distances: Vec<f64> = points.iter().filter_map(|&p| scan.tree.closest(p)).map(|c| c.distance).collect();
            let (Some(median), Some(p90)) = (quantile(&mut distances, 0.5), quantile(&mut distances, 0.9)) else { continue };
            if median > ON_SKIN.0 || p90 > ON_SKIN.1 {
                continue;
            }
            if let Some(body) = body {
                let errors: Vec<f64> = landed
                    .iter()
                    .filter_map(|&(i, p)| Some((placement.apply(take.track.take.point(frame, i)?) - p).length()))
                    .collect();
                if errors.is_empty() || errors.iter().sum::<f64>() / errors.len() as f64 > RIGHT_WAY * body.stature {
                    continue;
                }
            }
            if best.is_none_or(|(worst, _)| p90 < worst) {
                best = Some((p90, Found { frame, factor }));
            }
        }
    }
    best.map(|(_, found)| found)
}

/// `--align none`: only the unit is converted; the reference frame is the first, or the user's.
pub(super) fn bind_as_it_is(scan: &ScanShape<'_>, body: Option<&Body>, take: &Take<'_>, options: &Options) -> Result<Binding> {
    let unit = options.capture_unit.map(|u| Known::new(u, Evidence::User)).or(take.capture.space.unit);
    let factor = options.scale.unwrap_or(1.0) * unit_factor(unit, scan_unit(scan, body, options));
    let frame = match options.reference {
        Reference::Auto => 0,
        Reference::Frame(number) => reference::frame_index(take.capture, &take.track, number)?,
    };
    bind_found(scan, body, take, Found { frame, factor }, options)
}

/// Binds every marker where it lies in the found frame.
pub(super) fn bind_found(
    scan: &ScanShape<'_>,
    body: Option<&Body>,
    take: &Take<'_>,
    found: Found,
    options: &Options,
) -> Result<Binding> {
    let mut binding = bind_placed(scan, body, take, (as_it_is(scan, found.factor, options), found.frame), options)?;
    if options.align == Align::None {
        let ignored = [
            ("--yaw", options.yaw.is_some()),
            ("--flip", options.flip),
            ("--capture-up", options.capture_up.is_some()),
            ("--scan-up", options.scan_up.is_some()),
        ];
        let ignored: Vec<&str> = ignored.iter().filter(|i| i.1).map(|i| i.0).collect();
        if !ignored.is_empty() {
            binding.notes.warn(format!("{} not used with --align none", ignored.join(" and ")));
        }
    } else {
        let words = "the markers lie on the scan as they are: nothing was moved (--align similarity or pose fits them instead)";
        binding.notes.warn(words);
    }
    let d = &mut binding.decisions;
    d.scale = found.factor / unit_factor(d.capture_unit, d.scan_unit);
    if matches!(take.capture.motion, Motion::Markers(_)) {
        binding.frozen = Some(Frozen::of(&binding, take, body, found.frame, None, options));
    }
    Ok(binding)
}

/// Binds every marker where a placement brings it in a frame.
pub(super) fn bind_placed(
    scan: &ScanShape<'_>,
    body: Option<&Body>,
    take: &Take<'_>,
    (placement, frame): (Similarity, usize),
    options: &Options,
) -> Result<Binding> {
    let mut handles = Vec::new();
    let mut unbound = Vec::new();
    for (marker, label) in take.track.take.labels.iter().enumerate() {
        // A place that is given needs no frame.
        let point = take.track.take.point(frame, marker);
        let Some(attachment) = options.pinned(label).or(point.map(|p| placement.apply(p))) else {
            unbound.push((label.clone(), "not there in the reference frame".to_owned()));
            continue;
        };
        if options.is_ignored(label) {
            unbound.push((label.clone(), "left out by the rig file".to_owned()));
            continue;
        }
        match outside(scan, attachment) {
            Some(far) => {
                unbound.push((label.clone(), format!("{:.1} % of the diagonal outside the scan", 100.0 * far)));
            }
            None => {
                let segment = take.names.places[marker].as_ref().filter(|_| body.is_some()).map(|p| p.segment());
                handles.push(BoundMarker { label: label.clone(), marker, attachment, segment, beta: 1.0 });
            }
        }
    }
    let number = take.capture.first_frame + frame as i64;
    if handles.is_empty() {
        return Err(Error::refused("no marker is on the scan or within 5 % of its diagonal")
            .file(&take.capture.source)
            .at(format!("frame {number}"))
            .expected("a capture in the space of the scan")
            .hint("--capture-unit or --scan-unit, or --ref N with a frame in which they meet"));
    }
    let unit = options.capture_unit.map(|u| Known::new(u, Evidence::User)).or(take.capture.space.unit);
    let skeleton = body.map(Skeleton::of);
    let segments = skeleton.iter().flat_map(|s| {
        super::Segment::ALL.map(|segment| SegmentPlace { segment, from: s.bone(segment).origin, to: s.bone(segment).end })
    });
    let scan_unit = scan_unit(scan, body, options);
    let decisions = Decisions {
        align: Align::None,
        on_skin: false,
        noun: take.capture.motion.noun(),
        reference_rest: false,
        reference_frame: number,
        reference_range: take.range(),
        reference_capture: None,
        scale: placement.scale * scan.unit_box.diagonal,
        yaw: 0.0,
        scan_unit,
        scan_up: body.map(|b| Known::new(b.up, Evidence::Shape)),
        scan_forward: body.map(|b| Known::new(b.forward, Evidence::Shape)),
        scan_height: body.map(|b| b.stature * scan.unit_box.diagonal),
        capture_unit: unit,
        capture_up: take.capture.space.up,
        actor_height: None,
        set: take.names.set,
        named: take.names.count(),
        markers: take.track.take.markers(),
        bound: handles.len(),
        off_surface: off_surface(scan, &handles),
        residual: None,
        proportions: Vec::new(),
        strain: None,
        feet: None,
    };
    Ok(Binding {
        placement,
        segments: segments.collect(),
        handles,
        unbound,
        trajectories: None,
        turning: Turning::default(),
        decisions,
        frozen: None,
        notes: Notes::default(),
    })
}

fn as_it_is(scan: &ScanShape<'_>, factor: f64, options: &Options) -> Similarity {
    let scale = factor / scan.unit_box.diagonal;
    Similarity {
        mirror: options.mirror,
        scale,
        rotation: DQuat::IDENTITY,
        translation: -scan.unit_box.centre / scan.unit_box.diagonal,
    }
}

/// Median and largest distance of the attachments from the skin, in the scan's unit, and the marker of the largest.
pub(super) fn off_surface(scan: &ScanShape<'_>, handles: &[BoundMarker]) -> Option<(f64, f64, String)> {
    let mut far: Vec<(f64, &str)> = handles
        .iter()
        .filter_map(|h| Some((scan.tree.closest(h.attachment)?.distance * scan.unit_box.diagonal, h.label.as_str())))
        .collect();
    far.sort_by(|a, b| a.0.total_cmp(&b.0));
    let worst = far.last()?;
    Some((far[far.len() / 2].0, worst.0, worst.1.to_owned()))
}
