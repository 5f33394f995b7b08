//! Handles from a table: they rest where they are in their first frame, and go where the table says.
//!
//! A handle with an orientation holds the scan by four points that move with it, its own and the ends of three axes.

use super::bind::scan_unit;
use super::landmarks::Body;
use super::segments::Skeleton;
use super::similarity::Similarity;
use super::{Align, Binding, BoundMarker, Decisions, Options, ScanShape, Segment, SegmentPlace};
use crate::capture::Capture;
use crate::capture::handles_csv::HandleTable;
use crate::error::{Error, Kind, Notes, Result};
use crate::space::{Evidence, Known};
use glam::{DQuat, DVec3};

/// Distance off the scan at rest, in diagonals, beyond which the table is not in the scan's space.
const ELSEWHERE: f64 = 0.5;
/// The same beyond which a handle moves the scan like a long lever.
const LEVER: f64 = 0.1;
/// Hardness of the points by which a turning handle holds the scan: they work on short levers.
const TURNING: f64 = 100.0;
/// Length of the axes by which a turning handle holds the scan, in diagonals.
const AXES: f64 = 0.07;

/// A binding without markers, for scans that handles alone move; the capture's space is the unit box.
pub fn unbound(scan: &ScanShape<'_>, body: Option<&Body>, table: &HandleTable, options: &Options) -> Binding {
    let skeleton = body.map(Skeleton::of);
    let segments = skeleton.iter().flat_map(|s| {
        Segment::ALL.map(|segment| SegmentPlace { segment, from: s.bone(segment).origin, to: s.bone(segment).end })
    });
    let said = |up: crate::space::Axis, how| Known::new(up.vector(), how);
    let up = options.scan_up.map(|up| said(up, Evidence::User));
    let up = up.or(scan.space.up.map(|up| said(up.value, up.how))).or(body.map(|b| Known::new(b.up, Evidence::Shape)));
    let decisions = Decisions {
        align: Align::None,
        on_skin: false,
        noun: "handle",
        reference_rest: false,
        reference_frame: table.first_frame,
        reference_range: (table.first_frame, table.first_frame + table.frames() as i64 - 1),
        reference_capture: None,
        scale: 1.0,
        yaw: 0.0,
        scan_unit: scan_unit(scan, body, options),
        scan_up: up,
        scan_forward: body.map(|b| Known::new(b.forward, Evidence::Shape)),
        scan_height: body.map(|b| b.stature * scan.unit_box.diagonal),
        capture_unit: None,
        capture_up: None,
        actor_height: None,
        set: None,
        named: 0,
        markers: 0,
        bound: 0,
        off_surface: None,
        residual: None,
        proportions: Vec::new(),
        strain: None,
    };
    Binding {
        placement: Similarity::IDENTITY,
        handles: Vec::new(),
        unbound: Vec::new(),
        segments: segments.collect(),
        trajectories: None,
        decisions,
        notes: Notes::default(),
    }
}

/// Adds the handles of a table to a capture and its binding. Frames are those of the capture's own numbering; a capture without markers
/// takes those of the table.
///
/// # Errors
/// [`Kind::Refused`] when a handle rests far from the scan or the frames do not meet; [`Kind::Usage`] when a handle has a marker's name.
pub fn add_handles(scan: &ScanShape<'_>, capture: &mut Capture, binding: &mut Binding, table: &HandleTable) -> Result<()> {
    let mut notes = Notes::default();
    let take = binding.trajectories.as_mut().unwrap_or_else(|| capture.motion.points_mut());
    if let Some(name) = table.names.iter().find(|name| take.labels.contains(name)) {
        return Err(Error::new(Kind::Usage, format!("handle {name} has the name of a marker"))
            .file(&table.source)
            .expected("names that the capture does not have"));
    }
    let (frames, first) = match take.frames() {
        0 => (table.frames(), table.first_frame),
        frames => (frames, capture.first_frame),
    };
    let (last, of_table) = (first + frames as i64 - 1, table.first_frame + table.frames() as i64 - 1);
    if table.first_frame > last || of_table < first {
        return Err(Error::refused(format!("frames {} to {of_table}: the capture has none of them", table.first_frame))
            .file(&table.source)
            .expected(format!("frames within {first}..{last}")));
    }
    if table.first_frame < first || of_table > last {
        notes.warn(format!(
            "{}: frames outside of the capture's {first}..{last} are not used",
            table.source.file_name().unwrap_or_default().to_string_lossy()
        ));
    }

    let old = take.labels.len();
    let mut far = Vec::new();
    let mut held = Vec::new();
    for (h, name) in table.names.iter().enumerate() {
        let Some((rest, turn)) = table.rest(h) else { continue };
        let attachment = scan.unit_box.enter(rest);
        let distance = scan.tree.closest(attachment).map_or(0.0, |c| c.distance);
        let outside = scan.tree.winding(attachment).abs() < 0.5;
        if outside && distance > ELSEWHERE {
            return Err(Error::refused(format!("handle {name} rests {distance:.1} diagonals away from the scan"))
                .file(&table.source)
                .expected("places in the scan's own coordinates and unit, at rest in the first frame")
                .hint("retarget inspect SCAN says where the scan lies"));
        }
        if outside && distance > LEVER {
            far.push(format!("{name} {:.0} %", 100.0 * distance));
        }
        let axes: &[(&str, DVec3)] = if table.oriented[h] { &AXIS_ENDS } else { &AXIS_ENDS[..1] };
        for &(ending, axis) in axes {
            held.push(Held { handle: h, axis, unturn: turn.inverse() });
            binding.handles.push(BoundMarker {
                label: format!("{name}{ending}"),
                marker: old + held.len() - 1,
                attachment: attachment + axis * AXES,
                segment: None,
                beta: if table.oriented[h] { TURNING } else { 1.0 },
            });
        }
    }
    if !far.is_empty() {
        notes.warn(format!("handles that rest far off the scan (of its diagonal): {}", far.join(", ")));
    }

    let mut points = Vec::with_capacity(frames * (old + held.len()));
    for frame in 0..frames {
        points.extend_from_slice(&take.points[frame * old..(frame + 1) * old]);
        let row = usize::try_from(first + frame as i64 - table.first_frame).ok().filter(|&row| row < table.frames());
        for h in &held {
            let place = row.map_or(DVec3::NAN, |row| {
                let cell = row * table.names.len() + h.handle;
                scan.unit_box.enter(table.points[cell]) + table.turns[cell] * (h.unturn * h.axis) * AXES
            });
            points.push(binding.placement.undo(place).to_array().map(|x| x as f32));
        }
    }
    take.points = points;
    take.labels.extend(binding.handles.iter().skip(binding.handles.len() - held.len()).map(|h| h.label.clone()));
    capture.first_frame = first;
    binding.notes.extend(notes);
    Ok(())
}

/// A point by which a handle holds the scan.
struct Held {
    /// Row of names in the table.
    handle: usize,
    /// From the handle at rest, in lengths of the axes.
    axis: DVec3,
    /// Undoes the orientation at rest.
    unturn: DQuat,
}

const AXIS_ENDS: [(&str, DVec3); 4] = [("", DVec3::ZERO), (" x", DVec3::X), (" y", DVec3::Y), (" z", DVec3::Z)];
