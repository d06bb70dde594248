//! Where a file's bytes come from: memory, a disk, or (in `web`) a network.
//!
//! A source never blocks for long and never calls back: it is asked for a range, then polled.

use std::fs::File;
use std::io::{Read, Seek, SeekFrom};
use std::ops::Range;
use std::path::Path;
use std::sync::Arc;

/// What a source has to say.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Piece {
    /// Nothing new yet.
    Waiting,
    /// The next bytes of the range, at least one.
    Bytes(Vec<u8>),
    /// No more will come: the range was delivered, or the file ends within it.
    End,
}

/// Why bytes cannot be had.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum SourceError {
    /// The answer was no. Asking again would not help.
    #[error("{what} cannot be read: {problem}")]
    Refused {
        /// Address or name.
        what: String,
        /// Why.
        problem: String,
    },
    /// There was no answer, or it broke off. Asking again may help.
    #[error("the connection to {what} failed: {problem}")]
    Interrupted {
        /// Address or name.
        what: String,
        /// Why.
        problem: String,
    },
}

/// Delivers ranges of a file.
pub trait Source {
    /// Asks for bytes; whatever was asked for before is forgotten.
    ///
    /// - `range`: not empty; may reach past the end of the file
    fn request(&mut self, range: Range<u64>);

    /// What has arrived of the range since the last call, in order.
    ///
    /// # Errors
    /// [`SourceError`] if the bytes cannot be had; the request is over then.
    fn poll(&mut self) -> Result<Piece, SourceError>;

    /// Length of the whole file, as soon as it is known.
    fn length(&self) -> Option<u64>;
}

/// A file in memory.
#[derive(Clone, Debug)]
pub struct BytesSource {
    bytes: Arc<[u8]>,
    rest: Range<usize>,
}

impl BytesSource {
    /// A source of these bytes.
    pub fn new(bytes: impl Into<Arc<[u8]>>) -> Self {
        Self { bytes: bytes.into(), rest: 0..0 }
    }
}

impl Source for BytesSource {
    fn request(&mut self, range: Range<u64>) {
        self.rest = clamp(&range, self.bytes.len() as u64);
    }

    fn poll(&mut self) -> Result<Piece, SourceError> {
        let range = std::mem::take(&mut self.rest);
        Ok(if range.is_empty() { Piece::End } else { Piece::Bytes(self.bytes[range].to_vec()) })
    }

    fn length(&self) -> Option<u64> {
        Some(self.bytes.len() as u64)
    }
}

/// A file on a disk.
#[derive(Debug)]
pub struct FileSource {
    name: String,
    file: File,
    length: u64,
    rest: Range<usize>,
}

impl FileSource {
    /// Opens a file.
    ///
    /// # Errors
    /// [`SourceError`] if it cannot be read.
    pub fn open(path: &Path) -> Result<Self, SourceError> {
        let name = path.display().to_string();
        let opened = File::open(path).and_then(|file| Ok((file.metadata()?.len(), file)));
        let (length, file) =
            opened.map_err(|error| SourceError::Refused { what: name.clone(), problem: error.to_string() })?;
        Ok(Self { name, file, length, rest: 0..0 })
    }
}

impl Source for FileSource {
    fn request(&mut self, range: Range<u64>) {
        self.rest = clamp(&range, self.length);
    }

    fn poll(&mut self) -> Result<Piece, SourceError> {
        let range = std::mem::take(&mut self.rest);
        if range.is_empty() {
            return Ok(Piece::End);
        }
        let mut bytes = vec![0; range.len()];
        let read = self.file.seek(SeekFrom::Start(range.start as u64)).and_then(|_| self.file.read_exact(&mut bytes));
        match read {
            Ok(()) => Ok(Piece::Bytes(bytes)),
            Err(error) => Err(SourceError::Refused { what: self.name.clone(), problem: error.to_string() }),
        }
    }

    fn length(&self) -> Option<u64> {
        Some(self.length)
    }
}

fn clamp(range: &Range<u64>, length: u64) -> Range<usize> {
    range.start.min(length) as usize..range.end.min(length) as usize
}
