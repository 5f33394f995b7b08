//! Four doubles side by side, and functions compiled for two instruction sets.
//!
//! Nothing here fuses a multiplication with an addition, so the baseline and the AVX2 version of a function give the same bits.

use std::ops::{Add, AddAssign, Div, Mul, Neg, Sub, SubAssign};
use std::sync::atomic::{AtomicBool, Ordering};

/// Four doubles that are added and multiplied lane by lane: a point with a spare lane, or the same quantity of four tetrahedra.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[repr(C, align(32))]
pub struct Lanes(pub [f64; 4]);

impl Lanes {
    /// Four zeros.
    pub const ZERO: Self = Self([0.0; 4]);

    /// The same value in every lane.
    #[inline(always)]
    pub fn splat(value: f64) -> Self {
        Self([value; 4])
    }

    /// A point; the spare lane is zero.
    #[inline(always)]
    pub fn point(p: glam::DVec3) -> Self {
        Self([p.x, p.y, p.z, 0.0])
    }

    /// The first three lanes.
    #[inline(always)]
    pub fn xyz(self) -> glam::DVec3 {
        glam::DVec3::new(self.0[0], self.0[1], self.0[2])
    }

    /// Cross product of two points; the spare lane is zero.
    #[inline(always)]
    pub fn cross(self, other: Self) -> Self {
        let (a, b) = (self.0, other.0);
        Self([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0], 0.0])
    }

    /// Square root of every lane.
    #[inline(always)]
    pub fn sqrt(self) -> Self {
        Self(self.0.map(f64::sqrt))
    }

    /// Absolute value of every lane.
    #[inline(always)]
    pub fn abs(self) -> Self {
        Self(self.0.map(f64::abs))
    }

    /// Sum of the lanes, in order.
    #[inline(always)]
    pub fn sum(self) -> f64 {
        self.0[0] + self.0[1] + self.0[2] + self.0[3]
    }

    /// Lane by lane: `yes` where the mask holds, else `no`.
    #[inline(always)]
    pub fn select(mask: [bool; 4], yes: Self, no: Self) -> Self {
        Self(std::array::from_fn(|i| if mask[i] { yes.0[i] } else { no.0[i] }))
    }
}

macro_rules! lane_operator {
    ($($operator:ident $function:ident $sign:tt),*) => {$(
        impl $operator for Lanes {
            type Output = Self;
            #[inline(always)]
            fn $function(self, other: Self) -> Self {
                let (a, b) = (self.0, other.0);
                Self([a[0] $sign b[0], a[1] $sign b[1], a[2] $sign b[2], a[3] $sign b[3]])
            }
        }
    )*};
}
lane_operator!(Add add +, Sub sub -, Mul mul *, Div div /);

impl Mul<f64> for Lanes {
    type Output = Self;
    #[inline(always)]
    fn mul(self, factor: f64) -> Self {
        self * Self::splat(factor)
    }
}

impl Neg for Lanes {
    type Output = Self;
    #[inline(always)]
    fn neg(self) -> Self {
        Self(self.0.map(|x| -x))
    }
}

impl AddAssign for Lanes {
    #[inline(always)]
    fn add_assign(&mut self, other: Self) {
        *self = *self + other;
    }
}

impl SubAssign for Lanes {
    #[inline(always)]
    fn sub_assign(&mut self, other: Self) {
        *self = *self - other;
    }
}

/// Rows of four lanes turned into columns.
#[inline(always)]
pub(crate) fn transpose(r: [Lanes; 4]) -> [Lanes; 4] {
    let [Lanes(a), Lanes(b), Lanes(c), Lanes(d)] = r;
    [
        Lanes([a[0], b[0], c[0], d[0]]),
        Lanes([a[1], b[1], c[1], d[1]]),
        Lanes([a[2], b[2], c[2], d[2]]),
        Lanes([a[3], b[3], c[3], d[3]]),
    ]
}

