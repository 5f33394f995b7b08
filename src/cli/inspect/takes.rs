//! `retarget inspect` of captures: what the file says, what it does not, and where points are missing.

use super::{Found, triple};
use crate::binding;
use crate::capture::{self, Capture, MarkerTake, Motion, ReadOptions, Rest, SkeletonTake};
use crate::cli::args::Inspect;
use crate::cli::decisions::repairs_json;
use crate::error::Result;
use crate::space::Known;
use crate::words;
use glam::DVec3;
use serde_json::{Value, json};
use std::fmt::Display;
use std::path::Path;

/// Cells of a bar.
const BAR: usize = 40;
/// Columns that a list of names may fill.
const WIDTH: usize = 100;

/// Looks into a capture.
pub(super) fn look(path: &Path, args: &Inspect) -> Result<Found> {
    let options =
        ReadOptions { clip: args.clip.clone(), skeleton: args.skeleton.clone(), rate: args.rate, ..ReadOptions::default() };
    let found = capture::read(path, &ReadOptions { as_found: true, ..options.clone() })?;
    let clean = capture::read(path, &options)?;
    let actor = match clean.motion {
        Motion::Markers(_) => Some(binding::actor_space(&clean)),
        _ => None,
    };
    let (space, stature) = actor.as_ref().map_or((&clean.space, None), |a| (&a.space, a.stature));
    let take = found.motion.points();
    let (first, frames) = (found.first_frame, take.frames());
    let last = first + frames as i64 - 1;
    let seconds = frames.saturating_sub(1) as f64 / found.rate;
    let (low, high) = range(take);
    let gaps: Vec<Gaps> = (0..take.markers()).map(|m| Gaps::of(take, m)).collect();
    let missing = gaps.iter().map(|g| g.missing).sum::<usize>() as f64 / take.points.len().max(1) as f64;

    let noun = found.motion.noun();
    let how = |what: Option<String>, name: &str| what.unwrap_or_else(|| format!("{name} unknown"));
    let mut space_words =
        vec![how(space.unit.map(|u| known(&u)), "unit"), how(space.up.map(|u| format!("{} up ({})", u.value, u.how)), "up")];
    space_words.extend(stature.map(|s| {
        let height = space.unit.map_or_else(|| words::digits(s), |u| words::length(s * u.value.metres()));
        format!("a person, {height} high")
    }));
    let rate = words::digits((found.rate * 1000.0).round() / 1000.0);
    let mut lines = vec![
        line("capture", &format!("{} · {}", found.name, words::plural(take.markers(), noun))),
        line(
            "frames",
            &format!("{first}..{last} · {} at {rate} Hz · {}", words::plural(frames, "frame"), words::seconds(seconds)),
        ),
        line("space", &space_words.join(" · ")),
        line("range", &format!("{} .. {}", triple(low), triple(high))),
    ];
    let cleaning = clean.cleaning.to_string();
    lines.extend((!cleaning.is_empty()).then(|| line("cleaning", &cleaning)));
    let kept = clean.motion.points();
    if (kept.markers(), kept.frames()) != (take.markers(), frames) {
        let (from, to) = (clean.first_frame, clean.first_frame + kept.frames() as i64 - 1);
        lines.push(line("used", &format!("{}, frames {from}..{to}", words::plural(kept.markers(), noun))));
    }
    let skeleton = match &found.motion {
        Motion::Skeleton(skeleton) => Some(skeleton),
        _ => None,
    };
    lines.extend(skeleton.into_iter().flat_map(bone_lines));
    lines.extend(gap_lines(&found, &gaps, missing, args.ascii));

    let per_marker = gaps.iter().zip(&take.labels).map(|(gap, name)| {
        json!({
            "name": name,
            "missing": gap.missing,
            "gaps": gap.count,
            "longest": gap.longest,
            "longest_first_frame": (gap.longest > 0).then_some(first + gap.longest_at as i64),
        })
    });
    let c = &clean.cleaning;
    let value = json!({
        "kind": "capture",
        "of": noun,
        "name": found.name,
        "frames": frames,
        "first_frame": first,
        "last_frame": last,
        "rate": found.rate,
        "seconds": seconds,
        "markers": take.labels,
        "skeleton": skeleton.map(bones),
        "missing": missing,
        "gaps": per_marker.collect::<Vec<Value>>(),
        "unit": space.unit.map(|u| u.value.to_string()),
        "unit_from": space.unit.map(|u| u.how.to_string()),
        "up": space.up.map(|u| u.value.to_string()),
        "up_from": space.up.map(|u| u.how.to_string()),
        "stature": stature,
        "box": if low.is_finite() { json!([low.to_array(), high.to_array()]) } else { Value::Null },
        "cleaned": {
            "markers": kept.labels,
            "first_frame": clean.first_frame,
            "frames": kept.frames(),
            "ghosts": c.ghosts, "computed": c.computed, "other_subjects": c.other_subjects, "empty": c.empty, "copies": c.copies,
            "renamed": c.renamed, "exchanged": c.exchanged, "jumps": c.jumps, "strays": c.strays,
            "stuck": c.stuck, "filled": c.filled, "left_open": c.left, "repairs": repairs_json(&clean),
        },
    });
    let mut notes = clean.notes;
    actor.into_iter().for_each(|a| notes.extend(a.notes));
    Ok(Found { value, lines, notes })
}

