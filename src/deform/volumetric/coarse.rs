//! A correction of the global step by a few dozen clusters of tetrahedra that turn as one.
//!
//! The plain step `u = A⁻¹ g` holds the rotations still while positions move, so slow modes, in which rotations and positions move together, take
//! hundreds of iterations. With rotations constant on clusters, Woodbury's identity gives the missing part: `z = A⁻¹ C S⁻¹ Cᵀ u`, where column block c
//! of C holds the loads `b_cv = Σ w_j R_j grad_jv` by which a turn of cluster c pulls at vertex v, and `S = D − Cᵀ A⁻¹ C`. The couplings
//! `m_cd = Σ_v b_cv (A⁻¹ b_d)_vᵀ` are computed once at rest and only turned with the clusters afterwards. It changes no fixed point.

use super::elements::{Blocks, Element, RIGID};
use super::handles::SoftHandles;
use crate::linalg::lanes::{Lanes, for_each_instruction_set};
use crate::linalg::rotation::{self, Quaternions};
use crate::linalg::{Cholesky, DenseCholesky, nearest_rotation};
use glam::{DMat3, DVec3};

/// Tetrahedra per cluster, and the fewest and most clusters: measured optimum of passes against their cost. Half as many clusters cost a tenth less per
/// frame, but poses of a walk are then twice as far from converged.
const TETS_PER_CLUSTER: usize = 110;
const CLUSTERS: (usize, usize) = (20, 100);

/// How many times as much the diagonal of a rigid group is stiffened as if its tetrahedra were free, at first. A free hand is as stiff as its wrist: by as much as its own stiffness asks for, it would turn by a
/// hundredth of the way in every step. Free clusters keep theirs: with more of it they come to the end later.
pub(super) const DAMPING: f64 = 10.0;
/// How many times more of it there is after a step that would have raised the energy.
pub(super) const MORE_DAMPING: f64 = 2.0;
/// The most of it.
pub(super) const MOST_DAMPING: f64 = 1000.0;

/// Rounds of Lloyd's algorithm.
const ROUNDS: usize = 8;

pub(super) struct Coarse {
    count: usize,
    /// Cluster of each lane of each block.
    clusters: Vec<[u32; 4]>,
    /// Where the load of each corner is added.
    slots: Vec<[[u32; 4]; 4]>,
    /// Slots of vertex v: `starts[v]..starts[v + 1]`, with the cluster of each.
    starts: Vec<u32>,
    slot_clusters: Vec<u32>,
    loads: Vec<Lanes>,
    /// Slots of vertices that are given and cannot be pulled.
    given: Vec<u32>,
    /// Sum of the weights of each cluster.
    weights: Vec<f64>,
    /// The same as if all of it were free: by a part of that the diagonal is stiffened.
    slack: Vec<f64>,
    /// Clusters of free tetrahedra; behind them come the rigid groups.
    free: usize,
    /// `m_cd` at rest with every handle at its full weight, `c ≥ d`, at `c · count + d`.
    rest_couplings: Vec<DMat3>,
    /// The same with the present weights.
    couplings: Vec<DMat3>,
    /// `B A₀⁻¹ b_c` at rest: cluster by cluster, one point per handle.
    handle_responses: Vec<DVec3>,
    whitened: Vec<f64>,
    sums: Vec<DMat3>,
    turns: Vec<DMat3>,
    system: DenseCholesky,
    right: Vec<f64>,
    points: Vec<Lanes>,
    ready: bool,
}

