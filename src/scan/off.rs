//! Geomview's object file format: OFF with its prefixes ST, C, N, 4 and n, as text or binary.
//!
//! Source: Geomview manual, "OFF: Object File Format".

use super::remarks::Remarks;
use super::text::{Lines, Words, number, quote};
use super::{NONE, Scan};
use crate::error::{Error, Kind, Result};
use glam::DVec3;
use std::path::Path;

/// What the keyword announces for every vertex.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
struct Layout {
    /// A fourth coordinate that divides the others.
    homogeneous: bool,
    normals: bool,
    colors: bool,
    uvs: bool,
    /// A line with the number of dimensions follows.
    dimension: bool,
}

impl Layout {
    /// Numbers of a vertex before its colour.
    fn before_color(self) -> usize {
        3 + usize::from(self.homogeneous) + 3 * usize::from(self.normals)
    }
}

fn layout(word: &[u8]) -> Option<Layout> {
    if word == b"off" {
        return Some(Layout::default());
    }
    let mut rest = word.strip_suffix(b"OFF")?;
    let mut take = |prefix: &[u8]| match rest.strip_prefix(prefix) {
        Some(after) => {
            rest = after;
            true
        }
        None => false,
    };
    let (uvs, colors, normals, homogeneous, dimension) = (take(b"ST"), take(b"C"), take(b"N"), take(b"4"), take(b"n"));
    rest.is_empty().then_some(Layout { homogeneous, normals, colors, uvs, dimension })
}

/// Whether the first word that is no comment is a keyword of the format.
pub(super) fn is_off(bytes: &[u8]) -> bool {
    let head = &bytes[..bytes.len().min(4096)];
    let words = Lines::new(head).map(Words::new).find_map(|mut w| w.next().filter(|w| w[0] != b'#'));
    words.is_some_and(|w| layout(w).is_some())
}

/// Reads an OFF file from its bytes. Colours of faces are not kept; a missing keyword means plain OFF.
///
/// Errors: what the head announces is not there, an index that does not exist, a coordinate that is not finite, no faces.
pub(super) fn read(bytes: &[u8], path: &Path) -> Result<Scan> {
    parse(bytes).map_err(|e| e.file(path))
}

fn parse(bytes: &[u8]) -> Result<Scan> {
    let mut body = Body::default();
    let mut rows = Rows { lines: Lines::new(bytes), remarks: Remarks::default() };
    let mut words = rows.next().ok_or_else(|| Error::malformed("no vertices").expected("an OFF file"))?;
    let mut ahead = words.clone();
    if let Some(layout) = ahead.next().and_then(layout) {
        body.layout = layout;
        words = ahead;
        if words.clone().next() == Some(b"BINARY") {
            body.scan.space = rows.remarks.space(&mut body.scan.notes);
            let begin = bytes.len() - rows.lines.rest().len();
            Binary { bytes, at: begin }.read(&mut body)?;
            return body.finish();
        }
        if layout.dimension {
            words = rows.unless_empty(words)?;
            if words.next().and_then(number) != Some(3.0) {
                return Err(Error::new(Kind::Unsupported, "nOFF of other than three dimensions").at(rows.place()));
            }
        }
        words = rows.unless_empty(words)?;
    }
    let mut count = |what: &str| {
        let word = words.next().unwrap_or_default();
        let value = std::str::from_utf8(word).ok().and_then(|w| w.parse::<u64>().ok());
        value.ok_or_else(|| {
            Error::malformed(format!("the number of {what} is {}", quote(word)))
                .at(rows.place())
                .expected("a line 'vertices faces edges'")
        })
    };
    let (vertices, faces) = (count("vertices")?, count("faces")?);
    // A vertex is at least three digits with three blanks or line ends; a face, a digit with its line end.
    let room = rows.lines.rest().len() as u64 + 1;
    enough(vertices, 6, room, "vertices")?;
    enough(faces, 2, room.saturating_sub(6 * vertices), "faces")?;
    for _ in 0..vertices {
        let words = rows.next().ok_or_else(|| rows.ended("vertices", body.scan.mesh.positions.len(), vertices))?;
        body.vertex(words).map_err(|e| e.at(rows.place()))?;
    }
    for done in 0..faces {
        let words = rows.next().ok_or_else(|| rows.ended("faces", done as usize, faces))?;
        body.face(words, vertices).map_err(|e| e.at(rows.place()))?;
    }
    let surplus = std::iter::from_fn(|| rows.next()).count();
    if surplus > 0 {
        body.scan.notes.warn(format!("lines behind the {faces} faces that the head announces, which are ignored: {surplus}"));
    }
    body.scan.space = rows.remarks.space(&mut body.scan.notes);
    body.finish()
}

