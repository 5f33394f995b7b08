//! Tables of handles: `frame,name,x,y,z[,qx,qy,qz,qw]`, one row per handle and frame, in the scan's coordinates and unit.
//!
//! The first line names the columns, in any order. Empty lines and lines that begin with `#` are passed over; a name with a comma stands
//! in double quotes. A handle without a row in a frame, or with three empty coordinates, is missing there. A handle whose rows have the
//! four numbers of a unit quaternion turns the scan too; with four empty ones it is a point.

use super::{Capture, Cleaning, MarkerTake, Motion};
use crate::error::{Error, Kind, Notes, Result};
use crate::opened;
use crate::space::Space;
use glam::{DQuat, DVec3};
use std::collections::BTreeMap;
use std::io::{BufRead, BufReader, Read};
use std::path::{Path, PathBuf};

/// Longest line that is read, in bytes.
const LONGEST_LINE: u64 = 1 << 16;
/// A table that is emptier than one row in this many is refused: its frame numbers are hardly meant.
const EMPTIEST: usize = 1000;

/// Places of handles, frame by frame.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct HandleTable {
    /// Names, in the order of their first rows; unique.
    pub names: Vec<String>,
    /// Number of the first frame.
    pub first_frame: i64,
    /// Frame-major places in the scan's coordinates and unit, `frames × names`; missing ones are NaN.
    pub points: Vec<DVec3>,
    /// Orientations, as `points`; of handles that are points the identity.
    pub turns: Vec<DQuat>,
    /// Whether each handle has an orientation.
    pub oriented: Vec<bool>,
    /// The file it came from.
    pub source: PathBuf,
}

impl HandleTable {
    /// Frames per second where nobody says any.
    pub const RATE: f64 = 30.0;

    /// Reads a table.
    ///
    /// # Errors
    /// Unreadable files, and rows that break the form, with their line.
    pub fn read(path: &Path) -> Result<Self> {
        let file = opened::open(path).map_err(|e| Error::unreadable(path, &e))?;
        let name = |e: Error| if e.file.is_none() { e.file(path) } else { e };
        let mut table = Self::gather(Rows::new(BufReader::new(file)).map_err(name)?).map_err(name)?;
        table.source = path.to_owned();
        Ok(table)
    }

    /// Number of frames from the first to the last.
    pub fn frames(&self) -> usize {
        self.points.len() / self.names.len().max(1)
    }

    /// Where a handle is and how it is turned in the first frame that has it: its place at rest.
    pub fn rest(&self, handle: usize) -> Option<(DVec3, DQuat)> {
        let cells = (handle..self.points.len()).step_by(self.names.len().max(1));
        cells.map(|cell| (self.points[cell], self.turns[cell])).find(|(p, _)| p.is_finite())
    }

    /// A capture of as many frames without markers, for scans that are moved by handles alone.
    pub fn empty_capture(&self, rate: f64) -> Capture {
        Capture {
            name: self.source.file_stem().map(|s| s.to_string_lossy().into_owned()).unwrap_or_default(),
            rate,
            first_frame: self.first_frame,
            space: Space::default(),
            motion: Motion::Markers(MarkerTake::default()),
            source: self.source.clone(),
            cleaning: Cleaning::default(),
            notes: Notes::default(),
        }
    }

    fn gather<R: BufRead>(rows: Rows<R>) -> Result<Self> {
        let mut columns: BTreeMap<String, usize> = BTreeMap::new();
        let mut names: Vec<String> = Vec::new();
        let mut cells: BTreeMap<(i64, usize), Row> = BTreeMap::new();
        let mut oriented: Vec<Option<bool>> = Vec::new();
        for row in rows {
            let row = row?;
            let column = match columns.get(&row.name) {
                Some(&column) => column,
                None => {
                    columns.insert(row.name.clone(), names.len());
                    names.push(row.name.clone());
                    names.len() - 1
                }
            };
            oriented.resize(names.len(), None);
            if row.position.is_some() && *oriented[column].get_or_insert(row.turn.is_some()) != row.turn.is_some() {
                return Err(Error::malformed(format!("handle {} has an orientation in some rows only", row.name))
                    .at(format!("line {}", row.line))
                    .expected("qx, qy, qz, qw in all of its rows or in none"));
            }
            if let Some(first) = cells.get(&(row.frame, column)) {
                return Err(Error::malformed(format!("handle {} has a second place in frame {}", row.name, row.frame))
                    .at(format!("line {}", row.line))
                    .expected(format!("one row for each handle and frame; the other is in line {}", first.line)));
            }
            cells.insert((row.frame, column), row);
        }
        if let Some(nowhere) = oriented.iter().position(Option::is_none) {
            return Err(Error::malformed(format!("handle {} has no place in any frame", names[nowhere])));
        }
        let (Some(((first, _), _)), Some(((last, _), row))) = (cells.first_key_value(), cells.last_key_value()) else {
            return Err(Error::malformed("there is no row below the header").expected("frame,name,x,y,z rows"));
        };
        let (first, last, line) = (*first, *last, row.line);
        let size = last.checked_sub(first).and_then(|span| usize::try_from(span).ok()?.checked_add(1)?.checked_mul(names.len()));
        let size = size.filter(|size| size / EMPTIEST <= cells.len()).ok_or_else(|| {
            Error::malformed(format!("{} rows for the frames {first} to {last}", cells.len()))
                .at(format!("line {line}"))
                .expected("frames that are numbered one after the other")
        })?;
        let mut points = vec![DVec3::NAN; size];
        let mut turns = vec![DQuat::IDENTITY; size];
        for ((frame, column), row) in &cells {
            // Within the size that was checked above.
            let cell = (frame - first) as usize * names.len() + column;
            points[cell] = row.position.unwrap_or(DVec3::NAN);
            turns[cell] = row.turn.unwrap_or(DQuat::IDENTITY);
        }
        let oriented = oriented.into_iter().map(|o| o == Some(true)).collect();
        Ok(Self { names, first_frame: first, points, turns, oriented, source: PathBuf::new() })
    }
}

