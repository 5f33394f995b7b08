//! Scan poses → files. One sink per format behind [`FrameSink`]; each is whole or absent.

use crate::error::{Error, Kind, Notes, Result};
use crate::proxy::Proxy;
use crate::scan::{Scan, UnitBox};
use glam::DVec3;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

pub mod alembic;
mod encode;
pub mod files;
pub mod glb;
mod measures;
pub mod obj;
mod ogawa;
pub mod page;
mod parts;
pub mod ply;
pub mod point_cache;
mod single;
pub mod stills;
pub mod usd;

pub use encode::{Encode, Tolerance};
pub use measures::{FrameMeasure, Measures, Residual};

pub(crate) use measures::rounded;

#[cfg(test)]
mod round_trips;

/// A request to stop, shared by all stages.
#[derive(Clone, Debug, Default)]
pub struct Cancel(Arc<AtomicBool>);

impl Cancel {
    /// Asks everybody to stop.
    pub fn cancel(&self) {
        self.0.store(true, Ordering::Relaxed);
    }

    /// An [`Kind::Interrupted`] error once somebody asked to stop.
    pub fn check(&self) -> Result<()> {
        if self.0.load(Ordering::Relaxed) { Err(Error::new(Kind::Interrupted, "interrupted")) } else { Ok(()) }
    }
}

/// What a sink needs to know before the first frame.
#[derive(Clone, Debug)]
pub struct Header {
    /// The scan at rest.
    pub scan: Arc<Scan>,
    /// Between the scan's space and the unit box of the poses.
    pub unit_box: UnitBox,
    /// The proxy at rest.
    pub proxy: Arc<Proxy>,
    /// The map from proxy poses to scan poses.
    pub map: Arc<crate::surface::SurfaceMap>,
    /// Name of the motion.
    pub take: String,
    /// Frames per second of what is written.
    pub rate: f64,
    /// Number of the first frame written, in the capture's own numbering.
    pub first_frame: i64,
    /// Number of frames that will be written.
    pub frames: usize,
    /// Places with names (body parts, handles) in the unit box, rest pose: joints are named after the nearest.
    pub places: Vec<(String, DVec3)>,
    /// Direction up in the scan's space, if known.
    pub up: Option<DVec3>,
    /// Length of the scan's unit in metres, if known.
    pub metres: Option<f64>,
    /// Stops long work.
    pub cancel: Cancel,
}

/// Some consecutive frames on their way out.
#[derive(Debug)]
pub struct FrameBatch<'a> {
    /// Index of the first of them, counted from 0.
    pub first: usize,
    /// Proxy poses in the unit box, one per frame.
    pub proxy: &'a [Vec<DVec3>],
    /// Scan vertices in the unit box, one array per frame; empty if no sink asked for them.
    pub points: &'a [Vec<[f32; 3]>],
    /// Unit normals per normal vertex (see [`crate::surface::NormalVertices`]), one array per frame; empty if no sink asked for them.
    pub normals: &'a [Vec<[f32; 3]>],
}

/// What a sink wants computed for it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Needs {
    /// Scan vertices.
    pub points: bool,
    /// Normals of the posed scan.
    pub normals: bool,
}

/// What a sink has written.
#[derive(Clone, Debug, Default)]
pub struct Written {
    /// File, or pattern of a sequence.
    pub path: PathBuf,
    /// Bytes in all.
    pub bytes: u64,
    /// Words for people: `skin, 64 joints`, `exact`.
    pub encoding: String,
    /// Distance of the decoded file from the computed motion at the worst vertex of the worst frame, in the scan's unit; 0 for exact formats.
    pub max_error: f64,
    /// The same, root mean square over all vertices and frames.
    pub rms_error: f64,
    /// The frame of `max_error`, in the capture's own numbering.
    pub worst_frame: Option<i64>,
    /// What was doubtful.
    pub notes: Notes,
}

/// Takes frames in order and makes a file of them.
///
/// Dropping a sink before [`FrameSink::finish`] leaves nothing behind.
pub trait FrameSink: Send {
    /// What it wants computed.
    fn needs(&self) -> Needs;

    /// Opens temporary files beside the target.
    fn begin(&mut self, header: &Arc<Header>) -> Result<()>;

    /// Takes the next frames.
    fn frames(&mut self, batch: &FrameBatch<'_>) -> Result<()>;

    /// Is told what was measured of the frames that it gets next.
    fn measured(&mut self, _measures: &Measures<'_>) -> Result<()> {
        Ok(())
    }

    /// Completes the file and puts it in place of the target.
    fn finish(self: Box<Self>) -> Result<Written>;
}
