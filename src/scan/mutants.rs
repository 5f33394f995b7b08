//! Damaged files end in a scan or an error, soon and within bounded memory.

#![allow(clippy::unwrap_used)]

use super::{Scan, obj, ply, read, source, stl};
use std::fmt::Write as _;
use std::path::Path;

/// A grid of quads as OBJ with everything that the format offers.
fn obj_sample() -> Vec<u8> {
    let mut text = String::from("# metres, Y up\nmtllib none.mtl\no thing\n");
    for k in 0..36 {
        let _ = writeln!(text, "v {} {} {:.3} 0.5 0.25 1\nvt {} 0.5\nvn 0 {} 1", k % 6, k / 6, f64::from(k).sin(), k % 6, k % 2);
    }
    for k in (0..30).filter(|k| k % 6 < 5) {
        let c = [k + 1, k + 2, k + 8, k + 7];
        let _ = match k % 3 {
            0 => writeln!(text, "g row {k}\nf {0}/{0}/{0} {1}/{1}/{1} \\\n {2}/{2}/{2} {3}/{3}/{3}", c[0], c[1], c[2], c[3]),
            1 => writeln!(text, "usemtl m {k}\nf {}//{} {} {} {}", c[0], c[0], c[1], c[2], c[3]),
            _ => writeln!(text, "f {} {} {}/{}", c[0] - 37, c[1] - 37, c[2] - 37, c[2] - 37),
        };
    }
    text.into_bytes()
}

fn ply_sample(binary: bool) -> Vec<u8> {
    let format = if binary { "binary_big_endian" } else { "ascii" };
    let mut bytes = format!(
        "ply\nformat {format} 1.0\ncomment metres\ncomment TextureFile x.png\nelement camera 2\nproperty float a\nproperty list uchar int k\n\
         element vertex 25\nproperty double x\nproperty float y\nproperty float z\nproperty uchar red\nproperty uchar green\nproperty uchar blue\n\
         element face 16\nproperty list uchar int vertex_indices\nproperty list uchar float texcoord\n\
         element tristrips 1\nproperty list int int vertex_indices\nend_header\n"
    )
    .into_bytes();
    let mut put = |kinds: &str, values: &[f64]| {
        for (kind, value) in kinds.chars().zip(values) {
            match (binary, kind) {
                (false, _) => bytes.extend(format!("{value} ").bytes()),
                (_, 'd') => bytes.extend(value.to_be_bytes()),
                (_, 'f') => bytes.extend((*value as f32).to_be_bytes()),
                (_, 'i') => bytes.extend((*value as i32).to_be_bytes()),
                _ => bytes.push(*value as u8),
            }
        }
        if !binary {
            bytes.push(b'\n');
        }
    };
    for _ in 0..2 {
        put("fbii", &[0.5, 2.0, 7.0, 9.0]);
    }
    for k in 0..25 {
        put("dffbbb", &[f64::from(k % 5), f64::from(k / 5), 0.25, 10.0, 20.0, f64::from(k)]);
    }
    for k in 0..16 {
        let v = f64::from(k / 4 * 5 + k % 4);
        put("biiiibffffffff", &[4.0, v, v + 1.0, v + 6.0, v + 5.0, 8.0, 0.0, 0.0, 1.0, 0.0, 1.0, 1.0, 0.0, 1.0]);
    }
    put("iiiiiiii", &[7.0, 0.0, 1.0, 5.0, -1.0, 6.0, 7.0, 8.0]);
    bytes
}

fn stl_sample(binary: bool) -> Vec<u8> {
    let corner = |k: u32, c: u32| [f64::from(k % 4 + c % 2), f64::from(k / 4 + c / 2), 0.5];
    let mut bytes = if binary { [&[b' '; 80][..], &20u32.to_le_bytes()].concat() } else { b"solid a thing\n".to_vec() };
    for k in 0..20 {
        if binary {
            bytes.extend([0; 12]);
            (0..3).flat_map(|c| corner(k, c)).for_each(|x| bytes.extend((x as f32).to_le_bytes()));
            bytes.extend([0; 2]);
        } else {
            bytes.extend(b"facet normal 0 0 0\nouter loop\n");
            (0..3).map(|c| corner(k, c)).for_each(|[x, y, z]| bytes.extend(format!("vertex {x} {y} {z}\n").bytes()));
            bytes.extend(b"endloop\nendfacet\n");
        }
    }
    bytes
}

