//! Sparse rows, the Cholesky factor, rotations. Imports nobody.

mod cholesky;
mod dense;
pub(crate) mod eigen;
pub(crate) mod lanes;
mod ordering;
pub(crate) mod repeated;
pub(crate) mod rotation;
mod symmetric;

pub use cholesky::{Cholesky, NotPositive};
pub use dense::DenseCholesky;
pub use lanes::{Lanes, use_baseline};
pub use ordering::elimination_order;
pub use rotation::nearest_rotation;
pub use symmetric::SymmetricMatrix;

/// A sparse linear functional over proxy vertices: `Σ values[i] · p[indices[i]]`. Indices ascend and are unique.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SparseRow {
    /// Vertices.
    pub indices: Vec<u32>,
    /// Their coefficients.
    pub values: Vec<f64>,
}

impl SparseRow {
    /// The row applied to points.
    pub fn apply(&self, points: &[glam::DVec3]) -> glam::DVec3 {
        let mut sum = glam::DVec3::ZERO;
        for (&i, &v) in self.indices.iter().zip(&self.values) {
            sum += points[i as usize] * v;
        }
        sum
    }
}
