//! Random access to the timesteps of a `.tcgs` file: a segment is read and decoded when one of its timesteps is needed.
//!
//! Input comes from any `Read + Seek`. [`Archive`] offers the same without its own input, for callers that fetch ranges
//! of bytes.

use std::collections::BTreeMap;
use std::io::{Read, Seek, SeekFrom};
use std::ops::Range;
use std::sync::Arc;

use tcgs_core::{Gaussians, Layout, SceneReader};

use crate::attached::{Light, MAX_BYTES, read_background, read_light};
use crate::bitstream::{Archive, Cohort, FileInfo, Opening, Sampler, Segment, end_of_file, other_attributes};
use crate::cache::SegmentCache;
use crate::compact::SceneInfo;
use crate::error::{DecodeError, ENDS_EARLY};
use crate::limits::DecodeLimits;

/// Number of bytes read first; the tables of most files fit.
const OPENING_BYTES: u64 = 1 << 14;

/// A `.tcgs` file with random access to timesteps.
///
/// Memory holds only the cohorts that live at the timestep read last. For these it holds the shared layers, the most
/// recently used segments ([`SegmentCache`], LRU), and the dequantised keypoints of the segment used last.
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
    /// Description of the readable part of the scene.
    info: SceneInfo,
    /// Readable layers of the only cohort; `None` if all are.
    num_layers: Option<usize>,
    loss: Option<Loss>,
    layout: Arc<Layout>,
    archive: Archive,
    /// Bound on the memory of a cohort's segments.
    max_segment_bytes: usize,
    /// Upper bound on the number of Gaussians that live at a timestep.
    max_gaussians: usize,
    /// The cohorts that live at the timestep read last.
    cohorts: BTreeMap<usize, OpenCohort>,
    light: Light,
}

/// A cohort with its shared layers.
struct OpenCohort {
    cohort: Cohort,
    cache: SegmentCache,
    /// Index of the segment used last, and its keypoints as floats.
    sampler: Option<(usize, Sampler)>,
}

/// Extent of a file before and after it was cut.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Loss {
    /// Bytes of the cut file.
    pub bytes: u64,
    /// Bytes of the whole file.
    pub bytes_before: u64,
    /// Timesteps of the whole file; [`SceneFile::info`] counts those that are left.
    pub timesteps_before: u32,
    /// Gaussians of the whole file; [`SceneFile::info`] counts those that are left.
    pub gaussians_before: u32,
}

impl<R> SceneFile<R> {
    /// Provenance of the scene, and counts of its readable part. The counts are those of [`Archive::info`]; for a file
    /// that was cut ([`Self::recover`]) they are smaller.
    pub fn info(&self) -> &SceneInfo {
        &self.info
    }

    /// Extent of the loss; `None` for a whole file.
    pub fn loss(&self) -> Option<&Loss> {
        self.loss.as_ref()
    }

    /// The archive from the start of the file.
    pub fn archive(&self) -> &Archive {
        &self.archive
    }

    /// Which columns the Gaussians have.
    pub fn layout(&self) -> &Arc<Layout> {
        &self.layout
    }

    /// Memory of the segments in the caches, in bytes.
    pub fn cached_bytes(&self) -> usize {
        self.cohorts.values().map(|open| open.cache.bytes()).sum()
    }
}

impl<R: Read + Seek> SceneFile<R> {
    /// Opens a file. Reads the description of the scene and the shared layers of the first cohort, and no segment.
    ///
    /// - `source`: the file, from its first byte on
    /// - `limits`: bounds on memory and counts
    /// - `max_segment_bytes`: bound on the memory of the decoded segments, for each cohort that lives at a timestep,
    ///   such as [`SegmentCache::DEFAULT_BYTES`]; a single segment may exceed the bound
    ///
    /// # Errors
    /// - [`DecodeError::Io`] if the source cannot be read
    /// - [`DecodeError::Format`] if the source is not a `.tcgs` file, has another length than its header says, or is
    ///   damaged before its segments or in application data of at most 1 MiB
    /// - [`DecodeError::Version`] if the file is of another version
    /// - [`DecodeError::Limit`] if the file exceeds `limits`
    pub fn open(source: R, limits: &DecodeLimits, max_segment_bytes: usize) -> Result<Self, DecodeError> {
        let file = Self::recover(source, limits, max_segment_bytes)?;
        file.loss.map_or(Ok(file), |loss| Err(end_of_file(loss.bytes, ENDS_EARLY)))
    }

