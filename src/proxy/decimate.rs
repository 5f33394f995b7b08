//! Decimation by edge collapse under quadric error (Garland and Heckbert 1997).
//!
//! Costs are kept lazily: a collapse does not touch the queue; an edge whose ends have moved is measured again when it comes up.

use super::edges::{Edges, double_area, renumber};
use glam::DVec3;
use rayon::prelude::*;
use std::cmp::Reverse;
use std::collections::BinaryHeap;

/// Pull of each vertex towards its own place, relative to the pull of its planes: keeps flat regions evenly sampled.
const POINT_WEIGHT: f64 = 1e-4;
/// Weight of the planes that hold open borders, relative to the square of the border's edge.
const BORDER_WEIGHT: f64 = 2.0;
/// Cosine of the largest turn of a triangle in one collapse.
const LARGEST_TURN: f64 = 0.2;
/// Smallest double area of a new triangle, relative to the square of its longest side.
const THINNEST: f64 = 0.02;
/// A collapse that would fold the surface is tried again when everything up to this many times its cost is done.
const RETRY: f64 = 8.0;
/// Costs at which an edge is given up; a collapse across the whole unit box costs less.
const HOPELESS: f64 = 1.0;
/// Smallest cost of a second try, far below the cost of any visible change.
const RETRY_FLOOR: f64 = 1e-18;

/// Above this multiple of the target, collapses are made in sweeps.
const SWEEP_ABOVE: usize = 4;
/// Share of the vertices that one sweep may remove.
const SWEEP: f64 = 1.0 / 3.0;
/// A sweep that removes less than this share is the last one.
const LEAST_SWEEP: f64 = 0.02;

/// Collapses edges until `target` vertices are left, or fewer collapses are possible.
///
/// `points`: about unit size. Topology is kept: no collapse closes a hole, joins borders or makes an edge of more than two triangles.
///
/// Far above the target the cheapest edges without a common vertex are collapsed in sweeps: three times as fast as one queue over
/// all edges, and the last collapses, which decide the shape, are in order of cost.
pub(super) fn decimate(points: &mut Vec<DVec3>, triangles: &mut Vec<[u32; 3]>, target: usize) {
    if points.len() <= target {
        return;
    }
    let quadrics = quadrics(points, triangles);
    let mut mesh = Collapsing::new(std::mem::take(points), std::mem::take(triangles), quadrics);
    while mesh.alive > SWEEP_ABOVE * target {
        let before = mesh.alive;
        mesh.sweep(SWEEP_ABOVE * target);
        let removed = before - mesh.alive;
        mesh = mesh.compacted();
        if (removed as f64) < LEAST_SWEEP * before as f64 {
            break;
        }
    }
    mesh.run(target);
    let mesh = mesh.compacted();
    (*points, *triangles) = (mesh.points, mesh.triangles);
}

/// The planes of the triangles around each vertex, weighted by area, and those that hold the borders.
fn quadrics(points: &[DVec3], triangles: &[[u32; 3]]) -> Vec<Quadric> {
    let mut quadrics = vec![Quadric::default(); points.len()];
    for &t in triangles {
        let normal = double_area(points, t);
        let length = normal.length();
        if length < 1e-20 {
            continue;
        }
        let weight = length / 6.0;
        let plane = Quadric::plane(normal / length, points[t[0] as usize], weight);
        for v in t.map(|v| v as usize) {
            quadrics[v].add(&plane);
            quadrics[v].add(&Quadric::point(points[v], weight * POINT_WEIGHT));
        }
    }
    for ([a, b], corners) in Edges::of(triangles, points.len()).iter().filter(|(_, corners)| corners.len() == 1) {
        let along = points[b as usize] - points[a as usize];
        let normal = along.cross(double_area(points, triangles[corners[0] as usize / 3]));
        if let Some(normal) = normal.try_normalize() {
            let plane = Quadric::plane(normal, points[a as usize], BORDER_WEIGHT * along.length_squared());
            quadrics[a as usize].add(&plane);
            quadrics[b as usize].add(&plane);
        }
    }
    quadrics
}

const DEAD: u32 = u32::MAX;

/// An edge by its [`key`], with the version of its ends when it was measured.
type Candidate = Reverse<(u64, u32)>;

