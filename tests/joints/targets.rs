//! What a skeleton asks of the parts, frame by frame.

use glam::{DQuat, DVec3};
use retarget::binding::Options;
use retarget::binding::person::{Joints, Person};
use retarget::capture::{Joint, MarkerTake, SkeletonTake};
use retarget::glam;
use retarget::pipeline::mechanism::drive::{Drive, Puppeteer, Stand};
use retarget::space::{Evidence, Known};

const FRAMES: usize = 40;
const SCALE: f64 = 0.5;
/// Joints by index: pelvis, then hip, knee and ankle, left before right.
const PLACES: [[f64; 3]; 7] = [
    [0.0, 0.0, 1.0],
    [0.1, 0.0, 0.95],
    [0.1, 0.02, 0.5],
    [0.1, 0.0, 0.1],
    [-0.1, 0.0, 0.95],
    [-0.1, 0.02, 0.5],
    [-0.1, 0.0, 0.1],
];
const PARENTS: [Option<usize>; 7] = [None, Some(0), Some(1), Some(2), Some(0), Some(4), Some(5)];

/// A person who stands; some joints are missing in some frames.
fn take(missing: impl Fn(usize, usize) -> bool) -> SkeletonTake {
    let names = || (0..PLACES.len()).map(|j| format!("joint {j}"));
    let point = |frame: usize, joint: usize| {
        let p = DVec3::from(PLACES[joint]);
        if missing(frame, joint) { [f32::NAN; 3] } else { p.to_array().map(|x| x as f32) }
    };
    let joints = names().zip(PARENTS).zip(PLACES).map(|((name, parent), rest)| Joint {
        name,
        parent,
        rest: rest.into(),
        rest_turn: DQuat::IDENTITY,
        end: false,
    });
    let points = (0..FRAMES).flat_map(|f| (0..PLACES.len()).map(move |j| (f, j))).map(|(f, j)| point(f, j)).collect();
    SkeletonTake {
        joints: joints.collect(),
        origins: MarkerTake { labels: names().collect(), points, ..MarkerTake::default() },
        rotations: vec![[0.0, 0.0, 0.0, 1.0]; FRAMES * PLACES.len()],
        ..SkeletonTake::default()
    }
}

/// Targets of all joints in all frames.
fn targets(take: &SkeletonTake) -> Vec<Vec<DVec3>> {
    let person = Person {
        pelvis: 0,
        chest: 0,
        neck: None,
        head: None,
        arms: [[0; 3]; 2],
        legs: [[1, 2, 3], [4, 5, 6]],
        toes: [None; 2],
        up: Known::new("+Z".parse().expect("an axis"), Evidence::User),
        unit: None,
        leg: 0.85,
    };
    let drive = |joint: usize| Drive {
        joint,
        name: format!("joint {joint}"),
        spot: (joint, DVec3::from(PLACES[joint]) * SCALE),
        parent: PARENTS[joint],
        weight: 1.0,
        turns: false,
    };
    let drives: Vec<Drive> = (0..PLACES.len()).map(drive).collect();
    let stand = Stand { axes: DQuat::IDENTITY, scale: SCALE, up: DVec3::Z, floor: 0.0 };
    let joints = Joints::of(take, &Options::default());
    let mut puppeteer = Puppeteer::new(joints, &drives, stand, &person, FRAMES, 100.0, true);
    let mut out = Vec::new();
    let mut frame = |f: usize| {
        puppeteer.frame(f, &mut out);
        out.clone()
    };
    (0..FRAMES).map(&mut frame).collect()
}

#[test]
fn a_gap_releases_what_hangs_on_the_joint_and_nothing_for_longer() {
    let whole = targets(&take(|_, _| false));
    let knee = |f: usize, j: usize| (10..13).contains(&f) && j == 2;
    let pelvis = |f: usize, j: usize| (20..23).contains(&f) && j == 0;
    let with_gaps = targets(&take(|f, j| knee(f, j) || pelvis(f, j)));
    for (f, (gaps, whole)) in with_gaps.iter().zip(&whole).enumerate() {
        for (j, (gap, p)) in gaps.iter().zip(whole).enumerate() {
            assert!(p.is_finite(), "frame {f}, joint {j}");
            let lost = ((10..13).contains(&f) && (j == 2 || j == 3)) || (20..23).contains(&f);
            match lost {
                true => assert!(gap.is_nan(), "frame {f}, joint {j}: {gap} for a missing joint"),
                // Single precision of the take.
                false => assert!(gap.distance(*p) < 1e-6, "frame {f}, joint {j}: {gap}, {p} without gaps"),
            }
        }
    }
}
