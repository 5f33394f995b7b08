//! glTF and GLB: a clip of node animations as the motion of a skeleton, or of the meshes that the nodes show.
//!
//! Joints are those of the skins, or, where there is no skin, the nodes that move and those below them. The clip is sampled at the rate of
//! its own keys. At rest joints are as the skin was bound to them; files without bind matrices rest as their nodes stand. Meshes that nodes
//! move without a skin are a captured surface: rigid segments, as marker-less systems and robots have them.

mod curves;
mod surface;

use super::clips::{self, Clip, Times};
use super::skeleton::{self, Frames, SkeletonFile};
use super::{Capture, Joint, ReadOptions, Rest};
use crate::error::{Error, Kind, Notes, Result};
use crate::gltf::{self, Files, Gltf, Hierarchy};
use crate::space::{Axis, Evidence, Known, Space, Unit};
use curves::{Accessors, Curves};
use glam::{DAffine3, DMat4};
use std::path::Path;

/// Extensions that pack or repeat meshes. Those that pack animations as well are told where data are missing.
const MESHES_ONLY: [&str; 5] = [
    "KHR_draco_mesh_compression",
    "EXT_meshopt_compression",
    "KHR_meshopt_compression",
    "MESHOPT_compression",
    "EXT_mesh_gpu_instancing",
];

/// Reads a file: joints, or the meshes that nodes move without a skin. `options` say which, where both are there, and the clip.
///
/// # Errors
/// Broken files; files without an animation of joints or meshes; no clip of this name.
pub(super) fn read(bytes: &[u8], files: &Files<'_>, path: &Path, options: &ReadOptions) -> Result<Capture> {
    let file = File::open(bytes, files)?;
    let clip = options.clip.as_deref();
    let surface = options.surface || !options.bodies && file.is_rigid_surface();
    if surface { surface::read(file, path, clip) } else { Ok(joints(file, clip)?.capture(path)) }
}

/// Reads the motion of the joints.
///
/// # Errors
/// As [`read`].
#[cfg(any(test, fuzzing))]
pub(super) fn read_joints(bytes: &[u8], files: &Files<'_>, clip: Option<&str>) -> Result<SkeletonFile> {
    joints(File::open(bytes, files)?, clip)
}

/// Reads the motion of the meshes.
///
/// # Errors
/// As [`read`].
#[cfg(any(test, fuzzing))]
pub(super) fn read_surface(bytes: &[u8], files: &Files<'_>) -> Result<Capture> {
    surface::read(File::open(bytes, files)?, Path::new("a.glb"), None)
}

/// A file and its tree of nodes.
struct File {
    gltf: Gltf,
    tree: Hierarchy,
    /// Bytes of the file and its buffers.
    size: usize,
    notes: Notes,
}

impl File {
    fn open(bytes: &[u8], files: &Files<'_>) -> Result<Self> {
        let gltf = gltf::parse(bytes, files)?;
        gltf.require_only(&[&gltf::KNOWN[..], &MESHES_ONLY[..]].concat())?;
        let tree = gltf.hierarchy()?;
        let mut notes = Notes::default();
        if let Some(text) = gltf.cut_short() {
            notes.warn(text);
        }
        let size = bytes.len().saturating_add(gltf.bytes());
        Ok(Self { gltf, tree, size, notes })
    }

    /// Whether nodes that an animation moves show meshes, and there is no skin.
    fn is_rigid_surface(&self) -> bool {
        let document = &self.gltf.document;
        let mut moves = vec![false; document.nodes.len()];
        for channel in document.animations.iter().flat_map(|a| &a.channels).filter(|c| is_place(&c.target.path)) {
            if let Some(moved) = channel.target.node.and_then(|n| moves.get_mut(n as usize)) {
                *moved = true;
            }
        }
        // Parents come before their children, and take them along.
        for &n in &self.tree.shown {
            moves[n as usize] |= self.tree.parents[n as usize].is_some_and(|p| moves[p as usize]);
        }
        let shows = |n: u32| moves[n as usize] && document.nodes[n as usize].mesh.is_some();
        document.skins.is_empty() && self.tree.shown.iter().any(|&n| shows(n))
    }
}

