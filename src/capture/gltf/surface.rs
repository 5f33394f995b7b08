//! The meshes that nodes move, as a captured surface: some vertices of them, moved by the nodes and joints that hold them.

use super::{Accessors, File, Play, space};
use crate::capture::vertices::{self, label};
use crate::capture::{Capture, Cleaning, MarkerTake, Motion, VertexTake, skeleton, source};
use crate::error::{Error, Kind, Notes, Result};
use crate::gltf::Gltf;
use crate::scan::{Hold, Shapes};
use crate::words;
use glam::{DAffine3, DVec3};
use std::path::Path;

/// Positions that a take may have, beyond which fewer vertices are kept; a binding needs no more than the least number.
const MOST: usize = 4 << 20;
const FEWEST: usize = 400;
/// Names of meshes that are listed.
const LISTED: usize = 5;

/// Reads the motion of the meshes of a scene.
///
/// # Errors
/// Files without meshes or without a motion of them; packed or broken geometry.
pub(super) fn read(file: File, path: &Path, clip: Option<&str>) -> Result<Capture> {
    // What the file lacks is told with its shapes.
    let mut notes = Notes::default();
    let (gltf, tree) = (&file.gltf, &file.tree);
    let nodes = holding(&file)?;
    let mut play = Play::start(&mut Accessors::new(gltf), &file, &nodes, clip, &mut notes)?;
    // Vertices are spread over the first frame: at rest all segments may lie in one place.
    let shapes = Shapes::of(gltf, &tree.shown, &play.worlds, file.size).map_err(|e| match e.kind {
        Kind::Unsupported if gltf.document.skins.is_empty() => {
            let joints = "--bodies takes the nodes alone, as joints";
            let hint = e.hint.as_ref().map_or_else(|| joints.to_owned(), |hint| format!("{hint}; {joints}"));
            e.hint(hint)
        }
        _ => e,
    })?;
    notes.extend(shapes.notes.clone());
    let still = still(&file, &play);
    if !still.is_empty() {
        let listed = still[..still.len().min(LISTED)].join(", ") + if still.len() > LISTED { ", …" } else { "" };
        notes.warn(format!("{} of the surface not moved: {listed}", words::plural(still.len(), "mesh")));
    }

    let frames = play.times.count;
    let most = (MOST / frames).clamp(FEWEST, vertices::MOST);
    let chosen = vertices::spread(&shapes.mesh, most);
    // A vertex and a frame are three numbers, a joint and a frame are seven.
    skeleton::cells(chosen.len().div_ceil(2), "vertices", frames, file.size)?;
    let holds = holds(gltf, &shapes, &chosen)?;
    let first: Vec<DVec3> = chosen.iter().map(|&v| shapes.mesh.positions[v as usize]).collect();
    let middle = first.iter().sum::<DVec3>() / first.len() as f64;
    let origin = if middle.is_finite() { middle } else { DVec3::ZERO };
    let (low, high) = first.iter().fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(low, high), p| (low.min(*p), high.max(*p)));
    let mut points = Vec::with_capacity(frames * chosen.len());
    for frame in 0..frames {
        play.go(frame);
        for holds in &holds {
            let place = place(holds, &play.worlds);
            let stored = (place - origin).to_array().map(|x| x as f32);
            points.push(if stored.iter().all(|x| x.is_finite()) { stored } else { [f32::NAN; 3] });
        }
    }
    let labels = chosen.iter().map(|&v| label(v)).collect();
    let count = shapes.mesh.positions.len();
    let take = VertexTake { points: MarkerTake { labels, points, origin }, vertices: chosen, count, faces: shapes.mesh.faces };
    let space = space(low.distance(high), "meshes", &mut notes);
    Ok(Capture {
        name: play.name.take().unwrap_or_else(|| source::stem(path)),
        rate: play.times.rate,
        first_frame: play.times.first_frame()?,
        space,
        motion: Motion::Vertices(take),
        source: path.to_owned(),
        cleaning: Cleaning::default(),
        notes,
    })
}

/// Where a vertex is that these nodes hold.
pub(super) fn place(holds: &[Hold], worlds: &[DAffine3]) -> DVec3 {
    holds.iter().map(|h| h.share * worlds[h.node as usize].transform_point3(h.place)).sum()
}

/// The nodes that show meshes, and the joints of their skins.
pub(super) fn holding(file: &File) -> Result<Vec<u32>> {
    let document = &file.gltf.document;
    let mut nodes = Vec::new();
    for &n in &file.tree.shown {
        let node = &document.nodes[n as usize];
        if node.mesh.is_none() {
            continue;
        }
        nodes.push(n);
        if let Some(skin) = node.skin {
            for &joint in &Gltf::get(&document.skins, skin, "skin")?.joints {
                Gltf::get(&document.nodes, joint, "node")?;
                nodes.push(joint);
            }
        }
    }
    if nodes.is_empty() {
        return Err(Error::new(Kind::Unsupported, "the scene shows no mesh").expected("meshes that nodes or joints move"));
    }
    nodes.sort_unstable();
    nodes.dedup();
    Ok(nodes)
}

/// Names of the meshes that nothing moves.
fn still(file: &File, play: &Play<'_>) -> Vec<String> {
    let document = &file.gltf.document;
    let mut moves = vec![false; document.nodes.len()];
    play.moving.iter().for_each(|&n| moves[n as usize] = true);
    let by_skin = |skin: u32| document.skins.get(skin as usize).is_some_and(|s| s.joints.iter().any(|&j| moves[j as usize]));
    let shown = file.tree.shown.iter().map(|&n| (n, &document.nodes[n as usize])).filter(|(_, node)| node.mesh.is_some());
    let still = shown.filter(|(n, node)| !node.skin.map_or(moves[*n as usize], by_skin));
    still.map(|(n, node)| node.name.as_deref().map_or_else(|| format!("node {n}"), |name| format!("'{name}'"))).collect()
}

/// What holds each of the vertices, which are in any order.
fn holds(gltf: &Gltf, shapes: &Shapes, vertices: &[u32]) -> Result<Vec<Vec<Hold>>> {
    let mut rising: Vec<(u32, usize)> = vertices.iter().copied().zip(0..).collect();
    rising.sort_unstable();
    let found = shapes.holds(gltf, &rising.iter().map(|r| r.0).collect::<Vec<_>>())?;
    let mut holds = vec![Vec::new(); vertices.len()];
    rising.into_iter().zip(found).for_each(|((_, place), found)| holds[place] = found);
    Ok(holds)
}
