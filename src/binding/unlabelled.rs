//! Markers whose labels say nothing, told by where they lie on the body.
//!
//! The landmarks of the dictionary on the scan are laid over the markers of one frame, both ways round; assignment and articulated fit take
//! turns. Which way round the actor stands, the feet tell, and a body that faces the other way must fit clearly worse. Distances between
//! markers alone do not tell segments apart in ordinary takes, and nearest points on the skin turn bodies round.

use super::fit::{self, Fit, Observation};
use super::labels::{self, Names, Place};
use super::places;
use super::segments::Skeleton;
use super::similarity::{Held, Similarity, upright};
use super::take::Take;
use crate::spatial::TriangleTree;
use crate::statistics::quantile;
use glam::DVec3;

/// Frames looked at, and those that are fitted.
const SAMPLES: usize = 40;
const FITTED: usize = 2;
/// Share of the best marker count that a frame shows.
const COMPLETE: f64 = 0.92;
/// Rounds of assignment and fit.
const ROUNDS: usize = 4;
/// Farther than this, in statures, all places are equally wrong for a marker.
const CAP: f64 = 0.25;
/// Markers farther than this from their landmark after the fit, in statures, have no name.
const UNLIKE: f64 = 0.06;
/// The other way round must fit worse by this factor, and the right one must fit to this share of stature. On 21 pairs of scans and takes the
/// nine that pass have 90 to 100 % of their segments right; factors from 1.2 to 1.4 hold one wrong in five.
const CLEAR: f64 = 1.4;
const GOOD: f64 = 0.025;
/// Fewest markers that make a person, and most that are told apart.
const FEWEST: usize = 20;
const MOST: usize = 200;
/// Heights of markers as shares of stature: of the feet, and of the highest.
const FEET: f64 = 0.10;
const TOP: f64 = 0.97;

/// Why the markers cannot be told, in words.
pub(super) struct Untold(pub String);

/// A landmark on the scan at rest.
struct Landmark {
    place: Place,
    at: DVec3,
}

/// One way to name the markers of a frame.
struct Reading {
    /// Landmark by marker.
    named: Vec<Option<usize>>,
    /// Median distance of the markers from their landmarks, in statures.
    error: f64,
}

/// Names of the markers, and by which factor the other way round fits worse. `up`: in the axes of the capture.
pub(super) fn tell(take: &Take<'_>, body: &Skeleton, tree: &TriangleTree, up: DVec3) -> Result<(Names, f64), Untold> {
    let landmarks: Vec<Landmark> =
        labels::all_places().into_iter().map(|place| Landmark { at: places::on_skin(&place, body, tree), place }).collect();
    let count = |frame: usize| (0..take.track.take.markers()).filter(|&m| take.track.point(frame, m).is_some()).count();
    let frames = take.track.sample(SAMPLES);
    let most = frames.iter().map(|&f| count(f)).max().unwrap_or(0);
    if most < FEWEST {
        return Err(Untold(format!("{most} markers are too few to be told apart by their places")));
    }
    if most > MOST {
        return Err(Untold(format!("{most} markers are too many to be told apart by their places")));
    }
    let mut starts: Vec<(f64, Start)> = frames
        .into_iter()
        .filter(|&f| count(f) as f64 >= COMPLETE * most as f64)
        .filter_map(|frame| Start::of(take, body, frame, up))
        .map(|start| {
            let named = assign(&start.points(&start.placement), &landmarks.iter().map(|l| l.at).collect::<Vec<_>>(), body);
            (start.error(&named, &landmarks, body), start)
        })
        .collect();
    starts.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.frame.cmp(&b.1.frame)));
    let mut best: Option<(Reading, Reading)> = None;
    for (_, start) in starts.iter().take(FITTED) {
        let way = start.read(&start.placement, body, &landmarks);
        let back = start.read(&start.turned(body), body, &landmarks);
        if best.as_ref().is_none_or(|(b, _)| way.error < b.error) {
            best = Some((way, back));
        }
    }
    let Some((reading, back)) = best else {
        return Err(Untold("no frame shows two feet on the floor that point one way".to_owned()));
    };
    let ratio = back.error / reading.error.max(1e-9);
    if ratio < CLEAR {
        return Err(Untold(format!("front and back of the markers cannot be told apart ({ratio:.2}, {CLEAR} or more is clear)")));
    }
    if reading.error > GOOD {
        let percent = 100.0 * reading.error;
        return Err(Untold(format!(
            "the markers do not lie where a person's do ({percent:.1} % of height off, {:.1} at most)",
            100.0 * GOOD
        )));
    }
    let places = reading.named.iter().map(|named| named.map(|l| landmarks[l].place.clone())).collect();
    Ok((Names { places, set: None }, ratio))
}