impl Coarse {
    /// `given`: vertices whose place is not solved for.
    pub(super) fn new(
        elements: &[Element],
        rest: &[DVec3],
        given: &[u32],
        blocks: &Blocks,
        handles: &SoftHandles,
        factor: &Cholesky,
    ) -> Self {
        let free: Vec<&Element> = elements.iter().take_while(|e| e.group.is_none()).collect();
        let wanted = (free.len() / TETS_PER_CLUSTER).clamp(CLUSTERS.0, CLUSTERS.1).min(free.len());
        let centroids: Vec<DVec3> =
            free.iter().map(|e| e.corners.iter().map(|&v| rest[v as usize]).sum::<DVec3>() * 0.25).collect();
        let (mut cluster, mut count) = cluster(&centroids, wanted);
        let free_clusters = count;
        for part in elements[free.len()..].chunk_by(|a, b| a.group == b.group) {
            cluster.resize(cluster.len() + part.len(), count as u32);
            count += 1;
        }
        let (mut weights, mut slack) = (vec![0.0; count], vec![0.0; count]);
        let mut pairs: Vec<(u32, u32)> = Vec::new();
        for (element, &c) in elements.iter().zip(&cluster) {
            weights[c as usize] += element.weight;
            slack[c as usize] += if element.group.is_some() { element.weight / RIGID } else { element.weight };
            pairs.extend(element.corners.iter().map(|&v| (v, c)));
        }
        pairs.sort_unstable();
        pairs.dedup();
        let mut starts = vec![0_u32; rest.len() + 1];
        for &(v, _) in &pairs {
            starts[v as usize + 1] += 1;
        }
        for v in 0..rest.len() {
            starts[v + 1] += starts[v];
        }
        let slot = |v: u32, c: u32| pairs.partition_point(|&pair| pair < (v, c)) as u32;
        // Lanes that only fill up the last block carry no weight, so any slot will do.
        let of = |block: usize, lane: usize| cluster[(4 * block + lane).min(elements.len() - 1)];
        let clusters: Vec<[u32; 4]> = (0..blocks.list.len()).map(|b| std::array::from_fn(|lane| of(b, lane))).collect();
        let slots = blocks.list.iter().zip(&clusters).map(|(block, clusters)| {
            block.corners.map(|lanes| {
                let known = |lane: usize| slot(lanes[lane], clusters[lane]).min(pairs.len() as u32 - 1);
                std::array::from_fn(known)
            })
        });
        let mut coarse = Self {
            slots: slots.collect(),
            slot_clusters: pairs.iter().map(|&(_, c)| c).collect(),
            loads: vec![Lanes::ZERO; pairs.len()],
            given: given.iter().flat_map(|&v| starts[v as usize]..starts[v as usize + 1]).collect(),
            rest_couplings: vec![DMat3::ZERO; count * count],
            couplings: Vec::new(),
            handle_responses: vec![DVec3::ZERO; count * handles.len()],
            whitened: vec![0.0; 3 * count * handles.len()],
            sums: vec![DMat3::ZERO; count],
            turns: vec![DMat3::IDENTITY; count],
            system: DenseCholesky::with_capacity(3 * count),
            right: vec![0.0; 3 * count],
            points: vec![Lanes::ZERO; count],
            ready: false,
            count,
            clusters,
            starts,
            weights,
            slack,
            free: free_clusters,
        };
        coarse.couple(blocks, handles, factor);
        coarse
    }

    fn couple(&mut self, blocks: &Blocks, handles: &SoftHandles, factor: &Cholesky) {
        let still = vec![rotation::IDENTITY; blocks.list.len()];
        blocks.turning_loads(&still, &self.slots, &self.clusters, &mut self.loads, &mut self.sums);
        self.drop_given();
        let mut response = vec![Lanes::ZERO; factor.size()];
        for d in 0..self.count {
            response.fill(Lanes::ZERO);
            for (v, response) in response.iter_mut().enumerate() {
                for s in self.slots_of(v).filter(|&s| self.slot_clusters[s] as usize == d) {
                    *response = self.loads[s];
                }
            }
            factor.solve(&mut response);
            for (v, r) in response.iter().enumerate() {
                for s in self.slots_of(v) {
                    let c = self.slot_clusters[s] as usize;
                    if c >= d {
                        let (b, r) = (self.loads[s].xyz(), r.xyz());
                        self.rest_couplings[c * self.count + d] += DMat3::from_cols(b * r.x, b * r.y, b * r.z);
                    }
                }
            }
            for h in 0..handles.len() {
                self.handle_responses[d * handles.len() + h] = handles.apply(h, &response).xyz();
            }
        }
        self.couplings = self.rest_couplings.clone();
    }

