//! Smoothing of takes: a low-pass that shifts nothing in time.

use super::{MarkerTake, Motion};
use crate::error::{Error, Kind, Result};
use std::f64::consts::{PI, SQRT_2};

/// Two passes of the filter weaken more than one: the frequency of the single pass over that at which both together halve the power.
/// Source: D. Winter, Biomechanics and Motor Control of Human Movement, (√2 − 1)^(1/4).
const BOTH_PASSES: f64 = 0.802_243_262_923_150_2;
/// Shorter stretches without a gap stay as they are.
const SHORTEST: usize = 4;

/// Weakens what is faster than `hertz`: a Butterworth filter of second order, run forwards and backwards over every stretch without a gap, the
/// ends of which are continued by their mirror images. Gaps stay gaps.
///
/// # Errors
/// [`Kind::Usage`] for a frequency that frames at `rate` cannot show.
pub fn low_pass(motion: &mut Motion, rate: f64, hertz: f64) -> Result<()> {
    let limit = 0.4 * rate;
    if !(hertz > 0.0 && hertz <= limit) {
        let limit = crate::words::digits(limit);
        return Err(Error::new(Kind::Usage, format!("smoothing at {hertz} Hz a take of {} Hz", crate::words::digits(rate)))
            .expected(format!("up to {limit} Hz, 0.4 times the rate of the take")));
    }
    let filter = Butterworth::new(hertz / BOTH_PASSES / rate);
    let pad = (rate / hertz).ceil() as usize;
    match motion {
        Motion::Markers(take) => markers(take, &filter, pad),
        Motion::Vertices(surface) => markers(&mut surface.points, &filter, pad),
        Motion::Skeleton(take) => {
            markers(&mut take.origins, &filter, pad);
            turns(&mut take.rotations, take.joints.len(), &filter, pad);
        }
    }
    Ok(())
}

fn markers(take: &mut MarkerTake, filter: &Butterworth, pad: usize) {
    let markers = take.markers();
    for marker in 0..markers {
        smooth_column(&mut take.points, marker, markers, filter, pad);
    }
}

/// Quaternions are smoothed by their parts, of one sign in every stretch, and made unit again.
fn turns(turns: &mut [[f32; 4]], joints: usize, filter: &Butterworth, pad: usize) {
    for joint in 0..joints {
        let mut before = [0.0; 4];
        for q in turns.iter_mut().skip(joint).step_by(joints) {
            if q.iter().zip(before).map(|(a, b): (&f32, f32)| a * b).sum::<f32>() < 0.0 {
                *q = q.map(|x| -x);
            }
            before = if q[0].is_nan() { [0.0; 4] } else { *q };
        }
        smooth_column(turns, joint, joints, filter, pad);
        for q in turns.iter_mut().skip(joint).step_by(joints) {
            let length = q.iter().map(|x| f64::from(*x).powi(2)).sum::<f64>().sqrt();
            *q = q.map(|x| (f64::from(x) / length) as f32);
        }
    }
}

/// Smooths one column of a frame-major table, stretch by stretch.
fn smooth_column<const N: usize>(values: &mut [[f32; N]], column: usize, width: usize, filter: &Butterworth, pad: usize) {
    let frames = values.len() / width.max(1);
    let mut start = 0;
    while start < frames {
        let there = |f: &usize| !values[f * width + column][0].is_nan();
        let end = (start..frames).find(|f| !there(f)).unwrap_or(frames);
        if end - start >= SHORTEST {
            let rows = start..end;
            (0..N).for_each(|part| {
                let mut stretch: Vec<f64> = rows.clone().map(|f| f64::from(values[f * width + column][part])).collect();
                filter.zero_phase(&mut stretch, pad);
                stretch.iter().zip(rows.clone()).for_each(|(x, f)| values[f * width + column][part] = *x as f32);
            });
        }
        start = end + 1;
    }
}

/// A low-pass of second order.
#[derive(Clone, Copy, Debug)]
struct Butterworth {
    b: [f64; 3],
    a: [f64; 2],
}

impl Butterworth {
    /// `cut`: frequency at which the power is halved, per frame; below 0.5.
    fn new(cut: f64) -> Self {
        let k = (PI * cut).tan();
        let norm = 1.0 / (1.0 + SQRT_2 * k + k * k);
        let b = k * k * norm;
        Self { b: [b, 2.0 * b, b], a: [2.0 * (k * k - 1.0) * norm, (1.0 - SQRT_2 * k + k * k) * norm] }
    }

