//! The values of a PLY body, one after the other, whatever their encoding.

use super::header::{Element, Encoding, Header, Property, Type};
use crate::error::{Error, Result};
use crate::scan::text::{Lines, Words, number, quote};

/// Goes through the body row by row.
pub(super) struct Values<'a> {
    source: Source<'a>,
    /// Lines of the header, or bytes of it.
    before: usize,
    element: String,
    count: u64,
    row: u64,
    /// Values behind the declared ones in ascii rows.
    pub(super) surplus: usize,
}

enum Source<'a> {
    Ascii { lines: Lines<'a>, words: Words<'a> },
    Binary { body: &'a [u8], at: usize, big: bool },
}

impl<'a> Values<'a> {
    /// The values of `body`, which follows `header_bytes` bytes of header.
    pub(super) fn new(header: &Header, body: &'a [u8], header_bytes: usize) -> Self {
        let (source, before) = match header.encoding {
            Encoding::Ascii => (Source::Ascii { lines: Lines::new(body), words: Words::new(&[]) }, header.lines),
            encoding => (Source::Binary { body, at: 0, big: encoding == Encoding::BigEndian }, header_bytes),
        };
        Self { source, before, element: String::new(), count: 0, row: 0, surplus: 0 }
    }

    /// Bytes that are left.
    pub(super) fn left(&self) -> usize {
        match &self.source {
            Source::Ascii { lines, .. } => lines.rest().len(),
            Source::Binary { body, at, .. } => body.len() - at,
        }
    }

    /// Begins the rows of `element`; its count is checked against the bytes that are there.
    pub(super) fn begin(&mut self, element: &Element) -> Result<()> {
        (self.element, self.count, self.row) = (element.name.clone(), element.count, 0);
        let (least, spare): (usize, usize) = match self.source {
            // A digit and a blank for each value; the last one may lack the blank.
            Source::Ascii { .. } => (2 * element.properties.len(), 1),
            Source::Binary { .. } => (element.properties.iter().map(|p| p.list.unwrap_or(p.kind).size()).sum(), 0),
        };
        let room = self.left() + spare;
        if u128::from(element.count) * least as u128 > room as u128 {
            let most = room / least.max(1);
            let found = format!(
                "the header announces {} rows of element '{}', and the file has room for {most} at most",
                element.count, element.name
            );
            return Err(Error::malformed(found)
                .expected("a complete file")
                .hint("the file seems to be cut short: copy it again"));
        }
        Ok(())
    }

    /// Skips all rows of an element without lists at once, if the encoding allows.
    pub(super) fn skip_rows(&mut self, element: &Element) -> bool {
        let Source::Binary { at, .. } = &mut self.source else { return false };
        if element.properties.iter().any(|p| p.list.is_some()) {
            return false;
        }
        let stride: usize = element.properties.iter().map(|p| p.kind.size()).sum();
        // Within the body: `begin` has compared the two.
        *at += stride * element.count as usize;
        true
    }

    /// Begins the next row.
    pub(super) fn begin_row(&mut self) -> Result<()> {
        self.row += 1;
        if let Source::Ascii { lines, words } = &mut self.source {
            loop {
                match lines.next() {
                    Some(line) => *words = Words::new(line),
                    None => return Err(self.ended()),
                }
                if words.clone().next().is_some() {
                    break;
                }
            }
        }
        Ok(())
    }

    /// Ends the row: in an ascii file, what is left of the line. `strict`: that is an error.
    pub(super) fn end_row(&mut self, strict: bool) -> Result<()> {
        if let Source::Ascii { words, .. } = &mut self.source
            && words.next().is_some()
        {
            if strict {
                return Err(self
                    .flaw(format!("a row of element '{}' has too many values", self.element))
                    .hint("check the counts of the header"));
            }
            self.surplus += 1;
        }
        Ok(())
    }

    /// The next value.
    pub(super) fn value(&mut self, kind: Type) -> Result<f64> {
        match &mut self.source {
            Source::Ascii { words, .. } => match words.next() {
                Some(word) => ascii(word).ok_or_else(|| self.flaw(format!("{} is not a number", quote(word)))),
                None => Err(self
                    .flaw(format!("a row of element '{}' has too few values", self.element))
                    .hint("check the counts of the header")),
            },
            Source::Binary { body, at, big } => {
                let size = kind.size();
                let Some(bytes) = body.get(*at..*at + size) else { return Err(self.ended()) };
                *at += size;
                let mut eight = [0; 8];
                eight[..size].copy_from_slice(bytes);
                if *big {
                    eight[..size].reverse();
                }
                let [a, b, c, d, ..] = eight;
                Ok(match kind {
                    Type::I8 => f64::from(a as i8),
                    Type::U8 => f64::from(a),
                    Type::I16 => f64::from(i16::from_le_bytes([a, b])),
                    Type::U16 => f64::from(u16::from_le_bytes([a, b])),
                    Type::I32 => f64::from(i32::from_le_bytes([a, b, c, d])),
                    Type::U32 => f64::from(u32::from_le_bytes([a, b, c, d])),
                    Type::F32 => f64::from(f32::from_le_bytes([a, b, c, d])),
                    Type::F64 => f64::from_le_bytes(eight),
                })
            }
        }
    }

    /// The next list, into `out`.
    pub(super) fn list(&mut self, length: Type, kind: Type, out: &mut Vec<f64>) -> Result<()> {
        out.clear();
        let count = self.value(length)?;
        let least = if matches!(self.source, Source::Ascii { .. }) { 2 } else { kind.size() };
        let room = match &self.source {
            Source::Ascii { words, .. } => words.rest().len() + 1,
            Source::Binary { .. } => self.left(),
        };
        if !(count >= 0.0 && count.fract() == 0.0) {
            return Err(self.flaw(format!("a list of {count} values")).hint("check the types of the header"));
        }
        if count * least as f64 > room as f64 {
            return Err(match self.source {
                Source::Ascii { .. } => self.flaw(format!("a list of {count} values, more than the row holds")),
                Source::Binary { .. } => self.ended(),
            });
        }
        for _ in 0..count as usize {
            out.push(self.value(kind)?);
        }
        Ok(())
    }

    /// Passes over a property.
    pub(super) fn skip(&mut self, property: &Property, scratch: &mut Vec<f64>) -> Result<()> {
        match property.list {
            Some(length) => self.list(length, property.kind, scratch),
            None => self.value(property.kind).map(drop),
        }
    }

    /// An error at the present place.
    pub(super) fn flaw(&self, found: impl Into<String>) -> Error {
        let place = match &self.source {
            Source::Ascii { lines, .. } => format!("line {}", self.before + lines.number()),
            Source::Binary { at, .. } => format!("{} {}, byte {}", self.element, self.row - 1, self.before + at),
        };
        Error::malformed(found).at(place)
    }

    fn ended(&self) -> Error {
        let found = format!("the file ends within row {} of the {} of element '{}'", self.row, self.count, self.element);
        self.flaw(found).expected("a complete file").hint("the file seems to be cut short: copy it again")
    }
}

/// A number; not-a-number for the spellings of NaN and infinity, which some scanners write for missing values.
fn ascii(word: &[u8]) -> Option<f64> {
    number(word).or_else(|| {
        let text = std::str::from_utf8(word).ok()?.trim_start_matches(['-', '+']).to_ascii_lowercase();
        let special = text.starts_with("nan")
            || text.starts_with("inf")
            || text.contains("#in")
            || text.contains("#qnan")
            || text.contains("#snan");
        special.then_some(f64::NAN)
    })
}
