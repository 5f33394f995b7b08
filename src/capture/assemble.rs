//! From what a file of markers holds to a clean capture: one subject, one label per marker, gaps filled.

use super::c3d::C3d;
use super::head::Head;
use super::table::Table;
use super::triads::Triads;
use super::{Capture, Cleaning, MarkerTake, Motion, ReadOptions, clean, labels, segments, source};
use crate::error::{Error, Kind, Notes, Result};
use crate::space::{Known, Unit};
use crate::words;
use glam::DVec3;
use std::io::{Read, Seek};
use std::path::Path;

/// A C3D file: only the columns that are wanted are read.
pub(super) fn c3d<R: Read + Seek>(mut file: C3d<R>, path: &Path, options: &ReadOptions) -> Result<Capture> {
    let head = Head {
        labels: std::mem::take(&mut file.labels),
        labelled: file.labelled,
        computed: std::mem::take(&mut file.computed),
        subjects: std::mem::take(&mut file.subjects),
        rate: file.rate,
        first_frame: file.first_frame,
        space: file.space.clone(),
        notes: std::mem::take(&mut file.notes),
    };
    if (head.labels.is_empty() || options.bodies) && file.has_segments() {
        return segments_of(file, head, path, options);
    }
    markers(head, path, options, |columns, notes| {
        let points = file.points(columns)?;
        notes.extend(std::mem::take(&mut file.notes));
        Ok((points, DVec3::ZERO))
    })
}

fn segments_of<R: Read + Seek>(mut file: C3d<R>, mut head: Head, path: &Path, options: &ReadOptions) -> Result<Capture> {
    let none = || Error::new(Kind::Unsupported, "holds no segments").expected("matrices of segments");
    let (take, rate) = file.segments()?.ok_or_else(none)?;
    head.notes.extend(std::mem::take(&mut file.notes));
    head.rate = rate;
    segments::assemble(take, head, path, options)
}

/// A table of text, which was read as a whole.
pub(super) fn table(table: Table, path: &Path, options: &ReadOptions) -> Result<Capture> {
    let Table { head, grid } = table;
    markers(head, path, options, |columns, _| grid.dense(columns))
}

/// `points`: positions of the columns that are wanted, frame-major, and what they count from.
fn markers(
    mut head: Head,
    path: &Path,
    options: &ReadOptions,
    points: impl FnOnce(&[usize], &mut Notes) -> Result<(Vec<[f32; 3]>, DVec3)>,
) -> Result<Capture> {
    let mut notes = std::mem::take(&mut head.notes);
    let mut cleaning = Cleaning::default();
    if !head.labelled {
        notes.warn(format!("the file has no labels: its {} points are numbered", head.labels.len()));
        for (n, label) in head.labels.iter_mut().enumerate() {
            *label = format!("M{:03}", n + 1);
        }
    }
    let wanted = options.subject.as_deref();
    let selection = labels::select(&head.labels, &head.computed, &head.subjects, wanted, &mut cleaning, &mut notes)?;
    if let Some(triads) = Triads::of(&head.labels, &selection) {
        let (points, origin) = points(&triads.columns(), &mut notes)?;
        let (take, skew) = triads.skeleton(&points, origin);
        notes.warn(format!("all {} points have the tips of two axes (…Y, …Z): they are joints that turn", take.joints.len()));
        if skew > 0 {
            notes.warn(format!("{} of joints whose axes are not at right angles: gaps", words::plural(skew, "place")));
        }
        head.subjects = selection.subject.map_or(head.subjects, |subject| vec![subject]);
        return segments::assemble(take, Head { notes, ..head }, path, options);
    }
    let (points, origin) = points(&selection.columns, &mut notes)?;
    let mut take = MarkerTake { labels: selection.labels, points, origin };
    let mut first_frame = head.first_frame;
    if options.as_found {
        clean::rename_namesakes(&mut take);
    } else {
        clean::clean(&mut take, &mut first_frame, head.rate, &mut cleaning, &mut notes)?;
    }
    check_size(clean::size(&take), head.space.unit, &mut notes);

    let only = match &head.subjects[..] {
        [one] => Some(one.clone()),
        _ => None,
    };
    Ok(Capture {
        name: selection.subject.or(only).unwrap_or_else(|| source::stem(path)),
        rate: head.rate,
        first_frame,
        space: head.space,
        motion: Motion::Markers(take),
        source: path.to_owned(),
        cleaning,
        notes,
    })
}

/// Warns where the unit makes the body absurdly large or small; the values are left alone.
fn check_size(size: f64, unit: Option<Known<Unit>>, notes: &mut Notes) {
    let Some(unit) = unit else { return };
    let metres = size * unit.value.metres();
    if metres > 20.0 || (metres > 0.0 && metres < 0.01) {
        let unit = unit.value;
        notes.warn(format!("the file says {unit}, but the markers then span {metres:.3} m: the unit is doubtful"));
    }
}
