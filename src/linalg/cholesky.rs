//! Sparse Cholesky factor: computed once by `faer`, then solved for up to four right sides at a time without allocation.

use super::SymmetricMatrix;
use super::lanes::{Lanes, for_each_instruction_set};
use faer::dyn_stack::{MemBuffer, MemStack};
use faer::linalg::cholesky::llt::factor::LltRegularization;
use faer::perm::PermRef;
use faer::sparse::linalg::cholesky::{
    CholeskySymbolicParams, SymbolicCholesky, SymbolicCholeskyRaw, SymmetricOrdering, factorize_symbolic_cholesky,
    supernodal::SupernodalLltRef,
};
use faer::sparse::linalg::{SupernodalThreshold, SymbolicSupernodalParams};
use faer::sparse::{SparseColMatRef, SymbolicSparseColMatRef};
use faer::{Par, Side, Spec};
use std::fmt;

/// The matrix is not positive definite to the precision of a double: something of the body is not held.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct NotPositive;

impl fmt::Display for NotPositive {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("the matrix is not positive definite")
    }
}

/// Where the entries of a factor are, in blocks of columns. `merging`: neighbouring blocks merge that have at most so many columns and such a share of
/// zeros.
pub(super) fn analyse(
    pattern: SymbolicSparseColMatRef<'_, u32>,
    merging: &[(usize, f64)],
) -> Result<SymbolicCholesky<u32>, NotPositive> {
    let size = pattern.ncols();
    let identity: Vec<u32> = (0..size as u32).collect();
    factorize_symbolic_cholesky(
        pattern,
        Side::Lower,
        SymmetricOrdering::Custom(PermRef::new_checked(&identity, &identity, size)),
        CholeskySymbolicParams {
            supernodal_flop_ratio_threshold: SupernodalThreshold::FORCE_SUPERNODAL,
            supernodal_params: SymbolicSupernodalParams { relax: Some(merging) },
            ..Default::default()
        },
    )
    .map_err(|_| NotPositive)
}

/// `A = L Lᵀ` of a sparse symmetric matrix, in the order of its unknowns (see [`super::elimination_order`]).
///
/// Columns with nearly the same rows are kept together as dense blocks: the triangle on the diagonal, with the reciprocals of its diagonal, and below
/// it the rows that the columns share.
#[derive(Debug)]
pub struct Cholesky {
    size: usize,
    blocks: Vec<Block>,
    rows: Vec<u32>,
    values: Vec<f64>,
}

#[derive(Clone, Copy, Debug)]
struct Block {
    /// First of its columns.
    start: usize,
    columns: usize,
    /// Where its shared rows begin in `rows`, and how many there are.
    rows_at: usize,
    rows: usize,
    /// Where its values begin: row by row, `columns` each, the triangle first.
    values_at: usize,
}

/// Neighbouring blocks merge when they have at most this many columns and this share of zeros: loops over few columns cost more than zeros.
const MERGING: [(usize, f64); 3] = [(4, 0.7), (16, 0.35), (40, 0.12)];

impl Cholesky {
    /// Factors `matrix`.
    ///
    /// # Errors
    /// [`NotPositive`] when a pivot is not positive.
    pub fn factor(matrix: &SymmetricMatrix) -> Result<Self, NotPositive> {
        let size = matrix.size();
        if matrix.values.iter().any(|v| !v.is_finite()) {
            return Err(NotPositive);
        }
        let pattern = SymbolicSparseColMatRef::new_checked(size, size, &matrix.starts, None, &matrix.rows);
        let symbolic = analyse(pattern, &MERGING)?;
        let mut values = vec![0.0; symbolic.len_val()];
        let mut memory = MemBuffer::new(symbolic.factorize_numeric_llt_scratch::<f64>(Par::Seq, Spec::default()));
        symbolic
            .factorize_numeric_llt(
                &mut values,
                SparseColMatRef::new(pattern, &matrix.values),
                Side::Lower,
                LltRegularization::default(),
                Par::Seq,
                MemStack::new(&mut memory),
                Spec::default(),
            )
            .map_err(|_| NotPositive)?;
        let SymbolicCholeskyRaw::Supernodal(structure) = symbolic.raw() else {
            unreachable!("the supernodal kind was demanded");
        };
        Ok(Self::from_supernodes(size, SupernodalLltRef::new(structure, &values)))
    }

