//! What the readers of skeletons have in common: the file that was read, unique names, the bound on memory, rest poses.

use super::table::FAR;
use super::{Capture, Cleaning, MarkerTake, Motion, Rest, SkeletonTake, source};
use crate::error::{Error, Kind, Notes, Result};
use crate::space::{Space, Unit};
use glam::{DMat3, DQuat, DVec3};
use std::path::Path;

/// Bytes of a take per byte of the file above which the file is refused, and bytes that are always allowed. A row of a real file has
/// two or more bytes for each of a joint's three numbers, and a joint takes 28 bytes per frame.
pub(super) const LARGEST_RATIO: usize = 64;
pub(super) const ALWAYS_ALLOWED: usize = 64 << 20;

/// A skeleton take as a file has it.
#[derive(Debug)]
pub(super) struct SkeletonFile {
    pub(super) take: SkeletonTake,
    /// Frames per second; positive.
    pub(super) rate: f64,
    /// Number of the first frame.
    pub(super) first_frame: i64,
    /// Unit and up axis, where the file says so.
    pub(super) space: Space,
    /// Name of the subject or the clip, where the file says so.
    pub(super) name: Option<String>,
    pub(super) notes: Notes,
}

impl SkeletonFile {
    /// Without a first frame that an exporter put before the motion as a pose at rest; the others keep their numbers.
    pub(super) fn without_rest_row(mut self) -> Self {
        let joints = self.take.joints.len();
        if self.take.rest == Rest::FirstFrame && self.take.origins.frames() > 1 {
            self.take.origins.points.drain(..joints);
            self.take.rotations.drain(..joints);
            self.first_frame += 1;
        }
        self
    }

    /// The capture that the file is.
    pub(super) fn capture(self, path: &Path) -> Capture {
        Capture {
            name: self.name.unwrap_or_else(|| source::stem(path)),
            rate: self.rate,
            first_frame: self.first_frame,
            space: self.space,
            motion: Motion::Skeleton(self.take),
            source: path.to_owned(),
            cleaning: Cleaning::default(),
            notes: self.notes,
        }
    }
}

/// Places and turns of all joints, filled frame by frame.
pub(super) struct Frames {
    joints: usize,
    /// Known with the first place.
    origin: Option<DVec3>,
    points: Vec<[f32; 3]>,
    rotations: Vec<[f32; 4]>,
}

impl Frames {
    /// Room for a take.
    ///
    /// # Errors
    /// A take that is out of all proportion to the `bytes` of its file: few numbers move very many joints.
    pub(super) fn new(joints: usize, frames: usize, bytes: usize) -> Result<Self> {
        let cells = cells(joints, "joints", frames, bytes)?;
        Ok(Self { joints, origin: None, points: Vec::with_capacity(cells), rotations: Vec::with_capacity(cells) })
    }

    /// Adds a joint of the frame that is being filled.
    pub(super) fn push(&mut self, place: DVec3, turn: DQuat) {
        if place.is_finite() && turn.is_finite() {
            let origin = *self.origin.get_or_insert_with(|| far(place));
            self.points.push((place - origin).to_array().map(|x| x as f32));
            self.rotations.push([turn.x, turn.y, turn.z, turn.w].map(|x| x as f32));
        } else {
            self.points.push([f32::NAN; 3]);
            self.rotations.push([f32::NAN; 4]);
        }
    }

    /// The take of these joints.
    pub(super) fn take(self, joints: Vec<super::Joint>, rest: super::Rest) -> SkeletonTake {
        debug_assert_eq!(joints.len(), self.joints);
        let labels = joints.iter().map(|j| j.name.clone()).collect();
        SkeletonTake {
            joints,
            rest,
            origins: MarkerTake { labels, points: self.points, origin: self.origin.unwrap_or_default() },
            rotations: self.rotations,
        }
    }
}

/// Where a take that begins at `place` counts from: zero along the axes where single precision is good enough.
fn far(place: DVec3) -> DVec3 {
    DVec3::from(place.to_array().map(|x| if x.abs() > FAR { x.round() } else { 0.0 }))
}

/// The product of frames and joints, or of frames and whatever else is computed in every frame.
///
/// # Errors
/// A take that is out of all proportion to the `bytes` of its file.
pub(super) fn cells(count: usize, noun: &str, frames: usize, bytes: usize) -> Result<usize> {
    let cells = count.checked_mul(frames);
    let needed = cells.and_then(|c| c.checked_mul(size_of::<[f32; 7]>())).unwrap_or(usize::MAX);
    if needed > ALWAYS_ALLOWED.saturating_add(bytes.saturating_mul(LARGEST_RATIO)) {
        return Err(Error::refused(format!("{frames} frames of {count} {noun} in {bytes} bytes"))
            .expected(format!("a file in which most {noun} move by numbers of their own")));
    }
    Ok(cells.unwrap_or_default())
}

