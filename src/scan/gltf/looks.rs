//! Materials, texture coordinates and vertex colours of a glTF scene, in the terms of an [`Appearance`](crate::scan::Appearance).

use crate::error::Result;
use crate::gltf::{Gltf, Picture, Primitive, SpecularGlossiness, TextureTransform, TextureUse};
use crate::scan::beside::Beside;
use crate::scan::{Image, Material, NONE, Scan};
use std::collections::{BTreeSet, HashMap};

/// Materials as far as they are met, and what was left out.
pub(super) struct Looks<'a> {
    gltf: &'a Gltf,
    beside: &'a Beside,
    materials: HashMap<u32, u32>,
    images: HashMap<u32, Option<Image>>,
    /// Bytes of images that may still be taken out of buffers: many images may be the same bytes.
    budget: usize,
    /// What was left out; each once.
    pub(super) notes: BTreeSet<String>,
}

/// Where the texture coordinates and colours of vertices come from.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct VertexLooks {
    uvs: Option<u32>,
    transform: TextureTransform,
    colors: Option<u32>,
}

impl<'a> Looks<'a> {
    /// Nothing met yet; at most `budget` bytes of images are taken out of buffers.
    pub(super) fn new(gltf: &'a Gltf, beside: &'a Beside, budget: usize) -> Self {
        Self { gltf, beside, budget, materials: HashMap::new(), images: HashMap::new(), notes: BTreeSet::new() }
    }

    /// The scan's number of a material, which is added when it is met first.
    pub(super) fn material(&mut self, material: Option<u32>, scan: &mut Scan) -> Result<u32> {
        let Some(index) = material else { return Ok(NONE) };
        if let Some(&known) = self.materials.get(&index) {
            return Ok(known);
        }
        let number = scan.look.materials.len() as u32;
        let material = self.describe(index)?;
        scan.look.materials.push(material);
        self.materials.insert(index, number);
        Ok(number)
    }

    fn describe(&mut self, index: u32) -> Result<Material> {
        let gltf = self.gltf;
        let source = Gltf::get(&gltf.document.materials, index, "material")?;
        let older = source.extensions.as_ref().and_then(|e| e.specular_glossiness.as_ref());
        let surface = source.pbr_metallic_roughness.as_deref();
        let base = base_texture(source);
        let (color, mut metallic, mut roughness) = match older {
            Some(SpecularGlossiness { diffuse_factor, glossiness_factor, .. }) => {
                (*diffuse_factor, 0.0, 1.0 - glossiness_factor.unwrap_or(1.0))
            }
            None => {
                let factor = |of: fn(&crate::gltf::Surface) -> Option<f32>| surface.and_then(of).unwrap_or(1.0);
                (surface.and_then(|s| s.base_color_factor), factor(|s| s.metallic_factor), factor(|s| s.roughness_factor))
            }
        };
        if surface.is_some_and(|s| s.metallic_roughness_texture.is_some()) && older.is_none() {
            self.notes.insert("textures of metal and roughness are left out: taken as matt".to_owned());
            (metallic, roughness) = (0.0, 1.0);
        }
        let bumps = source.normal_texture.as_deref();
        // One set of texture coordinates is kept, placed as the base colour's texture wants it.
        let fits = bumps.is_none_or(|b| base.is_none_or(|base| placement(b) == placement(base)));
        if !fits {
            self.notes.insert("normal textures with texture coordinates of their own are left out".to_owned());
        }
        let unit = |x: f32| if x.is_finite() { x.clamp(0.0, 1.0) } else { 1.0 };
        Ok(Material {
            name: source.name.as_deref().map_or_else(|| format!("material {index}"), str::to_owned),
            base_color: color.unwrap_or([1.0; 4]).map(unit),
            base_color_texture: self.image(base)?,
            normal_texture: self.image(bumps.filter(|_| fits))?,
            emissive: source.emissive_factor.unwrap_or_default().map(unit),
            metallic: unit(metallic),
            roughness: unit(roughness),
            // A mask is nearer to blending than to no holes at all.
            blend: source.alpha_mode.as_deref().is_some_and(|m| m == "BLEND" || m == "MASK"),
        })
    }

    fn image(&mut self, texture: Option<&TextureUse>) -> Result<Option<Image>> {
        let Some(texture) = texture else { return Ok(None) };
        let Some(index) = Gltf::get(&self.gltf.document.textures, texture.index, "texture")?.source else {
            self.notes.insert("textures of formats that only extensions know are left out".to_owned());
            return Ok(None);
        };
        if let Some(known) = self.images.get(&index) {
            return Ok(known.clone());
        }
        let source = Gltf::get(&self.gltf.document.images, index, "image")?;
        let image = match self.gltf.picture(index)? {
            Some(Picture::Embedded(bytes)) if bytes.len() > self.budget => {
                self.notes.insert("images that repeat the same bytes are left out".to_owned());
                None
            }
            Some(Picture::Embedded(bytes)) => {
                self.budget -= bytes.len();
                let name =
                    source.name.as_deref().filter(|n| !n.is_empty()).map_or_else(|| format!("image {index}"), str::to_owned);
                Some(Image::Embedded { name, bytes })
            }
            Some(Picture::File(file)) => {
                let found = self.beside.image(&file);
                if found.is_none() && self.notes.len() < 16 {
                    self.notes.insert(format!("texture '{file}' is missing"));
                }
                found
            }
            None => None,
        };
        self.images.insert(index, image.clone());
        Ok(image)
    }

