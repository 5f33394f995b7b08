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
];
