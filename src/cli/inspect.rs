//! `retarget inspect`: what is in scans, captures and outputs.

mod drawing;
mod takes;

use super::args::Inspect;
use super::console::Console;
use crate::binding;
use crate::binding::landmarks::{self, Arms, Body, NotHuman};
use crate::error::{Error, Kind, Notes, Result};
use crate::proxy::medit;
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
        match look(path, args) {
            Ok(found) => {
                print(args, path, &found);
                found.notes.iter().for_each(|text| console.warning(&format!("{}: {text}", path.display())));
            }
            Err(error) if failure.is_ok() => failure = Err(error),
            Err(error) => console.error(&error),
        }
    }
    match (&args.picture, failure) {
        (Some(path), Ok(())) => drawing::draw(args, path),
        (_, failure) => failure,
    }
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

/// What kind of file it is, by its first bytes and its name.
enum Sort {
    Cache,
    Gltf,
    Mesh,
    Proxy,
    Take,
    Mdd,
    /// What is written and not read.
    Written,
}

fn sort(path: &Path) -> Result<Sort> {
    let name = path.file_name().unwrap_or_default().to_string_lossy().to_ascii_lowercase();
    let ends = |extensions: &[&str]| extensions.iter().any(|e| name.trim_end_matches(".gz").ends_with(e));
    let mut head = [0; 12];
    let mut file = File::open(path).map_err(|e| Error::unreadable(path, &e))?;
    let length = file.read(&mut head).map_err(|e| Error::unreadable(path, &e))?;
    Ok(match &head[..length] {
        b"POINTCACHE2\0" => Sort::Cache,
        [b'g', b'l', b'T', b'F', ..] => Sort::Gltf,
        _ if ends(&[".usda", ".usdc", ".usdz", ".abc", ".html", ".png", ".apng"]) => Sort::Written,
        _ if ends(&[".mdd"]) => Sort::Mdd,
        [b'P', b'K', 3, 4, ..] => Sort::Mesh,
        _ if ends(&[".gltf", ".glb"]) => Sort::Gltf,
        _ if ends(&[".obj", ".ply", ".stl", ".off"]) => Sort::Mesh,
        _ if ends(&[".mesh"]) => Sort::Proxy,
        _ => Sort::Take,
    })
}

/// Whether a file may hold a scan.
fn is_mesh(path: &Path) -> Result<bool> {
    sort(path).map(|sort| matches!(sort, Sort::Mesh | Sort::Gltf))
}

fn look(path: &Path, args: &Inspect) -> Result<Found> {
    match sort(path)? {
        Sort::Cache => cache(path),
        Sort::Gltf => with_motion(mesh(path), path, args),
        Sort::Mesh => mesh(path),
        Sort::Proxy => proxy(path),
        Sort::Take => takes::look(path, args),
        Sort::Mdd => mdd(path),
        Sort::Written => Err(Error::new(
            Kind::Unsupported,
            "USD, Alembic, pages and pictures are formats that this program writes, but does not read",
        )
        .file(path)
        .expected("a scan, a capture, a proxy (.mesh), or a .glb, .pc2 or .mdd")
        .hint("for what a run has put into it, see its --report")),
    }
}

