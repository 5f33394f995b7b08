//! Stanford PLY: ascii and binary, with the properties that scanners and modellers add.

mod header;
mod values;

use super::beside::Beside;
use super::remarks::Remarks;
use super::text::name;
use super::{Material, NONE, Scan};
use crate::equal::{bits, first_equal};
use crate::error::{Error, Result};
use glam::DVec3;
use header::{Element, Header};
use std::path::Path;
use values::Values;

/// Whether the first line is `ply`.
pub(super) fn is_ply(bytes: &[u8]) -> bool {
    bytes.starts_with(b"ply") && bytes.get(3).is_some_and(|b| b.is_ascii_whitespace())
}

/// Reads a PLY file from its bytes; its textures lie `beside` it.
///
/// Read are the elements `vertex` (position, colour, uv), `face` (n-gons, uv per corner, texture number) and `tristrips`; other elements
/// and properties are passed over. Faces of fewer than three corners are skipped with a note.
///
/// Errors: what the header announces is not there, an index that does not exist, a coordinate that is not finite, no faces.
pub(super) fn read(bytes: &[u8], path: &Path, beside: &Beside) -> Result<Scan> {
    parse(bytes, beside).map_err(|e| e.file(path))
}

fn parse(bytes: &[u8], beside: &Beside) -> Result<Scan> {
    let (header, body) = header::parse(bytes)?;
    let mut values = Values::new(&header, body, bytes.len() - body.len());
    let mut body = Body::default();
    for element in header.elements.iter().filter(|e| !e.properties.is_empty()) {
        values.begin(element)?;
        match element.name.as_str() {
            "vertex" => body.vertices(element, &mut values)?,
            "face" => body.faces(element, &mut values)?,
            "tristrips" => body.strips(element, &mut values)?,
            _ if values.skip_rows(element) => {}
            _ => {
                let mut scratch = Vec::new();
                for _ in 0..element.count {
                    values.begin_row()?;
                    element.properties.iter().try_for_each(|p| values.skip(p, &mut scratch))?;
                    values.end_row(false)?;
                }
            }
        }
    }
    if values.surplus > 0 {
        body.scan.notes.warn(format!("rows with more values than the header announces, which are ignored: {}", values.surplus));
    }
    body.finish(&header, beside)
}

#[derive(Default)]
struct Body {
    scan: Scan,
    seen_vertices: bool,
    vertex_uvs: bool,
    /// uv of every corner, where faces have their own.
    corner_uvs: Vec<[f32; 2]>,
    texture_numbers: Vec<u32>,
    short_faces: usize,
    odd_uv_lists: usize,
    face_colors: bool,
}

/// What a column of the vertex table means.
#[derive(Clone, Copy)]
enum Column {
    Position(usize),
    /// Channel, and the value of full colour.
    Color(usize, f64),
    Uv(usize),
    Other,
}

fn columns(element: &Element) -> Vec<Column> {
    let has = |name: &str| element.properties.iter().any(|p| p.name == name && p.list.is_none());
    let plain_color = has("red") && has("green") && has("blue");
    let diffuse_color = !plain_color && has("diffuse_red") && has("diffuse_green") && has("diffuse_blue");
    let short_color = !plain_color && !diffuse_color && has("r") && has("g") && has("b");
    let pairs = [("s", "t"), ("u", "v"), ("texture_u", "texture_v"), ("texture_s", "texture_t")];
    let uv = pairs.into_iter().find(|(u, v)| has(u) && has(v));
    let meaning = |p: &header::Property| {
        let full = p.kind.full_color();
        match p.name.as_str() {
            _ if p.list.is_some() => Column::Other,
            "x" => Column::Position(0),
            "y" => Column::Position(1),
            "z" => Column::Position(2),
            "red" if plain_color => Column::Color(0, full),
            "green" if plain_color => Column::Color(1, full),
            "blue" if plain_color => Column::Color(2, full),
            "alpha" if plain_color => Column::Color(3, full),
            "diffuse_red" if diffuse_color => Column::Color(0, full),
            "diffuse_green" if diffuse_color => Column::Color(1, full),
            "diffuse_blue" if diffuse_color => Column::Color(2, full),
            "diffuse_alpha" | "alpha" if diffuse_color => Column::Color(3, full),
            "r" if short_color => Column::Color(0, full),
            "g" if short_color => Column::Color(1, full),
            "b" if short_color => Column::Color(2, full),
            "a" if short_color => Column::Color(3, full),
            other => match uv {
                Some((u, _)) if u == other => Column::Uv(0),
                Some((_, v)) if v == other => Column::Uv(1),
                _ => Column::Other,
            },
        }
    };
    element.properties.iter().map(meaning).collect()
}

