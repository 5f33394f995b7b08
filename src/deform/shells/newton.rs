//! Gauss–Newton with a line search (Fröhlich & Botsch 2011, §5.2): one code for positions, and for positions with example weights.

use super::geometry::{dihedral, dihedral_gradient, double_area, volume, volume_gradient, wrapped};
use super::quadratic::Bounds;
use super::shell::Shell;
use super::system::{Direction, Linearization, Pull, System, Unknown};
use super::topology::Hinge;
use glam::{DMat3, DVec3};

/// The shortest share of a step that is tried.
const SHORTEST: f64 = 1e-10;
/// Energy below which there is nothing left to gain.
const NOTHING: f64 = 1e-24;
/// Root mean square of the moves of the last step, in diagonals, below which a pose that was not solved to the tolerance counts as solved.
const SETTLED: f64 = 1e-4;

/// Distances of a hinge from the angle that is wanted, in radians, from which it is held back, and in full.
const CREASING: f64 = 0.1;
const CREASED: f64 = 0.5;
/// From here on it is turned inside out.
const INSIDE_OUT: f64 = 2.0;

/// When the second derivative of stretched edges is part of the matrix. The minimum is the same.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Tension {
    /// Where the full step without it fails.
    WhenNeeded,
    /// Always: for pure deformations far from rest.
    #[cfg_attr(not(test), allow(dead_code))]
    Always,
}

/// What is done about the weights of the examples.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Weights {
    /// They are given.
    Given,
    /// They are found with the positions.
    Free { bounds: Bounds, regularization: f64 },
}

/// When to stop, and how to go.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Settings {
    pub steps: u32,
    /// Relative decrease of the energy of a step below which it was the last.
    pub decrease: f64,
    /// The same for the root mean square of its moves, in diagonals.
    pub still: f64,
    /// Relative damping of the diagonal.
    pub damping: f64,
    pub tension: Tension,
    pub weights: Weights,
}

/// Where the pulls shall be, and how hard they pull: factors of half the square of a distance.
#[derive(Clone, Copy, Debug)]
pub(super) struct Goals<'a> {
    pub positions: &'a [DVec3],
    pub weights: &'a [f64],
}

/// Why it ended.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) enum Stop {
    Converged,
    #[default]
    Cap,
    NoDecrease,
    /// The matrix could not be factored.
    Singular,
}

/// How far a step moves the vertices, in diagonals.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Moves {
    /// Root mean square.
    pub mean: f64,
    pub most: f64,
}

/// What a minimization amounted to.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Minimum {
    pub steps: u32,
    /// Stretching, bending, volume, pulls, weights.
    pub terms: [f64; 5],
    /// The last step, or the one that was refused since it lessened nothing; none where there was neither.
    pub last: Option<Moves>,
    pub stop: Stop,
}

impl Minimum {
    pub fn energy(&self) -> f64 {
        self.terms.iter().sum()
    }

    /// Whether what is left to move is little.
    pub fn is_settled(&self) -> bool {
        self.stop == Stop::Converged || self.last.is_some_and(|moves| moves.mean < SETTLED)
    }

    /// What the shell itself resists.
    pub fn shell(&self) -> f64 {
        self.terms[..3].iter().sum()
    }
}

/// A pull that is not on the surface: a row over vertices, and shares of the outward offsets of triangles, whose corners are in the row.
#[derive(Clone, Debug, Default)]
pub(super) struct Grip {
    pub pull: Pull,
    pub offsets: Vec<(u32, f64)>,
}

/// The minimizer of a shell with its memory.
#[derive(Debug)]
pub(super) struct Newton {
    pub shell: Shell,
    system: System,
    pulls: Vec<Pull>,
    offsets: Vec<Vec<(u32, f64)>>,
    at: Linearization,
    wanted_lengths: Vec<f64>,
    wanted_angles: Vec<f64>,
    forces: Vec<DVec3>,
    drags: Vec<Drag>,
    directions: [Direction; 2],
    trials: [(Vec<DVec3>, Vec<f64>); 2],
    energies: Vec<f64>,
}

/// What holds a hinge back at the angle of the frame before: a share of its stiffness.
#[derive(Clone, Copy, Debug, Default)]
struct Drag {
    share: f64,
    angle: f64,
}

