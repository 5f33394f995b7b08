//! The normal equations of a step: six unknowns per variable (a turn and a shift), blocks where variables share a row.

use crate::linalg::repeated::RepeatedCholesky;
use crate::linalg::{NotPositive, elimination_order};
use glam::{DMat3, DVec3};

/// Damping, as a share of the diagonal.
const DAMPING: f64 = 1e-7;

/// Parts of a step at least and at most.
const LEAST: f64 = 0.2;
const MOST: f64 = 2.0;

/// How a residual changes with one variable: with its turn and with its shift.
#[derive(Clone, Copy, Debug)]
pub(super) struct Part<T> {
    pub(super) variable: usize,
    pub(super) turn: T,
    pub(super) shift: T,
}

/// Matrix, gradient and energy, summed up row by row; pattern and analysis are made once.
#[derive(Debug)]
pub(super) struct System {
    /// Place of each variable in the order of elimination.
    places: Vec<u32>,
    /// Blocks on and below the diagonal: first of each column, and the place of its row.
    starts: Vec<usize>,
    rows: Vec<u32>,
    /// First value of each block column.
    columns: Vec<usize>,
    values: Vec<f64>,
    damped: Vec<f64>,
    gradient: Vec<f64>,
    step: Vec<f64>,
    /// The step before.
    last: Vec<f64>,
    pub(super) energy: f64,
    cholesky: RepeatedCholesky,
}

impl System {
    /// For so many variables, of which the groups share rows.
    ///
    /// # Errors
    /// More unknowns than can be counted.
    pub(super) fn new(variables: usize, groups: &[Vec<u32>]) -> Result<Self, NotPositive> {
        let order = elimination_order(variables, groups.iter().map(Vec::as_slice));
        let mut places = vec![0; variables];
        order.iter().zip(0..).for_each(|(&v, place)| places[v as usize] = place);
        let mut below: Vec<Vec<u32>> = (0..variables as u32).map(|k| vec![k]).collect();
        for group in groups {
            for (i, &a) in group.iter().enumerate() {
                for &b in &group[..i] {
                    let (a, b) = (places[a as usize], places[b as usize]);
                    below[a.min(b) as usize].push(a.max(b));
                }
            }
        }
        let (mut starts, mut rows, mut columns) = (vec![0], Vec::new(), vec![0]);
        let (mut scalar_starts, mut scalar_rows) = (vec![0_u32], Vec::new());
        for column in &mut below {
            column.sort_unstable();
            column.dedup();
            for c in 0..6 {
                scalar_rows.extend((c..6).map(|r| 6 * column[0] + r));
                scalar_rows.extend(column[1..].iter().flat_map(|&row| (0..6).map(move |r| 6 * row + r)));
                scalar_starts.push(scalar_rows.len() as u32);
            }
            rows.extend_from_slice(column);
            starts.push(rows.len());
            columns.push(scalar_rows.len());
        }
        let count = scalar_rows.len();
        Ok(Self {
            places,
            starts,
            rows,
            columns,
            values: vec![0.0; count],
            damped: vec![0.0; count],
            gradient: vec![0.0; 6 * variables],
            step: vec![0.0; 6 * variables],
            last: vec![0.0; 6 * variables],
            energy: 0.0,
            cholesky: RepeatedCholesky::analyse(scalar_starts, scalar_rows, 1)?,
        })
    }

    /// Forgets all rows.
    pub(super) fn clear(&mut self) {
        self.values.fill(0.0);
        self.gradient.fill(0.0);
        self.energy = 0.0;
    }

    /// Adds three rows: a residual vector, and how it changes.
    pub(super) fn add(&mut self, weight: f64, residual: DVec3, parts: &[Part<DMat3>]) {
        self.energy += weight * residual.length_squared();
        for (i, p) in parts.iter().enumerate() {
            let (turn, shift) = (p.turn.transpose(), p.shift.transpose());
            self.add_gradient(p.variable, turn * residual * weight, shift * residual * weight);
            for q in &parts[..=i] {
                self.add_block(
                    p.variable,
                    q.variable,
                    weight,
                    [[turn * q.turn, turn * q.shift], [shift * q.turn, shift * q.shift]],
                );
            }
        }
    }