/// Errors if `count` rows of `least` bytes do not fit into `room`.
fn enough(count: u64, least: u64, room: u64, what: &str) -> Result<()> {
    if count.saturating_mul(least) <= room {
        return Ok(());
    }
    Err(Error::malformed(format!("the head announces {count} {what}, and the file has room for {} at most", room / least))
        .expected("a complete file")
        .hint("the file seems to be cut short: copy it again"))
}

/// Lines with something on them, comments taken away.
struct Rows<'a> {
    lines: Lines<'a>,
    remarks: Remarks,
}

impl<'a> Rows<'a> {
    fn next(&mut self) -> Option<Words<'a>> {
        loop {
            let line = self.lines.next()?;
            let (row, comment) = match line.iter().position(|&b| b == b'#') {
                Some(at) => (&line[..at], Some(&line[at + 1..])),
                None => (line, None),
            };
            comment.into_iter().for_each(|c| self.remarks.add(c));
            let words = Words::new(row);
            if words.clone().next().is_some() {
                return Some(words);
            }
        }
    }

    /// `words` if there are any, else the next row.
    fn unless_empty(&mut self, words: Words<'a>) -> Result<Words<'a>> {
        if words.clone().next().is_some() {
            return Ok(words);
        }
        self.next()
            .ok_or_else(|| Error::malformed("the head has no counts").at(self.place()).expected("a line 'vertices faces edges'"))
    }

    fn place(&self) -> String {
        format!("line {}", self.lines.number())
    }

    fn ended(&self, what: &str, found: usize, announced: u64) -> Error {
        Error::malformed(format!("the file ends after {found} of {announced} {what}"))
            .at(self.place())
            .expected("a complete file")
            .hint("the file seems to be cut short: copy it again")
    }
}

#[derive(Default)]
struct Body {
    layout: Layout,
    scan: Scan,
    short_faces: usize,
    colored_faces: usize,
}

impl Body {
    fn vertex(&mut self, words: Words<'_>) -> Result<()> {
        let mut values = [0.0; 16];
        let mut count = 0;
        for word in words {
            let Some(value) = values.get_mut(count) else {
                return Err(Error::malformed("a vertex with too many values").hint("check the counts of the head"));
            };
            *value = number(word).ok_or_else(|| Error::malformed(format!("{} is not a finite number", quote(word))))?;
            count += 1;
        }
        let before = self.layout.before_color();
        let after = 2 * usize::from(self.layout.uvs);
        let color = count.wrapping_sub(before + after);
        // Writers of plain OFF put colours behind the position too; a fourth number alone is a face that is counted as a vertex.
        let expected = if self.layout.colors { color == 3 || color == 4 } else { color == 0 || color == 3 || color == 4 };
        if count < before + after || !expected {
            return Err(Error::malformed(format!("a vertex of {count} values")).hint("check the counts of the head"));
        }
        self.add_vertex(&values[..count], color)
    }

