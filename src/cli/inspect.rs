//! `retarget inspect`: what is in scans, captures and outputs.

mod takes;

use super::args::Inspect;
use super::console::Console;
use crate::binding::landmarks::{self, Body, NotHuman};
use crate::error::{Error, Notes, Result};
use crate::scan::{self, UnitBox};
use crate::words;
use anstream::println;
use glam::DVec3;
use serde_json::{Value, json};
use std::fs::File;
use std::io::Read;
use std::path::Path;

/// What was found in a file: for programs, for people, and what was doubtful.
struct Found {
    value: Value,
    lines: Vec<String>,
    notes: Notes,
}

/// Prints what is in every file on standard output; warnings go to standard error.
pub(super) fn run(args: &Inspect, console: &Console) -> Result<()> {
    let mut failure = Ok(());
    for path in &args.files {
        match look(path, args.ascii) {
            Ok(found) => {
                print(args, path, &found);
                found.notes.iter().for_each(|text| console.warning(&format!("{}: {text}", path.display())));
            }
            Err(error) if failure.is_ok() => failure = Err(error),
            Err(error) => console.error(&error),
        }
    }
    failure
}

#[allow(clippy::print_stdout)]
fn print(args: &Inspect, path: &Path, found: &Found) {
    if args.json {
        let mut value = found.value.clone();
        value["file"] = json!(path.display().to_string());
        value["warnings"] = found.notes.iter().collect();
        println!("{value}");
    } else {
        println!("\x1b[1m{}\x1b[0m", path.display());
        found.lines.iter().for_each(|line| println!("  {line}"));
    }
}

fn look(path: &Path, ascii: bool) -> Result<Found> {
    let name = path.file_name().unwrap_or_default().to_string_lossy().to_ascii_lowercase();
    let mut head = [0; 12];
    let mut file = File::open(path).map_err(|e| Error::unreadable(path, &e))?;
    let length = file.read(&mut head).map_err(|e| Error::unreadable(path, &e))?;
    match &head[..length] {
        b"POINTCACHE2\0" => cache(path),
        [b'g', b'l', b'T', b'F', ..] => with_motion(binary_gltf(path).map(|found| with_mesh(found, path)), path, ascii),
        [b'P', b'K', 3, 4, ..] => mesh(path),
        _ if [".gltf", ".glb"].iter().any(|e| name.trim_end_matches(".gz").ends_with(e)) => with_motion(mesh(path), path, ascii),
        _ if [".obj", ".ply", ".stl", ".off"].iter().any(|e| name.trim_end_matches(".gz").ends_with(e)) => mesh(path),
        _ => takes::look(path, ascii),
    }
}

/// Adds what a glTF file is as a scan, if it is one.
fn with_mesh(mut found: Found, path: &Path) -> Found {
    if let Ok(mesh) = mesh(path) {
        for (key, value) in mesh.value.as_object().into_iter().flatten() {
            if found.value[key].is_null() {
                found.value[key] = value.clone();
            }
        }
        found.lines.extend(mesh.lines);
        found.notes.extend(mesh.notes);
    }
    found
}

/// Adds the animation of joints that a glTF file holds, if any, to what else is in it.
fn with_motion(found: Result<Found>, path: &Path, ascii: bool) -> Result<Found> {
    let (mut found, motion) = match (found, takes::look(path, ascii)) {
        (Ok(found), Ok(motion)) => (found, motion),
        (found, Err(_)) => return found,
        (Err(_), Ok(motion)) => return Ok(motion),
    };
    found.lines.extend(motion.lines);
    found.value["capture"] = motion.value;
    found.notes.extend(motion.notes);
    Ok(found)
}

fn mesh(path: &Path) -> Result<Found> {
    let scan = scan::read(path)?;
    let (mesh, look) = (&scan.mesh, &scan.look);
    let unit_box = UnitBox::of(mesh).ok_or_else(|| Error::malformed("the mesh has no extent").file(path))?;
    let used = mesh.faces.corners.iter().map(|&v| mesh.positions[v as usize]);
    let (lo, hi) = used.fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(lo, hi), p| (lo.min(p), hi.max(p)));
    let sides = |n: std::ops::RangeInclusive<usize>| mesh.faces.iter().filter(|f| n.contains(&f.len())).count();
    let (triangles, quads, larger) = (sides(0..=3), sides(4..=4), sides(5..=usize::MAX));
    let points: Vec<DVec3> = mesh.positions.iter().map(|&p| unit_box.enter(p)).collect();
    let body = landmarks::find(&points, &mesh.vertex_triangles());
    let round = |v: DVec3| v.to_array().map(|c| (c * 1e6).round() / 1e6);
    let mut lines = vec![
        format!(
            "scan · {} · {}, {}, {} larger",
            words::plural(mesh.positions.len(), "vertex"),
            words::plural(triangles, "triangle"),
            words::plural(quads, "quad"),
            words::count(larger)
        ),
        format!("box {} .. {} · diagonal {}", triple(lo), triple(hi), words::digits(unit_box.diagonal)),
        format!(
            "{} · {} · {} · {}",
            words::plural(look.materials.len(), "material"),
            words::plural(look.groups.len(), "group"),
            if look.uvs.is_empty() { "no uv" } else { "uv" },
            if look.colors.is_empty() { "no vertex colours" } else { "vertex colours" }
        ),
        body_words(&body, unit_box),
    ];
    let unit = scan.space.unit.map(|u| format!("unit {} ({})", u.value, u.how));
    let up = scan.space.up.map(|u| format!("{} up ({})", u.value, u.how));
    let stated: Vec<String> = unit.into_iter().chain(up).collect();
    if !stated.is_empty() {
        lines.push(stated.join(" · "));
    }
    let value = json!({
        "kind": "scan",
        "vertices": mesh.positions.len(),
        "faces": { "triangles": triangles, "quads": quads, "larger": larger },
        "box": [round(lo), round(hi)],
        "diagonal": unit_box.diagonal,
        "materials": look.materials.iter().map(|m| m.name.clone()).collect::<Vec<_>>(),
        "up": scan.space.up.map(|u| u.value.to_string()),
        "groups": look.groups.iter().map(|g| g.group.clone().or(g.object.clone())).collect::<Vec<_>>(),
        "uv": !look.uvs.is_empty(),
        "vertex_colors": !look.colors.is_empty(),
        "unit": scan.space.unit.map(|u| u.value.to_string()),
        "body": body.ok().map(|b| json!({
            "stature": b.stature * unit_box.diagonal,
            "up": round(b.up),
            "forward": round(b.forward),
            "margin": b.margin,
            "arm_elevation": b.arm_elevation,
            "joints": b.joints.iter().map(|&p| round(unit_box.leave(p))).collect::<Vec<_>>(),
        })),
    });
    Ok(Found { value, lines, notes: scan.notes })
}

