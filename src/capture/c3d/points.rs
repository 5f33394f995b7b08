//! The data section of a C3D file: positions, and which of them are real.
//!
//! The fourth value of a point should be negative where the point is missing, but systems also write zeros, huge numbers or
//! not-a-number with any fourth value, and a negative one beside good coordinates (points that the capture system filled, or all
//! points of a take). So the coordinates decide: a point is missing where they are not finite, all exactly zero, or huge; a
//! negative fourth value counts only where the coordinates merely repeat the frame before.

use super::header::{Header, Processor};
use std::io::{self, Read};

/// No marker is this far from the origin in any unit in use (10 km in mm); systems write ±1e9 for a missing point.
const HUGE: f32 = 1e7;

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
    let bytes = 4 * header.value_bytes() as usize;
    for _ in 0..frames {
        source.read_exact(&mut buffer)?;
        for (column, before) in columns.iter().zip(&mut before) {
            let (p, marked) = decode.point(&buffer[column * bytes..(column + 1) * bytes]);
            points.push(judge(p, marked, *before, &mut doubtful));
            *before = p;
        }
    }
    Ok((points, doubtful))
}

/// The point, or NaN where it is missing.
fn judge(p: [f32; 3], marked: bool, before: [f32; 3], doubtful: &mut Doubtful) -> [f32; 3] {
    const MISSING: [f32; 3] = [f32::NAN; 3];
    if p.iter().any(|c| !c.is_finite()) || p == [0.0; 3] {
        return MISSING;
    }
    if p.iter().any(|c| c.abs() > HUGE) {
        doubtful.huge += 1;
        return MISSING;
    }
    if marked && p == before {
        doubtful.held += 1;
        return MISSING;
    }
    doubtful.marked_but_there += usize::from(marked);
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

    #[test]
    fn coordinates_decide_and_the_mark_only_confirms() {
        let mut seen = Doubtful::default();
        let good = [1.0, 2.0, 3.0];
        assert_eq!(judge(good, false, good, &mut seen), good);
        assert_eq!(judge(good, true, [1.0, 2.0, 2.5], &mut seen), good);
        for (p, marked, before) in [
            ([f32::NAN, 2.0, 3.0], false, good),
            ([f32::INFINITY, 2.0, 3.0], false, good),
            ([0.0, -0.0, 0.0], false, good),
            ([-1e9; 3], false, good),
            (good, true, good),
        ] {
            assert!(judge(p, marked, before, &mut seen)[0].is_nan(), "{p:?} {marked}");
        }
        assert_eq!(seen, Doubtful { marked_but_there: 1, held: 1, huge: 1 });
    }
}
