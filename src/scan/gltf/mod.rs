//! glTF and GLB: the scene at rest, as one mesh.

mod looks;
mod place;

use super::beside::Beside;
use super::{Faces, Group, NONE, Scan, SurfaceMesh};
use crate::equal::{bits, first_equal};
use crate::error::{Error, Notes, Result};
use crate::gltf::{self, Attributes, Gltf, MeshExtras, MorphTarget, Node, Primitive, needs_extension};
use crate::space::{Axis, Evidence, Known, Unit};
use glam::{DAffine3, DVec3};
use looks::Looks;
pub(crate) use place::Hold;
use place::{Place, Skins};
use std::path::Path;

/// Most morph targets that are taken as poses.
const MOST_TARGETS: usize = 256;
/// Vertices per byte of file above which a file is refused that shows its meshes again and again, and what is always allowed.
const LARGEST_RATIO: usize = 20;
const ALWAYS_ALLOWED: usize = 4 << 20;

/// Reads a glTF or GLB file from its bytes; its buffers and images lie `beside` it.
///
/// All meshes of the scene are read where their nodes place them, one after the other in the order of the nodes; skinned ones as their
/// joints hold them at rest. Vertices keep the file's order and number: primitives over the same vertices share them. Morph targets are
/// left out. The format prescribes metres and +Y up.
///
/// Errors: a damaged container or document, data that are not there, packed geometry (Draco, meshopt), no triangles.
pub(super) fn read(bytes: &[u8], path: &Path, beside: &Beside) -> Result<Scan> {
    parse(bytes, beside).map_err(|e| if e.file.is_none() { e.file(path) } else { e })
}

fn parse(bytes: &[u8], beside: &Beside) -> Result<Scan> {
    let gltf = gltf::parse(bytes, &|name| beside.needed(name))?;
    // Packed geometry says more below, where it is met.
    let packed = ["KHR_draco_mesh_compression", "EXT_meshopt_compression", "KHR_meshopt_compression"];
    gltf.require_only(&[&gltf::KNOWN[..], &packed[..]].concat())?;
    let hierarchy = gltf.hierarchy()?;
    let mut scene = Scene::new(&gltf, beside, bytes.len(), 2 * bytes.len() + gltf.bytes());
    scene.nodes(&hierarchy.shown, &hierarchy.worlds)?;
    scene.finish()
}

/// The scene in each of its morph targets at full weight, with their names; none where there are none.
///
/// # Errors
/// As [`read`]; targets that do not fit their vertices.
pub(super) fn read_targets(bytes: &[u8], path: &Path, beside: &Beside) -> Result<Vec<(String, Scan)>> {
    let named = |e: Error| if e.file.is_none() { e.file(path) } else { e };
    let gltf = gltf::parse(bytes, &|name| beside.needed(name)).map_err(named)?;
    let meshes = &gltf.document.meshes;
    let count = meshes.iter().flat_map(|m| &m.primitives).map(|p| p.targets.len()).max().unwrap_or(0);
    let names = meshes.iter().find_map(|m| match &m.extras {
        Some(MeshExtras::Named { target_names }) => Some(target_names),
        _ => None,
    });
    if count > MOST_TARGETS {
        return Err(Error::refused(format!("{count} morph targets"))
            .file(path)
            .expected(format!("at most {MOST_TARGETS} examples")));
    }
    let of = |target: usize| {
        let hierarchy = gltf.hierarchy()?;
        let mut scene = Scene::new(&gltf, &Beside::Nothing, bytes.len(), 0);
        scene.target = Some(target);
        scene.nodes(&hierarchy.shown, &hierarchy.worlds)?;
        scene.looks.notes.clear();
        let name = names.and_then(|n| n.get(target)).map_or_else(|| format!("target {}", target + 1), |n| n.to_string());
        Ok((name, scene.finish()?))
    };
    (0..count).map(|target| of(target).map_err(named)).collect()
}

/// The meshes of a scene as [`read`] numbers their vertices, without looks.
pub(crate) struct Shapes {
    /// Where the vertices are, and their faces.
    pub(crate) mesh: SurfaceMesh,
    /// Where they come from, in the order of the vertices.
    parts: Vec<Part>,
    /// What was left out.
    pub(crate) notes: Notes,
}

/// Vertices of a primitive as a node shows them.
struct Part {
    first: u32,
    count: u32,
    node: u32,
    skin: Option<u32>,
    attributes: Attributes,
}

