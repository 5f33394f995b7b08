//! Alembic (Ogawa): one polygon mesh under a transform, with sampled positions, normals and bounds, for film and simulation pipelines.
//!
//! What does not move is written once. Frame N is at N ÷ rate seconds. Faces run the other way round than in the scan: in Alembic the outside
//! is where they run clockwise. Layouts: lib/Alembic/AbcCoreOgawa and AbcGeom of Alembic 1.8.

use super::ogawa::{Child, Ogawa, digest};
use super::parts::{self, Part};
use super::single::{Singles, bytes};
use super::usd::bounds;
use super::{Cancel, FrameBatch, FrameSink, Header, Needs, Written};
use crate::error::{Notes, Result};
use crate::scan::{Faces, Scan};
use crate::space::{Axis, Unit};
use crate::surface::NormalVertices;
use std::collections::HashSet;
use std::path::{Path, PathBuf};
use std::sync::Arc;

mod schema;

use schema::{Archive, Compound, Kind, Object, Samples, Type};

/// Index of the uniform time sampling of the frames; 0 is Alembic's own, for what has one sample.
const FRAMES: u32 = 1;

const SCHEMA_MESH: &str = "schema=AbcGeom_PolyMesh_v1;schemaBaseType=AbcGeom_GeomBase_v1";
const SCHEMA_FACES: &str = "schema=AbcGeom_FaceSet_v1;schemaBaseType=AbcGeom_GeomBase_v1";
const SCHEMA_TRANSFORM: &str = "schema=AbcGeom_Xform_v3";

/// Writes an `.abc` file, in the scan's own unit, axes and vertex order.
#[derive(Debug)]
pub struct Alembic {
    path: PathBuf,
    open: Option<Open>,
}

#[derive(Debug)]
struct Open {
    header: Arc<Header>,
    archive: Archive,
    singles: Singles,
    /// Whether hard edges give vertices several normals; else the first normals are those of the vertices.
    split: bool,
    normal_vertices: NormalVertices,
    positions: Samples,
    normals: Samples,
    bounds: Samples,
    cancel: Cancel,
    buffer: Vec<u8>,
}

impl Alembic {
    /// A sink for `path`.
    pub fn new(path: &Path) -> Self {
        Self { path: path.to_owned(), open: None }
    }
}

impl FrameSink for Alembic {
    fn needs(&self) -> Needs {
        Needs { points: true, normals: true }
    }

    fn begin(&mut self, header: &Arc<Header>) -> Result<()> {
        let normal_vertices = NormalVertices::of(&header.scan);
        let vertices = header.scan.mesh.positions.len();
        self.open = Some(Open {
            header: header.clone(),
            archive: Archive::create(&self.path)?,
            singles: Singles::new(vertices, header.unit_box, header.first_frame),
            split: normal_vertices.vertices.len() > vertices,
            normal_vertices,
            positions: Samples::default(),
            normals: Samples::default(),
            bounds: Samples::default(),
            cancel: header.cancel.clone(),
            buffer: Vec::new(),
        });
        Ok(())
    }

    fn frames(&mut self, batch: &FrameBatch<'_>) -> Result<()> {
        let open = self.open.as_mut().expect("begin comes before frames");
        assert_eq!(batch.points.len(), batch.normals.len(), "a frame has points and normals");
        for (points, normals) in batch.points.iter().zip(batch.normals) {
            open.cancel.check()?;
            open.frame(points, normals)?;
        }
        // Here and not on finish, which has to be quick and sure.
        if open.singles.frames() == open.header.frames {
            open.complete()?;
        }
        Ok(())
    }

    fn finish(self: Box<Self>) -> Result<Written> {
        let open = self.open.expect("begin comes before finish");
        assert_eq!(open.singles.frames(), open.header.frames, "as many frames as were announced");
        let bytes = open.archive.finish()?;
        Ok(open.singles.written(self.path, bytes, "Alembic", Notes::default()))
    }
}

