//! C3D files: points, labels, rate and what the file says of its unit and axes, in all six encodings.
//!
//! Analog data, events and force plates are stepped over. Where header and parameters contradict each other the header is
//! believed (on real files it was right wherever they differed), and the length of the file is believed before both.

mod header;
mod parameters;
mod points;
mod rotations;

use super::SkeletonTake;
use crate::error::{Error, Notes, Result};
use crate::opened;
use crate::space::{Evidence, Known, Space};
use header::{BLOCK, Header, Processor};
use parameters::Parameters;
use rotations::Rotations;
use std::fs::File;
use std::io::{self, BufReader, Read, Seek, SeekFrom};
use std::path::Path;

/// An opened C3D file: everything but the positions, which [`C3d::points`] reads for the columns that are wanted.
pub(super) struct C3d<R> {
    source: R,
    header: Header,
    processor: Processor,
    /// First byte of the data.
    data_start: u64,
    /// Number of the first frame.
    pub(super) first_frame: i64,
    /// Whole frames in the file; at least one.
    pub(super) frames: usize,
    /// Frames per second; positive.
    pub(super) rate: f64,
    /// One label per point as written, without padding; empty where the file has fewer labels than points.
    pub(super) labels: Vec<String>,
    /// Whether the file has labels at all.
    pub(super) labelled: bool,
    /// Labels listed as angles, forces, moments, powers, scalars or modelled markers.
    pub(super) computed: Vec<String>,
    /// Names of the subjects, where the file lists them.
    pub(super) subjects: Vec<String>,
    /// Unit and up axis, where the file says so.
    pub(super) space: Space,
    /// Segments with turns, where the file has them.
    rotations: Option<Rotations>,
    /// Length of the file in bytes.
    length: u64,
    /// Contradictions and what was believed.
    pub(super) notes: Notes,
}

impl C3d<BufReader<File>> {
    /// Opens a file and reads everything but the data.
    pub(super) fn open(path: &Path) -> Result<Self> {
        let unreadable = |e: io::Error| Error::unreadable(path, &e);
        let file = opened::open(path).map_err(unreadable)?;
        if file.metadata().map_err(unreadable)?.is_dir() {
            return Err(Error::new(crate::error::Kind::Unreadable, "is a folder").file(path).expected("a capture file"));
        }
        Self::parse(BufReader::with_capacity(1 << 18, file)).map_err(|e| e.file(path))
    }
}

impl<R: Read + Seek> C3d<R> {
    /// Reads everything but the data.
    pub(super) fn parse(mut source: R) -> Result<Self> {
        let length = source.seek(SeekFrom::End(0)).map_err(cannot_read)?;
        let block = header_block(&mut source)?;
        let section_start = header::parameter_start(&block, length);
        let lead = section_start.map(|start| bytes_at(&mut source, start, 4)).transpose()?;
        let code = lead.as_ref().and_then(|b| b.get(3).copied());
        let (processor, named) = header::processor(&block, code, length)?;
        let mut header = Header::parse(&block, processor);
        let mut notes = Notes::default();
        if !named {
            notes.warn("the file does not name its processor: the byte order was taken from the header");
        }

        let section = match section_start {
            Some(start) => {
                // The declared number of blocks is wrong in some files, so the section may reach up to the data.
                let data = u64::from(header.data_block.max(1) - 1) * BLOCK;
                let end = if data > start { data } else { start + 255 * BLOCK };
                bytes_at(&mut source, start + 4, end.saturating_sub(start + 4))?
            }
            None => Vec::new(),
        };
        let parameters = Parameters::parse(&section, processor);
        let rotations = Rotations::of(&parameters, processor, length, &mut notes);
        if rotations.is_none() {
            check_points(&header)?;
        }
        believe_scale(&mut header, &parameters, &mut notes)?;
        let data_start = match header.points {
            0 => BLOCK,
            _ => data_start(&header, &parameters, section_start, &section, &mut notes)?,
        };
        let whole = match (header.points, &rotations) {
            (0, Some(rotations)) => rotations.frames(length),
            _ => length.saturating_sub(data_start) / header.frame_bytes(),
        };
        let (first_frame, frames) = frame_range(&header, &parameters, whole, &mut notes);
        if frames == 0 {
            return Err(Error::malformed(format!("the file ends after {length} bytes, before the first whole frame"))
                .at(format!("data begin at byte {data_start}, {} bytes per frame", header.frame_bytes())));
        }
        let rate = frame_rate(&header, &parameters, &mut notes);
        let written = parameters.long_texts("POINT", "LABELS");
        let labelled = !written.is_empty();
        if parameters.number("POINT", "USED").is_some_and(|used| used != f64::from(header.points)) {
            let used = parameters.number("POINT", "USED").unwrap_or_default();
            notes.warn(format!("the header has {} points, POINT:USED says {used}: the header is believed", header.points));
        }
        if labelled && written.len() < usize::from(header.points) {
            notes.warn(format!("{} points have no label", usize::from(header.points) - written.len()));
        }
        let mut labels = written;
        labels.resize(header.points.into(), String::new());
        let lists = ["ANGLES", "FORCES", "MOMENTS", "POWERS", "SCALARS", "MODELED_MARKERS"];
        let computed = lists.iter().flat_map(|l| parameters.long_texts("POINT", l)).filter(|l| !l.is_empty()).collect();
        let subjects = parameters.texts("SUBJECTS", "NAMES").into_iter().filter(|n| !n.is_empty()).collect();
        let space = space(&parameters, &mut notes);
        Ok(Self {
            source,
            header,
            processor,
            data_start,
            first_frame,
            frames,
            rate,
            labels,
            labelled,
            computed,
            subjects,
            space,
            rotations,
            length,
            notes,
        })
    }

