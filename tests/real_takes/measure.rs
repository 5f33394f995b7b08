//! What is measured of a finished run, from its cache, its report and the rest scan.

use glam::{DMat3, DMat4, DQuat, DVec3, DVec4};
use retarget::scan::Scan;
use serde_json::Value;
use std::fs::File;
use std::io::{BufReader, Read};
use std::path::Path;

/// Figures of one run. Ratios are against the rest scan; lengths in millimetres.
#[derive(Debug)]
pub(crate) struct Figures {
    pub(crate) bound: usize,
    pub(crate) markers: usize,
    /// Median over the frames of the median residual.
    pub(crate) residual: f64,
    pub(crate) worst_residual: f64,
    /// Smallest and largest volume of the proxy.
    pub(crate) volume: (f64, f64),
    /// Longest edge, and the share of all edges in all frames that are below twice their rest length.
    pub(crate) stretch: f64,
    pub(crate) calm: f64,
    /// 99th percentile of the stretch over all edges and frames.
    pub(crate) stretch_p99: f64,
    /// Error of the skin, root mean square and worst, as shares of the diagonal.
    pub(crate) skin: (f64, f64),
    pub(crate) joints: String,
    /// Largest and root mean square distance from the rest shape after the best rigid motion, worst frame, in diagonals.
    pub(crate) from_rest: (f64, f64),
    /// Frames written.
    pub(crate) frames: usize,
    /// Seconds until the first frame.
    pub(crate) set_up: f64,
    pub(crate) peak_mb: f64,
}

/// Edges shorter than this share of the diagonal are noise of the scanner, not shape.
const SHORT: f64 = 0.0005;

/// Finest step of the stretch histogram; the last bin holds all from 5 on.
const STEP: f64 = 0.001;

impl Figures {
    /// Reads a run: the scan at rest, its cache, its report. The first output of the report is the GLB.
    pub(crate) fn read(scan: &Scan, cache: &Path, report: &Value) -> Self {
        let frames = report["frames"].as_array().unwrap();
        let number = |value: &Value| value.as_f64().unwrap_or_else(|| panic!("{value} is no number"));
        let over = |pick: &dyn Fn(&Value) -> f64| frames.iter().map(pick).collect::<Vec<f64>>();
        let mut medians = over(&|f| number(&f["residual_mm"]["median"]));
        medians.sort_by(f64::total_cmp);
        let volumes = over(&|f| number(&f["volume_ratio"]));
        let binding = &report["decisions"]["binding"];
        let count = |key: &str| binding[key].as_u64().unwrap() as usize;

        let rest = &scan.mesh.positions;
        let diagonal = number(&report["decisions"]["scan"]["diagonal"]);
        let edges = long_edges(scan, SHORT * diagonal);
        let mut histogram = vec![0u64; 5001];
        let mut stretch: f64 = 0.0;
        let mut from_rest: (f64, f64) = (0.0, 0.0);
        let mut cache = Cache::open(cache);
        assert_eq!(cache.points, rest.len(), "the cache keeps the scan's vertices");
        assert_eq!(cache.frames, frames.len(), "a cached frame for every frame of the report");
        while let Some(pose) = cache.next() {
            for &(a, b, length) in &edges {
                let ratio = pose[a as usize].distance(pose[b as usize]) / length;
                assert!(ratio.is_finite());
                stretch = stretch.max(ratio);
                histogram[((ratio / STEP) as usize).min(5000)] += 1;
            }
            let (worst, rms) = distance_after_rigid_motion(rest, pose);
            from_rest = (from_rest.0.max(worst / diagonal), from_rest.1.max(rms / diagonal));
        }
        let total: u64 = histogram.iter().sum();
        let below = |bin: usize| histogram[..bin].iter().sum::<u64>() as f64 / total as f64;

        let glb = &report["outputs"][0];
        let in_diagonals = |mm: &Value| number(mm) / (diagonal * millimetres(binding));
        Self {
            bound: count("bound"),
            markers: count("markers"),
            residual: medians[medians.len() / 2],
            worst_residual: over(&|f| number(&f["residual_mm"]["max"])).into_iter().fold(0.0, f64::max),
            volume: volumes.iter().fold((f64::INFINITY, 0.0), |(lo, hi), &v| (v.min(lo), v.max(hi))),
            stretch,
            calm: below((2.0 / STEP) as usize),
            stretch_p99: (0..histogram.len()).find(|&bin| below(bin) >= 0.99).unwrap_or(5000) as f64 * STEP,
            skin: (in_diagonals(&glb["rms_error_mm"]), in_diagonals(&glb["max_error_mm"])),
            joints: glb["encoding"].as_str().unwrap().to_owned(),
            from_rest,
            frames: frames.len(),
            set_up: report["setup_ms"].as_object().unwrap().values().map(number).sum::<f64>() / 1000.0,
            peak_mb: number(&report["peak_mb"]),
        }
    }

