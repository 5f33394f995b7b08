//! STL, binary and ascii, in the dialects that are met. The format repeats every vertex in every facet; equal positions of one solid become
//! one vertex.

use super::remarks::Remarks;
use super::text::{Lines, Words, name, number, quote};
use super::{Faces, Group, Material, NONE, Scan, SurfaceMesh};
use crate::equal::{bits, first_equal};
use crate::error::{Error, Result};
use glam::DVec3;
use std::collections::HashMap;
use std::path::Path;

const HEAD: usize = 84;
const FACET: usize = 50;

/// Most colours that become materials; more of them become colours of the vertices.
const MOST_MATERIALS: usize = 32;

/// Whether `bytes` have exactly the length that a binary STL announces.
pub(super) fn is_exact_binary(bytes: &[u8]) -> bool {
    declared(bytes).is_some_and(|n| n > 0 && bytes.len() as u64 == HEAD as u64 + FACET as u64 * u64::from(n))
}

fn declared(bytes: &[u8]) -> Option<u32> {
    Some(u32::from_le_bytes(bytes.get(80..84)?.try_into().ok()?))
}

/// Facets as the file has them, before equal corners become one vertex.
#[derive(Default)]
struct Facets {
    /// Three per facet.
    corners: Vec<DVec3>,
    /// Name and first facet of each solid.
    solids: Vec<(String, usize)>,
    /// Colour of each facet in 5 bits per channel, red first; empty where no facet has one.
    colors: Vec<Option<[u8; 3]>>,
}

/// Reads an STL file from its bytes.
///
/// Vertices of one solid whose coordinates are equal bit for bit are one, numbered by first occurrence. Facets that thereby lose a corner
/// are dropped with a note: they carry no surface, and the format has no order to keep. Solids become groups, colours of facets (the
/// attribute words of VisCAM, SolidView and Magics) become materials, or colours of the vertices where there are many. Facet normals are not
/// read. The format states no unit.
///
/// Errors: a coordinate that is not a finite number, an ascii file with other words than the format's, no facets.
pub(super) fn read(bytes: &[u8], path: &Path) -> Result<Scan> {
    let mut scan = Scan::default();
    let read = if is_text(bytes) { ascii(bytes, &mut scan) } else { binary(bytes, &mut scan) };
    read.and_then(|facets| weld(facets, &mut scan)).map_err(|e| e.file(path))?;
    Ok(scan)
}

/// Whether the file is ascii: binary heads may begin with `solid` too, so the file must go on as a text, or say its next keyword.
fn is_text(bytes: &[u8]) -> bool {
    let head = &bytes[..bytes.len().min(1024)];
    let head = head.strip_prefix(b"\xef\xbb\xbf").unwrap_or(head).trim_ascii_start();
    let lower = head.to_ascii_lowercase();
    let keyword = lower.starts_with(b"solid") || lower.starts_with(b"facet");
    keyword && !is_exact_binary(bytes) && !head.contains(&0)
}

