//! The best few joints of a vertex: `min wᵀGw`, `w ≥ 0`, `Σw = 1`, at most four of `w` not zero.
//!
//! Since the weights sum to 1, the error of a blend is the blend of its joints' errors, and `G` is the Gram matrix of these errors.

use super::Influences;

/// Most candidates of a vertex.
pub const CANDIDATES: usize = 10;
/// Most influences that are kept: what every player reads.
pub const INFLUENCES: usize = 4;

/// Pairs of candidates, each with itself too.
pub const PAIRS: usize = CANDIDATES * (CANDIDATES + 1) / 2;

/// Gram matrix of the candidates' errors.
#[derive(Clone, Debug)]
pub struct Gram {
    size: usize,
    g: [[f64; CANDIDATES]; CANDIDATES],
}

/// Chosen candidates with their weights.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Choice {
    /// How many.
    pub count: usize,
    /// Candidates.
    pub members: [usize; CANDIDATES],
    /// Their weights, positive, summing to 1.
    pub weights: [f64; CANDIDATES],
    /// `wᵀGw`.
    pub cost: f64,
}

impl Choice {
    /// The chosen ones of these joints, heaviest first. At most four are chosen.
    pub fn influences(&self, joints: &[usize]) -> Influences {
        let mut order: Vec<usize> = (0..self.count).collect();
        order.sort_by(|&a, &b| self.weights[b].total_cmp(&self.weights[a]).then(a.cmp(&b)));
        let mut influences = Influences::default();
        for (place, &a) in order.iter().enumerate() {
            influences.joints[place] = joints[self.members[a]] as u16;
            influences.weights[place] = self.weights[a];
        }
        influences
    }
}

impl Gram {
    /// Of the scalar products of errors, row by row of the lower triangle.
    pub fn new(size: usize, products: &[f32]) -> Self {
        assert!((1..=CANDIDATES).contains(&size));
        let mut g = [[0.0; CANDIDATES]; CANDIDATES];
        let pairs = (0..size).flat_map(|a| (0..=a).map(move |b| (a, b)));
        for ((a, b), &product) in pairs.zip(products) {
            (g[a][b], g[b][a]) = (product.into(), product.into());
        }
        // Keeps nearly equal candidates apart and prefers small weights among them.
        let least = (0..size).map(|a| g[a][a]).fold(f64::INFINITY, f64::min);
        for (a, row) in g.iter_mut().enumerate().take(size) {
            row[a] += 1e-5 * least + 1e-14;
        }
        Self { size, g }
    }

    /// The best at most four candidates: all first, then the least useful dropped one after the other, then, with `swaps`, exchanges with unused
    /// candidates while that helps.
    pub fn choose(&self, swaps: bool) -> Choice {
        let mut all = [0; CANDIDATES];
        for (a, member) in all.iter_mut().enumerate() {
            *member = a;
        }
        let mut best = self.on_simplex(&all[..self.size]);
        while best.count > INFLUENCES {
            best = self.without_least(&best);
        }
        if swaps {
            for _ in 0..3 {
                if !self.swap_pass(&mut best) {
                    break;
                }
            }
        }
        best
    }

    fn swap_pass(&self, best: &mut Choice) -> bool {
        let mut changed = false;
        for other in 0..self.size {
            if best.members[..best.count].contains(&other) {
                continue;
            }
            let mut candidate: Option<Choice> = None;
            let places = if best.count < INFLUENCES { best.count..best.count + 1 } else { 0..best.count };
            let len = places.end;
            for place in places {
                let mut set = best.members;
                set[place] = other;
                let limit = candidate.map_or(best.cost * (1.0 - 1e-6), |c| c.cost);
                candidate = self.on_simplex_below(&set[..len], limit).or(candidate);
            }
            if let Some(c) = candidate {
                *best = c;
                changed = true;
            }
        }
        changed
    }

