//! Parts, cells and joints → variables: cells that move as one share a rigid motion.

use super::cells::Cells;
use crate::disjoint::DisjointSets;
use crate::error::{Error, Result};
use crate::joints::Kind;
use crate::linalg::SparseRow;
use crate::proxy::Proxy;
use glam::{DMat3, DVec3};

/// Distance of the frame points of a variable from its origin, in the unit box.
const ARM: f64 = 0.1;

/// A part of the model, in the unit box.
#[derive(Clone, Debug)]
pub struct Part {
    /// Its name.
    pub name: String,
    /// Its vertices at rest.
    pub points: Vec<DVec3>,
    /// How it bends.
    pub body: Body,
}

/// How a part bends.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Body {
    /// Not at all.
    Rigid,
    /// As a grid of cells, along its principal axes, longest first.
    Soft {
        /// Cells along each axis.
        cells: [u32; 3],
        /// Against that of other soft parts; a hundredth stretches like rubber.
        stiffness: f64,
    },
}

/// A region of a soft part.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Region {
    /// Lower corner.
    pub lo: DVec3,
    /// Upper corner.
    pub hi: DVec3,
}

/// Cells of a soft part that move as one.
#[derive(Clone, Debug, PartialEq)]
pub struct Group {
    /// Its name, by which joints may call it.
    pub name: String,
    /// The part.
    pub part: usize,
    /// The cells with their middle in one of these.
    pub regions: Vec<Region>,
}

/// One side of a joint.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Side {
    /// A part: the cells around the joint.
    Part(usize),
    /// A group.
    Group(usize),
}

/// A joint at rest.
#[derive(Clone, Debug)]
pub struct JointSpec {
    /// Its name.
    pub name: String,
    /// How it moves.
    pub kind: Kind,
    /// The side that stays.
    pub a: Side,
    /// The side that moves against it.
    pub b: Side,
    /// A point of the axis, of the plane, or the centre.
    pub centre: DVec3,
    /// Columns X, Y, Z: X turns or slides, Z is the normal of a plane.
    pub frame: DMat3,
    /// Turns about X, radians; free where there is none. Rest is 0.
    pub angle: Option<(f64, f64)>,
    /// Slides along X.
    pub slide: Option<(f64, f64)>,
    /// Largest swing of X, radians.
    pub cone: Option<f64>,
    /// On soft sides: the cells that it holds; without, those nearest to the centre.
    pub region: Option<Region>,
}

/// A plane that points of the parts do not go below.
#[derive(Clone, Debug)]
pub struct Ground {
    /// Unit normal, away from what is below.
    pub up: DVec3,
    /// Of the plane, along the normal.
    pub height: f64,
    /// Parts and places on them at rest.
    pub points: Vec<(usize, DVec3)>,
}

/// A joint between variables.
#[derive(Clone, Debug)]
pub(super) struct Link {
    pub(super) kind: Kind,
    pub(super) a: usize,
    pub(super) b: usize,
    pub(super) centre: DVec3,
    pub(super) frame: DMat3,
    pub(super) angle: Option<(f64, f64)>,
    pub(super) slide: Option<(f64, f64)>,
    pub(super) cone: Option<f64>,
}

/// What two neighbouring cells of different variables want: the same motion at the corners of both. Summed up, since the sum over the corners is that over
/// their mean and three arms.
#[derive(Clone, Debug)]
pub(super) struct Strain {
    pub(super) a: usize,
    pub(super) b: usize,
    /// Times the weight of strain.
    pub(super) stiffness: f64,
    /// Corners, mean corner, arms whose squares sum to the second moments.
    pub(super) count: f64,
    pub(super) mean: DVec3,
    pub(super) arms: [DVec3; 3],
}

/// A thing of parts and joints at rest.
#[derive(Clone, Debug)]
pub struct Model {
    parts: Vec<Part>,
    cells: Vec<Cells>,
    /// First cell of each part.
    first: Vec<usize>,
    /// Variable of each cell.
    variables: Vec<u32>,
    /// Origin of each variable: the mean of its cells.
    pub(super) origins: Vec<DVec3>,
    pub(super) links: Vec<Link>,
    pub(super) strains: Vec<Strain>,
    pub(super) ground: Option<Ground>,
}

