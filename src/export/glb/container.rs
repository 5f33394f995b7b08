//! The GLB container: one JSON chunk and one binary chunk of aligned views.

use serde_json::{Value, json};
use std::io::{self, Write};

/// Component types of glTF.
pub(crate) mod component {
    /// `UNSIGNED_BYTE`
    pub(crate) const U8: u32 = 5121;
    /// `SHORT`
    pub(crate) const I16: u32 = 5122;
    /// `UNSIGNED_SHORT`
    pub(crate) const U16: u32 = 5123;
    /// `UNSIGNED_INT`
    pub(crate) const U32: u32 = 5125;
    /// `FLOAT`
    pub(crate) const F32: u32 = 5126;
}

/// What a view is used for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Target {
    /// Vertex attributes, with the distance from one to the next.
    Attributes(usize),
    /// Triangle indices.
    Indices,
    /// Anything else.
    Other,
}

/// Views and accessors in the order in which they are added.
#[derive(Debug, Default)]
pub(crate) struct Buffer {
    views: Vec<Value>,
    accessors: Vec<Value>,
    bytes: Vec<Vec<u8>>,
    length: usize,
}

impl Buffer {
    /// Adds a view; returns its index.
    pub(crate) fn view(&mut self, bytes: Vec<u8>, target: Target) -> usize {
        let mut view = json!({ "buffer": 0, "byteOffset": self.length, "byteLength": bytes.len() });
        match target {
            Target::Attributes(stride) => {
                view["target"] = json!(34962);
                view["byteStride"] = json!(stride);
            }
            Target::Indices => view["target"] = json!(34963),
            Target::Other => {}
        }
        self.length += bytes.len().next_multiple_of(4);
        self.bytes.push(bytes);
        self.views.push(view);
        self.views.len() - 1
    }

    /// Adds an accessor; returns its index. `more` holds `normalized`, `min`, `max`.
    pub(crate) fn accessor(
        &mut self,
        view: usize,
        offset: usize,
        component: u32,
        count: usize,
        kind: &str,
        more: Value,
    ) -> usize {
        let mut accessor =
            json!({ "bufferView": view, "byteOffset": offset, "componentType": component, "count": count, "type": kind });
        if let (Some(accessor), Value::Object(more)) = (accessor.as_object_mut(), more) {
            accessor.extend(more);
        }
        self.accessors.push(accessor);
        self.accessors.len() - 1
    }

    /// Writes the file: `document` with buffers, views and accessors added. An error of kind `InvalidData` if the
    /// file would not fit the format's 4 GiB.
    pub(crate) fn write(self, mut document: Value, out: &mut impl Write) -> io::Result<()> {
        document["buffers"] = json!([{ "byteLength": self.length }]);
        document["bufferViews"] = Value::Array(self.views);
        document["accessors"] = Value::Array(self.accessors);
        let mut json = serde_json::to_vec(&document)?;
        json.resize(json.len().next_multiple_of(4), b' ');
        let total = 12 + 8 + json.len() as u64 + 8 + self.length as u64;
        let word = |n: u64| u32::try_from(n).map_err(|_| io::Error::new(io::ErrorKind::InvalidData, "a GLB holds at most 4 GiB"));
        out.write_all(b"glTF")?;
        for n in [2, word(total)?, word(json.len() as u64)?] {
            out.write_all(&n.to_le_bytes())?;
        }
        out.write_all(b"JSON")?;
        out.write_all(&json)?;
        out.write_all(&word(self.length as u64)?.to_le_bytes())?;
        out.write_all(b"BIN\0")?;
        for bytes in self.bytes {
            out.write_all(&bytes)?;
            out.write_all(&[0; 3][..bytes.len().next_multiple_of(4) - bytes.len()])?;
        }
        Ok(())
    }
}

/// Bytes of rows of `f32`.
pub(crate) fn float_rows<const N: usize>(rows: impl Iterator<Item = [f32; N]>) -> Vec<u8> {
    let mut bytes = Vec::with_capacity(rows.size_hint().0 * N * 4);
    for row in rows {
        for x in row {
            bytes.extend_from_slice(&x.to_le_bytes());
        }
    }
    bytes
}

/// `min` and `max` of an accessor, component by component.
pub(crate) fn bounds<const N: usize>(rows: impl Iterator<Item = [f32; N]>) -> Value {
    let mut min = [f32::INFINITY; N];
    let mut max = [f32::NEG_INFINITY; N];
    for row in rows {
        for k in 0..N {
            min[k] = min[k].min(row[k]);
            max[k] = max[k].max(row[k]);
        }
    }
    json!({ "min": numbers(&min), "max": numbers(&max) })
}

/// Numbers that read back to the same `f32`.
pub(crate) fn numbers(values: &[f32]) -> Value {
    Value::Array(values.iter().map(|&x| json!(f64::from(x))).collect())
}