    /// Whether the file has segments with turns.
    pub(super) fn has_segments(&self) -> bool {
        self.rotations.is_some()
    }

    /// Segments with turns, and their samples per second; `None` where the file has none.
    pub(super) fn segments(&mut self) -> Result<Option<(SkeletonTake, f64)>> {
        let Some(rotations) = self.rotations.take() else { return Ok(None) };
        let samples = rotations.samples(self.frames as u64, self.length, &mut self.notes);
        self.source.seek(SeekFrom::Start(rotations.start)).map_err(cannot_read)?;
        let take = rotations.read(&mut self.source, samples, &mut self.notes).map_err(cannot_read)?;
        Ok(Some((take, rotations.rate(self.rate))))
    }

    /// Positions of the given points in every frame: frame-major, `frames × columns`, in the file's unit; missing ones are NaN.
    pub(super) fn points(&mut self, columns: &[usize]) -> Result<Vec<[f32; 3]>> {
        self.source.seek(SeekFrom::Start(self.data_start)).map_err(cannot_read)?;
        let (points, doubtful) =
            points::read(&mut self.source, &self.header, self.processor, columns, self.frames).map_err(cannot_read)?;
        if doubtful.marked_but_there > 0 {
            let n = doubtful.marked_but_there;
            self.notes.warn(format!("{n} positions are marked as missing but have coordinates: kept as filled by the system"));
        }
        if doubtful.held > 0 {
            self.notes.warn(format!("{} positions are marked as missing and repeat the frame before: gaps", doubtful.held));
        }
        if doubtful.huge > 0 {
            self.notes.warn(format!("{} positions lie beyond any room: gaps", doubtful.huge));
        }
        Ok(points)
    }
}

fn cannot_read(e: io::Error) -> Error {
    Error::new(crate::error::Kind::Unreadable, format!("cannot read: {e}"))
}

fn header_block(source: &mut (impl Read + Seek)) -> Result<[u8; BLOCK as usize]> {
    let bytes = bytes_at(source, 0, BLOCK)?;
    header::check_key(&bytes)?;
    bytes.try_into().map_err(|_| Error::malformed("not a C3D file"))
}

/// Up to `count` bytes, fewer at the end of the file; memory grows only with what is there.
fn bytes_at(source: &mut (impl Read + Seek), at: u64, count: u64) -> Result<Vec<u8>> {
    let mut bytes = Vec::new();
    source.seek(SeekFrom::Start(at)).map_err(cannot_read)?;
    source.take(count).read_to_end(&mut bytes).map_err(cannot_read)?;
    Ok(bytes)
}

/// Refuses files without points and says what they hold instead.
fn check_points(header: &Header) -> Result<()> {
    if header.points > 0 {
        return Ok(());
    }
    let unsupported = |found: String| Error::new(crate::error::Kind::Unsupported, found).expected("labelled points");
    Err(if header.analog > 0 {
        unsupported(format!("holds only analog data ({} words per frame): nothing to animate", header.analog))
    } else {
        unsupported("holds no points: nothing to animate".into())
    })
}

fn believe_scale(header: &mut Header, parameters: &Parameters<'_>, notes: &mut Notes) -> Result<()> {
    let usable = |s: f64| s.is_finite() && s != 0.0;
    let declared = parameters.number("POINT", "SCALE");
    if !usable(header.scale.into()) {
        let Some(scale) = declared.filter(|s| usable(*s)) else {
            return Err(Error::malformed(format!("the scale is {}", header.scale))
                .at("bytes 13 to 16, and POINT:SCALE")
                .expected("a positive factor of integers, or a negative number for floats"));
        };
        notes.warn(format!("the header has no scale: POINT:SCALE {scale} is used"));
        header.scale = scale as f32;
    } else if header.scale > 0.0 && declared.is_some_and(|s| (s - f64::from(header.scale)).abs() > 1e-5 * s.abs()) {
        let scale = declared.unwrap_or_default();
        notes.warn(format!("the header scales by {}, POINT:SCALE by {scale:.6}: the header is believed", header.scale));
    }
    Ok(())
}

