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
//! moved rigidly onto the handles, are tried as starts. Where an edge has turned inside out, a pose without is looked for (`unfold`).
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
mod refined;
mod rows;
#[cfg(test)]
pub(crate) mod shapes;
mod shell;
mod starts;
#[cfg(test)]
mod stored_cases;
mod system;
mod topology;
mod unfold;

pub use body::Body;
pub use interpolate::Interpolator;
pub(crate) use interpolate::too_far;
pub use quadratic::Bounds;
pub use refined::Refined;
pub use rows::SurfaceRows;
pub use shell::Material;

use super::{Deformer, FrameStats, Handle, OrientedHandle, Placement, Targets};
use crate::error::{Error, Result};
use body::tip;
use geometry::volume;
use glam::DVec3;
use newton::{Goals, Minimum, Newton, Settings, Tension, Weights};
use pulls::Pulls;
use shell::Shell;
use starts::Starts;
use unfold::Unfold;

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
    /// Root mean square of the moves of a step, in diagonals, below which a frame is solved. Where this and `decrease` are 0, `steps` is a fixed
    /// count, whose frames say nothing of how well they are solved.
    pub still: f64,
    /// Factor of the stiffness of each triangle; empty: 1.
    pub stiffness: Vec<f64>,
    /// Triangles that keep their shape, or that of the examples, in groups.
    pub rigid: Vec<Vec<u32>>,
    /// Frames per second.
    pub rate: f64,
}

impl Options {
    /// For so many examples.
    pub fn for_examples(count: usize) -> Self {
        Self {
            material: if count > 0 { Material::WITH_EXAMPLES } else { Material::WITHOUT_EXAMPLES },
            bounds: Bounds::BOX,
            regularization: 1e-4,
            hardness: 1e6,
            steps: 8,
            decrease: 1e-5,
            still: 2e-5,
            stiffness: Vec::new(),
            rigid: Vec::new(),
            rate: 100.0,
        }
    }

    fn is_fixed_count(&self) -> bool {
        self.decrease <= 0.0 && self.still <= 0.0
    }

    /// How energies are minimized, with so many examples.
    fn settings(&self, examples: usize) -> Settings {
        let free = Weights::Free { bounds: self.bounds, regularization: self.regularization };
        Settings {
            steps: self.steps,
            decrease: self.decrease,
            still: self.still,
            damping: DAMPING,
            tension: Tension::WhenNeeded,
            weights: if examples > 0 { free } else { Weights::Given },
        }
    }

    /// Stiffness of each triangle with that of the rigid groups; empty: 1.
    fn stiffness(&self, faces: usize) -> Result<Vec<f64>> {
        let mut stiffness = self.stiffness.clone();
        if !stiffness.is_empty() && stiffness.len() != faces {
            return Err(Error::refused(format!("{} stiffness values for {faces} triangles", stiffness.len())));
        }
        if let Some(t) = stiffness.iter().position(|k| !(k.is_finite() && *k > 0.0)) {
            return Err(Error::refused(format!("stiffness {} of triangle {t}", stiffness[t])).expected("a positive number"));
        }
        if !self.rigid.is_empty() {
            stiffness.resize(faces, 1.0);
        }
        for (number, group) in self.rigid.iter().enumerate() {
            for &t in group {
                let Some(factor) = stiffness.get_mut(t as usize) else {
                    return Err(Error::refused(format!("rigid group {number}: triangle {t} of a shell with {faces}")));
                };
                *factor *= RIGID;
            }
        }
        Ok(stiffness)
    }
}

/// Stiffness of what is rigid.
const RIGID: f64 = 30.0;
/// Relative damping of the matrix, for what the handles leave free.
const DAMPING: f64 = 1e-9;
/// Mean distance of the handles from their targets, in diagonals, from which a frame begins anew: a cut in the take.
const CUT: f64 = 0.1;
/// Drag of a crease against its stiffness, in seconds: what it would take to come within 1/e of an angle that nothing else keeps it from.
const DRAG: f64 = 0.02;
/// Mean speed of the targets, in diagonals per second, from which the drag is full: four centimetres of a person. A body that is held still comes to
/// the minimum without it.
const PACE: f64 = 0.02;

/// A shell that handles pose.
#[derive(Debug)]
pub struct Shells {
    newton: Newton,
    pulls: Pulls,
    starts: Starts,
    unfold: Unfold,
    settings: Settings,
    x: Vec<DVec3>,
    weights: Vec<f64>,
    /// Pose and weights that are kept while others are tried.
    kept: (Vec<DVec3>, Vec<f64>),
    pose: Vec<DVec3>,
    last: FrameStats,
    is_cold: bool,
    is_fixed_count: bool,
    rate: f64,
}

impl Shells {
    /// A shell with handles; rows are over [`Body::proxy`].
    ///
    /// # Errors
    /// Handles that are broken; a part of the mesh that no handle holds; stiffness for other triangles than there are; a mesh that is no surface.
    pub fn new(body: &Body, handles: &[Handle], oriented: &[OrientedHandle], options: &Options) -> Result<Self> {
        super::volumetric::check_handles(&body.proxy, handles)?;
        let n = body.vertices();
        let faces = &body.proxy.boundary;
        let stiffness = options.stiffness(faces.len())?;
        let shell = Shell::new(&body.proxy.rest[..n], faces, &body.examples, &options.material, &stiffness)?;
        let pulls = Pulls::new(&body.proxy, handles, oriented, options.hardness / shell.size.powi(2));
        check_components(body, &pulls)?;
        let weights = vec![0.0; shell.examples.len()];
        let newton = Newton::new(shell, &pulls.held(n), pulls.grips());
        Ok(Self {
            newton,
            starts: Starts::new(body, &pulls),
            unfold: Unfold::new(body, pulls.held(n)),
            kept: (body.proxy.rest[..n].to_vec(), weights.clone()),
            pulls,
            settings: options.settings(weights.len()),
            x: body.proxy.rest[..n].to_vec(),
            weights,
            pose: body.proxy.rest.clone(),
            last: FrameStats { converged: true, volume_ratio: 1.0, ..FrameStats::default() },
            is_cold: true,
            is_fixed_count: options.is_fixed_count(),
            rate: options.rate,
        })
    }