fn binary(bytes: &[u8], scan: &mut Scan) -> Result<Facets> {
    let Some(first) = declared(bytes) else {
        return Err(Error::malformed(format!("{} bytes, less than the head of a binary STL file", bytes.len()))
            .expected("a facet count at byte 80"));
    };
    let mut remarks = Remarks::default();
    bytes[..80].split(|&b| b == 0 || b == b'\n').for_each(|c| remarks.add(c));
    scan.space = remarks.space(&mut scan.notes);
    let sections = sections(bytes).unwrap_or_else(|| {
        let (announced, present) = (first as usize, (bytes.len() - HEAD) / FACET);
        let behind = bytes.len() - HEAD - FACET * present.min(announced);
        let whole = behind.is_multiple_of(FACET);
        let count = match announced.cmp(&present) {
            std::cmp::Ordering::Greater => {
                scan.notes.warn(format!("the head announces {announced} facets and the file holds {present}: these are taken"));
                present
            }
            // Writers that do not know the count beforehand leave 0, or forget to mend it.
            std::cmp::Ordering::Less if whole && all_finite(&bytes[HEAD..]) => {
                scan.notes.warn(format!("the head announces {announced} facets and the file holds {present}: all are taken"));
                present
            }
            _ => {
                if behind > 0 {
                    scan.notes.warn(format!("{behind} bytes behind the last facet are ignored"));
                }
                announced
            }
        };
        vec![(0, count)]
    });
    let total: usize = sections.iter().map(|s| s.1).sum();
    let mut facets = Facets { corners: Vec::with_capacity(3 * total), ..Facets::default() };
    let mut colors = Vec::new();
    for &(begin, count) in &sections {
        facets.solids.push((String::new(), facets.corners.len() / 3));
        let decode = color_of(&bytes[begin..begin + 80]);
        for (f, facet) in bytes[begin + HEAD..].chunks_exact(FACET).take(count).enumerate() {
            facets.corners.extend(corners(facet).map_err(|e| e.at(format!("facet {f}")))?);
            colors.push(decode(u16::from_le_bytes([facet[48], facet[49]])));
        }
    }
    if colors.iter().any(Option::is_some) {
        facets.colors = colors;
    }
    Ok(facets)
}

/// First byte and number of facets of each solid, if the file is several binary files in a row.
fn sections(bytes: &[u8]) -> Option<Vec<(usize, usize)>> {
    let mut sections = Vec::new();
    let mut begin = 0;
    while begin < bytes.len() {
        let count = declared(&bytes[begin..]).filter(|&n| n > 0)? as usize;
        sections.push((begin, count));
        begin = begin.checked_add(HEAD + FACET.checked_mul(count)?)?;
    }
    (begin == bytes.len()).then_some(sections)
}

fn all_finite(facets: &[u8]) -> bool {
    facets.chunks_exact(FACET).all(|f| corners(f).is_ok())
}

fn corners(facet: &[u8]) -> Result<[DVec3; 3]> {
    let float = |at: usize| f64::from(f32::from_le_bytes([facet[at], facet[at + 1], facet[at + 2], facet[at + 3]]));
    let corners = [12, 24, 36].map(|at| DVec3::new(float(at), float(at + 4), float(at + 8)));
    if corners.iter().all(|c| c.is_finite()) {
        Ok(corners)
    } else {
        Err(Error::malformed("a facet has a coordinate that is not a finite number").expected("finite coordinates"))
    }
}

/// What the attribute word of a facet means. Magics says so in the head (`COLOR=` with the colour of the whole), counts red from the lowest
/// bit and marks facets of the whole's colour by the highest bit; VisCAM and SolidView count blue from the lowest bit and mark facets that
/// have a colour.
fn color_of(head: &[u8]) -> impl Fn(u16) -> Option<[u8; 3]> {
    let magics = head.windows(6).position(|w| w == b"COLOR=").and_then(|at| head.get(at + 6..at + 9));
    let whole = magics.map(|c| [c[0] >> 3, c[1] >> 3, c[2] >> 3]);
    move |word| {
        let channels = [word & 31, word >> 5 & 31, word >> 10 & 31].map(|c| c as u8);
        match whole {
            Some(whole) if word & 0x8000 != 0 => Some(whole),
            Some(_) => Some(channels),
            None if word & 0x8000 != 0 => Some([channels[2], channels[1], channels[0]]),
            None => None,
        }
    }
}

