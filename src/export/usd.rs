//! USD, as text, as a crate or as a package: one mesh with time-sampled points, normals and extent, for film and simulation pipelines.
//!
//! What does not move is written once. Time codes are frame numbers.

use super::files::Pending;
use super::single::Singles;
use super::{Cancel, FrameBatch, FrameSink, Header, Needs, Written};
use crate::error::{Notes, Result};
use crate::surface::NormalVertices;
use std::path::{Path, PathBuf};
use std::sync::Arc;

mod binary;
mod material;
mod package;
mod stage;
mod text;
mod tree;

use material::Textures;
use package::Package;
use tree::Track;

/// Writes a `.usda`, `.usdc` or `.usdz` file, in the scan's own unit, axes and vertex order.
#[derive(Debug)]
pub struct Usd {
    path: PathBuf,
    open: Option<Open>,
}

/// How a stage becomes bytes.
trait Encoding: std::fmt::Debug + Send {
    /// Takes the value of a track at the next time code; all tracks come once per frame.
    fn sample(&mut self, track: Track, code: i64, values: &[[f32; 3]]) -> Result<()>;

    /// Writes all that is left.
    fn complete(&mut self, cancel: &Cancel) -> Result<()>;

    /// Puts the file in place of the target; returns its size in bytes.
    fn finish(self: Box<Self>) -> Result<u64>;
}

#[derive(Debug)]
struct Open {
    encoding: Box<dyn Encoding>,
    singles: Singles,
    first_frame: i64,
    frames: usize,
    /// How many of the normals are written.
    normals: usize,
    cancel: Cancel,
    notes: Notes,
}

impl Usd {
    /// A sink for `path`; its extension tells whether it is text or a package.
    pub fn new(path: &Path) -> Self {
        Self { path: path.to_owned(), open: None }
    }
}

impl FrameSink for Usd {
    fn needs(&self) -> Needs {
        Needs { points: true, normals: true }
    }

    fn begin(&mut self, header: &Arc<Header>) -> Result<()> {
        let mut notes = Notes::default();
        let scan = &*header.scan;
        let vertices = scan.mesh.positions.len();
        let normal_vertices = NormalVertices::of(scan);
        // First the file, since textures are named from its folder, which may be new.
        let file = Pending::create(&self.path)?;
        let path = &self.path;
        let extension = path.extension().unwrap_or_default().to_ascii_lowercase();
        let mut textures = match extension == "usdz" {
            true => Textures::Inside(Vec::new(), Vec::new()),
            false => Textures::Beside(crate::beside::folder_of(path)),
        };
        let layer = stage::layer(header, &normal_vertices, &mut textures, &mut notes);
        let normals = if stage::split(scan, &normal_vertices) { normal_vertices.vertices.len() } else { vertices };
        let encoding: Box<dyn Encoding> = match (textures, extension == "usdc") {
            (Textures::Inside(textures, _), _) => {
                Package::check_size(path, header.frames as u64 * (vertices + normals) as u64 * 12)?;
                Box::new(Package::begin([Pending::create(path)?, file], layer, textures, path)?)
            }
            (Textures::Beside(_), true) => Box::new(binary::Crate::begin(file, layer)?),
            (Textures::Beside(_), false) => Box::new(text::Text::begin(file, &layer, path)?),
        };
        self.open = Some(Open {
            encoding,
            singles: Singles::new(vertices, header.unit_box, header.first_frame),
            first_frame: header.first_frame,
            frames: header.frames,
            normals,
            cancel: header.cancel.clone(),
            notes,
        });
        Ok(())
    }

    fn frames(&mut self, batch: &FrameBatch<'_>) -> Result<()> {
        let open = self.open.as_mut().expect("begin comes before frames");
        assert_eq!(batch.points.len(), batch.normals.len(), "a frame has points and normals");
        for (points, normals) in batch.points.iter().zip(batch.normals) {
            open.cancel.check()?;
            let code = open.first_frame + open.singles.frames() as i64;
            let points = open.singles.frame(points);
            open.encoding.sample(Track::Points, code, points)?;
            open.encoding.sample(Track::Normals, code, &normals[..open.normals])?;
            let (low, high) = bounds(points);
            open.encoding.sample(Track::Extent, code, &[low, high])?;
        }
        // Here and not on finish, which has to be quick and sure.
        if open.singles.frames() == open.frames {
            open.encoding.complete(&open.cancel)?;
        }
        Ok(())
    }

    fn finish(self: Box<Self>) -> Result<Written> {
        let open = self.open.expect("begin comes before finish");
        assert_eq!(open.singles.frames(), open.frames, "as many frames as were announced");
        let bytes = open.encoding.finish()?;
        Ok(open.singles.written(self.path, bytes, "USD", open.notes))
    }
}

/// Corners of the box around points.
pub(super) fn bounds(points: &[[f32; 3]]) -> ([f32; 3], [f32; 3]) {
    let start = ([f32::INFINITY; 3], [f32::NEG_INFINITY; 3]);
    points.iter().fold(start, |(mut low, mut high), p| {
        for c in 0..3 {
            low[c] = low[c].min(p[c]);
            high[c] = high[c].max(p[c]);
        }
        (low, high)
    })
}
