//! ASF: the bones of a skeleton, their axes and their degrees of freedom.

use super::lines::{Line, lines};
use crate::capture::{number, turns};
use crate::error::{Error, Notes, Result};
use crate::space::Unit;
use glam::{DQuat, DVec3};
use std::collections::HashMap;

/// Longest name of a bone, in bytes; more is no name.
const LONGEST_NAME: usize = 255;

/// A degree of freedom: a number in a row of the motion.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Freedom {
    /// Place along an axis.
    Translation(usize),
    /// Turn about an axis.
    Rotation(usize),
    /// Length of the bone.
    Length,
}

/// A bone; the root is the first.
#[derive(Clone, Debug)]
pub(super) struct Bone {
    pub(super) name: String,
    pub(super) parent: Option<usize>,
    /// From its start to its end at rest, in the axes of the file; zero for the root.
    pub(super) along: DVec3,
    /// Its own axes at rest: angles of the motion are about these.
    pub(super) axes: DQuat,
    /// The order in which its turns are made, first to last.
    pub(super) order: [usize; 3],
    /// What the numbers of the motion are, in their order.
    pub(super) freedoms: Vec<Freedom>,
}

/// A skeleton.
#[derive(Debug)]
pub(super) struct Asf {
    /// Parents before children; the first is the root.
    pub(super) bones: Vec<Bone>,
    /// Place of the root at rest.
    pub(super) origin: DVec3,
    pub(super) name: Option<String>,
    /// Whether angles are in radians.
    pub(super) radians: bool,
    /// Unit of length.
    pub(super) unit: Option<Unit>,
    pub(super) notes: Notes,
}

/// Reads a file.
///
/// # Errors
/// With the line: values that are no numbers, bones that the hierarchy names and that are not described, or that have two parents.
pub(super) fn read(bytes: &[u8]) -> Result<Asf> {
    let mut asf = Asf {
        bones: vec![Bone::new("root".into())],
        origin: DVec3::ZERO,
        name: None,
        radians: false,
        unit: None,
        notes: Notes::default(),
    };
    let (mut section, mut draft): (Vec<u8>, Option<Draft>) = (Vec::new(), None);
    let mut root = Draft::new();
    let mut by_name: HashMap<String, usize> = HashMap::from([("root".to_owned(), 0)]);
    let mut links: Vec<Link> = Vec::new();
    let mut last = 0;
    for line in lines(bytes) {
        last = line.number;
        let keyword = line.keyword();
        if keyword.starts_with(b":") {
            section = keyword;
            if section == b":name" && line.words.len() > 1 {
                asf.name = Some(line.text(1));
            }
            continue;
        }
        match (section.as_slice(), keyword.as_slice()) {
            (b":units", _) => units(&line, &keyword, &mut asf)?,
            (b":root", _) => root.take(&line, &keyword)?,
            (b":bonedata", b"begin") => draft = Some(Draft::new()),
            (b":bonedata", b"end") => {
                let bone = draft.take().ok_or_else(|| line.error("'end' without 'begin'"))?.bone(asf.radians, &line)?;
                if by_name.insert(bone.name.clone(), asf.bones.len()).is_some() {
                    return Err(line.error(format!("bone '{}' is described twice", bone.name)));
                }
                asf.bones.push(bone);
            }
            (b":bonedata", _) => {
                draft.as_mut().ok_or_else(|| line.error(format!("unexpected '{}'", line.shown())))?.take(&line, &keyword)?;
            }
            (b":hierarchy", b"begin" | b"end") => {}
            (b":hierarchy", _) => {
                let bone = |word: usize| {
                    by_name.get(line.text(word).as_str()).copied().ok_or_else(|| {
                        line.error(format!("bone '{:.40}' is in the hierarchy but not described", line.text(word)))
                    })
                };
                let parent = bone(0)?;
                for word in 1..line.words.len() {
                    links.push(Link { parent, child: bone(word)?, line: line.number });
                }
            }
            _ => {}
        }
    }
    if links.is_empty() {
        return Err(Error::malformed("no hierarchy of bones")
            .at(format!("line {last}"))
            .expected("an ASF skeleton: :root, :bonedata, :hierarchy"));
    }
    root.root(&mut asf);
    grow(&mut asf, &links)?;
    Ok(asf)
}

