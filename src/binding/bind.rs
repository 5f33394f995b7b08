//! The binding of a capture to a scan, from labels to attachment points.

mod attach;

use attach::Kept;

use super::actor::{self, Actor};
use super::fit::{self, Fit, Observation, SIZE};
use super::labels::{self, Names, Part};
use super::landmarks::{Arms, Body, NotHuman};
use super::reference::{self, Chosen, Landed};
use super::retarget::{self, Retargeting, Seen};
use super::rig::Frozen;
use super::segments::{self, Segment, Side, Skeleton};
use super::shape::{outside, scan_unit, segment_places, unit_factor};
use super::similarity::{Held, Similarity, upright};
use super::take::Take;
use super::{
    Align, Binding, BoundMarker, Decisions, Options, Reference, ScanShape, Turning, Watch, checks, clusters, pinned, places, raw,
    refuse, skeletons, skin, surfaces, unlabelled,
};
use crate::capture::{Capture, Motion};
use crate::error::{Error, Kind, Notes, Result};
use crate::space::{Evidence, Known};
use crate::statistics::quantile;
use glam::DVec3;

/// Root mean square of a similarity, in statures, below which actor and scan are alike in shape and pose.
const ALIKE: f64 = 0.015;
/// Frames nearest to the scan's pose that are tried on the skin.
const NEAREST: usize = 8;
/// The same beyond which the reference frame is not the scan's pose in any way.
const FAR_POSE: f64 = 0.15;
/// The same beyond which the pose is worth a word.
const OTHER_POSE: f64 = 0.05;
/// Median and 90th percentile of the fit's residuals, in statures: fine up to the first pair, refused beyond the second.
const GOOD: (f64, f64) = (0.025, 0.06);
const BEARABLE: (f64, f64) = (0.04, 0.09);
/// Residual of one marker, in statures, from which it is doubtful.
const DOUBTFUL: f64 = 0.06;
/// How far a marker may leave its segment (95th percentile, in statures) before it is doubtful.
const LEAVES: f64 = 0.03;
/// Weight of landmarks on arms that touch the trunk: their joints err by up to 4 % of height, those of arms apart by 1 %.
const HANGING: f64 = 0.3;
/// Hardness of a doubtful handle.
const SOFT: f64 = 0.1;
/// An unnamed marker that moves more than this against every segment, in statures, is not on the body.
const PROP: f64 = 0.02;
/// One that moves more than this against its own pulls softly: a backrest moves nearly as the one does who leans on it.
const NEARLY_PROP: f64 = 0.5 * PROP;
/// Frames that it takes to tell with which segment an unnamed marker moves.
const LEAST_MOTION: usize = 10;
/// Frames that the whole-take measures look at.
const SAMPLES: usize = 60;
/// Distances along bones that differ by more than this are worth a word (95th percentile).
const STRETCH: f64 = 0.25;
/// Length ratios of actor and scan farther from 1 than this are worth a word where targets keep the actor's lengths.
const OTHER_BUILD: f64 = 0.10;
/// Within so much of each other are the lengths of an actor and of his own scan, and so near to 1 is their size: of six made bodies, seven of
/// eight pairs of one body in two poses pass, and one of 22 pairs of different bodies.
const OWN_LENGTHS: f64 = 0.04;
const OWN_SIZE: f64 = 0.03;
/// Weight of a marker for the pose of its segment where the dictionary does not name it, or where it is doubtful.
const UNNAMED: f64 = 0.5;
const DOUBTED: f64 = 0.3;

