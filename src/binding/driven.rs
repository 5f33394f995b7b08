//! Handles from a table: they rest where they are in their first frame, and go where the table says.
//!
//! A handle without an orientation is a point like a marker. One with an orientation, or one that holds a part of the scan, moves and turns what it
//! holds; see [`crate::pipeline::grips`].

use super::landmarks::Body;
use super::segments::Skeleton;
use super::select::Hold;
use super::shape::scan_unit;
use super::similarity::Similarity;
use super::{Align, Binding, BoundMarker, Decisions, Options, ScanShape, Segment, SegmentPlace};
use crate::capture::Capture;
use crate::capture::handles_csv::HandleTable;
use crate::capture::resample::Sampling;
use crate::error::{Error, Kind, Notes, Result};
use crate::space::{Evidence, Known};
use glam::{DQuat, DVec3};

/// Distance off the scan at rest, in diagonals, beyond which the table is not in the scan's space.
const ELSEWHERE: f64 = 0.5;
/// The same beyond which a handle moves the scan like a long lever.
const LEVER: f64 = 0.1;
/// A handle that moves and turns what it holds.
#[derive(Clone, Debug, PartialEq)]
pub struct TurningHandle {
    /// Its name.
    pub name: String,
    /// Where it is at rest, in the unit box.
    pub rest: DVec3,
}

/// Where a handle is in a frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Place {
    /// In the unit box.
    pub position: DVec3,
    /// From rest.
    pub turn: DQuat,
}

/// Handles that turn, and where they are in every frame.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Turning {
    /// The handles.
    pub handles: Vec<TurningHandle>,
    /// Frame-major places, `frames × handles`; `None` where a handle is missing.
    pub places: Vec<Option<Place>>,
}

impl Turning {
    /// Number of frames.
    pub fn frames(&self) -> usize {
        self.places.len() / self.handles.len().max(1)
    }

    /// Places of all handles in one frame.
    pub fn frame(&self, frame: usize) -> &[Option<Place>] {
        &self.places[frame * self.handles.len()..(frame + 1) * self.handles.len()]
    }

    /// Brings the places to other frames.
    pub(super) fn resample(&mut self, sampling: &Sampling) {
        let count = self.handles.len();
        let old = |frame: usize, handle: usize| self.places.get(frame * count + handle).copied().flatten();
        let new = (0..sampling.frames()).flat_map(|frame| (0..count).map(move |handle| (frame, handle)));
        let places = new.map(|(frame, handle)| {
            let position = sampling.point(frame, |f| old(f, handle).map(|p| p.position))?;
            Some(Place { position, turn: sampling.turn(frame, |f| old(f, handle).map(|p| p.turn))? })
        });
        self.places = places.collect();
    }

    /// Adds handles with their places in as many frames, one handle after the other.
    fn add(&mut self, handles: Vec<TurningHandle>, places: &[Option<Place>], frames: usize) {
        let (old, new) = (self.handles.len(), handles.len());
        let mut all = Vec::with_capacity(frames * (old + new));
        for frame in 0..frames {
            all.extend_from_slice(&self.places[frame * old..(frame + 1) * old]);
            all.extend((0..new).map(|h| places[h * frames + frame]));
        }
        self.places = all;
        self.handles.extend(handles);
    }
}

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
        feet: None,
    };
    Binding {
        placement: Similarity::IDENTITY,
        handles: Vec::new(),
        unbound: Vec::new(),
        segments: segments.collect(),
        trajectories: None,
        turning: Turning::default(),
        decisions,
        frozen: None,
        notes: Notes::default(),
    }
}

/// Adds the handles of a table to a capture and its binding; those that `holds` names hold a part of the scan. Frames are those of the capture's own
/// numbering; a capture without markers takes those of the table.
///
/// # Errors
/// [`Kind::Refused`] when a handle rests far from the scan or the frames do not meet; [`Kind::Usage`] when a handle has the name of a marker or of
/// another handle.
pub fn add_handles(
    scan: &ScanShape<'_>,
    capture: &mut Capture,
    binding: &mut Binding,
    table: &HandleTable,
    holds: &[Hold],
) -> Result<()> {
    let mut notes = Notes::default();
    let noun = capture.motion.noun();
    let take = binding.trajectories.as_mut().unwrap_or_else(|| capture.motion.points_mut());
    let known = |name: &str| binding.handles.iter().any(|h| h.known_as() == name);
    let twice =
        |name: &&String| take.labels.contains(name) || known(name) || binding.turning.handles.iter().any(|h| h.name == **name);
    if let Some(name) = table.names.iter().find(twice) {
        return Err(Error::new(Kind::Usage, format!("handle {name} has the name of a {noun} or of another handle"))
            .file(&table.source)
            .expected("names that the capture does not have"));
    }
    let (frames, first) = match take.frames().max(binding.turning.frames()) {
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
    // Place and orientation in a frame of the capture, `None` where it is missing.
    let cell = |frame: usize, h: usize| -> Option<(DVec3, DQuat)> {
        let row = usize::try_from(first + frame as i64 - table.first_frame).ok().filter(|&row| row < table.frames())?;
        let cell = row * table.names.len() + h;
        table.points[cell].is_finite().then(|| (scan.unit_box.enter(table.points[cell]), table.turns[cell]))
    };

    let old = take.labels.len();
    let mut far = Vec::new();
    let mut points = Vec::new();
    let (mut turning, mut places) = (Vec::new(), Vec::new());
    for (h, name) in table.names.iter().enumerate() {
        let Some((rest, turn)) = table.rest(h) else { continue };
        let rest = scan.unit_box.enter(rest);
        let holds_part = holds.iter().any(|hold| hold.handle == *name);
        let distance = scan.tree.closest(rest).map_or(0.0, |c| c.distance);
        let outside = scan.tree.winding(rest).abs() < 0.5;
        if outside && distance > ELSEWHERE {
            return Err(Error::refused(format!("handle {name} rests {distance:.1} diagonals away from the scan"))
                .file(&table.source)
                .expected("places in the scan's own coordinates and unit, at rest in the first frame")
                .hint("retarget inspect SCAN says where the scan lies"));
        }
        if outside && distance > LEVER && !holds_part {
            far.push(format!("{name} {:.0} %", 100.0 * distance));
        }
        if holds_part || table.oriented[h] {
            let unturn = turn.inverse();
            places.extend(
                (0..frames)
                    .map(|frame| cell(frame, h).map(|(position, turn)| Place { position, turn: (turn * unturn).normalize() })),
            );
            turning.push(TurningHandle { name: name.clone(), rest });
        } else {
            binding.handles.push(BoundMarker {
                label: name.clone(),
                marker: old + points.len(),
                attachment: rest,
                segment: None,
                beta: 1.0,
            });
            points.push(h);
        }
    }
    if !far.is_empty() {
        notes.warn(format!("handles that rest far off the scan (of its diagonal): {}", far.join(", ")));
    }

    let mut all = Vec::with_capacity(frames * (old + points.len()));
    for frame in 0..frames {
        all.extend_from_slice(&take.points[frame * old..(frame + 1) * old]);
        all.extend(points.iter().map(|&h| {
            let place = cell(frame, h).map_or(DVec3::NAN, |(position, _)| position);
            take.stored(binding.placement.undo(place))
        }));
    }
    take.points = all;
    take.labels.extend(points.iter().map(|&h| table.names[h].clone()));
    binding.turning.add(turning, &places, frames);
    capture.first_frame = first;
    binding.notes.extend(notes);
    Ok(())
}
