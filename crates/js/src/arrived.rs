//! The bytes of a file that have arrived.

use std::cell::RefCell;
use std::collections::BTreeMap;
use std::io::{self, Read, Seek, SeekFrom};
use std::ops::Range;
use std::rc::Rc;

/// Least number of bytes of a request, since each request has a cost of its own.
const AT_LEAST: u64 = 1 << 18;

/// A file whose parts arrive over time. Clones share the parts, but each has its own position in the file.
///
/// ```
/// use std::io::Read;
/// use tcgs_js::Arrived;
/// let (mut file, mut word) = (Arrived::new(10), [0; 3]);
/// assert!(file.read_exact(&mut word).is_err());
/// assert_eq!(file.missing(), Some(0..10));
/// file.arrive(0, b"0123456789".to_vec());
/// file.read_exact(&mut word).unwrap();
/// assert_eq!(&word, b"012");
/// ```
#[derive(Clone, Debug)]
pub struct Arrived {
    length: u64,
    place: u64,
    parts: Rc<RefCell<Parts>>,
}

#[derive(Debug, Default)]
struct Parts {
    /// By first byte; parts may overlap.
    by_start: BTreeMap<u64, Vec<u8>>,
    missing: Option<Range<u64>>,
}

impl Arrived {
    /// A file without any parts.
    ///
    /// - `length`: bytes of the whole file
    pub fn new(length: u64) -> Self {
        Self { length, place: 0, parts: Rc::default() }
    }

    /// Adds a part of the file.
    ///
    /// - `offset`: its first byte in the file
    pub fn arrive(&self, offset: u64, bytes: Vec<u8>) {
        let parts = &mut *self.parts.borrow_mut();
        parts.missing = None;
        // A longer part with the same start contains this one.
        if parts.by_start.get(&offset).is_none_or(|held| held.len() < bytes.len()) {
            parts.by_start.insert(offset, bytes);
        }
    }

    /// The missing bytes of the last read, extended by bytes that are likely to be needed next. `None` if no byte was
    /// missing.
    pub fn missing(&self) -> Option<Range<u64>> {
        self.parts.borrow().missing.clone()
    }

    /// Forgets all parts, to free memory.
    pub fn forget(&self) {
        self.parts.borrow_mut().by_start.clear();
    }

    /// Number of bytes of all parts.
    pub fn held(&self) -> usize {
        self.parts.borrow().by_start.values().map(Vec::len).sum()
    }
}

impl Read for Arrived {
    /// Fails with [`io::ErrorKind::WouldBlock`] if the next byte has not arrived.
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let left = self.length.saturating_sub(self.place);
        if buffer.is_empty() || left == 0 {
            return Ok(0);
        }
        let parts = &mut *self.parts.borrow_mut();
        let place = self.place;
        let rest_of = |(start, bytes): (&u64, &Vec<u8>)| {
            let from = usize::try_from(place - start).ok()?;
            (from < bytes.len()).then_some((*start, from))
        };
        let Some((start, from)) = parts.by_start.range(..=place).rev().find_map(rest_of) else {
            let wanted = (buffer.len() as u64).max(AT_LEAST).min(left);
            parts.missing = Some(place..place + wanted);
            return Err(io::ErrorKind::WouldBlock.into());
        };
        let bytes = &parts.by_start[&start][from..];
        let count = bytes.len().min(buffer.len()).min(usize::try_from(left).unwrap_or(usize::MAX));
        buffer[..count].copy_from_slice(&bytes[..count]);
        self.place += count as u64;
        Ok(count)
    }
}

impl Seek for Arrived {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        let place = match to {
            SeekFrom::Start(place) => Some(place),
            SeekFrom::End(by) => self.length.checked_add_signed(by),
            SeekFrom::Current(by) => self.place.checked_add_signed(by),
        };
        self.place = place.ok_or_else(|| io::Error::from(io::ErrorKind::InvalidInput))?;
        Ok(self.place)
    }
}

#[cfg(test)]
mod tests {
    use tcgs_codec::{DecodeError, DecodeLimits, SceneFile, SegmentCache};

    use super::*;

    /// Repeats a call until no bytes are missing, with at most `step` bytes at a time.
    fn patiently<T>(
        file: &[u8],
        arrived: &Arrived,
        step: usize,
        mut call: impl FnMut() -> Result<T, DecodeError>,
    ) -> T {
        for _ in 0..10_000 {
            match call() {
                Ok(done) => return done,
                Err(DecodeError::Io(_)) => {
                    let missing = arrived.missing().expect("bytes that lack");
                    let start = missing.start as usize;
                    let end = (start + step).min(missing.end as usize);
                    arrived.arrive(missing.start, file[start..end].to_vec());
                }
                Err(error) => panic!("{error}"),
            }
        }
        panic!("never enough");
    }

    #[test]
    fn a_scene_that_arrives_in_pieces_is_the_scene() {
        let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../../testdata/bitstream/v2");
        let mut num_files = 0;
        for path in std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()) {
            if path.extension().is_none_or(|extension| extension != "tcgs") {
                continue;
            }
            num_files += 1;
            let file = std::fs::read(&path).unwrap();
            let limits = DecodeLimits::default();
            let mut whole = SceneFile::open(io::Cursor::new(&file), &limits, SegmentCache::DEFAULT_BYTES).unwrap();
            for step in [61, 1 << 20] {
                let arrived = Arrived::new(file.len() as u64);
                let open = || SceneFile::open(arrived.clone(), &limits, SegmentCache::DEFAULT_BYTES);
                let mut scene = patiently(&file, &arrived, step, open);
                for t in 0..whole.info().num_timesteps as usize {
                    let found = patiently(&file, &arrived, step, || scene.at(t));
                    assert_eq!(found, whole.at(t).unwrap(), "{}, timestep {t}", path.display());
                    arrived.forget();
                }
                assert_eq!(arrived.held(), 0);
            }
        }
        assert!(num_files > 5, "{num_files} vectors");
    }

    #[test]
    fn a_read_asks_for_what_lies_ahead_and_not_beyond_the_end() {
        let mut file = Arrived::new(1 << 20);
        file.seek(SeekFrom::End(-10)).unwrap();
        assert_eq!(file.read(&mut [0; 4]).unwrap_err().kind(), io::ErrorKind::WouldBlock);
        assert_eq!(file.missing(), Some((1 << 20) - 10..1 << 20));
        file.seek(SeekFrom::Start(100)).unwrap();
        assert!(file.read(&mut [0; 4]).is_err());
        assert_eq!(file.missing(), Some(100..100 + AT_LEAST));
        file.arrive(90, vec![7; 12]);
        assert_eq!((file.missing(), file.read(&mut [0; 4]).unwrap()), (None, 2));
        file.seek(SeekFrom::End(5)).unwrap();
        assert_eq!(file.read(&mut [0; 4]).unwrap(), 0);
    }
}
