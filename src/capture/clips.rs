//! Animations of which a file holds several, and the times of their frames.

use super::{number, skeleton};
use crate::error::{Error, Kind, Notes, Result};
use crate::words;

/// Frames per second that keys at uneven times are sampled with at most.
const LARGEST_RATE: f64 = 240.0;
/// Keys nearer in time than this, in seconds, are one: times are stored in 32 bits.
const SAME: f64 = 2e-5;

/// An animation of a file.
#[derive(Clone, Debug)]
pub(super) struct Clip {
    /// Its name; may be empty.
    pub(super) name: String,
    /// Seconds that its motion takes.
    pub(super) seconds: f64,
    /// Whether it moves anything that is wanted.
    pub(super) moves: bool,
}

/// Chooses the clip called `wanted` (in any case, or the only one whose name contains it), or the longest of those that move something.
///
/// # Errors
/// No clip of this name, with the names that there are; no clip that moves a joint.
pub(super) fn choose(clips: &[Clip], wanted: Option<&str>, notes: &mut Notes) -> Result<usize> {
    let shown = |n: usize| match clips[n].name.as_str() {
        "" => format!("number {}", n + 1),
        name => format!("'{name}'"),
    };
    let listed = |except: Option<usize>| {
        let others: Vec<usize> = (0..clips.len()).filter(|n| Some(*n) != except).collect();
        let few: Vec<String> =
            others.iter().take(12).map(|&n| format!("{} ({})", shown(n), words::seconds(clips[n].seconds))).collect();
        let more = if others.len() > few.len() { format!(" and {} more", others.len() - few.len()) } else { String::new() };
        few.join(", ") + &more
    };
    if let Some(name) = wanted {
        let with = |test: &dyn Fn(&str) -> bool| -> Vec<usize> { (0..clips.len()).filter(|&n| test(&clips[n].name)).collect() };
        let lower = name.to_lowercase();
        let rank = [with(&|n| n == name), with(&|n| n.to_lowercase() == lower), with(&|n| n.to_lowercase().contains(&lower))];
        return match rank.iter().find(|found| !found.is_empty()).map(Vec::as_slice) {
            Some([only]) => Ok(*only),
            _ => {
                Err(Error::new(Kind::Usage, format!("there is no clip '{name}', or more than one")).expected(match clips.len() {
                    0 => "no --clip: the file has no animation".to_owned(),
                    _ => format!("one of {}", listed(None)),
                }))
            }
        };
    }
    let longest = (0..clips.len())
        .filter(|&n| clips[n].moves)
        .reduce(|best, n| if clips[n].seconds > clips[best].seconds { n } else { best })
        .ok_or_else(|| {
            skeleton::no_frames(if clips.is_empty() {
                "the file has no animation"
            } else {
                "no animation of the file moves a joint"
            })
        })?;
    if clips.len() > 1 {
        notes.warn(format!(
            "{} clips: {} ({}) is used, the longest; others (--clip): {}",
            clips.len(),
            shown(longest),
            words::seconds(clips[longest].seconds),
            listed(Some(longest))
        ));
    }
    Ok(longest)
}

/// Times of frames: `start + n / rate`, the last one no later than `end`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Times {
    pub(super) start: f64,
    pub(super) end: f64,
    pub(super) rate: f64,
    pub(super) count: usize,
}

impl Times {
    /// The frames that the keys mean: at the keys' own rate where they are evenly spaced, a few left out or not; else as close as the
    /// closest of them, at most 240 per second. `None` without keys.
    pub(super) fn of_keys(mut keys: Vec<f64>) -> Option<Self> {
        keys.retain(|t| t.is_finite());
        keys.sort_by(f64::total_cmp);
        let (&start, &end) = (keys.first()?, keys.last()?);
        keys.dedup_by(|b, a| *b - *a <= SAME);
        let mut steps: Vec<f64> = keys.windows(2).map(|w| w[1] - w[0]).collect();
        if steps.is_empty() {
            return Some(Self { start, end: start, rate: 30.0, count: 1 });
        }
        let whole = (end - start) / steps.len() as f64;
        if steps.iter().all(|s| (s / whole - 1.0).abs() < 0.02) {
            return Some(Self::new(start, end, skeleton::rate(whole, 6)));
        }
        // A twentieth of the steps may be shorter: keys set by hand between the others.
        steps.sort_by(f64::total_cmp);
        let least = steps[steps.len() / 20].max(1.0 / LARGEST_RATE);
        let alike = &steps[steps.partition_point(|&s| s < 0.99 * least)..steps.partition_point(|&s| s < 1.1 * least)];
        let step = alike.get(alike.len() / 2).copied().unwrap_or(least);
        // Over the whole length rounding counts least; but the last key need not be on the grid of the others.
        let n = ((end - start) / step).round().max(1.0);
        let fitted = (end - start) / n;
        Some(Self::new(start, end, skeleton::rate(if (fitted / step - 1.0).abs() * n < 0.02 { fitted } else { step }, 6)))
    }

