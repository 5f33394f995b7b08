//! A walk and a squat for the body's skeleton, and the skin that follows by linear blending.

use super::body::{ARM, Body, Bone, CHEST, HEAD, LEG, PELVIS};
use glam::{DMat3, DQuat, DVec3};
use std::f64::consts::TAU;

/// Frames per second.
pub const RATE: f64 = 120.0;
/// Frames in the take.
pub const FRAMES: usize = 372;

/// Goes from 0 at `from` to 1 at `to` with level ends.
pub fn ease(t: f64, from: f64, to: f64) -> f64 {
    let s = ((t - from) / (to - from)).clamp(0.0, 1.0);
    s * s * s * (10.0 - 15.0 * s + 6.0 * s * s)
}

/// How much of the walk is on at a time.
fn walking(t: f64) -> f64 {
    ease(t, 0.1, 0.5) * (1.0 - ease(t, 1.7, 2.05))
}

/// Rotation and origin of every bone in a frame; frame 0 is the rest pose.
pub fn pose(bones: &[Bone], frame: usize) -> Vec<(DMat3, DVec3)> {
    let t = frame as f64 / RATE;
    let walk = walking(t);
    let squat = ease(t, 2.0, 2.5) * (1.0 - ease(t, 2.6, 3.05));
    let phase = TAU * 1.05 * t;
    let x = |angle: f64| DQuat::from_rotation_x(angle);
    let mut local = vec![DQuat::IDENTITY; bones.len()];
    local[PELVIS] =
        DQuat::from_rotation_y(0.10 * walk * phase.sin()) * DQuat::from_rotation_z(0.03 * walk * phase.cos()) * x(0.45 * squat);
    local[CHEST] = DQuat::from_rotation_y(-0.20 * walk * phase.sin()) * x(0.10 * squat);
    local[HEAD] = DQuat::from_rotation_y(0.10 * walk * phase.sin()) * x(-0.45 * squat);
    for (side, sign) in [1.0, -1.0].into_iter().enumerate() {
        let swing = (phase + side as f64 * TAU / 2.0).sin();
        let lag = (phase + side as f64 * TAU / 2.0 - 0.9).sin();
        let lowered = DQuat::from_rotation_z(-sign * 0.55 * walk.max(0.3 * squat));
        local[ARM[side]] = x(-0.45 * walk * -swing - 1.0 * squat) * lowered;
        let hinge = (bones[ARM[side]].to - bones[ARM[side]].from).cross(DVec3::Z).normalize();
        local[ARM[side] + 1] = DQuat::from_axis_angle(hinge, (0.35 + 0.25 * -swing) * walk + 0.5 * squat);
        local[LEG[side]] = x(-0.48 * walk * swing - 1.75 * squat);
        local[LEG[side] + 1] = x(0.55 * walk * (1.0 - lag) * 0.8 + 1.95 * squat);
        local[LEG[side] + 2] = x(-0.15 * walk * lag - 0.68 * squat);
    }
    let travel: f64 = (0..frame).map(|f| 1.15 / RATE * walking(f as f64 / RATE)).sum();
    let bob = -0.025 * walk * (1.0 - (2.0 * phase).cos()) * 0.5 - 0.36 * squat;
    chain(bones, &local, DVec3::new(0.02 * walk * phase.cos(), bob, travel - 0.10 * squat))
}

/// Rotation and origin of every bone, from turns against the parents and the shift of the pelvis.
pub fn chain(bones: &[Bone], local: &[DQuat], shift: DVec3) -> Vec<(DMat3, DVec3)> {
    let mut out: Vec<(DMat3, DVec3)> = Vec::with_capacity(bones.len());
    for (b, bone) in bones.iter().enumerate() {
        if b == PELVIS {
            out.push((DMat3::from_quat(local[b]), bone.from + shift));
        } else {
            let parent = &bones[bone.parent];
            let (rotation, origin) = out[bone.parent];
            out.push((rotation * DMat3::from_quat(local[b]), origin + rotation * (bone.from - parent.from)));
        }
    }
    out
}

/// The skin in a frame.
pub fn skin(body: &Body, bones: &[Bone], frame: usize) -> Vec<DVec3> {
    posed(body, bones, &pose(bones, frame))
}

/// The skin on bones in a pose.
pub fn posed(body: &Body, bones: &[Bone], pose: &[(DMat3, DVec3)]) -> Vec<DVec3> {
    body.points
        .iter()
        .zip(&body.weights)
        .map(|(&p, weights)| weights.iter().map(|&(b, w)| (pose[b].0 * (p - bones[b].from) + pose[b].1) * w).sum())
        .collect()
}