    /// One pass that begins as if the first value had always been there.
    fn pass<'a>(&self, values: impl Iterator<Item = &'a mut f64>) {
        let mut state: Option<[f64; 2]> = None;
        for x in values {
            let [z1, z2] = state.unwrap_or([(1.0 - self.b[0]) * *x, (self.b[2] - self.a[1]) * *x]);
            let y = self.b[0] * *x + z1;
            state = Some([self.b[1] * *x - self.a[0] * y + z2, self.b[2] * *x - self.a[1] * y]);
            *x = y;
        }
    }

    /// Both passes over what differs from an even motion between the ends, and over `pad` more values on either side, its mirror images
    /// through the end points.
    fn zero_phase(&self, values: &mut [f64], pad: usize) {
        let n = values.len();
        let pad = pad.min(n - 1);
        let (first, step) = (values[0], (values[n - 1] - values[0]) / (n - 1) as f64);
        values.iter_mut().enumerate().for_each(|(k, x)| *x -= first + step * k as f64);
        let before = (1..=pad).rev().map(|k| -values[k]);
        let after = (1..=pad).map(|k| -values[n - 1 - k]);
        let mut long: Vec<f64> = before.chain(values.iter().copied()).chain(after).collect();
        self.pass(long.iter_mut());
        self.pass(long.iter_mut().rev());
        values.iter_mut().enumerate().for_each(|(k, x)| *x = long[pad + k] + first + step * k as f64);
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::super::{Joint, SkeletonTake};
    use super::*;
    use glam::{DQuat, DVec3};

    #[test]
    fn values_are_those_of_another_implementation() {
        // scipy.signal.filtfilt of butter(2, …), odd padding of 17, over what differs from the line between the ends.
        let signal = |n: usize| {
            let t = n as f64 / 100.0;
            300.0 * (2.0 * PI * 1.3 * t).sin() + 5.0 * (2.0 * PI * 23.0 * t + 1.0).sin() + 1000.0
        };
        let mut values: Vec<f64> = (0..40).map(signal).collect();
        Butterworth::new(6.0 / BOTH_PASSES / 100.0).zero_phase(&mut values, 17);
        for (n, truth) in [
            (0, 1004.214902),
            (1, 1027.232232),
            (2, 1050.298607),
            (3, 1073.392563),
            (10, 1218.370257),
            (20, 1299.13782),
            (30, 1190.890467),
            (37, 1037.18913),
            (38, 1013.797832),
            (39, 990.50105),
        ] {
            assert!((values[n] - truth).abs() < 2e-6, "{n}: {}", values[n]);
        }
    }

    #[test]
    fn slow_motion_passes_in_time_and_fast_motion_does_not() {
        let wave = |hz: f64| -> Vec<f64> { (0..1000).map(|n| (2.0 * PI * hz * n as f64 / 100.0).sin()).collect() };
        let gain = |hz: f64| {
            let mut smooth = wave(hz);
            Butterworth::new(6.0 / BOTH_PASSES / 100.0).zero_phase(&mut smooth, 17);
            // The part in phase, and the part a quarter of a period late.
            let part = |shift: usize| (200..800).map(|n| smooth[n] * wave(hz)[n + shift]).sum::<f64>() / 300.0;
            [part(0), part((25.0 / hz) as usize)]
        };
        let [slow, late] = gain(1.0);
        assert!((slow - 1.0).abs() < 2e-3 && late.abs() < 1e-3, "{slow} {late}");
        let [half, late] = gain(6.25);
        assert!((half - 0.68).abs() < 0.03 && late.abs() < 0.01, "{half} {late}");
        assert!(gain(25.0)[0] < 0.01);
    }

    #[test]
    fn first_and_last_frame_of_an_even_walk_stay_and_gaps_stay_gaps() {
        let even = |f: usize| [f as f32 * 0.5, 7.0, 100.0 - f as f32];
        let mut points: Vec<[f32; 3]> = (0..90).map(even).collect();
        points[50..60].fill([f32::NAN; 3]);
        points[62] = [f32::NAN; 3];
        let take = MarkerTake { labels: vec!["a".into()], points: points.clone(), ..MarkerTake::default() };
        let mut motion = Motion::Markers(take);
        low_pass(&mut motion, 100.0, 6.0).unwrap();
        for (p, q) in motion.points().points.iter().zip(&points) {
            assert_eq!(p[0].is_nan(), q[0].is_nan());
            assert!(p[0].is_nan() || (0..3).all(|i| (p[i] - q[i]).abs() < 1e-4), "{p:?} {q:?}");
        }
        assert_eq!(low_pass(&mut motion, 100.0, 45.0).unwrap_err().kind, Kind::Usage);
    }

    #[test]
    fn turns_of_any_sign_are_smoothed_to_unit_length() {
        let truth = |f: usize| DQuat::from_rotation_z(f as f64 * 0.05);
        let noisy = |f: usize| {
            let jitter = DQuat::from_rotation_x(if f.is_multiple_of(2) { 0.01 } else { -0.01 });
            (truth(f) * jitter).to_array().map(|x| (x * if f % 5 < 2 { 1.0 } else { -1.0 }) as f32)
        };
        let joint = Joint { name: "a".into(), parent: None, rest: DVec3::NAN, rest_turn: DQuat::IDENTITY, end: false };
        let origins = MarkerTake { labels: vec!["a".into()], points: vec![[1.0; 3]; 100], ..MarkerTake::default() };
        let take =
            SkeletonTake { joints: vec![joint], origins, rotations: (0..100).map(noisy).collect(), ..SkeletonTake::default() };
        let mut motion = Motion::Skeleton(take);
        low_pass(&mut motion, 100.0, 6.0).unwrap();
        let Motion::Skeleton(take) = motion else { return };
        for (f, q) in take.rotations.iter().enumerate() {
            let q = DQuat::from_array(q.map(f64::from));
            let off = 2.0 * (q.inverse() * truth(f)).xyz().length();
            assert!((q.length() - 1.0).abs() < 1e-6 && off < if f > 9 && f < 90 { 5e-4 } else { 1.2e-2 }, "{f}: {q} {off}");
        }
    }
}
