//! The shell deformer: a surface that resists stretching, bending and a change of its volume, and has learnt from example poses how it bends.
//!
//! It minimises over positions x of a coarse mesh and weights α of its examples (Fröhlich & Botsch 2011, (1)–(8))
//!
//! ```text
//! E(x, α) = λ Σ_e (l_e − l_e*)² / L_e² + μ Σ_e L_e² / A_e (θ_e − θ_e*)² + ν (v − v*)² / V² + η Σ_h w_h |c_h x − p_h|² / D² + ½ ρ Σ_i d_i α_i²
//! ```
//!
//! with the lengths, dihedral angles and volume wanted (6) `l* = L + Σ α_i (l_i − L)` and so on: they do not change when an example is moved or turned,
//! so that examples may come in any orientation. The last two terms are not in the paper: the pulls of the handles, and a weak pull of the weights
//! to 0, each against what it resists on its own (`d_i`), which decides among examples that are alike.
//!
//! A frame is Gauss–Newton from the pose of the frame before (`newton`): a sparse Cholesky factor of one pattern, the volume's dense row by Sherman
//! and Morrison, the weights by a Schur complement (`system`). Where there is no frame before, and where the energy leaps, rest and every example,
//! moved rigidly onto the handles, are tried as starts.
//!
//! Source: S. Fröhlich, M. Botsch, *Example-Driven Deformations Based on Discrete Shells*, Computer Graphics Forum 30(8), 2011.

mod body;
mod decimate;
mod geometry;
mod interpolate;
#[cfg(test)]
mod laws;
mod newton;
mod pulls;
mod quadratic;
mod rows;
#[cfg(test)]
pub(crate) mod shapes;
mod shell;
mod starts;
#[cfg(test)]
mod stored_cases;
mod system;
mod topology;

pub use body::Body;
pub use interpolate::Interpolator;
pub use quadratic::Bounds;
pub use rows::SurfaceRows;
pub use shell::Material;

use super::{Deformer, ERROR_PER_STEP, FrameStats, Handle, OrientedHandle, Placement, Targets};
use crate::error::{Error, Result};
use body::tip;
use geometry::volume;
use glam::DVec3;
use newton::{Goals, Minimum, Newton, Settings, Stop, Tension, Weights};
use pulls::Pulls;
use shell::Shell;
use starts::Starts;

/// How the shell is solved.
#[derive(Clone, Debug)]
pub struct Options {
    /// How hard it is.
    pub material: Material,
    /// Where the weights may lie.
    pub bounds: Bounds,
    /// ρ: how strongly weights are drawn to 0.
    pub regularization: f64,
    /// η: how hard a handle with `beta` 1 pulls.
    pub hardness: f64,
    /// Most Gauss–Newton steps per frame.
    pub steps: u32,
    /// Relative decrease of the energy below which a frame is solved.
    pub decrease: f64,
    /// Root mean square of the moves of a step, in diagonals, below which a frame is solved.
    pub still: f64,
    /// Factor of the stiffness of each triangle; empty: 1.
    pub stiffness: Vec<f64>,
    /// Triangles that keep their shape, or that of the examples, in groups.
    pub rigid: Vec<Vec<u32>>,
}

impl Options {
    /// For so many examples.
    pub fn for_examples(count: usize) -> Self {
        Self {
            material: if count > 0 { Material::WITH_EXAMPLES } else { Material::WITHOUT_EXAMPLES },
            bounds: Bounds::BOX,
            regularization: 1e-4,
            hardness: 1e6,
            steps: 5,
            decrease: 1e-5,
            still: 2e-5,
            stiffness: Vec::new(),
            rigid: Vec::new(),
        }
    }
}

/// Stiffness of what is rigid.
const RIGID: f64 = 30.0;
/// Relative damping of the matrix, for what the handles leave free.
const DAMPING: f64 = 1e-9;
/// Mean distance of the handles from their targets, in diagonals, from which a frame begins anew: a cut in the take.
const CUT: f64 = 0.1;
/// Root mean square of the moves of the last step, in diagonals, up to which a frame that was not solved to the tolerance counts as solved.
const SETTLED: f64 = 1e-4;
/// A hinge that is so far from its wanted angle, in radians, is turned inside out.
const INSIDE_OUT: f64 = 2.0;

/// A shell that handles pose.
#[derive(Debug)]
pub struct Shells {
    newton: Newton,
    pulls: Pulls,
    starts: Starts,
    settings: Settings,
    x: Vec<DVec3>,
    weights: Vec<f64>,
    pose: Vec<DVec3>,
    last: FrameStats,
    is_cold: bool,
}

