//! Rig file and scan → parts, joints and the rows of the scan's vertices.

use crate::binding::rig::RigFile;
use crate::binding::rig::mechanism::{ComponentSection, JointSection, PartKind};
use crate::deform::joints::{Body, Group, JointSpec, Model, Part, Region, Side};
use crate::error::{Error, Notes, Result};
use crate::joints::{Component, Kind, components};
use crate::linalg::SparseRow;
use crate::scan::{Scan, UnitBox};
use crate::words;
use glam::{DMat3, DVec3};
use rayon::prelude::*;

/// A thing made of parts, in the unit box.
#[derive(Clone, Debug)]
pub struct Machine {
    /// Parts, joints and cells.
    pub model: Model,
    /// The joints, in the file's order, without those that are off.
    pub joints: Vec<JointSpec>,
    /// Part of each vertex of the scan.
    pub part_of_vertex: Vec<u32>,
}

impl Machine {
    /// The thing that a rig file says a scan is; without components there, every object, group or piece is a rigid part.
    ///
    /// # Errors
    /// Names and numbers of the file that do not fit the scan.
    pub fn new(rig: &RigFile, scan: &Scan, unit_box: UnitBox, notes: &mut Notes) -> Result<Self> {
        let shells = components(scan);
        let points: Vec<DVec3> = scan.mesh.positions.iter().map(|&p| unit_box.enter(p)).collect();
        let whole = |shell: &Component| ComponentSection { name: shell.name.clone(), ..ComponentSection::default() };
        let own: Vec<ComponentSection> = shells.iter().map(whole).collect();
        let sections = if rig.components.is_empty() { &own } else { &rig.components };
        let mut part_of_shell = vec![None; shells.len()];
        for (p, section) in sections.iter().enumerate() {
            let names = if section.shells.is_empty() { std::slice::from_ref(&section.name) } else { &section.shells };
            for name in names {
                let shell = shells.iter().position(|s| s.name == *name).ok_or_else(|| unknown(section, name, &shells))?;
                if part_of_shell[shell].replace(p).is_some() {
                    return Err(Error::malformed(format!("{name} belongs to two components")).at("[[component]]"));
                }
            }
        }
        adopt(&shells, &points, &mut part_of_shell, notes);
        let mut part_of_vertex = vec![u32::MAX; points.len()];
        for (shell, part) in shells.iter().zip(&part_of_shell) {
            for &v in &shell.vertices {
                let owner = &mut part_of_vertex[v as usize];
                *owner = (*owner).min(part.unwrap_or(0) as u32);
            }
        }
        // Vertices without a face go with the first part.
        part_of_vertex.iter_mut().filter(|p| **p == u32::MAX).for_each(|p| *p = 0);

        let mut of_part = vec![Vec::new(); sections.len()];
        for (shell, part) in shells.iter().zip(&part_of_shell) {
            of_part[part.unwrap_or(0)].extend(shell.vertices.iter().map(|&v| points[v as usize]));
        }
        let parts = sections.iter().zip(of_part).map(|(section, points)| Part {
            name: section.name.clone(),
            points,
            body: match section.kind {
                PartKind::Rigid => Body::Rigid,
                PartKind::Soft => {
                    Body::Soft { cells: section.cells.unwrap_or([8, 2, 2]), stiffness: section.stiffness.unwrap_or(1.0) }
                }
            },
        });
        // Regions of one name are one.
        let mut groups: Vec<Group> = Vec::new();
        for (part, section) in sections.iter().enumerate() {
            for r in &section.rigid {
                let name = format!("{}/{}", section.name, r.name);
                let region = Region { lo: unit_box.enter(r.min.into()), hi: unit_box.enter(r.max.into()) };
                match groups.iter_mut().find(|g| g.name == name) {
                    Some(group) => group.regions.push(region),
                    None => groups.push(Group { name, part, regions: vec![region] }),
                }
            }
        }
        let side = |name: &str| {
            let group = groups.iter().position(|g| g.name == name).map(Side::Group);
            group.or_else(|| sections.iter().position(|s| s.name == name).map(Side::Part)).ok_or_else(|| {
                let nearest = sections.iter().map(|s| s.name.as_str()).min_by_key(|known| strsim::levenshtein(name, known));
                Error::malformed(format!("a joint joins {name}, which is no component"))
                    .at("[[joint]]")
                    .hint(format!("{}?", nearest.unwrap_or("[[component]] in the rig file")))
            })
        };
        let mut joints = Vec::new();
        for section in &rig.joints {
            if let Some(kind) = section.kind.0.0 {
                joints.push(spec(section, kind, side(&section.a)?, side(&section.b)?, unit_box, notes));
            }
        }
        let model = Model::new(parts.collect(), &groups, &joints)?;
        Ok(Self { model, joints, part_of_vertex })
    }