/// Whether what an animation changes of a node is its place.
fn is_place(path: &str) -> bool {
    matches!(path, "translation" | "rotation" | "scale")
}

/// A clip as it is played, frame by frame.
struct Play<'a> {
    file: &'a File,
    curves: Curves,
    times: Times,
    /// Name of the clip, where the file has several.
    name: Option<String>,
    /// What moves of the nodes and those above them, parents before children.
    moving: Vec<u32>,
    /// Where all these nodes are in the frame that was played last.
    worlds: Vec<DAffine3>,
}

impl<'a> Play<'a> {
    /// The clip called `clip`, or the longest that moves one of `nodes`, in its first frame.
    fn start(
        accessors: &mut Accessors<'_>,
        file: &'a File,
        nodes: &[u32],
        clip: Option<&str>,
        notes: &mut Notes,
    ) -> Result<Self> {
        let (gltf, tree) = (&file.gltf, &file.tree);
        let clips = clips(accessors, gltf, tree, nodes);
        let chosen = clips::choose(&clips, clip, notes)?;
        let order = with_ancestors(tree, nodes);
        let mut wanted = vec![false; gltf.document.nodes.len()];
        order.iter().for_each(|&n| wanted[n as usize] = true);
        let animation = &gltf.document.animations[chosen];
        let curves = Curves::read(accessors, animation, &|n| wanted[n as usize])?;
        let times = Times::of_keys(curves.keys()).ok_or_else(|| skeleton::no_frames("the animation has no keys"))?;
        let name = (clips.len() > 1 && !clips[chosen].name.is_empty()).then(|| clips[chosen].name.clone());
        let worlds = vec![DAffine3::IDENTITY; gltf.document.nodes.len()];
        // What stands still is placed once; what moves is work in every frame, whether it is wanted or not.
        let mut play = Self { file, curves, times, name, moving: order, worlds };
        play.go(0);
        let mut moves = vec![false; gltf.document.nodes.len()];
        for &n in &play.moving {
            moves[n as usize] = play.curves.moves(n) || tree.parents[n as usize].is_some_and(|p| moves[p as usize]);
        }
        play.moving.retain(|&n| moves[n as usize]);
        skeleton::cells(play.moving.len(), "nodes", times.count, file.size)?;
        Ok(play)
    }

    /// Goes to a frame.
    fn go(&mut self, frame: usize) {
        self.stand(self.times.at(frame));
    }

    /// Places the nodes as they are at a time.
    fn stand(&mut self, time: f64) {
        for &n in &self.moving {
            let turn = self.curves.turn(n, time, self.file.gltf.document.nodes[n as usize].turn());
            let local = DAffine3::from_scale_rotation_translation(turn.scale, turn.rotation, turn.translation);
            let parent = self.file.tree.parents[n as usize];
            self.worlds[n as usize] = parent.map_or(local, |p| self.worlds[p as usize] * local);
        }
    }
}

fn joints(mut file: File, clip: Option<&str>) -> Result<SkeletonFile> {
    let mut notes = std::mem::take(&mut file.notes);
    let nodes = joint_nodes(&file.gltf, &file.tree)?;
    let mut accessors = Accessors::new(&file.gltf);
    let mut play = Play::start(&mut accessors, &file, &nodes, clip, &mut notes)?;
    let (joints, rest) = at_rest(&mut accessors, &file.gltf, &file.tree, &nodes)?;
    let mut frames = Frames::new(nodes.len(), play.times.count, file.size)?;
    for frame in 0..play.times.count {
        play.go(frame);
        for &n in &nodes {
            let world = &play.worlds[n as usize];
            frames.push(world.translation, skeleton::turn(&world.matrix3));
        }
    }
    let take = frames.take(joints, rest);
    let space = space(skeleton::span(&take), "joints", &mut notes);
    Ok(SkeletonFile { take, rate: play.times.rate, first_frame: play.times.first_frame()?, space, name: play.name, notes })
}

