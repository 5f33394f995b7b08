//! OBJ frame sequences: text, one file per frame, with the scan's polygons, groups, materials, uv and colours in their order.
//!
//! Each file names the scan's own material libraries by a path relative to the frames, so textures are found where they are and nothing
//! is copied. A scan with materials but no library (PLY with a texture) gets one beside the frames.

use super::files::{Sequence, relative};
use super::{Cancel, FrameBatch, FrameSink, Header, Needs, Written};
use crate::beside::{folder_of, locate};
use crate::error::{Notes, Result};
use crate::scan::{Group, Image, Material, NONE, Scan, UnitBox, statements};
use crate::surface::NormalVertices;
use glam::Vec3;
use rayon::prelude::*;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Vertices that are turned into text by one thread at a time.
const PIECE: usize = 8192;

/// Ending of the material library that is written where the scan has none.
const LIBRARY: &str = "materials.mtl";

/// Writes `frames/f_####.obj`, in the scan's own unit and axes.
///
/// Positions have as many digits as their double-precision value needs; normals have five decimals.
#[derive(Debug)]
pub struct ObjFrames {
    pattern: PathBuf,
    open: Option<Open>,
}

#[derive(Debug)]
struct Open {
    sequence: Sequence,
    text: Text,
    unit_box: UnitBox,
    first_frame: i64,
    cancel: Cancel,
    notes: Notes,
    vertex_pieces: Vec<String>,
    normal_pieces: Vec<String>,
}

impl ObjFrames {
    /// A sink for a pattern such as `frames/f_####.obj`.
    pub fn new(pattern: &Path) -> Self {
        Self { pattern: pattern.to_owned(), open: None }
    }

    pub(super) fn open(
        &mut self,
        scan: &Scan,
        normals: &NormalVertices,
        unit_box: UnitBox,
        first_frame: i64,
        cancel: &Cancel,
    ) -> Result<()> {
        let sequence = Sequence::create_or_single(&self.pattern)?;
        let mut notes = Notes::default();
        let libraries = libraries(scan, &sequence)?;
        if scan.look.colors_have_alpha {
            notes.warn("OBJ: the alpha of the vertex colours is left out: the format has none");
        }
        let text = Text::new(scan, normals, &libraries);
        let pieces = |count: usize| vec![String::new(); count.div_ceil(PIECE)];
        self.open = Some(Open {
            vertex_pieces: pieces(scan.mesh.positions.len()),
            normal_pieces: pieces(text.normals),
            sequence,
            text,
            unit_box,
            first_frame,
            cancel: cancel.clone(),
            notes,
        });
        Ok(())
    }
}

impl FrameSink for ObjFrames {
    fn needs(&self) -> Needs {
        Needs { points: true, normals: true }
    }

    fn begin(&mut self, header: &Arc<Header>) -> Result<()> {
        self.open(&header.scan, &NormalVertices::of(&header.scan), header.unit_box, header.first_frame, &header.cancel)
    }

    fn frames(&mut self, batch: &FrameBatch<'_>) -> Result<()> {
        let open = self.open.as_mut().expect("begin comes before frames");
        assert_eq!(batch.points.len(), batch.normals.len(), "a frame has points and normals");
        for (k, (points, normals)) in batch.points.iter().zip(batch.normals).enumerate() {
            open.cancel.check()?;
            open.frame(open.first_frame + (batch.first + k) as i64, points, normals)?;
        }
        Ok(())
    }

    fn finish(self: Box<Self>) -> Result<Written> {
        let open = self.open.expect("begin comes before finish");
        let finished = open.sequence.finish()?;
        let mut notes = open.notes;
        super::files::note_older(&finished, &mut notes);
        Ok(Written { path: self.pattern, bytes: finished.bytes, encoding: "exact".to_owned(), notes, ..Written::default() })
    }
}

impl Open {
    fn frame(&mut self, frame: i64, points: &[[f32; 3]], normals: &[[f32; 3]]) -> Result<()> {
        let Self { text, unit_box, vertex_pieces, normal_pieces, .. } = self;
        assert!(points.len() == text.vertices && normals.len() == text.normals, "a frame has all vertices of the scan");
        vertex_pieces.par_iter_mut().zip(points.par_chunks(PIECE)).enumerate().for_each(|(piece, (out, points))| {
            out.clear();
            for (k, &point) in points.iter().enumerate() {
                let p = unit_box.leave(Vec3::from(point).as_dvec3());
                let _ = writeln!(out, "v {} {} {}{}", p.x, p.y, p.z, text.color(piece * PIECE + k));
            }
        });
        normal_pieces.par_iter_mut().zip(normals.par_chunks(PIECE)).for_each(|(out, normals)| {
            out.clear();
            for [x, y, z] in normals {
                let _ = writeln!(out, "vn {x:.5} {y:.5} {z:.5}");
            }
        });
        let pieces =
            [&text.head].into_iter().chain(&*vertex_pieces).chain([&text.uvs]).chain(&*normal_pieces).chain([&text.faces]);
        self.sequence.write(frame, pieces.map(String::as_bytes))
    }
}

/// The parts of a file that do not move.
#[derive(Debug)]
struct Text {
    head: String,
    uvs: String,
    faces: String,
    /// Colours of all vertices, each with a blank before it, and where each begins.
    colors: String,
    color_starts: Vec<u32>,
    vertices: usize,
    normals: usize,
}