    /// Opens the intact part of a file that may have been cut, such as by an interrupted transfer. The intact part is
    /// the timesteps of the whole segments. If even the first segment is not whole, it is that segment's timesteps with
    /// the Gaussians of its whole layers. A whole file is read as by [`Self::open`].
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
    /// As [`Self::open`]. A file that was cut is an error only if its first segment has no whole layer.
    pub fn recover(mut source: R, limits: &DecodeLimits, max_segment_bytes: usize) -> Result<Self, DecodeError> {
        let length = source.seek(SeekFrom::End(0))?;
        let mut start = read(&mut source, 0..OPENING_BYTES.min(length))?;
        let archive = loop {
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
        let whole = archive.info().clone();
        let mut file = Self {
            source,
            info: whole.clone(),
            num_layers: None,
            loss: None,
            layout: Layout::base(),
            max_gaussians: max_gaussians(&archive),
            archive,
            max_segment_bytes,
            cohorts: BTreeMap::new(),
            light: Light::default(),
        };
        if length < file.archive.file_bytes() {
            file.loss = Some(Loss {
                bytes: length,
                bytes_before: file.archive.file_bytes(),
                timesteps_before: whole.num_timesteps,
                gaussians_before: whole.num_gaussians,
            });
            let early = || end_of_file(length, ENDS_EARLY);
            let (num_layers, num_timesteps) = file.what_is_whole(length)?.ok_or_else(early)?;
            file.info.num_timesteps = num_timesteps as u32;
            if let Some(num_layers) = num_layers {
                let layers = file.cohorts[&0].cohort.layers();
                file.info.num_gaussians = layers[..num_layers].iter().sum();
                (file.max_gaussians, file.num_layers) = (file.info.num_gaussians as usize, Some(num_layers));
            }
        }
        if file.archive.num_cohorts() > 0 {
            file.open_cohort(0)?;
            file.layout = Arc::clone(file.cohorts[&0].cohort.layout());
        }
        let data = file.application_data_of(MAX_BYTES as u64)?;
        (file.layout, file.light) = (file.layout.with_background(read_background(&data)), read_light(&data));
        Ok(file)
    }

    /// Opens a cohort with its shared layers, if it is not open.
    fn open_cohort(&mut self, index: usize) -> Result<(), DecodeError> {
        if self.cohorts.contains_key(&index) {
            return Ok(());
        }
        if let Some(before) = self.archive.needs_before(index) {
            let head = read(&mut self.source, self.archive.head_range(before))?;
            self.archive.open_cohort(before, &head)?;
        }
        let start = self.archive.start_range(index);
        let bytes = read(&mut self.source, start.clone())?;
        let mut cohort = self.archive.open_cohort(index, &bytes)?;
        let shared = cohort.shared_range(cohort.num_layers()).start - start.start;
        cohort.read_shared(bytes.get(shared as usize..).unwrap_or(&[]))?;
        let cache = SegmentCache::new(self.max_segment_bytes);
        self.cohorts.insert(index, OpenCohort { cohort, cache, sampler: None });
        Ok(())
    }

    /// Number of whole layers (`None` if all are) and of whole timesteps in a file that was cut.
    ///
    /// - `length`: bytes of the cut file
    /// - returns: `None` if even the first layer of the first timestep is not whole
    fn what_is_whole(&mut self, length: u64) -> Result<Option<(Option<usize>, usize)>, DecodeError> {
        let mut num_timesteps = self.info.num_timesteps as usize;
        for index in 0..self.archive.num_cohorts() {
            let span = self.archive.timesteps_of(index);
            if span.start >= num_timesteps {
                break;
            }
            // A file of version 1 has no head; the code below counts its layers.
            if self.archive.head_range(index).end > length {
                num_timesteps = span.start;
                break;
            }
            self.open_cohort(index)?;
            let cohort = &self.cohorts[&index].cohort;
            // A segment in which nothing moves has no bytes, so its offset does not matter.
            let is_whole = |segment: usize, layers: usize| {
                let range = cohort.segment_range(segment, layers);
                layers <= cohort.layers_read() && (range.is_empty() || range.end <= length)
            };
            let all = cohort.num_layers();
            let segments = (0..cohort.num_segments()).take_while(|&segment| is_whole(segment, all)).count();
            if segments < cohort.num_segments() {
                num_timesteps = num_timesteps.min(cohort.timesteps_of(segments).start);
            }
            if num_timesteps == 0 && self.archive.num_cohorts() == 1 {
                let layers = (1..all).take_while(|&layers| is_whole(0, layers)).count();
                let first = cohort.timesteps_of(0).end;
                return Ok((layers > 0).then_some((Some(layers), first)));
            }
            if index > 0 {
                self.cohorts.remove(&index);
            }
        }
        Ok((num_timesteps > 0).then_some((None, num_timesteps)))
    }

    /// Describes the file without reading shared layers or segments; for a long scene this reads only a small part.
    /// Verifies only the checksums of the tables and heads.
    ///
    /// # Errors
    /// [`DecodeError`] if a head cannot be read or is damaged.
    pub fn outline(&mut self) -> Result<FileInfo, DecodeError> {
        let length = self.loss.map_or(self.archive.file_bytes(), |loss| loss.bytes);
        let mut info = FileInfo::new(&self.archive, length, None);
        for index in 0..self.archive.num_cohorts() {
            let range = self.archive.head_range(index);
            if range.end > length {
                break;
            }
            let head = read(&mut self.source, range)?;
            let cohort = self.archive.open_cohort(index, &head)?;
            info.add(&self.archive, &cohort, None);
        }
        Ok(info)
    }

    /// Names and content of the application data, in the order of the file. Leaves out data without a name in UTF-8
    /// and, in a file that was cut, data that are not whole.
    ///
    /// # Errors
    /// [`DecodeError::Format`] if data are damaged.
    pub fn application_data(&mut self) -> Result<Vec<(String, Vec<u8>)>, DecodeError> {
        self.application_data_of(u64::MAX)
    }

    /// Gains of all colours over time, which [`Self::at`] does not apply. Ignores application data of more than 1 MiB.
    pub fn light(&self) -> &Light {
        &self.light
    }

    /// [`Self::at`] with colours multiplied by the gains of the timestep ([`Self::light`]), as a renderer draws them.
    ///
    /// # Errors
    /// As [`Self::at`].
    pub fn lit(&mut self, timestep: usize) -> Result<Gaussians, DecodeError> {
        let gains = self.light.at(timestep);
        Ok(self.at(timestep)?.lit(gains))
    }

    /// - `most`: length of the longest section to read, bytes
    fn application_data_of(&mut self, most: u64) -> Result<Vec<(String, Vec<u8>)>, DecodeError> {
        let length = self.loss.map_or(self.archive.file_bytes(), |loss| loss.bytes);
        let mut all = Vec::new();
        for (index, range) in self.archive.application_ranges().into_iter().enumerate() {
            if range.end <= length && range.end - range.start <= most {
                let bytes = read(&mut self.source, range)?;
                let data = self.archive.read_application(index, &bytes)?;
                all.extend(data.map(|(name, data)| (name, data.to_vec())));
            }
        }
        Ok(all)
    }

    /// A segment of a cohort, from the cache if possible; else it is read and decoded.
    ///
    /// # Errors
    /// [`DecodeError`] if the segment cannot be read, is damaged, or exceeds the limits.
    ///
    /// # Panics
    /// If `cohort` is not below [`Archive::num_cohorts`] or `segment` not below [`Cohort::num_segments`]. In a file
    /// that was cut, a segment beyond [`Self::info`] has fewer layers than the others.
    pub fn segment(&mut self, cohort: usize, segment: usize) -> Result<Arc<Segment>, DecodeError> {
        self.open_cohort(cohort)?;
        let open = self.cohorts.get_mut(&cohort).expect("a cohort that was opened");
        if let Some(held) = open.cache.recall(segment) {
            return Ok(held.clone());
        }
        let layers = self.num_layers.unwrap_or(open.cohort.num_layers());
        let bytes = read(&mut self.source, open.cohort.segment_range(segment, layers))?;
        open.cache.make_room();
        let decoded = Arc::new(open.cohort.read_segment(segment, &bytes)?);
        open.cache.insert(decoded.clone());
        Ok(decoded)
    }

    /// The Gaussians that live at one timestep as floats, in stored form: the values of [`crate::CompactScene::at`],
    /// cohort by cohort. Fastest if successive calls ask for successive timesteps.
    ///
    /// # Errors
    /// As [`Self::segment`].
    ///
    /// # Panics
    /// If `timestep` is not below [`SceneInfo::num_timesteps`].
    pub fn at(&mut self, timestep: usize) -> Result<Gaussians, DecodeError> {
        let alive = self.cohorts_at(timestep);
        let mut parts = Vec::with_capacity(alive.len());
        for cohort in alive {
            // With the background, which the layouts of cohorts lack.
            parts.push(self.of_cohort(cohort, timestep)?.extended(&self.layout));
        }
        if let [_] = &parts[..] {
            return Ok(parts.pop().expect("one part"));
        }
        Ok(Gaussians::concat(&self.layout, &parts))
    }

    /// Indices, among all Gaussians of the file, of the Gaussians that [`Self::at`] returns: cohort by cohort,
    /// ascending.
    ///
    /// # Errors
    /// As [`Self::segment`].
    ///
    /// # Panics
    /// As [`Self::at`].
    pub fn living(&mut self, timestep: usize) -> Result<Vec<usize>, DecodeError> {
        let (mut living, mut counted, mut before) = (Vec::new(), 0, 0);
        for cohort in self.cohorts_at(timestep) {
            before += (counted..cohort).map(|other| self.archive.num_gaussians_of(other)).sum::<usize>();
            counted = cohort;
            self.open_cohort(cohort)?;
            let index = self.cohorts[&cohort].cohort.segment_at(timestep);
            let segment = self.segment(cohort, index)?;
            match segment.alive(timestep) {
                Some(alive) => living.extend(alive.iter().map(|gaussian| before + gaussian)),
                None => living.extend(before..before + segment.num_gaussians()),
            }
        }
        Ok(living)
    }

    /// The cohorts that live at a timestep, ascending. Drops all others.
    fn cohorts_at(&mut self, timestep: usize) -> Vec<usize> {
        let num_timesteps = self.info.num_timesteps as usize;
        assert!(timestep < num_timesteps, "timestep {timestep} of {num_timesteps}");
        let alive: Vec<usize> = self.archive.cohorts_at(timestep).collect();
        self.cohorts.retain(|cohort, _| alive.contains(cohort));
        alive
    }

    /// The Gaussians of a cohort that live at a timestep.
    fn of_cohort(&mut self, cohort: usize, timestep: usize) -> Result<Gaussians, DecodeError> {
        self.open_cohort(cohort)?;
        let open = &self.cohorts[&cohort];
        if open.cohort.layout().with_background(self.layout.background()) != self.layout {
            return Err(other_attributes(self.archive.head_range(cohort).start));
        }
        let index = open.cohort.segment_at(timestep);
        let segment = self.segment(cohort, index)?;
        let open = self.cohorts.get_mut(&cohort).expect("a cohort that was opened");
        if open.sampler.as_ref().is_none_or(|(held, _)| *held != index) {
            open.sampler = Some((index, Sampler::new(&segment)));
        }
        let (_, sampler) = open.sampler.as_mut().expect("a sampler that was just made");
        let all = sampler.at(timestep);
        Ok(segment.alive(timestep).map_or_else(|| all.clone(), |alive| all.select(&alive)))
    }
}

/// Largest total number of Gaussians in the cohorts that live at one timestep.
fn max_gaussians(archive: &Archive) -> usize {
    let mut changes: BTreeMap<usize, i64> = BTreeMap::new();
    for cohort in 0..archive.num_cohorts() {
        let (span, count) = (archive.timesteps_of(cohort), archive.num_gaussians_of(cohort) as i64);
        *changes.entry(span.start).or_default() += count;
        *changes.entry(span.end).or_default() -= count;
    }
    let mut alive = 0;
    let alive = changes.values().map(|change| {
        alive += change;
        alive
    });
    alive.max().unwrap_or(0) as usize
}

impl<R: Read + Seek> SceneReader for SceneFile<R> {
    type Error = DecodeError;

