//! Lines of words, as both Acclaim files have them.

use crate::error::Error;

/// A line that says something.
#[derive(Clone, Debug)]
pub(super) struct Line<'a> {
    /// Its number, from 1.
    pub(super) number: usize,
    /// Its words; at least one.
    pub(super) words: Vec<&'a [u8]>,
    /// Whether it is the last one and no line end follows: it may have been cut.
    pub(super) open: bool,
}

impl Line<'_> {
    /// A word as text.
    pub(super) fn text(&self, word: usize) -> String {
        self.words.get(word).map(|w| String::from_utf8_lossy(w).into_owned()).unwrap_or_default()
    }

    /// The first word in lower case.
    pub(super) fn keyword(&self) -> Vec<u8> {
        self.words[0].to_ascii_lowercase()
    }

    /// The line as text, cut to what a message can hold.
    pub(super) fn shown(&self) -> String {
        let text =
            self.words.iter().take(8).map(|w| String::from_utf8_lossy(&w[..w.len().min(40)])).collect::<Vec<_>>().join(" ");
        text.chars().take(60).collect()
    }

    /// An error at this line.
    pub(super) fn error(&self, found: impl Into<String>) -> Error {
        Error::malformed(found).at(format!("line {}", self.number))
    }
}

/// The lines of a text in any line endings, without comments (`#` at the beginning of a line) and empty ones.
pub(super) fn lines(bytes: &[u8]) -> impl Iterator<Item = Line<'_>> {
    let bytes = bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes);
    let mut at = 0;
    let mut number = 0;
    std::iter::from_fn(move || {
        while at < bytes.len() {
            let rest = &bytes[at..];
            let length = rest.iter().position(|b| matches!(b, b'\n' | b'\r')).unwrap_or(rest.len());
            let crlf = rest[length..].starts_with(b"\r\n");
            at += length + 1 + usize::from(crlf);
            number += 1;
            let words: Vec<&[u8]> =
                rest[..length].split(|b| b.is_ascii_whitespace() || matches!(b, 0 | 0x1a)).filter(|w| !w.is_empty()).collect();
            if words.first().is_some_and(|w| w[0] != b'#') {
                return Some(Line { number, words, open: length == rest.len() });
            }
        }
        None
    })
}