impl Text {
    fn new(scan: &Scan, normals: &NormalVertices, libraries: &[String]) -> Self {
        let Scan { mesh, look, .. } = scan;
        let mut head = String::from("# written by retarget\n");
        statements(&scan.space).iter().for_each(|s| head += &format!("# {s}\n"));
        libraries.iter().for_each(|l| head += &format!("mtllib {l}\n"));
        let mut uvs = String::new();
        look.uvs.iter().for_each(|[u, v]| uvs += &format!("vt {u} {v}\n"));
        let mut colors = String::new();
        let mut color_starts = Vec::new();
        for [r, g, b, _] in &look.colors {
            color_starts.push(colors.len() as u32);
            let _ = write!(colors, " {r} {g} {b}");
        }
        color_starts.push(colors.len() as u32);
        Self {
            head,
            uvs,
            faces: faces(scan, normals),
            colors,
            color_starts,
            vertices: mesh.positions.len(),
            normals: normals.vertices.len(),
        }
    }

    fn color(&self, vertex: usize) -> &str {
        match self.color_starts.get(vertex..vertex + 2) {
            Some(&[begin, end]) => &self.colors[begin as usize..end as usize],
            _ => "",
        }
    }
}

/// The faces with the groups and materials that hold for them.
fn faces(scan: &Scan, normals: &NormalVertices) -> String {
    let Scan { mesh, look, .. } = scan;
    let nothing = Group::default();
    let mut group = &nothing;
    let mut material = NONE;
    let mut text = String::with_capacity(mesh.faces.corners.len() * 20);
    for f in 0..mesh.faces.len() {
        let new_group = look.face_groups.get(f).and_then(|&g| look.groups.get(g as usize)).unwrap_or(&nothing);
        if new_group != group {
            if new_group.object != group.object {
                line(&mut text, "o", new_group.object.as_deref());
            }
            if new_group.group != group.group {
                line(&mut text, "g", new_group.group.as_deref());
            }
            group = new_group;
        }
        let new_material = look.face_materials.get(f).copied().unwrap_or(NONE);
        if new_material != material {
            line(&mut text, "usemtl", look.materials.get(new_material as usize).map(|m| m.name.as_str()));
            material = new_material;
        }
        text.push('f');
        for corner in mesh.faces.range(f) {
            let (vertex, normal) = (mesh.faces.corners[corner] + 1, normals.corners[corner] + 1);
            let _ = match look.corner_uvs.get(corner) {
                Some(&uv) if uv != NONE => write!(text, " {vertex}/{}/{normal}", uv + 1),
                _ => write!(text, " {vertex}//{normal}"),
            };
        }
        text.push('\n');
    }
    text
}

/// A statement, whose name may be missing.
fn line(text: &mut String, keyword: &str, name: Option<&str>) {
    text.push_str(keyword);
    if let Some(name) = name {
        text.push(' ');
        text.push_str(&on_one_line(name));
    }
    text.push('\n');
}

/// A name as a statement can hold it: other formats allow line ends in names.
fn on_one_line(name: &str) -> std::borrow::Cow<'_, str> {
    if name.contains(char::is_control) { name.replace(char::is_control, "_").into() } else { name.into() }
}

/// The libraries that the frames name: the scan's, as seen from the frames, or as written where they are missing; else an own one, if the
/// materials say more than their names.
fn libraries(scan: &Scan, sequence: &Sequence) -> Result<Vec<String>> {
    let look = &scan.look;
    let telling = |m: &Material| *m != Material { name: m.name.clone(), ..Material::default() };
    if look.material_libraries.is_empty() && look.materials.iter().any(telling) {
        let text = library(&look.materials, sequence)?;
        sequence.write_companion(LIBRARY, text.as_bytes())?;
        return Ok(vec![sequence.companion_name(LIBRARY)]);
    }
    let seen = |name: &String| match locate(folder_of(&scan.source), name) {
        Some(path) => relative(sequence.folder(), &path),
        None => name.clone(),
    };
    Ok(look.material_libraries.iter().map(seen).collect())
}

/// A library of the materials; images that lie in no file of their own are written beside it.
fn library(materials: &[Material], sequence: &Sequence) -> Result<String> {
    let mut text = String::from("# written by retarget\n");
    let mut written: Vec<&Image> = Vec::new();
    for Material { name, base_color: [r, g, b, a], base_color_texture, normal_texture, emissive, metallic, roughness, .. } in
        materials
    {
        let [er, eg, eb] = emissive;
        let name = on_one_line(name);
        text += &format!("newmtl {name}\nKd {r} {g} {b}\nd {a}\nKe {er} {eg} {eb}\nPm {metallic}\nPr {roughness}\n");
        for (keyword, texture) in [("map_Kd", base_color_texture), ("norm", normal_texture)] {
            let file = match texture {
                None => continue,
                Some(Image::File(path)) => relative(sequence.folder(), path),
                Some(image @ Image::Embedded { bytes, .. }) => {
                    let number = written.iter().position(|w| *w == image).unwrap_or(written.len());
                    let ending = if bytes.starts_with(&[0xFF, 0xD8]) { "jpg" } else { "png" };
                    let companion = format!("texture{}.{ending}", number + 1);
                    if number == written.len() {
                        sequence.write_companion(&companion, bytes)?;
                        written.push(image);
                    }
                    sequence.companion_name(&companion)
                }
            };
            text += &format!("{keyword} {file}\n");
        }
    }
    Ok(text)
}
