//! Soft handles: their pull in the energy, and their release without a new factorization.
//!
//! The matrix is factored with every handle at its full weight, `A₀ = L + Bᵀ W B`. A handle that is released or fades has the weight
//! `W (1 − released)`, and Woodbury's identity gives the solution with the changed weights from the solution with the full ones:
//! `A⁻¹ r = z + Yₛ √D (I − √D S √D)⁻¹ √D Bₛ z`, with `z = A₀⁻¹ r`, `Y = A₀⁻¹ Bᵀ`, `S = B Y`, `D = W · released`, over the released handles s.

use crate::deform::{Handle, Targets};
use crate::linalg::lanes::{Lanes, for_each_instruction_set};
use crate::linalg::{Cholesky, DenseCholesky};

/// What the presence of the handles says about a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Presence {
    /// No handle holds the body.
    Nobody,
    /// The weights are those of the frame before.
    Same,
    /// Some weight is another one.
    Changed,
}

/// Hardness that replaces a release which would leave the body without hold.
const LAST_RESORT: f64 = 0.01;

/// Bound on the smallest eigenvalue of `I − √D S √D`, below which the remaining handles do not hold the body.
const UNHELD: f64 = 1e-9;

pub(super) struct SoftHandles {
    starts: Vec<usize>,
    vertices: Vec<u32>,
    values: Vec<f64>,
    weights: Vec<f64>,
    /// Part of the weight that is kept when a release would leave the body without hold.
    last_resort: Vec<f64>,
    /// `A₀⁻¹ Bᵀ`, one handle after the other.
    responses: Vec<f64>,
    /// `B A₀⁻¹ Bᵀ`.
    compliance: Vec<f64>,
    /// Present targets; of an absent handle the last one.
    targets: Vec<Lanes>,
    /// Part of the full weight that each handle holds with.
    presence: Vec<f64>,
    asked: Vec<f64>,
    /// Handles with less than their full weight.
    released: Vec<usize>,
    /// `√D` of each of them.
    roots: Vec<f64>,
    capacitance: DenseCholesky,
    scratch: Vec<f64>,
}

impl SoftHandles {
    /// `handles` with rows in the solver's numbering, and `weights` in the energy.
    pub(super) fn new(handles: &[Handle], weights: Vec<f64>, factor: &Cholesky) -> Self {
        let (count, size) = (handles.len(), factor.size());
        let mut result = Self {
            starts: vec![0],
            vertices: Vec::new(),
            values: Vec::new(),
            last_resort: handles.iter().map(|h| (LAST_RESORT / h.beta).min(1.0)).collect(),
            weights,
            responses: vec![0.0; count * size],
            compliance: vec![0.0; count * count],
            targets: vec![Lanes::ZERO; count],
            presence: vec![1.0; count],
            asked: vec![1.0; count],
            released: Vec::with_capacity(count),
            roots: Vec::with_capacity(count),
            capacitance: DenseCholesky::with_capacity(count),
            scratch: vec![0.0; count],
        };
        for handle in handles {
            result.vertices.extend_from_slice(&handle.row.indices);
            result.values.extend_from_slice(&handle.row.values);
            result.starts.push(result.vertices.len());
        }
        result.respond(factor);
        result
    }

    fn respond(&mut self, factor: &Cholesky) {
        let (count, size) = (self.len(), factor.size());
        let mut x = vec![Lanes::ZERO; size];
        for first in (0..count).step_by(4) {
            let lanes = (count - first).min(4);
            x.fill(Lanes::ZERO);
            for lane in 0..lanes {
                for (v, b) in self.row(first + lane) {
                    x[v].0[lane] += b;
                }
            }
            factor.solve(&mut x);
            for lane in 0..lanes {
                let h = first + lane;
                for (response, x) in self.responses[h * size..(h + 1) * size].iter_mut().zip(&x) {
                    *response = x.0[lane];
                }
                for other in 0..count {
                    self.compliance[other * count + h] = self.row(other).map(|(v, b)| b * x[v].0[lane]).sum();
                }
            }
        }
    }

    pub(super) fn len(&self) -> usize {
        self.weights.len()
    }

