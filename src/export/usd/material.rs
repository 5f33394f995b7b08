//! Materials as `UsdPreviewSurface`, with textures where they are files.

use super::super::files::relative;
use super::super::parts::Part;
use super::{Tuple, quoted};
use crate::error::Notes;
use crate::scan::{Image, Material, Scan};
use std::fmt::Write as _;
use std::path::Path;

/// The scope with the materials that faces have; empty without any. `folder`: of the file, from which textures are named.
pub(super) fn scope(scan: &Scan, materials: &[(String, Part)], folder: &Path, notes: &mut Notes) -> String {
    if materials.is_empty() {
        return String::new();
    }
    let textured = !scan.look.corner_uvs.is_empty();
    let mut text = String::from("    def Scope \"materials\"\n    {\n");
    for (identifier, part) in materials {
        let material = &scan.look.materials[part.index];
        let mut texture = |image: &Option<Image>| {
            let image = image.as_ref().filter(|_| textured)?;
            match image {
                Image::File(path) => Some(asset(&relative(folder, path))),
                Image::Embedded { name, .. } => {
                    notes.warn(format!(
                        "USD: texture '{name}' left out: it is held by the scan's own file, not by one of its own"
                    ));
                    None
                }
            }
        };
        let (base, bumps) = (texture(&material.base_color_texture), texture(&material.normal_texture));
        text += &surface(identifier, material, base.as_deref(), bumps.as_deref());
    }
    text + "    }\n\n"
}

fn surface(identifier: &str, material: &Material, base: Option<&str>, bumps: Option<&str>) -> String {
    let path = format!("/scan/materials/{identifier}");
    let [r, g, b, alpha] = material.base_color;
    let mut shader = String::new();
    let mut put = |line: String| {
        let _ = writeln!(shader, "                {line}");
    };
    match base {
        Some(_) => put(format!("color3f inputs:diffuseColor.connect = <{path}/base_color.outputs:rgb>")),
        None => put(format!("color3f inputs:diffuseColor = {}", Tuple([r, g, b]))),
    }
    put(format!("color3f inputs:emissiveColor = {}", Tuple(material.emissive)));
    put(format!("float inputs:metallic = {}", material.metallic));
    if bumps.is_some() {
        put(format!("normal3f inputs:normal.connect = <{path}/normal.outputs:rgb>"));
    }
    match base {
        Some(_) if material.blend => put(format!("float inputs:opacity.connect = <{path}/base_color.outputs:a>")),
        _ => put(format!("float inputs:opacity = {alpha}")),
    }
    put(format!("float inputs:roughness = {}", material.roughness));
    put("token outputs:surface".to_owned());

    let mut text = format!(
        "        def Material \"{identifier}\" (\n            customData = {{\n                string name = {}\n            }}\n        )\n        {{\n            token outputs:surface.connect = <{path}/surface.outputs:surface>\n",
        quoted(&material.name)
    );
    text += &node("surface", "UsdPreviewSurface", &shader);
    if let Some(file) = base {
        let scale = format!("                float4 inputs:scale = {}\n", Tuple(material.base_color));
        text += &node("base_color", "UsdUVTexture", &texture(&path, file, "sRGB", &scale));
    }
    if let Some(file) = bumps {
        let scale = "                float4 inputs:bias = (-1, -1, -1, 0)\n                float4 inputs:scale = (2, 2, 2, 1)\n";
        text += &node("normal", "UsdUVTexture", &texture(&path, file, "raw", scale));
    }
    if base.is_some() || bumps.is_some() {
        let body = "                string inputs:varname = \"st\"\n                float2 outputs:result\n";
        text += &node("uv", "UsdPrimvarReader_float2", body);
    }
    text + "        }\n"
}

fn node(name: &str, kind: &str, body: &str) -> String {
    format!(
        "\n            def Shader \"{name}\"\n            {{\n                uniform token info:id = \"{kind}\"\n{body}            }}\n"
    )
}

fn texture(path: &str, file: &str, space: &str, scale: &str) -> String {
    let lines = [
        format!("asset inputs:file = {file}"),
        format!("token inputs:sourceColorSpace = \"{space}\""),
        format!("float2 inputs:st.connect = <{path}/uv.outputs:result>"),
        "token inputs:wrapS = \"repeat\"".to_owned(),
        "token inputs:wrapT = \"repeat\"".to_owned(),
        "float outputs:a".to_owned(),
        "float3 outputs:rgb".to_owned(),
    ];
    lines.iter().fold(scale.to_owned(), |text, line| text + "                " + line + "\n")
}

/// A path between its marks; one that does not lead up is told apart from a search path.
fn asset(path: &str) -> String {
    let path = if path.starts_with("../") || Path::new(path).is_absolute() { path.to_owned() } else { format!("./{path}") };
    if path.contains('@') { format!("@@@{path}@@@") } else { format!("@{path}@") }
}
