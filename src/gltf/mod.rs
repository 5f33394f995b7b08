//! glTF 2.0 as text or binary: the document, its buffers, accessors and nodes. What they mean as a scan or as a take is told by the stations.
//!
//! Nothing here believes the file: every index, offset and count is checked against what is there before it is used, so a damaged file
//! ends in an error, within memory that is bounded by a small multiple of the file's size.
//!
//! Source: Khronos Group, glTF 2.0 Specification (ISO/IEC 12113).

mod accessors;
mod container;
mod document;
mod nodes;
#[cfg(test)]
pub(crate) mod tests;

pub(crate) use container::is_binary;
pub(crate) use document::*;
pub(crate) use nodes::{Hierarchy, Turn, affine};

use crate::error::{Error, Kind, Result};
use container::Buffer;
use std::path::Path;
use std::sync::Arc;

/// Extensions that a file may require: they change looks only, or are done where the file is read.
pub(crate) const KNOWN: [&str; 18] = [
    "KHR_mesh_quantization",
    "KHR_texture_transform",
    "KHR_materials_unlit",
    "KHR_materials_pbrSpecularGlossiness",
    "KHR_materials_clearcoat",
    "KHR_materials_emissive_strength",
    "KHR_materials_ior",
    "KHR_materials_sheen",
    "KHR_materials_specular",
    "KHR_materials_transmission",
    "KHR_materials_variants",
    "KHR_materials_volume",
    "KHR_lights_punctual",
    "KHR_texture_basisu",
    "KHR_animation_pointer",
    "EXT_texture_webp",
    "EXT_texture_avif",
    "VRMC_vrm",
];

/// Gives the bytes of a file that the document names by a relative path (already decoded); the error says why it cannot.
pub(crate) type Files<'a> = dyn Fn(&str) -> Result<Vec<u8>> + 'a;

/// A glTF file: its document, and its buffers as far as they could be had.
#[derive(Debug)]
pub(crate) struct Gltf {
    /// The document.
    pub(crate) document: Document,
    buffers: Vec<Buffer>,
    /// Bytes of all buffers: what an accessor without data may be measured by.
    bytes: usize,
}

/// An image of the document.
#[derive(Clone, Debug)]
pub(crate) enum Picture {
    /// Held by the file itself.
    Embedded(Arc<[u8]>),
    /// A file of this relative path.
    File(String),
}

/// Files beside `path`, as documents name them.
pub(crate) fn beside(path: &Path) -> impl Fn(&str) -> Result<Vec<u8>> {
    let folder = crate::beside::folder_of(path).to_owned();
    move |name| {
        let file = crate::beside::locate(&folder, name)
            .ok_or_else(|| Error::new(Kind::Unreadable, format!("'{name}', which the file needs, is missing")))?;
        crate::beside::read(&file).map_err(|e| Error::unreadable(&file, &e))
    }
}

/// Reads a glTF or GLB file from its bytes. Buffers that cannot be had are an error only once an accessor needs them.
///
/// # Errors
/// Without the file's name, which the caller adds: broken container or JSON, another version than 2.
pub(crate) fn parse(bytes: &[u8], files: &Files<'_>) -> Result<Gltf> {
    let (json, binary) = container::split(bytes)?;
    let document = Document::parse(json)?;
    let buffers = container::load(&document.buffers, binary, files);
    let bytes = buffers.iter().map(Buffer::len).sum();
    Ok(Gltf { document, buffers, bytes })
}

impl Gltf {
    /// Bytes of all buffers.
    pub(crate) fn bytes(&self) -> usize {
        self.bytes
    }

    /// A warning, where a buffer holds less than the document announces.
    pub(crate) fn cut_short(&self) -> Option<String> {
        self.document.buffers.iter().zip(&self.buffers).enumerate().find_map(|(k, (entry, buffer))| {
            let container::Buffer::Loaded(bytes) = buffer else { return None };
            let announced = entry.byte_length.filter(|&n| n > bytes.len() as f64)?;
            Some(format!("buffer {k} has {} of the {announced} bytes that it announces: the file may be cut short", bytes.len()))
        })
    }

    /// The element `index` of one of the document's arrays; `what` names it in the error.
    pub(crate) fn get<'a, T>(items: &'a [T], index: u32, what: &str) -> Result<&'a T> {
        items
            .get(index as usize)
            .ok_or_else(|| Error::malformed(format!("{what} {index} does not exist: there are {}", items.len())))
    }

    /// Refuses the file if it requires an extension that is not among `known`, with the remedy.
    pub(crate) fn require_only(&self, known: &[&str]) -> Result<()> {
        match self.document.extensions_required.iter().find(|e| !known.contains(&e.as_str())) {
            None => Ok(()),
            Some(name) => Err(needs_extension(name)),
        }
    }

    /// Where the bytes of an image are; `None` if the image names neither a view nor a file.
    pub(crate) fn picture(&self, image: u32) -> Result<Option<Picture>> {
        let image = Self::get(&self.document.images, image, "image")?;
        if let Some(view) = image.buffer_view {
            return Ok(Some(Picture::Embedded(self.view(view)?.bytes.into())));
        }
        let Some(uri) = image.uri.as_deref() else { return Ok(None) };
        Ok(Some(match container::data_uri(uri) {
            Some(bytes) => Picture::Embedded(bytes?.into()),
            None => Picture::File(container::relative(uri)?),
        }))
    }
}

/// The error for an extension without which the file cannot be understood.
pub(crate) fn needs_extension(name: &str) -> Error {
    let hint = match name {
        "KHR_draco_mesh_compression" => "export it without Draco compression (in Blender: untick Compression)",
        "EXT_meshopt_compression" | "KHR_meshopt_compression" | "MESHOPT_compression" => {
            "unpack it first: gltf-transform copy in.glb out.glb, or export it without meshopt compression"
        }
        _ => "export it without this extension",
    };
    Error::new(Kind::Unsupported, format!("needs the glTF extension {name}, which is not read"))
        .expected("plain glTF 2.0, or KHR_mesh_quantization")
        .hint(hint)
}