    /// Adds three rows that depend on turns alone.
    pub(super) fn add_turns(&mut self, weight: f64, residual: DVec3, parts: &[(usize, DMat3)]) {
        self.energy += weight * residual.length_squared();
        for (i, (v, turn)) in parts.iter().enumerate() {
            let turn = turn.transpose();
            self.add_gradient(*v, turn * residual * weight, DVec3::ZERO);
            for (w, other) in &parts[..=i] {
                self.add_block(*v, *w, weight, [[turn * *other, DMat3::ZERO], [DMat3::ZERO; 2]]);
            }
        }
    }

    /// Adds one row.
    pub(super) fn add_scalar(&mut self, weight: f64, residual: f64, parts: &[Part<DVec3>]) {
        self.energy += weight * residual * residual;
        for (i, p) in parts.iter().enumerate() {
            self.add_gradient(p.variable, p.turn * (residual * weight), p.shift * (residual * weight));
            for q in &parts[..=i] {
                let block = [[outer(p.turn, q.turn), outer(p.turn, q.shift)], [outer(p.shift, q.turn), outer(p.shift, q.shift)]];
                self.add_block(p.variable, q.variable, weight, block);
            }
        }
    }

    fn add_gradient(&mut self, variable: usize, turn: DVec3, shift: DVec3) {
        let at = 6 * self.places[variable] as usize;
        for k in 0..3 {
            self.gradient[at + k] += turn[k];
            self.gradient[at + 3 + k] += shift[k];
        }
    }

    /// Adds the block of rows of `v` and columns of `w`, and, off the diagonal, its mirror image.
    fn add_block(&mut self, v: usize, w: usize, weight: f64, blocks: [[DMat3; 2]; 2]) {
        let (p, q) = (self.places[v], self.places[w]);
        let (row, column) = (p.max(q), p.min(q) as usize);
        let own = &self.rows[self.starts[column]..self.starts[column + 1]];
        // Every pair of a row is in the pattern.
        let Ok(block) = own.binary_search(&row) else { return };
        let length = 6 * own.len();
        let entry = |r: usize, c: usize| weight * blocks[r / 3][c / 3].col(c % 3)[r % 3];
        for c in 0..6 {
            // Each column of the triangle is one shorter than the one before.
            let start = self.columns[column] + c * length - c * c.saturating_sub(1) / 2;
            let values = &mut self.values[start + 6 * block - if block == 0 { 0 } else { c }..];
            if block == 0 {
                for r in c..6 {
                    values[r - c] += entry(r, c);
                }
            } else if p > q {
                for (r, value) in values[..6].iter_mut().enumerate() {
                    *value += entry(r, c);
                }
            } else {
                for (r, value) in values[..6].iter_mut().enumerate() {
                    *value += entry(c, r);
                }
            }
        }
    }

    /// Solves for the step; turn and shift of a variable by [`Self::step`].
    ///
    /// # Errors
    /// Rows that are not finite.
    pub(super) fn solve(&mut self) -> Result<(), NotPositive> {
        self.damped.copy_from_slice(&self.values);
        let size = self.places.len();
        let diagonal = |k: usize, c: usize| {
            let length = 6 * (self.starts[k + 1] - self.starts[k]);
            self.columns[k] + c * length - c * c.saturating_sub(1) / 2
        };
        let all = || (0..size).flat_map(|k| (0..6).map(move |c| (k, c)));
        let largest = all().map(|(k, c)| self.values[diagonal(k, c)]).fold(f64::MIN_POSITIVE, f64::max);
        for (k, c) in all() {
            let at = diagonal(k, c);
            self.damped[at] += DAMPING * self.values[at].max(1e-6 * largest);
        }
        self.cholesky.factor(&self.damped)?;
        std::mem::swap(&mut self.step, &mut self.last);
        self.step.iter_mut().zip(&self.gradient).for_each(|(s, g)| *s = -g);
        self.cholesky.solve(&mut self.step);
        if self.step.iter().all(|x| x.is_finite()) { Ok(()) } else { Err(NotPositive) }
    }

    /// The part of the step that ends where steps seem to lead to; `share`: the part of the one before that was taken. Less than all where they go to and fro,
    /// more where they creep (Aitken's relaxation of a vector; Irons, Tuck 1969).
    pub(super) fn relaxation(&self, share: f64) -> f64 {
        let change = || self.step.iter().zip(&self.last).map(|(s, l)| s - l);
        let along: f64 = change().zip(&self.last).map(|(d, l)| d * l).sum();
        let square: f64 = change().map(|d| d * d).sum();
        let share = -share * along / square;
        if share.is_finite() { share.clamp(LEAST, MOST) } else { 1.0 }
    }

