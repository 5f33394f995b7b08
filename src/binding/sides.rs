//! Pairs of markers that carry each other's labels, left and right exchanged, throughout a take.

use super::labels::{Names, Part, Place};
use super::segments::Side;
use super::track::Track;
use glam::DVec3;

/// Frames looked at.
const SAMPLES: usize = 60;
/// Fewest other pairs that tell which side is left.
const OTHERS: usize = 3;
/// Mean cosine between a pair and the others: exchanged below minus this, and as it should be above. In none of 30 real takes is a pair taken for
/// exchanged that is not, and 94 % of those that are exchanged on purpose are found.
const TELLS: f64 = 0.3;
/// An exchanged pair of a limb is nearer to the other side's markers of that limb, by this factor: limbs may cross.
const NEARER: f64 = 0.85;

/// A landmark that both sides have.
struct Pair {
    left: usize,
    right: usize,
    place: Place,
}

/// Markers, left and right, that lie on each other's side against all others.
pub(super) fn exchanged(track: &Track<'_>, names: &Names) -> Vec<(usize, usize)> {
    let pairs: Vec<Pair> = names
        .iter()
        .filter(|(_, place)| place.side == Side::Left && !place.is_nameless())
        .filter_map(|(left, place)| {
            let mate = |(_, other): &(usize, &Place)| other.side == Side::Right && other.landmark == place.landmark;
            names.iter().find(mate).map(|(right, _)| Pair { left, right, place: place.clone() })
        })
        .collect();
    let frames = track.sample(SAMPLES);
    let cosines: Vec<f64> = (0..pairs.len()).map(|p| cosine(track, &pairs, p, &frames)).collect();
    let (right, wrong) = (cosines.iter().filter(|c| **c > TELLS).count(), cosines.iter().filter(|c| **c < -TELLS).count());
    if right < OTHERS || right < 2 * wrong {
        return Vec::new();
    }
    let swapped = |p: &usize| cosines[*p] < -TELLS && is_nearer_crossed(track, &pairs, *p, &frames);
    (0..pairs.len()).filter(swapped).map(|p| (pairs[p].left, pairs[p].right)).collect()
}

/// Mean cosine between a pair and the sum of the others; 0 where they are never there together.
fn cosine(track: &Track<'_>, pairs: &[Pair], of: usize, frames: &[usize]) -> f64 {
    let across = |pair: &Pair, f: usize| (track.point(f, pair.left)? - track.point(f, pair.right)?).try_normalize();
    let told: Vec<f64> = frames
        .iter()
        .filter_map(|&f| {
            let others = pairs.iter().enumerate().filter(|(p, _)| *p != of).filter_map(|(_, pair)| across(pair, f));
            Some(across(&pairs[of], f)?.dot(others.sum::<DVec3>().try_normalize()?))
        })
        .collect();
    told.iter().sum::<f64>() / told.len().max(1) as f64
}

/// Whether the two markers of a limb are nearer to the other side's markers of it; of the trunk, whose sides never cross, the cosine says enough.
fn is_nearer_crossed(track: &Track<'_>, pairs: &[Pair], of: usize, frames: &[usize]) -> bool {
    let Some(limb) = limb(pairs[of].place.part) else { return true };
    let (mut own, mut crossed) = (0.0, 0.0);
    let Pair { left, right, .. } = pairs[of];
    for other in pairs.iter().enumerate().filter(|(p, pair)| *p != of && limb.contains(&pair.place.part)).map(|(_, pair)| pair) {
        for &f in frames {
            let four = [left, right, other.left, other.right].map(|m| track.point(f, m));
            if let [Some(left), Some(right), Some(other_left), Some(other_right)] = four {
                own += left.distance(other_left) + right.distance(other_right);
                crossed += left.distance(other_right) + right.distance(other_left);
            }
        }
    }
    crossed < NEARER * own
}

/// Parts that lie on the same limb.
fn limb(part: Part) -> Option<&'static [Part]> {
    match part {
        Part::Pelvis | Part::Trunk | Part::Head | Part::Shoulder => None,
        Part::UpperArm | Part::Forearm | Part::Hand => Some(&[Part::Shoulder, Part::UpperArm, Part::Forearm, Part::Hand]),
        Part::Thigh | Part::Shank | Part::Foot => Some(&[Part::Thigh, Part::Shank, Part::Foot]),
    }
}

