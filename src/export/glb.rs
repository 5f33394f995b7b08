//! Binary glTF: the motion as a skin of rigid joints that every viewer plays.
//!
//! Positions are the scan's own, in its unit and axes; only a scan that lies far from the origin is written around the origin, under a node with
//! the offset, since single precision would lose its detail. Vertex colours are converted from sRGB to the linear light that glTF asks for.

use super::encode::spool::Spool;
use super::encode::{Encoded, Job, Tolerance, skin::FileSpace};
use super::files::{Pending, folder_of};
use super::{FrameBatch, FrameSink, Header, Needs, Written};
use crate::error::{Error, Notes, Result};
use crate::scan::{NONE, UnitBox};
use crate::space::{Axis, Unit};
use crate::surface::NormalVertices;
use glam::DVec3;
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;

mod container;
mod document;
mod geometry;
mod looks;
mod names;

pub(super) use geometry::is_solid;
pub(super) use looks::linear;

use document::Content;
use geometry::Geometry;

/// A centre farther from the origin than so many diagonals is taken out of the positions: single precision then keeps a millionth of the diagonal.
const FAR: f64 = 16.0;

/// Writes an animated GLB.
#[derive(Debug)]
pub struct GlbSink {
    path: PathBuf,
    tolerance: Tolerance,
    open: Option<Open>,
}

#[derive(Debug)]
struct Open {
    // Dropped in this order: the poses go before the folder.
    poses: Poses,
    file: Pending,
}

/// Poses on their way into a GLB.
#[derive(Debug)]
pub(super) struct Poses {
    header: Arc<Header>,
    spool: Spool,
}

impl GlbSink {
    /// A sink for `path` that aims at a worst error of 0.25 % of the diagonal and 0.05 % root mean square.
    pub fn new(path: impl Into<PathBuf>) -> Self {
        Self::with_tolerance(path, Tolerance::default())
    }

    /// A sink with its own aim. A skin that misses it in more than one of a hundred frames, or by twice, is written all the same, with a note.
    pub fn with_tolerance(path: impl Into<PathBuf>, tolerance: Tolerance) -> Self {
        Self { path: path.into(), tolerance, open: None }
    }
}

impl FrameSink for GlbSink {
    fn needs(&self) -> Needs {
        Needs::default()
    }

    fn begin(&mut self, header: &Arc<Header>) -> Result<()> {
        // The file first: it makes the folder.
        let file = Pending::create(&self.path)?;
        self.open = Some(Open { poses: Poses::new(&self.path, header)?, file });
        Ok(())
    }

    fn frames(&mut self, batch: &FrameBatch<'_>) -> Result<()> {
        self.open.as_mut().expect("a sink is begun before it gets frames").poses.push(batch)
    }

    fn finish(mut self: Box<Self>) -> Result<Written> {
        let Some(Open { poses, mut file }) = self.open.take() else {
            return Err(Error::refused("no frames").file(&self.path));
        };
        let mut out = BufWriter::with_capacity(1 << 20, file.file_mut());
        let written = poses.write(&self.path, self.tolerance, &mut out)?;
        out.flush().map_err(|e| Error::unwritable(&self.path, &e))?;
        drop(out);
        Ok(Written { bytes: file.finish()?, ..written })
    }
}

impl Poses {
    /// None yet; they are kept beside `path`.
    pub(super) fn new(path: &Path, header: &Arc<Header>) -> Result<Self> {
        if !(header.rate.is_finite() && header.rate > 0.0) {
            return Err(Error::refused(format!("a frame rate of {}", header.rate)).file(path));
        }
        let spool = Spool::new(folder_of(path), header.proxy.rest.len()).map_err(|e| e.file(path))?;
        Ok(Self { header: header.clone(), spool })
    }

    /// Takes the next frames.
    pub(super) fn push(&mut self, batch: &FrameBatch<'_>) -> Result<()> {
        debug_assert_eq!(batch.first, self.spool.frames(), "frames come in order");
        batch.proxy.iter().try_for_each(|pose| self.spool.push(pose))
    }

