//! The JSON of a glTF file, as far as it is used. Names are those of the specification.

use crate::error::{Error, Kind, Result};
use serde::de::{Deserialize, Deserializer, SeqAccess, Visitor};
use std::fmt;
use std::marker::PhantomData;

/// Most entries in one array of the document: their descriptions take more memory here than in the file.
const MOST: usize = 1 << 20;

/// The document.
#[derive(Debug, Default, serde::Deserialize)]
#[serde(rename_all = "camelCase", default)]
pub(crate) struct Document {
    asset: Asset,
    /// Extensions without which the file cannot be understood.
    #[serde(deserialize_with = "array")]
    pub(crate) extensions_required: Vec<String>,
    /// The scene to show.
    pub(crate) scene: Option<u32>,
    /// Scenes.
    #[serde(deserialize_with = "array")]
    pub(crate) scenes: Vec<Scene>,
    /// Nodes.
    #[serde(deserialize_with = "array")]
    pub(crate) nodes: Vec<Node>,
    /// Meshes.
    #[serde(deserialize_with = "array")]
    pub(crate) meshes: Vec<Mesh>,
    /// Skins.
    #[serde(deserialize_with = "array")]
    pub(crate) skins: Vec<Skin>,
    /// Animations.
    #[serde(deserialize_with = "array")]
    pub(crate) animations: Vec<Animation>,
    /// Accessors.
    #[serde(deserialize_with = "array")]
    pub(crate) accessors: Vec<Accessor>,
    /// Views into buffers.
    #[serde(deserialize_with = "array")]
    pub(crate) buffer_views: Vec<BufferView>,
    /// Buffers.
    #[serde(deserialize_with = "array")]
    pub(super) buffers: Vec<BufferEntry>,
    /// Materials.
    #[serde(deserialize_with = "array")]
    pub(crate) materials: Vec<Material>,
    /// Textures.
    #[serde(deserialize_with = "array")]
    pub(crate) textures: Vec<Texture>,
    /// Images.
    #[serde(deserialize_with = "array")]
    pub(crate) images: Vec<Image>,
}

#[derive(Debug, Default, serde::Deserialize)]
#[serde(default)]
struct Asset {
    version: String,
}

/// A scene: its root nodes.
#[derive(Debug, Default, serde::Deserialize)]
#[serde(default)]
pub(crate) struct Scene {
    /// Root nodes.
    pub(crate) nodes: Box<[u32]>,
}

/// A node of the scene graph.
#[derive(Debug, Default, serde::Deserialize)]
#[serde(default)]
pub(crate) struct Node {
    /// Its name.
    pub(crate) name: Option<Box<str>>,
    /// Nodes below it.
    pub(crate) children: Box<[u32]>,
    /// The mesh that it shows.
    pub(crate) mesh: Option<u32>,
    /// The skin that deforms this mesh.
    pub(crate) skin: Option<u32>,
    /// Its placement as a matrix, column by column.
    pub(super) matrix: Option<Box<[f64; 16]>>,
    /// Its translation, rotation (x, y, z, w) and scale.
    pub(super) translation: Option<Box<[f64; 3]>>,
    pub(super) rotation: Option<Box<[f64; 4]>>,
    pub(super) scale: Option<Box<[f64; 3]>>,
    /// Extensions.
    pub(crate) extensions: Option<Box<NodeExtensions>>,
}

/// Extensions of a node that change what is shown.
#[derive(Debug, Default, serde::Deserialize)]
#[serde(default)]
pub(crate) struct NodeExtensions {
    #[serde(rename = "EXT_mesh_gpu_instancing")]
    pub(crate) instancing: Option<Present>,
}

/// A mesh.
#[derive(Debug, Default, serde::Deserialize)]
#[serde(default)]
pub(crate) struct Mesh {
    /// Its name.
    pub(crate) name: Option<Box<str>>,
    /// Its parts.
    pub(crate) primitives: Box<[Primitive]>,
    /// Weights of its morph targets.
    pub(crate) weights: Box<[f64]>,
    /// By convention, the names of its morph targets.
    pub(crate) extras: Option<MeshExtras>,
}

/// What applications add to a mesh.
#[derive(Debug, serde::Deserialize)]
#[serde(untagged)]
pub(crate) enum MeshExtras {
    /// The names of its morph targets.
    #[serde(rename_all = "camelCase")]
    Named {
        /// One per target.
        target_names: Box<[Box<str>]>,
    },
    /// Anything else.
    Other(Present),
}

