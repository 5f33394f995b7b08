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

fn person() -> Person {
    Person {
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
    }
}

/// Targets of all joints in all frames.
fn targets(take: &SkeletonTake) -> Vec<Vec<DVec3>> {
    let person = person();
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

/// Joints of one who squats on both feet and then lifts the left one; the last two are the toes.
fn squat(frame: usize, joint: usize) -> DVec3 {
    const THIGH: f64 = 0.45;
    const SHANK: f64 = 0.4;
    let down = 0.25 * (frame.min(50) as f64 / 50.0).powi(2);
    let left = [1, 2, 3, 7].contains(&joint);
    let lift = if left { DVec3::new(0.0, 0.004, 0.006) * frame.saturating_sub(60) as f64 } else { DVec3::ZERO };
    let x = if left { 0.1 } else { -0.1 };
    let hip = DVec3::new(x, 0.0, 0.95 - down);
    let ankle = DVec3::new(x, 0.0, 0.1) + lift;
    match joint {
        0 => DVec3::new(0.0, 0.0, 1.0 - down),
        1 | 4 => hip,
        3 | 6 => ankle,
        7 | 8 => ankle + DVec3::new(0.0, 0.15, -0.08),
        _ => {
            let way = ankle - hip;
            let along = way.length().min(0.9999 * (THIGH + SHANK));
            let x = (THIGH * THIGH + along * along - SHANK * SHANK) / (2.0 * along);
            let aside = way.cross(DVec3::X).normalize() * -(THIGH * THIGH - x * x).max(0.0).sqrt();
            hip + way.normalize() * x + aside
        }
    }
}

#[test]
fn feet_that_stand_stay_where_they_are_and_rise_as_high_as_the_actors() {
    const FRAMES: usize = 100;
    const RATE: f64 = 50.0;
    // Hips twice as wide, shanks longer than thighs, steeper feet: bone by bone, its feet would slide and sink.
    let home = |joint: usize| {
        let side = if [1, 2, 3, 7].contains(&joint) { 1.0 } else { -1.0 };
        match joint {
            0 => DVec3::new(0.0, 0.0, 0.5),
            1 | 4 => DVec3::new(0.1 * side, 0.0, 0.475),
            2 | 5 => DVec3::new(0.1 * side, 0.0, 0.3),
            3 | 6 => DVec3::new(0.1 * side, 0.0, 0.05),
            _ => DVec3::new(0.1 * side, 0.05, 0.0),
        }
    };
    let parents = [None, Some(0), Some(1), Some(2), Some(0), Some(4), Some(5), Some(3), Some(6)];
    let joints = (0..9).map(|j| Joint {
        name: format!("joint {j}"),
        parent: parents[j],
        rest: squat(0, j),
        rest_turn: DQuat::IDENTITY,
        end: false,
    });
    let points = (0..FRAMES).flat_map(|f| (0..9).map(move |j| squat(f, j).to_array().map(|x| x as f32))).collect();
    let take = SkeletonTake {
        joints: joints.collect(),
        origins: MarkerTake { labels: (0..9).map(|j| format!("joint {j}")).collect(), points, ..MarkerTake::default() },
        rotations: vec![[0.0, 0.0, 0.0, 1.0]; FRAMES * 9],
        ..SkeletonTake::default()
    };
    let person = Person { toes: [Some(7), Some(8)], ..person() };
    let drive = |joint: usize| Drive {
        joint,
        name: format!("joint {joint}"),
        spot: (joint, home(joint)),
        parent: parents[joint],
        weight: 1.0,
        turns: false,
    };
    let drives: Vec<Drive> = (0..9).map(drive).collect();
    let stand = Stand { axes: DQuat::IDENTITY, scale: SCALE, up: DVec3::Z, floor: 0.0 };
    let run = |plant: bool| -> Vec<Vec<DVec3>> {
        let mut puppeteer = Puppeteer::new(Joints::of(&take, &Options::default()), &drives, stand, &person, FRAMES, RATE, plant);
        let mut out = Vec::new();
        let mut frame = |f: usize| {
            puppeteer.frame(f, &mut out);
            out.clone()
        };
        (0..FRAMES).map(&mut frame).collect()
    };
    let level = |p: DVec3| DVec3::new(p.x, p.y, 0.0);
    let slid = |frames: &[Vec<DVec3>], joint: usize, to: usize| {
        frames[..to].iter().map(|f| level(f[joint] - frames[0][joint]).length()).fold(0.0, f64::max)
    };
    let (held, free) = (run(true), run(false));
    assert!(slid(&free, 8, FRAMES) > 0.01, "their own way slides: {}", slid(&free, 8, FRAMES));
    for (joint, to) in [(8, FRAMES), (7, 60)] {
        assert!(slid(&held, joint, to) < 1e-6, "joint {joint} slides by {}", slid(&held, joint, to));
    }
    for (f, frame) in held.iter().enumerate() {
        let lift = 0.006 * SCALE * f.saturating_sub(60) as f64;
        for (joint, lift) in [(3, lift), (7, lift), (6, 0.0), (8, 0.0)] {
            let height = frame[joint].z - home(joint).z;
            assert!((height - lift).abs() < 1e-6, "frame {f}, joint {joint}: {height} over the ground instead of {lift}");
        }
        let moved = f.checked_sub(1).map_or(0.0, |before| frame[7].distance(held[before][7]));
        assert!(moved < 0.02, "frame {f}: the toe jumps by {moved}");
    }
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
