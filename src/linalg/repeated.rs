//! Sparse Cholesky factors of matrices that share one pattern: analysed once, factored again and again without allocation.

use super::NotPositive;
use super::cholesky::analyse;
use faer::dyn_stack::{MemBuffer, MemStack};
use faer::linalg::cholesky::llt::factor::LltRegularization;
use faer::sparse::linalg::cholesky::{LltRef, SymbolicCholesky};
use faer::sparse::{SparseColMatRef, SymbolicSparseColMat};
use faer::{Conj, MatMut, Par, Side, Spec};

/// Neighbouring blocks of the factor merge when they have at most this many columns and this share of zeros.
const MERGING: [(usize, f64); 3] = [(4, 0.9), (16, 0.5), (48, 0.15)];

/// `A = L Lᵀ` for the matrices of one pattern, in the order of its unknowns (see [`super::elimination_order`]).
pub struct RepeatedCholesky {
    pattern: SymbolicSparseColMat<u32>,
    symbolic: SymbolicCholesky<u32>,
    values: Vec<f64>,
    memory: MemBuffer,
    sides: usize,
}

impl std::fmt::Debug for RepeatedCholesky {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("RepeatedCholesky")
            .field("size", &self.size())
            .field("entries", &self.values.len())
            .finish_non_exhaustive()
    }
}

impl RepeatedCholesky {
    /// Analyses a pattern: the lower triangle by columns, rows rising, with the whole diagonal. At most `sides` right sides are solved for at a time.
    ///
    /// # Errors
    /// [`NotPositive`] when the factor has too many entries to be counted.
    pub fn analyse(starts: Vec<u32>, rows: Vec<u32>, sides: usize) -> Result<Self, NotPositive> {
        let size = starts.len() - 1;
        let pattern = SymbolicSparseColMat::new_checked(size, size, starts, None, rows);
        let symbolic = analyse(pattern.as_ref(), &MERGING)?;
        let values = vec![0.0; symbolic.len_val()];
        let factoring = symbolic.factorize_numeric_llt_scratch::<f64>(Par::Seq, Spec::default());
        let memory = MemBuffer::new(factoring.or(symbolic.solve_in_place_scratch::<f64>(sides, Par::Seq)));
        Ok(Self { pattern, symbolic, values, memory, sides })
    }

    /// Number of unknowns.
    pub fn size(&self) -> usize {
        self.pattern.ncols()
    }

    /// Number of entries of the factor, padding included.
    pub fn entries(&self) -> usize {
        self.values.len()
    }

    /// Factors the matrix with these values at the places of the pattern.
    ///
    /// # Errors
    /// [`NotPositive`] when a pivot is not positive; there is no factor then.
    pub fn factor(&mut self, values: &[f64]) -> Result<(), NotPositive> {
        if values.iter().any(|v| !v.is_finite()) {
            return Err(NotPositive);
        }
        self.symbolic
            .factorize_numeric_llt(
                &mut self.values,
                SparseColMatRef::new(self.pattern.as_ref(), values),
                Side::Lower,
                LltRegularization::default(),
                Par::Seq,
                MemStack::new(&mut self.memory),
                Spec::default(),
            )
            .map(drop)
            .map_err(|_| NotPositive)
    }

    /// Replaces right sides, one after the other in `x`, by their solutions.
    pub fn solve(&mut self, x: &mut [f64]) {
        let size = self.size();
        let sides = x.len().checked_div(size).unwrap_or(0);
        assert!(x.len() == sides * size && sides <= self.sides, "whole right sides, as many as announced");
        LltRef::new(&self.symbolic, &self.values).solve_in_place_with_conj(
            Conj::No,
            MatMut::from_column_major_slice_mut(x, size, sides),
            Par::Seq,
            MemStack::new(&mut self.memory),
        );
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Tridiagonal, `d` on the diagonal and -1 beside it.
    fn chain(size: u32, d: f64) -> (Vec<u32>, Vec<u32>, Vec<f64>) {
        let (mut starts, mut rows, mut values) = (vec![0], Vec::new(), Vec::new());
        for j in 0..size {
            rows.push(j);
            values.push(d);
            if j + 1 < size {
                rows.push(j + 1);
                values.push(-1.0);
            }
            starts.push(rows.len() as u32);
        }
        (starts, rows, values)
    }

    #[test]
    fn every_matrix_of_the_pattern_is_solved_and_an_indefinite_one_refused() {
        let (starts, rows, _) = chain(9, 0.0);
        let mut cholesky = RepeatedCholesky::analyse(starts, rows, 2).expect("a small pattern");
        for d in [2.0, 3.5] {
            cholesky.factor(&chain(9, d).2).expect("positive definite");
            let right: Vec<f64> = (0..18).map(|i| f64::from(i * 7 % 5) - 2.0).collect();
            let mut x = right.clone();
            cholesky.solve(&mut x);
            for (x, right) in x.chunks(9).zip(right.chunks(9)) {
                for i in 0..9 {
                    let beside = if i > 0 { x[i - 1] } else { 0.0 } + x.get(i + 1).unwrap_or(&0.0);
                    assert!((d * x[i] - beside - right[i]).abs() < 1e-12, "{d} {i}");
                }
            }
        }
        assert_eq!(cholesky.factor(&chain(9, 0.5).2), Err(NotPositive));
        assert_eq!(cholesky.factor(&chain(9, f64::NAN).2), Err(NotPositive));
    }
}