/// The markers of a frame, placed as the feet tell.
struct Start<'a> {
    take: &'a Take<'a>,
    frame: usize,
    placement: Similarity,
}

impl<'a> Start<'a> {
    fn of(take: &'a Take<'a>, body: &Skeleton, frame: usize, up: DVec3) -> Option<Self> {
        let markers: Vec<DVec3> = (0..take.track.take.markers()).filter_map(|m| take.track.point(frame, m)).collect();
        let heights = markers.iter().map(|p| p.dot(up));
        let (low, high) = heights.fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), x| (l.min(x), h.max(x)));
        let stature = (high - low) / TOP;
        if stature.is_nan() || stature <= 0.0 {
            return None;
        }
        let (facing, middle) = feet(&markers, up, low, stature)?;
        let scale = body.stature / stature;
        let tilt = super::similarity::turn_between(up, body.up);
        let forward = tilt * facing;
        let yaw = body.up.dot(forward.cross(body.forward)).atan2(forward.dot(body.forward));
        let rotation = glam::DQuat::from_axis_angle(body.up, yaw) * tilt;
        let floor = body.bone(super::Segment::Head).end.dot(body.up) - body.stature;
        let ankles = (body.bone(super::Segment::LeftFoot).origin + body.bone(super::Segment::RightFoot).origin) * 0.5;
        let target = ankles + body.up * (floor - ankles.dot(body.up));
        let from = rotation * (middle + up * (low - middle.dot(up))) * scale;
        Some(Self { take, frame, placement: Similarity { mirror: false, scale, rotation, translation: target - from } })
    }

    /// The same, facing the other way over the same middle of the feet.
    fn turned(&self, body: &Skeleton) -> Similarity {
        let half = glam::DQuat::from_axis_angle(body.up, std::f64::consts::PI);
        let ankles = (body.bone(super::Segment::LeftFoot).origin + body.bone(super::Segment::RightFoot).origin) * 0.5;
        Similarity {
            rotation: half * self.placement.rotation,
            translation: ankles + half * (self.placement.translation - ankles),
            ..self.placement
        }
    }

    /// Markers in the unit box; `None` where missing.
    fn points(&self, placement: &Similarity) -> Vec<Option<DVec3>> {
        let markers = 0..self.take.track.take.markers();
        markers.map(|m| self.take.track.point(self.frame, m).map(|p| placement.apply(p))).collect()
    }

    fn error(&self, named: &[Option<usize>], landmarks: &[Landmark], body: &Skeleton) -> f64 {
        let points = self.points(&self.placement);
        let far = points.iter().zip(named).filter_map(|(p, n)| Some(p.as_ref()?.distance(landmarks[(*n)?].at)));
        quantile(&mut far.collect::<Vec<_>>(), 0.5).map_or(f64::INFINITY, |m| m / body.stature)
    }

    /// Assignment and fit in turns.
    fn read(&self, placement: &Similarity, body: &Skeleton, landmarks: &[Landmark]) -> Reading {
        let mut placement = *placement;
        let mut expected: Vec<DVec3> = landmarks.iter().map(|l| l.at).collect();
        let mut reading = Reading { named: Vec::new(), error: f64::INFINITY };
        for round in 0..ROUNDS {
            let points = self.points(&placement);
            let named = assign(&points, &expected, body);
            if round == 0 {
                // Size and place by all, before the limbs bend.
                let pairs: Vec<(DVec3, DVec3, f64)> = named
                    .iter()
                    .enumerate()
                    .filter_map(|(m, n)| {
                        let landmark = &landmarks[(*n)?];
                        Some((self.take.track.point(self.frame, m)?, landmark.at, landmark.place.weight))
                    })
                    .collect();
                let capture_up = placement.rotation.inverse() * body.up;
                let better = upright(&pairs, capture_up, body.up, Held::default());
                placement = better.map_or(placement, |u| u.placement);
            }
            let points = self.points(&placement);
            let observations: Vec<Observation> = points
                .iter()
                .zip(&named)
                .filter_map(|(p, n)| {
                    let landmark = &landmarks[(*n)?];
                    let (segment, weight) = (landmark.place.segment(), landmark.place.weight);
                    Some(Observation { marker: (*p)?, place: landmark.at, segment, weight })
                })
                .collect();
            let fitted = fit::fit(body, &observations);
            expected = landmarks.iter().map(|l| fitted.pose(body, l.place.segment(), l.at)).collect();
            reading = self.judged(named, &points, &expected, &fitted, body);
        }
        reading
    }

    fn judged(
        &self,
        mut named: Vec<Option<usize>>,
        points: &[Option<DVec3>],
        expected: &[DVec3],
        fitted: &Fit,
        body: &Skeleton,
    ) -> Reading {
        let stature = body.stature * fitted.size;
        let mut far = Vec::new();
        for (name, point) in named.iter_mut().zip(points) {
            if let (Some(landmark), Some(point)) = (*name, point) {
                let distance = point.distance(expected[landmark]) / stature;
                far.push(distance);
                if distance > UNLIKE {
                    *name = None;
                }
            }
        }
        Reading { named, error: quantile(&mut far, 0.5).unwrap_or(f64::INFINITY) }
    }
}

