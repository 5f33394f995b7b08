//! Vertices of a captured surface on a scan of about its shape: by their numbers where both have one connectivity, else where they lie,
//! as they are or once the shapes are brought together.

use super::landmarks::Body;
use super::raw::{Found, bind_as_it_is, bind_found, lies_on, off_surface};
use super::reference::frame_index;
use super::registration::{Given, Registration, Target};
use super::shape::{scan_unit, unit_factor};
use super::similarity::{Held, Similarity, rigid, turn_between};
use super::take::Take;
use super::{Align, Binding, BoundMarker, Decisions, Options, Reference, ScanShape, Turning, refuse};
use crate::capture::{Capture, VertexTake};
use crate::error::{Error, Kind, Notes, Result};
use crate::scan::SurfaceMesh;
use crate::space::{Evidence, Known};
use crate::spatial::PointTree;
use crate::statistics::quantile;
use crate::words;
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
/// A vertex farther off the scan than this, in diagonals, holds nothing; the share of such vertices that is not worth a word.
const NEAR: f64 = 0.025;
const FEW: f64 = 0.02;
/// Distance of surfaces that were brought together, in diagonals: worth a word beyond the first, refused beyond the second. Measured on
/// bodies: 0.8 % or less for another build in the same pose, 2.1 % for a robot, 3.6 % for an armadillo.
const FITS: (f64, f64) = (0.01, 0.015);
/// The next best turn must be so many times as far off.
const RIVAL: f64 = 1.3;
/// A placement that is not upright must be nearer than an upright one by this factor.
const LYING: f64 = 0.7;

/// Binds the vertices of a captured surface.
///
/// # Errors
/// A refusal where the scan has neither the capture's connectivity nor about its shape.
pub(super) fn bind(
    scan: &ScanShape<'_>,
    body: Option<&Body>,
    capture: &Capture,
    vertices: &VertexTake,
    reference: Option<&Capture>,
    options: &Options,
) -> Result<Binding> {
    let take = Take::of(capture, options);
    let same = scan.mesh.filter(|mesh| mesh.positions.len() == vertices.count && mesh.faces == vertices.faces);
    let mut binding = match same {
        _ if options.align == Align::None => bind_as_it_is(scan, body, &take, options)?,
        Some(mesh) => by_number(scan, mesh, body, &take, vertices, options)?,
        None => match as_it_lies(scan, &take, options) {
            Some(found) => bind_found(scan, body, &take, found, options)?,
            None => by_shape(scan, body, &take, options)?,
        },
    };
    let near = |h: &BoundMarker| scan.tree.closest_within(h.attachment, NEAR).is_some();
    let all = binding.handles.len();
    binding.handles.retain(near);
    let far = all - binding.handles.len();
    if far as f64 > FEW * all as f64 {
        binding.notes.warn(format!(
            "{far} of {} are farther than {:.1} % of the diagonal from the scan in the reference frame: they hold nothing",
            words::plural(all, capture.motion.noun()),
            100.0 * NEAR
        ));
    }
    if binding.handles.is_empty() {
        return Err(Error::refused("no vertex of the captured surface is near the scan in the reference frame")
            .file(&capture.source)
            .hint("--ref N with a frame in which both stand alike"));
    }
    // The reader orders vertices so that the first of them are spread evenly.
    binding.handles.truncate(HANDLES);
    binding.decisions.bound = binding.handles.len();
    binding.decisions.off_surface = off_surface(scan, &binding.handles);
    binding.unbound.clear();
    if reference.is_some() {
        binding.notes.warn("the reference capture is not used with a captured surface");
    }
    Ok(binding)
}

/// A frame in which the surface lies on the scan with nothing but the unit converted, if nothing else is asked for.
fn as_it_lies(scan: &ScanShape<'_>, take: &Take<'_>, options: &Options) -> Option<Found> {
    let moved = options.align == Align::Similarity || options.yaw.is_some() || options.scale.is_some() || options.flip;
    let turned = options.capture_up.is_some() || options.reference != Reference::Auto;
    if moved || turned { None } else { lies_on(scan, take, None, options) }
}

