//! What tables of markers have in common, whatever program wrote them: cells of text, numbers that stand for nothing, frame numbers and
//! times, rows of different lengths.

use super::head::Head;
use super::number;
use crate::error::{Error, Notes, Result};
use crate::statistics::middle;
use crate::words;
use glam::DVec3;
use std::borrow::Cow;

/// A table of markers that was read.
#[derive(Debug)]
pub(super) struct Table {
    pub(super) head: Head,
    pub(super) grid: Grid,
}

/// More markers than this in one row are a damaged file.
pub(super) const MOST_MARKERS: usize = 65_535;
/// No marker is this far from the others in any unit in use (10 km in mm).
const HUGE: f64 = 1e7;
/// Farther from zero than this, positions are stored from an origin of their own: single precision then keeps 0.001 units.
pub(super) const FAR: f64 = 4096.0;
/// Positions that tell where a take is.
const ENOUGH: usize = 512;

/// The text of a file: UTF-8 with or without a mark, UTF-16 with one, else Latin-1.
pub(super) fn decode(bytes: &[u8]) -> Cow<'_, str> {
    let wide = |rest: &[u8], unit: fn([u8; 2]) -> u16| {
        let units: Vec<u16> = rest.chunks_exact(2).map(|b| unit([b[0], b[1]])).collect();
        Cow::Owned(String::from_utf16_lossy(&units))
    };
    match bytes {
        [0xff, 0xfe, rest @ ..] => wide(rest, u16::from_le_bytes),
        [0xfe, 0xff, rest @ ..] => wide(rest, u16::from_be_bytes),
        _ => {
            let bytes = bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes);
            std::str::from_utf8(bytes).map_or_else(|_| Cow::Owned(bytes.iter().map(|b| char::from(*b)).collect()), Cow::Borrowed)
        }
    }
}

/// Lines with their numbers, from 1; any line ends.
#[derive(Clone, Debug)]
pub(super) struct Lines<'a> {
    rest: &'a str,
    number: usize,
    ended: bool,
}

impl<'a> Lines<'a> {
    pub(super) fn new(text: &'a str) -> Self {
        Self { rest: text, number: 0, ended: true }
    }

    /// The next line that is not empty.
    pub(super) fn next_said(&mut self) -> Option<(usize, &'a str)> {
        self.find(|(_, line)| !line.trim().is_empty())
    }

    /// Whether the file stops within the line that came last.
    pub(super) fn stops(&self) -> bool {
        !self.ended
    }
}

impl<'a> Iterator for Lines<'a> {
    type Item = (usize, &'a str);

    fn next(&mut self) -> Option<Self::Item> {
        if self.rest.is_empty() {
            return None;
        }
        self.number += 1;
        let end = self.rest.bytes().position(|b| b == b'\n' || b == b'\r').unwrap_or(self.rest.len());
        let (line, rest) = self.rest.split_at(end);
        self.ended = !rest.is_empty();
        self.rest = rest.strip_prefix("\r\n").or_else(|| rest.strip_prefix(['\n', '\r'])).unwrap_or(rest);
        Some((self.number, line))
    }
}

/// What stands between cells.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Separator {
    /// This character; two of them enclose an empty cell.
    Each(char),
    /// Any number of blanks.
    Blanks,
}

impl Separator {
    /// The strongest one in a line.
    pub(super) fn of(line: &str) -> Self {
        ['\t', ';', ','].into_iter().find(|c| line.contains(*c)).map_or(Self::Blanks, Self::Each)
    }

    /// The cells of a line, without blanks and quotes around them.
    pub(super) fn split<'a>(self, line: &'a str, cells: &mut Vec<&'a str>) {
        cells.clear();
        match self {
            Self::Blanks => cells.extend(line.split_whitespace()),
            Self::Each(c) if !line.contains('"') => cells.extend(line.split(c).map(str::trim)),
            Self::Each(c) => {
                let mut quoted = false;
                let parts = line.split(|x: char| {
                    quoted ^= x == '"';
                    x == c && !quoted
                });
                cells.extend(parts.map(|cell| {
                    let cell = cell.trim();
                    cell.strip_prefix('"').and_then(|c| c.strip_suffix('"')).unwrap_or(cell).trim()
                }));
            }
        }
    }
}

