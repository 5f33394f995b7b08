//! The rotation nearest to a deformation gradient: one warm Newton step for four tetrahedra at a time, and the exact answer by singular values.
//!
//! "Nearest" maximises `tr(Rᵀ F)` over proper rotations. An inverted tetrahedron gives the sign to its smallest singular direction: to turn the
//! whole matrix round instead (Stoll et al. 2007, (2.8)) would throw a slightly inverted tetrahedron 90–180° off.

use super::lanes::Lanes;
use glam::{DMat3, DVec3};

/// Four unit quaternions w, x, y, z, one per lane.
pub(crate) type Quaternions = [Lanes; 4];

/// Four 3×3 matrices by rows, one per lane.
pub(crate) type Matrices = [Lanes; 9];

/// Four times the identity.
pub(crate) const IDENTITY: Quaternions = [Lanes([1.0; 4]), Lanes::ZERO, Lanes::ZERO, Lanes::ZERO];

/// Matrices of unit quaternions.
#[inline(always)]
pub(crate) fn matrices(q: &Quaternions) -> Matrices {
    let [w, x, y, z] = *q;
    let (one, two) = (Lanes::splat(1.0), Lanes::splat(2.0));
    [
        one - two * (y * y + z * z),
        two * (x * y - w * z),
        two * (x * z + w * y),
        two * (x * y + w * z),
        one - two * (x * x + z * z),
        two * (y * z - w * x),
        two * (x * z - w * y),
        two * (y * z + w * x),
        one - two * (x * x + y * y),
    ]
}

/// One step towards the rotations nearest to `f`, from warm estimates; returns the squared angle of the step.
///
/// Newton: with `A = F Rᵀ` the increment is `H⁻¹ axial(A − Aᵀ)`, `H = tr A · I − sym A` (quadratic convergence). Where `H` is not positive definite the
/// step of Müller, Bender, Chentanez, Macklin 2016, axial / |tr A|, which never leads away. The increment is applied as the quaternion
/// (1, w/2), normalized: no trigonometry.
#[inline(always)]
pub(crate) fn newton_step(f: &Matrices, q: &mut Quaternions) -> Lanes {
    let r = matrices(q);
    let product = |i: usize, j: usize| f[3 * i] * r[3 * j] + f[3 * i + 1] * r[3 * j + 1] + f[3 * i + 2] * r[3 * j + 2];
    let (a00, a01, a02) = (product(0, 0), product(0, 1), product(0, 2));
    let (a10, a11, a12) = (product(1, 0), product(1, 1), product(1, 2));
    let (a20, a21, a22) = (product(2, 0), product(2, 1), product(2, 2));
    let axial = [a21 - a12, a02 - a20, a10 - a01];
    let trace = a00 + a11 + a22;
    let half = Lanes::splat(-0.5);
    let (h00, h11, h22) = (trace - a00, trace - a11, trace - a22);
    let (h01, h02, h12) = (half * (a01 + a10), half * (a02 + a20), half * (a12 + a21));
    let (c00, c01, c02) = (h11 * h22 - h12 * h12, h02 * h12 - h01 * h22, h01 * h12 - h11 * h02);
    let (c11, c12, c22) = (h00 * h22 - h02 * h02, h01 * h02 - h00 * h12, h00 * h11 - h01 * h01);
    let determinant = h00 * c00 + h01 * c01 + h02 * c02;
    let size = h00.abs() + h11.abs() + h22.abs();
    let floor = Lanes::splat(1e-6) * size * size * size;
    let positive: [bool; 4] = std::array::from_fn(|i| (h00.0[i] > 0.0) & (c22.0[i] > 0.0) & (determinant.0[i] > floor.0[i]));
    let half_inverse = Lanes::splat(0.5) / Lanes::select(positive, determinant, trace.abs() + Lanes::splat(1e-9));
    let [v0, v1, v2] = axial;
    let w0 = Lanes::select(positive, c00 * v0 + c01 * v1 + c02 * v2, v0) * half_inverse;
    let w1 = Lanes::select(positive, c01 * v0 + c11 * v1 + c12 * v2, v1) * half_inverse;
    let w2 = Lanes::select(positive, c02 * v0 + c12 * v1 + c22 * v2, v2) * half_inverse;
    let [qw, qx, qy, qz] = *q;
    let next = [
        qw - (w0 * qx + w1 * qy + w2 * qz),
        qx + (w0 * qw + w1 * qz - w2 * qy),
        qy + (w1 * qw + w2 * qx - w0 * qz),
        qz + (w2 * qw + w0 * qy - w1 * qx),
    ];
    let norm = (next[0] * next[0] + next[1] * next[1] + next[2] * next[2] + next[3] * next[3]).sqrt();
    let inverse = Lanes::splat(1.0) / norm;
    *q = [next[0] * inverse, next[1] * inverse, next[2] * inverse, next[3] * inverse];
    (w0 * w0 + w1 * w1 + w2 * w2) * 4.0
}

