//! `retarget joints`: the joints of a thing made of parts, as a table, a picture and a rig file to be edited.

use super::args::Joints;
use super::console::Console;
use super::{outputs, picture};
use crate::binding::rig::mechanism::{ComponentSection, JointKind, JointSection, MeshSection};
use crate::binding::rig::{RigFile, SpaceSection, Written};
use crate::error::{Error, Result};
use crate::export::files::Pending;
use crate::export::glb;
use crate::joints::{self, Component, Joint, Kind, Options};
use crate::picture::{Colors, Mark, Shape, Sheet, Stroke, Surface, View};
use crate::scan::{self, Scan, UnitBox};
use crate::words;
use glam::DVec3;
use std::path::PathBuf;

/// Components that a file may have: their pairs are all looked at.
const MOST: usize = 2000;

/// Finds the joints and writes the rig file.
///
/// # Errors
/// A file that cannot be read or written; an output that would replace the model or the other one; a mesh with more components than can be paired.
pub(super) fn run(args: &Joints, console: &Console) -> Result<()> {
    let written: Vec<&PathBuf> = std::iter::once(&args.out).chain(&args.picture).collect();
    outputs::checked(&[], &written, &[&args.model], args.force, false, &glb::Recording::new(glb::Options::default()))?;
    let scan = scan::read(&args.model)?;
    let unit_box = UnitBox::of(&scan.mesh).ok_or_else(|| Error::malformed("the mesh has no extent").file(&args.model))?;
    let components = joints::components(&scan);
    if components.len() > MOST {
        return Err(Error::refused(format!("{} components", words::count(components.len())))
            .file(&args.model)
            .expected(format!("at most {}: objects or groups that are the parts", words::count(MOST)))
            .hint("name the parts as objects or groups of an OBJ file"));
    }
    console.station(
        "model",
        &format!(
            "{} · {} vertices · {}",
            words::plural(components.len(), "component"),
            words::count(scan.mesh.positions.len()),
            list(&components)
        ),
    );
    for text in scan.notes.iter() {
        console.warning(text);
    }
    let parts: Vec<joints::Part> = components.iter().map(|c| c.part(&scan.mesh.positions, unit_box.diagonal)).collect();
    let options = Options { reach: args.reach / 100.0, style: args.style.into() };
    let mut found = joints::find(&parts, unit_box.diagonal, &options);
    // What a person has to look at first.
    found.sort_by_key(|j| (j.closes_loop, j.is_sure(), j.a, j.b));
    print(&found, &components, unit_box, console);
    let alone: Vec<&str> = (0..components.len())
        .filter(|&c| !found.iter().any(|j| j.a == c || j.b == c))
        .map(|c| components[c].name.as_str())
        .collect();
    if !alone.is_empty() {
        let some = alone.iter().take(5).copied().collect::<Vec<_>>().join(", ");
        let more = if alone.len() > 5 { ", …" } else { "" };
        console.warning(&format!(
            "{} that nothing touches ({some}{more}): joints of them are written by hand, as [[joint]] in the rig file",
            words::plural(alone.len(), "component")
        ));
    }
    if let Some(path) = &args.picture {
        picture::write(path, &drawn(args, &scan, unit_box, &components, &found))?;
        console.station("picture", &path.display().to_string());
    }
    let text = rig(args, &scan, unit_box, &components, &found).to_text()?;
    let mut file = Pending::create(&args.out)?;
    file.write(text.as_bytes())?;
    file.finish()?;
    console.station("write", &args.out.display().to_string());
    Ok(())
}

fn list(components: &[Component]) -> String {
    let names: Vec<&str> = components.iter().take(6).map(|c| c.name.as_str()).collect();
    format!("{}{}", names.join(", "), if components.len() > 6 { ", …" } else { "" })
}

