//! A capture on a thing made of parts: what of it drives which part, and where that has to be in every frame.
//!
//! Joints of a person are rebuilt bone by bone: directions are the actor's, lengths the machine's own, the way of the pelvis is scaled by the legs. Feet
//! stand on the ground.

use super::feet::{Foot, tilted};
use super::machine::Machine;
use super::robot::{Robot, Spot};
use crate::binding::person::{Joints, Person};
use crate::deform::Handle;
use crate::linalg::SparseRow;
use glam::{DMat3, DQuat, DVec3};

/// Arms of the handles that turn a part, in the unit box.
const ARM: f64 = 0.05;
/// What drives a part.
#[derive(Clone, Debug, PartialEq)]
pub struct Drive {
    /// Joint of the take.
    pub joint: usize,
    /// Its name there, or what it is.
    pub name: String,
    /// The part and the place on it, in the unit box; for turns the place does not count.
    pub spot: Spot,
    /// Of several drives, the one from which the bone to this one goes.
    pub parent: Option<usize>,
    /// Against others.
    pub weight: f64,
    /// Whether it turns the part instead of moving it.
    pub turns: bool,
}

/// How the take stands to the machine.
#[derive(Clone, Copy, Debug)]
pub struct Stand {
    /// Machine's axes from the capture's.
    pub axes: DQuat,
    /// Unit box from the capture's unit.
    pub scale: f64,
    /// Direction up of the machine.
    pub up: DVec3,
    /// Height of the machine's lowest point.
    pub floor: f64,
}

/// Drives for a person in a machine, with the names of the take's joints.
pub fn drives(person: &Person, robot: &Robot, names: &dyn Fn(usize) -> String) -> Vec<Drive> {
    let mut drives: Vec<Drive> = Vec::new();
    let mut add = |joint: usize, spot: Spot, parent: Option<usize>, weight: f64, turns: bool| {
        drives.push(Drive { joint, name: names(joint), spot, parent, weight, turns });
        Some(drives.len() - 1)
    };
    let root = add(person.pelvis, robot.pelvis, None, 1.0, false);
    for side in 0..2 {
        let [hip, knee, ankle] = person.legs[side];
        let [at_hip, at_knee, at_ankle] = robot.legs[side];
        let hip = add(hip, at_hip, root, 1.0, false);
        let knee = add(knee, at_knee, hip, 1.0, false);
        let ankle = add(ankle, at_ankle, knee, 16.0, false);
        if let Some(toe) = person.toes[side] {
            add(toe, robot.toes[side], ankle, 8.0, false);
        }
    }
    let neck = person.neck.zip(robot.neck).map(|(joint, spot)| add(joint, spot, root, 1.0, false));
    let above = neck.flatten().or(root);
    for side in 0..2 {
        let [shoulder, elbow, wrist] = person.arms[side];
        let [at_shoulder, at_elbow, at_wrist] = robot.arms[side];
        // A person's shoulders move on the trunk, a machine's mostly do not.
        let shoulder = add(shoulder, at_shoulder, above, 0.3, false);
        let elbow = add(elbow, at_elbow, shoulder, 1.0, false);
        add(wrist, at_wrist, elbow, 2.0, false);
    }
    add(person.pelvis, robot.pelvis, None, 5.0, true);
    add(person.chest, (robot.chest, DVec3::ZERO), None, 5.0, true);
    if let (Some(head), Some(spot)) = (person.head, robot.crown) {
        add(head, spot, None, 3.0, true);
    }
    drives
}

