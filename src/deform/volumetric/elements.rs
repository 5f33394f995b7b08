//! The tetrahedra as the energy sees them: hat gradients, weights, and one fused pass over positions and rotations.

use crate::error::{Error, Result};
use crate::linalg::lanes::{Lanes, for_each_instruction_set, transpose};
use crate::linalg::rotation::{self, Matrices, Quaternions};
use crate::proxy::Proxy;
use glam::DVec3;

/// One tetrahedron at rest.
#[derive(Clone, Debug)]
pub(super) struct Element {
    pub(super) corners: [u32; 4],
    /// Gradients of the four hat functions (Stoll et al. 2007, (2.2)–(2.3)).
    pub(super) gradients: [DVec3; 4],
    pub(super) volume: f64,
    /// Volume, less where the tetrahedron would be a sliver stiffer than the cap.
    pub(super) capped: f64,
    /// `capped` times the stiffness times `1 + bulk`: the weight in the matrix. The energy has it over `1 + bulk`, so that the matrix bounds the
    /// curvature of the change of volume too.
    pub(super) weight: f64,
    /// Weight of the change of volume against that of the deformation.
    pub(super) bulk: f64,
}

/// The change of volume `g` counts as `g² / (1 + g² · SATURATION)`.
const SATURATION: f64 = 0.25;

/// Slivers stiffer than this many medians count less in the change of volume: a small move turns and stretches them without end, so that its
/// curvature has no bound there, while their volume is next to nothing.
const SLENDER: f64 = 3.0;

/// Below this ratio of six volumes to the cube of the longest edge the gradients are rounding; such a tetrahedron is left out.
const FLAT: f64 = 1e-7;

/// The tetrahedra of a proxy. `sliver_cap` limits `volume · |gradient|²`, in medians: a flat tetrahedron is a stiff one.
pub(super) fn elements(proxy: &Proxy, stiffness: &[f64], sliver_cap: f64, bulk: f64) -> Result<Vec<Element>> {
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
        let stiffness = stiffness.get(j).copied().unwrap_or(1.0);
        elements.push(Element {
            corners,
            gradients: [ga, gb, gc, -(ga + gb + gc)],
            volume,
            capped: volume,
            weight: stiffness,
            bulk,
        });
    }
    cap_slivers(&mut elements, sliver_cap);
    for element in &mut elements {
        element.weight *= element.capped * (1.0 + bulk);
    }
    Ok(elements)
}

