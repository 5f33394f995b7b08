//! Markers in a plain table: one row per frame with three columns per marker, or one row per marker and frame.
//!
//! Wide: `frame,time,LASI_x,LASI_y,LASI_z,…`. Long: `frame,time,marker,x,y,z`. One of frame and time may be left out; columns may stand in
//! any order and others are passed over. Lines that begin with `#` may say `rate`, `unit` and `up` above the header. Cells are separated by
//! commas, semicolons or tabs; what is missing is left empty.

use super::ReadOptions;
use super::head::Head;
use super::table::{Grid, Lines, MOST_MARKERS, Separator, Table, decode, value, whole};
use crate::error::{Error, Notes, Result};
use crate::space::{Evidence, Known, Space};
use std::collections::BTreeMap;

const HEADER: &str = "a header such as frame,time,LASI_x,LASI_y,LASI_z,… or frame,marker,x,y,z";

/// Whether a table is one of markers: by the first line that is no comment.
pub(super) fn is_marker_table(head: &str) -> bool {
    let mut lines = Lines::new(head);
    let header = std::iter::from_fn(|| lines.next_said()).find(|(_, line)| !line.trim_start().starts_with('#'));
    header.is_some_and(|(_, line)| Columns::of(line).is_some_and(|c| !matches!(c.place, Place::Wide(ref m) if m.is_empty())))
}

/// Reads a table.
///
/// # Errors
/// A header without markers, rows that break the form, with their line.
pub(super) fn read(bytes: &[u8], options: &ReadOptions) -> Result<Table> {
    let text = decode(bytes);
    let mut lines = Lines::new(&text);
    let mut said = Said::default();
    let header = loop {
        match lines.next_said() {
            Some((_, line)) if line.trim_start().starts_with('#') => said.comment(line),
            Some(header) => break header,
            None => return Err(Error::malformed("the table is empty").expected(HEADER)),
        }
    };
    let columns = Columns::of(header.1).ok_or_else(|| {
        Error::malformed("no column is a frame, a time or a marker").at(format!("line {}", header.0)).expected(HEADER)
    })?;
    let mut grid = Grid::new(bytes.len());
    let mut notes = Notes::default();
    if columns.other > 0 {
        notes.warn(format!("{} columns are neither frame, time nor the coordinate of a marker: passed over", columns.other));
    }
    let labels = match &columns.place {
        Place::Wide(markers) => {
            if markers.is_empty() {
                return Err(Error::malformed("no marker has three columns").at(format!("line {}", header.0)).expected(HEADER));
            }
            wide(&mut lines, &columns, markers, &mut grid)?;
            markers.iter().map(|m| m.0.clone()).collect()
        }
        Place::Long { name, xyz } => long(&mut lines, &columns, *name, *xyz, &mut grid)?,
    };
    if grid.rows() == 0 {
        return Err(Error::malformed("there is no row below the header").expected("one row per frame"));
    }
    if grid.columns() == 0 {
        return Err(Error::malformed("no row has a position").expected("three numbers per marker"));
    }
    let (first_frame, rate) = grid.clock(said.rate, options.rate, &mut notes);
    grid.remark(&mut notes);
    notes.extend(said.notes);
    let head = Head { labels, labelled: true, rate, first_frame, space: said.space, notes, ..Head::default() };
    Ok(Table { head, grid })
}

/// What comments say.
#[derive(Debug, Default)]
struct Said {
    rate: Option<f64>,
    space: Space,
    notes: Notes,
}

impl Said {
    /// `# rate 120`, `# unit: mm`, `# up = Z`; anything else is only a comment.
    fn comment(&mut self, line: &str) {
        let line = line.trim().trim_start_matches('#').trim();
        let Some((key, text)) = line.split_once(|c: char| c.is_whitespace() || c == ':' || c == '=') else { return };
        let text = text.trim_matches(|c: char| c.is_whitespace() || ":=,;".contains(c));
        let ignored = |notes: &mut Notes| notes.warn(format!("the comment '{key} {text}' makes no sense: ignored"));
        match key.to_ascii_lowercase().as_str() {
            "rate" | "fps" => match text.trim_end_matches(|c: char| c.is_ascii_alphabetic()).trim().parse() {
                Ok(rate) => self.rate = Some(rate),
                Err(_) => ignored(&mut self.notes),
            },
            "unit" | "units" => match text.parse() {
                Ok(unit) => self.space.unit = Some(Known::new(unit, Evidence::File)),
                Err(_) => ignored(&mut self.notes),
            },
            "up" => match text.parse() {
                Ok(up) => self.space.up = Some(Known::new(up, Evidence::File)),
                Err(_) => ignored(&mut self.notes),
            },
            _ => {}
        }
    }
}

