//! Poses on their way into a GLB, encoded once for all files that hold them.

use super::Options;
use super::document::{Content, Precision};
use super::geometry::Geometry;
use super::names;
use crate::error::{Error, Kind, Notes, Result};
use crate::export::encode::spool::Spool;
use crate::export::encode::{Encode, Encoded, Job, skin::FileSpace};
use crate::export::files::folder_of;
use crate::export::{FrameBatch, Header, Written};
use crate::scan::{NONE, UnitBox};
use crate::space::{Axis, Unit};
use crate::surface::NormalVertices;
use crate::words;
use glam::DVec3;
use std::io::Write;
use std::path::Path;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// A centre farther from the origin than so many diagonals is taken out of the positions: single precision then keeps a millionth of the diagonal.
const FAR: f64 = 16.0;

/// Vertices from which on normals and weights are stored in bytes.
const MANY: usize = 100_000;

/// Tolerance that is wide enough for weights in bytes.
const WIDE: f64 = 0.002;

/// Numbers up to here are exact as `f32`.
const MOST_NUMBERED: usize = 1 << 24;

/// The poses of one take. Clones share them: a recording that several sinks are made of is encoded once.
#[derive(Clone, Debug)]
pub struct Recording {
    options: Options,
    state: Arc<Mutex<State>>,
}

#[derive(Debug, Default)]
struct State {
    header: Option<Arc<Header>>,
    spool: Option<Spool>,
    encoded: Option<Arc<Encoded>>,
}

impl Recording {
    /// None yet.
    pub fn new(options: Options) -> Self {
        Self { options, state: Arc::default() }
    }

    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Is told what comes. Poses are kept beside the first `path`.
    pub(crate) fn begin(&self, path: &Path, header: &Arc<Header>) -> Result<()> {
        if !(header.rate.is_finite() && header.rate > 0.0) {
            return Err(Error::refused(format!("a frame rate of {}", header.rate)).file(path));
        }
        let vertices = header.scan.mesh.positions.len();
        if self.options.source_index && vertices > MOST_NUMBERED {
            return Err(Error::new(Kind::Unsupported, format!("{vertices} vertices cannot be numbered in a GLB"))
                .file(path)
                .expected(format!("at most {MOST_NUMBERED}"))
                .hint("leave out --source-index"));
        }
        let mut state = self.state();
        if state.spool.is_none() {
            state.spool = Some(Spool::new(folder_of(path), header.proxy.rest.len()).map_err(|e| e.file(path))?);
            state.header = Some(header.clone());
        }
        Ok(())
    }

    /// Takes the next frames, once.
    pub(crate) fn push(&self, batch: &FrameBatch<'_>) -> Result<()> {
        let mut state = self.state();
        let spool = state.spool.as_mut().expect("a recording is begun before it gets frames");
        if batch.first < spool.frames() {
            return Ok(());
        }
        debug_assert_eq!(batch.first, spool.frames(), "frames come in order");
        batch.proxy.iter().try_for_each(|pose| spool.push(pose))
    }

    /// Encodes the poses, unless that is done, and writes the file to `out`; `path` is for errors and for what is returned, which lacks the bytes.
    pub(crate) fn write(&self, path: &Path, out: &mut impl Write) -> Result<Written> {
        let mut state = self.state();
        let (Some(header), Some(spool)) = (state.header.clone(), state.spool.as_ref().filter(|s| s.frames() > 0)) else {
            return Err(Error::refused("no frames").file(path));
        };
        let scan = &header.scan;
        let mut notes = Notes::default();
        let normal_vertices = NormalVertices::of(scan);
        let geometry = Geometry::of(scan, &normal_vertices);
        let vertices = geometry.scan_vertices();
        let (space, offset) = file_space(&header.unit_box);
        let rest = header.unit_box.enter_all(&scan.mesh.positions);
        let mut places = vec![NONE; scan.mesh.positions.len()];
        for (place, &v) in vertices.iter().enumerate() {
            places[v as usize] = place as u32;
        }
        let encoded = match state.encoded.clone() {
            Some(encoded) => encoded,
            None => {
                let job = Job {
                    map: header.map.as_ref(),
                    proxy_rest: &header.proxy.rest,
                    spool,
                    vertices: &vertices,
                    rest: &rest,
                    pieces: &geometry.pieces(&vertices, &places),
                    space,
                    tolerance: self.options.tolerance,
                    encode: self.options.encode,
                    levels: if vertices.len() > MANY && self.options.tolerance.worst >= WIDE { 255 } else { u16::MAX },
                    cancel: &header.cancel,
                };
                Arc::new(job.run().map_err(|e| self.unreached(e, &header).file(path))?)
            }
        };
        state.encoded = Some(encoded.clone());
        drop(state);
        let mut normals = Vec::new();
        let points: Vec<[f32; 3]> = rest.iter().map(|p| p.as_vec3().to_array()).collect();
        normal_vertices.compute(scan, &points, &mut normals);
        let geometry = match &encoded.parts {
            Some(parts) => Geometry::of_parts(scan, &normal_vertices, |v| parts.of_vertex[places[v as usize] as usize]),
            None => geometry,
        };
        let node_names = names::node_names(&encoded, scan, &places, &header.proxy.rest, &header.places);
        let stem = |p: &Path| p.file_stem().map(|s| s.to_string_lossy().into_owned()).filter(|s| !s.is_empty());
        let content = Content {
            scan,
            geometry: &geometry,
            normals: &normals,
            encoded: &encoded,
            places: &places,
            node_names: &node_names,
            offset,
            rate: header.rate,
            name: &stem(&scan.source).unwrap_or_else(|| "scan".to_owned()),
            animation: if header.take.is_empty() { "motion" } else { &header.take },
            precision: if vertices.len() > MANY { Precision::Compact } else { Precision::Full },
            source_index: self.options.source_index,
        };
        let (document, buffer) = content.build(&mut notes);
        header.cancel.check()?;
        buffer.write(document, out, |e| Error::unwritable(path, &e))?;
        remark(&header, vertices.len(), &mut notes);
        Ok(Written {
            path: path.to_owned(),
            bytes: 0,
            encoding: described(&encoded),
            max_error: encoded.summary.worst,
            rms_error: encoded.summary.rms,
            worst_frame: Some(header.first_frame + encoded.summary.frame as i64),
            notes,
        })
    }