/// The surfaces are brought together by their shapes, and every vertex holds what it is near to then.
fn by_shape(scan: &ScanShape<'_>, body: Option<&Body>, take: &Take<'_>, options: &Options) -> Result<Binding> {
    let mut notes = Notes::default();
    let file = &take.capture.source;
    let frames = match options.reference {
        Reference::Auto => take.track.sample(SAMPLES),
        Reference::Frame(number) => vec![frame_index(take.capture, &take.track, number)?],
    };
    let Some(mesh) = scan.mesh else { return Err(Error::refused("the scan has no faces to fit a surface to").file(file)) };
    let unit = options.capture_unit.map(|u| Known::new(u, Evidence::User)).or(take.capture.space.unit);
    let of_scan = scan_unit(scan, body, options);
    let said = unit_factor(unit, of_scan);
    let capture_up = options.capture_up.map(|up| Known::new(up, Evidence::User)).or(take.capture.space.up);
    let scan_up = match (options.scan_up, scan.space.up, body) {
        (Some(up), ..) => Some(Known::new(up.vector(), Evidence::User)),
        (_, _, Some(body)) => Some(Known::new(body.up, Evidence::Shape)),
        (_, up, None) => up.map(|up| Known::new(up.value.vector(), up.how)),
    };
    let ups = capture_up.zip(scan_up).map(|(a, b)| (a.value.vector(), b.value));
    let yaw = options.yaw.map(f64::to_radians);
    let held = Held { yaw: yaw.filter(|_| ups.is_some()), scale: options.scale.map(|s| s * said / scan.unit_box.diagonal) };
    if yaw.is_some() && ups.is_none() {
        notes.warn("--yaw is not used where it is not known what is up (--capture-up and --scan-up say it)");
    }

    let target = Target::new(mesh, scan.tree, scan.unit_box);
    let mut given = Given { ups, held };
    let mut found = target.register(&take.track, &frames, &given);
    let by_user = options.capture_up.is_some() || options.scan_up.is_some() || options.yaw.is_some();
    if ups.is_some() && !by_user && found.is_none_or(|f| f.residual > FITS.0) {
        let free = Given { ups: None, held };
        let tumbled = target.register(&take.track, &frames, &free);
        if let Some(other) = tumbled.filter(|t| found.is_none_or(|f| t.residual < LYING * f.residual)) {
            notes.warn("the captured surface fits the scan only if it is not upright: what is up is not believed (--capture-up and --scan-up say it)");
            (given, found) = (free, Some(other));
        }
    }
    let found = found.ok_or_else(|| Error::refused("no frame shows four vertices in different places").file(file))?;
    let turned = |(from, up): (DVec3, DVec3)| {
        let about = found.placement.rotation * turn_between(from, up).inverse();
        let angle = 2.0 * DVec3::new(about.x, about.y, about.z).dot(up).atan2(about.w).to_degrees();
        (angle + 180.0).rem_euclid(360.0) - 180.0
    };
    let yaw = given.ups.map(turned);
    check(&found, yaw, options, &mut notes).map_err(|e| e.file(file))?;

    let place = |marker: usize| Some((marker, found.placement.apply(take.track.point(found.frame, marker)?)));
    let handles: Vec<BoundMarker> = (0..take.track.take.markers())
        .filter_map(place)
        .map(|(marker, attachment)| point_of_surface(take, marker, attachment))
        .collect();
    let mut decisions = decisions(scan, body, take, options, found.frame);
    decisions.align = Align::Similarity;
    decisions.yaw = yaw.unwrap_or(0.0);
    decisions.scale = found.placement.scale * scan.unit_box.diagonal / said;
    Ok(binding(Similarity { mirror: options.mirror, ..found.placement }, handles, decisions, notes))
}

