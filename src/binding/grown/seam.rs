//! Cutting a surface along the seam between two sides, and closing it.

use super::sides::Side;
use crate::disjoint::DisjointSets;
use crate::scan::Faces;
use glam::DVec3;
use std::collections::{BTreeMap, VecDeque};

/// Rounds in which rims and arms are smoothed while they are apart: a seam follows the faces in steps, and thin arms with ragged rims are lost
/// when the proxy's surface is simplified (a left forearm 45 mm thick was).
const SMOOTHING: usize = 5;
/// The surface that is cut. Vertices in the same place are one.
pub(super) struct Mesh<'a> {
    points: &'a [DVec3],
    faces: &'a Faces,
    place: Vec<u32>,
    pub(super) keep: Vec<bool>,
    pub(super) added: Vec<[u32; 3]>,
    /// Vertices at the cuts.
    pub(super) rims: Vec<bool>,
}

impl<'a> Mesh<'a> {
    pub(super) fn new(points: &'a [DVec3], faces: &'a Faces) -> Self {
        let mut first = BTreeMap::new();
        let key = |p: &DVec3| p.to_array().map(|x| (x + 0.0).to_bits());
        let place = (0u32..).zip(points).map(|(v, p)| *first.entry(key(p)).or_insert(v)).collect();
        Self { points, faces, place, keep: vec![true; faces.len()], added: Vec::new(), rims: vec![false; points.len()] }
    }

    fn corners(&self) -> impl Iterator<Item = (usize, &'a [u32])> {
        let kept = self.faces.iter().enumerate();
        kept.filter(|(f, _)| self.keep[*f])
    }

    /// What does not hang together with the most of its side goes to the other.
    pub(super) fn tidy(&self, sides: &mut [Side]) {
        for (own, other) in [(Side::Limb, Side::Rest), (Side::Rest, Side::Limb)] {
            let mut sets = DisjointSets::of(self.place.clone());
            for (_, face) in self.corners() {
                for (&a, &b) in face.iter().zip(face.iter().cycle().skip(1)) {
                    if sides[a as usize] == own && sides[b as usize] == own {
                        sets.unite(a, b);
                    }
                }
            }
            let mut sizes = vec![0u32; sides.len()];
            let roots: Vec<u32> = (0..sides.len() as u32).map(|v| sets.find(v)).collect();
            (0..sides.len()).filter(|&v| sides[v] == own).for_each(|v| sizes[roots[v] as usize] += 1);
            let most = (0..sides.len()).max_by_key(|&v| (sizes[v], std::cmp::Reverse(v)));
            for (side, &root) in sides.iter_mut().zip(&roots) {
                if *side == own && Some(root as usize) != most {
                    *side = other;
                }
            }
        }
    }

