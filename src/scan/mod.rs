//! Mesh files → [`Scan`]. One file per format; everything that the file says is kept in the file's own order, unit and axes.

mod archive;
mod beside;
mod gltf;
mod mtl;
mod obj;
mod off;
mod ply;
mod poses;
mod remarks;
mod source;
mod stl;
mod text;
mod triangulate;

#[cfg(any(test, fuzzing))]
pub(crate) mod fuzz;

#[cfg(test)]
mod broken_files;
#[cfg(test)]
mod corpus;
#[cfg(test)]
mod mutants;

use crate::error::{Error, Kind, Notes, Result};
use crate::space::Space;
use beside::Beside;
use glam::DVec3;
use std::path::{Path, PathBuf};
use std::sync::Arc;

pub(crate) use gltf::{Hold, Shapes};
pub use poses::{Pose, read_poses};
pub(crate) use remarks::statements;
pub use triangulate::Triangles;

/// Reads a mesh file: OBJ with its material libraries, PLY, STL, OFF, glTF or GLB; each also packed by gzip, or as the only mesh of a zip
/// archive with what it needs beside it. The content decides, then the extension.
///
/// Errors name the file and the place in it: it cannot be read, breaks its format, or has no faces. What is merely doubtful is in
/// [`Scan::notes`].
pub fn read(path: &Path) -> Result<Scan> {
    parse(path).map_err(|e| e.hint_for_broken_file())
}

fn parse(path: &Path) -> Result<Scan> {
    let source::Content { bytes, name, beside } = source::load(path)?;
    let mut scan = parse_bytes(&bytes, &name, &beside)?;
    scan.source = path.to_owned();
    Ok(scan)
}

/// Reads a mesh from its bytes; `path` names it in errors.
fn parse_bytes(bytes: &[u8], path: &Path, beside: &Beside) -> Result<Scan> {
    match source::format(path, bytes)? {
        source::Format::Obj => obj::read(bytes, path, beside),
        source::Format::Ply => ply::read(bytes, path, beside),
        source::Format::Stl => stl::read(bytes, path),
        source::Format::Off => off::read(bytes, path),
        source::Format::Gltf => gltf::read(bytes, path, beside),
    }
}

/// The error for a file without faces; `others`: what it holds instead.
fn nothing_to_animate(vertices: usize, others: &[(usize, &str)]) -> Error {
    let others = others.iter().filter(|(count, _)| *count > 0).map(|(count, what)| format!(", {count} {what}"));
    let found = format!("nothing to animate: {vertices} vertices, no faces{}", others.collect::<String>());
    Error::new(Kind::Unsupported, found)
        .expected("a surface: faces over the vertices")
        .hint("reconstruct a surface from the points first")
}

/// Brings colours into 0 to 1; returns a note if the file counts them to 255.
fn settle_colors(look: &mut Appearance) -> Option<String> {
    let largest = look.colors.iter().flat_map(|c| &c[..3]).fold(0.0f32, |m, &x| m.max(x));
    let scale = if largest > 1.0 { 255.0 } else { 1.0 };
    for channel in look.colors.iter_mut().flatten() {
        *channel = if channel.is_finite() { *channel } else { 1.0 };
    }
    for color in &mut look.colors {
        // White by default, so an alpha up to 1 is no 255th.
        let alpha_scale = if color[3] > 1.0 { 255.0 } else { 1.0 };
        *color = [color[0] / scale, color[1] / scale, color[2] / scale, color[3] / alpha_scale].map(|x| x.clamp(0.0, 1.0));
    }
    (scale > 1.0).then(|| "vertex colours go above 1: taken as 0 to 255".to_owned())
}

/// Marks a corner without uv, a face without material, and the like.
pub const NONE: u32 = u32::MAX;

/// A mesh as its file holds it, with its looks.
#[derive(Clone, Debug, Default)]
pub struct Scan {
    /// Vertices and faces.
    pub mesh: SurfaceMesh,
    /// Texture coordinates, colours, materials, groups.
    pub look: Appearance,
    /// What the file says of unit and axes.
    pub space: Space,
    /// The file it came from.
    pub source: PathBuf,
    /// What was doubtful about the file.
    pub notes: Notes,
}

impl Scan {
    /// The scan with the faces that pass, by the positions of their corners, and all its vertices.
    pub fn with_faces(&self, passes: impl Fn(&[DVec3]) -> bool) -> Self {
        let mesh = &self.mesh;
        let mut corners = Vec::new();
        let kept: Vec<usize> = (0..mesh.faces.len())
            .filter(|&f| {
                corners.clear();
                corners.extend(mesh.faces.face(f).iter().map(|&v| mesh.positions[v as usize]));
                passes(&corners)
            })
            .collect();
        self.recut(&kept, &[])
    }

