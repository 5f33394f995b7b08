//! A reach to the side with a bow, as a table of handles that move and turn.

use super::body::{ARM, Bone, CHEST, HEAD, LEG, PELVIS};
use super::motion::{chain, ease};
use glam::{DMat3, DQuat, DVec3};
use std::fmt::Write;

/// Frames in the take, numbered from 1; the first is the rest pose.
pub const FRAMES: usize = 60;

/// Rotation and origin of every bone in a frame, counted from 0.
pub fn pose(bones: &[Bone], frame: usize) -> Vec<(DMat3, DVec3)> {
    let t = frame as f64 / (FRAMES - 1) as f64;
    let (bow, turn, back) = (ease(t, 0.0, 0.6), ease(t, 0.1, 0.8), ease(t, 0.6, 1.0));
    let mut local = vec![DQuat::IDENTITY; bones.len()];
    local[PELVIS] = DQuat::from_rotation_x(0.15 * bow);
    local[CHEST] = DQuat::from_rotation_y(0.5 * turn) * DQuat::from_rotation_x(0.35 * bow - 0.3 * back);
    local[HEAD] = DQuat::from_rotation_y(0.6 * turn) * DQuat::from_rotation_x(-0.2 * bow);
    local[ARM[0]] = DQuat::from_rotation_z(0.8 * turn) * DQuat::from_rotation_y(-0.3 * bow);
    let along = (bones[ARM[0] + 2].to - bones[ARM[0] + 2].from).normalize();
    local[ARM[0] + 2] = DQuat::from_axis_angle(along, 0.7 * turn);
    local[ARM[1]] = DQuat::from_rotation_x(-0.5 * bow);
    for leg in LEG {
        local[leg] = DQuat::from_rotation_x(-0.15 * bow);
    }
    chain(bones, &local, DVec3::new(0.0, 0.0, -0.03 * bow))
}

/// The table: frames inside of pelvis, head, hands and feet, a frame outside in front of the chest, and a point on either elbow. One hand is not told
/// in some frames.
pub fn csv(bones: &[Bone]) -> String {
    let mut csv = "# a reach to the left, in the space of scan.obj\nframe,name,x,y,z,qx,qy,qz,qw\n".to_owned();
    let middle = |bone: usize| bones[bone].from.lerp(bones[bone].to, 0.5);
    let frames = [
        ("pelvis", PELVIS, middle(PELVIS)),
        ("chest", CHEST, DVec3::new(0.0, 1.32, 0.17)),
        ("head", HEAD, bones[HEAD].from.lerp(bones[HEAD].to, 0.8)),
        ("left hand", ARM[0] + 2, middle(ARM[0] + 2)),
        ("right hand", ARM[1] + 2, middle(ARM[1] + 2)),
        ("left foot", LEG[0] + 2, bones[LEG[0] + 2].from.lerp(bones[LEG[0] + 2].to, 0.4)),
        ("right foot", LEG[1] + 2, bones[LEG[1] + 2].from.lerp(bones[LEG[1] + 2].to, 0.4)),
    ];
    let points = [("left elbow", ARM[0]), ("right elbow", ARM[1])];
    for frame in 0..FRAMES {
        let pose = pose(bones, frame);
        let at = |bone: usize, p: DVec3| pose[bone].0 * (p - bones[bone].from) + pose[bone].1;
        for (name, bone, rest) in frames {
            if name == "right hand" && (24..30).contains(&frame) {
                continue;
            }
            let (p, q) = (at(bone, rest), DQuat::from_mat3(&pose[bone].0).normalize());
            let q = if q.w < 0.0 { -q } else { q };
            let _ = writeln!(
                csv,
                "{},{name},{:.5},{:.5},{:.5},{:.6},{:.6},{:.6},{:.6}",
                frame + 1,
                p.x,
                p.y,
                p.z,
                q.x,
                q.y,
                q.z,
                q.w
            );
        }
        for (name, bone) in points {
            let p = at(bone, bones[bone].to);
            let _ = writeln!(csv, "{},{name},{:.5},{:.5},{:.5},,,,", frame + 1, p.x, p.y, p.z);
        }
    }
    csv
}