    fn from_supernodes(size: usize, factor: SupernodalLltRef<'_, u32, f64>) -> Self {
        let mut result = Self { size, blocks: Vec::new(), rows: Vec::new(), values: Vec::new() };
        for s in 0..factor.symbolic().n_supernodes() {
            let supernode = factor.supernode(s);
            let (matrix, pattern) = (supernode.val(), supernode.pattern());
            let columns = matrix.ncols();
            result.blocks.push(Block {
                start: supernode.start(),
                columns,
                rows_at: result.rows.len(),
                rows: pattern.len(),
                values_at: result.values.len(),
            });
            result.rows.extend_from_slice(pattern);
            for r in 0..columns + pattern.len() {
                for c in 0..columns {
                    result.values.push(match r.cmp(&c) {
                        std::cmp::Ordering::Less => 0.0,
                        std::cmp::Ordering::Equal => 1.0 / matrix[(r, c)],
                        std::cmp::Ordering::Greater => matrix[(r, c)],
                    });
                }
            }
        }
        result
    }

    /// Number of unknowns.
    pub fn size(&self) -> usize {
        self.size
    }

    /// Number of entries kept, padding included.
    pub fn entries(&self) -> usize {
        self.values.len()
    }

    /// Replaces four right sides, one per lane, by their solutions.
    pub fn solve(&self, x: &mut [Lanes]) {
        assert_eq!(x.len(), self.size, "one entry per unknown");
        solve(&self.blocks, &self.rows, &self.values, x);
    }
}

for_each_instruction_set! {
    fn solve(blocks: &[Block], rows: &[u32], values: &[f64], x: &mut [Lanes]) {
        for block in blocks {
            let (triangle, below, shared) = parts(block, rows, values);
            // Shared rows come after the block's own columns.
            let (head, tail) = x.split_at_mut(block.start + block.columns);
            let own = &mut head[block.start..];
            forward(triangle, below, shared, own, tail, block.start + block.columns);
        }
        for block in blocks.iter().rev() {
            let (triangle, below, shared) = parts(block, rows, values);
            let (head, tail) = x.split_at_mut(block.start + block.columns);
            let own = &mut head[block.start..];
            backward(triangle, below, shared, own, tail, block.start + block.columns);
        }
    }
}

#[inline(always)]
fn parts<'a>(block: &Block, rows: &'a [u32], values: &'a [f64]) -> (&'a [f64], &'a [f64], &'a [u32]) {
    let values = &values[block.values_at..][..block.columns * (block.columns + block.rows)];
    let (triangle, below) = values.split_at(block.columns * block.columns);
    (triangle, below, &rows[block.rows_at..][..block.rows])
}

#[inline(always)]
fn forward(triangle: &[f64], below: &[f64], shared: &[u32], own: &mut [Lanes], tail: &mut [Lanes], shift: usize) {
    let n = own.len();
    for r in 0..n {
        let row = &triangle[r * n..r * n + r + 1];
        let mut sum = own[r];
        for (l, y) in row[..r].iter().zip(own.iter()) {
            sum -= *y * *l;
        }
        own[r] = sum * row[r];
    }
    let mut lines = below.chunks_exact(2 * n);
    let mut pairs = shared.chunks_exact(2);
    for (line, pair) in (&mut lines).zip(&mut pairs) {
        let (upper, lower) = line.split_at(n);
        let (i, j) = (pair[0] as usize - shift, pair[1] as usize - shift);
        let (mut a, mut b) = (tail[i], tail[j]);
        for ((l, m), y) in upper.iter().zip(lower).zip(own.iter()) {
            a -= *y * *l;
            b -= *y * *m;
        }
        tail[i] = a;
        tail[j] = b;
    }
    if let [i] = pairs.remainder() {
        let i = *i as usize - shift;
        let mut a = tail[i];
        for (l, y) in lines.remainder().iter().zip(own.iter()) {
            a -= *y * *l;
        }
        tail[i] = a;
    }
}

