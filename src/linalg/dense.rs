//! Cholesky factor of a small dense matrix, refilled and refactored in place.

use super::lanes::for_each_instruction_set;

/// `A = L Lᵀ` of a dense symmetric matrix; memory is kept from one factorization to the next.
#[derive(Clone, Debug, Default)]
pub struct DenseCholesky {
    size: usize,
    /// By columns; only entries on and below the diagonal count.
    values: Vec<f64>,
}

impl DenseCholesky {
    /// Room for matrices up to `size`; holds no factor yet.
    pub fn with_capacity(size: usize) -> Self {
        Self { size: 0, values: Vec::with_capacity(size * size) }
    }

    /// Starts a matrix of zeros and lends it, by columns: entry (i, j) at `j · size + i`. Fill at least the lower triangle, then call [`Self::factor`].
    pub fn refill(&mut self, size: usize) -> &mut [f64] {
        self.size = size;
        self.values.clear();
        self.values.resize(size * size, 0.0);
        &mut self.values
    }

    /// Number of rows and columns.
    pub fn size(&self) -> usize {
        self.size
    }

    /// Replaces the matrix by its factor; `false` where it is not positive definite (the content is then of no use).
    #[must_use]
    pub fn factor(&mut self) -> bool {
        factor(self.size, &mut self.values)
    }

    /// Replaces a right side by its solution.
    pub fn solve(&self, x: &mut [f64]) {
        assert_eq!(x.len(), self.size, "one entry per unknown");
        solve(self.size, &self.values, x);
    }

    /// Solves `L x = b` only.
    pub fn solve_lower(&self, x: &mut [f64]) {
        assert_eq!(x.len(), self.size, "one entry per unknown");
        for j in 0..self.size {
            let column = &self.values[j * self.size..][j..self.size];
            let solved = x[j] / column[0];
            x[j] = solved;
            for (x, l) in x[j + 1..].iter_mut().zip(&column[1..]) {
                *x -= solved * l;
            }
        }
    }
}

for_each_instruction_set! {
    fn factor(n: usize, a: &mut [f64]) -> bool {
        for j in 0..n {
            let (done, rest) = a.split_at_mut(j * n);
            let column = &mut rest[j..n];
            // Four earlier columns at a time: one load and store of the column for four updates.
            let mut k = 0;
            while k + 4 <= j {
                let at = |k: usize| &done[k * n + j..(k + 1) * n];
                let (c0, c1, c2, c3) = (at(k), at(k + 1), at(k + 2), at(k + 3));
                let (l0, l1, l2, l3) = (c0[0], c1[0], c2[0], c3[0]);
                for ((((x, a), b), c), d) in column.iter_mut().zip(c0).zip(c1).zip(c2).zip(c3) {
                    *x = *x - l0 * a - l1 * b - l2 * c - l3 * d;
                }
                k += 4;
            }
            for k in k..j {
                let earlier = &done[k * n + j..(k + 1) * n];
                let l = earlier[0];
                for (x, a) in column.iter_mut().zip(earlier) {
                    *x -= l * a;
                }
            }
            let pivot = column[0];
            if !(pivot > 0.0 && pivot.is_finite()) {
                return false;
            }
            let root = pivot.sqrt();
            column[0] = root;
            let inverse = 1.0 / root;
            for x in &mut column[1..] {
                *x *= inverse;
            }
        }
        true
    }
}

for_each_instruction_set! {
    fn solve(n: usize, a: &[f64], x: &mut [f64]) {
        for j in 0..n {
            let column = &a[j * n + j..(j + 1) * n];
            let solved = x[j] / column[0];
            x[j] = solved;
            for (x, l) in x[j + 1..].iter_mut().zip(&column[1..]) {
                *x -= solved * l;
            }
        }
        for j in (0..n).rev() {
            let column = &a[j * n + j..(j + 1) * n];
            let (pairs, rest) = column[1..].as_chunks::<4>();
            let (xs, x_rest) = x[j + 1..n].as_chunks::<4>();
            let mut sums = [0.0; 4];
            for (l, y) in pairs.iter().zip(xs) {
                for i in 0..4 {
                    sums[i] += l[i] * y[i];
                }
            }
            let mut sum = (sums[0] + sums[1]) + (sums[2] + sums[3]);
            for (l, y) in rest.iter().zip(x_rest) {
                sum += l * y;
            }
            x[j] = (x[j] - sum) / column[0];
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_known_factor_is_found() {
        let mut dense = DenseCholesky::with_capacity(3);
        dense.refill(3).copy_from_slice(&[4.0, 12.0, -16.0, 0.0, 37.0, -43.0, 0.0, 0.0, 98.0]);
        assert!(dense.factor());
        assert_eq!(dense.values, [2.0, 6.0, -8.0, 0.0, 1.0, 5.0, 0.0, 0.0, 3.0]);
        let mut x = [4.0 + 24.0 - 48.0, 12.0 + 74.0 - 129.0, -16.0 - 86.0 + 294.0];
        dense.solve(&mut x);
        assert_eq!(x, [1.0, 2.0, 3.0]);
        let mut y = [2.0, 8.0, 5.0];
        dense.solve_lower(&mut y);
        assert_eq!(y, [1.0, 2.0, 1.0]);
    }

    #[test]
    fn larger_systems_are_solved() {
        let n = 37;
        let entry = |i: usize, j: usize| if i == j { 30.0 + i as f64 } else { ((i * j) % 7) as f64 / 7.0 };
        let mut dense = DenseCholesky::default();
        let a = dense.refill(n);
        for j in 0..n {
            for i in j..n {
                a[j * n + i] = entry(i.max(j), i.min(j));
            }
        }
        assert!(dense.factor());
        let mut x: Vec<f64> = (0..n).map(|i| (0..n).map(|j| entry(i.max(j), i.min(j)) * j as f64).sum()).collect();
        dense.solve(&mut x);
        assert!(x.iter().enumerate().all(|(i, x)| (x - i as f64).abs() < 1e-12));
    }

    #[test]
    fn indefinite_is_said() {
        let mut dense = DenseCholesky::default();
        dense.refill(2).copy_from_slice(&[1.0, 2.0, 0.0, 1.0]);
        assert!(!dense.factor());
    }
}
