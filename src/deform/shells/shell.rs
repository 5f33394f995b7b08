//! The discrete shell: what a mesh resists, at rest and in its examples (Fröhlich & Botsch 2011, (1)–(8)).

use super::geometry::{dihedral, double_area, size, volume, wrapped};
use super::topology::{Hinge, NONE, Topology};
use crate::error::Result;
use glam::DVec3;
use std::f64::consts::PI;

/// Edges for which the factor of stretching is meant, where it is weighted by area: those of a mesh of 1,000 vertices.
const EDGES: f64 = 3000.0;
/// Least length of an edge in the weights, in median lengths, and least area at it, in squares of that length: edges that have vanished would
/// outweigh all others.
const FLOOR: f64 = 0.1;
/// Twice the area of a triangle over the square of its longest edge below which its normal says nothing.
const SLIVER: f64 = 1e-4;
/// The softest edge keeps this share of the stiffness (Appendix A with a relative ε).
const SOFTEST: f64 = 1e-2;

/// How hard the shell is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Material {
    /// λ of stretching.
    pub stretching: f64,
    /// μ of bending.
    pub bending: f64,
    /// ν of the volume.
    pub volume: f64,
    /// Whether each edge counts by the area beside it, so that λ means the same for any number of vertices: that on a mesh of 1,000. Else (1) as
    /// printed, where stretching grows with the number of edges.
    pub by_area: bool,
    /// Whether edges that change much in the examples are softer (Appendix A).
    pub from_examples: bool,
}

impl Material {
    /// For examples with free weights.
    pub const WITH_EXAMPLES: Self = Self { stretching: 100.0, bending: 1.0, volume: 1000.0, by_area: true, from_examples: false };
    /// Without examples: harder to blow up, and somewhat thicker, so that it does not crumple. A much thicker one gives way by triangles that collapse, and
    /// snaps from frame to frame.
    pub const WITHOUT_EXAMPLES: Self = Self { stretching: 30.0, volume: 30_000.0, ..Self::WITH_EXAMPLES };
    /// As the paper has it: 100, 1 and 1000.
    pub const PAPER: Self = Self { by_area: false, ..Self::WITH_EXAMPLES };

    /// The same with the stretching of a sheet of so many edge lengths of a mesh of 1,000 vertices: λ = μ (3.7 / t)².
    #[must_use]
    pub fn with_thickness(self, edges: f64) -> Self {
        Self { stretching: self.bending * (3.7 / edges).powi(2), ..self }
    }
}

/// An example: what it changes against the rest pose.
#[derive(Clone, Debug)]
pub(super) struct Example {
    lengths: Vec<f64>,
    angles: Vec<f64>,
    volume: f64,
    /// Derivatives of the weighted residuals with respect to its weight: edges, hinges, volume.
    pub stretch: Vec<f64>,
    pub bend: Vec<f64>,
    pub swell: f64,
    /// Sum of their squares.
    pub curvature: f64,
}

/// A mesh at rest with its examples.
#[derive(Clone, Debug)]
pub(super) struct Shell {
    pub rest: Vec<DVec3>,
    pub faces: Vec<[u32; 3]>,
    pub topology: Topology,
    pub examples: Vec<Example>,
    /// See [`size`].
    pub size: f64,
    pub volume: f64,
    lengths: Vec<f64>,
    angles: Vec<f64>,
    /// Roots of the weights in (8).
    pub stretch: Vec<f64>,
    pub bend: Vec<f64>,
    pub swell: f64,
    /// See [`super::geometry::dihedral_gradient`].
    pub floor: f64,
    /// Hinges that do not resist, since the way to an example leads through more than half a turn.
    pub folded: usize,
    /// Hinges that do not resist, since a triangle beside them has no normal.
    pub thin: usize,
}

