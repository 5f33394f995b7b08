//! A skeleton take on parts: by the binds of the rig file, or by who is who.

use super::{Driven, Stage};
use crate::binding::person::{self, Joints, Person};
use crate::binding::rig::mechanism::{BindKind, FromSection};
use crate::capture::{MarkerTake, SkeletonTake};
use crate::cli::args::Plant;
use crate::cli::captures::Captures;
use crate::error::{Error, Notes, Result};
use crate::pipeline::mechanism::drive::{self, Drive, Puppeteer, Stand};
use crate::pipeline::mechanism::{feet, floor, robot};
use crate::space::{Evidence, Known, Unit};
use glam::{DQuat, DVec3};

impl Stage<'_> {
    /// A skeleton: by the binds of the file, or by who is who.
    pub(super) fn skeleton(&self, captures: &Captures, take: &SkeletonTake, notes: &mut Notes) -> Result<Driven> {
        let capture = &captures.capture;
        let person = person::person(capture, take, self.options, notes)?;
        let joints = Joints::of(take, self.options);
        let frames = take.origins.frames();
        let up = self.up().value;
        let said_forward = self.file.space.scan_forward.as_ref().map(|f| f.0.vector());
        let body = robot::robot(self.machine, up, said_forward);
        let name = |joint: usize| take.joints[joint].name.clone();
        let told: Vec<_> = self.file.binds.iter().filter(|b| matches!(b.from, FromSection::Joint(_))).collect();
        let drives = if told.is_empty() {
            let body = body.as_ref().map_err(|lack| {
                Error::refused(format!("the parts and joints are not those of a body with arms and legs: {lack}"))
                    .expected("a pelvis with two legs, a chest with two arms, joined by joints of the rig file; up as [space] says")
                    .hint("[[bind]] in the rig file: from = { joint = \"LeftKnee\" }, to = { component = \"shank\", point = [x, y, z] }")
            })?;
            drive::drives(&person, body, &name)
        } else {
            self.told(take)?
        };
        let forward = body.as_ref().map(|b| b.forward).ok().or(said_forward).unwrap_or_else(|| up.any_orthonormal_vector());
        let front = drive::front(&joints, &person, frames).unwrap_or_else(|| person.up.value.vector().any_orthonormal_vector());
        let turn = self.turn();
        let normal = floor::normal(&joints, &person, frames, capture.rate);
        let leans = normal.angle_between(person.up.value.vector()).to_degrees();
        let axes = DQuat::from_axis_angle(up, turn.to_radians()) * drive::axes(normal, front, up, forward);
        let leg = leg_of(&drives, &person).or(body.as_ref().ok().map(|b| length(b.legs[0]))).ok_or_else(|| {
            Error::refused("no leg of the machine is driven: its size against the actor is not known").hint("--scale X")
        });
        let scale = match self.options.scale {
            // Both in metres.
            Some(scale) => {
                scale * person.unit.map_or(1.0, |u| u.value.metres())
                    / (self.unit().map_or(1.0, |u| u.value.metres()) * self.unit_box.diagonal)
            }
            None => leg? / person.leg,
        };
        let floor = self.machine.model.parts().iter().flat_map(|p| &p.points).map(|p| p.dot(up)).fold(f64::INFINITY, f64::min);
        let stand = Stand { axes, scale, up, floor };
        let plant = self.args.plant == Plant::Auto;
        let mut puppeteer = Puppeteer::new(joints, &drives, stand, &person, frames, capture.rate, plant);
        let handles = drive::handles(self.machine, &drives);
        let mut take = MarkerTake { labels: handles.iter().map(|h| h.name.clone()).collect(), ..MarkerTake::default() };
        let mut places = Vec::new();
        for frame in 0..frames {
            puppeteer.frame(frame, &mut places);
            take.points.extend(places.iter().map(|p| p.to_array().map(|x| x as f32)));
        }
        let metres = |unit: Option<Known<Unit>>| unit.map_or(1.0, |u| u.value.metres());
        let factor = scale * self.unit_box.diagonal * metres(self.unit()) / metres(person.unit);
        let map = drives.iter().map(|d| self.says(d)).collect::<Vec<_>>().join(", ");
        let how = if told.is_empty() { "by the body" } else { "by the rig file" };
        let floor = if leans > 0.0 { format!(" · its floor leans by {leans:.1}°, taken level") } else { String::new() };
        let words = format!("bone by bone, {how} · scale {factor:.3}{floor} · {map}");
        let mut decisions = self.decisions(captures, "joint", handles.len());
        decisions.scale = factor;
        decisions.yaw = turn;
        decisions.capture_unit = person.unit;
        decisions.capture_up = Some(person.up);
        let how = match (said_forward, &body) {
            (Some(_), _) => Evidence::Rig,
            (None, Ok(body)) if body.is_named => Evidence::Names,
            _ => Evidence::Shape,
        };
        decisions.scan_forward = Some(Known::new(forward, how));
        let ground = plant.then(|| feet::ground(&self.machine.model, &drives, &person, &stand));
        Ok(Driven { binding: self.binding(decisions, &handles, take), handles, ground, words })
    }

    fn says(&self, drive: &Drive) -> String {
        let part = &self.machine.model.parts()[drive.spot.0].name;
        format!("{}{} → {part}", drive.name, if drive.turns { " (turn)" } else { "" })
    }

    /// The drives that the file says.
    fn told(&self, take: &SkeletonTake) -> Result<Vec<Drive>> {
        let index = |name: &str| {
            take.joints.iter().position(|j| j.name == name).ok_or_else(|| {
                let names: Vec<&str> = take.joints.iter().take(12).map(|j| j.name.as_str()).collect();
                Error::malformed(format!("[[bind]] from joint {name}: the capture has none of that name"))
                    .expected(format!("one of {}, …", names.join(", ")))
            })
        };
        let mut drives: Vec<Drive> = Vec::new();
        for bind in &self.file.binds {
            let FromSection::Joint(name) = &bind.from else { continue };
            let part = self.part(&bind.to.component)?;
            let place = bind.to.point.map_or(DVec3::ZERO, |p| self.unit_box.enter(p.into()));
            let joint = index(name)?;
            let turns = bind.kind == BindKind::Orientation;
            drives.push(Drive {
                joint,
                name: name.clone(),
                spot: (part, place),
                parent: None,
                weight: bind.weight.unwrap_or(1.0),
                turns,
            });
        }
        let binds = self.file.binds.iter().filter(|b| matches!(b.from, FromSection::Joint(_)));
        for (k, bind) in binds.enumerate() {
            let Some(parent) = &bind.parent else { continue };
            // The targets are made in the file's order.
            let found = drives[..k].iter().position(|d| d.name == *parent && !d.turns).ok_or_else(|| {
                Error::malformed(format!("[[bind]] from {}: no bind before it is from its parent {parent}", drives[k].name))
                    .expected("the bind of the parent first")
            })?;
            drives[k].parent = Some(found);
        }
        Ok(drives)
    }
}

fn length(limb: [(usize, DVec3); 3]) -> f64 {
    limb[0].1.distance(limb[1].1) + limb[1].1.distance(limb[2].1)
}

/// Length of the driven leg on the machine, in the unit box.
fn leg_of(drives: &[Drive], person: &Person) -> Option<f64> {
    let spot = |joint: usize| drives.iter().find(|d| d.joint == joint && !d.turns).map(|d| d.spot);
    person.legs.iter().find_map(|&[hip, knee, ankle]| Some(length([spot(hip)?, spot(knee)?, spot(ankle)?])))
}
