//! The volumetric deformer: tetrahedra that want to stay as they are, up to a rotation each, pulled by handles.
//!
//! It minimises, over positions p and one rotation per tetrahedron,
//!
//! ```text
//! E(p, R) = Σ_j w_j ( |F_j(p) − R_j|² + κ (det F_j(p) − 1)² + 4 κ min(0, det F_j(p) − ¼)² )  +  Σ_h a_h |b_h p − c_h|²,     w_j = stiffness_j · volume_j
//! ```
//!
//! The terms with κ ([`Options::bulk`]) keep the volume, and more so in folds, which the last frame holds back besides while the targets move; the source
//! has nothing of that, and with κ = 0 the energy is the source's.
//! Both saturate: a square g² counts as g² / (1 + g²/4); in slivers the first counts less.
//!
//! Source: Stoll, de Aguiar, Theobalt, Seidel: *A volumetric approach to interactive shape editing*, MPI-I-2007-4-004. Their alternation of a linear
//! solve and a rotation update is [`Options::iterations`]; two or three of them lag visibly behind the handles, so the default runs to the minimum: it
//! predicts linearly, completes the linear step by a coarse level, accelerates and never lets the energy rise.

mod anderson;
#[cfg(test)]
mod bodies;
mod calibration;
mod coarse;
mod descent;
mod drag;
mod elements;
#[cfg(test)]
mod handle_laws;
mod handles;
#[cfg(test)]
mod laws;
mod lead;
mod oriented;
#[cfg(test)]
mod oriented_laws;
#[cfg(test)]
mod precision;
#[cfg(test)]
mod recovery;
#[cfg(test)]
pub(crate) mod stored_poses;
#[cfg(test)]
mod wild;

use super::{Deformer, ERROR_PER_STEP, FrameStats, Handle, OrientedHandle, Placement, Targets};
use crate::disjoint::DisjointSets;
use crate::error::{Error, Result};
use crate::linalg::lanes::{Lanes, longest};
use crate::linalg::rotation::{self, Quaternions};
use crate::linalg::{Cholesky, SparseRow, SymmetricMatrix, elimination_order, nearest_rotation};
use crate::proxy::Proxy;
use coarse::Coarse;
use descent::{Memory, Settings};
use drag::Drag;
use elements::{Blocks, Element};
use glam::{DMat3, DQuat, DVec3};
use handles::{Presence, SoftHandles};
use lead::Lead;
use oriented::Oriented;

/// How the deformer solves.
#[derive(Clone, Debug)]
pub struct Options {
    /// A frame ends when the pose is within about twenty times this of the minimum, in diagonals of the rest box: when no vertex moves farther than this in
    /// a step, or less far where parts hang on few handles.
    pub tolerance: f64,
    /// Exactly this many plain iterations per frame, warm, without prediction, coarse level and acceleration: the paper's way. `None`: to the tolerance.
    pub iterations: Option<u32>,
    /// With a fixed count of iterations: so many Newton steps of the rotations in each, warm from the one before; `None`: to rounding. One costs a third and
    /// is as near to the minimum after as many iterations.
    pub rotation_steps: Option<u32>,
    /// Stiffness of each tetrahedron of the proxy, relative to the body; empty: 1 everywhere.
    pub stiffness: Vec<f64>,
    /// Sets of tetrahedra of the proxy that move like a rigid body each: they share one rotation and are a hundred times as stiff. A set may consist of
    /// parts that do not touch. Flat tetrahedra count for nothing.
    pub rigid: Vec<Vec<u32>>,
    /// When an oriented handle turns farther than this in one frame, radians, and there are at least two, the rotations of the whole body are first
    /// turned by a harmonic blend of the handles' turns. Changes only where the frame begins. `f64::INFINITY`: never.
    pub interpolate_above: f64,
    /// κ, the weight of the change of volume; 0 with a fixed count of iterations. Without it a body in a deep squat loses 8 % of its volume and is
    /// folded for a second, with 1 it loses 4.9 %, with 1.4 4.3 % without a fold, for about 1.5 times the passes.
    pub bulk: f64,
    /// Slivers are as stiff as this many medians at most. `f64::INFINITY` leaves them as they are.
    pub sliver_cap: f64,
}

