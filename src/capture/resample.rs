//! Takes at another frame rate: positions by cubics, turns by cubics on the sphere. Frames that fall on frames of the take are copied; what is
//! missing on either side of a new frame is missing in it.

use super::{MarkerTake, Motion, SkeletonTake, VertexTake};
use glam::{DQuat, DVec3};
use std::ops::Range;

/// Where the frames of a new take lie in the one that it is made of.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sampling {
    /// Place of the first new frame, in frames of the old take.
    start: f64,
    /// Old frames per new frame.
    step: f64,
    /// New frames.
    frames: usize,
}

/// A place this near to a frame, in frames, is that frame: rates are decimal numbers.
const ON_FRAME: f64 = 1e-6;

impl Sampling {
    /// New frames from the first old one of `range` on, as many as begin before its last one ends: the last is exact where the rates meet.
    ///
    /// `lead`: frames before the range that are wanted too; there may be fewer. Returns also how many there are.
    ///
    /// Shapes: `range`: frames counted from 0, not empty; `rate`, `new_rate`: frames per second, positive.
    pub fn new(range: Range<usize>, lead: usize, rate: f64, new_rate: f64) -> (Self, usize) {
        let step = rate / new_rate;
        let count = |frames: usize| (frames as f64 / step + ON_FRAME) as usize;
        let lead = lead.min(count(range.start));
        let frames = count(range.end - range.start - 1).saturating_add(1 + lead);
        (Self { start: range.start as f64 - lead as f64 * step, step, frames }, lead)
    }

    /// Number of new frames.
    pub fn frames(&self) -> usize {
        self.frames
    }

    /// The old frame before a new one, and how far behind it that is.
    fn place(&self, frame: usize) -> (usize, f64) {
        let at = (self.start + frame as f64 * self.step).max(0.0);
        let near = at.round();
        if (at - near).abs() <= ON_FRAME { (near as usize, 0.0) } else { (at as usize, at.fract()) }
    }

    /// The motion at the new frames.
    pub fn motion(&self, motion: &Motion) -> Motion {
        match motion {
            Motion::Markers(take) => Motion::Markers(self.markers(take)),
            Motion::Vertices(surface) => {
                Motion::Vertices(VertexTake { points: self.markers(&surface.points), ..surface.clone() })
            }
            Motion::Skeleton(take) => Motion::Skeleton(SkeletonTake {
                origins: self.markers(&take.origins),
                rotations: self.turns(&take.rotations, take.joints.len()),
                ..take.clone()
            }),
        }
    }

    /// Trajectories at the new frames.
    pub fn markers(&self, take: &MarkerTake) -> MarkerTake {
        let markers = take.markers();
        let mut points = Vec::with_capacity(self.frames.saturating_mul(markers));
        for frame in 0..self.frames {
            for marker in 0..markers {
                let at = |f: usize| take.points.get(f * markers + marker).filter(|p| !p[0].is_nan());
                let point = self.point(frame, |f| at(f).map(|p| DVec3::from_array(p.map(f64::from))));
                points.push(point.map_or([f32::NAN; 3], |p| p.as_vec3().to_array()));
            }
        }
        MarkerTake { labels: take.labels.clone(), points, origin: take.origin }
    }

    fn turns(&self, turns: &[[f32; 4]], joints: usize) -> Vec<[f32; 4]> {
        let mut new = Vec::with_capacity(self.frames.saturating_mul(joints));
        for frame in 0..self.frames {
            for joint in 0..joints {
                let at = |f: usize| turns.get(f * joints + joint).filter(|q| !q[0].is_nan());
                let turn = self.turn(frame, |f| at(f).map(|q| DQuat::from_array(q.map(f64::from))));
                new.push(turn.map_or([f32::NAN; 4], |q| q.to_array().map(|x| x as f32)));
            }
        }
        new
    }

    /// The place in a new frame of what is `at` the frames of the old take, `None` where it is missing or the take has ended.
    pub fn point(&self, frame: usize, at: impl Fn(usize) -> Option<DVec3>) -> Option<DVec3> {
        let (frame, share) = self.place(frame);
        if share == 0.0 { at(frame) } else { between(at, frame, share) }
    }