/// A bone under another, and the line that says so.
struct Link {
    parent: usize,
    child: usize,
    line: usize,
}

/// Gives the bones their parents, and brings them into the order of the hierarchy, depth first.
fn grow(asf: &mut Asf, links: &[Link]) -> Result<()> {
    let mut parents: Vec<Option<usize>> = vec![None; asf.bones.len()];
    for link in links {
        if link.child == 0 || parents[link.child].replace(link.parent).is_some() {
            return Err(Error::malformed(format!("bone '{}' has two parents", asf.bones[link.child].name))
                .at(format!("line {}", link.line)));
        }
    }
    let mut below: Vec<usize> = (0..links.len()).collect();
    below.sort_by_key(|&l| links[l].parent);
    let mut placed: Vec<Option<usize>> = vec![None; asf.bones.len()];
    let (mut order, mut stack) = (Vec::with_capacity(asf.bones.len()), vec![0]);
    while let Some(bone) = stack.pop() {
        placed[bone] = Some(order.len());
        order.push(bone);
        let start = below.partition_point(|&l| links[l].parent < bone);
        let end = below.partition_point(|&l| links[l].parent <= bone);
        stack.extend(below[start..end].iter().rev().map(|&l| links[l].child));
    }
    let lost = asf.bones.len() - order.len();
    if lost > 0 {
        asf.notes.warn(format!("{} without a way to the root: left out", crate::words::plural(lost, "bone")));
    }
    let mut all: Vec<Option<Bone>> = std::mem::take(&mut asf.bones).into_iter().map(Some).collect();
    asf.bones = order
        .iter()
        .filter_map(|&b| all[b].take().map(|bone| Bone { parent: parents[b].and_then(|p| placed[p]), ..bone }))
        .collect();
    Ok(())
}

/// `length 0.45`: 0.45 of the file's units are an inch; `angle deg`.
fn units(line: &Line<'_>, keyword: &[u8], asf: &mut Asf) -> Result<()> {
    match keyword {
        b"length" => {
            let length = line.words.get(1).and_then(|w| number::parse(w)).filter(|&l| l.is_finite() && l > 0.0);
            let length = length
                .ok_or_else(|| line.error(format!("unexpected '{}'", line.shown())).expected("length and a positive number"))?;
            // 1 is what files say that know nothing of their unit.
            asf.unit = (length != 1.0).then(|| Unit::of_metres(0.0254 / length)).flatten();
        }
        b"angle" => asf.radians = line.text(1).to_ascii_lowercase().starts_with("rad"),
        _ => {}
    }
    Ok(())
}

impl Bone {
    fn new(name: String) -> Self {
        Self { name, parent: None, along: DVec3::ZERO, axes: DQuat::IDENTITY, order: [0, 1, 2], freedoms: Vec::new() }
    }
}

/// A bone as its lines describe it.
struct Draft {
    name: String,
    direction: DVec3,
    length: f64,
    axis: DVec3,
    order: [usize; 3],
    position: DVec3,
    freedoms: Vec<Freedom>,
}

impl Draft {
    fn new() -> Self {
        Self {
            name: String::new(),
            direction: DVec3::ZERO,
            length: 0.0,
            axis: DVec3::ZERO,
            order: [0, 1, 2],
            position: DVec3::ZERO,
            freedoms: Vec::new(),
        }
    }