/// One row of a table.
#[derive(Clone, Debug, PartialEq)]
pub struct Row {
    /// Line in the file, from 1.
    pub line: usize,
    /// Frame number.
    pub frame: i64,
    /// Name of the handle.
    pub name: String,
    /// Its place; `None` where it is missing.
    pub position: Option<DVec3>,
    /// Its orientation, if it has one.
    pub turn: Option<DQuat>,
}

/// Reads a table row by row, for streams.
#[derive(Debug)]
pub struct Rows<R> {
    reader: R,
    line: usize,
    /// Columns of frame, name, x, y, z.
    columns: [usize; 5],
    /// Columns of qx, qy, qz, qw.
    turn: Option<[usize; 4]>,
    fields: usize,
    buffer: Vec<u8>,
}

const COLUMNS: [&str; 5] = ["frame", "name", "x", "y", "z"];
const TURN: [&str; 4] = ["qx", "qy", "qz", "qw"];
const HEADER: &str = "a first line 'frame,name,x,y,z' or 'frame,name,x,y,z,qx,qy,qz,qw'";
/// Farther from length 1 a quaternion is hardly meant as an orientation.
const UNIT: f64 = 0.01;

impl<R: BufRead> Rows<R> {
    /// Reads the header.
    ///
    /// # Errors
    /// A header that is not there or has other columns.
    pub fn new(reader: R) -> Result<Self> {
        let mut rows = Self { reader, line: 0, columns: [0; 5], turn: None, fields: 0, buffer: Vec::new() };
        let Some(header) = rows.next_fields()? else {
            return Err(Error::malformed("the table is empty").expected(HEADER));
        };
        let header: Vec<String> = header.iter().map(|name| name.trim().to_ascii_lowercase()).collect();
        let here = |e: Error| e.at(format!("line {}", rows.line)).expected(HEADER);
        if header.len() == 1 && header[0].contains([';', '\t']) {
            return Err(here(Error::malformed("the columns are not parted by commas")));
        }
        if let Some(unknown) = header.iter().find(|name| !COLUMNS.iter().chain(&TURN).any(|known| known == name)) {
            let what = if unknown.parse::<f64>().is_ok() { "there is no header line" } else { "unknown column" };
            return Err(here(Error::malformed(format!("{what}: '{unknown}'"))));
        }
        if let Some(twice) = COLUMNS.iter().chain(&TURN).find(|name| header.iter().filter(|h| h == *name).count() > 1) {
            return Err(here(Error::malformed(format!("column {twice} stands twice"))));
        }
        let find = |name: &str| {
            let column = header.iter().position(|h| h == name);
            column.ok_or_else(|| here(Error::malformed(format!("column {name} is missing"))))
        };
        let mut columns = [0; 5];
        for (column, name) in columns.iter_mut().zip(COLUMNS) {
            *column = find(name)?;
        }
        let mut turn = [0; 4];
        let turns = header.iter().any(|name| TURN.contains(&name.as_str()));
        for (column, name) in turn.iter_mut().zip(TURN).filter(|_| turns) {
            *column = find(name)?;
        }
        rows.turn = turns.then_some(turn);
        (rows.columns, rows.fields) = (columns, header.len());
        Ok(rows)
    }