    /// The scan with some of its faces, rising, and triangles over its vertices that look like the first face kept at each corner.
    pub fn recut(&self, kept: &[usize], added: &[[u32; 3]]) -> Self {
        let Self { mesh, look, .. } = self;
        let mut faces = Faces::default();
        kept.iter().for_each(|&f| faces.push(mesh.faces.face(f).iter().copied()));
        let mut first = vec![None; if added.is_empty() { 0 } else { mesh.positions.len() }];
        for &f in kept.iter().rev().filter(|_| !added.is_empty()) {
            mesh.faces.range(f).for_each(|corner| first[mesh.faces.corners[corner] as usize] = Some((f, corner)));
        }
        added.iter().for_each(|t| faces.push(*t));
        // Arrays are empty where the file has nothing of the kind.
        let of_corners = |all: &[u32], new: bool| -> Vec<u32> {
            let old = kept.iter().flat_map(|&f| all.get(mesh.faces.range(f)).unwrap_or_default()).copied();
            let like = |v: &u32| first[*v as usize].filter(|_| new).map_or(NONE, |(_, corner): (usize, usize)| all[corner]);
            let added = added.iter().flatten().filter(|_| !all.is_empty()).map(like);
            old.chain(added).collect()
        };
        let of_faces = |all: &[u32]| -> Vec<u32> {
            let like = |t: &[u32; 3]| t.iter().find_map(|&v| first[v as usize]).map_or(NONE, |(f, _)| all[f]);
            let added = added.iter().filter(|_| !all.is_empty()).map(like);
            kept.iter().filter_map(|&f| all.get(f)).copied().chain(added).collect()
        };
        let look = Appearance {
            corner_uvs: of_corners(&look.corner_uvs, true),
            corner_normals: of_corners(&look.corner_normals, false),
            face_materials: of_faces(&look.face_materials),
            face_groups: of_faces(&look.face_groups),
            ..look.clone()
        };
        Self { mesh: SurfaceMesh { positions: mesh.positions.clone(), faces }, look, ..self.clone() }
    }
}

/// Vertices and polygons, in the file's order; vertices that no face uses are kept.
#[derive(Clone, Debug, Default)]
pub struct SurfaceMesh {
    /// Positions in the scan's own unit and axes.
    pub positions: Vec<DVec3>,
    /// Polygons over `positions`.
    pub faces: Faces,
}

/// Polygons in one array: face `f` is `corners[starts[f]..starts[f + 1]]`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Faces {
    /// Where each face begins, and the end: one more than there are faces.
    pub starts: Vec<u32>,
    /// Vertex of each corner.
    pub corners: Vec<u32>,
}

impl Default for Faces {
    fn default() -> Self {
        Self { starts: vec![0], corners: Vec::new() }
    }
}

impl Faces {
    /// Number of faces.
    pub fn len(&self) -> usize {
        self.starts.len() - 1
    }

    /// Whether there is no face.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Adds a face.
    pub fn push(&mut self, corners: impl IntoIterator<Item = u32>) {
        self.corners.extend(corners);
        self.starts.push(self.corners.len() as u32);
    }

    /// Range of the corners of face `f`.
    pub fn range(&self, f: usize) -> std::ops::Range<usize> {
        self.starts[f] as usize..self.starts[f + 1] as usize
    }

    /// Vertices of face `f`.
    pub fn face(&self, f: usize) -> &[u32] {
        &self.corners[self.range(f)]
    }

    /// The faces in order.
    pub fn iter(&self) -> impl ExactSizeIterator<Item = &[u32]> {
        (0..self.len()).map(|f| self.face(f))
    }
}

/// Everything about a scan that is not its shape. Arrays are empty where the file has nothing of the kind.
#[derive(Clone, Debug, Default)]
pub struct Appearance {
    /// Texture coordinates, origin at the bottom left (the OBJ convention).
    pub uvs: Vec<[f32; 2]>,
    /// Index into `uvs` per corner, or [`NONE`].
    pub corner_uvs: Vec<u32>,
    /// The file's normal index per corner, or [`NONE`]: corners of one vertex with different indices are a hard edge.
    /// The normals themselves are not kept, since they change with the pose.
    pub corner_normals: Vec<u32>,
    /// Per vertex the first one that has its place and its normal in the file, itself where none has: formats with one set of looks per
    /// vertex (glTF) repeat vertices along seams, where the surface is smooth nevertheless.
    pub twins: Vec<u32>,
    /// RGBA per vertex, 0 to 1 as stored in the file (sRGB by convention).
    pub colors: Vec<[f32; 4]>,
    /// Whether the file's colours have an alpha.
    pub colors_have_alpha: bool,
    /// Materials in the order of their first use.
    pub materials: Vec<Material>,
    /// Index into `materials` per face, or [`NONE`].
    pub face_materials: Vec<u32>,
    /// Material libraries that the file names.
    pub material_libraries: Vec<String>,
    /// Objects and groups in the order of their first use.
    pub groups: Vec<Group>,
    /// Index into `groups` per face, or [`NONE`].
    pub face_groups: Vec<u32>,
}

