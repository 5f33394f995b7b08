//! Where the nodes of the scene are.

use super::{Gltf, Node};
use crate::error::{Error, Result};
use glam::{DAffine3, DMat3, DQuat, DVec3};

/// The placement of a node under its parent.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Turn {
    /// Translation.
    pub(crate) translation: DVec3,
    /// Rotation, of length 1.
    pub(crate) rotation: DQuat,
    /// Scale.
    pub(crate) scale: DVec3,
}

impl Node {
    /// Its placement under its parent at rest.
    pub(crate) fn local(&self) -> DAffine3 {
        match &self.matrix {
            Some(m) => affine(m),
            None => {
                let turn = self.turn();
                DAffine3::from_scale_rotation_translation(turn.scale, turn.rotation, turn.translation)
            }
        }
    }

    /// Its placement under its parent at rest by parts. A matrix with shear loses the shear.
    pub(crate) fn turn(&self) -> Turn {
        if let Some(m) = &self.matrix {
            let (scale, rotation, translation) = affine(m).to_scale_rotation_translation();
            let sound = scale.is_finite() && rotation.is_finite() && (rotation.length_squared() - 1.0).abs() < 1e-6;
            return Turn { translation, rotation: if sound { rotation } else { DQuat::IDENTITY }, scale };
        }
        let rotation = self.rotation.as_deref().map_or(DQuat::IDENTITY, |&q| DQuat::from_array(q));
        Turn {
            translation: self.translation.as_deref().map_or(DVec3::ZERO, |&t| t.into()),
            rotation: if rotation.length_squared() > 0.0 { rotation.normalize() } else { DQuat::IDENTITY },
            scale: self.scale.as_deref().map_or(DVec3::ONE, |&s| s.into()),
        }
    }
}

/// The affine map of a 4 × 4 matrix, column by column; its last row counts as 0 0 0 1.
pub(crate) fn affine(m: &[f64; 16]) -> DAffine3 {
    let column = |k: usize| DVec3::new(m[4 * k], m[4 * k + 1], m[4 * k + 2]);
    DAffine3 { matrix3: DMat3::from_cols(column(0), column(1), column(2)), translation: column(3) }
}

/// The tree of nodes.
#[derive(Debug)]
pub(crate) struct Hierarchy {
    /// Parent of each node.
    pub(crate) parents: Vec<Option<u32>>,
    /// Nodes of the scene, parents before children, in the order of the file's lists.
    pub(crate) shown: Vec<u32>,
    /// Placement of every node in the world at rest, whether it is shown or not.
    pub(crate) worlds: Vec<DAffine3>,
}

impl Gltf {
    /// The tree of nodes. Shown is the file's scene, or its first; all nodes where there is none.
    ///
    /// # Errors
    /// Nodes that do not exist, have two parents, or are their own ancestors.
    pub(crate) fn hierarchy(&self) -> Result<Hierarchy> {
        let nodes = &self.document.nodes;
        let mut parents = vec![None; nodes.len()];
        for (parent, node) in nodes.iter().enumerate() {
            for &child in &node.children {
                Self::get(nodes, child, "node").map_err(|e| e.at(format!("node {parent}")))?;
                if parents[child as usize].replace(parent as u32).is_some() {
                    return Err(Error::malformed(format!("node {child} has two parents")).at(format!("node {child}")));
                }
            }
        }
        let roots: Vec<u32> = (0..nodes.len() as u32).filter(|&n| parents[n as usize].is_none()).collect();
        let order = self.below(&roots);
        // With one parent each, nodes that no root leads to form rings.
        if order.len() < nodes.len() {
            return Err(Error::malformed("nodes that are their own ancestors").expected("a tree of nodes"));
        }
        let mut worlds = vec![DAffine3::IDENTITY; nodes.len()];
        for &n in &order {
            let local = nodes[n as usize].local();
            worlds[n as usize] = match parents[n as usize] {
                Some(parent) => worlds[parent as usize] * local,
                None => local,
            };
        }
        let scene = self.document.scene.map(|s| Self::get(&self.document.scenes, s, "scene")).transpose()?;
        let shown = match scene.or(self.document.scenes.first()) {
            None => order,
            Some(scene) => {
                for &root in &scene.nodes {
                    Self::get(nodes, root, "node")?;
                }
                self.below(&scene.nodes)
            }
        };
        Ok(Hierarchy { parents, shown, worlds })
    }

    /// `roots` and all nodes below them, depth first, each once.
    fn below(&self, roots: &[u32]) -> Vec<u32> {
        let mut seen = vec![false; self.document.nodes.len()];
        let mut order = Vec::new();
        let mut stack: Vec<u32> = roots.iter().rev().copied().collect();
        while let Some(n) = stack.pop() {
            if !std::mem::replace(&mut seen[n as usize], true) {
                order.push(n);
                stack.extend(self.document.nodes[n as usize].children.iter().rev());
            }
        }
        order
    }
}