    fn drop_given(&mut self) {
        for &slot in &self.given {
            self.loads[slot as usize] = Lanes::ZERO;
        }
    }

    fn slots_of(&self, v: usize) -> std::ops::Range<usize> {
        self.starts[v] as usize..self.starts[v + 1] as usize
    }

    /// Takes over changed weights of the handles: `m_cd += (Bₛ Z_c)ᵀ √D (I − √D S √D)⁻¹ √D (Bₛ Z_d)`.
    pub(super) fn rehandle(&mut self, handles: &SoftHandles) {
        self.couplings.copy_from_slice(&self.rest_couplings);
        let (released, roots, capacitance) = handles.released();
        let size = released.len();
        if size == 0 {
            return;
        }
        for c in 0..self.count {
            for axis in 0..3 {
                let column = &mut self.whitened[(3 * c + axis) * size..][..size];
                for ((x, &h), root) in column.iter_mut().zip(released).zip(roots) {
                    *x = self.handle_responses[c * handles.len() + h][axis] * root;
                }
                capacitance.solve_lower(column);
            }
        }
        for c in 0..self.count {
            for d in 0..=c {
                let coupling = &mut self.couplings[c * self.count + d];
                for k in 0..3 {
                    for i in 0..3 {
                        let (a, b) = (&self.whitened[(3 * c + i) * size..][..size], &self.whitened[(3 * d + k) * size..][..size]);
                        coupling.col_mut(k)[i] += a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
                    }
                }
            }
        }
    }

    /// Turns loads and couplings with the present rotations and factors `S`. `damping`: how many times as much the diagonal of a rigid group is stiffened
    /// as if it were free, see [`DAMPING`]. Without success [`Self::is_ready`] says no until the next call.
    pub(super) fn build(&mut self, blocks: &Blocks, rotations: &[Quaternions], damping: f64) {
        self.loads.fill(Lanes::ZERO);
        self.sums.fill(DMat3::ZERO);
        blocks.turning_loads(rotations, &self.slots, &self.clusters, &mut self.loads, &mut self.sums);
        self.drop_given();
        for (turn, sum) in self.turns.iter_mut().zip(&self.sums) {
            *turn = nearest_rotation(*sum, DMat3::IDENTITY);
        }
        // The couplings are exact only at rest, so S may lose its sign: a stiffer diagonal gives a shorter step.
        let mut shift = 0.01;
        self.ready = false;
        for _ in 0..12 {
            self.fill(shift, damping);
            if self.system.factor() {
                self.ready = true;
                return;
            }
            shift *= 2.0;
        }
    }

    fn fill(&mut self, shift: f64, damping: f64) {
        let size = 3 * self.count;
        let system = self.system.refill(size);
        let slack = |c: usize| if c < self.free { self.slack[c] } else { self.slack[c] * damping };
        for d in 0..self.count {
            let back = self.turns[d].transpose();
            for c in d..self.count {
                let m = self.turns[c] * self.couplings[c * self.count + d] * back;
                let trace = m.x_axis.x + m.y_axis.y + m.z_axis.z;
                let diagonal = if c == d { 2.0 * (self.weights[c] + shift * slack(c)) - trace } else { -trace };
                for k in 0..3 {
                    for i in 0..3 {
                        // S takes the transpose of m: m[k][i] is row k, column i.
                        let entry = m.col(i)[k] + if i == k { diagonal } else { 0.0 };
                        system[(3 * d + k) * size + 3 * c + i] = entry;
                    }
                }
            }
        }
    }

    pub(super) fn has_rigid_groups(&self) -> bool {
        self.free < self.count
    }

    pub(super) fn is_ready(&self) -> bool {
        self.ready
    }

