//! What a fuzzer runs, by name. Only there for it and for the tests.

/// A body: reads bytes as one format, asserts what reading promises, and tells whether they were read.
pub type Body = fn(&[u8]) -> bool;

/// All bodies.
pub const BODIES: &[(&str, Body)] = &[
    ("scan_obj", crate::scan::fuzz::obj),
    ("scan_mtl", crate::scan::fuzz::materials),
    ("scan_ply", crate::scan::fuzz::ply),
    ("scan_stl", crate::scan::fuzz::stl),
    ("scan_off", crate::scan::fuzz::off),
    ("scan_gltf", crate::scan::fuzz::gltf),
    ("scan_packed", crate::scan::fuzz::packed),
    ("capture_c3d", crate::capture::fuzz_tables::c3d),
    ("capture_trc", crate::capture::fuzz_tables::trc),
    ("capture_csv", crate::capture::fuzz_tables::csv),
    ("capture_bvh", crate::capture::fuzz_skeletons::bvh),
    ("capture_acclaim", crate::capture::fuzz_skeletons::acclaim),
    ("capture_gltf", crate::capture::fuzz_skeletons::gltf),
    #[cfg(feature = "fbx")]
    ("capture_fbx", crate::capture::fuzz_skeletons::fbx),
    ("batch_table", crate::batch::manifest::fuzz::table),
    ("batch_toml", crate::batch::manifest::fuzz::toml),
];

/// Damage that can be made again.
#[cfg(test)]
pub mod mutants {
    use super::Body;
    use crate::splitmix::Sequence;

    /// Mutants of each sample.
    const ROUNDS: usize = 2600;

    fn damage(random: &mut Sequence, sample: &[u8]) -> Vec<u8> {
        const WORDS: [&[u8]; 8] = [b"2147483648", b"-1", b"nan", b"1e308", b"\t\t", b",,", b"\n", b"99999999999999999999"];
        let mut bytes = sample.to_vec();
        if random.below(5) == 0 {
            bytes.truncate(random.below(sample.len()));
        }
        // Half of the damage goes to the first quarter, where the headers are.
        let reach = if random.below(2) == 0 { bytes.len() / 4 } else { bytes.len() };
        for _ in 0..(1 + random.below(5)) * reach.min(1) {
            let at = random.below(bytes.len().min(reach.max(1)));
            match random.below(7) {
                0 => bytes[at] = b"0123456789-+./,;\t\n"[random.below(18)],
                1 => bytes[at] = [0, 0xff, 0x7f, 0x80][random.below(4)],
                2 => bytes[at] ^= 1 << random.below(8),
                3 => bytes[at] = random.below(256) as u8,
                4 => drop(bytes.splice(at..at, WORDS[random.below(8)].iter().copied())),
                5 => drop(bytes.drain(at..(at + 1 + random.below(9)).min(bytes.len()))),
                _ => {
                    let end = (at + 4).min(bytes.len());
                    bytes[at..end].copy_from_slice(&2u32.pow(31).to_le_bytes()[..end - at]);
                }
            }
            if bytes.is_empty() {
                break;
            }
        }
        bytes
    }

    /// Runs a body over each sample, over mutants of it, and over what is left when it is cut off after every byte.
    pub fn run(seed: u64, name: &str, body: Body, samples: &[Vec<u8>]) {
        let mut random = Sequence(seed);
        for sample in samples {
            assert!(body(sample), "{name}");
            let mut outcomes = [0, 0];
            for _ in 0..ROUNDS {
                outcomes[usize::from(body(&damage(&mut random, sample)))] += 1;
            }
            assert!(outcomes[0] > ROUNDS / 50 && outcomes[1] > ROUNDS / 50, "{name}: {outcomes:?} refused and read");
            // Cut off after every byte.
            for length in 0..sample.len().min(6000) {
                body(&sample[..length]);
            }
        }
    }
}
