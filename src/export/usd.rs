//! USD as text: one mesh with time-sampled points, normals and extent, for film and simulation pipelines.
//!
//! What does not move is written once. Time codes are frame numbers. All samples of an attribute stand together in this format, so those of the
//! normals wait in a file without a name until the points are complete.

use super::files::Pending;
use super::parts::{self, Identifiers, Part};
use super::single::Singles;
use super::{Cancel, FrameBatch, FrameSink, Header, Needs, Written};
use crate::error::{Error, Notes, Result};
use crate::scan::Scan;
use crate::space::Axis;
use crate::surface::NormalVertices;
use rayon::prelude::*;
use std::fmt::{Display, Write as _};
use std::fs::File;
use std::io::{Read, Seek, SeekFrom, Write as _};
use std::path::{Path, PathBuf};
use std::sync::Arc;

mod material;

/// Vertices that are turned into text by one thread at a time.
const PIECE: usize = 8192;

/// Bytes that are copied at a time.
const COPIED: usize = 1 << 20;

/// Writes a `.usda` file, in the scan's own unit, axes and vertex order.
#[derive(Debug)]
pub struct Usd {
    path: PathBuf,
    open: Option<Open>,
}

#[derive(Debug)]
struct Open {
    file: Pending,
    normals: File,
    extents: String,
    singles: Singles,
    first_frame: i64,
    frames: usize,
    /// Attribute of the normals, and how many there are.
    normal_name: &'static str,
    normal_count: usize,
    subsets: String,
    cancel: Cancel,
    notes: Notes,
    pieces: Vec<String>,
}

impl Usd {
    /// A sink for `path`.
    pub fn new(path: &Path) -> Self {
        Self { path: path.to_owned(), open: None }
    }
}

impl FrameSink for Usd {
    fn needs(&self) -> Needs {
        Needs { points: true, normals: true }
    }

    fn begin(&mut self, header: &Arc<Header>) -> Result<()> {
        let mut file = Pending::create(&self.path)?;
        let folder = crate::beside::folder_of(&self.path);
        let normals = tempfile::tempfile_in(folder).map_err(|e| Error::unwritable(&self.path, &e))?;
        let mut notes = Notes::default();
        let scan = &*header.scan;
        let vertices = scan.mesh.positions.len();
        let normal_vertices = NormalVertices::of(scan);
        // Where no edge is hard, the first normals are those of the vertices.
        let split = normal_vertices.vertices.len() > vertices;
        let (normal_name, interpolation) = if split { ("primvars:normals", "faceVarying") } else { ("normals", "vertex") };
        let materials = parts::materials(scan);
        let mut identifiers = Identifiers::default();
        let identified: Vec<(String, Part)> = materials.into_iter().map(|m| (identifiers.of(&m.name), m)).collect();

        let mut text = layer(header, &mut notes);
        text += "\ndef Xform \"scan\"\n{\n";
        text += &material::scope(scan, &identified, folder, &mut notes);
        text += &mesh(scan, !identified.is_empty());
        let _ = writeln!(
            text,
            "        normal3f[] {normal_name} (\n            interpolation = \"{interpolation}\"\n        )\n        point3f[] points.timeSamples = {{"
        );
        if split {
            let indices = format!("        int[] {normal_name}:indices = {}\n", list(&normal_vertices.corners));
            let at = text.rfind("        point3f[]").unwrap_or(text.len());
            text.insert_str(at, &indices);
        }
        file.write(text.as_bytes())?;
        self.open = Some(Open {
            file,
            normals,
            extents: String::new(),
            singles: Singles::new(vertices, header.unit_box, header.first_frame),
            first_frame: header.first_frame,
            frames: header.frames,
            normal_name,
            normal_count: if split { normal_vertices.vertices.len() } else { vertices },
            subsets: subsets(scan, &identified, &mut identifiers),
            cancel: header.cancel.clone(),
            notes,
            pieces: Vec::new(),
        });
        Ok(())
    }

