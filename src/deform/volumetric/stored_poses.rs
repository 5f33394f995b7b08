//! Poses that an independent implementation in double precision converged to, kept as `.npz` files outside the repository; skipped without them.
//!
//! They live under `bench/cases` of the folder that `RETARGET_SHARED` names, else of `../shared`.
#![allow(clippy::unwrap_used, clippy::print_stderr)]

use super::oriented::Oriented;
use super::{Options, Volumetric, elements};
use crate::deform::{Deformer, FrameStats, Grip, Handle, OrientedHandle, Placement, Targets};
use crate::linalg::SparseRow;
use crate::proxy::Proxy;
use glam::{DMat3, DQuat, DVec3};
use std::collections::BTreeMap;
use std::io::Read;
use std::path::PathBuf;
use std::time::Instant;

/// Numeric arrays of an `.npz` file, flattened and widened.
fn read_npz(name: &str) -> Option<BTreeMap<String, Vec<f64>>> {
    let shared = std::env::var_os("RETARGET_SHARED")
        .map_or_else(|| PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../shared"), PathBuf::from);
    let path = shared.join("bench/cases").join(name);
    let Ok(zip) = std::fs::read(&path) else {
        eprintln!("skipped: {} is not there", path.display());
        return None;
    };
    let u16_at = |at: usize| usize::from(u16::from_le_bytes(zip[at..at + 2].try_into().unwrap()));
    let u32_at = |at: usize| u32::from_le_bytes(zip[at..at + 4].try_into().unwrap()) as usize;
    let end = (0..zip.len() - 21).rev().find(|&at| zip[at..].starts_with(b"PK\x05\x06")).unwrap();
    let mut entry = u32_at(end + 16);
    let mut arrays = BTreeMap::new();
    for _ in 0..u16_at(end + 10) {
        let (method, packed, local) = (u16_at(entry + 10), u32_at(entry + 20), u32_at(entry + 42));
        let name = String::from_utf8_lossy(&zip[entry + 46..][..u16_at(entry + 28)]).trim_end_matches(".npy").to_owned();
        let data = &zip[local + 30 + u16_at(local + 26) + u16_at(local + 28)..][..packed];
        let mut npy = Vec::new();
        match method {
            0 => npy.extend_from_slice(data),
            _ => _ = flate2::read::DeflateDecoder::new(data).read_to_end(&mut npy).unwrap(),
        }
        arrays.extend(numbers(&npy).map(|numbers| (name, numbers)));
        entry += 46 + u16_at(entry + 28) + u16_at(entry + 30) + u16_at(entry + 32);
    }
    Some(arrays)
}

/// Numbers of a little-endian `.npy` file in C order.
fn numbers(npy: &[u8]) -> Option<Vec<f64>> {
    let header = 10 + usize::from(u16::from_le_bytes([npy[8], npy[9]]));
    let text = String::from_utf8_lossy(&npy[10..header]);
    let data = &npy[header..];
    let kind = text.split('\'').nth(3)?;
    Some(match kind {
        "<f4" => data.as_chunks().0.iter().map(|b| f64::from(f32::from_le_bytes(*b))).collect(),
        "<f8" => data.as_chunks().0.iter().map(|b| f64::from_le_bytes(*b)).collect(),
        "<i4" => data.as_chunks().0.iter().map(|b| f64::from(i32::from_le_bytes(*b))).collect(),
        "<i8" => data.as_chunks().0.iter().map(|b| i64::from_le_bytes(*b) as f64).collect(),
        _ => return None,
    })
}

fn points(numbers: &[f64]) -> Vec<DVec3> {
    numbers.as_chunks::<3>().0.iter().map(|p| DVec3::from_array(*p)).collect()
}

fn indices(numbers: &[f64]) -> Vec<u32> {
    numbers.iter().map(|x| *x as u32).collect()
}

/// A stored case.
struct Case {
    deformer: Volumetric,
    targets: Vec<Targets>,
    /// Of the one or two oriented handles, per frame.
    placements: Vec<Vec<Placement>>,
    /// Their places at rest.
    rests: Vec<DVec3>,
    diagonal: f64,
    stored: Vec<(usize, Vec<DVec3>, f64)>,
}

/// A case by name. Its given vertices are regions with an imposed rotation each.
fn case(name: &str, options: &Options) -> Option<Case> {
    let arrays = read_npz(&format!("{name}.npz"))?;
    let rest = points(&arrays["V"]);
    let tets = indices(&arrays["T"]).as_chunks().0.to_vec();
    let proxy = Proxy { rest, tets, ..Default::default() };
    let rows = arrays.get("row_ptr").map_or(vec![0], |rows| indices(rows));
    let handles: Vec<Handle> = rows
        .windows(2)
        .map(|range| {
            let range = range[0] as usize..range[1] as usize;
            let mut terms: Vec<(u32, f64)> = range.map(|i| (arrays["row_idx"][i] as u32, arrays["row_val"][i])).collect();
            terms.sort_by_key(|t| t.0);
            let (indices, values) = terms.into_iter().unzip();
            Handle { name: "stored".into(), row: SparseRow { indices, values }, beta: 1000.0 }
        })
        .collect();
    let frames = arrays["frames"][0] as usize;
    let soft = arrays.get("soft_targets").map_or(Vec::new(), |soft| points(soft));
    let count = handles.len();
    let of = |frame: usize| soft[frame * count..(frame + 1) * count].to_vec();
    let targets = (0..frames).map(|f| Targets { positions: of(f), presence: vec![1.0; count] }).collect();
    let (oriented, placements) = regions(&arrays, &proxy, frames);
    let stored = indices(&arrays["pose_frames"])
        .iter()
        .zip(points(&arrays["poses"]).chunks(proxy.rest.len()))
        .zip(&arrays["pose_energy"])
        .map(|((frame, pose), energy)| (*frame as usize, pose.to_vec(), *energy))
        .collect();
    let elements = elements::elements(&proxy, options).unwrap();
    let (lo, hi) = proxy.rest.iter().fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(lo, hi), p| (lo.min(*p), hi.max(*p)));
    let oriented_rests = oriented.iter().map(|h| h.rest).collect();
    let (oriented, points) = Oriented::new(&proxy, &oriented, handles.len()).unwrap();
    assert!(points.is_empty(), "exact grips have no points that pull");
    let deformer = Volumetric::with_weights(
        &proxy,
        elements,
        &handles,
        arrays.get("weights").cloned().unwrap_or_default(),
        oriented,
        options,
    )
    .unwrap();
    Some(Case { deformer, targets, placements, rests: oriented_rests, diagonal: (hi - lo).length(), stored })
}

