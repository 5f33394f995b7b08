//! Oriented handles: the points that they carry, the vertices that they give, and the turn of the whole body with them.
//!
//! Stoll et al. 2007, §2.3.2: a handle that turns far in one frame turns the rotations of all tetrahedra before the first linear step, by a blend of the
//! handles' turns with harmonic weights. A turn is relative to the estimate before that step, since after it the handle is where it shall be. It is a
//! prediction only: the minimum does not know of it.

use super::elements::{Blocks, Element};
use super::handles::SoftHandles;
use super::{check_handles, matrix};
use crate::deform::{Grip, Handle, OrientedHandle, Placement, Targets};
use crate::error::{Error, Result};
use crate::linalg::lanes::{Lanes, longest};
use crate::linalg::rotation::{self, Quaternions};
use crate::linalg::{Cholesky, SparseRow, nearest_rotation};
use crate::proxy::Proxy;
use glam::{DMat3, DQuat, DVec3};
use std::ops::Range;

/// Keeps the matrix of the harmonic weights definite on parts of the body that no oriented handle reaches; relative to its diagonal.
const UNREACHED: f64 = 1e-12;
/// How firmly the mean weight around a frame is held at 1 or 0, relative to the diagonal of its vertices.
const HELD: f64 = 1e4;
/// Weights lie a little below 0 or above 1 beyond a frame, whose surroundings have them in the mean.
const BEYOND: f64 = 0.25;

pub(super) struct Oriented {
    handles: Vec<Held>,
    placements: Vec<Placement>,
    /// Points that pull.
    points: usize,
    /// Vertices that are given, their rest positions and their last targets.
    given: Vec<u32>,
    given_rest: Vec<DVec3>,
    targets: Vec<Lanes>,
    turning: Vec<Turning>,
}

struct Held {
    name: String,
    carried: Carried,
    /// From its point to each carried one, at rest.
    offsets: Vec<DVec3>,
    /// Whether it holds its surroundings in the mean only, and not vertex by vertex.
    is_frame: bool,
}

/// What a handle carries: soft handles by their numbers, or places in the list of given vertices.
enum Carried {
    Soft(Range<usize>),
    Given(Range<usize>),
}

/// A handle whose turn the body follows.
struct Turning {
    handle: usize,
    /// Harmonic weight in each tetrahedron.
    shares: Vec<Lanes>,
    /// Its turn in this frame.
    turn: DQuat,
}

impl Oriented {
    /// The handles at rest, and the points by which they pull, to be appended to `first` others.
    pub(super) fn new(proxy: &Proxy, handles: &[OrientedHandle], first: usize) -> Result<(Self, Vec<Handle>)> {
        let mut points = Vec::new();
        let mut result = Self {
            handles: Vec::with_capacity(handles.len()),
            placements: Vec::with_capacity(handles.len()),
            points: 0,
            given: Vec::new(),
            given_rest: Vec::new(),
            targets: Vec::new(),
            turning: Vec::new(),
        };
        let mut taken = vec![false; proxy.rest.len()];
        for handle in handles {
            let refuse = |what: String| Error::refused(format!("oriented handle {}: {what}", handle.name));
            if !handle.rest.is_finite() {
                return Err(refuse(format!("its point is {}", handle.rest)));
            }
            let begin = points.len();
            let mut exact = false;
            match &handle.grip {
                Grip::Frame { rows, beta } => {
                    points.extend(rows.iter().map(|row| Handle { name: handle.name.clone(), row: row.clone(), beta: *beta }));
                }
                Grip::Region { vertices, beta } => {
                    check_vertices(vertices, &mut vec![false; proxy.rest.len()]).map_err(refuse)?;
                    let row = |&v: &u32| SparseRow { indices: vec![v], values: vec![1.0] };
                    points.extend(vertices.iter().map(|v| Handle { name: handle.name.clone(), row: row(v), beta: *beta }));
                }
                Grip::Exact { vertices } => {
                    check_vertices(vertices, &mut taken).map_err(refuse)?;
                    result.given.extend(vertices);
                    exact = true;
                }
            }
            check_handles(proxy, &points[begin..])?;
            let (carried, rest): (_, Vec<DVec3>) = if exact {
                let range = result.given_rest.len()..result.given.len();
                let rest: Vec<DVec3> = result.given[range.clone()].iter().map(|&v| proxy.rest[v as usize]).collect();
                result.given_rest.extend(&rest);
                result.targets.extend(rest.iter().map(|p| Lanes::point(*p)));
                (Carried::Given(range), rest)
            } else {
                let rest = points[begin..].iter().map(|h| h.row.apply(&proxy.rest)).collect();
                (Carried::Soft(first + begin..first + points.len()), rest)
            };
            if let (Grip::Frame { .. }, [origin, x, y, z]) = (&handle.grip, rest.as_slice()) {
                let axes = DMat3::from_cols(*x - *origin, *y - *origin, *z - *origin);
                let size = axes.x_axis.length() * axes.y_axis.length() * axes.z_axis.length();
                if axes.determinant().abs() <= 1e-6 * size {
                    return Err(refuse("the ends of its axes lie in one plane with its origin".into()));
                }
            }
            result.placements.push(Placement { position: handle.rest, orientation: DQuat::IDENTITY, presence: 1.0 });
            let offsets = rest.iter().map(|p| *p - handle.rest).collect();
            let is_frame = matches!(handle.grip, Grip::Frame { .. });
            result.handles.push(Held { name: handle.name.clone(), carried, offsets, is_frame });
        }
        result.points = points.len();
        Ok((result, points))
    }