/// First byte of the data: the header's word, else the parameter, else behind the parameter section.
fn data_start(
    header: &Header,
    parameters: &Parameters<'_>,
    section_start: Option<u64>,
    section: &[u8],
    notes: &mut Notes,
) -> Result<u64> {
    let block = match header.data_block {
        0 => parameters.number("POINT", "DATA_START").map_or(0, |b| b as u64),
        block => block.into(),
    };
    match (block, section_start) {
        (2.., _) => Ok((block - 1).saturating_mul(BLOCK)),
        // Two bytes before the walked entries hold the number of blocks; `section` begins behind it.
        (_, Some(start)) if !section.is_empty() => {
            notes.warn("the file does not say where its data begin: taken as behind the parameters");
            Ok(start + blocks_of(section) * BLOCK)
        }
        _ => Err(Error::malformed("the file does not say where its data begin").at("bytes 17 and 18")),
    }
}

/// Blocks up to the last byte of the section that is not zero.
fn blocks_of(section: &[u8]) -> u64 {
    let used = section.iter().rposition(|b| *b != 0).map_or(0, |p| p + 1);
    (used as u64 + 4).div_ceil(BLOCK)
}

/// Number of the first frame and count of frames.
///
/// The header's 16-bit words end at 65,535; longer takes write 32-bit numbers in TRIAL:ACTUAL_START_FIELD and
/// ACTUAL_END_FIELD (low word first) or a float in POINT:LONG_FRAMES.
fn frame_range(header: &Header, parameters: &Parameters<'_>, whole: u64, notes: &mut Notes) -> (i64, usize) {
    const LIMIT: u64 = 65_535;
    let wide = |name: &str| match parameters.numbers("TRIAL", name)[..] {
        [low, high, ..] => {
            Some((low as u64).saturating_add((high as u64).saturating_mul(65_536))).filter(|n| *n <= u32::MAX.into())
        }
        [one] => Some(one as u64).filter(|n| *n <= u32::MAX.into()),
        [] => None,
    };
    let short = u64::from(header.last).saturating_sub(header.first.into()) + u64::from(header.last >= header.first);
    let actual = wide("ACTUAL_START_FIELD").zip(wide("ACTUAL_END_FIELD")).filter(|(start, end)| end >= start && *end > LIMIT);
    let long = parameters.number("POINT", "LONG_FRAMES").map(|n| n as u64).filter(|n| *n > LIMIT && *n <= u32::MAX.into());
    let listed = parameters.number("POINT", "FRAMES").map(|n| n as u64).filter(|n| *n > 0);

    let (first, declared) = match (actual, long) {
        (Some((start, end)), _) => (start, end - start + 1),
        (None, Some(count)) => (header.first.into(), count),
        (None, None) if short == 0 => (header.first.into(), listed.unwrap_or(whole)),
        // A saturated word without a longer one: what is there beyond a block of padding are frames.
        (None, None) if header.last == u16::MAX && whole > short + BLOCK / header.frame_bytes().max(1) + 1 => {
            notes.warn(format!("the header counts {short} frames, but the file holds {whole}: all are read"));
            (header.first.into(), whole)
        }
        (None, None) => (header.first.into(), short),
    };
    let count = if declared <= whole {
        if let Some(n) = listed.filter(|n| *n != declared && *n < LIMIT && declared <= LIMIT) {
            notes.warn(format!("the header counts {declared} frames, POINT:FRAMES {n}: the header is believed"));
        }
        declared
    } else {
        let there = listed.filter(|n| *n <= whole).unwrap_or(whole);
        notes.warn(format!("the file announces {declared} frames but holds {there} whole ones: it is cut short"));
        there
    };
    (i64::try_from(first).unwrap_or(1), count as usize)
}

fn frame_rate(header: &Header, parameters: &Parameters<'_>, notes: &mut Notes) -> f64 {
    /// Used where nothing says so; the speed of the result is then arbitrary, its shape is not.
    const ASSUMED: f64 = 100.0;
    let usable = |r: f64| r.is_finite() && r > 0.0 && r < 1e6;
    let listed = parameters.number("POINT", "RATE").filter(|r| usable(*r));
    let written = Some(f64::from(header.rate)).filter(|r| usable(*r));
    match (written, listed) {
        (Some(rate), Some(other)) if (rate - other).abs() > 1e-4 * rate => {
            notes.warn(format!("the header says {rate} Hz, POINT:RATE {other} Hz: the header is believed"));
            rate
        }
        (Some(rate), _) | (None, Some(rate)) => rate,
        (None, None) => parameters.number("TRIAL", "CAMERA_RATE").filter(|r| usable(*r)).unwrap_or_else(|| {
            notes.warn(format!("the file has no frame rate: {ASSUMED} Hz assumed"));
            ASSUMED
        }),
    }
}

fn space(parameters: &Parameters<'_>, notes: &mut Notes) -> Space {
    let unit = parameters.texts("POINT", "UNITS").into_iter().next().filter(|u| !u.is_empty());
    let up = parameters.texts("POINT", "Y_SCREEN").into_iter().next().filter(|a| !a.is_empty());
    Space {
        unit: unit.and_then(|u| match u.parse() {
            Ok(unit) => Some(Known::new(unit, Evidence::File)),
            Err(_) => {
                notes.warn(format!("POINT:UNITS '{u}' is not a unit of length: ignored"));
                None
            }
        }),
        up: up.and_then(|axis| axis.parse().ok()).map(|axis| Known::new(axis, Evidence::File)),
        forward: None,
    }
}