/// Hardness of a handle with beta 1 that sits on one vertex, in entries of that vertex in the matrix. With half of it the markers of real takes stay at
/// 0.7 to 1 mm (medians) instead of 0.4 to 0.55; neither volume nor folds tell the difference.
const FIRM: f64 = 2.0;

/// Mean distance of the targets from where the handles would be by their motion so far, in diagonals, from which the take was cut there: a body at
/// thirty frames a second does not change its speed by that much.
const CUT: f64 = 0.25;

impl Options {
    /// Tolerance for a preview: 99 % of the errors below half a thousandth of the body.
    pub const DRAFT: f64 = 5e-5;
    /// The default tolerance: 99 % of the errors below a ten-thousandth of the body.
    pub const NORMAL: f64 = 4e-6;
    /// Tolerance for poses that are compared with others: errors around a millionth of the body.
    pub const CONVERGED: f64 = 1e-7;

    fn effective_bulk(&self) -> f64 {
        if self.iterations.is_some() { 0.0 } else { self.bulk }
    }
}

impl Default for Options {
    fn default() -> Self {
        Self {
            tolerance: Self::NORMAL,
            iterations: None,
            rotation_steps: None,
            stiffness: Vec::new(),
            rigid: Vec::new(),
            interpolate_above: std::f64::consts::FRAC_PI_6,
            bulk: 1.4,
            sliver_cap: 30.0,
        }
    }
}

/// The deformer of a tetrahedral proxy. Memory is reserved at set-up; a frame allocates nothing.
pub struct Volumetric {
    settings: Settings,
    blocks: Blocks,
    /// Names of the point handles, then of the points of oriented ones.
    names: Vec<String>,
    handles: SoftHandles,
    oriented: Oriented,
    /// Targets of all handles in one list.
    asked: Targets,
    factor: Cholesky,
    coarse: Coarse,
    drag: Drag,
    lead: Lead,
    /// Rest positions in elimination order, and the attachment of each handle on them.
    rest: Vec<Lanes>,
    attachments: Vec<DVec3>,
    /// Place of each vertex of the proxy in elimination order.
    places: Vec<u32>,
    /// The last pose and the one before, in elimination order.
    p: Vec<Lanes>,
    before: Vec<Lanes>,
    rotations: Vec<Quaternions>,
    /// Consecutive frames solved since the last start or hold: two give a velocity.
    frames: u32,
    memory: Memory,
    pose: Vec<DVec3>,
    last: FrameStats,
}

impl Volumetric {
    /// Sets up: gradients, matrix, factor, release of handles, clusters.
    ///
    /// # Errors
    /// [`crate::error::Kind::Refused`] when a component of the proxy has no handle, when a handle or a stiffness is not usable, or when the proxy
    /// has vertices on flat tetrahedra only.
    pub fn new(proxy: &Proxy, handles: &[Handle], options: &Options) -> Result<Self> {
        Self::with_oriented(proxy, handles, &[], options)
    }

    /// As [`Self::new`], with oriented handles besides; they begin at rest, see [`Deformer::place`]. Those that hold by [`Grip::Exact`] are eliminated
    /// from the linear systems; the others add rows to them.
    ///
    /// [`Grip::Exact`]: super::Grip::Exact
    ///
    /// # Errors
    /// As [`Self::new`]; also when a grip names a vertex twice or one that is not there.
    pub fn with_oriented(proxy: &Proxy, handles: &[Handle], oriented: &[OrientedHandle], options: &Options) -> Result<Self> {
        if !(options.bulk >= 0.0 && options.bulk.is_finite()) {
            return Err(Error::refused(format!("bulk {}", options.bulk)).expected("a number that is not negative"));
        }
        if options.interpolate_above.is_nan() {
            return Err(Error::refused("the angle above which rotations are interpolated is not a number"));
        }
        let elements = elements::elements(proxy, options)?;
        let (oriented, points) = Oriented::new(proxy, oriented, handles.len())?;
        let handles = [handles, &points].concat();
        check_handles(proxy, &handles)?;
        // Hardness is relative to the body without its stiffer parts: a handle on a stiff part is not stiffer for it.
        let mut largest = vec![0.0; proxy.rest.len()];
        for e in &elements {
            for (&v, g) in e.corners.iter().zip(&e.gradients) {
                largest[v as usize] += e.capped * g.length_squared();
            }
        }
        let hardness = |row: &SparseRow| {
            let each = row.indices.iter().zip(&row.values).map(|(&v, c)| largest[v as usize] * c.abs());
            FIRM * each.sum::<f64>()
        };
        let weights = handles.iter().map(|h| h.beta * hardness(&h.row)).collect();
        Self::assemble(proxy, elements, &handles, weights, oriented, options)
    }