struct Collapsing {
    points: Vec<DVec3>,
    quadrics: Vec<Quadric>,
    /// Dead triangles have [`DEAD`] as first vertex.
    triangles: Vec<[u32; 3]>,
    /// Corners around each vertex as a linked list, so that two lists join without a copy; dead ones are skipped.
    first: Vec<u32>,
    last: Vec<u32>,
    next: Vec<u32>,
    /// The vertex that a vertex was merged into, or itself.
    into: Vec<u32>,
    version: Vec<u32>,
    border: Vec<bool>,
    edges: Vec<[u32; 2]>,
    mark: Vec<u32>,
    stamp: u32,
    alive: usize,
}

impl Collapsing {
    fn new(points: Vec<DVec3>, triangles: Vec<[u32; 3]>, quadrics: Vec<Quadric>) -> Self {
        let n = points.len();
        let (mut first, mut last, mut next) = (vec![DEAD; n], vec![DEAD; n], vec![DEAD; 3 * triangles.len()]);
        for (corner, &v) in triangles.iter().flatten().enumerate() {
            let v = v as usize;
            if first[v] == DEAD {
                first[v] = corner as u32;
            } else {
                next[last[v] as usize] = corner as u32;
            }
            last[v] = corner as u32;
        }
        let mut border = vec![false; n];
        let table = Edges::of(&triangles, n);
        let mut edges = Vec::with_capacity(table.len());
        for ([a, b], corners) in table.iter() {
            edges.push([a, b]);
            if corners.len() != 2 {
                border[a as usize] = true;
                border[b as usize] = true;
            }
        }
        Self {
            alive: first.iter().filter(|&&c| c != DEAD).count(),
            points,
            quadrics,
            triangles,
            first,
            last,
            next,
            into: (0..n as u32).collect(),
            version: vec![0; n],
            border,
            edges,
            mark: vec![0; n],
            stamp: 0,
        }
    }

    /// The same without what is dead.
    fn compacted(mut self) -> Self {
        self.triangles.retain(|t| t[0] != DEAD);
        let kept = renumber(&mut self.triangles, self.points.len());
        let points = kept.iter().map(|&v| self.points[v as usize]).collect();
        let quadrics = kept.iter().map(|&v| self.quadrics[v as usize]).collect();
        Self::new(points, self.triangles, quadrics)
    }

    /// All edges by ascending cost; ties go to the lower edge.
    fn costs(&self) -> Vec<u64> {
        let cost = |(e, &[a, b]): (usize, &[u32; 2])| key(self.place(a, b).0, e as u32);
        self.edges.par_iter().enumerate().with_min_len(1024).map(cost).collect()
    }

    /// Collapses the cheapest edges of which no two share a vertex, down to `least` vertices or by a third.
    fn sweep(&mut self, least: usize) {
        let least = least.max((self.alive as f64 * (1.0 - SWEEP)) as usize);
        let mut costs = self.costs();
        costs.par_sort_unstable();
        for cost in costs {
            if self.alive <= least {
                break;
            }
            let [a, b] = self.edges[cost as u32 as usize];
            // A vertex whose version has changed has moved or is gone; the cost of its edges is not known in this sweep.
            if self.version[a as usize] == 0 && self.version[b as usize] == 0 {
                let (_, place) = self.place(a, b);
                if self.is_allowed(a, b, place) {
                    self.collapse(a, b, place);
                    self.version[b as usize] = 1;
                }
            }
        }
    }

    /// Collapses edges in order of cost.
    fn run(&mut self, target: usize) {
        let mut queue: BinaryHeap<Candidate> = self.costs().into_iter().map(|cost| Reverse((cost, 0))).collect();
        while self.alive > target {
            let Some(Reverse((popped, version))) = queue.pop() else { break };
            let e = popped as u32;
            let [a, b] = self.edges[e as usize].map(|v| self.current(v));
            self.edges[e as usize] = [a, b];
            if a == b {
                continue;
            }
            let (cost, place) = self.place(a, b);
            let now = self.version[a as usize].wrapping_add(self.version[b as usize]);
            if now != version {
                let fresh = key(cost, e);
                if queue.peek().is_some_and(|Reverse((least, _))| *least < fresh) {
                    queue.push(Reverse((fresh, now)));
                    continue;
                }
            }
            if self.is_allowed(a, b, place) {
                self.collapse(a, b, place);
            } else {
                let again = RETRY * f64::from(f32::from_bits((popped >> 32) as u32)).max(RETRY_FLOOR);
                if again < HOPELESS && self.share_triangle(a, b) {
                    queue.push(Reverse((key(again, e), now)));
                }
            }
        }
    }

