//! CSV tables that OptiTrack Motive exports: markers, rigid bodies and bones.
//!
//! The first line holds pairs of words and values; then come lines of types, names, channels and axes, one cell per column. A marker of a
//! body appears as it was measured (`Marker`) and as the body says where it should be (`Bone Marker`, `Rigid Body Marker`); the measured one
//! is taken where there is one. Bones and rigid bodies are taken where there are no markers.

use super::head::Head;
use super::table::{Grid, Lines, MOST_MARKERS, Separator, Table, decode, value, whole};
use super::{Joint, MarkerTake, ReadOptions, SkeletonTake};
use crate::error::{Error, Kind, Notes, Result};
use crate::space::{Evidence, Known, Space, Unit};
use crate::words;
use glam::{DQuat, DVec3};
use std::collections::{BTreeMap, BTreeSet};

/// Lines in which the header must be complete.
const HEADER_LINES: usize = 32;

/// What a file holds.
#[derive(Debug)]
pub(super) enum Export {
    /// Trajectories of markers.
    Markers(Table),
    /// Bones or rigid bodies, and what else the file says.
    Bodies(SkeletonTake, Head),
}

/// Reads a table.
///
/// # Errors
/// A header without the lines of names and axes, rows that break the form, and files without markers, bones or rigid bodies.
pub(super) fn read(bytes: &[u8], options: &ReadOptions) -> Result<Export> {
    let text = decode(bytes);
    let mut lines = Lines::new(&text);
    let header = Header::read(&mut lines)?;
    let mut notes = Notes::default();
    let (markers, bodies) = (header.markers(), header.bodies());
    let by_markers = !markers.is_empty() && (!options.bodies || bodies.is_empty());
    if by_markers && !bodies.is_empty() {
        notes.warn(format!("{} with turns left aside for the markers", words::plural(bodies.len(), "segment")));
    }
    let taken = if by_markers { markers } else { bodies };
    if taken.is_empty() {
        return Err(Error::new(Kind::Unsupported, "an export of Motive without markers, bones and rigid bodies")
            .expected("columns of the type Marker, Bone or Rigid Body, bodies with quaternions"));
    }
    if !by_markers && header.said.get("coordinate space").is_some_and(|s| !s.eq_ignore_ascii_case("global")) {
        return Err(Error::new(Kind::Unsupported, "bones in the coordinates of their parents")
            .at("Coordinate Space")
            .expected("Global")
            .hint("export with global coordinates, or with markers"));
    }

    let mut grid = Grid::new(bytes.len());
    let mut turns = Vec::new();
    let mut cells = Vec::new();
    while let Some((number, line)) = lines.next_said() {
        Separator::Each(',').split(line, &mut cells);
        let cut = lines.stops() && grid.rows() > 0;
        let read = row(&cells, &taken, &mut grid, &mut turns);
        if cut && (read.is_err() || cells.len() < header.columns) {
            if read.is_ok() {
                grid.drop_row()
            } else {
                grid.drop_open()
            }
            notes.warn(format!("the last row is cut short: left out (line {number})"));
            break;
        }
        read.map_err(|e| e.at(format!("line {number}")))?;
    }
    if grid.rows() == 0 {
        return Err(Error::malformed("there is no row below the header").expected("one row per frame"));
    }
    if grid.columns() == 0 {
        return Err(Error::malformed("no row has a position").expected("three numbers per marker"));
    }
    if let Some(n) = header.number("total exported frames").filter(|n| *n != grid.rows() as f64) {
        notes.warn(format!("the header announces {n} frames, {} are there", grid.rows()));
    }
    let declared = header.number("export frame rate");
    if declared == Some(0.0) {
        notes.warn("the header says a frame rate of 0: ignored");
    }
    let given = header.number("capture frame rate").filter(|r| *r > 0.0).or(options.rate);
    let (first_frame, rate) = grid.clock(declared.filter(|r| *r > 0.0), given, &mut notes);
    grid.remark(&mut notes);
    let unit = header.said.get("length units").and_then(|u| u.parse::<Unit>().ok());
    let space = Space { unit: unit.map(|u| Known::new(u, Evidence::File)), ..Space::default() };
    let labels: Vec<String> = taken.iter().map(|g| g.name.clone()).collect();
    let head = Head { labels, labelled: true, rate, first_frame, space, notes, ..Head::default() };
    if by_markers { Ok(Export::Markers(Table { head, grid })) } else { skeleton(head, grid, turns, &taken) }
}

