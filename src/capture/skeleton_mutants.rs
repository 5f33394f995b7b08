//! Damaged skeleton files end in a sound take or an error, soon and within bounded memory.

#![allow(clippy::unwrap_used, clippy::type_complexity)]

use super::fuzz_skeletons as body;
use crate::gltf::tests::glb;
use crate::splitmix::Sequence;
use serde_json::json;

/// Mutants of each sample.
const MUTANTS: usize = 5000;

const BVH: &[u8] = b"HIERARCHY\nROOT Hips\n{\n OFFSET 0 91 0\n CHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation\n JOINT Chest 1\n {\n  OFFSET 0 10 0\n  \
    CHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation\n  End Site\n  {\n   OFFSET 0 5 0.5\n  }\n }\n JOINT Leg\n {\n  OFFSET 2 -8 0\n  CHANNELS 3 Xrotation \
    Yrotation Zrotation\n }\n}\nMOTION\nFrames: 3\nFrame Time: .0083333\n1 90.5 2 90 0 0 0 10 0 0 0 0 0 0 0\n1.5 91,5 2.5 1e1 20.5 -30.5 0 10 0 4.5 5.5 6.5 7.5 -8.5 nan\n\
    2 92.5 3 -100.5 2.5 3.5\n 0 10 0 4.5 5.5 6.5 7.5 8.5 9.5 # last\n";

const ACCLAIM: &[u8] = b":version 1.10\n:name LEG\n:units\n length 0.45\n angle deg\n:root\n order TX TY TZ RX RY RZ\n axis XYZ\n position 0 0 0\n orientation 0 0 0\n\
    :bonedata\nbegin\n name femur\n direction 0 -2 0\n length 4\n axis 0 0 30 XYZ\n dof rx ry rz\nend\nbegin\n name tibia\n direction 0 -1 0\n length 3\n axis 10 20 30 ZYX\n \
    dof rz rx\nend\n:hierarchy\nbegin\nroot femur\nfemur tibia\nend\n\x1c#!OML\n:FULLY-SPECIFIED\n:DEGREES\n7\nroot 1 2 3 0 90 0\nfemur 0 0 0\ntibia 15 25\n8\n\
    root 1 2 4 10 20 30\nfemur 5e+00 -6 7\ntibia 15 25\n9\nroot 1 2 5 0 0 0\nfemur 0 0 0\ntibia 0 0\n";

/// Two bones, bound, in two clips: a spline of the turn, a line of the place, steps of the scale.
pub(super) fn gltf() -> Vec<u8> {
    let mut binary: Vec<u8> = Vec::new();
    let mut views = Vec::new();
    let mut put = |numbers: &[f32]| {
        views.push(json!({ "buffer": 0, "byteOffset": binary.len(), "byteLength": 4 * numbers.len() }));
        numbers.iter().for_each(|x| binary.extend(x.to_le_bytes()));
    };
    put(&[0.5, 1.0, 1.5]);
    let (s, c) = (0.5f32.sqrt(), 0.5f32.sqrt());
    put(&[
        0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.3, 0.0, 0.0, 0.0, 0.1, 0.0, 0.0, 0.0, s, c, 0.0, 0.0, -0.1, 0.0, 0.0,
        0.0, 0.2, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0,
    ]);
    put(&[0.0, 0.0, 0.0, 1.0, 2.0, 3.0, 2.0, 4.0, 6.0]);
    put(&[1.0, 1.0, 1.0, 2.0, 2.0, 2.0, 1.0, 1.0, 1.0]);
    put(&[
        1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0,
        0.0, 0.0, 1.0, 0.0, 0.0, -1.0, 0.0, 1.0,
    ]);
    let accessor = |view: usize, count: usize, shape: &str| json!({ "bufferView": view, "componentType": 5126, "count": count, "type": shape });
    let document = json!({
        "asset": { "version": "2.0" },
        "scene": 0,
        "scenes": [{ "nodes": [0] }],
        "nodes": [
            { "name": "armature", "children": [2], "scale": [1.0, 1.0, 1.0] },
            { "name": "tip", "translation": [0.0, 1.0, 0.0] },
            { "name": "base", "children": [1] },
        ],
        "skins": [{ "joints": [1, 2], "inverseBindMatrices": 5 }],
        "animations": [
            {
                "name": "Bend",
                "channels": [
                    { "sampler": 0, "target": { "node": 2, "path": "rotation" } },
                    { "sampler": 1, "target": { "node": 0, "path": "translation" } },
                    { "sampler": 2, "target": { "node": 2, "path": "scale" } },
                ],
                "samplers": [
                    { "input": 0, "output": 1, "interpolation": "CUBICSPLINE" },
                    { "input": 0, "output": 2 },
                    { "input": 0, "output": 3, "interpolation": "STEP" },
                ],
            },
            { "name": "Stay", "channels": [{ "sampler": 0, "target": { "node": 1, "path": "translation" } }], "samplers": [{ "input": 4, "output": 2 }] },
        ],
        "accessors": [accessor(0, 3, "SCALAR"), accessor(1, 9, "VEC4"), accessor(2, 3, "VEC3"), accessor(3, 3, "VEC3"), accessor(0, 1, "SCALAR"), accessor(4, 2, "MAT4")],
        "bufferViews": views,
        "buffers": [{ "byteLength": binary.len() }],
    });
    // The second joint's matrix comes first: joints 1 and 2 of the skin are the tip and the base.
    binary[4 * (3 + 36 + 9 + 9)..].rotate_left(64);
    glb(&document, &binary)
}

