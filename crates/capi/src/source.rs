//! The source of a scene's bytes.

use std::ffi::c_void;
use std::fs::File;
use std::io::{self, Cursor, Read, Seek, SeekFrom};

/// A file, bytes, or a function of the caller.
pub enum Source {
    File(File),
    Bytes(Cursor<Vec<u8>>),
    Callback(Callback),
}

impl Read for Source {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        match self {
            Self::File(file) => file.read(buffer),
            Self::Bytes(bytes) => bytes.read(buffer),
            Self::Callback(callback) => callback.read(buffer),
        }
    }
}

impl Seek for Source {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        match self {
            Self::File(file) => file.seek(to),
            Self::Bytes(bytes) => bytes.seek(to),
            Self::Callback(callback) => callback.seek(to),
        }
    }
}

type ReadRange = unsafe extern "C" fn(*mut c_void, u64, *mut u8, usize) -> i32;

/// A function of the caller that fills a buffer with a range of bytes.
pub struct Callback {
    read: ReadRange,
    user: *mut c_void,
    size: u64,
    place: u64,
}

impl Callback {
    pub fn new(read: ReadRange, user: *mut c_void, size: u64) -> Self {
        Self { read, user, size, place: 0 }
    }
}

impl Read for Callback {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let left = usize::try_from(self.size.saturating_sub(self.place)).unwrap_or(usize::MAX);
        let length = buffer.len().min(left);
        if length == 0 {
            return Ok(0);
        }
        // Safety: the buffer has room for `length` bytes; the rest is the contract of `tcgs_open_reader`.
        let status = unsafe { (self.read)(self.user, self.place, buffer.as_mut_ptr(), length) };
        if status != 0 {
            let (from, to) = (self.place, self.place + length as u64);
            return Err(io::Error::other(format!("the caller's function gave {status} for bytes {from} to {to}")));
        }
        self.place += length as u64;
        Ok(length)
    }
}

impl Seek for Callback {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        let place = match to {
            SeekFrom::Start(place) => Some(place),
            SeekFrom::End(by) => self.size.checked_add_signed(by),
            SeekFrom::Current(by) => self.place.checked_add_signed(by),
        };
        self.place = place.ok_or_else(|| io::Error::from(io::ErrorKind::InvalidInput))?;
        Ok(self.place)
    }
}