    /// Fields of the next line that says something.
    fn next_fields(&mut self) -> Result<Option<Vec<String>>> {
        loop {
            self.buffer.clear();
            let read = self.reader.by_ref().take(LONGEST_LINE).read_until(b'\n', &mut self.buffer);
            let count = read
                .map_err(|e| Error::new(Kind::Unreadable, format!("cannot read: {e}")).at(format!("line {}", self.line + 1)))?;
            if count == 0 {
                return Ok(None);
            }
            self.line += 1;
            let here = |e: Error| e.at(format!("line {}", self.line));
            if count as u64 == LONGEST_LINE && self.buffer.last() != Some(&b'\n') {
                return Err(here(
                    Error::malformed(format!("the line is longer than {LONGEST_LINE} bytes")).expected("a table of text"),
                ));
            }
            let text = std::str::from_utf8(&self.buffer)
                .map_err(|_| here(Error::malformed("the line is no text in UTF-8").expected("a table of text")))?;
            let text = text.trim_start_matches('\u{feff}').trim();
            if !text.is_empty() && !text.starts_with('#') {
                return fields(text).map(Some).map_err(here);
            }
        }
    }

    fn row(&self, fields: &[String]) -> Result<Row> {
        if fields.len() != self.fields {
            return Err(
                Error::malformed(format!("{} fields", fields.len())).expected(format!("{} as in the header", self.fields))
            );
        }
        let [frame, name, ..] = self.columns;
        let frame = fields[frame].trim();
        let frame = frame.parse().map_err(|_| Error::malformed(format!("frame '{frame}'")).expected("a whole number"))?;
        let name = fields[name].trim();
        if name.is_empty() {
            return Err(Error::malformed("the handle has no name"));
        }
        let [_, _, x, y, z] = self.columns;
        let position = numbers(fields, [x, y, z], ["x", "y", "z"], name)?.map(DVec3::from_array);
        let turn = match self.turn {
            Some(columns) => numbers(fields, columns, TURN, name)?.map(DQuat::from_array),
            None => None,
        };
        if let Some(q) = turn
            && (q.length() - 1.0).abs() > UNIT
        {
            return Err(
                Error::malformed(format!("the quaternion of handle {name} has length {:.3}", q.length())).expected("length 1")
            );
        }
        Ok(Row { line: self.line, frame, name: name.to_owned(), position, turn: turn.map(DQuat::normalize) })
    }
}

/// Some fields as numbers; `None` where all are empty.
fn numbers<const N: usize>(fields: &[String], columns: [usize; N], names: [&str; N], handle: &str) -> Result<Option<[f64; N]>> {
    let texts = columns.map(|column| fields[column].trim());
    if texts.iter().all(|t| t.is_empty()) {
        return Ok(None);
    }
    let mut values = [0.0; N];
    for ((value, text), name) in values.iter_mut().zip(texts).zip(names) {
        *value = text.parse().ok().filter(|x: &f64| x.is_finite()).ok_or_else(|| {
            Error::malformed(format!("{name} '{text}' of handle {handle}"))
                .expected(format!("a number, or {N} empty fields where there is nothing"))
        })?;
    }
    Ok(Some(values))
}

impl<R: BufRead> Iterator for Rows<R> {
    type Item = Result<Row>;

    fn next(&mut self) -> Option<Self::Item> {
        let fields = match self.next_fields() {
            Ok(fields) => fields?,
            Err(e) => return Some(Err(e)),
        };
        Some(self.row(&fields).map_err(|e| e.at(format!("line {}", self.line))))
    }
}