/// The nodes that are joints, parents before children.
fn joint_nodes(gltf: &Gltf, tree: &Hierarchy) -> Result<Vec<u32>> {
    let document = &gltf.document;
    let mut joint = vec![false; document.nodes.len()];
    for skin in &document.skins {
        for &n in &skin.joints {
            Gltf::get(&document.nodes, n, "node")?;
            joint[n as usize] = true;
        }
    }
    let order = depth_first(tree);
    if document.skins.is_empty() {
        for channel in document.animations.iter().flat_map(|a| &a.channels) {
            if let Some(n) = channel.target.node.filter(|_| is_place(&channel.target.path)) {
                Gltf::get(&document.nodes, n, "node")?;
                joint[n as usize] = true;
            }
        }
        for &n in &order {
            joint[n as usize] |= tree.parents[n as usize].is_some_and(|p| joint[p as usize]);
        }
    }
    let nodes: Vec<u32> = order.into_iter().filter(|&n| joint[n as usize]).collect();
    if nodes.is_empty() {
        return Err(
            Error::new(Kind::Unsupported, "the file has neither a skin nor nodes that move").expected("an animation of joints")
        );
    }
    Ok(nodes)
}

/// All nodes, parents before children.
fn depth_first(tree: &Hierarchy) -> Vec<u32> {
    let mut depths = vec![u32::MAX; tree.parents.len()];
    let mut way = Vec::new();
    for start in 0..tree.parents.len() {
        let mut n = start;
        while depths[n] == u32::MAX {
            way.push(n);
            match tree.parents[n] {
                Some(parent) => n = parent as usize,
                None => {
                    depths[n] = 0;
                    way.pop();
                }
            }
        }
        while let Some(below) = way.pop() {
            depths[below] = depths[n] + 1;
            n = below;
        }
    }
    let mut order: Vec<u32> = (0..tree.parents.len() as u32).collect();
    order.sort_by_key(|&n| depths[n as usize]);
    order
}

/// The nodes and all nodes above them, parents before children.
fn with_ancestors(tree: &Hierarchy, nodes: &[u32]) -> Vec<u32> {
    let mut seen = vec![false; tree.parents.len()];
    for &start in nodes {
        let mut at = Some(start);
        while let Some(n) = at.filter(|&n| !std::mem::replace(&mut seen[n as usize], true)) {
            at = tree.parents[n as usize];
        }
    }
    depth_first(tree).into_iter().filter(|&n| seen[n as usize]).collect()
}

fn clips(accessors: &mut Accessors<'_>, gltf: &Gltf, tree: &Hierarchy, nodes: &[u32]) -> Vec<Clip> {
    let mut wanted = vec![false; tree.parents.len()];
    with_ancestors(tree, nodes).into_iter().for_each(|n| wanted[n as usize] = true);
    let mut clips = Vec::new();
    for animation in &gltf.document.animations {
        let (mut start, mut end, mut moves) = (f64::INFINITY, f64::NEG_INFINITY, false);
        for channel in &animation.channels {
            let Some(sampler) = animation.samplers.get(channel.sampler as usize) else { continue };
            // What cannot be read is told where it is used.
            if let Ok(times) = accessors.times(sampler.input) {
                (start, end) = (start.min(times[0]), end.max(times[times.len() - 1]));
            }
            // A node that does not exist counts as one that is wanted, so that it is told.
            moves |= is_place(&channel.target.path)
                && channel.target.node.is_some_and(|n| wanted.get(n as usize).copied().unwrap_or(true));
        }
        let name = animation.name.as_deref().unwrap_or_default().to_owned();
        clips.push(Clip { name, seconds: if end > start { end - start } else { 0.0 }, moves });
    }
    clips
}

