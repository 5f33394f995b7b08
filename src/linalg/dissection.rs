//! Elimination order by geometric nested dissection: cut the points in two, number the border between the halves last, go on in both halves.

use glam::DVec3;

/// Which unknowns share a matrix entry.
#[derive(Clone, Debug)]
pub struct Adjacency {
    starts: Vec<u32>,
    neighbours: Vec<u32>,
}

impl Adjacency {
    /// Unknowns that appear together in a list are neighbours.
    pub fn of_groups<'a>(size: usize, groups: impl Iterator<Item = &'a [u32]> + Clone) -> Self {
        let mut lists = vec![Vec::new(); size];
        for group in groups {
            for &a in group {
                lists[a as usize].extend(group.iter().copied().filter(|&b| b != a));
            }
        }
        let (mut starts, mut neighbours) = (vec![0], Vec::new());
        for mut list in lists {
            list.sort_unstable();
            list.dedup();
            neighbours.extend(list);
            starts.push(neighbours.len() as u32);
        }
        Self { starts, neighbours }
    }

    fn neighbours(&self, v: u32) -> &[u32] {
        &self.neighbours[self.starts[v as usize] as usize..self.starts[v as usize + 1] as usize]
    }
}

/// Below this many unknowns a further cut no longer saves entries of the factor.
const LEAF: usize = 48;

/// Order in which to eliminate: entry `k` is the unknown that comes `k`-th.
///
/// Shapes: `points`: one position per unknown. Source: George 1973, with a median cut across the longest extent as the separator's place.
pub fn nested_dissection(adjacency: &Adjacency, points: &[DVec3]) -> Vec<u32> {
    let mut order: Vec<u32> = (0..points.len() as u32).collect();
    let mut side = vec![Side::Outside; points.len()];
    dissect(adjacency, points, &mut order, &mut side);
    order
}

#[derive(Clone, Copy, PartialEq)]
enum Side {
    Outside,
    Low,
    High,
}

fn dissect(adjacency: &Adjacency, points: &[DVec3], part: &mut [u32], side: &mut [Side]) {
    if part.len() <= LEAF {
        return;
    }
    let (lo, hi) = part.iter().fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(lo, hi), &v| {
        let p = points[v as usize];
        (lo.min(p), hi.max(p))
    });
    let extent = hi - lo;
    let axis = (0..3).fold(0, |best, i| if extent[i] > extent[best] { i } else { best });
    let half = part.len() / 2;
    part.select_nth_unstable_by(half, |&a, &b| points[a as usize][axis].total_cmp(&points[b as usize][axis]).then(a.cmp(&b)));
    // The selection leaves each half in an order of its own making.
    part[..half].sort_unstable();
    part[half..].sort_unstable();
    for (i, &v) in part.iter().enumerate() {
        side[v as usize] = if i < half { Side::Low } else { Side::High };
    }
    let touches_high = |v: u32| adjacency.neighbours(v).iter().any(|&b| side[b as usize] == Side::High);
    let (border, inner): (Vec<u32>, Vec<u32>) = part[..half].iter().partition(|&&v| touches_high(v));
    let high = part[half..].to_vec();
    for &v in part.iter() {
        side[v as usize] = Side::Outside;
    }
    let (low_end, high_end) = (inner.len(), inner.len() + high.len());
    part[..low_end].copy_from_slice(&inner);
    part[low_end..high_end].copy_from_slice(&high);
    part[high_end..].copy_from_slice(&border);
    dissect(adjacency, points, &mut part[..low_end], side);
    dissect(adjacency, points, &mut part[low_end..high_end], side);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn halves_of_a_line_meet_only_in_the_border() {
        let points: Vec<DVec3> = (0..101).map(|i| DVec3::X * f64::from(i)).collect();
        let pairs: Vec<[u32; 2]> = (0..100).map(|i| [i, i + 1]).collect();
        let adjacency = Adjacency::of_groups(101, pairs.iter().map(|p| p.as_slice()));
        let order = nested_dissection(&adjacency, &points);
        let mut sorted = order.clone();
        sorted.sort_unstable();
        assert_eq!(sorted, (0..101).collect::<Vec<u32>>());
        assert_eq!(order[100], 49, "the low vertex at the cut is eliminated last");
        assert!(order[..49].iter().all(|&v| v < 49) && order[49..100].iter().all(|&v| v > 49));
    }

    #[test]
    fn coincident_points_are_still_an_order() {
        let points = vec![DVec3::ZERO; 200];
        let groups: Vec<[u32; 2]> = (0..199).map(|i| [i, i + 1]).collect();
        let mut order = nested_dissection(&Adjacency::of_groups(200, groups.iter().map(|p| p.as_slice())), &points);
        order.sort_unstable();
        assert_eq!(order, (0..200).collect::<Vec<u32>>());
    }
}