    fn row(&self, h: usize) -> impl Iterator<Item = (usize, f64)> + '_ {
        let range = self.starts[h]..self.starts[h + 1];
        self.vertices[range.clone()].iter().zip(&self.values[range]).map(|(&v, &b)| (v as usize, b))
    }

    /// The row of a handle applied to points.
    pub(super) fn apply(&self, h: usize, points: &[Lanes]) -> Lanes {
        self.row(h).fold(Lanes::ZERO, |sum, (v, b)| sum + points[v] * b)
    }

    /// Mean distance of the present targets from their handles, where `place` tells the points.
    pub(super) fn mean_distance(&self, place: impl Fn(usize) -> Lanes) -> f64 {
        let (mut sum, mut count) = (0.0, 0.0);
        for h in (0..self.len()).filter(|&h| self.asked[h] > 0.0) {
            let handle = self.row(h).fold(Lanes::ZERO, |sum, (v, b)| sum + place(v) * b);
            sum += (handle - self.targets[h]).xyz().length();
            count += 1.0;
        }
        if count > 0.0 { sum / count } else { 0.0 }
    }

    pub(super) fn target(&self, h: usize) -> Lanes {
        self.targets[h]
    }

    /// The weight of a handle in this frame.
    pub(super) fn weight(&self, h: usize) -> f64 {
        self.weights[h] * self.presence[h]
    }

    /// The same, without what is kept of handles that have no target.
    pub(super) fn present_weight(&self, h: usize) -> f64 {
        self.weights[h] * self.asked[h]
    }

    /// Moves the remembered target of a handle that is absent.
    pub(super) fn place_absent(&mut self, place: impl Fn(usize, &Self) -> Lanes) {
        for h in 0..self.len() {
            if self.asked[h] == 0.0 {
                self.targets[h] = place(h, self);
            }
        }
    }

    /// Takes over the targets of a frame. Targets that are not points count as absent. With [`Presence::Nobody`] nothing is taken over.
    pub(super) fn take(&mut self, targets: &Targets) -> Presence {
        let asked = |h: usize| {
            let presence = targets.presence[h];
            if targets.positions[h].is_finite() && presence > 0.0 { presence.min(1.0) } else { 0.0 }
        };
        if (0..self.len()).all(|h| asked(h) == 0.0) {
            return Presence::Nobody;
        }
        let mut result = Presence::Same;
        for h in 0..self.len() {
            let presence = asked(h);
            if presence > 0.0 {
                self.targets[h] = Lanes::point(targets.positions[h]);
            }
            if self.asked[h] != presence {
                self.asked[h] = presence;
                result = Presence::Changed;
            }
        }
        if result == Presence::Changed {
            self.presence.copy_from_slice(&self.asked);
            if !self.release() {
                for h in 0..self.len() {
                    self.presence[h] = self.asked[h].max(self.last_resort[h]);
                }
                if !self.release() {
                    // The hardness of the last resort is within the precision of a double for any hardness in use; full weights always hold.
                    self.presence.fill(1.0);
                    self.release();
                }
            }
        }
        result
    }

    /// Prepares Woodbury's identity for the present weights; `false` when what is left does not hold the body.
    fn release(&mut self) -> bool {
        let count = self.len();
        self.released.clear();
        self.roots.clear();
        for h in (0..count).filter(|&h| self.presence[h] < 1.0) {
            self.released.push(h);
            self.roots.push((self.weights[h] * (1.0 - self.presence[h])).sqrt());
        }
        let size = self.released.len();
        let matrix = self.capacitance.refill(size);
        for (j, (&b, rb)) in self.released.iter().zip(&self.roots).enumerate() {
            for (i, (&a, ra)) in self.released.iter().zip(&self.roots).enumerate().skip(j) {
                matrix[j * size + i] = f64::from(u8::from(i == j)) - ra * self.compliance[a * count + b] * rb;
            }
        }
        self.capacitance.factor() && self.smallest_eigenvalue() > UNHELD
    }

    /// A lower bound of the smallest eigenvalue, from the Frobenius norm of the inverse.
    fn smallest_eigenvalue(&mut self) -> f64 {
        let column = &mut self.scratch[..self.released.len()];
        let mut squares = 0.0;
        for j in 0..column.len() {
            column.fill(0.0);
            column[j] = 1.0;
            self.capacitance.solve(column);
            squares += column.iter().map(|x| x * x).sum::<f64>();
        }
        if squares == 0.0 { 1.0 } else { 1.0 / squares.sqrt() }
    }

    /// Adds the pull of the handles at `p` to half the gradient; returns their energy.
    pub(super) fn pull(&self, p: &[Lanes], g: &mut [Lanes]) -> f64 {
        let mut energy = 0.0;
        for h in 0..self.len() {
            let weight = self.weight(h);
            if weight == 0.0 {
                continue;
            }
            let residual = self.apply(h, p) - self.targets[h];
            energy += weight * (residual * residual).sum();
            for (v, b) in self.row(h) {
                g[v] += residual * (weight * b);
            }
        }
        energy
    }

    /// `A⁻¹ x` with the present weights; `pulls` is memory for one point per handle.
    pub(super) fn solve(&self, factor: &Cholesky, x: &mut [Lanes], pulls: &mut [[f64; 3]], scratch: &mut [f64]) {
        factor.solve(x);
        let size = self.released.len();
        if size == 0 {
            return;
        }
        let (pulls, scratch) = (&mut pulls[..size], &mut scratch[..size]);
        for ((pull, &h), root) in pulls.iter_mut().zip(&self.released).zip(&self.roots) {
            let value = self.apply(h, x) * *root;
            *pull = [value.0[0], value.0[1], value.0[2]];
        }
        for axis in 0..3 {
            for (s, pull) in scratch.iter_mut().zip(pulls.iter()) {
                *s = pull[axis];
            }
            self.capacitance.solve(scratch);
            for ((s, pull), root) in scratch.iter().zip(pulls.iter_mut()).zip(&self.roots) {
                pull[axis] = s * root;
            }
        }
        for (pull, &h) in pulls.iter().zip(&self.released) {
            let [a, b, c] = *pull;
            add_response(&self.responses[h * x.len()..(h + 1) * x.len()], Lanes([a, b, c, 0.0]), x);
        }
    }

    /// Handles with less than their full weight, `√D` of each, and the factor of `I − √D S √D`.
    pub(super) fn released(&self) -> (&[usize], &[f64], &DenseCholesky) {
        (&self.released, &self.roots, &self.capacitance)
    }
}

for_each_instruction_set! {
    fn add_response(response: &[f64], pull: Lanes, x: &mut [Lanes]) {
        for (x, y) in x.iter_mut().zip(response) {
            *x += pull * *y;
        }
    }
}