    /// As [`Self::with_oriented`], with the weight of each handle in the energy as it is, in place of its hardness.
    ///
    /// # Errors
    /// As [`Self::with_oriented`]; also when there is not one positive weight per handle, or an oriented handle does not hold by [`Grip::Exact`].
    ///
    /// [`Grip::Exact`]: super::Grip::Exact
    pub fn with_weights(
        proxy: &Proxy,
        handles: &[Handle],
        weights: &[f64],
        oriented: &[OrientedHandle],
        options: &Options,
    ) -> Result<Self> {
        let (oriented, points) = Oriented::new(proxy, oriented, handles.len())?;
        if weights.len() != handles.len() || !points.is_empty() || weights.iter().any(|w| !(*w > 0.0 && w.is_finite())) {
            return Err(Error::refused(format!("{} weights for {} handles", weights.len(), handles.len() + points.len()))
                .expected("a positive number for each, and oriented handles that hold exactly"));
        }
        check_handles(proxy, handles)?;
        Self::assemble(proxy, elements::elements(proxy, options)?, handles, weights.to_vec(), oriented, options)
    }

    fn assemble(
        proxy: &Proxy,
        mut elements: Vec<Element>,
        handles: &[Handle],
        weights: Vec<f64>,
        mut oriented: Oriented,
        options: &Options,
    ) -> Result<Self> {
        check_components(proxy, &elements, handles, oriented.given())?;
        if !(options.tolerance > 0.0 && options.tolerance.is_finite()) {
            return Err(Error::refused(format!("tolerance {}", options.tolerance)).expected("a positive number"));
        }
        let size = proxy.rest.len();
        let groups = elements.iter().map(|e| e.corners.as_slice()).chain(handles.iter().map(|h| h.row.indices.as_slice()));
        let order = elimination_order(size, groups);
        let mut places = vec![0; size];
        for (place, &v) in order.iter().enumerate() {
            places[v as usize] = place as u32;
        }
        let rest: Vec<DVec3> = order.iter().map(|&v| proxy.rest[v as usize]).collect();
        for element in &mut elements {
            element.corners = element.corners.map(|v| places[v as usize]);
        }
        oriented.renumber(&places);
        let mut given = vec![false; size];
        oriented.given().iter().for_each(|&v| given[v as usize] = true);
        let all_given = |e: &Element| e.corners.iter().all(|&v| given[v as usize]);
        // What is given altogether costs nothing; only when nothing else is left it stays, so that there is something to solve.
        let (held, elements): (Vec<_>, Vec<_>) =
            if elements.iter().all(all_given) { (Vec::new(), elements) } else { elements.into_iter().partition(all_given) };
        let elements = elements::arrange(elements);
        let attachments = handles.iter().map(|h| h.row.apply(&proxy.rest)).collect();
        let handles: Vec<Handle> = handles
            .iter()
            .map(|h| {
                let indices = h.row.indices.iter().map(|&v| places[v as usize]).collect();
                Handle { row: SparseRow { indices, values: h.row.values.clone() }, ..h.clone() }
            })
            .collect();
        let matrix = matrix(&given, &elements, &handles, &weights);
        let factor = Cholesky::factor(&matrix).map_err(|reason| {
            Error::refused(format!("the handles do not hold the proxy: {reason}"))
                .hint("handles of more moderate hardness, or a proxy without flat tetrahedra")
        })?;
        let blocks = Blocks::new(&elements, &held, options.effective_bulk());
        let names = handles.iter().map(|h| h.name.clone()).collect();
        oriented.share(&elements, &held, &handles, size, &blocks)?;
        let handles = SoftHandles::new(&handles, weights, &given, &factor);
        let coarse = Coarse::new(&elements, &rest, oriented.given(), &blocks, &handles, &factor);
        let (lo, hi) = rest.iter().fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(lo, hi), p| (lo.min(*p), hi.max(*p)));
        let points: Vec<Lanes> = rest.iter().map(|p| Lanes::point(*p)).collect();
        let last = FrameStats { converged: true, volume_ratio: 1.0, ..Default::default() };
        let mut made = Self {
            settings: Settings {
                tolerance: options.tolerance,
                error_per_step: ERROR_PER_STEP,
                diagonal: (hi - lo).length(),
                iterations: options.iterations,
                rotation_steps: options.rotation_steps,
                interpolate_above: options.interpolate_above,
            },
            names,
            asked: Targets { positions: vec![DVec3::ZERO; handles.len()], presence: vec![0.0; handles.len()] },
            oriented,
            rotations: vec![rotation::IDENTITY; blocks.list.len()],
            memory: Memory::new(size, handles.len(), blocks.list.len(), options.iterations),
            p: points.clone(),
            before: points.clone(),
            rest: points,
            pose: proxy.rest.clone(),
            frames: 0,
            drag: Drag::new(&blocks, options.effective_bulk()),
            lead: Lead::new(handles.len() + given.iter().filter(|given| **given).count()),
            blocks,
            handles,
            factor,
            coarse,
            attachments,
            places,
            last,
        };
        if options.iterations.is_none() {
            made.settings.error_per_step = made.error_per_step(&elements);
        }
        Ok(made)
    }

    /// Energy after each accepted step of the last frame, with that of the drag on folds, from its beginning. Never rises, but for rounding.
    pub fn energies(&self) -> &[f64] {
        &self.memory.energies
    }

    fn solve(&mut self, targets: &Targets, cold: bool) -> Result<FrameStats> {
        let count = self.handles.len() - self.oriented.points();
        assert!(targets.positions.len() == count && targets.presence.len() == count, "one target per handle");
        for ((name, position), presence) in self.names.iter().zip(&targets.positions).zip(&targets.presence) {
            if presence.is_nan() || *presence > 0.0 && !position.is_finite() {
                return Err(Error::refused(format!("the target of handle {name} is {position} with presence {presence}"))
                    .expected("a point, or presence 0"));
            }
        }
        self.asked.positions[..count].copy_from_slice(&targets.positions);
        self.asked.presence[..count].copy_from_slice(&targets.presence);
        self.oriented.ask(&mut self.asked);
        let presence = self.handles.take(&self.asked, self.oriented.holds());
        match presence {
            Presence::Nobody => {
                self.frames = self.frames.min(1);
                return Ok(self.hold());
            }
            Presence::Changed => self.coarse.rehandle(&self.handles),
            Presence::Same => {}
        }
        let soft = (0..self.handles.len()).map(|h| (self.handles.target(h), self.handles.present_weight(h) > 0.0));
        self.lead.follow(soft.chain(self.oriented.targets().map(|target| (target, true))));
        let lost = !cold && self.settings.iterations.is_none() && self.is_inside_out();
        let starts = cold || self.frames == 0 || lost || self.jumps();
        if starts {
            self.align();
        } else if presence == Presence::Same && self.stays() {
            return Ok(self.hold());
        }
        let mut stats = self.frame();
        if starts && !stats.converged {
            // A start far away may take more than one frame's passes; a film begins with it.
            let passes = stats.passes;
            stats = self.frame();
            stats.passes += passes;
        }
        if !self.is_finite(&stats) {
            self.align();
            stats = self.frame();
            stats.recovered = true;
            if !self.is_finite(&stats) {
                self.align();
                self.write_pose();
                return Err(Error::refused("the pose is not finite").expected("targets within reach of the body"));
            }
        }
        stats.recovered |= lost;
        self.frames = self.frames.saturating_add(1).min(2);
        self.write_pose();
        self.last = stats;
        Ok(stats)
    }

    /// Whether the last pose is the answer once more: the same targets, and it hardly changed with them.
    fn stays(&self) -> bool {
        let close = ERROR_PER_STEP * self.settings.tolerance * self.settings.diagonal;
        self.settings.iterations.is_none()
            && self.lead.is_still()
            && self.last.converged
            && self.p.iter().zip(&self.before).all(|(now, before)| longest(&[*now - *before]) < close)
    }

    /// A frame without any handle, or without anything new: the pose stays.
    fn hold(&mut self) -> FrameStats {
        self.before.copy_from_slice(&self.p);
        self.memory.energies.clear();
        FrameStats { passes: 0, step: 0.0, converged: true, recovered: false, ..self.last }
    }

    fn is_finite(&self, stats: &FrameStats) -> bool {
        stats.energy.is_finite() && stats.step.is_finite() && self.p.iter().all(|p| p.xyz().is_finite())
    }

    /// Whether the targets are elsewhere than where the last frames lead: a cut in the take.
    fn jumps(&self) -> bool {
        if self.settings.iterations.is_some() {
            return false;
        }
        let distance = self.handles.mean_distance(|place| {
            let now = self.p[place];
            if self.frames < 2 { now } else { now * 2.0 - self.before[place] }
        });
        distance > CUT * self.settings.diagonal
    }

    /// The rest pose, moved rigidly so that the attachments come nearest to the present targets: a start.
    fn align(&mut self) {
        let (turn, from, to) = self.lie_at_rest();
        self.before.copy_from_slice(&self.p);
        let attachments = &self.attachments;
        self.handles.place_absent(|h, _| Lanes::point(turn * (attachments[h] - from) + to));
        self.oriented.place_absent(|p| turn * (p - from) + to);
        self.frames = 0;
    }

    /// Positions and rotations of that pose: a turn about a point, and where that goes.
    fn lie_at_rest(&mut self) -> (DMat3, DVec3, DVec3) {
        let present = |h: usize| (self.handles.present_weight(h), self.attachments[h], self.handles.target(h).xyz());
        let (mut total, mut from, mut to) = (0.0, DVec3::ZERO, DVec3::ZERO);
        let soft = (0..self.handles.len()).map(present).filter(|(w, ..)| *w > 0.0);
        // Given vertices say where the body is; beside them points that pull count little.
        let given = 100.0 * self.handles.largest_weight();
        let all = || soft.clone().chain(self.oriented.attachments().map(|(a, t)| (given, a, t)));
        for (w, a, t) in all() {
            total += w;
            from += a * w;
            to += t * w;
        }
        let (from, to) = (from / total, to / total);
        let mut covariance = DMat3::ZERO;
        for (w, a, t) in all() {
            let (a, t) = ((a - from) * w, t - to);
            covariance += DMat3::from_cols(t * a.x, t * a.y, t * a.z);
        }
        let turn = nearest_rotation(covariance, DMat3::IDENTITY);
        for (p, rest) in self.p.iter_mut().zip(&self.rest) {
            *p = Lanes::point(turn * (rest.xyz() - from) + to);
        }
        let quaternion = DQuat::from_mat3(&turn).normalize();
        for q in &mut self.rotations {
            for lane in 0..4 {
                rotation::set_lane(q, lane, quaternion);
            }
        }
        (turn, from, to)
    }

    fn write_pose(&mut self) {
        for (pose, &place) in self.pose.iter_mut().zip(&self.places) {
            *pose = self.p[place as usize].xyz();
        }
    }
}

