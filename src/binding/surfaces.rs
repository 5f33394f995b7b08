//! Vertices of a captured surface on a scan of the same thing: by their numbers where both have one connectivity, else where they lie.

use super::actor::quantile;
use super::bind::{Take, scan_unit, unit_factor};
use super::landmarks::Body;
use super::raw::{bind_found, lies_on, off_surface};
use super::reference::frame_index;
use super::similarity::{Similarity, rigid};
use super::{Align, Binding, BoundMarker, Decisions, Options, Reference, ScanShape, Turning};
use crate::capture::{Capture, VertexTake};
use crate::error::{Error, Notes, Result};
use crate::scan::SurfaceMesh;
use crate::space::{Evidence, Known};
use crate::spatial::PointTree;
use glam::{DQuat, DVec3};

/// Handles are thinned to this number.
const HANDLES: usize = 400;
/// Size of the scan against the capture that is taken for the same.
const SAME_SIZE: std::ops::RangeInclusive<f64> = 0.8..=1.25;
/// Logarithm of the size against a power of ten up to which only the unit differs.
const SAME_UNIT: f64 = 0.02;
/// Turn in degrees up to which the capture has the scan's axes.
const SAME_AXES: f64 = 45.0;
/// Frames looked at.
const SAMPLES: usize = 60;

/// Binds the vertices of a captured surface.
///
/// # Errors
/// A refusal where the scan has neither the capture's connectivity nor its place.
pub(super) fn bind(
    scan: &ScanShape<'_>,
    body: Option<&Body>,
    capture: &Capture,
    vertices: &VertexTake,
    reference: Option<&Capture>,
    options: &Options,
) -> Result<Binding> {
    let take = Take::of(capture, options);
    let mut binding = match scan.mesh.filter(|mesh| mesh.positions.len() == vertices.count && mesh.faces == vertices.faces) {
        Some(mesh) => by_number(scan, mesh, body, &take, vertices, options)?,
        None => {
            let found = lies_on(scan, &take, None, options).ok_or_else(|| {
                Error::refused(
                    "the captured surface is not that of the scan: it has other faces, and lies elsewhere in every frame",
                )
                .file(&capture.source)
                .expected("the scan's own mesh, or a surface that lies on the scan in some frame")
                .hint("--capture-unit or --scan-unit when only the unit differs; --align none binds what is near")
            })?;
            bind_found(scan, body, &take, found, options)?
        }
    };
    // The reader orders vertices so that the first of them are spread evenly.
    binding.handles.truncate(HANDLES);
    binding.decisions.bound = binding.handles.len();
    binding.unbound.clear();
    if reference.is_some() {
        binding.notes.warn("the reference capture is not used with a captured surface");
    }
    Ok(binding)
}

