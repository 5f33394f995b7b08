//! The tetrahedra as the energy sees them: hat gradients, weights, and one fused pass over positions and rotations.

use super::Options;
use crate::error::{Error, Result};
use crate::linalg::lanes::{Lanes, for_each_instruction_set, transpose};
use crate::linalg::rotation::{self, Matrices, Quaternions};
use crate::proxy::Proxy;
use crate::statistics::middle;
use glam::{DMat3, DVec3};
use std::ops::Range;

/// One tetrahedron at rest.
#[derive(Clone, Debug)]
pub(super) struct Element {
    pub(super) corners: [u32; 4],
    /// The rigid group it belongs to.
    pub(super) group: Option<u32>,
    /// Gradients of the four hat functions (Stoll et al. 2007, (2.2)–(2.3)).
    pub(super) gradients: [DVec3; 4],
    pub(super) volume: f64,
    /// Volume, less where the tetrahedron would be a sliver stiffer than the cap.
    pub(super) capped: f64,
    /// `capped` times the stiffness times [`in_matrix`]: the weight in the matrix. The energy has it without that.
    pub(super) weight: f64,
    /// Weight of the change of volume, relative to that of a tetrahedron that is no sliver.
    pub(super) bulk: f64,
}

/// Below this part of its volume a tetrahedron resists with so many times the bulk more, slivers too. It calms deep creases, where whole rows of
/// tetrahedra turn inside out and snap back: in a squat a fifth of the frames with more than ten of them inside out and two thirds of the farthest jump
/// from frame to frame, for the same passes. Twice as much takes twice the passes.
const FOLDED: f64 = 0.25;
const FOLDED_BULK: f64 = 4.0;
/// The change of volume `g` counts as `g² / (1 + g² · SATURATION)`.
const SATURATION: f64 = 0.25;

/// Weight of a tetrahedron in the matrix over that in the energy, so that the matrix bounds the curvature of the change of volume too. `1 + bulk` would
/// do where nothing is folded; with that, folds and their drag make every fifth step too long, which costs half as many passes again.
fn in_matrix(bulk: f64) -> f64 {
    1.0 + 2.0 * bulk
}

/// Slivers stiffer than this many medians count less in the change of volume: a small move turns and stretches them without end, so that its
/// curvature has no bound there, while their volume is next to nothing.
const SLENDER: f64 = 3.0;

/// Below this ratio of six volumes to the cube of the longest edge the gradients are rounding; such a tetrahedron is left out.
const FLAT: f64 = 1e-7;

/// How many times as stiff the tetrahedra of a rigid group are: a shared rotation alone leaves half of their deformation.
pub(super) const RIGID: f64 = 100.0;

/// Rigid group of each tetrahedron.
fn groups(proxy: &Proxy, rigid: &[Vec<u32>]) -> Result<Vec<Option<u32>>> {
    let mut groups = vec![None; proxy.tets.len()];
    for (number, tets) in rigid.iter().enumerate() {
        for &tet in tets {
            let refuse = |what: String| Err(Error::refused(format!("rigid group {number}: {what}")));
            let Some(group) = groups.get_mut(tet as usize) else {
                return refuse(format!("tetrahedron {tet} of a proxy with {}", proxy.tets.len()));
            };
            match group.replace(number as u32) {
                Some(other) if other != number as u32 => return refuse(format!("tetrahedron {tet} is in group {other} too")),
                _ => {}
            }
        }
    }
    Ok(groups)
}

