//! Where two parts touch: candidate pairs and contact surfaces (Xu et al. 2009, §3.1–3.2).

use super::part::Part;
use super::samples::Samples;
use glam::DVec3;

/// Normals of touching surfaces are at least this far apart (cosine of 145°).
const OPPOSED: f64 = -0.819;

/// Samples in the region that two parts share, of each part.
const COUNT: usize = 4000;

/// The surface of two parts that faces the other one closely.
#[derive(Clone, Debug, Default)]
pub struct Contact {
    /// Of both parts.
    pub surface: Samples,
    /// How many of the first samples belong to the first part.
    pub of_first: usize,
}

impl Contact {
    /// Between two parts whose surfaces are at most `reach` apart, be it a gap or an overlap. `spacing`: of the samples, at most.
    pub fn between(a: &Part, b: &Part, reach: f64, spacing: f64) -> Self {
        let mut surface = Samples::default();
        let Some((lo, hi)) = shared(a, b, reach) else { return Self::default() };
        surface.extend(&a.samples(lo, hi, COUNT, spacing), |p, n| faces(b, p, n, reach));
        let of_first = surface.len();
        surface.extend(&b.samples(lo, hi, COUNT, spacing), |p, n| faces(a, p, n, reach));
        Self { surface, of_first }
    }

    /// The surface of the part that lies deeper than `reach` in the other one: solids pushed into each other, without a cavity.
    pub fn embedded(a: &Part, b: &Part, reach: f64, spacing: f64) -> Self {
        let Some((lo, hi)) = shared(a, b, reach) else { return Self::default() };
        let inside = |x: &Part, y: &Part| {
            let mut surface = Samples::default();
            surface.extend(&x.samples(lo, hi, COUNT, spacing), |p, _| y.depth(p) > reach);
            surface
        };
        let (of_a, of_b) = (inside(a, b), inside(b, a));
        if of_a.area() >= of_b.area() {
            Self { of_first: of_a.len(), surface: of_a }
        } else {
            Self { of_first: 0, surface: of_b }
        }
    }
}

/// The box in which two parts can be within `reach` of each other.
fn shared(a: &Part, b: &Part, reach: f64) -> Option<(DVec3, DVec3)> {
    let lo = a.bounds.0.max(b.bounds.0) - reach;
    let hi = a.bounds.1.min(b.bounds.1) + reach;
    lo.cmple(hi).all().then_some((lo, hi))
}

/// Whether the line through `p` along its normal meets `other` within `reach` on either side, at a face that looks the other way. It begins behind `p`,
/// since tessellated mating surfaces cross each other.
fn faces(other: &Part, p: DVec3, n: DVec3, reach: f64) -> bool {
    if other.tree.closest_within(p, reach).is_none() {
        return false;
    }
    let hits = other.tree.hits(p - n * reach, n);
    hits.iter().take_while(|hit| hit.distance <= 2.0 * reach).any(|hit| other.normals[hit.triangle].dot(n) < OPPOSED)
}

/// Pairs of parts that come within `reach` of each other, in order.
pub fn pairs(parts: &[Part], reach: f64) -> Vec<(usize, usize)> {
    let near = |a: &Part, b: &Part| {
        let Some((lo, hi)) = shared(a, b, reach) else { return false };
        let (few, many) = if a.triangles.len() <= b.triangles.len() { (a, b) } else { (b, a) };
        let within = |p: DVec3| p.cmpge(lo).all() && p.cmple(hi).all();
        let near = |x: &Part, p: DVec3| within(p) && x.tree.closest_within(p, reach).is_some();
        few.points.iter().any(|&p| near(many, p))
            || many.points.iter().any(|&p| near(few, p))
            || few.samples(lo, hi, 500, f64::INFINITY).points.iter().any(|&p| near(many, p))
    };
    let all = (0..parts.len()).flat_map(|i| (i + 1..parts.len()).map(move |j| (i, j)));
    all.filter(|&(i, j)| near(&parts[i], &parts[j])).collect()
}