    /// Cuts along the seam between the sides and closes both; whether there is one, all in one piece from front to back. Nothing is changed
    /// otherwise. `least`: how far down along `up` it has to reach.
    pub(super) fn part(&mut self, sides: &[Side], up: DVec3, least: f64) -> bool {
        let across = |face: &[u32]| {
            let has = |side: Side| face.iter().any(|&v| sides[v as usize] == side);
            has(Side::Limb) && has(Side::Rest)
        };
        let seam: Vec<usize> = self.corners().filter(|(_, face)| across(face)).map(|(f, _)| f).collect();
        if seam.is_empty() {
            return false;
        }
        let mut at_seam = vec![false; sides.len()];
        for &f in &seam {
            self.keep[f] = false;
            self.faces
                .face(f)
                .iter()
                .filter(|&&v| sides[v as usize] != Side::Neither)
                .for_each(|&v| at_seam[self.place[v as usize] as usize] = true);
        }
        let before = self.added.len();
        let (mut rims, mut parted) = (0, 0);
        for rim in self.holes().into_iter().filter(|rim| rim.iter().any(|&v| at_seam[v as usize])) {
            let heights = rim.iter().map(|&v| self.points[v as usize].dot(up));
            let (low, high) = heights.fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), h| (a.min(h), b.max(h)));
            // Specks stay holes.
            if high - low < least {
                continue;
            }
            rims += 1;
            if let Some([limb, rest]) = halves(&rim, sides) {
                self.close(&limb);
                self.close(&rest);
                parted += 1;
            }
        }
        if (parted, rims) == (1, 1) {
            self.rims.iter_mut().enumerate().for_each(|(v, rim)| *rim |= at_seam[self.place[v] as usize]);
            return true;
        }
        self.added.truncate(before);
        seam.iter().for_each(|&f| self.keep[f] = true);
        false
    }

    /// Edges of what stays, both ways, in their order.
    fn edges(&self) -> Vec<(u32, u32)> {
        let mut edges: Vec<(u32, u32)> = Vec::new();
        for face in self.corners().map(|(_, face)| face).chain(self.added.iter().map(|t| &t[..])) {
            for (&a, &b) in face.iter().zip(face.iter().cycle().skip(1)) {
                let (a, b) = (self.place[a as usize], self.place[b as usize]);
                edges.extend([(a, b), (b, a)]);
            }
        }
        edges.sort_unstable();
        edges.dedup();
        edges
    }

    /// Gives the side of their neighbours to those of neither side that pass, the nearest first.
    pub(super) fn spread(&self, sides: &mut [Side], passes: impl Fn(usize) -> bool) {
        let edges = self.edges();
        let mut open: VecDeque<u32> = (0..sides.len() as u32).filter(|&v| sides[v as usize] != Side::Neither).collect();
        while let Some(v) = open.pop_front() {
            let first = edges.partition_point(|e| e.0 < v);
            for &(_, w) in edges[first..].iter().take_while(|e| e.0 == v) {
                if sides[w as usize] == Side::Neither && passes(w as usize) {
                    sides[w as usize] = sides[v as usize];
                    open.push_back(w);
                }
            }
        }
        (0..sides.len()).for_each(|v| sides[v] = sides[self.place[v] as usize]);
    }

    /// Moves some vertices half way to the mean of their neighbours, again and again.
    pub(super) fn smooth(&self, moving: &[bool], shift: &mut [DVec3]) {
        let edges = self.edges();
        let around: Vec<&[(u32, u32)]> =
            edges.chunk_by(|a, b| a.0 == b.0).filter(|around| moving[around[0].0 as usize]).collect();
        for _ in 0..SMOOTHING {
            let at = |v: u32| self.points[v as usize] + shift[v as usize];
            let mean = |around: &&[(u32, u32)]| around.iter().map(|e| at(e.1)).sum::<DVec3>() / around.len() as f64;
            let halves: Vec<DVec3> = around.iter().map(|around| (mean(around) - at(around[0].0)) * 0.5).collect();
            around.iter().zip(halves).for_each(|(around, half)| shift[around[0].0 as usize] += half);
        }
        (0..shift.len()).for_each(|v| shift[v] = shift[self.place[v] as usize]);
    }

    /// Rims of the holes, each in the order that faces which close it have.
    fn holes(&self) -> Vec<Vec<u32>> {
        let mut sides: BTreeMap<(u32, u32), i32> = BTreeMap::new();
        let kept = self.corners().map(|(_, face)| face);
        for face in kept.chain(self.added.iter().map(|t| &t[..])) {
            for (&a, &b) in face.iter().zip(face.iter().cycle().skip(1)) {
                let (a, b) = (self.place[a as usize], self.place[b as usize]);
                *sides.entry((a, b)).or_default() += 1;
                *sides.entry((b, a)).or_default() -= 1;
            }
        }
        let mut next: BTreeMap<u32, Vec<u32>> = BTreeMap::new();
        sides.iter().filter(|side| *side.1 > 0).for_each(|(&(a, b), _)| next.entry(b).or_default().push(a));
        let mut rims = Vec::new();
        while let Some((&start, _)) = next.first_key_value() {
            let mut rim = vec![start];
            loop {
                let last = rim[rim.len() - 1];
                let Some(to) = next.get_mut(&last).and_then(Vec::pop) else { break };
                if next[&last].is_empty() {
                    next.remove(&last);
                }
                if to == start {
                    break;
                }
                rim.push(to);
            }
            rims.push(rim);
        }
        rims
    }

    /// Closes a rim whose ends are the front and the back of where the parts meet: from there on by the shorter of the two next edges.
    fn close(&mut self, rim: &[u32]) {
        let (mut i, mut j) = (0, rim.len() - 1);
        let length = |a: usize, b: usize| self.points[rim[a] as usize].distance_squared(self.points[rim[b] as usize]);
        while j - i > 1 {
            if length(i + 1, j) <= length(i, j - 1) {
                self.added.push([rim[i], rim[i + 1], rim[j]]);
                i += 1;
            } else {
                self.added.push([rim[i], rim[j - 1], rim[j]]);
                j -= 1;
            }
        }
    }
}

/// The rim of each side, from one place where they meet to the other; `None` unless there are two such places.
fn halves(rim: &[u32], sides: &[Side]) -> Option<[Vec<u32>; 2]> {
    let at = |i: usize| sides[rim[i % rim.len()] as usize];
    let mut first = None;
    let mut runs = 0;
    let mut before = (0..rim.len()).rev().map(at).find(|s| *s != Side::Neither)?;
    for i in 0..rim.len() {
        let own = at(i);
        if own != Side::Neither && own != before {
            runs += 1;
            if own == Side::Limb {
                first = Some(i);
            }
            before = own;
        }
    }
    let first = first.filter(|_| runs == 2)?;
    let turned: Vec<u32> = (0..rim.len()).map(|i| rim[(first + i) % rim.len()]).collect();
    let is = |side: Side| move |v: &u32| sides[*v as usize] == side;
    let (last_limb, rest) = (turned.iter().rposition(is(Side::Limb))?, turned.iter().position(is(Side::Rest))?);
    let last_rest = turned.iter().rposition(is(Side::Rest))?;
    // Where no vertex lies between the sides, the last of one is the place.
    let middle = |from: usize, to: usize| if to > from + 1 { from.midpoint(to) } else { from };
    let (one, other) = (middle(last_limb, rest), middle(last_rest, turned.len()));
    let limb = turned[other..].iter().chain(&turned[..=one]).copied().collect();
    Some([limb, turned[one..=other].to_vec()])
}