/// Cut, changed, doubled, moved and claimed to be more.
fn damage(random: &mut Sequence, sample: &[u8]) -> Vec<u8> {
    let mut bytes = sample.to_vec();
    if random.below(4) == 0 {
        bytes.truncate(random.below(sample.len()));
    }
    for _ in 0..=random.below(4) {
        let at = random.below(bytes.len());
        let length = random.below(40).min(bytes.len() - at);
        match random.below(8) {
            0 => bytes.splice(at..at, *b"2147483648").count(),
            1 => bytes.splice(at..at + length, []).count(),
            2 => {
                let piece = bytes[at..at + length].to_vec();
                let to = random.below(bytes.len());
                bytes.splice(to..to, piece).count()
            }
            3 if length >= 4 => bytes.splice(at..at + 4, [[0xff; 4], [0; 4], [0xff, 0xff, 0xff, 0x7f]][random.below(3)]).count(),
            4 | 5 => bytes.splice(at..at + length.min(1), [b"0123456789-+.,eE \n{}[]\":#"[random.below(25)]]).count(),
            6 => bytes.splice(at..at + length.min(1), [random.below(256) as u8]).count(),
            _ if length > 0 => {
                bytes[at] ^= 1 << random.below(8);
                1
            }
            _ => 0,
        };
    }
    bytes
}

/// Runs a body over its sample cut at every byte and over mutants of it; some of both have to be read and some refused.
fn attack(sample: &[u8], read: fn(&[u8]) -> bool, mutants: usize, step: usize) {
    assert!(read(sample), "the sample itself");
    let cuts = (0..sample.len()).step_by(step).filter(|&cut| read(&sample[..cut])).count();
    assert!(cuts * step < sample.len());
    let mut random = Sequence(11);
    let good = (0..mutants).filter(|_| read(&damage(&mut random, sample))).count();
    assert!(good > mutants / 200 && good < mutants - mutants / 200, "{good} of {mutants} were read");
}

#[test]
fn damaged_bvh_does_no_harm() {
    attack(BVH, body::bvh, MUTANTS, 1);
}

#[test]
fn damaged_acclaim_does_no_harm() {
    attack(ACCLAIM, body::acclaim, MUTANTS, 1);
}

#[test]
fn damaged_gltf_does_no_harm() {
    attack(&gltf(), body::gltf, MUTANTS, 1);
}

#[cfg(feature = "fbx")]
#[test]
fn damaged_fbx_does_no_harm() {
    attack(super::fbx::tests::ASCII.as_bytes(), body::fbx, MUTANTS, 1);
}

/// Real files, which reach further than samples.
#[test]
fn damaged_real_files_do_no_harm() {
    let real = |name: &str| super::tests::real(name).map(|path| super::source::load(&path).unwrap());
    let cases: &[(&str, fn(&[u8]) -> bool)] = &[
        ("broken/bvh_ok_5frames.bvh", body::bvh),
        ("bvh/makehuman_dance1_1frame.bvh", body::bvh),
        ("gltf/SimpleSkin.gltf", body::gltf),
        #[cfg(feature = "fbx")]
        ("fbx/motionbuilder_sausage_rrss_7700_binary.fbx", body::fbx),
        #[cfg(feature = "fbx")]
        ("fbx/blender_279_sausage_7400_binary.fbx", body::fbx),
    ];
    for &(name, read) in cases {
        let Some(sample) = real(name) else { continue };
        let step = (sample.len() / 60).max(1);
        attack(&sample, read, 250, step);
    }
    let (Some(mut asf), Some(amc)) = (real("amc/cmu_11.asf"), real("broken/amc_ok_4frames.amc")) else { return };
    asf.push(0x1c);
    asf.extend(amc);
    attack(&asf, body::acclaim, 500, 100);
}

/// Puts the samples where the fuzzer looks for them; see `scripts/fuzz.sh`.
#[test]
fn seeds_of_the_fuzzer_of_skeletons() {
    let Some(folder) = std::env::var_os("RETARGET_FUZZ_SEEDS").map(std::path::PathBuf::from) else { return };
    let samples: &[(&str, Vec<u8>)] = &[
        ("capture_bvh", BVH.to_vec()),
        ("capture_acclaim", ACCLAIM.to_vec()),
        ("capture_gltf", gltf()),
        #[cfg(feature = "fbx")]
        ("capture_fbx", super::fbx::tests::ASCII.as_bytes().to_vec()),
    ];
    for (body, sample) in samples {
        std::fs::create_dir_all(folder.join(body)).unwrap();
        std::fs::write(folder.join(body).join("sample"), sample).unwrap();
    }
}