impl Newton {
    /// `held`: vertices that do not move.
    pub fn new(shell: Shell, held: &[bool], grips: Vec<Grip>) -> Self {
        let (pulls, offsets): (Vec<_>, Vec<_>) = grips.into_iter().map(|g| (g.pull, g.offsets)).unzip();
        let system = System::new(&shell, held, &pulls);
        let (n, k, edges, hinges) =
            (shell.rest.len(), shell.examples.len(), shell.topology.edges.len(), shell.topology.hinges.len());
        let direction = Direction { moves: vec![DVec3::ZERO; n], weights: vec![0.0; k] };
        let trial = (vec![DVec3::ZERO; n], vec![0.0; k]);
        Self {
            system,
            at: Linearization {
                stretch: vec![0.0; edges],
                bend: vec![0.0; hinges],
                swell: 0.0,
                edges: vec![DVec3::ZERO; edges],
                lengths: vec![0.0; edges],
                hinges: vec![[DVec3::ZERO; 4]; hinges],
                drags: vec![0.0; hinges],
                drag: vec![0.0; hinges],
                volume: vec![DVec3::ZERO; n],
                pulls: pulls.iter().map(|p| p.values.iter().map(|c| DMat3::from_diagonal(DVec3::splat(*c))).collect()).collect(),
            },
            wanted_lengths: vec![0.0; edges],
            wanted_angles: vec![0.0; hinges],
            forces: vec![DVec3::ZERO; pulls.len()],
            drags: vec![Drag::default(); hinges],
            energies: Vec::with_capacity(64),
            pulls,
            offsets,
            directions: [direction.clone(), direction],
            trials: [trial.clone(), trial],
            shell,
        }
    }

    /// Steps from a pose to one of less energy, until one of the settings says that it is enough. Never to one of more.
    pub fn minimize(&mut self, x: &mut [DVec3], weights: &mut [f64], goals: &Goals<'_>, settings: &Settings) -> Minimum {
        if let Weights::Free { bounds, .. } = settings.weights {
            weights.iter_mut().for_each(|w| *w = w.clamp(bounds.least, bounds.most));
        }
        let terms = self.energy(x, weights, goals, settings.weights);
        let mut result = Minimum { terms, stop: Stop::Cap, ..Minimum::default() };
        self.energies.clear();
        self.energies.push(result.energy());
        while result.steps < settings.steps {
            self.linearize(x, weights);
            self.force(x, goals);
            let free = matches!(settings.weights, Weights::Free { .. });
            self.system.load(&self.shell, &self.at, &self.pulls, &self.forces, free);
            let before = result.energy();
            let tries: &[bool] = if settings.tension == Tension::Always { &[true] } else { &[false, true] };
            let mut best: Option<(usize, [f64; 5], f64)> = None;
            let mut refused = None;
            for (slot, &tension) in tries.iter().enumerate() {
                let unknown = match settings.weights {
                    Weights::Given => None,
                    Weights::Free { bounds, regularization } => Some(Unknown { weights, bounds, regularization }),
                };
                let direction = &mut self.directions[slot];
                let (system, shell, at) = (&mut self.system, &self.shell, &self.at);
                let found = system.direction(shell, at, goals.weights, tension, settings.damping, unknown.as_ref(), direction);
                if found.is_none() {
                    continue;
                }
                refused = Some(slot);
                let Some((terms, share)) = self.search(slot, x, weights, goals, settings, before) else { continue };
                let energy: f64 = terms.iter().sum();
                if best.is_none_or(|(_, other, _)| energy < other.iter().sum()) {
                    best = Some((slot, terms, share));
                }
                if share == 1.0 {
                    break;
                }
            }
            let Some((slot, terms, share)) = best else {
                result.stop = if refused.is_none() { Stop::Singular } else { Stop::NoDecrease };
                result.last = refused.map(|slot| self.moves(slot, 1.0)).or(result.last);
                break;
            };
            let (moved, reweighted) = &self.trials[slot];
            x.copy_from_slice(moved);
            weights.copy_from_slice(reweighted);
            result.steps += 1;
            result.terms = terms;
            let moves = self.moves(slot, share);
            result.last = Some(moves);
            let energy = result.energy();
            self.energies.push(energy);
            // A step that had to be shortened is short for that, and says nothing.
            let is_little = before - energy < settings.decrease * before || moves.mean < settings.still;
            if share == 1.0 && is_little || energy < NOTHING {
                result.stop = Stop::Converged;
                break;
            }
        }
        result
    }

    /// Moves of a share of a step.
    fn moves(&self, slot: usize, share: f64) -> Moves {
        let moves = &self.directions[slot].moves;
        let squares = || moves.iter().map(|m| m.length_squared());
        let length = |square: f64| share * square.sqrt() / self.shell.size;
        Moves { mean: length(squares().sum::<f64>() / moves.len().max(1) as f64), most: length(squares().fold(0.0, f64::max)) }
    }

