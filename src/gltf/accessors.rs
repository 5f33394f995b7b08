//! Accessors → rows of numbers, within the bounds of their buffers.

use super::container::Buffer;
use super::document::{Accessor, Sparse};
use super::{Gltf, needs_extension};
use crate::error::{Error, Kind, Result};

/// A view: its bytes and the distance of rows, where it states one.
pub(super) struct View<'a> {
    pub(super) bytes: &'a [u8],
    stride: Option<usize>,
}

/// Types of numbers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Type {
    I8,
    U8,
    I16,
    U16,
    U32,
    F32,
}

impl Type {
    fn of(code: u32) -> Result<Self> {
        Ok(match code {
            5120 => Type::I8,
            5121 => Type::U8,
            5122 => Type::I16,
            5123 => Type::U16,
            5125 => Type::U32,
            5126 => Type::F32,
            _ => return Err(Error::malformed(format!("an accessor of component type {code}")).expected("5120 to 5126")),
        })
    }

    fn size(self) -> usize {
        match self {
            Type::I8 | Type::U8 => 1,
            Type::I16 | Type::U16 => 2,
            Type::U32 | Type::F32 => 4,
        }
    }

    /// What stands for 1 in normalized integers.
    fn full(self) -> f64 {
        match self {
            Type::I8 => 127.0,
            Type::U8 => 255.0,
            Type::I16 => 32767.0,
            Type::U16 => 65535.0,
            Type::U32 => f64::from(u32::MAX),
            Type::F32 => 1.0,
        }
    }
}

/// Rows of bytes, which are all there.
struct Rows<'a> {
    bytes: &'a [u8],
    stride: usize,
    count: usize,
    /// Bytes of one row.
    size: usize,
}

impl<'a> Rows<'a> {
    fn iter(&self) -> impl Iterator<Item = &'a [u8]> {
        let (bytes, stride, size) = (self.bytes, self.stride, self.size);
        (0..self.count).map(move |k| &bytes[k * stride..k * stride + size])
    }
}

