//! Scan → joints: the parts of a thing, and how they move against each other, read from its shape.
//!
//! Source: Xu, Wang, Yin, Zhou, van de Panne, Chen, Guo: *Joint-aware manipulation of deformable models*, 2009, §3. Surface samples with normals that
//! respect creases take the place of vertices, a gap of the spectrum that of a fixed ratio, and flat flanges are read by the housings around them:
//! on robots as they come that finds three times as many joints.

mod components;
mod contact;
mod flat;
mod part;
mod range;
mod samples;
mod slippage;

pub use components::{Component, components};
pub use contact::Contact;
pub use part::Part;
pub use samples::Samples;

use glam::{DMat3, DVec3};
use rayon::prelude::*;
use slippage::{Reading, Slippage};

/// How one part can move against another.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Kind {
    /// Turns about a point.
    Ball,
    /// Slides in a plane and turns about its normal.
    Plane,
    /// Slides along an axis and turns about it.
    Cylinder,
    /// Slides along an axis.
    Prismatic,
    /// Turns about an axis.
    Revolute,
    /// Does not move.
    Fixed,
}

impl Kind {
    /// All, with the word for each.
    pub const WORDS: [(Kind, &'static str); 6] = [
        (Kind::Ball, "ball"),
        (Kind::Plane, "plane"),
        (Kind::Cylinder, "cylinder"),
        (Kind::Prismatic, "prismatic"),
        (Kind::Revolute, "revolute"),
        (Kind::Fixed, "fixed"),
    ];

    /// The word for it.
    pub fn word(self) -> &'static str {
        Self::WORDS.iter().find(|w| w.0 == self).map_or("", |w| w.1)
    }
}

/// What a joint was read from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Evidence {
    /// Surfaces that face each other.
    Contact,
    /// A flat contact and the housing around it.
    Collar,
    /// A flat contact that is round.
    Round,
    /// A solid in another one.
    Embedded,
}

impl Evidence {
    /// The word for it.
    pub fn word(self) -> &'static str {
        match self {
            Evidence::Contact => "contact",
            Evidence::Collar => "collar",
            Evidence::Round => "round contact",
            Evidence::Embedded => "embedded",
        }
    }
}

/// What kind of thing it is.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Style {
    /// Flat round contacts are turning flanges.
    #[default]
    Mechanism,
    /// Flat contacts are what they seem.
    Furniture,
}

/// How joints are looked for.
#[derive(Clone, Copy, Debug)]
pub struct Options {
    /// Surfaces touch that are no farther apart, in diagonals of the model.
    pub reach: f64,
    /// What kind of thing it is.
    pub style: Style,
}

impl Default for Options {
    fn default() -> Self {
        Self { reach: 0.004, style: Style::Mechanism }
    }
}

/// A joint between two parts.
#[derive(Clone, Debug)]
pub struct Joint {
    /// The part that stays.
    pub a: usize,
    /// The part that moves.
    pub b: usize,
    /// How.
    pub kind: Kind,
    /// A point of the axis, of the plane, or the centre.
    pub centre: DVec3,
    /// Columns X, Y, Z: X is the axis of turning or sliding and the stem of a ball, Z the normal of a plane.
    pub frame: DMat3,
    /// Range of the turn about X from rest, radians; `None`: free or not known.
    pub angle: Option<(f64, f64)>,
    /// Range of the slide along X.
    pub slide: Option<(f64, f64)>,
    /// Largest swing of X of a ball.
    pub cone: Option<f64>,
    /// What it was read from.
    pub evidence: Evidence,
    /// Samples of the contact.
    pub samples: usize,
    /// Area of the contact.
    pub area: f64,
    /// How clearly the slipping motions stand apart: the gap of the spectrum, 1 where nothing slips.
    pub gap: f64,
    /// How much faster the surface leaves itself by its fastest motion than by its slowest.
    pub spread: f64,
    /// Whether the parts hang together without it.
    pub closes_loop: bool,
    /// The contact.
    pub contact: Contact,
}

impl Joint {
    /// Whether the shape leaves no doubt: motions that stand far apart from the others, on a contact of some size. A part that does not move at all is
    /// rarely sure, since what is held by friction or a screw looks the same.
    pub fn is_sure(&self) -> bool {
        let seen = matches!(self.evidence, Evidence::Contact | Evidence::Collar) && self.samples >= ENOUGH && !self.closes_loop;
        let sure = if self.evidence == Evidence::Collar { SURE_COLLAR } else { SURE };
        // What lies flat on another part may be screwed to it, and what is round and cannot turn is round for another reason.
        let narrow =
            self.angle.is_some_and(|(lo, hi)| hi - lo < SURE_TURN) || self.cone.is_some_and(|cone| 2.0 * cone < SURE_TURN);
        let doubtful = self.kind == Kind::Plane || narrow;
        seen && !doubtful && if self.kind == Kind::Fixed { self.spread < SURELY_FIXED } else { self.gap >= sure }
    }
}

/// Fewest samples of a contact.
const FEWEST: usize = 6;
/// Distance of samples at most, in diagonals of the model.
const SPACING: f64 = 0.006;
/// Shares of the reach for a closer look, the gap above which there is no need for one, and how much clearer it has to be, on how many samples.
const CLOSER: [f64; 2] = [0.5, 0.25];
const CLEAR: f64 = 50.0;
const CLEARER: f64 = 2.0;
const ENOUGH: usize = 200;
/// The reach for parts that touch nothing, in reaches.
const LONGER: f64 = 2.5;
/// From this gap on a joint is sure, below this spread that there is none.
const SURE: f64 = 30.0;
/// The same of a flange, which may be bolted.
const SURE_COLLAR: f64 = 150.0;
const SURELY_FIXED: f64 = 10.0;
/// What turns by less is not sure to be meant to.
const SURE_TURN: f64 = 60.0 * std::f64::consts::PI / 180.0;

