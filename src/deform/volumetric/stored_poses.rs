//! Poses that an independent implementation in double precision converged to, kept as `.npz` files outside the repository; skipped without them.
//!
//! They live under `bench/cases` of the folder that `RETARGET_SHARED` names, else of `../shared`.
#![allow(clippy::unwrap_used, clippy::print_stderr)]

use super::{Options, Volumetric, elements};
use crate::deform::{Deformer, FrameStats, Handle, Targets};
use crate::linalg::SparseRow;
use crate::proxy::Proxy;
use glam::DVec3;
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

/// A stored case with soft handles only.
struct Case {
    deformer: Volumetric,
    targets: Vec<Targets>,
    diagonal: f64,
    stored: Vec<(usize, Vec<DVec3>, f64)>,
}

fn human_walk(options: &Options) -> Option<Case> {
    let arrays = read_npz("human_walk.npz")?;
    let rest = points(&arrays["V"]);
    let tets = indices(&arrays["T"]).as_chunks().0.to_vec();
    let proxy = Proxy { rest, tets, ..Default::default() };
    let rows = indices(&arrays["row_ptr"]);
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
    let soft = points(&arrays["soft_targets"]);
    let targets = soft
        .chunks(handles.len())
        .map(|frame| Targets { positions: frame.to_vec(), presence: vec![1.0; handles.len()] })
        .collect();
    let stored = indices(&arrays["pose_frames"])
        .iter()
        .zip(points(&arrays["poses"]).chunks(proxy.rest.len()))
        .zip(&arrays["pose_energy"])
        .map(|((frame, pose), energy)| (*frame as usize, pose.to_vec(), *energy))
        .collect();
    let elements = elements::elements(&proxy, &[], options.sliver_cap, 0.0).unwrap();
    let (lo, hi) = proxy.rest.iter().fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(lo, hi), p| (lo.min(*p), hi.max(*p)));
    let begin = Instant::now();
    let deformer = Volumetric::with_weights(&proxy, elements, &handles, arrays["weights"].clone(), options).unwrap();
    eprintln!("set-up {:.1} ms, {} entries", begin.elapsed().as_secs_f64() * 1e3, deformer.factor.entries());
    Some(Case { deformer, targets, diagonal: (hi - lo).length(), stored })
}

/// Solves all frames in order; returns the measures of each and, for the stored ones, distances of all vertices in diagonals and the energy's excess.
fn run(case: &mut Case) -> (Vec<FrameStats>, Vec<Vec<f64>>, Vec<f64>) {
    let (mut all, mut distances, mut excess) = (Vec::new(), Vec::new(), Vec::new());
    let mut time = 0.0;
    for (frame, targets) in case.targets.iter().enumerate() {
        let begin = Instant::now();
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
    let Some(mut case) = human_walk(&options) else { return };
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
    let Some(mut case) = human_walk(&options) else { return };
    let (stats, distances, _) = run(&mut case);
    let mut all: Vec<f64> = distances[1..].concat();
    all.sort_by(f64::total_cmp);
    let millimetres = |d: f64| d * case.diagonal * 1e3;
    let (p99, max) = (millimetres(all[all.len() * 99 / 100]), millimetres(*all.last().unwrap()));
    eprintln!("p99 {p99:.3} mm, max {max:.3} mm, inverted {:?}", stats.iter().map(|s| s.inverted).max());
    assert!(p99 < 0.2 && max < 0.5, "{p99} {max}");
    assert!(stats[3..].iter().map(|s| s.passes).max() < Some(25));
}