/// The hierarchy and the rest pose of a skeleton, for people.
fn bone_lines(skeleton: &SkeletonTake) -> Vec<String> {
    let count = |wanted: fn(&capture::Joint) -> bool| skeleton.joints.iter().filter(|j| wanted(j)).count();
    let counts = format!(
        "{}, {}, {}, depth {}",
        words::plural(count(|j| !j.end), "joint"),
        words::plural(count(|j| j.parent.is_none()), "root"),
        words::plural(count(|j| j.end), "bone end"),
        skeleton.depth(),
    );
    vec![line("bones", &counts), line("rest pose", &skeleton.rest.to_string())]
}

/// The same for programs.
fn bones(skeleton: &SkeletonTake) -> Value {
    let (low, high) = skeleton.range();
    json!({
        "joints": skeleton.joints.iter().filter(|j| !j.end).count(),
        "parents": skeleton.joints.iter().map(|j| j.parent).collect::<Vec<_>>(),
        "ends": skeleton.joints.iter().map(|j| j.end).collect::<Vec<_>>(),
        "depth": skeleton.depth(),
        "rest": (skeleton.rest != Rest::Unknown).then(|| skeleton.rest.to_string()),
        "range": [low.to_array(), high.to_array()],
    })
}

fn line(name: &str, text: &str) -> String {
    format!("{name:<9} {text}")
}

fn known<T: Display>(known: &Known<T>) -> String {
    format!("{} ({})", known.value, known.how)
}

/// Least and largest coordinates; infinite where nothing is there.
fn range(take: &MarkerTake) -> (DVec3, DVec3) {
    let places = take.points.iter().filter(|p| !p[0].is_nan()).map(|p| DVec3::from_array(p.map(f64::from)));
    let (low, high) = places.fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(low, high), p| (low.min(p), high.max(p)));
    (low + take.origin, high + take.origin)
}

/// Where a marker is missing.
#[derive(Clone, Debug, Default, PartialEq)]
struct Gaps {
    /// Frames without it.
    missing: usize,
    /// Stretches of them.
    count: usize,
    /// Frames of the longest.
    longest: usize,
    /// First frame of the longest, counted from 0.
    longest_at: usize,
    /// Share of the frames that it is there in, for each cell of the bar.
    shares: Vec<f64>,
}

impl Gaps {
    fn of(take: &MarkerTake, marker: usize) -> Self {
        let frames = take.frames();
        let there = |frame: usize| !take.points[frame * take.markers() + marker][0].is_nan();
        let mut gaps = Self::default();
        let mut run = 0;
        for frame in 0..frames {
            run = if there(frame) { 0 } else { run + 1 };
            gaps.missing += usize::from(run > 0);
            gaps.count += usize::from(run == 1);
            if run > gaps.longest {
                (gaps.longest, gaps.longest_at) = (run, frame + 1 - run);
            }
        }
        let cells = BAR.min(frames);
        gaps.shares = (0..cells)
            .map(|c| {
                let span = c * frames / cells..(c + 1) * frames / cells;
                span.clone().filter(|f| there(*f)).count() as f64 / span.len() as f64
            })
            .collect();
        gaps
    }