#[inline(always)]
fn backward(triangle: &[f64], below: &[f64], shared: &[u32], own: &mut [Lanes], tail: &[Lanes], shift: usize) {
    let n = own.len();
    let mut c = 0;
    while c + 4 <= n {
        let mut sums = [own[c], own[c + 1], own[c + 2], own[c + 3]];
        for (line, &i) in below.chunks_exact(n).zip(shared) {
            let y = tail[i as usize - shift];
            for (sum, l) in sums.iter_mut().zip(&line[c..c + 4]) {
                *sum -= y * *l;
            }
        }
        own[c..c + 4].copy_from_slice(&sums);
        c += 4;
    }
    for c in c..n {
        let mut sum = own[c];
        for (line, &i) in below.chunks_exact(n).zip(shared) {
            sum -= tail[i as usize - shift] * line[c];
        }
        own[c] = sum;
    }
    for r in (0..n).rev() {
        let solved = own[r] * triangle[r * n + r];
        own[r] = solved;
        for (c, l) in triangle[r * n..r * n + r].iter().enumerate() {
            own[c] -= solved * *l;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::linalg::elimination_order;

    /// Laplacian of a grid plus a little of the identity, in an order that keeps the factor sparse.
    fn grid(side: u32, shift: f64) -> SymmetricMatrix {
        ordered_grid(side, shift, true)
    }

    fn ordered_grid(side: u32, shift: f64, sparse: bool) -> SymmetricMatrix {
        let id = |x: u32, y: u32, z: u32| (z * side + y) * side + x;
        let mut pairs = Vec::new();
        for (z, y, x) in (0..side).flat_map(|z| (0..side).flat_map(move |y| (0..side).map(move |x| (z, y, x)))) {
            pairs.extend((x + 1 < side).then(|| [id(x, y, z), id(x + 1, y, z)]));
            pairs.extend((y + 1 < side).then(|| [id(x, y, z), id(x, y + 1, z)]));
            pairs.extend((z + 1 < side).then(|| [id(x, y, z), id(x, y, z + 1)]));
        }
        let mut order: Vec<u32> = (0..side.pow(3)).collect();
        if sparse {
            order = elimination_order(order.len(), pairs.iter().map(|p| p.as_slice()));
        }
        let mut place = vec![0; order.len()];
        for (new, &old) in order.iter().enumerate() {
            place[old as usize] = new as u32;
        }
        let mut entries: Vec<(u32, u32, f64)> = (0..order.len() as u32).map(|i| (i, i, shift)).collect();
        for [a, b] in pairs {
            let (a, b) = (place[a as usize], place[b as usize]);
            entries.extend([(a, a, 1.0), (b, b, 1.0), (a, b, -1.0)]);
        }
        SymmetricMatrix::assemble(order.len(), &entries)
    }

    #[test]
    fn the_solution_satisfies_the_equations() {
        for side in [1, 2, 3, 5, 9] {
            let matrix = grid(side, 0.1);
            let factor = Cholesky::factor(&matrix).expect("positive definite");
            let right: Vec<Lanes> =
                (0..matrix.size()).map(|i| Lanes(std::array::from_fn(|k| ((i * 7 + k * 3) % 11) as f64 - 5.0))).collect();
            let mut x = right.clone();
            factor.solve(&mut x);
            let mut product = vec![Lanes::ZERO; x.len()];
            for (i, j, v) in matrix.entries() {
                product[i] += x[j] * v;
                if i != j {
                    product[j] += x[i] * v;
                }
            }
            for (p, r) in product.iter().zip(&right) {
                assert!((*p - *r).0.iter().all(|e| e.abs() < 1e-12), "side {side}: {p:?} for {r:?}");
            }
        }
    }

    #[test]
    fn an_indefinite_matrix_is_refused() {
        assert_eq!(Cholesky::factor(&grid(3, -0.5)).err(), Some(NotPositive));
        let broken = SymmetricMatrix::assemble(2, &[(0, 0, 1.0), (1, 1, f64::NAN)]);
        assert_eq!(Cholesky::factor(&broken).err(), Some(NotPositive));
    }

    #[test]
    fn the_order_saves_entries() {
        let entries = |sparse| Cholesky::factor(&ordered_grid(14, 0.1, sparse)).expect("positive definite").entries();
        let (sparse, natural) = (entries(true), entries(false));
        assert!(sparse * 2 < natural, "{sparse} against {natural}");
    }
}
