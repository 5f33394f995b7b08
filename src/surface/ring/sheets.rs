//! Feet that stand on another part: where limbs touch or overlap at rest, the boundary nearest to a vertex of the one may be that of the other.
//!
//! Along the skin feet move on steadily. Small patches of skin whose feet are far along the boundary from those of the skin around them stand on
//! another part; they are led back from their rims.

use super::weights::{Foot, Walk, fan_neighbours};
use crate::disjoint::DisjointSets;
use crate::proxy::Proxy;
use crate::scan::Faces;
use crate::spatial::TriangleTree;
use glam::DVec3;
use rayon::prelude::*;
use std::collections::{BTreeMap, VecDeque};

/// Feet of neighbours are this near along the boundary, or nearer than so many edges, in the unit box.
const NEAR: f64 = 0.04;
const EDGES: f64 = 4.0;
/// Larger patches, as a share of the piece of the skin that they belong to, are left as they are: cloth hangs from both legs.
const PATCH: f64 = 0.05;
/// How much farther off a vertex its foot may be on its own part, in the unit box.
const FARTHER: f64 = 0.02;

/// Leads the feet of small patches back to the part that the skin around them stands on. `faces`: those of the scan, over `points`.
pub(super) fn keep_to_own_part(proxy: &Proxy, centres: &[DVec3], points: &[DVec3], faces: &Faces, feet: &mut [Foot]) {
    let neighbours: Vec<Vec<(u32, f64)>> = fan_neighbours(&proxy.boundary)
        .into_iter()
        .zip(centres)
        .map(|(fan, c)| fan.into_iter().map(|n| (n, c.distance(centres[n as usize]))).collect())
        .collect();
    let places = places(points);
    let mut edges: Vec<[u32; 2]> = faces
        .iter()
        .flat_map(|face| face.iter().zip(face.iter().cycle().skip(1)))
        .map(|(&a, &b)| [places[a as usize], places[b as usize]])
        .filter(|[a, b]| a != b)
        .map(|[a, b]| [a.min(b), a.max(b)])
        .collect();
    edges.par_sort_unstable();
    edges.dedup();
    let limit = |&[a, b]: &[u32; 2]| NEAR + EDGES * points[a as usize].distance(points[b as usize]);
    let broken: Vec<bool> = edges
        .par_iter()
        .map_init(
            || Walk::new(centres.len()),
            |walk, edge| {
                let [from, to] = edge.map(|v| feet[v as usize].face);
                let beside = || neighbours[from as usize].iter().any(|n| n.0 == to);
                from != to && !beside() && !walk.from(from, limit(edge), &neighbours).iter().any(|reached| reached.0 == to)
            },
        )
        .collect();
    if !broken.contains(&true) {
        return;
    }
    let (piece, patch) =
        (sets(points.len(), edges.iter()), sets(points.len(), edges.iter().zip(&broken).filter(|e| !e.1).map(|e| e.0)));
    let sizes = |of: &[u32]| {
        let mut sizes = vec![0usize; of.len()];
        (0..of.len()).filter(|&v| places[v] as usize == v).for_each(|v| sizes[of[v] as usize] += 1);
        sizes
    };
    let (piece_sizes, patch_sizes) = (sizes(&piece), sizes(&patch));
    let strayed =
        |v: u32| (patch_sizes[patch[v as usize] as usize] as f64) < PATCH * piece_sizes[piece[v as usize] as usize] as f64;
    let mut around: BTreeMap<u32, Vec<u32>> = BTreeMap::new();
    let mut rims = Vec::new();
    for (&[a, b], broken) in edges.iter().zip(&broken) {
        for (v, w) in [(a, b), (b, a)].into_iter().filter(|(_, w)| strayed(*w)) {
            around.entry(v).or_default().push(w);
            if *broken && !strayed(v) {
                rims.push(v);
            }
        }
    }
    rims.dedup();
    let mut settled: Vec<bool> = (0..points.len() as u32).map(|v| !strayed(v)).collect();
    let (mut queue, mut walk) = (VecDeque::from(rims), Walk::new(centres.len()));
    while let Some(v) = queue.pop_front() {
        for &w in around.get(&v).into_iter().flatten() {
            if settled[w as usize] {
                continue;
            }
            let reached = walk.from(feet[v as usize].face, limit(&[v, w]), &neighbours);
            let triangles: Vec<[u32; 3]> = reached.iter().map(|(f, _)| proxy.boundary[*f as usize]).collect();
            let farthest = feet[w as usize].distance + FARTHER;
            let Some(c) = TriangleTree::new(&proxy.rest, &triangles).closest_within(points[w as usize], farthest) else {
                continue;
            };
            feet[w as usize] = Foot { face: reached[c.triangle].0, point: c.point, distance: c.distance };
            settled[w as usize] = true;
            queue.push_back(w);
        }
    }
    for v in 0..points.len() {
        feet[v] = feet[places[v] as usize];
    }
}

/// For each point the first one in the same place.
fn places(points: &[DVec3]) -> Vec<u32> {
    let key = |v: u32| points[v as usize].to_array().map(|x| (x + 0.0).to_bits());
    let mut order: Vec<u32> = (0..points.len() as u32).collect();
    order.par_sort_unstable_by_key(|&v| (key(v), v));
    let mut places = vec![0; points.len()];
    for group in order.chunk_by(|&a, &b| key(a) == key(b)) {
        group.iter().for_each(|&v| places[v as usize] = group[0]);
    }
    places
}

/// The lowest member of the set of each element, when edges join their ends.
fn sets<'a>(count: usize, edges: impl Iterator<Item = &'a [u32; 2]>) -> Vec<u32> {
    let mut sets = DisjointSets::new(count);
    for &[a, b] in edges {
        sets.unite(a, b);
    }
    (0..count as u32).map(|v| sets.find(v)).collect()
}
