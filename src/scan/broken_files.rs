//! Broken and odd files of the shared data: what each must do; skipped where the data is absent.

#![allow(clippy::unwrap_used, clippy::print_stderr)]

use super::{Scan, corpus::meshes, read};

fn with_case(name: &str, test: impl FnOnce(crate::error::Result<Scan>)) {
    if let Some(folder) = meshes() {
        test(read(&folder.join("broken").join(name)));
    }
}

/// The file is refused, with these words in the message.
fn fails(name: &str, words: &[&str]) {
    with_case(name, |result| {
        let text = result.expect_err(name).to_string();
        assert!(text.contains(name) && words.iter().all(|w| text.contains(w)), "{text}");
    });
}

/// The file is read, with this many vertices and faces, and notes with these words, as many as given.
fn loads(name: &str, vertices: usize, faces: usize, notes: &[&str]) {
    with_case(name, |result| {
        let scan = result.unwrap();
        assert_eq!((scan.mesh.positions.len(), scan.mesh.faces.len()), (vertices, faces), "{name}");
        let found: Vec<&str> = scan.notes.iter().collect();
        assert_eq!(found.len(), notes.len(), "{name}: {found:?}");
        assert!(notes.iter().zip(&found).all(|(n, f)| f.contains(n)), "{name}: {found:?}");
    });
}

#[test]
fn files_without_a_surface_say_what_they_hold() {
    fails("empty.obj", &["no vertices"]);
    fails("comment_only.obj", &["no vertices"]);
    fails("points_only.obj", &["nothing to animate", "vertices, no faces"]);
    fails("lines_only.obj", &["nothing to animate", "line elements", "point elements"]);
    fails("ply_points_only.ply", &["nothing to animate", "128 vertices"]);
    fails("stl_empty_ascii.stl", &["nothing to animate"]);
    fails("not_a_mesh.obj", &[]);
    fails("png_named.obj", &["PNG"]);
    fails("glb_bad_length.glb", &["GLB"]);
}

#[test]
fn flaws_name_their_lines() {
    fails("nan_inf.obj", &["'nan' is not a finite number", "vertex 6", "lines 6, 18 and 31"]);
    fails("index_out_of_range.obj", &["index 99", "lines 15 and 16"]);
    fails("exponents_commas.obj", &["'1.d0'", "lines 3 and 4"]);
    fails("ply_count_lie_vertices.ply", &["element 'vertex'", "too many values", "line 138"]);
    fails("ply_count_lie_huge.ply", &["4000000000"]);
    fails("ply_truncated_binary.ply", &["ends within row", "face"]);
    fails("ply_negative_index.ply", &["index -1", "line 23"]);
}

#[test]
fn odd_obj_files_load() {
    loads("negative_indices.obj", 9, 4, &[]);
    loads("zero_area_faces.obj", 11, 10, &["2 faces name a vertex twice"]);
    loads("duplicate_vertices_faces.obj", 32, 10, &[]);
    loads("nonmanifold_edge.obj", 9, 8, &[]);
    loads("ngons_concave.obj", 24, 14, &[]);
    loads("missing_mtl.obj", 8, 6, &["'not_there.mtl' is missing", "'also missing file.mtl' is missing"]);
    loads("latin1_names.obj", 8, 6, &[]);
    loads("no_newline_at_end.obj", 8, 6, &[]);
    let weird = [
        "2 statements of curves",
        "3 vertices have no colour",
        "1 lines with unknown keywords",
        "1 faces with fewer than 3 corners are skipped (line 15)",
    ];
    loads("weird_syntax.obj", 4, 4, &weird);
}

#[test]
fn a_file_cut_short_loads_with_a_warning() {
    with_case("truncated.obj", |result| {
        let notes = result.unwrap().notes;
        assert!(notes.iter().any(|n| n.contains("cut short")), "{notes:?}");
    });
}

#[test]
fn far_and_small_coordinates_keep_their_digits() {
    with_case("huge_offset.obj", |result| {
        let diagonal = super::UnitBox::of(&result.unwrap().mesh).unwrap().diagonal;
        assert!((diagonal / 3f64.sqrt() - 1.0).abs() < 0.02, "{diagonal}");
    });
    with_case("tiny_scale.obj", |result| {
        let diagonal = super::UnitBox::of(&result.unwrap().mesh).unwrap().diagonal;
        assert!((diagonal / 2e-6 / 3f64.sqrt() - 1.0).abs() < 0.02, "{diagonal}");
    });
}

#[test]
fn concave_caps_have_their_area() {
    with_case("ngons_concave.obj", |result| {
        let mesh = result.unwrap().mesh;
        let p = |v: u32| mesh.positions[v as usize];
        let (triangles, vertices) = (mesh.triangulate(), mesh.vertex_triangles());
        for f in (0..mesh.faces.len()).filter(|&f| mesh.faces.face(f).len() == 12) {
            let of_face = triangles.faces.iter().zip(&vertices).filter(|(face, _)| **face as usize == f);
            let area: f64 = of_face.map(|(_, t)| (p(t[1]) - p(t[0])).cross(p(t[2]) - p(t[0])).length() / 2.0).sum();
            assert!((area - 1.2).abs() < 1e-9, "{area}");
        }
    });
}

#[test]
fn names_of_any_encoding_are_kept() {
    with_case("crlf_bom_utf8.obj", |result| {
        let look = result.unwrap().look;
        assert_eq!(look.groups[0].group.as_deref(), Some("Körper 人体"));
        assert_eq!((look.materials[0].name.as_str(), look.materials[0].base_color), ("Haut hell", [0.8, 0.6, 0.5, 1.0]));
        assert_eq!(look.material_libraries, ["crlf_bom_utf8.mtl"]);
    });
    with_case("latin1_names.obj", |result| assert_eq!(result.unwrap().look.groups[0].group.as_deref(), Some("Körper")));
}

#[test]
fn odd_ply_files_load() {
    loads("ply_ascii_extra_elements.ply", 128, 252, &[]);
    loads("ply_crlf_header_binary.ply", 8, 6, &[]);
    loads("ply_tristrips.ply", 8, 4, &[]);
    with_case("ply_big_endian_double_extra.ply", |result| {
        let scan = result.unwrap();
        assert_eq!((scan.mesh.positions.len(), scan.mesh.faces.len()), (128, 252));
        assert!(scan.look.colors.iter().all(|c| c.map(|x| (x * 255.0).round()) == [200.0, 100.0, 50.0, 255.0]));
    });
}

#[test]
fn odd_stl_files_load() {
    loads("stl_binary_solid_header.stl", 128, 252, &[]);
    loads("stl_binary_count_lie.stl", 128, 252, &["announces 1252 facets"]);
    with_case("stl_ascii_short.stl", |result| assert_eq!(result.unwrap().mesh.faces.len(), 40));
}

#[test]
fn meshes_with_odd_topology_load_whole() {
    for name in
        ["nonmanifold_vertex", "flipped_orientation", "mixed_orientation", "self_intersecting", "open_surface", "many_components"]
    {
        with_case(&format!("{name}.obj"), |result| assert!(result.unwrap().notes.is_empty()));
    }
}
