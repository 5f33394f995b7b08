//! Where the skin meets skin that is far away along the surface: an arm against the trunk, thigh against thigh.
//!
//! Neither air nor the inside test tells such parts apart: there is no air, and where they overlap everything lies inside. The skin does:
//! the way along it is long, and the two sides face each other (or lie inside each other) all the same.

use super::edges::{Edges, double_area};
use crate::disjoint::DisjointSets;
use crate::spatial::{Neighbour, PointTree, TriangleTree};
use glam::DVec3;
use rayon::prelude::*;
use std::cmp::Reverse;
use std::collections::BinaryHeap;

/// Skin nearer than this along the surface is a neighbour, as a share of the diagonal: on a person the ways from finger to finger and
/// into an armpit are shorter.
const FAR: f64 = 0.1;
/// So is skin whose way along the surface is less than this multiple of the straight way: half way round a limb it is 1.6.
const FAR_RATIO: f64 = 3.0;
/// Share of the vertices from which one part is the body, and the others move with it.
const ONE_BODY: f64 = 0.95;
/// Facing sides nearer than this touch, as a share of the diagonal; wider gaps are air to the tetrahedra.
const TOUCH: f64 = 0.004;
/// Longest way out of an overlap that is looked for, as a share of the diagonal.
const DEEPEST: f64 = 0.12;
/// Height above the skin at which it is asked whether a vertex lies inside another part, as a share of the diagonal.
const LIFT: f64 = 0.001;
/// Winding number there from which it does.
const BURIED: f64 = 0.5;
/// Inside an overlap, skin that is further away along the surface than this is the other side, as a share of the diagonal: so far into an armpit arm and
/// trunk are told apart. (A heavy man's arms: 1 tetrahedron stays joined to the trunk there, 44 with [`FAR`].)
const FAR_INSIDE: f64 = 0.05;
/// Skin nearer than this leaves an overlap in nearly the same direction, as a share of the diagonal: a foot does as a whole, an arm turns away from the hip.
/// (Feet of a man turned in by 12 and 13 degrees come apart with 0.085 and 0.1; with 0.15 their skin is 3.5 % off at 12 degrees.)
const ONE_WAY: f64 = 0.1;
/// Largest cosine between normals of sides that face each other.
const OPPOSED: f64 = -0.2;
/// Least cosine between the normals and an edge that joins two sides through air.
const LEAVING: f64 = 0.2;

/// The surface of the proxy in its rest pose, with what is known of ways along it.
pub(super) struct Skin<'a> {
    /// Its triangles.
    pub(super) triangles: &'a [[u32; 3]],
    /// Neighbours of each vertex along its edges, with the length of the edge at rest.
    pub(super) around: Vec<Vec<(u32, f64)>>,
    /// The same, and for vertices of small parts (eyes) the nearest of the largest part, with which they move.
    pub(super) moving: Vec<Vec<u32>>,
    /// Part of each vertex, connected along the surface. Separate parts (jacket and trousers) may overlap as they like.
    part: Vec<u32>,
    /// Whether one part is almost the whole surface. Otherwise parts overlap, and a part does not tell which other part moves with it.
    one: bool,
    diagonal: f64,
}

/// A vertex that touches skin far away along the surface, or lies inside of it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Contact {
    /// The vertex.
    pub(super) vertex: u32,
    /// The vertices of the triangle on the other side, and the weights of the nearest point.
    pub(super) face: [u32; 3],
    pub(super) weights: [f64; 3],
    /// Unit direction in which the vertex has to go.
    pub(super) direction: DVec3,
    /// Width of the gap; negative where the sides overlap: the way out along `direction`.
    pub(super) gap: f64,
}

/// How a vertex inside another part gets out.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum WayOut {
    /// To the nearest skin of the other side that faces it.
    Nearest,
    /// In the direction in which its neighbours leave, too.
    Together,
}

impl<'a> Skin<'a> {
    pub(super) fn new(rest: &[DVec3], triangles: &'a [[u32; 3]], diagonal: f64) -> Self {
        let mut around = vec![Vec::new(); rest.len()];
        let mut parts = DisjointSets::new(rest.len());
        for ([a, b], _) in Edges::of(triangles, rest.len()).iter() {
            let length = rest[a as usize].distance(rest[b as usize]);
            around[a as usize].push((b, length));
            around[b as usize].push((a, length));
            parts.unite(a, b);
        }
        let (part, count) = parts.labels();
        let mut sizes = vec![0; count];
        part.iter().for_each(|&p| sizes[p as usize] += 1);
        let main = (0..count as u32).max_by_key(|&p| (sizes[p as usize], Reverse(p))).unwrap_or(0);
        let body: Vec<u32> = (0..rest.len() as u32).filter(|&v| part[v as usize] == main).collect();
        let one = body.len() as f64 >= ONE_BODY * rest.len() as f64;
        let mut moving: Vec<Vec<u32>> = around.iter().map(|n: &Vec<(u32, f64)>| n.iter().map(|&(w, _)| w).collect()).collect();
        let nearest = PointTree::new(&body.iter().map(|&v| rest[v as usize]).collect::<Vec<_>>());
        let mut found = Vec::new();
        for v in (0..rest.len()).filter(|&v| part[v] != main) {
            nearest.nearest(rest[v], 1, &mut found);
            let tie = body[found[0].point];
            moving[v].push(tie);
            moving[tie as usize].push(v as u32);
        }
        Self { triangles, around, moving, part, one, diagonal }
    }