    /// The encoder's error with the frame in the capture's own numbering, and what to do.
    fn unreached(&self, mut error: Error, header: &Header) -> Error {
        if error.kind != Kind::Unreached {
            return error;
        }
        let frame = error.place.as_deref().and_then(|f| f.parse::<i64>().ok()).map(|f| header.first_frame + f);
        error.place = frame.map(|f| format!("worst in frame {f}").into());
        let aim = self.options.tolerance;
        let what = match self.options.encode {
            Encode::Auto => "joints and corrective morph targets",
            Encode::Skin => "joints",
            Encode::Morph => "morph targets",
        };
        error.found = format!("{what} come within {} of the diagonal", error.found);
        let other = match self.options.encode {
            Encode::Skin => "--encode auto",
            Encode::Auto => "--encode morph",
            Encode::Morph => "--encode auto",
        };
        error
            .expected(format!("{} % worst, {} % rms", words::digits(aim.worst * 100.0), words::digits(aim.rms * 100.0)))
            .hint(format!("a larger --tolerance, {other}, or an exact format as -o FILE.usdc"))
    }
}

/// `skin, 64 joints`, `skin, 64 joints, 3 morphs`, `40 morphs`, `5 rigid parts`, `5 rigid parts, skin, 8 joints`.
fn described(encoded: &Encoded) -> String {
    let (rigid, joints, targets) = (encoded.rigid_parts(), encoded.joints(), encoded.morphs.targets.len());
    let parts = (rigid > 0).then(|| words::plural(rigid, "rigid part"));
    let skin = (joints > 0).then(|| format!("skin, {joints} joints"));
    let morphs = (targets > 0 || joints + rigid == 0).then(|| format!("{targets} morphs"));
    parts.into_iter().chain(skin).chain(morphs).collect::<Vec<_>>().join(", ")
}

/// Coordinates of the file, and where they begin in the scan's.
pub(crate) fn file_space(unit_box: &UnitBox) -> (FileSpace, DVec3) {
    let far = unit_box.centre.abs().max_element() > FAR * unit_box.diagonal;
    // Rounded, so that a reader in single precision has the same offset.
    let offset = if far { unit_box.centre.as_vec3().as_dvec3() } else { DVec3::ZERO };
    (FileSpace { scale: unit_box.diagonal, shift: unit_box.centre - offset }, offset)
}

fn remark(header: &Header, vertices: usize, notes: &mut Notes) {
    let unused = header.scan.mesh.positions.len() - vertices;
    if unused > 0 {
        notes.warn(format!("{unused} vertices that no face uses are not in the GLB"));
    }
    let unit = header.scan.space.unit.map(|u| u.value).filter(|u| *u != Unit::Metre);
    let up = header.up.map(Axis::nearest).filter(|a| a.negative || a.index != 1);
    let own: Vec<String> = unit.map(|u| u.to_string()).into_iter().chain(up.map(|a| format!("{a} up"))).collect();
    if !own.is_empty() {
        notes.warn(format!("the GLB keeps the scan's own {}; viewers take glTF as metres, +Y up", own.join(" and ")));
    }
}
