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
use crate::error::{DecodeError, ENDS_EARLY};
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
    /// Counts of what can be read.
    info: SceneInfo,
    /// Layers that can be read.
    num_layers: usize,
    loss: Option<Loss>,
    layout: Arc<Layout>,
    archive: Archive,
    cache: SegmentCache,
    /// Index of a segment and its keypoints as floats.
    sampler: Option<(usize, Sampler)>,
}

/// What a file that was cut has lost.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Loss {
    /// Bytes of the file.
    pub bytes: u64,
    /// Bytes that the file had.
    pub bytes_before: u64,
    /// Timesteps that the file had; [`SceneFile::info`] counts those that are left.
    pub timesteps_before: u32,
    /// Gaussians that the file had; [`SceneFile::info`] counts those that are left.
    pub gaussians_before: u32,
}

impl<R> SceneFile<R> {
    /// Provenance of the scene, and counts of what can be read: those of [`Archive::info`], or fewer of a file that was
    /// cut ([`Self::recover`]).
    pub fn info(&self) -> &SceneInfo {
        &self.info
    }

    /// What the file has lost; none of a whole file.
    pub fn loss(&self) -> Option<&Loss> {
        self.loss.as_ref()
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
    pub fn open(source: R, limits: &DecodeLimits, max_segment_bytes: usize) -> Result<Self, DecodeError> {
        let file = Self::recover(source, limits, max_segment_bytes)?;
        file.loss.map_or(Ok(file), |loss| Err(end_of_file(loss.bytes, ENDS_EARLY)))
    }

    /// Opens a file that may have been cut, such as by a transfer that broke off, for what is whole of it: the
    /// timesteps of the segments that are whole; if the first segment is not, its timesteps with the Gaussians of the
    /// layers that are. A file that was not cut is read as by [`Self::open`].
    ///
    /// ```
    /// use std::io::Cursor;
    /// use tcgs_codec::{BitMap, CompressSettings, DecodeLimits, SceneFile, SceneInfo, SegmentCache, compress, encode};
    /// use tcgs_core::{DynamicGaussians, Gaussians};
    /// let mut scene = DynamicGaussians::default();
    /// scene.push(Gaussians::zeros(3));
    /// scene.push(Gaussians::zeros(3));
    /// let settings = CompressSettings { segment_length: Some(1), ..CompressSettings::default() };
    /// let compact = compress(&scene, &BitMap::uniform(3, 16, 6), None, SceneInfo::of(&scene), &settings)?;
    ///
    /// let mut cut = encode(&compact)?;
    /// cut.pop();
    /// let mut file = SceneFile::recover(Cursor::new(cut), &DecodeLimits::default(), SegmentCache::DEFAULT_BYTES)?;
    /// assert_eq!(file.loss().map(|loss| loss.bytes_before - loss.bytes), Some(1));
    /// assert_eq!(file.at(0)?, compact.at(0));
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    ///
    /// # Errors
    /// As [`Self::open`], of a file that was cut only if nothing of its first segment is whole.
    pub fn recover(mut source: R, limits: &DecodeLimits, max_segment_bytes: usize) -> Result<Self, DecodeError> {
        let length = source.seek(SeekFrom::End(0))?;
        let mut start = read(&mut source, 0..OPENING_BYTES.min(length))?;
        let mut archive = loop {
            match Archive::open(&start, limits)? {
                Opening::Ready(archive) => break *archive,
                Opening::More(needed) if needed <= length => {
                    let rest = read(&mut source, start.len() as u64..needed)?;
                    start.extend(rest);
                }
                Opening::More(_) => return Err(end_of_file(length, ENDS_EARLY)),
            }
        };
        if archive.file_bytes() < length {
            return Err(end_of_file(length, "bytes are left over"));
        }
        let shared = read(&mut source, archive.shared_range(archive.num_layers()))?;
        archive.read_shared(&shared)?;
        let whole = archive.info();
        let loss = (length < archive.file_bytes()).then(|| Loss {
            bytes: length,
            bytes_before: archive.file_bytes(),
            timesteps_before: whole.num_timesteps,
            gaussians_before: whole.num_gaussians,
        });
        let (num_layers, num_timesteps) =
            what_is_whole(&archive, length).ok_or_else(|| end_of_file(length, ENDS_EARLY))?;
        let num_gaussians = archive.layers()[..num_layers].iter().sum();
        let info = SceneInfo { num_gaussians, num_timesteps: num_timesteps as u32, ..whole.clone() };
        let cache = SegmentCache::new(archive.num_segments(), max_segment_bytes);
        Ok(Self { source, info, num_layers, loss, layout: Layout::base(), archive, cache, sampler: None })
    }

    /// The segment of index `segment`, from the cache or else read and decoded.
    ///
    /// # Errors
    /// [`DecodeError`] if the segment cannot be read, is damaged, or exceeds the limits.
    ///
    /// # Panics
    /// If `segment` is not below [`Archive::num_segments`]. Of a file that was cut, a segment beyond [`Self::info`] has
    /// fewer layers than the others.
    pub fn segment(&mut self, segment: usize) -> Result<Arc<Segment>, DecodeError> {
        if let Some(held) = self.cache.recall(segment) {
            return Ok(held.clone());
        }
        let bytes = read(&mut self.source, self.archive.segment_range(segment, self.num_layers))?;
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

/// Layers and timesteps of which all bytes are there, if there are any.
///
/// - `archive`: with the shared layers that are whole
/// - `length`: bytes of the file
fn what_is_whole(archive: &Archive, length: u64) -> Option<(usize, usize)> {
    // A segment in which nothing moves has no bytes, wherever it lies.
    let is_whole = |segment: usize, layers: usize| {
        let range = archive.segment_range(segment, layers);
        layers <= archive.layers_read() && (range.is_empty() || range.end <= length)
    };
    let all = archive.num_layers();
    let segments = (0..archive.num_segments()).take_while(|&segment| is_whole(segment, all)).count();
    if segments > 0 {
        return Some((all, archive.timesteps(segments - 1).end));
    }
    let layers = (1..all).take_while(|&layers| is_whole(0, layers)).count();
    (layers > 0).then(|| (layers, archive.timesteps(0).end))
}

/// Bytes of a source; fewer if it ends.
fn read(source: &mut (impl Read + Seek), range: Range<u64>) -> Result<Vec<u8>, DecodeError> {
    source.seek(SeekFrom::Start(range.start))?;
    let mut bytes = Vec::new();
    source.take(range.end - range.start).read_to_end(&mut bytes)?;
    Ok(bytes)
}
