//! What the recipes of the guide need beside the walk: an actor of another build, the walk as a skeleton, a machine and a trunk that bends, each with a table
//! that drives it.

use super::body::{Body, Bone, CHEST, HEAD, LEG, PELVIS};
use super::markers::{glued, laboratory};
use super::motion::{RATE, pose};
use crate::c3d_writer;
use glam::{DMat3, DQuat, DVec3, EulerRot};
use std::f64::consts::TAU;
use std::fmt::Write as _;

/// Frames of the walk that the tall actor's take has: in none of them does he stand as the scan does.
const TALL_FRAMES: std::ops::Range<usize> = 60..180;
/// Every so many frames of the walk are in the skeleton's take.
const SKELETON_STEP: usize = 4;
/// Frames of the skeleton's take.
const SKELETON_FRAMES: usize = 60;

/// How much larger each bone of the tall actor is.
fn growth(bone: usize) -> f64 {
    match bone {
        PELVIS => 1.03,
        CHEST => 1.05,
        HEAD => 1.0,
        b if LEG.iter().any(|&leg| (leg..leg + 3).contains(&b)) => 1.12,
        _ => 1.08,
    }
}

/// The skeleton of the tall actor: the same directions, other lengths, soles on the floor.
fn tall(bones: &[Bone]) -> Vec<Bone> {
    let mut out: Vec<Bone> = Vec::new();
    for (b, bone) in bones.iter().enumerate() {
        let from = if b == PELVIS {
            bone.from
        } else {
            out[bone.parent].from + (bone.from - bones[bone.parent].from) * growth(bone.parent)
        };
        out.push(Bone { parent: bone.parent, from, to: from + (bone.to - bone.from) * growth(b), radii: bone.radii });
    }
    let foot = LEG[0] + 2;
    let lift = DVec3::Y * (bones[foot].from.y * growth(foot) - out[foot].from.y);
    out.iter_mut().for_each(|bone| (bone.from, bone.to) = (bone.from + lift, bone.to + lift));
    out
}

/// Markers of the tall actor, who walks as the fixture does.
pub fn tall_c3d(body: &Body, bones: &[Bone]) -> Vec<u8> {
    let tall = tall(bones);
    let glued = glued(body, bones);
    let mut points = Vec::new();
    for frame in TALL_FRAMES {
        let pose = pose(&tall, frame);
        for (_, vertex) in &glued {
            let rest = body.points[*vertex];
            let place = body.weights[*vertex]
                .iter()
                .map(|&(b, w)| (pose[b].0 * (rest - bones[b].from) * growth(b) + pose[b].1) * w)
                .sum::<DVec3>();
            points.push(Some(laboratory(place).to_array().map(|c| c as f32)));
        }
    }
    c3d_writer::C3dFile {
        labels: glued.into_iter().map(|(name, _)| name).collect(),
        points,
        rate: RATE as f32,
        ..c3d_writer::C3dFile::default()
    }
    .bytes()
}

/// Names of the bones as joints, in the order of the bones.
const JOINTS: [&str; 15] = [
    "Hips",
    "Spine",
    "Head",
    "LeftArm",
    "LeftForeArm",
    "LeftHand",
    "RightArm",
    "RightForeArm",
    "RightHand",
    "LeftUpLeg",
    "LeftLeg",
    "LeftFoot",
    "RightUpLeg",
    "RightLeg",
    "RightFoot",
];

/// The walk of the tall actor as a skeleton in centimetres.
pub fn bvh(bones: &[Bone]) -> Vec<u8> {
    let bones = &tall(bones);
    let mut text = String::from("HIERARCHY\n");
    joint(bones, PELVIS, 0, &mut text);
    let order = depth_first(bones, PELVIS);
    let _ = write!(text, "MOTION\nFrames: {SKELETON_FRAMES}\nFrame Time: {:.6}\n", SKELETON_STEP as f64 / RATE);
    for frame in (0..).step_by(SKELETON_STEP).take(SKELETON_FRAMES) {
        let pose = pose(bones, frame);
        let root = pose[PELVIS].1 * 100.0;
        let _ = write!(text, "{:.3} {:.3} {:.3}", root.x, root.y, root.z);
        for &b in &order {
            let above = if b == PELVIS { DMat3::IDENTITY } else { pose[bones[b].parent].0 };
            let local = DQuat::from_mat3(&(above.transpose() * pose[b].0));
            let (z, x, y) = local.to_euler(EulerRot::ZXY);
            for angle in [z, x, y] {
                // No minus before zero.
                let _ = write!(text, " {:.3}", (angle.to_degrees() * 1e3).round() / 1e3 + 0.0);
            }
        }
        text.push('\n');
    }
    text.into_bytes()
}