    /// As [`Sampling::point`], for orientations.
    pub fn turn(&self, frame: usize, at: impl Fn(usize) -> Option<DQuat>) -> Option<DQuat> {
        let (frame, share) = self.place(frame);
        if share == 0.0 { at(frame) } else { turned_between(|f| at(f).map(DQuat::normalize), frame, share) }
    }
}

/// Hermite cubic between a frame and the next; `None` where either is missing.
fn between(at: impl Fn(usize) -> Option<DVec3>, frame: usize, t: f64) -> Option<DVec3> {
    let (a, b) = (at(frame)?, at(frame + 1)?);
    let (start, end) = (slope(&at, frame, b - a), slope(&at, frame + 1, b - a));
    let (t2, t3) = (t * t, t * t * t);
    Some(a * (2.0 * t3 - 3.0 * t2 + 1.0) + start * (t3 - 2.0 * t2 + t) + b * (3.0 * t2 - 2.0 * t3) + end * (t3 - t2))
}

/// Derivative at a frame that is there, per frame: the highest order that its neighbours allow.
fn slope(at: &impl Fn(usize) -> Option<DVec3>, frame: usize, chord: DVec3) -> DVec3 {
    let near = |offset: isize| frame.checked_add_signed(offset).and_then(at);
    match (near(-2), near(-1), near(0), near(1), near(2)) {
        (Some(a), Some(b), _, Some(d), Some(e)) => (a - e + 8.0 * (d - b)) / 12.0,
        (_, Some(b), _, Some(d), _) => 0.5 * (d - b),
        (_, None, Some(c), Some(d), Some(e)) => 0.5 * (4.0 * d - 3.0 * c - e),
        (Some(a), Some(b), Some(c), None, _) => 0.5 * (3.0 * c - 4.0 * b + a),
        _ => chord,
    }
}

/// Cubic Bézier curve on the sphere between a frame and the next, with the turning speeds of both.
///
/// Source: K. Shoemake, Animating rotation with quaternion curves, 1985.
fn turned_between(at: impl Fn(usize) -> Option<DQuat>, frame: usize, t: f64) -> Option<DQuat> {
    let (a, b) = (at(frame)?, at(frame + 1)?);
    let chord = turning(a, b);
    let before = frame.checked_sub(1).and_then(&at).map_or(chord, |p| turning(p, a));
    let after = at(frame + 2).map_or(chord, |n| turning(b, n));
    let reach = |speed: DVec3| DQuat::from_scaled_axis(speed / 3.0);
    let controls = [a, a * reach(0.5 * (before + chord)), b * reach(-0.5 * (chord + after)), b];
    let mut curve = controls;
    for left in (1..4).rev() {
        for k in 0..left {
            curve[k] = curve[k] * DQuat::from_scaled_axis(turning(curve[k], curve[k + 1]) * t);
        }
    }
    Some(curve[0].normalize())
}

