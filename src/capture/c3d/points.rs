//! The data section of a C3D file: positions, and which of them are real.
//!
//! The fourth value of a point should be negative where the point is missing, but systems also write zeros, huge numbers or
//! not-a-number with any fourth value, and a negative one beside good coordinates (points that the capture system filled, or all
//! points of a take). So the coordinates decide: a point is missing where they are not finite, all exactly zero, or huge; a
//! negative fourth value counts only where the coordinates merely repeat the frame before, and not where all values are negative.

use super::header::{Header, Processor};
use std::io::{self, Read};

/// No marker is this far from the origin in any unit in use (10 km in mm); systems write ±1e9 for a missing point.
const HUGE: f32 = 1e7;

const MISSING: [f32; 3] = [f32::NAN; 3];

/// What the validity rules met.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Doubtful {
    /// Points marked as missing whose coordinates were kept.
    pub(super) marked_but_there: usize,
    /// Points marked as missing that repeat the frame before.
    pub(super) held: usize,
    /// Points at absurd distances.
    pub(super) huge: usize,
}

/// Reads `frames` frames and keeps the given columns: frame-major, `frames × columns`, a missing point is NaN.
pub(super) fn read(
    source: &mut impl Read,
    header: &Header,
    processor: Processor,
    columns: &[usize],
    frames: usize,
) -> io::Result<(Vec<[f32; 3]>, Doubtful)> {
    let decode = Decoder { processor, real: header.scale < 0.0, scale: f64::from(header.scale) };
    let mut buffer = vec![0; header.frame_bytes() as usize];
    let mut points = Vec::with_capacity(frames * columns.len());
    let mut before = vec![[f32::NAN; 3]; columns.len()];
    let mut doubtful = Doubtful::default();
    let mut held = Vec::new();
    let mut trusted = 0;
    let bytes = 4 * header.value_bytes() as usize;
    for _ in 0..frames {
        source.read_exact(&mut buffer)?;
        for (column, before) in columns.iter().zip(&mut before) {
            let (p, marked) = decode.point(&buffer[column * bytes..(column + 1) * bytes]);
            let p = judge(p, &mut doubtful);
            match marked {
                _ if p[0].is_nan() => {}
                false => trusted += 1,
                true if p == *before => held.push(points.len()),
                true => doubtful.marked_but_there += 1,
            }
            points.push(p);
            *before = p;
        }
    }
    if trusted > 0 {
        doubtful.held = held.len();
        held.iter().for_each(|i| points[*i] = MISSING);
    } else {
        doubtful.marked_but_there += held.len();
    }
    Ok((points, doubtful))
}

/// The point, or NaN where its coordinates say that it is missing.
fn judge(p: [f32; 3], doubtful: &mut Doubtful) -> [f32; 3] {
    if p.iter().any(|c| !c.is_finite()) || p == [0.0; 3] {
        return MISSING;
    }
    if p.iter().any(|c| c.abs() > HUGE) {
        doubtful.huge += 1;
        return MISSING;
    }
    p
}

struct Decoder {
    processor: Processor,
    real: bool,
    scale: f64,
}

impl Decoder {
    /// Coordinates, and whether the fourth value marks the point as missing.
    fn point(&self, bytes: &[u8]) -> ([f32; 3], bool) {
        if self.real {
            let value = |i: usize| self.processor.f32([bytes[4 * i], bytes[4 * i + 1], bytes[4 * i + 2], bytes[4 * i + 3]]);
            ([value(0), value(1), value(2)], negative_as_integer(value(3)))
        } else {
            let value = |i: usize| self.processor.i16([bytes[2 * i], bytes[2 * i + 1]]);
            ([0, 1, 2].map(|i| (f64::from(value(i)) * self.scale) as f32), value(3) < 0)
        }
    }
}

/// The fourth value is two bytes (cameras, residual) even in float files, where some systems write it without its sign.
/// Values that do not fit are garbage and say nothing.
fn negative_as_integer(word: f32) -> bool {
    word.abs() <= 65535.0 && (word as i32 as u16 as i16) < 0
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    #[test]
    fn the_fourth_word_is_a_16_bit_integer() {
        assert!(negative_as_integer(-1.0));
        assert!(negative_as_integer(65535.0));
        assert!(!negative_as_integer(1.7e38));
        assert!(!negative_as_integer(f32::NAN));
        assert!(!negative_as_integer(4.0));
    }

    /// Frames of one point as floats.
    fn one_point(frames: &[[f32; 4]]) -> (Vec<[f32; 3]>, Doubtful) {
        let bytes: Vec<u8> = frames.iter().flatten().flat_map(|v| v.to_le_bytes()).collect();
        let header = Header { points: 1, analog: 0, first: 1, last: 1, scale: -1.0, data_block: 3, rate: 100.0 };
        read(&mut bytes.as_slice(), &header, Processor::Intel, &[0], frames.len()).unwrap()
    }

    #[test]
    fn coordinates_decide_and_the_mark_only_confirms() {
        let (points, seen) = one_point(&[
            [1.0, 2.0, 3.0, 0.0],
            [1.0, 2.0, 3.5, -1.0],
            [1.0, 2.0, 3.5, -1.0],
            [1.0, 2.0, 3.5, 0.0],
            [f32::NAN, 2.0, 3.0, 0.0],
            [1.0, f32::INFINITY, 3.0, 0.0],
            [0.0, -0.0, 0.0, 0.0],
            [-1e9, -1e9, -1e9, 0.0],
        ]);
        let there: Vec<bool> = points.iter().map(|p| !p[0].is_nan()).collect();
        assert_eq!(there, [true, true, false, true, false, false, false, false]);
        assert_eq!(seen, Doubtful { marked_but_there: 1, held: 1, huge: 1 });
    }

    #[test]
    fn a_mark_on_every_point_says_nothing() {
        let (points, seen) = one_point(&[[1.0, 2.0, 3.0, -1.0], [1.0, 2.0, 3.0, -1.0], [0.0, 0.0, 0.0, -1.0]]);
        assert_eq!(points[1], [1.0, 2.0, 3.0]);
        assert!(points[2][0].is_nan());
        assert_eq!(seen, Doubtful { marked_but_there: 2, held: 0, huge: 0 });
    }
}
