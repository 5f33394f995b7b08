//! TRC tables of markers, as Motion Analysis, Kaydara, OpenSim and many scripts write them.
//!
//! Five lines of header, then one row per frame: number, time, three cells per marker. Files differ in what stands between the cells, in
//! how many cells the rows have, and their counts are often wrong; so the rows are believed, and the header only for rate and unit.

use super::ReadOptions;
use super::head::Head;
use super::table::{Grid, Lines, MOST_MARKERS, Separator, Table, decode, value, whole};
use crate::error::{Error, Notes, Result};
use crate::space::{Evidence, Known, Space, Unit};

/// Lines in which the header must be complete.
const HEADER_LINES: usize = 64;

/// Reads a table.
///
/// # Errors
/// A header without the line of names, a file without rows, and cells that are neither a number nor one of the marks for none.
pub(super) fn read(bytes: &[u8], options: &ReadOptions) -> Result<Table> {
    let text = decode(bytes);
    let mut lines = Lines::new(&text);
    let mut notes = Notes::default();
    let header = Header::read(&mut lines)?;
    let mut grid = Grid::new(bytes.len());
    rows(&mut lines, &header, &mut grid, &mut notes)?;
    if grid.rows() == 0 {
        return Err(Error::malformed("there is no row below the header").expected("one row per frame"));
    }

    let named = header.names.len();
    if let Some(n) = header.markers.filter(|n| *n != named as f64) {
        notes.warn(format!("the header announces {n} markers, the line of names has {named}: the names are believed"));
    }
    if let Some(n) = header.frames.filter(|n| *n != grid.rows() as f64) {
        notes.warn(format!("the header announces {n} frames, {} are there", grid.rows()));
    }
    let mut labels = header.names;
    let extra = grid.columns().saturating_sub(named);
    if extra > 0 && named > 0 {
        notes.warn(format!("{extra} columns of positions without a name behind the named ones"));
    }
    labels.extend((named..named + extra).map(|n| if named == 0 { String::new() } else { format!("*{}", n + 1) }));
    let labelled = labels.iter().any(|l| !l.is_empty());
    if labels.is_empty() {
        return Err(Error::malformed("no row has a position").expected("three cells per marker"));
    }
    let (first_frame, rate) = grid.clock(header.rate, options.rate, &mut notes);
    grid.remark(&mut notes);
    let unit = header.unit.as_deref().and_then(|word| match word.parse::<Unit>() {
        Ok(unit) => Some(Known::new(unit, Evidence::File)),
        Err(_) => {
            notes.warn(format!("Units '{word}' is not a unit of length: ignored"));
            None
        }
    });
    let space = Space { unit, ..Space::default() };
    let head = Head { labels, labelled, rate, first_frame, space, notes, ..Head::default() };
    Ok(Table { head, grid })
}

/// What stands above the rows.
#[derive(Debug)]
struct Header {
    rate: Option<f64>,
    unit: Option<String>,
    markers: Option<f64>,
    frames: Option<f64>,
    /// One name per marker; empty where a column has none.
    names: Vec<String>,
    separator: Separator,
}

impl Header {
    /// Reads up to the line of names and the one of axes below it.
    fn read(lines: &mut Lines<'_>) -> Result<Self> {
        let mut header =
            Self { rate: None, unit: None, markers: None, frames: None, names: Vec::new(), separator: Separator::Blanks };
        let begins = |line: &str, word: &str| line.trim_start().get(..word.len()).is_some_and(|w| w.eq_ignore_ascii_case(word));
        let mut last = 0;
        while let Some((number, line)) = lines.next_said().filter(|(number, _)| *number <= HEADER_LINES) {
            last = number;
            if begins(line, "DataRate") {
                let Some((_, values)) = lines.next_said() else { break };
                header.values(line, values);
            } else if begins(line, "Frame") {
                header.names(line).map_err(|e| e.at(format!("line {number}")))?;
                let mut ahead = lines.clone();
                if ahead.next_said().is_some_and(|(_, line)| axes(line)) {
                    *lines = ahead;
                }
                return Ok(header);
            }
        }
        Err(Error::malformed("the header ends before the line of marker names")
            .at(format!("line {}", last.max(1)))
            .expected("a TRC table: a line that begins with Frame# and Time"))
    }