    /// Energies before the first and after every step of the last frame's last minimization.
    pub fn energies(&self) -> &[f64] {
        self.newton.energies()
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
        let size = self.newton.shell.size;
        let speed = self.pulls.motion() / size * self.rate;
        let cut = self.pulls.distance(&self.x, &self.newton.shell.faces) > CUT * size;
        let mut recovered = false;
        let mut minimum = if cold || self.is_cold || cut {
            self.starts.forget();
            self.unfold.forget();
            self.begin()
        } else {
            self.pulls.settle(&mut self.x, None);
            if !self.is_fixed_count {
                self.newton.hold_back(&self.x, &self.weights, DRAG * self.rate * (speed / PACE).min(1.0));
            }
            self.newton.minimize(&mut self.x, &mut self.weights, &self.pulls.goals(), &self.settings)
        };
        if !self.is_fixed_count {
            let frame = &mut unfold::Frame {
                newton: &mut self.newton,
                x: &mut self.x,
                weights: &mut self.weights,
                goals: &self.pulls.goals(),
                settings: &self.settings,
            };
            minimum = self.unfold.turn_back(frame, minimum, speed == 0.0);
        }
        if !minimum.energy().is_finite() || self.starts.leaps(minimum.shell(), speed == 0.0) {
            (minimum, recovered) = self.restart(minimum);
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
        self.newton.release();
        let goals = self.pulls.goals();
        self.starts.best(&mut self.newton, &self.pulls, &goals, &self.settings, &mut self.x, &mut self.weights)
    }

    /// Solves from rest and examples, and takes the best if it is better than what there is; whether it was.
    fn restart(&mut self, found: Minimum) -> (Minimum, bool) {
        self.kept.0.copy_from_slice(&self.x);
        self.kept.1.copy_from_slice(&self.weights);
        // Without what holds creases back: a pose from elsewhere has none of it.
        self.newton.release();
        let before = self.newton.total(&self.x, &self.weights, &self.pulls.goals(), &self.settings);
        let again = self.begin();
        let steps = found.steps + again.steps;
        let is_better = again.energy() < before || !before.is_finite();
        if !is_better {
            self.x.copy_from_slice(&self.kept.0);
            self.weights.copy_from_slice(&self.kept.1);
            self.starts.wait();
            return (Minimum { steps, ..found }, false);
        }
        (Minimum { steps, ..again }, true)
    }

    fn write_pose(&mut self) {
        let n = self.x.len();
        self.pose[..n].copy_from_slice(&self.x);
        for (point, face) in self.pose[n..].iter_mut().zip(&self.newton.shell.faces) {
            *point = tip(&self.x, *face);
        }
    }

    fn measure(&self, minimum: &Minimum, recovered: bool) -> FrameStats {
        let shell = &self.newton.shell;
        let now = volume(&self.x, &shell.faces, &shell.topology.holes);
        let (mut inverted, mut longest) = (0, None::<(f64, DVec3)>);
        for [a, b, ..] in self.newton.inside_out(&self.x, &self.weights) {
            inverted += 1;
            let [a, b] = [a, b].map(|v| shell.rest[v as usize]);
            if longest.is_none_or(|(length, _)| a.distance(b) > length) {
                longest = Some((a.distance(b), (a + b) * 0.5));
            }
        }
        FrameStats {
            passes: minimum.steps,
            step: minimum.last.map_or(0.0, |moves| moves.most),
            // A step of Newton's method says how far the step before was off; what is left after it is less.
            error: minimum.last.filter(|_| !self.is_fixed_count && minimum.is_settled()).map(|moves| moves.most),
            violation: None,
            converged: self.is_fixed_count || minimum.is_settled(),
            recovered,
            energy: minimum.energy(),
            inverted,
            fold: longest.map(|(_, place)| place),
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

/// Every connected part hangs on a handle.
fn check_components(body: &Body, pulls: &Pulls) -> Result<()> {
    let proxy = &body.proxy;
    let count = proxy.components.iter().max().map_or(0, |&last| last as usize + 1);
    let mut of_vertex = vec![0; body.vertices()];
    for (face, &component) in proxy.boundary.iter().zip(&proxy.components) {
        face.iter().for_each(|&v| of_vertex[v as usize] = component as usize);
    }
    let mut held = vec![false; count];
    pulls.holding().for_each(|v| held[of_vertex[v as usize]] = true);
    let Some(free) = held.iter().position(|held| !held) else { return Ok(()) };
    let members: Vec<DVec3> =
        of_vertex.iter().zip(&proxy.rest).filter(|(component, _)| **component == free).map(|(_, p)| *p).collect();
    let centre = members.iter().sum::<DVec3>() / members.len().max(1) as f64;
    let faces = proxy.components.iter().filter(|component| **component as usize == free).count();
    Err(Error::refused(format!(
        "no handle holds component {} of {count} of the shell: {faces} triangles around {centre:.3} in the unit box",
        free + 1
    ))
    .expected("at least one handle on every component")
    .hint("a marker on it, or a scan without the loose part"))
}

impl Goals<'_> {
    /// Nothing pulls.
    const NONE: Goals<'static> = Goals { positions: &[], weights: &[] };
}
