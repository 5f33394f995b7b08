//! What a skeleton take says of its own space: up, size, unit, and whether its toes point to the front.

use super::cast::Cast;
use super::rig::{Pose, Rig};
use crate::binding::actor::{check_up, unit_of_stature};
use crate::binding::{Options, refuse};
use crate::error::{Error, Kind, Notes, Result};
use crate::space::{Axis, Evidence, Known, Space, Unit};
use crate::statistics::quantile;
use glam::DVec3;

/// Frames looked at.
const SAMPLES: usize = 300;
/// Hip to ankle along the bones, in statures (Winter, Biomechanics and Motor Control of Human Movement).
const LEG: f64 = 0.491;

/// The captured body in its own space.
#[derive(Clone, Debug)]
pub(super) struct Stance {
    pub up: Known<Axis>,
    pub unit: Option<Known<Unit>>,
    /// Length of thigh and shank.
    pub leg: f64,
    /// Height as the legs tell it.
    pub stature: f64,
}

/// Lengths of the bones of a cast in the median frame, means of both sides.
#[derive(Clone, Copy, Debug)]
pub(super) struct Lengths {
    pub thigh: f64,
    pub shank: f64,
    pub upper_arm: f64,
    pub forearm: f64,
    /// Mid hip to mid shoulder.
    pub torso: f64,
}

impl Lengths {
    pub(super) fn of(rig: &Rig<'_>, cast: &Cast) -> Option<Self> {
        let frames = rig.sample(60);
        let median = |ends: &dyn Fn(Pose) -> Option<[f64; 2]>| {
            let mut all: Vec<f64> = frames.iter().filter_map(|&f| ends(Pose::Frame(f))).flatten().collect();
            quantile(&mut all, 0.5)
        };
        let bone = |pose: Pose, a: usize, b: usize| Some((rig.place(pose, a)? - rig.place(pose, b)?).length());
        let legs = |pick: fn(&super::cast::Leg) -> (usize, usize)| {
            median(&|pose| {
                let [l, r] = cast.legs.map(|leg| pick(&leg));
                Some([bone(pose, l.0, l.1)?, bone(pose, r.0, r.1)?])
            })
        };
        let arms = |pick: fn(&super::cast::Arm) -> (usize, usize)| {
            median(&|pose| {
                let [l, r] = cast.arms.map(|arm| pick(&arm));
                Some([bone(pose, l.0, l.1)?, bone(pose, r.0, r.1)?])
            })
        };
        Some(Self {
            thigh: legs(|l| (l.hip, l.knee))?,
            shank: legs(|l| (l.knee, l.ankle))?,
            upper_arm: arms(|a| (a.shoulder, a.elbow))?,
            forearm: arms(|a| (a.elbow, a.wrist))?,
            torso: median(&|pose| Some([(shoulders(rig, cast, pose)? - hips(rig, cast, pose)?).length(); 2]))?,
        })
    }
}

/// The middle of the hips.
pub(super) fn hips(rig: &Rig<'_>, cast: &Cast, pose: Pose) -> Option<DVec3> {
    Some((rig.place(pose, cast.legs[0].hip)? + rig.place(pose, cast.legs[1].hip)?) * 0.5)
}

/// The middle of the shoulders.
pub(super) fn shoulders(rig: &Rig<'_>, cast: &Cast, pose: Pose) -> Option<DVec3> {
    Some((rig.place(pose, cast.arms[0].shoulder)? + rig.place(pose, cast.arms[1].shoulder)?) * 0.5)
}

/// From the right side of the body to the left, by the hips, or the shoulders where the hips are one point.
pub(super) fn leftwards(rig: &Rig<'_>, cast: &Cast, pose: Pose, up: DVec3) -> Option<DVec3> {
    let level = |l: usize, r: usize| {
        let d = rig.place(pose, l)? - rig.place(pose, r)?;
        Some(d - up * d.dot(up))
    };
    let hips = level(cast.legs[0].hip, cast.legs[1].hip)?;
    let shoulders = level(cast.arms[0].shoulder, cast.arms[1].shoulder)?;
    if hips.length() > 0.2 * shoulders.length() { hips.try_normalize() } else { shoulders.try_normalize() }
}

