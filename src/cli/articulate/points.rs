//! Markers and handles of tables on parts: where the rig file binds them, or where they lie in the first frame.

use super::{Driven, Stage};
use crate::binding::rig::mechanism::FromSection;
use crate::capture::{Capture, MarkerTake};
use crate::cli::args::Align;
use crate::cli::captures::{Captures, is_table};
use crate::deform::Handle;
use crate::error::{Error, Kind, Notes, Result};
use crate::spatial::TriangleTree;
use crate::words;
use glam::{DQuat, DVec3};

impl Stage<'_> {
    /// Markers and handles of tables: where the file binds them, or where they lie on the parts in the first frame.
    pub(super) fn points(&self, captures: &Captures, notes: &mut Notes) -> Result<Driven> {
        let table = captures.tables.first().filter(|_| is_table(&self.args.capture));
        let capture = &captures.capture;
        let markers = capture.motion.points();
        let (labels, frames): (&[String], usize) = match table {
            Some(table) => (&table.names, table.frames()),
            None => (&markers.labels, markers.frames()),
        };
        let told: Vec<(usize, DVec3, f64, usize)> = self.bound_markers(labels, notes)?;
        let raw = |frame: usize, marker: usize| match table {
            Some(table) => Some(table.points[frame * labels.len() + marker]).filter(|p| p.is_finite()),
            None => markers.point(frame, marker),
        };
        let in_scan = table.is_some() || self.args.align == Align::None;
        self.check_sides(in_scan, notes)?;
        let factor = if table.is_some() { 1.0 } else { self.factor(capture) };
        let space = (!in_scan).then(|| self.space(capture, &told, &raw, frames, factor));
        let place = |frame: usize, marker: usize| {
            let p = raw(frame, marker)?;
            Some(match space {
                Some((axes, scale)) => axes * p * scale,
                None => self.unit_box.enter(p * factor),
            })
        };
        let mut chosen = told;
        if chosen.is_empty() {
            if !in_scan {
                return Err(Error::refused("no [[bind]] says which marker sits on which component")
                    .expected("[[bind]] with from = { marker = \"NAME\" }, to = { component = \"NAME\", point = [x, y, z] }")
                    .hint("--align none where the markers lie on the parts of the mesh in their first frame"));
            }
            chosen = self.lying(labels, frames, &place, notes)?;
        }
        let handles: Vec<Handle> = chosen
            .iter()
            .map(|&(part, at, weight, marker)| Handle {
                name: labels[marker].clone(),
                row: self.machine.model.row(part, at),
                beta: weight,
            })
            .collect();
        let mut take = MarkerTake { labels: handles.iter().map(|h| h.name.clone()).collect(), ..MarkerTake::default() };
        for frame in 0..frames {
            let points = chosen.iter().map(|c| place(frame, c.3).unwrap_or(DVec3::NAN));
            take.points.extend(points.map(|p| p.to_array().map(|x| x as f32)));
        }
        let mut parts: Vec<usize> = chosen.iter().map(|c| c.0).collect();
        parts.sort_unstable();
        parts.dedup();
        let noun = if table.is_some() { "handle" } else { "marker" };
        let words = format!("{} on {}", words::plural(handles.len(), noun), words::plural(parts.len(), "part"));
        let mut decisions = self.decisions(captures, noun, handles.len());
        decisions.reference_frame = table.map_or(capture.first_frame, |t| t.first_frame);
        decisions.yaw = if in_scan { 0.0 } else { self.turn() };
        Ok(Driven { binding: self.binding(decisions, &handles, take), handles, ground: None, words })
    }

    /// Part, place, weight and index of the markers that the file binds.
    fn bound_markers(&self, labels: &[String], notes: &mut Notes) -> Result<Vec<(usize, DVec3, f64, usize)>> {
        let mut told = Vec::new();
        let mut missing = Vec::new();
        for bind in &self.file.binds {
            let (FromSection::Marker(name), Some(point)) = (&bind.from, bind.to.point) else { continue };
            let part = self.part(&bind.to.component)?;
            match labels.iter().position(|l| l == name) {
                Some(marker) => told.push((part, self.unit_box.enter(point.into()), bind.weight.unwrap_or(1.0), marker)),
                None => missing.push(name.as_str()),
            }
        }
        if !missing.is_empty() {
            if told.is_empty() {
                return Err(Error::refused(format!(
                    "the capture has none of the markers that the rig file binds ({}, …)",
                    missing[0]
                ))
                .expected(labels.iter().take(12).cloned().collect::<Vec<_>>().join(", ")));
            }
            notes.warn(format!(
                "{} of the rig file not in the capture: {}",
                words::plural(missing.len(), "marker"),
                missing.join(", ")
            ));
        }
        Ok(told)
    }

    /// What turns and sides cannot do to markers and handles: refused from the command line, a warning from the rig file.
    fn check_sides(&self, in_scan: bool, notes: &mut Notes) -> Result<()> {
        let (args, options) = (self.args, self.options);
        let without = [
            ("--mirror", args.mirror, options.mirror),
            ("--swap-sides", args.swap_sides, options.swap_sides),
            ("--flip", args.flip && in_scan, options.flip && in_scan),
        ];
        if let Some((option, ..)) = without.iter().find(|o| o.1) {
            return Err(Error::new(Kind::Usage, format!("{option} has no effect on these markers"))
                .expected("markers where they are on the parts; sides are told apart in skeletons alone"));
        }
        let lies = [("--yaw", options.yaw.is_some() && in_scan), ("--capture-up", options.capture_up.is_some() && in_scan)];
        let ignored: Vec<&str> = without.iter().map(|o| (o.0, o.2)).chain(lies).filter(|o| o.1).map(|o| o.0).collect();
        if !ignored.is_empty() {
            let why = if in_scan { "the capture is taken as it lies on the mesh" } else { "markers have no sides" };
            notes.warn(format!("{} not used: {why}", ignored.join(" and ")));
        }
        Ok(())
    }

    /// Scan units per unit of a marker capture, times `--scale`.
    fn factor(&self, capture: &Capture) -> f64 {
        let of_capture = self.options.capture_unit.or(capture.space.unit.map(|u| u.value));
        let units = of_capture.zip(self.unit()).map_or(1.0, |(c, s)| c.metres() / s.value.metres());
        self.options.scale.unwrap_or(1.0) * units
    }

    /// Turn and scale of a marker capture: axes by up, lengths by the distances of markers on one part, or by `factor`.
    fn space(
        &self,
        capture: &Capture,
        told: &[(usize, DVec3, f64, usize)],
        raw: &dyn Fn(usize, usize) -> Option<DVec3>,
        frames: usize,
        factor: f64,
    ) -> (DQuat, f64) {
        let up = self.options.capture_up.or(capture.space.up.map(|up| up.value)).map_or(DVec3::Z, |up| up.vector());
        let turn = DQuat::from_axis_angle(self.up().value, self.turn().to_radians());
        let axes = turn * DQuat::from_rotation_arc(up, self.up().value);
        let mut ratios = Vec::new();
        for (k, a) in told.iter().enumerate() {
            for b in told[..k].iter().filter(|b| b.0 == a.0) {
                let apart = a.1.distance(b.1);
                let seen = (0..frames.min(200)).find_map(|f| Some(raw(f, a.3)?.distance(raw(f, b.3)?)));
                ratios.extend(seen.filter(|s| *s > 0.0 && apart > 1e-6).map(|s| apart / s));
            }
        }
        ratios.sort_by(f64::total_cmp);
        let by_distances = ratios.get(ratios.len() / 2).copied().filter(|_| self.options.scale.is_none());
        (axes, by_distances.unwrap_or(factor / self.unit_box.diagonal))
    }

    /// Markers on the parts that are nearest to where they are in the first frame. One that comes later is left out: its part has moved by then.
    fn lying(
        &self,
        labels: &[String],
        frames: usize,
        place: &dyn Fn(usize, usize) -> Option<DVec3>,
        notes: &mut Notes,
    ) -> Result<Vec<(usize, DVec3, f64, usize)>> {
        const FAR: f64 = 0.1;
        let points: Vec<DVec3> = self.scan.mesh.positions.iter().map(|&p| self.unit_box.enter(p)).collect();
        let triangles = self.scan.mesh.vertex_triangles();
        let tree = TriangleTree::new(&points, &triangles);
        let mut lying = Vec::new();
        let mut late = Vec::new();
        for (marker, label) in labels.iter().enumerate() {
            let Some(at) = (frames > 0).then(|| place(0, marker)).flatten() else {
                late.push(label.as_str());
                continue;
            };
            let Some(near) = tree.closest(at) else { continue };
            if near.distance > FAR {
                return Err(Error::refused(format!(
                    "{label} begins {:.0} % of the diagonal away from the mesh",
                    100.0 * near.distance
                ))
                .expected("markers in the mesh's own space, on its parts in the first frame"));
            }
            let part = self.machine.part_of_vertex[triangles[near.triangle][0] as usize] as usize;
            lying.push((part, at, 1.0, marker));
        }
        if lying.is_empty() {
            return Err(Error::refused("no marker has a place in the first frame")
                .expected("markers on the parts in the first frame, or [[bind]] in the rig file"));
        }
        if !late.is_empty() {
            notes.warn(format!(
                "{} not in the first frame and so on no part: {}; [[bind]] in the rig file says where they are",
                words::plural(late.len(), "marker"),
                late.join(", ")
            ));
        }
        Ok(lying)
    }
}
