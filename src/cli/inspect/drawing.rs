//! `retarget inspect --picture`: a scan with its landmarks, and with a capture bound to it, without a solve.

use crate::binding::{self, Options, ScanShape, landmarks};
use crate::capture::{self, ReadOptions};
use crate::cli::args::Inspect;
use crate::cli::picture::{self, Bound, Unbound};
use crate::error::{Error, Kind, Result};
use crate::export::files;
use crate::scan::{self, UnitBox};
use crate::spatial::TriangleTree;
use crate::words::file_name;
use glam::DVec3;
use std::path::Path;

/// Draws the first scan of the files, and the first capture beside it or on it.
///
/// Errors: no scan; a picture that exists, or cannot be written. What keeps the capture from being bound is returned after it is drawn.
pub(super) fn draw(args: &Inspect, path: &Path) -> Result<()> {
    if !args.force && files::exists(path) {
        return Err(Error::new(Kind::Unwritable, "exists already").file(path).hint("--force replaces it"));
    }
    let is_mesh = |file: &&std::path::PathBuf| super::is_mesh(file).unwrap_or(false);
    let scan_file = args.files.iter().find(is_mesh).ok_or_else(|| {
        Error::new(Kind::Usage, "there is no scan among the files to draw").expected("an OBJ, PLY, STL, OFF, glTF or GLB file")
    })?;
    let scan = scan::read(scan_file)?;
    let unit_box = UnitBox::of(&scan.mesh).ok_or_else(|| Error::malformed("the mesh has no extent").file(scan_file))?;
    let points = unit_box.enter_all(&scan.mesh.positions);
    let triangles = scan.mesh.vertex_triangles();
    let body = landmarks::find(&points, &triangles);
    let unbound = |heading, body| Unbound { heading, scan: &scan, points: &points, triangles: &triangles, body };
    // A glTF file may be both; as a capture it comes second.
    let Some(capture_file) = args.files.iter().find(|file| *file != scan_file) else {
        let heading = vec![file_name(scan_file), super::body_words(&body, unit_box)];
        return picture::write(path, &picture::landmarks(unbound(heading, body.as_ref().ok())));
    };
    let options =
        ReadOptions { clip: args.clip.clone(), skeleton: args.skeleton.clone(), rate: args.rate, ..ReadOptions::default() };
    let capture = capture::read(capture_file, &options)?;
    let files = format!("{} \u{b7} {}", file_name(scan_file), file_name(capture_file));
    let tree = TriangleTree::new(&points, &triangles);
    let shape = ScanShape { tree: &tree, unit_box, space: &scan.space, mesh: Some(&scan.mesh) };
    match binding::bind(&shape, body.clone(), &capture, None, &Options::default(), &|_, _| Ok(())) {
        Ok(binding) => {
            let heading = vec![files, binding.decisions.bind_line()];
            let (points, triangles) = (&points, &triangles);
            let bound = Bound { heading, scan: &scan, points, triangles, binding: &binding, reference: &capture, joined: &[] };
            picture::write(path, &picture::bound(&bound))
        }
        Err(error) => {
            let up = binding::actor_space(&capture).space.up.map_or(DVec3::Z, |up| up.value.vector());
            let heading = vec![files, "not bound".to_owned()];
            picture::write(path, &picture::not_bound(unbound(heading, body.as_ref().ok()), &capture, up))?;
            Err(if error.file.is_none() { error.file(scan_file) } else { error })
        }
    }
}
