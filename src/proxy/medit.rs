//! MEDIT `.mesh` text files: a proxy of the user's own, and the proxy of a run for others to look at.

use super::Proxy;
use super::carve::finish;
use super::tetrahedra::{faces, sides, volume};
use crate::error::{Error, Kind, Notes, Result};
use crate::scan::UnitBox;
use flate2::read::MultiGzDecoder;
use glam::DVec3;
use std::io::{Read, Write};
use std::path::Path;

/// More text than this is not a proxy.
const LARGEST: u64 = 1 << 30;
/// A proxy this many times smaller or larger than the scan, or this many diagonals away, is in another unit or place.
const MISFIT: f64 = 4.0;

/// Reads the `Vertices` and `Tetrahedra` of a text `.mesh` file, gzipped or not, in the coordinates of the scan.
///
/// The boundary consists of the faces of one tetrahedron only; what else the file holds is skipped. Inverted tetrahedra are turned, flat
/// ones and vertices without a tetrahedron are left out, all with a note.
///
/// Errors: unreadable file; broken format, with the line; an index without a vertex; a proxy that does not lie at the scan.
pub fn read(path: &Path, unit_box: &UnitBox) -> Result<(Proxy, Notes)> {
    let bytes = crate::opened::read(path).map_err(|e| Error::unreadable(path, &e))?;
    parse(&bytes, unit_box).map_err(|e| e.file(path))
}

/// Writes the proxy in the coordinates of the scan: vertices, boundary triangles, tetrahedra.
pub fn write(out: &mut dyn Write, proxy: &Proxy, unit_box: &UnitBox) -> std::io::Result<()> {
    writeln!(out, "MeshVersionFormatted 2\nDimension 3\nVertices\n{}", proxy.rest.len())?;
    for p in &proxy.rest {
        let p = unit_box.leave(*p);
        writeln!(out, "{} {} {} 0", p.x, p.y, p.z)?;
    }
    writeln!(out, "Triangles\n{}", proxy.boundary.len())?;
    for [a, b, c] in proxy.boundary.iter().map(|f| f.map(|v| v + 1)) {
        writeln!(out, "{a} {b} {c} 0")?;
    }
    writeln!(out, "Tetrahedra\n{}", proxy.tets.len())?;
    for [a, b, c, d] in proxy.tets.iter().map(|t| t.map(|v| v + 1)) {
        writeln!(out, "{a} {b} {c} {d} 0")?;
    }
    writeln!(out, "End")
}

/// What a file holds, whatever scan it belongs to: vertices in its own coordinates, and the number of tetrahedra.
///
/// Errors: unreadable file; broken format, with the line; no vertices or no tetrahedra.
pub fn look(path: &Path) -> Result<(Vec<DVec3>, usize)> {
    let bytes = crate::opened::read(path).map_err(|e| Error::unreadable(path, &e))?;
    let file = sections(&bytes).map_err(|e| e.file(path))?;
    match (file.vertices, file.tets) {
        (Some(vertices), Some(tets)) if !vertices.is_empty() && !tets.is_empty() => Ok((vertices, tets.len())),
        _ => Err(Error::malformed("no tetrahedra").file(path).expected("the sections Vertices and Tetrahedra")),
    }
}

fn parse(bytes: &[u8], unit_box: &UnitBox) -> Result<(Proxy, Notes)> {
    assemble(sections(bytes)?, unit_box)
}

fn sections(bytes: &[u8]) -> Result<File> {
    let mut unpacked = Vec::new();
    let text = if bytes.starts_with(&[0x1F, 0x8B]) {
        let mut gunzip = MultiGzDecoder::new(bytes).take(LARGEST);
        gunzip.read_to_end(&mut unpacked).map_err(|e| Error::malformed(format!("broken gzip data: {e}")))?;
        &unpacked
    } else {
        bytes
    };
    // Binary .meshb files begin with the integer 1 in either byte order.
    if text.starts_with(&[1, 0, 0, 0]) || text.starts_with(&[0, 0, 0, 1]) {
        return Err(Error::new(Kind::Unsupported, "a binary MEDIT file").expected("MEDIT text (.mesh)"));
    }
    File::parse(text)
}