/// A number, NaN where the cell says in one of many ways that there is none, `None` where it is neither.
pub(super) fn value(cell: &str) -> Option<f64> {
    const NONE: [&str; 9] = ["na", "n/a", "null", "none", "missing", "-", "--", "---", "."];
    match number::parse(cell.as_bytes()) {
        Some(value) => Some(value),
        None if cell.is_empty() || NONE.iter().any(|n| cell.eq_ignore_ascii_case(n)) => Some(f64::NAN),
        None => None,
    }
}

/// A whole number, also written as `7.0`; `None` for anything else.
pub(super) fn whole(cell: &str) -> Option<i64> {
    value(cell).filter(|x| x.fract() == 0.0 && x.abs() <= number::LARGEST_FRAME as f64).map(|x| x as i64)
}

/// Whether three coordinates are one of the marks that programs write for a missing point: zeros, nines, a huge number.
fn stands_for_none(p: [f64; 3]) -> bool {
    let nines = |x: f64| [9999.0, 99_999.0, 999_999.0, 9_999_999.0, 99_999_999.0, 999_999_999.0].contains(&x);
    p[0] == p[1] && p[1] == p[2] && (p[0] == 0.0 || nines(p[0].abs()) || p[0].abs() >= 1e9)
}

/// Rows of positions, of different lengths, with their frame numbers and times.
#[derive(Debug, Default)]
pub(super) struct Grid {
    rows: Vec<Row>,
    /// Positions of all rows from the origin, without those missing at their ends.
    points: Vec<[f32; 3]>,
    origin: Option<DVec3>,
    /// Positions so far, by their place in `points`, as long as the origin is not known.
    early: Vec<(usize, DVec3)>,
    /// Longest row.
    columns: usize,
    /// Empty frames before each row, where frame numbers are left out.
    lost: Vec<(usize, usize)>,
    /// Positions that are numbers which stand for none.
    marks: usize,
    /// Positions of which only one or two coordinates are there.
    parts: usize,
    /// Positions far from all others.
    huge: usize,
    /// Size of the file, against which that of the take is measured.
    bytes: usize,
}

#[derive(Clone, Copy, Debug)]
struct Row {
    /// First place behind the row in the points.
    end: usize,
    number: Option<i64>,
    time: f64,
}

impl Grid {
    /// A grid for the table of a file with so many bytes.
    pub(super) fn new(bytes: usize) -> Self {
        Self { bytes, ..Self::default() }
    }

    /// Number of rows.
    pub(super) fn rows(&self) -> usize {
        self.rows.len()
    }

    /// Length of the longest row.
    pub(super) fn columns(&self) -> usize {
        self.columns
    }

    /// Adds a position to the row that is being filled; any coordinate may be NaN.
    pub(super) fn push(&mut self, p: [f64; 3]) {
        let missing = p.iter().filter(|c| !c.is_finite()).count();
        if missing > 0 || stands_for_none(p) {
            self.marks += usize::from(missing == 0 && p[0] != 0.0);
            self.parts += usize::from(missing == 1 || missing == 2);
            self.points.push([f32::NAN; 3]);
            return;
        }
        let p = DVec3::from_array(p);
        match self.origin {
            Some(origin) => self.store(self.points.len(), p, origin),
            None => {
                self.early.push((self.points.len(), p));
                self.points.push([f32::NAN; 3]);
                if self.early.len() >= ENOUGH {
                    self.settle();
                }
            }
        }
    }

    fn store(&mut self, place: usize, p: DVec3, origin: DVec3) {
        let from = p - origin;
        let far = from.abs().max_element() > HUGE;
        self.huge += usize::from(far);
        let stored = if far { [f32::NAN; 3] } else { from.as_vec3().to_array() };
        match self.points.get_mut(place) {
            Some(point) => *point = stored,
            None => self.points.push(stored),
        }
    }

