//! The Ogawa container of Alembic: groups and data at 64-bit offsets, written as they come, closed at the end.
//!
//! `Ogawa`, 0xFF once the file is complete, u16 version 1 (big endian), u64 place of the root group. Data: u64 bytes, then these. A group: u64
//! children, then u64 per child: the place of a group, or of data with the highest bit set; 0 and the bit alone are empty ones. Little endian.
//! Source: lib/Alembic/Ogawa of Alembic 1.8.

use super::files::Pending;
use crate::error::Result;
use std::path::Path;

/// Marks a child as data.
const DATA: u64 = 1 << 63;

/// A child of a group.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Child(u64);

impl Child {
    /// Data without bytes.
    pub(super) const EMPTY_DATA: Self = Self(DATA);
}

/// A file that is being written.
#[derive(Debug)]
pub(super) struct Ogawa {
    file: Pending,
    end: u64,
}

impl Ogawa {
    /// Opens a file and writes its head.
    ///
    /// # Errors
    /// [`crate::error::Kind::Unwritable`], here and in the other functions.
    pub(super) fn create(path: &Path) -> Result<Self> {
        let mut file = Pending::create(path)?;
        file.write(b"Ogawa\0\0\x01\0\0\0\0\0\0\0\0")?;
        Ok(Self { file, end: 16 })
    }

    /// Appends data that consist of `parts`.
    pub(super) fn data(&mut self, parts: &[&[u8]]) -> Result<Child> {
        let bytes: usize = parts.iter().map(|p| p.len()).sum();
        let place = self.end;
        self.file.write(&(bytes as u64).to_le_bytes())?;
        parts.iter().try_for_each(|part| self.file.write(part))?;
        self.end += 8 + bytes as u64;
        Ok(Child(place | DATA))
    }

    /// Appends a group of what is already written.
    pub(super) fn group(&mut self, children: &[Child]) -> Result<Child> {
        if children.is_empty() {
            return Ok(Child(0));
        }
        let mut bytes = (children.len() as u64).to_le_bytes().to_vec();
        children.iter().for_each(|child| bytes.extend(child.0.to_le_bytes()));
        let place = self.end;
        self.file.write(&bytes)?;
        self.end += bytes.len() as u64;
        Ok(Child(place))
    }

    /// Names the root group and marks the file as complete.
    pub(super) fn close(&mut self, root: Child) -> Result<()> {
        self.file.patch(8, &root.0.to_le_bytes())?;
        self.file.patch(5, &[0xFF])
    }

    /// Puts the file in place of the target; returns its size in bytes.
    pub(super) fn finish(self) -> Result<u64> {
        self.file.finish()
    }
}

/// MurmurHash3 of 128 bits for 64-bit machines (Appleby, public domain), seed 0: the key of a sample, by which readers know equal ones.
pub(super) fn digest(bytes: &[u8]) -> [u8; 16] {
    const C1: u64 = 0x87c3_7b91_1142_53d5;
    const C2: u64 = 0x4cf5_ad43_2745_937f;
    let stir1 = |k: u64| k.wrapping_mul(C1).rotate_left(31).wrapping_mul(C2);
    let stir2 = |k: u64| k.wrapping_mul(C2).rotate_left(33).wrapping_mul(C1);
    let word = |bytes: &[u8]| {
        let mut word = [0; 8];
        word[..bytes.len()].copy_from_slice(bytes);
        u64::from_le_bytes(word)
    };
    let (mut h1, mut h2) = (0u64, 0u64);
    let mut blocks = bytes.chunks_exact(16);
    for block in &mut blocks {
        h1 ^= stir1(word(&block[..8]));
        h1 = h1.rotate_left(27).wrapping_add(h2).wrapping_mul(5).wrapping_add(0x52dc_e729);
        h2 ^= stir2(word(&block[8..]));
        h2 = h2.rotate_left(31).wrapping_add(h1).wrapping_mul(5).wrapping_add(0x3849_5ab5);
    }
    let rest = blocks.remainder();
    h2 ^= stir2(word(&rest[rest.len().min(8)..]));
    h1 ^= stir1(word(&rest[..rest.len().min(8)]));
    let mix = |mut k: u64| {
        k = (k ^ (k >> 33)).wrapping_mul(0xff51_afd7_ed55_8ccd);
        k = (k ^ (k >> 33)).wrapping_mul(0xc4ce_b9fe_1a85_ec53);
        k ^ (k >> 33)
    };
    h1 ^= bytes.len() as u64;
    h2 ^= bytes.len() as u64;
    h1 = h1.wrapping_add(h2);
    h2 = h2.wrapping_add(h1);
    (h1, h2) = (mix(h1), mix(h2));
    h1 = h1.wrapping_add(h2);
    h2 = h2.wrapping_add(h1);
    let mut out = [0; 16];
    out[..8].copy_from_slice(&h1.to_le_bytes());
    out[8..].copy_from_slice(&h2.to_le_bytes());
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn samples_have_the_keys_that_alembic_gives_them() {
        // Six counts of four, and a file number, as Alembic 1.8.3 wrote them.
        let fours: Vec<u8> = [4u32; 6].iter().flat_map(|n| n.to_le_bytes()).collect();
        assert_eq!(digest(&fours), *b"L\x85\xa2\x9c\x1f\x18\x95\x11\xcc-\xd6\xc5\xfd\xfd\xf8\xcf");
        assert_eq!(digest(&3u32.to_le_bytes()), *b";\xa1\xd2{\x7f\xdeHH\xa8n\x86\\l@-\xfa");
        assert_eq!(digest(&[1]), *b"\x16\xfet\x83\x90\\\xcez\x85g\x0eC\xe4g\x88w");
    }
}
