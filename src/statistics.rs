//! Middles and shares of numbers. Imports nobody.

/// The middle value, of an even number the upper of the two in the middle; `None` of none. Reorders them.
pub(crate) fn middle(values: &mut [f64]) -> Option<f64> {
    let at = values.len() / 2;
    (!values.is_empty()).then(|| *values.select_nth_unstable_by(at, f64::total_cmp).1)
}

/// The value below which a share `q` of the values lies, between two of them where it falls there; sorts them.
pub(crate) fn quantile(values: &mut [f64], q: f64) -> Option<f64> {
    values.sort_by(f64::total_cmp);
    let last = values.len().checked_sub(1)?;
    let x = q * last as f64;
    let (low, part) = (x.floor() as usize, x.fract());
    Some(values[low] + (values[(low + 1).min(last)] - values[low]) * part)
}

/// A histogram with bins of 1 %, for medians over a take of any length in constant memory.
#[derive(Clone, Debug)]
pub struct Spread {
    bins: Vec<u64>,
    total: u64,
}

impl Default for Spread {
    fn default() -> Self {
        Self { bins: vec![0; 3000], total: 0 }
    }
}

impl Spread {
    const LOWEST: f64 = 1e-6;
    const RATIO: f64 = 1.01;

    /// Adds a value; values below 1e-6 count as 1e-6.
    pub fn add(&mut self, value: f64) {
        let bin = (value.max(Self::LOWEST) / Self::LOWEST).ln() / Self::RATIO.ln();
        let last = self.bins.len() - 1;
        self.bins[(bin as usize).min(last)] += 1;
        self.total += 1;
    }

    /// The value below which the share `q` of all values lies, within 1 %; 0 when empty.
    pub fn quantile(&self, q: f64) -> f64 {
        let wanted = (q * self.total as f64).ceil().max(1.0) as u64;
        let mut seen = 0;
        for (bin, &n) in self.bins.iter().enumerate() {
            seen += n;
            if seen >= wanted && self.total > 0 {
                return Self::LOWEST * Self::RATIO.powf(bin as f64 + 0.5);
            }
        }
        0.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_middle_of_an_even_number_is_the_upper_one_and_a_quantile_lies_between() {
        assert_eq!(middle(&mut [3.0, 1.0, 2.0]), Some(2.0));
        assert_eq!(middle(&mut [4.0, 1.0, 3.0, 2.0]), Some(3.0));
        assert_eq!(middle(&mut []), None);
        assert_eq!(quantile(&mut [4.0, 1.0, 3.0, 2.0], 0.5), Some(2.5));
        assert_eq!(quantile(&mut [4.0, 1.0], 1.0), Some(4.0));
        assert_eq!(quantile(&mut [], 0.5), None);
    }

    #[test]
    fn a_spread_knows_its_median_within_a_percent() {
        let mut spread = Spread::default();
        assert_eq!(spread.quantile(0.5), 0.0);
        for i in 1..=999 {
            spread.add(f64::from(i) * 0.01);
        }
        assert!((spread.quantile(0.5) / 5.0 - 1.0).abs() < 0.012, "{}", spread.quantile(0.5));
        assert!((spread.quantile(1.0) / 9.99 - 1.0).abs() < 0.012);
    }
}