    /// A vertex with `color` numbers of colour behind its position and normal.
    fn add_vertex(&mut self, values: &[f64], color: usize) -> Result<()> {
        let mut position = DVec3::new(values[0], values[1], values[2]);
        if self.layout.homogeneous {
            position /= values[3];
        }
        if !position.is_finite() {
            let vertex = self.scan.mesh.positions.len();
            return Err(Error::malformed(format!("vertex {vertex} (from 0) has coordinates that are not finite numbers"))
                .expected("finite coordinates"));
        }
        let before = self.layout.before_color();
        let look = &mut self.scan.look;
        if color > 0 {
            look.colors.resize(self.scan.mesh.positions.len(), [1.0; 4]);
            let alpha = if color == 4 { values[before + 3] as f32 } else { 1.0 };
            look.colors_have_alpha |= color == 4;
            look.colors.push([values[before] as f32, values[before + 1] as f32, values[before + 2] as f32, alpha]);
        }
        if self.layout.uvs {
            let uv = &values[values.len() - 2..];
            look.uvs.push([uv[0] as f32, uv[1] as f32].map(|x| if x.is_finite() { x } else { 0.0 }));
        }
        self.scan.mesh.positions.push(position);
        Ok(())
    }

    fn face(&mut self, mut words: Words<'_>, vertices: u64) -> Result<()> {
        let index = |word: &[u8]| std::str::from_utf8(word).ok().and_then(|w| w.parse::<u32>().ok());
        let word = words.next().unwrap_or_default();
        let sides = index(word)
            .filter(|&n| n > 0)
            .ok_or_else(|| Error::malformed(format!("a face of {} corners", quote(word))).hint("check the counts of the head"))?;
        let begin = self.scan.mesh.faces.corners.len();
        for _ in 0..sides {
            let word = words.next().ok_or_else(|| Error::malformed(format!("a face of {sides} corners ends early")))?;
            let corner = index(word).filter(|&v| u64::from(v) < vertices).ok_or_else(|| {
                Error::malformed(format!("a face with vertex index {} where there are {vertices} vertices", quote(word)))
                    .expected("whole numbers from 0")
            })?;
            self.scan.mesh.faces.corners.push(corner);
        }
        self.colored_faces += usize::from(words.next().is_some());
        self.end_face(begin)
    }

    fn end_face(&mut self, begin: usize) -> Result<()> {
        let faces = &mut self.scan.mesh.faces;
        if faces.corners.len() >= NONE as usize {
            return Err(Error::malformed("more face corners than 32 bits can number"));
        }
        if faces.corners.len() - begin < 3 {
            faces.corners.truncate(begin);
            self.short_faces += 1;
        } else {
            faces.starts.push(faces.corners.len() as u32);
        }
        Ok(())
    }

    fn finish(mut self) -> Result<Scan> {
        let scan = &mut self.scan;
        let vertices = scan.mesh.positions.len();
        if self.short_faces > 0 {
            scan.notes.warn(format!("faces with fewer than 3 corners skipped: {}", self.short_faces));
        }
        if self.colored_faces > 0 {
            scan.notes.warn("colours per face are not read");
        }
        if scan.mesh.faces.is_empty() {
            return Err(super::nothing_to_animate(vertices, &[(self.short_faces, "faces of fewer than 3 corners")]));
        }
        if !scan.look.colors.is_empty() {
            scan.look.colors.resize(vertices, [1.0; 4]);
        }
        // The format knows both 0 to 1 and 0 to 255.
        super::settle_colors(&mut scan.look);
        if self.layout.uvs {
            scan.look.corner_uvs = scan.mesh.faces.corners.clone();
        }
        Ok(self.scan)
    }
}

/// The binary form: big-endian 32-bit integers and floats.
struct Binary<'a> {
    bytes: &'a [u8],
    at: usize,
}