    fn frames(&mut self, batch: &FrameBatch<'_>) -> Result<()> {
        let open = self.open.as_mut().expect("begin comes before frames");
        assert_eq!(batch.points.len(), batch.normals.len(), "a frame has points and normals");
        for (points, normals) in batch.points.iter().zip(batch.normals) {
            open.cancel.check()?;
            open.frame(points, normals, &self.path)?;
        }
        // Here and not on finish, which has to be quick and sure.
        if open.singles.frames() == open.frames {
            open.complete(&self.path)?;
        }
        Ok(())
    }

    fn finish(self: Box<Self>) -> Result<Written> {
        let open = self.open.expect("begin comes before finish");
        assert_eq!(open.singles.frames(), open.frames, "as many frames as were announced");
        let bytes = open.file.finish()?;
        Ok(open.singles.written(self.path, bytes, "USD", open.notes))
    }
}

impl Open {
    fn frame(&mut self, points: &[[f32; 3]], normals: &[[f32; 3]], path: &Path) -> Result<()> {
        let code = self.first_frame + self.singles.frames() as i64;
        let points = self.singles.frame(points);
        let (low, high) = bounds(points);
        let _ = writeln!(self.extents, "            {code}: [{}, {}],", Tuple(low), Tuple(high));
        sample(code, points, &mut self.pieces, |text| self.file.write(text))?;
        sample(code, &normals[..self.normal_count], &mut self.pieces, |text| {
            self.normals.write_all(text).map_err(|e| Error::unwritable(path, &e))
        })
    }

    /// Writes what stands behind the points.
    fn complete(&mut self, path: &Path) -> Result<()> {
        self.file.write(format!("        }}\n        normal3f[] {}.timeSamples = {{\n", self.normal_name).as_bytes())?;
        let unreadable = |e: std::io::Error| Error::unwritable(path, &e);
        self.normals.seek(SeekFrom::Start(0)).map_err(unreadable)?;
        let mut buffer = vec![0; COPIED];
        loop {
            self.cancel.check()?;
            let count = self.normals.read(&mut buffer).map_err(unreadable)?;
            if count == 0 {
                break;
            }
            self.file.write(&buffer[..count])?;
        }
        let rest = format!("        }}\n        float3[] extent.timeSamples = {{\n{}        }}\n", self.extents);
        self.file.write(rest.as_bytes())?;
        self.file.write(self.subsets.as_bytes())?;
        self.file.write(b"    }\n}\n")
    }
}

/// The head of the file.
fn layer(header: &Header, notes: &mut Notes) -> String {
    let last = header.first_frame + header.frames as i64 - 1;
    let mut text = format!(
        "#usda 1.0\n(\n    defaultPrim = \"scan\"\n    doc = \"written by retarget\"\n    endTimeCode = {last}\n    framesPerSecond = {}\n",
        header.rate
    );
    match header.metres {
        Some(metres) => text += &format!("    metersPerUnit = {metres}\n"),
        None => notes.warn("USD: the scan's unit is not known, so the file states none: readers take centimetres"),
    }
    text += &format!("    startTimeCode = {}\n    timeCodesPerSecond = {}\n", header.first_frame, header.rate);
    match header.up.map(Axis::nearest) {
        Some(Axis { index: index @ 1..=2, negative: false }) => {
            text += &format!("    upAxis = \"{}\"\n", ["X", "Y", "Z"][index]);
        }
        up => {
            let up = up.map_or("not known".to_owned(), |axis| axis.to_string());
            notes.warn(format!("USD: up is {up}, which the format cannot state: readers take Y"));
        }
    }
    text + ")\n"
}

