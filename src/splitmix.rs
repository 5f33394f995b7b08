//! Numbers that look random and are the same on every machine: Vigna's splitmix64. Imports nobody.

/// What the state grows by from number to number.
const STEP: u64 = 0x9e37_79b9_7f4a_7c15;

/// Another well mixed number for each.
pub(crate) fn mix(x: u64) -> u64 {
    let z = x.wrapping_add(STEP);
    let z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    let z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

/// The number at `index` of the sequence of seed 0.
pub(crate) fn nth(index: u64) -> u64 {
    mix(index.wrapping_mul(STEP))
}

/// From 0 up to 1, of 64 random bits.
pub(crate) fn unit(bits: u64) -> f64 {
    (bits >> 11) as f64 / (1_u64 << 53) as f64
}

/// From −1 up to 1, of 64 random bits.
pub(crate) fn signed(bits: u64) -> f64 {
    (bits >> 11) as f64 / (1_u64 << 52) as f64 - 1.0
}

/// The sequence of a seed, for tests.
#[cfg(test)]
pub(crate) struct Sequence(pub(crate) u64);

#[cfg(test)]
impl Sequence {
    /// The next 64 bits.
    pub(crate) fn bits(&mut self) -> u64 {
        let bits = mix(self.0);
        self.0 = self.0.wrapping_add(STEP);
        bits
    }

    /// A number below `bound`; 0 where that is 0.
    pub(crate) fn below(&mut self, bound: usize) -> usize {
        (self.bits() % bound.max(1) as u64) as usize
    }

    /// A number from 0 up to 1.
    pub(crate) fn unit(&mut self) -> f64 {
        unit(self.bits())
    }

    /// A number from −1 up to 1.
    pub(crate) fn signed(&mut self) -> f64 {
        signed(self.bits())
    }

    /// A point in a cube of `size` about the origin.
    pub(crate) fn point(&mut self, size: f64) -> glam::DVec3 {
        glam::DVec3::new(self.unit() - 0.5, self.unit() - 0.5, self.unit() - 0.5) * size
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_sequence_is_that_of_the_published_code() {
        let mut sequence = Sequence(1_234_567);
        let published = [6_457_827_717_110_365_317, 3_203_168_211_198_807_973, 9_817_491_932_198_370_423];
        assert_eq!(published.map(|_| sequence.bits()), published);
        assert_eq!(nth(3), {
            let mut first = Sequence(0);
            (0..4).map(|_| first.bits()).last().unwrap_or_default()
        });
        assert_eq!((unit(0), unit(u64::MAX) < 1.0, signed(0)), (0.0, true, -1.0));
    }
}
