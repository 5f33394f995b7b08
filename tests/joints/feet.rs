//! Feet of a robot on the ground, over real takes of people who walk.

use crate::common::{read_pc2, retarget_ok};
use crate::corpus;
use std::collections::BTreeSet;

/// How high over the ground the sole of the lower foot is, in metres, in half of the frames at most: a walk has a foot on the ground in all of them, which
/// comes down on its heel and leaves from its toe.
const STANDS: f64 = 4e-3;
/// A sole is no deeper in the ground than this.
const DEEP: f64 = 2e-3;

/// The vertices of an object of an OBJ.
fn vertices(text: &str, object: &str) -> Vec<usize> {
    let mut own = BTreeSet::new();
    let mut inside = false;
    for line in text.lines() {
        match line.split_once(' ') {
            Some(("o" | "g", name)) => inside = name.trim() == object,
            Some(("f", corners)) if inside => {
                let index = |c: &str| c.split('/').next().and_then(|i| i.parse::<usize>().ok()).expect("an index") - 1;
                own.extend(corners.split_whitespace().map(index));
            }
            _ => {}
        }
    }
    own.into_iter().collect()
}

#[test]
fn soles_come_down_to_the_ground_though_the_floor_of_the_take_leans_and_hips_sit_otherwise() {
    let (Some(cases), Some(takes)) = (corpus::folder("bench/joints_cases"), corpus::folder("data/motion")) else { return };
    let rig = std::fs::read_to_string(cases.join("talos.rig.toml")).expect("a rig file");
    let mesh = std::fs::read_to_string(cases.join("talos_merged.obj")).expect("a mesh");
    let (parts, binds) = (rig.find("[[component]]").expect("components"), rig.find("[[bind]]").expect("binds"));
    let feet = ["leg_left_6_link", "leg_right_6_link"].map(|name| vertices(&mesh, name));
    let heights = mesh.lines().filter_map(|l| l.strip_prefix("v ")?.split_whitespace().nth(2)?.parse::<f64>().ok());
    let ground = heights.fold(f64::INFINITY, f64::min);
    for take in ["bvh/cmu_12_01_walk.bvh.gz", "amc/cmu_11_01.amc.gz"] {
        let folder = tempfile::tempdir().expect("a folder");
        let text = format!("[space]\nscan_unit = \"m\"\nscan_up = \"+Z\"\n{}", &rig[parts..binds]);
        std::fs::write(folder.path().join("rig.toml"), text).expect("a file");
        let (scan, capture) = (cases.join("talos_merged.obj").display().to_string(), takes.join(take).display().to_string());
        let said = retarget_ok(folder.path(), [&scan, &capture, "--rig", "rig.toml", "-o", "out.pc2"]);
        assert!(!said.contains("not solved"), "{take}: {said}");
        let mut soles: Vec<f64> = read_pc2(&folder.path().join("out.pc2"))
            .iter()
            .map(|frame| feet.iter().flatten().map(|&v| f64::from(frame[v][2])).fold(f64::INFINITY, f64::min) - ground)
            .collect();
        soles.sort_by(f64::total_cmp);
        let (deepest, middle) = (soles[0], soles[soles.len() / 2]);
        eprintln!("{take}: the lower sole is {:.1} mm over the ground, median, and {:.1} at least", middle * 1e3, deepest * 1e3);
        assert!(deepest > -DEEP && middle < STANDS, "{take}: {deepest} to {middle}");
    }
}