    /// Ways from `start` along the edges, infinite beyond `reach`.
    pub(super) fn ways(&self, start: u32, reach: f64) -> Vec<f64> {
        let mut ways = vec![f64::INFINITY; self.around.len()];
        // Lengths are not negative, so their bits are in their order.
        let mut queue = BinaryHeap::from([Reverse((0u64, start))]);
        ways[start as usize] = 0.0;
        while let Some(Reverse((bits, v))) = queue.pop() {
            let way = f64::from_bits(bits);
            if way > ways[v as usize] {
                continue;
            }
            for &(w, length) in &self.around[v as usize] {
                let longer = way + length;
                if longer < ways[w as usize] && longer <= reach {
                    ways[w as usize] = longer;
                    queue.push(Reverse((longer.to_bits(), w)));
                }
            }
        }
        ways
    }

    /// The largest way along the surface that still makes neighbours of two points.
    fn far(&self, straight: f64) -> f64 {
        (FAR * self.diagonal).max(FAR_RATIO * straight)
    }

    /// Outward area vectors of the vertices in a pose: those of the triangles around them.
    fn areas(&self, points: &[DVec3]) -> Vec<DVec3> {
        let mut areas = vec![DVec3::ZERO; points.len()];
        for t in self.triangles {
            let area = double_area(points, *t);
            t.iter().for_each(|&v| areas[v as usize] += area);
        }
        areas
    }

    /// For each vertex that is buried: the direction in which its side leaves the other one.
    ///
    /// When a side moves along d, the volume of the overlap grows by d · ∫ n dA over its skin inside the other side (Reynolds' transport theorem), and by
    /// −d · ∫ n dA over the skin of the other inside it. It shrinks fastest against the sum, here over what lies within [`ONE_WAY`], so that
    /// neighbours leave in almost the same direction however deep they are.
    fn ways_out(&self, points: &[DVec3], areas: &[DVec3], buried: &[bool]) -> Vec<DVec3> {
        let reach = ONE_WAY * self.diagonal;
        let inside: Vec<usize> = (0..points.len()).filter(|&v| buried[v]).collect();
        let near = PointTree::new(&inside.iter().map(|&v| points[v]).collect::<Vec<_>>());
        let out = |v: usize| {
            let mut found = Vec::new();
            near.within(points[v], reach, &mut found);
            found.retain(|n| self.part[inside[n.point]] == self.part[v]);
            let ways = self.ways(v as u32, self.far(reach));
            let share = |n: &Neighbour| {
                let w = inside[n.point];
                let toward = if ways[w] <= self.far(n.distance) { -1.0 } else { 1.0 };
                areas[w] * (toward * (1.0 - n.distance / reach))
            };
            found.iter().map(share).sum::<DVec3>().normalize_or_zero()
        };
        let found: Vec<DVec3> = inside.par_iter().with_min_len(16).map(|&v| out(v)).collect();
        let mut all = vec![DVec3::ZERO; points.len()];
        inside.into_iter().zip(found).for_each(|(v, out)| all[v] = out);
        all
    }

    /// The vertices that lie inside another part of the body, in a pose with `tree` as its closed surface.
    pub(super) fn buried(&self, points: &[DVec3], normals: &[DVec3], tree: &TriangleTree) -> Vec<bool> {
        let lift = LIFT * self.diagonal;
        (0..points.len()).into_par_iter().map(|v| tree.winding(points[v] + normals[v] * lift) > BURIED).collect()
    }

