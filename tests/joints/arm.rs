//! An arm of four parts for whole runs of the program: a ball, a hinge and a sliding hand, all rigid or with a soft forearm.

use crate::shapes::{Mesh, turned};
use glam::{DQuat, DVec3};
use retarget::glam;
use std::fmt::Write as _;
use std::path::Path;

pub const PARTS: [&str; 4] = ["base", "upper", "fore", "hand"];
/// Heights at which parts meet.
const MEET: [f64; 5] = [0.0, 0.4, 1.0, 1.6, 1.9];

/// A point of the arm with its joints bent, as a part: turn of the ball about Y, of the hinge about X, slide of the hand.
pub fn bent(part: usize, p: DVec3, [ball, hinge, slide]: [f64; 3]) -> DVec3 {
    let about = |p: DVec3, q: DQuat, height: f64| q * (p - DVec3::Z * height) + DVec3::Z * height;
    let p = if part > 2 { p + DVec3::Z * slide } else { p };
    let p = if part > 1 { about(p, DQuat::from_rotation_x(hinge), MEET[2]) } else { p };
    if part > 0 { about(p, DQuat::from_rotation_y(ball), MEET[1]) } else { p }
}

/// Surfaces of the parts.
pub fn meshes() -> [Mesh; 4] {
    std::array::from_fn(|k| {
        let (lo, hi, radius) = (MEET[k], MEET[k + 1], 0.16 - 0.03 * k as f64);
        let rings = (0..=12).map(|i| (radius, lo + (hi - lo) * f64::from(i) / 12.0));
        let outline: Vec<(f64, f64)> = [(0.0, lo)].into_iter().chain(rings).chain([(0.0, hi)]).collect();
        turned(&outline, 10)
    })
}

/// Part and place of each vertex.
pub fn rest() -> Vec<(usize, DVec3)> {
    meshes().into_iter().enumerate().flat_map(|(part, mesh)| mesh.0.into_iter().map(move |p| (part, p))).collect()
}

/// A similarity of space: what everything of a run is seen through.
#[derive(Clone, Copy)]
pub struct View {
    pub scale: f64,
    pub turn: DQuat,
    pub shift: DVec3,
}

impl View {
    pub const PLAIN: Self = Self { scale: 1.0, turn: DQuat::IDENTITY, shift: DVec3::ZERO };

    pub fn see(&self, p: DVec3) -> DVec3 {
        self.turn * p * self.scale + self.shift
    }
}

/// Writes mesh and rig file.
pub fn write(folder: &Path, view: &View, soft: bool) {
    let mut text = String::new();
    let mut first = 1;
    for (name, (points, triangles)) in PARTS.iter().zip(meshes()) {
        let _ = writeln!(text, "o {name}");
        for p in &points {
            let p = view.see(*p);
            let _ = writeln!(text, "v {} {} {}", p.x, p.y, p.z);
        }
        for t in triangles {
            let _ = writeln!(text, "f {} {} {}", t[0] + first, t[1] + first, t[2] + first);
        }
        first += points.len() as u32;
    }
    std::fs::write(folder.join("arm.obj"), text).expect("a mesh");
    let mut rig = String::new();
    for name in PARTS {
        let body = if soft && name == "fore" { "kind = \"soft\"\ncells = [6, 1, 1]\n" } else { "" };
        let _ = write!(rig, "[[component]]\nname = \"{name}\"\n{body}");
    }
    let limits = [
        ("ball", "cone = 0.9".to_owned(), DVec3::Z),
        ("revolute", "angle = [-0.2, 1.6]".to_owned(), DVec3::X),
        ("cylinder", format!("slide = [{}, {}]", -0.1 * view.scale, 0.1 * view.scale), DVec3::Z),
    ];
    for (k, (kind, limit, axis)) in limits.into_iter().enumerate() {
        let (centre, x) = (view.see(DVec3::Z * MEET[k + 1]).to_array(), (view.turn * axis).to_array());
        let (a, b) = (PARTS[k], PARTS[k + 1]);
        let _ = write!(
            rig,
            "[[joint]]\nname = \"{a}-{b}\"\ntype = \"{kind}\"\na = \"{a}\"\nb = \"{b}\"\ncentre = {centre:?}\nx = {x:?}\n{limit}\n"
        );
    }
    std::fs::write(folder.join("rig.toml"), rig).expect("a rig file");
}

/// Handles: three on the base, one at the elbow, three on the hand, by part and place.
pub fn spots() -> Vec<(usize, DVec3)> {
    let ring = |part: usize, height: f64| {
        (0..3).map(move |k| (part, DQuat::from_rotation_z(f64::from(k) * 2.1) * DVec3::new(0.08, 0.0, height)))
    };
    ring(0, 0.2).chain([(1, DVec3::new(0.0, 0.1, 0.95))]).chain(ring(3, 1.75)).collect()
}

/// Writes a table of handles; the first frame is at rest, what is not finite has no row.
pub fn write_table(path: &Path, view: &View, frames: &[Vec<DVec3>]) {
    let mut text = "frame,name,x,y,z\n".to_owned();
    for (frame, places) in frames.iter().enumerate() {
        for (k, p) in places.iter().enumerate().filter(|p| p.1.is_finite()) {
            let p = view.see(*p);
            let _ = writeln!(text, "{frame},h{k},{},{},{}", p.x, p.y, p.z);
        }
    }
    std::fs::write(path, text).expect("a table");
}

/// Places of the handles in takes of so many frames: within all joints, and beyond their limits.
pub fn takes(frames: usize) -> [(&'static str, Vec<Vec<DVec3>>); 2] {
    let within = |t: f64| [0.5 * t.sin(), 0.7 - 0.7 * t.cos(), 0.06 * (2.0 * t).sin()];
    let beyond = |t: f64| [1.4 * t.sin(), 0.4 * t, 0.2 * (1.5 * t).sin()];
    let play = |joints: &dyn Fn(f64) -> [f64; 3]| {
        let frame = |f: usize| spots().iter().map(|&(part, p)| bent(part, p, joints(0.12 * f as f64))).collect();
        (0..frames).map(frame).collect()
    };
    [("within", play(&within)), ("beyond", play(&beyond))]
}
