//! Materials, with their images inside the file, and vertex colours.

use super::container::{Buffer, Target};
use super::geometry::{Geometry, is_solid};
use crate::error::Notes;
use crate::scan::{Image, Material, NONE, Scan};
use serde_json::{Value, json};
use std::path::Path;

/// Materials, textures and images of a document.
#[derive(Debug, Default)]
pub(crate) struct Looks {
    /// One per primitive, in the primitives' order.
    pub(crate) materials: Vec<Value>,
    /// Textures, one per image.
    pub(crate) textures: Vec<Value>,
    /// Images.
    pub(crate) images: Vec<Value>,
    known: Vec<(Image, Option<usize>)>,
}

impl Looks {
    /// Materials of the primitives; images are copied into `buffer` as they are.
    pub(crate) fn of(scan: &Scan, geometry: &Geometry, buffer: &mut Buffer, notes: &mut Notes) -> Self {
        let mut looks = Self::default();
        let double_sided = !is_solid(scan);
        let plain = Material { name: "default".to_owned(), ..Material::default() };
        let clear = scan.look.colors_have_alpha && scan.look.colors.iter().any(|c| c[3] < 1.0);
        for primitive in &geometry.primitives {
            let material = if primitive.material == NONE { None } else { scan.look.materials.get(primitive.material as usize) };
            let material = material.unwrap_or(&plain);
            let mut texture = |image: &Option<Image>, notes: &mut Notes| {
                let image = image.as_ref()?;
                if primitive.textured {
                    looks.texture(image, buffer, notes)
                } else {
                    notes.warn(format!("{}: not used, the faces have no texture coordinates", image.name()));
                    None
                }
            };
            let base = texture(&material.base_color_texture, notes);
            let bumps = texture(&material.normal_texture, notes);
            looks.materials.push(describe(material, double_sided, clear, base, bumps));
        }
        looks
    }

    /// The texture of an image, once per image.
    fn texture(&mut self, image: &Image, buffer: &mut Buffer, notes: &mut Notes) -> Option<usize> {
        if let Some((_, known)) = self.known.iter().find(|(i, _)| i == image) {
            return *known;
        }
        let loaded = load(image);
        if let Err(reason) = &loaded {
            notes.warn(format!("{}: texture left out: {reason}", image.name()));
        }
        let texture = loaded.ok().map(|(bytes, mime)| {
            let view = buffer.view(bytes, Target::Other);
            let name = Path::new(&image.name()).file_stem().map_or_else(String::new, |s| s.to_string_lossy().into_owned());
            self.images.push(json!({ "bufferView": view, "mimeType": mime, "name": name }));
            self.textures.push(json!({ "source": self.images.len() - 1 }));
            self.textures.len() - 1
        });
        self.known.push((image.clone(), texture));
        texture
    }
}

/// Bytes of an image with its type, if it is of one that glTF and USD packages hold.
pub(crate) fn load(image: &Image) -> Result<(Vec<u8>, &'static str), String> {
    let bytes = image.read().map_err(|e| e.to_string())?;
    let mime = match bytes.as_slice() {
        [0x89, b'P', b'N', b'G', 0x0D, 0x0A, 0x1A, 0x0A, ..] => "image/png",
        [0xFF, 0xD8, 0xFF, ..] => "image/jpeg",
        _ => return Err("neither PNG nor JPEG".to_owned()),
    };
    Ok((bytes, mime))
}

fn describe(material: &Material, double_sided: bool, clear: bool, base: Option<usize>, bumps: Option<usize>) -> Value {
    let unit = |x: f32| json!(if x.is_finite() { f64::from(x.clamp(0.0, 1.0)) } else { 1.0 });
    let mut surface = json!({
        "baseColorFactor": material.base_color.map(unit),
        "metallicFactor": unit(material.metallic),
        "roughnessFactor": unit(material.roughness),
    });
    if let Some(index) = base {
        surface["baseColorTexture"] = json!({ "index": index });
    }
    let mut value = json!({ "name": material.name, "pbrMetallicRoughness": surface });
    if let Some(index) = bumps {
        value["normalTexture"] = json!({ "index": index });
    }
    if material.emissive.iter().any(|&e| e > 0.0) {
        value["emissiveFactor"] = json!(material.emissive.map(unit));
    }
    if material.blend || clear {
        value["alphaMode"] = json!("BLEND");
    }
    if double_sided {
        value["doubleSided"] = json!(true);
    }
    value
}

/// Linear light of a stored channel, which is sRGB.
pub(crate) fn linear(c: f32) -> f32 {
    if c <= 0.04045 { c / 12.92 } else { ((c + 0.055) / 1.055).powf(2.4) }
}

/// A stored colour as glTF wants it: linear light in 16 bits. What the file stores is sRGB; alpha is linear already.
pub(crate) fn linear_color(color: [f32; 4]) -> [u16; 4] {
    let step = |x: f32| (x.clamp(0.0, 1.0) * 65535.0).round() as u16;
    [step(linear(color[0])), step(linear(color[1])), step(linear(color[2])), step(color[3])]
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    #[test]
    fn colours_become_linear_light() {
        assert_eq!(linear_color([0.0, 1.0, 0.5, 0.5]), [0, 65535, 14027, 32768]);
    }

    #[test]
    fn an_image_is_embedded_once_and_other_files_are_named() {
        let folder = tempfile::tempdir().unwrap();
        let png = folder.path().join("skin.png");
        std::fs::write(&png, b"\x89PNG\r\n\x1a\nrest").unwrap();
        let tga = folder.path().join("skin.tga");
        std::fs::write(&tga, b"TGA").unwrap();
        let (png, tga) = (Image::File(png), Image::File(tga));
        let (mut looks, mut buffer, mut notes) = (Looks::default(), Buffer::default(), Notes::default());
        assert_eq!(looks.texture(&png, &mut buffer, &mut notes), Some(0));
        assert_eq!(looks.texture(&png, &mut buffer, &mut notes), Some(0));
        assert_eq!(looks.texture(&tga, &mut buffer, &mut notes), None);
        assert_eq!(looks.images.len(), 1);
        assert_eq!(looks.images[0]["mimeType"], "image/png");
        assert_eq!(notes.iter().count(), 1);
        assert!(notes.iter().all(|n| n.contains("skin.tga") && n.contains("neither PNG nor JPEG")));
    }
}
