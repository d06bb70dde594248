//! The numbers of a glTF file: its buffers, and what accessors say of them. All places and counts are checked against the
//! bytes that are there.

use std::fs;
use std::path::Path;

use base64::Engine;
use base64::prelude::BASE64_STANDARD;

use super::document::Document;

/// The bytes of all buffers of a document.
pub struct Buffers<'a> {
    document: &'a Document,
    bytes: Vec<Vec<u8>>,
}

impl<'a> Buffers<'a> {
    /// Reads the buffers, or says what is wrong.
    ///
    /// - `path`: of the document, beside which its other files lie
    /// - `chunk`: the buffer inside a `.glb` file
    pub fn open(document: &'a Document, path: &Path, mut chunk: Option<Vec<u8>>) -> Result<Self, String> {
        let mut bytes = Vec::new();
        for (i, buffer) in document.buffers.iter().enumerate() {
            let content = match &buffer.uri {
                None => chunk.take().ok_or_else(|| format!("has no bytes for buffer {i}, expected a chunk BIN"))?,
                Some(uri) => match uri.split_once(";base64,") {
                    Some((start, text)) if start.starts_with("data:") => {
                        BASE64_STANDARD.decode(text).map_err(|error| format!("buffer {i}: {error}, expected base64"))?
                    }
                    _ => beside(path, uri)?,
                },
            };
            if content.len() < buffer.byte_length {
                let (found, expected) = (content.len(), buffer.byte_length);
                return Err(format!("has {found} bytes in buffer {i}, expected {expected}"));
            }
            bytes.push(content);
        }
        Ok(Self { document, bytes })
    }

    /// Length of all buffers together.
    pub fn num_bytes(&self) -> usize {
        self.bytes.iter().map(Vec::len).sum()
    }

    /// The numbers of an accessor, or what is wrong with it.
    ///
    /// - `name`: of the attribute, for messages
    /// - `components`: 1, 3 or 4
    /// - returns: `[count * components]`, and the step of integers that stand for a share of 1; 0 of floats
    pub fn read(&self, index: usize, name: &str, components: usize) -> Result<(Vec<f32>, f64), String> {
        let wrong = |problem: String| format!("{name} {problem}");
        let accessor = self.document.accessors.get(index).ok_or_else(|| wrong("has no accessor".into()))?;
        let shape = ["SCALAR", "VEC2", "VEC3", "VEC4"][components - 1];
        if accessor.shape != shape || accessor.sparse.is_some() {
            let sparse = if accessor.sparse.is_some() { "sparse " } else { "" };
            return Err(wrong(format!("is {sparse}{}, expected {shape}", accessor.shape)));
        }
        let (size, largest) = match accessor.component_type {
            5120 => (1, 127.0),
            5121 => (1, 255.0),
            5122 => (2, 32767.0),
            5123 => (2, 65535.0),
            5126 => (4, 0.0),
            other => return Err(wrong(format!("has components of type {other}, expected floats, bytes or shorts"))),
        };
        let view = accessor.buffer_view.and_then(|view| self.document.buffer_views.get(view));
        let view = view.ok_or_else(|| wrong("has no buffer view, expected one".into()))?;
        let row = size * components;
        let stride = view.byte_stride.unwrap_or(row).max(row);
        let bytes = || {
            let buffer = self.bytes.get(view.buffer)?;
            let view = buffer.get(view.byte_offset..view.byte_offset.checked_add(view.byte_length)?)?;
            let needed = stride.checked_mul(accessor.count.checked_sub(1)?)?.checked_add(row)?;
            view.get(accessor.byte_offset..)?.get(..needed)
        };
        let bytes =
            bytes().ok_or_else(|| wrong(format!("of {} rows ends early, expected a whole one", accessor.count)))?;
        let number = |bytes: &[u8]| match (accessor.component_type, bytes) {
            (5120, &[a]) => f64::from(i8::from_le_bytes([a])),
            (5121, &[a]) => f64::from(a),
            (5122, &[a, b]) => f64::from(i16::from_le_bytes([a, b])),
            (5123, &[a, b]) => f64::from(u16::from_le_bytes([a, b])),
            (_, &[a, b, c, d]) => f64::from(f32::from_le_bytes([a, b, c, d])),
            _ => unreachable!("a component of type {} has {} bytes", accessor.component_type, bytes.len()),
        };
        let is_share = accessor.normalized && largest > 0.0;
        let share = |x: f64| if is_share { (x / largest).max(-1.0) } else { x };
        let rows = bytes.chunks(stride).flat_map(|bytes| bytes[..row].chunks_exact(size));
        Ok((rows.map(|bytes| share(number(bytes)) as f32).collect(), if is_share { 1.0 / largest } else { 0.0 }))
    }
}

/// A file that a document names, which lies beside it or in a folder there.
fn beside(path: &Path, uri: &str) -> Result<Vec<u8>, String> {
    let is_inside = |part: &str| !part.is_empty() && part != "." && part != "..";
    if uri.contains([':', '\\']) || !uri.split('/').all(is_inside) {
        return Err(format!("has its numbers at {uri:?}, expected the name of a file beside it"));
    }
    let file = path.parent().unwrap_or(Path::new("")).join(uri);
    fs::read(&file).map_err(|error| format!("{}: {error}, expected a buffer", file.display()))
}
