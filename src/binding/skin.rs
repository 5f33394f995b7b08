//! An actor who was scanned as he stands in some frame: all his markers lie on the scan's skin then, each at the same small distance.
//!
//! The places of the dictionary are good to a per cent or two of the height. Where the scan is the actor's own, the skin itself tells the
//! placement far better: scale, turn about up, shift and the common distance of the markers are solved for.

use super::reference::{Chosen, Landed};
use super::segments::Skeleton;
use super::similarity::{Similarity, Upright};
use super::track::Track;
use crate::linalg::DenseCholesky;
use crate::spatial::TriangleTree;
use crate::statistics::quantile;
use glam::{DQuat, DVec3};

/// Median and 90th percentile of the distances from the common shell, in statures, up to which the markers lie on the skin. Strangers of like
/// build stay above three times these.
const ON_SKIN: (f64, f64) = (0.0025, 0.006);
/// Distance at which a marker loses most of its say, in statures.
const LOOSE: f64 = 0.006;
/// Largest distance of the shell from the skin, in statures: markers on stalks are no shell.
const FARTHEST: f64 = 0.02;
/// Fewer markers lie on some shell by chance.
const LEAST: usize = 12;
const ROUNDS: usize = 40;

/// The candidate in which the markers lie on the skin best, placed there, if they do in any.
pub(super) fn settle(
    track: &Track<'_>,
    landed: &[Landed],
    body: &Skeleton,
    tree: &TriangleTree,
    candidates: &[Chosen],
) -> Option<Chosen> {
    let mut best: Option<(f64, Chosen)> = None;
    for candidate in candidates {
        let points: Vec<DVec3> = landed.iter().filter_map(|l| track.point(candidate.frame, l.marker)).collect();
        if points.len() < LEAST {
            continue;
        }
        let Some((placement, yaw, mut distances)) = onto_skin(&points, candidate.upright, body, tree) else { continue };
        let (median, p90) = (quantile(&mut distances, 0.5)?, quantile(&mut distances, 0.9)?);
        if median < ON_SKIN.0 && p90 < ON_SKIN.1 && best.is_none_or(|(m, _)| median < m) {
            let upright = Upright { placement, yaw, rms: candidate.upright.rms };
            best = Some((median, Chosen { upright, ..*candidate }));
        }
    }
    best.map(|b| b.1)
}

/// Gauss–Newton on the signed distances; gives the distances from the shell in statures.
fn onto_skin(points: &[DVec3], start: Upright, body: &Skeleton, tree: &TriangleTree) -> Option<(Similarity, f64, Vec<f64>)> {
    // Turned and scaled about the markers: takes may lie far from their origin.
    let centre = points.iter().sum::<DVec3>() / points.len() as f64;
    let (mut placement, mut yaw, mut shell) = (start.placement, start.yaw, 0.0_f64);
    placement.translation = placement.apply(centre);
    let mut distances = vec![0.0; points.len()];
    let mut factor = DenseCholesky::with_capacity(6);
    for _ in 0..ROUNDS {
        let normal = factor.refill(6);
        let mut right = [0.0; 6];
        for (&p, distance) in points.iter().zip(&mut distances) {
            let x = placement.apply(p - centre);
            let near = tree.closest(x)?;
            let away = x - near.point;
            let sign = if tree.winding(x) > 0.5 { -1.0 } else { 1.0 };
            let residual = near.distance * sign - shell;
            *distance = residual.abs() / body.stature;
            let Some(outward) = (away * sign).try_normalize() else { continue };
            let weight = (1.0 + (residual / (LOOSE * body.stature)).powi(2)).powi(-2);
            let arm = x - placement.translation;
            let row = [outward.x, outward.y, outward.z, outward.dot(body.up.cross(arm)), outward.dot(arm), -1.0];
            for i in 0..6 {
                right[i] -= weight * row[i] * residual;
                for j in 0..6 {
                    normal[6 * i + j] += weight * row[i] * row[j];
                }
            }
        }
        for i in 0..6 {
            normal[7 * i] += 1e-6 * points.len() as f64;
        }
        if !factor.factor() {
            return None;
        }
        let mut step = right;
        factor.solve(&mut step);
        placement.translation += DVec3::new(step[0], step[1], step[2]);
        yaw += step[3];
        placement.rotation = (DQuat::from_axis_angle(body.up, step[3]) * placement.rotation).normalize();
        placement.scale *= step[4].clamp(-0.2, 0.2).exp();
        shell = (shell + step[5]).clamp(0.0, FARTHEST * body.stature);
    }
    placement.translation -= placement.rotation * centre * placement.scale;
    Some((placement, yaw, distances))
}