    /// Frames from `start` to `end` at a rate.
    pub(super) fn new(start: f64, end: f64, rate: f64) -> Self {
        let count = ((end - start) * rate).round().clamp(0.0, 1e15) as usize + 1;
        Self { start, end, rate, count }
    }

    /// Time of a frame.
    pub(super) fn at(&self, frame: usize) -> f64 {
        (self.start + frame as f64 / self.rate).min(self.end)
    }

    /// The number of the first frame, where frame 0 is at time 0.
    ///
    /// # Errors
    /// Times that no capture has.
    pub(super) fn first_frame(&self) -> Result<i64> {
        let number = (self.start * self.rate).round();
        if number.abs() > number::LARGEST_FRAME as f64 {
            return Err(Error::refused(format!("the animation begins at {:e} s", self.start)).expected("times of a capture"));
        }
        Ok(number as i64)
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    fn clip(name: &str, seconds: f64, moves: bool) -> Clip {
        Clip { name: name.into(), seconds, moves }
    }

    #[test]
    fn the_longest_clip_that_moves_is_taken_unless_another_is_named() {
        let clips = [
            clip("Idle", 2.0, true),
            clip("Run", 1.0, true),
            clip("Camera", 9.0, false),
            clip("Run fast", 0.5, true),
            clip("", 0.1, true),
        ];
        let mut notes = Notes::default();
        assert_eq!(choose(&clips, None, &mut notes).unwrap(), 0);
        let said: Vec<&str> = notes.iter().collect();
        assert_eq!(
            said,
            [
                "5 clips: 'Idle' (2.0 s) is used, the longest; others (--clip): 'Run' (1.0 s), 'Camera' (9.0 s), 'Run fast' (0.5 s), number 5 (0.1 s)"
            ]
        );
        let named = |name| choose(&clips, Some(name), &mut Notes::default());
        assert_eq!((named("Run").unwrap(), named("run").unwrap(), named("FAST").unwrap(), named("cam").unwrap()), (1, 1, 3, 2));
        let missing = named("walk").unwrap_err();
        assert!(missing.kind == Kind::Usage && missing.to_string().contains("'Run fast' (0.5 s)"), "{missing}");
        assert_eq!(
            choose(&clips[2..3], None, &mut Notes::default()).unwrap_err().found,
            "no animation of the file moves a joint"
        );
        assert_eq!(choose(&[], None, &mut Notes::default()).unwrap_err().found, "the file has no animation");
        let mut notes = Notes::default();
        assert_eq!(choose(&clips[..1], None, &mut notes).unwrap(), 0);
        assert!(notes.is_empty());
    }

    #[test]
    fn frames_are_where_the_keys_are() {
        let even: Vec<f64> = (0..25).map(|k| f64::from(k as f32 / 24.0)).collect();
        assert_eq!(Times::of_keys(even.clone()).unwrap(), Times { start: 0.0, end: 1.0, rate: 24.0, count: 25 });
        let holes: Vec<f64> = even.iter().enumerate().filter(|(k, _)| k % 5 != 1 && *k != 12).map(|(_, t)| *t).collect();
        assert_eq!(Times::of_keys(holes).unwrap(), Times { start: 0.0, end: 1.0, rate: 24.0, count: 25 });
        let beyond: Vec<f64> = even.iter().filter(|t| **t != 0.25).copied().chain([1.02]).collect();
        let beyond = Times::of_keys(beyond).unwrap();
        assert_eq!((beyond.rate, beyond.count, beyond.at(24)), (24.0, 25, 1.0));
        let late = Times::of_keys(even.iter().map(|t| t + 1.0 / 24.0).collect()).unwrap();
        assert_eq!((late.first_frame().unwrap(), late.count, late.at(24)), (1, 25, late.end));
        assert_eq!(Times::of_keys(vec![1e17]).unwrap().first_frame().unwrap_err().kind, Kind::Refused);
        let slow = Times::of_keys(vec![0.0, 5.5, 0.5, 1.0, 1.5, 2.0, 2.5, 3.0, 3.5, 4.0, 4.5, 5.0]).unwrap();
        assert_eq!((slow.rate, slow.count), (2.0, 12));
        let uneven = Times::of_keys(vec![0.0, 1e-4, 2e-4, 0.7, 1.0]).unwrap();
        assert_eq!((uneven.rate, uneven.count, uneven.at(240)), (240.0, 241, 1.0));
        assert_eq!(Times::of_keys(vec![3.0]).unwrap().count, 1);
        assert!(Times::of_keys(vec![f64::NAN]).is_none());
        assert!(Times::of_keys(vec![0.0, 1e30]).unwrap().count > 1);
    }
}
