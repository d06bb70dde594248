//! The numbers of a glTF file: its buffers, and its accessors. All offsets and counts are checked against the available
//! bytes.

use std::collections::BTreeMap;
use std::io::Read;
use std::path::{Path, PathBuf};
use std::rc::Rc;

use base64::Engine;
use base64::prelude::BASE64_STANDARD;

use super::document::Document;
use crate::input;

/// The bytes of all buffers of a document.
pub struct Buffers<'a> {
    document: &'a Document,
    bytes: Vec<Rc<Vec<u8>>>,
}

impl<'a> Buffers<'a> {
    /// Reads the buffers.
    ///
    /// - `files`: the files that the document names
    /// - `chunk`: the buffer inside a `.glb` file
    pub fn open(document: &'a Document, files: &Files, mut chunk: Option<Vec<u8>>) -> Result<Self, String> {
        let mut bytes: Vec<Rc<Vec<u8>>> = Vec::new();
        let mut read = BTreeMap::new();
        for (i, buffer) in document.buffers.iter().enumerate() {
            let content = match &buffer.uri {
                None => {
                    let chunk = chunk.take();
                    chunk.ok_or_else(|| format!("has no bytes for buffer {i}, expected a chunk BIN"))?.into()
                }
                Some(uri) => match inline(uri) {
                    Some(text) => {
                        let decoded = BASE64_STANDARD.decode(text);
                        decoded.map_err(|error| format!("buffer {i}: {error}, expected base64"))?.into()
                    }
                    None => files.read(uri, &mut read)?,
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

    /// The numbers of an accessor.
    ///
    /// - `name`: name of the attribute, for messages
    /// - `components`: 1, 3 or 4
    /// - returns: `[count * components]`, and the step of normalised integers; 0 for floats
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

/// The text of a buffer embedded in the document.
fn inline(uri: &str) -> Option<&str> {
    uri.split_once(";base64,").filter(|(start, _)| start.starts_with("data:")).map(|(_, text)| text)
}

/// The files that a document names, each once.
pub struct Files {
    /// The file and its length, by its name in the document.
    by_name: BTreeMap<String, (PathBuf, u64)>,
}

impl Files {
    /// Finds the files, which lie beside the document or in a folder there. Reads none of them.
    ///
    /// - `path`: path of the document
    pub fn find(document: &Document, path: &Path) -> Result<Self, String> {
        let mut by_name = BTreeMap::new();
        for (i, buffer) in document.buffers.iter().enumerate() {
            let Some(uri) = buffer.uri.as_ref().filter(|uri| inline(uri).is_none()) else { continue };
            if by_name.contains_key(uri) {
                continue;
            }
            let is_inside = |part: &str| !part.is_empty() && part != "." && part != "..";
            if uri.contains([':', '\\']) || !uri.split('/').all(is_inside) {
                return Err(format!("has its numbers at {uri:?}, expected the name of a file beside it"));
            }
            let file = path.parent().unwrap_or(Path::new("")).join(uri);
            let failed = |error| format!("{}: {error}, expected a buffer", file.display());
            // Several names may lead to one file.
            let place = file.canonicalize().map_err(failed)?;
            if path.canonicalize().is_ok_and(|document| document == place) {
                return Err(format!("names itself as buffer {i}, expected another file"));
            }
            let length = place.metadata().map_err(failed)?.len();
            by_name.insert(uri.clone(), (place, length));
        }
        Ok(Self { by_name })
    }

    /// Length of all files together.
    pub fn num_bytes(&self) -> u64 {
        let places: BTreeMap<&PathBuf, u64> = self.by_name.values().map(|(place, length)| (place, *length)).collect();
        places.values().sum()
    }

    /// The bytes of a file.
    ///
    /// - `read`: files that were read before
    fn read<'a>(&'a self, name: &str, read: &mut BTreeMap<&'a Path, Rc<Vec<u8>>>) -> Result<Rc<Vec<u8>>, String> {
        let (place, length) = &self.by_name[name];
        if let Some(bytes) = read.get(&**place) {
            return Ok(Rc::clone(bytes));
        }
        let (file, _) = input::open(place).map_err(|error| error.to_string())?;
        let mut bytes = Vec::new();
        let taken = file.take(*length).read_to_end(&mut bytes);
        taken.map_err(|error| format!("{}: {error}, expected a buffer", place.display()))?;
        let bytes = Rc::new(bytes);
        read.insert(place, Rc::clone(&bytes));
        Ok(bytes)
    }
}
