//! Where the vertices of a node's mesh are at rest.

use super::Part;
use crate::error::{Error, Result};
use crate::gltf::{Attributes, Gltf, Node, affine};
use glam::{DAffine3, DVec3};
use std::collections::HashMap;
use std::rc::Rc;

/// Most joints and matrices of all skins together.
const MOST_JOINTS: usize = 1 << 20;

/// The maps of the joints of each skin that was met.
#[derive(Default)]
pub(super) struct Skins {
    known: HashMap<u32, Rc<[DAffine3]>>,
    joints: usize,
}

impl Skins {
    fn of(&mut self, index: u32, gltf: &Gltf, worlds: &[DAffine3]) -> Result<Rc<[DAffine3]>> {
        if let Some(known) = self.known.get(&index) {
            return Ok(known.clone());
        }
        let skin = Gltf::get(&gltf.document.skins, index, "skin")?;
        let matrices = skin.inverse_bind_matrices.map(|a| gltf.accessor(a)).transpose()?.map_or(0, |a| a.count as usize);
        self.joints = self.joints.saturating_add(skin.joints.len().max(matrices));
        if self.joints > MOST_JOINTS {
            return Err(Error::malformed(format!("skins with more than {MOST_JOINTS} joints")));
        }
        let inverse = skin.inverse_bind_matrices.map(|accessor| gltf.floats::<16>(accessor)).transpose()?;
        if inverse.is_some() && matrices < skin.joints.len() {
            return Err(Error::malformed(format!("{matrices} inverse bind matrices for {} joints", skin.joints.len())));
        }
        let map = |(k, &joint): (usize, &u32)| {
            let world = Gltf::get(worlds, joint, "node")?;
            Ok(inverse.as_ref().map_or(*world, |inverse| *world * affine(&inverse[k])))
        };
        let maps: Rc<[DAffine3]> = skin.joints.iter().enumerate().map(map).collect::<Result<Vec<_>>>()?.into();
        self.known.insert(index, maps.clone());
        Ok(maps)
    }
}

/// The placement of a mesh: by its node, or by the joints of its skin.
pub(super) struct Place {
    world: DAffine3,
    /// The map of each joint; empty without a skin.
    joints: Rc<[DAffine3]>,
    /// Whether it turns faces inside out.
    pub(super) mirrors: bool,
}

impl Place {
    /// The placement of node `n`. The place of a skinned mesh's own node does not count.
    pub(super) fn of(gltf: &Gltf, n: u32, node: &Node, worlds: &[DAffine3], skins: &mut Skins) -> Result<Self> {
        let world = worlds[n as usize];
        let joints = node.skin.map(|skin| skins.of(skin, gltf, worlds)).transpose()?.unwrap_or_default();
        let mirrors = joints.first().unwrap_or(&world).matrix3.determinant() < 0.0;
        Ok(Self { world, joints, mirrors })
    }

    /// Puts the vertices in place; returns how many of a skinned mesh have no weight.
    ///
    /// A vertex goes where the mean of its joints takes it, weighted as the file says; weights count by their share of their sum.
    pub(super) fn put(&self, gltf: &Gltf, attributes: &Attributes, points: &mut [DVec3]) -> Result<usize> {
        let influences = Influences::of(gltf, attributes, points.len(), self.joints.is_empty())?;
        let mut unweighted = 0;
        for (v, point) in points.iter_mut().enumerate() {
            let (mut sum, mut total) = (DVec3::ZERO, 0.0);
            for (joint, weight) in influences.of_vertex(v) {
                sum += weight * Gltf::get(&self.joints, joint, "joint")?.transform_point3(*point);
                total += weight;
            }
            unweighted += usize::from(!influences.0.is_empty() && total == 0.0);
            *point = if total == 0.0 { self.world.transform_point3(*point) } else { sum / total };
        }
        Ok(unweighted)
    }
}

/// Joints and weights of the vertices of a primitive, by the file's sets of four.
struct Influences(Vec<Four>);

struct Four {
    joints: Vec<[u32; 4]>,
    weights: Vec<[f64; 4]>,
}

impl Influences {
    fn of(gltf: &Gltf, attributes: &Attributes, vertices: usize, rigid: bool) -> Result<Self> {
        let sets = [(attributes.joints_0, attributes.weights_0), (attributes.joints_1, attributes.weights_1)];
        let mut influences = Vec::new();
        for (joints, weights) in sets {
            if let (false, Some(joints), Some(weights)) = (rigid, joints, weights) {
                for accessor in [joints, weights] {
                    let count = gltf.accessor(accessor)?.count;
                    if count != vertices as u64 {
                        return Err(Error::malformed(format!(
                            "joints or weights of {count} vertices where there are {vertices}"
                        ))
                        .at(format!("accessor {accessor}")));
                    }
                }
                influences.push(Four { joints: gltf.integers(joints)?, weights: gltf.floats(weights)? });
            }
        }
        Ok(Self(influences))
    }

    /// Joints of a vertex with weights other than zero.
    fn of_vertex(&self, v: usize) -> impl Iterator<Item = (u32, f64)> {
        let all = self.0.iter().flat_map(move |four| four.joints[v].into_iter().zip(four.weights[v]));
        all.filter(|(_, weight)| *weight != 0.0)
    }
}

/// A node that holds a vertex.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Hold {
    /// The node.
    pub(crate) node: u32,
    /// The vertex in the space of the node.
    pub(crate) place: DVec3,
    /// Share of the node in where the vertex is.
    pub(crate) share: f64,
}

/// The nodes that hold the `wanted` vertices of a part, wherever the nodes go; `wanted` counts within the part.
pub(super) fn holds(gltf: &Gltf, part: &Part, wanted: impl Iterator<Item = u32>) -> Result<Vec<Vec<Hold>>> {
    let Some(position) = part.attributes.position else { return Ok(Vec::new()) };
    let points = gltf.floats::<3>(position)?;
    let still = vec![DAffine3::IDENTITY; gltf.document.nodes.len()];
    let binds = part.skin.map(|skin| Skins::default().of(skin, gltf, &still)).transpose()?.unwrap_or_default();
    let joints = part.skin.map(|skin| Gltf::get(&gltf.document.skins, skin, "skin")).transpose()?.map_or(&[][..], |s| &s.joints);
    let influences = Influences::of(gltf, &part.attributes, points.len(), binds.is_empty())?;
    wanted
        .map(|v| {
            let place = DVec3::from_array(points[v as usize]);
            let mut holds = Vec::new();
            for (joint, share) in influences.of_vertex(v as usize) {
                let place = Gltf::get(&binds, joint, "joint")?.transform_point3(place);
                holds.push(Hold { node: joints[joint as usize], place, share });
            }
            let total: f64 = holds.iter().map(|h| h.share).sum();
            if total == 0.0 {
                return Ok(vec![Hold { node: part.node, place, share: 1.0 }]);
            }
            holds.iter_mut().for_each(|h| h.share /= total);
            Ok(holds)
        })
        .collect()
}
