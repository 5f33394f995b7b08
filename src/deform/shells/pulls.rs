//! The pulls of handles: rows over vertices and the points off the triangles, targets and weights.

use super::newton::{Goals, Grip, outwards};
use super::system::Pull;
use crate::deform::{Grip as Hold, Handle, OrientedHandle, Placement, Targets};
use crate::error::{Error, Result};
use crate::linalg::SparseRow;
use crate::proxy::Proxy;
use crate::proxy::rows::RowSum;
use glam::DVec3;

/// Coefficients smaller than this are rounding.
const NOTHING: f64 = 1e-12;

/// Handles as points that are pulled, those of oriented handles last.
#[derive(Clone, Debug)]
pub(super) struct Pulls {
    names: Vec<String>,
    grips: Vec<Grip>,
    /// Where each holds the body at rest.
    pub attachments: Vec<DVec3>,
    /// Weight of each where its presence is 1.
    full: Vec<f64>,
    positions: Vec<DVec3>,
    weights: Vec<f64>,
    /// Positions of the frame before.
    before: Vec<DVec3>,
    /// Handles that are points.
    points: usize,
    carried: Vec<Carried>,
    /// Vertices that are where an oriented handle puts them.
    exact: Vec<(u32, Carried)>,
    placements: Vec<Placement>,
}

/// A point that an oriented handle carries.
#[derive(Clone, Copy, Debug)]
struct Carried {
    handle: usize,
    /// From the handle to it, at rest.
    offset: DVec3,
}

impl Pulls {
    /// `hardness`: weight of a handle with `beta` 1.
    pub fn new(proxy: &Proxy, handles: &[Handle], oriented: &[OrientedHandle], hardness: f64) -> Self {
        let mut pulls = Self {
            names: handles.iter().map(|h| h.name.clone()).chain(oriented.iter().map(|h| h.name.clone())).collect(),
            grips: Vec::new(),
            attachments: Vec::new(),
            full: Vec::new(),
            positions: Vec::new(),
            weights: Vec::new(),
            before: Vec::new(),
            points: handles.len(),
            carried: Vec::new(),
            exact: Vec::new(),
            placements: Vec::new(),
        };
        let vertices = proxy.rest.len() - proxy.tets.len();
        let mut sum = RowSum::new(vertices);
        let mut add = |row: &SparseRow, weight: f64| {
            pulls.grips.push(grip(row, proxy, vertices, &mut sum));
            pulls.attachments.push(row.apply(&proxy.rest));
            pulls.full.push(weight);
        };
        handles.iter().for_each(|h| add(&h.row, hardness * h.beta));
        let (mut carried, mut exact) = (Vec::new(), Vec::new());
        // The points off the triangles follow.
        let points = vertices;
        let on_mesh = |vertices: &[u32]| -> Vec<SparseRow> {
            let own = vertices.iter().filter(|v| (**v as usize) < points);
            own.map(|&v| SparseRow { indices: vec![v], values: vec![1.0] }).collect()
        };
        for (number, handle) in oriented.iter().enumerate() {
            let (rows, beta): (Vec<SparseRow>, f64) = match &handle.grip {
                Hold::Frame { rows, beta } => (rows.to_vec(), *beta),
                Hold::Region { vertices, beta } => (on_mesh(vertices), *beta),
                Hold::Exact { vertices } => {
                    exact.extend(vertices.iter().filter(|v| (**v as usize) < points).map(|&v| (v, number)));
                    (on_mesh(vertices), 1.0)
                }
            };
            let share = beta / rows.len().max(1) as f64;
            for row in rows {
                add(&row, hardness * share);
                carried.push(Carried { handle: number, offset: row.apply(&proxy.rest) - handle.rest });
            }
        }
        pulls.carried = carried;
        pulls.exact = exact
            .into_iter()
            .map(|(vertex, handle)| (vertex, Carried { handle, offset: proxy.rest[vertex as usize] - oriented[handle].rest }))
            .collect();
        pulls.positions.clone_from(&pulls.attachments);
        pulls.before.clone_from(&pulls.attachments);
        pulls.weights = vec![0.0; pulls.full.len()];
        pulls.placements.reserve(oriented.len());
        pulls
    }

    pub fn grips(&self) -> Vec<Grip> {
        self.grips.clone()
    }

    /// Takes over the targets of the handles that are points.
    pub fn take(&mut self, targets: &Targets) -> Result<()> {
        assert!(targets.positions.len() == self.points && targets.presence.len() == self.points, "one target per handle");
        for (h, (position, presence)) in targets.positions.iter().zip(&targets.presence).enumerate() {
            if presence.is_nan() || *presence > 0.0 && !position.is_finite() {
                let found = format!("the target of handle {} is {position} with presence {presence}", self.names[h]);
                return Err(Error::refused(found).expected("a point, or presence 0"));
            }
            self.weights[h] = self.full[h] * presence.max(0.0);
            if *presence > 0.0 {
                self.positions[h] = *position;
            }
        }
        Ok(())
    }