    /// Takes the middle of the positions so far for the origin, where it is far from zero.
    fn settle(&mut self) {
        if self.origin.is_some() {
            return;
        }
        let mut origin = DVec3::ZERO;
        for axis in 0..3 {
            let mut values: Vec<f64> = self.early.iter().map(|(_, p)| p[axis]).collect();
            let Some(median) = middle(&mut values) else { break };
            if median.abs() > FAR && median.abs() < 1e15 {
                origin[axis] = median.round();
            }
        }
        self.origin = Some(origin);
        for (place, p) in std::mem::take(&mut self.early) {
            self.store(place, p, origin);
        }
    }

    /// Ends the row.
    pub(super) fn end_row(&mut self, number: Option<i64>, time: f64) {
        let start = self.rows.last().map_or(0, |r| r.end);
        let known = |(place, p): (usize, &[f32; 3])| !p[0].is_nan() || self.early.binary_search_by_key(&place, |e| e.0).is_ok();
        let length = (start..self.points.len()).rev().find(|i| known((*i, &self.points[*i]))).map_or(0, |last| last + 1 - start);
        self.points.truncate(start + length);
        self.columns = self.columns.max(length);
        self.rows.push(Row { end: start + length, number, time });
    }

    /// Takes the last row back.
    pub(super) fn drop_row(&mut self) {
        self.rows.pop();
        self.drop_open();
    }

    /// Takes the row back that is being filled.
    pub(super) fn drop_open(&mut self) {
        self.points.truncate(self.rows.last().map_or(0, |r| r.end));
        let length = self.points.len();
        self.early.retain(|e| e.0 < length);
    }

    /// Settles the numbers of frames and their rate; the rate is the declared one unless the times contradict it.
    ///
    /// Returns the number of the first frame and the rate.
    pub(super) fn clock(&mut self, declared: Option<f64>, given: Option<f64>, notes: &mut Notes) -> (i64, f64) {
        self.settle();
        let first = self.number(notes);
        (first, self.rate(declared, given, notes))
    }

    /// Number of the first frame; rows that are left out become empty frames.
    fn number(&mut self, notes: &mut Notes) -> i64 {
        let numbers: Vec<i64> = self.rows.iter().filter_map(|r| r.number).collect();
        let Some(&first) = numbers.first() else { return 1 };
        if numbers.len() < self.rows.len() {
            notes.warn(format!("{} without a frame number: counted on", words::plural(self.rows.len() - numbers.len(), "row")));
            return first;
        }
        let steps = || numbers.windows(2).map(|w| w[1] - w[0]);
        let lost: i64 = steps().map(|s| (s - 1).max(0)).fold(0, i64::saturating_add);
        if let Some(back) = steps().position(|s| s <= 0) {
            notes.warn(format!(
                "frame {} comes after frame {}: the frames are counted on from {first}",
                numbers[back + 1],
                numbers[back]
            ));
        } else if lost > 0 && steps().all(|s| s == numbers[1] - first) {
            notes.warn(format!("every {} frame is there: they are counted on from {first}", ordinal(numbers[1] - first)));
        } else if lost as u64 > self.rows.len() as u64 {
            notes.warn(format!(
                "{lost} frames between {first} and {} are not there: counted on from {first}",
                numbers[numbers.len() - 1]
            ));
        } else if lost > 0 {
            notes.warn(format!("{} left out of the table: gaps", words::plural(lost as usize, "frame")));
            self.lost = steps().enumerate().filter(|(_, s)| *s > 1).map(|(row, s)| (row + 1, s as usize - 1)).collect();
        }
        first
    }