/// What the file says.
#[derive(Default)]
struct File {
    vertices: Option<Vec<DVec3>>,
    /// Indices from 0, and the line of each.
    tets: Option<Vec<([u32; 4], usize)>>,
}

impl File {
    fn parse(text: &[u8]) -> Result<Self> {
        let mut file = Self::default();
        let mut words = Words { text, at: 0, line: 1 };
        let Some((first, line)) = words.next() else { return Err(Error::malformed("an empty file").expected("MEDIT text")) };
        if !first.eq_ignore_ascii_case("MeshVersionFormatted") {
            return Err(Error::malformed(format!("the file begins with '{}'", clip(first)))
                .at(format!("line {line}"))
                .expected("MeshVersionFormatted, as in every MEDIT text file"));
        }
        words.next();
        while let Some((word, line)) = words.next() {
            match word.to_ascii_lowercase().as_str() {
                "dimension" => {
                    let dimension = words.count("Dimension")?;
                    if dimension != 3 {
                        return Err(Error::new(Kind::Unsupported, format!("a mesh of dimension {dimension}"))
                            .at(format!("line {line}"))
                            .expected("Dimension 3"));
                    }
                }
                "vertices" if file.vertices.is_some() => return Err(twice("Vertices", line)),
                "vertices" => file.vertices = Some(words.vertices()?),
                "tetrahedra" if file.tets.is_some() => return Err(twice("Tetrahedra", line)),
                "tetrahedra" => file.tets = Some(words.tetrahedra()?),
                "end" => break,
                _ => {}
            }
        }
        Ok(file)
    }
}

fn twice(section: &str, line: usize) -> Error {
    Error::malformed(format!("a second {section} section")).at(format!("line {line}"))
}

/// Words between white space, with comments left out.
struct Words<'a> {
    text: &'a [u8],
    at: usize,
    line: usize,
}

impl<'a> Words<'a> {
    fn next(&mut self) -> Option<(&'a str, usize)> {
        loop {
            match *self.text.get(self.at)? {
                b'\n' => {
                    self.line += 1;
                    self.at += 1;
                }
                b'#' => self.at += self.text[self.at..].iter().position(|&b| b == b'\n').unwrap_or(self.text.len() - self.at),
                c if c.is_ascii_whitespace() || c == 0 => self.at += 1,
                _ => break,
            }
        }
        let rest = &self.text[self.at..];
        let length = rest.iter().position(|&b| b.is_ascii_whitespace() || b == b'#' || b == 0).unwrap_or(rest.len());
        self.at += length;
        Some((std::str::from_utf8(&rest[..length]).unwrap_or("\u{FFFD}"), self.line))
    }

    /// The next word as a number, or an error that says of what.
    fn number<T: std::str::FromStr>(&mut self, what: impl Fn() -> String) -> Result<T> {
        let Some((word, line)) = self.next() else {
            return Err(Error::malformed("the file ends too early").at(format!("line {}", self.line)).expected(what()));
        };
        word.parse().map_err(|_| Error::malformed(format!("'{}'", clip(word))).at(format!("line {line}")).expected(what()))
    }

    fn count(&mut self, section: &str) -> Result<usize> {
        self.number(|| format!("a count after {section}"))
    }

    /// Room for `count` records of `words` words each, but never more than the rest of the text can hold.
    fn room(&self, count: usize, words: usize) -> usize {
        count.min((self.text.len() - self.at) / (2 * words))
    }

    fn vertices(&mut self) -> Result<Vec<DVec3>> {
        let count = self.count("Vertices")?;
        let mut vertices = Vec::with_capacity(self.room(count, 4));
        for i in 0..count {
            let mut p = [0.0; 3];
            for x in &mut p {
                *x = self.number(|| format!("a coordinate of vertex {} of {count}", i + 1))?;
                if !f64::is_finite(*x) {
                    return Err(Error::malformed(format!("a coordinate of vertex {} is not finite", i + 1))
                        .at(format!("line {}", self.line)));
                }
            }
            // References are integers, but some writers put labels as floats there.
            self.number::<f64>(|| format!("the reference of vertex {} of {count}", i + 1))?;
            vertices.push(DVec3::from_array(p));
        }
        Ok(vertices)
    }