fn triple(v: DVec3) -> String {
    format!("({} {} {})", words::digits(v.x), words::digits(v.y), words::digits(v.z))
}

fn body_words(body: &std::result::Result<Body, NotHuman>, unit_box: UnitBox) -> String {
    match body {
        Ok(b) => format!(
            "a person, {} high, up {}, facing {}, arms {:.0}° and {:.0}° against the horizontal, margin {:.2}",
            words::digits(b.stature * unit_box.diagonal),
            triple(b.up),
            triple(b.forward),
            b.arm_elevation[0],
            b.arm_elevation[1],
            b.margin
        ),
        Err(reason) => format!("no person was recognised: {}", reason.reason),
    }
}

fn cache(path: &Path) -> Result<Found> {
    let unreadable = |e: std::io::Error| Error::unreadable(path, &e);
    let mut head = [0; 32];
    let mut file = File::open(path).map_err(unreadable)?;
    file.read_exact(&mut head).map_err(|_| Error::malformed("the header is cut short").file(path).expected("32 bytes"))?;
    let word = |at: usize| [head[at], head[at + 1], head[at + 2], head[at + 3]];
    let (points, samples) = (i32::from_le_bytes(word(16)), i32::from_le_bytes(word(28)));
    let bytes = file.metadata().map_err(unreadable)?.len();
    let expected = 32 + u64::from(points.unsigned_abs()) * u64::from(samples.unsigned_abs()) * 12;
    if points < 0 || samples < 0 || bytes != expected {
        return Err(Error::malformed(format!("{bytes} bytes for {points} points and {samples} samples"))
            .file(path)
            .expected(format!("{expected} bytes")));
    }
    let lines = vec![format!("cache · {} points, {} samples", words::count(points as usize), words::count(samples as usize))];
    Ok(Found { value: json!({ "kind": "cache", "points": points, "samples": samples }), lines, notes: Notes::default() })
}

fn binary_gltf(path: &Path) -> Result<Found> {
    let unreadable = |e: std::io::Error| Error::unreadable(path, &e);
    let bytes = std::fs::read(path).map_err(unreadable)?;
    let broken = |what: &str| Error::malformed(what).file(path).expected("a binary glTF 2.0 file");
    let word = |at: usize| bytes.get(at..at + 4).map(|b| u32::from_le_bytes([b[0], b[1], b[2], b[3]]) as usize);
    let length = word(12).ok_or_else(|| broken("the header is cut short"))?;
    let text = bytes.get(20..20usize.saturating_add(length)).ok_or_else(|| broken("the JSON chunk is cut short"))?;
    let json: Value = serde_json::from_slice(text).map_err(|e| broken(&format!("the JSON chunk is broken: {e}")))?;
    let list = |key: &str| json[key].as_array().cloned().unwrap_or_default();
    let count =
        |accessor: &Value| accessor.as_u64().and_then(|i| json["accessors"][i as usize]["count"].as_u64()).unwrap_or(0) as usize;
    let primitives: Vec<Value> =
        list("meshes").iter().flat_map(|m| m["primitives"].as_array().cloned().unwrap_or_default()).collect();
    let vertices: usize = primitives.iter().map(|p| count(&p["attributes"]["POSITION"])).sum();
    let triangles: usize = primitives.iter().map(|p| count(&p["indices"]) / 3).sum();
    let joints: usize = list("skins").iter().map(|s| s["joints"].as_array().map_or(0, Vec::len)).sum();
    let keys = list("animations")
        .iter()
        .flat_map(|a| a["samplers"].as_array().cloned().unwrap_or_default())
        .map(|s| count(&s["input"]))
        .max()
        .unwrap_or(0);
    let lines = vec![format!(
        "glTF · {} in {}, {} · {} · {} · {}",
        words::plural(vertices, "vertex"),
        words::plural(primitives.len(), "primitive"),
        words::plural(triangles, "triangle"),
        words::plural(joints, "joint"),
        words::plural(keys, "key"),
        words::plural(list("materials").len(), "material")
    )];
    let value = json!({
        "kind": "gltf", "vertices": vertices, "primitives": primitives.len(), "triangles": triangles, "joints": joints, "keys": keys,
        "materials": list("materials").len(),
    });
    Ok(Found { value, lines, notes: Notes::default() })
}
