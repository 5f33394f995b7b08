//! `--rig` and `--save-rig`: what a rig file adds to the command line, and the file of a run.

use super::args::{Animate, Plant, Reference};
use crate::binding::landmarks::Joint;
use crate::binding::rig::{Pin, RigFile, Spot};
use crate::binding::select::Stiffness;
use crate::binding::{self, Binding, Marker, Rules};
use crate::error::{Error, Notes, Result};
use crate::export::files::Pending;
use crate::scan::{Scan, UnitBox};
use glam::DVec3;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// A rig file with its path; empty where there is none.
#[derive(Debug, Default)]
pub(super) struct Rig {
    file: RigFile,
    path: PathBuf,
}

impl Rig {
    /// The file of `--rig`.
    pub(super) fn read(args: &Animate) -> Result<Self> {
        match &args.rig {
            Some(path) => Ok(Self { file: RigFile::read(path)?, path: path.clone() }),
            None => Ok(Self::default()),
        }
    }

    /// What the file says.
    pub(super) fn file(&self) -> &RigFile {
        &self.file
    }

    /// The static trial: that of the command line, or that of the file, beside it.
    pub(super) fn reference(&self, args: &Animate) -> Option<PathBuf> {
        // What is frozen needs no second look at the trial.
        if self.file.frozen.is_some() {
            return None;
        }
        args.ref_file.clone().or_else(|| self.trial())
    }

    fn trial(&self) -> Option<PathBuf> {
        Some(self.path.parent().unwrap_or(Path::new("")).join(self.file.reference.file.as_ref()?))
    }

    /// Adds to the rules what the file says of parts.
    pub(super) fn rules(&self, rules: &mut Rules) {
        for group in &self.file.groups {
            match group.stiffness {
                Some(factor) => rules.stiffness(Stiffness { what: group.what.0.clone(), factor }),
                None => rules.rigid(group.what.0.clone()),
            }
        }
    }

    /// The joints of the scan that the file gives, in the unit box.
    pub(super) fn landmarks(&self, scan: &Scan, unit_box: UnitBox) -> Result<BTreeMap<Joint, DVec3>> {
        let place = |(joint, spot): (&Joint, &Spot)| {
            Ok((*joint, self.place(*spot, scan, unit_box).map_err(|e| e.at(format!("[landmarks] {joint:?}")))?))
        };
        self.file.landmarks.iter().map(place).collect()
    }

    fn place(&self, spot: Spot, scan: &Scan, unit_box: UnitBox) -> Result<DVec3> {
        let place = match spot {
            Spot::Place(place) => place,
            Spot::Vertex(vertex) => {
                let found = usize::try_from(vertex).ok().and_then(|v| scan.mesh.positions.get(v)).copied();
                found.ok_or_else(|| {
                    Error::malformed(format!("the scan has no vertex {vertex}"))
                        .file(&self.path)
                        .expected(format!("0 to {}", scan.mesh.positions.len().saturating_sub(1)))
                })?
            }
        };
        Ok(unit_box.enter(place))
    }

    /// What command line and file decide about the binding; the command line wins.
    pub(super) fn options(&self, args: &Animate, scan: &Scan, unit_box: UnitBox, notes: &mut Notes) -> Result<binding::Options> {
        let space = &self.file.space;
        let mut markers = BTreeMap::new();
        for (label, pin) in &self.file.markers {
            let marker = match pin {
                Pin::Ignore => Marker::Ignored,
                Pin::As(word) => Marker::As(word.clone()),
                Pin::At(spot) => Marker::At(self.place(*spot, scan, unit_box).map_err(|e| e.at(format!("[markers] {label}")))?),
            };
            markers.insert(label.clone(), marker);
        }
        let again: Vec<&str> = [
            (args.align != super::args::Align::Auto, "--align"),
            (args.reference != Reference::Auto, "--ref"),
            (args.ref_file.is_some(), "--ref-file"),
            (args.yaw.is_some(), "--yaw"),
            (args.scale.is_some(), "--scale"),
            (args.flip, "--flip"),
            (args.mirror, "--mirror"),
            (args.swap_sides, "--swap-sides"),
            (args.scan_unit.is_some(), "--scan-unit"),
            (args.scan_up.is_some(), "--scan-up"),
            (args.capture_unit.is_some(), "--capture-unit"),
            (args.capture_up.is_some(), "--capture-up"),
        ]
        .into_iter()
        .filter_map(|(given, word)| given.then_some(word))
        .collect();
        if self.file.frozen.is_some() && !again.is_empty() {
            notes.warn(format!(
                "{} not used: [frozen] of the rig file decides; without that section all is decided anew",
                again.join(", ")
            ));
        }
        Ok(binding::Options {
            align: args.align.into(),
            reference: match (args.reference, self.file.reference.frame) {
                (Reference::Frame(number), _) | (Reference::Auto, Some(number)) => binding::Reference::Frame(number),
                (Reference::Auto, None) => binding::Reference::Auto,
            },
            yaw: args.yaw.or(space.yaw),
            flip: args.flip || space.flip,
            scale: args.scale.or(space.scale),
            free_feet: args.plant == Plant::Off,
            accept_doubtful: args.accept_doubtful,
            mirror: args.mirror || space.mirror,
            swap_sides: args.swap_sides || space.swap_sides,
            scan_unit: args.scan_unit.or(space.scan_unit.as_ref().map(|u| u.0)),
            scan_up: args.scan_up.or(space.scan_up.as_ref().map(|a| a.0)),
            capture_unit: args.capture_unit.or(space.capture_unit.as_ref().map(|u| u.0)),
            capture_up: args.capture_up.or(space.capture_up.as_ref().map(|a| a.0)),
            markers,
            joints: self.file.skeleton.iter().map(|(name, role)| (name.clone(), role.0.clone())).collect(),
            frozen: self.file.frozen.clone().map(Arc::new),
        })
    }

    /// Writes the file of `--save-rig`: what was fed in, and what was decided; says where that is nothing.
    pub(super) fn save(&self, args: &Animate, scan: &Scan, binding: &Binding, notes: &mut Notes) -> Result<()> {
        let Some(path) = &args.save_rig else { return Ok(()) };
        let frozen = binding.frozen.clone().map(|frozen| frozen.for_scan(&scan.mesh));
        if frozen.is_none() {
            notes.warn("the rig file holds no decisions: what lies in the scan already has none to keep");
        }
        let mut rig = RigFile { frozen, ..self.file.clone() };
        rig.solver.shell = args.shells.section(&self.file.solver.shell)?;
        // Beside another file a relative path leads elsewhere.
        if self.path.parent() != path.parent()
            && let Some(trial) = self.trial()
        {
            rig.reference.file = Some(std::path::absolute(&trial).unwrap_or(trial));
        }
        let text = rig.to_text()?;
        let mut file = Pending::create(path)?;
        file.write(text.as_bytes())?;
        file.finish()?;
        Ok(())
    }
}
