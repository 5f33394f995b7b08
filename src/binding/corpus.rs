//! Real takes on real bodies. Skipped where the data are not there.

use super::*;
use crate::capture;
use crate::scan;
use std::path::PathBuf;

fn data(name: &str) -> Option<PathBuf> {
    let shared = std::env::var_os("RETARGET_SHARED")
        .map_or_else(|| PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../shared"), PathBuf::from);
    let path = shared.join("data").join(name);
    path.exists().then_some(path)
}

struct Case {
    binding: Binding,
}

/// Binds a take of the data to a scan of the data; `None` (said on standard error) where a file is not there.
fn case(scan_name: &str, take: &str, still: Option<&str>, options: &Options) -> Option<Result<Case>> {
    let file = |folder: &str, name: &str| {
        let path = data(&format!("{folder}/{name}"));
        if path.is_none() {
            eprintln!("skipped: {name} is not there");
        }
        path
    };
    let scan_path = file("meshes", scan_name)?;
    let take_path = file("motion/c3d", take)?;
    let still_path = match still {
        Some(name) => Some(file("motion/c3d", name)?),
        None => None,
    };
    let scan = scan::read(&scan_path).unwrap();
    let unit_box = UnitBox::of(&scan.mesh).unwrap();
    let points = unit_box.enter_all(&scan.mesh.positions);
    let triangles = scan.mesh.vertex_triangles();
    let tree = TriangleTree::new(&points, &triangles);
    let body = landmarks::find(&points, &triangles);
    let read = |path: &PathBuf| capture::read(path, &capture::ReadOptions::default()).unwrap();
    let capture = read(&take_path);
    let still = still_path.as_ref().map(read);
    let shape = ScanShape { tree: &tree, unit_box, space: &scan.space, mesh: Some(&scan.mesh) };
    let start = std::time::Instant::now();
    let bound = bind(&shape, body, &capture, still.as_ref(), options, &|_, _| Ok(()));
    let elapsed = start.elapsed();
    Some(bound.map(|binding| {
        let d = &binding.decisions;
        eprintln!("== {scan_name} x {take}: {:.0} ms", elapsed.as_secs_f64() * 1e3);
        eprintln!("scan     {}\ncapture  {}\nbind     {}", d.scan_words(), d.capture_words(), d.bind_line());
        eprintln!("         proportions {:.2?}", d.proportions);
        for note in binding.notes.iter() {
            eprintln!("warning  {note}");
        }
        for (label, reason) in &binding.unbound {
            eprintln!("unbound  {label}: {reason}");
        }
        Case { binding }
    }))
}

impl Case {
    /// Handles whose nearest segment is neither their own nor a neighbour of it.
    fn astray(&self) -> Vec<String> {
        let distance = |p: DVec3, s: &SegmentPlace| {
            let d = s.to - s.from;
            let t = ((p - s.from).dot(d) / d.length_squared()).clamp(0.0, 1.0);
            let thick = match s.segment {
                Segment::Pelvis => 0.7,
                Segment::Trunk => 0.6,
                _ => 1.0,
            };
            (p - s.from - d * t).length() * thick
        };
        let astray = self.binding.handles.iter().filter_map(|h| {
            let own = h.segment?;
            let nearest =
                self.binding.segments.iter().min_by(|a, b| distance(h.attachment, a).total_cmp(&distance(h.attachment, b)))?;
            let kin = nearest.segment == own
                || nearest.segment.parent() == Some(own)
                || own.parent() == Some(nearest.segment)
                || own.parent().is_some() && own.parent() == nearest.segment.parent() && own.is_arm() == nearest.segment.is_arm();
            (!kin).then(|| format!("{} of {} near {}", h.label, own.name(), nearest.segment.name()))
        });
        astray.collect()
    }

    fn share(&self) -> f64 {
        self.binding.handles.len() as f64 / self.binding.decisions.markers as f64
    }
}

#[test]
fn labelled_takes_are_bound_to_bodies() {
    let male_t = "bodies/makehuman_male_body_tpose_quads_cm.obj.gz";
    let male_a = "bodies/makehuman_male_body_apose_quads.obj.gz";
    let scanned = "scans/synthetic_scan_male_apose_mm_zup.ply.gz";
    let still = Some("pig_antom_static.c3d");
    for (scan, take, still, least, pose_is_shown) in [
        (male_t, "mocap36.c3d", None, 0.85, true),
        (male_a, "pig_antom_walk.c3d", still, 0.85, false),
        (scanned, "pycgm_rom_static.c3d", None, 0.9, true),
        (scanned, "pig_antom_walk.c3d", still, 0.85, false),
        ("bodies/nbs_maynard_tpose.obj.gz", "mocap36.c3d", None, 0.85, true),
    ] {
        let Some(bound) = case(scan, take, still, &Options::default()) else { continue };
        let case = bound.unwrap();
        assert!(case.share() >= least, "{scan} {take}: {:?}", case.binding.unbound);
        assert_eq!(case.astray(), Vec::<String>::new(), "{scan} {take}");
        let (median, p90) = case.binding.decisions.residual.unwrap();
        assert!(median < 2.5 && p90 < 6.0, "{scan} {take}: {median} {p90}");
        assert!((case.binding.decisions.scale - 1.0).abs() < 0.06, "{scan} {take}: {}", case.binding.decisions.scale);
        let warned = case.binding.notes.iter().any(|n| n.contains("never shows the scan's pose"));
        assert_eq!(warned, !pose_is_shown, "{scan} {take}");
    }
}

#[test]
fn a_climb_is_refused_or_warned_about() {
    let Some(bound) = case("bodies/makehuman_male_body_apose_quads.obj.gz", "cmu_01_01.c3d", None, &Options::default()) else {
        return;
    };
    match bound {
        Ok(case) => assert!(case.binding.notes.iter().any(|n| n.contains("never shows the scan's pose"))),
        Err(error) => assert_eq!(error.exit_code(), 3),
    }
}

#[test]
fn takes_without_labels_are_told_rightly_or_refused() {
    let mut told = 0;
    let mut lowest = (1.0f64, 1.0f64);
    for scan_name in ["bodies/makehuman_male_body_apose_quads.obj.gz", "bodies/nbs_maynard_tpose.obj.gz"] {
        for take in [
            "pycgm_rom_static.c3d",
            "pig_antom_static.c3d",
            "pig_antom_walk.c3d",
            "mocap36.c3d",
            "cmu_01_01.c3d",
            "mac_jump2.c3d",
        ] {
            let (Some(scan_path), Some(take_path)) = (data(&format!("meshes/{scan_name}")), data(&format!("motion/c3d/{take}")))
            else {
                eprintln!("skipped: {scan_name} or {take} is not there");
                continue;
            };
            let scan = scan::read(&scan_path).unwrap();
            let unit_box = UnitBox::of(&scan.mesh).unwrap();
            let points = unit_box.enter_all(&scan.mesh.positions);
            let triangles = scan.mesh.vertex_triangles();
            let tree = TriangleTree::new(&points, &triangles);
            let body = landmarks::find(&points, &triangles);
            let shape = ScanShape { tree: &tree, unit_box, space: &scan.space, mesh: Some(&scan.mesh) };
            let mut capture = capture::read(&take_path, &capture::ReadOptions::default()).unwrap();
            let named =
                bind(&shape, body.clone(), &capture, None, &Options { accept_doubtful: true, ..Options::default() }, &|_, _| {
                    Ok(())
                })
                .unwrap();
            let labels = capture.motion.points().labels.clone();
            let truth = |k: usize| named.handles.iter().find(|h| h.label == labels[k]).and_then(|h| h.segment);
            capture.motion.points_mut().labels = (0..labels.len()).map(|k| format!("U_{k}")).collect();
            let start = std::time::Instant::now();
            match bind(&shape, body, &capture, None, &Options::default(), &|_, _| Ok(())) {
                Ok(bound) => {
                    let known: Vec<(Segment, Segment, &str)> = bound
                        .handles
                        .iter()
                        .filter_map(|h| {
                            let k: usize = h.label[2..].parse().unwrap();
                            Some((truth(k)?, h.segment?, labels[k].as_str()))
                        })
                        .collect();
                    let kin = |a: Segment, b: Segment| a == b || a.parent() == Some(b) || b.parent() == Some(a);
                    let share = |count: usize| count as f64 / known.len() as f64;
                    let right = share(known.iter().filter(|k| k.0 == k.1).count());
                    let near = share(known.iter().filter(|k| kin(k.0, k.1)).count());
                    let wrong: Vec<_> = known.iter().filter(|k| k.0 != k.1).collect();
                    eprintln!(
                        "{scan_name} x {take}: {:.0} % of {} right, {:.0} % near, {:?}: {wrong:?}",
                        100.0 * right,
                        known.len(),
                        100.0 * near,
                        start.elapsed()
                    );
                    lowest = (lowest.0.min(right), lowest.1.min(near));
                    told += 1;
                }
                Err(error) => {
                    eprintln!("{scan_name} x {take}: {}, {:?}", error.found, start.elapsed());
                    assert_eq!(error.exit_code(), 3);
                }
            }
        }
    }
    if data("motion/c3d").is_some() {
        assert!(told >= 3, "{told} takes told");
        assert!(lowest.0 >= 0.8 && lowest.1 >= 0.95, "{lowest:?}");
    }
}
