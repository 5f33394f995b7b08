//! Wavefront OBJ.

use super::beside::Beside;
use super::mtl::{Libraries, unquoted};
use super::remarks::Remarks;
use super::text::{Lines, Words, name, number, quote};
use super::{Group, Material, NONE, Scan};
use crate::equal::{bits, first_equal};
use crate::error::{Error, Result};
use glam::DVec3;
use std::collections::HashMap;
use std::path::Path;

/// Reads an OBJ file from its bytes; its material libraries lie `beside` it.
///
/// Vertices, n-gons, uv and normal indices, groups and materials keep the file's order. Lines and points are skipped with a note, as are
/// faces of fewer than three corners; faces that repeat a vertex are kept.
///
/// Errors: a coordinate that is not a finite number, a vertex index that does not exist, no faces.
pub(super) fn read(bytes: &[u8], path: &Path, beside: &Beside) -> Result<Scan> {
    if bytes[..bytes.len().min(4096)].contains(&0) {
        return Err(Error::malformed("not a text: it holds zero bytes").file(path).expected("an OBJ file"));
    }
    let mut reader = Reader::default();
    let mut lines = Lines::new(bytes);
    let mut joined = Vec::new();
    while let Some(mut line) = lines.next() {
        let number = lines.number();
        if line.trim_ascii_end().ends_with(b"\\") {
            joined.clear();
            loop {
                let trimmed = line.trim_ascii_end();
                joined.extend_from_slice(trimmed.strip_suffix(b"\\").unwrap_or(trimmed));
                joined.push(b' ');
                if !trimmed.ends_with(b"\\") {
                    break;
                }
                let Some(next) = lines.next() else { break };
                line = next;
            }
            line = &joined;
        }
        reader.line(line, number)?;
        if lines.at_unfinished_end() && reader.last_flaw == number {
            reader.cut_short = true;
        }
    }
    reader.finish(beside).map_err(|e| e.file(path))
}

#[derive(Default)]
struct Reader {
    scan: Scan,
    normals: Vec<[f32; 3]>,
    colored: usize,
    remarks: Remarks,
    /// Material and group that hold for the next face: their names, and their index once a face has used them.
    material: Option<String>,
    material_index: Option<u32>,
    materials: HashMap<String, u32>,
    group: Group,
    group_index: Option<u32>,
    groups: HashMap<Group, u32>,
    /// Vertex indices beyond the vertices read so far, with their lines: they may be defined later.
    forward: Vec<(u32, usize)>,
    flaws: Flaws,
    last_flaw: usize,
    cut_short: bool,
    counts: Counts,
    unknown: Vec<String>,
}

/// Lines that make the file unusable. All are looked for, since a user mends them all at once.
#[derive(Default)]
struct Flaws {
    first: Option<(usize, Error)>,
    lines: Vec<usize>,
}

#[derive(Default)]
struct Counts {
    lines: usize,
    points: usize,
    short_faces: Vec<usize>,
    repeating_faces: usize,
    weighted: usize,
    bad_uvs: usize,
    lost_uvs: usize,
    lost_normals: usize,
    free_form: usize,
    unknown: usize,
}

impl Reader {
    fn line(&mut self, line: &[u8], at: usize) -> Result<()> {
        let mut words = Words::new(line);
        let Some(keyword) = words.next() else { return Ok(()) };
        match keyword {
            b"v" => self.vertex(words, at),
            b"f" | b"fo" => self.face(words, at)?,
            b"vt" => self.uv(words),
            b"vn" => {
                let mut n = [0.0; 3];
                n.iter_mut().zip(words).for_each(|(n, w)| *n = number(w).unwrap_or(0.0) as f32);
                self.normals.push(n);
            }
            b"usemtl" => {
                self.material = Some(name(unquoted(words.rest()))).filter(|n| !n.is_empty());
                self.material_index = None;
            }
            b"mtllib" => self.scan.look.material_libraries.push(name(words.rest())),
            b"o" => {
                self.group.object = some_name(words.rest());
                self.group_index = None;
            }
            b"g" => {
                self.group.group = some_name(words.rest());
                self.group_index = None;
            }
            b"l" => self.counts.lines += 1,
            b"p" => self.counts.points += 1,
            b"s" | b"usemap" | b"maplib" | b"lod" | b"mg" | b"bevel" | b"c_interp" | b"d_interp" | b"shadow_obj"
            | b"trace_obj" => {}
            b"vp" | b"cstype" | b"deg" | b"curv" | b"curv2" | b"surf" | b"parm" | b"trim" | b"hole" | b"scrv" | b"sp"
            | b"end" | b"bmat" | b"step" | b"con" | b"ctech" | b"stech" => self.counts.free_form += 1,
            _ if keyword[0] == b'#' => self.remarks.add(&line.trim_ascii()[1..]),
            _ => {
                self.counts.unknown += 1;
                let word = quote(keyword);
                if self.unknown.len() < 3 && !self.unknown.contains(&word) {
                    self.unknown.push(word);
                }
            }
        }
        Ok(())
    }

