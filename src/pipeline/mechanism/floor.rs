//! The floor of a take: that of a capture volume whose axes were set by eye leans, and whoever walks across it comes down or up by centimetres.

use crate::binding::person::{Joints, Person};
use crate::statistics::middle;
use glam::{DMat2, DVec2, DVec3};

/// A foot has come down while it is slower than this, in lengths of a leg per second, for so many seconds.
const SPEED: f64 = 0.3;
const STANDS: f64 = 0.1;
/// Where it rests so far from where it came down it has made a step, in lengths of a leg.
const APART: f64 = 0.15;
/// How much the heights of footfalls differ on a level floor, in lengths of a leg.
const SPREAD: f64 = 0.01;
/// How much floors lean, as a slope, before a take is seen.
const USUAL: f64 = 0.01;
/// A floor that leans by more than this, in degrees, is a ramp or a stair.
const MOST: f64 = 2.0;
/// Share of the height that footfalls differ by on a level floor that may be left on a leaning one: the lean of a person who stands differently in
/// different places leaves more.
const LEFT: f64 = 0.5;
/// Footfalls of a foot at least, so that both feet together tell more than they have to.
const FEWEST: usize = 2;
const ROUNDS: usize = 30;

/// Where a foot came down, in lengths of a leg.
#[derive(Clone, Copy, Debug)]
struct Footfall {
    /// 0 left, 1 right: their joints need not be equally high.
    side: usize,
    height: f64,
    place: DVec2,
}

/// Unit normal of the floor in the capture: up, unless footfalls tell that the floor leans.
pub fn normal(joints: &Joints<'_>, person: &Person, frames: usize, rate: f64) -> DVec3 {
    let up = person.up.value.vector();
    let (x, y) = up.any_orthonormal_pair();
    let [left, right] = person.toes;
    let points = left.zip(right).map_or(person.legs.map(|leg| leg[2]), |(left, right)| [left, right]);
    let mut falls = Vec::new();
    for (side, joint) in points.into_iter().enumerate() {
        let mut run: Vec<DVec3> = Vec::new();
        let mut before: Option<DVec3> = None;
        let flat = |p: DVec3| DVec2::new(p.dot(x), p.dot(y));
        let mut end = |run: &mut Vec<DVec3>| {
            if run.len() as f64 >= STANDS * rate {
                let height = median(run.iter().map(|p| p.dot(up)));
                falls.push(Footfall { side, height, place: flat(run.iter().sum::<DVec3>() / run.len() as f64) });
            }
            run.clear();
        };
        for frame in 0..frames {
            let here = joints.place(Some(frame), joint).map(|p| p / person.leg);
            if let (Some(here), Some(before)) = (here, before)
                && flat(here - before).length() * rate <= SPEED
            {
                if run.first().is_some_and(|first| flat(here - *first).length() > APART) {
                    end(&mut run);
                }
                run.push(here);
            }
            before = here;
        }
        end(&mut run);
    }
    let slope = slope(&falls);
    (up - x * slope.x - y * slope.y).normalize()
}

