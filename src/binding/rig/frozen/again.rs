//! Another take by what was decided.

use super::*;

impl Frozen {
    /// Binds a take of the same actor on the same scan by what was decided.
    pub(in crate::binding) fn bind(
        &self,
        scan: &ScanShape<'_>,
        take: &Take<'_>,
        options: &Options,
        watch: Watch<'_>,
    ) -> Result<Binding> {
        let mut notes = Notes::default();
        self.check_scan(scan, &mut notes);
        let body = self.body();
        let skeleton = body.as_ref().map(Skeleton::of);
        let labels = &take.track.take.labels;
        let mut handles = Vec::new();
        let mut seen = Vec::new();
        let mut missing = Vec::new();
        let mut unbound = Vec::new();
        for frozen in &self.markers {
            let Some(marker) = labels.iter().position(|label| *label == frozen.label) else {
                missing.push(frozen.label.as_str());
                continue;
            };
            if options.is_ignored(&frozen.label) {
                unbound.push((frozen.label.clone(), "left out by the rig file".to_owned()));
                continue;
            }
            let attachment = options.pinned(&frozen.label).unwrap_or(DVec3::from(frozen.attachment));
            seen.push(Seen {
                at: DVec3::from(frozen.seen.unwrap_or_default()),
                shoulder: frozen.shoulder,
                weight: frozen.weight,
            });
            handles.push(BoundMarker {
                label: frozen.label.clone(),
                marker,
                attachment,
                segment: frozen.segment,
                beta: frozen.hardness,
            });
        }
        if !missing.is_empty() {
            notes.warn(format!("{} of the rig file's markers are not in the capture: {}", missing.len(), missing.join(", ")));
        }
        for label in labels.iter().filter(|label| !self.markers.iter().any(|m| m.label == **label)) {
            unbound.push((label.clone(), "not in [frozen] of the rig file".to_owned()));
        }
        if handles.is_empty() {
            return Err(Error::refused("the capture has none of the rig file's markers")
                .file(&take.capture.source)
                .expected(format!("labels as {}", self.markers.iter().take(4).map(|m| &*m.label).collect::<Vec<_>>().join(", ")))
                .hint("a rig file without [frozen], or one that was made from a capture with these labels"));
        }
        let placement = Similarity {
            mirror: self.placement.mirror,
            scale: self.placement.scale,
            rotation: DQuat::from_array(self.placement.rotation),
            translation: DVec3::from(self.placement.translation),
        };
        let track = Track { take: take.track.take, mirror: placement.mirror };
        let stature = skeleton.as_ref().map_or(1.0, |s| s.stature);
        let frames = take.track.sample(60);
        let off_surface = raw::off_surface(scan, &handles);
        let fit = self.actor.as_ref().map(FrozenActor::fit);
        let mut proportions = Vec::new();
        let mut feet = None;
        let mut joints = Vec::new();
        let mut trajectories = None;
        if let (Some(fit), Some(actor), Some(skeleton)) = (&fit, &self.actor, &skeleton) {
            let clavicles = actor.clavicles.map(DVec3::from);
            let start = self.start_in(scan, take, &track, skeleton);
            let retargeting = Retargeting {
                body: skeleton,
                fit,
                clavicles,
                placement: Similarity { mirror: false, ..placement },
                start,
                feet: options.feet(take.capture),
            };
            joints = retarget::joints(skeleton, &handles);
            let (own, planter) = retargeting.trajectories(&track, &handles, &seen, &joints, watch)?;
            feet = planter.and_then(|planter| planter.slip(scan.unit_box.diagonal));
            trajectories = Some(own);
            proportions = SIZE.iter().map(|&(r, name)| (name, fit.ratios[r as usize])).collect();
        }
        let strain = match &trajectories {
            Some(own) => checks::strain(&take.names, &handles, |frame, i| own.point(frame, i), &frames, stature),
            None => {
                let target = |frame: usize, i: usize| take.track.take.point(frame, handles[i].marker).map(|p| placement.apply(p));
                checks::strain(&take.names, &handles, target, &frames, stature)
            }
        };
        let bound = handles.len();
        if trajectories.is_some() {
            handles.extend(joints);
            handles.iter_mut().enumerate().for_each(|(i, handle)| handle.marker = i);
        }
        let decisions = Decisions {
            set: take.names.set,
            named: take.names.count(),
            markers: labels.len(),
            bound,
            off_surface,
            proportions,
            strain: strain.map(|(median, p95)| (100.0 * median, 100.0 * p95)),
            feet,
            ..self.decisions(scan, take.capture)
        };
        Ok(Binding {
            placement: if trajectories.is_some() { Similarity::IDENTITY } else { placement },
            handles,
            unbound,
            segments: skeleton.as_ref().map_or(Vec::new(), segment_places),
            trajectories,
            turning: Turning::default(),
            decisions,
            frozen: Some(self.clone()),
            notes,
        })
    }

    /// Whether it was made from this capture.
    pub(super) fn is_of(&self, capture: &Capture) -> bool {
        self.capture == capture.name && self.file == stem(capture) && self.frames == capture.motion.points().frames()
    }

    /// The frame from which the poses go out: the one that was frozen, or that of another take which is nearest to the scan's pose.
    fn start_in(&self, scan: &ScanShape<'_>, take: &Take<'_>, track: &Track<'_>, skeleton: &Skeleton) -> usize {
        let frames = take.track.take.frames();
        let frozen = self.start.checked_sub(take.capture.first_frame).and_then(|f| usize::try_from(f).ok());
        if self.is_of(take.capture)
            && let Some(frame) = frozen.filter(|&frame| frame < frames)
        {
            return frame;
        }
        let landed: Vec<reference::Landed> = take
            .names
            .iter()
            .map(|(marker, place)| reference::Landed {
                marker,
                place: places::on_skin(place, skeleton, scan.tree),
                weight: place.weight,
            })
            .collect();
        let up = DQuat::from_array(self.placement.rotation).inverse() * skeleton.up;
        let auto = Options { reference: Reference::Auto, ..Options::default() };
        let found = reference::candidates(take.capture, track, up, skeleton, &landed, Held::default(), &auto);
        found.map_or(0, |candidates| candidates[0].frame)
    }
}