/// Binds a capture to a scan.
///
/// `body` is the scan as [`super::landmarks::find`] sees it. `reference` is a second capture of the same actor with the same labels, in
/// which the reference frame is looked for. `watch`: retargeted marker takes are posed frame by frame from the reference frame on, before
/// the first frame is written.
///
/// Errors: refusals that name the deciding option (`Refused`, `Ambiguous`); a reference frame outside the capture (`Usage`); those of
/// `watch`.
pub fn bind(
    scan: &ScanShape<'_>,
    body: Result<Body, NotHuman>,
    capture: &Capture,
    reference: Option<&Capture>,
    options: &Options,
    watch: Watch<'_>,
) -> Result<Binding> {
    if let Some(frozen) = &options.frozen {
        let options = &Options { mirror: frozen.mirror(), swap_sides: frozen.swap_sides(), ..options.clone() };
        let take = Take::of(capture, options);
        return match (&capture.motion, frozen.joints()) {
            (Motion::Markers(_), None) => frozen.bind(scan, &take, options, watch),
            (Motion::Skeleton(joints), Some(kept)) => skeletons::bind_again(scan, capture, joints, frozen, kept, options),
            _ => Err(Error::refused("the rig file's [frozen] is of another kind of capture".to_owned())
                .file(&capture.source)
                .hint("a rig file without [frozen]")),
        };
    }
    let mut take = Take::of(capture, options);
    if take.track.take.frames() == 0 {
        return Err(Error::refused("there is no marker to bind").file(&capture.source));
    }
    if let Motion::Skeleton(joints) = &capture.motion
        && let Some(bound) = skeletons::bind_own(scan, body.as_ref().ok(), capture, joints, reference, options)
    {
        return bound;
    }
    if let Motion::Vertices(vertices) = &capture.motion {
        return surfaces::bind(scan, body.as_ref().ok(), capture, vertices, reference, options);
    }
    if options.align == Align::None {
        let mut binding = raw::bind_as_it_is(scan, body.as_ref().ok(), &take, options)?;
        if reference.is_some() {
            binding.notes.warn("the reference capture is not used with --align none");
        }
        return Ok(binding);
    }
    let body = match body {
        Ok(body) => oriented(body, options),
        Err(reason) => {
            if options.align == Align::Auto
                && options.reference == Reference::Auto
                && !matches!(capture.motion, Motion::Skeleton(_))
                && let Some(found) = raw::lies_on(scan, &take, None, options)
            {
                return raw::bind_found(scan, None, &take, found, options);
            }
            if matches!(options.align, Align::Auto | Align::Similarity)
                && let Some(bound) = pinned::bind(scan, &take, options)
            {
                return bound;
            }
            return Err(checks::no_body(&reason));
        }
    };
    if let Motion::Skeleton(joints) = &capture.motion {
        let mut notes = Notes::default();
        checks::body(&body, options, &mut notes)?;
        return skeletons::bind(scan, &body, capture, joints, reference, options, notes);
    }
    let skeleton = Skeleton::of(&body);
    take.correct(options, Some(&skeleton));
    take.exchange_sides(options);
    if !checks::are_told(&take) && matches!(capture.motion, Motion::Markers(_)) {
        match tell(scan, &skeleton, &take, options) {
            Ok((names, remark)) => {
                take.names = names;
                take.remarks.push(remark);
                take.correct(options, Some(&skeleton));
            }
            // What lies on the scan needs no names.
            Err(error) => {
                if options.align == Align::Auto
                    && options.reference == Reference::Auto
                    && reference.is_none()
                    && let Some(found) = raw::lies_on(scan, &take, Some(&skeleton), options)
                {
                    return raw::bind_found(scan, Some(&body), &take, found, options);
                }
                return Err(error);
            }
        }
    }
    if options.align == Align::Auto
        && options.reference == Reference::Auto
        && reference.is_none()
        && options.yaw.is_none()
        && options.scale.is_none()
        && let Some(found) = raw::lies_on(scan, &take, Some(&skeleton), options)
    {
        return raw::bind_found(scan, Some(&body), &take, found, options);
    }
    Human { scan, body: &body, skeleton: &skeleton, take: &take, options, watch }.bind(reference)
}