impl Shapes {
    /// The meshes that the nodes `shown` show where the nodes are at `worlds`; the file is of `size` bytes.
    ///
    /// # Errors
    /// As [`read`].
    pub(crate) fn of(gltf: &Gltf, shown: &[u32], worlds: &[DAffine3], size: usize) -> Result<Self> {
        let mut scene = Scene::new(gltf, &Beside::Nothing, size, 0);
        scene.nodes(shown, worlds)?;
        scene.looks.notes.clear();
        let parts = std::mem::take(&mut scene.parts);
        let Scan { mesh, notes, .. } = scene.finish()?;
        Ok(Self { mesh, parts, notes })
    }

    /// The nodes that hold some vertices, which rise: for each vertex one or, in a skin, several.
    ///
    /// # Errors
    /// Accessors that cannot be read.
    pub(crate) fn holds(&self, gltf: &Gltf, vertices: &[u32]) -> Result<Vec<Vec<Hold>>> {
        let mut holds = Vec::with_capacity(vertices.len());
        for part in &self.parts {
            let of_part = |v: u32| vertices.partition_point(|&w| w < v);
            let wanted = &vertices[of_part(part.first)..of_part(part.first + part.count)];
            if !wanted.is_empty() {
                holds.extend(place::holds(gltf, part, wanted.iter().map(|v| v - part.first))?);
            }
        }
        Ok(holds)
    }
}

/// The scene as far as it is read.
struct Scene<'a> {
    gltf: &'a Gltf,
    scan: Scan,
    looks: Looks<'a>,
    skins: Skins,
    /// Normal of every vertex as the file has it, not a number where it has none; with the node that shows the vertex.
    normals: Vec<([f32; 3], u32)>,
    /// Where the vertices come from.
    parts: Vec<Part>,
    /// Which morph target is added to the vertices.
    target: Option<usize>,
    /// Most vertices and corners.
    most: usize,
    counts: Counts,
}

#[derive(Default)]
struct Counts {
    points: usize,
    lines: usize,
    morphed: usize,
    incomplete: usize,
    colored: usize,
    unweighted: usize,
    instanced: usize,
}

/// Vertices of a mesh that several primitives may share.
struct Shared {
    attributes: Attributes,
    target: MorphTarget,
    looks: looks::VertexLooks,
    first: u32,
    count: u32,
}

impl<'a> Scene<'a> {
    /// Nothing read yet of a file of `size` bytes; at most `images` bytes of images are taken out of it.
    fn new(gltf: &'a Gltf, beside: &'a Beside, size: usize, images: usize) -> Self {
        Self {
            gltf,
            scan: Scan::default(),
            looks: Looks::new(gltf, beside, images),
            skins: Skins::default(),
            normals: Vec::new(),
            parts: Vec::new(),
            target: None,
            most: ALWAYS_ALLOWED.max(LARGEST_RATIO.saturating_mul(size)),
            counts: Counts::default(),
        }
    }

    fn nodes(&mut self, shown: &[u32], worlds: &[DAffine3]) -> Result<()> {
        for &n in shown {
            let node = &self.gltf.document.nodes[n as usize];
            if node.mesh.is_some() {
                self.node(n, node, worlds)?;
            }
        }
        Ok(())
    }

    fn node(&mut self, n: u32, node: &Node, worlds: &[DAffine3]) -> Result<()> {
        let gltf = self.gltf;
        let at = |e: Error| if e.place.is_none() { e.at(format!("node {n}")) } else { e };
        let mesh = Gltf::get(&gltf.document.meshes, node.mesh.unwrap_or(NONE), "mesh").map_err(at)?;
        self.counts.instanced += usize::from(node.extensions.as_ref().is_some_and(|e| e.instancing.is_some()));
        let place = Place::of(gltf, n, node, worlds, &mut self.skins).map_err(at)?;
        let name = node.name.as_ref().or(mesh.name.as_ref()).filter(|n| !n.is_empty());
        let group = name.map_or(NONE, |name| {
            let groups = &mut self.scan.look.groups;
            let group = Group { object: Some(name.to_string()), group: None };
            // Instances follow each other, mostly; equal names that do not are two entries of one name.
            if groups.last() != Some(&group) {
                groups.push(group);
            }
            groups.len() as u32 - 1
        });
        let mut shared: Vec<Shared> = Vec::new();
        for primitive in &mesh.primitives {
            self.primitive(primitive, &place, (n, node.skin, group), &mut shared).map_err(at)?;
        }
        Ok(())
    }