impl Body {
    fn vertices(&mut self, element: &Element, values: &mut Values<'_>) -> Result<()> {
        if std::mem::replace(&mut self.seen_vertices, true) {
            return Err(Error::malformed("two elements 'vertex'").expected("one"));
        }
        let columns = columns(element);
        let has = |test: fn(&Column) -> bool| columns.iter().filter(|c| test(c)).count();
        if has(|c| matches!(c, Column::Position(_))) != 3 {
            return Err(Error::malformed("the element 'vertex' lacks x, y or z").expected("the properties x, y and z"));
        }
        let colored = has(|c| matches!(c, Column::Color(..))) > 0;
        self.vertex_uvs = has(|c| matches!(c, Column::Uv(_))) == 2;
        self.scan.look.colors_have_alpha = has(|c| matches!(c, Column::Color(3, _))) > 0;
        let mut bad = Vec::new();
        let mut scratch = Vec::new();
        for row in 0..element.count {
            values.begin_row()?;
            let (mut position, mut color, mut uv) = (DVec3::ZERO, [1.0f32; 4], [0.0f32; 2]);
            for (property, column) in element.properties.iter().zip(&columns) {
                match *column {
                    Column::Position(axis) => position[axis] = values.value(property.kind)?,
                    Column::Color(channel, full) => color[channel] = (values.value(property.kind)? / full) as f32,
                    Column::Uv(axis) => uv[axis] = values.value(property.kind)? as f32,
                    Column::Other => values.skip(property, &mut scratch)?,
                }
            }
            values.end_row(true)?;
            if !position.is_finite() {
                bad.push(row);
            }
            self.scan.mesh.positions.push(position);
            if colored {
                self.scan.look.colors.push(color);
            }
            if self.vertex_uvs {
                self.scan.look.uvs.push(uv.map(|x| if x.is_finite() { x } else { 0.0 }));
            }
        }
        if let Some(first) = bad.first() {
            let found = format!(
                "{} vertices have coordinates that are not finite numbers, the first is vertex {first} (from 0)",
                bad.len()
            );
            return Err(Error::malformed(found)
                .at(format!("vertex {first}"))
                .expected("finite coordinates")
                .hint("remove these vertices"));
        }
        Ok(())
    }

    fn faces(&mut self, element: &Element, values: &mut Values<'_>) -> Result<()> {
        let names = |p: &header::Property| (p.name.clone(), p.list.is_some());
        let is_indices = |p: &header::Property| matches!(names(p), (ref n, true) if n == "vertex_indices" || n == "vertex_index");
        if element.count > 0 && !element.properties.iter().any(is_indices) {
            return Err(
                Error::malformed("the element 'face' has no list of vertices").expected("property list uchar int vertex_indices")
            );
        }
        self.face_colors = element.properties.iter().any(|p| p.name == "red");
        let (mut indices, mut uvs, mut scratch) = (Vec::new(), Vec::new(), Vec::new());
        for _ in 0..element.count {
            values.begin_row()?;
            uvs.clear();
            let mut texture = NONE;
            for property in &element.properties {
                match (property.name.as_str(), property.list) {
                    ("vertex_indices" | "vertex_index", Some(length)) => values.list(length, property.kind, &mut indices)?,
                    ("texcoord" | "texcoords", Some(length)) => values.list(length, property.kind, &mut uvs)?,
                    ("texnumber", None) => texture = values.value(property.kind)?.max(0.0) as u32,
                    _ => values.skip(property, &mut scratch)?,
                }
            }
            values.end_row(false)?;
            if indices.len() < 3 {
                self.short_faces += 1;
                continue;
            }
            for &index in &indices {
                self.scan.mesh.faces.corners.push(vertex_index(index, values)?);
            }
            self.end_face(values)?;
            self.texture_numbers.push(texture);
            if !uvs.is_empty() || !self.corner_uvs.is_empty() {
                self.face_uvs(&uvs, indices.len());
            }
        }
        Ok(())
    }

