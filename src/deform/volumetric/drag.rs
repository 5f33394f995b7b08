//! Drag of tetrahedra that are about to fold.
//!
//! A deep crease of the skin has several minima, and from frame to frame the one that the body is in may cease to be one: the crease snaps, by a tenth of
//! the body, while the targets hardly move. Flesh does not, since it takes time to flow. So a tetrahedron with little of its volume left is held back
//! towards the shape, but for a rotation, that it had after the last frame:
//!
//! ```text
//! Σ_j d_j w_j min_Q |F_j − Q S_j|²,     S_j the symmetric part of the polar decomposition of F_j after the last frame
//! ```
//!
//! The drag d fades with the motion of the targets: a body that is held still comes to the minimum without it. Tetrahedra that keep their volume have none.

use super::elements::{Blocks, determinants};
use crate::linalg::lanes::{Lanes, for_each_instruction_set};
use crate::linalg::rotation::{self, Matrices, Quaternions};
use glam::DMat3;

/// Below this part of its volume a tetrahedron is held back, in full where nothing of it is left.
const FOLDING: f64 = 0.9;

/// Weight of the drag of a flat tetrahedron, relative to its own. Twice as much calms creases further, but the matrix does not know of it: more frames then
/// end at the cap of passes, and the handles of a squat lag more.
const STRENGTH: f64 = 1.6;

/// Mean move of the targets in a frame, in diagonals, from which the drag is full: less than half a millimetre of a person.
const PACE: f64 = 2e-4;

/// Four tetrahedra of which at least one is held back.
struct Held {
    block: usize,
    weight: Lanes,
    /// Their stretch after the last frame.
    stretch: Matrices,
    /// The rotations that bring it nearest to the present deformation gradients.
    rotations: Quaternions,
}

/// The tetrahedra that are held back in this frame.
pub(super) struct Drag {
    held: Vec<Held>,
    folding: Vec<usize>,
    pub(super) strength: f64,
}

impl Drag {
    /// Room for all of `blocks`. Without bulk, nothing is added to the energy of the source.
    pub(super) fn new(blocks: &Blocks, bulk: f64) -> Self {
        let count = blocks.list.len();
        let strength = if bulk > 0.0 { STRENGTH } else { 0.0 };
        Self { held: Vec::with_capacity(count), folding: Vec::with_capacity(count), strength }
    }

    /// Holds nothing back.
    pub(super) fn release(&mut self) {
        self.held.clear();
    }

    /// Holds back what is folding in `p`. `motion`: mean move of the targets to this frame, in diagonals.
    pub(super) fn hold(&mut self, blocks: &Blocks, p: &[Lanes], rotations: &[Quaternions], motion: f64) {
        self.release();
        let strength = self.strength * (motion / PACE).min(1.0);
        if strength == 0.0 {
            return;
        }
        self.folding.clear();
        blocks.below(p, FOLDING, &mut self.folding);
        for &block in &self.folding {
            let f = blocks.deformation(block, p);
            let share = determinants(&f).0.map(|d| ((FOLDING - d) / FOLDING).clamp(0.0, 1.0));
            let mut rotations = rotations[block];
            rotation::extract(&f, &mut rotations);
            let mut stretch = product(&transposed(&rotation::matrices(&rotations)), &f);
            for lane in 0..4 {
                flatten(&mut stretch, lane);
            }
            self.held.push(Held { block, weight: blocks.weight(block) * Lanes(share) * strength, stretch, rotations });
        }
    }

    /// As [`Blocks::pass`]: the energy of the drag, and half its gradient added to `g`.
    pub(super) fn pass(&mut self, blocks: &Blocks, p: &[Lanes], newton: u32, g: &mut [Lanes]) -> f64 {
        pass(&mut self.held, blocks, p, newton, g)
    }
}

for_each_instruction_set! {
    fn pass(held: &mut [Held], blocks: &Blocks, p: &[Lanes], newton: u32, g: &mut [Lanes]) -> f64 {
        let mut energy = Lanes::ZERO;
        for held in held {
            let f = blocks.deformation(held.block, p);
            // The stretch is its own transpose.
            let turned = product(&f, &held.stretch);
            for _ in 0..newton {
                rotation::newton_step(&turned, &mut held.rotations);
            }
            let mut pull = product(&rotation::matrices(&held.rotations), &held.stretch);
            let mut square = Lanes::ZERO;
            for k in 0..9 {
                let d = f[k] - pull[k];
                square += d * d;
                pull[k] = d * held.weight;
            }
            energy += square * held.weight;
            blocks.add_pull(held.block, &pull, g);
        }
        energy.sum()
    }
}

#[inline(always)]
fn product(a: &Matrices, b: &Matrices) -> Matrices {
    let mut out = [Lanes::ZERO; 9];
    for i in 0..3 {
        for j in 0..3 {
            out[3 * i + j] = a[3 * i] * b[j] + a[3 * i + 1] * b[3 + j] + a[3 * i + 2] * b[6 + j];
        }
    }
    out
}

fn transposed(a: &Matrices) -> Matrices {
    std::array::from_fn(|k| a[k % 3 * 3 + k / 3])
}

/// The stretch of a tetrahedron that is inside out becomes that of a flat one, by as much of the identity as that takes: nobody is kept inside out.
fn flatten(stretch: &mut Matrices, lane: usize) {
    let least = smallest_eigenvalue(DMat3::from_cols_array(&std::array::from_fn(|k| stretch[k].0[lane])));
    if least < 0.0 {
        let part = least / (least - 1.0);
        for (k, entry) in stretch.iter_mut().enumerate() {
            let identity = if k % 4 == 0 { 1.0 } else { 0.0 };
            entry.0[lane] += part * (identity - entry.0[lane]);
        }
    }
}

