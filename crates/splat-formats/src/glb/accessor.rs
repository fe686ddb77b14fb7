//! Numbers that an accessor of a glTF file describes.

use super::json::Root;
use super::{FLOAT, UNSIGNED_BYTE};
use crate::Rule;

/// A view of one attribute in the binary part.
pub(super) struct Attribute<'a> {
    bytes: &'a [u8],
    pub(super) count: usize,
    stride: usize,
    component: u32,
    normalized: bool,
}

impl<'a> Attribute<'a> {
    /// The accessor of this index, which must have the type `kind` of `width` components.
    pub(super) fn new(
        root: &Root,
        binary: &'a [u8],
        name: &str,
        index: usize,
        (kind, width): (&str, usize),
    ) -> Result<Self, Rule> {
        let accessor = root.accessors.get(index).ok_or(Rule::Index { what: "accessor", index })?;
        if accessor.sparse.is_some() || accessor.buffer_view.is_none() {
            return Err(Rule::Unsupported {
                what: "accessor without a buffer view, or sparse,",
                found: name.into(),
            });
        }
        let size = match accessor.component_type {
            5120 | UNSIGNED_BYTE => 1,
            5122 | 5123 => 2,
            FLOAT => 4,
            _ => 0,
        };
        if size == 0 || accessor.kind != kind {
            let found = format!("{} of component type {}", accessor.kind, accessor.component_type);
            return Err(Rule::Accessor { index, found, name: name.into() });
        }
        if accessor.count == 0 {
            return Err(Rule::Empty);
        }
        let view_index = accessor.buffer_view.unwrap_or(usize::MAX);
        let view = root
            .buffer_views
            .get(view_index)
            .ok_or(Rule::Index { what: "buffer view", index: view_index })?;
        let buffer = root.buffers.get(view.buffer).filter(|_| view.buffer == 0);
        let buffer = buffer.ok_or(Rule::Index { what: "buffer", index: view.buffer })?;
        if buffer.uri.is_some() {
            return Err(Rule::Unsupported { what: "buffer outside the file:", found: "uri".into() });
        }
        let whole = slice(binary, view.byte_offset, view.byte_length);
        let whole = whole.ok_or(Rule::Range { what: "buffer view", index: view_index })?;
        let element = size * width as u64;
        let stride = view.byte_stride.unwrap_or(element);
        let length = (accessor.count - 1).checked_mul(stride).and_then(|bytes| bytes.checked_add(element));
        let bytes = length
            .filter(|_| stride >= element)
            .and_then(|length| slice(whole, accessor.byte_offset, length));
        Ok(Self {
            bytes: bytes.ok_or(Rule::Range { what: "accessor", index })?,
            // Not more than there are bytes.
            count: accessor.count as usize,
            stride: stride as usize,
            component: accessor.component_type,
            normalized: accessor.normalized,
        })
    }

    /// The numbers of a Gaussian.
    pub(super) fn get<const N: usize>(&self, index: usize) -> [f32; N] {
        let bytes = &self.bytes[index * self.stride..];
        let short = |i: usize| [bytes[2 * i], bytes[2 * i + 1]];
        std::array::from_fn(|i| {
            let (value, most) = match self.component {
                5120 => (f32::from(bytes[i].cast_signed()), 127.0),
                UNSIGNED_BYTE => (f32::from(bytes[i]), 255.0),
                5122 => (f32::from(i16::from_le_bytes(short(i))), 32767.0),
                5123 => (f32::from(u16::from_le_bytes(short(i))), 65535.0),
                _ => return f32::from_le_bytes(std::array::from_fn(|k| bytes[4 * i + k])),
            };
            if self.normalized { (value / most).max(-1.0) } else { value }
        })
    }
}

fn slice(bytes: &[u8], offset: u64, length: u64) -> Option<&[u8]> {
    let (offset, length) = (usize::try_from(offset).ok()?, usize::try_from(length).ok()?);
    bytes.get(offset..offset.checked_add(length)?)
}