/// A morph target: what it adds to the attributes of a primitive.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Deserialize)]
#[serde(rename_all = "SCREAMING_SNAKE_CASE", default)]
pub(crate) struct MorphTarget {
    pub(crate) position: Option<u32>,
}

/// A part of a mesh with one material.
#[derive(Debug, serde::Deserialize)]
pub(crate) struct Primitive {
    /// Accessors of the vertices. Not left to a default: an entry then takes a size in the file that is comparable to this one's.
    pub(crate) attributes: Attributes,
    /// Accessor of the indices; without one the vertices are taken in order.
    pub(crate) indices: Option<u32>,
    /// Material.
    pub(crate) material: Option<u32>,
    /// 0 points, 1–3 lines, 4 triangles (also where it is missing), 5 strip, 6 fan.
    pub(crate) mode: Option<u32>,
    /// Morph targets.
    #[serde(default)]
    pub(crate) targets: Box<[MorphTarget]>,
    /// Extensions.
    #[serde(default)]
    pub(crate) extensions: PrimitiveExtensions,
}

/// Extensions of a primitive that change where its data are.
#[derive(Debug, Default, serde::Deserialize)]
#[serde(default)]
pub(crate) struct PrimitiveExtensions {
    #[serde(rename = "KHR_draco_mesh_compression")]
    pub(crate) draco: Option<Present>,
}

/// Accessors of a primitive's vertices.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Deserialize)]
#[serde(rename_all = "SCREAMING_SNAKE_CASE", default)]
pub(crate) struct Attributes {
    pub(crate) position: Option<u32>,
    pub(crate) normal: Option<u32>,
    #[serde(rename = "TEXCOORD_0")]
    pub(crate) texcoord_0: Option<u32>,
    #[serde(rename = "TEXCOORD_1")]
    pub(crate) texcoord_1: Option<u32>,
    #[serde(rename = "COLOR_0")]
    pub(crate) color: Option<u32>,
    #[serde(rename = "JOINTS_0")]
    pub(crate) joints_0: Option<u32>,
    #[serde(rename = "JOINTS_1")]
    pub(crate) joints_1: Option<u32>,
    #[serde(rename = "WEIGHTS_0")]
    pub(crate) weights_0: Option<u32>,
    #[serde(rename = "WEIGHTS_1")]
    pub(crate) weights_1: Option<u32>,
}

/// Something that is there, whatever it says.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Present;

impl<'de> Deserialize<'de> for Present {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        serde::de::IgnoredAny::deserialize(deserializer).map(|_| Present)
    }
}

/// A skin.
#[derive(Debug, Default, serde::Deserialize)]
#[serde(rename_all = "camelCase", default)]
pub(crate) struct Skin {
    /// Its name.
    pub(crate) name: Option<Box<str>>,
    /// Nodes that are its joints.
    pub(crate) joints: Box<[u32]>,
    /// The node above its joints, where the file says.
    pub(crate) skeleton: Option<u32>,
    /// Accessor of one matrix per joint; without it they are the identity.
    pub(crate) inverse_bind_matrices: Option<u32>,
}

/// An animation.
#[derive(Debug, Default, serde::Deserialize)]
#[serde(default)]
pub(crate) struct Animation {
    /// Its name.
    pub(crate) name: Option<Box<str>>,
    /// What moves.
    pub(crate) channels: Box<[Channel]>,
    /// How it moves.
    pub(crate) samplers: Box<[Sampler]>,
}

/// What a sampler of an animation moves.
#[derive(Debug, serde::Deserialize)]
pub(crate) struct Channel {
    /// Index of the animation's sampler.
    #[serde(default)]
    pub(crate) sampler: u32,
    /// Node and property.
    pub(crate) target: Target,
}

/// A property of a node.
#[derive(Debug, Default, serde::Deserialize)]
#[serde(default)]
pub(crate) struct Target {
    /// The node.
    pub(crate) node: Option<u32>,
    /// `translation`, `rotation`, `scale`, `weights`, or what an extension adds.
    pub(crate) path: Box<str>,
}

/// A property over time.
#[derive(Debug, Default, serde::Deserialize)]
#[serde(default)]
pub(crate) struct Sampler {
    /// Accessor of the times in seconds.
    pub(crate) input: u32,
    /// Accessor of the values; three per time for cubic splines (in-tangent, value, out-tangent).
    pub(crate) output: u32,
    /// Between the times.
    pub(crate) interpolation: Interpolation,
}

/// How a sampler goes on between its times.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Deserialize)]
#[serde(rename_all = "UPPERCASE")]
pub(crate) enum Interpolation {
    #[default]
    Linear,
    Step,
    CubicSpline,
}

