//! PLY frame sequences: binary little endian, one file per frame, the scan's vertices and polygons in their order.
//!
//! All that does not move is laid out once; a frame only overwrites positions and normals in it.

use super::files::{Sequence, relative};
use super::{Cancel, FrameBatch, FrameSink, Header, Needs, Written};
use crate::error::{Notes, Result};
use crate::scan::{Appearance, Image, NONE, Scan, UnitBox, statements};
use glam::Vec3;
use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Rounding of single-precision coordinates, as a fraction of the diagonal, above which they are written in double precision.
const LARGEST_ROUNDING: f64 = 1e-7;

/// Writes `frames/f_####.ply`, in the scan's own unit and axes.
#[derive(Debug)]
pub struct PlyFrames {
    pattern: PathBuf,
    open: Option<Open>,
}

#[derive(Debug)]
struct Open {
    sequence: Sequence,
    layout: Layout,
    unit_box: UnitBox,
    first_frame: i64,
    cancel: Cancel,
    notes: Notes,
}

impl PlyFrames {
    /// A sink for a pattern such as `frames/f_####.ply`.
    pub fn new(pattern: &Path) -> Self {
        Self { pattern: pattern.to_owned(), open: None }
    }

    pub(super) fn open(&mut self, scan: &Scan, unit_box: UnitBox, first_frame: i64, cancel: &Cancel) -> Result<()> {
        let sequence = Sequence::create_or_single(&self.pattern)?;
        let mut notes = Notes::default();
        let layout = Layout::new(scan, unit_box, sequence.folder(), &mut notes);
        self.open = Some(Open { sequence, layout, unit_box, first_frame, cancel: cancel.clone(), notes });
        Ok(())
    }
}

impl FrameSink for PlyFrames {
    fn needs(&self) -> Needs {
        Needs { points: true, normals: true }
    }

    fn begin(&mut self, header: &Arc<Header>) -> Result<()> {
        self.open(&header.scan, header.unit_box, header.first_frame, &header.cancel)
    }

    fn frames(&mut self, batch: &FrameBatch<'_>) -> Result<()> {
        let open = self.open.as_mut().expect("begin comes before frames");
        assert_eq!(batch.points.len(), batch.normals.len(), "a frame has points and normals");
        for (k, (points, normals)) in batch.points.iter().zip(batch.normals).enumerate() {
            open.cancel.check()?;
            open.layout.pose(points, normals, &open.unit_box);
            open.sequence.write(open.first_frame + (batch.first + k) as i64, [open.layout.file.as_slice()])?;
        }
        Ok(())
    }

    fn finish(self: Box<Self>) -> Result<Written> {
        let open = self.open.expect("begin comes before finish");
        let finished = open.sequence.finish()?;
        let mut notes = open.notes;
        super::files::note_older(&finished, &mut notes);
        let encoding = if open.layout.double { "exact, double precision" } else { "exact" };
        Ok(Written { path: self.pattern, bytes: finished.bytes, encoding: encoding.to_owned(), notes, ..Written::default() })
    }
}

/// A whole file, and where its vertices are.
#[derive(Debug)]
struct Layout {
    file: Vec<u8>,
    begin: usize,
    stride: usize,
    vertices: usize,
    double: bool,
}

