//! Morph targets in a document: displacements per primitive, and the track of their weights.

use super::container::{Buffer, Pieces, Target as Use, bounds, component, float_rows};
use super::geometry::{Geometry, Primitive};
use crate::export::encode::morphs::{Morphs, Target};
use serde_json::{Value, json};

/// A target is stored sparse where that is shorter: 16 bytes a vertex against 12 for all.
const SPARSE: f64 = 0.7;

/// The targets of a primitive. `places`: place in the skin of each scan vertex.
pub(super) fn targets(
    morphs: &Morphs,
    geometry: &Geometry,
    primitive: &Primitive,
    places: &[u32],
    buffer: &mut Buffer,
) -> Vec<Value> {
    let vertices = &geometry.vertices[primitive.vertices.clone()];
    let target = |target: &Target| {
        let offsets = vertices.iter().map(|&v| target.offset(places[v as usize]));
        let bounds = bounds(offsets.clone());
        let mut moved: Vec<(u32, [f32; 3])> = (0u32..).zip(offsets.clone()).filter(|(_, o)| *o != [0.0; 3]).collect();
        if moved.is_empty() {
            // By the format an accessor may have no values at all, but not every reader takes that.
            moved.push((0, [0.0; 3]));
        }
        let position = if moved.len() as f64 > SPARSE * vertices.len() as f64 {
            let view = buffer.view(float_rows(offsets), Use::Attributes(12));
            buffer.accessor(view, 0, component::F32, vertices.len(), "VEC3", bounds)
        } else {
            let indices = buffer.view(moved.iter().flat_map(|(v, _)| v.to_le_bytes()).collect(), Use::Other);
            let values = buffer.view(float_rows(moved.iter().map(|(_, o)| *o)), Use::Other);
            buffer.sparse((indices, values), moved.len(), vertices.len(), bounds)
        };
        json!({ "POSITION": position })
    };
    morphs.targets.iter().map(target).collect()
}

/// All weights of each frame, frame by frame.
pub(super) fn weights(morphs: &Morphs) -> Pieces {
    let morphs = morphs.clone();
    Box::new((0..morphs.frames()).map(move |frame| Ok(morphs.weights(frame)?.iter().flat_map(|w| w.to_le_bytes()).collect())))
}

/// Names of the targets, where programs look for them.
pub(super) fn names(morphs: &Morphs) -> Value {
    json!((1..=morphs.targets.len()).map(|k| format!("morph_{k:02}")).collect::<Vec<_>>())
}