/// Axis times angle, in the body's own axes, of the shorter way from one orientation to another.
fn turning(from: DQuat, to: DQuat) -> DVec3 {
    let step = from.inverse() * to;
    (if step.w < 0.0 { -step } else { step }).to_scaled_axis()
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    fn take(frames: usize, place: impl Fn(f64) -> [f64; 3]) -> MarkerTake {
        let points = (0..frames).map(|f| place(f as f64).map(|x| x as f32)).collect();
        MarkerTake { labels: vec!["a".into()], points, ..MarkerTake::default() }
    }

    #[test]
    fn first_and_last_frame_are_exact_where_the_rates_meet() {
        let walk = take(241, |f| [f.sin(), f * 0.37, (f * 0.1).cos()]);
        for (rate, new_rate, range, frames) in [
            (120.0, 30.0, 0..241, 61),
            (120.0, 24.0, 3..239, 48),
            (120.0, 250.0, 0..241, 501),
            (59.94, 29.97, 10..21, 6),
            (120.0, 120.0, 7..200, 193),
            (120.0, 30.0, 5..6, 1),
        ] {
            let (sampling, lead) = Sampling::new(range.clone(), 0, rate, new_rate);
            let new = sampling.markers(&walk);
            assert_eq!((sampling.frames(), new.frames(), lead), (frames, frames, 0), "{rate} to {new_rate}");
            assert_eq!(new.points[0], walk.points[range.start]);
            let last = (range.end - 1 - range.start) as f64 / rate * new_rate;
            if (last - last.round()).abs() < 1e-6 {
                assert_eq!(new.points[frames - 1], walk.points[range.end - 1], "{rate} to {new_rate}");
            }
        }
    }

    #[test]
    fn frames_before_the_range_lead_into_it() {
        let walk = take(100, |f| [f, 0.0, 0.0]);
        let (sampling, lead) = Sampling::new(40..81, 8, 120.0, 30.0);
        let new = sampling.markers(&walk);
        assert_eq!((lead, new.frames()), (8, 19));
        assert_eq!((new.points[0][0], new.points[8][0], new.points[18][0]), (8.0, 40.0, 80.0));
        assert_eq!(Sampling::new(6..81, 8, 120.0, 30.0).1, 1);
    }

    #[test]
    fn cubics_are_met_and_gaps_stay_gaps() {
        let cubic = |f: f64| [0.001 * f * f * f - 0.1 * f * f + f, 2.0 * f, 5.0 - 0.02 * f * f];
        let mut curve = take(60, cubic);
        curve.points[30] = [f32::NAN; 3];
        let (sampling, _) = Sampling::new(0..60, 0, 50.0, 120.0);
        let new = sampling.markers(&curve);
        for f in 0..new.frames() {
            let at = f as f64 * 50.0 / 120.0;
            // A cubic has its slopes inside; at ends and gaps they are those of a parabola or a central difference.
            let p = new.point(f, 0);
            assert_eq!(p.is_none(), at > 29.0 && at < 31.0, "{at}");
            let far = at > 2.0 && at < 57.0 && !(27.0..=33.0).contains(&at);
            assert!(p.is_none_or(|p| p.distance(cubic(at).into()) < if far { 1e-4 } else { 2e-3 }), "{at}: {p:?}");
        }
    }

    #[test]
    fn a_frame_on_a_frame_is_copied_however_its_place_is_rounded() {
        // 55 steps of 120/110 are 59.99999999999999.
        let mut walk = take(80, |f| [f.sin(), f * 0.37, 1.0]);
        walk.points[59] = [f32::NAN; 3];
        let (sampling, _) = Sampling::new(0..80, 0, 120.0, 110.0);
        assert_eq!(sampling.markers(&walk).points[55], walk.points[60]);
    }

    #[test]
    fn turns_stay_on_the_sphere_and_meet_an_even_turn() {
        let axis = DVec3::new(0.6, 0.0, 0.8);
        let truth = |f: f64| DQuat::from_axis_angle(axis, 0.4 * f);
        // Stored with any sign.
        let sign = |f: usize| if f % 3 == 1 { -1.0 } else { 1.0 };
        let mut rotations: Vec<[f32; 4]> = (0..40).map(|f| truth(f as f64).to_array().map(|x| (x * sign(f)) as f32)).collect();
        rotations[20] = [f32::NAN; 4];
        let (sampling, _) = Sampling::new(0..40, 0, 30.0, 100.0);
        let new = sampling.turns(&rotations, 1);
        assert_eq!((new.len(), new[0], new[130]), (131, rotations[0], rotations[39]));
        for (f, q) in new.iter().enumerate() {
            let at = f as f64 * 0.3;
            assert_eq!(q[0].is_nan(), at > 19.0 + 1e-9 && at < 21.0 - 1e-9, "{at}");
            let q = DQuat::from_array(q.map(f64::from));
            let off = 2.0 * (q.inverse() * truth(at)).xyz().length();
            assert!(q.x.is_nan() || (off < 2e-6 && (q.length() - 1.0).abs() < 1e-6), "{at}: {q}");
        }
    }
}