impl Shells {
    /// A shell with handles; rows are over [`Body::proxy`].
    ///
    /// # Errors
    /// Handles that are broken or do not hold a part of the mesh; a mesh that is no surface.
    pub fn new(body: &Body, handles: &[Handle], oriented: &[OrientedHandle], options: &Options) -> Result<Self> {
        super::volumetric::check_handles(&body.proxy, handles)?;
        let n = body.vertices();
        let faces = &body.proxy.boundary;
        let mut stiffness = options.stiffness.clone();
        if !options.rigid.is_empty() {
            stiffness.resize(faces.len(), 1.0);
            options.rigid.iter().flatten().for_each(|&t| stiffness[t as usize] *= RIGID);
        }
        let shell = Shell::new(&body.proxy.rest[..n], faces, &body.examples, &options.material, &stiffness)?;
        let pulls = Pulls::new(&body.proxy, handles, oriented, options.hardness / shell.diagonal.powi(2));
        let weights = vec![0.0; shell.examples.len()];
        let newton = Newton::new(shell, &pulls.held(n), pulls.grips());
        let free = Weights::Free { bounds: options.bounds, regularization: options.regularization };
        let settings = Settings {
            steps: options.steps,
            decrease: options.decrease,
            still: options.still,
            damping: DAMPING,
            tension: Tension::WhenNeeded,
            weights: if weights.is_empty() { Weights::Given } else { free },
        };
        Ok(Self {
            newton,
            starts: Starts::new(body, &pulls),
            pulls,
            settings,
            x: body.proxy.rest[..n].to_vec(),
            weights,
            pose: body.proxy.rest.clone(),
            last: FrameStats { converged: true, volume_ratio: 1.0, ..FrameStats::default() },
            is_cold: true,
        })
    }

    /// Hinges that do not resist: since an example turns them by more than half a turn, and since a triangle beside them has no normal.
    pub fn without_bending(&self) -> (usize, usize) {
        (self.newton.shell.folded, self.newton.shell.thin)
    }

    fn solve(&mut self, targets: &Targets, cold: bool) -> Result<FrameStats> {
        self.pulls.take(targets)?;
        if !self.pulls.any() {
            self.last = FrameStats { passes: 0, step: 0.0, converged: true, recovered: false, ..self.last };
            return Ok(self.last);
        }
        let cut = self.pulls.distance(&self.x, &self.newton.shell.faces) > CUT * self.newton.shell.diagonal;
        let mut recovered = false;
        let mut minimum = if cold || self.is_cold || cut {
            self.starts.forget();
            self.begin()
        } else {
            self.pulls.settle(&mut self.x, None);
            self.newton.minimize(&mut self.x, &mut self.weights, &self.pulls.goals(), &self.settings)
        };
        if !minimum.energy().is_finite() || self.starts.leaps(minimum.shell()) {
            recovered = !minimum.energy().is_finite();
            let again = self.restart(minimum);
            minimum.steps += again.steps;
            minimum = Minimum { steps: minimum.steps, ..again };
        }
        if !minimum.energy().is_finite() || self.x.iter().any(|p| !p.is_finite()) {
            self.is_cold = true;
            self.x.copy_from_slice(&self.newton.shell.rest);
            self.weights.fill(0.0);
            return Err(Error::refused("the pose is not finite").expected("targets within reach of the body"));
        }
        self.starts.note(minimum.shell());
        self.is_cold = false;
        self.write_pose();
        self.last = self.measure(&minimum, recovered);
        Ok(self.last)
    }

    /// Solves from the best of rest and examples.
    fn begin(&mut self) -> Minimum {
        let goals = self.pulls.goals();
        self.starts.best(&mut self.newton, &self.pulls, &goals, &self.settings, &mut self.x, &mut self.weights)
    }

    /// Solves from rest and examples, and takes the best if it is better than what there is.
    fn restart(&mut self, found: Minimum) -> Minimum {
        let (x, weights) = (self.x.clone(), self.weights.clone());
        let again = self.begin();
        if found.energy().is_finite() && found.energy() <= again.energy() {
            self.x = x;
            self.weights = weights;
            return Minimum { steps: again.steps, ..found };
        }
        again
    }

    fn write_pose(&mut self) {
        let n = self.x.len();
        self.pose[..n].copy_from_slice(&self.x);
        for (point, face) in self.pose[n..].iter_mut().zip(&self.newton.shell.faces) {
            *point = tip(&self.x, *face);
        }
    }

    fn measure(&mut self, minimum: &Minimum, recovered: bool) -> FrameStats {
        let shell = &self.newton.shell;
        let now = volume(&self.x, &shell.faces, &shell.topology.holes);
        let (inverted, fold) = self.newton.inside_out(&self.x, &self.weights, INSIDE_OUT);
        FrameStats {
            passes: minimum.steps,
            // A step of Newton's method says how far the step before was off; what is left after it is less.
            step: minimum.still / ERROR_PER_STEP,
            error: Some(minimum.still),
            violation: None,
            converged: minimum.stop != Stop::Cap || minimum.still < SETTLED,
            recovered,
            energy: minimum.energy(),
            inverted,
            fold,
            volume_ratio: if self.newton.shell.swell > 0.0 { now / self.newton.shell.volume } else { 1.0 },
        }
    }
}

impl Deformer for Shells {
    fn start(&mut self, targets: &Targets) -> Result<FrameStats> {
        self.solve(targets, true)
    }

    fn step(&mut self, targets: &Targets) -> Result<FrameStats> {
        self.solve(targets, false)
    }

    fn place(&mut self, placements: &[Placement]) -> Result<()> {
        self.pulls.place(placements)
    }

    fn pose(&self) -> &[DVec3] {
        &self.pose
    }

    fn weights(&self) -> &[f64] {
        &self.weights
    }
}

impl Goals<'_> {
    /// Nothing pulls.
    const NONE: Goals<'static> = Goals { positions: &[], weights: &[] };
}