fn cap_slivers(elements: &mut [Element], cap: f64) {
    let entry = |e: &Element| e.volume * e.gradients.iter().fold(0.0_f64, |m, g| m.max(g.length_squared()));
    let mut entries: Vec<f64> = elements.iter().map(entry).collect();
    if entries.is_empty() {
        return;
    }
    let middle = entries.len() / 2;
    let median = *entries.select_nth_unstable_by(middle, f64::total_cmp).1;
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
/// wait for each other when they add to the same vertex.
pub(super) fn arrange(mut elements: Vec<Element>) -> Vec<Element> {
    elements.sort_by_key(|e| e.corners.iter().copied().min());
    let blocks = elements.len() / 4;
    let dealt = (0..blocks).flat_map(|b| (0..4).map(move |lane| lane * blocks + b));
    dealt.chain(4 * blocks..elements.len()).map(|j| elements[j].clone()).collect()
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
    bulk: Lanes,
}

/// The tetrahedra in blocks of four, in a fixed order.
#[derive(Clone, Debug)]
pub(super) struct Blocks {
    pub(super) list: Vec<Block>,
    pub(super) total_weight: f64,
    total_volume: f64,
    bulk: f64,
}

impl Blocks {
    /// `bulk`: weight of the change of volume against that of the deformation, which the weights of the elements include (see [`elements`]).
    pub(super) fn new(elements: &[Element], bulk: f64) -> Self {
        let list = elements
            .chunks(4)
            .map(|four| {
                let of = |lane: usize| four.get(lane).unwrap_or(&four[0]);
                let gather = |value: &dyn Fn(&Element) -> f64| Lanes(std::array::from_fn(|lane| value(of(lane))));
                let filled =
                    |value: &dyn Fn(&Element) -> f64| Lanes(std::array::from_fn(|lane| four.get(lane).map_or(0.0, value)));
                Block {
                    corners: std::array::from_fn(|corner| std::array::from_fn(|lane| of(lane).corners[corner])),
                    gradients: std::array::from_fn(|k| gather(&|e| e.gradients[k / 3][k % 3])),
                    weight: filled(&|e| e.weight),
                    volume: filled(&|e| e.volume),
                    bulk: filled(&|e| e.bulk),
                }
            })
            .collect();
        Self {
            list,
            total_weight: elements.iter().map(|e| e.weight).sum(),
            total_volume: elements.iter().map(|e| e.volume).sum(),
            bulk,
        }
    }

    /// `newton` steps of every rotation towards the deformation gradients of `p`, then energy and half its gradient by `p`, which is written to `g`.
    pub(super) fn pass(&self, p: &[Lanes], rotations: &mut [Quaternions], newton: u32, g: &mut [Lanes]) -> f64 {
        pass(&self.list, p, rotations, newton, 1.0 / (1.0 + self.bulk), g)
    }

    /// Weight of the change of volume.
    pub(super) fn bulk(&self) -> f64 {
        self.bulk
    }

    /// The rotations nearest to the deformation gradients of `p`, to rounding.
    pub(super) fn extract(&self, p: &[Lanes], rotations: &mut [Quaternions]) {
        for (block, q) in self.list.iter().zip(rotations) {
            rotation::extract(&deformation(block, p), q);
        }
    }

    /// Loads by which a turn of the tetrahedra pulls at their corners: `w R grad`, added corner by corner at `slots`; and `w R` itself per block.
    pub(super) fn turning_loads(
        &self,
        rotations: &[Quaternions],
        slots: &[[[u32; 4]; 4]],
        loads: &mut [Lanes],
        mut each: impl FnMut(usize, &Matrices),
    ) {
        for (index, ((block, q), slots)) in self.list.iter().zip(rotations).zip(slots).enumerate() {
            let turned = rotation::matrices(q).map(|r| r * block.weight);
            add_to_corners(slots, &hat_products(block, &turned), loads);
            each(index, &turned);
        }
    }

    /// Tetrahedra turned inside out, and the volume against rest.
    pub(super) fn measure(&self, p: &[Lanes]) -> (u32, f64) {
        let (inverted, volume) = measure(&self.list, p);
        (inverted, volume / self.total_volume)
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
    fn pass(blocks: &[Block], p: &[Lanes], rotations: &mut [Quaternions], newton: u32, relief: f64, g: &mut [Lanes]) -> f64 {
        g.fill(Lanes::ZERO);
        let mut energy = Lanes::ZERO;
        for (block, rotation) in blocks.iter().zip(rotations) {
            let f = deformation(block, p);
            let mut q = *rotation;
            for _ in 0..newton {
                rotation::newton_step(&f, &mut q);
            }
            *rotation = q;
            let r = rotation::matrices(&q);
            let weight = block.weight * relief;
            let cofactors = cofactors(&f);
            let growth = f[0] * cofactors[0] + f[1] * cofactors[1] + f[2] * cofactors[2] - Lanes::splat(1.0);
            // Beyond a doubling the term saturates, so that it never outgrows the others.
            let bounded = Lanes::splat(1.0) / (Lanes::splat(1.0) + growth * growth * SATURATION);
            let press = growth * bounded * block.bulk;
            let pressure = press * bounded;
            let mut pull = [Lanes::ZERO; 9];
            let mut square = growth * press;
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
    fn measure(blocks: &[Block], p: &[Lanes]) -> (u32, f64) {
        let mut inverted = 0;
        let mut volume = Lanes::ZERO;
        for block in blocks {
            let f = deformation(block, p);
            let cofactors = cofactors(&f);
            let determinant = f[0] * cofactors[0] + f[1] * cofactors[1] + f[2] * cofactors[2];
            volume += determinant * block.volume;
            for lane in 0..4 {
                inverted += u32::from((determinant.0[lane] < 0.0) & (block.volume.0[lane] > 0.0));
            }
        }
        (inverted, volume.sum())
    }
}