fn children(bones: &[Bone], of: usize) -> impl Iterator<Item = usize> {
    (0..bones.len()).filter(move |&b| b != PELVIS && bones[b].parent == of)
}

fn depth_first(bones: &[Bone], bone: usize) -> Vec<usize> {
    std::iter::once(bone).chain(children(bones, bone).flat_map(|b| depth_first(bones, b))).collect()
}

fn joint(bones: &[Bone], bone: usize, depth: usize, text: &mut String) {
    let indent = "  ".repeat(depth);
    let offset = |v: DVec3| {
        let v = v * 100.0;
        format!("OFFSET {:.3} {:.3} {:.3}", v.x, v.y, v.z)
    };
    let (kind, from, channels) = if bone == PELVIS {
        ("ROOT", bones[bone].from, "6 Xposition Yposition Zposition")
    } else {
        ("JOINT", bones[bone].from - bones[bones[bone].parent].from, "3")
    };
    let _ = writeln!(text, "{indent}{kind} {}\n{indent}{{\n{indent}  {}", JOINTS[bone], offset(from));
    let _ = writeln!(text, "{indent}  CHANNELS {channels} Zrotation Xrotation Yrotation");
    let mut leaf = true;
    for child in children(bones, bone) {
        joint(bones, child, depth + 1, text);
        leaf = false;
    }
    if leaf {
        let _ = writeln!(
            text,
            "{indent}  End Site\n{indent}  {{\n{indent}    {}\n{indent}  }}",
            offset(bones[bone].to - bones[bone].from)
        );
    }
    let _ = writeln!(text, "{indent}}}");
}

/// Hinges of the lamp, metres, Z up; their axes are Y.
const HINGES: [DVec3; 3] = [DVec3::new(0.0, 0.0, 0.10), DVec3::new(-0.12, 0.0, 0.42), DVec3::new(0.22, 0.0, 0.60)];
/// Radius of the bolts, of what is around them, and the air between, metres.
const BOLT: [f64; 3] = [0.010, 0.022, 0.0002];
/// Half the width of the arms between their forks, and of the forks.
const WIDTH: [f64; 2] = [0.020, 0.032];

/// A mesh that parts are put together of.
#[derive(Default)]
struct Part {
    points: Vec<DVec3>,
    quads: Vec<[usize; 4]>,
}

impl Part {
    /// A ring of rectangular or richer section: an outline of (radius, place along Y), turned about an axis Y through `centre`.
    fn turned(&mut self, centre: DVec3, outline: &[(f64, f64)]) {
        const AROUND: usize = 32;
        let first = self.points.len();
        for &(r, y) in outline {
            for k in 0..AROUND {
                let (sin, cos) = ((k as f64 + 0.5) * TAU / AROUND as f64).sin_cos();
                self.points.push(centre + DVec3::new(r * sin, y, r * cos));
            }
        }
        let at = |i: usize, k: usize| first + (i % outline.len()) * AROUND + k % AROUND;
        for i in 0..outline.len() {
            self.quads.extend((0..AROUND).map(|k| [at(i, k), at(i, k + 1), at(i + 1, k + 1), at(i + 1, k)]));
        }
    }

    /// A straight bar between two places, so wide across, between two places along Y.
    fn bar(&mut self, a: DVec3, b: DVec3, half: f64, y: [f64; 2]) {
        let across = (b - a).normalize().cross(DVec3::Y) * half;
        let first = self.points.len();
        for end in [a, b] {
            for (side, y) in [(-1.0, y[0]), (1.0, y[0]), (1.0, y[1]), (-1.0, y[1])] {
                self.points.push(end + across * side + DVec3::Y * y);
            }
        }
        for quad in [[0, 1, 2, 3], [7, 6, 5, 4], [0, 4, 5, 1], [1, 5, 6, 2], [2, 6, 7, 3], [3, 7, 4, 0]] {
            self.quads.push(quad.map(|i| first + i));
        }
    }

