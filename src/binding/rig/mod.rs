//! The rig file: what a person says once about a scan and a capture, and what a run decided, to be edited and fed back.
//!
//! TOML; every section may be left out, every key is in `docs/formats.md`. Units, axes and sides are `[space]`, frames `[reference]`, names and places
//! `[markers]`, `[landmarks]` and `[skeleton]`, stiffer parts `[[group]]`; a thing made of parts is `[mesh]`, `[[component]]` and `[[joint]]`, driven by
//! `[[bind]]` and solved as `[solver]` says; [`Frozen`] holds the decisions of one run.
//!
//! What the command line says wins over the file.

mod frozen;
pub mod mechanism;
pub mod shell;
mod spot;
#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests;

pub use frozen::Frozen;
pub(super) use frozen::FrozenJoints;
pub use spot::{Pin, Spot};

use super::Role;
use super::landmarks::Joint;
use super::select::{Selector, Stiffness};
use crate::error::{Error, Result};
use crate::opened;
use crate::space::{Axis, Unit};
use mechanism::{BindSection, ComponentSection, JointSection, MeshSection, SolverSection};
use serde::{Deserialize, Deserializer, Serialize, Serializer};
use std::collections::BTreeMap;
use std::fmt::Display;
use std::io::Read;
use std::path::{Path, PathBuf};
use std::str::FromStr;

/// Bytes that a rig file may have; what a person writes is a thousandth of it.
const MOST: u64 = 16 << 20;

/// A rig file.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct RigFile {
    /// Units, axes and sides.
    #[serde(skip_serializing_if = "is_default")]
    pub space: SpaceSection,
    /// Where the reference frame is.
    #[serde(skip_serializing_if = "is_default")]
    pub reference: ReferenceSection,
    /// What labels mean.
    #[serde(skip_serializing_if = "is_default")]
    pub markers: BTreeMap<String, Pin>,
    /// Joints of the scan.
    #[serde(skip_serializing_if = "is_default")]
    pub landmarks: BTreeMap<Joint, Spot>,
    /// What joints of the capture are.
    #[serde(skip_serializing_if = "is_default")]
    pub skeleton: BTreeMap<String, Written<Role>>,
    /// Rigid and stiffer parts.
    #[serde(rename = "group", skip_serializing_if = "is_default")]
    pub groups: Vec<Group>,
    /// The mesh of a thing made of parts.
    #[serde(skip_serializing_if = "is_default")]
    pub mesh: MeshSection,
    /// How parts and joints are solved.
    #[serde(skip_serializing_if = "is_default")]
    pub solver: SolverSection,
    /// Its parts.
    #[serde(rename = "component", skip_serializing_if = "is_default")]
    pub components: Vec<ComponentSection>,
    /// Its joints.
    #[serde(rename = "joint", skip_serializing_if = "is_default")]
    pub joints: Vec<JointSection>,
    /// What drives its parts.
    #[serde(rename = "bind", skip_serializing_if = "is_default")]
    pub binds: Vec<BindSection>,
    /// The decisions of a run.
    #[serde(skip_serializing_if = "is_default")]
    pub frozen: Option<Frozen>,
}

/// `[space]`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
#[allow(missing_docs)]
pub struct SpaceSection {
    #[serde(skip_serializing_if = "is_default")]
    pub scan_unit: Option<Written<Unit>>,
    #[serde(skip_serializing_if = "is_default")]
    pub scan_up: Option<Written<Axis>>,
    #[serde(skip_serializing_if = "is_default")]
    pub scan_forward: Option<Written<Axis>>,
    #[serde(skip_serializing_if = "is_default")]
    pub capture_unit: Option<Written<Unit>>,
    #[serde(skip_serializing_if = "is_default")]
    pub capture_up: Option<Written<Axis>>,
    #[serde(skip_serializing_if = "is_default")]
    pub scale: Option<f64>,
    #[serde(skip_serializing_if = "is_default")]
    pub yaw: Option<f64>,
    #[serde(skip_serializing_if = "is_default")]
    pub flip: bool,
    #[serde(skip_serializing_if = "is_default")]
    pub mirror: bool,
    #[serde(skip_serializing_if = "is_default")]
    pub swap_sides: bool,
}

/// `[reference]`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
#[allow(missing_docs)]
pub struct ReferenceSection {
    #[serde(skip_serializing_if = "is_default")]
    pub frame: Option<i64>,
    #[serde(skip_serializing_if = "is_default")]
    pub file: Option<PathBuf>,
}

