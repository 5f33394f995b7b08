//! Bodies that a fuzzer runs, and that the tests run over samples and their mutants: whatever the bytes are, reading them as a skeleton
//! ends soon, within memory in proportion to them, in a sound take or in an error that says something.

use super::skeleton::{ALWAYS_ALLOWED, LARGEST_RATIO, SkeletonFile};
use super::{Capture, Motion, Rest, acclaim, bvh, gltf};
use crate::error::{Error, Kind, Result};

/// Reads the bytes as BVH; tells whether they were read.
pub fn bvh(bytes: &[u8]) -> bool {
    sound(bytes, bvh::read(bytes, None))
}

/// Reads the bytes as an ASF skeleton and, behind the first byte 0x1c, an AMC motion.
pub fn acclaim(bytes: &[u8]) -> bool {
    let cut = bytes.iter().position(|&b| b == 0x1c).unwrap_or(bytes.len());
    sound(bytes, acclaim::parse(&bytes[..cut], bytes.get(cut + 1..).unwrap_or_default()))
}

/// Reads the bytes as glTF or GLB: its joints and its meshes.
pub fn gltf(bytes: &[u8]) -> bool {
    let alone = |_: &str| Err(Error::new(Kind::Unreadable, "there is no file beside it"));
    match gltf::read_surface(bytes, &alone) {
        Ok(capture) => check_surface(&capture, bytes.len()),
        Err(error) => assert!(!error.found.is_empty() && error.found.len() < 2000, "{error:?}"),
    }
    sound(bytes, gltf::read_joints(bytes, &alone, None))
}

/// Reads the bytes as FBX.
#[cfg(feature = "fbx")]
pub fn fbx(bytes: &[u8]) -> bool {
    sound(bytes, super::fbx::read(bytes, None))
}

fn sound(bytes: &[u8], read: Result<SkeletonFile>) -> bool {
    match read {
        Ok(file) => {
            check(&file, bytes.len());
            true
        }
        Err(error) => {
            assert!(!error.found.is_empty() && error.found.len() < 2000, "{error:?}");
            false
        }
    }
}

/// Asserts what the reader of meshes promises of a surface from `length` bytes.
fn check_surface(capture: &Capture, length: usize) {
    let Motion::Vertices(take) = &capture.motion else { panic!("no surface") };
    let (vertices, points) = (take.vertices.len(), &take.points.points);
    assert!(vertices > 0 && !points.is_empty() && points.len().is_multiple_of(vertices));
    assert!(12 * points.len() <= ALWAYS_ALLOWED + LARGEST_RATIO * (length + (1 << 20)), "{} places", points.len());
    assert!(take.vertices.iter().all(|&v| (v as usize) < take.count) && take.points.labels.len() == vertices);
    assert!(points.iter().all(|p| p.iter().all(|x| x.is_nan() == p[0].is_nan() && !x.is_infinite())));
    assert!(capture.rate.is_finite() && capture.rate > 0.0 && take.points.origin.is_finite());
    assert!(capture.notes.iter().count() < 20 && capture.notes.iter().all(|n| n.len() < 4000));
}

/// Asserts what every reader promises of a take from `length` bytes.
fn check(file: &SkeletonFile, length: usize) {
    let take = &file.take;
    let (joints, cells) = (take.joints.len(), take.origins.points.len());
    assert!(joints > 0 && cells > 0 && cells.is_multiple_of(joints));
    assert!(28 * cells <= ALWAYS_ALLOWED + LARGEST_RATIO * (length + (1 << 20)), "{cells} places from {length} bytes");
    assert_eq!(take.rotations.len(), cells);
    assert_eq!(take.origins.labels.len(), joints);
    assert!(file.rate.is_finite() && file.rate > 0.0);
    let mut names = std::collections::BTreeSet::new();
    for (n, joint) in take.joints.iter().enumerate() {
        assert!(joint.parent.is_none_or(|p| p < n), "{joint:?} is number {n}");
        assert!(!joint.name.is_empty() && names.insert(&joint.name) && take.origins.labels[n] == joint.name, "{joint:?}");
        let turned = joint.rest_turn.is_finite() && (joint.rest_turn.length() - 1.0).abs() < 1e-6;
        assert!(take.rest == Rest::Unknown || turned || !joint.rest.is_finite(), "{joint:?}");
    }
    for (place, turn) in take.origins.points.iter().zip(&take.rotations) {
        let missing = place[0].is_nan();
        assert!(place.iter().all(|x| x.is_nan() == missing) && turn.iter().all(|x| x.is_nan() == missing), "{place:?} {turn:?}");
        let length = turn.iter().map(|x| f64::from(*x).powi(2)).sum::<f64>();
        assert!(missing || (length - 1.0).abs() < 1e-4, "{turn:?}");
    }
    assert!(file.notes.iter().count() < 20 && file.notes.iter().all(|n| n.len() < 4000));
}