    /// What turns on a bolt: the ring around it.
    fn eye(&mut self, at: DVec3) {
        let (inner, outer, half) = (BOLT[0] + BOLT[2], BOLT[1], WIDTH[0]);
        self.turned(at, &[(inner, -half), (outer, -half), (outer, half), (inner, half)]);
    }

    /// A bolt with its collars, and the two plates of a fork that hold it, towards `to`; they meet there.
    fn fork(&mut self, at: DVec3, to: DVec3) {
        let (inner, outer) = (WIDTH[0] + BOLT[2], WIDTH[1]);
        let (r, collar) = (BOLT[0], BOLT[1] * 0.8);
        let outline = [
            (0.0, -outer),
            (collar, -outer),
            (collar, -inner),
            (r, -inner),
            (r, inner),
            (collar, inner),
            (collar, outer),
            (0.0, outer),
        ];
        self.turned(at, &outline);
        let far = at + (to - at).normalize() * 0.05;
        for side in [-1.0, 1.0] {
            let mut y = [side * (inner + 0.002), side * outer];
            y.sort_by(f64::total_cmp);
            self.bar(at, far, 0.012, y);
        }
        self.bar(far - (to - at).normalize() * 0.012, to, 0.012, [-outer, outer]);
    }
}

/// The parts of the lamp, by name.
fn lamp_parts() -> Vec<(&'static str, Part)> {
    let [foot, elbow, neck] = HINGES;
    let mut base = Part::default();
    base.bar(DVec3::new(-0.12, 0.0, 0.015), DVec3::new(0.12, 0.0, 0.015), 0.015, [-0.1, 0.1]);
    base.fork(foot, DVec3::Z * 0.03);
    let mut lower = Part::default();
    lower.eye(foot);
    lower.eye(elbow);
    let along = (elbow - foot).normalize() * BOLT[1] * 0.95;
    lower.bar(foot + along, elbow - along, 0.010, [-0.012, 0.012]);
    let mut upper = Part::default();
    upper.fork(elbow, elbow.lerp(neck, 0.6));
    upper.eye(neck);
    upper.bar(elbow.lerp(neck, 0.55), neck - (neck - elbow).normalize() * BOLT[1] * 0.95, 0.010, [-0.012, 0.012]);
    let mut shade = Part::default();
    let tip = neck + DVec3::new(0.10, 0.0, -0.05);
    shade.fork(neck, tip);
    shade.bar(tip, tip + DVec3::new(0.06, 0.0, -0.03), 0.05, [-0.05, 0.05]);
    vec![("base", base), ("lower", lower), ("upper", upper), ("shade", shade)]
}

/// A lamp of four parts with three hinges.
pub fn lamp_obj() -> Vec<u8> {
    let mut text = String::from("# a lamp of four parts: metres, Z up\n");
    let mut first = 1;
    for (name, part) in lamp_parts() {
        let _ = writeln!(text, "o {name}");
        for p in &part.points {
            let _ = writeln!(text, "v {:.5} {:.5} {:.5}", p.x + 0.0, p.y + 0.0, p.z + 0.0);
        }
        for quad in &part.quads {
            let [a, b, c, d] = quad.map(|i| i + first);
            let _ = writeln!(text, "f {a} {b} {c} {d}");
        }
        first += part.points.len();
    }
    text.into_bytes()
}

/// What drives the lamp: its base stays, and its shade is led by two places.
pub fn lamp_csv() -> Vec<u8> {
    let mut text = String::from("frame,name,x,y,z\n");
    let [foot, elbow, neck] = HINGES;
    let corners = [DVec3::new(-0.12, -0.1, 0.0), DVec3::new(0.12, -0.1, 0.0), DVec3::new(0.0, 0.1, 0.03)];
    let places = [neck + DVec3::new(0.05, 0.0, -0.025), neck + DVec3::new(0.16, 0.0, -0.08)];
    for frame in 0..48 {
        let swing = (f64::from(frame) * TAU / 47.0).sin();
        let about = |centre: DVec3, angle: f64, p: DVec3| centre + DQuat::from_rotation_y(angle) * (p - centre);
        for (name, p) in ["corner 1", "corner 2", "corner 3"].iter().zip(corners) {
            let _ = writeln!(text, "{frame},{name},{:.5},{:.5},{:.5}", p.x, p.y, p.z);
        }
        // From the last hinge to the first.
        let places = places.map(|p| about(foot, 0.35 * swing, about(elbow, -0.6 * swing, about(neck, 0.5 * swing, p))));
        for (name, p) in ["shade", "rim"].iter().zip(places) {
            let _ = writeln!(text, "{frame},{name},{:.5},{:.5},{:.5}", p.x, p.y + 0.0, p.z);
        }
    }
    text.into_bytes()
}