fn ascii(bytes: &[u8], scan: &mut Scan) -> Result<Facets> {
    let mut facets = Facets::default();
    let mut outline: Vec<DVec3> = Vec::new();
    let (mut short, mut larger) = (0, 0);
    let mut close = |outline: &mut Vec<DVec3>, corners: &mut Vec<DVec3>| {
        match outline.len() {
            0 => {}
            1 | 2 => short += 1,
            n => {
                larger += usize::from(n > 3);
                (1..n - 1).for_each(|k| corners.extend([outline[0], outline[k], outline[k + 1]]));
            }
        }
        outline.clear();
    };
    let mut lines = Lines::new(bytes);
    while let Some(line) = lines.next() {
        let place = || format!("line {}", lines.number());
        let mut words = Words::new(line);
        while let Some(word) = words.next() {
            let mut word = word.to_ascii_lowercase();
            if word == b"end" {
                // Some write the closing words apart.
                word.extend(words.next().unwrap_or_default().to_ascii_lowercase());
            }
            match word.as_slice() {
                b"vertex" => {
                    let mut position = DVec3::ZERO;
                    for axis in 0..3 {
                        let word = words.next().unwrap_or_default();
                        position[axis] = number(word).filter(|x| x.is_finite()).ok_or_else(|| {
                            Error::malformed(format!("coordinate {} is not a finite number", quote(word)))
                                .expected("vertex x y z")
                                .at(place())
                        })?;
                    }
                    outline.push(position);
                }
                b"endloop" | b"endfacet" => close(&mut outline, &mut facets.corners),
                b"solid" => {
                    close(&mut outline, &mut facets.corners);
                    let (title, rest) = title(words.rest());
                    facets.solids.push((name(title), facets.corners.len() / 3));
                    words = Words::new(rest);
                }
                b"endsolid" => {
                    close(&mut outline, &mut facets.corners);
                    // Its name may be any words, but a file in one line goes on with the next solid.
                    words = Words::new(before_word(words.rest(), b"solid").1);
                }
                // The normal, whatever it says: up to three values, which may be no numbers.
                b"facet" => words = Words::new(before_word(words.rest(), b"outer").1),
                b"outer" | b"loop" => {}
                _ if word.starts_with(b"#") || word.starts_with(b";") || word.starts_with(b"//") => break,
                _ => {
                    return Err(Error::malformed(format!("{} in an ascii STL file", quote(&word)))
                        .expected("facet, vertex, endfacet …")
                        .at(place()));
                }
            }
        }
    }
    if !outline.is_empty() {
        outline.truncate(outline.len().min(2));
        close(&mut outline, &mut facets.corners);
    }
    if short > 0 {
        scan.notes.warn(format!("facets that have not three vertices skipped: {short}"));
    }
    if larger > 0 {
        scan.notes.warn(format!("facets of more than three vertices, cut into triangles: {larger}"));
    }
    Ok(facets)
}

/// The name behind `solid`, and what follows it on the line: a file may be one line.
fn title(rest: &[u8]) -> (&[u8], &[u8]) {
    let (title, behind) = before_word(rest, b"facet");
    let next = Words::new(behind).nth(1).unwrap_or_default();
    // A name may hold the word.
    if next.eq_ignore_ascii_case(b"normal") { (title, behind) } else { (rest, &[]) }
}

/// What comes before the first occurrence of `word` as a word, and the rest with it.
fn before_word<'a>(text: &'a [u8], word: &[u8]) -> (&'a [u8], &'a [u8]) {
    let mut words = Words::new(text);
    let mut at = text.len() - words.rest().len();
    while let Some(next) = words.next() {
        if next.eq_ignore_ascii_case(word) {
            return (&text[..at], &text[at..]);
        }
        at = text.len() - words.rest().len();
    }
    (text, &[])
}

