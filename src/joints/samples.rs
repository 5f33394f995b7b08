//! Points of a surface with their normals and areas.

use crate::linalg::eigen;
use glam::DVec3;

/// Points with unit normals and weights (areas).
#[derive(Clone, Debug, Default)]
pub struct Samples {
    /// Places.
    pub points: Vec<DVec3>,
    /// Unit normals.
    pub normals: Vec<DVec3>,
    /// Areas that the points stand for.
    pub weights: Vec<f64>,
}

impl Samples {
    /// Number of points.
    pub fn len(&self) -> usize {
        self.points.len()
    }

    /// Whether there is no point.
    pub fn is_empty(&self) -> bool {
        self.points.is_empty()
    }

    /// Adds a point.
    pub fn push(&mut self, point: DVec3, normal: DVec3, weight: f64) {
        self.points.push(point);
        self.normals.push(normal);
        self.weights.push(weight);
    }

    /// Adds those of another that pass.
    pub fn extend(&mut self, other: &Samples, mut passes: impl FnMut(DVec3, DVec3) -> bool) {
        for (p, n, w) in other.iter() {
            if passes(p, n) {
                self.push(p, n, w);
            }
        }
    }

    /// Point, normal and weight of each.
    pub fn iter(&self) -> impl Iterator<Item = (DVec3, DVec3, f64)> + '_ {
        self.points.iter().zip(&self.normals).zip(&self.weights).map(|((p, n), w)| (*p, *n, *w))
    }

    /// Sum of the weights.
    pub fn area(&self) -> f64 {
        self.weights.iter().sum()
    }

    /// Their mean place, weighted; zero where there is none.
    pub fn centre(&self) -> DVec3 {
        let area = self.area();
        if area > 0.0 { self.iter().map(|(p, _, w)| p * w).sum::<DVec3>() / area } else { DVec3::ZERO }
    }

    /// Principal axes of the places, by falling variance, and the variances.
    pub fn principal(&self) -> ([DVec3; 3], [f64; 3]) {
        let centre = self.centre();
        let area = self.area().max(f64::MIN_POSITIVE);
        let mut matrix = [[0.0; 3]; 3];
        for (p, _, w) in self.iter() {
            let d = (p - centre).to_array();
            for i in 0..3 {
                for j in 0..3 {
                    matrix[i][j] += w / area * d[i] * d[j];
                }
            }
        }
        let (values, vectors) = eigen::symmetric(matrix);
        ([2, 1, 0].map(|k| DVec3::from(vectors[k])), [2, 1, 0].map(|k| values[k]))
    }
}