/// The tetrahedra of a proxy. `sliver_cap` limits `volume · |gradient|²`, in medians: a flat tetrahedron is a stiff one.
pub(super) fn elements(proxy: &Proxy, options: &Options) -> Result<Vec<Element>> {
    let stiffness = &options.stiffness;
    let groups = groups(proxy, &options.rigid)?;
    if !stiffness.is_empty() && stiffness.len() != proxy.tets.len() {
        return Err(Error::refused(format!("{} stiffness values for {} tetrahedra", stiffness.len(), proxy.tets.len())));
    }
    if let Some(j) = stiffness.iter().position(|k| !(k.is_finite() && *k > 0.0)) {
        return Err(Error::refused(format!("stiffness {} of tetrahedron {j}", stiffness[j])).expected("a positive number"));
    }
    if let Some(v) = proxy.rest.iter().position(|p| !p.is_finite()) {
        return Err(Error::refused(format!("vertex {v} of the proxy is not a point: {}", proxy.rest[v])));
    }
    let mut elements = Vec::with_capacity(proxy.tets.len());
    for (j, &corners) in proxy.tets.iter().enumerate() {
        let p = corners.map(|v| proxy.rest[v as usize]);
        let (a, b, c) = (p[0] - p[3], p[1] - p[3], p[2] - p[3]);
        let six_volumes = a.dot(b.cross(c));
        let longest = [a, b, c, p[0] - p[1], p[1] - p[2], p[2] - p[0]].iter().fold(0.0_f64, |m, e| m.max(e.length()));
        if six_volumes.is_nan() || six_volumes.abs() <= FLAT * longest.powi(3) {
            continue;
        }
        let (ga, gb, gc) = (b.cross(c) / six_volumes, c.cross(a) / six_volumes, a.cross(b) / six_volumes);
        let volume = six_volumes.abs() / 6.0;
        let weight = stiffness.get(j).copied().unwrap_or(1.0) * groups[j].map_or(1.0, |_| RIGID);
        let gradients = [ga, gb, gc, -(ga + gb + gc)];
        elements.push(Element { corners, group: groups[j], gradients, volume, capped: volume, weight, bulk: 1.0 });
    }
    cap_slivers(&mut elements, options.sliver_cap);
    for element in &mut elements {
        element.weight *= element.capped * in_matrix(options.effective_bulk());
    }
    Ok(elements)
}

fn cap_slivers(elements: &mut [Element], cap: f64) {
    let entry = |e: &Element| e.volume * e.gradients.iter().fold(0.0_f64, |m, g| m.max(g.length_squared()));
    let mut entries: Vec<f64> = elements.iter().map(entry).collect();
    let Some(median) = middle(&mut entries) else { return };
    for element in elements {
        let medians = entry(element) / median;
        element.bulk *= (SLENDER / medians).min(1.0);
        let excess = medians / cap;
        if excess > 1.0 {
            element.capped = element.volume / excess;
        }
    }
}

/// Elements in the order of their vertices, dealt out so that the four of a block come from four quarters of that order: neighbours in a block would
/// wait for each other when they add to the same vertex. First those with a rotation of their own, then group by group; each part is filled up to
/// whole blocks with tetrahedra without weight and volume.
pub(super) fn arrange(mut elements: Vec<Element>) -> Vec<Element> {
    elements.sort_by_key(|e| (e.group, e.corners.iter().copied().min()));
    let mut arranged = Vec::with_capacity(elements.len() + 4);
    for part in elements.chunk_by(|a, b| a.group == b.group) {
        let blocks = part.len() / 4;
        let dealt = (0..blocks).flat_map(|b| (0..4).map(move |lane| lane * blocks + b));
        arranged.extend(dealt.chain(4 * blocks..part.len()).map(|j| part[j].clone()));
        let filler = Element { volume: 0.0, capped: 0.0, weight: 0.0, ..part[0].clone() };
        arranged.resize(arranged.len().next_multiple_of(4), filler);
    }
    arranged
}

/// Four tetrahedra side by side.
#[derive(Clone, Debug)]
pub(super) struct Block {
    /// Vertex of each corner, lane by lane.
    pub(super) corners: [[u32; 4]; 4],
    /// Gradients of the first three hats, x y z each.
    gradients: [Lanes; 9],
    /// Zero in lanes that only fill up the last block.
    weight: Lanes,
    volume: Lanes,
    /// Relative to the bulk of the others.
    bulk: Lanes,
}

/// The tetrahedra in blocks of four, in a fixed order.
#[derive(Clone, Debug)]
pub(super) struct Blocks {
    pub(super) list: Vec<Block>,
    /// The first so many have a rotation per tetrahedron.
    free: usize,
    /// The others share one rotation per range.
    groups: Vec<Range<usize>>,
    /// Tetrahedra whose corners are all given: nothing to solve, but they have a volume.
    held: Vec<Block>,
    pub(super) total_weight: f64,
    total_volume: f64,
    /// The weight of the change of volume.
    bulk: f64,
}