static BASELINE: AtomicBool = AtomicBool::new(false);

/// Runs what is compiled for both as on a processor without AVX2, or again as this one allows. The results are the same bits either way; benches and tests compare.
pub fn use_baseline(only: bool) {
    BASELINE.store(only, Ordering::Relaxed);
}

/// Whether the processor has AVX2 and it is to be used.
pub(crate) fn avx2() -> bool {
    #[cfg(target_arch = "x86_64")]
    return !BASELINE.load(Ordering::Relaxed) && std::arch::is_x86_feature_detected!("avx2");
    #[cfg(not(target_arch = "x86_64"))]
    false
}

/// Defines a function that is compiled for the baseline and for AVX2 and chosen at run time. Everything that it calls has to be inlined.
macro_rules! for_each_instruction_set {
    ($(#[$meta:meta])* $vis:vis fn $name:ident($($arg:ident: $ty:ty),* $(,)?) $(-> $ret:ty)? $body:block) => {
        $(#[$meta])*
        $vis fn $name($($arg: $ty),*) $(-> $ret)? {
            #[inline(always)]
            fn baseline($($arg: $ty),*) $(-> $ret)? $body

            #[cfg(target_arch = "x86_64")]
            #[target_feature(enable = "avx2")]
            fn avx2($($arg: $ty),*) $(-> $ret)? {
                baseline($($arg),*)
            }

            #[cfg(target_arch = "x86_64")]
            if $crate::linalg::lanes::avx2() {
                // SAFETY: the processor was just asked whether it has the only feature that the callee enables.
                return unsafe { avx2($($arg),*) };
            }
            baseline($($arg),*)
        }
    };
}
pub(crate) use for_each_instruction_set;

for_each_instruction_set! {
    /// Scalar product of two lists of points.
    pub(crate) fn dot(a: &[Lanes], b: &[Lanes]) -> f64 {
        let mut sums = [Lanes::ZERO; 4];
        let (a4, a_rest) = a.as_chunks::<4>();
        let (b4, b_rest) = b.as_chunks::<4>();
        for (x, y) in a4.iter().zip(b4) {
            for i in 0..4 {
                sums[i] += x[i] * y[i];
            }
        }
        for (x, y) in a_rest.iter().zip(b_rest) {
            sums[0] += *x * *y;
        }
        ((sums[0] + sums[1]) + (sums[2] + sums[3])).sum()
    }
}

for_each_instruction_set! {
    /// `y += factor · x`.
    pub(crate) fn add_scaled(y: &mut [Lanes], factor: f64, x: &[Lanes]) {
        for (y, x) in y.iter_mut().zip(x) {
            *y += *x * factor;
        }
    }
}

/// Length of the longest of the points (spare lanes are not looked at).
pub(crate) fn longest(points: &[Lanes]) -> f64 {
    let mut most = 0.0_f64;
    for p in points {
        let square = p.0[0] * p.0[0] + p.0[1] * p.0[1] + p.0[2] * p.0[2];
        if square.is_nan() {
            return f64::NAN;
        }
        most = most.max(square);
    }
    most.sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn dot_and_longest_agree_with_plain_sums() {
        let a: Vec<Lanes> = (0..11).map(|i| Lanes([f64::from(i), 1.0, -2.0, 0.0])).collect();
        assert_eq!(dot(&a, &a), (0..11).map(|i| f64::from(i * i) + 5.0).sum::<f64>());
        assert_eq!(longest(&a), 105.0_f64.sqrt());
        assert!(longest(&[Lanes::ZERO, Lanes::splat(f64::NAN), Lanes::splat(1.0)]).is_nan());
    }

    #[test]
    fn cross_is_right_handed() {
        assert_eq!(Lanes([1.0, 0.0, 0.0, 0.0]).cross(Lanes([0.0, 1.0, 0.0, 0.0])), Lanes([0.0, 0.0, 1.0, 0.0]));
    }
}