    fn current(&mut self, mut v: u32) -> u32 {
        while self.into[v as usize] != v {
            let further = self.into[self.into[v as usize] as usize];
            self.into[v as usize] = further;
            v = further;
        }
        v
    }

    /// Cost and place of the vertex that replaces `a` and `b`.
    fn place(&self, a: u32, b: u32) -> (f64, DVec3) {
        let mut sum = self.quadrics[a as usize];
        sum.add(&self.quadrics[b as usize]);
        let (p, q) = (self.points[a as usize], self.points[b as usize]);
        let middle = (p + q) * 0.5;
        if let Some(best) = sum.minimum()
            && best.distance_squared(middle) < 4.0 * p.distance_squared(q)
        {
            return (sum.at(best).max(0.0), best);
        }
        let mut found = (sum.at(middle), middle);
        for candidate in [p, q] {
            let cost = sum.at(candidate);
            if cost < found.0 {
                found = (cost, candidate);
            }
        }
        (found.0.max(0.0), found.1)
    }

    /// Living triangles around `v`.
    fn around(&self, v: u32) -> impl Iterator<Item = u32> + '_ {
        let mut corner = self.first[v as usize];
        std::iter::from_fn(move || {
            while corner != DEAD {
                let t = corner / 3;
                corner = self.next[corner as usize];
                if self.triangles[t as usize][0] != DEAD {
                    return Some(t);
                }
            }
            None
        })
    }

    fn share_triangle(&self, a: u32, b: u32) -> bool {
        self.around(a).any(|t| self.triangles[t as usize].contains(&b))
    }

    fn is_allowed(&mut self, a: u32, b: u32, place: DVec3) -> bool {
        self.keeps_topology(a, b) && self.keeps_directions(a, b, place) && self.keeps_directions(b, a, place)
    }

    /// The link condition: the ends have no common neighbour besides those opposite the edge, and two borders do not meet.
    fn keeps_topology(&mut self, a: u32, b: u32) -> bool {
        let mut mark = std::mem::take(&mut self.mark);
        let (near, common) = (self.stamp + 1, self.stamp + 2);
        self.stamp = common;
        for t in self.around(a) {
            for v in self.triangles[t as usize] {
                mark[v as usize] = near;
            }
        }
        let (mut shared, mut commons) = (0, 0);
        for t in self.around(b) {
            let triangle = self.triangles[t as usize];
            shared += usize::from(triangle.contains(&a));
            for v in triangle {
                if v != a && v != b && mark[v as usize] == near {
                    mark[v as usize] = common;
                    commons += 1;
                }
            }
        }
        self.mark = mark;
        let joins_borders = shared == 2 && self.border[a as usize] && self.border[b as usize];
        commons <= shared && (shared == 1 || shared == 2) && !joins_borders
    }

    /// Whether no triangle of `v` (those on the edge apart) folds over or becomes a needle when `v` moves to `place`.
    fn keeps_directions(&self, v: u32, other: u32, place: DVec3) -> bool {
        self.around(v).all(|t| {
            let t = self.triangles[t as usize];
            if t.contains(&other) {
                return true;
            }
            let old = t.map(|w| self.points[w as usize]);
            let [p, q, r] = [0, 1, 2].map(|k| if t[k] == v { place } else { old[k] });
            let before = (old[1] - old[0]).cross(old[2] - old[0]);
            let after = (q - p).cross(r - p);
            let longest = p.distance_squared(q).max(q.distance_squared(r)).max(r.distance_squared(p));
            let area = after.length();
            before.dot(after) >= LARGEST_TURN * before.length() * area && area >= THINNEST * longest
        })
    }

    /// Merges `b` into `a` at `place`.
    fn collapse(&mut self, a: u32, b: u32, place: DVec3) {
        let (ai, bi) = (a as usize, b as usize);
        self.points[ai] = place;
        let quadric = self.quadrics[bi];
        self.quadrics[ai].add(&quadric);
        self.border[ai] |= self.border[bi];
        self.into[bi] = a;
        // Greater than both, so that the sum over any edge's ends grows with every change.
        self.version[ai] = self.version[ai].max(self.version[bi]) + 1;
        self.next[self.last[ai] as usize] = self.first[bi];
        self.last[ai] = self.last[bi];
        // Walk the joined list once: triangles on the edge die, the others take `a` for `b`, dead corners are unlinked.
        let (mut corner, mut previous) = (self.first[ai], DEAD);
        while corner != DEAD {
            let following = self.next[corner as usize];
            let t = &mut self.triangles[corner as usize / 3];
            if t[0] != DEAD && t.contains(&b) {
                if t.contains(&a) {
                    *t = [DEAD; 3];
                } else {
                    for v in t.iter_mut().filter(|v| **v == b) {
                        *v = a;
                    }
                }
            }
            if t[0] == DEAD {
                if previous == DEAD { self.first[ai] = following } else { self.next[previous as usize] = following }
            } else {
                previous = corner;
            }
            corner = following;
        }
        self.last[ai] = previous;
        self.alive -= 1 + usize::from(previous == DEAD);
    }
}