impl Open {
    fn frame(&mut self, points: &[[f32; 3]], normals: &[[f32; 3]]) -> Result<()> {
        let points = self.singles.frame(points);
        bytes(points, f32::to_le_bytes, &mut self.buffer);
        self.archive.sample(&mut self.positions, &self.buffer)?;
        let (low, high) = bounds(points);
        let corners: Vec<u8> = [low, high].as_flattened().iter().flat_map(|&x| f64::from(x).to_le_bytes()).collect();
        self.archive.sample(&mut self.bounds, &corners)?;
        let count = if self.split { self.normal_vertices.vertices.len() } else { points.len() };
        bytes(&normals[..count], f32::to_le_bytes, &mut self.buffer);
        self.archive.sample(&mut self.normals, &self.buffer)
    }

    /// Writes what does not move, and the tables of all.
    fn complete(&mut self) -> Result<()> {
        let header = self.header.clone();
        let children = self.face_sets(&header.scan)?;
        let mesh = self.mesh(&header.scan)?;
        let mesh = self.archive.object("mesh", SCHEMA_MESH, "AbcGeom_PolyMesh_v1:.geom", vec![mesh], children)?;
        let inherits = self.archive.constant(b"\x01")?;
        let inherits = self.archive.property(".inherits", Type::BOOL, "", (1, 0), Kind::Scalar, inherits)?;
        let transform = self.archive.compound(".xform", SCHEMA_TRANSFORM, vec![inherits])?;
        let name = "scan";
        let transform = self.archive.object(name, SCHEMA_TRANSFORM, "AbcGeom_Xform_v3:.xform", vec![transform], vec![mesh])?;
        let times = Times { first: header.first_frame as f64 / header.rate, rate: header.rate, frames: header.frames };
        self.archive.close(&description(&header), transform, times)
    }

    fn mesh(&mut self, scan: &Scan) -> Result<Compound> {
        let frames = self.header.frames as u32;
        let times = (frames, FRAMES);
        let faces = &scan.mesh.faces;
        let (archive, split) = (&mut self.archive, self.split);
        let positions = std::mem::take(&mut self.positions);
        let mut all = Vec::new();
        let bounds = std::mem::take(&mut self.bounds);
        all.push(archive.property(".selfBnds", Type::BOX, "interpretation=box", times, Kind::Scalar, bounds)?);
        all.push(archive.property("P", Type::F3, "geoScope=vtx;interpretation=point", times, Kind::Array, positions)?);
        let indices = integers(reversed(faces, &faces.corners));
        let counts = integers(faces.iter().map(|f| f.len() as u32));
        for (name, values) in [(".faceIndices", indices), (".faceCounts", counts)] {
            let samples = archive.constant(&values)?;
            all.push(archive.property(name, Type::I32, "", times, Kind::Array, samples)?);
        }
        if let Some((values, indices)) = parts::corner_uvs(scan) {
            let meta = parameter("fvr", "vector", 2);
            let mut buffer = Vec::new();
            bytes(&values, f32::to_le_bytes, &mut buffer);
            let values = archive.constant(&buffer)?;
            let values = archive.property(".vals", Type::F2, &meta, times, Kind::Array, values)?;
            let indices = archive.constant(&integers(reversed(faces, &indices)))?;
            let indices = archive.property(".indices", Type::U32, "", times, Kind::Array, indices)?;
            all.push(archive.compound("uv", &meta, vec![values, indices])?);
        }
        let normals = std::mem::take(&mut self.normals);
        if split {
            let meta = parameter("fvr", "normal", 3);
            let values = archive.property(".vals", Type::F3, &meta, times, Kind::Array, normals)?;
            let indices = archive.constant(&integers(reversed(faces, &self.normal_vertices.corners)))?;
            let indices = archive.property(".indices", Type::U32, "", times, Kind::Array, indices)?;
            all.push(archive.compound("N", &meta, vec![values, indices])?);
        } else {
            all.push(archive.property("N", Type::F3, &parameter("vtx", "normal", 3), times, Kind::Array, normals)?);
        }
        if !scan.look.colors.is_empty() {
            let (kind, interpretation, width) = match scan.look.colors_have_alpha {
                true => (Type::F4, "rgba", 4),
                false => (Type::F3, "rgb", 3),
            };
            let colors = scan.look.colors.iter().flat_map(|c| c[..width].to_vec());
            let colors: Vec<u8> = colors.flat_map(f32::to_le_bytes).collect();
            let colors = archive.constant(&colors)?;
            let meta = parameter("vtx", interpretation, width);
            let colors = archive.property("Cd", kind, &meta, times, Kind::Array, colors)?;
            all.push(archive.compound(".arbGeomParams", "", vec![colors])?);
        }
        archive.compound(".geom", SCHEMA_MESH, all)
    }

