//! Parting of what touches or overlaps: the skin is moved, as little and as smoothly as it can, until there is air between the sides.
//!
//! The tetrahedra are made in that pose and carried back to the scan's. There they overlap as the scan does, but each belongs to its own limb.

use super::contacts::{Contact, Skin, WayOut};
use crate::spatial::TriangleTree;
use glam::DVec3;

/// Width of the gap that is made, as a share of the diagonal.
const CLEARANCE: f64 = 0.01;
/// Rounds of looking for contacts and moving the skin.
const ROUNDS: usize = 16;
/// Weight of a contact relative to that of an edge.
const CONTACT: f64 = 10.0;
/// Weight of staying in place relative to that of an edge: just enough that the body as a whole does not drift.
const STAY: f64 = 1e-5;
/// The conjugate gradients end when the residual is this much smaller than the right side.
const ACCURACY: f64 = 1e-4;
/// Most steps of the conjugate gradients.
const STEPS: usize = 600;
/// Sweeps that carry displacements inwards.
const SWEEPS: usize = 200;
/// Where fewer of the vertices inside another part have a nearest way out, as a share of those that have one with their neighbours, the nearest
/// ways lead to the wrong side. (Feet of a man turned in by 12 degrees: 136 of 338.)
const LOST: f64 = 0.6;
/// Fewer contacts are noise.
const FEWEST: usize = 3;

/// A pose in which the parts of a body are apart.
pub(super) struct Parted {
    /// Displacement of each vertex of the skin.
    pub(super) shift: Vec<DVec3>,
    /// Vertices in contact in the scan's pose.
    pub(super) contacts: usize,
    /// Longest way out of an overlap in the scan's pose.
    pub(super) depth: f64,
}

/// Parts what touches; `None` where nothing does. `close` makes the closed surface of a pose.
///
/// Each vertex leaves by the nearest way. Of limbs that go through each other so far that many vertices find none, or that they are stuck then, all
/// leave together.
pub(super) fn part(skin: &Skin<'_>, rest: &[DVec3], close: impl Fn(&[DVec3]) -> TriangleTree) -> Option<Parted> {
    let whole = close(rest);
    let inside = |way_out: WayOut| skin.contacts(rest, &whole, way_out).iter().filter(|c| c.gap < 0.0).count();
    let (alone, together) = (inside(WayOut::Nearest), inside(WayOut::Together));
    if (alone as f64) < LOST * together as f64 {
        return part_by(skin, rest, &close, WayOut::Together);
    }
    let nearest = part_by(skin, rest, &close, WayOut::Nearest)?;
    let posed: Vec<DVec3> = rest.iter().zip(&nearest.shift).map(|(p, u)| *p + *u).collect();
    let stuck = skin.contacts(&posed, &close(&posed), WayOut::Together).iter().any(|c| c.gap < 0.0);
    if stuck { part_by(skin, rest, &close, WayOut::Together) } else { Some(nearest) }
}

fn part_by(skin: &Skin<'_>, rest: &[DVec3], close: impl Fn(&[DVec3]) -> TriangleTree, way_out: WayOut) -> Option<Parted> {
    let mut parted = Parted { shift: vec![DVec3::ZERO; rest.len()], contacts: 0, depth: 0.0 };
    let mut held: Vec<Option<(Contact, f64)>> = vec![None; rest.len()];
    for round in 0..ROUNDS {
        let posed: Vec<DVec3> = rest.iter().zip(&parted.shift).map(|(p, u)| *p + *u).collect();
        let found = skin.contacts(&posed, &close(&posed), way_out);
        if round == 0 {
            if found.len() < FEWEST {
                return None;
            }
            parted.contacts = found.len();
            parted.depth = found.iter().map(|c| -c.gap).fold(0.0, f64::max);
        } else if found.is_empty() {
            break;
        }
        // The way the sides have to part in all, so far and from now on.
        for c in found {
            let goal = CLEARANCE * skin.diagonal() - c.gap + opened(&c, &parted.shift);
            held[c.vertex as usize] = Some((c, goal));
        }
        // A contact that has more room than it needs would pull its sides together.
        for hold in &mut held {
            if hold.is_some_and(|(c, goal)| opened(&c, &parted.shift) > goal) {
                *hold = None;
            }
        }
        let active: Vec<(Contact, f64)> = held.iter().flatten().copied().collect();
        relax(skin, &active, &mut parted.shift);
    }
    Some(parted)
}

