//! Bodies whose limbs touch or overlap, with known answer: poses of our own making, and a heavy man with his arms inside his hips.

#![allow(clippy::unwrap_used, clippy::print_stderr)]

use super::SurfaceMap;
use crate::proxy::corpus::shared;
use crate::proxy::figure::{Figure, Outcome, Pose};
use crate::proxy::rows::MapKind;
use crate::scan::Faces;
use glam::{DQuat, DVec3};

#[test]
fn arms_and_legs_that_touch_stay_apart() {
    let Some(folder) = shared("bodies") else { return };
    let figure = Figure::read(&folder.join("makehuman_male_body_apose_quads.obj.gz"), DQuat::IDENTITY);
    let hips = DVec3::new(0.04, 0.56, 0.02);
    let straight = |arm, leg| Pose { arm, leg, hand: None };
    let poses = [
        (straight(30.0, 0.0), false),
        (straight(8.0, 7.0), false),
        (straight(0.0, 10.0), false),
        (straight(-3.0, 0.0), true),
        (straight(-6.0, 0.0), true),
        (straight(-12.0, 0.0), true),
        (straight(-4.0, 11.0), true),
        (straight(-8.0, 12.0), true),
        (straight(-12.0, 13.0), true),
        (straight(-9.0, 12.5), true),
        (straight(30.0, 11.5), true),
        (Pose { arm: 42.0, leg: 0.0, hand: Some(hips) }, true),
    ];
    for (pose, touches) in poses {
        let outcome = figure.build(&format!("{pose:?}"), &figure.posed(pose));
        let (mean, worst, strayed) = skin_back(&figure, &outcome);
        let Outcome { built, torn, mixed, volume, .. } = outcome;
        assert_eq!(built.summary.touching > 0, touches);
        assert_eq!((built.summary.pieces, built.summary.joined), (1, built.joined.len()));
        // Even where nine tenths of the feet are inside each other.
        assert!((torn, mixed) == (0, 0) && volume > 0.985, "{torn} {mixed} {volume}");
        assert!(built.joined.is_empty(), "{:?}", built.joined);
        // The skin follows its own limb.
        assert!(mean < 2e-4 && worst < 0.03 && strayed == 0, "{mean} {worst} {strayed}");
    }
}

#[test]
fn arms_inside_the_hips_are_parted_from_them() {
    let Some(folder) = shared("bodies") else { return };
    let up = DQuat::from_rotation_x(-std::f64::consts::FRAC_PI_2);
    let figure = Figure::read(&folder.join("makehuman_heavy_armsdown_soup_mm_zup.stl"), up);
    let outcome = figure.build("heavy", &[figure.points.clone(), figure.skin.clone()]);
    let (.., strayed) = skin_back(&figure, &outcome);
    let Outcome { built, mixed, volume, .. } = outcome;
    assert_eq!(built.summary.pieces, 1);
    assert!(built.summary.overlap > 0.03 && mixed == 0 && volume > 0.98, "{mixed} {volume}");
    // In the armpits, where arm and trunk become one.
    assert!(built.joined.len() <= 5, "{:?}", built.joined);
    assert!(strayed <= 5, "{strayed} of {} vertices hang on another limb", figure.skin.len());
}

/// Distances of the skin from where it is in the A pose, when the vertices of the proxy are taken back there, in diagonals: mean, largest, and how
/// many vertices of the skin hang on another limb.
fn skin_back(figure: &Figure, outcome: &Outcome) -> (f64, f64, usize) {
    let Outcome { vertices, skin, diagonal, .. } = outcome;
    let diagonal = *diagonal;
    let proxy = &outcome.built.proxy;
    let mut around = vec![Vec::new(); proxy.rest.len()];
    for t in &proxy.tets {
        t.iter().for_each(|&v| around[v as usize].extend(t.iter().filter(|&&w| w != v)));
    }
    let back: Vec<Option<DVec3>> =
        (0..).zip(vertices).map(|(v, known)| known.map(|k: usize| figure.points[k] / diagonal - proxy.rest[v])).collect();
    let mut shift: Vec<DVec3> = back.iter().map(|s| s.unwrap_or(DVec3::ZERO)).collect();
    for _ in 0..200 {
        for v in (0..shift.len()).filter(|&v| back[v].is_none()) {
            shift[v] = around[v].iter().map(|&w: &u32| shift[w as usize]).sum::<DVec3>() / around[v].len() as f64;
        }
    }
    let pose: Vec<DVec3> = proxy.rest.iter().zip(&shift).map(|(p, s)| *p + *s).collect();
    let mut faces = Faces::default();
    figure.skin_triangles.iter().for_each(|t| faces.push(*t));
    let map = SurfaceMap::build_by_pieces(proxy, skin, &faces, MapKind::Ring).unwrap();
    let mut mapped = vec![Vec::new()];
    map.apply(&[&pose], &mut mapped);
    let errors: Vec<f64> =
        figure.skin.iter().zip(&mapped[0]).map(|(p, m)| (*p / diagonal).distance(DVec3::from(m.map(f64::from)))).collect();
    let limb = |v: usize| [&figure.arms[0], &figure.arms[1]].map(|a| a[v] > 0.9);
    let off = |v: &usize| {
        let row = map.row(*v);
        let (body, arm) = (figure.limbs.iter().all(|a| a[*v] == 0.0), figure.limbs.iter().any(|a| a[*v] > 0.9));
        let foreign = |w: u32| {
            vertices[w as usize]
                .is_some_and(|k| if body { limb(k) != [false; 2] } else { arm && figure.arms.iter().all(|a| a[k] == 0.0) })
        };
        let share = |select: &dyn Fn(u32) -> bool| {
            row.indices.iter().zip(&row.values).filter(|(w, _)| select(**w)).map(|(_, c)| c.abs()).sum::<f64>()
        };
        share(&foreign) > 0.05 * share(&|_| true)
    };
    let mean = errors.iter().sum::<f64>() / errors.len() as f64;
    let worst = errors.iter().copied().fold(0.0, f64::max);
    let strayed = (0..skin.len()).filter(off).count();
    eprintln!("skin: {:.4} % mean, {:.2} % worst, {strayed} on another limb", 100.0 * mean, 100.0 * worst);
    (mean, worst, strayed)
}