    fn flaw(&mut self, at: usize, error: impl FnOnce() -> Error) {
        self.last_flaw = at;
        if self.flaws.first.as_ref().is_none_or(|(line, _)| at < *line) {
            self.flaws.first = Some((at, error()));
        }
        self.flaws.lines.push(at);
    }

    /// `v x y z [w]`, `v x y z r g b [a]`.
    fn vertex(&mut self, words: Words<'_>, at: usize) {
        let mut values = [0.0; 7];
        let mut count = 0;
        for word in words.take_while(|w| w[0] != b'#').take(7) {
            match number(word) {
                Some(value) if value.is_finite() => values[count] = value,
                _ => {
                    let vertex = self.scan.mesh.positions.len() + 1;
                    self.flaw(at, || {
                        Error::malformed(format!("vertex {vertex}: {} is not a finite number", quote(word)))
                            .expected("decimal coordinates")
                    });
                    break;
                }
            }
            count += 1;
        }
        if count < 3 && self.last_flaw != at {
            let vertex = self.scan.mesh.positions.len() + 1;
            self.flaw(at, || Error::malformed(format!("vertex {vertex} has {count} coordinates")).expected("3 coordinates"));
        }
        if (4..6).contains(&count) && values[3] != 1.0 {
            self.counts.weighted += 1;
        }
        let colors = &mut self.scan.look.colors;
        if count >= 6 {
            colors.resize(self.scan.mesh.positions.len(), [1.0; 4]);
            let alpha = if count == 7 { values[6] as f32 } else { 1.0 };
            self.scan.look.colors_have_alpha |= count == 7;
            colors.push([values[3] as f32, values[4] as f32, values[5] as f32, alpha]);
            self.colored += 1;
        }
        self.scan.mesh.positions.push(DVec3::new(values[0], values[1], values[2]));
    }

    /// `vt u [v [w]]`. Exporters write NaN here for faces without extent in the texture.
    fn uv(&mut self, words: Words<'_>) {
        let mut uv = [0.0f32; 2];
        for (value, word) in uv.iter_mut().zip(words.take_while(|w| w[0] != b'#')) {
            *value = number(word).unwrap_or(f64::NAN) as f32;
        }
        if !uv.iter().all(|x| x.is_finite()) {
            self.counts.bad_uvs += 1;
            uv = [0.0; 2];
        }
        self.scan.look.uvs.push(uv);
    }