/// How far a displacement has parted the sides of a contact.
fn opened(c: &Contact, shift: &[DVec3]) -> f64 {
    (shift[c.vertex as usize] - at(c, shift)).dot(c.direction)
}

fn at(c: &Contact, shift: &[DVec3]) -> DVec3 {
    c.face.iter().zip(c.weights).map(|(&v, w)| shift[v as usize] * w).sum()
}

/// Minimises Σ |u_i − u_j|² over edges + [`CONTACT`] Σ (opened − goal)² + [`STAY`] Σ |u_i|² by conjugate gradients from where `shift` is.
fn relax(skin: &Skin<'_>, contacts: &[(Contact, f64)], shift: &mut [DVec3]) {
    let spread = |out: &mut [DVec3], c: &Contact, amount: f64| {
        let force = c.direction * amount;
        out[c.vertex as usize] += force;
        c.face.iter().zip(c.weights).for_each(|(&v, w)| out[v as usize] -= force * w);
    };
    let apply = |u: &[DVec3]| -> Vec<DVec3> {
        let smooth = |v: usize| skin.moving[v].iter().map(|&w| u[v] - u[w as usize]).sum::<DVec3>() + u[v] * STAY;
        let mut out: Vec<DVec3> = (0..u.len()).map(smooth).collect();
        contacts.iter().for_each(|(c, _)| spread(&mut out, c, CONTACT * opened(c, u)));
        out
    };
    let dot = |a: &[DVec3], b: &[DVec3]| a.iter().zip(b).map(|(a, b)| a.dot(*b)).sum::<f64>();
    let mut wanted = vec![DVec3::ZERO; shift.len()];
    contacts.iter().for_each(|(c, goal)| spread(&mut wanted, c, CONTACT * goal));
    let mut residual: Vec<DVec3> = wanted.iter().zip(apply(shift)).map(|(b, a)| *b - a).collect();
    let enough = ACCURACY * ACCURACY * dot(&wanted, &wanted);
    let mut direction = residual.clone();
    let mut square = dot(&residual, &residual);
    for _ in 0..STEPS {
        if square <= enough {
            break;
        }
        let image = apply(&direction);
        let step = square / dot(&direction, &image);
        for v in 0..shift.len() {
            shift[v] += direction[v] * step;
            residual[v] -= image[v] * step;
        }
        let next = dot(&residual, &residual);
        for (d, r) in direction.iter_mut().zip(&residual) {
            *d = *r + *d * (next / square);
        }
        square = next;
    }
}

/// Displacements of all points, those of the skin first and given: each of the others moves as the mean of its neighbours.
pub(super) fn carry_inwards(shift: &[DVec3], points: usize, tets: &[[u32; 4]]) -> Vec<DVec3> {
    let mut all = shift.to_vec();
    all.resize(points, DVec3::ZERO);
    let mut neighbours = vec![Vec::new(); points];
    for t in tets {
        for &v in t.iter().filter(|&&v| v as usize >= shift.len()) {
            neighbours[v as usize].extend(t.iter().copied().filter(|&w| w != v));
        }
    }
    for around in &mut neighbours {
        around.sort_unstable();
        around.dedup();
    }
    for _ in 0..SWEEPS {
        for v in shift.len()..points {
            if !neighbours[v].is_empty() {
                all[v] = neighbours[v].iter().map(|&w| all[w as usize]).sum::<DVec3>() / neighbours[v].len() as f64;
            }
        }
    }
    all
}
