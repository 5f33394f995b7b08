//! Every body with every take of a whole person: how each pair is placed and bound, and how it moves. `scripts/pairs.sh` prints the table.

use super::{at, common, run};
use glam::DVec3;
use rayon::prelude::*;
use serde_json::Value;

/// What a pair came to. Lengths in millimetres, shares in per cent.
struct Row {
    name: String,
    refused: Option<String>,
    /// What is wrong with up, facing or fit.
    wrong: Vec<String>,
    warnings: Vec<String>,
    align: String,
    surface: Option<(f64, f64)>,
    fit: Option<(f64, f64)>,
    strain: Option<(f64, f64)>,
    first: f64,
    residual: (f64, f64),
    slip: Option<(f64, f64)>,
}

/// Angle between a direction of the report and the expected one, in degrees.
fn off(value: &Value, expected: &str) -> f64 {
    let direction = |numbers: Vec<f64>| DVec3::from_slice(&numbers);
    let found = value.as_array().map(|list| direction(list.iter().filter_map(Value::as_f64).collect()));
    let truth = direction(expected.split(',').filter_map(|n| n.trim().parse().ok()).collect());
    found.map_or(180.0, |f| f.angle_between(truth).to_degrees())
}

fn two(value: &Value, a: &str, b: &str) -> Option<(f64, f64)> {
    Some((at(value, a).as_f64()?, at(value, b).as_f64()?))
}

fn measured(mut row: Row, report: &Value, body: &[&str], up: &str) -> Row {
    let bound = &report["decisions"]["binding"];
    let axis = off(&at(bound, "scan_up.value"), body[2]);
    if axis > 10.0 {
        row.wrong.push(format!("up of the scan is {axis:.0}° off"));
    }
    let facing = off(&at(bound, "scan_forward.value"), body[3]);
    if facing > 20.0 {
        row.wrong.push(format!("facing of the scan is {facing:.0}° off"));
    }
    let found = at(bound, "capture_up.value");
    let plain = found.as_str().unwrap_or("none").replace('\u{2212}', "-");
    if plain != up {
        row.wrong.push(format!("up of the capture is {plain}, not {up}"));
    }
    row.align = bound["align"].as_str().unwrap_or_default().to_owned();
    row.fit = two(bound, "fit_residual_percent_of_height.median", "fit_residual_percent_of_height.p90");
    if row.fit.is_some_and(|f| f.0 > 4.0 || f.1 > 9.0) {
        row.wrong.push("the fit is bad".to_owned());
    }
    row.strain = two(bound, "strain_percent.median", "strain_percent.p95");
    row.surface = two(bound, "off_surface_mm.median", "off_surface_mm.worst");
    row.slip = two(bound, "feet.slid_mm.median", "feet.left_mm.median");
    let frames = report["frames"].as_array().cloned().unwrap_or_default();
    let mut medians: Vec<f64> = frames.iter().filter_map(|f| at(f, "residual_mm.median").as_f64()).collect();
    row.first = medians.first().copied().unwrap_or(f64::NAN);
    medians.sort_by(f64::total_cmp);
    let worst = frames.iter().filter_map(|f| at(f, "residual_mm.max").as_f64()).fold(0.0, f64::max);
    row.residual = (medians.get(medians.len() / 2).copied().unwrap_or(f64::NAN), worst);
    row
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
    let of = |kind: &str| table.iter().filter(|row| row[0] == kind).cloned().collect::<Vec<_>>();
    let (bodies, takes) = (of("body"), of("take"));
    let pairs: Vec<(&Vec<&str>, &Vec<&str>)> = bodies.iter().flat_map(|b| takes.iter().map(move |t| (b, t))).collect();
    let rows: Vec<Row> = pairs
        .par_iter()
        .enumerate()
        .map(|(k, (body, take))| {
            let path = |folder: &str, name: &str| data.join(folder).join(name).to_string_lossy().into_owned();
            let output = |ending: &str| folder.path().join(format!("{k}.{ending}")).to_string_lossy().into_owned();
            let (report, cache) = (output("json"), output("pc2"));
            let (scan, capture) = (path("meshes", body[1]), path("motion", take[1]));
            let mut arguments = vec![scan, capture, "-o".into(), cache.clone(), "--report".into(), report.clone()];
            arguments.extend(["--threads", "1"].map(String::from));
            let options = take[2].split_whitespace();
            arguments.extend(options.map(|o| if o.contains('/') { path("motion", o) } else { o.to_owned() }));
            let output = run(&arguments.iter().map(String::as_str).collect::<Vec<_>>());
            drop(std::fs::remove_file(cache));
            let said = String::from_utf8_lossy(&output.stderr).into_owned();
            let short = |path: &str| path.rsplit('/').next().unwrap_or(path).split('.').next().unwrap_or("").to_owned();
            let row = Row {
                name: format!("{} | {}", short(body[1]), short(take[1])),
                refused: None,
                wrong: Vec::new(),
                warnings: said.lines().filter_map(|l| l.strip_prefix("warning  ")).map(str::to_owned).collect(),
                align: String::new(),
                surface: None,
                fit: None,
                strain: None,
                first: f64::NAN,
                residual: (f64::NAN, f64::NAN),
                slip: None,
            };
            match std::fs::read(&report) {
                Ok(bytes) if output.status.success() => measured(row, &serde_json::from_slice(&bytes).unwrap(), body, take[3]),
                _ => {
                    let panicked = !matches!(output.status.code(), Some(1 | 3)) || said.contains("panicked");
                    let line = said.lines().find(|l| l.starts_with("error")).unwrap_or(&said).to_owned();
                    let wrong = if panicked { vec![said.clone()] } else { Vec::new() };
                    Row { refused: Some(line), wrong, ..row }
                }
            }
        })
        .collect();

    println!(
        "| scan | take | align | off the skin mm | fit % | strain % | first frame, median, worst residual mm | sliding mm | |"
    );
    println!("|---|---|---|---|---|---|---|---|---|");
    let pair = |p: Option<(f64, f64)>, digits: usize| p.map_or("–".to_owned(), |(a, b)| format!("{a:.digits$} / {b:.digits$}"));
    for row in &rows {
        let (names, said) = (&row.name, row.wrong.join("; "));
        match &row.refused {
            Some(why) => println!("| {names} | refused | {} | {said} |", why.chars().take(150).collect::<String>()),
            None => println!(
                "| {names} | {} | {} | {} | {} | {:.2}, {:.2}, {:.1} | {} | {said} |",
                row.align,
                pair(row.surface, 0),
                pair(row.fit, 1),
                pair(row.strain, 1),
                row.first,
                row.residual.0,
                row.residual.1,
                pair(row.slip, 1),
            ),
        }
    }
    let done = rows.iter().filter(|r| r.refused.is_none()).count();
    let warned =
        |row: &&Row| row.warnings.iter().any(|w| ["facing", "up axis", "hardly a person", "fit"].iter().any(|x| w.contains(x)));
    let silent: Vec<&str> = rows.iter().filter(|r| !r.wrong.is_empty() && !warned(r)).map(|r| r.name.as_str()).collect();
    let loud = rows.iter().filter(|r| !r.wrong.is_empty() && warned(r)).count();
    println!("pairs: {done} done, {} refused, {loud} wrong and warned, {} wrong and not warned", rows.len() - done, silent.len());
    assert!(silent.is_empty(), "{silent:?}");
}
