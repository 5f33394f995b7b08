//! The sections of a rig file that say what a thing made of parts is, and what drives it.

use super::shell::ShellSection;
use super::{Written, is_default};
use crate::error::{Error, Result};
use crate::joints::{Kind, Style};
use serde::{Deserialize, Serialize};
use std::str::FromStr;

/// `[mesh]`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
#[allow(missing_docs)]
pub struct MeshSection {
    #[serde(skip_serializing_if = "is_default")]
    pub file: Option<String>,
    /// Vertices of the mesh: a warning where it has others.
    #[serde(skip_serializing_if = "is_default")]
    pub vertices: Option<usize>,
    /// How flat contacts were read.
    #[serde(skip_serializing_if = "is_default")]
    pub style: Option<Written<Style>>,
    /// Within which surfaces counted as touching, in diagonals.
    #[serde(skip_serializing_if = "is_default")]
    pub reach: Option<f64>,
}

/// `[[component]]`: a part.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
#[allow(missing_docs)]
pub struct ComponentSection {
    pub name: String,
    /// Objects, groups or pieces of the mesh that it consists of; the one of its name where there are none.
    #[serde(default, skip_serializing_if = "is_default")]
    pub shells: Vec<String>,
    #[serde(default, skip_serializing_if = "is_default")]
    pub kind: PartKind,
    /// Of a soft part: cells along its principal axes, longest first.
    #[serde(default, skip_serializing_if = "is_default")]
    pub cells: Option<[u32; 3]>,
    /// Of a soft part: against that of others; 0.01 stretches.
    #[serde(default, skip_serializing_if = "is_default")]
    pub stiffness: Option<f64>,
    /// Regions of a soft part that stay rigid; joints call them `part/region`. Boxes of one name are one region.
    #[serde(default, skip_serializing_if = "is_default")]
    pub rigid: Vec<RegionSection>,
}

/// Whether a part bends.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum PartKind {
    /// It does not.
    #[default]
    Rigid,
    /// It does.
    Soft,
}

/// A region of a soft part: a box in the mesh's coordinates.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
#[allow(missing_docs)]
pub struct RegionSection {
    pub name: String,
    pub min: [f64; 3],
    pub max: [f64; 3],
}

/// `[[joint]]`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
#[allow(missing_docs)]
pub struct JointSection {
    pub name: String,
    /// `off`: the parts are not joined.
    #[serde(rename = "type")]
    pub kind: Written<JointKind>,
    pub a: String,
    pub b: String,
    #[serde(default, skip_serializing_if = "is_default")]
    pub centre: Option<[f64; 3]>,
    #[serde(default, skip_serializing_if = "is_default")]
    pub x: Option<[f64; 3]>,
    #[serde(default, skip_serializing_if = "is_default")]
    pub z: Option<[f64; 3]>,
    /// Radians from rest.
    #[serde(default, skip_serializing_if = "is_default")]
    pub angle: Option<[f64; 2]>,
    #[serde(default, skip_serializing_if = "is_default")]
    pub slide: Option<[f64; 2]>,
    #[serde(default, skip_serializing_if = "is_default")]
    pub cone: Option<f64>,
    /// On soft sides: the cells that it holds.
    #[serde(default, skip_serializing_if = "is_default")]
    pub region: Option<BoxSection>,
    /// Words for people: what it was read from, and how sure that is.
    #[serde(default, skip_serializing_if = "is_default")]
    pub source: Option<String>,
}

/// A box in the mesh's coordinates.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
#[allow(missing_docs)]
pub struct BoxSection {
    pub min: [f64; 3],
    pub max: [f64; 3],
}

/// The type of a joint; `None` is `off`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct JointKind(pub Option<Kind>);

impl std::fmt::Display for JointKind {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(self.0.map_or("off", Kind::word))
    }
}

impl FromStr for JointKind {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let known = Kind::WORDS.iter().find(|w| w.1 == text).map(|w| Self(Some(w.0)));
        let words = || Kind::WORDS.map(|w| w.1).join(", ");
        known.or((text == "off").then_some(Self(None))).ok_or_else(|| format!("'{text}' is no joint: {}, off", words()))
    }
}