impl Shell {
    /// Shapes: `rest` and each example: n; `stiffness`: factors of faces, or empty. Each face counter-clockwise from outside.
    ///
    /// # Errors
    /// Those of [`Topology::of`].
    pub fn new(
        rest: &[DVec3],
        faces: &[[u32; 3]],
        examples: &[Vec<DVec3>],
        material: &Material,
        stiffness: &[f64],
    ) -> Result<Self> {
        let topology = Topology::of(rest.len(), faces).map_err(|flaw| flaw.error(|v| v))?;
        let length_of =
            |x: &[DVec3]| -> Vec<f64> { topology.edges.iter().map(|[a, b]| x[*a as usize].distance(x[*b as usize])).collect() };
        let angles_of = |x: &[DVec3]| -> Vec<f64> { topology.hinges.iter().map(|h| dihedral(x, *h)).collect() };
        let (lengths, angles) = (length_of(rest), angles_of(rest));
        let median = median(&lengths);
        let double_areas: Vec<f64> = faces.iter().map(|f| double_area(rest, *f).length()).collect();
        let beside = |sides: &[u32; 2], of: &[f64]| -> (f64, f64) {
            let there = sides.iter().filter(|t| **t != NONE);
            (there.clone().map(|t| of[*t as usize]).sum(), there.count() as f64)
        };
        let areas: Vec<f64> = topology.sides.iter().map(|sides| 0.5 * beside(sides, &double_areas).0).collect();
        let floors: Vec<f64> = lengths.iter().map(|l| l.max(FLOOR * median)).collect();
        let mut differences: Vec<Example> = examples
            .iter()
            .map(|x| {
                let apart = |a: Vec<f64>, b: &[f64]| -> Vec<f64> { a.iter().zip(b).map(|(a, b)| a - b).collect() };
                Example {
                    lengths: apart(length_of(x), &lengths),
                    angles: apart(angles_of(x), &angles),
                    volume: volume(x, faces, &topology.holes),
                    stretch: Vec::new(),
                    bend: Vec::new(),
                    swell: 0.0,
                    curvature: 0.0,
                }
            })
            .collect();
        let (mut folded, mut thin) = (0, 0);
        let poses = || std::iter::once(rest).chain(examples.iter().map(Vec::as_slice));
        let off: Vec<bool> = (0..topology.hinges.len())
            .map(|h| {
                let is_folded = differences.iter().any(|e| e.angles[h].abs() > PI);
                let is_thin = poses().any(|x| has_sliver(x, topology.hinges[h]));
                folded += usize::from(is_folded);
                thin += usize::from(is_thin && !is_folded);
                is_folded || is_thin
            })
            .collect();
        for e in &mut differences {
            e.angles.iter_mut().zip(&off).for_each(|(angle, off)| *angle = if *off { 0.0 } else { wrapped(*angle) });
        }
        let soft = |of: fn(&Example) -> &[f64], count: usize| -> Vec<f64> {
            let change = |i: usize| differences.iter().map(|e| of(e)[i].abs()).fold(0.0, f64::max);
            let most = (0..count).map(change).fold(0.0, f64::max);
            if !material.from_examples || most == 0.0 {
                return vec![1.0; count];
            }
            (0..count).map(|i| 1.0 - change(i) / (most * (1.0 + SOFTEST))).collect()
        };
        let (soft_edges, soft_hinges) = (soft(|e| &e.lengths, lengths.len()), soft(|e| &e.angles, angles.len()));
        let factor = |edge: usize| {
            let (sum, count) = if stiffness.is_empty() { (1.0, 1.0) } else { beside(&topology.sides[edge], stiffness) };
            sum / count
        };
        let total: f64 = areas.iter().sum();
        let stretch: Vec<f64> = (0..lengths.len())
            .map(|e| {
                let share = if material.by_area { EDGES * areas[e] / total } else { 1.0 };
                (material.stretching * soft_edges[e] * factor(e) * share).sqrt() / floors[e]
            })
            .collect();
        let bend: Vec<f64> = (0..angles.len())
            .map(|h| {
                let e = topology.hinge_edges[h] as usize;
                let area = areas[e].max(FLOOR * floors[e] * floors[e]);
                if off[h] { 0.0 } else { (material.bending * soft_hinges[h] * factor(e) / area).sqrt() * floors[e] }
            })
            .collect();
        let size = size(rest, faces);
        let at_rest = volume(rest, faces, &topology.holes);
        let swell = if at_rest.abs() > 1e-12 * size.powi(3) { material.volume.sqrt() / at_rest.abs() } else { 0.0 };
        for e in &mut differences {
            e.volume -= at_rest;
            e.stretch = e.lengths.iter().zip(&stretch).map(|(d, w)| -d * w).collect();
            e.bend = e.angles.iter().zip(&bend).map(|(d, w)| -d * w).collect();
            e.swell = -swell * e.volume;
            let squares = |v: &[f64]| v.iter().map(|x| x * x).sum::<f64>();
            e.curvature = squares(&e.stretch) + squares(&e.bend) + e.swell * e.swell;
        }
        Ok(Self {
            rest: rest.to_vec(),
            faces: faces.to_vec(),
            topology,
            examples: differences,
            size,
            volume: at_rest,
            lengths,
            angles,
            stretch,
            bend,
            swell,
            floor: (1e-6 * median * median).powi(2),
            folded,
            thin,
        })
    }

    /// What lengths, angles and volume shall be with the weights (6); the volume is returned.
    pub fn wanted(&self, weights: &[f64], lengths: &mut [f64], angles: &mut [f64]) -> f64 {
        lengths.copy_from_slice(&self.lengths);
        angles.copy_from_slice(&self.angles);
        let mut volume = self.volume;
        for (example, &weight) in self.examples.iter().zip(weights).filter(|(_, weight)| **weight != 0.0) {
            lengths.iter_mut().zip(&example.lengths).for_each(|(l, d)| *l += weight * d);
            angles.iter_mut().zip(&example.angles).for_each(|(a, d)| *a += weight * d);
            volume += weight * example.volume;
        }
        volume
    }

    /// What the angle of a hinge shall be with the weights (6).
    pub fn wanted_angle(&self, hinge: usize, weights: &[f64]) -> f64 {
        self.angles[hinge]
            + self.examples.iter().zip(weights).map(|(example, weight)| weight * example.angles[hinge]).sum::<f64>()
    }
}

/// Whether a triangle of the hinge has no normal worth the name.
fn has_sliver(x: &[DVec3], [a, b, c, d]: Hinge) -> bool {
    [[a, b, c], [b, a, d]].into_iter().any(|face| {
        let [p, q, r] = face.map(|v| x[v as usize]);
        let longest = p.distance_squared(q).max(q.distance_squared(r)).max(r.distance_squared(p));
        double_area(x, face).length() <= SLIVER * longest.max(f64::MIN_POSITIVE)
    })
}

/// The median, the mean of the two in the middle where there is none.
fn median(values: &[f64]) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_unstable_by(f64::total_cmp);
    let half = sorted.len() / 2;
    match sorted.len() {
        0 => 0.0,
        n if n % 2 == 1 => sorted[half],
        _ => 0.5 * (sorted[half - 1] + sorted[half]),
    }
}