    fn tetrahedra(&mut self) -> Result<Vec<([u32; 4], usize)>> {
        let count = self.count("Tetrahedra")?;
        let mut tets = Vec::with_capacity(self.room(count, 5));
        for i in 0..count {
            let mut t = [0u32; 4];
            for v in &mut t {
                let index: u32 = self.number(|| format!("a vertex of tetrahedron {} of {count}", i + 1))?;
                *v = index.checked_sub(1).ok_or_else(|| {
                    Error::malformed(format!("tetrahedron {} names vertex 0", i + 1))
                        .at(format!("line {}", self.line))
                        .expected("vertices counted from 1")
                })?;
            }
            let line = self.line;
            if (1..4).any(|k| t[..k].contains(&t[k])) {
                return Err(Error::malformed(format!("tetrahedron {} names a vertex twice", i + 1)).at(format!("line {line}")));
            }
            self.number::<f64>(|| format!("the reference of tetrahedron {} of {count}", i + 1))?;
            tets.push((t, line));
        }
        Ok(tets)
    }
}

fn clip(word: &str) -> String {
    word.chars().take(40).collect()
}

fn assemble(file: File, unit_box: &UnitBox) -> Result<(Proxy, Notes)> {
    let (Some(vertices), Some(records)) = (file.vertices, file.tets) else {
        return Err(Error::malformed("no Vertices or no Tetrahedra section").expected("a tetrahedral mesh"));
    };
    let mut tets = Vec::with_capacity(records.len());
    for (i, (t, line)) in records.iter().enumerate() {
        if let Some(v) = t.iter().find(|&&v| v as usize >= vertices.len()) {
            return Err(Error::malformed(format!("tetrahedron {} names vertex {}", i + 1, u64::from(*v) + 1))
                .at(format!("line {line}"))
                .expected(format!("1 to {}", vertices.len())));
        }
        tets.push(*t);
    }
    let points: Vec<DVec3> = vertices.iter().map(|p| unit_box.enter(*p)).collect();
    let mut notes = Notes::default();
    let mut turned = 0;
    for t in &mut tets {
        if volume(&points, *t) < 0.0 {
            t.swap(2, 3);
            turned += 1;
        }
    }
    if turned > 0 {
        notes.warn(format!("proxy: {turned} of {} tetrahedra are inverted: turned", tets.len()));
    }
    let overlaps = faces(&sides(&tets)).filter(|face| face.len() > 2).count();
    if overlaps > 0 {
        notes.warn(format!("proxy: {overlaps} faces belong to more than two tetrahedra: it overlaps itself there"));
    }
    let (proxy, flat) = finish(&points, tets);
    if proxy.tets.is_empty() {
        return Err(Error::refused("the proxy has no tetrahedron with a volume"));
    }
    if flat > 0 {
        notes.warn(format!("proxy: {flat} flat tetrahedra are left out"));
    }
    if proxy.rest.len() < points.len() {
        let unused = points.len() - proxy.rest.len();
        notes.warn(format!(
            "proxy: {unused} vertices belong to no tetrahedron with a volume: left out, the others are renumbered"
        ));
    }
    lies_at_scan(&proxy)?;
    Ok((proxy, notes))
}