impl Blocks {
    /// From arranged elements. `bulk`: weight of the change of volume against that of the deformation, which the weights of the elements include
    /// (see [`elements`]).
    pub(super) fn new(elements: &[Element], held: &[Element], bulk: f64) -> Self {
        let list: Vec<Block> = elements.chunks(4).map(Block::new).collect();
        let free = elements.iter().filter(|e| e.group.is_none()).count() / 4;
        let mut groups = Vec::new();
        for part in elements[4 * free..].chunk_by(|a, b| a.group == b.group) {
            let start = groups.last().map_or(free, |last: &Range<usize>| last.end);
            groups.push(start..start + part.len() / 4);
        }
        Self {
            list,
            free,
            groups,
            held: held.chunks(4).map(Block::new).collect(),
            total_weight: elements.iter().map(|e| e.weight).sum(),
            total_volume: elements.iter().chain(held).map(|e| e.volume).sum(),
            bulk,
        }
    }

    /// `newton` steps of every rotation towards the deformation gradients of `p`, then energy and half its gradient by `p`, which is written to `g`.
    pub(super) fn pass(&self, p: &[Lanes], rotations: &mut [Quaternions], newton: u32, g: &mut [Lanes]) -> f64 {
        self.pass_with(self.bulk, p, rotations, newton, g)
    }

    /// The same for the energy without the change of volume, with the weights of the matrix: its matrix is exactly the factored one.
    pub(super) fn pass_without_bulk(&self, p: &[Lanes], rotations: &mut [Quaternions], g: &mut [Lanes]) {
        self.pass_with(0.0, p, rotations, 0, g);
    }

    fn pass_with(&self, bulk: f64, p: &[Lanes], rotations: &mut [Quaternions], newton: u32, g: &mut [Lanes]) -> f64 {
        g.fill(Lanes::ZERO);
        let scales = (1.0 / in_matrix(bulk), bulk);
        let mut energy = pass(&self.list[..self.free], p, &mut rotations[..self.free], newton, scales, g);
        for range in &self.groups {
            let (blocks, rotations) = (&self.list[range.clone()], &mut rotations[range.clone()]);
            if newton > 0 {
                let (f, mut q) = (mean_deformation(blocks, p), rotations[0]);
                for _ in 0..newton {
                    rotation::newton_step(&f, &mut q);
                }
                rotations.fill(q);
            }
            energy += pass(blocks, p, rotations, 0, scales, g);
        }
        energy
    }

    /// Blocks of tetrahedra with a rotation of their own of which one has less than `part` of its volume.
    pub(super) fn below(&self, p: &[Lanes], part: f64, found: &mut Vec<usize>) {
        below(&self.list[..self.free], p, part, found);
    }

    /// Deformation gradients of a block.
    #[inline(always)]
    pub(super) fn deformation(&self, block: usize, p: &[Lanes]) -> Matrices {
        deformation(&self.list[block], p)
    }

    /// Weights of a block in the energy; zero in lanes that only fill it up.
    pub(super) fn weight(&self, block: usize) -> Lanes {
        self.list[block].weight * (1.0 / in_matrix(self.bulk))
    }

    /// Adds to half a gradient by the points what a block has by the deformation gradients.
    #[inline(always)]
    pub(super) fn add_pull(&self, block: usize, pull: &Matrices, g: &mut [Lanes]) {
        let block = &self.list[block];
        add_to_corners(&block.corners, &hat_products(block, pull), g);
    }

    /// The ranges of blocks that share a rotation.
    pub(super) fn groups(&self) -> &[Range<usize>] {
        &self.groups
    }

    /// Weight of the change of volume.
    pub(super) fn bulk(&self) -> f64 {
        self.bulk
    }

    /// The rotations nearest to the deformation gradients of `p`, to rounding.
    pub(super) fn extract(&self, p: &[Lanes], rotations: &mut [Quaternions]) {
        extract(&self.list[..self.free], p, rotations);
        for range in &self.groups {
            let mut q = rotations[range.start];
            rotation::extract(&mean_deformation(&self.list[range.clone()], p), &mut q);
            rotations[range.clone()].fill(q);
        }
    }

    /// Adds the loads by which a turn of the tetrahedra pulls at their corners, `w R grad`, corner by corner at `slots`; and `w R` itself to the sums of
    /// their `clusters`.
    pub(super) fn turning_loads(
        &self,
        rotations: &[Quaternions],
        slots: &[[[u32; 4]; 4]],
        clusters: &[[u32; 4]],
        loads: &mut [Lanes],
        sums: &mut [DMat3],
    ) {
        turning_loads(&self.list, rotations, slots, clusters, loads, sums);
    }

