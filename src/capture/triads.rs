//! Joints that a file of markers holds as three points each: an origin and the tips of two axes, `HEAD HEADY HEADZ`.

use super::labels::Selection;
use super::{Joint, MarkerTake, Rest, SkeletonTake};
use glam::{DMat3, DQuat, DVec3};
use std::collections::HashMap;

/// Cosine of the angle between the axes beyond which a frame shows no turn: integers that ran over move a tip.
const SKEW: f64 = 0.1;
/// Fewer triads than this may be markers that are called so.
const LEAST: usize = 4;

/// Columns of the triads of a subject.
pub(super) struct Triads {
    names: Vec<String>,
    columns: Vec<[usize; 3]>,
}

impl Triads {
    /// The triads, if all points of a selection are origins of them. `labels`: those of all columns as written.
    pub(super) fn of(labels: &[String], selection: &Selection) -> Option<Self> {
        let columns: HashMap<&str, usize> = labels.iter().map(String::as_str).zip(0..).collect();
        let tip = |column: usize, axis: char| columns.get(format!("{}{axis}", labels[column]).as_str()).copied();
        let triads = selection.columns.iter().map(|&c| Some([c, tip(c, 'Y')?, tip(c, 'Z')?]));
        let columns: Vec<[usize; 3]> = triads.collect::<Option<_>>()?;
        (columns.len() >= LEAST).then(|| Self { names: selection.labels.clone(), columns })
    }

    /// The columns to read, rising.
    pub(super) fn columns(&self) -> Vec<usize> {
        let mut columns = self.columns.concat();
        columns.sort_unstable();
        columns
    }

    /// Joints without a hierarchy, from the positions of [`Triads::columns`], frame by frame; and how many turns are lost to skew axes.
    pub(super) fn skeleton(self, points: &[[f32; 3]], origin: DVec3) -> (SkeletonTake, usize) {
        let columns = self.columns();
        let place = |c: usize| columns.partition_point(|&d| d < c);
        let triads: Vec<[usize; 3]> = self.columns.iter().map(|t| t.map(place)).collect();
        let mut origins = MarkerTake { labels: self.names, points: Vec::new(), origin };
        super::clean::rename_namesakes(&mut origins);
        let mut rotations = Vec::new();
        let mut skew = 0;
        for frame in points.chunks_exact(columns.len()) {
            for triad in &triads {
                let [o, y, z] = triad.map(|k| DVec3::from_array(frame[k].map(f64::from)));
                let (y, z) = ((y - o).normalize_or_zero(), (z - o).normalize_or_zero());
                let turns = y.dot(z).abs() < SKEW && y != DVec3::ZERO && z != DVec3::ZERO;
                skew += usize::from(!turns && o.is_finite());
                let x = y.cross(z).normalize_or_zero();
                let turn = DQuat::from_mat3(&DMat3::from_cols(x, z.cross(x), z)).normalize();
                let there = turns && turn.is_finite();
                origins.points.push(if there { frame[triad[0]] } else { [f32::NAN; 3] });
                rotations.push(if there { turn.to_array().map(|x| x as f32) } else { [f32::NAN; 4] });
            }
        }
        let joint =
            |name: &String| Joint { name: name.clone(), parent: None, rest: DVec3::NAN, rest_turn: DQuat::IDENTITY, end: false };
        let joints = origins.labels.iter().map(joint).collect();
        (SkeletonTake { joints, origins, rotations, rest: Rest::Unknown }, skew)
    }
}
