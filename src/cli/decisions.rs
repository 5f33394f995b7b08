//! The decisions block, the warnings about a run and the closing summary, in words and for the report.

use super::args::Animate;
use super::captures::is_table;
use crate::binding::Binding;
use crate::capture::{Capture, How};
use crate::deform::{Grip, OrientedHandle};
use crate::error::{Error, Kind, Notes, Result};
use crate::export::Written;
use crate::pipeline::Outcome;
use crate::scan::{Scan, UnitBox};
use crate::words::{self, file_name};
use serde_json::{Value, json};
use std::ops::Range;

pub(super) fn bind_line(args: &Animate, binding: &Binding) -> String {
    // Handles at joints of sets of few markers are the binding's own.
    let of_tables = binding.handles.iter().skip(binding.decisions.bound).filter(|h| h.known_as() == h.label).count();
    let handles = of_tables + binding.turning.handles.len();
    match (is_table(&args.capture), handles) {
        (true, n) => format!("{}, fixed to the scan where they are in their first frames", words::plural(n, "handle")),
        (false, 0) => binding.decisions.bind_line(),
        (false, n) => format!("{} · {} of a table", binding.decisions.bind_line(), words::plural(n, "handle")),
    }
}

pub(super) fn scan_line(args: &Animate, scan: &Scan, binding: &Binding) -> String {
    let mesh = &scan.mesh;
    let (mut triangles, mut polygons) = (0, 0);
    mesh.faces.iter().for_each(|f| if f.len() == 3 { triangles += 1 } else { polygons += 1 });
    let mut faces = Vec::new();
    if triangles > 0 {
        faces.push(words::plural(triangles, "triangle"));
    }
    if polygons > 0 {
        faces.push(words::plural(polygons, "polygon"));
    }
    format!(
        "{}  {}, {}  {}",
        file_name(&args.scan),
        words::plural(mesh.positions.len(), "vertex"),
        faces.join(", "),
        binding.decisions.scan_words()
    )
}

pub(super) fn capture_line(args: &Animate, capture: &Capture, binding: &Binding) -> String {
    let mut parts = vec![
        capture_counts(capture, binding, is_table(&args.capture)),
        binding.decisions.capture_words(),
        capture.cleaning.to_string(),
        args.smooth.map_or_else(String::new, |hz| format!("smoothed at {} Hz", words::digits(hz))),
        args.fps.map_or_else(String::new, |fps| format!("resampled to {} Hz", words::digits(fps))),
    ];
    parts.retain(|p| !p.is_empty());
    format!("{}  {}", file_name(&args.capture), parts.join(" · "))
}

fn capture_counts(capture: &Capture, binding: &Binding, table: bool) -> String {
    let (take, turning) = (capture.motion.points(), &binding.turning);
    let points_of_tables = binding.handles.iter().skip(binding.decisions.bound).filter(|h| h.known_as() == h.label).count();
    let what = if table {
        words::plural(points_of_tables + turning.handles.len(), "handle")
    } else {
        // Trajectories of their own leave the capture's points as they are.
        let added = if binding.trajectories.is_none() { points_of_tables } else { 0 };
        words::plural(take.markers() - added, capture.motion.noun())
    };
    let rate = words::digits((capture.rate * 1000.0).round() / 1000.0);
    format!("{what}, {} at {rate} Hz", words::plural(take.frames().max(turning.frames()), "frame"))
}

/// A range that reaches beyond the take is cut to it.
pub(super) fn cut(args: &Animate, capture: &Capture, range: &Range<usize>) -> Notes {
    let mut notes = Notes::default();
    let (first, last) = (capture.first_frame + range.start as i64, capture.first_frame + range.end as i64 - 1);
    if let Some((a, b)) = args.frames.filter(|&(a, b)| a < first || b > last) {
        notes.warn(format!("--frames {a}..{b} reaches beyond the take: frames {first}..{last} are written"));
    }
    notes
}

/// The markers that do not pull, by name.
pub(super) fn unbound(binding: &Binding) -> Notes {
    const NAMED: usize = 6;
    let mut notes = Notes::default();
    if !binding.unbound.is_empty() {
        let named: Vec<String> =
            binding.unbound.iter().take(NAMED).map(|(label, reason)| format!("{label} ({reason})")).collect();
        let more = binding.unbound.len().saturating_sub(NAMED);
        let more = if more > 0 { format!(" and {more} more, see --verbose") } else { String::new() };
        notes.warn(format!(
            "{} not bound: {}{more}",
            words::plural(binding.unbound.len(), binding.decisions.noun),
            named.join(", ")
        ));
    }
    notes
}

