//! Flat contacts that are joints all the same: housings of robots meet at flanges, and a block on a table is the exception.

use super::Kind;
use super::contact::Contact;
use super::part::Part;
use super::samples::Samples;
use super::slippage::{Reading, Slippage};
use crate::linalg::eigen;
use glam::DVec3;

/// Side walls reach this far from the axis, in radii of the patch.
const OUT: f64 = 1.35;
/// A patch whose second moments differ by less is round.
const ROUND: f64 = 0.5;
/// Directions in which the surroundings of a patch are looked at, and the share of them in which a table goes on beyond it.
const DIRECTIONS: usize = 24;
const TABLE: f64 = 0.8;

/// The joint of coaxial housings: slippage of the patch together with the side walls of either part next to it, if that is a turn about the normal.
pub fn collar(a: &Part, b: &Part, contact: &Contact, plane: &Reading, spacing: f64) -> Option<Reading> {
    let z = plane.axis;
    let centre = contact.surface.centre();
    let height = |p: DVec3| (p - centre).dot(z);
    let off_axis = |p: DVec3| (p - centre - z * height(p)).length();
    let mut radii: Vec<f64> = contact.surface.points.iter().map(|&p| off_axis(p)).collect();
    radii.sort_by(f64::total_cmp);
    let radius = *radii.get(radii.len() * 98 / 100)?;
    let readings = [a, b].into_iter().filter_map(|part| {
        let reach = DVec3::splat(OUT * radius);
        let mut walls = Samples::default();
        walls.extend(&part.samples(centre - reach, centre + reach, 4000, spacing), |p, n| {
            let r = off_axis(p);
            n.dot(z).abs() < 0.35 && height(p).abs() < 0.35 * radius && r < OUT * radius && r > 0.5 * radius
        });
        if walls.len() < 30 {
            return None;
        }
        let mut whole = contact.surface.clone();
        whole.extend(&walls, |_, _| true);
        let slippage = Slippage::of(&whole)?;
        let reading = slippage.read();
        let about = reading.kind == Kind::Revolute && reading.axis.dot(z).abs() > 0.98;
        about.then(|| (slippage.values[5] / slippage.values[0], reading))
    });
    readings.max_by(|a, b| a.0.total_cmp(&b.0)).map(|best| best.1)
}

/// Whether the flat face of one part goes on around the patch: the other one lies on it like a block on a table.
pub fn on_table(a: &Part, b: &Part, contact: &Contact, plane: &Reading, reach: f64) -> bool {
    let z = plane.axis;
    let centre = contact.surface.centre();
    let (x, y) = z.any_orthonormal_pair();
    let mut radii = [0.0_f64; DIRECTIONS];
    let step = std::f64::consts::TAU / DIRECTIONS as f64;
    for p in &contact.surface.points {
        let d = *p - centre;
        let (u, v) = (d.dot(x), d.dot(y));
        let direction = (v.atan2(u) / step).round().rem_euclid(DIRECTIONS as f64) as usize;
        radii[direction.min(DIRECTIONS - 1)] = radii[direction.min(DIRECTIONS - 1)].max(u.hypot(v));
    }
    let goes_on = |part: &Part| {
        let beyond = radii.iter().enumerate().filter(|(k, radius)| {
            let (sin, cos) = (*k as f64 * step).sin_cos();
            let p = centre + (x * cos + y * sin) * (**radius * 1.2 + reach);
            part.tree.closest_within(p, reach).is_some_and(|c| part.normals[c.triangle].dot(z).abs() > 0.95)
        });
        beyond.count() as f64 >= TABLE * DIRECTIONS as f64
    };
    goes_on(a) || goes_on(b)
}

/// The turn about the normal of a patch that is about as wide as long, through the middle of its box: less biased by an uneven rim than the mean.
pub fn round(contact: &Contact, plane: &Reading) -> Option<Reading> {
    let z = plane.axis;
    let centre = contact.surface.centre();
    let (x, y) = z.any_orthonormal_pair();
    let flat = |p: DVec3| ((p - centre).dot(x), (p - centre).dot(y));
    let mut moments = [[0.0; 2]; 2];
    for (p, _, w) in contact.surface.iter() {
        let (u, v) = flat(p);
        moments[0][0] += w * u * u;
        moments[0][1] += w * u * v;
        moments[1][1] += w * v * v;
    }
    moments[1][0] = moments[0][1];
    let (values, axes) = eigen::symmetric(moments);
    if values[0] < ROUND * values[1] {
        return None;
    }
    let middle = axes.map(|[cu, cv]| {
        let along = |p: &DVec3| {
            let (u, v) = flat(*p);
            u * cu + v * cv
        };
        let values = || contact.surface.points.iter().map(along);
        0.5 * (values().fold(f64::INFINITY, f64::min) + values().fold(f64::NEG_INFINITY, f64::max))
    });
    let (u, v) = (middle[0] * axes[0][0] + middle[1] * axes[1][0], middle[0] * axes[0][1] + middle[1] * axes[1][1]);
    Some(Reading { kind: Kind::Revolute, centre: centre + x * u + y * v, ..*plane })
}