    /// Where the looks of a primitive's vertices come from.
    pub(super) fn vertex_looks(&mut self, primitive: &Primitive) -> VertexLooks {
        let attributes = &primitive.attributes;
        let material = primitive.material.and_then(|m| self.gltf.document.materials.get(m as usize));
        let texture = material.and_then(|m| base_texture(m).or(m.normal_texture.as_deref()));
        let (set, transform) = texture.map(placement).unwrap_or_default();
        let uvs = match set {
            0 => attributes.texcoord_0,
            1 => attributes.texcoord_1,
            _ => {
                self.notes.insert("texture coordinates beyond the second set are not read".to_owned());
                None
            }
        };
        VertexLooks { uvs, transform, colors: attributes.color }
    }

    /// Adds the looks of `count` vertices from `first`; returns whether they have colours.
    pub(super) fn add_vertices(&mut self, looks: &VertexLooks, first: usize, count: usize, scan: &mut Scan) -> Result<bool> {
        let look = &mut scan.look;
        let mut fits = |accessor: &u32| -> bool {
            let fits = self.gltf.accessor(*accessor).is_ok_and(|a| a.count == count as u64);
            if !fits {
                self.notes.insert("texture coordinates or colours of a wrong number of vertices are left out".to_owned());
            }
            fits
        };
        let (uvs, colors) = (looks.uvs.filter(&mut fits), looks.colors.filter(&mut fits));
        if let Some(accessor) = uvs {
            let uvs = self.gltf.floats::<2>(accessor)?;
            look.uvs.resize(first, [f32::NAN; 2]);
            look.uvs.extend(uvs.iter().map(|&uv| bottom_left(moved(uv, &looks.transform))));
        }
        let Some(accessor) = colors else { return Ok(false) };
        look.colors.resize(first, [1.0; 4]);
        match self.gltf.accessor(accessor)?.shape.columns() {
            4 => {
                look.colors_have_alpha = true;
                look.colors.extend(self.gltf.floats::<4>(accessor)?.iter().map(|&c| stored(c)));
            }
            _ => look.colors.extend(self.gltf.floats::<3>(accessor)?.iter().map(|&[r, g, b]| stored([r, g, b, 1.0]))),
        }
        Ok(true)
    }
}

fn base_texture(material: &crate::gltf::Material) -> Option<&TextureUse> {
    let older = material.extensions.as_ref().and_then(|e| e.specular_glossiness.as_ref());
    match older {
        Some(older) => older.diffuse_texture.as_ref(),
        None => material.pbr_metallic_roughness.as_ref().and_then(|s| s.base_color_texture.as_ref()),
    }
}

/// The set of texture coordinates that a texture uses, and how it moves them.
fn placement(texture: &TextureUse) -> (u32, TextureTransform) {
    let transform = texture.extensions.transform.unwrap_or_default();
    (transform.tex_coord.unwrap_or(texture.tex_coord), TextureTransform { tex_coord: None, ..transform })
}

/// A texture coordinate scaled, turned and shifted as KHR_texture_transform prescribes.
fn moved([u, v]: [f64; 2], transform: &TextureTransform) -> [f64; 2] {
    if *transform == TextureTransform::default() {
        return [u, v];
    }
    let [su, sv] = transform.scale.unwrap_or([1.0; 2]);
    let (sin, cos) = transform.rotation.sin_cos();
    let (u, v) = (u * su, v * sv);
    [transform.offset[0] + cos * u + sin * v, transform.offset[1] - sin * u + cos * v]
}

/// With the origin at the bottom left; not a number where it is none.
fn bottom_left([u, v]: [f64; 2]) -> [f32; 2] {
    let uv = [u as f32, (1.0 - v) as f32];
    if uv.iter().all(|x| x.is_finite()) { uv } else { [f32::NAN; 2] }
}

/// Linear light as scans store it: sRGB. The inverse of what the GLB writer does.
fn stored(color: [f64; 4]) -> [f32; 4] {
    let unit = |x: f64| if x.is_finite() { x.clamp(0.0, 1.0) } else { 1.0 };
    let encode = |c: f64| if c <= 0.003_130_8 { c * 12.92 } else { 1.055 * c.powf(1.0 / 2.4) - 0.055 };
    let [r, g, b, a] = color.map(unit);
    [encode(r) as f32, encode(g) as f32, encode(b) as f32, a as f32]
}