#[cfg(test)]
#[allow(clippy::print_stderr, clippy::unwrap_used)]
mod tests {
    use super::*;
    use crate::binding::segments::Skeleton;
    use crate::binding::tests::{PLUG_IN_GAIT, bound, labels_of, landmarks_of, person, stride, take};
    use crate::binding::{Options, fit, labels};
    use crate::capture::{self, MarkerTake, Motion};

    fn exchanged_labels(take: &MarkerTake) -> Vec<(String, String)> {
        let track = Track { take, mirror: false };
        let names = labels::name(&take.labels, &track.coverage(), false);
        let label = |m: usize| take.labels[m].clone();
        exchanged(&track, &names).into_iter().map(|(a, b)| (label(a), label(b))).collect()
    }

    #[test]
    fn a_pair_with_each_others_labels_is_bound_where_it_is() {
        let person = person(0.75);
        let labels = labels_of(&PLUG_IN_GAIT);
        let skeleton = Skeleton::of(&person.body);
        let seen = landmarks_of(&person, &labels);
        let frames: Vec<Vec<DVec3>> = (0..12).map(|k| fit::simulate(&skeleton, &seen, &stride(k), &[])).collect();
        let right = bound(&person, &take(&person, &labels, &frames, 0.4, 1.0), &Options::default()).unwrap();
        for (left, pair) in [("LKNE", "RKNE"), ("LASI", "RASI"), ("LWRA", "RWRA")] {
            let mut swapped = labels.clone();
            let [a, b] = [left, pair].map(|label| labels.iter().position(|l| l == label).unwrap());
            swapped.swap(a, b);
            let binding = bound(&person, &take(&person, &swapped, &frames, 0.4, 1.0), &Options::default()).unwrap();
            let said = format!("{left} and {pair} ");
            assert!(binding.notes.iter().any(|n| n.contains(&said)), "{:?}", binding.notes);
            for (as_it_is, straight) in binding.handles.iter().zip(&right.handles) {
                assert!(as_it_is.attachment.distance(straight.attachment) < 1e-9, "{} for {}", as_it_is.label, straight.label);
            }
        }
        assert!(!right.notes.iter().any(|n| n.contains("exchanged")));
    }

    /// `cargo test --release --lib exchanged_in_real -- --nocapture` prints how many pairs are found, and the least cosine of those that are right.
    #[test]
    fn pairs_exchanged_in_real_takes_are_found_and_no_others() {
        let shared = std::env::var_os("RETARGET_SHARED").map(std::path::PathBuf::from);
        let folder = shared.map(|s| s.join("data/motion/c3d")).filter(|f| f.exists());
        let Some(folder) = folder else { return eprintln!("skipped: no real takes are there") };
        let (mut tried, mut found) = (0, 0);
        for entry in std::fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            let Ok(mut capture) = capture::read(&path, &capture::ReadOptions::default()) else { continue };
            let Motion::Markers(take) = &mut capture.motion else { continue };
            let name = path.file_stem().unwrap().to_string_lossy().into_owned();
            assert_eq!(exchanged_labels(take), [], "{name}");
            let track = Track { take, mirror: false };
            let names = labels::name(&take.labels, &track.coverage(), false);
            let sided: Vec<(usize, Place)> = names.iter().map(|(m, p)| (m, p.clone())).collect();
            // With fewer pairs there are not enough others to tell.
            if sided.iter().filter(|(_, p)| p.side == Side::Left).count() <= OTHERS {
                continue;
            }
            let mut missed = Vec::new();
            for (a, place) in sided.iter().filter(|(_, p)| p.side == Side::Left) {
                let mate = |(_, q): &&(usize, Place)| q.side == Side::Right && q.landmark == place.landmark;
                let Some((b, _)) = sided.iter().find(mate) else { continue };
                take.labels.swap(*a, *b);
                let swapped = exchanged_labels(take);
                take.labels.swap(*a, *b);
                let pair = (take.labels[*a].clone(), take.labels[*b].clone());
                tried += 1;
                assert!(swapped.iter().all(|p| *p == (pair.0.clone(), pair.1.clone())), "{name}: {pair:?} gives {swapped:?}");
                found += swapped.len();
                if swapped.is_empty() {
                    missed.push(pair.0);
                }
            }
            if !missed.is_empty() {
                eprintln!("{name}: not found {missed:?}");
            }
        }
        eprintln!("{found} of {tried} exchanged pairs found");
        assert!(found * 10 >= tried * 9, "{found} of {tried}");
    }
}