/// Names of markers whose labels say nothing, and how they were told.
fn tell(scan: &ScanShape<'_>, body: &Skeleton, take: &Take<'_>, options: &Options) -> Result<(Names, String)> {
    let known = options.capture_up.or(take.capture.space.up.map(|up| up.value));
    let Some(up) = known else {
        return Err(checks::few_labels(take, "the file does not say which way is up, so their places do not tell either")
            .hint("--capture-up +Z (or the axis that points up); or names in [markers] of a rig file"));
    };
    let hint = "names for them in [markers] of a rig file, or --align none when the scan is where the capture's markers are";
    match unlabelled::tell(take, body, scan.tree, up.vector()) {
        Ok((names, ratio)) => {
            let count = names.count();
            let markers = take.track.take.markers();
            let remark = format!(
                "labels say too little: {count} of {markers} markers told by their places on the body (the other way round fits {ratio:.1} times worse); \
                 check the picture"
            );
            Ok((names, remark))
        }
        Err(untold) => Err(checks::few_labels(take, &untold.0).hint(hint)),
    }
}

fn oriented(body: Body, options: &Options) -> Body {
    let mut body = if options.flip { segments::turned(&body) } else { body };
    if let Some(axis) = options.scan_up {
        body.up = axis.vector();
        let level = body.forward - body.up * body.forward.dot(body.up);
        body.forward = level.try_normalize().unwrap_or_else(|| body.up.any_orthonormal_vector());
    }
    body
}

struct Human<'a> {
    scan: &'a ScanShape<'a>,
    body: &'a Body,
    skeleton: &'a Skeleton,
    take: &'a Take<'a>,
    options: &'a Options,
    watch: Watch<'a>,
}