/// One line per repair of the capture, for `--verbose`.
pub(super) fn repair_details(capture: &Capture) -> Vec<String> {
    capture.cleaning.repairs.iter().map(|repair| repair.words(capture.rate, capture.first_frame)).collect()
}

/// The repairs of a capture for the report.
pub(super) fn repairs_json(capture: &Capture) -> Value {
    let repairs = capture.cleaning.repairs.iter().map(|repair| {
        let (first, last) = repair.frames;
        let mut value = json!({
            "marker": repair.marker,
            "how": repair.how.word(),
            "first_frame": first,
            "last_frame": last,
            "seconds": (last - first + 1) as f64 / capture.rate,
        });
        match &repair.how {
            How::Filled(neighbours) => value["neighbours"] = json!(neighbours),
            How::Exchanged(other) | How::Joined(other) => value["with"] = json!(other),
            _ => {}
        }
        value
    });
    repairs.collect()
}

/// One line per marker, for `--verbose`.
pub(super) fn binding_details(binding: &Binding) -> Vec<String> {
    let bound = binding.handles.iter().map(|h| {
        let segment = h.segment.map_or("as it is", |s| s.name());
        let doubt = if h.beta < 1.0 { "  (doubtful: soft)" } else { "" };
        format!("{:<12} {segment}{doubt}", h.label)
    });
    let turning = binding.turning.handles.iter().map(|h| format!("{:<12} moves and turns what it holds", h.name));
    let bound = bound.chain(turning);
    bound.chain(binding.unbound.iter().map(|(label, reason)| format!("{label:<12} not bound: {reason}"))).collect()
}

/// The decisions of the binding for the report.
pub(super) fn binding_json(binding: &Binding, unit_box: UnitBox) -> Value {
    let d = &binding.decisions;
    // Of scans without a known unit, in the scan's own.
    let mm = d.scan_unit.map_or(1.0, |unit| unit.value.metres() * 1e3);
    let known = |value: String, how: crate::space::Evidence| json!({ "value": value, "from": how.to_string() });
    json!({
        "align": d.align.to_string(),
        "on_skin": d.on_skin,
        "reference_is_rest": d.reference_rest,
        "points": d.noun,
        "reference_frame": d.reference_frame,
        "reference_capture": d.reference_capture,
        "scale": d.scale,
        "yaw_degrees": d.yaw,
        "scan_unit": d.scan_unit.map(|k| known(k.value.to_string(), k.how)),
        "scan_up": d.scan_up.map(|k| json!({ "value": k.value.to_array(), "from": k.how.to_string() })),
        "scan_forward": d.scan_forward.map(|k| json!({ "value": k.value.to_array(), "from": k.how.to_string() })),
        "scan_height": d.scan_height,
        "capture_unit": d.capture_unit.map(|k| known(k.value.to_string(), k.how)),
        "capture_up": d.capture_up.map(|k| known(k.value.to_string(), k.how)),
        "actor_height": d.actor_height,
        "marker_set": d.set,
        "markers": d.markers,
        "named": d.named,
        "bound": d.bound,
        "fit_residual_percent_of_height": d.residual.map(|(median, p90)| json!({ "median": median, "p90": p90 })),
        "strain_percent": d.strain.map(|(median, p95)| json!({ "median": median, "p95": p95 })),
        "off_surface_mm": d.off_surface.as_ref().map(|(median, worst, label)| json!({ "median": mm * median, "worst": mm * worst, "label": label })),
        "feet": d.feet.map(|f| json!({
            "contacts": f.contacts,
            "slid_mm": { "median": mm * f.before.0, "worst": mm * f.before.1 },
            "left_mm": { "median": mm * f.after.0, "worst": mm * f.after.1 },
        })),
        "proportions": d.proportions.iter().map(|&(name, ratio)| (name.to_owned(), json!(ratio))).collect::<serde_json::Map<_, _>>(),
        "handles": binding.handles.iter().map(|h| json!({
            "label": h.label,
            "segment": h.segment.map(|s| s.name()),
            "attachment": unit_box.leave(h.attachment).to_array(),
            "beta": h.beta,
        })).collect::<Vec<_>>(),
        "unbound": binding.unbound.iter().map(|(label, reason)| json!({ "label": label, "reason": reason })).collect::<Vec<_>>(),
    })
}

/// How an oriented handle holds the scan, for the report.
pub(super) fn oriented_json(handle: &OrientedHandle, unit_box: UnitBox) -> Value {
    let (grip, vertices) = match &handle.grip {
        Grip::Frame { rows, .. } => ("surroundings", rows[0].indices.len()),
        Grip::Region { vertices, .. } => ("part", vertices.len()),
        Grip::Exact { vertices } => ("part, exactly", vertices.len()),
    };
    json!({ "label": handle.name, "rest": unit_box.leave(handle.rest).to_array(), "holds": grip, "proxy_vertices": vertices })
}

