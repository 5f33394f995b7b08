//! Which limb each vertex of the proxy belongs to, by the ways through the body: where limbs touch or overlap, places do not tell.

use super::{Binding, Segment};
use crate::proxy::Proxy;
use glam::DVec3;
use std::cmp::Reverse;
use std::collections::BinaryHeap;

/// A way to the hips that leads through the middle of an upper arm or a hip joint is longer than the shortest by no more than the limb is thick
/// there, in statures.
const THICK: f64 = 0.08;
/// An arm that hangs begins below the armpit: at this share of the upper arm.
const ARMPIT: f64 = 0.6;
/// Places nearer than this, in diagonals, are one.
const SAME: f64 = 1e-9;
/// A leg is what lies farther than this from its hip joint, in statures.
const ROOT: f64 = 0.12;
/// So far beyond its beginning an arm may still move with the trunk, in statures.
const REACH: f64 = 0.05;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Limb {
    /// A piece by itself: no way leads there.
    Loose,
    Body,
    Arm(usize),
    Leg(usize),
}

/// The limbs of a proxy.
#[derive(Clone, Debug)]
pub struct Limbs {
    of: Vec<Limb>,
    /// Whether a vertex of an arm is near its shoulder.
    root: Vec<bool>,
}

impl Limbs {
    /// `None` where no body is known. `diagonal`: of the scan, in its own unit; `joined`: centroids of tetrahedra that join what only touches, which are
    /// no way.
    pub fn of(proxy: &Proxy, binding: &Binding, diagonal: f64, joined: &[DVec3]) -> Option<Self> {
        let height = binding.decisions.scan_height? / diagonal;
        let start = |s: Segment| binding.segments.iter().find(|p| p.segment == s).map(|p| p.from);
        let ways = Ways::new(proxy, joined);
        let from = |s: Segment| Some(ways.from(proxy, start(s)?));
        let below = |s: Segment| {
            let place = binding.segments.iter().find(|p| p.segment == s)?;
            Some(ways.from(proxy, place.from.lerp(place.to, ARMPIT)))
        };
        let hips = from(Segment::Pelvis)?;
        let arms = [below(Segment::LeftUpperArm)?, below(Segment::RightUpperArm)?];
        let legs = [from(Segment::LeftThigh)?, from(Segment::RightThigh)?];
        let past = |(root, ways): &(usize, Vec<f64>), v: usize| {
            ways[v].is_finite() && hips.1[v] + THICK * height >= hips.1[*root] + ways[v]
        };
        let limb = |v: usize| {
            if !hips.1[v].is_finite() {
                return Limb::Loose;
            }
            let arm = (0..2).filter(|&s| past(&arms[s], v)).min_by(|&a, &b| arms[a].1[v].total_cmp(&arms[b].1[v]));
            let leg = (0..2).filter(|&s| past(&legs[s], v) && legs[s].1[v] > ROOT * height);
            let leg = leg.min_by(|&a, &b| legs[a].1[v].total_cmp(&legs[b].1[v]));
            arm.map(Limb::Arm).or(leg.map(Limb::Leg)).unwrap_or(Limb::Body)
        };
        let of: Vec<Limb> = (0..proxy.rest.len()).map(limb).collect();
        let root =
            of.iter().enumerate().map(|(v, limb)| matches!(limb, Limb::Arm(s) if arms[*s].1[v] < REACH * height)).collect();
        Some(Self { of, root })
    }

    /// Whether a vertex may move with a segment: those of other limbs do not.
    pub fn suits(&self, vertex: u32, segment: Segment) -> bool {
        use Segment::*;
        let limb = self.of[vertex as usize];
        if limb == Limb::Loose {
            return true;
        }
        match segment {
            LeftForearm | LeftHand => limb == Limb::Arm(0),
            RightForearm | RightHand => limb == Limb::Arm(1),
            LeftUpperArm => matches!(limb, Limb::Arm(0) | Limb::Body),
            RightUpperArm => matches!(limb, Limb::Arm(1) | Limb::Body),
            LeftShank | LeftFoot => limb == Limb::Leg(0),
            RightShank | RightFoot => limb == Limb::Leg(1),
            LeftThigh => matches!(limb, Limb::Leg(0) | Limb::Body),
            RightThigh => matches!(limb, Limb::Leg(1) | Limb::Body),
            Pelvis | Trunk | Head => !matches!(limb, Limb::Arm(_)) || self.root[vertex as usize],
        }
    }
}

/// Edges of the tetrahedra.
struct Ways {
    /// Vertices of the largest component.
    body: Vec<u32>,
    starts: Vec<usize>,
    next: Vec<(u32, f64)>,
}

impl Ways {
    fn new(proxy: &Proxy, joined: &[DVec3]) -> Self {
        let joins = |t: &[u32; 4]| {
            let centroid = t.iter().map(|&v| proxy.rest[v as usize]).sum::<DVec3>() / 4.0;
            joined.iter().any(|j| j.distance(centroid) < SAME)
        };
        let mut edges: Vec<[u32; 2]> = proxy
            .tets
            .iter()
            .filter(|t| !joins(t))
            .flat_map(|t| t.iter().flat_map(move |&a| t.iter().map(move |&b| [a, b])))
            .filter(|e| e[0] != e[1])
            .collect();
        edges.sort_unstable();
        edges.dedup();
        let mut starts = vec![0; proxy.rest.len() + 1];
        edges.iter().for_each(|e| starts[e[0] as usize + 1] += 1);
        (0..proxy.rest.len()).for_each(|v| starts[v + 1] += starts[v]);
        let length = |e: &[u32; 2]| proxy.rest[e[0] as usize].distance(proxy.rest[e[1] as usize]);
        let component = |c: u32| proxy.tets.iter().zip(&proxy.components).filter(move |(_, of)| **of == c).map(|(t, _)| t);
        let count = proxy.components.iter().max().map_or(0, |&last| last + 1);
        let main = (0..count).max_by_key(|&c| (component(c).count(), Reverse(c))).unwrap_or(0);
        let mut body: Vec<u32> = component(main).flatten().copied().collect();
        body.sort_unstable();
        body.dedup();
        Self { body, starts, next: edges.iter().map(|e| (e[1], length(e))).collect() }
    }