    fn end_face(&mut self, values: &Values<'_>) -> Result<()> {
        let faces = &mut self.scan.mesh.faces;
        if faces.corners.len() >= NONE as usize {
            return Err(values.flaw("more face corners than 32 bits can number"));
        }
        faces.starts.push(faces.corners.len() as u32);
        Ok(())
    }

    fn face_uvs(&mut self, uvs: &[f64], corners: usize) {
        let before = self.scan.mesh.faces.corners.len() - corners;
        self.corner_uvs.resize(before, [f32::NAN; 2]);
        if uvs.len() == 2 * corners {
            self.corner_uvs.extend(uvs.chunks_exact(2).map(|uv| [uv[0] as f32, uv[1] as f32]));
        } else {
            self.odd_uv_lists += usize::from(!uvs.is_empty());
            self.corner_uvs.resize(before + corners, [f32::NAN; 2]);
        }
    }

    /// Strips of triangles, parted by −1; every second triangle of a strip is turned, and repeated vertices only move the strip on.
    fn strips(&mut self, element: &Element, values: &mut Values<'_>) -> Result<()> {
        let mut indices = Vec::new();
        for _ in 0..element.count {
            values.begin_row()?;
            for property in &element.properties {
                match (property.name.as_str(), property.list) {
                    ("vertex_indices" | "vertex_index", Some(length)) => values.list(length, property.kind, &mut indices)?,
                    _ => values.skip(property, &mut Vec::new())?,
                }
            }
            values.end_row(false)?;
            for strip in indices.split(|&i| i == -1.0) {
                for (k, triangle) in strip.windows(3).enumerate() {
                    let [a, b, c] = [
                        vertex_index(triangle[0], values)?,
                        vertex_index(triangle[1], values)?,
                        vertex_index(triangle[2], values)?,
                    ];
                    if a != b && b != c && c != a {
                        self.scan.mesh.faces.corners.extend(if k % 2 == 0 { [a, b, c] } else { [b, a, c] });
                        self.end_face(values)?;
                    }
                }
            }
        }
        Ok(())
    }

    fn finish(mut self, header: &Header, beside: &Beside) -> Result<Scan> {
        let vertices = self.scan.mesh.positions.len();
        if vertices == 0 {
            return Err(Error::malformed("no vertices").expected("a PLY file with the elements 'vertex' and 'face'"));
        }
        if let Some(bad) = self.scan.mesh.faces.corners.iter().position(|&v| v as usize >= vertices) {
            let face = self.scan.mesh.faces.starts.partition_point(|&s| s as usize <= bad) - 1;
            let index = self.scan.mesh.faces.corners[bad];
            let found = format!("face {face} (from 0) has vertex index {index} where there are {vertices} vertices");
            return Err(Error::malformed(found).at(format!("face {face}")));
        }
        let mut note = |count: usize, text: &str| {
            if count > 0 {
                self.scan.notes.warn(format!("{text}: {count}"));
            }
        };
        note(self.short_faces, "faces with fewer than 3 corners skipped");
        note(self.odd_uv_lists, "faces whose list of texture coordinates has the wrong length, left without");
        if self.face_colors {
            self.scan.notes.warn("colours per face are not read");
        }
        if self.scan.mesh.faces.is_empty() {
            let edges = header.elements.iter().find(|e| e.name == "edge").map_or(0, |e| e.count as usize);
            return Err(super::nothing_to_animate(vertices, &[(edges, "edges")]));
        }
        self.uvs();
        self.textures(header, beside);
        let scan = &mut self.scan;
        super::settle_colors(&mut scan.look).into_iter().for_each(|note| scan.notes.warn(note));
        let mut remarks = Remarks::default();
        header.comments.iter().for_each(|c| remarks.add(c));
        scan.space = remarks.space(&mut scan.notes);
        Ok(self.scan)
    }