/// Handles of drives: one for a place, three for a turn.
pub fn handles(machine: &Machine, drives: &[Drive]) -> Vec<Handle> {
    let mut handles = Vec::new();
    for drive in drives {
        let (part, place) = drive.spot;
        if drive.turns {
            let middle =
                machine.model.parts()[part].points.iter().sum::<DVec3>() / machine.model.parts()[part].points.len() as f64;
            for (axis, letter) in DVec3::AXES.into_iter().zip(["x", "y", "z"]) {
                let row = difference(&machine.model.row(part, middle + axis * ARM), &machine.model.row(part, middle));
                handles.push(Handle { name: format!("{} \u{203a} turn {letter}", drive.name), row, beta: drive.weight });
            }
        } else {
            let row = machine.model.row(part, place);
            handles.push(Handle { name: drive.name.clone(), row, beta: drive.weight });
        }
    }
    handles
}

/// A row that tells a direction: of the far point minus the near one.
fn difference(far: &SparseRow, near: &SparseRow) -> SparseRow {
    let mut row = SparseRow::default();
    let mut entries: Vec<(u32, f64)> = far.indices.iter().copied().zip(far.values.iter().copied()).collect();
    entries.extend(near.indices.iter().copied().zip(near.values.iter().map(|v| -v)));
    entries.sort_by_key(|e| e.0);
    for same in entries.chunk_by(|a, b| a.0 == b.0) {
        row.indices.push(same[0].0);
        row.values.push(same.iter().map(|s| s.1).sum());
    }
    row
}

/// Makes the targets of drives, frame after frame.
pub struct Puppeteer<'a> {
    joints: Joints<'a>,
    drives: &'a [Drive],
    stand: Stand,
    /// Length of the bone to each drive, on the machine.
    bones: Vec<f64>,
    /// Of hips on the same part as the pelvis: the drive that turns it.
    turned_by: Vec<Option<usize>>,
    /// Where the roots are in the first frame, flat, and their height over the floor there.
    start: Option<DVec3>,
    /// Height of the actor's ankles when they stand, in the unit box, and that of the machine's.
    level: f64,
    lift: f64,
    feet: Vec<Foot>,
    /// Whether feet that rest are held.
    plant: bool,
    rate: f64,
    /// Length of a leg on the machine.
    leg: f64,
    targets: Vec<DVec3>,
    own: Vec<DVec3>,
}

impl<'a> Puppeteer<'a> {
    /// For a take of so many frames. `plant`: whether feet that rest are held.
    pub fn new(
        joints: Joints<'a>,
        drives: &'a [Drive],
        stand: Stand,
        person: &Person,
        frames: usize,
        rate: f64,
        plant: bool,
    ) -> Self {
        let place = |d: usize| drives[d].spot.1;
        let bones = drives.iter().map(|d| d.parent.map_or(0.0, |p| d.spot.1.distance(place(p)))).collect();
        let turned_by = |d: &Drive| {
            let root = d.parent.filter(|p| drives[*p].parent.is_none() && drives[*p].spot.0 == d.spot.0)?;
            person.legs.iter().find(|leg| leg[0] == d.joint)?;
            drives.iter().position(|t| t.turns && t.joint == drives[root].joint && t.spot.0 == d.spot.0)
        };
        let turned_by = drives.iter().map(|d| turned_by(d).filter(|_| !d.turns)).collect();
        let feet = Foot::all(&joints, drives, &stand, person, frames);
        // The lower ankle comes to the height at which the machine has it at rest.
        let levels = feet.iter().map(Foot::levels).reduce(|a, b| (a.0.min(b.0), a.1.min(b.1)));
        let (level, lift) = levels.unwrap_or((0.0, stand.floor));
        let count = drives.len();
        Self {
            joints,
            drives,
            stand,
            bones,
            turned_by,
            start: None,
            level,
            lift,
            feet,
            plant,
            rate,
            leg: person.leg * stand.scale,
            targets: vec![DVec3::NAN; count],
            own: vec![DVec3::NAN; count],
        }
    }