/// Direction in which both feet point, and the middle between them. Of the markers of a foot the highest is near the ankle, and the one that is
/// farthest from it lies at the toes.
fn feet(markers: &[DVec3], up: DVec3, low: f64, stature: f64) -> Option<(DVec3, DVec3)> {
    let level = |p: DVec3| p - up * p.dot(up);
    let near: Vec<DVec3> = markers.iter().copied().filter(|p| p.dot(up) < low + FEET * stature).collect();
    // The two that are farthest apart belong to two feet.
    let mut apart = (0.0, None);
    for (i, a) in near.iter().enumerate() {
        for b in &near[i + 1..] {
            let distance = level(*a - *b).length();
            if distance > apart.0 {
                apart = (distance, Some((*a, *b)));
            }
        }
    }
    let (a, b) = apart.1?;
    let mut sides: [Vec<DVec3>; 2] = Default::default();
    for p in near {
        sides[usize::from(level(p - a).length() > level(p - b).length())].push(p);
    }
    let mut directions = [DVec3::ZERO; 2];
    let mut middle = DVec3::ZERO;
    for (side, direction) in sides.iter().zip(&mut directions) {
        let ankle = side.iter().copied().max_by(|p, q| p.dot(up).total_cmp(&q.dot(up)))?;
        let toes = side.iter().copied().max_by(|p, q| level(*p - ankle).length().total_cmp(&level(*q - ankle).length()))?;
        *direction = level(toes - ankle).try_normalize()?;
        middle += side.iter().sum::<DVec3>() / side.len() as f64 * 0.5;
    }
    // Feet that point apart by more than a right angle do not tell.
    let facing = directions[0] + directions[1];
    (directions[0].dot(directions[1]) > 0.0).then(|| facing.try_normalize()).flatten().map(|f| (f, middle))
}