    fn face(&mut self, words: Words<'_>, at: usize) -> Result<()> {
        let vertices = self.scan.mesh.positions.len();
        let begin = self.scan.mesh.faces.corners.len();
        let mut flawed = false;
        for word in words.take_while(|w| w[0] != b'#') {
            let index = corner(word);
            let vertex = index.and_then(|c| absolute(c[0], vertices));
            let Some(vertex) = vertex else {
                self.flaw(at, || match index {
                    Some([0, ..]) => Error::malformed("a face with vertex index 0").expected("indices from 1, or negative ones"),
                    Some([v, ..]) => {
                        Error::malformed(format!("a face with vertex index {v} where there are {vertices} vertices"))
                    }
                    None => {
                        Error::malformed(format!("a face with {}", quote(word))).expected("corners as v, v/vt, v//vn or v/vt/vn")
                    }
                });
                flawed = true;
                break;
            };
            let [_, uv, normal] = index.unwrap_or_default();
            if vertex as usize >= vertices {
                self.forward.push((vertex, at));
            }
            let corners = &mut self.scan.mesh.faces.corners;
            let look = &mut self.scan.look;
            push_index(&mut look.corner_uvs, corners.len(), uv, look.uvs.len(), &mut self.counts.lost_uvs);
            push_index(&mut look.corner_normals, corners.len(), normal, self.normals.len(), &mut self.counts.lost_normals);
            corners.push(vertex);
        }
        let corners = &mut self.scan.mesh.faces.corners;
        if flawed || corners.len() - begin < 3 {
            if !flawed {
                self.counts.short_faces.push(at);
                self.last_flaw = at;
            }
            corners.truncate(begin);
            self.scan.look.corner_uvs.truncate(begin);
            self.scan.look.corner_normals.truncate(begin);
            return Ok(());
        }
        if corners.len() >= NONE as usize {
            return Err(Error::malformed("more face corners than 32 bits can number").at(format!("line {at}")));
        }
        let face = &corners[begin..];
        if face.len() <= 8 && (1..face.len()).any(|i| face[..i].contains(&face[i])) {
            self.counts.repeating_faces += 1;
        }
        let end = corners.len() as u32;
        self.face_looks();
        self.scan.mesh.faces.starts.push(end);
        Ok(())
    }

    /// Material and group of the face that is about to be added.
    fn face_looks(&mut self) {
        let faces = self.scan.mesh.faces.len();
        let look = &mut self.scan.look;
        if self.material.is_some() || !look.face_materials.is_empty() {
            let index = *self.material_index.get_or_insert_with(|| match &self.material {
                None => NONE,
                Some(material) => *self.materials.entry(material.clone()).or_insert_with(|| {
                    look.materials.push(Material { name: material.clone(), ..Material::default() });
                    look.materials.len() as u32 - 1
                }),
            });
            look.face_materials.resize(faces, NONE);
            look.face_materials.push(index);
        }
        if self.group != Group::default() || !look.face_groups.is_empty() {
            let index = *self.group_index.get_or_insert_with(|| {
                if self.group == Group::default() {
                    return NONE;
                }
                *self.groups.entry(self.group.clone()).or_insert_with(|| {
                    look.groups.push(self.group.clone());
                    look.groups.len() as u32 - 1
                })
            });
            look.face_groups.resize(faces, NONE);
            look.face_groups.push(index);
        }
    }

    fn finish(mut self, beside: &Beside) -> Result<Scan> {
        let vertices = self.scan.mesh.positions.len();
        for (vertex, at) in std::mem::take(&mut self.forward) {
            if vertex as usize >= vertices && self.flaws.lines.last() != Some(&at) {
                self.flaw(at, || {
                    Error::malformed(format!("a face with vertex index {} of {vertices} vertices", u64::from(vertex) + 1))
                });
            }
        }
        if let Some((_, error)) = self.flaws.first {
            let error = if self.cut_short { error.hint("the file seems to be cut short: copy it again") } else { error };
            return Err(error.at(line_list(&mut self.flaws.lines)));
        }
        if vertices == 0 {
            return Err(Error::malformed("no vertices").expected("an OBJ file with lines 'v x y z' and 'f i j k'"));
        }
        self.add_notes();
        let scan = &mut self.scan;
        if scan.mesh.faces.is_empty() {
            return Err(super::nothing_to_animate(
                vertices,
                &[(self.counts.lines, "line elements"), (self.counts.points, "point elements")],
            ));
        }
        finish_uvs(scan);
        scan.look.corner_normals = canonical(&scan.look.corner_normals, &self.normals);
        let scale_notes = super::settle_colors(&mut scan.look);
        scale_notes.into_iter().for_each(|note| scan.notes.warn(note));
        scan.space = self.remarks.space(&mut scan.notes);
        let libraries = std::mem::take(&mut scan.look.material_libraries);
        let found = Libraries::load(beside, &libraries, &mut scan.notes);
        found.fill(&mut scan.look.materials, !libraries.is_empty(), &mut scan.notes);
        // What lies in an archive cannot be named from outside.
        scan.look.material_libraries = if beside.is_archive() { Vec::new() } else { found.names };
        Ok(self.scan)
    }