    /// Places of the handles of all drives in a frame, in the unit box; not a number where a joint is missing. Frames in order.
    pub fn frame(&mut self, frame: usize, out: &mut Vec<DVec3>) {
        let Stand { axes, scale, up, .. } = self.stand;
        let place = |joint: usize| self.joints.place(Some(frame), joint).map(|p| axes * p);
        let turn = |joint: usize| self.joints.turn(frame, joint).map(|q| axes * q * axes.inverse());
        for (k, drive) in self.drives.iter().enumerate() {
            self.own[k] = place(drive.joint).unwrap_or(DVec3::NAN);
        }
        // From the pelvis to a hip, as the machine's are turned.
        let turned = |k: usize| {
            let drive = &self.drives[k];
            let bone = drive.spot.1 - self.drives[drive.parent?].spot.1;
            turn(self.drives[self.turned_by[k]?].joint).map(|turn| turn * bone)
        };
        for (k, drive) in self.drives.iter().enumerate() {
            if drive.turns {
                continue;
            }
            self.targets[k] = match drive.parent {
                Some(parent) if turned(k).is_some() => self.targets[parent] + turned(k).unwrap_or_default(),
                Some(parent) => {
                    let mut bone = self.own[k] - self.own[parent];
                    if let (Some(steeper), Some(above)) =
                        (self.feet.iter().find_map(|f| f.steeper(k)), self.drives[parent].parent)
                    {
                        bone = tilted(bone, self.own[parent] - self.own[above], steeper);
                    }
                    // Normalizing to zero would hide that a joint is missing.
                    let direction = if bone.is_finite() { bone.normalize_or_zero() } else { DVec3::NAN };
                    self.targets[parent] + direction * self.bones[k]
                }
                None => {
                    let at = self.own[k] * scale;
                    // A pelvis is as high over its hips as the machine's, not as the actor's.
                    let hips = (0..self.drives.len()).filter(|&h| self.drives[h].parent == Some(k));
                    let over = hips.filter_map(|h| Some((self.own[h] * scale - turned(h)?).dot(up))).filter(|h| h.is_finite());
                    let (sum, count) = over.fold((0.0, 0), |(sum, n), h| (sum + h, n + 1));
                    let high = if count > 0 { sum / f64::from(count) } else { at.dot(up) };
                    let height = high - self.level + self.lift;
                    let flat = at - up * at.dot(up);
                    if self.start.is_none() && flat.is_finite() {
                        let home = drive.spot.1;
                        self.start = Some(flat - (home - up * home.dot(up)));
                    }
                    flat - self.start.unwrap_or_default() + up * height
                }
            };
        }
        if self.plant {
            for foot in &mut self.feet {
                foot.place(&self.own, &mut self.targets, &self.stand, self.leg, self.rate);
            }
        }
        out.clear();
        for (k, drive) in self.drives.iter().enumerate() {
            if drive.turns {
                let turn = turn(drive.joint);
                out.extend(DVec3::AXES.map(|e| turn.map_or(DVec3::NAN, |q| q * e * ARM)));
            } else {
                out.push(self.targets[k]);
            }
        }
    }
}

/// The capture's up and front onto the machine's.
pub fn axes(up: DVec3, forward: DVec3, to_up: DVec3, to_forward: DVec3) -> DQuat {
    let frame = |up: DVec3, forward: DVec3| {
        let forward = (forward - up * up.dot(forward)).normalize_or(up.any_orthonormal_vector());
        DMat3::from_cols(forward, up.cross(forward), up)
    };
    DQuat::from_mat3(&(frame(to_up, to_forward) * frame(up, forward).transpose()))
}

/// The front of a person, from hips and shoulders at rest, or in the first frame that shows them.
pub fn front(joints: &Joints<'_>, person: &Person, frames: usize) -> Option<DVec3> {
    let up = person.up.value.vector();
    let at = |frame: Option<usize>| {
        let place = |j: usize| joints.place(frame, j);
        let left = place(person.legs[0][0])? - place(person.legs[1][0])? + place(person.arms[0][0])? - place(person.arms[1][0])?;
        let front = left.cross(up);
        (front - up * front.dot(up)).try_normalize()
    };
    at(None).or_else(|| (0..frames.min(1000)).find_map(|f| at(Some(f))))
}