    /// The minimum over the simplex of one member less: the member whose removal costs least is dropped.
    ///
    /// On the plane of all weights that sum to 1 a removal is an update of the inverse; only where that makes a weight negative, and still costs less
    /// than the others, it is solved.
    fn without_least(&self, choice: &Choice) -> Choice {
        let count = choice.count;
        let inverse = self.inverse(&choice.members[..count]);
        let sums: [f64; CANDIDATES] = std::array::from_fn(|a| inverse[a][..count].iter().sum());
        let total: f64 = sums[..count].iter().sum();
        let mut best = Choice { cost: f64::INFINITY, ..Choice::default() };
        for drop in 0..count {
            let factor = sums[drop] / inverse[drop][drop];
            let left = total - factor * sums[drop];
            // The simplex is part of the plane.
            if 1.0 / left >= best.cost {
                continue;
            }
            let (members, len) = without(choice, drop);
            let mut weights = [0.0; CANDIDATES];
            for (place, a) in (0..count).filter(|&a| a != drop).enumerate() {
                weights[place] = (sums[a] - inverse[a][drop] * factor) / left;
            }
            if weights[..len].iter().all(|&w| w > 0.0) {
                best = Choice { count: len, members, weights, cost: 1.0 / left };
            } else {
                let tried = self.active_set(&members[..len], &weights);
                best = if tried.cost < best.cost { tried } else { best };
            }
        }
        // Costs that are no numbers compare with nothing.
        if best.count == 0 { self.on_simplex(&choice.members[..1]) } else { best }
    }

    /// The minimum over the simplex of `set`, exact.
    fn on_simplex(&self, set: &[usize]) -> Choice {
        let mut first = Choice { count: 1, cost: self.g[set[0]][set[0]], ..Choice::default() };
        (first.members[0], first.weights[0]) = (set[0], 1.0);
        self.on_simplex_below(set, f64::INFINITY).unwrap_or(first)
    }

    /// The same, if it costs less than `limit`.
    fn on_simplex_below(&self, set: &[usize], limit: f64) -> Option<Choice> {
        // Where the minimum under the sum alone has no negative weight it is the answer; else it costs less than the answer.
        let mut x = [0.0; CANDIDATES];
        let cost = self.on_plane(set, &mut x);
        if cost >= limit {
            return None;
        }
        if x[..set.len()].iter().all(|&w| w > 0.0) {
            let mut choice = Choice { count: set.len(), cost, weights: x, ..Choice::default() };
            choice.members[..set.len()].copy_from_slice(set);
            return Some(choice);
        }
        Some(self.active_set(set, &x)).filter(|c| c.cost < limit)
    }

    /// Active-set method (as Lawson & Hanson's NNLS, on the simplex) from weights of which some are positive: these are inside at first.
    fn active_set(&self, set: &[usize], weights: &[f64; CANDIDATES]) -> Choice {
        let len = set.len();
        let inside = &mut weights.map(|w| w > 0.0);
        inside[len..].fill(false);
        let total: f64 = weights[..len].iter().filter(|w| **w > 0.0).sum();
        let mut w = [0.0; CANDIDATES];
        for a in 0..len {
            w[a] = weights[a].max(0.0) / total;
        }
        self.walk_to_plane(set, inside, &mut w);
        for _ in 0..6 * CANDIDATES {
            let mut slope = [0.0; CANDIDATES];
            let mut level = 0.0;
            for a in 0..len {
                slope[a] = (0..len).map(|b| self.g[set[a]][set[b]] * w[b]).sum();
                level += slope[a] * w[a];
            }
            let mut enter = None;
            let mut least = -1e-9 * level.abs() - 1e-30;
            for a in 0..len {
                if !inside[a] && slope[a] - level < least {
                    least = slope[a] - level;
                    enter = Some(a);
                }
            }
            let Some(enter) = enter else { break };
            inside[enter] = true;
            self.walk_to_plane(set, inside, &mut w);
        }
        let mut choice = Choice::default();
        for a in 0..len {
            if w[a] > 0.0 {
                choice.members[choice.count] = set[a];
                choice.weights[choice.count] = w[a];
                choice.count += 1;
            }
            choice.cost += (0..len).map(|b| self.g[set[a]][set[b]] * w[b] * w[a]).sum::<f64>();
        }
        choice
    }

