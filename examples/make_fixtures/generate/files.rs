//! The files: OBJ with MTL and a texture, a dirtied PLY, PLY truths.

use super::body::{ARM, Body, Bone, HEAD, LEG};
use glam::DVec3;
use std::fmt::Write as _;
use std::io::Write as _;

/// A reproducible stream of numbers in 0..1 (a 64-bit linear congruential generator, high bits used).
pub struct Seeded(pub u64);

impl Seeded {
    pub fn next(&mut self) -> f64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 11) as f64 / (1u64 << 53) as f64
    }
}

/// Name, material of the part that a bone belongs to.
fn part(bone: usize) -> (&'static str, &'static str) {
    let in_limb = |first: [usize; 2], k: usize| first.iter().any(|&f| bone == f + k);
    if bone == HEAD {
        ("head", "skin")
    } else if in_limb(ARM, 0) {
        ("sleeves", "shirt cloth")
    } else if in_limb(ARM, 1) || in_limb(ARM, 2) {
        ("hands", "skin")
    } else if in_limb(LEG, 2) {
        ("shoes", "leather")
    } else if in_limb(LEG, 0) || in_limb(LEG, 1) || bone == 0 {
        ("trousers", "denim")
    } else {
        ("shirt", "shirt cloth")
    }
}

/// Angle round a bone and place along it, each 0..1: an atlas cell per bone, so that seams run along every limb.
fn unwrap(bone: &Bone, index: usize, p: DVec3) -> [f64; 2] {
    let axis = (bone.to - bone.from).normalize();
    let across = axis.any_orthonormal_vector();
    let d = p - bone.from;
    let angle = d.dot(axis.cross(across)).atan2(d.dot(across)) / std::f64::consts::TAU + 0.5;
    let along = (d.dot(axis) / (bone.to - bone.from).length() * 0.6 + 0.2).clamp(0.0, 1.0);
    [(angle * 0.9 + 0.05 + (index % 4) as f64) / 4.0, (along * 0.9 + 0.05 + (index / 4) as f64) / 4.0]
}

/// The scan as OBJ text: quads, groups, three or more materials, uv with seams.
pub fn obj(body: &Body, bones: &[Bone]) -> String {
    let mut text = String::from("# a generated body: metres, Y up, facing +Z\nmtllib scan.mtl\no body\n");
    for p in &body.points {
        let _ = writeln!(text, "v {:.5} {:.5} {:.5}", p.x, p.y, p.z);
    }
    let mut order: Vec<usize> = (0..body.quads.len()).collect();
    order.sort_by_key(|&q| (part(body.quad_bones[q]).0, q));
    let (mut uvs, mut faces) = (String::new(), String::new());
    let mut seen = std::collections::BTreeMap::new();
    let mut group = "";
    for q in order {
        let bone = body.quad_bones[q];
        let (name, material) = part(bone);
        if name != group {
            let _ = writeln!(faces, "g {name}\nusemtl {material}");
            group = name;
        }
        let mut uv = body.quads[q].map(|i| unwrap(&bones[bone], bone, body.points[i as usize]));
        // A quad across the seam takes its corners from one side.
        let widest = uv.iter().map(|t| t[0]).fold(f64::MIN, f64::max);
        for t in &mut uv {
            if widest - t[0] > 0.12 {
                t[0] += 0.225;
            }
        }
        faces.push('f');
        for (&i, t) in body.quads[q].iter().zip(uv) {
            let key = format!("{:.4} {:.4}", t[0].min(1.0), t[1]);
            let next = seen.len() + 1;
            let index = *seen.entry(key.clone()).or_insert_with(|| {
                let _ = writeln!(uvs, "vt {key}");
                next
            });
            let _ = write!(faces, " {}/{index}", i + 1);
        }
        faces.push('\n');
    }
    text + &uvs + &faces
}

/// The material library of the scan.
pub fn mtl() -> &'static str {
    "newmtl skin\nKd 1 1 1\nmap_Kd scan_skin.png\n\nnewmtl shirt cloth\nKd 0.20 0.38 0.62\n\nnewmtl denim\nKd 0.12 0.14 0.24\n\nnewmtl leather\nKd 0.18 0.10 0.06\nNs 60\nKs 0.2 0.2 0.2\n"
}