    /// Takes over the places of the oriented handles.
    pub fn place(&mut self, placements: &[Placement]) -> Result<()> {
        for placement in placements {
            if placement.presence > 0.0 && !(placement.position.is_finite() && placement.orientation.is_finite()) {
                return Err(Error::refused("the place of an oriented handle is not finite").expected("a point and a turn"));
            }
        }
        self.placements.clear();
        self.placements.extend_from_slice(placements);
        for (k, carried) in self.carried.iter().enumerate() {
            let Some(placement) = placements.get(carried.handle) else { continue };
            let pull = self.points + k;
            self.weights[pull] = self.full[pull] * placement.presence.max(0.0);
            if placement.presence > 0.0 {
                self.positions[pull] = placement.position + placement.orientation * carried.offset;
            }
        }
        Ok(())
    }

    /// Which vertices do not move by themselves.
    pub fn held(&self, vertices: usize) -> Vec<bool> {
        let mut held = vec![false; vertices];
        self.exact.iter().for_each(|(v, _)| held[*v as usize] = true);
        held
    }

    /// Puts the vertices that are held exactly where they shall be, or by a share of the way from where they were `before`.
    pub fn settle(&self, x: &mut [DVec3], before: Option<(&[DVec3], f64)>) {
        for (vertex, carried) in &self.exact {
            let v = *vertex as usize;
            if let Some(placement) = self.placements.get(carried.handle).filter(|p| p.presence > 0.0) {
                let there = placement.position + placement.orientation * carried.offset;
                x[v] = before.map_or(there, |(before, share)| before[v].lerp(there, share));
            }
        }
    }

    /// Vertices that handles hold.
    pub fn holding(&self) -> impl Iterator<Item = u32> {
        let pulled = self.grips.iter().flat_map(|grip| &grip.pull.vertices).copied();
        pulled.chain(self.exact.iter().map(|(v, _)| *v))
    }

    /// Whether anything pulls.
    pub fn any(&self) -> bool {
        self.weights.iter().any(|w| *w > 0.0)
    }

    pub fn goals(&self) -> Goals<'_> {
        Goals { positions: &self.positions, weights: &self.weights }
    }

    /// Where each pull holds a pose.
    pub fn hold(&self, pull: usize, x: &[DVec3], faces: &[[u32; 3]]) -> DVec3 {
        let grip = &self.grips[pull];
        let off: DVec3 = grip.offsets.iter().map(|&(face, share)| share * outwards(x, faces[face as usize])).sum();
        grip.pull.apply(x) + off
    }

    /// Mean move of the targets since the last call.
    pub fn motion(&mut self) -> f64 {
        let (mut sum, mut count) = (0.0, 0);
        for ((now, before), _) in self.positions.iter().zip(&self.before).zip(&self.weights).filter(|(_, w)| **w > 0.0) {
            sum += now.distance(*before);
            count += 1;
        }
        self.before.copy_from_slice(&self.positions);
        sum / f64::from(count.max(1))
    }

    /// Mean distance of what is held from its targets.
    pub fn distance(&self, x: &[DVec3], faces: &[[u32; 3]]) -> f64 {
        let (mut sum, mut count) = (0.0, 0);
        for (pull, _) in self.weights.iter().enumerate().filter(|(_, w)| **w > 0.0) {
            sum += self.hold(pull, x, faces).distance(self.positions[pull]);
            count += 1;
        }
        sum / f64::from(count.max(1))
    }
}

/// A row over the points of the proxy as one over vertices and offsets of triangles.
fn grip(row: &SparseRow, proxy: &Proxy, vertices: usize, sum: &mut RowSum) -> Grip {
    let mut offsets = Vec::new();
    for (&point, &value) in row.indices.iter().zip(&row.values) {
        match (point as usize).checked_sub(vertices) {
            None => sum.add(point, value),
            Some(face) => {
                proxy.boundary[face].iter().for_each(|&v| sum.add(v, value / 3.0));
                if value.abs() > NOTHING {
                    offsets.push((face as u32, value));
                }
            }
        }
    }
    let row = sum.take();
    let corner = |v: u32| offsets.iter().any(|&(face, _): &(u32, f64)| proxy.boundary[face as usize].contains(&v));
    let terms = row.indices.into_iter().zip(row.values).filter(|(v, c)| c.abs() > NOTHING || corner(*v));
    let (indices, values) = terms.unzip();
    Grip { pull: Pull { vertices: indices, values }, offsets }
}