    /// Tetrahedra turned inside out, the corners of the one with the most volume, and the volume of all against rest.
    pub(super) fn measure(&self, p: &[Lanes]) -> (u32, Option<[u32; 4]>, f64) {
        let ((inverted, worst, volume), (others, _, held)) = (measure(&self.list, p), measure(&self.held, p));
        let corners = worst.map(|(block, lane)| self.list[block].corners.map(|lanes| lanes[lane]));
        (inverted + others, corners, (volume + held) / self.total_volume)
    }
}

impl Block {
    /// One to four elements.
    fn new(four: &[Element]) -> Self {
        let of = |lane: usize| four.get(lane).unwrap_or(&four[0]);
        let gather = |value: &dyn Fn(&Element) -> f64| Lanes(std::array::from_fn(|lane| value(of(lane))));
        let filled = |value: &dyn Fn(&Element) -> f64| Lanes(std::array::from_fn(|lane| four.get(lane).map_or(0.0, value)));
        Self {
            corners: std::array::from_fn(|corner| std::array::from_fn(|lane| of(lane).corners[corner])),
            gradients: std::array::from_fn(|k| gather(&|e| e.gradients[k / 3][k % 3])),
            weight: filled(&|e| e.weight),
            volume: filled(&|e| e.volume),
            bulk: filled(&|e| e.bulk),
        }
    }
}

for_each_instruction_set! {
    /// `Σ w F / Σ w` in every lane: the rotation nearest to it is the best one that all can share.
    fn mean_deformation(blocks: &[Block], p: &[Lanes]) -> Matrices {
        let (mut sum, mut total) = ([Lanes::ZERO; 9], 0.0);
        for block in blocks {
            let f = deformation(block, p);
            for k in 0..9 {
                sum[k] += f[k] * block.weight;
            }
            total += block.weight.sum();
        }
        sum.map(|lanes| Lanes::splat(lanes.sum() / total))
    }
}

for_each_instruction_set! {
    fn turning_loads(
        blocks: &[Block],
        rotations: &[Quaternions],
        slots: &[[[u32; 4]; 4]],
        clusters: &[[u32; 4]],
        loads: &mut [Lanes],
        sums: &mut [DMat3],
    ) {
        for (((block, q), slots), clusters) in blocks.iter().zip(rotations).zip(slots).zip(clusters) {
            let mut m = rotation::matrices(q);
            for m in &mut m {
                *m = *m * block.weight;
            }
            add_to_corners(slots, &hat_products(block, &m), loads);
            for lane in 0..4 {
                let column = |k: usize| DVec3::new(m[k].0[lane], m[3 + k].0[lane], m[6 + k].0[lane]);
                sums[clusters[lane] as usize] += DMat3::from_cols(column(0), column(1), column(2));
            }
        }
    }
}

/// Deformation gradients by rows (Stoll et al. 2007, (2.6), transposed: `x' = F x`).
#[inline(always)]
fn deformation(block: &Block, p: &[Lanes]) -> Matrices {
    // Written out: a closure in an array's `map` is compiled for the baseline and called.
    let corner =
        |lanes: &[u32; 4]| transpose([p[lanes[0] as usize], p[lanes[1] as usize], p[lanes[2] as usize], p[lanes[3] as usize]]);
    let x = [corner(&block.corners[0]), corner(&block.corners[1]), corner(&block.corners[2]), corner(&block.corners[3])];
    let g = &block.gradients;
    let mut f = [Lanes::ZERO; 9];
    for i in 0..3 {
        let (a, b, c) = (x[0][i] - x[3][i], x[1][i] - x[3][i], x[2][i] - x[3][i]);
        for k in 0..3 {
            f[3 * i + k] = a * g[k] + b * g[3 + k] + c * g[6 + k];
        }
    }
    f
}

/// Derivatives of the determinant by the entries.
#[inline(always)]
fn cofactors(&[a, b, c, d, e, f, g, h, i]: &Matrices) -> Matrices {
    let first = [e * i - f * h, f * g - d * i, d * h - e * g];
    let second = [c * h - b * i, a * i - c * g, b * g - a * h];
    let third = [b * f - c * e, c * d - a * f, a * e - b * d];
    [first[0], first[1], first[2], second[0], second[1], second[2], third[0], third[1], third[2]]
}

#[inline(always)]
pub(super) fn determinants(f: &Matrices) -> Lanes {
    let cofactors = cofactors(f);
    f[0] * cofactors[0] + f[1] * cofactors[1] + f[2] * cofactors[2]
}