/// A table of numbers in a buffer.
#[derive(Debug, Default, serde::Deserialize)]
#[serde(rename_all = "camelCase", default)]
pub(crate) struct Accessor {
    /// The view that holds it; zeros without one.
    pub(crate) buffer_view: Option<u32>,
    /// Its first byte in the view.
    pub(super) byte_offset: u64,
    /// 5120 i8, 5121 u8, 5122 i16, 5123 u16, 5125 u32, 5126 f32.
    pub(crate) component_type: u32,
    /// Whether integers stand for fractions.
    pub(crate) normalized: bool,
    /// Rows, as the file claims.
    pub(crate) count: u64,
    /// Columns.
    #[serde(rename = "type")]
    pub(crate) shape: Shape,
    /// Rows that are replaced.
    pub(super) sparse: Option<Box<Sparse>>,
}

/// Columns of an accessor.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Deserialize)]
#[serde(rename_all = "UPPERCASE")]
pub(crate) enum Shape {
    #[default]
    Scalar,
    Vec2,
    Vec3,
    Vec4,
    Mat2,
    Mat3,
    Mat4,
}

impl Shape {
    /// Numbers per row.
    pub(crate) fn columns(self) -> usize {
        match self {
            Shape::Scalar => 1,
            Shape::Vec2 => 2,
            Shape::Vec3 => 3,
            Shape::Vec4 | Shape::Mat2 => 4,
            Shape::Mat3 => 9,
            Shape::Mat4 => 16,
        }
    }
}

#[derive(Debug, serde::Deserialize)]
pub(super) struct Sparse {
    pub(super) count: u64,
    pub(super) indices: SparseIndices,
    pub(super) values: SparseValues,
}

#[derive(Debug, serde::Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct SparseIndices {
    pub(super) buffer_view: u32,
    #[serde(default)]
    pub(super) byte_offset: u64,
    pub(super) component_type: u32,
}

#[derive(Debug, serde::Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct SparseValues {
    pub(super) buffer_view: u32,
    #[serde(default)]
    pub(super) byte_offset: u64,
}

/// A part of a buffer.
#[derive(Debug, Default, serde::Deserialize)]
#[serde(rename_all = "camelCase", default)]
pub(crate) struct BufferView {
    pub(super) buffer: u32,
    pub(super) byte_offset: u64,
    pub(super) byte_length: u64,
    pub(super) byte_stride: Option<u64>,
    pub(super) extensions: Option<Box<ViewExtensions>>,
}

/// Extensions of a view that change how its bytes are packed.
#[derive(Debug, Default, serde::Deserialize)]
#[serde(default)]
pub(super) struct ViewExtensions {
    #[serde(rename = "EXT_meshopt_compression", alias = "KHR_meshopt_compression", alias = "MESHOPT_compression")]
    pub(super) meshopt: Option<Present>,
}

#[derive(Debug, Default, serde::Deserialize)]
#[serde(rename_all = "camelCase", default)]
pub(super) struct BufferEntry {
    pub(super) uri: Option<String>,
    pub(super) byte_length: Option<f64>,
}

/// A material.
#[derive(Debug, Default, serde::Deserialize)]
#[serde(rename_all = "camelCase", default)]
pub(crate) struct Material {
    /// Its name.
    pub(crate) name: Option<Box<str>>,
    /// Metal and roughness.
    pub(crate) pbr_metallic_roughness: Option<Box<Surface>>,
    /// Texture of the normals.
    pub(crate) normal_texture: Option<Box<TextureUse>>,
    /// Light that it sends out.
    pub(crate) emissive_factor: Option<[f32; 3]>,
    /// `OPAQUE`, `MASK` or `BLEND`.
    pub(crate) alpha_mode: Option<Box<str>>,
    /// Extensions.
    pub(crate) extensions: Option<Box<MaterialExtensions>>,
}

/// Extensions of a material that hold its colour.
#[derive(Debug, Default, serde::Deserialize)]
#[serde(default)]
pub(crate) struct MaterialExtensions {
    #[serde(rename = "KHR_materials_pbrSpecularGlossiness")]
    pub(crate) specular_glossiness: Option<SpecularGlossiness>,
}

/// The older description of a surface.
#[derive(Debug, Default, serde::Deserialize)]
#[serde(rename_all = "camelCase", default)]
pub(crate) struct SpecularGlossiness {
    pub(crate) diffuse_factor: Option<[f32; 4]>,
    pub(crate) diffuse_texture: Option<TextureUse>,
    pub(crate) glossiness_factor: Option<f32>,
}