/// The regions of a case and their placements per frame: every connected set of tetrahedra with an imposed rotation is one.
fn regions(arrays: &BTreeMap<String, Vec<f64>>, proxy: &Proxy, frames: usize) -> (Vec<OrientedHandle>, Vec<Vec<Placement>>) {
    let (mut handles, mut placements) = (Vec::new(), vec![Vec::new(); frames]);
    let count = (0..).take_while(|k| arrays.contains_key(&format!("frame{k}_tets"))).count();
    if count == 0 {
        return (handles, placements);
    }
    let hard = indices(&arrays["hard"]);
    let hard_targets = points(&arrays["hard_targets"]);
    for k in 0..count {
        let tets = indices(&arrays[&format!("frame{k}_tets")]);
        let mut vertices: Vec<u32> = tets.iter().flat_map(|&t| proxy.tets[t as usize]).collect();
        vertices.sort_unstable();
        vertices.dedup();
        let mean = |points: &dyn Fn(u32) -> DVec3| vertices.iter().map(|&v| points(v)).sum::<DVec3>() / vertices.len() as f64;
        let rest = mean(&|v| proxy.rest[v as usize]);
        for (frame, placements) in placements.iter_mut().enumerate() {
            let target = |v: u32| hard_targets[frame * hard.len() + hard.iter().position(|&h| h == v).unwrap()];
            // Rows of R with x' = R x.
            let r = &arrays["rotations"][9 * (count * frame + k)..][..9];
            let turn = DMat3::from_cols_array(&std::array::from_fn(|i| r[i % 3 * 3 + i / 3]));
            let orientation = DQuat::from_mat3(&turn).normalize();
            placements.push(Placement { position: mean(&target), orientation, presence: 1.0 });
        }
        handles.push(OrientedHandle { name: format!("region {k}"), rest, grip: Grip::Exact { vertices } });
    }
    // Given vertices without a tetrahedron of their own among them.
    let mut single = hard.clone();
    single.retain(|v| !handles.iter().any(|h| matches!(&h.grip, Grip::Exact { vertices } if vertices.contains(v))));
    for v in single {
        for (frame, placements) in placements.iter_mut().enumerate() {
            let position = hard_targets[frame * hard.len() + hard.iter().position(|&h| h == v).unwrap()];
            placements.push(Placement { position, orientation: DQuat::IDENTITY, presence: 1.0 });
        }
        let grip = Grip::Exact { vertices: vec![v] };
        handles.push(OrientedHandle { name: format!("vertex {v}"), rest: proxy.rest[v as usize], grip });
    }
    (handles, placements)
}

