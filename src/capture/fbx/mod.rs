//! FBX, binary and ASCII, through the library `ufbx`: a stack of animation as the motion of a skeleton.
//!
//! Joints are the bones and whatever skins are bound to; where there are none, the nodes that move. The stack is sampled at the file's
//! frame rate over the stack's own time. At rest joints are as the skin was bound to them, else as a stored bind pose has them, else as
//! the nodes stand.

use super::clips::{self, Clip, Times};
use super::skeleton::{self, Frames, SkeletonFile};
use super::{Joint, Rest};
use crate::error::{Error, Kind, Notes, Result};
use crate::space::{Axis, Evidence, Known, Space, Unit};
use glam::{DAffine3, DMat3, DVec3};
use std::collections::BTreeMap;
use ufbx::{AllocatorOpts, AnimStack, CoordinateAxis, ExtrapolationMode, LoadOpts, Matrix, Node, Scene};

/// Bytes of memory per byte of the file that the library may take, and bytes that it always may: packed arrays unfold.
const MEMORY_RATIO: usize = 32;
const MEMORY_ALWAYS: usize = 128 << 20;
/// Deepest nesting of nodes.
const DEPTH: u32 = 4096;

/// Reads a file; `clip` names the stack.
///
/// # Errors
/// Broken files with the library's reason; files without bones; no stack of this name.
pub(super) fn read(bytes: &[u8], clip: Option<&str>) -> Result<SkeletonFile> {
    let memory =
        || AllocatorOpts { memory_limit: MEMORY_ALWAYS + bytes.len().saturating_mul(MEMORY_RATIO), ..AllocatorOpts::default() };
    let options = LoadOpts {
        temp_allocator: memory(),
        result_allocator: memory(),
        ignore_geometry: true,
        ignore_embedded: true,
        node_depth_limit: DEPTH,
        ..LoadOpts::default()
    };
    let scene = ufbx::load_memory(bytes, options).map_err(|e| broken(&e))?;
    let mut notes = Notes::default();
    let nodes = joint_nodes(&scene)?;
    let tree = Tree::new(&scene, &nodes);
    let clips: Vec<Clip> = scene.anim_stacks.iter().map(|stack| self::clip(stack, &tree)).collect();
    // A file without curves may still hold a pose, which is worth one frame.
    let still = clip.is_none() && !clips.iter().any(|c| c.moves);
    let (rate, times, stack) = if still {
        notes.warn("no stack of the file moves a bone: its pose is one frame");
        (rate(&scene), Times::new(0.0, 0.0, rate(&scene)), None)
    } else {
        let chosen = clips::choose(&clips, clip, &mut notes)?;
        let stack = &scene.anim_stacks[chosen];
        let (start, end) = span(stack, &tree);
        (rate(&scene), Times::new(start, end, rate(&scene)), Some((stack, chosen)))
    };

    let mut frames = Frames::new(nodes.len(), times.count, bytes.len())?;
    let last_key = stack.map_or(0.0, |(stack, _)| last_key(stack, &tree));
    let mut pose: Vec<DAffine3> = nodes.iter().map(|&n| affine(&scene.nodes[n].node_to_world)).collect();
    let mut shown = f64::NAN;
    for frame in 0..times.count {
        // Behind the last key nothing moves any more.
        let time = times.at(frame).min(last_key);
        if let Some((stack, _)) = stack.filter(|_| time != shown) {
            let posed = ufbx::evaluate_scene(&scene, &stack.anim, time, ufbx::EvaluateOpts::default()).map_err(|e| broken(&e))?;
            pose.iter_mut().zip(&nodes).for_each(|(world, &n)| *world = affine(&posed.nodes[n].node_to_world));
            shown = time;
        }
        pose.iter().for_each(|world| frames.push(world.translation, skeleton::turn(&world.matrix3)));
    }
    let (joints, rest) = joints(&scene, &nodes, &tree);
    let take = frames.take(joints, rest);
    let space = space(&scene, &take, &mut notes);
    let name = stack.filter(|_| clips.len() > 1).map(|(_, n)| clips[n].name.clone()).filter(|n| !n.is_empty());
    Ok(SkeletonFile { take, rate, first_frame: times.first_frame()?, space, name, notes })
}