/// What the columns hold.
#[derive(Debug)]
struct Columns {
    separator: Separator,
    count: usize,
    frame: Option<usize>,
    time: Option<usize>,
    place: Place,
    /// Columns of no use.
    other: usize,
}

#[derive(Debug)]
enum Place {
    /// Markers with the columns of their coordinates.
    Wide(Vec<(String, [usize; 3])>),
    /// Column of the marker's name, and those of the coordinates.
    Long { name: usize, xyz: [usize; 3] },
}

impl Columns {
    /// Reads a header; `None` where it has neither frame nor time, or no place for a marker.
    fn of(header: &str) -> Option<Self> {
        let separator = Separator::of(header);
        let mut cells = Vec::new();
        separator.split(header, &mut cells);
        if cells.len() > 3 * MOST_MARKERS {
            return None;
        }
        let bare: Vec<String> = cells.iter().map(|c| c.to_ascii_lowercase()).collect();
        let find = |names: &[&str]| bare.iter().position(|c| names.contains(&c.as_str()));
        let frame = find(&["frame", "frame#", "frame number", "frame_number", "frameno"]);
        let time = find(&["time", "t", "time (s)", "time (seconds)", "time_s", "seconds", "timestamp"]);
        if frame.is_none() && time.is_none() {
            return None;
        }
        let named = usize::from(frame.is_some()) + usize::from(time.is_some());
        if let (Some(name), Some(x), Some(y), Some(z)) = (find(&["marker", "label"]), find(&["x"]), find(&["y"]), find(&["z"])) {
            let other = cells.len() - named - 4;
            return Some(Self { separator, count: cells.len(), frame, time, place: Place::Long { name, xyz: [x, y, z] }, other });
        }
        let mut markers: Vec<(String, [Option<usize>; 3])> = Vec::new();
        let mut place: BTreeMap<&str, usize> = BTreeMap::new();
        for (column, cell) in cells.iter().enumerate().filter(|(c, _)| Some(*c) != frame && Some(*c) != time) {
            let Some((name, axis)) = coordinate(cell) else { continue };
            // A name that comes again is another marker of the same name.
            let marker = match place.get(name) {
                Some(&m) if markers[m].1[axis].is_none() => m,
                _ => {
                    place.insert(name, markers.len());
                    markers.push((name.to_owned(), [None; 3]));
                    markers.len() - 1
                }
            };
            markers[marker].1[axis] = Some(column);
        }
        let markers: Vec<(String, [usize; 3])> =
            markers.into_iter().filter_map(|(name, [x, y, z])| Some((name, [x?, y?, z?]))).collect();
        let other = cells.len() - named - 3 * markers.len();
        Some(Self { separator, count: cells.len(), frame, time, place: Place::Wide(markers), other })
    }

    /// Frame number and time of a row.
    fn when(&self, cells: &[&str]) -> Result<(Option<i64>, f64)> {
        let number = match self.frame.map(|f| cells[f]) {
            None | Some("") => None,
            Some(text) => {
                Some(whole(text).ok_or_else(|| Error::malformed(format!("frame '{text}'")).expected("a whole number"))?)
            }
        };
        let time = self.time.map_or(Ok(f64::NAN), |t| {
            value(cells[t]).ok_or_else(|| Error::malformed(format!("time '{}'", cells[t])).expected("seconds"))
        })?;
        Ok((number, time))
    }

    fn split<'a>(&self, line: &'a str, cells: &mut Vec<&'a str>) -> Result<()> {
        self.separator.split(line, cells);
        // Empty cells at the end are often left out.
        if cells.len() > self.count && cells[self.count..].iter().any(|c| !c.is_empty()) {
            return Err(Error::malformed(format!("{} cells", cells.len())).expected(format!("{} as in the header", self.count)));
        }
        cells.resize(self.count, "");
        Ok(())
    }
}

