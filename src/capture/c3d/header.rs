//! The header block of a C3D file and the number formats of the three processors that wrote it.

use crate::error::{Error, Result};

/// Bytes per block; positions in a C3D file are block numbers counted from 1.
pub(super) const BLOCK: u64 = 512;

/// The second byte of every C3D file.
const KEY: u8 = 0x50;

/// Whose byte order and floats the file uses.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Processor {
    /// Little endian, IEEE floats.
    Intel,
    /// Little endian, VAX F floats.
    Dec,
    /// Big endian, IEEE floats.
    Mips,
}

impl Processor {
    /// From the fourth byte of the parameter section.
    pub(super) fn from_code(code: u8) -> Option<Self> {
        match code {
            84 => Some(Self::Intel),
            85 => Some(Self::Dec),
            86 => Some(Self::Mips),
            _ => None,
        }
    }

    pub(super) fn u16(self, bytes: [u8; 2]) -> u16 {
        match self {
            Self::Intel | Self::Dec => u16::from_le_bytes(bytes),
            Self::Mips => u16::from_be_bytes(bytes),
        }
    }

    pub(super) fn i16(self, bytes: [u8; 2]) -> i16 {
        self.u16(bytes) as i16
    }

    pub(super) fn f32(self, b: [u8; 4]) -> f32 {
        match self {
            Self::Intel => f32::from_le_bytes(b),
            // A VAX F float has its 16-bit halves exchanged and an exponent bias larger by 2.
            Self::Dec => f32::from_le_bytes([b[2], b[3], b[0], b[1]]) / 4.0,
            Self::Mips => f32::from_be_bytes(b),
        }
    }
}

/// The words of the header block that trajectories need.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Header {
    /// Points per frame.
    pub(super) points: u16,
    /// Analog words per frame, over all channels and samples.
    pub(super) analog: u16,
    /// Number of the first frame.
    pub(super) first: u16,
    /// Number of the last frame; saturated or wrapped in takes beyond 65,535.
    pub(super) last: u16,
    /// Positive: integers times this; negative: floats.
    pub(super) scale: f32,
    /// Block where the data begin; 0 in files that do not say.
    pub(super) data_block: u16,
    /// Frames per second.
    pub(super) rate: f32,
}

impl Header {
    pub(super) fn parse(block: &[u8; BLOCK as usize], processor: Processor) -> Self {
        let word = |n: usize| processor.u16([block[2 * n - 2], block[2 * n - 1]]);
        let real = |n: usize| processor.f32([block[2 * n - 2], block[2 * n - 1], block[2 * n], block[2 * n + 1]]);
        Self {
            points: word(2),
            analog: word(3),
            first: word(4),
            last: word(5),
            scale: real(7),
            data_block: word(9),
            rate: real(11),
        }
    }

    /// Bytes of one value in the data section.
    pub(super) fn value_bytes(&self) -> u64 {
        if self.scale < 0.0 { 4 } else { 2 }
    }

    /// Bytes of one frame: four values per point, then the analog words.
    pub(super) fn frame_bytes(&self) -> u64 {
        (4 * u64::from(self.points) + u64::from(self.analog)) * self.value_bytes()
    }

    /// Whether the words could be true of a file of this length; decides the byte order where the file does not name it.
    fn plausible(&self, file_bytes: u64) -> bool {
        let start = u64::from(self.data_block.max(1) - 1) * BLOCK;
        self.last >= self.first
            && self.scale.is_finite()
            && self.scale != 0.0
            && self.scale.abs() < 1e4
            && (0.0..1e5).contains(&self.rate)
            && start + self.frame_bytes() <= file_bytes
    }
}

/// First byte of the parameter section, from the first byte of the header; `None` where it lies outside the file.
pub(super) fn parameter_start(block: &[u8; BLOCK as usize], file_bytes: u64) -> Option<u64> {
    let start = u64::from(block[0].checked_sub(1)?) * BLOCK;
    (start >= BLOCK && start + 4 <= file_bytes).then_some(start)
}

/// Checks the key byte.
pub(super) fn check_key(block: &[u8]) -> Result<()> {
    match block.get(1) {
        _ if block.is_empty() => Err(Error::malformed("the file is empty")),
        Some(&KEY) if block.len() == BLOCK as usize => Ok(()),
        Some(&KEY) => {
            Err(Error::malformed(format!("the file ends after {} bytes", block.len()))
                .expected("a C3D header block of 512 bytes"))
        }
        found => Err(Error::malformed("not a C3D file")
            .at(found.map_or("byte 2 is missing".into(), |b| format!("byte 2 is 0x{b:02x}")))
            .expected("0x50, the mark of C3D")
            .hint("a C3D file with labelled markers")),
    }
}

/// The processor that the parameter section names, else the first one whose byte order makes sense of the header.
pub(super) fn processor(block: &[u8; BLOCK as usize], code: Option<u8>, file_bytes: u64) -> Result<(Processor, bool)> {
    if let Some(known) = code.and_then(Processor::from_code) {
        return Ok((known, true));
    }
    [Processor::Intel, Processor::Mips, Processor::Dec]
        .into_iter()
        .find(|p| Header::parse(block, *p).plausible(file_bytes))
        .map(|p| (p, false))
        .ok_or_else(|| {
            Error::malformed("the header makes no sense in any byte order")
                .at("bytes 3 to 24")
                .expected("counts of points and frames, a scale and a rate")
        })
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    #[test]
    fn vax_floats_are_read() {
        // 1.0 and -0.1 as a VAX writes them: sign, excess-128 exponent and high fraction in the first word.
        assert_eq!(Processor::Dec.f32([0x80, 0x40, 0x00, 0x00]), 1.0);
        assert_eq!(Processor::Dec.f32([0xcc, 0xbe, 0xcd, 0xcc]), -0.1);
        assert_eq!(Processor::Dec.f32([0, 0, 0, 0]), 0.0);
    }

    #[test]
    fn a_header_without_a_processor_code_is_read_in_the_order_that_makes_sense() {
        let mut block = [0u8; 512];
        block[..2].copy_from_slice(&[2, KEY]);
        for (word, value) in [(2, 5u16), (4, 1), (5, 9), (9, 3)] {
            block[2 * word - 2..2 * word].copy_from_slice(&value.to_be_bytes());
        }
        block[12..16].copy_from_slice(&(-1.0f32).to_be_bytes());
        block[20..24].copy_from_slice(&100.0f32.to_be_bytes());
        let (found, named) = processor(&block, Some(0), 4096).unwrap();
        assert_eq!((found, named), (Processor::Mips, false));
        assert_eq!(Header::parse(&block, found).points, 5);
        assert!(processor(&[0; 512], None, 4096).is_err());
        // In a long file only the order of the first and the last frame tells: 257 to 512, which is 257 to 2 the other way round.
        for (word, value) in [(2, 1u16), (4, 257), (5, 512)] {
            block[2 * word - 2..2 * word].copy_from_slice(&value.to_be_bytes());
        }
        assert_eq!(processor(&block, None, 1 << 20).unwrap().0, Processor::Mips);
    }
}