/// The joints of all pairs of parts that touch; parts that touch nothing are looked at with a longer reach. `size`: diagonal of the model.
///
/// Pairs that would close a loop are marked: most of them are parts that only lie beside each other.
pub fn find(parts: &[Part], size: f64, options: &Options) -> Vec<Joint> {
    let look = |pairs: Vec<(usize, usize)>, options: &Options| -> Vec<Joint> {
        pairs.into_par_iter().filter_map(|(a, b)| between(parts, a, b, size, options)).collect()
    };
    let mut joints = look(contact::pairs(parts, options.reach * size), options);
    let alone = |part: usize| !joints.iter().any(|j| j.a == part || j.b == part);
    let alone: Vec<bool> = (0..parts.len()).map(alone).collect();
    if alone.contains(&true) {
        let options = Options { reach: options.reach * LONGER, ..*options };
        let mut pairs = contact::pairs(parts, options.reach * size);
        pairs.retain(|&(a, b)| alone[a] || alone[b]);
        joints.extend(look(pairs, &options));
        joints.sort_by_key(|j| (j.a, j.b));
    }
    mark_loops(parts.len(), &mut joints);
    let reach = options.reach * size;
    joints.par_iter_mut().filter(|j| !j.closes_loop).for_each(|joint| range::limit(joint, parts, size, reach));
    joints
}

/// Marks the joints that are not in the spanning tree of the largest contacts.
fn mark_loops(parts: usize, joints: &mut [Joint]) {
    let mut order: Vec<usize> = (0..joints.len()).collect();
    order.sort_by(|&i, &j| joints[j].area.total_cmp(&joints[i].area).then(i.cmp(&j)));
    let mut set: Vec<usize> = (0..parts).collect();
    for k in order {
        let (a, b) = (set[joints[k].a], set[joints[k].b]);
        joints[k].closes_loop = a == b;
        set.iter_mut().filter(|s| **s == b).for_each(|s| *s = a);
    }
}

/// The joint between two parts; `None` where they do not touch.
///
/// Where the contact says nothing clear, it may have caught surfaces beside the joint, which is small against the model: a closer look that is much clearer
/// replaces it.
pub fn between(parts: &[Part], a: usize, b: usize, size: f64, options: &Options) -> Option<Joint> {
    let mut best = at_reach(parts, a, b, size, options.reach * size, options.style)?;
    for closer in CLOSER {
        if best.evidence != Evidence::Contact || best.gap > CLEAR {
            break;
        }
        let Some(joint) = at_reach(parts, a, b, size, options.reach * closer * size, options.style) else { break };
        if joint.evidence == Evidence::Embedded || joint.samples < ENOUGH {
            break;
        }
        if joint.kind != Kind::Fixed && joint.gap > CLEARER * best.gap {
            best = joint;
        }
    }
    Some(best)
}

fn at_reach(parts: &[Part], a: usize, b: usize, size: f64, reach: f64, style: Style) -> Option<Joint> {
    let (first, second) = (&parts[a], &parts[b]);
    let spacing = SPACING * size;
    let contact = Contact::between(first, second, reach, spacing);
    if contact.surface.len() < FEWEST {
        let contact = Contact::embedded(first, second, reach, spacing);
        if contact.surface.len() < FEWEST {
            return None;
        }
        let reading = Slippage::of(&contact.surface)?.read();
        let reading = if reading.kind == Kind::Plane { Reading { kind: Kind::Fixed, ..reading } } else { reading };
        return Some(joint(a, b, contact, reading, Evidence::Embedded));
    }
    let reading = Slippage::of(&contact.surface)?.read();
    if reading.kind == Kind::Plane && style == Style::Mechanism {
        if let Some(collar) = flat::collar(first, second, &contact, &reading, spacing) {
            return Some(joint(a, b, contact, collar, Evidence::Collar));
        }
        if !flat::on_table(first, second, &contact, &reading, reach)
            && let Some(round) = flat::round(&contact, &reading)
        {
            return Some(joint(a, b, contact, round, Evidence::Round));
        }
    }
    Some(joint(a, b, contact, reading, Evidence::Contact))
}

fn joint(a: usize, b: usize, contact: Contact, reading: Reading, evidence: Evidence) -> Joint {
    let (axes, _) = contact.surface.principal();
    let frame = match reading.kind {
        Kind::Plane => frame(reading.axis, axes[0], false),
        Kind::Ball | Kind::Fixed => frame(axes[0], axes[2], true),
        _ => {
            let least = axes.into_iter().min_by(|p, q| p.dot(reading.axis).abs().total_cmp(&q.dot(reading.axis).abs()));
            frame(reading.axis, least.unwrap_or(DVec3::X), true)
        }
    };
    Joint {
        a,
        b,
        kind: reading.kind,
        centre: reading.centre,
        frame,
        angle: None,
        slide: None,
        cone: None,
        evidence,
        samples: contact.surface.len(),
        area: contact.surface.area(),
        gap: reading.gap,
        spread: reading.spread,
        closes_loop: false,
        contact,
    }
}

/// An orthonormal frame with `main` as X (or as Z) and `other` near Z (or near X).
fn frame(main: DVec3, other: DVec3, main_is_x: bool) -> DMat3 {
    let main = main.normalize_or(DVec3::X);
    let other = (other - main * main.dot(other)).normalize_or(main.any_orthonormal_vector());
    let (x, z) = if main_is_x { (main, other) } else { (other, main) };
    DMat3::from_cols(x, z.cross(x), z)
}