impl Layout {
    fn new(scan: &Scan, unit_box: UnitBox, folder: &Path, notes: &mut Notes) -> Self {
        let Scan { mesh, look, .. } = scan;
        let vertices = mesh.positions.len();
        let used = mesh.faces.corners.iter().map(|&v| mesh.positions[v as usize]);
        let largest = used.fold(0.0f64, |m, p| m.max(p.abs().max_element()));
        let double = largest * f64::from(f32::EPSILON) / 2.0 > LARGEST_ROUNDING * unit_box.diagonal;
        let bytes_suffice = has_byte_colors(look);
        let channels = if look.colors.is_empty() { 0 } else { 3 + usize::from(look.colors_have_alpha) };
        let uvs = vertex_uvs(scan);
        if uvs.is_none() && !look.corner_uvs.is_empty() {
            notes.warn("PLY: texture coordinates are left out, since corners of one vertex differ (OBJ and GLB keep them)");
        }
        let longest = mesh.faces.iter().map(<[u32]>::len).max().unwrap_or(0);
        let mut file = Vec::new();
        let mut line = |text: String| file.extend(text.into_bytes().into_iter().chain([b'\n']));
        line("ply\nformat binary_little_endian 1.0\ncomment written by retarget".to_owned());
        statements(&scan.space).into_iter().for_each(|s| line(format!("comment {s}")));
        if let (Some(_), Some(texture)) = (&uvs, only_texture(look)) {
            line(format!("comment TextureFile {}", relative(folder, texture)));
        }
        line(format!("element vertex {vertices}"));
        let kind = if double { "double" } else { "float" };
        ["x", "y", "z"].iter().for_each(|axis| line(format!("property {kind} {axis}")));
        ["nx", "ny", "nz"].iter().for_each(|axis| line(format!("property float {axis}")));
        let color_kind = if bytes_suffice { "uchar" } else { "float" };
        ["red", "green", "blue", "alpha"].iter().take(channels).for_each(|c| line(format!("property {color_kind} {c}")));
        if uvs.is_some() {
            line("property float s\nproperty float t".to_owned());
        }
        let length_kind = if longest <= 255 { "uchar" } else { "int" };
        line(format!("element face {}\nproperty list {length_kind} int vertex_indices\nend_header", mesh.faces.len()));
        let begin = file.len();
        let moving = if double { 36 } else { 24 };
        for v in 0..vertices {
            file.extend(&[0; 36][..moving]);
            if let Some(color) = look.colors.get(v) {
                for &channel in &color[..channels] {
                    if bytes_suffice {
                        file.push((channel * 255.0).round() as u8);
                    } else {
                        file.extend(channel.to_le_bytes());
                    }
                }
            }
            if let Some(uvs) = &uvs {
                uvs[v].iter().for_each(|x| file.extend(x.to_le_bytes()));
            }
        }
        let stride = (file.len() - begin).checked_div(vertices).unwrap_or(moving);
        for face in mesh.faces.iter() {
            if longest <= 255 {
                file.push(face.len() as u8);
            } else {
                file.extend((face.len() as u32).to_le_bytes());
            }
            face.iter().for_each(|v| file.extend(v.to_le_bytes()));
        }
        Self { file, begin, stride, vertices, double }
    }

    /// Puts the positions and normals of a frame into the file.
    fn pose(&mut self, points: &[[f32; 3]], normals: &[[f32; 3]], unit_box: &UnitBox) {
        assert!(points.len() == self.vertices && normals.len() >= self.vertices, "a frame has all vertices of the scan");
        let rows = self.file[self.begin..].chunks_exact_mut(self.stride);
        for ((row, &point), normal) in rows.zip(points).zip(normals) {
            let p = unit_box.leave(Vec3::from(point).as_dvec3());
            let mut out = row;
            let wrote = if self.double {
                p.to_array().iter().try_for_each(|x| out.write_all(&x.to_le_bytes()))
            } else {
                p.as_vec3().to_array().iter().try_for_each(|x| out.write_all(&x.to_le_bytes()))
            };
            wrote
                .and_then(|()| normal.iter().try_for_each(|x| out.write_all(&x.to_le_bytes())))
                .expect("the row has room for both");
        }
    }
}

/// Whether all colours are multiples of 1/255, as they are when the scan's file holds bytes.
fn has_byte_colors(look: &Appearance) -> bool {
    look.colors.iter().flatten().all(|&x| (x * 255.0 - (x * 255.0).round()).abs() < 1e-3)
}

/// One uv per vertex, if all corners of every vertex agree; `None` if they do not or there are none.
fn vertex_uvs(scan: &Scan) -> Option<Vec<[f32; 2]>> {
    let Scan { mesh, look, .. } = scan;
    if look.corner_uvs.is_empty() {
        return None;
    }
    let mut of_vertex = vec![NONE; mesh.positions.len()];
    for (&vertex, &uv) in mesh.faces.corners.iter().zip(&look.corner_uvs) {
        let known = &mut of_vertex[vertex as usize];
        if *known == NONE {
            *known = uv;
        } else if uv != NONE && look.uvs[uv as usize] != look.uvs[*known as usize] {
            return None;
        }
    }
    Some(of_vertex.into_iter().map(|uv| if uv == NONE { [0.0; 2] } else { look.uvs[uv as usize] }).collect())
}

/// The texture of the scan, if there is just one and it is a file.
fn only_texture(look: &Appearance) -> Option<&Path> {
    let mut textures = look.materials.iter().filter_map(|m| m.base_color_texture.as_ref());
    match textures.next()? {
        first @ Image::File(path) if textures.all(|t| t == first) => Some(path),
        _ => None,
    }
}
