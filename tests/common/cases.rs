//! Cases for the volumetric deformer in `.npz` files: a mesh of tetrahedra, handles, their targets frame by frame, and poses that an independent
//! implementation in double precision converged to. Benches and tests read them.
//!
//! Arrays: `V` n×3, `T` m×4; `hard` and `hard_targets` frames×h×3: vertices that are where they are put; `row_ptr`, `row_idx`, `row_val`, `weights`,
//! `soft_targets` frames×k×3: rows that are pulled, with their weights in the energy; `frameK_tets` and `rotations` frames×K×3×3: tetrahedra among the
//! hard vertices that turn as told; `frames`; `pose_frames`, `poses`, `pose_energy`.
#![allow(dead_code, clippy::unwrap_used)]

use glam::{DMat3, DQuat, DVec3};
use retarget::deform::volumetric::{Options, Volumetric};
use retarget::deform::{Deformer, FrameStats, Grip, Handle, OrientedHandle, Placement, Targets};
use retarget::linalg::SparseRow;
use retarget::proxy::Proxy;
use std::collections::BTreeMap;
use std::io::Read;
use std::path::Path;

/// Arrays by their names.
pub type Arrays = BTreeMap<String, Vec<f64>>;

/// Numeric arrays of an `.npz` file, flattened and widened; `None` where there is no such file.
pub fn read_npz(path: &Path) -> Option<Arrays> {
    let zip = std::fs::read(path).ok()?;
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

/// A case.
pub struct Case {
    pub proxy: Proxy,
    pub handles: Vec<Handle>,
    /// Their weights in the energy.
    pub weights: Vec<f64>,
    /// Every connected set of tetrahedra with an imposed rotation is one, every other hard vertex too.
    pub oriented: Vec<OrientedHandle>,
    pub targets: Vec<Targets>,
    /// Of the oriented handles, per frame.
    pub placements: Vec<Vec<Placement>>,
    pub diagonal: f64,
    /// Frame, pose and energy.
    pub stored: Vec<(usize, Vec<DVec3>, f64)>,
}

impl Case {
    /// Reads a case; `None` where there is no such file.
    pub fn read(path: &Path) -> Option<Self> {
        let arrays = read_npz(path)?;
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
        let none = Vec::new();
        let stored = indices(arrays.get("pose_frames").unwrap_or(&none))
            .iter()
            .zip(points(arrays.get("poses").unwrap_or(&none)).chunks(proxy.rest.len()))
            .zip(arrays.get("pose_energy").unwrap_or(&none))
            .map(|((frame, pose), energy)| (*frame as usize, pose.to_vec(), *energy))
            .collect();
        let weights = arrays.get("weights").cloned().unwrap_or_default();
        Some(Self { diagonal: diagonal(&proxy.rest), proxy, handles, weights, oriented, targets, placements, stored })
    }

    /// A deformer of it.
    pub fn deformer(&self, options: &Options) -> Volumetric {
        Volumetric::with_weights(&self.proxy, &self.handles, &self.weights, &self.oriented, options).unwrap()
    }

    /// Solves a frame; the first one, or one after another than the one before, with `cold`.
    pub fn solve(&self, deformer: &mut Volumetric, frame: usize, cold: bool) -> FrameStats {
        deformer.place(&self.placements[frame]).unwrap();
        let targets = &self.targets[frame];
        if cold { deformer.start(targets) } else { deformer.step(targets) }.unwrap()
    }

    /// Everything as it is at rest.
    pub fn at_rest(&self) -> (Targets, Vec<Placement>) {
        let still = |h: &OrientedHandle| Placement { position: h.rest, orientation: DQuat::IDENTITY, presence: 1.0 };
        let positions: Vec<DVec3> = self.handles.iter().map(|h| h.row.apply(&self.proxy.rest)).collect();
        (Targets { presence: vec![1.0; positions.len()], positions }, self.oriented.iter().map(still).collect())
    }

    /// The same with `factor` times the frames: targets along natural cubic splines. The stored poses go. For cases without oriented handles.
    pub fn resampled(mut self, factor: usize) -> Self {
        assert!(self.oriented.is_empty(), "orientations have no spline");
        let frames = self.targets.len();
        let curves: Vec<Vec<DVec3>> = (0..self.handles.len())
            .map(|h| spline(&self.targets.iter().map(|t| t.positions[h]).collect::<Vec<_>>(), factor))
            .collect();
        let count = (frames - 1) * factor + 1;
        let of = |f: usize| Targets { positions: curves.iter().map(|c| c[f]).collect(), presence: vec![1.0; curves.len()] };
        self.targets = (0..count).map(of).collect();
        self.placements = vec![Vec::new(); count];
        self.stored.clear();
        self
    }
}

/// The natural cubic spline through equally spaced points, at `factor` places per interval.
fn spline(points: &[DVec3], factor: usize) -> Vec<DVec3> {
    // Second derivatives by elimination of the system [1 4 1].
    let n = points.len();
    let mut second = vec![DVec3::ZERO; n];
    let mut ratio = vec![0.0; n];
    for i in 1..n - 1 {
        let pivot = 4.0 - ratio[i - 1];
        ratio[i] = 1.0 / pivot;
        second[i] = ((points[i + 1] - points[i] * 2.0 + points[i - 1]) * 6.0 - second[i - 1]) / pivot;
    }
    for i in (1..n - 1).rev() {
        let next = second[i + 1];
        second[i] -= next * ratio[i];
    }
    let at = |k: usize| {
        let i = (k / factor).min(n - 2);
        let b = (k - i * factor) as f64 / factor as f64;
        let a = 1.0 - b;
        points[i] * a + points[i + 1] * b + (second[i] * (a * a * a - a) + second[i + 1] * (b * b * b - b)) / 6.0
    };
    (0..=(n - 1) * factor).map(at).collect()
}

/// Length of the diagonal of the box around points.
pub fn diagonal(points: &[DVec3]) -> f64 {
    let (lo, hi) = points.iter().fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(lo, hi), p| (lo.min(*p), hi.max(*p)));
    (hi - lo).length()
}

/// The regions of a case and their placements per frame: every connected set of tetrahedra with an imposed rotation is one.
fn regions(arrays: &Arrays, proxy: &Proxy, frames: usize) -> (Vec<OrientedHandle>, Vec<Vec<Placement>>) {
    let (mut handles, mut placements) = (Vec::new(), vec![Vec::new(); frames]);
    let hard = arrays.get("hard").map_or(Vec::new(), |hard| indices(hard));
    if hard.is_empty() {
        return (handles, placements);
    }
    let hard_targets = points(&arrays["hard_targets"]);
    let count = (0..).take_while(|k| arrays.contains_key(&format!("frame{k}_tets"))).count();
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
    let among = |v: u32, handles: &[OrientedHandle]| {
        handles.iter().any(|h| matches!(&h.grip, Grip::Exact { vertices } if vertices.contains(&v)))
    };
    let single: Vec<(usize, u32)> = hard.iter().copied().enumerate().filter(|&(_, v)| !among(v, &handles)).collect();
    for (place, v) in single {
        for (frame, placements) in placements.iter_mut().enumerate() {
            let position = hard_targets[frame * hard.len() + place];
            placements.push(Placement { position, orientation: DQuat::IDENTITY, presence: 1.0 });
        }
        let grip = Grip::Exact { vertices: vec![v] };
        handles.push(OrientedHandle { name: format!("vertex {v}"), rest: proxy.rest[v as usize], grip });
    }
    (handles, placements)
}
