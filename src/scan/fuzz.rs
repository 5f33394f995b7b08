//! Bodies that a fuzzer runs, and that the tests run over samples and their mutants: whatever the bytes are, reading them ends soon, within
//! memory in proportion to them, in a sound scan or in an error that says something.

use super::beside::Beside;
use super::{NONE, Scan, gltf as gltf_scene, mtl, obj as obj_text, off as off_text, ply as ply_table, source, stl as stl_facets};
use crate::error::{Notes, Result};
use std::path::Path;

/// Reads the bytes as OBJ; tells whether they were read.
pub fn obj(bytes: &[u8]) -> bool {
    sound(bytes, obj_text::read(bytes, Path::new("a.obj"), &Beside::Nothing))
}

/// Reads the bytes as a material library of OBJ files.
pub fn materials(bytes: &[u8]) -> bool {
    let mut notes = Notes::default();
    let materials = mtl::parse(bytes, &Beside::Nothing, &mut notes);
    assert!(materials.len() <= bytes.len() / 6 + 1);
    for material in &materials {
        let numbers = material.base_color.iter().chain(&material.emissive).chain([&material.metallic, &material.roughness]);
        assert!(numbers.into_iter().all(|x| (0.0..=1.0).contains(x)), "{material:?}");
    }
    !materials.is_empty()
}

/// Reads the bytes as PLY.
pub fn ply(bytes: &[u8]) -> bool {
    sound(bytes, ply_table::read(bytes, Path::new("a.ply"), &Beside::Nothing))
}

/// Reads the bytes as STL.
pub fn stl(bytes: &[u8]) -> bool {
    sound(bytes, stl_facets::read(bytes, Path::new("a.stl")))
}

/// Reads the bytes as OFF.
pub fn off(bytes: &[u8]) -> bool {
    sound(bytes, off_text::read(bytes, Path::new("a.off")))
}

/// Reads the bytes as glTF or GLB.
pub fn gltf(bytes: &[u8]) -> bool {
    sound(bytes, gltf_scene::read(bytes, Path::new("a.glb"), &Beside::Nothing))
}

/// Takes gzip or zip away and reads what is in it as what it looks like.
pub fn packed(bytes: &[u8]) -> bool {
    let read = source::unwrap_packing(bytes.to_vec(), Path::new("a")).and_then(|content| {
        super::parse_bytes(&content.bytes, &content.name, &Beside::Nothing).map(|scan| (content.bytes.len(), scan))
    });
    match read {
        Ok((length, scan)) => {
            check(&scan, length);
            true
        }
        Err(error) => {
            assert!(!error.found.is_empty());
            false
        }
    }
}

fn sound(bytes: &[u8], read: Result<Scan>) -> bool {
    match read {
        Ok(scan) => {
            check(&scan, bytes.len());
            true
        }
        Err(error) => {
            assert!(!error.found.is_empty() && error.file.is_some(), "{error:?}");
            false
        }
    }
}

/// Asserts what every reader promises of a scan from `length` bytes.
pub(super) fn check(scan: &Scan, length: usize) {
    let (mesh, look) = (&scan.mesh, &scan.look);
    let (vertices, corners, faces) = (mesh.positions.len(), mesh.faces.corners.len(), mesh.faces.len());
    assert!(faces > 0);
    assert!(mesh.positions.iter().all(|p| p.is_finite()));
    assert_eq!(mesh.faces.starts.last().copied(), Some(corners as u32));
    assert!(mesh.faces.starts.windows(2).all(|w| w[1] >= w[0] + 3));
    assert!(mesh.faces.corners.iter().all(|&v| (v as usize) < vertices));
    // Only glTF may repeat meshes, and strips have three corners per index.
    let most = (4 << 20).max(20 * length);
    assert!(vertices <= most && corners <= most, "{vertices} vertices and {corners} corners from {length} bytes");
    let optional = |indices: &[u32], count: usize, values: usize| {
        assert!(indices.is_empty() || indices.len() == count);
        assert!(indices.iter().all(|&i| i == NONE || (i as usize) < values));
    };
    optional(&look.corner_uvs, corners, look.uvs.len());
    optional(&look.corner_normals, corners, usize::MAX);
    optional(&look.face_materials, faces, look.materials.len());
    optional(&look.face_groups, faces, look.groups.len());
    assert!(look.twins.is_empty() || look.twins.len() == vertices);
    assert!(look.twins.iter().enumerate().all(|(v, &t)| t as usize <= v && look.twins[t as usize] == t));
    assert!(look.uvs.iter().flatten().all(|x| x.is_finite()));
    assert!(look.colors.is_empty() || look.colors.len() == vertices);
    assert!(look.colors.iter().flatten().all(|x| (0.0..=1.0).contains(x)));
    assert_eq!(mesh.triangulate().corners.len(), corners - 2 * faces);
}
