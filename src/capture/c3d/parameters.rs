//! The parameter section of a C3D file: groups of named values.
//!
//! Walked by the offset to the next entry, never by the lengths of the entries: several systems leave out a length byte or write
//! sizes that contradict the offset. Whatever cannot be read is left out, because the header alone is enough for the points.

use super::header::Processor;
use std::collections::BTreeMap;

/// No parameter has more strings, and no name more numbered continuations, than points fit a frame.
const MOST_TEXTS: usize = 65_535;
const MOST_PARTS: usize = MOST_TEXTS / 255 + 1;
/// Numbers that are wanted of one parameter.
const MOST_NUMBERS: usize = 16;

/// One value or array of values.
struct Parameter<'a> {
    group: i8,
    name: String,
    /// −1 characters, 1 bytes, 2 integers of 16 bits, 4 floats.
    kind: i8,
    dims: &'a [u8],
    /// As many bytes as the dimensions ask for, or fewer where the section ends first.
    data: &'a [u8],
}

/// All parameters that could be read.
pub(super) struct Parameters<'a> {
    processor: Processor,
    groups: BTreeMap<i8, String>,
    entries: Vec<Parameter<'a>>,
}

impl<'a> Parameters<'a> {
    /// Walks the entries of a section that begins after its four leading bytes.
    pub(super) fn parse(section: &'a [u8], processor: Processor) -> Self {
        let mut found = Self { processor, groups: BTreeMap::new(), entries: Vec::new() };
        let mut at = 0;
        while let Some(next) = found.entry(section, at) {
            at = next;
        }
        found
    }

    /// Reads the entry at `at` and returns where the next one begins, which is always behind it.
    fn entry(&mut self, section: &'a [u8], at: usize) -> Option<usize> {
        let length = usize::from((*section.get(at)? as i8).unsigned_abs());
        let id = *section.get(at + 1)? as i8;
        if length == 0 || id == 0 {
            return None;
        }
        let name = text(section.get(at + 2..at + 2 + length)?).to_ascii_uppercase();
        let offset_at = at + 2 + length;
        let offset = usize::from(self.processor.u16([*section.get(offset_at)?, *section.get(offset_at + 1)?]));
        if id < 0 {
            self.groups.entry(id.wrapping_neg()).or_insert(name);
        } else if let Some(rest) = section.get(offset_at + 2..) {
            self.entries.extend(parameter(id, name, rest));
        }
        (offset > 0).then_some(offset_at + offset)
    }

    /// The first parameter of this name: duplicates occur, and the first is the one that other readers take.
    fn find(&self, group: &str, name: &str) -> Option<&Parameter<'a>> {
        self.entries.iter().find(|p| p.name == name && self.groups.get(&p.group).is_some_and(|g| g == group))
    }

    /// The first numbers of a parameter of any type; integers of 16 bits as unsigned ones, because counts are written beyond 32,767.
    pub(super) fn numbers(&self, group: &str, name: &str) -> Vec<f64> {
        let Some(p) = self.find(group, name) else { return Vec::new() };
        let values = p.data.chunks_exact(usize::from(p.kind.unsigned_abs()).max(1)).take(MOST_NUMBERS);
        match p.kind {
            1 => values.map(|b| f64::from(b[0])).collect(),
            2 => values.map(|b| f64::from(self.processor.u16([b[0], b[1]]))).collect(),
            4 => values.map(|b| f64::from(self.processor.f32([b[0], b[1], b[2], b[3]]))).collect(),
            _ => Vec::new(),
        }
    }

    /// The first number of a parameter.
    pub(super) fn number(&self, group: &str, name: &str) -> Option<f64> {
        self.numbers(group, name).first().copied()
    }

    /// Strings without padding, in the order of the file.
    pub(super) fn texts(&self, group: &str, name: &str) -> Vec<String> {
        match self.find(group, name) {
            Some(p) if p.kind == -1 => match usize::from(p.dims.first().copied().unwrap_or(1)) {
                0 => Vec::new(),
                width => p.data.chunks(width).take(MOST_TEXTS).map(text).collect(),
            },
            _ => Vec::new(),
        }
    }

    /// The strings of `NAME`, `NAME2`, `NAME3`, …: one parameter holds at most 255.
    pub(super) fn long_texts(&self, group: &str, name: &str) -> Vec<String> {
        let mut all = self.texts(group, name);
        for n in 2..=MOST_PARTS {
            let more = self.texts(group, &format!("{name}{n}"));
            if more.is_empty() {
                break;
            }
            all.extend(more);
        }
        all
    }
}

/// Type, dimensions and data of a parameter.
fn parameter(group: i8, name: String, rest: &[u8]) -> Option<Parameter<'_>> {
    let kind = *rest.first()? as i8;
    let count = usize::from(*rest.get(1)?);
    let dims = rest.get(2..2 + count)?;
    let values = dims.iter().try_fold(1usize, |product, d| product.checked_mul(usize::from(*d)))?;
    let bytes = values.checked_mul(usize::from(kind.unsigned_abs()))?;
    let data = &rest[2 + count..];
    Some(Parameter { group, name, kind, dims, data: &data[..bytes.min(data.len())] })
}

/// UTF-8 where it is, else Latin-1, without blanks and zeros around it.
fn text(bytes: &[u8]) -> String {
    let whole = std::str::from_utf8(bytes).map_or_else(|_| bytes.iter().map(|b| char::from(*b)).collect(), str::to_owned);
    whole.trim_matches(|c: char| c.is_whitespace() || c == '\0').to_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn entry(name: &str, id: i8, body: &[u8], next: u16) -> Vec<u8> {
        let mut bytes = vec![name.len() as u8, id as u8];
        bytes.extend(name.as_bytes());
        bytes.extend(next.to_le_bytes());
        bytes.extend(body);
        bytes
    }

    #[test]
    fn the_offset_is_believed_where_the_length_contradicts_it() {
        let mut section = entry("POINT", -1, &[0], 3);
        // Characters, 2 dimensions, 2 × 2, four bytes; the description's length byte is missing.
        section.extend(entry("LABELS", 1, &[255, 2, 2, 2, b'A', b'B', b'C', b' '], 10));
        section.extend(entry("USED", 1, &[2, 0, 2, 0, 0], 0));
        let p = Parameters::parse(&section, Processor::Intel);
        assert_eq!(p.texts("POINT", "LABELS"), ["AB", "C"]);
        assert_eq!(p.number("POINT", "USED"), Some(2.0));
    }

    #[test]
    fn values_beyond_the_section_are_cut_off() {
        let mut section = entry("G", -1, &[0], 3);
        section.extend(entry("V", 1, &[4, 2, 255, 255, 0, 0, 128, 63, 1], 0));
        assert_eq!(Parameters::parse(&section, Processor::Intel).numbers("G", "V"), [1.0]);
    }

    #[test]
    fn an_offset_that_leads_nowhere_ends_the_walk() {
        let mut section = entry("POINT", -1, &[0], 3);
        section.extend(entry("USED", 1, &[2, 0, 7, 0, 0], 0xffff));
        assert_eq!(Parameters::parse(&section, Processor::Intel).number("POINT", "USED"), Some(7.0));
    }
}