/// A deformer with the handles of a case, their targets at rest, and the diagonal.
pub(super) fn at_rest(name: &str, options: &Options) -> Option<(Volumetric, Targets, f64)> {
    let case = case(name, options)?;
    let rest: Vec<DVec3> = case.deformer.attachments.clone();
    Some((case.deformer, Targets { presence: vec![1.0; rest.len()], positions: rest }, case.diagonal))
}

/// The same with the handles where the last frame has them.
pub(super) fn posed(name: &str, options: &Options) -> Option<(Volumetric, Targets, f64)> {
    let mut case = case(name, options)?;
    case.deformer.place(case.placements.last().unwrap()).unwrap();
    Some((case.deformer, case.targets.pop().unwrap(), case.diagonal))
}

/// Solves all frames in order; returns the measures of each and, for the stored ones, distances of all vertices in diagonals and the energy's excess.
fn run(case: &mut Case) -> (Vec<FrameStats>, Vec<Vec<f64>>, Vec<f64>) {
    let (mut all, mut distances, mut excess) = (Vec::new(), Vec::new(), Vec::new());
    let mut time = 0.0;
    for (frame, targets) in case.targets.iter().enumerate() {
        let begin = Instant::now();
        case.deformer.place(&case.placements[frame]).unwrap();
        let stats = if frame == 0 { case.deformer.start(targets) } else { case.deformer.step(targets) }.unwrap();
        if frame > 2 {
            time += begin.elapsed().as_secs_f64();
        }
        let energies = case.deformer.energies();
        assert!(energies.windows(2).all(|e| e[1] <= e[0] * (1.0 + 1e-9)), "frame {frame}: {energies:?}");
        all.push(stats);
        if let Some((_, pose, energy)) = case.stored.iter().find(|s| s.0 == frame) {
            distances.push(pose.iter().zip(case.deformer.pose()).map(|(a, b)| a.distance(*b) / case.diagonal).collect());
            excess.push(stats.energy / energy - 1.0);
        }
    }
    let warm = &all[3..];
    eprintln!(
        "{:.2} ms and {:.1} passes per frame, at most {}; first frame {}",
        time * 1e3 / warm.len() as f64,
        warm.iter().map(|s| f64::from(s.passes)).sum::<f64>() / warm.len() as f64,
        warm.iter().map(|s| s.passes).max().unwrap(),
        all[0].passes,
    );
    (all, distances, excess)
}

fn largest(values: &[f64]) -> f64 {
    values.iter().fold(0.0, |m, v| m.max(v.abs()))
}

#[test]
fn the_stored_walk_is_reached_when_converged() {
    let options = Options { tolerance: 1e-8, sliver_cap: f64::INFINITY, bulk: 0.0, ..Default::default() };
    let Some(mut case) = case("human_walk", &options) else { return };
    let (stats, distances, excess) = run(&mut case);
    let worst = largest(&distances.iter().map(|d| largest(d)).collect::<Vec<_>>());
    eprintln!("worst {worst:.1e} diagonals, energy {:.1e}", largest(&excess));
    assert!(worst < 1e-5, "{worst}");
    // The stored energy at rest is rounding.
    assert!(excess[1..].iter().all(|e| e.abs() < 1e-6), "{excess:?}");
    assert!(stats.iter().all(|s| s.converged));
}

#[test]
fn the_default_tolerance_is_a_fifth_of_a_millimetre_of_the_stored_walk() {
    let options = Options { sliver_cap: f64::INFINITY, bulk: 0.0, ..Default::default() };
    let Some(mut case) = case("human_walk", &options) else { return };
    let (stats, distances, _) = run(&mut case);
    let mut all: Vec<f64> = distances[1..].concat();
    all.sort_by(f64::total_cmp);
    let millimetres = |d: f64| d * case.diagonal * 1e3;
    let (p99, max) = (millimetres(all[all.len() * 99 / 100]), millimetres(*all.last().unwrap()));
    eprintln!("p99 {p99:.3} mm, max {max:.3} mm, inverted {:?}", stats.iter().map(|s| s.inverted).max());
    assert!(p99 < 0.2 && max < 0.5, "{p99} {max}");
    assert!(stats[3..].iter().map(|s| s.passes).max() < Some(25));
}