    fn layout(&self) -> &Arc<Layout> {
        &self.layout
    }

    fn num_identities(&self) -> Option<usize> {
        Some(self.info.num_gaussians as usize)
    }

    /// Number of Gaussians in the cohorts that live at a timestep: an upper bound, since lives within a cohort are
    /// unknown before it is read.
    fn num_gaussians_at(&self, timestep: usize) -> usize {
        let of = |cohort| self.archive.num_gaussians_of(cohort);
        if self.num_layers.is_some() { self.max_gaussians } else { self.archive.cohorts_at(timestep).map(of).sum() }
    }

    /// An upper bound, as [`Self::num_gaussians_at`].
    fn max_gaussians(&self) -> usize {
        self.max_gaussians
    }

    fn num_timesteps(&self) -> usize {
        self.info().num_timesteps as usize
    }

    fn span(&self, timestep: usize) -> Range<usize> {
        let mut span = 0..self.num_timesteps();
        for cohort in self.archive.cohorts_at(timestep) {
            let of_cohort = match self.cohorts.get(&cohort) {
                Some(open) => open.cohort.timesteps_of(open.cohort.segment_at(timestep)),
                None => self.archive.timesteps_of(cohort),
            };
            span = span.start.max(of_cohort.start)..span.end.min(of_cohort.end);
        }
        span
    }

    fn at(&mut self, timestep: usize) -> Result<Gaussians, DecodeError> {
        SceneFile::at(self, timestep)
    }
}

/// Reads a range of a source; returns fewer bytes if the source ends.
fn read(source: &mut (impl Read + Seek), range: Range<u64>) -> Result<Vec<u8>, DecodeError> {
    source.seek(SeekFrom::Start(range.start))?;
    let mut bytes = Vec::new();
    source.take(range.end - range.start).read_to_end(&mut bytes)?;
    Ok(bytes)
}