fn print(found: &[Joint], components: &[Component], unit_box: UnitBox, console: &Console) {
    let sure = found.iter().filter(|j| j.is_sure()).count();
    let loops = found.iter().filter(|j| j.closes_loop).count();
    let beside = if loops > 0 { format!(" · {loops} more would close a loop (off)") } else { String::new() };
    console
        .station("joints", &format!("{} · {sure} sure, {} to look at{beside}", found.len() - loops, found.len() - loops - sure));
    let width = found.iter().map(|j| components[j.a].name.len() + components[j.b].name.len() + 3).max().unwrap_or(0).min(60);
    for joint in found.iter().filter(|j| !j.closes_loop) {
        let pair = format!("{} – {}", components[joint.a].name, components[joint.b].name);
        let doubt = if joint.is_sure() { "" } else { "?" };
        let range = range_words(joint, unit_box).join(", ");
        let of = unit_box.diagonal;
        let place = (joint.centre).to_array().map(|x| rounded(x, of).to_string()).join(" ");
        console.station(
            &format!("  {}{doubt}", joint.kind.word()),
            &format!("  {pair:<width$}  at {place}  {range}  ({}, {})", joint.evidence.word(), clarity(joint)),
        );
    }
}

fn range_words(joint: &Joint, unit_box: UnitBox) -> Vec<String> {
    let degrees = |(lo, hi): (f64, f64)| format!("{:.0}° to {:.0}°", lo.to_degrees(), hi.to_degrees());
    let length = |x: f64| rounded(x, unit_box.diagonal * 100.0);
    let turns = joint.angle.map(degrees);
    let slides = joint.slide.map(|(lo, hi)| format!("{} to {}", length(lo), length(hi)));
    let swings = joint.cone.map(|c| format!("cone {:.0}°", c.to_degrees()));
    [turns, slides, swings].into_iter().flatten().collect()
}

/// How sure a joint is, in words.
fn clarity(joint: &Joint) -> String {
    let how = match joint.kind {
        Kind::Fixed => format!("spread {:.0}", joint.spread),
        // Nothing else moves in the contact at all.
        _ if joint.gap > 9999.0 => "no other fits".to_owned(),
        _ => format!("gap {:.0}", joint.gap),
    };
    format!("{}, {} samples", how, joint.samples)
}

/// The file: doubtful joints first, those that would close a loop last and off.
fn rig(args: &Joints, scan: &Scan, unit_box: UnitBox, components: &[Component], found: &[Joint]) -> RigFile {
    let of = unit_box.diagonal;
    let triple = |v: DVec3, of: f64| v.to_array().map(|x| rounded(x, of));
    let section = |joint: &Joint| {
        let (a, b) = (name(&components[joint.a]), name(&components[joint.b]));
        let sure = if joint.is_sure() { "sure" } else { "look at it" };
        let source = format!("{}, {}: {sure}", joint.evidence.word(), clarity(joint));
        let kind = if joint.closes_loop { None } else { Some(joint.kind) };
        let was = if joint.closes_loop { format!("{}, would close a loop; ", joint.kind.word()) } else { String::new() };
        let plane = joint.kind == Kind::Plane;
        JointSection {
            name: format!("{a}-{b}"),
            kind: Written(JointKind(kind)),
            a,
            b,
            centre: Some(triple(joint.centre, of)),
            x: (joint.kind != Kind::Fixed && !plane).then(|| triple(joint.frame.x_axis, 1.0)),
            z: plane.then(|| triple(joint.frame.z_axis, 1.0)),
            angle: joint.angle.map(|(lo, hi)| [lo, hi].map(|x| rounded(x, 100.0))),
            slide: joint.slide.map(|(lo, hi)| [lo, hi].map(|x| rounded(x, of * 10.0))),
            cone: joint.cone.map(|c| rounded(c, 100.0)),
            region: None,
            source: Some(format!("{was}{source}")),
        }
    };
    RigFile {
        space: SpaceSection {
            scan_unit: scan.space.unit.map(|u| Written(u.value)),
            scan_up: scan.space.up.map(|u| Written(u.value)),
            ..SpaceSection::default()
        },
        mesh: MeshSection {
            file: args.model.file_name().map(|n| n.to_string_lossy().into_owned()),
            vertices: Some(scan.mesh.positions.len()),
            style: Some(Written(args.style.into())),
            reach: Some(args.reach / 100.0),
        },
        components: components
            .iter()
            .map(|c| ComponentSection { name: name(c), shells: shells(c), ..ComponentSection::default() })
            .collect(),
        joints: found.iter().map(section).collect(),
        ..RigFile::default()
    }
}