    /// Makes a skin of them and writes the file to `out`; `path` is for errors and for what is returned, which lacks the bytes.
    pub(super) fn write(self, path: &Path, tolerance: Tolerance, out: &mut impl Write) -> Result<Written> {
        let Self { header, spool } = self;
        if spool.frames() == 0 {
            return Err(Error::refused("no frames").file(path));
        }
        let scan = &header.scan;
        let mut notes = Notes::default();
        let normal_vertices = NormalVertices::of(scan);
        let geometry = Geometry::of(scan, &normal_vertices);
        let vertices = geometry.scan_vertices();
        let (space, offset) = file_space(&header.unit_box);
        let rest: Vec<DVec3> = scan.mesh.positions.iter().map(|&p| header.unit_box.enter(p)).collect();
        let job = Job {
            map: header.map.as_ref(),
            proxy_rest: &header.proxy.rest,
            spool: &spool,
            vertices: &vertices,
            rest: &rest,
            space,
            tolerance,
            cancel: &header.cancel,
        };
        let encoded = job.run().map_err(|e| e.file(path))?;
        let mut normals = Vec::new();
        let points: Vec<[f32; 3]> = rest.iter().map(|p| p.as_vec3().to_array()).collect();
        normal_vertices.compute(scan, &points, &mut normals);
        let mut places = vec![NONE; scan.mesh.positions.len()];
        for (place, &v) in vertices.iter().enumerate() {
            places[v as usize] = place as u32;
        }
        let stem = |p: &Path| p.file_stem().map(|s| s.to_string_lossy().into_owned()).filter(|s| !s.is_empty());
        let content = Content {
            scan,
            geometry: &geometry,
            normals: &normals,
            skin: &encoded.skin,
            rest: &encoded.rest,
            places: &places,
            joint_names: &names::joint_names(&encoded, &header.proxy.rest, &header.places),
            offset,
            rate: header.rate,
            name: &stem(&scan.source).unwrap_or_else(|| "scan".to_owned()),
            animation: if header.take.is_empty() { "motion" } else { &header.take },
        };
        let (document, buffer) = content.build(&mut notes);
        header.cancel.check()?;
        buffer.write(document, out, |e| Error::unwritable(path, &e))?;
        remark(&header, &encoded, vertices.len(), tolerance, &mut notes);
        Ok(Written {
            path: path.to_owned(),
            bytes: 0,
            encoding: format!("skin, {} joints", encoded.skin.nodes() - 1),
            max_error: encoded.summary.worst,
            rms_error: encoded.summary.rms,
            worst_frame: Some(header.first_frame + encoded.summary.frame as i64),
            notes,
        })
    }
}

/// Coordinates of the file, and where they begin in the scan's.
pub(super) fn file_space(unit_box: &UnitBox) -> (FileSpace, DVec3) {
    let far = unit_box.centre.abs().max_element() > FAR * unit_box.diagonal;
    // Rounded, so that a reader in single precision has the same offset.
    let offset = if far { unit_box.centre.as_vec3().as_dvec3() } else { DVec3::ZERO };
    (FileSpace { scale: unit_box.diagonal, shift: unit_box.centre - offset }, offset)
}

fn remark(header: &Header, encoded: &Encoded, vertices: usize, tolerance: Tolerance, notes: &mut Notes) {
    let summary = &encoded.summary;
    let percent = 100.0 / header.unit_box.diagonal;
    if !encoded.met {
        notes.warn(format!(
            "the skin is {:.2} % of the diagonal off at the worst vertex (frame {}) and {:.3} % rms; the aim is {} % and {} %",
            summary.worst * percent,
            header.first_frame + summary.frame as i64,
            summary.rms * percent,
            tolerance.worst * 100.0,
            tolerance.rms * 100.0,
        ));
    }
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

#[cfg(test)]
pub(super) mod tests;
