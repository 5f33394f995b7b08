//! Names of joints.

use crate::export::encode::Encoded;
use glam::DVec3;
use std::collections::BTreeSet;

/// `root`, then `<place>_<nn>` after the place that most of a joint's weight is nearest to, numbered along each place; all different.
pub(crate) fn joint_names(encoded: &Encoded, proxy_rest: &[DVec3], places: &[(String, DVec3)]) -> Vec<String> {
    let joints = encoded.skin.nodes() - 1;
    let mut shares = vec![vec![0.0; places.len()]; joints];
    for (vertex, influences) in &encoded.proxy_influences {
        let Some(near) = nearest(proxy_rest[*vertex as usize], places) else { break };
        for (k, w) in influences.iter() {
            shares[k][near] += w;
        }
    }
    let mut names = vec!["root".to_owned()];
    let mut taken = BTreeSet::from(["root".to_owned(), "rig".to_owned()]);
    for share in shares {
        let heaviest = (0..places.len()).fold(None, |best: Option<usize>, p| match best {
            Some(b) if share[b] >= share[p] => best,
            _ => Some(p),
        });
        let part = heaviest.map_or("joint", |p| places[p].0.as_str());
        let part = if part.is_empty() { "joint" } else { part };
        let name = (1..).map(|n| format!("{part}_{n:02}")).find(|name| !taken.contains(name));
        let name = name.expect("the numbers never end");
        taken.insert(name.clone());
        names.push(name);
    }
    names
}

fn nearest(point: DVec3, places: &[(String, DVec3)]) -> Option<usize> {
    let distance = |p: usize| (places[p].1 - point).length_squared();
    (0..places.len()).reduce(|best, p| if distance(p) < distance(best) { p } else { best })
}