/// By how much the floor rises along both directions; zero where it does not clearly lean.
///
/// A plane with one offset per foot, by reweighting: a foot on a box or on its tip is left out. What footfalls do not tell, as the lean across a straight
/// way, stays near zero.
fn slope(falls: &[Footfall]) -> DVec2 {
    if (0..2).any(|side| falls.iter().filter(|f| f.side == side).count() < FEWEST) {
        return DVec2::ZERO;
    }
    let offsets = |slope: DVec2| -> [f64; 2] {
        [0, 1].map(|side| median(falls.iter().filter(|f| f.side == side).map(|f| f.height - slope.dot(f.place))))
    };
    let misses = |slope: DVec2| -> Vec<f64> {
        let level = offsets(slope);
        falls.iter().map(|f| f.height - slope.dot(f.place) - level[f.side]).collect()
    };
    let mut slope = DVec2::ZERO;
    for _ in 0..ROUNDS {
        let weights: Vec<f64> = misses(slope).iter().map(|m| (1.0 + (m / (3.0 * SPREAD)).powi(2)).powi(-2)).collect();
        let mut matrix = DMat2::IDENTITY * (SPREAD / USUAL).powi(2);
        let mut side_of = DVec2::ZERO;
        for side in 0..2 {
            let own = || falls.iter().zip(&weights).filter(|(f, _)| f.side == side);
            let total: f64 = own().map(|(_, w)| w).sum();
            let (place, height) =
                own().fold((DVec2::ZERO, 0.0), |(p, h), (f, w)| (p + f.place * (w / total), h + f.height * (w / total)));
            for (f, w) in own() {
                let d = f.place - place;
                matrix += DMat2::from_cols(d * d.x, d * d.y) * *w;
                side_of += d * ((f.height - height) * w);
            }
        }
        slope = matrix.inverse() * side_of;
    }
    let typical = |slope: DVec2| misses(slope).iter().map(|m| m.abs().min(3.0 * SPREAD)).sum::<f64>();
    let leans = slope.is_finite() && slope.length() <= MOST.to_radians().tan() && typical(slope) < LEFT * typical(DVec2::ZERO);
    if leans { slope } else { DVec2::ZERO }
}

fn median(values: impl Iterator<Item = f64>) -> f64 {
    middle(&mut values.collect::<Vec<f64>>()).unwrap_or(0.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Steps along a way, the left foot higher than the right by its marker, each a little off; every seventh is on something.
    fn walk(steps: usize, slope: DVec2, off: f64, way: impl Fn(f64) -> DVec2) -> Vec<Footfall> {
        (0..steps)
            .map(|k| {
                let place = way(k as f64);
                let on = if k % 7 == 5 { 0.2 } else { 0.0 };
                let level = if k % 2 == 0 { 0.13 } else { 0.1 };
                Footfall { side: k % 2, height: level + on + slope.dot(place) + off * (2.4 * k as f64).sin(), place }
            })
            .collect()
    }

    #[test]
    fn a_floor_that_leans_is_found_along_the_way() {
        let straight = |k: f64| DVec2::new(0.8 * k, if k % 2.0 < 1.0 { 0.1 } else { -0.1 });
        let found = slope(&walk(9, DVec2::new(0.012, 0.02), 2e-3, straight));
        assert!((found.x - 0.012).abs() < 1e-3, "{found}");
        assert!(found.y.abs() < 2e-3, "a straight way does not tell how the floor leans across: {found}");
        let round = |k: f64| DVec2::from_angle(0.5 * k) * 2.0;
        let found = slope(&walk(30, DVec2::new(0.012, -0.02), 2e-3, round));
        assert!(found.distance(DVec2::new(0.012, -0.02)) < 1.5e-3, "{found}");
    }

    #[test]
    fn a_level_floor_a_stair_and_one_who_stands_are_left_alone() {
        let straight = |k: f64| DVec2::new(0.8 * k, 0.0);
        assert_eq!(slope(&walk(9, DVec2::ZERO, 4e-3, straight)), DVec2::ZERO);
        assert_eq!(slope(&walk(9, DVec2::new(0.3, 0.0), 0.0, straight)), DVec2::ZERO);
        let round = |k: f64| DVec2::from_angle(0.5 * k) * 0.5;
        assert_eq!(slope(&walk(30, DVec2::new(0.06, 0.0), 0.0, round)), DVec2::ZERO, "a ramp");
        assert_eq!(slope(&walk(3, DVec2::new(0.015, 0.0), 0.0, straight)), DVec2::ZERO, "one footfall of a foot");
        // On the spot, the hind foot on its ball.
        let spot = |k: f64| DVec2::new(if k % 3.0 < 1.0 { -0.4 } else { 0.1 }, 0.0) + DVec2::from_angle(k) * 0.2;
        assert_eq!(slope(&walk(40, DVec2::new(0.015, 0.0), 9e-3, spot)), DVec2::ZERO);
    }
}