    /// The part of a name.
    pub fn part(&self, name: &str) -> Option<usize> {
        self.model.parts().iter().position(|p| p.name == name)
    }

    /// Rows of the scan's vertices over the model's frame points; `points`: in the unit box.
    pub fn rows(&self, points: &[DVec3]) -> Vec<SparseRow> {
        points
            .par_iter()
            .zip(&self.part_of_vertex)
            .map(|(&p, &part)| self.model.row(part as usize, if p.is_finite() { p } else { DVec3::ZERO }))
            .collect()
    }
}

fn unknown(section: &ComponentSection, name: &str, shells: &[Component]) -> Error {
    let some: Vec<&str> = shells.iter().take(6).map(|s| s.name.as_str()).collect();
    let more = if shells.len() > some.len() { format!(", … ({} in all)", shells.len()) } else { String::new() };
    Error::malformed(format!("component {}: the mesh has no object, group or piece {name}", section.name))
        .at("[[component]]")
        .expected(format!("{}{more}", some.join(", ")))
}

/// Gives shells that no component claims to the part that is nearest.
fn adopt(shells: &[Component], points: &[DVec3], part_of_shell: &mut [Option<usize>], notes: &mut Notes) {
    let centre = |shell: &Component| {
        shell.vertices.iter().map(|&v| points[v as usize]).sum::<DVec3>() / shell.vertices.len().max(1) as f64
    };
    let claimed: Vec<(DVec3, usize)> =
        shells.iter().zip(part_of_shell.iter()).filter_map(|(s, p)| Some((centre(s), (*p)?))).collect();
    let mut loose = 0;
    for (shell, part) in shells.iter().zip(part_of_shell.iter_mut()).filter(|(_, part)| part.is_none()) {
        let c = centre(shell);
        *part = claimed.iter().min_by(|a, b| a.0.distance(c).total_cmp(&b.0.distance(c))).map(|n| n.1);
        loose += 1;
    }
    if loose > 0 {
        notes
            .warn(format!("{} of the mesh in no component: the nearest component takes it along", words::plural(loose, "piece")));
    }
}

fn spec(section: &JointSection, kind: Kind, a: Side, b: Side, unit_box: UnitBox, notes: &mut Notes) -> JointSpec {
    let plane = kind == Kind::Plane;
    let given = |v: Option<[f64; 3]>| v.map(DVec3::from).and_then(DVec3::try_normalize);
    let z = given(section.z);
    let frame = match (given(section.x), z) {
        (x, Some(z)) if plane => {
            let x = x.unwrap_or_else(|| z.any_orthonormal_vector());
            let x = (x - z * z.dot(x)).normalize_or(z.any_orthonormal_vector());
            DMat3::from_cols(x, z.cross(x), z)
        }
        (x, z) => {
            let x = x.unwrap_or(DVec3::X);
            let z = z.map_or(DVec3::ZERO, |z| z - x * x.dot(z)).normalize_or(x.any_orthonormal_vector());
            DMat3::from_cols(x, z.cross(x), z)
        }
    };
    // At rest every coordinate is 0.
    let mut with_rest = |range: Option<[f64; 2]>, scale: f64| {
        range.map(|[lo, hi]| {
            if lo > 0.0 || hi < 0.0 {
                notes.warn(format!("joint {}: its limits leave out the pose at rest; they are widened to it", section.name));
            }
            (lo.min(0.0) / scale, hi.max(0.0) / scale)
        })
    };
    let turns = matches!(kind, Kind::Revolute | Kind::Cylinder);
    let slides = matches!(kind, Kind::Prismatic | Kind::Cylinder);
    JointSpec {
        name: section.name.clone(),
        kind,
        a,
        b,
        centre: unit_box.enter(section.centre.map_or(unit_box.centre, DVec3::from)),
        frame,
        angle: with_rest(section.angle.filter(|_| turns), 1.0),
        slide: with_rest(section.slide.filter(|_| slides), unit_box.diagonal),
        cone: section.cone.filter(|_| kind == Kind::Ball),
        region: section.region.map(|r| Region { lo: unit_box.enter(r.min.into()), hi: unit_box.enter(r.max.into()) }),
    }
}