    /// Moves `w` to the minimum under the sum over the members inside, letting go of those that would become negative on the way.
    fn walk_to_plane(&self, set: &[usize], inside: &mut [bool; CANDIDATES], w: &mut [f64; CANDIDATES]) {
        for _ in 0..2 * CANDIDATES {
            let mut members = [0; CANDIDATES];
            let mut places = [0; CANDIDATES];
            let mut count = 0;
            for a in 0..set.len() {
                if inside[a] {
                    members[count] = set[a];
                    places[count] = a;
                    count += 1;
                }
            }
            let mut x = [0.0; CANDIDATES];
            self.on_plane(&members[..count], &mut x);
            let mut step = 1.0;
            let mut leaves = None;
            for a in 0..count {
                if x[a] <= 0.0 {
                    let t = w[places[a]] / (w[places[a]] - x[a]);
                    if leaves.is_none() || t < step {
                        step = t;
                        leaves = Some(places[a]);
                    }
                }
            }
            for a in 0..count {
                w[places[a]] += step * (x[a] - w[places[a]]);
            }
            let Some(leaves) = leaves else { break };
            w[leaves] = 0.0;
            inside[leaves] = false;
        }
    }

    /// The minimum over `Σw = 1` alone: `w ∝ G⁻¹1`, by Cholesky. Returns the cost.
    fn on_plane(&self, set: &[usize], w: &mut [f64; CANDIDATES]) -> f64 {
        let n = set.len();
        let l = self.factor(set);
        for a in 0..n {
            let mut sum = 1.0;
            for k in 0..a {
                sum -= l[a][k] * w[k];
            }
            w[a] = sum / l[a][a];
        }
        for a in (0..n).rev() {
            let mut sum = w[a];
            for k in a + 1..n {
                sum -= l[k][a] * w[k];
            }
            w[a] = sum / l[a][a];
        }
        let total: f64 = w[..n].iter().sum();
        for x in &mut w[..n] {
            *x /= total;
        }
        1.0 / total
    }
}

impl Gram {
    /// Cholesky factor over some members.
    fn factor(&self, set: &[usize]) -> [[f64; CANDIDATES]; CANDIDATES] {
        let mut l = [[0.0; CANDIDATES]; CANDIDATES];
        for a in 0..set.len() {
            for b in 0..=a {
                let known: f64 = l[a][..b].iter().zip(&l[b][..b]).map(|(x, y)| x * y).sum();
                let sum = self.g[set[a]][set[b]] - known;
                // Below this a pivot is the rounding of the products, which may be of either sign.
                l[a][b] = if a == b { sum.max(1e-8 * self.g[set[a]][set[a]]).sqrt() } else { sum / l[b][b] };
            }
        }
        l
    }

    /// Inverse over some members.
    fn inverse(&self, set: &[usize]) -> [[f64; CANDIDATES]; CANDIDATES] {
        let n = set.len();
        let l = self.factor(set);
        // Columns of the factor's inverse, as rows.
        let mut columns = [[0.0; CANDIDATES]; CANDIDATES];
        for (c, column) in columns.iter_mut().enumerate().take(n) {
            column[c] = 1.0 / l[c][c];
            for a in c + 1..n {
                let known: f64 = l[a][c..a].iter().zip(&column[c..a]).map(|(x, y)| x * y).sum();
                column[a] = -known / l[a][a];
            }
        }
        let mut inverse = [[0.0; CANDIDATES]; CANDIDATES];
        for a in 0..n {
            for b in 0..=a {
                inverse[a][b] = columns[a][a..n].iter().zip(&columns[b][a..n]).map(|(x, y)| x * y).sum();
                inverse[b][a] = inverse[a][b];
            }
        }
        inverse
    }
}