    /// Names of the columns of [`row`](Self::row).
    pub(crate) const HEAD: &str = "take        frames  bound    residual mm   volume %      stretch        <2x       from rest %  skin %           joints          set-up  peak";

    /// One line of the table.
    pub(crate) fn row(&self, name: &str) -> String {
        let percent = |x: f64| x * 100.0;
        format!(
            "{name:<11} {:>6}  {:>2} of {:<2} {:>5.2} / {:<5.2} {:>5.1}-{:<5.1} {:>5.2} / {:<6.2} {:>8.4} {:>5.2} / {:<5.2} {:.4} / {:.4}  {:<15} {:>4.1} s {:>4.0} MB",
            self.frames,
            self.bound,
            self.markers,
            self.residual,
            self.worst_residual,
            percent(self.volume.0),
            percent(self.volume.1),
            self.stretch_p99,
            self.stretch,
            percent(self.calm),
            percent(self.from_rest.1),
            percent(self.from_rest.0),
            percent(self.skin.0),
            percent(self.skin.1),
            self.joints,
            self.set_up,
            self.peak_mb
        )
    }

    /// What does not hold of the demands on every take; `least` is the smallest share of bound markers.
    pub(crate) fn faults(&self, least: f64) -> Vec<String> {
        let mut faults = Vec::new();
        let mut demand = |holds: bool, text: String| {
            if !holds {
                faults.push(text);
            }
        };
        demand(self.bound as f64 >= least * self.markers as f64, format!("{} of {} markers bound", self.bound, self.markers));
        demand(self.residual <= 1.0, format!("median residual {:.2} mm", self.residual));
        let (lo, hi) = self.volume;
        demand(lo >= 0.95 && hi <= 1.05, format!("volume of the proxy {lo:.4} to {hi:.4} of rest"));
        demand(self.stretch <= 4.0, format!("an edge is {:.2} times its rest length", self.stretch));
        demand(self.calm >= 0.999, format!("only {:.3} % of the edges are below twice their rest length", self.calm * 100.0));
        demand(self.skin.0 <= 0.001, format!("skin error {:.4} % rms", self.skin.0 * 100.0));
        demand(self.skin.1 <= 0.01, format!("skin error {:.4} % at the worst vertex", self.skin.1 * 100.0));
        faults
    }
}

/// Millimetres of the scan's unit.
fn millimetres(binding: &Value) -> f64 {
    match binding["scan_unit"]["value"].as_str() {
        Some("m") => 1000.0,
        Some("dm") => 100.0,
        Some("cm") => 10.0,
        _ => 1.0,
    }
}

/// Every edge longer than `least` once, with its length.
fn long_edges(scan: &Scan, least: f64) -> Vec<(u32, u32, f64)> {
    let faces = &scan.mesh.faces;
    let mut edges = Vec::new();
    for pair in faces.starts.windows(2) {
        let face = &faces.corners[pair[0] as usize..pair[1] as usize];
        edges.extend((0..face.len()).map(|i| (face[i], face[(i + 1) % face.len()])).map(|(a, b)| (a.min(b), a.max(b))));
    }
    edges.sort_unstable();
    edges.dedup();
    let length = |(a, b): (u32, u32)| scan.mesh.positions[a as usize].distance(scan.mesh.positions[b as usize]);
    edges.into_iter().map(|e| (e.0, e.1, length(e))).filter(|e| e.2 > least).collect()
}

/// Largest and root mean square distance between a pose and the rest shape moved onto it.
fn distance_after_rigid_motion(rest: &[DVec3], pose: &[DVec3]) -> (f64, f64) {
    let mean = |points: &[DVec3]| points.iter().sum::<DVec3>() / points.len() as f64;
    let (p, q) = (mean(rest), mean(pose));
    let mut covariance = DMat3::ZERO;
    for (&x, &y) in rest.iter().zip(pose) {
        let (x, y) = (x - p, y - q);
        covariance += DMat3::from_cols(x * y.x, x * y.y, x * y.z);
    }
    let r = rotation_of(&covariance);
    let distances = rest.iter().zip(pose).map(|(&x, &y)| (r * (x - p) + q).distance(y));
    let (worst, squares) = distances.fold((0.0f64, 0.0), |(worst, sum), d| (worst.max(d), sum + d * d));
    (worst, (squares / rest.len() as f64).sqrt())
}