    /// The longest share of a step, by halves, that lessens the energy; the pose there is left in the trial.
    fn search(
        &mut self,
        slot: usize,
        x: &[DVec3],
        weights: &[f64],
        goals: &Goals<'_>,
        settings: &Settings,
        before: f64,
    ) -> Option<([f64; 5], f64)> {
        let mut share = 1.0;
        while share >= SHORTEST {
            let (mut moved, mut reweighted) = std::mem::take(&mut self.trials[slot]);
            let direction = &self.directions[slot];
            for ((to, from), step) in moved.iter_mut().zip(x).zip(&direction.moves) {
                *to = *from + share * *step;
            }
            for ((to, from), step) in reweighted.iter_mut().zip(weights).zip(&direction.weights) {
                *to = from + share * step;
            }
            let terms = self.energy(&moved, &reweighted, goals, settings.weights);
            self.trials[slot] = (moved, reweighted);
            if terms.iter().sum::<f64>() < before {
                return Some((terms, share));
            }
            share *= 0.5;
        }
        None
    }

    /// Holds hinges back that are far from the angle that is wanted, at the one they have.
    ///
    /// A deep crease of the skin has several minima, and snaps from one to another while the targets hardly move. Flesh does not. `strength`: share
    /// of the stiffness of a hinge that is [`CREASED`] and more. One that is inside out is not kept so.
    pub fn hold_back(&mut self, x: &[DVec3], weights: &[f64], strength: f64) {
        let shell = &self.shell;
        shell.wanted(weights, &mut self.wanted_lengths, &mut self.wanted_angles);
        let hinges = shell.topology.hinges.iter().zip(&shell.bend);
        for (((hinge, _), wanted), drag) in
            hinges.zip(&self.wanted_angles).zip(&mut self.drags).filter(|(((_, w), _), _)| **w > 0.0)
        {
            let angle = dihedral(x, *hinge);
            let off = (angle - wanted).abs();
            let share = if off > INSIDE_OUT { 0.0 } else { ((off - CREASING) / (CREASED - CREASING)).clamp(0.0, 1.0) };
            *drag = Drag { share: strength * share, angle };
        }
    }

    /// Holds nothing back any longer.
    pub fn release(&mut self) {
        self.drags.fill(Drag::default());
    }

    /// Energy of a pose with everything that is minimized.
    pub fn total(&mut self, x: &[DVec3], weights: &[f64], goals: &Goals<'_>, settings: &Settings) -> f64 {
        self.energy(x, weights, goals, settings.weights).iter().sum()
    }

    /// Energies before the first and after every step of the last minimization.
    pub fn energies(&self) -> &[f64] {
        &self.energies
    }

    /// Energy of the shell alone.
    pub fn resisted(&mut self, x: &[DVec3], weights: &[f64]) -> f64 {
        self.energy(x, weights, &Goals::NONE, Weights::Given).iter().sum()
    }

    /// Energy of a pose by its terms.
    fn energy(&mut self, x: &[DVec3], weights: &[f64], goals: &Goals<'_>, free: Weights) -> [f64; 5] {
        let shell = &self.shell;
        let wanted = shell.wanted(weights, &mut self.wanted_lengths, &mut self.wanted_angles);
        let (mut stretch, mut bend, mut pull) = (0.0, 0.0, 0.0);
        for (([a, b], w), wanted) in shell.topology.edges.iter().zip(&shell.stretch).zip(&self.wanted_lengths) {
            stretch += (w * (x[*a as usize].distance(x[*b as usize]) - wanted)).powi(2);
        }
        let hinges = shell.topology.hinges.iter().zip(&shell.bend);
        for (((hinge, w), wanted), drag) in hinges.zip(&self.wanted_angles).zip(&self.drags).filter(|(((_, w), _), _)| **w > 0.0)
        {
            let angle = dihedral(x, *hinge);
            bend += (w * (angle - wanted)).powi(2) + drag.share * (w * wrapped(angle - drag.angle)).powi(2);
        }
        let swell = if shell.swell > 0.0 {
            (shell.swell * (volume(x, &shell.faces, &shell.topology.holes) - wanted)).powi(2)
        } else {
            0.0
        };
        for (k, (goal, weight)) in goals.positions.iter().zip(goals.weights).enumerate().filter(|(_, (_, w))| **w > 0.0) {
            pull += weight * self.hold(k, x).distance_squared(*goal);
        }
        let drawn = match free {
            Weights::Given => 0.0,
            Weights::Free { regularization, .. } => {
                weights.iter().zip(&shell.examples).map(|(w, e)| regularization * e.curvature * w * w).sum::<f64>()
            }
        };
        [stretch, bend, swell, pull, drawn].map(|twice| 0.5 * twice)
    }