/// A surface by metal and roughness.
#[derive(Debug, Default, serde::Deserialize)]
#[serde(rename_all = "camelCase", default)]
pub(crate) struct Surface {
    pub(crate) base_color_factor: Option<[f32; 4]>,
    pub(crate) base_color_texture: Option<TextureUse>,
    pub(crate) metallic_factor: Option<f32>,
    pub(crate) roughness_factor: Option<f32>,
    pub(crate) metallic_roughness_texture: Option<Present>,
}

/// How a material uses a texture.
#[derive(Debug, Default, serde::Deserialize)]
#[serde(rename_all = "camelCase", default)]
pub(crate) struct TextureUse {
    /// The texture.
    pub(crate) index: u32,
    /// Which texture coordinates.
    pub(crate) tex_coord: u32,
    /// Extensions.
    pub(crate) extensions: TextureUseExtensions,
}

/// Extensions that move a texture.
#[derive(Debug, Default, serde::Deserialize)]
#[serde(default)]
pub(crate) struct TextureUseExtensions {
    #[serde(rename = "KHR_texture_transform")]
    pub(crate) transform: Option<TextureTransform>,
}

/// Where a texture is moved to: first scaled, then turned, then shifted.
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Deserialize)]
#[serde(rename_all = "camelCase", default)]
pub(crate) struct TextureTransform {
    pub(crate) offset: [f64; 2],
    pub(crate) rotation: f64,
    pub(crate) scale: Option<[f64; 2]>,
    pub(crate) tex_coord: Option<u32>,
}

/// A texture.
#[derive(Debug, Default, serde::Deserialize)]
#[serde(default)]
pub(crate) struct Texture {
    /// Its image, unless an extension has one of a newer format.
    pub(crate) source: Option<u32>,
}

/// An image.
#[derive(Debug, Default, serde::Deserialize)]
#[serde(rename_all = "camelCase", default)]
pub(crate) struct Image {
    /// Its name.
    pub(crate) name: Option<Box<str>>,
    /// File or data.
    pub(super) uri: Option<String>,
    /// The view that holds it.
    pub(super) buffer_view: Option<u32>,
}

impl Document {
    /// Reads the JSON.
    ///
    /// # Errors
    /// Not JSON, not of the format's types, more than a million entries in an array, another version than 2.
    pub(super) fn parse(json: &[u8]) -> Result<Self> {
        let json = json.strip_prefix(b"\xef\xbb\xbf").unwrap_or(json);
        let broken = |e: serde_json::Error| {
            let place = format!("line {}, column {}", e.line(), e.column());
            let text = e.to_string();
            let what = text.rsplit_once(" at line ").map_or(text.as_str(), |(what, _)| what);
            Error::malformed(format!("the JSON of the glTF file: {what}")).at(place)
        };
        // The version first: the arrays of version 1 are of other types.
        #[derive(Default, serde::Deserialize)]
        #[serde(default)]
        struct Head {
            asset: Option<Asset>,
        }
        let head: Head = serde_json::from_slice(json).map_err(broken)?;
        match head.asset {
            Some(asset) if asset.version.starts_with("2.") || asset.version == "2" => {}
            Some(asset) => {
                return Err(Error::new(Kind::Unsupported, format!("is of glTF version '{}'", asset.version.escape_debug()))
                    .expected("glTF 2.0")
                    .hint("convert it with a current exporter"));
            }
            None => return Err(Error::malformed("the JSON has no 'asset'").expected("a glTF 2.0 document")),
        }
        serde_json::from_slice(json).map_err(broken)
    }
}

/// An array of at most [`MOST`] entries.
fn array<'de, T: Deserialize<'de>, D: Deserializer<'de>>(deserializer: D) -> Result<Vec<T>, D::Error> {
    struct Bounded<T>(PhantomData<T>);

    impl<'de, T: Deserialize<'de>> Visitor<'de> for Bounded<T> {
        type Value = Vec<T>;

        fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
            f.write_str("an array")
        }

        fn visit_seq<A: SeqAccess<'de>>(self, mut entries: A) -> Result<Vec<T>, A::Error> {
            let mut items = Vec::new();
            while let Some(item) = entries.next_element()? {
                if items.len() == MOST {
                    return Err(serde::de::Error::custom(format!("an array of more than {MOST} entries")));
                }
                items.push(item);
            }
            Ok(items)
        }
    }

    deserializer.deserialize_seq(Bounded(PhantomData))
}
