//! A skin in the numbers that a file holds, and the skinning matrices that a player makes of them.

use super::Influences;
use super::motion::Motion;
use super::table::{Growing, Table};
use super::tracks::Tracks;
use crate::error::Result;
use bytemuck::{Pod, Zeroable};
use glam::{DMat3, DQuat, DVec3};
use rayon::prelude::*;
use std::path::Path;

/// From the unit box to the coordinates of the file: `u · scale + shift`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FileSpace {
    /// Length of the diagonal in the file's unit.
    pub scale: f64,
    /// Where the centre of the box is in the file.
    pub shift: DVec3,
}

impl FileSpace {
    /// Coordinates of the file.
    pub fn leave(&self, u: DVec3) -> DVec3 {
        u * self.scale + self.shift
    }
}

/// Node 0 is the root, which carries the motion of the whole; nodes 1 and up are its children, the joints of the fit in their order.
/// No vertex hangs on node 0, unless there are no joints: then all do.
#[derive(Clone, Debug)]
pub struct Skin {
    /// Where nodes are at rest, in the file's coordinates; they have no rotation there. Rest is the pose of binding.
    pub pivots: Vec<[f32; 3]>,
    /// Translation from the root to each node at rest; for the root, from the origin.
    pub rest_translations: Vec<[f32; 3]>,
    /// Place of each node in its parent in every frame.
    pub keys: Table<Key>,
    /// Four nodes per vertex, heaviest first, 0 where the weight is 0.
    pub joints: Vec<[u16; 4]>,
    /// Their weights in units of 1/levels; each four sum to `levels`.
    pub weights: Vec<[u16; 4]>,
    /// Steps of a weight from 0 to 1: 255 or 65535.
    pub levels: u16,
}

/// Place of a node in its parent.
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct Key {
    /// x, y, z, w in units of 1/32767.
    pub rotation: [i16; 4],
    /// In the file's unit.
    pub translation: [f32; 3],
}

/// `x ↦ linear · x + offset` in the file's coordinates.
#[derive(Clone, Copy, Debug)]
pub struct Matrix {
    /// Columns of the linear part.
    pub linear: DMat3,
    /// Added after it.
    pub offset: DVec3,
}

impl Skin {
    /// Rounds a fitted skin. `rest`: vertices at rest in the unit box, as many as `influences`; without influences all hang on the root.
    ///
    /// Pivots lie in the middle of their joint's weights: between two keys a player interpolates rotation and translation each for itself, and far
    /// from the pivot the two would not fit together.
    pub fn new(
        motion: &Motion<'_>,
        tracks: &Tracks,
        rest: &[DVec3],
        influences: &[Influences],
        space: FileSpace,
        levels: u16,
    ) -> Result<Self> {
        let middle = rest.iter().sum::<DVec3>() / rest.len().max(1) as f64;
        let mut sums = vec![(DVec3::ZERO, 0.0); tracks.joints()];
        for (&p, influence) in rest.iter().zip(influences) {
            for (k, w) in influence.iter() {
                sums[k].0 += p * (w * w);
                sums[k].1 += w * w;
            }
        }
        let pivots: Vec<DVec3> =
            std::iter::once(middle).chain(sums.iter().map(|&(s, w)| if w > 0.0 { s / w } else { middle })).collect();
        let local = |k: usize| (pivots[k] - middle) * space.scale;
        let mut keys = Growing::new(motion.spool.folder(), pivots.len())?;
        let mut before: Vec<Key> = Vec::new();
        for f in 0..tracks.frames() {
            let root = motion.roots[f];
            let mut now = vec![Key::new(&root.rotation, space.leave(root.apply(middle)))];
            now.extend(tracks.motions(f)?.iter().zip(&pivots[1..]).map(|(joint, &pivot)| {
                let place = (joint.apply(pivot) - middle) * space.scale;
                Key::new(&joint.rotation, place)
            }));
            now.iter_mut().zip(&before).for_each(|(key, before)| key.follow(before));
            keys.push(&now)?;
            before = now;
        }
        let mut skin = Self {
            pivots: pivots.iter().map(|&p| space.leave(p).as_vec3().to_array()).collect(),
            rest_translations: (0..pivots.len())
                .map(|k| if k == 0 { space.leave(middle) } else { local(k) }.as_vec3().to_array())
                .collect(),
            keys: keys.finish()?,
            joints: vec![[0; 4]; rest.len()],
            weights: vec![[levels, 0, 0, 0]; rest.len()],
            levels,
        };
        skin.joints.par_iter_mut().zip(&mut skin.weights).zip(influences).for_each(|((joints, weights), influence)| {
            (*joints, *weights) = round(influence, levels);
        });
        Ok(skin)
    }

    /// This skin and another one over the same motion as one: its joints and vertices, then those of the other under the same root. `places`: of the
    /// vertices of both in the whole.
    pub fn beside(&self, other: &Self, places: [&[u32]; 2], folder: &Path) -> Result<Self> {
        let wide = |p: [f32; 3]| DVec3::from_array(p.map(f64::from));
        let shift = wide(other.pivots[0]) - wide(self.pivots[0]);
        let moved = |p: [f32; 3]| (wide(p) + shift).as_vec3().to_array();
        let mut keys = Growing::new(folder, self.nodes() + other.nodes() - 1)?;
        for f in 0..self.frames() {
            let mut row = self.keys.frame(f)?;
            let others = other.keys.frame(f)?;
            row.extend(others[1..].iter().map(|key| Key { translation: moved(key.translation), ..*key }));
            keys.push(&row)?;
        }
        let count = places[0].len() + places[1].len();
        let (mut joints, mut weights) = (vec![[0; 4]; count], vec![[0; 4]; count]);
        let before = (self.nodes() - 1) as u16;
        for ((skin, places), before) in [self, other].into_iter().zip(places).zip([0, before]) {
            for (k, &place) in places.iter().enumerate() {
                joints[place as usize] = skin.joints[k].map(|node| if node > 0 { node + before } else { 0 });
                weights[place as usize] = skin.weights[k];
            }
        }
        let after = |own: &[[f32; 3]], others: Vec<[f32; 3]>| [own, &others].concat();
        Ok(Self {
            pivots: after(&self.pivots, other.pivots[1..].to_vec()),
            rest_translations: after(&self.rest_translations, other.rest_translations[1..].iter().map(|&t| moved(t)).collect()),
            keys: keys.finish()?,
            joints,
            weights,
            levels: self.levels,
        })
    }

