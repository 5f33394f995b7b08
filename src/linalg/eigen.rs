//! Eigenvalues of symmetric matrices, by cyclic Jacobi rotations (Golub and Van Loan, Matrix Computations, §8.5).

/// What is left off the diagonal, squared and as a share of what is on it, when no digit changes any more.
const NOTHING: f64 = 1e-30;

/// Eigenvalues of a small symmetric matrix, ascending, and the unit eigenvector of each.
pub(crate) fn symmetric<const N: usize>(mut a: [[f64; N]; N]) -> ([f64; N], [[f64; N]; N]) {
    let mut v: [[f64; N]; N] = std::array::from_fn(|i| std::array::from_fn(|j| f64::from(u8::from(i == j))));
    diagonalize(&mut a, &mut v, NOTHING);
    let mut order: [usize; N] = std::array::from_fn(|i| i);
    order.sort_by(|&i, &j| a[i][i].total_cmp(&a[j][j]));
    (order.map(|k| a[k][k]), order.map(|k| std::array::from_fn(|i| v[i][k])))
}

/// The largest eigenvalue of a small symmetric matrix and its unit eigenvector.
pub(crate) fn largest<const N: usize>(a: [[f64; N]; N]) -> (f64, [f64; N]) {
    let (values, vectors) = symmetric(a);
    // Of equal ones the first: a turn by which nothing is told is none.
    let first = values.iter().position(|x| *x == values[N - 1]).unwrap_or(N - 1);
    (values[first], vectors[first])
}

/// Turns `a`, symmetric, until its squares off the diagonal are the share `left` of those on it: the diagonal holds the eigenvalues then.
/// The columns of `v`, at first those of the identity, turn along and are the eigenvectors.
pub(crate) fn diagonalize<R: AsMut<[f64]> + AsRef<[f64]>>(a: &mut [R], v: &mut [R], left: f64) {
    // Convergence is quadratic: a few sweeps, whatever the size.
    const SWEEPS: usize = 60;
    let n = a.len();
    for _ in 0..SWEEPS {
        let at = |i: usize, j: usize| a[i].as_ref()[j];
        let off: f64 = (0..n).flat_map(|i| (0..i).map(move |j| (i, j))).map(|(i, j)| at(i, j) * at(i, j)).sum();
        let on: f64 = (0..n).map(|i| at(i, i) * at(i, i)).sum();
        if !off.is_finite() || off <= left * on || off == 0.0 {
            break;
        }
        for p in 0..n {
            for q in p + 1..n {
                rotate(a, v, p, q);
            }
        }
    }
}

/// The turn in the plane of `p` and `q` that makes their entry 0.
fn rotate<R: AsMut<[f64]> + AsRef<[f64]>>(a: &mut [R], v: &mut [R], p: usize, q: usize) {
    let row = a[p].as_ref();
    let (pivot, on) = (row[q], row[p]);
    if pivot == 0.0 {
        return;
    }
    let theta = (a[q].as_ref()[q] - on) / (2.0 * pivot);
    let t = theta.signum() / (theta.abs() + (theta * theta + 1.0).sqrt());
    let c = 1.0 / (t * t + 1.0).sqrt();
    let s = t * c;
    for row in a.iter_mut().chain(v).map(AsMut::as_mut) {
        (row[p], row[q]) = (c * row[p] - s * row[q], s * row[p] + c * row[q]);
    }
    let (before, after) = a.split_at_mut(q);
    for (x, y) in before[p].as_mut().iter_mut().zip(after[0].as_mut()) {
        (*x, *y) = (c * *x - s * *y, s * *x + c * *y);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn vectors_and_values_fit_the_matrix() {
        let a: [[f64; 6]; 6] = std::array::from_fn(|i| {
            std::array::from_fn(|j| ((i * j) as f64 * 0.7).sin() + ((i + j) as f64).cos() + if i == j { 3.0 } else { 0.0 })
        });
        let (values, vectors) = symmetric(a);
        for (value, x) in values.iter().zip(&vectors) {
            for (row, xi) in a.iter().zip(x) {
                let product: f64 = row.iter().zip(x).map(|(a, x)| a * x).sum();
                assert!((product - value * xi).abs() < 1e-12);
            }
        }
        assert!(values.windows(2).all(|w| w[0] <= w[1]));
        assert_eq!(largest(a), (values[5], vectors[5]));
    }

    #[test]
    fn what_is_no_number_ends() {
        assert!(symmetric([[f64::NAN, 1.0], [1.0, f64::INFINITY]]).0.iter().any(|value| !value.is_finite()));
    }
}
