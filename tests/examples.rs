//! The examples of the library do what they say.

#![allow(clippy::unwrap_used, dead_code, missing_docs)]

mod common;

#[path = "../examples/bind_and_solve.rs"]
mod bind_and_solve;
#[path = "../examples/custom_deformer.rs"]
mod custom_deformer;
#[path = "../examples/custom_sink.rs"]
mod custom_sink;

use common::{fixture, read_pc2, retarget_ok};

#[test]
fn the_library_poses_as_the_program_does_without_its_rules_for_parts() {
    let path = bind_and_solve::pose(&fixture("scan.obj"), &fixture("walk.c3d"), 6).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let (scan, capture) = (fixture("scan.obj"), fixture("walk.c3d"));
    let arguments = [scan.as_os_str(), capture.as_os_str()]
        .into_iter()
        .chain(["--frames", "1..6", "--stiffness", "ends=1", "-o", "a.pc2"].iter().map(|word| std::ffi::OsStr::new(*word)));
    retarget_ok(folder.path(), arguments);
    let frames = read_pc2(&folder.path().join("a.pc2"));
    assert_eq!((path.len(), frames.len()), (6, 6));
    for (mine, theirs) in path.iter().zip(&frames) {
        let theirs = retarget::glam::DVec3::from(theirs[0].map(f64::from));
        assert!(mine.distance(theirs) < 1e-3, "{mine} and {theirs}: a millimetre apart or more");
    }
}

#[test]
fn a_sink_of_ones_own_gets_every_frame_and_leaves_nothing_half_written() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("box.csv");
    custom_sink::stream(&fixture("scan.obj"), &fixture("walk.c3d"), &out, 60..72).unwrap();
    let text = std::fs::read_to_string(&out).unwrap();
    let rows: Vec<Vec<f64>> = text.lines().skip(1).map(|line| line.split(',').map(|x| x.parse().unwrap()).collect()).collect();
    assert_eq!(rows.iter().map(|row| row[0] as i64).collect::<Vec<_>>(), (61..=72).collect::<Vec<_>>());
    // A walking person is as tall as a standing one, less what bent knees take.
    assert!(rows.iter().all(|row| (1.6..1.8).contains(&(row[5] - row[2]))), "{text}");
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
}

#[test]
fn a_deformer_of_ones_own_moves_what_it_is_told_to() {
    let [low, high] = custom_deformer::lift(&fixture("trunk.obj"), 0.1).unwrap();
    assert!(low.abs() < 0.005 && (high - 0.1).abs() < 0.005, "{low} {high}");
}
