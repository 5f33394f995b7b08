//! Distances through the solid.

use super::voxels::{NONE, STEPS, Solid};
use std::cmp::Reverse;
use std::collections::BinaryHeap;

/// Distance inside the solid of every voxel from one voxel, in units of the mesh; infinite nowhere, since the solid hangs together.
///
/// Fast marching (Sethian 1996), so that fronts in a straight limb run across it; where the body is one voxel thin or touches by
/// edges only, steps to the 26 neighbours bound the distance instead.
pub(super) fn distances(solid: &Solid, from: usize) -> Vec<f64> {
    let lengths = STEPS.map(|d| f64::from(d[0].abs() + d[1].abs() + d[2].abs()).sqrt());
    let mut distance = vec![f64::INFINITY; solid.len()];
    let mut settled = vec![false; solid.len()];
    let mut queue = BinaryHeap::new();
    distance[from] = 0.0;
    queue.push(Reverse((0_u64, from as u32)));
    while let Some(Reverse((bits, voxel))) = queue.pop() {
        let voxel = voxel as usize;
        if settled[voxel] || f64::from_bits(bits) > distance[voxel] {
            continue;
        }
        settled[voxel] = true;
        for (step, &next) in solid.neighbours[voxel].iter().enumerate() {
            if next == NONE || settled[next as usize] {
                continue;
            }
            let mut reached = distance[voxel] + lengths[step];
            if step < 6 {
                reached = reached.min(across(solid, next as usize, &distance, &settled));
            }
            if reached < distance[next as usize] {
                distance[next as usize] = reached;
                // Bits of positive floats sort as the floats do.
                queue.push(Reverse((reached.to_bits(), next)));
            }
        }
    }
    for d in &mut distance {
        *d *= solid.pitch;
    }
    distance
}

/// Upwind solution of |grad T| = 1 from the settled neighbours across faces, in voxels.
fn across(solid: &Solid, voxel: usize, distance: &[f64], settled: &[bool]) -> f64 {
    let known = |step: usize| {
        let n = solid.neighbours[voxel][step];
        if n != NONE && settled[n as usize] { distance[n as usize] } else { f64::INFINITY }
    };
    let mut sides = [known(0).min(known(5)), known(1).min(known(4)), known(2).min(known(3))];
    sides.sort_by(f64::total_cmp);
    let mut best = sides[0] + 1.0;
    let (mut sum, mut squares) = (sides[0], sides[0] * sides[0]);
    for (n, side) in (2..).zip(sides.into_iter().skip(1)) {
        if side >= best {
            break;
        }
        sum += side;
        squares += side * side;
        let n = f64::from(n);
        let root = sum * sum - n * (squares - 1.0);
        if root < 0.0 {
            break;
        }
        best = (sum + root.sqrt()) / n;
    }
    best
}