impl Model {
    /// Cells, variables and the rows between them.
    ///
    /// # Errors
    /// Names of the joint or part that is not usable: without a point, with an axis that is none, with limits the wrong way round.
    pub fn new(parts: Vec<Part>, groups: &[Group], joints: &[JointSpec]) -> Result<Self> {
        if let Some(part) = parts.iter().find(|p| p.points.is_empty() || p.points.iter().any(|p| !p.is_finite())) {
            return Err(Error::malformed(format!("part {} has no usable points", part.name)).at("[[component]]"));
        }
        let cells: Vec<Cells> = parts
            .iter()
            .map(|part| match part.body {
                Body::Rigid => Cells::single(&part.points),
                Body::Soft { cells, .. } => Cells::grid(&part.points, cells),
            })
            .collect();
        let mut first = vec![0];
        cells.iter().for_each(|c| first.push(first[first.len() - 1] + c.corners.len()));
        let mut sets = DisjointSets::new(first[parts.len()]);
        let mut join = |a: usize, b: usize| sets.unite(a as u32, b as u32);
        let members = |group: &Group| -> Vec<usize> {
            let own = &cells[group.part];
            let mut inside: Vec<usize> = group.regions.iter().flat_map(|r| own.inside(r.lo, r.hi)).collect();
            if inside.is_empty() {
                inside.extend(group.regions.iter().map(|r| own.at((r.lo + r.hi) * 0.5)));
            }
            inside.iter().map(|c| first[group.part] + c).collect()
        };
        let members: Vec<Vec<usize>> = groups.iter().map(members).collect();
        for group in &members {
            group.iter().for_each(|&c| join(group[0], c));
        }
        let mut sides = Vec::new();
        for joint in joints {
            check(joint)?;
            let held = |side: Side| match side {
                Side::Group(group) => members[group].clone(),
                Side::Part(part) => {
                    let own = &cells[part];
                    let mut held = joint.region.map_or_else(Vec::new, |r| own.within(r.lo, r.hi));
                    if held.is_empty() {
                        held.push(own.at(joint.centre));
                    }
                    held.iter().map(|c| first[part] + c).collect()
                }
            };
            let (a, b) = (held(joint.a), held(joint.b));
            a.iter().for_each(|&c| join(a[0], c));
            b.iter().for_each(|&c| join(b[0], c));
            if joint.kind == Kind::Fixed {
                join(a[0], b[0]);
            }
            sides.push((a[0], b[0]));
        }
        let (variables, count) = sets.labels();
        let mut sums = vec![(DVec3::ZERO, 0.0); count];
        for (own, first) in cells.iter().zip(&first) {
            for c in 0..own.corners.len() {
                let v = variables[first + c] as usize;
                sums[v] = (sums[v].0 + own.centre(c), sums[v].1 + 1.0);
            }
        }
        let origins = sums.iter().map(|(sum, n)| *sum / *n).collect();
        let mut links = Vec::new();
        for (joint, &(a, b)) in joints.iter().zip(&sides) {
            let (a, b) = (variables[a] as usize, variables[b] as usize);
            if joint.kind == Kind::Fixed || a == b {
                continue;
            }
            let JointSpec { kind, centre, frame, angle, slide, cone, .. } = *joint;
            links.push(Link { kind, a, b, centre, frame, angle, slide, cone });
        }
        // Groups that hang together by joints come apart along their borders, as two ears on one head do from it and from each other.
        let mut hanging = DisjointSets::new(groups.len());
        for joint in joints {
            if let (Side::Group(a), Side::Group(b)) = (joint.a, joint.b) {
                hanging.unite(a as u32, b as u32);
            }
        }
        let mut hangs: Vec<Option<u32>> = vec![None; count];
        let roots: Vec<u32> = (0..groups.len() as u32).map(|g| hanging.find(g)).collect();
        for (g, cells) in members.iter().enumerate() {
            if roots.iter().filter(|root| **root == roots[g]).count() > 1 {
                hangs[variables[cells[0]] as usize] = Some(roots[g]);
            }
        }
        let come_apart = |a: u32, b: u32| hangs[a as usize].is_some() && hangs[a as usize] == hangs[b as usize];
        let mut strains = Vec::new();
        for (p, own) in cells.iter().enumerate() {
            let Body::Soft { stiffness, .. } = parts[p].body else { continue };
            for pair in &own.neighbours {
                let [a, b] = pair.map(|c| variables[first[p] + c as usize]);
                if a != b && !come_apart(a, b) {
                    let corners = pair.map(|c| own.corners[c as usize]);
                    strains.push(Strain::new(a as usize, b as usize, stiffness, &corners));
                }
            }
        }
        Ok(Self { parts, cells, first, variables, origins, links, strains, ground: None })
    }

    /// The same over a ground.
    pub fn over(self, ground: Ground) -> Self {
        Self { ground: Some(ground), ..self }
    }

    /// Number of cells.
    pub fn cells(&self) -> usize {
        self.variables.len()
    }

    /// Number of rigid motions that are solved for.
    pub fn variables(&self) -> usize {
        self.origins.len()
    }

    /// The parts.
    pub fn parts(&self) -> &[Part] {
        &self.parts
    }

    /// The variable that a point of a part follows most.
    pub fn variable(&self, part: usize, point: DVec3) -> usize {
        let weights = self.cells[part].weights(point);
        let most = weights.into_iter().max_by(|a, b| a.1.total_cmp(&b.1)).map_or(0, |w| w.0);
        self.variables[self.first[part] + most] as usize
    }