impl Gltf {
    /// The bytes of a view.
    pub(super) fn view(&self, index: u32) -> Result<View<'_>> {
        let view = Self::get(&self.document.buffer_views, index, "buffer view")?;
        Self::get(&self.buffers, view.buffer, "buffer")?;
        let mut at = view.buffer as usize;
        let bytes = loop {
            match &self.buffers[at] {
                Buffer::Loaded(bytes) => break bytes,
                Buffer::Same(first) => at = *first,
                // A packed view points to a buffer that exists only once it is unpacked.
                Buffer::Missing(_) if view.extensions.as_ref().is_some_and(|e| e.meshopt.is_some()) => {
                    return Err(needs_extension("EXT_meshopt_compression"));
                }
                Buffer::Missing(error) => return Err(error.clone()),
            }
        };
        let end = view.byte_offset.checked_add(view.byte_length).filter(|&end| end <= bytes.len() as u64);
        let Some(end) = end else {
            return Err(Error::malformed(format!(
                "buffer view {index} is bytes {} to {} of a buffer that holds {}",
                view.byte_offset,
                view.byte_offset.saturating_add(view.byte_length),
                bytes.len()
            ))
            .at(format!("buffer view {index}"))
            .expected("a complete file")
            .hint("the file or one beside it seems to be cut short: copy it again"));
        };
        Ok(View {
            bytes: &bytes[view.byte_offset as usize..end as usize],
            stride: view.byte_stride.map(|s| s.min(1 << 30) as usize),
        })
    }

    fn rows(&self, view: u32, offset: u64, count: u64, size: usize) -> Result<Rows<'_>> {
        let View { bytes, stride } = self.view(view)?;
        let stride = stride.filter(|&s| s > 0).unwrap_or(size);
        let needed = match count {
            0 => 0,
            count => u128::from(offset) + u128::from(count - 1) * stride as u128 + size as u128,
        };
        if needed > bytes.len() as u128 || stride < size {
            return Err(Error::malformed(format!(
                "{count} rows of {size} bytes, {stride} bytes apart from byte {offset}, in a view of {} bytes",
                bytes.len()
            ))
            .at(format!("buffer view {view}")));
        }
        let bytes = if count == 0 { bytes } else { &bytes[offset as usize..] };
        Ok(Rows { bytes, stride, count: count as usize, size })
    }

    /// The accessor `index`.
    pub(crate) fn accessor(&self, index: u32) -> Result<&Accessor> {
        Self::get(&self.document.accessors, index, "accessor")
    }

    /// Rows of an accessor as real numbers; normalized integers become fractions. They may be infinite or not numbers.
    ///
    /// # Errors
    /// No such accessor, other columns than `N`, or rows that are not there.
    pub(crate) fn floats<const N: usize>(&self, index: u32) -> Result<Vec<[f64; N]>> {
        let accessor = self.accessor(index)?;
        let kind = Type::of(accessor.component_type).map_err(|e| e.at(format!("accessor {index}")))?;
        let scale = if accessor.normalized { kind.full() } else { 1.0 };
        let least = if accessor.normalized { -1.0 } else { f64::NEG_INFINITY };
        // A division rounds correctly where a product with the inverse does not.
        let scaled = move |x: f64| if scale == 1.0 { x } else { (x / scale).max(least) };
        self.table(index, move |bytes| match (kind, bytes) {
            (Type::F32, &[a, b, c, d]) => f64::from(f32::from_le_bytes([a, b, c, d])),
            (Type::U32, &[a, b, c, d]) => scaled(f64::from(u32::from_le_bytes([a, b, c, d]))),
            (Type::I16, &[a, b]) => scaled(f64::from(i16::from_le_bytes([a, b]))),
            (Type::U16, &[a, b]) => scaled(f64::from(u16::from_le_bytes([a, b]))),
            (Type::I8, &[a]) => scaled(f64::from(a as i8)),
            (Type::U8, &[a]) => scaled(f64::from(a)),
            _ => f64::NAN,
        })
    }

    /// Rows of an accessor as whole numbers from 0.
    ///
    /// # Errors
    /// As [`Gltf::floats`], and for signed or real numbers.
    pub(crate) fn integers<const N: usize>(&self, index: u32) -> Result<Vec<[u32; N]>> {
        let kind = Type::of(self.accessor(index)?.component_type).map_err(|e| e.at(format!("accessor {index}")))?;
        if !matches!(kind, Type::U8 | Type::U16 | Type::U32) {
            return Err(Error::malformed(format!("accessor {index} holds {kind:?} where indices are wanted"))
                .at(format!("accessor {index}"))
                .expected("unsigned integers"));
        }
        self.table(index, |bytes| match *bytes {
            [a, b, c, d] => u32::from_le_bytes([a, b, c, d]),
            [a, b] => u32::from(u16::from_le_bytes([a, b])),
            [a] => u32::from(a),
            _ => 0,
        })
    }

    fn table<T: Copy + Default, const N: usize>(&self, index: u32, read: impl Fn(&[u8]) -> T) -> Result<Vec<[T; N]>> {
        self.checked_table(index, read).map_err(|e| if e.place.is_none() { e.at(format!("accessor {index}")) } else { e })
    }

    fn checked_table<T: Copy + Default, const N: usize>(&self, index: u32, read: impl Fn(&[u8]) -> T) -> Result<Vec<[T; N]>> {
        let accessor = self.accessor(index)?;
        let component = Type::of(accessor.component_type)?.size();
        if accessor.shape.columns() != N || matches!(accessor.shape, super::Shape::Mat2 | super::Shape::Mat3) {
            return Err(Error::malformed(format!("accessor {index} has {:?} rows", accessor.shape))
                .expected(format!("{N} numbers per row")));
        }
        let size = N * component;
        let row = |bytes: &[u8]| -> [T; N] { std::array::from_fn(|k| read(&bytes[k * component..(k + 1) * component])) };
        let mut table: Vec<[T; N]> = match accessor.buffer_view {
            Some(view) => self.rows(view, accessor.byte_offset, accessor.count, size)?.iter().map(row).collect(),
            None if accessor.count <= self.bytes as u64 => vec![[T::default(); N]; accessor.count as usize],
            None => {
                return Err(Error::new(Kind::Refused, format!("accessor {index} announces {} rows of zeros", accessor.count))
                    .expected("no more than the file has bytes"));
            }
        };
        if let Some(sparse) = &accessor.sparse {
            let Sparse { count, indices, values } = &**sparse;
            if *count > accessor.count {
                return Err(Error::malformed(format!("accessor {index} replaces {count} of {} rows", accessor.count)));
            }
            let index_size = Type::of(indices.component_type)?.size();
            let places = self.rows(indices.buffer_view, indices.byte_offset, *count, index_size)?;
            let values = self.rows(values.buffer_view, values.byte_offset, *count, size)?;
            for (place, value) in places.iter().zip(values.iter()) {
                let place = place.iter().rev().fold(0u32, |sum, &b| sum << 8 | u32::from(b));
                let rows = table.len();
                let Some(target) = table.get_mut(place as usize) else {
                    return Err(Error::malformed(format!("accessor {index} replaces row {place} of {rows}")));
                };
                *target = row(value);
            }
        }
        Ok(table)
    }
}
