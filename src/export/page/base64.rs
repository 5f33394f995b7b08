//! Base 64 (RFC 4648), as it is written.

use std::io::{self, Write};

const LETTERS: &[u8; 64] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";

/// Encodes what is written to it.
pub(super) struct Base64<W> {
    out: W,
    /// Bytes that do not make a group of three yet.
    rest: Vec<u8>,
    text: Vec<u8>,
}

impl<W: Write> Base64<W> {
    pub(super) fn new(out: W) -> Self {
        Self { out, rest: Vec::new(), text: Vec::new() }
    }

    /// Writes the last group.
    pub(super) fn finish(mut self) -> io::Result<()> {
        if self.rest.is_empty() {
            return Ok(());
        }
        let count = self.rest.len();
        self.rest.resize(3, 0);
        let mut last = group(&self.rest);
        last[count + 1..].fill(b'=');
        self.out.write_all(&last)
    }
}

impl<W: Write> Write for Base64<W> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.text.clear();
        let missing = if self.rest.is_empty() { 0 } else { (3 - self.rest.len()).min(bytes.len()) };
        let (first, bytes_left) = bytes.split_at(missing);
        self.rest.extend_from_slice(first);
        if self.rest.len() == 3 {
            self.text.extend(group(&self.rest));
            self.rest.clear();
        }
        let groups = bytes_left.chunks_exact(3);
        self.rest.extend_from_slice(groups.remainder());
        groups.for_each(|g| self.text.extend(group(g)));
        self.out.write_all(&self.text)?;
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        self.out.flush()
    }
}

fn group(bytes: &[u8]) -> [u8; 4] {
    let n = u32::from(bytes[0]) << 16 | u32::from(bytes[1]) << 8 | u32::from(bytes[2]);
    [18, 12, 6, 0].map(|shift| LETTERS[(n >> shift & 63) as usize])
}

/// All at once.
pub(super) fn encoded(bytes: &[u8]) -> String {
    let mut text = Vec::with_capacity(bytes.len().div_ceil(3) * 4);
    let mut out = Base64::new(&mut text);
    // Writing to memory does not fail.
    let _ = out.write_all(bytes).and_then(|()| out.finish());
    text.iter().map(|&b| char::from(b)).collect()
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    #[test]
    fn the_vectors_of_the_rfc() {
        for (plain, text) in
            [("", ""), ("f", "Zg=="), ("fo", "Zm8="), ("foo", "Zm9v"), ("foob", "Zm9vYg=="), ("foobar", "Zm9vYmFy")]
        {
            assert_eq!(encoded(plain.as_bytes()), text);
        }
    }

    #[test]
    fn pieces_of_any_length_make_the_same_text() {
        let bytes: Vec<u8> = (0..=255).collect();
        for size in 1..8 {
            let mut text = Vec::new();
            let mut out = Base64::new(&mut text);
            bytes.chunks(size).for_each(|piece| out.write_all(piece).unwrap());
            out.finish().unwrap();
            assert_eq!(text, encoded(&bytes).into_bytes(), "pieces of {size}");
        }
    }
}
