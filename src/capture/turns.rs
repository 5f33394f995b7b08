//! Turns about coordinate axes.

use glam::DQuat;
use std::f64::consts::PI;

/// Coefficients of the sine's polynomial from x³ on, and of the cosine's from x⁴ on, for half a right angle to both sides.
#[allow(clippy::excessive_precision)]
const SIN: [f64; 6] = [
    -1.66666666666666324348e-01,
    8.33333333332248946124e-03,
    -1.98412698298579493134e-04,
    2.75573137070700676789e-06,
    -2.50507602534068634195e-08,
    1.58969099521155010221e-10,
];
#[allow(clippy::excessive_precision)]
const COS: [f64; 6] = [
    4.16666666666666019037e-02,
    -1.38888888888741095749e-03,
    2.48015872894767294178e-05,
    -2.75573143513906633035e-07,
    2.08757232129817482790e-09,
    -1.13596475577881948265e-11,
];

/// Sine and cosine of an angle in degrees, to the last bit or the next to it.
///
/// Whole quarter turns are taken off in degrees, without rounding, so that 90° is 90°; the polynomials are those of Sun's fdlibm.
/// Only additions and multiplications: the same bits on every machine, which the system's own functions do not promise.
pub(super) fn sin_cos(degrees: f64) -> (f64, f64) {
    // Adding and subtracting 1.5·2⁵² rounds to the nearest integer.
    const ROUND: f64 = 6_755_399_441_055_744.0;
    let degrees = if degrees.abs() < 1e12 { degrees } else { degrees % 360.0 };
    let shifted = degrees * (1.0 / 90.0) + ROUND;
    let quarters = shifted - ROUND;
    let x = (degrees - quarters * 90.0) * (PI / 180.0);
    let z = x * x;
    let tail = SIN[1] + z * (SIN[2] + z * (SIN[3] + z * (SIN[4] + z * SIN[5])));
    let sin = x + x * z * (SIN[0] + z * tail);
    let tail = COS[0] + z * (COS[1] + z * (COS[2] + z * (COS[3] + z * (COS[4] + z * COS[5]))));
    let (half, most) = (0.5 * z, 1.0 - 0.5 * z);
    let cos = most + (((1.0 - most) - half) + z * z * tail);
    // The low bits of the shifted number are those of the integer.
    match shifted.to_bits() & 3 {
        0 => (sin, cos),
        1 => (cos, -sin),
        2 => (-sin, -cos),
        _ => (-cos, sin),
    }
}

/// A turn about the x (0), y (1) or z (2) axis by an angle in degrees.
pub(super) fn about(axis: usize, degrees: f64) -> DQuat {
    let (sin, cos) = sin_cos(0.5 * degrees);
    match axis {
        0 => DQuat::from_xyzw(sin, 0.0, 0.0, cos),
        1 => DQuat::from_xyzw(0.0, sin, 0.0, cos),
        _ => DQuat::from_xyzw(0.0, 0.0, sin, cos),
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use glam::DVec3;

    #[test]
    fn sines_and_cosines_are_right_to_the_last_bits() {
        for k in -40_000..40_000 {
            let degrees = f64::from(k) * 0.0317;
            let (sin, cos) = sin_cos(degrees);
            // The reference loses digits when it brings whole turns to radians, so they are taken off first.
            let (s, c) = (degrees % 360.0).to_radians().sin_cos();
            assert!((sin - s).abs() < 1e-15 && (cos - c).abs() < 1e-15, "{degrees}: {sin} {s} {cos} {c}");
            assert!((sin * sin + cos * cos - 1.0).abs() < 4e-16);
        }
        assert_eq!([0.0, 90.0, 180.0, 270.0, -90.0].map(|d| sin_cos(d).0), [0.0, 1.0, 0.0, -1.0, -1.0]);
        assert!((sin_cos(3.6e15 + 90.0).0 - 1.0).abs() < 1e-15);
        assert!(sin_cos(f64::NAN).0.is_nan() && sin_cos(f64::INFINITY).0.is_nan());
    }

    #[test]
    fn turns_follow_the_right_hand() {
        for (axis, from, to) in [(0, DVec3::Y, DVec3::Z), (1, DVec3::Z, DVec3::X), (2, DVec3::X, DVec3::Y)] {
            assert!((about(axis, 90.0) * from).distance(to) < 1e-15);
        }
    }
}
