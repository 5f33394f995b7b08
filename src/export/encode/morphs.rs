//! Morph targets in the numbers that a file holds: what is added to positions at rest, weighted anew in every frame.

use super::table::{Growing, Table};
use crate::error::Result;
use glam::DVec3;
use rayon::prelude::*;

/// Vertices of one piece of work.
const PIECE: usize = 4096;

/// Morph targets and their weights. In most frames most weights of corrective targets are 0.
#[derive(Clone, Debug)]
pub struct Morphs {
    /// The targets.
    pub targets: Vec<Target>,
    /// Their weights in every frame; `None` without targets.
    weights: Option<Table<f32>>,
    frames: usize,
}

/// What a weight of 1 adds.
#[derive(Clone, Debug, PartialEq)]
pub enum Target {
    /// To some vertices, ascending, by their places in the skin.
    Sparse(Vec<u32>, Vec<[f32; 3]>),
    /// To every vertex.
    Dense(Vec<[f32; 3]>),
}

impl Morphs {
    /// No target.
    pub fn none(frames: usize) -> Self {
        Self { targets: Vec::new(), weights: None, frames }
    }

    /// Targets with a row of weights per frame.
    pub fn new(targets: Vec<Target>, weights: Table<f32>) -> Self {
        assert_eq!(targets.len(), weights.columns());
        if targets.is_empty() {
            return Self::none(weights.frames());
        }
        Self { frames: weights.frames(), targets, weights: Some(weights) }
    }

    /// Number of frames.
    pub fn frames(&self) -> usize {
        self.frames
    }

    /// Weights of all targets in a frame.
    pub fn weights(&self, frame: usize) -> Result<Vec<f32>> {
        self.weights.as_ref().map_or(Ok(Vec::new()), |table| table.frame(frame))
    }

    /// These targets and more, with their weights in every frame.
    pub fn with(self, more: Vec<Target>, folder: &std::path::Path, weights: impl Fn(usize) -> Vec<f32>) -> Result<Self> {
        let mut all = Growing::new(folder, self.targets.len() + more.len())?;
        for frame in 0..self.frames {
            let mut row = self.weights(frame)?;
            row.extend(weights(frame));
            all.push(&row)?;
        }
        let mut targets = self.targets;
        targets.extend(more);
        Ok(Self::new(targets, all.finish()?))
    }

    /// The same targets of vertices that are among others; `places`: where.
    pub fn of_places(self, places: &[u32]) -> Self {
        let moved = |target| match target {
            Target::Sparse(vertices, offsets) => Target::Sparse(vertices.iter().map(|&v| places[v as usize]).collect(), offsets),
            Target::Dense(offsets) => Target::Sparse(places.to_vec(), offsets),
        };
        Self { targets: self.targets.into_iter().map(moved).collect(), ..self }
    }

    /// Positions of a frame before the joints move them, from those at rest; `None` where they are the same.
    pub fn apply(&self, frame: usize, rest: &[[f32; 3]]) -> Result<Option<Vec<DVec3>>> {
        let weights = self.weights(frame)?;
        if weights.iter().all(|&w| w == 0.0) {
            return Ok(None);
        }
        let wide = |p: &[f32; 3]| DVec3::from_array(p.map(f64::from));
        let mut moved: Vec<DVec3> = rest.iter().map(wide).collect();
        let active = || self.targets.iter().zip(&weights).filter(|(_, w)| **w != 0.0).map(|(t, &w)| (t, f64::from(w)));
        moved.par_chunks_mut(PIECE).enumerate().for_each(|(piece, moved)| {
            for (target, w) in active() {
                if let Target::Dense(offsets) = target {
                    moved.iter_mut().zip(&offsets[piece * PIECE..]).for_each(|(p, o)| *p += wide(o) * w);
                }
            }
        });
        for (target, w) in active() {
            if let Target::Sparse(vertices, offsets) = target {
                vertices.iter().zip(offsets).for_each(|(&v, o)| moved[v as usize] += wide(o) * w);
            }
        }
        Ok(Some(moved))
    }
}

impl Target {
    /// What is added to vertices by their places in the skin, ascending; `None` if that are all.
    #[cfg(test)]
    pub fn vertices(&self) -> Option<&[u32]> {
        match self {
            Self::Sparse(vertices, _) => Some(vertices),
            Self::Dense(_) => None,
        }
    }

    /// What a weight of 1 adds to a vertex.
    pub fn offset(&self, vertex: u32) -> [f32; 3] {
        match self {
            Self::Sparse(vertices, offsets) => vertices.binary_search(&vertex).map_or([0.0; 3], |at| offsets[at]),
            Self::Dense(offsets) => offsets[vertex as usize],
        }
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    #[test]
    fn targets_of_some_vertices_keep_to_them_among_others() {
        let folder = tempfile::tempdir().unwrap();
        let dense = Target::Dense(vec![[1.0, 0.0, 0.0], [2.0, 0.0, 0.0], [3.0, 0.0, 0.0]]);
        let sparse = Target::Sparse(vec![0, 2], vec![[4.0, 0.0, 0.0], [5.0, 0.0, 0.0]]);
        let own = Morphs::none(1).with(vec![sparse, dense], folder.path(), |_| vec![0.5, 1.0]).unwrap();
        let moved = own.of_places(&[1, 4, 6]);
        assert_eq!(moved.targets[0], Target::Sparse(vec![1, 6], vec![[4.0, 0.0, 0.0], [5.0, 0.0, 0.0]]));
        let x: Vec<f64> = moved.apply(0, &[[0.0; 3]; 7]).unwrap().unwrap().iter().map(|p| p.x).collect();
        assert_eq!(x, [0.0, 3.0, 0.0, 0.0, 2.0, 0.0, 5.5]);
    }

    #[test]
    fn targets_add_up_by_their_weights() {
        let folder = tempfile::tempdir().unwrap();
        let dense = Target::Dense(vec![[1.0, 0.0, 0.0], [0.0, 2.0, 0.0]]);
        let sparse = Target::Sparse(vec![1], vec![[0.0, 0.0, 4.0]]);
        let one = Morphs::none(3).with(vec![dense], folder.path(), |f| vec![f as f32]).unwrap();
        let both = one.with(vec![sparse.clone()], folder.path(), |f| vec![if f == 1 { 0.5 } else { 0.0 }]).unwrap();
        let rest = [[10.0, 0.0, 0.0], [20.0, 0.0, 0.0]];
        assert_eq!(both.apply(0, &rest).unwrap(), None);
        assert_eq!(both.apply(1, &rest).unwrap().unwrap(), [DVec3::new(11.0, 0.0, 0.0), DVec3::new(20.0, 2.0, 2.0)]);
        assert_eq!(both.apply(2, &rest).unwrap().unwrap()[1], DVec3::new(20.0, 4.0, 0.0));
        assert_eq!(both.weights(1).unwrap(), [1.0, 0.5]);
        assert_eq!((sparse.offset(0), sparse.offset(1)), ([0.0; 3], [0.0, 0.0, 4.0]));
    }
}