/// One row: number, time, and the cells of the groups that are taken.
fn row(cells: &[&str], taken: &[&Group], grid: &mut Grid, turns: &mut Vec<[f32; 4]>) -> Result<()> {
    let cell = |n: usize| cells.get(n).copied().unwrap_or_default();
    let read = |n: usize| {
        value(cell(n)).ok_or_else(|| {
            Error::malformed(format!("cell {} is '{}'", n + 1, cell(n).chars().take(20).collect::<String>()))
                .expected("a number, or nothing where the marker is missing")
        })
    };
    let number = match cell(0) {
        "" => None,
        text => Some(whole(text).ok_or_else(|| Error::malformed(format!("frame '{text}'")).expected("a whole number"))?),
    };
    let time = read(1)?;
    for group in taken {
        let [x, y, z] = group.place;
        grid.push([read(x)?, read(y)?, read(z)?]);
    }
    for [x, y, z, w] in taken.iter().filter_map(|g| g.turn) {
        let q = DQuat::from_xyzw(read(x)?, read(y)?, read(z)?, read(w)?);
        let unit = q.is_finite() && q.length_squared() > 0.25;
        turns.push(if unit { q.normalize().to_array().map(|x| x as f32) } else { [f32::NAN; 4] });
    }
    grid.end_row(number, time);
    Ok(())
}

/// The segments as a skeleton with the parents that the file names, without a rest pose.
fn skeleton(head: Head, grid: Grid, turns: Vec<[f32; 4]>, taken: &[&Group]) -> Result<Export> {
    let columns: Vec<usize> = (0..taken.len()).collect();
    let mut rotations = grid.spread(turns, taken.len(), [f32::NAN; 4]);
    let (points, origin) = grid.dense(&columns)?;
    let bare = |name: &str| name.rsplit_once(':').map_or(name, |(_, bare)| bare).to_owned();
    let mut origins = MarkerTake { labels: taken.iter().map(|g| bare(&g.name)).collect(), points, origin };
    super::clean::rename_namesakes(&mut origins);
    rotations.resize(origins.points.len(), [f32::NAN; 4]);
    for (p, q) in origins.points.iter_mut().zip(&mut rotations) {
        if p[0].is_nan() || q[0].is_nan() {
            (*p, *q) = ([f32::NAN; 3], [f32::NAN; 4]);
        }
    }
    let earlier: BTreeMap<&str, usize> = taken.iter().enumerate().rev().map(|(n, g)| (g.name.as_str(), n)).collect();
    let joints = taken.iter().zip(&origins.labels).enumerate().map(|(n, (group, name))| Joint {
        name: name.clone(),
        parent: earlier.get(group.parent.as_str()).copied().filter(|p| *p < n),
        rest: DVec3::NAN,
        rest_turn: DQuat::IDENTITY,
        end: false,
    });
    Ok(Export::Bodies(SkeletonTake { joints: joints.collect(), origins, rotations, ..SkeletonTake::default() }, head))
}

/// Columns of one marker, bone or rigid body.
#[derive(Clone, Debug, Default, PartialEq)]
struct Group {
    /// In lower case without blanks: `marker`, `bonemarker`, `bone`, `rigidbody` …
    kind: String,
    name: String,
    parent: String,
    place: [usize; 3],
    /// Columns of x, y, z, w.
    turn: Option<[usize; 4]>,
}

/// What stands above the rows.
#[derive(Debug)]
struct Header {
    /// The pairs of the first line, words in lower case.
    said: BTreeMap<String, String>,
    groups: Vec<Group>,
    columns: usize,
}

