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
    let size = header.frame_bytes() as usize;
    let scale = f64::from(header.scale);
    // One loop per encoding: what differs is decided outside of it.
    match (processor, header.scale < 0.0) {
        (Processor::Intel, true) => gather(source, size, columns, frames, |b| real(b, |v| Processor::Intel.f32(v))),
        (Processor::Dec, true) => gather(source, size, columns, frames, |b| real(b, |v| Processor::Dec.f32(v))),
        (Processor::Mips, true) => gather(source, size, columns, frames, |b| real(b, |v| Processor::Mips.f32(v))),
        (Processor::Mips, false) => gather(source, size, columns, frames, |b| whole(b, scale, |v| Processor::Mips.i16(v))),
        (_, false) => gather(source, size, columns, frames, |b| whole(b, scale, |v| Processor::Intel.i16(v))),
    }
}

/// Coordinates of floats, and whether the fourth value marks the point as missing.
fn real(b: &[u8; 16], value: impl Fn([u8; 4]) -> f32) -> ([f32; 3], bool) {
    let at = |i: usize| value([b[4 * i], b[4 * i + 1], b[4 * i + 2], b[4 * i + 3]]);
    ([at(0), at(1), at(2)], negative_as_integer(at(3)))
}

/// The same of integers.
fn whole(b: &[u8; 8], scale: f64, value: impl Fn([u8; 2]) -> i16) -> ([f32; 3], bool) {
    let at = |i: usize| value([b[2 * i], b[2 * i + 1]]);
    ([0, 1, 2].map(|i| (f64::from(at(i)) * scale) as f32), at(3) < 0)
}

/// Reads frames of `size` bytes whose points are `BYTES` each.
fn gather<const BYTES: usize>(
    source: &mut impl Read,
    size: usize,
    columns: &[usize],
    frames: usize,
    decode: impl Fn(&[u8; BYTES]) -> ([f32; 3], bool),
) -> io::Result<(Vec<[f32; 3]>, Doubtful)> {
    /// Large reads go past the buffer of the reader.
    const AT_ONCE: usize = 1 << 20;
    let together = (AT_ONCE / size.max(1)).clamp(1, frames.max(1));
    let mut buffer = vec![0; together * size];
    let mut points = Vec::with_capacity(frames * columns.len());
    let mut before = vec![[f32::NAN; 3]; columns.len()];
    let mut doubtful = Doubtful::default();
    let mut held = Vec::new();
    let mut trusted = 0;
    let mut left = frames;
    while left > 0 {
        let count = together.min(left);
        source.read_exact(&mut buffer[..count * size])?;
        left -= count;
        for frame in buffer[..count * size].chunks_exact(size) {
            let (values, _) = frame.as_chunks::<BYTES>();
            for (column, before) in columns.iter().zip(&mut before) {
                let (p, marked) = decode(&values[*column]);
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
    fn the_mark_of_integers_counts_as_that_of_floats() {
        let frames: [[i16; 4]; 3] = [[10, 20, 30, 0], [10, 20, 30, -1], [10, 20, 31, -1]];
        for (processor, bytes) in
            [(Processor::Intel, i16::to_le_bytes as fn(i16) -> [u8; 2]), (Processor::Mips, i16::to_be_bytes)]
        {
            let bytes: Vec<u8> = frames.iter().flatten().flat_map(|v| bytes(*v)).collect();
            let header = Header { points: 1, analog: 0, first: 1, last: 3, scale: 0.5, data_block: 3, rate: 100.0 };
            let (points, seen) = read(&mut bytes.as_slice(), &header, processor, &[0], 3).unwrap();
            assert_eq!((points[0], points[1][0].is_nan(), points[2]), ([5.0, 10.0, 15.0], true, [5.0, 10.0, 15.5]));
            assert_eq!(seen, Doubtful { marked_but_there: 1, held: 1, huge: 0 });
        }
    }

    #[test]
    fn a_mark_on_every_point_says_nothing() {
        let (points, seen) = one_point(&[[1.0, 2.0, 3.0, -1.0], [1.0, 2.0, 3.0, -1.0], [0.0, 0.0, 0.0, -1.0]]);
        assert_eq!(points[1], [1.0, 2.0, 3.0]);
        assert!(points[2][0].is_nan());
        assert_eq!(seen, Doubtful { marked_but_there: 2, held: 0, huge: 0 });
    }
}
