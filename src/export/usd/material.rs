//! Materials as `UsdPreviewSurface`, with textures where they are files.

use super::tree::{Content, Prim, Property, Value};
use crate::error::Notes;
use crate::export::files::relative;
use crate::export::glb::load_image;
use crate::export::parts::Part;
use crate::scan::{Image, Material, Scan};
use std::path::Path;

/// Where textures are.
#[derive(Debug)]
pub(super) enum Textures<'a> {
    /// In files of their own, named from the folder of the stage's.
    Beside(&'a Path),
    /// In the package: name and bytes, and the images that they are of.
    Inside(Vec<(String, Vec<u8>)>, Vec<Image>),
}

impl Textures<'_> {
    /// The path of an image in the stage.
    fn path(&mut self, image: &Image, notes: &mut Notes) -> Option<String> {
        match (self, image) {
            (Self::Beside(folder), Image::File(path)) => Some(anchored(relative(folder, path))),
            (Self::Beside(_), Image::Embedded { name, .. }) => {
                notes.warn(format!("USD: texture '{name}' left out: it is held by the scan's own file, not by one of its own"));
                None
            }
            (Self::Inside(files, images), image) => {
                if let Some(known) = images.iter().position(|i| i == image) {
                    return Some(format!("./{}", files[known].0));
                }
                match load_image(image) {
                    Ok((bytes, mime)) => {
                        let ending = if mime == "image/png" { "png" } else { "jpg" };
                        files.push((format!("textures/{}.{ending}", files.len() + 1), bytes));
                        images.push(image.clone());
                        files.last().map(|(name, _)| format!("./{name}"))
                    }
                    Err(reason) => {
                        notes.warn(format!("{}: texture left out: {reason}", image.name()));
                        None
                    }
                }
            }
        }
    }
}

/// The scope with the materials that faces have.
pub(super) fn scope(scan: &Scan, materials: &[(String, Part)], textures: &mut Textures<'_>, notes: &mut Notes) -> Option<Prim> {
    let textured = !scan.look.corner_uvs.is_empty();
    let mut children = Vec::new();
    for (identifier, part) in materials {
        let material = &scan.look.materials[part.index];
        let mut texture = |image: &Option<Image>| textures.path(image.as_ref().filter(|_| textured)?, notes);
        let (base, bumps) = (texture(&material.base_color_texture), texture(&material.normal_texture));
        children.push(prim(identifier, material, base, bumps));
    }
    let scope = Prim { name: "materials".to_owned(), kind: "Scope", children, ..Prim::default() };
    Some(scope).filter(|s| !s.children.is_empty())
}

fn prim(identifier: &str, material: &Material, base: Option<String>, bumps: Option<String>) -> Prim {
    let path = format!("/scan/materials/{identifier}");
    let from = |node: &str| Content::Connection(format!("{path}/{node}"));
    let [r, g, b, alpha] = material.base_color;
    let float = |name, x| Property::value("float", name, Value::Float(x));
    let color = match base {
        Some(_) => from("base_color.outputs:rgb"),
        None => Content::Value(Value::Vector3([r, g, b])),
    };
    let mut surface = vec![
        Property::new("color3f", "inputs:diffuseColor", color),
        Property::value("color3f", "inputs:emissiveColor", Value::Vector3(material.emissive)),
        float("inputs:metallic", material.metallic),
        float("inputs:roughness", material.roughness),
    ];
    if bumps.is_some() {
        surface.push(Property::new("normal3f", "inputs:normal", from("normal.outputs:rgb")));
    }
    surface.push(match base {
        Some(_) if material.blend => Property::new("float", "inputs:opacity", from("base_color.outputs:a")),
        _ => float("inputs:opacity", alpha),
    });
    surface.push(Property::new("token", "outputs:surface", Content::Nothing));

    let mut children = vec![shader("surface", "UsdPreviewSurface", surface)];
    if base.is_some() || bumps.is_some() {
        let uv = [
            Property::value("string", "inputs:varname", Value::Text("st".to_owned())),
            Property::new("float2", "outputs:result", Content::Nothing),
        ];
        children.push(shader("uv", "UsdPrimvarReader_float2", uv.to_vec()));
    }
    if let Some(file) = base {
        let scale = vec![("inputs:scale", material.base_color)];
        children.push(texture("base_color", file, "sRGB", scale, from("uv.outputs:result")));
    }
    if let Some(file) = bumps {
        let scale = vec![("inputs:bias", [-1.0, -1.0, -1.0, 0.0]), ("inputs:scale", [2.0, 2.0, 2.0, 1.0])];
        children.push(texture("normal", file, "raw", scale, from("uv.outputs:result")));
    }
    let properties = vec![
        Property::name_in_the_scan(&material.name),
        Property::new("token", "outputs:surface", from("surface.outputs:surface")),
    ];
    Prim { name: identifier.to_owned(), kind: "Material", properties, children, ..Prim::default() }
}

fn shader(name: &str, id: &str, mut properties: Vec<Property>) -> Prim {
    properties.insert(0, Property::value("token", "info:id", Value::token(id)).uniform());
    Prim { name: name.to_owned(), kind: "Shader", properties, ..Prim::default() }
}

fn texture(name: &str, file: String, space: &str, scale: Vec<(&str, [f32; 4])>, uv: Content) -> Prim {
    let mut properties = vec![
        Property::value("asset", "inputs:file", Value::Asset(file)),
        Property::value("token", "inputs:sourceColorSpace", Value::token(space)),
        Property::new("float2", "inputs:st", uv),
        Property::value("token", "inputs:wrapS", Value::token("repeat")),
        Property::value("token", "inputs:wrapT", Value::token("repeat")),
        Property::new("float", "outputs:a", Content::Nothing),
        Property::new("float3", "outputs:rgb", Content::Nothing),
    ];
    properties.extend(scale.into_iter().map(|(name, x)| Property::value("float4", name, Value::Vector4(x))));
    shader(name, "UsdUVTexture", properties)
}

/// A path from the file; one that does not lead up is told apart from a search path.
fn anchored(path: String) -> String {
    if path.starts_with("../") || Path::new(&path).is_absolute() { path } else { format!("./{path}") }
}