impl std::fmt::Display for Style {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Style::Mechanism => "mechanism",
            Style::Furniture => "furniture",
        })
    }
}

impl FromStr for Style {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text {
            "mechanism" => Ok(Style::Mechanism),
            "furniture" => Ok(Style::Furniture),
            _ => Err(format!("'{text}' is no style: mechanism, furniture")),
        }
    }
}

/// `[[bind]]`: what drives a part.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
#[allow(missing_docs)]
pub struct BindSection {
    pub from: FromSection,
    pub to: ToSection,
    #[serde(default, skip_serializing_if = "is_default")]
    pub kind: BindKind,
    /// The joint of the capture from which the bone to this one goes.
    #[serde(default, skip_serializing_if = "is_default")]
    pub parent: Option<String>,
    #[serde(default, skip_serializing_if = "is_default")]
    pub weight: Option<f64>,
}

/// What of a capture.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum FromSection {
    /// A joint of a skeleton.
    Joint(String),
    /// A marker.
    Marker(String),
}

/// Where on the mesh.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
#[allow(missing_docs)]
pub struct ToSection {
    pub component: String,
    #[serde(default, skip_serializing_if = "is_default")]
    pub point: Option<[f64; 3]>,
}

/// What of it drives the part.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum BindKind {
    /// Its place.
    #[default]
    Position,
    /// Its turn.
    Orientation,
}

/// `[solver]`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
#[allow(missing_docs)]
pub struct SolverSection {
    /// How strongly joints stay turned as in the frame before.
    #[serde(skip_serializing_if = "is_default")]
    pub hold: Option<f64>,
    /// Steps per frame at most.
    #[serde(skip_serializing_if = "is_default")]
    pub iterations: Option<u32>,
    /// Whether a tree of rigid parts is made exact.
    #[serde(skip_serializing_if = "is_default")]
    pub snap: Option<bool>,
    #[serde(skip_serializing_if = "is_default")]
    pub weights: WeightsSection,
    #[serde(skip_serializing_if = "is_default")]
    pub shell: ShellSection,
}

/// `weights` in `[solver]`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
#[allow(missing_docs)]
pub struct WeightsSection {
    #[serde(skip_serializing_if = "is_default")]
    pub joint: Option<f64>,
    #[serde(skip_serializing_if = "is_default")]
    pub limit: Option<f64>,
    #[serde(skip_serializing_if = "is_default")]
    pub strain: Option<f64>,
    #[serde(skip_serializing_if = "is_default")]
    pub pos: Option<f64>,
}

impl SolverSection {
    /// Checks that its numbers are usable.
    pub(super) fn check(&self) -> Result<()> {
        let fail = |what: String, expected: &str| Err(Error::malformed(what).at("[solver]").expected(expected.to_owned()));
        if self.iterations == Some(0) {
            return fail("iterations = 0".into(), "1 or more");
        }
        self.shell.check()?;
        let WeightsSection { joint, limit, strain, pos } = self.weights;
        let numbers = [("hold", self.hold), ("joint", joint), ("limit", limit), ("strain", strain), ("pos", pos)];
        match numbers.into_iter().find(|n| n.1.is_some_and(|x| !x.is_finite() || x < 0.0)) {
            Some((name, _)) => fail(format!("{name} is no usable number"), "a finite number, 0 or more"),
            None => Ok(()),
        }
    }
}