fn without(choice: &Choice, drop: usize) -> ([usize; CANDIDATES], usize) {
    let mut set = choice.members;
    set.copy_within(drop + 1..choice.count, drop);
    (set, choice.count - 1)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn errors(seed: u64, candidates: usize) -> Vec<Vec<f64>> {
        let mut state = seed * 2 + 1;
        let mut next = || {
            state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
            (state >> 11) as f64 / (1u64 << 53) as f64 - 0.4
        };
        (0..candidates).map(|_| (0..30).map(|_| next()).collect()).collect()
    }

    fn gram(errors: &[Vec<f64>]) -> Gram {
        let product = |a: usize, b: usize| errors[a].iter().zip(&errors[b]).map(|(x, y)| x * y).sum::<f64>() as f32;
        let products: Vec<f32> =
            (0..errors.len()).flat_map(|a| (0..=a).map(move |b| (a, b))).map(|(a, b)| product(a, b)).collect();
        Gram::new(errors.len(), &products)
    }

    #[test]
    fn the_simplex_minimum_satisfies_its_optimality_conditions() {
        for seed in 0..200 {
            let e = errors(seed, 8);
            let g = gram(&e);
            let set: Vec<usize> = (0..8).collect();
            let mut first = [0.0; CANDIDATES];
            first[seed as usize % 8] = 1.0;
            for best in [g.on_simplex(&set), g.active_set(&set, &first)] {
                let mut w = [0.0; 8];
                for k in 0..best.count {
                    w[best.members[k]] = best.weights[k];
                }
                assert!((w.iter().sum::<f64>() - 1.0).abs() < 1e-9);
                for a in 0..8 {
                    let slope: f64 = (0..8).map(|b| g.g[a][b] * w[b]).sum();
                    assert!(slope >= best.cost * (1.0 - 1e-6), "seed {seed}: {slope} {}", best.cost);
                    assert!(w[a] == 0.0 || slope <= best.cost * (1.0 + 1e-6));
                }
            }
        }
    }

    #[test]
    fn a_blend_of_three_is_found_among_ten() {
        let mut e = errors(7, 10);
        let blend: Vec<f64> = (0..30).map(|i| -(0.5 * e[1][i] + 0.2 * e[4][i]) / 0.3).collect();
        e[6] = blend;
        let best = gram(&e).choose(true);
        let mut found: Vec<(usize, f64)> = (0..best.count).map(|k| (best.members[k], best.weights[k])).collect();
        found.sort_by_key(|f| f.0);
        found.retain(|f| f.1 > 1e-3);
        assert_eq!(found.iter().map(|f| f.0).collect::<Vec<_>>(), [1, 4, 6]);
        for (f, w) in found.iter().zip([0.5, 0.2, 0.3]) {
            assert!((f.1 - w).abs() < 1e-3);
        }
    }

    #[test]
    fn the_member_that_is_dropped_is_the_one_that_costs_least() {
        let mut negative = 0;
        for seed in 0..200 {
            // What all have in common, in different amounts, drives weights below 0.
            let mut e = errors(seed, 9);
            for (a, row) in e.iter_mut().enumerate() {
                row.iter_mut()
                    .enumerate()
                    .for_each(|(i, x)| *x += 0.02 * (seed % 10) as f64 * (1.0 + 0.1 * a as f64) * (i as f64).sin());
            }
            let g = gram(&e);
            let all = g.on_simplex(&[0, 1, 2, 3, 4, 5, 6, 7, 8]);
            let tried = |drop: usize| {
                let (set, len) = without(&all, drop);
                g.on_simplex(&set[..len])
            };
            let exact = (0..all.count).map(|d| tried(d).cost).fold(f64::INFINITY, f64::min);
            let found = g.without_least(&all);
            assert!((found.cost / exact - 1.0).abs() < 1e-6, "seed {seed}: {} {exact}", found.cost);
            assert!((found.weights.iter().sum::<f64>() - 1.0).abs() < 1e-9);
            negative += (0..all.count).filter(|&d| tried(d).count + 1 < all.count).count();
        }
        assert!(negative > 0, "no removal drove another weight out");
    }

    #[test]
    fn products_that_rounding_made_indefinite_still_give_weights() {
        // Two errors that are one and the same but for rounding, their product too large, and a small one.
        let products = [1.0, 1.000_001, 1.0, 0.0, 0.0, 1e-8];
        let best = Gram::new(3, &products).choose(false);
        assert!(best.cost < 2e-8, "{best:?}");
        assert!((best.weights.iter().sum::<f64>() - 1.0).abs() < 1e-9 && best.weights.iter().all(|w| *w >= 0.0));
        let nothing = Gram::new(2, &[0.0; 3]).choose(false);
        assert!((nothing.weights.iter().sum::<f64>() - 1.0).abs() < 1e-9);
    }

    #[test]
    fn at_most_four_and_swaps_never_cost() {
        for seed in 0..100 {
            let g = gram(&errors(seed, 10));
            let (plain, swapped) = (g.choose(false), g.choose(true));
            assert!(plain.count <= 4 && swapped.count <= 4);
            assert!(swapped.cost <= plain.cost * (1.0 + 1e-12));
        }
    }
}