    /// Hinges that are inside out.
    pub fn inside_out<'a>(&'a self, x: &'a [DVec3], weights: &'a [f64]) -> impl Iterator<Item = Hinge> + 'a {
        let shell = &self.shell;
        let is_folded =
            move |h: usize| (dihedral(x, shell.topology.hinges[h]) - shell.wanted_angle(h, weights)).abs() > INSIDE_OUT;
        (0..shell.bend.len()).filter(move |&h| shell.bend[h] > 0.0 && is_folded(h)).map(|h| shell.topology.hinges[h])
    }

    /// Residuals and their derivatives at a pose.
    fn linearize(&mut self, x: &[DVec3], weights: &[f64]) {
        let (shell, at) = (&self.shell, &mut self.at);
        let wanted = shell.wanted(weights, &mut self.wanted_lengths, &mut self.wanted_angles);
        for (e, [a, b]) in shell.topology.edges.iter().enumerate() {
            let along = x[*b as usize] - x[*a as usize];
            let length = along.length();
            at.lengths[e] = length;
            at.stretch[e] = shell.stretch[e] * (length - self.wanted_lengths[e]);
            at.edges[e] = along * (shell.stretch[e] / length.max(f64::MIN_POSITIVE));
        }
        for (h, hinge) in shell.topology.hinges.iter().enumerate() {
            let w = shell.bend[h];
            if w > 0.0 {
                let (angle, gradients) = dihedral_gradient(x, *hinge, shell.floor);
                at.bend[h] = w * (angle - self.wanted_angles[h]);
                at.hinges[h] = gradients.map(|g| g * w);
                at.drags[h] = self.drags[h].share;
                at.drag[h] = self.drags[h].share * w * wrapped(angle - self.drags[h].angle);
            } else {
                at.bend[h] = 0.0;
                at.hinges[h] = [DVec3::ZERO; 4];
            }
        }
        at.swell = 0.0;
        if shell.swell > 0.0 {
            at.swell = shell.swell * (volume(x, &shell.faces, &shell.topology.holes) - wanted);
            volume_gradient(x, &shell.faces, &shell.topology.holes, &mut at.volume);
            at.volume.iter_mut().for_each(|g| *g *= shell.swell);
        }
    }

    /// Where a pull holds a pose.
    fn hold(&self, pull: usize, x: &[DVec3]) -> DVec3 {
        let off = self.offsets[pull].iter().map(|&(face, share)| share * outwards(x, self.shell.faces[face as usize]));
        self.pulls[pull].apply(x) + off.sum::<DVec3>()
    }

    /// Derivatives of the points that are held, and the forces on them.
    fn force(&mut self, x: &[DVec3], goals: &Goals<'_>) {
        for k in 0..self.forces.len() {
            let weight = goals.weights.get(k).copied().unwrap_or(0.0);
            self.forces[k] = if weight > 0.0 { (goals.positions[k] - self.hold(k, x)) * weight } else { DVec3::ZERO };
            if weight <= 0.0 || self.offsets[k].is_empty() {
                continue;
            }
            let (pull, maps) = (&self.pulls[k], &mut self.at.pulls[k]);
            for (map, c) in maps.iter_mut().zip(&pull.values) {
                *map = DMat3::from_diagonal(DVec3::splat(*c));
            }
            for &(face, share) in &self.offsets[k] {
                let face = self.shell.faces[face as usize];
                for (v, derivative) in face.into_iter().zip(outwards_derivative(x, face)) {
                    if let Ok(at) = pull.vertices.binary_search(&v) {
                        maps[at] += share * derivative;
                    }
                }
            }
        }
    }
}

/// Derivatives of [`outwards`] with respect to the corners.
fn outwards_derivative(x: &[DVec3], face: [u32; 3]) -> [DMat3; 3] {
    let normal = double_area(x, face);
    let length = normal.length().max(f64::MIN_POSITIVE);
    let unit = normal / length;
    let across = DMat3::from_cols(unit * unit.x, unit * unit.y, unit * unit.z);
    let root = (DMat3::IDENTITY - across * 0.5) * (1.0 / length.sqrt());
    let [a, b, c] = face.map(|v| x[v as usize]);
    // A change of a corner adds its product with the opposite edge to the normal.
    [c - b, a - c, b - a].map(|edge| root * DMat3::from_cols(edge.cross(DVec3::X), edge.cross(DVec3::Y), edge.cross(DVec3::Z)))
}

/// From the centre of a triangle outwards, as long as the root of twice its area.
pub(super) fn outwards(x: &[DVec3], face: [u32; 3]) -> DVec3 {
    let normal = double_area(x, face);
    normal / normal.length().max(f64::MIN_POSITIVE).sqrt()
}

impl Pull {
    pub fn apply(&self, x: &[DVec3]) -> DVec3 {
        self.vertices.iter().zip(&self.values).map(|(&v, c)| x[v as usize] * *c).sum()
    }
}

#[cfg(test)]
mod derivatives;
