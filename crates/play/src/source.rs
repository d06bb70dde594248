//! Where the bytes of a file come from: memory, a disk, or (in `web`) a network.
//!
//! A browser allows no blocking reads, so a source is asked for a range and then polled.

use std::fs::File;
use std::io::{Read, Seek, SeekFrom};
use std::ops::Range;
use std::path::Path;
use std::sync::Arc;

use tcgs_core::open_file;

/// Result of [`RangeSource::poll`].
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Piece {
    /// Nothing has arrived since the last poll.
    Waiting,
    /// The next bytes of the range, at least one.
    Bytes(Vec<u8>),
    /// No more bytes will come: the whole range was delivered, or the file ends within the range.
    End,
}

/// Why the bytes of a file are not available.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum SourceError {
    /// The server or the system refused. Another request would get the same answer.
    #[error("{what} cannot be read: {problem}")]
    Refused {
        /// Address or name of the file.
        what: String,
        /// Reason, as the server or the system gives it.
        problem: String,
    },
    /// There was no answer, or the connection broke off. Another request may succeed.
    #[error("the connection to {what} failed: {problem}")]
    Interrupted {
        /// Address or name of the file.
        what: String,
        /// Reason, as the server or the system gives it.
        problem: String,
    },
    /// A page gave something to open that is neither an address nor a file.
    #[error("this cannot be opened, expected an address or a Blob")]
    NoFile,
}

/// Delivers byte ranges of one file without blocking.
///
/// A player asks for one range at a time and polls until [`Piece::End`]. Implementations outside this crate can read
/// files from other places.
///
/// ```
/// use tcgs_play::{BytesSource, Piece, RangeSource};
/// let mut source = BytesSource::new(*b"0123456789");
/// source.request(3..6);
/// assert_eq!(source.poll()?, Piece::Bytes(b"345".to_vec()));
/// assert_eq!(source.poll()?, Piece::End);
/// # Ok::<(), tcgs_play::SourceError>(())
/// ```
pub trait RangeSource {
    /// Requests a range of the file. The request before, if there is one, is dropped.
    ///
    /// - `range`: bytes, not empty; may reach past the end of the file
    fn request(&mut self, range: Range<u64>);

    /// Takes the bytes of the requested range that arrived since the last call, in order.
    ///
    /// # Errors
    /// [`SourceError`] if the bytes are not available. The request is over then; the caller may make another.
    fn poll(&mut self) -> Result<Piece, SourceError>;

    /// Length of the whole file in bytes, as soon as it is known.
    fn length(&self) -> Option<u64>;
}

/// A file in memory.
#[derive(Clone, Debug)]
pub struct BytesSource {
    bytes: Arc<[u8]>,
    rest: Range<usize>,
}

impl BytesSource {
    /// - `bytes`: the whole file
    pub fn new(bytes: impl Into<Arc<[u8]>>) -> Self {
        Self { bytes: bytes.into(), rest: 0..0 }
    }
}

impl RangeSource for BytesSource {
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

/// A file on a disk. Polling reads it, and blocks as long as the disk does.
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
    /// [`SourceError::Refused`] if the file does not exist or cannot be read.
    pub fn open(path: &Path) -> Result<Self, SourceError> {
        let name = path.display().to_string();
        let opened = open_file(path).and_then(|file| Ok((file.metadata()?.len(), file)));
        let (length, file) =
            opened.map_err(|error| SourceError::Refused { what: name.clone(), problem: error.to_string() })?;
        Ok(Self { name, file, length, rest: 0..0 })
    }
}

impl RangeSource for FileSource {
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

/// The part of a range that lies within a file of this length.
fn clamp(range: &Range<u64>, length: u64) -> Range<usize> {
    range.start.min(length) as usize..range.end.min(length) as usize
}
