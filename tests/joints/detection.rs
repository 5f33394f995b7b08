//! What joints are read from shapes.

use crate::shapes::{Place, pieces};
use glam::DVec3;
use retarget::glam;
use retarget::joints::{self, Joint, Kind, Options};

fn angle(a: DVec3, b: DVec3) -> f64 {
    a.dot(b).abs().min(1.0).acos().to_degrees()
}

fn axis(joint: &Joint) -> DVec3 {
    if joint.kind == Kind::Plane { joint.frame.z_axis } else { joint.frame.x_axis }
}

/// Distance of the centre from where it may be, in diagonals.
fn off(joint: &Joint, centre: DVec3, along: DVec3, size: f64) -> f64 {
    let d = joint.centre - centre;
    match joint.kind {
        Kind::Revolute | Kind::Cylinder => (d - along * d.dot(along)).length() / size,
        Kind::Plane => d.dot(along).abs() / size,
        Kind::Ball => d.length() / size,
        Kind::Prismatic | Kind::Fixed => 0.0,
    }
}

#[test]
fn every_piece_has_its_joint_wherever_it_stands_and_however_it_is_cut() {
    for piece in pieces() {
        for (place, shuffled) in [(Place::odd(1e-3), false), (Place::odd(7.0), true)] {
            let (mut parts, size) = place.parts(&piece, shuffled);
            for swapped in [false, true] {
                if swapped {
                    parts.swap(0, 1);
                }
                let found = joints::find(&parts, size, &Options::default());
                let [joint] = &found[..] else { panic!("{}: {} joints", piece.name, found.len()) };
                assert_eq!(joint.kind, piece.kind, "{} swapped {swapped}", piece.name);
                let along = place.turn * DVec3::Z;
                if piece.has_axis {
                    assert!(angle(axis(joint), along) < 0.5, "{}: {}", piece.name, angle(axis(joint), along));
                }
                let off = off(joint, place.apply(DVec3::ZERO), along, size);
                assert!(off < 3e-3, "{}: centre off by {off}", piece.name);
                assert!((joint.frame.determinant() - 1.0).abs() < 1e-9);
                if let Some(slide) = piece.slide {
                    let (lo, hi) = joint.slide.expect("a range");
                    let error = (hi - slide * place.scale).abs().max((lo + slide * place.scale).abs());
                    assert!(error < 2e-3 * size, "{}: {lo}..{hi}", piece.name);
                }
            }
        }
    }
}

#[test]
fn parts_that_do_not_touch_have_no_joint() {
    let piece = &pieces()[1];
    let (mut parts, size) = Place::odd(1.0).parts(piece, false);
    parts.truncate(1);
    assert!(joints::find(&parts, size, &Options::default()).is_empty());
    let (there, _) = Place { shift: DVec3::X * 3.0, ..Place::odd(1.0) }.parts(piece, false);
    parts.push(there.into_iter().nth(1).expect("two parts"));
    assert!(joints::find(&parts, size, &Options::default()).is_empty());
}

#[test]
fn a_part_has_no_more_than_a_hundred_thousand_samples() {
    let (parts, _) = Place::odd(1.0).parts(&pieces()[1], false);
    let all = parts[0].samples(DVec3::NEG_INFINITY, DVec3::INFINITY, 4000, 1e-5);
    assert!((90_000..110_000).contains(&all.len()), "{}", all.len());
    let area: f64 = parts[0].areas.iter().sum();
    assert!((all.weights.iter().sum::<f64>() - area).abs() < 1e-3 * area, "their weights are still the area");
}

#[test]
fn a_rod_between_tight_collars_turns_but_does_not_slide() {
    use crate::shapes::{Piece, turned};
    // By its contact a cylinder joint: the collars are farther away than surfaces that touch.
    let collar = 0.2 + 0.012;
    let rod =
        [(0.0, -0.6), (0.18, -0.6), (0.18, -collar), (0.1, -collar), (0.1, collar), (0.18, collar), (0.18, 0.6), (0.0, 0.6)];
    let tube = [(0.102, -0.2), (0.25, -0.2), (0.25, 0.2), (0.102, 0.2)];
    let piece = Piece {
        name: "tight",
        base: turned(&tube, 32),
        moving: turned(&rod, 32),
        kind: Kind::Revolute,
        has_axis: true,
        slide: None,
    };
    let (parts, size) = Place::odd(1.0).parts(&piece, false);
    let found = joints::find(&parts, size, &Options { reach: 0.003, ..Options::default() });
    assert_eq!(found.len(), 1);
    assert_eq!((found[0].kind, found[0].slide), (Kind::Revolute, None));
}

#[test]
fn the_same_joints_come_out_for_any_number_of_threads() {
    let (parts, size) = Place::odd(1.0).parts(&pieces()[2], false);
    let once = || {
        format!(
            "{:?}",
            joints::find(&parts, size, &Options::default())
                .iter()
                .map(|j| (j.kind, j.centre, j.frame, j.slide))
                .collect::<Vec<_>>()
        )
    };
    let pool = retarget_pool(1);
    assert_eq!(pool.install(once), retarget_pool(2).install(once));
}

fn retarget_pool(threads: usize) -> rayon::ThreadPool {
    rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads")
}