impl Deformer for Volumetric {
    fn start(&mut self, targets: &Targets) -> Result<FrameStats> {
        self.solve(targets, true)
    }

    fn step(&mut self, targets: &Targets) -> Result<FrameStats> {
        self.solve(targets, false)
    }

    fn place(&mut self, placements: &[Placement]) -> Result<()> {
        self.oriented.place(placements)
    }

    fn pose(&self) -> &[DVec3] {
        &self.pose
    }
}

/// `L + Bᵀ W B` (Stoll et al. 2007, (2.4)).
///
/// Rows and columns of given vertices are those of the identity: with zeros there in a right side they have no part in the solution.
fn matrix(given: &[bool], elements: &[Element], handles: &[Handle], weights: &[f64]) -> SymmetricMatrix {
    let mut entries = Vec::with_capacity(10 * elements.len());
    for e in elements {
        for (i, (&a, ga)) in e.corners.iter().zip(&e.gradients).enumerate() {
            for (&b, gb) in e.corners.iter().zip(&e.gradients).take(i + 1) {
                entries.push((a, b, e.weight * ga.dot(*gb)));
            }
        }
    }
    for (handle, &weight) in handles.iter().zip(weights) {
        let terms = || handle.row.indices.iter().zip(&handle.row.values);
        for (i, (&a, x)) in terms().enumerate() {
            for (&b, y) in terms().take(i + 1) {
                entries.push((a, b, weight * x * y));
            }
        }
    }
    if given.contains(&true) {
        entries.retain(|&(a, b, _)| !given[a as usize] && !given[b as usize]);
        entries.extend((0_u32..).zip(given).filter(|(_, given)| **given).map(|(v, _)| (v, v, 1.0)));
    }
    SymmetricMatrix::assemble(given.len(), &entries)
}

