//! What a GLB of a thing made of parts holds, read by the letter of the format.

use crate::arm::{self, View};
use crate::common::{read_pc2, retarget_ok};
use glam::{DQuat, DVec3};
use retarget::glam;

/// How far a vertex may be off: 0.25 % of the diagonal of the arm, which is 1.9 long and 0.3 wide …
const SOFT: f64 = 4.8e-3;
/// … and what the rounding of a turn to 1/32767 does to a part of 0.7.
const RIGID: f64 = 5e-5;

/// Translation and rotation of a node in its parent.
type Key = (DVec3, DQuat);

fn wide(p: [f32; 3]) -> DVec3 {
    DVec3::from(p.map(f64::from))
}

/// Keys of each node in each frame of the only animation.
fn keys(file: &gltf::Document, blob: &[u8]) -> Vec<Vec<Key>> {
    let resting = |node: gltf::Node<'_>| {
        let (at, turn, _) = node.transform().decomposed();
        (wide(at), DQuat::from_array(turn.map(f64::from)))
    };
    let animation = file.animations().next().expect("an animation");
    let frames = animation.samplers().next().expect("a track").input().count();
    let mut keys = vec![file.nodes().map(resting).collect::<Vec<_>>(); frames];
    for channel in animation.channels() {
        let node = channel.target().node().index();
        match channel.reader(|_| Some(blob)).read_outputs().expect("values") {
            gltf::animation::util::ReadOutputs::Translations(all) => all.enumerate().for_each(|(f, p)| keys[f][node].0 = wide(p)),
            gltf::animation::util::ReadOutputs::Rotations(all) => {
                let turns = all.into_f32().map(|q| DQuat::from_array(q.map(f64::from)).normalize());
                turns.enumerate().for_each(|(f, q)| keys[f][node].1 = q);
            }
            _ => panic!("neither scales nor morph targets are needed"),
        }
    }
    keys
}

/// Rigid parts leave as nodes though one part bends, and the part that bends as a skin; both are where the exact format has them.
#[test]
fn a_soft_forearm_leaves_as_a_skin_beside_the_nodes_of_the_other_parts() {
    let folder = tempfile::tempdir().expect("a folder");
    let at = folder.path();
    arm::write(at, &View::PLAIN, true);
    arm::write_table(&at.join("take.csv"), &View::PLAIN, &arm::takes(24)[1].1);
    let said = retarget_ok(at, ["arm.obj", "take.csv", "--rig", "rig.toml", "-o", "out.glb", "-o", "out.pc2"]);
    assert!(said.contains("(3 rigid parts, skin, "), "{said}");
    let exact = read_pc2(&at.join("out.pc2"));
    let mut file = gltf::Gltf::open(at.join("out.glb")).expect("a GLB");
    let blob = file.blob.take().expect("a buffer");
    let skin = file.skins().next().expect("a skin");
    let joints: Vec<usize> = skin.joints().map(|n| n.index()).collect();
    let bind = skin.reader(|_| Some(&blob)).read_inverse_bind_matrices().expect("matrices");
    let back: Vec<DVec3> = bind.map(|m| wide([m[3][0], m[3][1], m[3][2]])).collect();
    let keys = keys(&file, &blob);
    assert_eq!(keys.len(), exact.len());
    let mut above = vec![None; file.nodes().count()];
    file.nodes().for_each(|n| n.children().for_each(|c| above[c.index()] = Some(n.index())));
    let carried = |f: usize, node: usize, p: DVec3| {
        let chain = std::iter::successors(Some(node), |n| above[*n]);
        chain.fold(p, |p, n| keys[f][n].1 * p + keys[f][n].0)
    };
    let rest = arm::rest();
    let (mut rigid, mut soft) = (Vec::new(), 0);
    for node in file.nodes() {
        let Some(mesh) = node.mesh() else { continue };
        for primitive in mesh.primitives() {
            let reader = primitive.reader(|_| Some(&blob));
            let points: Vec<DVec3> = reader.read_positions().expect("positions").map(wide).collect();
            let hooks = reader.read_joints(0).map(|j| j.into_u16().zip(reader.read_weights(0).expect("weights").into_f32()));
            let hooks: Option<Vec<([u16; 4], [f32; 4])>> = hooks.map(Iterator::collect);
            let (bound, name) = if hooks.is_some() { (SOFT, "fore") } else { (RIGID, node.name().expect("a name")) };
            let part = arm::PARTS.iter().position(|p| *p == name).expect("a part");
            match hooks {
                Some(_) => soft += points.len(),
                None => rigid.push(name),
            }
            let posed = |f: usize, i: usize| match &hooks {
                None => carried(f, node.index(), points[i]),
                Some(hooks) => {
                    let (on, weights) = hooks[i];
                    let moved = |k: usize| {
                        let joint = usize::from(on[k]);
                        carried(f, joints[joint], points[i] + back[joint]) * f64::from(weights[k])
                    };
                    (0..4).map(moved).sum()
                }
            };
            for i in 0..points.len() {
                // At rest, which is the first frame, everything is where the mesh has it.
                let far = |v: &usize| rest[*v].1.distance(posed(0, i));
                let own = (0..rest.len()).filter(|&v| rest[v].0 == part);
                let v = own.min_by(|a, b| far(a).total_cmp(&far(b))).expect("a vertex");
                for (f, exact) in exact.iter().enumerate() {
                    let off = posed(f, i).distance(wide(exact[v]));
                    assert!(off < bound, "{name}, frame {f}: {off} off");
                }
            }
        }
    }
    assert_eq!(rigid, ["base", "upper", "hand"]);
    assert!(soft > 0);
}