/// Of a symmetric matrix: the first root of its characteristic polynomial by Newton's method from below, where it never steps past the root. Without
/// functions that differ between machines.
fn smallest_eigenvalue(m: DMat3) -> f64 {
    const STEPS: usize = 40;
    let mean = (m.x_axis.x + m.y_axis.y + m.z_axis.z) / 3.0;
    let rest = m - DMat3::IDENTITY * mean;
    let spread = (rest.to_cols_array().iter().map(|x| x * x).sum::<f64>() / 6.0).sqrt();
    if spread == 0.0 {
        return mean;
    }
    // Of the matrix without its mean, over its spread: x³ − 3 x − d, with roots from −2 to 2.
    let d = (rest * (1.0 / spread)).determinant().clamp(-2.0, 2.0);
    let mut x = -2.0f64;
    for _ in 0..STEPS {
        let slope = 3.0 * (x * x - 1.0);
        let step = (d + 3.0 * x - x * x * x) / slope;
        if step.is_nan() || step <= 1e-15 {
            break;
        }
        x += step;
    }
    mean + spread * x
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::super::bodies::{block, distance, handles, targets_of};
    use super::super::{Options, Volumetric};
    use super::*;
    use crate::deform::Deformer;
    use glam::{DQuat, DVec3};

    #[test]
    fn the_smallest_eigenvalue_of_turned_diagonals_is_found() {
        let q = DMat3::from_quat(DQuat::from_axis_angle(DVec3::new(0.6, 0.0, 0.8), 1.1));
        for d in [DVec3::new(1.2, 0.9, -0.3), DVec3::new(0.5, 2.0, 0.7), DVec3::ONE, DVec3::new(1.0, 1.0, -2.0)] {
            let m = q * DMat3::from_diagonal(d) * q.transpose();
            assert!((smallest_eigenvalue(m) - d.min_element()).abs() < 1e-7, "{d}");
        }
    }

    #[test]
    fn a_stretch_that_is_inside_out_becomes_flat_and_others_stay() {
        let of = |d: DVec3| -> Matrices { std::array::from_fn(|k| Lanes::splat(if k % 4 == 0 { d[k / 4] } else { 0.0 })) };
        for (from, to) in [(-1.0, 0.0), (0.3, 0.3)] {
            let mut stretch = of(DVec3::new(2.0, from, 1.0));
            flatten(&mut stretch, 2);
            assert!((stretch[4].0[2] - to).abs() < 1e-12 && stretch[4].0[1] == from);
        }
    }

    /// A slab whose ends come together until its middle is folded.
    fn folded(strength: f64) -> (Volumetric, Vec<crate::deform::Handle>, crate::proxy::Proxy) {
        let proxy = block([8, 3, 3], 0.1);
        let handles = handles(&proxy, 1.0);
        let mut deformer = Volumetric::new(&proxy, &handles, &Options::default()).unwrap();
        deformer.drag.strength = strength;
        deformer.start(&targets_of(&proxy, &handles, |p| p)).unwrap();
        for frame in 1..=6 {
            deformer.step(&targets_of(&proxy, &handles, squeezed(frame))).unwrap();
        }
        (deformer, handles, proxy)
    }

    fn squeezed(frame: u32) -> impl Fn(DVec3) -> DVec3 {
        let t = f64::from(frame) / 6.0;
        move |p| DQuat::from_rotation_z(2.6 * t * p.x) * p * DVec3::new(1.0 - 0.4 * t, 1.0, 1.0)
    }

    #[test]
    fn half_the_gradient_is_the_slope_of_the_energy() {
        let (mut deformer, ..) = folded(STRENGTH);
        deformer.drag.hold(&deformer.blocks, &deformer.p, &deformer.rotations, 1.0);
        assert!(!deformer.drag.held.is_empty());
        let wave = |v: usize| Lanes::point(DVec3::new((v as f64).sin(), (1.7 * v as f64).cos(), (2.3 * v as f64).sin()));
        let mut along = |step: f64, newton: u32| {
            let p: Vec<Lanes> = deformer.p.iter().enumerate().map(|(v, p)| *p + wave(v) * step).collect();
            let mut g = vec![Lanes::ZERO; p.len()];
            let energy = deformer.drag.pass(&deformer.blocks, &p, newton, &mut g);
            (energy, g.iter().enumerate().map(|(v, g)| 2.0 * (*g * wave(v)).sum()).sum::<f64>())
        };
        let (_, expected) = along(0.02, 12);
        let slope = (along(0.02 + 1e-6, 0).0 - along(0.02 - 1e-6, 0).0) / 2e-6;
        assert!(expected > 1e-4 && (slope - expected).abs() < 1e-6 * expected, "{slope} {expected}");
    }

    #[test]
    fn drag_slows_folds_and_lets_go_of_a_body_that_is_held_still() {
        let ([mut with, mut without], handles, proxy) = {
            let ((a, handles, proxy), (b, ..)) = (folded(STRENGTH), folded(0.0));
            ([a, b], handles, proxy)
        };
        assert!(!with.drag.held.is_empty() && without.drag.held.is_empty());
        assert!(distance(with.pose(), without.pose()) > 1e-4);
        let targets = targets_of(&proxy, &handles, squeezed(6));
        for deformer in [&mut with, &mut without] {
            deformer.step(&targets).unwrap();
        }
        assert!(with.drag.held.is_empty());
        assert!(distance(with.pose(), without.pose()) < 2e-4, "{}", distance(with.pose(), without.pose()));
    }
}