    /// Takes over another numbering of the vertices.
    pub(super) fn renumber(&mut self, places: &[u32]) {
        self.given.iter_mut().for_each(|v| *v = places[*v as usize]);
    }

    pub(super) fn points(&self) -> usize {
        self.points
    }

    pub(super) fn given(&self) -> &[u32] {
        &self.given
    }

    /// Whether given vertices hold the body, with or without a target.
    pub(super) fn holds(&self) -> bool {
        !self.given.is_empty()
    }

    pub(super) fn place(&mut self, placements: &[Placement]) -> Result<()> {
        if placements.len() != self.handles.len() {
            return Err(Error::refused(format!("{} placements for {} oriented handles", placements.len(), self.handles.len())));
        }
        for (handle, p) in self.handles.iter().zip(placements) {
            let usable = p.position.is_finite() && p.orientation.is_finite() && p.orientation.length() > 1e-6;
            if p.presence.is_nan() || p.presence > 0.0 && !usable {
                return Err(Error::refused(format!("the placement of handle {} is {p:?}", handle.name))
                    .expected("a point and a turn, or presence 0"));
            }
        }
        for ((old, new), handle) in self.placements.iter_mut().zip(placements).zip(&self.handles) {
            old.presence = new.presence.clamp(0.0, 1.0);
            if old.presence > 0.0 {
                (old.position, old.orientation) = (new.position, new.orientation.normalize());
                if let Carried::Given(range) = &handle.carried {
                    for (target, offset) in self.targets[range.clone()].iter_mut().zip(&handle.offsets) {
                        *target = Lanes::point(old.position + old.orientation * *offset);
                    }
                }
            }
        }
        Ok(())
    }

    /// Writes the targets of the points that pull.
    pub(super) fn ask(&self, targets: &mut Targets) {
        for (handle, placement) in self.handles.iter().zip(&self.placements) {
            if let Carried::Soft(range) = &handle.carried {
                for (h, offset) in range.clone().zip(&handle.offsets) {
                    targets.positions[h] = placement.position + placement.orientation * *offset;
                    targets.presence[h] = placement.presence;
                }
            }
        }
    }

    /// Puts the given vertices where they shall be; returns how far the farthest moves.
    pub(super) fn put_given(&self, p: &mut [Lanes]) -> f64 {
        let mut farthest = 0.0_f64;
        for (&v, &target) in self.given.iter().zip(&self.targets) {
            farthest = farthest.max(longest(&[target - p[v as usize]]));
            p[v as usize] = target;
        }
        farthest
    }