/// An `o`/`g` section of an OBJ file.
#[derive(Clone, Debug, Default, PartialEq, Eq, Hash)]
pub struct Group {
    /// Name of the object, if any.
    pub object: Option<String>,
    /// Names of the groups, as written after `g`.
    pub group: Option<String>,
}

/// Where an image is.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Image {
    /// A file, resolved against the scan's folder.
    File(PathBuf),
    /// Held by the scan's own file.
    Embedded {
        /// Its name there.
        name: String,
        /// The encoded image.
        bytes: Arc<[u8]>,
    },
}

/// A surface material in the terms that glTF can carry.
#[derive(Clone, Debug, PartialEq)]
pub struct Material {
    /// Its name.
    pub name: String,
    /// Linear RGBA factor.
    pub base_color: [f32; 4],
    /// Image of the base colour.
    pub base_color_texture: Option<Image>,
    /// Image of the tangent-space normals.
    pub normal_texture: Option<Image>,
    /// Emitted light, linear RGB.
    pub emissive: [f32; 3],
    /// 0 (dielectric) to 1 (metal).
    pub metallic: f32,
    /// 0 (mirror) to 1 (matt).
    pub roughness: f32,
    /// Whether alpha blends.
    pub blend: bool,
}

impl Default for Material {
    fn default() -> Self {
        Self {
            name: String::new(),
            base_color: [1.0; 4],
            base_color_texture: None,
            normal_texture: None,
            emissive: [0.0; 3],
            metallic: 0.0,
            roughness: 1.0,
            blend: false,
        }
    }
}

/// Shift and scale between the scan's own space and the unit box that everything inside works in: centre 0, diagonal 1.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct UnitBox {
    /// Centre of the bounding box, in the scan's unit.
    pub centre: DVec3,
    /// Diagonal of the bounding box, in the scan's unit; positive.
    pub diagonal: f64,
}

impl UnitBox {
    /// The box of the vertices that faces use; `None` if there is no extent.
    pub fn of(mesh: &SurfaceMesh) -> Option<Self> {
        let used = mesh.faces.corners.iter().map(|&v| mesh.positions[v as usize]);
        let (lo, hi) = used.fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(lo, hi), p| (lo.min(p), hi.max(p)));
        let diagonal = (hi - lo).length();
        (diagonal.is_finite() && diagonal > 0.0).then_some(Self { centre: lo + (hi - lo) * 0.5, diagonal })
    }

    /// From the scan's space into the unit box.
    pub fn enter(&self, p: DVec3) -> DVec3 {
        (p - self.centre) / self.diagonal
    }

    /// All of them from the scan's space into the unit box.
    pub fn enter_all(&self, points: &[DVec3]) -> Vec<DVec3> {
        points.iter().map(|&p| self.enter(p)).collect()
    }

    /// From the unit box back into the scan's space.
    pub fn leave(&self, p: DVec3) -> DVec3 {
        p * self.diagonal + self.centre
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_belongs_to_faces_goes_with_them() {
        let mut faces = Faces::default();
        faces.push([0, 1, 2]);
        faces.push([0, 2, 3, 4]);
        faces.push([2, 3, 4]);
        let positions = (0..5).map(|v| DVec3::new(f64::from(v), 0.0, 0.0)).collect();
        let look = Appearance {
            corner_uvs: (10..20).collect(),
            face_materials: vec![7, 8, 9],
            colors: vec![[0.5; 4]; 5],
            ..Appearance::default()
        };
        let scan = Scan { mesh: SurfaceMesh { positions, faces }, look, ..Scan::default() };
        let kept = scan.with_faces(|corners| corners.len() == 4 || corners[0].x > 1.0);
        let corners: Vec<&[u32]> = kept.mesh.faces.iter().collect();
        assert_eq!(corners, [&[0, 2, 3, 4][..], &[2, 3, 4]]);
        assert_eq!(kept.look.corner_uvs, [13, 14, 15, 16, 17, 18, 19]);
        assert_eq!(kept.look.face_materials, [8, 9]);
        assert!(kept.look.corner_normals.is_empty() && kept.look.face_groups.is_empty());
        assert_eq!((kept.mesh.positions.len(), kept.look.colors.len()), (5, 5));
    }
}