/// `LASI_x`, `LASI.X`, `LASI:x`, `LASI X`, `LASI-Y` → the name and the axis.
fn coordinate(cell: &str) -> Option<(&str, usize)> {
    let axis = match cell.chars().next_back()? {
        'x' | 'X' => 0,
        'y' | 'Y' => 1,
        'z' | 'Z' => 2,
        _ => return None,
    };
    let name = cell[..cell.len() - 1].strip_suffix(['_', '.', ':', ' ', '-'])?.trim();
    (!name.is_empty()).then_some((name, axis))
}

fn position(cells: &[&str], columns: [usize; 3]) -> Result<[f64; 3]> {
    let mut p = [0.0; 3];
    for (p, column) in p.iter_mut().zip(columns) {
        let text = cells[column];
        *p = value(text).ok_or_else(|| {
            Error::malformed(format!("column {} is '{}'", column + 1, text.chars().take(20).collect::<String>()))
                .expected("a number, or nothing where the marker is missing")
        })?;
    }
    Ok(p)
}

fn wide(lines: &mut Lines<'_>, columns: &Columns, markers: &[(String, [usize; 3])], grid: &mut Grid) -> Result<()> {
    let mut cells = Vec::new();
    while let Some((number, line)) = lines.next_said() {
        if line.trim_start().starts_with('#') {
            continue;
        }
        let mut row = || -> Result<()> {
            columns.split(line, &mut cells)?;
            for (_, xyz) in markers {
                grid.push(position(&cells, *xyz)?);
            }
            let (frame, time) = columns.when(&cells)?;
            grid.end_row(frame, time);
            Ok(())
        };
        row().map_err(|e| e.at(format!("line {number}")))?;
    }
    Ok(())
}

/// The rows of one frame.
struct Frame {
    number: Option<i64>,
    time: f64,
    /// Marker, position, line.
    points: Vec<(usize, [f64; 3], usize)>,
}

/// One row per marker and frame; returns the labels. The rows of a frame need not stand together.
fn long(lines: &mut Lines<'_>, columns: &Columns, name: usize, xyz: [usize; 3], grid: &mut Grid) -> Result<Vec<String>> {
    let mut labels: Vec<String> = Vec::new();
    let mut place: BTreeMap<String, usize> = BTreeMap::new();
    // Frames in order: by number, else by time.
    let order = |frame: Option<i64>, time: f64| frame.unwrap_or_else(|| (time * 1e6).round() as i64);
    let mut rows: BTreeMap<i64, Frame> = BTreeMap::new();
    let mut cells = Vec::new();
    while let Some((number, line)) = lines.next_said() {
        if line.trim_start().starts_with('#') {
            continue;
        }
        let mut row = || -> Result<()> {
            columns.split(line, &mut cells)?;
            let (frame, time) = columns.when(&cells)?;
            if frame.is_none() && time.is_nan() {
                return Err(Error::malformed("a row without frame and time").expected("a number"));
            }
            let label = cells[name];
            let marker = match place.get(label) {
                Some(&m) => m,
                None if labels.len() == MOST_MARKERS => {
                    return Err(Error::malformed("too many markers").expected("at most 65,535"));
                }
                None => {
                    place.insert(label.to_owned(), labels.len());
                    labels.push(label.to_owned());
                    labels.len() - 1
                }
            };
            let p = position(&cells, xyz)?;
            let at = rows.entry(order(frame, time)).or_insert_with(|| Frame { number: frame, time, points: Vec::new() });
            at.points.push((marker, p, number));
            Ok(())
        };
        row().map_err(|e| e.at(format!("line {number}")))?;
    }
    let size = rows.values().map(|f| f.points.iter().map(|p| p.0 + 1).max().unwrap_or(0)).sum();
    grid.check_size(size)?;
    for Frame { number: frame, time, mut points } in rows.into_values() {
        points.sort_by_key(|(marker, _, line)| (*marker, *line));
        if let Some(pair) = points.windows(2).find(|w| w[0].0 == w[1].0) {
            return Err(Error::malformed(format!("marker {} has a second place in the frame", labels[pair[1].0]))
                .at(format!("line {}", pair[1].2))
                .expected(format!("one row for each marker and frame; the other is in line {}", pair[0].2)));
        }
        let mut column = 0;
        for (marker, p, _) in points {
            while column < marker {
                grid.push([f64::NAN; 3]);
                column += 1;
            }
            grid.push(p);
            column += 1;
        }
        grid.end_row(frame, time);
    }
    Ok(labels)
}