    fn take(&mut self, line: &Line<'_>, keyword: &[u8]) -> Result<()> {
        match keyword {
            b"name" if line.words.get(1).is_some_and(|w| w.len() <= LONGEST_NAME) => self.name = line.text(1),
            b"name" => return Err(line.error("a bone without a usable name")),
            b"direction" => self.direction = triple(line)?,
            b"length" => {
                let length = line.words.get(1).and_then(|w| number::parse(w)).filter(|l| l.is_finite());
                self.length =
                    length.ok_or_else(|| line.error(format!("unexpected '{}'", line.shown())).expected("length and a number"))?;
            }
            b"axis" if line.words.len() == 2 => self.order = order(line, 1)?,
            b"axis" => {
                self.axis = triple(line)?;
                if line.words.len() > 4 {
                    self.order = order(line, 4)?;
                }
            }
            b"orientation" => self.axis = triple(line)?,
            b"position" => self.position = triple(line)?,
            b"dof" | b"order" => {
                self.freedoms = line.words[1..]
                    .iter()
                    .map(|word| match word.to_ascii_lowercase().as_slice() {
                        [b't', axis @ b'x'..=b'z'] => Ok(Freedom::Translation(usize::from(axis - b'x'))),
                        [b'r', axis @ b'x'..=b'z'] => Ok(Freedom::Rotation(usize::from(axis - b'x'))),
                        b"l" => Ok(Freedom::Length),
                        _ => Err(line.error(format!("unexpected '{}'", line.shown())).expected("tx ty tz rx ry rz or l")),
                    })
                    .collect::<Result<_>>()?;
            }
            _ => {}
        }
        Ok(())
    }

    /// The bone's own axes at rest.
    fn axes(&self, radians: bool) -> DQuat {
        compose(self.order, self.axis.to_array(), radians)
    }

    fn bone(self, radians: bool, end: &Line<'_>) -> Result<Bone> {
        if self.name.is_empty() {
            return Err(end.error("a bone without a name"));
        }
        let along = self.direction.normalize_or_zero() * self.length;
        Ok(Bone { along, axes: self.axes(radians), order: self.order, freedoms: self.freedoms, name: self.name, parent: None })
    }

    fn root(self, asf: &mut Asf) {
        asf.origin = self.position;
        if self.position != DVec3::ZERO || self.axis != DVec3::ZERO {
            asf.notes.warn("the skeleton's root has a place or a turn at rest: the motion is taken to be on top of it (assumed)");
        }
        let axes = self.axes(asf.radians);
        asf.bones[0] = Bone { axes, order: self.order, freedoms: self.freedoms, ..Bone::new("root".into()) };
    }
}

/// Turns about three axes, made in `order`; angles by axis.
pub(super) fn compose(order: [usize; 3], angles: [f64; 3], radians: bool) -> DQuat {
    let turn = |axis: usize| turns::about(axis, if radians { angles[axis].to_degrees() } else { angles[axis] });
    turn(order[2]) * turn(order[1]) * turn(order[0])
}

fn triple(line: &Line<'_>) -> Result<DVec3> {
    let mut values = DVec3::ZERO;
    for axis in 0..3 {
        values[axis] = line
            .words
            .get(axis + 1)
            .and_then(|w| number::parse(w))
            .filter(|v| v.is_finite())
            .ok_or_else(|| line.error(format!("unexpected '{}'", line.shown())).expected("three numbers"))?;
    }
    Ok(values)
}

/// `XYZ`, `zxy` …
fn order(line: &Line<'_>, word: usize) -> Result<[usize; 3]> {
    let text = line.text(word).to_ascii_lowercase();
    let axes: Vec<usize> = text.bytes().map(|b| usize::from(b.wrapping_sub(b'x'))).collect();
    match axes[..] {
        [a, b, c] if a < 3 && b < 3 && c < 3 && a != b && b != c && a != c => Ok([a, b, c]),
        _ => Err(line.error(format!("unexpected '{}'", line.shown())).expected("an order of axes such as XYZ")),
    }
}