/// The scan fills the unit box: centre 0, diagonal 1.
fn lies_at_scan(proxy: &Proxy) -> Result<()> {
    let (lo, hi) = proxy.rest.iter().fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(lo, hi), p| (lo.min(*p), hi.max(*p)));
    let size = (hi - lo).length();
    let hint = "the proxy must be in the unit and place of the scan file";
    if size > MISFIT || size * MISFIT < 1.0 {
        return Err(Error::refused(format!("the proxy is {size:.3} times as large as the scan")).hint(hint));
    }
    let away = ((lo + hi) * 0.5).length();
    if away > 1.0 {
        return Err(Error::refused(format!("the proxy lies {away:.1} times the size of the scan away from it")).hint(hint));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    const UNIT: UnitBox = UnitBox { centre: DVec3::new(0.5, 0.5, 0.5), diagonal: 1.7320508 };

    const CUBE: &str = "MeshVersionFormatted 1\n# a cube\nDimension\n3\nVertices 8\n0 0 0 0\n1 0 0 0\n0 1 0 0\n1 1 0 0 # corner\n0 0 1 0\n1 0 1 0\n\
                        0 1 1 0\n1 1 1 0\nTriangles\n1\n1 2 3 7\nTetrahedra\n5\n1 2 3 5 0\n2 4 3 8 0\n5 6 8 2 0\n5 8 7 3 0\n2 3 5 8 0\nEnd\n";

    fn fails(text: &str) -> String {
        parse(text.as_bytes(), &UNIT).unwrap_err().to_string()
    }

    #[test]
    fn a_cube_of_five_tetrahedra() {
        let (proxy, notes) = parse(CUBE.as_bytes(), &UNIT).unwrap();
        assert_eq!((proxy.rest.len(), proxy.tets.len(), proxy.boundary.len()), (8, 5, 12));
        let total: f64 = proxy.tets.iter().map(|t| volume(&proxy.rest, *t)).sum();
        assert!((total * UNIT.diagonal.powi(3) - 1.0).abs() < 1e-12);
        assert!(proxy.tets.iter().all(|t| volume(&proxy.rest, *t) > 0.0));
        assert_eq!(notes.iter().collect::<Vec<_>>(), ["proxy: 2 of 5 tetrahedra are inverted: turned"]);
    }

    #[test]
    fn what_is_written_is_read_back() {
        let (proxy, _) = parse(CUBE.as_bytes(), &UNIT).unwrap();
        let mut text = Vec::new();
        write(&mut text, &proxy, &UNIT).unwrap();
        let (again, notes) = parse(&text, &UNIT).unwrap();
        assert_eq!((&again.tets, &again.boundary, &again.boundary_tets), (&proxy.tets, &proxy.boundary, &proxy.boundary_tets));
        assert!(again.rest.iter().zip(&proxy.rest).all(|(a, b)| a.distance(*b) < 1e-15));
        assert!(notes.is_empty());
        let mut zip = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::fast());
        zip.write_all(&text).unwrap();
        assert_eq!(parse(&zip.finish().unwrap(), &UNIT).unwrap().0.tets, proxy.tets);
    }

    #[test]
    fn broken_files_are_named_by_line() {
        assert!(fails(&CUBE.replace("2 3 5 8 0", "2 3 5 9 0")).contains("names vertex 9 (line 23)\n   expected 1 to 8"));
        assert!(fails(&CUBE.replace("2 3 5 8 0", "2 3 5 0 0")).contains("line 23"));
        assert!(fails(&CUBE.replace("2 3 5 8 0", "2 3 5 5 0")).contains("twice (line 23)"));
        assert!(
            fails(&CUBE.replace("Vertices 8", "Vertices 9"))
                .contains("'Triangles' (line 14)\n   expected a coordinate of vertex 9 of 9")
        );
        assert!(fails(&CUBE[..CUBE.len() - 8]).contains("ends too early (line 23)"));
        assert!(fails(&CUBE.replace("Vertices 8", "Vertices 18446744073709551615")).contains("line 14"));
        assert!(fails(&CUBE.replace("1 0 0 0\n", "1 nan 0 0\n")).contains("not finite (line 7)"));
        assert!(fails(&CUBE.replace("Tetrahedra", "Hexahedra")).contains("no Tetrahedra"));
        assert!(fails("solid cube\n").contains("'solid' (line 1)"));
        assert!(fails("\u{1}\0\0\0\u{3}\0\0\0").contains("binary"));
        assert!(fails("").contains("empty"));
    }

    #[test]
    fn a_proxy_in_another_unit_is_refused() {
        let millimetres = UnitBox { centre: UNIT.centre * 1000.0, diagonal: UNIT.diagonal * 1000.0 };
        assert!(parse(CUBE.as_bytes(), &millimetres).unwrap_err().to_string().contains("0.001 times as large"));
    }
}