/// Matrix times hat gradient for the four corners; they sum to zero.
#[inline(always)]
fn hat_products(block: &Block, m: &Matrices) -> [[Lanes; 3]; 4] {
    let g = &block.gradients;
    let mut products = [[Lanes::ZERO; 3]; 4];
    for i in 0..3 {
        for corner in 0..3 {
            products[corner][i] = m[3 * i] * g[3 * corner] + m[3 * i + 1] * g[3 * corner + 1] + m[3 * i + 2] * g[3 * corner + 2];
        }
        products[3][i] = -(products[0][i] + products[1][i] + products[2][i]);
    }
    products
}

#[inline(always)]
fn add_to_corners(places: &[[u32; 4]; 4], values: &[[Lanes; 3]; 4], sums: &mut [Lanes]) {
    for (places, [x, y, z]) in places.iter().zip(values) {
        let points = transpose([*x, *y, *z, Lanes::ZERO]);
        for lane in 0..4 {
            sums[places[lane] as usize] += points[lane];
        }
    }
}

for_each_instruction_set! {
    /// `scales`: from the weights in the matrix to those in the energy, and of the change of volume.
    fn pass(
        blocks: &[Block],
        p: &[Lanes],
        rotations: &mut [Quaternions],
        newton: u32,
        scales: (f64, f64),
        g: &mut [Lanes],
    ) -> f64 {
        let mut energy = Lanes::ZERO;
        for (block, rotation) in blocks.iter().zip(rotations) {
            let f = deformation(block, p);
            let mut q = *rotation;
            for _ in 0..newton {
                rotation::newton_step(&f, &mut q);
            }
            *rotation = q;
            let r = rotation::matrices(&q);
            let weight = block.weight * scales.0;
            let cofactors = cofactors(&f);
            let growth = f[0] * cofactors[0] + f[1] * cofactors[1] + f[2] * cofactors[2] - Lanes::splat(1.0);
            // Beyond a doubling the term saturates, so that it never outgrows the others.
            let bounded = |g: Lanes| Lanes::splat(1.0) / (Lanes::splat(1.0) + g * g * SATURATION);
            let bulk = block.bulk * scales.1;
            let bound = bounded(growth);
            let press = growth * bound * bulk;
            // Zero where the tetrahedron keeps enough of its volume.
            let lack = growth + Lanes::splat(1.0 - FOLDED);
            let lack = Lanes::select(std::array::from_fn(|lane| lack.0[lane] < 0.0), lack, Lanes::ZERO);
            let resist_bound = bounded(lack);
            let resist = lack * resist_bound * (scales.1 * FOLDED_BULK);
            let pressure = press * bound + resist * resist_bound;
            let mut pull = [Lanes::ZERO; 9];
            let mut square = growth * press + lack * resist;
            for k in 0..9 {
                let d = f[k] - r[k];
                square += d * d;
                pull[k] = (d + cofactors[k] * pressure) * weight;
            }
            energy += square * weight;
            add_to_corners(&block.corners, &hat_products(block, &pull), g);
        }
        energy.sum()
    }
}

for_each_instruction_set! {
    fn extract(blocks: &[Block], p: &[Lanes], rotations: &mut [Quaternions]) {
        for (block, q) in blocks.iter().zip(rotations) {
            rotation::extract(&deformation(block, p), q);
        }
    }
}

for_each_instruction_set! {
    fn below(blocks: &[Block], p: &[Lanes], part: f64, found: &mut Vec<usize>) {
        for (index, block) in blocks.iter().enumerate() {
            let determinants = determinants(&deformation(block, p));
            if (0..4).any(|lane| (determinants.0[lane] < part) & (block.weight.0[lane] > 0.0)) {
                found.push(index);
            }
        }
    }
}

for_each_instruction_set! {
    fn measure(blocks: &[Block], p: &[Lanes]) -> (u32, Option<(usize, usize)>, f64) {
        let (mut inverted, mut least, mut worst) = (0, 0.0, None);
        let mut volume = Lanes::ZERO;
        for (index, block) in blocks.iter().enumerate() {
            let volumes = determinants(&deformation(block, p)) * block.volume;
            volume += volumes;
            for lane in 0..4 {
                inverted += u32::from(volumes.0[lane] < 0.0);
                if volumes.0[lane] < least {
                    (least, worst) = (volumes.0[lane], Some((index, lane)));
                }
            }
        }
        (inverted, worst, volume.sum())
    }
}
