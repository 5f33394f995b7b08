//! Binds markers to a scan and poses it frame by frame, without the program:
//!
//! `cargo run --release --example bind_and_solve fixtures/scan.obj fixtures/walk.c3d`

#![allow(clippy::print_stdout)]

use retarget::binding::{self, ScanShape, landmarks};
use retarget::deform::volumetric::{Options, Volumetric};
use retarget::deform::{Deformer, Handle, Targets};
use retarget::glam::DVec3;
use retarget::proxy::rows::{HandleRows, MapKind};
use retarget::{capture, proxy, scan, spatial::TriangleTree, surface::SurfaceMap};
use std::path::Path;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let [scan, capture] = ["fixtures/scan.obj", "fixtures/walk.c3d"];
    let argument = |k: usize, otherwise: &str| std::env::args().nth(k).unwrap_or_else(|| otherwise.to_owned());
    for (frame, vertex) in pose(argument(1, scan).as_ref(), argument(2, capture).as_ref(), 10)?.iter().enumerate() {
        println!("frame {frame}: vertex 0 at {vertex:.4}");
    }
    Ok(())
}

/// Where vertex 0 of the scan is in the first frames, in the scan's own coordinates.
pub fn pose(scan: &Path, capture: &Path, frames: usize) -> Result<Vec<DVec3>, Box<dyn std::error::Error>> {
    let scan = scan::read(scan)?;
    let capture = capture::read(capture, &capture::ReadOptions::default())?;
    let unit_box = scan::UnitBox::of(&scan.mesh).ok_or("an empty mesh")?;
    let points: Vec<DVec3> = scan.mesh.positions.iter().map(|&p| unit_box.enter(p)).collect();
    let triangles = scan.mesh.vertex_triangles();

    // Where on the scan each marker sits.
    let tree = TriangleTree::new(&points, &triangles);
    let shape = ScanShape { tree: &tree, unit_box, space: &scan.space, mesh: Some(&scan.mesh) };
    let body = landmarks::find(&points, &triangles);
    let binding = binding::bind(&shape, body, &capture, None, &binding::Options::default(), &|_, _| Ok(()))?;

    // The tetrahedra that are solved, and the map from them to the scan.
    let proxy = proxy::build(&points, &triangles, &Default::default(), &|| Ok(()))?.proxy;
    let map = SurfaceMap::build_by_pieces(&proxy, &points, &scan.mesh.faces, MapKind::Ring)?;
    let rows = HandleRows::new(&proxy, MapKind::Ring);
    let handle = |h: &binding::BoundMarker| Handle { name: h.label.clone(), row: rows.row(h.attachment), beta: h.beta };
    let handles: Vec<Handle> = binding.handles.iter().map(handle).collect();
    let mut body = Volumetric::new(&proxy, &handles, &Options::default())?;

    let take = binding.take(&capture);
    let (mut targets, mut present, mut posed) = (Targets::default(), Vec::new(), vec![Vec::new()]);
    let mut path = Vec::new();
    for frame in 0..take.frames().min(frames) {
        binding.targets(take, frame, &mut targets.positions, &mut present);
        targets.presence = present.iter().map(|&there| f64::from(there)).collect();
        if frame == 0 {
            body.start(&targets)?
        } else {
            body.step(&targets)?
        };
        map.apply(&[body.pose()], &mut posed);
        path.push(unit_box.leave(DVec3::from(posed[0][0].map(f64::from))));
    }
    Ok(path)
}
