//! The small quadratic program of the example weights.

/// Where the weights of examples may lie.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bounds {
    /// Least weight.
    pub least: f64,
    /// Largest weight.
    pub most: f64,
}

impl Bounds {
    /// Anywhere.
    pub const FREE: Self = Self { least: f64::NEG_INFINITY, most: f64::INFINITY };
    /// Somewhat beyond the examples.
    pub const BOX: Self = Self { least: -0.2, most: 1.2 };
    /// Between rest and each example.
    pub const CONVEX: Self = Self { least: 0.0, most: 1.0 };
}

/// Sweeps of coordinate descent.
const SWEEPS: usize = 200;
/// Change of a weight in a sweep that ends them.
const STILL: f64 = 1e-14;

/// Solves the program again and again in the same memory.
#[derive(Clone, Debug, Default)]
pub(super) struct Quadratic {
    members: Vec<usize>,
    factor: Vec<f64>,
    polished: Vec<f64>,
}

impl Quadratic {
    /// Room for `k` weights.
    pub fn with_capacity(k: usize) -> Self {
        Self { members: Vec::with_capacity(k), factor: Vec::with_capacity(k * k), polished: Vec::with_capacity(k) }
    }

    /// The change `d` of weights that minimizes `½ dᵀ S d − rᵀ d` with the changed weights in bounds.
    ///
    /// Shapes: `s`: k × k, symmetric, positive definite; the others: k.
    pub fn least(&mut self, s: &[f64], r: &[f64], bounds: Bounds, weights: &[f64], d: &mut [f64]) {
        let k = r.len();
        let lo = |i: usize| bounds.least - weights[i];
        let hi = |i: usize| bounds.most - weights[i];
        d.copy_from_slice(r);
        self.members.clear();
        self.members.extend(0..k);
        self.solve(s, k, d);
        if (0..k).all(|i| (lo(i)..=hi(i)).contains(&d[i])) {
            return;
        }
        for (i, d) in d.iter_mut().enumerate() {
            *d = if d.is_finite() { *d } else { 0.0 }.clamp(lo(i), hi(i));
        }
        for _ in 0..SWEEPS {
            let mut change = 0.0_f64;
            for i in 0..k {
                let slope: f64 = r[i] - (0..k).map(|j| s[i * k + j] * d[j]).sum::<f64>();
                let moved = (d[i] + slope / s[i * k + i].max(f64::MIN_POSITIVE)).clamp(lo(i), hi(i));
                change = change.max((moved - d[i]).abs());
                d[i] = moved;
            }
            if change < STILL {
                break;
            }
        }
        // Among the weights that are not at a bound the solution is that of the equations.
        let inside = |i: usize| d[i] > lo(i) && d[i] < hi(i);
        self.members.clear();
        self.members.extend((0..k).filter(|i| inside(*i)));
        let mut polished = std::mem::take(&mut self.polished);
        polished.clear();
        polished.extend((0..k).map(|i| {
            if inside(i) { r[i] - (0..k).filter(|j| !inside(*j)).map(|j| s[i * k + j] * d[j]).sum::<f64>() } else { d[i] }
        }));
        self.solve(s, k, &mut polished);
        if (0..k).all(|i| polished[i] >= lo(i) - 1e-12 && polished[i] <= hi(i) + 1e-12) {
            (0..k).for_each(|i| d[i] = polished[i].clamp(lo(i), hi(i)));
        }
        self.polished = polished;
    }

    /// Solves the equations among the members; the other unknowns stay.
    fn solve(&mut self, s: &[f64], k: usize, x: &mut [f64]) {
        let Self { members, factor: l, .. } = self;
        let n = members.len();
        let trace: f64 = members.iter().map(|&i| s[i * k + i]).sum();
        l.clear();
        l.resize(n * n, 0.0);
        for (i, &a) in members.iter().enumerate() {
            for (j, &b) in members.iter().enumerate().take(i + 1) {
                let below: f64 = (0..j).map(|t| l[i * n + t] * l[j * n + t]).sum();
                let left = s[a * k + b] - below;
                l[i * n + j] = if i == j { left.max(1e-14 * trace.max(f64::MIN_POSITIVE)).sqrt() } else { left / l[j * n + j] };
            }
        }
        for i in 0..n {
            let known: f64 = (0..i).map(|j| l[i * n + j] * x[members[j]]).sum();
            x[members[i]] = (x[members[i]] - known) / l[i * n + i];
        }
        for i in (0..n).rev() {
            let known: f64 = (i + 1..n).map(|j| l[j * n + i] * x[members[j]]).sum();
            x[members[i]] = (x[members[i]] - known) / l[i * n + i];
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Positive definite, with strong ties between neighbours.
    const S: [f64; 9] = [2.0, 1.5, 0.1, 1.5, 3.0, -1.0, 0.1, -1.0, 1.0];

    #[test]
    fn without_bounds_the_equations_hold() {
        let r = [1.0, -2.0, 3.0];
        let mut d = [0.0; 3];
        Quadratic::default().least(&S, &r, Bounds::FREE, &[0.0; 3], &mut d);
        for i in 0..3 {
            let left: f64 = (0..3).map(|j| S[3 * i + j] * d[j]).sum();
            assert!((left - r[i]).abs() < 1e-12, "{d:?}");
        }
    }

    #[test]
    fn at_a_bound_the_slope_points_outwards_and_elsewhere_it_is_none() {
        let weights = [0.3, 0.9, 0.5];
        for r in [[1.0, -2.0, 3.0], [-5.0, 0.5, 0.1], [9.0, 9.0, -9.0]] {
            let mut d = [0.0; 3];
            Quadratic::default().least(&S, &r, Bounds::CONVEX, &weights, &mut d);
            let mut at_bounds = 0;
            for i in 0..3 {
                let slope = r[i] - (0..3).map(|j| S[3 * i + j] * d[j]).sum::<f64>();
                let to = weights[i] + d[i];
                assert!((-1e-12..=1.0 + 1e-12).contains(&to), "{d:?}");
                if to < 1e-12 {
                    at_bounds += 1;
                    assert!(slope <= 1e-9, "{r:?} {d:?} {slope}");
                } else if to > 1.0 - 1e-12 {
                    at_bounds += 1;
                    assert!(slope >= -1e-9, "{r:?} {d:?} {slope}");
                } else {
                    assert!(slope.abs() < 1e-9, "{r:?} {d:?} {slope}");
                }
            }
            assert!(at_bounds > 0);
        }
    }
}