/// Parts a line at its commas; a field in double quotes may hold commas, and quotes as two.
fn fields(line: &str) -> Result<Vec<String>> {
    let mut fields = Vec::new();
    let mut rest = line;
    loop {
        let (field, after) = match rest.trim_start().strip_prefix('"') {
            Some(quoted) => {
                let mut field = String::new();
                let mut tail = quoted;
                loop {
                    let (part, after) = tail.split_once('"').ok_or_else(|| Error::malformed("a quote is not closed"))?;
                    field.push_str(part);
                    tail = after;
                    let Some(more) = tail.strip_prefix('"') else { break };
                    field.push('"');
                    tail = more;
                }
                (field, tail.trim_start())
            }
            None => {
                let end = rest.find(',').unwrap_or(rest.len());
                (rest[..end].to_owned(), &rest[end..])
            }
        };
        fields.push(field);
        if after.is_empty() {
            return Ok(fields);
        }
        rest = after.strip_prefix(',').ok_or_else(|| Error::malformed("text after a closing quote").expected("a comma"))?;
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    fn table(text: &str) -> Result<HandleTable> {
        HandleTable::gather(Rows::new(text.as_bytes())?)
    }

    #[test]
    fn rows_in_any_order_become_frames() {
        let t = table("\u{feff}# made by hand\r\nName, frame ,z,y,x\r\n\r\n\"tip, \"\"left\"\"\",4,3,2,1\r\nroot,2,6,5,4\n# done\nroot,4,,,\n").unwrap();
        assert_eq!(t.names, ["tip, \"left\"", "root"]);
        assert_eq!((t.first_frame, t.frames()), (2, 3));
        assert_eq!(t.points[1], DVec3::new(4.0, 5.0, 6.0));
        assert_eq!(t.points[4], DVec3::new(1.0, 2.0, 3.0));
        assert_eq!(t.points.iter().filter(|p| p.is_finite()).count(), 2);
        assert_eq!(t.rest(0), Some((DVec3::new(1.0, 2.0, 3.0), DQuat::IDENTITY)));
        assert_eq!(t.rest(1), Some((DVec3::new(4.0, 5.0, 6.0), DQuat::IDENTITY)));
        assert_eq!(t.oriented, [false, false]);
        let t = table("frame,name,x,y,z,qx,qy,qz,qw\n1,a,0,0,0,,,,\n1,b,0,0,0,0.6,0,0,0.8\n2,b,,,,,,,\n").unwrap();
        assert_eq!(t.oriented, [false, true]);
        assert_eq!(t.rest(1), Some((DVec3::ZERO, DQuat::from_xyzw(0.6, 0.0, 0.0, 0.8))));
    }

    #[test]
    fn mistakes_are_told_with_their_line() {
        let h = "frame,name,x,y,z\n";
        let q = "frame,name,x,y,z,qx,qy,qz,qw\n";
        for (text, words) in [
            (String::new(), ["empty", "frame,name,x,y,z"]),
            ("1,a,0,0,0\n".into(), ["no header", "line 1"]),
            ("frame;name;x;y;z\n".into(), ["commas", "line 1"]),
            ("frame,name,x,y\n".into(), ["column z is missing", "line 1"]),
            ("frame,name,x,y,z,w\n".into(), ["unknown column: 'w'", "line 1"]),
            ("frame,name,x,y,z,x\n".into(), ["x stands twice", "line 1"]),
            ("\nframe,name,x,y,z,qx,qy,qz\n".into(), ["column qw is missing", "line 2"]),
            (format!("{q}1,a,0,0,0,0,0,0,2\n"), ["length 2.000", "line 2"]),
            (format!("{q}1,a,0,0,0,0,0,,1\n"), ["qz '' of handle a", "line 2"]),
            (format!("{q}1,a,0,0,0,0,0,0,1\n2,a,0,0,0,,,,\n"), ["in some rows only", "line 3"]),
            (h.into(), ["no row", "frame,name,x,y,z"]),
            (format!("{h}1,a,0,0\n"), ["4 fields", "line 2"]),
            (format!("{h}1,a,0,0,0\n\n1.5,a,0,0,0\n"), ["frame '1.5'", "line 4"]),
            (format!("{h}1,,0,0,0\n"), ["no name", "line 2"]),
            (format!("{h}1,a,0,nan,0\n"), ["y 'nan' of handle a", "line 2"]),
            (format!("{h}1,a,0,,0\n"), ["y '' of handle a", "line 2"]),
            (format!("{h}1,a,0,0,0\n1,a,1,0,0\n"), ["second place in frame 1", "line 3"]),
            (format!("{h}1,a,0,0,0\n1,b,,,\n"), ["handle b has no place", "any frame"]),
            (format!("{h}1,a,0,0,0\n9000000000,a,1,0,0\n"), ["2 rows", "line 3"]),
            (format!("{h}{},a,0,0,0\n{},a,1,0,0\n", i64::MIN, i64::MAX), ["2 rows", "line 3"]),
            (format!("{h}1,\"a,0,0,0\n"), ["not closed", "line 2"]),
            (format!("{h}1,\"a\"b,0,0,0\n"), ["after a closing quote", "line 2"]),
            (format!("{h}1,{},0,0,0\n", "a".repeat(70_000)), ["longer than", "line 2"]),
        ] {
            let error = table(&text).unwrap_err().to_string();
            assert!(words.iter().all(|w| error.contains(w)), "{:.60}: {error}", text);
        }
        assert!(
            Rows::new(&b"frame,name,x,y,z\n1,\xff,0,0,0\n"[..])
                .unwrap()
                .next()
                .unwrap()
                .unwrap_err()
                .to_string()
                .contains("UTF-8")
        );
    }

    #[test]
    fn a_stream_gives_each_row_when_its_line_is_there() {
        let mut rows = Rows::new(&b"frame,name,x,y,z\n1,a,0,0,0\nbroken\n2,a,1,0,0\n"[..]).unwrap();
        assert_eq!(rows.next().unwrap().unwrap().line, 2);
        assert!(rows.next().unwrap().is_err());
        assert_eq!(rows.next().unwrap().unwrap().position, Some(DVec3::X));
        assert!(rows.next().is_none());
    }
}