/// Refuses a placement that the shapes do not speak for.
fn check(found: &Registration, yaw: Option<f64>, options: &Options, notes: &mut Notes) -> Result<()> {
    let percent = 100.0 * found.residual;
    if found.residual > FITS.1 {
        let found = format!(
            "the captured surface is not that of the scan: brought together they are {percent:.1} % of the diagonal apart"
        );
        let most = 100.0 * FITS.1;
        let error = Error::refused(found)
            .expected(format!("at most {most:.1} %: a surface of about the scan's shape, which stands like it in some frame"))
            .hint("--ref N with a frame in which both stand alike, --yaw DEGREES with --capture-up and --scan-up, --align none where they meet");
        return refuse(error, options, notes);
    }
    if let Some((angle, times)) = found.rival.filter(|r| r.1 < RIVAL && options.yaw.is_none()) {
        let error = Error::new(
            Kind::Ambiguous,
            format!("the captured surface fits the scan two ways: turned by {angle:.0}° it is only {times:.2} times as far off"),
        )
        .expected(format!("{RIVAL} times as far or more"))
        .hint(match yaw {
            Some(yaw) => format!("--yaw DEGREES, the turn of the capture about the scan's up axis (nearest is {yaw:.0})"),
            None => "--capture-up and --scan-up, which say what is up, with --yaw DEGREES".to_owned(),
        });
        refuse(error, options, notes)?;
    }
    if found.residual > FITS.0 {
        notes.warn(format!("the captured surface is {percent:.1} % of the diagonal off the scan: it has another shape or pose"));
    }
    Ok(())
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
    let handles: Vec<BoundMarker> =
        rest.iter().enumerate().map(|(marker, &attachment)| point_of_surface(take, marker, attachment)).collect();
    let mut decisions = decisions(scan, body, take, options, frame);
    decisions.align = if own_axes && options.align != Align::Similarity { Align::None } else { Align::Similarity };
    decisions.scale = factor / said;
    decisions.set = Some("the scan's own vertices");
    decisions.named = handles.len();
    decisions.markers = vertices.count;
    Ok(binding(Similarity { mirror: options.mirror, scale, rotation, translation }, handles, decisions, notes))
}

fn binding(placement: Similarity, handles: Vec<BoundMarker>, decisions: Decisions, notes: Notes) -> Binding {
    Binding {
        placement,
        handles,
        unbound: Vec::new(),
        segments: Vec::new(),
        trajectories: None,
        turning: Turning::default(),
        decisions,
        frozen: None,
        notes,
    }
}

/// A point of the surface that holds the scan at a place.
fn point_of_surface(take: &Take<'_>, marker: usize, attachment: DVec3) -> BoundMarker {
    BoundMarker { label: take.label(marker).to_owned(), marker, attachment, segment: None, beta: 1.0 }
}

/// What is decided in any case, for a placement in a frame.
fn decisions(scan: &ScanShape<'_>, body: Option<&Body>, take: &Take<'_>, options: &Options, frame: usize) -> Decisions {
    Decisions {
        align: Align::None,
        noun: take.capture.motion.noun(),
        on_skin: false,
        reference_frame: take.capture.first_frame + frame as i64,
        reference_range: take.range(),
        reference_capture: None,
        reference_rest: false,
        scale: 1.0,
        yaw: 0.0,
        scan_unit: scan_unit(scan, body, options),
        scan_up: body.map(|b| Known::new(b.up, Evidence::Shape)),
        scan_forward: body.map(|b| Known::new(b.forward, Evidence::Shape)),
        scan_height: body.map(|b| b.stature * scan.unit_box.diagonal),
        capture_unit: options.capture_unit.map(|u| Known::new(u, Evidence::User)).or(take.capture.space.unit),
        capture_up: take.capture.space.up,
        actor_height: None,
        set: None,
        named: 0,
        markers: take.track.take.markers(),
        bound: 0,
        off_surface: None,
        residual: None,
        proportions: Vec::new(),
        strain: None,
        feet: None,
    }
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