    /// The contacts of a pose, at most one per vertex, in the order of the vertices.
    pub(super) fn contacts(&self, points: &[DVec3], tree: &TriangleTree, way_out: WayOut) -> Vec<Contact> {
        if !self.one {
            return Vec::new();
        }
        let areas = self.areas(points);
        let normals: Vec<DVec3> = areas.iter().map(|n| n.normalize_or_zero()).collect();
        let buried = self.buried(points, &normals, tree);
        let together = way_out == WayOut::Together;
        let out = if together { self.ways_out(points, &areas, &buried) } else { Vec::new() };
        let faces: Vec<DVec3> = self.triangles.iter().map(|t| double_area(points, *t).normalize_or_zero()).collect();
        let centre = |t: &[u32; 3]| t.iter().map(|&v| points[v as usize]).sum::<DVec3>() / 3.0;
        let centres: Vec<DVec3> = self.triangles.iter().map(centre).collect();
        let radius = |(t, c): (&[u32; 3], &DVec3)| t.iter().map(|&v| points[v as usize].distance(*c)).fold(0.0, f64::max);
        let widest = self.triangles.iter().zip(&centres).map(radius).fold(0.0, f64::max);
        let near = PointTree::new(&centres);
        let find = |v: usize| -> Option<Contact> {
            let (p, normal) = (points[v], normals[v]);
            let reach = self.diagonal * if buried[v] { DEEPEST } else { TOUCH };
            let mut found = Vec::new();
            near.within(p, reach + widest, &mut found);
            let opposed = |t: usize| faces[t].dot(normal) < OPPOSED;
            found.retain(|n| self.part[self.triangles[n.point][0] as usize] == self.part[v]);
            let leaves_together = together && buried[v];
            if !leaves_together && !found.iter().any(|n| opposed(n.point)) {
                return None;
            }
            let ways = self.ways(v as u32, self.far(reach));
            let way = |t: &[u32; 3]| t.iter().map(|&w| ways[w as usize]).fold(f64::INFINITY, f64::min);
            // Not the far side of the same limb. The nearest of the others decides: in a fold it is near along the surface.
            found.retain(|n| way(&self.triangles[n.point]) > FAR_RATIO * n.distance);
            let candidates: Vec<[u32; 3]> = found.iter().map(|n| self.triangles[n.point]).collect();
            let others = TriangleTree::new(points, &candidates);
            if leaves_together {
                // The first skin of the other side on the way out.
                let hit = *others.hits(p, out[v]).first()?;
                let face = candidates[hit.triangle];
                let leaves = faces[found[hit.triangle].point].dot(out[v]) > 0.0;
                let far = (FAR_INSIDE * self.diagonal).max(FAR_RATIO * hit.distance);
                if !leaves || hit.distance > reach || way(&face) <= far {
                    return None;
                }
                let weights = TriangleTree::new(points, &[face]).closest(p + out[v] * hit.distance)?.barycentric;
                return Some(Contact { vertex: v as u32, face, weights, direction: out[v], gap: -hit.distance });
            }
            let closest = others.closest_within(p, reach)?;
            let face = candidates[closest.triangle];
            if !opposed(found[closest.triangle].point) {
                return None;
            }
            let outward = faces[found[closest.triangle].point];
            let above = (p - closest.point).dot(outward);
            let facing = if buried[v] { above < 0.0 } else { above >= 0.0 && (closest.point - p).dot(normal) >= 0.0 };
            (facing && way(&face) > self.far(closest.distance)).then_some(Contact {
                vertex: v as u32,
                face,
                weights: closest.barycentric,
                direction: outward,
                gap: if buried[v] { -closest.distance } else { closest.distance },
            })
        };
        (0..points.len()).into_par_iter().with_min_len(16).filter_map(find).collect()
    }

    /// The tetrahedra that join skin far apart along the surface: through the air between two sides (`true`), or inside an overlap (`false`).
    ///
    /// `points`: those of the skin first. An edge that joins two sides of one limb through its inside is none of them.
    pub(super) fn bridging(&self, points: &[DVec3], tets: &[[u32; 4]], tree: &TriangleTree) -> Vec<(usize, bool)> {
        let count = self.around.len();
        let normals: Vec<DVec3> = self.areas(&points[..count]).iter().map(|n| n.normalize_or_zero()).collect();
        let buried = self.buried(&points[..count], &normals, tree);
        let suspect = |i: u32, j: u32| -> Option<bool> {
            let (a, b) = (i as usize, j as usize);
            if a >= count || b >= count || self.part[a] != self.part[b] {
                return None;
            }
            let along = (points[b] - points[a]).normalize_or_zero();
            let through_air = along.dot(normals[a]) > LEAVING && -along.dot(normals[b]) > LEAVING;
            (through_air || buried[a] || buried[b]).then_some(!buried[a] && !buried[b])
        };
        let pairs =
            |t: &[u32; 4]| [(0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)].map(|(i, j)| [t[i].min(t[j]), t[i].max(t[j])]);
        let mut edges: Vec<([u32; 2], bool)> =
            tets.iter().flat_map(pairs).filter_map(|[i, j]| suspect(i, j).map(|air| ([i, j], air))).collect();
        edges.sort_unstable();
        edges.dedup();
        let bridges: Vec<([u32; 2], bool)> = edges
            .chunk_by(|a, b| a.0[0] == b.0[0])
            .collect::<Vec<_>>()
            .into_par_iter()
            .flat_map_iter(|group| {
                let start = group[0].0[0];
                let far = |e: &[u32; 2]| self.far(points[e[0] as usize].distance(points[e[1] as usize]));
                let ways = self.ways(start, group.iter().map(|(e, _)| far(e)).fold(0.0, f64::max));
                group.iter().filter(move |(e, _)| ways[e[1] as usize] > far(e)).copied().collect::<Vec<_>>()
            })
            .collect();
        let kind = |e: &[u32; 2]| bridges.binary_search_by_key(e, |b| b.0).ok().map(|k| bridges[k].1);
        let of = |t: &[u32; 4]| pairs(t).iter().filter_map(kind).reduce(|a, b| a && b);
        tets.iter().enumerate().filter_map(|(i, t)| of(t).map(|air| (i, air))).collect()
    }

    /// The diagonal of the body.
    pub(super) fn diagonal(&self) -> f64 {
        self.diagonal
    }
}
