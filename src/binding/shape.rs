//! What is asked of the scan: its unit, whether a point lies off it, where its segments are.

use super::landmarks::Body;
use super::segments::{Segment, Skeleton};
use super::{Options, ScanShape, SegmentPlace, actor};
use crate::space::{Evidence, Known, Unit};
use glam::DVec3;

/// Attachments farther outside than this, in diagonals, are refused by name.
const OUTSIDE: f64 = 0.05;

/// The unit of a scan from the user, its file, or the size of the body in it.
pub(super) fn scan_unit(scan: &ScanShape<'_>, body: Option<&Body>, options: &Options) -> Option<Known<Unit>> {
    if let Some(unit) = options.scan_unit {
        return Some(Known::new(unit, Evidence::User));
    }
    match body {
        Some(body) => unit_of_body(body, scan.unit_box.diagonal, scan.space.unit),
        None => scan.space.unit,
    }
}

/// The unit in which a body has a person's height; the one that its file says where that fits. `diagonal`: of the scan, in its own unit.
pub fn unit_of_body(body: &Body, diagonal: f64, file: Option<Known<Unit>>) -> Option<Known<Unit>> {
    actor::unit_of_stature(body.stature * diagonal, file).or(file)
}

/// Scan units per unit of the capture; 1 where one of them is unknown.
pub(super) fn unit_factor(capture: Option<Known<Unit>>, scan: Option<Known<Unit>>) -> f64 {
    match (capture, scan) {
        (Some(a), Some(b)) => a.value.metres() / b.value.metres(),
        _ => 1.0,
    }
}

/// Distance outside the scan in diagonals where it is too much.
pub(super) fn outside(scan: &ScanShape<'_>, p: DVec3) -> Option<f64> {
    let closest = scan.tree.closest(p)?;
    (closest.distance > OUTSIDE && scan.tree.winding(p).abs() < 0.5).then_some(closest.distance)
}

/// The segments of a body at rest.
pub(super) fn segment_places(body: &Skeleton) -> Vec<SegmentPlace> {
    let place = |&segment: &Segment| {
        let bone = body.bone(segment);
        SegmentPlace { segment, from: bone.origin, to: bone.end }
    };
    Segment::ALL.iter().map(place).collect()
}
