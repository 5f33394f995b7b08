//! Where the markers of a person sit on the scan, and what they follow.

use super::*;

/// What a retargeted take can be bound by again.
pub(super) struct Kept {
    pub(super) clavicles: [DVec3; 2],
    pub(super) seen: Vec<Seen>,
    pub(super) placement: Similarity,
    pub(super) start: usize,
}

/// The markers that hold the scan, where the actor has them, and those that do not, with why.
struct Attached {
    handles: Vec<BoundMarker>,
    seen: Vec<Seen>,
    unbound: Vec<(String, String)>,
    /// What pulls softly, and how far it is off.
    doubtful: Vec<String>,
}

struct Placed {
    similarity: Similarity,
    yaw: f64,
    /// The frame of the take that it was read in.
    frame: usize,
}

impl Human<'_> {
    #[allow(clippy::too_many_arguments)]
    pub(super) fn attach(
        &self,
        posed: &Take<'_>,
        apart: bool,
        actor: &Actor,
        fitted: &Fitted<'_>,
        align: Align,
        held: Held,
        factor: f64,
        mut notes: Notes,
    ) -> Result<(Binding, Kept)> {
        let take = self.take;
        let start = fitted.chosen.upright.placement;
        let frame = fitted.chosen.frame;
        let frames = take.track.sample(SAMPLES);
        let clavicles = match align {
            Align::Similarity => [DVec3::ZERO; 2],
            _ => retarget::clavicles(self.skeleton, &fitted.fit, self.body.arm_elevation),
        };
        let Attached { mut handles, seen, unbound, doubtful } = self.attachments(posed, apart, fitted, align, clavicles, &frames);
        if !doubtful.is_empty() {
            let s = if doubtful.len() == 1 { "marker pulls" } else { "markers pull" };
            notes.warn(format!("{} doubtful {s} softly: {}", doubtful.len(), doubtful.join(", ")));
        }
        if handles.is_empty() {
            return Err(Error::refused("no marker can be bound to the scan").file(&take.capture.source));
        }

        let placement = self.place(align, actor, fitted, apart, &handles, held)?;
        let similarity = placement.similarity;
        let size = fitted.fit.size;
        let at_size = Similarity { scale: similarity.scale * size, translation: similarity.translation * size, ..similarity };
        let kept = Kept { clavicles, seen, placement: if apart { at_size } else { start }, start: placement.frame };
        let joints = match align {
            Align::Retarget => retarget::joints(self.skeleton, &handles),
            _ => Vec::new(),
        };
        let trajectories = (align == Align::Retarget)
            .then(|| self.retargeting(&fitted.fit, &kept).trajectories(&take.track, &handles, &kept.seen, &joints, self.watch))
            .transpose()?;
        let (trajectories, planter) = trajectories.unzip();
        let feet = planter.flatten().and_then(|planter| planter.slip(self.scan.unit_box.diagonal));
        let strain = match &trajectories {
            Some(own) => {
                let target = |frame: usize, handle: usize| own.point(frame, handle);
                checks::strain(&take.names, &handles, target, &frames, self.skeleton.stature)
            }
            None => {
                let target =
                    |frame: usize, handle: usize| take.track.point(frame, handles[handle].marker).map(|p| similarity.apply(p));
                checks::strain(&take.names, &handles, target, &frames, self.skeleton.stature)
            }
        };
        let off_surface = raw::off_surface(self.scan, &handles);
        let bound = handles.len();
        if trajectories.is_some() {
            handles.extend(joints);
            handles.iter_mut().enumerate().for_each(|(i, handle)| handle.marker = i);
        }
        let decisions = Decisions {
            align,
            on_skin: false,
            noun: take.capture.motion.noun(),
            reference_rest: false,
            reference_frame: posed.capture.first_frame + frame as i64,
            reference_range: posed.range(),
            reference_capture: apart.then(|| posed.capture.name.clone()),
            scale: similarity.scale * self.scan.unit_box.diagonal / factor,
            yaw: placement.yaw.to_degrees(),
            scan_unit: None,
            scan_up: None,
            scan_forward: None,
            scan_height: None,
            capture_unit: actor.unit,
            capture_up: Some(actor.up),
            actor_height: actor.stature,
            set: take.names.set,
            named: take.names.count(),
            markers: take.track.take.markers(),
            bound,
            off_surface,
            residual: Some(fitted.residual(self.skeleton)).map(|(a, b)| (100.0 * a, 100.0 * b)),
            proportions: SIZE.iter().map(|&(r, name)| (name, fitted.fit.ratios[r as usize])).collect(),
            strain: strain.map(|(median, p95)| (100.0 * median, 100.0 * p95)),
            feet,
        };
        warn_of_build(&decisions, strain, &mut notes);
        let binding = Binding {
            placement: match trajectories {
                Some(_) => Similarity::IDENTITY,
                None => Similarity { mirror: self.options.mirror, ..similarity },
            },
            handles,
            unbound,
            segments: segment_places(self.skeleton),
            trajectories,
            turning: Turning::default(),
            decisions,
            frozen: None,
            notes,
        };
        Ok((binding, kept))
    }

    /// Where each marker holds the scan, in what the take shows in `frames`. `clavicles`: by how much the shoulders of scan and actor differ.
    fn attachments(
        &self,
        posed: &Take<'_>,
        apart: bool,
        fitted: &Fitted<'_>,
        align: Align,
        clavicles: [DVec3; 2],
        frames: &[usize],
    ) -> Attached {
        let take = self.take;
        let (start, frame) = (fitted.chosen.upright.placement, fitted.chosen.frame);
        let stature = self.skeleton.stature / start.scale;
        let unnamed: Vec<usize> = (0..take.track.take.markers()).filter(|&i| take.names.places[i].is_none()).collect();
        let assigned = clusters::assign(&take.track, &take.names, &unnamed, frames, stature);

        let strays = clusters::strays(&take.track, &take.names, frames, stature, LEAVES);

        let mut handles = Vec::new();
        let mut seen = Vec::new();
        let mut unbound = Vec::new();
        let mut doubtful = Vec::new();
        for marker in 0..take.track.take.markers() {
            let label = take.label(marker).to_owned();
            if self.options.is_ignored(&label) {
                unbound.push((label, "left out by the rig file".to_owned()));
                continue;
            }
            let place = take.names.places[marker].as_ref();
            let named = place.map(super::labels::Place::segment);
            let assignment = assigned.iter().find(|a| a.marker == marker);
            let segment = match named {
                Some(segment) => segment,
                None if take.track.take.frames() < LEAST_MOTION => {
                    unbound.push((label, "unknown label in a take too short to tell its segment".to_owned()));
                    continue;
                }
                None => match assignment {
                    Some(a) if a.movement <= PROP => a.segment,
                    Some(a) => {
                        let far = 100.0 * a.movement;
                        unbound.push((label, format!("unknown label that moves {far:.1} % of height against every segment")));
                        continue;
                    }
                    None => {
                        unbound.push((label, "unknown label that is never seen with a segment".to_owned()));
                        continue;
                    }
                },
            };
            let twin = if apart { take.twin(marker, posed) } else { Some(marker) };
            let point = twin.and_then(|i| {
                let seen = posed.track.point(frame, i);
                seen.or_else(|| clusters::predict(&posed.track, &posed.names, i, segment, &posed.track.sample(300), frame))
            });
            let Some(point) = point else {
                unbound.push((label, "not there in the reference frame".to_owned()));
                continue;
            };
            let at = start.apply(point);
            let shoulder = place.filter(|p| p.part == Part::Shoulder).map(|p| usize::from(p.side == Side::Right));
            let attachment = match align {
                _ if place.is_some_and(|p| p.at.is_some()) => place.and_then(|p| p.at).unwrap_or(at),
                Align::Similarity => at,
                _ => fitted.fit.carry(self.skeleton, segment, at) - shoulder.map_or(DVec3::ZERO, |s| clavicles[s]),
            };
            if let Some(far) = outside(self.scan, attachment) {
                unbound.push((label, format!("{:.1} % of the diagonal outside the scan", 100.0 * far)));
                continue;
            }
            let residual = twin.and_then(|i| fitted.of(posed, i)).map(|r| r / self.skeleton.stature);
            let leaves = strays.iter().find(|s| s.0 == marker).map(|s| s.1);
            let movement = assignment.map_or(0.0, |a| a.movement);
            let soft = residual.is_some_and(|r| r > DOUBTFUL) || leaves.is_some_and(|l| l > LEAVES) || movement > NEARLY_PROP;
            if soft {
                let percent = 100.0 * residual.unwrap_or(0.0).max(leaves.unwrap_or(0.0)).max(movement);
                doubtful.push(format!("{label} {percent:.1} %"));
            }
            let weight = if soft { DOUBTED } else { place.map_or(UNNAMED, |p| p.weight) };
            seen.push(Seen { at, shoulder, weight });
            handles.push(BoundMarker { label, marker, attachment, segment: Some(segment), beta: if soft { SOFT } else { 1.0 } });
        }
        Attached { handles, seen, unbound, doubtful }
    }

    /// The placement of the whole take: scale from the fit, turn and shift from the handles of trunk and legs in the take's own frame
    /// nearest to the scan's pose.
    fn place(
        &self,
        align: Align,
        actor: &Actor,
        fitted: &Fitted<'_>,
        apart: bool,
        handles: &[BoundMarker],
        held: Held,
    ) -> Result<Placed> {
        let chosen = fitted.chosen;
        let scale = match align {
            Align::Similarity => chosen.upright.placement.scale,
            _ => chosen.upright.placement.scale / fitted.fit.size,
        };
        if align == Align::Similarity && !apart {
            return Ok(Placed { similarity: chosen.upright.placement, yaw: chosen.upright.yaw, frame: chosen.frame });
        }
        let up = actor.up.value.vector();
        let frame = if apart {
            let landed = self.landed(self.take);
            let auto = Options { reference: Reference::Auto, ..self.options.clone() };
            reference::candidates(self.take.capture, &self.take.track, up, self.skeleton, &landed, held, &auto)?[0].frame
        } else {
            chosen.frame
        };
        let pairs = |core: bool| -> Vec<(DVec3, DVec3, f64)> {
            handles
                .iter()
                .filter(|h| !core || h.segment.is_some_and(|s| !s.is_arm() && s != Segment::Head))
                .filter_map(|h| Some((self.take.track.point(frame, h.marker)?, h.attachment, 1.0)))
                .collect()
        };
        let held = Held { scale: Some(scale), ..held };
        let placed = upright(&pairs(true), up, self.skeleton.up, held)
            .or_else(|| upright(&pairs(false), up, self.skeleton.up, held))
            .ok_or_else(|| Error::refused("fewer than three bound markers are there at once").file(&self.take.capture.source))?;
        Ok(Placed { similarity: placed.placement, yaw: placed.yaw, frame })
    }
}

/// Says where distances along bones are others than on the scan. `strain`: median and 95th percentile.
fn warn_of_build(decisions: &Decisions, strain: Option<(f64, f64)>, notes: &mut Notes) {
    let Some((_, p95)) = strain else { return };
    let stretched: Vec<String> = decisions
        .proportions
        .iter()
        .filter(|(_, r)| decisions.align != Align::Retarget && (r - 1.0).abs() > OTHER_BUILD)
        .map(|(name, r)| format!("{name} {r:.2}"))
        .collect();
    if !stretched.is_empty() {
        notes.warn(format!(
            "actor and scan differ in build ({}): the scan's limbs are stretched to the actor's lengths",
            stretched.join(", ")
        ));
    } else if p95 > STRETCH {
        notes.warn(format!(
            "distances along bones differ by {:.0} % (p95): a marker may sit elsewhere than its label says",
            100.0 * p95
        ));
    }
}