/// The mesh up to what moves.
fn mesh(scan: &Scan, has_materials: bool) -> String {
    let faces = &scan.mesh.faces;
    let mut text = String::from("    def Mesh \"mesh\"");
    if has_materials {
        text += " (\n        prepend apiSchemas = [\"MaterialBindingAPI\"]\n    )";
    }
    text += "\n    {\n        uniform token subdivisionScheme = \"none\"\n";
    if !super::glb::is_solid(scan) {
        text += "        uniform bool doubleSided = 1\n";
    }
    text += &format!("        int[] faceVertexCounts = {}\n", list(faces.iter().map(<[u32]>::len)));
    text += &format!("        int[] faceVertexIndices = {}\n", list(&faces.corners));
    if let Some((values, indices)) = parts::corner_uvs(scan) {
        let values = list(values.into_iter().map(Tuple));
        text +=
            &format!("        texCoord2f[] primvars:st = {values} (\n            interpolation = \"faceVarying\"\n        )\n");
        text += &format!("        int[] primvars:st:indices = {}\n", list(indices));
    }
    let colors = &scan.look.colors;
    if !colors.is_empty() {
        let values = list(colors.iter().map(|c| Tuple([c[0], c[1], c[2]].map(super::glb::linear))));
        text +=
            &format!("        color3f[] primvars:displayColor = {values} (\n            interpolation = \"vertex\"\n        )\n");
    }
    if scan.look.colors_have_alpha {
        let values = list(colors.iter().map(|c| c[3]));
        text +=
            &format!("        float[] primvars:displayOpacity = {values} (\n            interpolation = \"vertex\"\n        )\n");
    }
    text
}

/// The faces of materials and of groups.
fn subsets(scan: &Scan, materials: &[(String, Part)], identifiers: &mut Identifiers) -> String {
    let mut text = String::new();
    let head = |text: &mut String, identifier: &str, part: &Part, api: &str, family: &str| {
        let name = quoted(&part.name);
        let _ = write!(
            text,
            "\n        def GeomSubset \"{identifier}\" (\n{api}            customData = {{\n                string name = {name}\n            }}\n        )\n        {{\n            uniform token elementType = \"face\"\n            uniform token familyName = \"{family}\"\n            int[] indices = {}\n",
            list(&part.faces)
        );
    };
    if !materials.is_empty() {
        text += "        uniform token subsetFamily:materialBind:familyType = \"nonOverlapping\"\n";
    }
    let groups = parts::groups(scan);
    if !groups.is_empty() {
        text += "        uniform token subsetFamily:group:familyType = \"nonOverlapping\"\n";
    }
    for (identifier, part) in materials {
        let api = "            prepend apiSchemas = [\"MaterialBindingAPI\"]\n";
        head(&mut text, identifier, part, api, "materialBind");
        let _ = write!(text, "            rel material:binding = </scan/materials/{identifier}>\n        }}\n");
    }
    for part in groups {
        head(&mut text, &identifiers.of(&part.name), &part, "", "group");
        text += "        }\n";
    }
    text
}

/// A time sample: `code: [(x, y, z), …],` handed on in pieces.
fn sample(code: i64, values: &[[f32; 3]], pieces: &mut Vec<String>, mut write: impl FnMut(&[u8]) -> Result<()>) -> Result<()> {
    pieces.resize(values.len().div_ceil(PIECE), String::new());
    pieces.par_iter_mut().zip(values.par_chunks(PIECE)).enumerate().for_each(|(piece, (out, values))| {
        out.clear();
        for (k, &value) in values.iter().enumerate() {
            let comma = if piece + k == 0 { "" } else { ", " };
            let _ = write!(out, "{comma}{}", Tuple(value));
        }
    });
    write(format!("            {code}: [").as_bytes())?;
    pieces.iter().try_for_each(|piece| write(piece.as_bytes()))?;
    write(b"],\n")
}

/// `(x, y, z)`, with the digits that give the same number back.
struct Tuple<const N: usize>([f32; N]);

impl<const N: usize> Display for Tuple<N> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        for (k, x) in self.0.iter().enumerate() {
            write!(f, "{}{x}", if k == 0 { "(" } else { ", " })?;
        }
        f.write_str(")")
    }
}

fn list<T: Display>(values: impl IntoIterator<Item = T>) -> String {
    let mut text = String::from("[");
    for (k, value) in values.into_iter().enumerate() {
        let _ = write!(text, "{}{value}", if k == 0 { "" } else { ", " });
    }
    text + "]"
}

/// A text in quotes.
fn quoted(text: &str) -> String {
    let mut out = String::from("\"");
    for c in text.chars() {
        match c {
            '"' | '\\' => out.extend(['\\', c]),
            c if c.is_control() => out.push('_'),
            c => out.push(c),
        }
    }
    out + "\""
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
