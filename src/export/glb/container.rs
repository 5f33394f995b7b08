//! The GLB container: one JSON chunk and one binary chunk of aligned views.

use crate::error::{Error, Result};
use serde_json::{Value, json};
use std::io::{self, Write};

/// Component types of glTF.
pub(crate) mod component {
    /// `UNSIGNED_BYTE`
    pub(crate) const U8: u32 = 5121;
    /// `BYTE`
    pub(crate) const I8: u32 = 5120;
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

/// Bytes of a view in pieces, made when they are written.
pub(crate) type Pieces = Box<dyn Iterator<Item = Result<Vec<u8>>>>;

/// Views and accessors in the order in which they are added.
#[derive(Default)]
pub(crate) struct Buffer {
    views: Vec<Value>,
    accessors: Vec<Value>,
    parts: Vec<Pieces>,
    length: usize,
}

impl Buffer {
    /// Adds a view; returns its index.
    pub(crate) fn view(&mut self, bytes: Vec<u8>, target: Target) -> usize {
        let length = bytes.len();
        self.part(Box::new(std::iter::once(Ok(bytes))), length, target)
    }

    /// Adds a view of `length` bytes in pieces; returns its index.
    pub(crate) fn pieces(&mut self, pieces: Pieces, length: usize) -> usize {
        self.part(pieces, length, Target::Other)
    }

    fn part(&mut self, part: Pieces, length: usize, target: Target) -> usize {
        let mut view = json!({ "buffer": 0, "byteOffset": self.length, "byteLength": length });
        match target {
            Target::Attributes(stride) => {
                view["target"] = json!(34962);
                view["byteStride"] = json!(stride);
            }
            Target::Indices => view["target"] = json!(34963),
            Target::Other => {}
        }
        self.length += length.next_multiple_of(4);
        self.parts.push(part);
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

    /// Adds an accessor of three floats that are zero but for some, whose views of indices and of values are given; returns its index.
    pub(crate) fn sparse(&mut self, (indices, values): (usize, usize), some: usize, count: usize, more: Value) -> usize {
        let indices = json!({ "bufferView": indices, "componentType": component::U32 });
        let sparse = json!({ "count": some, "indices": indices, "values": { "bufferView": values } });
        let mut accessor = json!({ "componentType": component::F32, "count": count, "type": "VEC3", "sparse": sparse });
        if let (Some(accessor), Value::Object(more)) = (accessor.as_object_mut(), more) {
            accessor.extend(more);
        }
        self.accessors.push(accessor);
        self.accessors.len() - 1
    }

    /// Writes the file: `document` with buffers, views and accessors added. `unwritable` makes an error of one of `out`; of kind
    /// `InvalidData` it is if the file would not fit the format's 4 GiB.
    pub(crate) fn write(self, mut document: Value, out: &mut impl Write, unwritable: impl Fn(io::Error) -> Error) -> Result<()> {
        document["buffers"] = json!([{ "byteLength": self.length }]);
        document["bufferViews"] = Value::Array(self.views);
        document["accessors"] = Value::Array(self.accessors);
        let mut json = serde_json::to_vec(&document).map_err(|e| unwritable(e.into()))?;
        json.resize(json.len().next_multiple_of(4), b' ');
        let total = 12 + 8 + json.len() as u64 + 8 + self.length as u64;
        let word = |n: u64| u32::try_from(n).map_err(|_| io::Error::new(io::ErrorKind::InvalidData, "a GLB holds at most 4 GiB"));
        let mut head = || -> io::Result<()> {
            out.write_all(b"glTF")?;
            for n in [2, word(total)?, word(json.len() as u64)?] {
                out.write_all(&n.to_le_bytes())?;
            }
            out.write_all(b"JSON")?;
            out.write_all(&json)?;
            out.write_all(&word(self.length as u64)?.to_le_bytes())?;
            out.write_all(b"BIN\0")
        };
        head().map_err(&unwritable)?;
        for pieces in self.parts {
            let mut length = 0usize;
            for bytes in pieces {
                let bytes = bytes?;
                length += bytes.len();
                out.write_all(&bytes).map_err(&unwritable)?;
            }
            out.write_all(&[0; 3][..length.next_multiple_of(4) - length]).map_err(&unwritable)?;
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