impl Binary<'_> {
    fn four(&mut self) -> Result<[u8; 4]> {
        let four = self.bytes.get(self.at..self.at + 4).and_then(|b| b.try_into().ok());
        self.at += 4;
        four.ok_or_else(|| {
            Error::malformed("the file ends early")
                .at(format!("byte {}", self.bytes.len()))
                .expected("a complete file")
                .hint("copy it again")
        })
    }

    fn integer(&mut self) -> Result<u32> {
        let at = self.at;
        let value = i32::from_be_bytes(self.four()?);
        u32::try_from(value).map_err(|_| {
            Error::malformed(format!("the number {value} where a count or index is wanted")).at(format!("byte {at}"))
        })
    }

    fn read(mut self, body: &mut Body) -> Result<()> {
        if body.layout.dimension && self.integer()? != 3 {
            return Err(Error::new(Kind::Unsupported, "nOFF of other than three dimensions"));
        }
        let (vertices, faces) = (self.integer()?, self.integer()?);
        self.integer()?;
        let color = if body.layout.colors { 4 } else { 0 };
        let columns = body.layout.before_color() + color + 2 * usize::from(body.layout.uvs);
        let room = self.bytes.len().saturating_sub(self.at) as u64;
        enough(vertices.into(), 4 * columns as u64, room, "vertices")?;
        enough(faces.into(), 8, room - 4 * columns as u64 * u64::from(vertices), "faces")?;
        let mut values = [0.0; 16];
        for _ in 0..vertices {
            let at = self.at;
            for value in &mut values[..columns] {
                *value = f64::from(f32::from_be_bytes(self.four()?));
            }
            body.add_vertex(&values[..columns], color).map_err(|e| e.at(format!("byte {at}")))?;
        }
        for _ in 0..faces {
            let at = self.at;
            let sides = self.integer()?;
            let begin = body.scan.mesh.faces.corners.len();
            for _ in 0..sides {
                let corner = self.integer()?;
                if corner >= vertices {
                    return Err(Error::malformed(format!(
                        "a face with vertex index {corner} where there are {vertices} vertices"
                    ))
                    .at(format!("byte {at}")));
                }
                body.scan.mesh.faces.corners.push(corner);
            }
            let colors = self.integer()?;
            body.colored_faces += usize::from(colors > 0);
            self.at = self.at.saturating_add(4 * colors as usize);
            body.end_face(begin)?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    fn parse_text(text: &str) -> Result<Scan> {
        read(text.as_bytes(), Path::new("a.off"))
    }

    const TRIANGLE: &str = "0 0 0\n1 0 0\n0 1 0\n";

    #[test]
    fn every_form_of_the_head() {
        for head in [
            "OFF\n3 1 0\n",
            "OFF 3 1 0\n",
            "# metres, Z up\n\nOFF # keyword\r\n3 1\r\n",
            "3 1 0\n",
            "\u{feff}OFF\n# x\n 3 1 0\n",
            "nOFF\n3\n3 1 0\n",
            "off\n3 1 0\n",
        ] {
            let scan = parse_text(&format!("{head}{TRIANGLE}3 0 1 2\n")).expect(head);
            assert_eq!((scan.mesh.positions[1], scan.mesh.faces.face(0)), (DVec3::X, &[0, 1, 2][..]));
            assert_eq!(scan.space.unit.is_some(), head.contains("metres"));
            assert!(scan.notes.is_empty());
        }
        assert!(
            is_off(b"#a\n  STCN4OFF 1") && is_off(b"OFF BINARY\n") && !is_off(b"TOFF\n") && !is_off(b"3 1 0\n") && !is_off(b"")
        );
        assert_eq!(parse_text("nOFF 4\n3 1 0\n").unwrap_err().kind, Kind::Unsupported);
    }

    #[test]
    fn prefixes_announce_columns() {
        let text = "STCN4OFF\n3 1 0\n 0 0 0 2  0 0 1  255 0 0 255  0 0.5\n2 0 0 2  0 0 1  0 51 0 255  1 0.5\n0 2 0 2  0 0 1  0 0 0 0  0 1\n3 0 1 2\n";
        let scan = parse_text(text).unwrap();
        assert_eq!(scan.mesh.positions[1], DVec3::X);
        assert_eq!(scan.look.colors[1], [0.0, 0.2, 0.0, 1.0]);
        assert!(scan.look.colors_have_alpha);
        assert_eq!((scan.look.uvs[2], scan.look.corner_uvs), ([0.0, 1.0], vec![0, 1, 2]));
        let plain = parse_text("OFF\n3 1 0\n0 0 0 1 0 0.5\n1 0 0 0 1 0\n0 1 0 0 0 1\n3 0 1 2 0.5 0.5 0.5\n").unwrap();
        assert_eq!(plain.look.colors[0], [1.0, 0.0, 0.5, 1.0]);
        assert_eq!(plain.notes.iter().collect::<Vec<_>>(), ["colours per face are not read"]);
        assert!(parse_text(&format!("COFF\n3 1 0\n{TRIANGLE}3 0 1 2\n")).is_err());
        assert!(parse_text("4OFF\n3 1 0\n0 0 0 0\n1 0 0 1\n0 1 0 1\n3 0 1 2\n").unwrap_err().found.contains("vertex 0"));
    }

    #[test]
    fn lies_of_the_head_are_errors() {
        let with = |counts: &str, rest: &str| parse_text(&format!("OFF\n{counts}\n{TRIANGLE}{rest}"));
        assert!(with("3 9 0", "3 0 1 2\n").unwrap_err().found.contains("room for"));
        assert!(with("3 2 0", "3 0 1 2\n").unwrap_err().found.contains("ends after 1 of 2 faces"));
        assert_eq!(with("4 1 0", "3 0 1 2\n3 0 1 2\n").unwrap_err().place.as_deref(), Some("line 6"));
        assert_eq!(with("2 1 0", "3 0 1 2\n").unwrap_err().place.as_deref(), Some("line 5"));
        assert!(with("3 1 0", "3 0 1 2\n3 2 1 0\n").unwrap().notes.iter().any(|n| n.contains("ignored: 1")));
        for counts in ["2147483648 1 0", "3 2147483648 0", "18446744073709551615 1 0", "-3 1 0", "x"] {
            assert!(with(counts, "3 0 1 2\n").is_err(), "{counts}");
        }
        for face in ["3 0 1 3", "3 0 1 -1", "3 0 1", "4294967295 0 1 2", "3 0 1 1.5", "2 0 1"] {
            assert!(with("3 1 0", &format!("{face}\n")).is_err(), "{face}");
        }
        assert!(parse_text("OFF").is_err() && parse_text("").is_err() && parse_text("OFF\n3 1 0\n0 0 nan\n").is_err());
    }

    #[test]
    fn binary_files_read_like_texts() {
        let mut bytes = b"COFF BINARY\n".to_vec();
        let mut put = |values: &[i32]| values.iter().for_each(|v| bytes.extend(v.to_be_bytes()));
        put(&[4, 2, 0]);
        for (x, y) in [(0.0f32, 0.0f32), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)] {
            put(&[x, y, 0.5, x, y, 0.25, 1.0].map(|f| f.to_bits() as i32));
        }
        put(&[4, 0, 1, 2, 3, 1, 7]);
        put(&[3, 0, 1, 2, 0]);
        let scan = read(&bytes, Path::new("a.off")).unwrap();
        assert_eq!(
            (scan.mesh.positions[2], scan.mesh.faces.face(0), scan.mesh.faces.face(1)),
            (DVec3::new(1.0, 1.0, 0.5), &[0, 1, 2, 3][..], &[0, 1, 2][..])
        );
        assert_eq!(scan.look.colors[2], [1.0, 1.0, 0.25, 1.0]);
        for cut in 0..bytes.len() {
            assert!(read(&bytes[..cut], Path::new("a.off")).is_err(), "{cut}");
        }
    }
}