impl Human<'_> {
    fn bind(&self, reference: Option<&Capture>) -> Result<Binding> {
        let options = self.options;
        let mut notes = Notes::default();
        checks::body(self.body, options, &mut notes)?;
        self.take.remarks.iter().for_each(|remark| notes.warn(remark.clone()));
        let actor = actor::read(&self.take.track, &self.take.names, &self.take.capture.space, options, &mut notes)
            .map_err(|e| e.file(&self.take.capture.source))?;
        self.check_sides(&actor, &mut notes)?;
        let unit = scan_unit(self.scan, Some(self.body), options);
        let factor = unit_factor(actor.unit, unit);
        let held = Held {
            yaw: options.yaw.map(f64::to_radians),
            scale: options.scale.map(|s| s * factor / self.scan.unit_box.diagonal),
        };

        // The pose is read in the reference capture, the motion in the take.
        let still = reference.map(|capture| {
            let mut still = Take::of(capture, options);
            still.correct(options, Some(self.skeleton));
            still.exchange_sides(options);
            still.remarks.iter().for_each(|remark| notes.warn(format!("in the reference capture {remark}")));
            still
        });
        let posed = still.as_ref().unwrap_or(self.take);
        if still.is_some() {
            checks::labels(posed)?;
            checks::same_actor(self.take, posed)?;
        }
        let still_actor = match &still {
            Some(still) => actor::read(&still.track, &still.names, &still.capture.space, options, &mut Notes::default())
                .map_err(|e| e.file(&still.capture.source))?,
            None => actor.clone(),
        };
        let landed = self.landed(posed);
        let pose_held = Held { yaw: if still.is_some() { None } else { held.yaw }, ..held };
        let candidates = reference::candidates(
            posed.capture,
            &posed.track,
            still_actor.up.value.vector(),
            self.skeleton,
            &landed,
            pose_held,
            options,
        )?;
        let own = (matches!(options.align, Align::Auto | Align::Similarity) && pose_held == Held::default())
            .then(|| self.own_pose(posed, &candidates, &landed))
            .flatten();
        let chosen = own.unwrap_or(candidates[0]);
        let fit = self.fit(posed, &landed, &chosen);
        let mut fit = Fitted { fit, landed: &landed, chosen: &chosen };
        if let Some(scale) = held.scale {
            fit.fit.resize(chosen.upright.placement.scale / scale);
        }
        let size = chosen.upright.placement.scale / fit.fit.size * self.scan.unit_box.diagonal / factor;
        let own_body =
            (size - 1.0).abs() < OWN_SIZE && SIZE.iter().all(|&(r, _)| (fit.fit.ratios[r as usize] - 1.0).abs() < OWN_LENGTHS);
        let align = match options.align {
            Align::Auto if own.is_some() || chosen.rms < ALIKE => Align::Similarity,
            Align::Auto if own_body => Align::Pose,
            Align::Auto => Align::Retarget,
            chosen => chosen,
        };
        self.warn_of_pose(&fit, still.is_some(), &mut notes);
        self.check_fit(posed, &fit, &mut notes)?;
        if !self
            .take
            .names
            .iter()
            .any(|(_, p)| p.segment() == Segment::Head || p.segment() == Segment::Trunk || p.segment().is_arm())
        {
            notes.warn("no upper-body markers: the upper body moves with the pelvis");
        }
        if !self.take.names.iter().any(|(_, p)| p.segment().is_leg()) {
            notes.warn(
                "no markers on the legs: they hang from the pelvis as they do in the scan, whether the actor stands or sits",
            );
        }
        let (mut binding, kept) = self.attach(posed, still.is_some(), &actor, &fit, align, held, factor, notes)?;
        let diagonal = self.scan.unit_box.diagonal;
        let d = &mut binding.decisions;
        d.on_skin = own.is_some() && align == Align::Similarity;
        d.scan_unit = unit;
        d.scan_up = Some(Known::new(self.body.up, if options.scan_up.is_some() { Evidence::User } else { Evidence::Shape }));
        d.scan_forward = Some(Known::new(self.body.forward, if options.flip { Evidence::User } else { Evidence::Shape }));
        d.scan_height = Some(self.body.stature * diagonal);
        let retargeted = (align == Align::Retarget).then(|| self.retargeting(&fit.fit, &kept));
        let retargeted = retargeted.as_ref().map(|r| (r, kept.seen.as_slice()));
        binding.frozen = Some(Frozen::of(&binding, self.take, Some(self.body), kept.start, retargeted, options));
        Ok(binding)
    }

    fn retargeting<'a>(&'a self, fit: &'a Fit, kept: &Kept) -> Retargeting<'a> {
        Retargeting {
            body: self.skeleton,
            fit,
            clavicles: kept.clavicles,
            placement: kept.placement,
            start: kept.start,
            feet: self.options.feet(self.take.capture),
        }
    }

    /// A frame in which the actor stands as he was scanned, placed by the skin: among the nearest in pose, the first and the last.
    fn own_pose(&self, posed: &Take<'_>, candidates: &[Chosen], landed: &[Landed]) -> Option<Chosen> {
        let ends = [candidates.iter().map(|c| c.frame).min(), candidates.iter().map(|c| c.frame).max()];
        let tried: Vec<Chosen> = candidates
            .iter()
            .enumerate()
            .filter(|(rank, c)| *rank < NEAREST || ends.contains(&Some(c.frame)))
            .map(|(_, c)| *c)
            .collect();
        skin::settle(&posed.track, landed, self.skeleton, self.scan.tree, &tried)
    }

    fn check_sides(&self, actor: &Actor, notes: &mut Notes) -> Result<()> {
        let file = &self.take.capture.source;
        match actor.sides {
            Some(sides) if sides < -0.3 => {
                let error = Error::new(
                    Kind::Ambiguous,
                    format!(
                        "left and right of the labels disagree with up and facing ({sides:+.2}): mirrored axes or swapped labels"
                    ),
                )
                .file(file)
                .expected("+0.3 or more")
                .hint("--mirror when the capture's axes are mirrored, --swap-sides when its labels are");
                refuse(error, self.options, notes)
            }
            Some(sides) if sides < 0.3 && self.options.yaw.is_none() => {
                let error = Error::new(Kind::Ambiguous, format!("the actor's facing is unclear ({sides:+.2})"))
                    .file(file)
                    .expected("+0.3 or more")
                    .hint("--yaw DEGREES, the turn of the capture about the scan's up axis");
                refuse(error, self.options, notes)
            }
            _ => Ok(()),
        }
    }

    fn landed(&self, take: &Take<'_>) -> Vec<Landed> {
        let arms = if self.body.arms == Arms::Hanging { HANGING } else { 1.0 };
        take.names
            .iter()
            .map(|(marker, place)| Landed {
                marker,
                place: places::on_skin(place, self.skeleton, self.scan.tree),
                weight: if place.segment().is_arm() { place.weight * arms } else { place.weight },
            })
            .collect()
    }

    /// Says how the actor's nearest pose differs from the scan's, where it does.
    fn warn_of_pose(&self, fitted: &Fitted<'_>, apart: bool, notes: &mut Notes) {
        let rms = fitted.chosen.rms;
        if rms <= OTHER_POSE {
            return;
        }
        let bent: Vec<String> = fitted
            .fit
            .bends(self.skeleton)
            .into_iter()
            .map(|(segment, angle)| format!("{} {angle:.0}°", segment.name()))
            .collect();
        let bent = if bent.is_empty() { String::new() } else { format!("; against the scan: {}", bent.join(", ")) };
        let what = if self.options.reference == Reference::Auto { "nearest frame" } else { "reference frame" };
        let source = if apart { "the reference capture" } else { "the take" };
        let twist = if rms > FAR_POSE { ", wrists may be twisted" } else { "" };
        let hint = if apart { "" } else { "; --ref-file takes a static trial of the same markers" };
        notes.warn(format!(
            "{source} never shows the scan's pose ({what} {:.1} % of height away{bent}): attachment points go through the fitted pose{twist}{hint}",
            100.0 * rms
        ));
    }

    fn fit(&self, posed: &Take<'_>, landed: &[Landed], chosen: &Chosen) -> Fit {
        let observations: Vec<Observation> = landed
            .iter()
            .filter_map(|l| {
                let place = posed.names.places[l.marker].as_ref()?;
                Some(Observation {
                    marker: chosen.upright.placement.apply(posed.track.point(chosen.frame, l.marker)?),
                    place: l.place,
                    segment: place.segment(),
                    weight: l.weight,
                })
            })
            .collect();
        fit::fit(self.skeleton, &observations)
    }

    fn check_fit(&self, posed: &Take<'_>, fitted: &Fitted<'_>, notes: &mut Notes) -> Result<()> {
        let (median, p90) = fitted.residual(self.skeleton);
        let words = format!(
            "the markers do not fit this body well: median {:.1} %, p90 {:.1} % of height off",
            100.0 * median,
            100.0 * p90
        );
        if median > BEARABLE.0 || p90 > BEARABLE.1 {
            let error = Error::refused(words)
                .file(&posed.capture.source)
                .at(format!("frame {}", posed.capture.first_frame + fitted.chosen.frame as i64))
                .expected("up to 4 % and 9 %")
                .hint("--ref N with a frame near the scan's pose, --ref-file with a static trial");
            return refuse(error, self.options, notes);
        }
        if median > GOOD.0 || p90 > GOOD.1 {
            notes.warn(words);
        }
        let arms = [Side::Left, Side::Right].map(|side| fitted.fit.arm_elevation(self.skeleton, side));
        let turned = (0..2).map(|i| (arms[i] - self.body.arm_elevation[i]).abs()).fold(0.0, f64::max);
        if turned > 30.0 {
            notes.warn(format!(
                "the arms of the reference frame are {turned:.0}° away from the scan's: shoulders may look square"
            ));
        }
        Ok(())
    }
}

struct Fitted<'a> {
    fit: Fit,
    landed: &'a [Landed],
    chosen: &'a Chosen,
}

impl Fitted<'_> {
    /// Median and 90th percentile of the residuals, in statures.
    fn residual(&self, body: &Skeleton) -> (f64, f64) {
        let mut values: Vec<f64> = self.fit.residuals.iter().map(|r| r / body.stature / self.fit.size).collect();
        (quantile(&mut values, 0.5).unwrap_or(0.0), quantile(&mut values, 0.9).unwrap_or(0.0))
    }

    /// Residual of a marker of the reference capture, in the unit box.
    fn of(&self, posed: &Take<'_>, marker: usize) -> Option<f64> {
        let seen = self.landed.iter().filter(|l| posed.track.point(self.chosen.frame, l.marker).is_some());
        seen.zip(&self.fit.residuals).find(|(l, _)| l.marker == marker).map(|(_, r)| r / self.fit.size)
    }
}
