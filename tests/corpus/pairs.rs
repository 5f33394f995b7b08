//! Every body with every take of a whole person: how each pair is placed and bound, and how it moves. `scripts/pairs.sh` prints the table.

use super::limbs::{self, Points, Shafts};
use super::verdict::{Kind, Wrong, alarms};
use super::{at, common, run};
use glam::DVec3;
use rayon::prelude::*;
use retarget::capture::{self, Capture, ReadOptions};
use serde_json::Value;
use std::path::{Path, PathBuf};

/// A limb that lies farther than this from how it was captured, in degrees, lies wrong: markers lie on the skin and not at the joints, by
/// up to half of it.
const LIES: f64 = 40.0;
/// So much longer or shorter than at rest, per cent, is a limb that is stretched.
const STRETCHED: f64 = 25.0;
/// Frames of a pair that are looked at.
const LOOKS: usize = 12;
/// Farther than this from its target, in millimetres, a handle is not followed: the worst of the take, and the median frame's median.
const LEFT: (f64, f64) = (80.0, 10.0);
/// Distances along bones that differ by more than this, per cent (95th percentile), are strained.
const STRAINED: f64 = 25.0;
/// A foot that stands slides by more than this, in millimetres (median of its footfalls).
const SLIDES: f64 = 10.0;
/// Shares of the pairs that may be refused, and that may be warned of where they are right: who warns of everything tells nothing.
const REFUSED: f64 = 0.05;
const CRIED: f64 = 0.35;

/// A body of the table.
pub struct Body {
    file: PathBuf,
    up: DVec3,
    facing: DVec3,
    unit: &'static str,
    rest: Vec<DVec3>,
    /// As `inspect` has them.
    joints: Option<[DVec3; 12]>,
    tips: [DVec3; 2],
    stature: f64,
    /// As other files have them.
    truth: Option<[DVec3; 12]>,
}

/// A take of the table.
pub struct Take {
    file: PathBuf,
    options: Vec<String>,
    up: &'static str,
    unit: &'static str,
    capture: Capture,
    points: Points,
    /// Up in `capture`.
    pub along: DVec3,
}

/// What a pair came to. Lengths in millimetres, shares in per cent, angles in degrees.
#[derive(Default)]
pub struct Row {
    name: String,
    pub refused: Option<String>,
    /// What is wrong with unit, up, facing, fit or pose.
    pub wrong: Vec<Wrong>,
    pub warnings: Vec<String>,
    align: String,
    surface: Option<(f64, f64)>,
    fit: Option<(f64, f64)>,
    strain: Option<(f64, f64)>,
    /// Most that a limb's length changes; median over the frames.
    stretch: f64,
    /// Mean and worst limb in the first frame; worst of the limbs' medians over the frames, with its number.
    pose: (f64, f64, f64, usize),
    first: f64,
    residual: (f64, f64),
    slip: Option<(f64, f64)>,
}

fn numbers(text: &str) -> DVec3 {
    DVec3::from_slice(&text.split(',').map(|n| n.trim().parse().unwrap()).collect::<Vec<f64>>())
}

fn vector(value: &Value) -> Option<DVec3> {
    let list: Vec<f64> = value.as_array()?.iter().filter_map(Value::as_f64).collect();
    (list.len() == 3).then(|| DVec3::from_slice(&list))
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or(f64::NAN)
}

fn two(value: &Value, a: &str, b: &str) -> Option<(f64, f64)> {
    Some((at(value, a).as_f64()?, at(value, b).as_f64()?))
}

fn stem(path: &Path) -> String {
    path.file_name().unwrap().to_string_lossy().split('.').next().unwrap_or("").to_owned()
}

/// Joints that a file beside the bodies lists: the file, a place in it, and what makes units of the scan of its own.
fn known(data: &Path, words: &str) -> Option<[DVec3; 12]> {
    let words: Vec<&str> = words.split_whitespace().collect();
    let &[file, place, scale, shift] = words.as_slice() else { return None };
    let value: Value = serde_json::from_slice(&std::fs::read(data.join("meshes").join(file)).unwrap()).unwrap();
    let listed = at(&value, place);
    let scale: f64 = scale.parse().unwrap();
    Some(limbs::BONES.map(|bone| {
        let bone = &listed[bone];
        vector(bone).or_else(|| vector(&bone["head"])).unwrap() * scale + numbers(shift)
    }))
}