/// The cost as the bits of an `f32`, then the edge, so that ties go to the lower one.
fn key(cost: f64, edge: u32) -> u64 {
    // The bits of a non-negative float order like the float.
    u64::from((cost as f32).to_bits()) << 32 | u64::from(edge)
}

/// The quadratic form of a sum of weighted squared distances: upper triangle of a symmetric 4 × 4 matrix.
#[derive(Clone, Copy, Default)]
struct Quadric {
    xx: f64,
    xy: f64,
    xz: f64,
    xw: f64,
    yy: f64,
    yz: f64,
    yw: f64,
    zz: f64,
    zw: f64,
    ww: f64,
}

impl Quadric {
    fn plane(normal: DVec3, on: DVec3, weight: f64) -> Self {
        let (n, d, s) = (normal, -normal.dot(on), normal * weight);
        Self {
            xx: n.x * s.x,
            xy: n.x * s.y,
            xz: n.x * s.z,
            xw: d * s.x,
            yy: n.y * s.y,
            yz: n.y * s.z,
            yw: d * s.y,
            zz: n.z * s.z,
            zw: d * s.z,
            ww: d * d * weight,
        }
    }

    fn point(p: DVec3, weight: f64) -> Self {
        let w = weight;
        Self { xx: w, yy: w, zz: w, xw: -w * p.x, yw: -w * p.y, zw: -w * p.z, ww: w * p.length_squared(), ..Self::default() }
    }

    fn add(&mut self, o: &Self) {
        self.xx += o.xx;
        self.xy += o.xy;
        self.xz += o.xz;
        self.xw += o.xw;
        self.yy += o.yy;
        self.yz += o.yz;
        self.yw += o.yw;
        self.zz += o.zz;
        self.zw += o.zw;
        self.ww += o.ww;
    }

    fn at(&self, p: DVec3) -> f64 {
        let squares = self.xx * p.x * p.x + self.yy * p.y * p.y + self.zz * p.z * p.z;
        let mixed = self.xy * p.x * p.y + self.xz * p.x * p.z + self.yz * p.y * p.z;
        squares + 2.0 * (mixed + self.xw * p.x + self.yw * p.y + self.zw * p.z) + self.ww
    }

    /// Where the form is least, unless that is badly determined.
    fn minimum(&self) -> Option<DVec3> {
        let (cx, cy, cz) =
            (self.yy * self.zz - self.yz * self.yz, self.xz * self.yz - self.xy * self.zz, self.xy * self.yz - self.yy * self.xz);
        let determinant = self.xx * cx + self.xy * cy + self.xz * cz;
        let trace = self.xx + self.yy + self.zz;
        if determinant.abs() < 1e-10 * trace * trace * trace {
            return None;
        }
        let (dyy, dyz, dzz) =
            (self.xx * self.zz - self.xz * self.xz, self.xy * self.xz - self.xx * self.yz, self.xx * self.yy - self.xy * self.xy);
        let v = -DVec3::new(self.xw, self.yw, self.zw);
        let adjugate_v =
            DVec3::new(cx * v.x + cy * v.y + cz * v.z, cy * v.x + dyy * v.y + dyz * v.z, cz * v.x + dyz * v.y + dzz * v.z);
        Some(adjugate_v / determinant)
    }
}