/// A reproducible sequence of numbers (Vigna's splitmix64).
struct Seeded(u64);

impl Seeded {
    fn below(&mut self, bound: usize) -> usize {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) % bound as u64) as usize
    }

    fn damage(&mut self, sample: &[u8]) -> Vec<u8> {
        let mut bytes = sample.to_vec();
        if self.below(4) == 0 {
            bytes.truncate(self.below(sample.len()));
        }
        // Half of the damage goes to the first quarter, where the headers are.
        let reach = if self.below(2) == 0 { bytes.len() / 4 } else { bytes.len() };
        for _ in 0..self.below(5) * reach.min(1) {
            let at = self.below(reach);
            bytes[at] = match self.below(4) {
                0 => b"0123456789-+./ \n\\#"[self.below(18)],
                1 => 0xff,
                2 => bytes[at] ^ (1 << self.below(8)),
                _ => self.below(256) as u8,
            };
        }
        bytes
    }
}

fn check(scan: &Scan) {
    assert!(scan.mesh.positions.iter().all(|p| p.is_finite()));
    assert!(scan.mesh.faces.corners.iter().all(|&v| (v as usize) < scan.mesh.positions.len()));
    assert!(scan.mesh.positions.len() < 1000 && scan.mesh.faces.corners.len() < 10_000);
    scan.mesh.triangulate();
}

#[test]
fn damaged_files_never_panic() {
    let samples = [
        ("a.obj", obj_sample()),
        ("a.ply", ply_sample(false)),
        ("a.ply", ply_sample(true)),
        ("a.stl", stl_sample(false)),
        ("a.stl", stl_sample(true)),
    ];
    let mut seeded = Seeded(7);
    for (name, sample) in &samples {
        let path = Path::new(name);
        let parse = |bytes: &[u8]| match source::format(path, bytes)? {
            source::Format::Obj => obj::read(bytes, path),
            source::Format::Ply => ply::read(bytes, path),
            source::Format::Stl => stl::read(bytes, path),
        };
        let whole = parse(sample).unwrap();
        assert!(whole.mesh.faces.len() > 10, "{name}");
        let (mut read, mut refused) = (0, 0);
        for _ in 0..600 {
            match parse(&seeded.damage(sample)) {
                Ok(scan) => {
                    check(&scan);
                    read += 1;
                }
                Err(error) => {
                    assert!(!error.found.is_empty());
                    refused += 1;
                }
            }
        }
        assert!(read > 20 && refused > 20, "{name}: {read} read, {refused} refused");
    }
}

#[test]
fn packed_files_read_like_plain_ones() {
    use std::io::Write;
    let dir = tempfile::tempdir().unwrap();
    for (name, sample) in [("a.obj", obj_sample()), ("b.ply", ply_sample(true)), ("c.stl", stl_sample(true))] {
        let plain = dir.path().join(name);
        std::fs::write(&plain, &sample).unwrap();
        let packed = dir.path().join(format!("{name}.gz"));
        let mut encoder = flate2::write::GzEncoder::new(std::fs::File::create(&packed).unwrap(), flate2::Compression::fast());
        encoder.write_all(&sample).unwrap();
        encoder.finish().unwrap();
        let (plain, packed) = (read(&plain).unwrap(), read(&packed).unwrap());
        assert_eq!(plain.mesh.positions, packed.mesh.positions);
        assert_eq!(plain.mesh.faces, packed.mesh.faces);
        assert_eq!(plain.look.face_groups, packed.look.face_groups);
    }
}