    fn primitive(
        &mut self,
        primitive: &Primitive,
        place: &Place,
        (node, skin, group): (u32, Option<u32>, u32),
        shared: &mut Vec<Shared>,
    ) -> Result<()> {
        let mode = primitive.mode.unwrap_or(4);
        match mode {
            0 => self.counts.points += 1,
            1..=3 => self.counts.lines += 1,
            4..=6 => {}
            _ => return Err(Error::malformed(format!("a primitive of mode {mode}")).expected("0 to 6")),
        }
        if mode < 4 {
            return Ok(());
        }
        let Some(position) = primitive.attributes.position else {
            return Err(match primitive.extensions.draco {
                Some(_) => needs_extension("KHR_draco_mesh_compression"),
                None => Error::malformed("a primitive without positions"),
            });
        };
        // Accessors without data are zeros, and Draco has its data elsewhere.
        if primitive.extensions.draco.is_some() && self.gltf.accessor(position)?.buffer_view.is_none() {
            return Err(needs_extension("KHR_draco_mesh_compression"));
        }
        self.counts.morphed += usize::from(!primitive.targets.is_empty());
        let material = self.looks.material(primitive.material, &mut self.scan)?;
        let looks = self.looks.vertex_looks(primitive);
        // The last few only: a mesh may have any number of primitives.
        let target = self.target.and_then(|t| primitive.targets.get(t)).copied().unwrap_or_default();
        let same = |s: &Shared| s.attributes == primitive.attributes && s.looks == looks && s.target == target;
        let known = shared.iter().rev().take(64).position(same);
        let known = match known {
            Some(behind) => shared.len() - 1 - behind,
            None => {
                let (first, count) = self.vertices(position, target, (node, &primitive.attributes), &looks, place)?;
                shared.push(Shared { attributes: primitive.attributes, target, looks, first, count });
                self.parts.push(Part { first, count, node, skin, attributes: primitive.attributes });
                shared.len() - 1
            }
        };
        let Shared { first, count, .. } = shared[known];
        let before = self.scan.mesh.faces.len();
        self.faces(primitive.indices, mode, first, count, place.mirrors)?;
        let faces = self.scan.mesh.faces.len();
        let look = &mut self.scan.look;
        for (list, value) in [(&mut look.face_materials, material), (&mut look.face_groups, group)] {
            if value != NONE || !list.is_empty() {
                list.resize(before, NONE);
                list.resize(faces, value);
            }
        }
        Ok(())
    }

    /// Adds the vertices of a primitive that `node` shows; returns the first with their number.
    fn vertices(
        &mut self,
        position: u32,
        target: MorphTarget,
        (node, attributes): (u32, &Attributes),
        looks: &looks::VertexLooks,
        place: &Place,
    ) -> Result<(u32, u32)> {
        self.room(self.scan.mesh.positions.len(), self.gltf.accessor(position)?.count as usize)?;
        let mut points: Vec<DVec3> = self.gltf.floats::<3>(position)?.into_iter().map(DVec3::from_array).collect();
        if let Some(moves) = target.position {
            let moves = self.gltf.floats::<3>(moves)?;
            if moves.len() != points.len() {
                return Err(Error::malformed(format!(
                    "a morph target of {} vertices where there are {}",
                    moves.len(),
                    points.len()
                )));
            }
            points.iter_mut().zip(moves).for_each(|(p, m)| *p += DVec3::from_array(m));
        }
        self.counts.unweighted += place.put(self.gltf, attributes, &mut points)?;
        if let Some(bad) = points.iter().position(|p| !p.is_finite()) {
            return Err(Error::malformed(format!("vertex {bad} (from 0) has coordinates that are not finite numbers"))
                .at(format!("accessor {position}"))
                .expected("finite coordinates"));
        }
        let positions = &mut self.scan.mesh.positions;
        let first = positions.len();
        positions.append(&mut points);
        let count = positions.len() - first;
        let normals = match attributes.normal {
            Some(normal) if self.gltf.accessor(normal)?.count == count as u64 => self.gltf.floats::<3>(normal)?,
            _ => vec![[f64::NAN; 3]; count],
        };
        self.normals.extend(normals.iter().map(|n| (n.map(|x| x as f32), node)));
        self.counts.colored += usize::from(self.looks.add_vertices(looks, first, count, &mut self.scan)?);
        Ok((first as u32, count as u32))
    }