    fn rate(&self, declared: Option<f64>, given: Option<f64>, notes: &mut Notes) -> f64 {
        /// Used where nothing says so; the speed of the result is then arbitrary, its shape is not.
        const ASSUMED: f64 = 100.0;
        let usable = |r: &f64| r.is_finite() && *r > 0.0 && *r < 1e6;
        let declared = declared.filter(usable);
        let spans = self.frames().saturating_sub(1) as f64;
        let rises = self.rows.windows(2).all(|w| w[1].time > w[0].time);
        let seconds = match (self.rows.first(), self.rows.last()) {
            (Some(first), Some(last)) if rises => last.time - first.time,
            _ => f64::NAN,
        };
        // Times are often rounded to milliseconds.
        let rounding = 0.0011 / seconds;
        let timed = Some(spans / seconds).filter(|r| usable(r) && rounding < 0.2);
        let near = |a: f64, b: f64| (a - b).abs() <= a * rounding.max(0.01);
        let shown = |r: f64| words::digits((r * 1e3).round() / 1e3);
        match (declared, timed) {
            (Some(rate), Some(other)) if !near(other, rate) => {
                notes.warn(format!("the header says {} Hz, the times {} Hz: the times are believed", shown(rate), shown(other)));
                other
            }
            (Some(rate), _) => rate,
            (None, Some(rate)) => {
                let even = rate.round().max(1.0);
                if (rate - even).abs() <= rate * (2.0 * rounding).min(0.01) { even } else { rate }
            }
            (None, None) => {
                let rate = given.filter(usable).unwrap_or(ASSUMED);
                notes.warn(format!("the file has no frame rate: {} Hz taken", shown(rate)));
                rate
            }
        }
    }

    /// Says what was met on the way.
    pub(super) fn remark(&self, notes: &mut Notes) {
        let said = [
            (self.marks, "numbers such as 9999999 that stand for none"),
            (self.huge, "beyond any room"),
            (self.parts, "incomplete"),
        ];
        for (count, what) in said.into_iter().filter(|(count, _)| *count > 0) {
            notes.warn(format!(
                "{} {what}: gaps",
                if count == 1 { "1 position is".to_owned() } else { format!("{count} positions are") }
            ));
        }
    }

    /// Frames, with those that are left out.
    pub(super) fn frames(&self) -> usize {
        self.rows.len() + self.lost.iter().map(|l| l.1).sum::<usize>()
    }

    /// Values of all rows with `empty` ones for the frames that are left out; `width` values per row.
    pub(super) fn spread<T: Copy>(&self, values: Vec<T>, width: usize, empty: T) -> Vec<T> {
        if self.lost.is_empty() {
            return values;
        }
        let mut spread = Vec::with_capacity(self.frames() * width);
        let mut lost = self.lost.iter().peekable();
        for (n, row) in values.chunks_exact(width).take(self.rows.len()).enumerate() {
            if let Some((_, count)) = lost.next_if(|l| l.0 == n) {
                spread.resize(spread.len() + count * width, empty);
            }
            spread.extend_from_slice(row);
        }
        spread
    }

    /// Checks that so many positions are not absurd for a file of this size.
    ///
    /// # Errors
    /// A table whose rows are so uneven that the take would be many times larger than the file.
    pub(super) fn check_size(&self, positions: usize) -> Result<()> {
        const LARGEST_RATIO: usize = 16;
        const ALWAYS_ALLOWED: usize = 1 << 20;
        if positions.saturating_mul(12) > LARGEST_RATIO * self.bytes + ALWAYS_ALLOWED {
            return Err(Error::malformed(format!(
                "a table of {} bytes for {positions} positions, hardly any of which is there",
                self.bytes
            ))
            .expected("rows of about the same length"));
        }
        Ok(())
    }

    /// Positions of some columns, frame-major, and what they count from.
    ///
    /// # Errors
    /// A table whose rows are so uneven that the take would be many times larger than the file.
    pub(super) fn dense(mut self, columns: &[usize]) -> Result<(Vec<[f32; 3]>, DVec3)> {
        self.settle();
        let frames = self.frames();
        self.check_size(frames.saturating_mul(columns.len()))?;
        let mut points = Vec::with_capacity(frames * columns.len());
        let mut lost = self.lost.iter().peekable();
        let mut start = 0;
        for (n, row) in self.rows.iter().enumerate() {
            if let Some((_, count)) = lost.next_if(|l| l.0 == n) {
                points.resize(points.len() + count * columns.len(), [f32::NAN; 3]);
            }
            let cells = &self.points[start..row.end];
            points.extend(columns.iter().map(|c| cells.get(*c).copied().unwrap_or([f32::NAN; 3])));
            start = row.end;
        }
        Ok((points, self.origin.unwrap_or(DVec3::ZERO)))
    }
}

/// `second`, `third`, `4th`.
fn ordinal(n: i64) -> String {
    match n {
        2 => "second".into(),
        3 => "third".into(),
        n => format!("{n}th"),
    }
}