/// The rate that a period in seconds means: its inverse, or the usual rate that the period is a rounding of. `decimals` are those
/// that the period is written with.
pub(super) fn rate(period: f64, decimals: usize) -> f64 {
    let raw = 1.0 / period;
    let whole = raw.round();
    let unit = 10f64.powi(-(decimals.min(22) as i32)) * 1.000_001;
    let near = |rate: f64| (1.0 / rate - period).abs();
    [whole, (2.0 * raw).round() / 2.0, 23.976, 29.97, 59.94, 119.88, (raw * 1.001).round() / 1.001]
        .into_iter()
        .filter(|&r| r > 0.0 && near(r) <= unit && (r / raw - 1.0).abs() < 2e-3)
        .fold(None, |best: Option<f64>, r| if best.is_none_or(|b| near(r) < near(b)) { Some(r) } else { best })
        .unwrap_or(raw)
}

/// The turn in a linear map with scale and shear: its first axis is kept, its second in its plane. A mirrored map gives the turn of its
/// opposite, so that what lies between two maps of a kind is right; no turn where a map is flat.
pub(super) fn turn(map: &DMat3) -> DQuat {
    let map = if map.determinant() < 0.0 { *map * -1.0 } else { *map };
    let x = map.x_axis.normalize_or_zero();
    let y = (map.y_axis - x * map.y_axis.dot(x)).normalize_or_zero();
    let z = x.cross(y);
    // Flat and broken maps have axes of length zero or none.
    if z.length_squared() > 0.5 {
        DQuat::from_mat3(&DMat3::from_cols(x, y, z)).normalize()
    } else if map.is_finite() {
        DQuat::IDENTITY
    } else {
        DQuat::NAN
    }
}

/// Diagonal of the box around the joints at rest; not positive where none has a place.
pub(super) fn span(take: &SkeletonTake) -> f64 {
    let box_of = |(low, high): (DVec3, DVec3), joint: &super::Joint| (low.min(joint.rest), high.max(joint.rest));
    let (low, high) = take.joints.iter().fold((DVec3::INFINITY, DVec3::NEG_INFINITY), box_of);
    low.distance(high)
}

/// The unit that a file says, if what moves spans a size then that a body or a thing can have: many files are in centimetres although
/// their format says metres.
pub(super) fn believed(unit: Unit, span: f64, noun: &str, notes: &mut Notes) -> Option<Unit> {
    const SIZES: std::ops::Range<f64> = 0.02..20.0;
    let size = span * unit.metres();
    if size > 0.0 && !SIZES.contains(&size) {
        notes.warn(format!("the file says {unit}, but the {noun} then span {size:.3} m: the unit is left open"));
        return None;
    }
    Some(unit)
}

/// An error for a take without frames.
pub(super) fn no_frames(found: &str) -> Error {
    Error::new(Kind::Unsupported, found).expected("at least one frame of motion")
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn a_rounded_period_means_the_usual_rate() {
        let cases = [
            (0.0083333, 7, 120.0),
            (0.008333, 6, 120.0),
            (0.033333, 6, 30.0),
            (0.0333, 4, 30.0),
            (0.033367, 6, 29.97),
            (0.041667, 6, 24.0),
            (0.0417083750417, 13, 23.976),
            (0.016666666666666666, 18, 60.0),
            (0.04, 2, 25.0),
            (0.0016, 4, 625.0),
        ];
        for (period, decimals, wanted) in cases {
            assert!((rate(period, decimals) - wanted).abs() < 1e-9, "{period}: {}", rate(period, decimals));
        }
        assert!((rate(0.0331, 4) - 1.0 / 0.0331).abs() < 1e-12);
    }

    #[test]
    fn turns_are_found_under_scale_mirror_and_shear() {
        let turn_of = |m: DMat3| turn(&m);
        let wanted = DQuat::from_euler(glam::EulerRot::XYZ, 0.3, -1.2, 2.0);
        let matrix = DMat3::from_quat(wanted);
        let same = |found: DQuat, wanted: DQuat| assert!((found.dot(wanted).abs() - 1.0).abs() < 1e-12, "{found} {wanted}");
        same(turn_of(matrix * 100.0), wanted);
        same(turn_of(matrix * DMat3::from_diagonal(DVec3::new(1.0, 2.0, 1e-3))), wanted);
        let (a, b) = (
            turn_of(matrix * DMat3::from_diagonal(DVec3::new(-1.0, 1.0, 1.0))),
            turn_of(DMat3::from_diagonal(DVec3::new(-1.0, 1.0, 1.0))),
        );
        same(a * b.inverse(), wanted);
        assert_eq!(turn_of(DMat3::ZERO), DQuat::IDENTITY);
        assert!(turn_of(DMat3::from_diagonal(DVec3::NAN)).is_nan());
    }

    #[test]
    fn a_take_out_of_proportion_is_refused() {
        assert!(Frames::new(100_000, 1_000_000, 4_000_000).is_err());
        assert!(Frames::new(usize::MAX, 3, 100).is_err());
        assert!(Frames::new(40, 3000, 2_000_000).is_ok());
    }
}