    /// Adds the triangles of a primitive over the `count` vertices from `first`.
    fn faces(&mut self, indices: Option<u32>, mode: u32, first: u32, count: u32, mirrored: bool) -> Result<()> {
        let length = match indices {
            Some(accessor) => self.gltf.accessor(accessor)?.count as usize,
            None => count as usize,
        };
        self.room(self.scan.mesh.faces.corners.len(), if mode == 4 { length } else { length.saturating_mul(3) })?;
        let indices: Vec<u32> = match indices {
            Some(accessor) => {
                let indices = self.gltf.integers::<1>(accessor)?.into_iter().map(|[i]| i).collect::<Vec<_>>();
                if let Some(bad) = indices.iter().find(|&&i| i >= count) {
                    return Err(Error::malformed(format!("vertex index {bad} where there are {count} vertices"))
                        .at(format!("accessor {accessor}")));
                }
                indices
            }
            None => (0..count).collect(),
        };
        let faces = &mut self.scan.mesh.faces;
        let mut add = |[a, b, c]: [u32; 3]| faces.push(if mirrored { [a, c, b] } else { [a, b, c] }.map(|i| first + i));
        match mode {
            4 => {
                self.counts.incomplete += usize::from(!indices.len().is_multiple_of(3));
                indices.chunks_exact(3).for_each(|t| add([t[0], t[1], t[2]]));
            }
            // Repeated vertices only move a strip on.
            5 => indices
                .windows(3)
                .enumerate()
                .filter(|(_, t)| t[0] != t[1] && t[1] != t[2] && t[2] != t[0])
                .for_each(|(k, t)| add(if k % 2 == 0 { [t[0], t[1], t[2]] } else { [t[1], t[0], t[2]] })),
            _ => indices.get(1..).unwrap_or_default().windows(2).for_each(|t| add([indices[0], t[0], t[1]])),
        }
        Ok(())
    }

    /// Errors if `more` beside `present` is beyond what a file of this size can mean.
    fn room(&self, present: usize, more: usize) -> Result<()> {
        if present.saturating_add(more) <= self.most.min(NONE as usize - 1) {
            return Ok(());
        }
        Err(Error::refused(format!("the scene repeats its meshes beyond {} vertices or corners", self.most))
            .expected("at most twenty per byte of the file")
            .hint("leave instances out"))
    }

    fn finish(mut self) -> Result<Scan> {
        let scan = &mut self.scan;
        let vertices = scan.mesh.positions.len();
        let Counts { points, lines, morphed, incomplete, colored, unweighted, instanced } = self.counts;
        if let Some(text) = self.gltf.cut_short() {
            scan.notes.warn(text);
        }
        let mut note = |count: usize, text: &str| {
            if count > 0 {
                scan.notes.warn(format!("{text}: {count}"));
            }
        };
        note(points, "primitives of points skipped");
        note(lines, "primitives of lines skipped");
        note(morphed, "primitives with morph targets, which are left out (--examples takes them as poses)");
        note(incomplete, "primitives whose last triangle is incomplete");
        note(unweighted, "vertices of skinned meshes without a weight, left where the mesh is");
        note(instanced, "nodes with EXT_mesh_gpu_instancing, taken once");
        if scan.mesh.faces.is_empty() {
            return Err(super::nothing_to_animate(vertices, &[(points, "primitives of points"), (lines, "primitives of lines")]));
        }
        let Faces { corners, .. } = &scan.mesh.faces;
        let look = &mut scan.look;
        if colored > 0 {
            look.colors.resize(vertices, [1.0; 4]);
        }
        if !look.uvs.is_empty() {
            look.uvs.resize(vertices, [f32::NAN; 2]);
            look.corner_uvs = corners.iter().map(|&v| if look.uvs[v as usize][0].is_nan() { NONE } else { v }).collect();
            look.uvs.iter_mut().filter(|uv| uv[0].is_nan()).for_each(|uv| *uv = [0.0; 2]);
        }
        // Equal names are usual here; elsewhere a name means one material.
        crate::words::unique(look.materials.iter_mut().map(|m| &mut m.name), "material");
        look.twins = twins(&scan.mesh.positions, &self.normals);
        self.looks.notes.into_iter().for_each(|text| scan.notes.warn(text));
        scan.space.unit = Some(Known::new(Unit::Metre, Evidence::File));
        scan.space.up = Some(Known::new(Axis { index: 1, negative: false }, Evidence::File));
        Ok(self.scan)
    }
}

/// Vertices of one node that have place and normal in common; empty if there are none.
fn twins(positions: &[DVec3], normals: &[([f32; 3], u32)]) -> Vec<u32> {
    let key = |v: usize| {
        let ([x, y, z], node) = normals[v];
        if !(x.is_finite() && y.is_finite() && z.is_finite()) {
            return [v as u64, u64::MAX, 0, 0, 0];
        }
        let [px, py, pz] = positions[v].to_array().map(bits);
        let two = |a: f32, b: u32| u64::from((a + 0.0).to_bits()) << 32 | u64::from(b);
        [px, py, pz, two(x, (y + 0.0).to_bits()), two(z, node)]
    };
    let first = first_equal(positions.len(), key);
    let any = first.iter().enumerate().any(|(v, &f)| v != f as usize);
    if any { first } else { Vec::new() }
}

#[cfg(test)]
mod tests;
