//! A `.tcgs` file read at single timesteps: only the segments that are asked for are decoded.

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

/// A `.tcgs` file that is read at single timesteps.
///
/// Holds what all segments share, the segments used last ([`SegmentCache`], LRU), and of the last one used its
/// keypoints as floats.
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
    /// Counts and provenance.
    pub fn info(&self) -> &SceneInfo {
        self.archive.info()
    }

    /// Where the parts of the file lie.
    pub fn archive(&self) -> &Archive {
        &self.archive
    }

    /// Memory of the segments held, in bytes.
    pub fn cached_bytes(&self) -> usize {
        self.cache.bytes()
    }
}

impl<R: Read + Seek> SceneFile<R> {
    /// Reads what comes before the segments.
    ///
    /// - `source`: the file, from its first byte on
    /// - `max_segment_bytes`: of decoded segments held together, such as [`SegmentCache::DEFAULT_BYTES`]; the one in use is held even if it is larger
    ///
    /// # Errors
    /// [`DecodeError`] if the source cannot be read, is no whole `.tcgs` file of the one version known, is damaged
    /// before its segments, or asks for more than `limits` allow.
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

    /// A segment, decoded now if it is not held.
    ///
    /// # Errors
    /// [`DecodeError`] if it cannot be read, is damaged, or is larger than the limits allow.
    ///
    /// # Panics
    /// If there is no such segment.
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

    /// One timestep as floats, in stored form: the same as [`crate::CompactScene::at`]. Fastest where timesteps of a
    /// segment follow each other.
    ///
    /// # Errors
    /// As [`Self::segment`].
    ///
    /// # Panics
    /// If there is no such timestep.
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