/// Adds the animation of joints that a glTF file holds, if any, to what else is in it.
fn with_motion(found: Result<Found>, path: &Path, args: &Inspect) -> Result<Found> {
    let (mut found, motion) = match (found, takes::look(path, args)) {
        (Ok(found), Ok(motion)) => (found, motion),
        // No clip of this name.
        (_, Err(error)) if error.kind == Kind::Usage => return Err(error),
        (Ok(mut found), Err(error)) => {
            if error.kind == Kind::Malformed {
                found.notes.warn(format!("its motion cannot be read: {}", error.found));
            }
            return Ok(found);
        }
        (found, Err(_)) => return found,
        (Err(_), Ok(motion)) => return Ok(motion),
    };
    found.lines.extend(motion.lines);
    found.value["capture"] = motion.value;
    // Both read the same file.
    for text in motion.notes.iter() {
        if !found.notes.iter().any(|other| other == text) {
            found.notes.warn(text);
        }
    }
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
    let points = unit_box.enter_all(&mesh.positions);
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
    let unit = body.as_ref().map_or(scan.space.unit, |b| binding::unit_of_body(b, unit_box.diagonal, scan.space.unit));
    let up = scan.space.up.map(|u| format!("{} up ({})", u.value, u.how));
    let stated: Vec<String> = unit.map(|u| format!("unit {} ({})", u.value, u.how)).into_iter().chain(up).collect();
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
        "unit": unit.map(|u| u.value.to_string()),
        "unit_from": unit.map(|u| u.how.to_string()),
        "body": body.ok().map(|b| json!({
            "stature": b.stature * unit_box.diagonal,
            "up": round(b.up),
            "forward": round(b.forward),
            "margin": b.margin,
            "arm_elevation": b.arm_elevation,
            "arms": if b.arms == Arms::Hanging { "along the trunk" } else { "apart" },
            "floor": b.floor.is_some(),
            "joints": b.joints.iter().map(|&p| round(unit_box.leave(p))).collect::<Vec<_>>(),
        })),
    });
    Ok(Found { value, lines, notes: scan.notes })
}

/// A tetrahedral proxy.
fn proxy(path: &Path) -> Result<Found> {
    let (vertices, tetrahedra) = medit::look(path)?;
    let (lo, hi) = vertices.iter().fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(lo, hi), p| (lo.min(*p), hi.max(*p)));
    let lines = vec![
        format!("proxy · {} · {} tetrahedra", words::plural(vertices.len(), "vertex"), words::count(tetrahedra)),
        format!("box {} .. {}", triple(lo), triple(hi)),
    ];
    let value = json!({
        "kind": "proxy", "vertices": vertices.len(), "tetrahedra": tetrahedra, "box": [lo.to_array(), hi.to_array()],
    });
    Ok(Found { value, lines, notes: Notes::default() })
}

fn triple(v: DVec3) -> String {
    format!("({} {} {})", words::digits(v.x), words::digits(v.y), words::digits(v.z))
}

fn body_words(body: &std::result::Result<Body, NotHuman>, unit_box: UnitBox) -> String {
    match body {
        Ok(b) => format!(
            "a person, {} high, up {}, facing {}, arms {:.0}° and {:.0}° against the horizontal{}{}, margin {:.2}",
            words::digits(b.stature * unit_box.diagonal),
            triple(b.up),
            triple(b.forward),
            b.arm_elevation[0],
            b.arm_elevation[1],
            if b.arms == Arms::Hanging { " along the trunk" } else { "" },
            if b.floor.is_some() { ", on a floor that has grown together with the feet" } else { "" },
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
    of_cache(path, "PC2", [points, samples], [bytes, expected])
}

fn mdd(path: &Path) -> Result<Found> {
    let unreadable = |e: std::io::Error| Error::unreadable(path, &e);
    let mut head = [[0; 4]; 2];
    let mut file = File::open(path).map_err(unreadable)?;
    let short = |_| Error::malformed("the header is cut short").file(path).expected("8 bytes");
    head.iter_mut().try_for_each(|word| file.read_exact(word)).map_err(short)?;
    let [samples, points] = head.map(i32::from_be_bytes);
    let bytes = file.metadata().map_err(unreadable)?.len();
    let [many, each] = [samples, points].map(|n| u64::from(n.unsigned_abs()));
    of_cache(path, "MDD", [points, samples], [bytes, 8 + many * 4 + many * each * 12])
}

/// A point cache, if it is as long as its header says.
fn of_cache(path: &Path, format: &str, [points, samples]: [i32; 2], [bytes, expected]: [u64; 2]) -> Result<Found> {
    if points < 0 || samples < 0 || bytes != expected {
        return Err(Error::malformed(format!("{bytes} bytes for {points} points and {samples} samples"))
            .file(path)
            .expected(format!("{expected} bytes")));
    }
    let lines = vec![format!("cache · {} points, {} samples", words::count(points as usize), words::count(samples as usize))];
    Ok(Found {
        value: json!({ "kind": "cache", "format": format, "points": points, "samples": samples }),
        lines,
        notes: Notes::default(),
    })
}