/// Steps after which a lane that still turns is handed to the singular values.
const MOST_STEPS: u32 = 20;

/// The rotations nearest to `f`, to rounding, from warm estimates.
#[inline(always)]
pub(crate) fn extract(f: &Matrices, q: &mut Quaternions) {
    for _ in 1..MOST_STEPS {
        let turned = newton_step(f, q);
        if !(0..4).any(|lane| still_turns(&turned, lane)) {
            return;
        }
    }
    extract_exactly(f, q);
}

#[inline(always)]
fn still_turns(turned: &Lanes, lane: usize) -> bool {
    turned.0[lane].is_nan() | (turned.0[lane] >= 1e-20)
}

/// One more step, and the singular values for the lanes that it still turns.
#[cold]
fn extract_exactly(f: &Matrices, q: &mut Quaternions) {
    let turned = newton_step(f, q);
    for lane in (0..4).filter(|&lane| still_turns(&turned, lane)) {
        let warm = self::lane(q, lane);
        let warm = if warm.is_finite() { DMat3::from_quat(warm) } else { DMat3::IDENTITY };
        let column = |j: usize| DVec3::new(f[j].0[lane], f[3 + j].0[lane], f[6 + j].0[lane]);
        let nearest = nearest_rotation(DMat3::from_cols(column(0), column(1), column(2)), warm);
        set_lane(q, lane, glam::DQuat::from_mat3(&nearest).normalize());
    }
}

/// The quaternion in a lane.
pub(crate) fn lane(q: &Quaternions, lane: usize) -> glam::DQuat {
    glam::DQuat::from_xyzw(q[1].0[lane], q[2].0[lane], q[3].0[lane], q[0].0[lane])
}

/// Puts a quaternion into a lane.
pub(crate) fn set_lane(q: &mut Quaternions, lane: usize, value: glam::DQuat) {
    q[0].0[lane] = value.w;
    q[1].0[lane] = value.x;
    q[2].0[lane] = value.y;
    q[3].0[lane] = value.z;
}

/// The proper rotation nearest to `f`. Where that is not unique (rank below two, or mirrored with equal singular values) the one nearest to `warm`.
pub fn nearest_rotation(f: DMat3, warm: DMat3) -> DMat3 {
    let (singular, rotation) = signed_polar(f);
    if !(singular[0] > 0.0 && singular[0].is_finite()) {
        return warm;
    }
    if singular[1] + singular[2] > 1e-9 * singular[0] {
        return rotation;
    }
    signed_polar(f + warm * (1e-9 * singular[0])).1
}