pub(super) fn check_handles(proxy: &Proxy, handles: &[Handle]) -> Result<()> {
    for handle in handles {
        let refuse = |what: String| Err(Error::refused(format!("handle {}: {what}", handle.name)));
        if !(handle.beta.is_finite() && handle.beta > 0.0) {
            return refuse(format!("hardness {}", handle.beta));
        }
        if handle.row.indices.len() != handle.row.values.len() || handle.row.values.iter().any(|v| !v.is_finite()) {
            return refuse("its row is broken".into());
        }
        if let Some(v) = handle.row.indices.iter().find(|&&v| v as usize >= proxy.rest.len()) {
            return refuse(format!("it sits on vertex {v} of a proxy with {}", proxy.rest.len()));
        }
        let sum: f64 = handle.row.values.iter().sum();
        if sum.is_nan() || (sum - 1.0).abs() > 1e-3 {
            return refuse(format!("the coefficients of its row sum to {sum}, not to 1"));
        }
    }
    Ok(())
}

/// Every vertex hangs on a tetrahedron, and every connected part on a handle.
fn check_components(proxy: &Proxy, elements: &[Element], handles: &[Handle], given: &[u32]) -> Result<()> {
    if elements.is_empty() {
        return Err(Error::refused("the proxy has no tetrahedra with volume"));
    }
    let mut sets = DisjointSets::new(proxy.rest.len());
    let mut used = vec![false; proxy.rest.len()];
    for e in elements {
        for v in e.corners {
            used[v as usize] = true;
            sets.unite(e.corners[0], v);
        }
    }
    if let Some(v) = used.iter().position(|used| !used) {
        return Err(Error::refused(format!(
            "vertex {v} of the proxy at {} belongs to no tetrahedron with volume",
            proxy.rest[v]
        )));
    }
    let mut held = vec![false; proxy.rest.len()];
    for handle in handles {
        for (&v, _) in handle.row.indices.iter().zip(&handle.row.values).filter(|(_, b)| **b != 0.0) {
            held[sets.find(v) as usize] = true;
        }
    }
    for &v in given {
        held[sets.find(v) as usize] = true;
    }
    let roots: Vec<u32> = (0..proxy.rest.len() as u32).filter(|&v| sets.find(v) == v).collect();
    let Some(number) = roots.iter().position(|&v| !held[v as usize]) else { return Ok(()) };
    let free = roots[number];
    let members: Vec<usize> = (0..proxy.rest.len()).filter(|&v| sets.find(v as u32) == free).collect();
    let centre = members.iter().map(|&v| proxy.rest[v]).sum::<DVec3>() / members.len() as f64;
    let count = elements.iter().filter(|e| sets.find(e.corners[0]) == free).count();
    Err(Error::refused(format!(
        "no handle holds component {} of {} of the proxy: {count} tetrahedra around {centre:.3} in the unit box",
        number + 1,
        roots.len()
    ))
    .expected("at least one handle on every component")
    .hint("a marker on it, or a scan without the loose part"))
}
