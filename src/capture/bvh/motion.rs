//! The second half of a BVH file: the frame time and the rows of numbers.

use super::text::Text;
use crate::capture::{number, skeleton};
use crate::error::{Error, Notes, Result};

/// Frames per second where the file gives none that can be used.
const ASSUMED_RATE: f64 = 30.0;
/// Rates outside of these are said to be doubtful.
const USUAL_RATES: std::ops::RangeInclusive<f64> = 1.0..=2000.0;

/// Rows of numbers.
#[derive(Debug)]
pub(super) struct Rows {
    /// Row-major values, `rows × columns`; NaN where the file says so.
    pub(super) values: Vec<f64>,
    /// Frames per second; positive.
    pub(super) rate: f64,
}

/// Reads what follows the word `MOTION`.
///
/// # Errors
/// With row and line: rows with more or fewer numbers than there are channels (a row may be wrapped over several lines), words that are
/// no numbers; no row at all.
pub(super) fn read(text: &mut Text<'_>, columns: usize, fallback: Option<f64>, notes: &mut Notes) -> Result<Rows> {
    let (mut announced, mut time) = (None, None);
    while let Some(word) = text.peek().map(<[u8]>::to_ascii_uppercase).filter(|w| w.starts_with(b"FRAME")) {
        text.word();
        if let Some(value) = word.strip_prefix(b"FRAMES") {
            let value = value_after(text, value);
            announced = Some(number::parse(&value).ok_or_else(|| text.unexpected(&value).expected("the number of frames"))?);
        } else {
            let mut label = word[b"FRAME".len()..].to_owned();
            if label.is_empty() {
                label = text.word().unwrap_or_default().to_ascii_uppercase();
            }
            let Some(value) = label.strip_prefix(b"TIME") else {
                return Err(text.unexpected(&label).expected("Frames: or Frame Time:"));
            };
            let value = value_after(text, value);
            let seconds =
                number::parse(&value).ok_or_else(|| text.unexpected(&value).expected("the time of a frame in seconds"))?;
            let decimals = value.iter().rev().take_while(|b| b.is_ascii_digit()).count();
            time = Some((seconds, if value.contains(&b'.') || value.contains(&b',') { decimals } else { 0 }));
        }
    }
    let rate = rate(time, fallback, notes);
    let values = rows(text, columns, notes)?;
    let present = values.len() / columns;
    match announced {
        Some(n) if n != present as f64 => notes.warn(format!("Frames: says {n}, {present} rows are there: all of them are used")),
        None => notes.warn(format!("the number of frames is not given: {present} rows are there")),
        Some(_) => {}
    }
    Ok(Rows { values, rate })
}

/// The value of `Frames:5`, `Frames: 5` or `Frames : 5`, of which `tail` is what follows the name.
fn value_after(text: &mut Text<'_>, tail: &[u8]) -> Vec<u8> {
    let mut tail = tail.to_owned();
    if tail.is_empty() {
        // No colon yet: it is the next word, or the beginning of it, or missing.
        tail = text.word().unwrap_or_default().to_owned();
    }
    match tail.strip_prefix(b":") {
        Some([]) => text.word().unwrap_or_default().to_owned(),
        Some(value) => value.to_owned(),
        None => tail,
    }
}

fn rate(time: Option<(f64, usize)>, fallback: Option<f64>, notes: &mut Notes) -> f64 {
    let (found, rate) = match time {
        Some((seconds, decimals)) => (format!("Frame Time: is {seconds}"), skeleton::rate(seconds, decimals)),
        None => ("there is no Frame Time".to_owned(), f64::NAN),
    };
    if !(rate.is_finite() && rate > 0.0) {
        if fallback.is_none() {
            notes.warn(format!("{found}: {ASSUMED_RATE} frames per second are assumed"));
        }
        return fallback.unwrap_or(ASSUMED_RATE);
    }
    if !USUAL_RATES.contains(&rate) {
        notes.warn(format!("{found}, which makes {rate} frames per second: doubtful"));
    }
    rate
}

/// The row that is being read: it may go over several lines, and a line may hold several rows.
struct Row {
    /// Where its first line begins.
    start: usize,
    lines: usize,
    /// Numbers on the first line.
    first: usize,
}

fn rows(text: &mut Text<'_>, columns: usize, notes: &mut Notes) -> Result<Vec<f64>> {
    let (bytes, offset) = text.rest();
    let mut values: Vec<f64> = Vec::with_capacity(bytes.len() / 8);
    // Numbers of whole rows.
    let mut whole = 0;
    let mut row = Row { start: 0, lines: 0, first: 0 };
    let mut at = 0;
    while at < bytes.len() {
        let (start, before) = (at, values.len());
        if let Err(bad) = line(bytes, &mut at, &mut values) {
            text.back_to(offset + bad.end);
            let place = format!("row {}, line {}", whole / columns + 1, text.line(offset + bad.start));
            return Err(text.unexpected(&bytes[bad]).expected("a number").at(place));
        }
        if values.len() == before {
            continue;
        }
        if before == whole {
            row = Row { start, lines: 0, first: values.len() - before };
        }
        row.lines += 1;
        let gathered = values.len() - whole;
        if gathered == columns || (row.lines == 1 && gathered.is_multiple_of(columns)) {
            whole = values.len();
        } else if gathered > columns {
            return Err(Error::malformed(format!("row {} has {} numbers", whole / columns + 1, row.first))
                .at(format!("line {}", text.line(offset + row.start)))
                .expected(format!("{columns}, one for every channel")));
        }
    }
    let cut = values.len() - whole;
    if whole == 0 {
        return Err(if cut == 0 {
            skeleton::no_frames("there are no rows of motion")
        } else {
            Error::malformed(format!("the only row has {cut} numbers")).expected(format!("{columns}, one for every channel"))
        });
    }
    if cut > 0 {
        notes.warn(format!("the last row is cut short ({cut} of {columns} numbers): left out"));
        values.truncate(whole);
    }
    let broken = values.iter().filter(|v| v.is_nan()).count();
    if broken > 0 {
        notes.warn(format!("{} of the motion are not finite: their joints are missing there", super::counted(broken, "number")));
    }
    Ok(values)
}

/// Reads the numbers of one line and goes past its end; fails with the range of a word that is none.
fn line(bytes: &[u8], at: &mut usize, values: &mut Vec<f64>) -> Result<(), std::ops::Range<usize>> {
    let mut i = *at;
    loop {
        match bytes.get(i) {
            None => break,
            Some(b'\n' | b'\r') => {
                i += 1;
                break;
            }
            Some(&b) if super::text::blank(b) => i += 1,
            Some(&b) => {
                if b == b'#' || bytes[i..].starts_with(b"//") {
                    i += bytes[i..].iter().position(|b| matches!(b, b'\n' | b'\r')).unwrap_or(bytes.len() - i);
                    continue;
                }
                let start = i;
                while bytes.get(i).is_some_and(|&b| b > b' ') {
                    i += 1;
                }
                // A control character that is no blank is a word of its own.
                i = i.max(start + 1);
                values.push(super::number(&bytes[start..i]).ok_or(start..i)?);
            }
        }
    }
    *at = i;
    Ok(())
}
