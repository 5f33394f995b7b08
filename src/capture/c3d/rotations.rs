//! The rotation blocks of a C3D file: frames of segments, as marker-less systems write them.
//!
//! Beside the points and in a section of their own, one 4 × 4 matrix per segment and sample, column by column, followed by a fourth-word-like
//! value that is negative where the segment is missing. Source: C3D file format extension of Theia and HAS-Motion, group ROTATION.

use super::header::{BLOCK, Processor};
use super::parameters::Parameters;
use crate::capture::{Joint, MarkerTake, SkeletonTake};
use crate::error::Notes;
use glam::{DMat3, DQuat, DVec3};
use std::io::{self, Read};

/// Floats of one segment: the matrix and its reliability.
const FLOATS: usize = 17;
/// Bytes of one segment.
const SEGMENT: u64 = FLOATS as u64 * 4;
/// Segments per sample, and samples per frame, at most: what a word of the header can count.
const MOST: u64 = u16::MAX as u64;
/// How far a matrix may be from a turn.
const SLACK: f64 = 0.01;

/// Where the rotations are and what they are called.
#[derive(Clone, Debug)]
pub(super) struct Rotations {
    labels: Vec<String>,
    /// Rotations per sample.
    count: usize,
    /// First byte.
    pub(super) start: u64,
    /// Samples per second, where the file says so.
    rate: Option<f64>,
    /// Samples per frame of the points.
    ratio: usize,
    processor: Processor,
}

impl Rotations {
    /// What the parameters say of rotations; `None` where there are none, or more than a file of this length can hold.
    pub(super) fn of(parameters: &Parameters<'_>, processor: Processor, length: u64, notes: &mut Notes) -> Option<Self> {
        let used = parameters.number("ROTATION", "USED").filter(|n| *n != 0.0)?;
        let block = parameters.number("ROTATION", "DATA_START").unwrap_or_default();
        let start = whole(block, 2, u32::MAX.into()).and_then(|b| (b - 1).checked_mul(BLOCK));
        let count = whole(used, 1, MOST);
        let held = |(count, start): &(u64, u64)| count * SEGMENT <= length.saturating_sub(*start);
        let Some((count, start)) = count.zip(start).filter(held) else {
            notes.warn(format!(
                "ROTATION:USED {used} from block {block} on is not in a file of {length} bytes: no segments are read"
            ));
            return None;
        };
        let ratio = parameters.number("ROTATION", "RATIO").and_then(|r| whole(r, 1, MOST)).unwrap_or(1);
        let usable = |r: &f64| r.is_finite() && *r > 0.0 && *r < 1e6;
        let rate = parameters.number("ROTATION", "RATE").filter(usable);
        let mut labels = parameters.long_texts("ROTATION", "LABELS");
        labels.resize(count as usize, String::new());
        for (n, label) in labels.iter_mut().enumerate() {
            let bare = label.strip_suffix("_4X4").or_else(|| label.strip_suffix("_4x4")).unwrap_or(label);
            *label = if bare.is_empty() { format!("segment {}", n + 1) } else { bare.to_owned() };
        }
        Some(Self { labels, count: count as usize, start, rate, ratio: ratio as usize, processor })
    }

    /// Samples per second, beside points at this rate.
    pub(super) fn rate(&self, points: f64) -> f64 {
        self.rate.unwrap_or(points * self.ratio as f64)
    }

    /// Whole frames of the points that a file of this length has rotations for.
    pub(super) fn frames(&self, length: u64) -> u64 {
        length.saturating_sub(self.start) / self.sample_bytes().max(1) / self.ratio as u64
    }

    fn sample_bytes(&self) -> u64 {
        self.count as u64 * SEGMENT
    }

    /// Samples for so many frames, as far as the file has them.
    pub(super) fn samples(&self, frames: u64, length: u64, notes: &mut Notes) -> usize {
        let declared = frames.saturating_mul(self.ratio as u64);
        let there = length.saturating_sub(self.start) / self.sample_bytes().max(1);
        if there < declared {
            notes.warn(format!(
                "the file announces {declared} samples of rotations but holds {there} whole ones: it is cut short"
            ));
        }
        declared.min(there) as usize
    }

    /// The segments as a skeleton without hierarchy and rest, in the unit of the points. The room itself, which some systems store as a
    /// segment, is left out.
    pub(super) fn read(&self, source: &mut impl Read, samples: usize, notes: &mut Notes) -> io::Result<SkeletonTake> {
        let kept: Vec<usize> = (0..self.count).filter(|n| !self.labels[*n].eq_ignore_ascii_case("worldbody")).collect();
        let mut take = SkeletonTake {
            joints: kept.iter().map(|n| segment(&self.labels[*n])).collect(),
            origins: MarkerTake { labels: kept.iter().map(|n| self.labels[*n].clone()).collect(), ..MarkerTake::default() },
            ..SkeletonTake::default()
        };
        take.origins.points.reserve_exact(samples * kept.len());
        take.rotations.reserve_exact(samples * kept.len());
        let mut buffer = vec![0; self.sample_bytes() as usize];
        let mut skewed = 0;
        for _ in 0..samples {
            source.read_exact(&mut buffer)?;
            for n in &kept {
                let bytes = &buffer[n * FLOATS * 4..(n + 1) * FLOATS * 4];
                let value = |i: usize| {
                    f64::from(self.processor.f32([bytes[4 * i], bytes[4 * i + 1], bytes[4 * i + 2], bytes[4 * i + 3]]))
                };
                let column = |c: usize| DVec3::new(value(4 * c), value(4 * c + 1), value(4 * c + 2));
                let axes = DMat3::from_cols(column(0), column(1), column(2));
                let there = axes.is_finite() && column(3).is_finite() && value(16) >= 0.0;
                let turn = there && near_turn(&axes);
                skewed += usize::from(there && !turn);
                if turn {
                    take.origins.points.push(column(3).as_vec3().to_array());
                    take.rotations.push(DQuat::from_mat3(&axes).normalize().to_array().map(|x| x as f32));
                } else {
                    take.origins.points.push([f32::NAN; 3]);
                    take.rotations.push([f32::NAN; 4]);
                }
            }
        }
        if skewed > 0 {
            notes.warn(format!("{skewed} matrices are no turns: gaps"));
        }
        Ok(take)
    }
}

/// A count that may be written as a float.
fn whole(value: f64, least: u64, most: u64) -> Option<u64> {
    (value.fract() == 0.0 && (least as f64..=most as f64).contains(&value)).then_some(value as u64)
}

fn segment(name: &str) -> Joint {
    Joint { name: name.to_owned(), parent: None, rest: DVec3::NAN, rest_turn: DQuat::IDENTITY, end: false }
}

/// Whether a matrix turns and neither scales nor mirrors.
fn near_turn(m: &DMat3) -> bool {
    let product = *m * m.transpose();
    let off = product.to_cols_array().iter().zip(DMat3::IDENTITY.to_cols_array()).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
    off < SLACK && m.determinant() > 0.0
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn mirrors_and_scales_are_no_turns() {
        let turn = DMat3::from_axis_angle(DVec3::new(0.6, 0.0, 0.8), 2.0);
        assert!(near_turn(&turn));
        assert!(!near_turn(&(turn * 1.1)) && !near_turn(&(turn * DMat3::from_diagonal(DVec3::new(1.0, 1.0, -1.0)))));
        assert!(!near_turn(&DMat3::ZERO));
    }
}