/// Reads the stance off the motion. Errors are refusals that name the option which decides.
pub(super) fn read(
    rig: &Rig<'_>,
    cast: &Cast,
    lengths: &Lengths,
    space: &Space,
    options: &Options,
    notes: &mut Notes,
) -> Result<Stance> {
    let frames = rig.sample(SAMPLES);
    let up = find_up(rig, cast, &frames, space, options, notes)?;
    check_toes(rig, cast, &frames, up.value.vector(), options, notes)?;
    let leg = lengths.thigh + lengths.shank;
    let stature = leg / LEG;
    let unit = match options.capture_unit {
        Some(unit) => Some(Known::new(unit, Evidence::User)),
        None => unit_of_stature(stature, space.unit).or(space.unit),
    };
    if let (Some(unit), Some(file)) = (unit, space.unit)
        && unit.value != file.value
        && unit.how == Evidence::Size
    {
        notes.warn(format!(
            "the capture file says {}, but then the actor would be {:.3} m tall: {} is believed (--capture-unit sets it)",
            file.value,
            stature * file.value.metres(),
            unit.value
        ));
    }
    Ok(Stance { up, unit, leg, stature })
}

fn find_up(
    rig: &Rig<'_>,
    cast: &Cast,
    frames: &[usize],
    space: &Space,
    options: &Options,
    notes: &mut Notes,
) -> Result<Known<Axis>> {
    if let Some(axis) = options.capture_up {
        return Ok(Known::new(axis, Evidence::User));
    }
    let upright = |&frame: &usize| {
        let pose = Pose::Frame(frame);
        let ankles = (rig.place(pose, cast.legs[0].ankle)? + rig.place(pose, cast.legs[1].ankle)?) * 0.5;
        (shoulders(rig, cast, pose)? - ankles).try_normalize()
    };
    let directions: Vec<DVec3> = frames.iter().filter_map(upright).collect();
    let mean = directions.iter().sum::<DVec3>() / directions.len().max(1) as f64;
    let axis = Axis::nearest(mean);
    let confidence = mean.dot(axis.vector());
    if let Some(file) = space.up.filter(|_| confidence < 0.5) {
        notes.warn(format!("the actor is not upright for most of the take: {} is up as the file says", file.value));
        return Ok(file);
    }
    check_up((axis, confidence), "shoulders", "+Y", options, notes)?;
    let how = match space.up {
        Some(file) if file.value == axis => file.how,
        Some(file) if cast.by_form => {
            let what = format!(
                "only the form of the skeleton tells a person, and by it {axis} is up, where the file says {}",
                file.value
            );
            let error = Error::refused(what).expected("joints that stand upright along the file's own axis");
            refuse(
                error.hint("--capture-up, or a skeleton with the usual names (Hips, LeftArm, LeftForeArm, …)"),
                options,
                notes,
            )?;
            Evidence::Shape
        }
        Some(file) if confidence < 0.8 => return Ok(file),
        Some(file) => {
            notes.warn(format!("the capture file says {} is up, its joints say {axis}: the joints are believed", file.value));
            Evidence::Shape
        }
        None => Evidence::Shape,
    };
    Ok(Known::new(axis, how))
}

/// Toes before the ankles, or left and right are exchanged.
fn check_toes(rig: &Rig<'_>, cast: &Cast, frames: &[usize], up: DVec3, options: &Options, notes: &mut Notes) -> Result<()> {
    let mut cosines = Vec::new();
    for &frame in frames {
        let pose = Pose::Frame(frame);
        let Some(left) = leftwards(rig, cast, pose, up) else { continue };
        let forward = left.cross(up);
        for leg in &cast.legs {
            let Some(toe) = leg.toe else { continue };
            if let (Some(a), Some(b)) = (rig.place(pose, leg.ankle), rig.place(pose, toe)) {
                let foot = (b - a) - up * (b - a).dot(up);
                cosines.extend(foot.try_normalize().map(|d| d.dot(forward)));
            }
        }
    }
    let Some(median) = quantile(&mut cosines, 0.5) else { return Ok(()) };
    if median < -0.3 {
        let error = Error::new(
            Kind::Ambiguous,
            format!("the toes point backwards as left and right are named ({median:+.2}): mirrored axes or swapped names"),
        )
        .expected("+0.3 or more")
        .hint("--mirror when the capture's axes are mirrored, --swap-sides when its names are");
        return refuse(error, options, notes);
    }
    if median < 0.3 {
        notes.warn(format!("the toes do not tell the front ({median:+.2}): check the facing, --yaw turns it"));
    }
    Ok(())
}