    fn add_notes(&mut self) {
        let Counts { lines, points, weighted, bad_uvs, repeating_faces, free_form, unknown, .. } = self.counts;
        let vertices = self.scan.mesh.positions.len();
        let notes = &mut self.scan.notes;
        let mut note = |count: usize, text: &str| {
            if count > 0 {
                notes.warn(format!("{text}: {count}"));
            }
        };
        note(lines, "line elements (l) skipped");
        note(points, "point elements (p) skipped");
        note(free_form, "statements of curves and free-form surfaces skipped");
        note(weighted, "vertices with a weight w, which is ignored");
        note(bad_uvs, "texture coordinates that are not finite numbers, taken as 0 0");
        note(repeating_faces, "faces that name a vertex twice, kept");
        let count_lost = |lost: usize, indices: &mut Vec<u32>, size: usize| {
            let beyond = indices.iter_mut().filter(|i| **i != NONE && **i as usize >= size);
            lost + beyond.map(|i| *i = NONE).count()
        };
        let look = &mut self.scan.look;
        note(
            count_lost(self.counts.lost_uvs, &mut look.corner_uvs, look.uvs.len()),
            "corners with texture coordinates that do not exist, left without",
        );
        note(
            count_lost(self.counts.lost_normals, &mut look.corner_normals, self.normals.len()),
            "corners with normals that do not exist, left without",
        );
        if self.colored > 0 && self.colored < vertices {
            note(vertices - self.colored, "vertices without colour where others have one, taken as white");
            look.colors.resize(vertices, [1.0; 4]);
        }
        if unknown > 0 {
            notes.warn(format!("lines with unknown keywords skipped: {unknown} ({})", self.unknown.join(", ")));
        }
        if !self.counts.short_faces.is_empty() {
            let count = self.counts.short_faces.len();
            let text = format!("faces with fewer than 3 corners skipped: {count} ({})", line_list(&mut self.counts.short_faces));
            notes.warn(if self.cut_short { text + ": the file seems to be cut short" } else { text });
        }
    }
}

/// Appends a uv or normal index for the corner number `corner`; arrays stay empty until the first corner has one.
fn push_index(indices: &mut Vec<u32>, corner: usize, raw: i64, count: usize, lost: &mut usize) {
    if raw == 0 && indices.is_empty() {
        return;
    }
    let index = absolute(raw, count);
    *lost += usize::from(raw != 0 && index.is_none());
    indices.resize(corner, NONE);
    indices.push(index.unwrap_or(NONE));
}

/// `v`, `v/vt`, `v//vn`, `v/vt/vn`, with empty parts as 0; `None` if a part is no integer or too large.
fn corner(word: &[u8]) -> Option<[i64; 3]> {
    let mut parts = [0i64; 3];
    let mut part = 0;
    let mut at = 0;
    while at < word.len() {
        if word[at] == b'/' {
            part += 1;
            at += 1;
            if part == 3 {
                return None;
            }
            continue;
        }
        let negative = word[at] == b'-';
        at += usize::from(negative || word[at] == b'+');
        let first = at;
        let mut value = 0i64;
        while at < word.len() && word[at].is_ascii_digit() {
            value = value * 10 + i64::from(word[at] - b'0');
            at += 1;
            if value > i64::from(u32::MAX) {
                return None;
            }
        }
        if at == first || (at < word.len() && word[at] != b'/') {
            return None;
        }
        parts[part] = if negative { -value } else { value };
    }
    Some(parts)
}

/// A 1-based or relative index as a 0-based one.
fn absolute(raw: i64, count: usize) -> Option<u32> {
    let index = if raw < 0 { count as i64 + raw } else { raw - 1 };
    u32::try_from(index).ok().filter(|&i| i != NONE)
}