/// A 64 × 64 checker in skin tones.
pub fn png() -> Vec<u8> {
    let mut rows = Vec::new();
    for y in 0..64 {
        rows.push(0);
        for x in 0..64 {
            let tone: u8 = if (x / 8 + y / 8) % 2 == 0 { 224 } else { 204 };
            rows.extend([tone, (f64::from(tone) * 0.76) as u8, (f64::from(tone) * 0.64) as u8]);
        }
    }
    let mut packed = flate2::write::ZlibEncoder::new(Vec::new(), flate2::Compression::best());
    packed.write_all(&rows).expect("writing into memory");
    let packed = packed.finish().expect("writing into memory");
    let mut png = vec![0x89, b'P', b'N', b'G', b'\r', b'\n', 0x1a, b'\n'];
    let mut chunk = |kind: &[u8; 4], data: &[u8]| {
        let mut crc = flate2::Crc::new();
        crc.update(kind);
        crc.update(data);
        png.extend((data.len() as u32).to_be_bytes());
        png.extend(kind);
        png.extend(data);
        png.extend(crc.sum().to_be_bytes());
    };
    chunk(b"IHDR", &[0, 0, 0, 64, 0, 0, 0, 64, 8, 2, 0, 0, 0]);
    chunk(b"IDAT", &packed);
    chunk(b"IEND", &[]);
    png
}

/// Points alone as binary PLY: the true scan vertices of one frame.
pub fn ply_points(points: &[DVec3]) -> Vec<u8> {
    let mut out = format!(
        "ply\nformat binary_little_endian 1.0\nelement vertex {}\nproperty float x\nproperty float y\nproperty float z\nend_header\n",
        points.len()
    )
    .into_bytes();
    for p in points {
        for c in p.to_array() {
            out.extend((c as f32).to_le_bytes());
        }
    }
    out
}

/// The scan as a scanner would deliver it: triangles, noise, holes, a floating piece, vertex colours; millimetres, Z up.
pub fn dirty_ply(body: &Body) -> Vec<u8> {
    let mut random = Seeded(7);
    let mut points: Vec<DVec3> = body
        .points
        .iter()
        .map(|p| {
            let noise = DVec3::new(random.next(), random.next(), random.next()) - 0.5;
            DVec3::new(p.x, -p.z, p.y) * 1000.0 + noise * 1.2 + DVec3::new(350.0, -120.0, 18.0)
        })
        .collect();
    let holes = [
        (0.0, 1.745, 0.0, 0.05),
        (0.155, 0.0, 0.02, 0.04),
        (-0.155, 0.0, 0.02, 0.04),
        (0.0, 1.30, 0.11, 0.02),
        (0.45, 1.12, 0.0, 0.025),
    ];
    let mut triangles: Vec<[u32; 3]> = Vec::new();
    for quad in &body.quads {
        let centre = quad.iter().map(|&i| body.points[i as usize]).sum::<DVec3>() / 4.0;
        if holes.iter().any(|&(x, y, z, r)| centre.distance(DVec3::new(x, y, z)) < r) {
            continue;
        }
        triangles.push([quad[0], quad[1], quad[2]]);
        triangles.push([quad[0], quad[2], quad[3]]);
    }
    let first = points.len() as u32;
    let at = DVec3::new(1100.0, -100.0, 900.0);
    for corner in [DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::Z] {
        points.push(at + corner * 25.0);
    }
    triangles.extend([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]].map(|t: [u32; 3]| t.map(|i| i + first)));
    let mut out = format!(
        "ply\nformat binary_little_endian 1.0\ncomment millimetres\nelement vertex {}\nproperty float x\nproperty float y\nproperty float z\n\
         property uchar red\nproperty uchar green\nproperty uchar blue\nelement face {}\nproperty list uchar int vertex_indices\nend_header\n",
        points.len(),
        triangles.len()
    )
    .into_bytes();
    for p in &points {
        for c in p.to_array() {
            out.extend((c as f32).to_le_bytes());
        }
        let stripe = if (p.z / 40.0) as i64 % 2 == 0 { 190 } else { 150 };
        out.extend([stripe, stripe, 160]);
    }
    for t in &triangles {
        out.push(3);
        t.iter().for_each(|i| out.extend(i.to_le_bytes()));
    }
    out
}