/// The name of a component in the file, where a slash parts a component from its region.
fn name(component: &Component) -> String {
    component.name.replace('/', "_")
}

/// What a component consists of, where its name does not say it.
fn shells(component: &Component) -> Vec<String> {
    if component.name.contains('/') { vec![component.name.clone()] } else { Vec::new() }
}

/// To about a millionth of `of`, as few digits as that takes.
fn rounded(x: f64, of: f64) -> f64 {
    let decimals = (6.0 - of.log10().ceil()).clamp(0.0, 15.0) as usize;
    let text = format!("{x:.decimals$}");
    // Zero has no sign in the file.
    text.parse::<f64>().unwrap_or(x) + 0.0
}

/// Colours of parts; a part has another than the next one.
const COLORS: [[u8; 3]; 10] = [
    [166, 178, 196],
    [214, 178, 140],
    [168, 194, 160],
    [206, 166, 178],
    [188, 184, 150],
    [150, 186, 196],
    [200, 190, 206],
    [178, 162, 146],
    [156, 170, 150],
    [210, 200, 178],
];
const SURE: [u8; 3] = [30, 124, 84];
const DOUBTFUL: [u8; 3] = [200, 62, 34];

fn drawn(args: &Joints, scan: &Scan, unit_box: UnitBox, components: &[Component], found: &[Joint]) -> crate::picture::Picture {
    let points = unit_box.enter_all(&scan.mesh.positions);
    let triangles: Vec<[u32; 3]> = components.iter().flat_map(|c| c.triangles.iter().copied()).collect();
    let colors: Vec<[u8; 3]> =
        components.iter().enumerate().flat_map(|(k, c)| c.triangles.iter().map(move |_| COLORS[k % COLORS.len()])).collect();
    let kept = || found.iter().filter(|j| !j.closes_loop && j.kind != Kind::Fixed);
    let color = |joint: &Joint| if joint.is_sure() { SURE } else { DOUBTFUL };
    let marks = kept().map(|joint| Mark {
        at: unit_box.enter(joint.centre),
        name: format!("{} {}", joint.kind.word(), components[joint.b].name),
        color: color(joint),
        shape: if joint.kind == Kind::Ball { Shape::Ring } else { Shape::Dot },
        through: true,
    });
    let strokes = kept().filter(|joint| joint.kind != Kind::Ball).map(|joint| {
        let axis = if joint.kind == Kind::Plane { joint.frame.z_axis } else { joint.frame.x_axis } * 0.05;
        let at = unit_box.enter(joint.centre);
        Stroke { from: at - axis, to: at + axis, color: color(joint), width: 3.0, opacity: 0.9 }
    });
    let up = scan.space.up.map_or(DVec3::Z, |up| up.value.vector());
    let front = up.any_orthonormal_vector();
    let front = if up == DVec3::Z {
        DVec3::NEG_Y
    } else if up == DVec3::Y {
        DVec3::Z
    } else {
        front
    };
    let side = up.cross(front);
    let view = |title: &str, toward: DVec3| View { title: title.into(), toward, up };
    crate::picture::draw(&Sheet {
        surfaces: vec![Surface { points: &points, triangles: &triangles, colors: Colors::PerFace(&colors) }],
        views: vec![view("front", front), view("side", side), view("above", front + side + up)],
        marks: marks.collect(),
        strokes: strokes.collect(),
        heading: vec![format!("{}: joints", words::file_name(&args.model))],
        legend: vec![(Shape::Dot, SURE, "sure".into()), (Shape::Dot, DOUBTFUL, "to look at".into())],
        height: 640,
    })
}