    fn uvs(&mut self) {
        let Scan { mesh, look, .. } = &mut self.scan;
        if !self.corner_uvs.is_empty() {
            self.corner_uvs.resize(mesh.faces.corners.len(), [f32::NAN; 2]);
            let corners = &self.corner_uvs;
            let first = first_equal(corners.len(), |i| corners[i].map(|x| bits(f64::from(x))));
            let mut number = vec![NONE; corners.len()];
            look.uvs.clear();
            for (corner, &first) in first.iter().enumerate() {
                if first as usize == corner && corners[corner].iter().all(|x| x.is_finite()) {
                    number[corner] = look.uvs.len() as u32;
                    look.uvs.push(corners[corner]);
                }
            }
            look.corner_uvs = first.iter().map(|&f| number[f as usize]).collect();
        } else if self.vertex_uvs {
            look.corner_uvs = mesh.faces.corners.clone();
        }
    }

    /// `comment TextureFile x.png`, as MeshLab and photogrammetry programs write it.
    fn textures(&mut self, header: &Header, beside: &Beside) {
        let look = &mut self.scan.look;
        for file in header.comments.iter().filter_map(|c| c.strip_prefix(b"TextureFile")).map(name) {
            let stem = Path::new(&file).file_stem().map(|s| s.to_string_lossy().into_owned()).unwrap_or_default();
            let found = beside.image(&file);
            if found.is_none() {
                self.scan.notes.warn(format!("texture '{file}' is missing"));
            }
            look.materials.push(Material { name: stem, base_color_texture: found, ..Material::default() });
        }
        if look.materials.is_empty() {
            return;
        }
        self.texture_numbers.resize(self.scan.mesh.faces.len(), NONE);
        let (only, count) = (look.materials.len() == 1, look.materials.len() as u32);
        let number = |&n: &u32| {
            if n < count {
                n
            } else if only || n == NONE {
                0
            } else {
                NONE
            }
        };
        look.face_materials = self.texture_numbers.iter().map(number).collect();
    }
}

