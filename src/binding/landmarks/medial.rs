//! Medial curves: the centres of the sections of a limb, from its tip inwards.

use super::voxels::{NONE, Solid};
use glam::DVec3;

/// A section of a limb: the voxels about equally far from its tip.
#[derive(Clone, Copy, Debug)]
pub(super) struct Section {
    /// Distance from the tip through the body.
    pub(super) level: f64,
    /// Area of the section.
    pub(super) area: f64,
    /// Centre of the section.
    pub(super) centre: DVec3,
}

/// The sections of one limb, one per voxel of distance from its tip.
pub(super) struct Curve(pub(super) Vec<Section>);

impl Curve {
    /// Follows the limb from its tip over `reach`, through the voxels that `belongs` lets through.
    ///
    /// Where the level falls into several pieces (fingers, both legs), the piece nearest to the last centre is followed.
    pub(super) fn follow(solid: &Solid, distance: &[f64], reach: f64, belongs: impl Fn(usize) -> bool) -> Self {
        let h = solid.pitch;
        let mut by_distance: Vec<u32> =
            (0..solid.len() as u32).filter(|&v| distance[v as usize] <= reach + h && belongs(v as usize)).collect();
        by_distance.sort_by(|&i, &j| distance[i as usize].total_cmp(&distance[j as usize]).then(i.cmp(&j)));
        // Level at which a voxel was last met, and at which it was put into a piece.
        let mut member = vec![0_u32; solid.len()];
        let mut placed = vec![0_u32; solid.len()];
        let mut sections: Vec<Section> = Vec::new();
        let mut pieces: Vec<(usize, DVec3)> = Vec::new();
        let mut queue = Vec::new();
        for number in 1.. {
            let level = f64::from(number) * h;
            let from = by_distance.partition_point(|&v| distance[v as usize] < level - h);
            let to = by_distance.partition_point(|&v| distance[v as usize] <= level + h);
            if level >= reach || from == to {
                break;
            }
            let band = &by_distance[from..to];
            for &v in band {
                member[v as usize] = number;
            }
            pieces.clear();
            for &first in band {
                if placed[first as usize] == number {
                    continue;
                }
                placed[first as usize] = number;
                queue.push(first);
                let (mut count, mut sum) = (0, DVec3::ZERO);
                while let Some(v) = queue.pop() {
                    count += 1;
                    sum += solid.centres[v as usize];
                    for &next in &solid.neighbours[v as usize] {
                        if next != NONE && member[next as usize] == number && placed[next as usize] != number {
                            placed[next as usize] = number;
                            queue.push(next);
                        }
                    }
                }
                pieces.push((count, sum / count as f64));
            }
            let most = pieces.iter().map(|p| p.0).max().unwrap_or(0);
            let chosen = match sections.last() {
                None => pieces.iter().find(|p| p.0 == most),
                Some(last) => pieces
                    .iter()
                    .filter(|p| 5 * p.0 >= most)
                    .min_by(|p, q| p.1.distance_squared(last.centre).total_cmp(&q.1.distance_squared(last.centre))),
            };
            let Some(&(count, centre)) = chosen else { break };
            sections.push(Section { level, area: count as f64 * h * h * 0.5, centre });
        }
        Self(sections)
    }

    /// Sections whose level lies strictly between two.
    pub(super) fn between(&self, low: f64, high: f64) -> &[Section] {
        let from = self.0.partition_point(|s| s.level <= low);
        let to = self.0.partition_point(|s| s.level < high);
        &self.0[from.min(to)..to]
    }

    /// Centres of those sections.
    pub(super) fn centres(&self, low: f64, high: f64) -> Vec<DVec3> {
        self.between(low, high).iter().map(|s| s.centre).collect()
    }

    /// The centre at a level, interpolated; the end beyond an end.
    pub(super) fn at(&self, level: f64) -> Option<DVec3> {
        let after = self.0.partition_point(|s| s.level <= level);
        match (after.checked_sub(1).map(|i| self.0[i]), self.0.get(after)) {
            (Some(a), Some(b)) => Some(a.centre.lerp(b.centre, (level - a.level) / (b.level - a.level))),
            (Some(end), None) => Some(end.centre),
            (None, Some(end)) => Some(end.centre),
            (None, None) => None,
        }
    }

    /// The section of least area between two levels; the outermost of equals.
    pub(super) fn narrowest(&self, low: f64, high: f64) -> Option<Section> {
        self.between(low, high).iter().min_by(|a, b| a.area.total_cmp(&b.area)).copied()
    }
}
