//! The normal equations of a Gauss–Newton step (Fröhlich & Botsch 2011, (9) and §6.2): a sparse matrix of one pattern for the positions, the
//! dense row of the volume by Sherman and Morrison, the columns of the example weights by their Schur complement.

use super::quadratic::{Bounds, Quadratic};
use super::shell::Shell;
use crate::linalg::elimination_order;
use crate::linalg::repeated::RepeatedCholesky;
use glam::{DMat3, DVec3};

/// No place, no block: of vertices that are held.
const NONE: u32 = u32::MAX;
/// Tries to make the matrix positive definite by more damping, a hundred times more each.
const DAMPINGS: usize = 5;

/// Residuals and their derivatives at a pose, weighted.
#[derive(Clone, Debug, Default)]
pub(super) struct Linearization {
    /// Residual of each edge and hinge, and of the volume.
    pub stretch: Vec<f64>,
    pub bend: Vec<f64>,
    pub swell: f64,
    /// Derivative of each edge with respect to its second end; the first has the opposite.
    pub edges: Vec<DVec3>,
    /// Lengths of the edges.
    pub lengths: Vec<f64>,
    pub hinges: Vec<[DVec3; 4]>,
    /// What holds each hinge back: a share of its stiffness, and the residual of that, times the share.
    pub drags: Vec<f64>,
    pub drag: Vec<f64>,
    pub volume: Vec<DVec3>,
    /// Per pull: derivative of the point that it holds with respect to each of its vertices.
    pub pulls: Vec<Vec<DMat3>>,
}

/// A pull on the pose: a row over vertices.
#[derive(Clone, Debug, Default)]
pub(super) struct Pull {
    pub vertices: Vec<u32>,
    pub values: Vec<f64>,
}

/// A step: moves of the vertices and changes of the weights.
#[derive(Clone, Debug, Default)]
pub(super) struct Direction {
    pub moves: Vec<DVec3>,
    pub weights: Vec<f64>,
}

/// Pattern, factor and memory of the normal equations.
#[derive(Debug)]
pub(super) struct System {
    /// Place of each vertex among the unknowns.
    places: Vec<u32>,
    /// Corners of each hinge by falling places, and the blocks of their pairs.
    hinge_orders: Vec<[u8; 4]>,
    hinge_blocks: Vec<[u32; 10]>,
    /// Blocks of the second end, the first end, both.
    edge_blocks: Vec<[u32; 3]>,
    /// Per pull: blocks with the vertices of their row and column.
    pull_pairs: Vec<Vec<(u32, u32, u32)>>,
    /// First block of each column of blocks; the diagonal one comes first.
    block_starts: Vec<u32>,
    /// By rows.
    blocks: Vec<[f64; 9]>,
    values: Vec<f64>,
    cholesky: RepeatedCholesky,
    /// Right sides one after the other: forces, volume, examples.
    sides: Vec<f64>,
    columns: usize,
    /// Forces, volume gradient and example columns as they were before they were solved for.
    given: Vec<f64>,
    schur: Vec<f64>,
    reduced: Vec<f64>,
    quadratic: Quadratic,
}