fn vertex_index(value: f64, values: &Values<'_>) -> Result<u32> {
    if value >= 0.0 && value < f64::from(NONE) && value.fract() == 0.0 {
        Ok(value as u32)
    } else {
        Err(values.flaw(format!("a face with vertex index {value}")).expected("whole numbers from 0"))
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    fn parse_text(text: &str) -> Result<Scan> {
        read(text.as_bytes(), Path::new("a.ply"), &Beside::Nothing)
    }

    const TRIANGLE: &str = "0 0 0\n1 0 0\n0 1 0\n";

    fn with_face(vertex: &str, rows: &str, face: &str) -> Result<Scan> {
        let head =
            format!("ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n{vertex}");
        parse_text(&format!("{head}element face 1\nproperty list uchar int vertex_indices\nend_header\n{rows}{face}"))
    }

    #[test]
    fn colours_of_any_type_become_fractions() {
        let of = |kind: &str, prefix: &str, values: &str| {
            let properties: String = ["red", "green", "blue"].map(|c| format!("property {kind} {prefix}{c}\n")).concat();
            let rows: String = ["0 0 0", "1 0 0", "0 1 0"].map(|p| format!("{p} {values}\n")).concat();
            with_face(&properties, &rows, "3 0 1 2\n").unwrap().look.colors[2]
        };
        assert_eq!(of("uchar", "", "255 51 0"), [1.0, 0.2, 0.0, 1.0]);
        assert_eq!(of("ushort", "diffuse_", "65535 13107 0"), [1.0, 0.2, 0.0, 1.0]);
        assert_eq!(of("float", "", "1 0.2 0"), [1.0, 0.2, 0.0, 1.0]);
    }

    #[test]
    fn vertex_uvs_belong_to_all_corners() {
        let scan = with_face("property float s\nproperty float t\n", "0 0 0 0 0\n1 0 0 1 0\n0 1 0 0 0.5\n", "3 2 0 1\n").unwrap();
        assert_eq!((scan.look.corner_uvs, scan.look.uvs[2]), (vec![2, 0, 1], [0.0, 0.5]));
    }

    #[test]
    fn corner_uvs_and_textures() {
        let dir = tempfile::tempdir().unwrap();
        std::fs::write(dir.path().join("skin two.png"), b"").unwrap();
        let text = format!(
            "ply\nformat ascii 1.0\ncomment TextureFile gone.png\ncomment TextureFile skin two.png\nelement vertex 3\nproperty float x\n\
             property float y\nproperty float z\nelement face 2\nproperty list uchar int vertex_index\nproperty list uchar float texcoord\n\
             property int texnumber\nend_header\n{TRIANGLE}3 0 1 2 6 0 0 1 0 0 1 1\n3 2 1 0 6 0 1 1 0 .5 .5 0\n"
        );
        let scan = read(text.as_bytes(), &dir.path().join("a.ply"), &Beside::Folder(dir.path().to_owned())).unwrap();
        assert_eq!(scan.look.uvs, [[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [0.5, 0.5]]);
        assert_eq!(scan.look.corner_uvs, [0, 1, 2, 2, 1, 3]);
        assert_eq!(scan.look.face_materials, [1, 0]);
        assert_eq!(scan.look.materials[1].base_color_texture, Some(crate::scan::Image::File(dir.path().join("skin two.png"))));
        assert_eq!(scan.look.materials[0].base_color_texture, None);
    }

    #[test]
    fn rows_of_the_wrong_length() {
        assert!(with_face("", TRIANGLE, "3 0 1 2 9\n").unwrap().notes.iter().any(|n| n.contains("more values")));
        let error = with_face("", "0 0\n1 0 0\n0 1 0\n", "3 0 1 2\n").unwrap_err();
        assert_eq!((error.place.as_deref(), error.found.contains("too few")), (Some("line 10"), true));
        let error = with_face("", TRIANGLE, "40 0 1 2\n").unwrap_err();
        assert!(error.found.contains("a list of 40 values, more than the row holds"), "{error}");
        assert!(with_face("", TRIANGLE, "3 0 1 3\n").unwrap_err().found.contains("index 3"));
        assert!(with_face("", TRIANGLE, "2 0 1\n").unwrap_err().found.contains("nothing to animate"));
        assert_eq!(with_face("", "0 0 nan\n1 0 0\n0 1 0\n", "3 0 1 2\n").unwrap_err().place.as_deref(), Some("vertex 0"));
    }

    #[test]
    fn lengths_of_lists_are_whole_numbers_and_missing_values_of_others_do_no_harm() {
        let of = |length: &str| {
            let head =
                "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\nelement face 1";
            parse_text(&format!("{head}\nproperty list float int vertex_indices\nend_header\n{TRIANGLE}{length} 0 1 2\n"))
        };
        assert_eq!(of("3").unwrap().mesh.faces.len(), 1);
        for length in ["3.5", "-1", "nan"] {
            let error = of(length).unwrap_err();
            assert!(error.found.contains("a list of") && error.place.as_deref() == Some("line 13"), "{length}: {error}");
        }
        let rows = "0 0 0 1.#INF\n1 0 0 -1.#IND00\n0 1 0 1.#QNAN\n";
        assert_eq!(with_face("property float quality\n", rows, "3 0 1 2\n").unwrap().mesh.faces.len(), 1);
    }

    #[test]
    fn a_file_one_byte_short_ends_early() {
        let head = "ply\nformat binary_little_endian 1.0\nelement vertex 1\nproperty uchar x\nproperty uchar y\nproperty uchar z\n\
                    element other 2\nproperty int a\nend_header\n";
        let bytes = [head.as_bytes(), &[0; 10]].concat();
        let error = read(&bytes, Path::new("a.ply"), &Beside::Nothing).unwrap_err();
        assert!(error.found.contains("2 rows of element 'other'"), "{error}");
    }

    #[test]
    fn every_line_end_before_binary_data() {
        for end in ["\n", "\r\n", "\r"] {
            let head = "ply|format binary_little_endian 1.0|element vertex 3|property uchar x|property uchar y|property uchar z|\
                        element face 1|property list uchar uchar vertex_indices|end_header|";
            let mut bytes = head.replace('|', end).into_bytes();
            bytes.extend([10, 13, 10, 11, 10, 10, 10, 12, 10, 3, 0, 1, 2]);
            let scan = read(&bytes, Path::new("a.ply"), &Beside::Nothing).unwrap();
            assert_eq!(scan.mesh.positions[0], DVec3::new(10.0, 13.0, 10.0), "{end:?}");
        }
    }
}