/// Singular values in descending order, the last with the sign of the determinant, and `U Vᵀ` with that sign taken out of the last direction.
fn signed_polar(f: DMat3) -> ([f64; 3], DMat3) {
    // One-sided Jacobi: turn the columns of F V until they are orthogonal. Precise also for small singular values.
    let mut a = [f.x_axis, f.y_axis, f.z_axis];
    let mut v = [DVec3::X, DVec3::Y, DVec3::Z];
    for _ in 0..30 {
        let mut off = 0.0_f64;
        for (p, q) in [(0, 1), (0, 2), (1, 2)] {
            let (alpha, beta, gamma) = (a[p].length_squared(), a[q].length_squared(), a[p].dot(a[q]));
            if gamma.abs() <= 1e-17 * (alpha * beta).sqrt() || gamma == 0.0 {
                continue;
            }
            off = off.max(gamma.abs() / (alpha * beta).sqrt());
            let zeta = (beta - alpha) / (2.0 * gamma);
            let t = zeta.signum() / (zeta.abs() + (1.0 + zeta * zeta).sqrt());
            let c = 1.0 / (1.0 + t * t).sqrt();
            let s = c * t;
            (a[p], a[q]) = (a[p] * c - a[q] * s, a[p] * s + a[q] * c);
            (v[p], v[q]) = (v[p] * c - v[q] * s, v[p] * s + v[q] * c);
        }
        if off <= 1e-15 {
            break;
        }
    }
    let mut order = [0, 1, 2];
    order.sort_by(|&i, &j| a[j].length_squared().total_cmp(&a[i].length_squared()));
    let [i, j, k] = order;
    let (s0, s1) = (a[i].length(), a[j].length());
    let u0 = if s0 > 0.0 { a[i] / s0 } else { DVec3::X };
    let across = a[j] - u0 * u0.dot(a[j]);
    let u1 = if across.length() > 1e-14 * s0 && s0 > 0.0 { across.normalize() } else { u0.any_orthonormal_vector() };
    let u2 = u0.cross(u1);
    // The third directions complete right-handed frames on both sides, so the product is a proper rotation whatever the determinant.
    let v2 = v[i].cross(v[j]);
    let s2 = u2.dot(a[k]) * v2.dot(v[k]);
    let rotation = DMat3::from_cols(u0, u1, u2) * DMat3::from_cols(v[i], v[j], v2).transpose();
    ([s0, s1, s2], rotation)
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DQuat;
    use proptest::prelude::*;

    fn lanes_of(f: DMat3) -> Matrices {
        std::array::from_fn(|k| Lanes::splat(f.col(k % 3)[k / 3]))
    }

    fn warm(q: DQuat) -> Quaternions {
        [Lanes::splat(q.w), Lanes::splat(q.x), Lanes::splat(q.y), Lanes::splat(q.z)]
    }

    fn matrix_of(q: &Quaternions) -> DMat3 {
        let m = matrices(q).map(|l| l.0[2]);
        DMat3::from_cols_array(&[m[0], m[3], m[6], m[1], m[4], m[7], m[2], m[5], m[8]])
    }

    fn distance(a: DMat3, b: DMat3) -> f64 {
        (a - b).to_cols_array().iter().fold(0.0, |m, x| m.max(x.abs()))
    }

    /// Rotations spread over the group without a random generator.
    fn rotations(count: u32) -> impl Iterator<Item = DMat3> {
        (0..count).map(|i| {
            let t = f64::from(i) * 0.618_033_988_749_895;
            let axis = DVec3::new((t * 5.1).sin(), (t * 3.7).cos(), (t * 2.3).sin() + 0.1).normalize();
            DMat3::from_axis_angle(axis, t * 7.9 % 6.2)
        })
    }

    #[test]
    fn the_rotation_of_a_stretched_rotation_is_found() {
        for (r, v) in rotations(40).zip(rotations(41).skip(1)) {
            let stretch = v * DMat3::from_diagonal(DVec3::new(1.7, 0.9, 0.3)) * v.transpose();
            assert!(distance(nearest_rotation(r * stretch, DMat3::IDENTITY), r) < 1e-14);
            let mut q = warm(DQuat::from_mat3(&(DMat3::from_rotation_y(0.1) * r)));
            extract(&lanes_of(r * stretch), &mut q);
            assert!(distance(matrix_of(&q), r) < 1e-13);
        }
    }

    #[test]
    fn newton_converges_quadratically() {
        let f = DMat3::from_diagonal(DVec3::new(1.2, 0.9, 0.8));
        let mut q = warm(DQuat::from_rotation_z(0.1));
        let angles: Vec<f64> = (0..4)
            .map(|_| {
                newton_step(&lanes_of(f), &mut q);
                distance(matrix_of(&q), DMat3::IDENTITY)
            })
            .collect();
        assert!(angles[0] < 5e-3 && angles[1] < 1e-6 && angles[2] < 1e-13, "{angles:?}");
    }

    #[test]
    fn a_slightly_inverted_tetrahedron_keeps_its_place() {
        for last in [-0.02, -0.5, -0.89] {
            let f = DMat3::from_diagonal(DVec3::new(1.05, 0.95, last));
            for r in rotations(20) {
                assert!(distance(nearest_rotation(r * f, DMat3::IDENTITY), r) < 1e-13, "{last}");
                let mut q = warm(DQuat::from_mat3(&(r * DMat3::from_rotation_x(0.05))));
                extract(&lanes_of(r * f), &mut q);
                assert!(distance(matrix_of(&q), r) < 1e-9, "{last}");
            }
        }
    }

    #[test]
    fn it_maximises_the_trace() {
        for (r, other) in rotations(30).zip(rotations(60).skip(30)) {
            let f = r * DMat3::from_diagonal(DVec3::new(1.3, 0.7, -0.4)) * other;
            let best = nearest_rotation(f, DMat3::IDENTITY);
            let trace = |r: DMat3| (r.transpose() * f).to_cols_array_2d().iter().enumerate().map(|(i, c)| c[i]).sum::<f64>();
            assert!((best.determinant() - 1.0).abs() < 1e-13);
            for tilt in rotations(30) {
                assert!(trace(tilt * best) <= trace(best) + 1e-13);
            }
        }
    }

    #[test]
    fn collapsed_gradients_keep_what_the_warm_start_says() {
        let warm_start = DMat3::from_rotation_z(0.4);
        assert_eq!(nearest_rotation(DMat3::ZERO, warm_start), warm_start);
        let line = DMat3::from_cols(DVec3::Y, DVec3::ZERO, DVec3::ZERO);
        let turned = nearest_rotation(line, DMat3::IDENTITY);
        assert!(distance(turned, DMat3::from_rotation_z(std::f64::consts::FRAC_PI_2)) < 1e-6, "the shortest turn from x to y");
        let mirrored = nearest_rotation(DMat3::from_diagonal(DVec3::new(1.0, 1.0, -1.0)), warm_start);
        assert!((mirrored.determinant() - 1.0).abs() < 1e-12 && mirrored.is_finite());
        let mut q = warm(DQuat::from_rotation_y(0.3));
        extract(&lanes_of(DMat3::ZERO), &mut q);
        assert!(distance(matrix_of(&q), DMat3::from_rotation_y(0.3)) < 1e-12);
    }

    #[test]
    fn a_warm_start_half_a_turn_off_is_mended() {
        let mut q = warm(DQuat::from_rotation_x(std::f64::consts::PI - 1e-9));
        extract(&lanes_of(DMat3::from_diagonal(DVec3::new(1.1, 1.0, 0.9))), &mut q);
        assert!(distance(matrix_of(&q), DMat3::IDENTITY) < 1e-9);
    }

    /// Stretches that are hard on rotations: flat, needles, inside out, next to inside out, nearly mirrored in two ways.
    fn stretches() -> impl Strategy<Value = DVec3> {
        let size = || prop_oneof![Just(0.0), Just(1.0), 1e-9..1e-6, 1e-3..0.1, 0.1..1.0, 1.0..30.0];
        (size(), size(), size(), prop_oneof![Just(1.0), Just(-1.0)]).prop_map(|(a, b, c, sign)| DVec3::new(a, b, c * sign))
    }

    fn turns() -> impl Strategy<Value = DQuat> {
        [-1.0..1.0f64, -1.0..1.0, -1.0..1.0, -1.0..1.0].prop_filter_map("a direction", |q| {
            let q = DQuat::from_array(q);
            (q.length() > 0.1).then(|| q.normalize())
        })
    }

    proptest! {
        #![proptest_config(ProptestConfig { cases: 4000, failure_persistence: None, ..ProptestConfig::default() })]

        /// No rotation has a larger trace with the matrix than the exact one, and a warm start comes to it where it is the only one.
        #[test]
        fn warm_steps_agree_with_singular_values(u in turns(), v in turns(), s in stretches(), axis in turns(), angle in 0.0..0.5f64) {
            let f = DMat3::from_quat(u) * DMat3::from_diagonal(s) * DMat3::from_quat(v);
            let exact = nearest_rotation(f, DMat3::IDENTITY);
            prop_assert!((exact.determinant() - 1.0).abs() < 1e-12 && exact.is_finite());
            let trace = |r: DMat3| (0..3).map(|k| r.col(k).dot(f.col(k))).sum::<f64>();
            let scale = s.abs().max_element();
            let (singular, _) = signed_polar(f);
            // Next to rank one the nearest to the warm start is taken, whose trace may lack as much as counts for nothing there.
            let slack = scale * if singular[1] + singular[2] > 2e-9 * scale { 1e-12 } else { 4e-9 };
            prop_assert!((trace(exact) - singular.iter().sum::<f64>()).abs() <= slack);
            let start = DMat3::from_axis_angle(axis.xyz().normalize_or(DVec3::X), angle) * exact;
            let mut q = warm(DQuat::from_mat3(&start).normalize());
            extract(&lanes_of(f), &mut q);
            let norm = q.iter().map(|l| l.0[2] * l.0[2]).sum::<f64>();
            prop_assert!((norm - 1.0).abs() < 1e-12);
            prop_assert!(trace(matrix_of(&q)) <= trace(exact) + slack);
            if singular[1] + singular[2] > 0.05 * scale && scale > 0.0 {
                prop_assert!(distance(matrix_of(&q), exact) < 1e-7, "{:?} from {angle}", singular);
            }
        }
    }
}