#[test]
fn stored_poses_with_given_vertices_are_reached() {
    for (name, tolerance) in [("bar_twist135", 1e-6), ("bar_twist360", 1e-6), ("bar_bend120", 1e-6), ("spot_head_turn", 1e-5)] {
        let options = Options { tolerance: 1e-8, sliver_cap: f64::INFINITY, bulk: 0.0, ..Default::default() };
        let Some(mut case) = case(name, &options) else { return };
        let (stats, distances, excess) = run(&mut case);
        let worst = largest(&distances.iter().map(|d| largest(d)).collect::<Vec<_>>());
        eprintln!("{name}: worst {worst:.1e} diagonals, energy {:.1e}", largest(&excess[1..]));
        assert!(worst < tolerance, "{name}: {worst}");
        assert!(excess[1..].iter().all(|e| e.abs() < 1e-5), "{name}: {excess:?}");
        assert!(distances.len() > 4 && stats.iter().all(|s| s.converged), "{name}");
    }
}

#[test]
fn five_iterations_agree_with_another_implementation() {
    // The same system in quasi-definite form, [L Bᵀ; B −W⁻¹], which permuted vertices change by 1e-15. The reference factors L + Bᵀ W B: its rows, with
    // coefficients up to 92 and a thousandfold weight, leave it no more than eight digits, and it is 2.5e-8 diagonals away.
    let walk = [
        (0, [-0.012064648654785796, 0.7029449615191963, 0.7850063172145174]),
        (1000, [-0.037519442605808306, -0.02035836349071768, 0.7530959607142614]),
        (2000, [0.25603866625300337, 0.33959915829678006, 0.6643945696631174]),
        (3600, [0.010258112925755717, 0.08697094103357163, 0.7458793299896033]),
    ];
    let off = |case: &Case, expected: &[(usize, [f64; 3])]| {
        let far = |(v, place): &(usize, [f64; 3])| case.deformer.pose()[*v].distance(DVec3::from_array(*place));
        expected.iter().map(far).fold(0.0, f64::max) / case.diagonal
    };
    let options = |interpolate_above: f64| Options {
        iterations: Some(5),
        sliver_cap: f64::INFINITY,
        interpolate_above,
        ..Default::default()
    };
    // From rest, without the rigid alignment that a start makes.
    let Some(mut human) = case("human_walk", &options(f64::INFINITY)) else { return };
    let rest = human.deformer.attachments.clone();
    human.deformer.start(&Targets { presence: vec![1.0; rest.len()], positions: rest }).unwrap();
    human.deformer.step(&human.targets[11]).unwrap();
    let error = off(&human, &walk);
    eprintln!("human, frame 11 from rest: {error:.1e} diagonals");
    assert!(error < 1e-9, "{error}");
    let (with, without) = (
        [
            (300, [0.3982315314493835, 0.18720647594503836, 0.016226173203179442]),
            (411, [0.5500456898174592, 0.09182077282738735, 0.11559194804121001]),
            (452, [0.600000023747067, 0.15686022052439785, 0.1381969439677002]),
            (603, [0.8002124519424986, 0.09558561209773174, 0.19654942626146082]),
        ],
        [
            (300, [0.41041311197015207, 0.10020764141216443, -5.2668785400652525e-05]),
            (411, [0.5648874710441384, 0.09975873470265664, 0.14977612119823178]),
            (452, [0.6163553093900864, 0.15039541971353726, 0.10035763581303553]),
            (603, [0.8217965933947409, 0.19739527065880022, 0.15675532351674437]),
        ],
    );
    for (interpolate_above, expected) in [(0.1, with), (f64::INFINITY, without)] {
        let mut bar = case("bar_twist135", &options(interpolate_above)).unwrap();
        let no_points = Targets::default();
        let mut placements: Vec<Placement> =
            bar.rests.iter().map(|&position| Placement { position, orientation: DQuat::IDENTITY, presence: 1.0 }).collect();
        bar.deformer.place(&placements).unwrap();
        bar.deformer.start(&no_points).unwrap();
        placements[1].orientation = DQuat::from_rotation_x(135_f64.to_radians());
        bar.deformer.place(&placements).unwrap();
        bar.deformer.step(&no_points).unwrap();
        let error = off(&bar, &expected);
        eprintln!("bar, 135° in one jump: {error:.1e} diagonals");
        assert!(error < 1e-9, "{error}");
    }
}