impl Body {
    fn read(data: &Path, row: &[&'static str]) -> Self {
        let truth = row.get(5).and_then(|words| known(data, words));
        Self::of(data.join("meshes").join(row[1]), numbers(row[2]), numbers(row[3]), row[4], truth)
    }

    pub fn of(file: PathBuf, up: DVec3, facing: DVec3, unit: &'static str, truth: Option<[DVec3; 12]>) -> Self {
        let output = run(&["inspect", "--json", &file.to_string_lossy()]);
        let found: Value = serde_json::from_slice(&output.stdout).unwrap();
        let joint = |j: usize| vector(&at(&found, &format!("body.joints.{j}")));
        let joints: Vec<DVec3> = limbs::JOINTS.into_iter().filter_map(joint).collect();
        Self {
            rest: retarget::scan::read(&file).unwrap().mesh.positions,
            file,
            up,
            facing,
            unit,
            joints: joints.try_into().ok(),
            tips: [7, 11].map(|j| joint(j).unwrap_or_default()),
            stature: at(&found, "body.stature").as_f64().unwrap_or(f64::NAN),
            truth,
        }
    }

    /// Mean and worst distance of the joints found from those known, in per cent of stature.
    fn errors(&self) -> Option<(f64, f64)> {
        let (found, truth) = (self.joints?, self.truth?);
        let far: Vec<f64> = found.iter().zip(&truth).map(|(a, b)| 100.0 * a.distance(*b) / self.stature).collect();
        Some((far.iter().sum::<f64>() / 12.0, far.iter().copied().fold(0.0, f64::max)))
    }
}

impl Take {
    fn read(data: &Path, row: &[&'static str]) -> Self {
        let path = |name: &str| data.join("motion").join(name);
        let options = row[2].split_whitespace();
        let options = options.map(|o| if o.contains('/') { path(o).to_string_lossy().into_owned() } else { o.to_owned() });
        Self::of(path(row[1]), &path(row[1]), options.collect(), (row[3], row[4]), row[5], row[6])
    }

    /// `truth`: the same motion, in which the points of the joints are found by their names; its up and unit are those of the take.
    pub fn of(
        file: PathBuf,
        truth: &Path,
        options: Vec<String>,
        (up, unit): (&'static str, &'static str),
        points: &str,
        mirror: &str,
    ) -> Self {
        let capture = capture::read(truth, &ReadOptions::default()).unwrap();
        let axis = ["X", "Y", "Z"].iter().position(|a| up.ends_with(a)).unwrap();
        let along = DVec3::AXES[axis] * if up.starts_with('-') { -1.0 } else { 1.0 };
        Self { points: Points::new(capture.motion.points(), points, mirror), file, options, up, unit, capture, along }
    }
}

fn measured(mut row: Row, report: &Value, body: &Body, take: &Take, frames: &[Vec<[f32; 3]>]) -> Row {
    let bound = &report["decisions"]["binding"];
    let off = |value: &Value, truth: DVec3| vector(value).map_or(180.0, |v| v.angle_between(truth).to_degrees());
    let axis = off(&at(bound, "scan_up.value"), body.up);
    if axis > 10.0 {
        row.wrong.push(Wrong::new(Kind::Up, format!("up of the scan is {axis:.0}° off")));
    }
    let facing = off(&at(bound, "scan_forward.value"), body.facing);
    if facing > 20.0 {
        row.wrong.push(Wrong::new(Kind::Facing, format!("facing of the scan is {facing:.0}° off")));
    }
    let word = |place: &str| at(bound, place).as_str().unwrap_or("none").replace('\u{2212}', "-");
    for (kind, what, place, truth) in [
        (Kind::Up, "up of the capture", "capture_up.value", take.up),
        (Kind::Unit, "unit of the capture", "capture_unit.value", take.unit),
        (Kind::Unit, "unit of the scan", "scan_unit.value", body.unit),
    ] {
        let found = word(place);
        if truth != "-" && found != truth {
            row.wrong.push(Wrong::new(kind, format!("{what} is {found}, not {truth}")));
        }
    }
    row.align = bound["align"].as_str().unwrap_or_default().to_owned();
    row.fit = two(bound, "fit_residual_percent_of_height.median", "fit_residual_percent_of_height.p90");
    if row.fit.is_some_and(|f| f.0 > 4.0 || f.1 > 9.0) {
        row.wrong.push(Wrong::new(Kind::Fit, "the fit is bad"));
    }
    row.strain = two(bound, "strain_percent.median", "strain_percent.p95");
    row.surface = two(bound, "off_surface_mm.median", "off_surface_mm.worst");
    row.slip = two(bound, "feet.slid_mm.median", "feet.left_mm.median");
    let listed = report["frames"].as_array().cloned().unwrap_or_default();
    let medians: Vec<f64> = listed.iter().filter_map(|f| at(f, "residual_mm.median").as_f64()).collect();
    row.first = medians.first().copied().unwrap_or(f64::NAN);
    let worst = listed.iter().filter_map(|f| at(f, "residual_mm.max").as_f64()).fold(0.0, f64::max);
    row.residual = (median(medians), worst);
    let (strain, slip) = (row.strain.map_or(0.0, |s| s.1), row.slip.map_or(0.0, |s| s.1));
    for (kind, found, limit, words) in [
        (Kind::Residual, worst, LEFT.0, format!("a handle stays {worst:.0} mm away")),
        (Kind::Residual, row.residual.0, LEFT.1, format!("handles stay {:.0} mm away", row.residual.0)),
        (Kind::Strain, strain, STRAINED, format!("handles are strained by {strain:.0} %")),
        (Kind::Slip, slip, SLIDES, format!("feet slide by {slip:.0} mm")),
    ] {
        if found > limit || found.is_nan() {
            row.wrong.push(Wrong::new(kind, words));
        }
    }

    let Some(joints) = body.truth.or(body.joints) else {
        row.wrong.push(Wrong::new(Kind::Broken, "no joints to look at"));
        return row;
    };
    let shafts = Shafts::new(&body.rest, joints, body.tips, body.stature);
    let looks: Vec<usize> =
        (0..LOOKS.min(frames.len())).map(|k| k * (frames.len() - 1) / (LOOKS.min(frames.len()) - 1).max(1)).collect();
    let written: Vec<limbs::Posed> = looks.iter().map(|&k| shafts.posed(&body.rest, &frames[k])).collect();
    let numbers: Vec<usize> =
        looks.iter().map(|&k| (listed[k]["frame"].as_i64().unwrap() - take.capture.first_frame) as usize).collect();
    let points = take.capture.motion.points();
    let captured: Vec<_> = numbers.iter().map(|&k| take.points.directions(points, k)).collect();
    let directions: Vec<[DVec3; 8]> = written.iter().map(|p| p.directions).collect();
    let errors = limbs::errors(&captured, &directions, (take.along, body.up));
    let first: Vec<f64> = errors[0].iter().flatten().copied().collect();
    let medians: Vec<(f64, usize)> =
        (0..8).map(|limb| (median(errors.iter().filter_map(|e| e[limb]).collect()), limb)).filter(|m| !m.0.is_nan()).collect();
    let worst = medians.iter().copied().max_by(|a, b| a.0.total_cmp(&b.0)).unwrap_or((f64::NAN, 0));
    row.pose = (first.iter().sum::<f64>() / first.len() as f64, first.iter().copied().fold(0.0, f64::max), worst.0, worst.1);
    for (error, limb) in medians.iter().filter(|m| m.0 > LIES) {
        row.wrong.push(Wrong::new(Kind::Pose(*limb), format!("the {} lies {error:.0}° off", limbs::NAMES[*limb])));
    }
    let stretch = (0..8).map(|limb| (median(written.iter().map(|p| 100.0 * (p.stretch[limb] - 1.0)).collect()), limb));
    let (stretch, limb) = stretch.max_by(|a, b| a.0.abs().total_cmp(&b.0.abs())).unwrap();
    row.stretch = stretch;
    if stretch.abs() > STRETCHED {
        row.wrong.push(Wrong::new(Kind::Length(limb), format!("the {} is {stretch:+.0} % longer", limbs::NAMES[limb])));
    }
    row
}

pub fn animate(data: &Path, folder: &Path, body: &Body, take: &Take) -> Row {
    let name = format!("{} | {}", stem(&body.file), stem(&take.file));
    let output = |ending: &str| folder.join(format!("{}.{ending}", name.replace(" | ", "+")));
    let (report, cache) = (output("json"), output("pc2"));
    let words = |p: &Path| p.to_string_lossy().into_owned();
    let mut arguments = vec![words(&body.file), words(&take.file), "-o".into(), words(&cache)];
    arguments.extend(["--report".into(), words(&report), "--threads".into(), "1".into()]);
    arguments.extend(take.options.iter().cloned());
    let output = run(&arguments.iter().map(String::as_str).collect::<Vec<_>>());
    let said = String::from_utf8_lossy(&output.stderr).replace(&*data.to_string_lossy(), "");
    let warnings = said.lines().filter_map(|l| l.strip_prefix("warning  ")).map(str::to_owned).collect();
    let row = Row { name, warnings, ..Row::default() };
    if let Ok(bytes) = std::fs::read(&report)
        && output.status.success()
    {
        let frames = common::read_pc2(&cache);
        drop(std::fs::remove_file(cache));
        return measured(row, &serde_json::from_slice(&bytes).unwrap(), body, take, &frames);
    }
    let panicked = !matches!(output.status.code(), Some(1 | 3)) || said.contains("panicked");
    let wrong = if panicked { vec![Wrong::new(Kind::Broken, said.clone())] } else { Vec::new() };
    Row { refused: Some(said.lines().find(|l| l.starts_with("error")).unwrap_or(&said).to_owned()), wrong, ..row }
}

pub fn print(row: &Row) {
    let pair = |p: Option<(f64, f64)>, digits: usize| p.map_or("–".to_owned(), |(a, b)| format!("{a:.digits$} / {b:.digits$}"));
    let said = |w: &Wrong| if w.is_told(&row.warnings) { w.to_string() } else { format!("{w} (not warned)") };
    let (names, said) = (&row.name, row.wrong.iter().map(said).collect::<Vec<_>>().join("; "));
    if let Some(why) = &row.refused {
        return println!("| {names} | refused | {} | {said} |", why.chars().take(150).collect::<String>());
    }
    println!(
        "| {names} | {} | {} | {} | {} | {:+.0} | {:.0} / {:.0}, {:.0} ({}) | {:.2}, {:.2}, {:.1} | {} | {said} |",
        row.align,
        pair(row.surface, 0),
        pair(row.fit, 1),
        pair(row.strain, 1),
        row.stretch,
        row.pose.0,
        row.pose.1,
        row.pose.2,
        limbs::NAMES[row.pose.3],
        row.first,
        row.residual.0,
        row.residual.1,
        pair(row.slip, 1),
    );
}

#[test]
#[ignore = "animates every real body by every take: scripts/pairs.sh"]
fn every_body_finds_its_place_in_every_take() {
    let Some(data) = common::shared() else { return };
    let folder = tempfile::tempdir().unwrap();
    let table: Vec<Vec<&str>> = include_str!("pairs.csv")
        .lines()
        .filter(|line| !line.starts_with('#') && !line.trim().is_empty())
        .map(|line| line.split(';').map(str::trim).collect())
        .collect();
    let of = |kind: &str| table.iter().filter(|row| row[0] == kind).collect::<Vec<_>>();
    let bodies: Vec<Body> = of("body").into_par_iter().map(|row| Body::read(&data, row)).collect();
    let takes: Vec<Take> = of("take").into_par_iter().map(|row| Take::read(&data, row)).collect();
    println!("| scan | joints found, mean / worst % of stature |");
    println!("|---|---|");
    for body in &bodies {
        if let Some((mean, worst)) = body.errors() {
            println!("| {} | {mean:.1} / {worst:.1} |", stem(&body.file));
        }
    }
    // RETARGET_PAIRS: only pairs with this word in their names.
    let some = std::env::var("RETARGET_PAIRS").unwrap_or_default();
    let named = |(b, t): &(&Body, &Take)| format!("{} | {}", stem(&b.file), stem(&t.file)).contains(&some);
    let pairs: Vec<(&Body, &Take)> = bodies.iter().flat_map(|b| takes.iter().map(move |t| (b, t))).filter(named).collect();
    let rows: Vec<Row> = pairs.par_iter().map(|(body, take)| animate(&data, folder.path(), body, take)).collect();

    println!(
        "| scan | take | align | off the skin mm | fit % | strain % | a limb's length % | pose: first frame mean / worst, over the take ° \
         | first frame, median, worst residual mm | sliding mm | |"
    );
    println!("|---|---|---|---|---|---|---|---|---|---|---|");
    rows.iter().for_each(print);
    let worst = |what: &str, value: &dyn Fn(&Row) -> f64| {
        let mut ranked: Vec<&Row> = rows.iter().filter(|r| r.refused.is_none() && !value(r).is_nan()).collect();
        ranked.sort_by(|a, b| value(b).total_cmp(&value(a)));
        for row in ranked.iter().take(5) {
            println!("| worst by {what} | {} | {:.1} |", row.name, value(row));
        }
    };
    let typical = |what: &str, value: &dyn Fn(&Row) -> f64| {
        let values: Vec<f64> = rows.iter().filter(|r| r.refused.is_none()).map(value).filter(|v| !v.is_nan()).collect();
        println!("| median over the pairs | {what} | {:.2} |", median(values));
    };
    typical("median residual mm", &|r| r.residual.0);
    typical("worst residual mm", &|r| r.residual.1);
    typical("pose of the worst limb °", &|r| r.pose.2);
    typical("sliding mm", &|r| r.slip.map_or(f64::NAN, |s| s.1));
    worst("residual mm", &|r| r.residual.1);
    worst("pose °", &|r| r.pose.2);
    worst("limb's length %", &|r| r.stretch.abs());
    worst("sliding mm", &|r| r.slip.map_or(f64::NAN, |s| s.1));
    worst("marker off the skin mm", &|r| r.surface.map_or(f64::NAN, |s| s.1));
    sum("pairs", rows.iter());
}

/// Prints how many are right; none may be wrong without the warning that tells of it, and few may be refused or warned of without being wrong.
pub fn sum<'a>(what: &str, rows: impl Iterator<Item = &'a Row>) {
    let rows: Vec<&Row> = rows.collect();
    let done = rows.iter().filter(|r| r.refused.is_none()).count();
    let silent = |r: &Row| r.wrong.iter().any(|w| !w.is_told(&r.warnings));
    let wrong = rows.iter().filter(|r| !r.wrong.is_empty()).count();
    let not_warned: Vec<&str> = rows.iter().filter(|r| silent(r)).map(|r| r.name.as_str()).collect();
    let cried = rows.iter().filter(|r| r.refused.is_none() && r.wrong.is_empty() && !alarms(&r.warnings).is_empty()).count();
    let all: Vec<(&str, bool)> =
        rows.iter().flat_map(|r| r.wrong.iter().map(|w| (w.kind.word(), w.is_told(&r.warnings)))).collect();
    for kind in all.iter().map(|w| w.0).collect::<std::collections::BTreeSet<_>>() {
        let count = |told: bool| all.iter().filter(|w| **w == (kind, told)).count();
        println!("| {what} | {kind} | {} wrong and warned | {} wrong and not warned |", count(true), count(false));
    }
    println!(
        "{what}: {done} done, {} refused, {} wrong and warned, {} wrong and not warned, {cried} right and warned of",
        rows.len() - done,
        wrong - not_warned.len(),
        not_warned.len()
    );
    assert!(not_warned.is_empty(), "{not_warned:?}");
    let most = |share: f64| (share * rows.len() as f64).ceil() as usize;
    if what == "pairs" {
        assert!(rows.len() - done <= most(REFUSED), "{} refused", rows.len() - done);
        assert!(cried <= most(CRIED), "{cried} right and warned of");
    }
}