    /// Full where the marker is there, flat where it is not, something between where it is there at times.
    fn bar(&self, ascii: bool) -> String {
        let cells: &[char] = if ascii { &['.', '-', '+', '#'] } else { &['▁', '▂', '▃', '▄', '▅', '▆', '▇'] };
        let inner = cells.len() - 2;
        let cell = |share: f64| match share {
            s if s <= 0.0 => cells[0],
            s if s >= 1.0 => cells[cells.len() - 1],
            s => cells[1 + ((s * inner as f64) as usize).min(inner - 1)],
        };
        self.shares.iter().map(|s| cell(*s)).collect()
    }
}

/// One line per marker with gaps, and the names of the others. Vertices of a surface are many, have no names and no gaps: their number is enough.
fn gap_lines(capture: &Capture, gaps: &[Gaps], missing: f64, ascii: bool) -> Vec<String> {
    let take = capture.motion.points();
    let complete: Vec<&str> =
        take.labels.iter().zip(gaps).filter(|(_, g)| g.missing == 0).map(|(label, _)| label.as_str()).collect();
    if matches!(capture.motion, Motion::Vertices(_)) && complete.len() == take.markers() {
        return vec![line("complete", &format!("{} all, without a gap", complete.len()))];
    }
    let mut lines = Vec::new();
    if complete.len() < take.markers() {
        let frames = take.frames().div_ceil(BAR.min(take.frames().max(1)));
        let title = format!("{} of all positions missing; one cell is {}", percent(missing), words::plural(frames, "frame"));
        lines.push(line("gaps", &title));
    }
    let width = take.labels.iter().map(|l| l.chars().count()).max().unwrap_or(0).clamp(4, 24);
    for (label, gap) in take.labels.iter().zip(gaps).filter(|(_, g)| g.missing > 0) {
        let at = capture.first_frame + gap.longest_at as i64;
        let longest = format!("longest {} at {at}", words::seconds_short(gap.longest as f64 / capture.rate));
        lines.push(format!(
            "  {label:<width$} {} {:>7}  {:>8}, {longest}",
            gap.bar(ascii),
            percent(gap.missing as f64 / take.frames().max(1) as f64),
            words::plural(gap.count, "gap"),
        ));
    }
    if !complete.is_empty() {
        let all = if complete.len() == take.markers() { "all, without a gap:".to_owned() } else { "without a gap:".to_owned() };
        let mut row = line("complete", &format!("{} {all}", complete.len()));
        for name in complete {
            if row.chars().count() + 1 + name.chars().count() > WIDTH {
                lines.push(std::mem::replace(&mut row, " ".repeat(9)));
            }
            row.push(' ');
            row.push_str(name);
        }
        lines.push(row);
    }
    lines
}

/// `3.4 %`, `< 0.1 %`.
fn percent(share: f64) -> String {
    let percent = share * 100.0;
    if percent > 0.0 && percent < 0.1 { "< 0.1 %".to_owned() } else { format!("{percent:.1} %") }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gaps_are_counted_and_drawn() {
        let nan = [f32::NAN; 3];
        let mut points = vec![[1.0, 2.0, 3.0]; 80];
        points[0..10].fill(nan);
        points[21] = nan;
        points[76..80].fill(nan);
        let take = MarkerTake { labels: vec!["a".into()], points, ..MarkerTake::default() };
        let gaps = Gaps::of(&take, 0);
        assert_eq!((gaps.missing, gaps.count, gaps.longest, gaps.longest_at), (15, 3, 10, 0));
        assert_eq!(gaps.bar(false), format!("{}{}▄{}{}", "▁".repeat(5), "▇".repeat(5), "▇".repeat(27), "▁".repeat(2)));
        assert_eq!(gaps.bar(true), format!("{}{}+{}{}", ".".repeat(5), "#".repeat(5), "#".repeat(27), ".".repeat(2)));
        assert_eq!((percent(0.0004), percent(0.034), percent(1.0)), ("< 0.1 %".into(), "3.4 %".into(), "100.0 %".into()));
    }
}