/// Every vertex of the capture is the scan's of the same number.
fn by_number(
    scan: &ScanShape<'_>,
    mesh: &SurfaceMesh,
    body: Option<&Body>,
    take: &Take<'_>,
    vertices: &VertexTake,
    options: &Options,
) -> Result<Binding> {
    let rest: Vec<DVec3> = vertices.vertices.iter().map(|&v| scan.unit_box.enter(mesh.positions[v as usize])).collect();
    let frames = match options.reference {
        Reference::Auto => take.track.sample(SAMPLES),
        Reference::Frame(number) => vec![frame_index(take.capture, &take.track, number)?],
    };
    let unit = options.capture_unit.map(|u| Known::new(u, Evidence::User)).or(take.capture.space.unit);
    let of_scan = scan_unit(scan, body, options);
    let said = unit_factor(unit, of_scan);
    let measured = size(&rest, take, frames[0]).unwrap_or(1.0) * scan.unit_box.diagonal;
    // Scan units per unit of the capture.
    let factor = match options.scale {
        Some(scale) => scale * said,
        None => {
            let power = 10f64.powf(measured.log10().round());
            let alike = |f: &f64| SAME_SIZE.contains(&(measured / f));
            let unit = ((measured / power).ln().abs() < SAME_UNIT).then_some(power);
            [said, 1.0].into_iter().find(alike).or(unit).unwrap_or(measured)
        }
    };
    let scale = factor / scan.unit_box.diagonal;

    let mut best: Option<(f64, usize, DQuat, DVec3)> = None;
    for &frame in &frames {
        let pairs: Vec<(DVec3, DVec3)> =
            rest.iter().enumerate().filter_map(|(i, &r)| Some((take.track.point(frame, i)? * scale, r))).collect();
        let Some((turn, shift)) = rigid(&pairs) else { continue };
        let squared: f64 = pairs.iter().map(|(a, b)| (turn * *a + shift - *b).length_squared()).sum();
        let rms = (squared / pairs.len() as f64).sqrt();
        if best.is_none_or(|(least, ..)| rms < least) {
            best = Some((rms, frame, turn, shift));
        }
    }
    let (_, frame, turn, shift) =
        best.ok_or_else(|| Error::refused("no frame shows three vertices").file(&take.capture.source))?;
    let own_axes = turn.angle_between(DQuat::IDENTITY).to_degrees() < SAME_AXES && factor != measured;
    let (rotation, translation) = if own_axes && options.align != Align::Similarity {
        (DQuat::IDENTITY, -scan.unit_box.centre / scan.unit_box.diagonal)
    } else {
        (turn, shift)
    };
    let mut notes = Notes::default();
    if factor != 1.0 && factor != said {
        notes.warn(format!("the scan is {factor:.3} times the size of the captured surface: the capture is scaled to it"));
    }
    let handles: Vec<BoundMarker> = rest
        .iter()
        .enumerate()
        .map(|(marker, &attachment)| BoundMarker {
            label: take.label(marker).to_owned(),
            marker,
            attachment,
            segment: None,
            beta: 1.0,
        })
        .collect();
    let decisions = Decisions {
        align: if own_axes { Align::None } else { Align::Similarity },
        noun: take.capture.motion.noun(),
        on_skin: false,
        reference_frame: take.capture.first_frame + frame as i64,
        reference_range: take.range(),
        reference_capture: None,
        reference_rest: false,
        scale: factor / said,
        yaw: 0.0,
        scan_unit: of_scan,
        scan_up: body.map(|b| Known::new(b.up, Evidence::Shape)),
        scan_forward: body.map(|b| Known::new(b.forward, Evidence::Shape)),
        scan_height: body.map(|b| b.stature * scan.unit_box.diagonal),
        capture_unit: unit,
        capture_up: take.capture.space.up,
        actor_height: None,
        set: Some("the scan's own vertices"),
        named: handles.len(),
        markers: vertices.count,
        bound: handles.len(),
        off_surface: off_surface(scan, &handles),
        residual: None,
        proportions: Vec::new(),
        strain: None,
        feet: None,
    };
    Ok(Binding {
        placement: Similarity { mirror: options.mirror, scale, rotation, translation },
        handles,
        unbound: Vec::new(),
        segments: Vec::new(),
        trajectories: None,
        turning: Turning::default(),
        decisions,
        frozen: None,
        notes,
    })
}

/// Unit-box lengths of the scan per unit of the capture: the median over distances between near vertices, which bends hardly change.
fn size(rest: &[DVec3], take: &Take<'_>, frame: usize) -> Option<f64> {
    let tree = PointTree::new(rest);
    let mut near = Vec::new();
    let mut ratios = Vec::new();
    for (i, &p) in rest.iter().enumerate() {
        tree.nearest(p, 4, &mut near);
        for n in near.iter().filter(|n| n.point != i && n.distance > 0.0) {
            if let (Some(a), Some(b)) = (take.track.point(frame, i), take.track.point(frame, n.point))
                && a != b
            {
                ratios.push(n.distance / (a - b).length());
            }
        }
    }
    quantile(&mut ratios, 0.5)
}