/// `[[group]]`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
#[allow(missing_docs)]
pub struct Group {
    pub what: Written<Selector>,
    #[serde(default, skip_serializing_if = "is_default")]
    pub rigid: bool,
    #[serde(default, skip_serializing_if = "is_default")]
    pub stiffness: Option<f64>,
}

fn is_default<T: Default + PartialEq>(value: &T) -> bool {
    *value == T::default()
}

/// A value that is written as a string.
#[derive(Clone, Debug, PartialEq)]
pub struct Written<T>(pub T);

impl<T: Display> Serialize for Written<T> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(&self.0)
    }
}

impl<'de, T: FromStr<Err: Display>> Deserialize<'de> for Written<T> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        String::deserialize(deserializer)?.parse().map(Self).map_err(serde::de::Error::custom)
    }
}

impl RigFile {
    /// Reads a rig file.
    ///
    /// # Errors
    /// Files that cannot be read; TOML and values that are wrong, with line and column and, of unknown keys, the nearest known one.
    pub fn read(path: &Path) -> Result<Self> {
        let mut text = String::new();
        let file = opened::open(path).map_err(|e| Error::unreadable(path, &e))?;
        file.take(MOST + 1).read_to_string(&mut text).map_err(|e| Error::unreadable(path, &e))?;
        if text.len() as u64 > MOST {
            return Err(Error::malformed("more than 16 MB").file(path).expected("a rig file: TOML, at most 16 MB"));
        }
        Self::parse(&text).map_err(|e| e.file(path))
    }

    pub(crate) fn parse(text: &str) -> Result<Self> {
        let rig: Self = toml::from_str(text).map_err(|e| explained(text, &e))?;
        let finite = |value: Option<f64>| value.is_none_or(f64::is_finite);
        if !finite(rig.space.yaw) || rig.space.scale.is_some_and(|s| !s.is_finite() || s <= 0.0) {
            return Err(Error::malformed("yaw or scale is no usable number").at("[space]").expected("degrees; a factor above 0"));
        }
        for group in &rig.groups {
            if group.rigid == group.stiffness.is_some() {
                let what =
                    format!("group {} is {}", group.what.0, if group.rigid { "rigid and has a stiffness" } else { "neither" });
                return Err(Error::malformed(what).at("[[group]]").expected("rigid = true or stiffness = X"));
            }
            if let Some(factor) = group.stiffness {
                let rule: Result<Stiffness, String> = format!("{}={factor}", group.what.0).parse();
                rule.map_err(|e| Error::malformed(e).at("[[group]]"))?;
            }
        }
        mechanism::check(&rig.components, &rig.joints, &rig.binds)?;
        rig.solver.check()?;
        if let Some(frozen) = &rig.frozen {
            frozen.check()?;
        }
        Ok(rig)
    }

    /// The text of the file.
    ///
    /// # Errors
    /// A value that TOML does not know.
    pub fn to_text(&self) -> Result<String> {
        let text = toml::to_string(self).map_err(|e| Error::malformed(format!("the rig file cannot be put into words: {e}")))?;
        Ok(format!("# Rig file of retarget: what was decided, to be edited and fed back with --rig.\n{text}"))
    }
}

/// An error of the TOML reader with its place, and the nearest key for an unknown one.
fn explained(text: &str, error: &toml::de::Error) -> Error {
    let at = error.span().map_or(0, |span| span.start.min(text.len()));
    let before = (0..=at).rev().find_map(|at| text.get(..at)).unwrap_or_default();
    let line = before.matches('\n').count() + 1;
    let column = before.rsplit('\n').next().unwrap_or("").chars().count() + 1;
    let message = error.message();
    let place = format!("line {line}, column {column}");
    let mut words = message.split('`').skip(1).step_by(2);
    let unknown = ["unknown field", "unknown variant"].iter().any(|what| message.starts_with(what));
    match (unknown, words.next()) {
        (true, Some(got)) => {
            let known: Vec<&str> = words.collect();
            let nearest = known.iter().min_by_key(|word| strsim::levenshtein(got, word));
            let error = Error::malformed(format!("'{got}' is not known here")).at(place).expected(known.join(", "));
            match nearest {
                Some(nearest) => error.hint(format!("{nearest}?")),
                None => error,
            }
        }
        _ => Error::malformed(message.to_owned()).at(place),
    }
}
