//! Words, names and lines of a BVH text in any line endings.

use crate::error::Error;

/// A place in the text.
pub(super) struct Text<'a> {
    bytes: &'a [u8],
    at: usize,
}

impl<'a> Text<'a> {
    pub(super) fn new(bytes: &'a [u8]) -> Self {
        Self { bytes: bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes), at: 0 }
    }

    /// The next word: up to a blank or a brace; a brace is a word of its own. Comments (`#` or `//` to the end of the line) are
    /// passed over. `None` at the end.
    pub(super) fn word(&mut self) -> Option<&'a [u8]> {
        self.skip_blanks();
        let rest = &self.bytes[self.at..];
        let length = match rest.first()? {
            b'{' | b'}' => 1,
            _ => rest.iter().position(|&b| blank(b) || matches!(b, b'{' | b'}')).unwrap_or(rest.len()),
        };
        self.at += length;
        Some(&rest[..length])
    }

    /// The next word, which stays.
    pub(super) fn peek(&mut self) -> Option<&'a [u8]> {
        let start = self.at;
        let word = self.word();
        self.at = start;
        word
    }

    /// A name: what stands before the end of the line or a brace, blanks inside it kept.
    pub(super) fn name(&mut self) -> String {
        let rest = &self.bytes[self.at..];
        let length = rest.iter().position(|&b| matches!(b, b'\n' | b'\r' | b'{' | b'}')).unwrap_or(rest.len());
        self.at += length;
        String::from_utf8_lossy(&rest[..length]).trim().to_owned()
    }

    /// What stands on the rest of the line, and goes past it.
    pub(super) fn rest_of_line(&mut self) -> &'a [u8] {
        let rest = &self.bytes[self.at..];
        let length = rest.iter().position(|b| matches!(b, b'\n' | b'\r')).unwrap_or(rest.len());
        self.at += length;
        &rest[..length]
    }

    /// Everything that was not read yet, and the place where it begins.
    pub(super) fn rest(&self) -> (&'a [u8], usize) {
        (&self.bytes[self.at..], self.at)
    }

    /// Takes a place back to where it was.
    pub(super) fn back_to(&mut self, at: usize) {
        self.at = at;
    }

    /// The number of the line at a place, from 1.
    pub(super) fn line(&self, at: usize) -> usize {
        let before = &self.bytes[..at.min(self.bytes.len())];
        // A line ends with \n, or with \r that no \n follows.
        1 + before
            .iter()
            .enumerate()
            .filter(|&(i, &b)| b == b'\n' || (b == b'\r' && self.bytes.get(i + 1) != Some(&b'\n')))
            .count()
    }

    /// An error at the place of the last word.
    pub(super) fn error(&self, found: impl Into<String>) -> Error {
        Error::malformed(found).at(format!("line {}", self.line(self.at.saturating_sub(1))))
    }

    /// An error about a word that does not belong there.
    pub(super) fn unexpected(&self, word: &[u8]) -> Error {
        let shown = String::from_utf8_lossy(&word[..word.len().min(40)]);
        self.error(if word.is_empty() { "the file ends here".to_owned() } else { format!("unexpected '{shown}'") })
    }

    fn skip_blanks(&mut self) {
        while let Some(&b) = self.bytes.get(self.at) {
            if b == b'#' || (b == b'/' && self.bytes.get(self.at + 1) == Some(&b'/')) {
                self.rest_of_line();
            } else if blank(b) {
                self.at += 1;
            } else {
                break;
            }
        }
    }
}

/// Blanks, line ends, and what old editors put at the end of a file.
pub(super) fn blank(b: u8) -> bool {
    matches!(b, b' ' | b'\t' | b'\n' | b'\r' | 0x0b | 0x0c | 0x1a | 0)
}