fn weld(facets: Facets, scan: &mut Scan) -> Result<()> {
    let Facets { corners, solids, colors } = facets;
    if corners.is_empty() {
        return Err(super::nothing_to_animate(0, &[(0, "facets")]));
    }
    let mut solid_of = vec![0u32; corners.len() / 3];
    for (k, (_, begin)) in solids.iter().enumerate() {
        let end = solids.get(k + 1).map_or(solid_of.len(), |(_, next)| *next);
        solid_of[*begin..end].fill(k as u32);
    }
    let key = |i: usize| {
        let [x, y, z] = corners[i].to_array().map(bits);
        [x, y, z, u64::from(solid_of[i / 3])]
    };
    let first = first_equal(corners.len(), key);
    let mut numbers = vec![NONE; corners.len()];
    let mut mesh = SurfaceMesh { positions: Vec::new(), faces: Faces::default() };
    let mut kept = Vec::with_capacity(corners.len() / 3);
    let mut collapsed = 0;
    for (facet, firsts) in first.chunks_exact(3).enumerate() {
        for (k, &f) in firsts.iter().enumerate() {
            if f as usize == 3 * facet + k {
                numbers[f as usize] = mesh.positions.len() as u32;
                mesh.positions.push(corners[f as usize]);
            }
        }
        let [a, b, c] = [0, 1, 2].map(|k| numbers[firsts[k] as usize]);
        if a == b || b == c || c == a {
            collapsed += 1;
        } else {
            mesh.faces.push([a, b, c]);
            kept.push(facet);
        }
    }
    if collapsed > 0 {
        scan.notes.warn(format!("facets with two equal vertices dropped: {collapsed}"));
    }
    if mesh.faces.is_empty() {
        return Err(super::nothing_to_animate(mesh.positions.len(), &[(collapsed, "facets without area")]));
    }
    scan.mesh = mesh;
    groups(&solids, &solid_of, &kept, scan);
    if !colors.is_empty() {
        let colors: Vec<Option<[u8; 3]>> = kept.iter().map(|&f| colors[f]).collect();
        paint(&colors, scan);
    }
    Ok(())
}

/// Solids as groups, where there are several or they have names; those without a name are numbered.
fn groups(solids: &[(String, usize)], solid_of: &[u32], kept: &[usize], scan: &mut Scan) {
    if solids.len() < 2 && solids.first().is_none_or(|(name, _)| name.is_empty()) {
        return;
    }
    let mut numbers = vec![NONE; solids.len()];
    for &f in kept {
        let k = solid_of[f] as usize;
        if numbers[k] == NONE {
            numbers[k] = scan.look.groups.len() as u32;
            let name = if solids[k].0.is_empty() { format!("solid {}", k + 1) } else { solids[k].0.clone() };
            scan.look.groups.push(Group { object: Some(name), group: None });
        }
        scan.look.face_groups.push(numbers[k]);
    }
}

/// Colours of the faces as materials, or as colours of the vertices, each the mean of its faces.
fn paint(colors: &[Option<[u8; 3]>], scan: &mut Scan) {
    let look = &mut scan.look;
    let mut known: HashMap<[u8; 3], u32> = HashMap::new();
    for color in colors.iter().flatten() {
        let next = known.len() as u32;
        known.entry(*color).or_insert(next);
    }
    let fraction = |c: u8| f32::from(c) / 31.0;
    if known.len() <= MOST_MATERIALS {
        let mut in_order: Vec<([u8; 3], u32)> = known.iter().map(|(&c, &n)| (c, n)).collect();
        in_order.sort_by_key(|&(_, n)| n);
        look.materials = in_order.iter().map(|&(color, _)| material(color)).collect();
        look.face_materials = colors.iter().map(|c| c.map_or(NONE, |c| known[&c])).collect();
        return;
    }
    let mut sums = vec![[0.0f32; 4]; scan.mesh.positions.len()];
    for (face, color) in scan.mesh.faces.iter().zip(colors) {
        let [r, g, b] = color.map_or([1.0; 3], |c| c.map(fraction));
        for &v in face {
            let sum = &mut sums[v as usize];
            [r, g, b, 1.0].iter().zip(sum).for_each(|(c, s)| *s += c);
        }
    }
    let mean = |[r, g, b, n]: [f32; 4]| if n > 0.0 { [r / n, g / n, b / n, 1.0] } else { [1.0; 4] };
    look.colors = sums.into_iter().map(mean).collect();
}

