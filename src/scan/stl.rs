//! STL, binary and ascii. The format repeats every vertex in every facet; equal positions become one vertex.

use super::remarks::Remarks;
use super::text::{Lines, Words, number, quote};
use super::weld::{bits, first_equal};
use super::{Faces, NONE, Scan, SurfaceMesh};
use crate::error::{Error, Result};
use glam::DVec3;
use std::path::Path;

const HEAD: usize = 84;
const FACET: usize = 50;

/// Whether `bytes` have exactly the length that a binary STL announces.
pub(super) fn is_exact_binary(bytes: &[u8]) -> bool {
    declared(bytes).is_some_and(|n| n > 0 && bytes.len() as u64 == HEAD as u64 + FACET as u64 * u64::from(n))
}

fn declared(bytes: &[u8]) -> Option<u32> {
    Some(u32::from_le_bytes(bytes.get(80..84)?.try_into().ok()?))
}

/// Reads an STL file from its bytes.
///
/// Vertices whose coordinates are equal bit for bit are one, numbered by first occurrence. Facets that thereby lose a corner are dropped
/// with a note: they carry no surface, and the format has no order to keep. Facet normals and attributes are not read.
///
/// Errors: a coordinate that is not a finite number, an ascii file with other words than the format's, no facets.
pub(super) fn read(bytes: &[u8], path: &Path) -> Result<Scan> {
    let head = &bytes[..bytes.len().min(512)];
    let ascii =
        !is_exact_binary(bytes) && head.trim_ascii_start().to_ascii_lowercase().starts_with(b"solid") && !head.contains(&0);
    let mut scan = Scan::default();
    let read = if ascii { ascii_corners(bytes, &mut scan) } else { binary_corners(bytes, &mut scan) };
    read.and_then(|corners| weld(&corners, &mut scan)).map_err(|e| e.file(path))?;
    Ok(scan)
}

fn binary_corners(bytes: &[u8], scan: &mut Scan) -> Result<Vec<DVec3>> {
    let Some(declared) = declared(bytes) else {
        return Err(Error::malformed(format!("{} bytes, less than the head of a binary STL file", bytes.len()))
            .expected("a facet count at byte 80"));
    };
    let mut remarks = Remarks::default();
    bytes[..80].split(|&b| b == 0 || b == b'\n').for_each(|c| remarks.add(c));
    scan.space = remarks.space(&mut scan.notes);
    let present = (bytes.len() - HEAD) / FACET;
    if declared as usize > present {
        scan.notes.warn(format!("the head announces {declared} facets and the file holds {present}: these are taken"));
    } else if bytes.len() > HEAD + FACET * declared as usize {
        scan.notes.warn(format!("{} bytes behind the last facet are ignored", bytes.len() - HEAD - FACET * declared as usize));
    }
    let count = present.min(declared as usize);
    let mut corners = Vec::with_capacity(3 * count);
    for (f, facet) in bytes[HEAD..].chunks_exact(FACET).take(count).enumerate() {
        for corner in facet[12..48].chunks_exact(12) {
            let at = |i: usize| f64::from(f32::from_le_bytes([corner[i], corner[i + 1], corner[i + 2], corner[i + 3]]));
            let position = DVec3::new(at(0), at(4), at(8));
            if !position.is_finite() {
                return Err(Error::malformed(format!("facet {f} (from 0) has a coordinate that is not a finite number"))
                    .at(format!("facet {f}")));
            }
            corners.push(position);
        }
    }
    Ok(corners)
}

fn ascii_corners(bytes: &[u8], scan: &mut Scan) -> Result<Vec<DVec3>> {
    let mut corners = Vec::new();
    let mut begin = 0;
    let mut odd_loops = 0;
    let mut lines = Lines::new(bytes);
    while let Some(line) = lines.next() {
        let place = || format!("line {}", lines.number());
        let mut words = Words::new(line);
        while let Some(word) = words.next() {
            match word.to_ascii_lowercase().as_slice() {
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
                    corners.push(position);
                }
                b"endloop" | b"endfacet" => {
                    if corners.len() - begin != 3 && corners.len() != begin {
                        corners.truncate(begin);
                        odd_loops += 1;
                    }
                    begin = corners.len();
                }
                b"solid" | b"endsolid" | b"facet" => break,
                b"outer" | b"loop" => {}
                _ => {
                    return Err(Error::malformed(format!("{} in an ascii STL file", quote(word)))
                        .expected("facet, vertex, endfacet …")
                        .at(place()));
                }
            }
        }
    }
    if corners.len() > begin {
        corners.truncate(begin);
        odd_loops += 1;
    }
    if odd_loops > 0 {
        scan.notes.warn(format!("{odd_loops} facets have not three vertices and are skipped"));
    }
    Ok(corners)
}

fn weld(corners: &[DVec3], scan: &mut Scan) -> Result<()> {
    if corners.is_empty() {
        return Err(super::nothing_to_animate(0, &[(0, "facets")]));
    }
    let first = first_equal(corners.len(), |i| corners[i].to_array().map(bits));
    let mut numbers = vec![NONE; corners.len()];
    let mut mesh = SurfaceMesh { positions: Vec::new(), faces: Faces::default() };
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
        }
    }
    if collapsed > 0 {
        scan.notes.warn(format!("{collapsed} facets with two equal vertices are dropped"));
    }
    if mesh.faces.is_empty() {
        return Err(super::nothing_to_animate(mesh.positions.len(), &[(collapsed, "facets without area")]));
    }
    scan.mesh = mesh;
    Ok(())
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    fn facet(corners: [[f64; 3]; 3]) -> String {
        let lines = corners.map(|[x, y, z]| format!(" vertex {x} {y} {z}\n")).concat();
        format!("facet normal 0 0 0\n outer loop\n{lines} endloop\nendfacet\n")
    }

    #[test]
    fn equal_corners_are_one_vertex_in_order_of_occurrence() {
        let (a, b, c, d) = ([0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [1.0, 1.0, 0.25]);
        let text =
            format!("solid two words\n{}{}{}endsolid\n", facet([a, b, c]), facet([[1.0, -0.0, 0.0], d, c]), facet([a, a, b]));
        let scan = read(text.as_bytes(), Path::new("a.stl")).unwrap();
        assert_eq!(scan.mesh.faces.corners, [0, 1, 2, 1, 3, 2]);
        assert_eq!(scan.mesh.positions[3], DVec3::new(1.0, 1.0, 0.25));
        assert_eq!(scan.notes.iter().collect::<Vec<_>>(), ["1 facets with two equal vertices are dropped"]);
    }

    #[test]
    fn flaws_name_their_place() {
        let text = format!("solid\n{}", facet([[0.0; 3], [1.0; 3], [f64::NAN, 0.0, 0.0]]));
        assert_eq!(read(text.as_bytes(), Path::new("a.stl")).unwrap_err().place.as_deref(), Some("line 6"));
        assert!(read(b"solid\nfacet\nvertx 0 0 0\n", Path::new("a.stl")).unwrap_err().found.contains("vertx"));
        assert!(read(b"", Path::new("a.stl")).is_err());
    }
}