impl System {
    /// Analyses the pattern. `held`: vertices that do not move; `pulls`: rows that may pull.
    pub fn new(shell: &Shell, held: &[bool], pulls: &[Pull]) -> Self {
        let n = shell.rest.len();
        let topology = &shell.topology;
        // A vertex of no face has nothing that holds it.
        let mut used = vec![false; n];
        shell.faces.iter().flatten().for_each(|&v| used[v as usize] = true);
        let free = |v: u32| used[v as usize] && !held[v as usize];
        let groups = || {
            let edges = topology.edges.iter().map(|e| e.as_slice());
            let hinges = topology.hinges.iter().map(|h| h.as_slice());
            edges.chain(hinges).chain(pulls.iter().map(|p| p.vertices.as_slice()))
        };
        let mut places = vec![NONE; n];
        let order: Vec<u32> = elimination_order(n, groups()).into_iter().filter(|&v| free(v)).collect();
        order.iter().zip(0..).for_each(|(&v, place)| places[v as usize] = place);
        let mut pairs: Vec<(u32, u32)> = (0..order.len() as u32).map(|p| (p, p)).collect();
        for group in groups() {
            for (i, &a) in group.iter().enumerate() {
                for &b in &group[..i] {
                    let (a, b) = (places[a as usize], places[b as usize]);
                    if a != NONE && b != NONE && a != b {
                        pairs.push((a.min(b), a.max(b)));
                    }
                }
            }
        }
        pairs.sort_unstable();
        pairs.dedup();
        let mut block_starts = vec![0_u32; order.len() + 1];
        pairs.iter().for_each(|(column, _)| block_starts[*column as usize + 1] += 1);
        (0..order.len()).for_each(|c| block_starts[c + 1] += block_starts[c]);
        let block = |a: u32, b: u32| -> u32 {
            let (a, b) = (places[a as usize], places[b as usize]);
            if a == NONE || b == NONE {
                return NONE;
            }
            pairs.binary_search(&(a.min(b), a.max(b))).map_or(NONE, |at| at as u32)
        };
        let mut hinge_orders = Vec::with_capacity(topology.hinges.len());
        let mut hinge_blocks = Vec::with_capacity(topology.hinges.len());
        for hinge in &topology.hinges {
            let mut corners = [0_u8, 1, 2, 3];
            corners.sort_by_key(|&c| std::cmp::Reverse(places[hinge[c as usize] as usize]));
            let mut slots = [NONE; 10];
            for (slot, (i, j)) in slots.iter_mut().zip(PAIRS) {
                *slot = block(hinge[corners[i] as usize], hinge[corners[j] as usize]);
            }
            hinge_orders.push(corners);
            hinge_blocks.push(slots);
        }
        let edge_blocks = topology.edges.iter().map(|&[a, b]| [block(b, b), block(a, a), block(a, b)]).collect();
        let pull_pairs = pulls
            .iter()
            .map(|pull| {
                let all = pull.vertices.iter().enumerate().flat_map(|(i, &a)| {
                    let pair = move |(j, &b): (usize, &u32)| (a, b, i as u32, j as u32);
                    pull.vertices[..=i].iter().enumerate().map(pair)
                });
                let falling = |a: u32, b: u32| places[a as usize] >= places[b as usize];
                let placed = all.map(|(a, b, i, j)| (block(a, b), if falling(a, b) { (i, j) } else { (j, i) }));
                placed.filter(|(slot, _)| *slot != NONE).map(|(slot, (i, j))| (slot, i, j)).collect()
            })
            .collect();
        let (starts, rows) = scalar_pattern(&block_starts, &pairs);
        let size = 3 * order.len();
        let columns = shell.examples.len();
        let analysed = RepeatedCholesky::analyse(starts, rows, columns + 2);
        let cholesky =
            analysed.unwrap_or_else(|_| unreachable!("faer counts entries by 32 bits only for patterns beyond all meshes"));
        Self {
            places,
            hinge_orders,
            hinge_blocks,
            edge_blocks,
            pull_pairs,
            block_starts,
            blocks: vec![[0.0; 9]; pairs.len()],
            values: vec![0.0; cholesky_entries(&pairs)],
            cholesky,
            sides: vec![0.0; size * (columns + 2)],
            given: vec![0.0; size * (columns + 2)],
            columns,
            schur: vec![0.0; columns * columns],
            reduced: vec![0.0; columns],
            quadratic: Quadratic::with_capacity(columns),
        }
    }

    /// Adds the matrix of the pose: `Σ g gᵀ` over edges, hinges and pulls; with `tension` also the second derivative of stretched edges, which is
    /// positive and has the same pattern.
    fn assemble(&mut self, shell: &Shell, at: &Linearization, pull_weights: &[f64], tension: bool, damping: f64) {
        self.blocks.fill([0.0; 9]);
        for (slots, (e, (g, (residual, length)))) in
            self.edge_blocks.iter().zip(at.edges.iter().zip(at.stretch.iter().zip(&at.lengths)).enumerate())
        {
            let mut k = outer(*g, *g);
            if tension && *residual > 0.0 {
                let along = *g / shell.stretch[e];
                let stiffness = shell.stretch[e] * residual / length.max(f64::MIN_POSITIVE);
                let across = outer(along, along);
                for (i, (k, across)) in k.iter_mut().zip(across).enumerate() {
                    *k += stiffness * (if i % 4 == 0 { 1.0 } else { 0.0 } - across);
                }
            }
            for (&slot, sign) in slots.iter().zip([1.0, 1.0, -1.0]) {
                if slot != NONE {
                    self.blocks[slot as usize].iter_mut().zip(k).for_each(|(b, k)| *b += sign * k);
                }
            }
        }
        let hinges = self.hinge_orders.iter().zip(&self.hinge_blocks).zip(&at.hinges);
        for (((corners, slots), gradients), drag) in hinges.zip(&at.drags) {
            let g = corners.map(|c| gradients[c as usize] * (1.0 + drag).sqrt());
            for (&slot, (i, j)) in slots.iter().zip(PAIRS) {
                if slot != NONE {
                    let k = outer(g[i], g[j]);
                    self.blocks[slot as usize].iter_mut().zip(k).for_each(|(b, k)| *b += k);
                }
            }
        }
        let pulls = self.pull_pairs.iter().zip(&at.pulls).zip(pull_weights);
        for ((pairs, maps), weight) in pulls.filter(|(_, weight)| **weight != 0.0) {
            for &(slot, i, j) in pairs {
                let product = maps[i as usize].transpose() * maps[j as usize];
                // By rows, where the matrix has its columns.
                let product = product.transpose().to_cols_array();
                self.blocks[slot as usize].iter_mut().zip(product).for_each(|(b, k)| *b += weight * k);
            }
        }
        let count = self.block_starts.len() - 1;
        let diagonal = |c: usize| self.block_starts[c] as usize;
        let trace: f64 = (0..count).map(|c| [0, 4, 8].map(|k| self.blocks[diagonal(c)][k]).iter().sum::<f64>()).sum();
        let least = 1e-3 * trace / (3 * count).max(1) as f64;
        let mut at = 0;
        for c in 0..count {
            let column = &self.blocks[self.block_starts[c] as usize..self.block_starts[c + 1] as usize];
            for k in 0..3 {
                self.values[at] = column[0][4 * k] + damping * column[0][4 * k].max(least);
                at += 1;
                for row in k + 1..3 {
                    self.values[at] = column[0][3 * row + k];
                    at += 1;
                }
                for block in &column[1..] {
                    self.values[at..at + 3].copy_from_slice(&[block[k], block[3 + k], block[6 + k]]);
                    at += 3;
                }
            }
        }
    }