/// Drops uv arrays that no corner uses, and makes equal coordinates one.
fn finish_uvs(scan: &mut Scan) {
    let look = &mut scan.look;
    if look.corner_uvs.iter().all(|&i| i == NONE) {
        look.corner_uvs.clear();
        look.uvs.clear();
    }
    look.corner_uvs = canonical(&look.corner_uvs, &look.uvs);
}

/// Points every index at the first of equal values: many exporters write one normal and one uv per corner, which would part the surface
/// at every edge. An array without any index becomes empty.
fn canonical<const N: usize>(indices: &[u32], values: &[[f32; N]]) -> Vec<u32> {
    if indices.iter().all(|&i| i == NONE) {
        return Vec::new();
    }
    let first = first_equal(values.len(), |i| values[i].map(|x| bits(f64::from(x))));
    indices.iter().map(|&i| if i == NONE { NONE } else { first[i as usize] }).collect()
}

/// `line 3`, `lines 3, 4 and 9`, `lines 3, 4, 5, 6, 7 and 12 more`.
fn line_list(lines: &mut Vec<usize>) -> String {
    lines.sort_unstable();
    lines.dedup();
    let shown: Vec<String> = lines.iter().take(5).map(usize::to_string).collect();
    match (lines.len(), shown.split_last()) {
        (1, _) => format!("line {}", lines[0]),
        (n, _) if n > 5 => format!("lines {} and {} more", shown.join(", "), n - 5),
        (_, Some((last, others))) => format!("lines {} and {last}", others.join(", ")),
        _ => String::new(),
    }
}

fn some_name(bytes: &[u8]) -> Option<String> {
    Some(name(bytes)).filter(|n| !n.is_empty())
}

