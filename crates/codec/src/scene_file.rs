//! Random access to the timesteps of a `.tcgs` file: a segment is read and decoded when one of its timesteps is needed.
//!
//! Input comes from any `Read + Seek`. [`Archive`] offers the same without input of its own, for callers that fetch
//! ranges of bytes.

use std::io::{Read, Seek, SeekFrom};
use std::ops::Range;
use std::sync::Arc;

use tcgs_core::{Gaussians, Layout, SceneReader};

use crate::bitstream::{Archive, Opening, Sampler, Segment, end_of_file};
use crate::cache::{Eviction, SegmentCache};
use crate::compact::SceneInfo;
use crate::error::DecodeError;
use crate::limits::DecodeLimits;

/// Bytes read at first; the tables of most files fit.
const OPENING_BYTES: u64 = 1 << 14;

/// A `.tcgs` file with random access to timesteps.
///
/// Memory holds the shared layers, the most recently used segments ([`SegmentCache`], LRU), and the dequantised
/// keypoints of the segment used last.
///
/// ```
/// use std::io::Cursor;
/// use tcgs_codec::{BitMap, CompressSettings, DecodeLimits, SceneFile, SceneInfo, SegmentCache, compress, encode};
/// use tcgs_core::{DynamicGaussians, Gaussians};
/// let mut scene = DynamicGaussians::default();
/// scene.push(Gaussians::zeros(3));
/// scene.push(Gaussians::zeros(3));
/// let settings = CompressSettings::default();
/// let compact = compress(&scene, &BitMap::uniform(3, 16, 6), None, SceneInfo::of(&scene), &settings)?;
///
/// let file = Cursor::new(encode(&compact)?); // or a `std::fs::File`
/// let mut file = SceneFile::open(file, &DecodeLimits::default(), SegmentCache::DEFAULT_BYTES)?;
/// assert_eq!(file.at(1)?, compact.at(1));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub struct SceneFile<R> {
    source: R,
    layout: Arc<Layout>,
    archive: Archive,
    cache: SegmentCache,
    /// Index of a segment and its keypoints as floats.
    sampler: Option<(usize, Sampler)>,
}

impl<R> SceneFile<R> {
    /// Counts and provenance of the scene.
    pub fn info(&self) -> &SceneInfo {
        self.archive.info()
    }

    /// Table of contents of the file, and its shared layers.
    pub fn archive(&self) -> &Archive {
        &self.archive
    }

    /// Memory of the segments in the cache, in bytes.
    pub fn cached_bytes(&self) -> usize {
        self.cache.bytes()
    }
}

impl<R: Read + Seek> SceneFile<R> {
    /// Opens a file: reads the header and the shared layers, and no segment.
    ///
    /// - `source`: the file, from its first byte on
    /// - `limits`: bounds on memory and counts
    /// - `max_segment_bytes`: bound on the memory of decoded segments, such as [`SegmentCache::DEFAULT_BYTES`]; a
    ///   single segment may exceed the bound
    ///
    /// # Errors
    /// - [`DecodeError::Io`] if the source cannot be read
    /// - [`DecodeError::Format`] if the source is no `.tcgs` file, has another length than its header says, or is
    ///   damaged before its segments
    /// - [`DecodeError::Version`] if the file is of another version
    /// - [`DecodeError::Limit`] if the file exceeds `limits`
    pub fn open(mut source: R, limits: &DecodeLimits, max_segment_bytes: usize) -> Result<Self, DecodeError> {
        let length = source.seek(SeekFrom::End(0))?;
        let mut start = read(&mut source, 0..OPENING_BYTES.min(length))?;
        let mut archive = loop {
            match Archive::open(&start, limits)? {
                Opening::Ready(archive) => break *archive,
                Opening::More(needed) if needed <= length => {
                    let rest = read(&mut source, start.len() as u64..needed)?;
                    start.extend(rest);
                }
                Opening::More(_) => return Err(end_of_file(length, "the file ends early")),
            }
        };
        if archive.file_bytes() != length {
            let is_short = length < archive.file_bytes();
            return Err(end_of_file(length, if is_short { "the file ends early" } else { "bytes are left over" }));
        }
        let shared = read(&mut source, archive.shared_range(archive.num_layers()))?;
        archive.read_shared(&shared)?;
        let cache = SegmentCache::new(archive.num_segments(), max_segment_bytes);
        Ok(Self { source, layout: Layout::base(), archive, cache, sampler: None })
    }

    /// The segment of index `segment`, from the cache or else read and decoded.
    ///
    /// # Errors
    /// [`DecodeError`] if the segment cannot be read, is damaged, or exceeds the limits.
    ///
    /// # Panics
    /// If `segment` is not below [`Archive::num_segments`].
    pub fn segment(&mut self, segment: usize) -> Result<Arc<Segment>, DecodeError> {
        if let Some(held) = self.cache.recall(segment) {
            return Ok(held.clone());
        }
        let bytes = read(&mut self.source, self.archive.segment_range(segment, self.archive.num_layers()))?;
        self.cache.make_room(segment, Eviction::LeastRecentlyUsed);
        let decoded = Arc::new(self.archive.read_segment(segment, &bytes)?);
        self.cache.insert(decoded.clone(), Eviction::LeastRecentlyUsed);
        Ok(decoded)
    }

    /// One timestep as floats, in stored form: the same values as [`crate::CompactScene::at`] gives. Fastest if
    /// successive calls ask for successive timesteps of one segment.
    ///
    /// # Errors
    /// As [`Self::segment`].
    ///
    /// # Panics
    /// If `timestep` is not below [`SceneInfo::num_timesteps`].
    pub fn at(&mut self, timestep: usize) -> Result<Gaussians, DecodeError> {
        let index = self.archive.segment_at(timestep);
        if self.sampler.as_ref().is_none_or(|(held, _)| *held != index) {
            self.sampler = None;
            let segment = self.segment(index)?;
            self.sampler = Some((index, Sampler::new(&segment)));
        }
        let (_, sampler) = self.sampler.as_mut().expect("a sampler that was just made");
        Ok(sampler.at(timestep).clone())
    }
}

impl<R: Read + Seek> SceneReader for SceneFile<R> {
    type Error = DecodeError;

    fn layout(&self) -> &Arc<Layout> {
        &self.layout
    }

    fn num_gaussians(&self) -> usize {
        self.info().num_gaussians as usize
    }

    fn num_timesteps(&self) -> usize {
        self.info().num_timesteps as usize
    }

    fn span(&self, timestep: usize) -> Range<usize> {
        self.archive.timesteps(self.archive.segment_at(timestep))
    }

    fn at(&mut self, timestep: usize) -> Result<Gaussians, DecodeError> {
        SceneFile::at(self, timestep)
    }
}

/// Bytes of a source; fewer if it ends.
fn read(source: &mut (impl Read + Seek), range: Range<u64>) -> Result<Vec<u8>, DecodeError> {
    source.seek(SeekFrom::Start(range.start))?;
    let mut bytes = Vec::new();
    source.take(range.end - range.start).read_to_end(&mut bytes)?;
    Ok(bytes)
}