    /// The line of values under the line of their names. The cells of the two may be separated differently.
    fn values(&mut self, names: &str, values: &str) {
        let parts = |line: &str| -> Vec<String> {
            let (separator, mut cells) = (Separator::of(line), Vec::new());
            separator.split(line, &mut cells);
            cells.into_iter().map(str::to_owned).collect()
        };
        let said =
            |cells: &[String]| -> Vec<String> { cells.iter().flat_map(|c| c.split_whitespace()).map(str::to_owned).collect() };
        let (mut names, mut values) = (parts(names), parts(values));
        // Where no cell is left out, doubled separators and padding are what makes the lines differ.
        if said(&names).len() <= said(&values).len() {
            (names, values) = (said(&names), said(&values));
        }
        let get = |name: &str| {
            let place = names.iter().position(|n| n.eq_ignore_ascii_case(name))?;
            values.get(place).map(String::as_str).filter(|v| !v.is_empty())
        };
        let number = |name: &str| get(name).and_then(value).filter(|v| v.is_finite());
        self.rate = number("DataRate").filter(|r| *r > 0.0).or_else(|| number("CameraRate"));
        self.markers = number("NumMarkers");
        self.frames = number("NumFrames");
        self.unit = get("Units").map(str::to_owned);
    }

    /// The line of names: every third cell, or every cell where the empty ones were left out.
    fn names(&mut self, line: &str) -> Result<()> {
        let mut cells = Vec::new();
        let spaced = |cells: &[&str]| cells.iter().skip(2).enumerate().all(|(k, c)| k % 3 == 0 || c.is_empty());
        self.separator = Separator::of(line);
        if self.separator == Separator::Blanks {
            // Single blanks around empty cells, as a table that was written with blanks for tabs has them.
            Separator::Each(' ').split(line, &mut cells);
            if spaced(&cells) && cells.len() > 3 {
                self.separator = Separator::Each(' ');
            }
        }
        self.separator.split(line, &mut cells);
        let length = cells.iter().rposition(|c| !c.is_empty()).map_or(0, |last| last + 1);
        let step = if spaced(&cells) { 3 } else { 1 };
        self.names = cells[..length].iter().skip(2).step_by(step).map(|c| (*c).to_owned()).collect();
        if step == 1 {
            self.names.retain(|n| !n.is_empty());
        }
        if self.names.len() > MOST_MARKERS {
            return Err(Error::malformed(format!("{} names", self.names.len())).expected("at most 65,535 markers"));
        }
        Ok(())
    }
}

impl Header {
    /// Checks the number of cells in a row.
    fn check(&self, cells: &[&str]) -> Result<()> {
        let (count, named) = (cells.len(), self.names.len());
        if count > 2 + 3 * MOST_MARKERS {
            return Err(Error::malformed(format!("{count} cells")).expected("at most 65,535 markers"));
        }
        // Between blanks no cell can be empty, so a missing one would shift all others.
        if self.separator == Separator::Blanks && named > 0 && count != 2 + 3 * named {
            return Err(Error::malformed(format!("{count} cells")).expected(format!("{} for {named} markers", 2 + 3 * named)));
        }
        Ok(())
    }
}

/// Whether a line is the one of axes, `X1 Y1 Z1 X2 …`, and not a row.
fn axes(line: &str) -> bool {
    let first = line.trim_start_matches(|c: char| c.is_whitespace() || ",;\"".contains(c));
    first.starts_with(['X', 'x', 'Y', 'y', 'Z', 'z'])
}

fn rows(lines: &mut Lines<'_>, header: &Header, grid: &mut Grid, notes: &mut Notes) -> Result<()> {
    let mut cells = Vec::new();
    let mut before = 0;
    while let Some((number, line)) = lines.next_said() {
        header.separator.split(line, &mut cells);
        let cut = lines.stops() && grid.rows() > 0;
        let read = header.check(&cells).and_then(|()| row(&cells, grid));
        if cut && (read.is_err() || cells.len() < before) {
            if read.is_ok() {
                grid.drop_row()
            } else {
                grid.drop_open()
            }
            notes.warn(format!("the last row is cut short: left out (line {number})"));
            return Ok(());
        }
        read.map_err(|e| e.at(format!("line {number}")))?;
        before = cells.len();
    }
    Ok(())
}

/// One row: number, time, three cells per marker.
fn row(cells: &[&str], grid: &mut Grid) -> Result<()> {
    let cell = |n: usize| cells.get(n).copied().unwrap_or_default();
    let number = match cell(0) {
        "" => None,
        text => Some(whole(text).ok_or_else(|| Error::malformed(format!("frame '{text}'")).expected("a whole number"))?),
    };
    let read = |n: usize| {
        let text = cell(n);
        value(text).ok_or_else(|| {
            Error::malformed(format!("cell {} is '{}'", n + 1, text.chars().take(20).collect::<String>()))
                .expected("a number, or nothing where the marker is missing")
        })
    };
    let time = read(1)?;
    for n in (2..cells.len()).step_by(3) {
        grid.push([read(n)?, read(n + 1)?, read(n + 2)?]);
    }
    grid.end_row(number, time);
    Ok(())
}