/// Horn 1987: the best rotation is the eigenvector of the largest eigenvalue of a 4 × 4 matrix, here by squaring it again and again.
fn rotation_of(covariance: &DMat3) -> DQuat {
    let s = |i: usize, j: usize| covariance.col(j)[i];
    let [x, y, z] = [s(1, 2) - s(2, 1), s(2, 0) - s(0, 2), s(0, 1) - s(1, 0)];
    let [xy, yz, zx] = [s(0, 1) + s(1, 0), s(1, 2) + s(2, 1), s(2, 0) + s(0, 2)];
    let mut n = DMat4::from_cols(
        DVec4::new(s(0, 0) + s(1, 1) + s(2, 2), x, y, z),
        DVec4::new(x, s(0, 0) - s(1, 1) - s(2, 2), xy, zx),
        DVec4::new(y, xy, s(1, 1) - s(0, 0) - s(2, 2), yz),
        DVec4::new(z, zx, yz, s(2, 2) - s(0, 0) - s(1, 1)),
    );
    let size = |m: &DMat4| m.to_cols_array().iter().map(|c| c * c).sum::<f64>().sqrt();
    // Shifted so that the largest eigenvalue is also the largest in size.
    n += DMat4::IDENTITY * size(&n);
    for _ in 0..40 {
        n *= 1.0 / size(&n);
        n *= n;
    }
    let longest = (0..4).map(|i| n.col(i)).max_by(|a, b| a.length_squared().total_cmp(&b.length_squared())).unwrap();
    DQuat::from_xyzw(longest.y, longest.z, longest.w, longest.x).normalize()
}

/// A PC2 cache, read frame by frame: the caches of whole takes are larger than one wants to hold.
pub(crate) struct Cache {
    file: BufReader<File>,
    pub(crate) points: usize,
    pub(crate) frames: usize,
    read: usize,
    bytes: Vec<u8>,
    pose: Vec<DVec3>,
}

impl Cache {
    pub(crate) fn open(path: &Path) -> Self {
        let mut file = BufReader::with_capacity(1 << 20, File::open(path).unwrap());
        let mut head = [0; 32];
        file.read_exact(&mut head).unwrap();
        assert_eq!(&head[..12], b"POINTCACHE2\0");
        let integer = |at: usize| i32::from_le_bytes(head[at..at + 4].try_into().unwrap()) as usize;
        assert_eq!(integer(12), 1, "version");
        let (points, frames) = (integer(16), integer(28));
        assert_eq!(std::fs::metadata(path).unwrap().len() as usize, 32 + points * frames * 12);
        Self { file, points, frames, read: 0, bytes: vec![0; points * 12], pose: vec![DVec3::ZERO; points] }
    }

    pub(crate) fn next(&mut self) -> Option<&[DVec3]> {
        if self.read == self.frames {
            return None;
        }
        self.read += 1;
        self.file.read_exact(&mut self.bytes).unwrap();
        let number = |c: &[u8]| f64::from(f32::from_le_bytes(c.try_into().unwrap()));
        for (point, b) in self.pose.iter_mut().zip(self.bytes.chunks_exact(12)) {
            *point = DVec3::new(number(&b[..4]), number(&b[4..8]), number(&b[8..]));
        }
        Some(&self.pose)
    }
}

#[test]
fn a_rigid_motion_is_no_distance() {
    let rest: Vec<DVec3> =
        (0..50).map(|i| DVec3::new((f64::from(i) * 1.7).sin(), (f64::from(i) * 2.3).cos(), f64::from(i % 7))).collect();
    for turn in [0.0, 0.4, 3.1] {
        let r = DQuat::from_axis_angle(DVec3::new(0.6, 0.0, 0.8), turn);
        let mut pose: Vec<DVec3> = rest.iter().map(|&p| r * p + DVec3::new(3.0, -5.0, 1.0)).collect();
        assert!(distance_after_rigid_motion(&rest, &pose).0 < 1e-9);
        pose[7] += DVec3::X;
        let (worst, rms) = distance_after_rigid_motion(&rest, &pose);
        assert!(worst > 0.9 && worst < 1.0 && rms > 0.1 && rms < 0.15, "{worst} {rms}");
    }
}
