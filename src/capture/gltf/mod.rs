//! glTF and GLB: a clip of node animations as the motion of a skeleton.
//!
//! Joints are those of the skins, or, where there is no skin, the nodes that move and those below them. The clip is sampled at the rate of
//! its own keys. At rest joints are as the skin was bound to them; files without bind matrices rest as their nodes stand.

mod curves;

use super::clips::{self, Clip, Times};
use super::skeleton::{self, Frames, SkeletonFile};
use super::{Joint, Rest};
use crate::error::{Error, Kind, Notes, Result};
use crate::gltf::{self, Files, Gltf, Hierarchy};
use crate::space::{Axis, Evidence, Known, Space, Unit};
use curves::{Accessors, Curves};
use glam::{DAffine3, DMat4};

/// Extensions that pack or repeat meshes. Those that pack animations as well are told where data are missing.
const MESHES_ONLY: [&str; 5] = [
    "KHR_draco_mesh_compression",
    "EXT_meshopt_compression",
    "KHR_meshopt_compression",
    "MESHOPT_compression",
    "EXT_mesh_gpu_instancing",
];

/// Reads a file; `clip` names the animation.
///
/// # Errors
/// Broken files; files without an animation of joints; no clip of this name.
pub(super) fn read(bytes: &[u8], files: &Files<'_>, clip: Option<&str>) -> Result<SkeletonFile> {
    let gltf = gltf::parse(bytes, files)?;
    gltf.require_only(&[&gltf::KNOWN[..], &MESHES_ONLY[..]].concat())?;
    let tree = gltf.hierarchy()?;
    let mut notes = Notes::default();
    if let Some(text) = gltf.cut_short() {
        notes.warn(text);
    }
    let nodes = joint_nodes(&gltf, &tree)?;
    let mut accessors = Accessors::new(&gltf);
    let clips = clips(&mut accessors, &gltf, &tree, &nodes);
    let chosen = clips::choose(&clips, clip, &mut notes)?;

    // What moves the joints: they, and the nodes above them.
    let order = with_ancestors(&tree, &nodes);
    let mut moving = vec![false; gltf.document.nodes.len()];
    order.iter().for_each(|&n| moving[n as usize] = true);
    let animation = &gltf.document.animations[chosen];
    let curves = Curves::read(&mut accessors, animation, &|n| moving[n as usize])?;
    let times = Times::of_keys(curves.keys()).ok_or_else(|| skeleton::no_frames("the animation has no keys"))?;

    let (joints, rest) = joints(&mut accessors, &gltf, &tree, &nodes)?;
    let size = bytes.len().saturating_add(gltf.bytes());
    let mut frames = Frames::new(nodes.len(), times.count, size)?;
    let mut worlds = vec![DAffine3::IDENTITY; gltf.document.nodes.len()];
    // What stands still is placed once; what moves is work in every frame, whether it is a joint or not.
    stand(&gltf, &tree, &order, &curves, times.at(0), &mut worlds);
    let mut moves = vec![false; gltf.document.nodes.len()];
    for &n in &order {
        moves[n as usize] = curves.moves(n) || tree.parents[n as usize].is_some_and(|p| moves[p as usize]);
    }
    let order: Vec<u32> = order.into_iter().filter(|&n| moves[n as usize]).collect();
    skeleton::cells(order.len(), "nodes", times.count, size)?;
    for frame in 0..times.count {
        let time = times.at(frame);
        stand(&gltf, &tree, &order, &curves, time, &mut worlds);
        for &n in &nodes {
            let world = &worlds[n as usize];
            frames.push(world.translation, skeleton::turn(&world.matrix3));
        }
    }
    let take = frames.take(joints, rest);
    let space = space(&take, &mut notes);
    let name = (clips.len() > 1 && !clips[chosen].name.is_empty()).then(|| clips[chosen].name.clone());
    Ok(SkeletonFile { take, rate: times.rate, first_frame: times.first_frame()?, space, name, notes })
}

/// Places the nodes of `order` in the world as they are at a time.
fn stand(gltf: &Gltf, tree: &Hierarchy, order: &[u32], curves: &Curves, time: f64, worlds: &mut [DAffine3]) {
    for &n in order {
        let turn = curves.turn(n, time, gltf.document.nodes[n as usize].turn());
        let local = DAffine3::from_scale_rotation_translation(turn.scale, turn.rotation, turn.translation);
        worlds[n as usize] = tree.parents[n as usize].map_or(local, |p| worlds[p as usize] * local);
    }
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
            let place = matches!(&*channel.target.path, "translation" | "rotation" | "scale");
            if let Some(n) = channel.target.node.filter(|_| place) {
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
            let place = matches!(&*channel.target.path, "translation" | "rotation" | "scale");
            // A node that does not exist counts as one that is wanted, so that it is told.
            moves |= place && channel.target.node.is_some_and(|n| wanted.get(n as usize).copied().unwrap_or(true));
        }
        let name = animation.name.as_deref().unwrap_or_default().to_owned();
        clips.push(Clip { name, seconds: if end > start { end - start } else { 0.0 }, moves });
    }
    clips
}

/// Joints with their places at rest, and what these are taken from.
fn joints(accessors: &mut Accessors<'_>, gltf: &Gltf, tree: &Hierarchy, nodes: &[u32]) -> Result<(Vec<Joint>, Rest)> {
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

/// The format says metres and y up.
fn space(take: &super::SkeletonTake, notes: &mut Notes) -> Space {
    let up = Some(Known::new(Axis { index: 1, negative: false }, Evidence::File));
    let unit = skeleton::believed(Unit::Metre, take, notes);
    Space { unit: unit.map(|u| Known::new(u, Evidence::File)), up, forward: None }
}

#[cfg(test)]
mod tests;