    /// The vertex of the body nearest to a place, and the ways from there to all; infinite where none leads.
    fn from(&self, proxy: &Proxy, place: DVec3) -> (usize, Vec<f64>) {
        let far = |v: &u32| proxy.rest[*v as usize].distance_squared(place);
        let root = self.body.iter().min_by(|a, b| far(a).total_cmp(&far(b))).map_or(0, |&v| v as usize);
        let mut ways = vec![f64::INFINITY; proxy.rest.len()];
        // Lengths are not negative, so their bits are in their order.
        let mut queue = BinaryHeap::from([Reverse((0u64, root as u32))]);
        ways[root] = 0.0;
        while let Some(Reverse((bits, v))) = queue.pop() {
            let way = f64::from_bits(bits);
            if way > ways[v as usize] {
                continue;
            }
            for &(w, length) in &self.next[self.starts[v as usize]..self.starts[v as usize + 1]] {
                if way + length < ways[w as usize] {
                    ways[w as usize] = way + length;
                    queue.push(Reverse(((way + length).to_bits(), w)));
                }
            }
        }
        (root, ways)
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;
    use crate::binding::tests::{PLUG_IN_GAIT, bound, labels_of, landmarks_of, person, take};
    use crate::binding::{Options, fit, segments::Skeleton};

    /// A person of sticks: vertices along the bones, each joined to the next by a tetrahedron.
    fn sticks(binding: &Binding) -> (Proxy, Vec<Segment>) {
        let mut proxy = Proxy::default();
        let mut segments = Vec::new();
        let mut ends: Vec<(DVec3, u32)> = Vec::new();
        for place in &binding.segments {
            let near = ends.iter().find(|e| e.0.distance(place.from) < 1e-9).map(|e| e.1);
            let hub = ends.first().map(|e| e.1);
            let mut last = near.or(hub);
            for k in 0..=8 {
                let p = place.from.lerp(place.to, f64::from(k) / 8.0);
                let first = proxy.rest.len() as u32;
                proxy.rest.extend([p, p + DVec3::X * 1e-3, p + DVec3::Y * 1e-3]);
                segments.extend([place.segment; 3]);
                if let Some(last) = last {
                    proxy.tets.push([last, first, first + 1, first + 2]);
                    proxy.components.push(0);
                }
                last = Some(first);
            }
            ends.push((place.to, last.unwrap()));
        }
        (proxy, segments)
    }

    #[test]
    fn hands_inside_the_hips_belong_to_the_arms() {
        let person = person(1.45);
        let labels = labels_of(&PLUG_IN_GAIT);
        let seen = landmarks_of(&person, &labels);
        let frame = fit::simulate(&Skeleton::of(&person.body), &seen, &[], &[]);
        let binding = bound(&person, &take(&person, &labels, &[frame], 0.3, 0.0), &Options::default()).unwrap();
        let (proxy, segments) = sticks(&binding);
        // An eye, which no way leads to.
        let (mut proxy, eye) = (proxy, segments.len() as u32);
        proxy.rest.extend([DVec3::Y, DVec3::Y * 1.001, DVec3::Y + DVec3::X * 1e-3, DVec3::Y + DVec3::Z * 1e-3]);
        proxy.tets.push([eye, eye + 1, eye + 2, eye + 3]);
        proxy.components.push(1);
        let limbs = Limbs::of(&proxy, &binding, person.unit_box.diagonal, &[]).unwrap();
        assert!(Segment::ALL.iter().all(|&s| limbs.suits(eye, s)));
        let used = |v: u32| proxy.tets.iter().flatten().any(|&w| w == v);
        for (v, &segment) in (0u32..).zip(&segments).filter(|(v, _)| used(*v)) {
            if matches!(segment, Segment::LeftForearm | Segment::LeftHand) {
                assert!(limbs.suits(v, Segment::LeftHand) && limbs.suits(v, Segment::LeftUpperArm), "{v}");
                assert!(
                    !limbs.suits(v, Segment::Pelvis)
                        && !limbs.suits(v, Segment::LeftThigh)
                        && !limbs.suits(v, Segment::RightHand)
                );
            }
            if matches!(segment, Segment::RightShank | Segment::RightFoot) {
                assert!(
                    limbs.suits(v, Segment::RightFoot)
                        && !limbs.suits(v, Segment::LeftFoot)
                        && !limbs.suits(v, Segment::RightHand)
                );
            }
            if segment == Segment::Pelvis {
                assert!(
                    limbs.suits(v, Segment::Trunk)
                        && !limbs.suits(v, Segment::LeftHand)
                        && !limbs.suits(v, Segment::RightForearm)
                );
            }
        }
    }
}