/// Compares positions, faces and uv with what `tobj` reads from the same text. It starts a model at every group and material, each with
/// its own arrays, so the comparison is corner by corner.
#[cfg(test)]
pub(super) fn compare_with_tobj(scan: &Scan, bytes: &[u8]) {
    let options = tobj::LoadOptions::default();
    let (models, _) = tobj::load_obj_buf(&mut &*bytes, &options, |_| Ok(Default::default())).expect("well-formed");
    let mut corner = 0;
    let mut face = 0;
    for tobj::Mesh { positions, texcoords, indices, texcoord_indices, face_arities, .. } in models.iter().map(|m| &m.mesh) {
        let arities: Vec<usize> =
            if face_arities.is_empty() { vec![3; indices.len() / 3] } else { face_arities.iter().map(|&n| n as usize).collect() };
        for n in arities {
            assert_eq!(scan.mesh.faces.face(face).len(), n);
            face += 1;
        }
        for (k, &index) in indices.iter().enumerate() {
            let ours = scan.mesh.positions[scan.mesh.faces.corners[corner] as usize].as_vec3().to_array();
            assert_eq!(ours, positions[3 * index as usize..][..3], "corner {corner}");
            if let Some(&uv) = texcoord_indices.get(k) {
                let ours = scan.look.uvs[scan.look.corner_uvs[corner] as usize];
                assert_eq!(ours, texcoords[2 * uv as usize..][..2]);
            }
            corner += 1;
        }
    }
    assert_eq!((corner, face), (scan.mesh.faces.corners.len(), scan.mesh.faces.len()));
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    fn parse(text: &str) -> Scan {
        read(text.as_bytes(), Path::new("a.obj"), &Beside::Nothing).unwrap()
    }

    #[test]
    fn a_well_formed_file_reads_as_tobj_reads_it() {
        let mut text = String::new();
        for k in 0..40 {
            text += &format!("v {} {:.6} {}e-1\n", k % 8, f64::from(k).cos(), k);
            text += &format!("vt {} {:.3}\nvn 0 0 {}\n", f64::from(k) / 40.0, f64::from(k).sin(), k % 3);
        }
        for k in (0..32).filter(|k| k % 8 < 7) {
            text += if k % 5 == 0 { "g part\n" } else { "" };
            let corner = |v: i32| format!("{0}/{0}/{0}", v + k + 1);
            text += &format!("f {} {} {} {}\n", corner(0), corner(1), corner(9), corner(8));
        }
        text += "g rest\nf 1/2/3 2/3/4 -1/-1/-1\n";
        compare_with_tobj(&parse(&text), text.as_bytes());
    }

    #[test]
    fn corners_may_have_any_of_uv_and_normal() {
        let scan = parse(
            "v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 1\nvt 1 0.5\nvn 0 0 1\nvn 1 0 0\nf 1 2 3\nf 1/2 2/1 3/2\nf 1//1 2//2 -1//-1\n",
        );
        assert_eq!(scan.look.corner_uvs, [NONE, NONE, NONE, 1, 0, 1, NONE, NONE, NONE]);
        assert_eq!(scan.look.corner_normals, [NONE, NONE, NONE, NONE, NONE, NONE, 0, 1, 1]);
    }

    #[test]
    fn equal_normals_and_uvs_are_one() {
        let text = "v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 1\nvt 1 1\nvt 0 1\nvn 0 0 1\nvn 0 -0 1\nvn 1 0 0\nf 1/1/1 2/2/2 3/3/3\n";
        let look = parse(text).look;
        assert_eq!((look.corner_uvs, look.corner_normals), (vec![0, 1, 0], vec![0, 0, 2]));
    }

    #[test]
    fn groups_objects_and_materials_follow_their_first_use() {
        let text = "v 0 0 0\nv 1 0 0\nv 0 1 0\ng unused\nf 1 2 3\no a b\ng x y\nusemtl two\nf 1 2 3\nusemtl one\ng x y\nf 1 2 3\n\
                    o c\nf 1 2 3\nusemtl two\no a b\ng x y\nf 1 2 3\n";
        let look = parse(text).look;
        assert_eq!(look.face_materials, [NONE, 0, 1, 1, 0]);
        assert_eq!(look.materials.iter().map(|m| m.name.as_str()).collect::<Vec<_>>(), ["two", "one"]);
        assert_eq!(look.face_groups, [0, 1, 1, 2, 1]);
        assert_eq!(look.groups[1], Group { object: Some("a b".into()), group: Some("x y".into()) });
        assert_eq!(look.groups[2], Group { object: Some("c".into()), group: Some("x y".into()) });
    }

    #[test]
    fn colours_on_some_vertices_only() {
        let scan = parse("v 0 0 0\nv 1 0 0 0 0.5 1\nv 0 1 0\nf 1 2 3\n");
        assert_eq!(scan.look.colors, [[1.0; 4], [0.0, 0.5, 1.0, 1.0], [1.0; 4]]);
        assert!(scan.notes.iter().any(|n| n.contains("taken as white: 2")));
        let scan = parse("v 0 0 0 255 0 0\nv 1 0 0 0 51 0\nv 0 1 0 0 0 0\nf 1 2 3\n");
        assert_eq!(scan.look.colors[1], [0.0, 0.2, 0.0, 1.0]);
    }

    #[test]
    fn faces_may_come_before_their_vertices() {
        assert_eq!(parse("f 1 2 3\nv 0 0 0\nv 1 0 0\nv 0 1 0\n").mesh.faces.face(0), [0, 1, 2]);
        let error = read(b"f 1 2 4\nv 0 0 0\nv 1 0 0\nv 0 1 0\n", Path::new("a.obj"), &Beside::Nothing).unwrap_err();
        assert_eq!((error.found.as_str(), error.place.as_deref()), ("a face with vertex index 4 of 3 vertices", Some("line 1")));
    }

    #[test]
    fn vertices_cut_short_are_an_error_with_a_hint() {
        let error = read(b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\nv 1 2", Path::new("a.obj"), &Beside::Nothing).unwrap_err();
        assert_eq!(error.place.as_deref(), Some("line 5"));
        assert!(error.hint.unwrap().contains("cut short"));
    }

    #[test]
    fn missing_uvs_and_normals_are_left_out_with_a_note() {
        let scan = parse("v 0 0 0\nv 1 0 0\nv 0 1 0\nvt nan 0\nf 1/1/1 2/9/2 3/1/3\n");
        assert_eq!((scan.look.corner_uvs, scan.look.uvs), (vec![0, NONE, 0], vec![[0.0; 2]]));
        assert!(scan.look.corner_normals.is_empty());
        assert_eq!(scan.notes.iter().count(), 3);
    }
}
