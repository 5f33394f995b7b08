//! A sink of one's own: the box around the scan in every frame, as CSV, written by the same stream as any format.
//!
//! `cargo run --release --example custom_sink fixtures/scan.obj fixtures/walk.c3d box.csv`

use retarget::binding::{self, ScanShape, landmarks};
use retarget::deform::Handle;
use retarget::deform::volumetric::{Options, Volumetric};
use retarget::error::Result;
use retarget::export::{Cancel, FrameBatch, FrameSink, Header, Needs, Written, files::Pending};
use retarget::glam::DVec3;
use retarget::pipeline::{self, Job};
use retarget::proxy::rows::{HandleRows, MapKind};
use retarget::{capture, proxy, scan, spatial::TriangleTree, surface::SurfaceMap};
use std::fmt::Write;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Writes the least and the greatest coordinates of every frame, in the scan's own unit.
pub struct BoxSink {
    path: PathBuf,
    // Beside the target under a temporary name: dropped unfinished, it leaves nothing behind.
    open: Option<(Pending, Arc<Header>)>,
    bytes: u64,
}

impl BoxSink {
    /// A sink that writes to `path`.
    pub fn new(path: &Path) -> Self {
        Self { path: path.to_owned(), open: None, bytes: 0 }
    }

    fn write(&mut self, text: &str) -> Result<()> {
        self.bytes += text.len() as u64;
        self.open.as_mut().map_or(Ok(()), |(file, _)| file.write(text.as_bytes()))
    }
}

impl FrameSink for BoxSink {
    fn needs(&self) -> Needs {
        Needs { points: true, normals: false }
    }

    fn begin(&mut self, header: &Arc<Header>) -> Result<()> {
        self.open = Some((Pending::create(&self.path)?, header.clone()));
        self.write("frame,least x,y,z,greatest x,y,z\n")
    }

    fn frames(&mut self, batch: &FrameBatch<'_>) -> Result<()> {
        let Some((_, header)) = &self.open else { return Ok(()) };
        let mut text = String::new();
        for (k, points) in batch.points.iter().enumerate() {
            let places = points.iter().map(|p| header.unit_box.leave(DVec3::from(p.map(f64::from))));
            let (lo, hi) = places.fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(lo, hi), p| (lo.min(p), hi.max(p)));
            let frame = header.first_frame + (batch.first + k) as i64;
            let _ = writeln!(text, "{frame},{},{},{},{},{},{}", lo.x, lo.y, lo.z, hi.x, hi.y, hi.z);
        }
        self.write(&text)
    }

    fn finish(mut self: Box<Self>) -> Result<Written> {
        if let Some((file, _)) = self.open.take() {
            file.finish()?;
        }
        Ok(Written { path: self.path, bytes: self.bytes, encoding: "boxes".into(), ..Written::default() })
    }
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let argument = |k: usize, otherwise: &str| std::env::args().nth(k).unwrap_or_else(|| otherwise.to_owned());
    let [scan, capture, out] = [argument(1, "fixtures/scan.obj"), argument(2, "fixtures/walk.c3d"), argument(3, "box.csv")];
    stream(scan.as_ref(), capture.as_ref(), out.as_ref(), 0..usize::MAX)
}

/// Streams frames of a take, counted from 0, into the sink.
pub fn stream(scan: &Path, capture: &Path, out: &Path, range: std::ops::Range<usize>) -> Result<(), Box<dyn std::error::Error>> {
    let scan = scan::read(scan)?;
    let capture = capture::read(capture, &capture::ReadOptions::default())?;
    let unit_box = scan::UnitBox::of(&scan.mesh).ok_or("an empty mesh")?;
    let points: Vec<DVec3> = scan.mesh.positions.iter().map(|&p| unit_box.enter(p)).collect();
    let triangles = scan.mesh.vertex_triangles();
    let tree = TriangleTree::new(&points, &triangles);
    let shape = ScanShape { tree: &tree, unit_box, space: &scan.space, mesh: Some(&scan.mesh) };
    let body = landmarks::find(&points, &triangles);
    let binding = binding::bind(&shape, body, &capture, None, &binding::Options::default(), &|_, _| Ok(()))?;
    let proxy = Arc::new(proxy::build(&points, &triangles, &Default::default(), &|| Ok(()))?.proxy);
    let map = Arc::new(SurfaceMap::build_by_pieces(&proxy, &points, &scan.mesh.faces, MapKind::Ring)?);
    let rows = HandleRows::new(&proxy, MapKind::Ring);
    let handle = |h: &binding::BoundMarker| Handle { name: h.label.clone(), row: rows.row(h.attachment), beta: h.beta };
    let handles: Vec<Handle> = binding.handles.iter().map(handle).collect();

    let take = binding.take(&capture);
    let range = range.start..range.end.min(take.frames());
    let header = Header {
        scan: Arc::new(scan),
        unit_box,
        proxy: proxy.clone(),
        map,
        take: capture.name.clone(),
        rate: capture.rate,
        first_frame: capture.first_frame + range.start as i64,
        frames: range.len(),
        places: binding.places().map(|(name, p)| (name.to_owned(), p)).collect(),
        up: None,
        metres: None,
        cancel: Cancel::default(),
    };
    let job = Job {
        header: Arc::new(header),
        take,
        range,
        first_frame: capture.first_frame,
        binding: &binding,
        handles: &handles,
        oriented: &[],
        deformer: Box::new(Volumetric::new(&proxy, &handles, &Options::default())?),
        sinks: vec![Box::new(BoxSink::new(out))],
        report: None,
        metres: None,
        examples: &[],
        overlap: true,
    };
    pipeline::run(job, &|_| ())?;
    Ok(())
}
