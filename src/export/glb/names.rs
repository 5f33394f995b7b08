//! Names of joints and of rigid parts.

use crate::export::encode::{Encoded, Parts};
use crate::scan::{NONE, Scan};
use glam::DVec3;
use std::collections::BTreeSet;

/// `root`, then the rigid parts, then the joints; all different. `vertices`: place in the skin of each scan vertex; `places`: with names, in the unit box.
pub(crate) fn node_names(
    encoded: &Encoded,
    scan: &Scan,
    vertices: &[u32],
    proxy_rest: &[DVec3],
    places: &[(String, DVec3)],
) -> Vec<String> {
    let mut taken = BTreeSet::from(["root".to_owned(), "rig".to_owned()]);
    let mut names = vec!["root".to_owned()];
    if let Some(Parts { rigid, of_vertex }) = &encoded.parts {
        names.extend(part_names(scan, *rigid, |v| of_vertex[vertices[v as usize] as usize].into(), &mut taken));
    }
    names.extend(joint_names(encoded, proxy_rest, places, &mut taken));
    names
}

/// `<place>_<nn>` after the place that most of a joint's weight is nearest to, numbered along each place.
fn joint_names(encoded: &Encoded, proxy_rest: &[DVec3], places: &[(String, DVec3)], taken: &mut BTreeSet<String>) -> Vec<String> {
    let mut shares = vec![vec![0.0; places.len()]; encoded.joints()];
    for (vertex, influences) in &encoded.proxy_influences {
        let Some(near) = nearest(proxy_rest[*vertex as usize], places) else { break };
        for (k, w) in influences.iter() {
            shares[k][near] += w;
        }
    }
    let name = |share: Vec<f64>| {
        let heaviest = (0..places.len()).fold(None, |best: Option<usize>, p| match best {
            Some(b) if share[b] >= share[p] => best,
            _ => Some(p),
        });
        let part = heaviest.map_or("joint", |p| places[p].0.as_str());
        numbered(if part.is_empty() { "joint" } else { part }, taken)
    };
    shares.into_iter().map(name).collect()
}

/// The name of each rigid part's first group, or `part_<nn>`. `part` tells that of a scan vertex; others are past the last.
fn part_names(scan: &Scan, parts: usize, part: impl Fn(u32) -> usize, taken: &mut BTreeSet<String>) -> Vec<String> {
    let mut of_part = vec![None; parts];
    for (face, corners) in scan.mesh.faces.iter().enumerate() {
        let group = scan.look.face_groups.get(face).filter(|g| **g != NONE).and_then(|&g| scan.look.groups.get(g as usize));
        let name = group.and_then(|g| g.group.as_ref().or(g.object.as_ref())).filter(|n| !n.is_empty());
        if let (Some(name), Some(&v)) = (name, corners.first().filter(|_| corners.len() > 2))
            && let Some(of_part) = of_part.get_mut(part(v))
        {
            of_part.get_or_insert(name);
        }
    }
    let name = |name: Option<&String>| match name {
        Some(name) if taken.insert(name.clone()) => name.clone(),
        name => numbered(name.map_or("part", |n| n), taken),
    };
    of_part.into_iter().map(name).collect()
}

/// `<stem>_<nn>` with the first number that is free.
fn numbered(stem: &str, taken: &mut BTreeSet<String>) -> String {
    let free = (1..).map(|n| format!("{stem}_{n:02}")).find(|name| taken.insert(name.clone()));
    free.expect("the numbers never end")
}

fn nearest(point: DVec3, places: &[(String, DVec3)]) -> Option<usize> {
    let distance = |p: usize| (places[p].1 - point).length_squared();
    (0..places.len()).reduce(|best, p| if distance(p) < distance(best) { p } else { best })
}
