//! Lines, words and numbers of the text formats, on bytes: names may be in any encoding.

/// The lines of a text with their numbers, whichever of LF, CRLF and CR ends them.
pub(super) struct Lines<'a> {
    rest: &'a [u8],
    number: usize,
    last_was_ended: bool,
}

impl<'a> Lines<'a> {
    /// The lines of `text`; a UTF-8 byte order mark is skipped.
    pub(super) fn new(text: &'a [u8]) -> Self {
        Self { rest: text.strip_prefix(b"\xef\xbb\xbf").unwrap_or(text), number: 0, last_was_ended: true }
    }

    /// Number of the line that was given last, from 1.
    pub(super) fn number(&self) -> usize {
        self.number
    }

    /// Whether the line that was given last is the file's last one and has no line end: the file may be cut short.
    pub(super) fn at_unfinished_end(&self) -> bool {
        self.rest.is_empty() && !self.last_was_ended
    }

    /// What follows the line that was given last.
    pub(super) fn rest(&self) -> &'a [u8] {
        self.rest
    }
}

impl<'a> Iterator for Lines<'a> {
    type Item = &'a [u8];

    fn next(&mut self) -> Option<&'a [u8]> {
        if self.rest.is_empty() {
            return None;
        }
        self.number += 1;
        match self.rest.iter().position(|&b| b == b'\n' || b == b'\r') {
            Some(end) => {
                let line = &self.rest[..end];
                let width = if self.rest[end..].starts_with(b"\r\n") { 2 } else { 1 };
                self.rest = &self.rest[end + width..];
                Some(line)
            }
            None => {
                self.last_was_ended = false;
                Some(std::mem::take(&mut self.rest))
            }
        }
    }
}

/// The words of a line, parted by blanks, tabs and other white space.
#[derive(Clone)]
pub(super) struct Words<'a> {
    rest: &'a [u8],
}

impl<'a> Words<'a> {
    /// The words of `line`.
    pub(super) fn new(line: &'a [u8]) -> Self {
        Self { rest: line }
    }

    /// What follows the words taken so far, without blanks around it.
    pub(super) fn rest(&self) -> &'a [u8] {
        self.rest.trim_ascii()
    }
}

fn is_blank(b: u8) -> bool {
    b <= b' '
}

impl<'a> Iterator for Words<'a> {
    type Item = &'a [u8];

    fn next(&mut self) -> Option<&'a [u8]> {
        let start = self.rest.iter().position(|&b| !is_blank(b))?;
        let rest = &self.rest[start..];
        let end = rest.iter().position(|&b| is_blank(b)).unwrap_or(rest.len());
        self.rest = &rest[end..];
        Some(&rest[..end])
    }
}

/// The number that `word` spells, correctly rounded; infinite where it overflows.
/// `None` for anything else, also for `nan`, `inf`, a decimal comma, a Fortran exponent.
pub(super) fn number(word: &[u8]) -> Option<f64> {
    short_decimal(word).or_else(|| {
        let plain = word.iter().all(|b| matches!(b, b'0'..=b'9' | b'+' | b'-' | b'.' | b'e' | b'E'));
        if plain { std::str::from_utf8(word).ok()?.parse().ok() } else { None }
    })
}

/// Decimals without exponent whose digits fit in 53 bits and whose power of ten is exact: one division then rounds correctly
/// (Clinger 1990). Nearly every coordinate in a file is of this kind.
fn short_decimal(word: &[u8]) -> Option<f64> {
    const POWERS: [f64; 16] = [1e0, 1e1, 1e2, 1e3, 1e4, 1e5, 1e6, 1e7, 1e8, 1e9, 1e10, 1e11, 1e12, 1e13, 1e14, 1e15];
    let (negative, digits) = match word.first()? {
        b'-' => (true, &word[1..]),
        b'+' => (false, &word[1..]),
        _ => (false, word),
    };
    if digits.is_empty() || digits.len() > 16 {
        return None;
    }
    let mut mantissa = 0u64;
    let mut count = 0;
    let mut point = None;
    for &b in digits {
        match b {
            b'0'..=b'9' => {
                mantissa = mantissa * 10 + u64::from(b - b'0');
                count += 1;
            }
            b'.' if point.is_none() => point = Some(count),
            _ => return None,
        }
    }
    if count == 0 || count > 15 {
        return None;
    }
    let value = mantissa as f64 / POWERS[count - point.unwrap_or(count)];
    Some(if negative { -value } else { value })
}

/// A name as text: UTF-8, or else Latin-1, which gives every byte a letter.
pub(super) fn name(bytes: &[u8]) -> String {
    let bytes = bytes.trim_ascii();
    match std::str::from_utf8(bytes) {
        Ok(text) => text.to_owned(),
        Err(_) => bytes.iter().map(|&b| char::from(b)).collect(),
    }
}

/// A piece of the file for a message: at most 40 characters, unprintable ones escaped.
pub(super) fn quote(word: &[u8]) -> String {
    let text = name(&word[..word.len().min(40)]);
    format!("'{}'", text.escape_debug())
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn lines_end_in_three_ways() {
        let text = b"\xef\xbb\xbfa\nb\r\n\rc";
        let mut lines = Lines::new(text);
        let all: Vec<_> = lines.by_ref().collect();
        assert_eq!(all, [&b"a"[..], b"b", b"", b"c"]);
        assert_eq!(lines.number(), 4);
        assert!(lines.at_unfinished_end());
    }

    #[test]
    fn numbers_are_those_of_the_standard_parser() {
        for word in ["0", "-0", "+1.5", ".5", "5.", "-0.344399", "123456789012345", "0.000000000000001", "1e0", "+1.0E+00"] {
            let expected: f64 = word.parse().unwrap();
            assert_eq!(number(word.as_bytes()).unwrap().to_bits(), expected.to_bits(), "{word}");
        }
        for word in ["0.35444599999999998", "3.78436673043415e-17", "179769313486231570000000000000000000000"] {
            assert_eq!(number(word.as_bytes()).unwrap(), word.parse::<f64>().unwrap());
        }
        assert_eq!(number(b"1e400"), Some(f64::INFINITY));
        for word in ["", "-", ".", "nan", "inf", "-inf", "infinity", "1.#QNAN", "0,5", "1.d0", "1e", "0x10", "1_0", "1.2.3"] {
            assert_eq!(number(word.as_bytes()), None, "{word}");
        }
    }

    #[test]
    fn seeded_decimals_are_rounded_correctly() {
        let mut state = 1u64;
        for _ in 0..20_000 {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            let text = format!("{:.*}", (state >> 60) as usize, (state >> 20) as f64 / 1e9 - 8e3);
            assert_eq!(number(text.as_bytes()), text.parse().ok(), "{text}");
        }
    }

    #[test]
    fn names_survive_in_latin_1() {
        assert_eq!(name("Körper".as_bytes()), "Körper");
        assert_eq!(name(b"K\xf6rper "), "Körper");
    }
}