    /// The faces of materials, or of groups where there are no materials: clients make materials of them.
    fn face_sets(&mut self, scan: &Scan) -> Result<Vec<Object>> {
        let materials = parts::materials(scan);
        let sets = if materials.is_empty() { parts::groups(scan) } else { materials };
        let mut taken = HashSet::new();
        sets.into_iter().map(|set| self.face_set(&set_name(&set, &mut taken), &set)).collect()
    }

    fn face_set(&mut self, name: &str, set: &Part) -> Result<Object> {
        // The box of a face set is empty unless somebody measures it.
        let empty: Vec<u8> = [f64::MAX, f64::MIN].iter().flat_map(|x| x.to_le_bytes().repeat(3)).collect();
        let archive = &mut self.archive;
        let empty = archive.constant(&empty)?;
        let empty = archive.property(".selfBnds", Type::BOX, "interpretation=box", (1, 0), Kind::Scalar, empty)?;
        let faces = archive.constant(&integers(set.faces.iter().copied()))?;
        let faces = archive.property(".faces", Type::I32, "", (1, 0), Kind::Array, faces)?;
        let compound = archive.compound(".faceset", SCHEMA_FACES, vec![empty, faces])?;
        archive.object(name, SCHEMA_FACES, "AbcGeom_FaceSet_v1:.faceset", vec![compound], Vec::new())
    }
}

/// Uniform times of the frames.
#[derive(Clone, Copy, Debug)]
struct Times {
    /// Seconds of the first.
    first: f64,
    /// Frames per second.
    rate: f64,
    frames: usize,
}

/// What the archive says of itself.
fn description(header: &Header) -> String {
    let unit = header.metres.and_then(Unit::of_metres).map_or("not known".to_owned(), |u| u.to_string());
    let up = header.up.map(Axis::nearest).map_or("not known".to_owned(), |a| a.to_string().replace('\u{2212}', "-"));
    let plain = |c: char| c.is_control() || c == ';' || c == '=';
    format!(
        "FramesPerTimeUnit={:.6};_ai_Application=retarget;_ai_Description={}, unit {unit}, up {up}",
        header.rate,
        header.take.replace(plain, "_")
    )
}

/// Metadata of a geometry parameter of 32-bit floats.
fn parameter(scope: &str, interpretation: &str, extent: usize) -> String {
    format!(
        "arrayExtent=1;geoScope={scope};interpretation={interpretation};isGeomParam=true;podExtent={extent};podName=float32_t"
    )
}

/// Values of corners with every face the other way round.
fn reversed<'a>(faces: &'a Faces, values: &'a [u32]) -> impl Iterator<Item = u32> + 'a {
    (0..faces.len()).flat_map(move |f| values[faces.range(f)].iter().rev().copied())
}

fn integers(values: impl Iterator<Item = u32>) -> Vec<u8> {
    values.flat_map(u32::to_le_bytes).collect()
}

/// The name of an object: any but empty, with a slash, or one that is taken.
fn set_name(set: &Part, taken: &mut HashSet<String>) -> String {
    let plain: String = set.name.chars().map(|c| if c == '/' || c.is_control() { '_' } else { c }).collect();
    let plain = if plain.is_empty() { "part".to_owned() } else { plain };
    let mut free = plain.clone();
    let mut number = 2;
    while !taken.insert(free.clone()) {
        free = format!("{plain}_{number}");
        number += 1;
    }
    free
}