/// Checks what the reader of TOML does not: names that are there once and are known, numbers that are usable.
pub(super) fn check(components: &[ComponentSection], joints: &[JointSection], binds: &[BindSection]) -> Result<()> {
    let fail = |section: &str, what: String, expected: &str| {
        Err(Error::malformed(what).at(format!("[[{section}]]")).expected(expected.to_owned()))
    };
    for (k, part) in components.iter().enumerate() {
        if components[..k].iter().any(|p| p.name == part.name) || part.name.contains('/') {
            return fail(
                "component",
                format!("component {} is there twice or has a / in its name", part.name),
                "a name of its own",
            );
        }
        if part.stiffness.is_some_and(|s| !(s > 0.0 && s.is_finite())) {
            return fail("component", format!("component {}: its stiffness is not usable", part.name), "a number above 0");
        }
        let cells = part.cells.unwrap_or([1; 3]);
        if cells.contains(&0) || cells.iter().map(|&c| u64::from(c)).product::<u64>() > 20_000 {
            return fail(
                "component",
                format!("component {}: {cells:?} cells", part.name),
                "1 or more along each axis, 20,000 in all at most",
            );
        }
        if part.kind == PartKind::Rigid && (part.cells.is_some() || part.stiffness.is_some() || !part.rigid.is_empty()) {
            return fail(
                "component",
                format!("component {} is rigid and has what soft parts have", part.name),
                "kind = \"soft\"",
            );
        }
        for region in &part.rigid {
            if region.min.iter().zip(&region.max).any(|(lo, hi)| lo.is_nan() || hi.is_nan() || lo > hi) {
                return fail("component", format!("region {}/{} is no box", part.name, region.name), "min below max");
            }
        }
    }
    // Without components every piece of the mesh is one, which is not known here.
    let known = |side: &str| match side.split_once('/') {
        None if components.is_empty() => true,
        None => components.iter().any(|p| p.name == side),
        Some((part, region)) => components.iter().any(|p| p.name == part && p.rigid.iter().any(|r| r.name == region)),
    };
    let nearest = |side: &str| {
        let name = components.iter().map(|p| p.name.as_str()).min_by_key(|name| strsim::levenshtein(side, name));
        name.map_or("[[component]] of kind = \"soft\", with that region in rigid".to_owned(), |name| format!("{name}?"))
    };
    for joint in joints {
        if let Some(side) = [&joint.a, &joint.b].into_iter().find(|side| !known(side)) {
            let error = Error::malformed(format!("joint {}: there is no component {side}", joint.name)).at("[[joint]]");
            return Err(error.hint(nearest(side)));
        }
        if joint.a == joint.b {
            return fail("joint", format!("joint {} joins {} to itself", joint.name, joint.a), "two components");
        }
        let numbers = [joint.centre, joint.x, joint.z].into_iter().flatten().flatten();
        if numbers.into_iter().any(|x| !x.is_finite()) || joint.x.is_some_and(|x| x == [0.0; 3]) {
            return fail(
                "joint",
                format!("joint {}: its centre or an axis is not usable", joint.name),
                "finite numbers, not all 0",
            );
        }
        if joint.kind.0.0.is_some_and(|k| k != Kind::Fixed) && joint.centre.is_none() {
            return fail("joint", format!("joint {} has no centre", joint.name), "centre = [x, y, z]");
        }
        let crossed = |range: Option<[f64; 2]>| range.is_some_and(|[lo, hi]| lo.is_nan() || hi.is_nan() || lo > hi);
        if crossed(joint.angle) || crossed(joint.slide) || joint.cone.is_some_and(|c| c.is_nan() || c < 0.0) {
            return fail("joint", format!("joint {}: its limits are the wrong way round", joint.name), "[lower, upper]");
        }
    }
    for bind in binds {
        if !known(&bind.to.component) {
            let error = Error::malformed(format!("there is no component {}", bind.to.component)).at("[[bind]]");
            return Err(error.hint(nearest(&bind.to.component)));
        }
        if let (FromSection::Marker(marker), BindKind::Orientation) = (&bind.from, bind.kind) {
            return fail(
                "bind",
                format!("the bind of marker {marker} has kind = \"orientation\": a marker has a place and no turn"),
                "kind = \"position\", or a joint of a skeleton",
            );
        }
        if bind.kind == BindKind::Position && bind.to.point.is_none() {
            return fail(
                "bind",
                format!("the bind to {} has no point", bind.to.component),
                "to = { component, point = [x, y, z] }",
            );
        }
        let usable = bind.weight.is_none_or(|w| w > 0.0 && w.is_finite());
        if !usable || bind.to.point.is_some_and(|p| p.iter().any(|x| !x.is_finite())) {
            return fail(
                "bind",
                format!("the bind to {} has no usable point or weight", bind.to.component),
                "finite numbers, a weight above 0",
            );
        }
    }
    Ok(())
}