    /// Targets of the given vertices.
    pub(super) fn targets(&self) -> impl Iterator<Item = Lanes> + '_ {
        self.targets.iter().copied()
    }

    pub(super) fn clear_given(&self, g: &mut [Lanes]) {
        for &v in &self.given {
            g[v as usize] = Lanes::ZERO;
        }
    }

    /// Rest position and target of the given vertices whose handle is present.
    pub(super) fn attachments(&self) -> impl Iterator<Item = (DVec3, DVec3)> + Clone + '_ {
        let present = self.handles.iter().zip(&self.placements).filter(|(_, p)| p.presence > 0.0);
        let ranges = present.filter_map(|(h, _)| match &h.carried {
            Carried::Given(range) => Some(range.clone()),
            Carried::Soft(_) => None,
        });
        ranges.flatten().map(|i| (self.given_rest[i], self.targets[i].xyz()))
    }

    /// Moves the given vertices whose handle is absent.
    pub(super) fn place_absent(&mut self, place: impl Fn(DVec3) -> DVec3) {
        for (handle, _) in self.handles.iter().zip(&self.placements).filter(|(_, p)| p.presence == 0.0) {
            if let Carried::Given(range) = &handle.carried {
                for i in range.clone() {
                    self.targets[i] = Lanes::point(place(self.given_rest[i]));
                }
            }
        }
    }

    /// Computes the harmonic weights: 1 on the vertices of a handle, 0 on those of the others; around frames in the mean, as these hold the body: a twist
    /// between two frames begins within their surroundings.
    pub(super) fn share(
        &mut self,
        elements: &[Element],
        held: &[Element],
        handles: &[Handle],
        size: usize,
        blocks: &Blocks,
    ) -> Result<()> {
        let turning: Vec<usize> = (0..self.handles.len()).filter(|&h| spans_a_plane(&self.handles[h].offsets)).collect();
        if turning.len() < 2 {
            return Ok(());
        }
        let vertices = |h: usize| -> Vec<u32> {
            match &self.handles[h].carried {
                Carried::Soft(_) if self.handles[h].is_frame => Vec::new(),
                Carried::Given(range) => self.given[range.clone()].to_vec(),
                Carried::Soft(range) => {
                    let terms = handles[range.clone()].iter().flat_map(|h| h.row.indices.iter().zip(&h.row.values));
                    let mut vertices: Vec<u32> = terms.filter(|(_, b)| **b != 0.0).map(|(&v, _)| v).collect();
                    vertices.sort_unstable();
                    vertices.dedup();
                    vertices
                }
            }
        };
        let sets: Vec<Vec<u32>> = turning.iter().map(|&h| vertices(h)).collect();
        let mut owners = vec![0.0; size];
        sets.iter().flatten().for_each(|&v| owners[v as usize] += 1.0);
        let fixed: Vec<bool> = owners.iter().map(|&n| n > 0.0).collect();
        let all: Vec<Element> = elements.iter().chain(held).map(|e| Element { weight: e.capped, ..e.clone() }).collect();
        let mut anchors = vec![0.0; size];
        for e in &all {
            for (&v, g) in e.corners.iter().zip(&e.gradients) {
                anchors[v as usize] += UNREACHED * e.capped * g.length_squared();
            }
        }
        let free = |v: &usize| !fixed[*v];
        let anchor =
            |v: usize| Handle { name: String::new(), row: SparseRow { indices: vec![v as u32], values: vec![1.0] }, beta: 1.0 };
        let mut anchored: Vec<Handle> = (0..size).filter(free).map(anchor).collect();
        let mut weights: Vec<f64> = (0..size).filter(free).map(|v| anchors[v]).collect();
        // The mean around each frame, and how firmly it is held.
        let means: Vec<Option<(SparseRow, f64)>> = turning
            .iter()
            .map(|&h| match &self.handles[h].carried {
                Carried::Soft(range) if self.handles[h].is_frame => {
                    let row = &handles[range.start].row;
                    let total: f64 = row.values.iter().map(|b| b.abs()).sum();
                    let values: Vec<f64> = row.values.iter().map(|b| b.abs() / total).collect();
                    let diagonal = row.indices.iter().map(|&v| anchors[v as usize] / UNREACHED).fold(0.0, f64::max);
                    Some((SparseRow { indices: row.indices.clone(), values }, HELD * diagonal))
                }
                _ => None,
            })
            .collect();
        for (row, weight) in means.iter().flatten() {
            anchored.push(Handle { name: String::new(), row: row.clone(), beta: 1.0 });
            weights.push(*weight);
        }
        let factor = Cholesky::factor(&matrix(&fixed, &all, &anchored, &weights))
            .map_err(|reason| Error::refused(format!("no harmonic weights for the oriented handles: {reason}")))?;
        for (chunk, (four, sets)) in turning.chunks(4).zip(sets.chunks(4)).enumerate() {
            let mut values = vec![Lanes::ZERO; size];
            for (lane, set) in sets.iter().enumerate() {
                set.iter().for_each(|&v| values[v as usize].0[lane] = 1.0 / owners[v as usize]);
            }
            let mut x = vec![Lanes::ZERO; size];
            for e in &all {
                for (&a, ga) in e.corners.iter().zip(&e.gradients).filter(|(a, _)| !fixed[**a as usize]) {
                    for (&b, gb) in e.corners.iter().zip(&e.gradients).filter(|(b, _)| fixed[**b as usize]) {
                        x[a as usize] -= values[b as usize] * (e.weight * ga.dot(*gb));
                    }
                }
            }
            for (h, (row, weight)) in means.iter().enumerate().filter_map(|(h, mean)| Some((h, mean.as_ref()?))) {
                let mut lack = Lanes::ZERO;
                if h / 4 == chunk {
                    lack.0[h % 4] = 1.0;
                }
                let terms = || row.indices.iter().map(|&v| v as usize).zip(&row.values);
                terms().filter(|(v, _)| fixed[*v]).for_each(|(v, b)| lack -= values[v] * *b);
                terms().filter(|(v, _)| !fixed[*v]).for_each(|(v, b)| x[v] += lack * (weight * b));
            }
            factor.solve(&mut x);
            (0..size).filter(|&v| fixed[v]).for_each(|v| x[v] = values[v]);
            for (lane, &handle) in four.iter().enumerate() {
                let mean =
                    |corners: &[[u32; 4]; 4], l: usize| corners.iter().map(|c| x[c[l] as usize].0[lane]).sum::<f64>() / 4.0;
                let shares =
                    blocks.list.iter().map(|b| Lanes(std::array::from_fn(|l| mean(&b.corners, l).clamp(-BEYOND, 1.0 + BEYOND))));
                let mut shares: Vec<Lanes> = shares.collect();
                for range in blocks.groups() {
                    let (mut sum, mut total) = (0.0, 0.0);
                    for (i, e) in elements[4 * range.start..4 * range.end].iter().enumerate() {
                        sum += e.weight * shares[range.start + i / 4].0[i % 4];
                        total += e.weight;
                    }
                    shares[range.clone()].fill(Lanes::splat(sum / total));
                }
                self.turning.push(Turning { handle, shares, turn: DQuat::IDENTITY });
            }
        }
        Ok(())
    }

    /// Turns the rotations by the blend of the handles' turns from where they are in `p`, if one turns by more than `above`.
    pub(super) fn turn_with_handles(
        &mut self,
        blocks: &Blocks,
        soft: &SoftHandles,
        p: &[Lanes],
        rotations: &mut [Quaternions],
        above: f64,
    ) -> bool {
        let mut farthest = 0.0_f64;
        for i in 0..self.turning.len() {
            let h = self.turning[i].handle;
            let placement = self.placements[h];
            let mut turn = DQuat::IDENTITY;
            if placement.presence > 0.0 {
                turn = placement.orientation * self.estimate(h, soft, p).inverse();
                // The shorter way round; sums of such quaternions have no trouble with their signs.
                turn = if turn.w < 0.0 { -turn } else { turn };
            }
            farthest = farthest.max(2.0 * turn.xyz().length().atan2(turn.w));
            self.turning[i].turn = turn;
        }
        if self.turning.is_empty() || farthest.is_nan() || farthest <= above {
            return false;
        }
        debug_assert_eq!(blocks.list.len(), rotations.len());
        for (b, q) in rotations.iter_mut().enumerate() {
            for lane in 0..4 {
                let (mut blend, mut rest) = (DQuat::from_xyzw(0.0, 0.0, 0.0, 0.0), 1.0);
                for t in &self.turning {
                    let share = t.shares[b].0[lane];
                    blend += t.turn * share;
                    rest -= share;
                }
                blend = (blend + DQuat::IDENTITY * rest).normalize();
                let old = rotation::lane(q, lane);
                rotation::set_lane(q, lane, (blend * old).normalize());
            }
        }
        true
    }

    /// The turn from rest that brings the points of a handle nearest to where they are.
    fn estimate(&self, h: usize, soft: &SoftHandles, p: &[Lanes]) -> DQuat {
        let handle = &self.handles[h];
        let point = |i: usize| match &handle.carried {
            Carried::Soft(range) => soft.apply(range.start + i, p).xyz(),
            Carried::Given(range) => p[self.given[range.start + i] as usize].xyz(),
        };
        let count = handle.offsets.len();
        let centre = (0..count).map(point).sum::<DVec3>() / count as f64;
        let rest = handle.offsets.iter().sum::<DVec3>() / count as f64;
        let mut covariance = DMat3::ZERO;
        for (i, offset) in handle.offsets.iter().enumerate() {
            let (a, t) = (*offset - rest, point(i) - centre);
            covariance += DMat3::from_cols(t * a.x, t * a.y, t * a.z);
        }
        DQuat::from_mat3(&nearest_rotation(covariance, DMat3::IDENTITY)).normalize()
    }
}

fn check_vertices(vertices: &[u32], taken: &mut [bool]) -> Result<(), String> {
    if vertices.is_empty() {
        return Err("it holds no vertex".into());
    }
    for &v in vertices {
        let size = taken.len();
        match taken.get_mut(v as usize) {
            None => return Err(format!("it holds vertex {v} of a proxy with {size}")),
            Some(taken) if *taken => return Err(format!("vertex {v} is held twice")),
            Some(taken) => *taken = true,
        }
    }
    Ok(())
}

/// Whether points tell a turn: they do not all lie on a line.
fn spans_a_plane(points: &[DVec3]) -> bool {
    let Some(&origin) = points.first() else { return false };
    let farthest = points.iter().map(|p| *p - origin).fold(DVec3::ZERO, |m, d| if d.length() > m.length() { d } else { m });
    points.iter().any(|p| (*p - origin).cross(farthest).length() > 1e-6 * farthest.length_squared())
}