fn material(color: [u8; 3]) -> Material {
    let [r, g, b] = color.map(|c| (u32::from(c) * 255 + 15) / 31);
    let linear = |c: u32| {
        let c = c as f32 / 255.0;
        if c <= 0.04045 { c / 12.92 } else { ((c + 0.055) / 1.055).powf(2.4) }
    };
    Material {
        name: format!("color {r:02x}{g:02x}{b:02x}"),
        base_color: [linear(r), linear(g), linear(b), 1.0],
        ..Material::default()
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    fn facet(corners: [[f64; 3]; 3]) -> String {
        let lines = corners.map(|[x, y, z]| format!(" vertex {x} {y} {z}\n")).concat();
        format!("facet normal 0 0 0\n outer loop\n{lines} endloop\nendfacet\n")
    }

    fn parse(bytes: &[u8]) -> Scan {
        read(bytes, Path::new("a.stl")).unwrap()
    }

    /// A binary file of `count` facets in a fan, which announces `announced`.
    fn binary(head: &[u8], announced: u32, count: u16, attribute: impl Fn(u16) -> u16) -> Vec<u8> {
        let mut bytes = head.to_vec();
        bytes.resize(80, b' ');
        bytes.extend(announced.to_le_bytes());
        for f in 0..count {
            bytes.extend([0; 12]);
            let corners = [[0.0, 0.0], [1.0, f32::from(f)], [1.0, f32::from(f + 1)]];
            corners.iter().for_each(|[x, y]| [*x, *y, 0.5].iter().for_each(|v| bytes.extend(v.to_le_bytes())));
            bytes.extend(attribute(f).to_le_bytes());
        }
        bytes
    }

    #[test]
    fn equal_corners_are_one_vertex_in_order_of_occurrence() {
        let (a, b, c, d) = ([0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [1.0, 1.0, 0.25]);
        let text =
            format!("solid two words\n{}{}{}endsolid\n", facet([a, b, c]), facet([[1.0, -0.0, 0.0], d, c]), facet([a, a, b]));
        let scan = parse(text.as_bytes());
        assert_eq!(scan.mesh.faces.corners, [0, 1, 2, 1, 3, 2]);
        assert_eq!(scan.mesh.positions[3], DVec3::new(1.0, 1.0, 0.25));
        assert_eq!(scan.notes.iter().collect::<Vec<_>>(), ["facets with two equal vertices dropped: 1"]);
        assert_eq!(scan.look.groups, [Group { object: Some("two words".into()), group: None }]);
    }

    #[test]
    fn flaws_name_their_place() {
        let text = format!("solid\n{}", facet([[0.0; 3], [1.0; 3], [f64::NAN, 0.0, 0.0]]));
        assert_eq!(read(text.as_bytes(), Path::new("a.stl")).unwrap_err().place.as_deref(), Some("line 6"));
        assert!(read(b"solid\nfacet\nvertx 0 0 0\n", Path::new("a.stl")).unwrap_err().found.contains("vertx"));
        assert!(read(b"", Path::new("a.stl")).is_err());
        let mut bytes = binary(b"", 2, 2, |_| 0);
        bytes[HEAD + FACET + 12..][..4].copy_from_slice(&f32::NAN.to_le_bytes());
        assert_eq!(read(&bytes, Path::new("a.stl")).unwrap_err().place.as_deref(), Some("facet 1"));
    }

    #[test]
    fn several_solids_are_groups_that_share_no_vertex() {
        let one = facet([[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]);
        let text = format!(
            "solid facet thing\n{one}endsolid facet thing\nsolid\n{one}{one}endsolid\nsolid empty\nendsolid\nSOLID last\n{one}"
        );
        let scan = parse(text.as_bytes());
        assert_eq!((scan.mesh.positions.len(), &scan.look.face_groups[..]), (9, &[0, 1, 1, 2][..]));
        let names: Vec<_> = scan.look.groups.iter().map(|g| g.object.as_deref().unwrap()).collect();
        assert_eq!(names, ["facet thing", "solid 2", "last"]);
        let bytes = [binary(b"first", 2, 2, |_| 0), binary(b"second", 3, 3, |_| 0)].concat();
        let scan = parse(&bytes);
        assert_eq!((scan.mesh.positions.len(), &scan.look.face_groups[..]), (4 + 5, &[0, 0, 1, 1, 1][..]));
        assert!(scan.notes.is_empty());
    }

    #[test]
    fn ascii_dialects_are_the_same_mesh() {
        let plain = format!(
            "solid a b\n{}{}endsolid a b\n",
            facet([[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]),
            facet([[0.0; 3], [0.0, 1.0, 0.0], [-1.0, 0.5, 0.25]])
        );
        let expected = parse(plain.as_bytes());
        let dialects = [
            plain.to_uppercase(),
            plain.replace('\n', "\r\n"),
            plain.replace('\n', "\r"),
            plain.replace('\n', " "),
            plain.replace("endsolid a b\n", ""),
            plain.replace("endloop", "end loop").replace("endfacet", "END FACET"),
            plain.replace("0.25", "+2.5E-001").replace("0 0 0", "0.000000e+000 0.0 -0"),
            plain.replace("normal 0 0 0", "normal nan -nan(ind) 1.#QNAN"),
            format!("\u{feff}\n  {}", plain.replace(" vertex", "\tvertex")),
            plain.replace("solid a b\nfacet", "solid a b\n# comment\n; comment\n// comment facet\nfacet"),
        ];
        for text in dialects {
            let scan = parse(text.as_bytes());
            assert_eq!((&scan.mesh.positions, &scan.mesh.faces), (&expected.mesh.positions, &expected.mesh.faces), "{text}");
            assert!(scan.notes.is_empty() && scan.look.groups.len() == 1, "{text}");
        }
        let quad = "solid\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 1 1 0\nvertex 0 1 0\nendloop\nendfacet\nfacet\nvertex 1 1 1\nendloop";
        let scan = parse(quad.as_bytes());
        assert_eq!(scan.mesh.faces.corners, [0, 1, 2, 0, 2, 3]);
        assert_eq!(scan.notes.iter().count(), 2);
    }

    #[test]
    fn counts_that_lie_and_heads_that_mislead() {
        for (announced, words) in
            [(9, "holds 4: these"), (0, "holds 4: all"), (3, "holds 4: all"), (u32::MAX, "these"), (1 << 31, "these")]
        {
            for head in [&b"binary"[..], b"solid thing", b"SOLID facet normal"] {
                let scan = parse(&binary(head, announced, 4, |_| 0));
                assert_eq!((scan.mesh.faces.len(), scan.mesh.positions.len()), (4, 6));
                assert!(scan.notes.iter().any(|n| n.contains(words)), "{announced}: {:?}", scan.notes);
            }
        }
        let mut longer = binary(b"solid", 4, 4, |_| 0);
        longer.extend([7; 33]);
        let scan = parse(&longer);
        assert_eq!(scan.mesh.faces.len(), 4);
        assert!(scan.notes.iter().any(|n| n.starts_with("33 bytes")));
        assert!(parse(&binary(b"solid", 4, 4, |_| 0)).notes.is_empty());
    }

    #[test]
    fn attribute_words_are_colours_of_two_kinds() {
        let red = parse(&binary(b"", 3, 3, |f| if f == 0 { 0 } else { 0x8000 | 31 << 10 }));
        assert_eq!((&red.look.face_materials[..], red.look.materials[0].base_color), (&[NONE, 0, 0][..], [1.0, 0.0, 0.0, 1.0]));
        assert_eq!(red.look.materials[0].name, "color ff0000");
        let magics = parse(&binary(b"x COLOR=\0\0\xff\xff,MATERIAL=", 3, 3, |f| if f == 0 { 31 } else { 0xffff }));
        let names: Vec<_> = magics.look.materials.iter().map(|m| m.name.as_str()).collect();
        assert_eq!((names, &magics.look.face_materials[..]), (vec!["color ff0000", "color 0000ff"], &[0, 1, 1][..]));
        assert!(parse(&binary(b"", 3, 3, |f| f)).look.materials.is_empty(), "without the mark a word is no colour");
        let many = parse(&binary(b"", 40, 40, |f| 0x8000 | (f % 32) << 10 | (f / 32) << 5));
        assert!(many.look.materials.is_empty());
        // Corner 2 of facet 0 is corner 1 of facet 1.
        assert_eq!(many.look.colors[2], [0.5 / 31.0, 0.0, 0.0, 1.0]);
    }
}