    /// The right sides at a pose, which do not depend on the matrix.
    ///
    /// `pull_forces`: what each pull adds to the forces; `free`: whether the weights of the examples are unknown.
    pub fn load(&mut self, shell: &Shell, at: &Linearization, pulls: &[Pull], pull_forces: &[DVec3], free: bool) {
        let size = self.cholesky.size();
        self.given.fill(0.0);
        let (forces, rest) = self.given.split_at_mut(size);
        let (volume, examples) = rest.split_at_mut(size);
        let places = &self.places;
        let add = |to: &mut [f64], v: u32, by: DVec3| {
            let place = places[v as usize];
            if place != NONE {
                let to = &mut to[3 * place as usize..][..3];
                to[0] += by.x;
                to[1] += by.y;
                to[2] += by.z;
            }
        };
        let transposed = |to: &mut [f64], sign: f64, stretch: &[f64], bend: &[f64]| {
            for (([a, b], g), f) in shell.topology.edges.iter().zip(&at.edges).zip(stretch) {
                let force = *g * (sign * f);
                add(to, *b, force);
                add(to, *a, -force);
            }
            for ((hinge, g), f) in shell.topology.hinges.iter().zip(&at.hinges).zip(bend) {
                if *f != 0.0 {
                    hinge.iter().zip(g).for_each(|(&v, g)| add(to, v, *g * (sign * f)));
                }
            }
        };
        transposed(forces, -1.0, &at.stretch, &at.bend);
        transposed(forces, -1.0, &[], &at.drag);
        if free {
            for (column, example) in examples.chunks_mut(size.max(1)).zip(&shell.examples) {
                transposed(column, 1.0, &example.stretch, &example.bend);
            }
        }
        for ((pull, maps), force) in pulls.iter().zip(&at.pulls).zip(pull_forces) {
            pull.vertices.iter().zip(maps).for_each(|(&v, map)| add(forces, v, map.transpose() * *force));
        }
        for (v, g) in at.volume.iter().enumerate() {
            add(volume, v as u32, *g);
        }
        if free {
            for (column, example) in examples.chunks_mut(size.max(1)).zip(&shell.examples) {
                column.iter_mut().zip(&*volume).for_each(|(c, u)| *c += example.swell * u);
            }
        }
        forces.iter_mut().zip(&*volume).for_each(|(f, u)| *f -= at.swell * u);
    }

    /// The step from a pose whose right sides are loaded; `None` where no damping makes the matrix positive definite.
    #[allow(clippy::too_many_arguments)]
    pub fn direction(
        &mut self,
        shell: &Shell,
        at: &Linearization,
        pull_weights: &[f64],
        tension: bool,
        damping: f64,
        weights: Option<&Unknown<'_>>,
        out: &mut Direction,
    ) -> Option<()> {
        let mut damping = damping;
        for _ in 0..DAMPINGS {
            self.assemble(shell, at, pull_weights, tension, damping);
            if self.cholesky.factor(&self.values).is_ok() {
                self.solve(shell, at, weights, out);
                return Some(());
            }
            damping *= 100.0;
        }
        None
    }