fn broken(error: &ufbx::Error) -> Error {
    let reason = error.description.to_string();
    let kind = if reason.contains("nsupported") { Kind::Unsupported } else { Kind::Malformed };
    Error::new(kind, format!("FBX: {}", if reason.is_empty() { "cannot be read" } else { &reason }))
        .hint("export it again as binary FBX 2014 or later, or as BVH or glTF")
}

/// Frames per second of the file.
fn rate(scene: &Scene) -> f64 {
    let rate = scene.settings.frames_per_second;
    if (0.01..=10_000.0).contains(&rate) { rate } else { 30.0 }
}

/// Indices of the nodes that are joints, parents before children.
fn joint_nodes(scene: &Scene) -> Result<Vec<usize>> {
    let count = scene.nodes.len();
    let mut joint: Vec<bool> = scene.nodes.iter().map(|n| n.bone.is_some()).collect();
    for node in scene.skin_clusters.iter().filter_map(|c| c.bone_node.as_ref()) {
        joint[index(node)] = true;
    }
    if !joint.contains(&true) {
        let animated = scene.anim_stacks.iter().flat_map(|s| s.layers.iter()).flat_map(|l| l.anim_props.iter());
        let by_element: BTreeMap<u32, usize> = (0..count).map(|n| (scene.nodes[n].element.element_id, n)).collect();
        animated.filter_map(|p| by_element.get(&p.element.element_id)).for_each(|&n| joint[n] = true);
    }
    let mut nodes: Vec<usize> = (0..count).filter(|&n| joint[n]).collect();
    nodes.sort_by_key(|&n| scene.nodes[n].node_depth);
    if nodes.is_empty() {
        return Err(
            Error::new(Kind::Unsupported, "the file has neither bones nor nodes that move").expected("an animation of bones")
        );
    }
    Ok(nodes)
}

fn index(node: &Node) -> usize {
    node.element.typed_id as usize
}

/// How the joints hang together.
struct Tree {
    /// The nearest joint above each joint.
    parents: Vec<Option<usize>>,
    /// Elements that move joints: they, and the nodes above them.
    moving: Vec<u32>,
}

impl Tree {
    fn new(scene: &Scene, nodes: &[usize]) -> Self {
        let number: BTreeMap<usize, usize> = nodes.iter().enumerate().map(|(k, &n)| (n, k)).collect();
        let mut moving: Vec<bool> = vec![false; scene.nodes.len()];
        let mut parents = Vec::with_capacity(nodes.len());
        for &n in nodes {
            moving[n] = true;
            let mut parent = None;
            let mut at = scene.nodes[n].parent.as_deref();
            while let Some(node) = at {
                moving[index(node)] = true;
                parent = number.get(&index(node)).copied();
                if parent.is_some() {
                    break;
                }
                at = node.parent.as_deref();
            }
            parents.push(parent);
        }
        let moving = scene.nodes.iter().filter(|n| moving[index(n)]).map(|n| n.element.element_id).collect::<Vec<_>>();
        let mut tree = Self { parents, moving };
        tree.moving.sort_unstable();
        tree
    }

    /// The curves of a stack that move joints.
    fn curves<'a>(&'a self, stack: &'a AnimStack) -> impl Iterator<Item = &'a ufbx::AnimCurve> {
        let props = stack.layers.iter().flat_map(|layer| layer.anim_props.iter());
        let moving = props.filter(|p| self.moving.binary_search(&p.element.element_id).is_ok());
        moving.flat_map(|p| p.anim_value.curves.iter().flatten()).map(|c| &**c).filter(|c| !c.keyframes.is_empty())
    }
}

fn clip(stack: &AnimStack, tree: &Tree) -> Clip {
    let (start, end) = span(stack, tree);
    Clip { name: stack.element.name.to_string(), seconds: (end - start).max(0.0), moves: tree.curves(stack).next().is_some() }
}