/// Rings of the trunk, corners of each, its radius and height, and where it bends, metres.
const TRUNK: (usize, usize, f64, f64, [f64; 2]) = (45, 14, 0.11, 1.0, [0.35, 0.7]);

/// A place of the trunk, which stands on the origin, when it is bent towards +X by an angle; its inner side bulges as it bends.
fn bent(p: DVec3, angle: f64) -> DVec3 {
    let ([from, to], angle) = (TRUNK.4, angle.max(1e-6));
    let along = ((p.z - from) / (to - from)).clamp(0.0, 1.0);
    let (sin, cos) = (angle * along).sin_cos();
    let radius = (to - from) / angle;
    let bulge = 1.0 + 0.35 * (angle / (TAU / 4.0)) * (along * TAU / 2.0).sin().powi(2) * f64::from(p.x > 0.0) * p.x / TRUNK.2;
    let (x, beyond) = (p.x * bulge, (p.z - to).max(0.0) + (p.z - from).min(0.0));
    let centre = DVec3::new(radius * (1.0 - cos), p.y, from + radius * sin);
    centre + DVec3::new(x * cos + beyond * sin, 0.0, beyond * cos - x * sin)
}

/// The trunk, bent by an angle.
pub fn trunk_obj(angle: f64) -> Vec<u8> {
    let (rings, around, radius, height, _) = TRUNK;
    let mut points = vec![DVec3::ZERO];
    for ring in 0..rings {
        let z = height * ring as f64 / (rings - 1) as f64;
        let round = (1.0 - ((z / height - 0.5).abs() * 2.0).powi(16)).max(0.04).sqrt();
        for k in 0..around {
            let (sin, cos) = (k as f64 * TAU / around as f64).sin_cos();
            points.push(DVec3::new(cos, sin, 0.0) * (radius * round * (1.0 - 0.35 * z)) + DVec3::Z * z);
        }
    }
    points.push(DVec3::Z * height);
    let mut text = String::from("# a trunk: metres, Z up\no trunk\n");
    for p in &points {
        let p = bent(*p, angle);
        let _ = writeln!(text, "v {:.5} {:.5} {:.5}", p.x + 0.0, p.y + 0.0, p.z + 0.0);
    }
    let at = |ring: usize, k: usize| 2 + ring * around + k % around;
    for k in 0..around {
        let _ = writeln!(text, "f 1 {} {}", at(0, k + 1), at(0, k));
        for ring in 0..rings - 1 {
            let [a, b, c, d] = [at(ring, k), at(ring, k + 1), at(ring + 1, k + 1), at(ring + 1, k)];
            let _ = writeln!(text, "f {a} {b} {c} {d}");
        }
        let _ = writeln!(text, "f {} {} {}", at(rings - 1, k), at(rings - 1, k + 1), points.len());
    }
    text.into_bytes()
}

/// What drives the trunk: places around its foot stay, and three at its tip go along as it bends by up to 80 degrees.
pub fn trunk_csv() -> Vec<u8> {
    let mut text = String::from("frame,name,x,y,z\n");
    let r = TRUNK.2;
    let foot = [DVec3::new(r, 0.0, 0.1), DVec3::new(-r, 0.0, 0.1), DVec3::new(0.0, r, 0.1)];
    let tip = [DVec3::new(0.06, 0.0, 0.9), DVec3::new(-0.06, 0.0, 0.9), DVec3::new(0.0, 0.06, 0.95)];
    for frame in 0..40 {
        let angle = (80.0_f64.to_radians()) * 0.5 * (1.0 - (f64::from(frame) * TAU / 39.0).cos());
        let places = foot.iter().copied().chain(tip.map(|p| bent(p, angle)));
        for (name, p) in ["foot 1", "foot 2", "foot 3", "tip 1", "tip 2", "tip 3"].iter().zip(places) {
            let _ = writeln!(text, "{frame},{name},{:.5},{:.5},{:.5}", p.x + 0.0, p.y + 0.0, p.z + 0.0);
        }
    }
    text.into_bytes()
}
