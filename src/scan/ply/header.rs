//! The head of a PLY file.

use crate::error::{Error, Result};
use crate::scan::text::{Lines, Words, name, quote};

/// A scalar type.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Type {
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    F32,
    F64,
}

impl Type {
    fn parse(word: &[u8]) -> Option<Self> {
        Some(match word {
            b"char" | b"int8" => Type::I8,
            b"uchar" | b"uint8" => Type::U8,
            b"short" | b"int16" => Type::I16,
            b"ushort" | b"uint16" => Type::U16,
            b"int" | b"int32" => Type::I32,
            b"uint" | b"uint32" => Type::U32,
            b"float" | b"float32" => Type::F32,
            b"double" | b"float64" => Type::F64,
            _ => return None,
        })
    }

    /// Bytes in a binary file.
    pub(super) fn size(self) -> usize {
        match self {
            Type::I8 | Type::U8 => 1,
            Type::I16 | Type::U16 => 2,
            Type::I32 | Type::U32 | Type::F32 => 4,
            Type::F64 => 8,
        }
    }

    /// The value that stands for full colour.
    pub(super) fn full_color(self) -> f64 {
        match self {
            Type::F32 | Type::F64 => 1.0,
            Type::U16 | Type::I16 => 65535.0,
            _ => 255.0,
        }
    }
}

/// A property of an element.
#[derive(Clone, Debug)]
pub(super) struct Property {
    /// Its name in lower case.
    pub(super) name: String,
    /// Type of the length, for a list.
    pub(super) list: Option<Type>,
    /// Type of the value or of the list's values.
    pub(super) kind: Type,
}

/// A table of the file.
#[derive(Clone, Debug)]
pub(super) struct Element {
    /// Its name in lower case.
    pub(super) name: String,
    /// Rows, as the header claims.
    pub(super) count: u64,
    /// Columns.
    pub(super) properties: Vec<Property>,
}

/// How the body is written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Encoding {
    Ascii,
    LittleEndian,
    BigEndian,
}

/// The head of a PLY file.
#[derive(Clone, Debug)]
pub(super) struct Header {
    pub(super) encoding: Encoding,
    pub(super) elements: Vec<Element>,
    /// Texts of `comment` and `obj_info`.
    pub(super) comments: Vec<Vec<u8>>,
    /// Number of lines.
    pub(super) lines: usize,
}

/// Reads the head; returns it with the body.
///
/// Errors name the line.
pub(super) fn parse(bytes: &[u8]) -> Result<(Header, &[u8])> {
    let mut lines = Lines::new(bytes);
    lines.next();
    let mut encoding = None;
    let mut elements: Vec<Element> = Vec::new();
    let mut comments = Vec::new();
    let carriage_only = bytes.starts_with(b"ply\r") && !bytes.starts_with(b"ply\r\n");
    while let Some(line) = lines.next() {
        let at = |error: Error| error.at(format!("line {}", lines.number()));
        let mut words = Words::new(line);
        match words.next() {
            Some(b"format") => encoding = Some(format(words).map_err(at)?),
            Some(b"comment" | b"obj_info") => comments.push(words.rest().to_vec()),
            Some(b"element") => elements.push(element(words).map_err(at)?),
            Some(b"property") => {
                let property = property(words).map_err(at)?;
                let element = elements.last_mut().ok_or_else(|| at(Error::malformed("a property before the first element")))?;
                element.properties.push(property);
            }
            Some(b"end_header") => {
                let encoding = encoding.ok_or_else(|| at(Error::malformed("the header states no format")))?;
                // Where lines end in a lone CR, an LF behind the last one is the first byte of the data.
                let start = bytes.len() - lines.rest().len();
                let body = if carriage_only && bytes[..start].ends_with(b"\r\n") { &bytes[start - 1..] } else { lines.rest() };
                return Ok((Header { encoding, elements, comments, lines: lines.number() }, body));
            }
            None => {}
            Some(other) => {
                return Err(at(Error::malformed(format!("{} in the header", quote(other)))
                    .expected("format, comment, obj_info, element, property or end_header")));
            }
        }
    }
    Err(Error::malformed("the header has no end_header").at(format!("line {}", lines.number())))
}

fn format(mut words: Words<'_>) -> Result<Encoding> {
    match words.next() {
        Some(b"ascii") => Ok(Encoding::Ascii),
        Some(b"binary_little_endian") => Ok(Encoding::LittleEndian),
        Some(b"binary_big_endian") => Ok(Encoding::BigEndian),
        other => Err(Error::malformed(format!("format {}", quote(other.unwrap_or_default())))
            .expected("ascii, binary_little_endian or binary_big_endian")),
    }
}

fn element(mut words: Words<'_>) -> Result<Element> {
    let (element, count) = (words.next().unwrap_or_default(), words.next().unwrap_or_default());
    let number = std::str::from_utf8(count).ok().and_then(|c| c.parse().ok());
    let count = number.ok_or_else(|| Error::malformed(format!("element {} has the count {}", quote(element), quote(count))))?;
    Ok(Element { name: name(element).to_ascii_lowercase(), count, properties: Vec::new() })
}

fn property(mut words: Words<'_>) -> Result<Property> {
    let kind = |words: &mut Words<'_>| {
        let word = words.next().unwrap_or_default();
        Type::parse(word).ok_or_else(|| {
            Error::malformed(format!("property of type {}", quote(word))).expected("a PLY type such as float or uchar")
        })
    };
    let mut ahead = words.clone();
    let list = if ahead.next() == Some(b"list") {
        words = ahead;
        Some(kind(&mut words)?)
    } else {
        None
    };
    let kind = kind(&mut words)?;
    Ok(Property { name: name(words.rest()).to_ascii_lowercase(), list, kind })
}