    /// A point that moves with a part, as a row over the frame points (see [`Self::frames`]). The point may lie off the part.
    pub fn row(&self, part: usize, point: DVec3) -> SparseRow {
        let mut of_variable: Vec<(u32, f64)> =
            self.cells[part].weights(point).into_iter().map(|(c, w)| (self.variables[self.first[part] + c], w)).collect();
        of_variable.sort_by_key(|v| v.0);
        let mut row = SparseRow::default();
        for same in of_variable.chunk_by(|a, b| a.0 == b.0) {
            let (v, w) = (same[0].0, same.iter().map(|s| s.1).sum::<f64>());
            let arms = (point - self.origins[v as usize]) * (w / ARM);
            row.indices.extend((0..4).map(|k| 4 * v + k));
            row.values.extend([w - arms.x - arms.y - arms.z, arms.x, arms.y, arms.z]);
        }
        row
    }

    /// The frame points at rest, four per variable: its origin and the ends of three arms, as a proxy of loose tetrahedra.
    pub fn frames(&self) -> Proxy {
        let count = self.variables() as u32;
        let rest = self.origins.iter().flat_map(|&o| [o, o + DVec3::X * ARM, o + DVec3::Y * ARM, o + DVec3::Z * ARM]);
        let faces = (0..count).flat_map(|v| [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]].map(|f| f.map(|k| 4 * v + k)));
        Proxy {
            rest: rest.collect(),
            tets: (0..count).map(|v| [0, 1, 2, 3].map(|k| 4 * v + k)).collect(),
            boundary: faces.collect(),
            boundary_tets: (0..count).flat_map(|v| [v; 4]).collect(),
            components: (0..count).collect(),
        }
    }

    /// What a row over frame points is of each variable: its share and its arm from the origin.
    pub(super) fn holds(row: &SparseRow) -> Vec<(usize, f64, DVec3)> {
        let entries: Vec<(u32, f64)> = row.indices.iter().copied().zip(row.values.iter().copied()).collect();
        let of_variable = entries.chunk_by(|a, b| a.0 / 4 == b.0 / 4);
        let hold = |same: &[(u32, f64)]| {
            let mut arm = DVec3::ZERO;
            for &(i, value) in same {
                if i % 4 > 0 {
                    arm[i as usize % 4 - 1] = value * ARM;
                }
            }
            (same[0].0 as usize / 4, same.iter().map(|s| s.1).sum(), arm)
        };
        of_variable.map(hold).collect()
    }

    /// The frame points of posed variables.
    pub(super) fn pose(turns: &[DMat3], places: &[DVec3], pose: &mut Vec<DVec3>) {
        pose.clear();
        for (turn, &place) in turns.iter().zip(places) {
            pose.extend([place, place + turn.x_axis * ARM, place + turn.y_axis * ARM, place + turn.z_axis * ARM]);
        }
    }
}

impl Strain {
    fn new(a: usize, b: usize, stiffness: f64, corners: &[[DVec3; 8]; 2]) -> Self {
        let count = 16.0;
        let all = || corners.iter().flatten();
        let mean = all().sum::<DVec3>() / count;
        let mut moments = [[0.0; 3]; 3];
        for d in all().map(|p| (*p - mean).to_array()) {
            for i in 0..3 {
                for j in 0..3 {
                    moments[i][j] += d[i] * d[j];
                }
            }
        }
        let (values, axes) = crate::linalg::eigen::symmetric(moments);
        let arms = std::array::from_fn(|k| DVec3::from(axes[k]) * values[k].max(0.0).sqrt());
        Self { a, b, stiffness, count, mean, arms }
    }
}

fn check(joint: &JointSpec) -> Result<()> {
    let fail = |what: &str, expected: &str| {
        Err(Error::malformed(format!("joint {}: {what}", joint.name)).at("[[joint]]").expected(expected.to_owned()))
    };
    let axes = [joint.frame.x_axis, joint.frame.y_axis, joint.frame.z_axis];
    if !joint.centre.is_finite() || axes.iter().any(|a| (a.length() - 1.0).abs() > 1e-6) {
        return fail("its centre or an axis is no place or direction", "finite numbers, and an axis that is not zero");
    }
    for (lo, hi) in [joint.angle, joint.slide].into_iter().flatten() {
        if lo.is_nan() || hi.is_nan() || lo > hi {
            return fail("its lower limit is above the upper one", "[lower, upper]");
        }
    }
    if joint.cone.is_some_and(|c| c.is_nan() || c < 0.0) {
        return fail("its cone is no angle", "radians, not negative");
    }
    if joint.a == joint.b {
        return fail("both sides are the same", "two parts");
    }
    Ok(())
}