/// Joints with their places at rest, and what these are taken from.
fn at_rest(accessors: &mut Accessors<'_>, gltf: &Gltf, tree: &Hierarchy, nodes: &[u32]) -> Result<(Vec<Joint>, Rest)> {
    let mut number = vec![None; tree.parents.len()];
    nodes.iter().enumerate().for_each(|(k, &n)| number[n as usize] = Some(k));
    let bound = bound(accessors, gltf, tree, &number)?;
    let mut joints: Vec<Joint> = Vec::with_capacity(nodes.len());
    let mut rests: Vec<DAffine3> = Vec::with_capacity(nodes.len());
    // The nearest joint above each node, which parents have found before their children ask.
    let mut above: Vec<Option<usize>> = vec![None; tree.parents.len()];
    for n in depth_first(tree) {
        let Some(parent) = tree.parents[n as usize] else { continue };
        above[n as usize] = number[parent as usize].or(above[parent as usize]);
    }
    for (k, &n) in nodes.iter().enumerate() {
        let parent = above[n as usize];
        let rest = bound[k].unwrap_or_else(|| {
            let stands = tree.worlds[n as usize];
            parent.map_or(stands, |p| rests[p] * (tree.worlds[nodes[p] as usize].inverse() * stands))
        });
        rests.push(rest);
        let name = gltf.document.nodes[n as usize].name.as_deref().unwrap_or_default().to_owned();
        let name = if name.is_empty() { format!("node {n}") } else { name };
        joints.push(Joint { name, parent, rest: rest.translation, rest_turn: skeleton::turn(&rest.matrix3), end: false });
    }
    crate::words::unique(joints.iter_mut().map(|j| &mut j.name), "joint");
    let rest = if bound.iter().any(Option::is_some) { Rest::Bind } else { Rest::Nodes };
    Ok((joints, rest))
}

/// Where the joints were when skins were bound to them, in the world.
///
/// Bind matrices are in the space of a mesh, which the file does not place for the pose at rest. One joint of each skin fixes it: one
/// that an earlier skin has placed, else the skin's highest, which is put where its node stands.
fn bound(
    accessors: &mut Accessors<'_>,
    gltf: &Gltf,
    tree: &Hierarchy,
    number: &[Option<usize>],
) -> Result<Vec<Option<DAffine3>>> {
    let joints = number.iter().flatten().count();
    let mut bound: Vec<Option<DAffine3>> = vec![None; joints];
    let mut read = std::collections::BTreeSet::new();
    for skin in &gltf.document.skins {
        let Some(accessor) = skin.inverse_bind_matrices else { continue };
        // Many skins over one skeleton share their joints and their matrices: nothing new is in the later ones.
        let index = |n: &u32| number[*n as usize];
        if !read.insert(accessor) {
            continue;
        }
        let matrices = accessors.rows::<16>(accessor)?;
        let binds: Vec<Option<DAffine3>> = matrices
            .iter()
            .map(|m| {
                let inverse = DAffine3::from_mat4(DMat4::from_cols_array(m));
                let bind = inverse.inverse();
                (inverse.matrix3.determinant().abs() > 1e-12 && bind.is_finite()).then_some(bind)
            })
            .collect();
        let placed = |k: usize| binds.get(k).copied().flatten();
        let known = skin.joints.iter().enumerate().find_map(|(k, n)| Some((placed(k)?, bound[index(n)?]?)));
        let highest = || {
            let (k, n) = skin.joints.iter().enumerate().filter(|(k, _)| placed(*k).is_some()).min_by_key(|(_, n)| index(n))?;
            Some((placed(k)?, tree.worlds[*n as usize]))
        };
        let Some((bind, world)) = known.or_else(highest) else { continue };
        let mesh = world * bind.inverse();
        for (k, n) in skin.joints.iter().enumerate() {
            if let (Some(bind), Some(joint)) = (placed(k), index(n)) {
                bound[joint].get_or_insert(mesh * bind);
            }
        }
    }
    Ok(bound)
}

/// The format says metres and y up; `span`: diagonal of the box around what moves.
fn space(span: f64, noun: &str, notes: &mut Notes) -> Space {
    let up = Some(Known::new(Axis { index: 1, negative: false }, Evidence::File));
    let unit = skeleton::believed(Unit::Metre, span, noun, notes);
    Space { unit: unit.map(|u| Known::new(u, Evidence::File)), up, forward: None }
}

#[cfg(test)]
mod tests;