    fn solve(&mut self, shell: &Shell, at: &Linearization, weights: Option<&Unknown<'_>>, out: &mut Direction) {
        let size = self.cholesky.size();
        let columns = if weights.is_some() { self.columns } else { 0 };
        let count = size * (columns + 2);
        self.sides[..count].copy_from_slice(&self.given[..count]);
        self.cholesky.solve(&mut self.sides[..count]);
        let (forces, rest) = self.sides[..count].split_at_mut(size);
        let (volume, examples) = rest.split_at_mut(size);
        let u = &self.given[size..2 * size];
        let scale = 1.0 / (1.0 + dot(u, volume));
        let correct = |y: &mut [f64]| {
            let share = scale * dot(u, y);
            y.iter_mut().zip(&*volume).for_each(|(y, z)| *y -= share * z);
        };
        correct(forces);
        examples.chunks_mut(size.max(1)).for_each(correct);
        out.weights.fill(0.0);
        if let Some(unknown) = weights {
            let columns_given = &self.given[2 * size..count];
            let column = |i: usize, of: &[f64]| -> std::ops::Range<usize> { i * size..((i + 1) * size).min(of.len()) };
            for i in 0..columns {
                let given = &columns_given[column(i, columns_given)];
                let a = &shell.examples[i];
                for j in 0..columns {
                    let b = &shell.examples[j];
                    let own = dot(&a.stretch, &b.stretch) + dot(&a.bend, &b.bend) + a.swell * b.swell;
                    self.schur[i * columns + j] = own - dot(given, &examples[column(j, examples)]);
                }
                let pulled = a.curvature * unknown.regularization;
                self.schur[i * columns + i] += pulled;
                let force = dot(&a.stretch, &at.stretch) + dot(&a.bend, &at.bend) + a.swell * at.swell;
                self.reduced[i] = -force - pulled * unknown.weights[i] - dot(given, forces);
            }
            self.quadratic.least(&self.schur, &self.reduced, unknown.bounds, unknown.weights, &mut out.weights);
            for (column, weight) in examples.chunks(size.max(1)).zip(&out.weights) {
                forces.iter_mut().zip(column).for_each(|(f, c)| *f -= weight * c);
            }
        }
        for (place, step) in self.places.iter().zip(&mut out.moves) {
            *step = if *place == NONE { DVec3::ZERO } else { DVec3::from_slice(&forces[3 * *place as usize..][..3]) };
        }
    }
}

/// Example weights that are to be found.
#[derive(Clone, Copy, Debug)]
pub(super) struct Unknown<'a> {
    pub weights: &'a [f64],
    pub bounds: Bounds,
    /// How strongly they are drawn to 0, against what they resist on their own.
    pub regularization: f64,
}

/// Pairs of four corners, the first not after the second.
const PAIRS: [(usize, usize); 10] = [(0, 0), (0, 1), (0, 2), (0, 3), (1, 1), (1, 2), (1, 3), (2, 2), (2, 3), (3, 3)];

/// By rows.
fn outer(a: DVec3, b: DVec3) -> [f64; 9] {
    [a.x * b.x, a.x * b.y, a.x * b.z, a.y * b.x, a.y * b.y, a.y * b.z, a.z * b.x, a.z * b.y, a.z * b.z]
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    let mut sums = [0.0; 4];
    let (a4, a_rest) = a.as_chunks::<4>();
    let (b4, b_rest) = b.as_chunks::<4>();
    for (x, y) in a4.iter().zip(b4) {
        for k in 0..4 {
            sums[k] += x[k] * y[k];
        }
    }
    let rest: f64 = a_rest.iter().zip(b_rest).map(|(x, y)| x * y).sum();
    (sums[0] + sums[1]) + (sums[2] + sums[3]) + rest
}

fn cholesky_entries(pairs: &[(u32, u32)]) -> usize {
    pairs.iter().map(|(a, b)| if a == b { 6 } else { 9 }).sum()
}

/// The lower triangle of scalars of a matrix of blocks.
fn scalar_pattern(block_starts: &[u32], pairs: &[(u32, u32)]) -> (Vec<u32>, Vec<u32>) {
    let (mut starts, mut rows) = (vec![0], Vec::with_capacity(cholesky_entries(pairs)));
    for range in block_starts.windows(2) {
        let column = &pairs[range[0] as usize..range[1] as usize];
        for k in 0..3 {
            rows.extend((k..3).map(|row| 3 * column[0].1 + row));
            rows.extend(column[1..].iter().flat_map(|(_, row)| (0..3).map(move |k| 3 * row + k)));
            starts.push(rows.len() as u32);
        }
    }
    (starts, rows)
}
