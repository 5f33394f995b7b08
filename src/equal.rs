//! Equal values are one value. Imports nobody.

use glam::DVec3;

/// No value.
const NONE: u32 = u32::MAX;

/// For each of `count` values the index of the first one with the same key.
///
/// Cost: linear; the result does not depend on the hash.
pub(crate) fn first_equal<const N: usize>(count: usize, key: impl Fn(usize) -> [u64; N]) -> Vec<u32> {
    let size = (2 * count).next_power_of_two().max(2);
    let mut table = vec![NONE; size];
    let mut first = Vec::with_capacity(count);
    for i in 0..count {
        let wanted = key(i);
        let mut slot = hash(&wanted) as usize & (size - 1);
        let found = loop {
            match table[slot] {
                NONE => {
                    table[slot] = i as u32;
                    break i as u32;
                }
                other if key(other as usize) == wanted => break other,
                _ => slot = (slot + 1) & (size - 1),
            }
        };
        first.push(found);
    }
    first
}

/// For each point the first one in the same place.
pub(crate) fn first_in_place(points: &[DVec3]) -> Vec<u32> {
    first_equal(points.len(), |v| points[v].to_array().map(bits))
}

/// The bits of a number, with one zero.
pub(crate) fn bits(x: f64) -> u64 {
    (x + 0.0).to_bits()
}

fn hash(key: &[u64]) -> u64 {
    let mut h = 0x9e37_79b9_7f4a_7c15u64;
    for &word in key {
        let product = u128::from(h ^ word) * 0xa076_1d64_78bd_642f_u128;
        h = (product as u64) ^ ((product >> 64) as u64);
        h ^= h >> 32;
    }
    h
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_of_equals_stands_for_all() {
        let values = [0.5f64, 0.0, 0.5, -0.0, 2.0, 0.5];
        assert_eq!(first_equal(values.len(), |i| [bits(values[i])]), [0, 1, 0, 1, 4, 0]);
        assert_eq!(first_equal(0, |_| [0]), [] as [u32; 0]);
    }
}