/// Time of a stack: what it says, or, where that is nothing, from its first key to its last.
fn span(stack: &AnimStack, tree: &Tree) -> (f64, f64) {
    let (start, end) = (stack.time_begin, stack.time_end);
    if start.is_finite() && end.is_finite() && start < end {
        return (start, end);
    }
    let keys = tree.curves(stack).fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), c| (a.min(c.min_time), b.max(c.max_time)));
    if keys.0.is_finite() && keys.1.is_finite() { keys } else { (0.0, 0.0) }
}

/// Time after which nothing moves; infinite where a curve goes on behind its last key.
fn last_key(stack: &AnimStack, tree: &Tree) -> f64 {
    let end = |c: &ufbx::AnimCurve| match c.post_extrapolation.mode {
        ExtrapolationMode::Constant => c.max_time,
        _ => f64::INFINITY,
    };
    tree.curves(stack).map(end).fold(f64::NEG_INFINITY, f64::max)
}

/// Joints with their places at rest, and what these are taken from.
fn joints(scene: &Scene, nodes: &[usize], tree: &Tree) -> (Vec<Joint>, Rest) {
    let mut bound: BTreeMap<usize, DAffine3> = BTreeMap::new();
    let poses = scene.poses.iter().filter(|p| p.is_bind_pose).flat_map(|p| p.bone_poses.iter());
    let of_poses = poses.map(|p| (index(&p.bone_node), affine(&p.bone_to_world)));
    let of_skins = scene.skin_clusters.iter().filter_map(|c| Some((index(c.bone_node.as_ref()?), affine(&c.bind_to_world))));
    for (node, world) in of_skins.chain(of_poses) {
        if world.is_finite() && world.matrix3.determinant() != 0.0 {
            bound.entry(node).or_insert(world);
        }
    }
    let mut joints: Vec<Joint> = Vec::with_capacity(nodes.len());
    let mut rests: Vec<DAffine3> = Vec::with_capacity(nodes.len());
    let mut from_bind = false;
    for (k, &n) in nodes.iter().enumerate() {
        let parent = tree.parents[k];
        let stands = affine(&scene.nodes[n].node_to_world);
        let rest = match bound.get(&n) {
            Some(world) => *world,
            None => parent.map_or(stands, |p| rests[p] * (affine(&scene.nodes[nodes[p]].node_to_world).inverse() * stands)),
        };
        from_bind |= bound.contains_key(&n);
        rests.push(rest);
        let name = scene.nodes[n].element.name.to_string();
        joints.push(Joint { name, parent, rest: rest.translation, rest_turn: skeleton::turn(&rest.matrix3), end: false });
    }
    crate::words::unique(joints.iter_mut().map(|j| &mut j.name), "joint");
    (joints, if from_bind { Rest::Bind } else { Rest::Nodes })
}

fn affine(m: &Matrix) -> DAffine3 {
    DAffine3 {
        matrix3: DMat3::from_cols(
            DVec3::new(m.m00, m.m10, m.m20),
            DVec3::new(m.m01, m.m11, m.m21),
            DVec3::new(m.m02, m.m12, m.m22),
        ),
        translation: DVec3::new(m.m03, m.m13, m.m23),
    }
}

fn space(scene: &Scene, take: &super::SkeletonTake, notes: &mut Notes) -> Space {
    let axis = |index: usize, negative: bool| Some(Known::new(Axis { index, negative }, Evidence::File));
    let up = match scene.settings.axes.up {
        CoordinateAxis::PositiveX => axis(0, false),
        CoordinateAxis::NegativeX => axis(0, true),
        CoordinateAxis::PositiveY => axis(1, false),
        CoordinateAxis::NegativeY => axis(1, true),
        CoordinateAxis::PositiveZ => axis(2, false),
        CoordinateAxis::NegativeZ => axis(2, true),
        CoordinateAxis::Unknown => None,
    };
    let unit = Unit::of_metres(scene.settings.unit_meters)
        .and_then(|unit| skeleton::believed(unit, skeleton::span(take), "joints", notes));
    Space { unit: unit.map(|u| Known::new(u, Evidence::File)), up, forward: None }
}

#[cfg(test)]
pub(super) mod tests;
