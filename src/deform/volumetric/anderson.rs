//! Anderson acceleration: the combination of the last steps that comes nearest to no step at all.

use crate::linalg::lanes::{Lanes, add_scaled, dot};

/// Steps that are remembered.
pub(super) const WINDOW: usize = 6;

pub(super) struct Anderson {
    /// Differences of consecutive images, and of the steps that led to them; used in turn.
    image_changes: [Vec<Lanes>; WINDOW],
    step_changes: [Vec<Lanes>; WINDOW],
    products: [[f64; WINDOW]; WINDOW],
    count: usize,
    next: usize,
    image: Vec<Lanes>,
    step: Vec<Lanes>,
    has_last: bool,
}

impl Anderson {
    pub(super) fn new(size: usize) -> Self {
        let zeros = || vec![Lanes::ZERO; size];
        Self {
            image_changes: std::array::from_fn(|_| zeros()),
            step_changes: std::array::from_fn(|_| zeros()),
            products: [[0.0; WINDOW]; WINDOW],
            count: 0,
            next: 0,
            image: zeros(),
            step: zeros(),
            has_last: false,
        }
    }

    /// Forgets the changes but not the last step.
    pub(super) fn forget_changes(&mut self) {
        self.count = 0;
        self.next = 0;
    }

    pub(super) fn forget(&mut self) {
        self.forget_changes();
        self.has_last = false;
    }

    /// Remembers a step and the image it leads to.
    pub(super) fn record(&mut self, image: &[Lanes], step: &[Lanes]) {
        if self.has_last {
            let slot = self.next;
            difference(image, &self.image, &mut self.image_changes[slot]);
            difference(step, &self.step, &mut self.step_changes[slot]);
            self.next = (slot + 1) % WINDOW;
            self.count = (self.count + 1).min(WINDOW);
            for i in 0..self.count {
                let product = dot(&self.step_changes[slot], &self.step_changes[i]);
                self.products[slot][i] = product;
                self.products[i][slot] = product;
            }
        }
        self.image.copy_from_slice(image);
        self.step.copy_from_slice(step);
        self.has_last = true;
    }

    /// Writes the accelerated image; `false` when there is nothing to combine.
    pub(super) fn mix(&self, out: &mut [Lanes]) -> bool {
        let Some(factors) = self.factors() else { return false };
        out.copy_from_slice(&self.image);
        for (factor, change) in factors.iter().zip(&self.image_changes).take(self.count) {
            add_scaled(out, -factor, change);
        }
        true
    }

    /// Least squares by normal equations with columns of unit length; a tiny ridge and the pivots tell dependent columns.
    fn factors(&self) -> Option<[f64; WINDOW]> {
        let n = self.count;
        if n == 0 {
            return None;
        }
        let mut scale = [0.0; WINDOW];
        let mut x = [0.0; WINDOW];
        for i in 0..n {
            scale[i] = 1.0 / (self.products[i][i] + 1e-300).sqrt();
            x[i] = dot(&self.step_changes[i], &self.step) * scale[i];
        }
        let mut l = [[0.0; WINDOW]; WINDOW];
        for j in 0..n {
            for i in j..n {
                let ridge = if i == j { 1e-11 } else { 0.0 };
                let done: f64 = (0..j).map(|k| l[i][k] * l[j][k]).sum();
                let rest = self.products[i][j] * scale[i] * scale[j] + ridge - done;
                if i == j {
                    if !(rest > 1e-13) {
                        return None;
                    }
                    l[j][j] = rest.sqrt();
                } else {
                    l[i][j] = rest / l[j][j];
                }
            }
        }
        for i in 0..n {
            let done: f64 = (0..i).map(|k| l[i][k] * x[k]).sum();
            x[i] = (x[i] - done) / l[i][i];
        }
        for i in (0..n).rev() {
            let done: f64 = (i + 1..n).map(|k| l[k][i] * x[k]).sum();
            x[i] = (x[i] - done) / l[i][i];
        }
        for i in 0..n {
            x[i] *= scale[i];
        }
        x.iter().all(|x| x.is_finite()).then_some(x)
    }
}

fn difference(a: &[Lanes], b: &[Lanes], out: &mut [Lanes]) {
    for ((out, a), b) in out.iter_mut().zip(a).zip(b) {
        *out = *a - *b;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_linear_iteration_with_three_rates_ends_after_three_changes() {
        let rates = Lanes([0.5, 0.2, 0.9, 0.0]);
        let mut anderson = Anderson::new(1);
        let mut x = [Lanes::ZERO];
        for _ in 0..4 {
            let step = [rates * (Lanes([1.0, 2.0, 3.0, 0.0]) - x[0])];
            let image = [x[0] + step[0]];
            anderson.record(&image, &step);
            if !anderson.mix(&mut x) {
                x = image;
            }
        }
        let error = (x[0] - Lanes([1.0, 2.0, 3.0, 0.0])).abs();
        assert!(error.0.iter().all(|e| *e < 1e-8), "{x:?}");
    }

    #[test]
    fn nothing_is_mixed_after_forgetting() {
        let mut anderson = Anderson::new(1);
        let mut out = [Lanes::ZERO];
        anderson.record(&[Lanes::splat(1.0)], &[Lanes::splat(1.0)]);
        assert!(!anderson.mix(&mut out));
        anderson.record(&[Lanes::splat(1.5)], &[Lanes::splat(0.5)]);
        assert!(anderson.mix(&mut out));
        anderson.forget_changes();
        assert!(!anderson.mix(&mut out));
    }
}