/// The landmark of each marker: of all ways to give each its own, the one with the least sum of squared distances.
///
/// Source: H. Kuhn, The Hungarian method for the assignment problem, 1955, by shortest augmenting paths.
fn assign(points: &[Option<DVec3>], landmarks: &[DVec3], body: &Skeleton) -> Vec<Option<usize>> {
    let cap = CAP * body.stature;
    let there: Vec<(usize, DVec3)> = points.iter().enumerate().filter_map(|(m, p)| Some((m, (*p)?))).collect();
    let (rows, columns) = (there.len(), landmarks.len().max(there.len()));
    let cost = |row: usize, column: usize| landmarks.get(column).map_or(cap, |l| there[row].1.distance(*l).min(cap)).powi(2);
    // Potentials of rows and columns, and the row of each column; index 0 stands for none.
    let (mut u, mut v) = (vec![0.0; rows + 1], vec![0.0; columns + 1]);
    let mut row_of = vec![0usize; columns + 1];
    let mut came = vec![0usize; columns + 1];
    for row in 1..=rows {
        row_of[0] = row;
        let mut column = 0;
        let mut least = vec![f64::INFINITY; columns + 1];
        let mut used = vec![false; columns + 1];
        loop {
            used[column] = true;
            let at = row_of[column];
            let (mut delta, mut next) = (f64::INFINITY, 0);
            for j in 1..=columns {
                if used[j] {
                    continue;
                }
                let reduced = cost(at - 1, j - 1) - u[at] - v[j];
                if reduced < least[j] {
                    (least[j], came[j]) = (reduced, column);
                }
                if least[j] < delta {
                    (delta, next) = (least[j], j);
                }
            }
            for j in 0..=columns {
                if used[j] {
                    u[row_of[j]] += delta;
                    v[j] -= delta;
                } else {
                    least[j] -= delta;
                }
            }
            column = next;
            if row_of[column] == 0 {
                break;
            }
        }
        while column != 0 {
            row_of[column] = row_of[came[column]];
            column = came[column];
        }
    }
    let mut out = vec![None; points.len()];
    for (column, &row) in row_of.iter().enumerate().skip(1) {
        if row > 0 && column <= landmarks.len() && there[row - 1].1.distance(landmarks[column - 1]) < cap {
            out[there[row - 1].0] = Some(column - 1);
        }
    }
    out
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;
    use crate::binding::tests::{PLUG_IN_GAIT, bound, labels_of, landmarks_of, person, stride, take};
    use crate::binding::{Options, fit};

    #[test]
    fn the_cheapest_of_all_assignments_is_found() {
        let body = Skeleton::of(&person(0.7).body);
        let landmarks = [DVec3::ZERO, DVec3::X * 0.1, DVec3::X * 0.4];
        let points = [Some(DVec3::X * 0.01), None, Some(DVec3::X * -0.06), Some(DVec3::X * 0.11)];
        assert_eq!(assign(&points, &landmarks[..2], &body), [Some(0), None, None, Some(1)]);
        // The first marker is nearer to the place that the third needs more.
        assert_eq!(assign(&points[..3], &landmarks, &body), [Some(1), None, Some(0)]);
    }

    #[test]
    fn markers_without_names_are_told_by_their_places() {
        let person = person(0.75);
        let named = labels_of(&PLUG_IN_GAIT);
        let seen = landmarks_of(&person, &named);
        let skeleton = Skeleton::of(&person.body);
        let frames: Vec<Vec<DVec3>> = (0..12).map(|k| fit::simulate(&skeleton, &seen, &stride(k), &[])).collect();
        let nameless: Vec<String> = (1..=named.len()).map(|i| format!("M{i:03}")).collect();
        let options = Options { capture_up: Some("+Z".parse().unwrap()), ..Options::default() };
        for yaw in [0.3, 2.9] {
            let binding = bound(&person, &take(&person, &nameless, &frames, yaw, 1.0), &options).unwrap();
            assert!(binding.handles.len() >= 30, "{:?}", binding.unbound);
            for handle in &binding.handles {
                let k = nameless.iter().position(|l| *l == handle.label).unwrap();
                assert_eq!(handle.segment, Some(seen[k].segment), "{}", named[k]);
            }
            assert!(binding.notes.iter().any(|n| n.contains("told by their places")));
        }
        // A sphere of markers is no person.
        let ball: Vec<Vec<DVec3>> = (0..3)
            .map(|_| {
                (0..35)
                    .map(|i| DVec3::new((f64::from(i) * 2.4).cos(), f64::from(i) / 17.0 - 1.0, (f64::from(i) * 2.4).sin()) * 0.2)
                    .collect()
            })
            .collect();
        let error = bound(&person, &take(&person, &nameless, &ball, 0.3, 0.0), &options).unwrap_err();
        assert_eq!(error.exit_code(), 3);
        assert!(error.to_string().contains("[markers]"), "{error}");
    }
}