    /// Number of nodes, the root included.
    pub fn nodes(&self) -> usize {
        self.pivots.len()
    }

    /// Number of frames.
    pub fn frames(&self) -> usize {
        self.keys.frames()
    }

    /// Replaces the weights of a vertex.
    pub fn set_influences(&mut self, vertex: usize, influences: &Influences) {
        (self.joints[vertex], self.weights[vertex]) = round(influences, self.levels);
    }

    /// What a vertex hangs on, as written, in joints of the fit.
    pub fn influences(&self, vertex: usize) -> Influences {
        let mut influences = Influences::default();
        for k in 0..4 {
            influences.joints[k] = self.joints[vertex][k].saturating_sub(1);
            influences.weights[k] = f64::from(self.weights[vertex][k]) / f64::from(self.levels);
        }
        influences
    }

    /// The nodes' skinning matrices of a frame, decoded.
    pub fn matrices(&self, frame: usize) -> Result<Vec<Matrix>> {
        let keys = self.keys.frame(frame)?;
        let local = |k: usize| {
            let [x, y, z, w] = keys[k].rotation.map(|c| (f64::from(c) / 32767.0).max(-1.0));
            let [a, b, c] = keys[k].translation.map(f64::from);
            Matrix { linear: DMat3::from_quat(DQuat::from_xyzw(x, y, z, w).normalize()), offset: DVec3::new(a, b, c) }
        };
        let root = local(0);
        Ok((0..keys.len())
            .map(|k| {
                let global = if k == 0 {
                    root
                } else {
                    let joint = local(k);
                    Matrix { linear: root.linear * joint.linear, offset: root.linear * joint.offset + root.offset }
                };
                let [a, b, c] = self.pivots[k].map(f64::from);
                Matrix { linear: global.linear, offset: global.offset - global.linear * DVec3::new(a, b, c) }
            })
            .collect())
    }
}

impl Key {
    fn new(rotation: &DMat3, translation: DVec3) -> Self {
        let unit = DQuat::from_mat3(rotation).normalize().to_array();
        Self { rotation: unit.map(|c| (c * 32767.0).round() as i16), translation: translation.as_vec3().to_array() }
    }

    /// Both signs are the same rotation; a player goes the short way only between neighbours of one sign.
    fn follow(&mut self, before: &Self) {
        let along: i64 = self.rotation.iter().zip(before.rotation).map(|(&a, b)| i64::from(a) * i64::from(b)).sum();
        if along < 0 {
            self.rotation = self.rotation.map(|c| -c);
        }
    }
}

/// Weights in steps of 1/levels that sum to `levels` (largest remainder), heaviest first, and the nodes they belong to.
fn round(influences: &Influences, levels: u16) -> ([u16; 4], [u16; 4]) {
    let total: f64 = influences.weights.iter().sum();
    let exact = influences.weights.map(|w| w / total * f64::from(levels));
    let mut whole = exact.map(|w| w.floor() as u32);
    let mut order = [0, 1, 2, 3];
    order.sort_by(|&a: &usize, &b| exact[b].fract().total_cmp(&exact[a].fract()).then(a.cmp(&b)));
    let missing = u32::from(levels).saturating_sub(whole.iter().sum());
    for &k in order.iter().cycle().filter(|&&k| exact[k] > 0.0).take(missing as usize) {
        whole[k] += 1;
    }
    order = [0, 1, 2, 3];
    order.sort_by(|&a, &b| whole[b].cmp(&whole[a]).then(a.cmp(&b)));
    let weights = order.map(|k| whole[k] as u16);
    let nodes = order.map(|k| if whole[k] > 0 { influences.joints[k] + 1 } else { 0 });
    (nodes, weights)
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    #[test]
    fn rounded_weights_sum_to_one_and_descend() {
        for seed in 0..500u32 {
            let x = |k: u32| f64::from((seed * 7919 + k * 104729) % 1000) / 1000.0 * f64::from(seed % (k + 2) + k % 2);
            let raw = [x(0) + 1e-3, x(1), x(2), x(3)];
            let total: f64 = raw.iter().sum();
            let influences = Influences { joints: [3, 9, 12, 40], weights: raw.map(|w| w / total) };
            let levels = if seed % 2 == 0 { 255 } else { 65535 };
            let (nodes, weights) = round(&influences, levels);
            assert_eq!(weights.iter().map(|&w| u32::from(w)).sum::<u32>(), u32::from(levels));
            assert!(weights.is_sorted_by(|a, b| a >= b));
            for k in 0..4 {
                assert_eq!(weights[k] == 0, nodes[k] == 0);
                if weights[k] > 0 {
                    let from = influences.joints.iter().position(|&j| j + 1 == nodes[k]).unwrap();
                    let step = 1.0 / f64::from(levels);
                    assert!((f64::from(weights[k]) * step - influences.weights[from]).abs() < 1.01 * step);
                }
            }
        }
    }
}