    /// Turn and shift of a variable.
    pub(super) fn step(&self, variable: usize) -> (DVec3, DVec3) {
        let at = 6 * self.places[variable] as usize;
        let s = &self.step[at..at + 6];
        (DVec3::new(s[0], s[1], s[2]), DVec3::new(s[3], s[4], s[5]))
    }

    /// Entries of the factor.
    pub(super) fn entries(&self) -> usize {
        self.cholesky.entries()
    }
}

fn outer(a: DVec3, b: DVec3) -> DMat3 {
    DMat3::from_cols(a * b.x, a * b.y, a * b.z)
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    #[test]
    fn steps_that_creep_are_lengthened_and_those_that_go_to_and_fro_shortened() {
        let mut system = System::new(2, &[vec![0, 1]]).unwrap();
        // Every step is this much of the one before, if that is taken in full.
        for (follows, expected) in
            [(0.0, 1.0), (0.4, 1.0 / 0.6), (0.9, MOST), (-0.5, 1.0 / 1.5), (-1.2, 1.0 / 2.2), (-9.0, LEAST)]
        {
            for taken in [1.0, 0.7] {
                system.last = (0..12).map(|k| (k as f64).cos()).collect();
                system.step = system.last.iter().map(|s| s * (1.0 - taken * (1.0 - follows))).collect();
                let share = system.relaxation(taken);
                assert!((share - expected).abs() < 1e-9, "{follows}: {share}");
            }
        }
    }

    #[test]
    fn a_step_solves_the_normal_equations_of_the_rows() {
        let x = |k: usize| ((k * k + 3 * k) as f64 * 0.37).sin();
        let matrix = |k: usize| DMat3::from_cols_array(&std::array::from_fn(|i| x(9 * k + i)));
        let vector = |k: usize| DVec3::from_array(std::array::from_fn(|i| x(100 + 3 * k + i)));
        let groups = [vec![0, 2], vec![2, 1], vec![3, 0], vec![1, 3]];
        let mut system = System::new(4, &groups).unwrap();
        let mut rows: Vec<([f64; 24], f64)> = Vec::new();
        for (g, group) in groups.iter().enumerate() {
            for k in 0..3 {
                let parts: Vec<Part<DMat3>> = group
                    .iter()
                    .enumerate()
                    .map(|(i, &v)| Part {
                        variable: v as usize,
                        turn: matrix(20 * g + 4 * k + i),
                        shift: matrix(20 * g + 4 * k + i + 2),
                    })
                    .collect();
                let residual = vector(7 * g + k);
                system.add(2.0, residual, &parts);
                for r in 0..3 {
                    let mut row = [0.0; 24];
                    for p in &parts {
                        for c in 0..3 {
                            row[6 * p.variable + c] = p.turn.col(c)[r] * 2.0_f64.sqrt();
                            row[6 * p.variable + 3 + c] = p.shift.col(c)[r] * 2.0_f64.sqrt();
                        }
                    }
                    rows.push((row, residual[r] * 2.0_f64.sqrt()));
                }
            }
            let parts: Vec<Part<DVec3>> = group
                .iter()
                .map(|&v| Part { variable: v as usize, turn: vector(g + v as usize), shift: vector(g + 40) })
                .collect();
            system.add_scalar(1.0, x(g), &parts);
            let mut row = [0.0; 24];
            for p in &parts {
                for c in 0..3 {
                    row[6 * p.variable + c] = p.turn[c];
                    row[6 * p.variable + 3 + c] = p.shift[c];
                }
            }
            rows.push((row, x(g)));
        }
        system.solve().unwrap();
        let step: Vec<f64> = (0..4)
            .flat_map(|v| {
                let (turn, shift) = system.step(v);
                [turn.to_array(), shift.to_array()].concat()
            })
            .collect();
        // The gradient of the quadratic model vanishes there, but for the damping.
        for c in 0..24 {
            let gradient: f64 =
                rows.iter().map(|(row, r)| row[c] * (r + row.iter().zip(&step).map(|(a, s)| a * s).sum::<f64>())).sum();
            let size: f64 = rows.iter().map(|(row, _)| row[c] * row[c]).sum();
            assert!(gradient.abs() < 1e-5 * size.max(1.0), "{c}: {gradient}");
        }
        let energy: f64 = rows.iter().map(|(_, r)| r * r).sum();
        assert!((system.energy - energy).abs() < 1e-12 * energy);
    }
}