    /// From `u = A⁻¹ g`: the load `C S⁻¹ Cᵀ u` whose solution, added to u, completes the step.
    pub(super) fn load(&mut self, u: &[Lanes], load: &mut [Lanes]) {
        self.points.fill(Lanes::ZERO);
        gather(&self.starts, &self.slot_clusters, &self.loads, u, &mut self.points);
        for (right, y) in self.right.chunks_exact_mut(3).zip(&self.points) {
            right.copy_from_slice(&y.0[..3]);
        }
        self.system.solve(&mut self.right);
        for (right, y) in self.right.chunks_exact(3).zip(&mut self.points) {
            *y = Lanes([right[0], right[1], right[2], 0.0]);
        }
        scatter(&self.starts, &self.slot_clusters, &self.loads, &self.points, load);
    }
}

for_each_instruction_set! {
    fn gather(starts: &[u32], clusters: &[u32], loads: &[Lanes], u: &[Lanes], sums: &mut [Lanes]) {
        for (range, u) in starts.windows(2).zip(u) {
            let range = range[0] as usize..range[1] as usize;
            for (&c, b) in clusters[range.clone()].iter().zip(&loads[range]) {
                sums[c as usize] += b.cross(*u);
            }
        }
    }
}

for_each_instruction_set! {
    fn scatter(starts: &[u32], clusters: &[u32], loads: &[Lanes], y: &[Lanes], out: &mut [Lanes]) {
        for (range, out) in starts.windows(2).zip(out) {
            let range = range[0] as usize..range[1] as usize;
            let mut sum = Lanes::ZERO;
            for (&c, b) in clusters[range.clone()].iter().zip(&loads[range]) {
                sum += y[c as usize].cross(*b);
            }
            *out = sum;
        }
    }
}

/// k-means from farthest-point seeds; returns the cluster of each point and the number of clusters, none of them empty.
fn cluster(points: &[DVec3], wanted: usize) -> (Vec<u32>, usize) {
    let mut centres = Vec::with_capacity(wanted);
    let mut nearest = vec![f64::INFINITY; points.len()];
    let mut seed = 0;
    for _ in 0..wanted {
        let centre = points[seed];
        centres.push(centre);
        for (d, p) in nearest.iter_mut().zip(points) {
            *d = d.min(p.distance_squared(centre));
        }
        seed = (0..points.len()).fold(0, |best, i| if nearest[i] > nearest[best] { i } else { best });
    }
    let mut cluster = vec![0_u32; points.len()];
    for _ in 0..ROUNDS {
        for (c, p) in cluster.iter_mut().zip(points) {
            let mut best = f64::INFINITY;
            for (k, centre) in centres.iter().enumerate() {
                let d = p.distance_squared(*centre);
                if d < best {
                    (best, *c) = (d, k as u32);
                }
            }
        }
        let mut sums = vec![(DVec3::ZERO, 0.0); centres.len()];
        for (&c, p) in cluster.iter().zip(points) {
            let (sum, count) = &mut sums[c as usize];
            *sum += *p;
            *count += 1.0;
        }
        for (centre, (sum, count)) in centres.iter_mut().zip(sums) {
            if count > 0.0 {
                *centre = sum / count;
            }
        }
    }
    let mut used = vec![false; centres.len()];
    for &c in &cluster {
        used[c as usize] = true;
    }
    let mut number = vec![0_u32; centres.len()];
    let mut count = 0;
    for (number, _) in number.iter_mut().zip(&used).filter(|(_, used)| **used) {
        *number = count;
        count += 1;
    }
    for c in &mut cluster {
        *c = number[*c as usize];
    }
    (cluster, count as usize)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn separate_heaps_are_separate_clusters() {
        let points: Vec<DVec3> = (0..30).map(|i| DVec3::new(f64::from(i / 10) * 100.0, f64::from(i % 10), 0.0)).collect();
        let (cluster, count) = cluster(&points, 3);
        assert_eq!(count, 3);
        assert!((0..30).all(|i| cluster[i] == cluster[i / 10 * 10]));
    }

    #[test]
    fn coincident_points_leave_no_empty_cluster() {
        assert_eq!(cluster(&[DVec3::ONE; 5], 4), (vec![0; 5], 1));
    }
}
