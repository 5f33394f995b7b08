//! One plain iteration: a fused pass with a Newton step of every rotation, and a linear solve. `scripts/libigl.sh` sets it against libigl's.

use super::cases::Case;
use super::milliseconds;
use glam::DVec3;
use retarget::deform::Deformer;
use retarget::deform::volumetric::{Options, Volumetric};
use retarget::linalg::use_baseline;
use std::io::Write;
use std::path::{Path, PathBuf};

const REPEATS: usize = 7;

/// The energy as it is published: no bulk, slivers as they are.
pub fn published() -> Options {
    Options { bulk: 0.0, sliver_cap: f64::INFINITY, interpolate_above: f64::INFINITY, ..Default::default() }
}

/// Plain iterations.
pub fn plain(count: u32, rotation_steps: Option<u32>) -> Options {
    Options { iterations: Some(count), rotation_steps, ..published() }
}

pub fn run(arguments: &[String]) {
    let mut poses: Option<PathBuf> = None;
    let mut arguments = arguments.iter();
    let count: u32 = arguments.next().expect("a count of iterations").parse().unwrap();
    while let Some(argument) = arguments.next() {
        if argument == "--poses" {
            poses = Some(arguments.next().expect("a folder").into());
            continue;
        }
        let path = Path::new(argument);
        let case = Case::read(path).unwrap_or_else(|| panic!("{argument} is not there"));
        let frame = case.targets.len() / 2;
        let name = path.file_stem().unwrap().to_string_lossy();
        let mut times = [0.0; 3];
        let mut deformer = case.deformer(&plain(count, Some(1)));
        for (time, baseline) in times.iter_mut().zip([false, true]) {
            use_baseline(baseline);
            *time = timed(&case, &mut deformer, frame, count);
        }
        use_baseline(false);
        if let Some(folder) = &poses {
            write(&folder.join(format!("{name}.plain")), deformer.pose());
            let mut converged = case.deformer(&Options { tolerance: 1e-10, ..published() });
            from_rest(&case, &mut converged, frame);
            write(&folder.join(format!("{name}.converged")), converged.pose());
        }
        times[2] = timed(&case, &mut case.deformer(&plain(count, None)), frame, count);
        println!(
            "iteration {name} {} {} {} {:.4} {:.4} {:.4} {:.2e}",
            case.proxy.rest.len(),
            case.proxy.tets.len(),
            case.handles.len() + case.oriented.len(),
            times[0],
            times[1],
            times[2],
            agreement(&case),
        );
    }
}

fn from_rest(case: &Case, deformer: &mut Volumetric, frame: usize) {
    let (targets, placements) = case.at_rest();
    deformer.place(&placements).unwrap();
    deformer.start(&targets).unwrap();
    case.solve(deformer, frame, false);
}

fn timed(case: &Case, deformer: &mut Volumetric, frame: usize, count: u32) -> f64 {
    let (targets, placements) = case.at_rest();
    let mut times = Vec::new();
    for _ in 0..REPEATS {
        deformer.place(&placements).unwrap();
        deformer.start(&targets).unwrap();
        times.push(milliseconds(1, || _ = case.solve(deformer, frame, false)) / f64::from(count));
    }
    super::median(times)
}

/// Largest distance to the stored poses, all frames solved in turn, in diagonals; NaN without stored poses.
fn agreement(case: &Case) -> f64 {
    let mut deformer = case.deformer(&Options { tolerance: 1e-8, ..published() });
    let mut worst = f64::NAN;
    for frame in 0..case.targets.len() {
        case.solve(&mut deformer, frame, frame == 0);
        for (_, pose, _) in case.stored.iter().filter(|s| s.0 == frame) {
            let far = pose.iter().zip(deformer.pose()).map(|(a, b)| a.distance(*b)).fold(0.0, f64::max);
            worst = worst.max(far / case.diagonal);
        }
    }
    worst
}

fn write(path: &Path, pose: &[DVec3]) {
    let mut file = std::io::BufWriter::new(std::fs::File::create(path).unwrap());
    pose.iter().flat_map(|p| p.to_array()).for_each(|x| file.write_all(&x.to_le_bytes()).unwrap());
}