pub(super) fn solve_line(args: &Animate) -> String {
    match args.iterations {
        Some(n) => format!("volumetric, {n} plain iterations per frame"),
        None => format!("volumetric, quality {:?}", args.quality).to_lowercase(),
    }
}

/// What a frame with a fold is.
pub(super) const FOLDING: &str = "more than 10 tetrahedra are inside out there";

/// A handle that stays farther from its target than this, in diagonals, is not followed.
const LEFT: f64 = 0.03;

/// Warnings about the frames, one per kind. `names` of the handles; `folding`: what a frame with a fold is.
pub(super) fn outcome_warnings(
    outcome: &Outcome,
    names: &[&str],
    diagonal: f64,
    metres: Option<f64>,
    folding: &str,
) -> Vec<String> {
    let mut texts = Vec::new();
    if let Some((worst, handle, frame)) = outcome.worst
        && worst > LEFT * diagonal * metres.map_or(1.0, |m| 1e3 * m)
    {
        texts.push(format!(
            "{} stays {} from its target in frame {frame}: the scan does not follow the capture there",
            names[handle],
            residual_words(worst, metres)
        ));
    }
    if outcome.held.count() > 0 {
        texts.push(format!("{} without any marker: the pose was held", outcome.held));
    }
    if outcome.folds.count() > 0 {
        let parts: Vec<&str> = outcome.folding.iter().take(3).map(|f| f.0).collect();
        let at = if parts.is_empty() { String::new() } else { format!(", {}", parts.join(", ")) };
        texts.push(format!("fold at {}{at}: {folding}, so look at deep creases of the skin", outcome.folds));
    }
    if outcome.unsolved.count() > 0 {
        let within = outcome.unsolved_error.map(|e| format!(", but to within about {}", length(e * diagonal, metres)));
        texts.push(format!("{} not solved to the tolerance{}", outcome.unsolved, within.unwrap_or_default()));
    }
    if outcome.recovered.count() > 0 {
        texts.push(format!("{} found again from the rest pose: the body may jump there", outcome.recovered));
    }
    texts
}

/// A length of the scan as a person reads it.
fn length(scan_units: f64, metres: Option<f64>) -> String {
    match metres {
        Some(m) => words::length(scan_units * m),
        None => format!("{} units", words::digits(scan_units)),
    }
}

/// A distance of handles to targets, in millimetres or, where the scan's unit is not known, in that.
fn residual_words(residual: f64, metres: Option<f64>) -> String {
    format!("{} {}", words::digits(residual), if metres.is_some() { "mm" } else { "units" })
}

/// Fails when the worst residual of the take is above the limit of `--fail-above`.
pub(super) fn within(limit: f64, outcome: &Outcome, names: &[&str], metres: Option<f64>) -> Result<()> {
    match outcome.worst {
        Some((worst, handle, frame)) if worst > limit => {
            let found = format!("{} stays {} from its target", names[handle], residual_words(worst, metres));
            Err(Error::new(Kind::AboveLimit, found)
                .at(format!("frame {frame}"))
                .expected(format!("at most {} (--fail-above {limit}); the outputs are written", residual_words(limit, metres)))
                .hint("--report FILE.json tells of every frame, --picture FILE.png shows where the handles sit"))
        }
        _ => Ok(()),
    }
}

pub(super) fn done_line(outcome: &Outcome, total: f64, names: &[&str], metres: Option<f64>, diagonal: f64) -> String {
    let mut parts = vec![words::seconds(total)];
    if let Some((worst, handle, frame)) = outcome.worst {
        parts.push(format!(
            "residual median {}, worst {} ({}, frame {frame})",
            // The histogram knows no figure below its first bin.
            residual_words(outcome.residuals.quantile(0.5).min(worst), metres),
            residual_words(worst, metres),
            names[handle]
        ));
    }
    parts.push(format!("volume {:.1}–{:.1} %", outcome.volume.0 * 100.0, outcome.volume.1 * 100.0));
    for written in &outcome.written {
        parts.push(written_words(written, diagonal, metres));
    }
    parts.join(" · ")
}

fn written_words(written: &Written, diagonal: f64, metres: Option<f64>) -> String {
    let mut text = format!("{} {} ({}", written.path.display(), words::bytes(written.bytes), written.encoding);
    if written.max_error > 0.0 {
        let percent = |e: f64| words::digits(e / diagonal * 100.0);
        text += &format!(
            ", rms {} %, worst vertex {} % = {}",
            percent(written.rms_error),
            percent(written.max_error),
            length(written.max_error, metres)
        );
        if let Some(frame) = written.worst_frame {
            text += &format!(" in frame {frame}");
        }
    }
    text + ")"
}