impl Header {
    fn read(lines: &mut Lines<'_>) -> Result<Self> {
        let mut rows: Vec<(usize, Vec<&str>)> = Vec::new();
        let axes = loop {
            let Some((number, line)) = lines.next().filter(|(number, _)| *number <= HEADER_LINES) else {
                return Err(Error::malformed("the header ends before the line of axes")
                    .at(format!("line {}", rows.last().map_or(1, |r| r.0)))
                    .expected("a line that begins with Frame"));
            };
            let mut cells = Vec::new();
            Separator::Each(',').split(line, &mut cells);
            if cells.first().is_some_and(|c| c.eq_ignore_ascii_case("frame")) {
                break cells;
            }
            if cells.iter().any(|c| !c.is_empty()) {
                rows.push((number, cells));
            }
        };
        let mut rows = rows.into_iter().map(|r| r.1);
        let first = rows.next().unwrap_or_default();
        let said = first.chunks_exact(2).map(|p| (p[0].to_ascii_lowercase(), p[1].to_owned())).collect();
        let rows: Vec<Vec<&str>> = rows.collect();
        let tagged = |tag: &str| rows.iter().find(|r| r.get(1).is_some_and(|c| c.eq_ignore_ascii_case(tag)));
        // Older versions leave the tags out; the order of the lines is the same.
        let (Some(types), Some(names), Some(channels)) =
            (tagged("Type").or(rows.first()), tagged("Name").or(rows.get(1)), rows.last().filter(|_| rows.len() > 2))
        else {
            return Err(Error::malformed(format!("{} lines between the first one and that of axes", rows.len()))
                .expected("lines of types, names, channels and axes"));
        };
        let (ids, parents) = (tagged("ID"), tagged("Parent"));
        let columns = axes.len();
        Ok(Self { said, groups: groups(types, names, ids, parents, channels, &axes), columns })
    }

    fn number(&self, key: &str) -> Option<f64> {
        self.said.get(key).and_then(|text| value(text)).filter(|x| x.is_finite())
    }

    /// Measured markers, and the solved ones that were not measured.
    fn markers(&self) -> Vec<&Group> {
        let measured: BTreeSet<&str> = self.groups.iter().filter(|g| g.kind == "marker").map(|g| g.name.as_str()).collect();
        let solved =
            |g: &Group| ["bonemarker", "rigidbodymarker"].contains(&g.kind.as_str()) && !measured.contains(g.name.as_str());
        self.groups.iter().filter(|g| g.kind == "marker" || solved(g)).take(MOST_MARKERS).collect()
    }

    fn bodies(&self) -> Vec<&Group> {
        let body = |g: &&Group| ["bone", "rigidbody"].contains(&g.kind.as_str()) && g.turn.is_some();
        self.groups.iter().filter(body).take(MOST_MARKERS).collect()
    }
}

/// A group that is being gathered.
struct Open {
    /// Type, name and number of what it is.
    key: [String; 3],
    parent: String,
    /// Columns by channel and axis.
    found: BTreeMap<(String, String), usize>,
}

/// Groups of columns that belong together; those without a position are passed over.
fn groups(
    types: &[&str],
    names: &[&str],
    ids: Option<&Vec<&str>>,
    parents: Option<&Vec<&str>>,
    channels: &[&str],
    axes: &[&str],
) -> Vec<Group> {
    let cell = |row: &[&str], n: usize| row.get(n).copied().unwrap_or_default().to_owned();
    let tag = |row: Option<&Vec<&str>>, n: usize| row.map_or_else(String::new, |r| cell(r, n));
    let mut groups = Vec::new();
    let mut open: Option<Open> = None;
    for n in 2..=axes.len() {
        let key = [cell(types, n), cell(names, n), tag(ids, n)];
        let channel = (cell(channels, n).to_ascii_lowercase(), cell(axes, n).to_ascii_uppercase());
        let same = n < axes.len() && open.as_ref().is_some_and(|o| o.key == key && !o.found.contains_key(&channel));
        if !same && let Some(Open { key: [kind, name, _], parent, found }) = open.take() {
            let at = |channel: &str, axis: &str| found.get(&(channel.to_owned(), axis.to_owned())).copied();
            let place = || Some([at("position", "X")?, at("position", "Y")?, at("position", "Z")?]);
            let turn = || Some([at("rotation", "X")?, at("rotation", "Y")?, at("rotation", "Z")?, at("rotation", "W")?]);
            if let Some(place) = place() {
                let kind = kind.to_ascii_lowercase().replace(' ', "");
                groups.push(Group { kind, name, parent, place, turn: turn() });
            }
        }
        if n < axes.len() {
            let open = open.get_or_insert_with(|| Open { key, parent: tag(parents, n), found: BTreeMap::new() });
            open.found.insert(channel, n);
        }
    }
    groups
}
