//! Decoding of parts of a cohort: the byte ranges that a timestep needs, and their content. The caller does the input:
//! this module takes bytes, and names the ranges that it needs.

use std::ops::Range;
use std::sync::Arc;

use super::head::Head;
use super::reader::{SegmentReader, SharedModels};
use super::section::{self, Cursor, Entry, MAPS, SKIPPED};
use super::segment::Segment;
use super::shared::Shared;
use crate::error::{DecodeError, ENDS_EARLY};
use crate::limits::Budget;

/// A set of Gaussians that are described together; in a file of version 1, all Gaussians. Holds the positions of the
/// sections, and the shared layers read so far. [`Archive::open_cohort`](crate::Archive::open_cohort) makes it.
///
/// A caller fetches ranges of bytes, for example with HTTP range requests:
///
/// 1. [`Self::shared_range`] of the layers it wants, for [`Self::read_shared`]
/// 2. [`Self::segment_range`] of any segments in any order, for [`Self::read_segment`]
#[derive(Clone, Debug)]
pub struct Cohort {
    head: Arc<Head>,
    /// The sections of every shared layer, then those of every layer of every segment; the sections of one layer are a
    /// *group*.
    sections: Vec<Entry>,
    /// Number of sections in a layer of a segment.
    of_segment: usize,
    shared: Arc<Shared>,
    layers_read: usize,
    /// Models of the shared layers; dropped after the last one. They take hundreds of kilobytes, and a file may hold
    /// many cohorts.
    models: Option<SharedModels>,
    budget: Arc<Budget>,
}

impl Cohort {
    /// - `sections`: [`Self::num_sections`] of them, in the order of the file
    pub(super) fn new(head: Head, sections: Vec<Entry>, budget: Arc<Budget>) -> Self {
        debug_assert_eq!(sections.len(), Self::num_sections(&head));
        Self {
            of_segment: head.plan.listed_varying().count(),
            models: None,
            shared: Arc::new(Shared::new(&head.plan, head.has_lives)),
            layers_read: 0,
            head: Arc::new(head),
            sections,
            budget,
        }
    }

    /// Number of sections of a cohort: those of every shared layer, then those of every layer of every segment.
    pub(super) fn num_sections(head: &Head) -> usize {
        let of_layer = sections_of_layer(head) + head.num_segments() * head.plan.listed_varying().count();
        head.layers.len() * of_layer
    }

    /// Number of Gaussians.
    pub fn num_gaussians(&self) -> usize {
        self.head.num_gaussians
    }

    /// Number of segments.
    pub fn num_segments(&self) -> usize {
        self.head.num_segments()
    }

    /// Number of layers; 0 for a file without Gaussians.
    pub fn num_layers(&self) -> usize {
        self.head.layers.len()
    }

    /// `[layers]`: number of Gaussians of each layer.
    pub fn layers(&self) -> &[u32] {
        &self.head.layers
    }

    /// Which columns the Gaussians have.
    pub fn layout(&self) -> &Arc<tcgs_core::Layout> {
        &self.head.plan.layout
    }

    /// By [`Attribute::index`](tcgs_core::Attribute::index): whether the attribute varies over time.
    pub fn varies(&self) -> &[bool] {
        &self.head.plan.varies
    }

    /// Whether some Gaussians live for a part of the cohort's timesteps only; see [`Segment::lives`].
    pub fn has_lives(&self) -> bool {
        self.head.has_lives
    }

    /// Names of optional attributes that are skipped because a newer version of this crate coded them.
    pub fn skipped(&self) -> impl Iterator<Item = &str> {
        self.head.plan.skipped.iter().map(|skipped| skipped.name.as_str())
    }

    /// Whether another cohort has the same attributes, as all cohorts of a file must.
    pub(crate) fn has_attributes_of(&self, other: &Self) -> bool {
        let [own, others] = [self, other].map(|cohort| &cohort.head.plan.skipped);
        let skips_same = own.len() == others.len() && own.iter().zip(others).all(|(own, other)| own.is_like(other));
        self.layout() == other.layout() && skips_same
    }

    /// Whether there are sections in segments.
    pub(super) fn has_segments(&self) -> bool {
        self.of_segment > 0
    }

    /// Number of shared layers that [`Self::read_shared`] has read so far.
    pub fn layers_read(&self) -> usize {
        self.layers_read
    }

    /// Timesteps of the scene that the cohort spans.
    pub fn timesteps(&self) -> Range<usize> {
        self.head.start..self.head.start + self.head.num_timesteps
    }

    /// Timesteps of the scene that a segment spans.
    ///
    /// # Panics
    /// If `segment` is not below [`Self::num_segments`].
    pub fn timesteps_of(&self, segment: usize) -> Range<usize> {
        assert!(segment < self.num_segments(), "segment {segment} of {}", self.num_segments());
        let Range { start, end } = self.head.span(segment);
        self.head.start + start..self.head.start + end
    }

    /// Index of the segment that holds a timestep of the scene.
    ///
    /// # Panics
    /// If `timestep` is not within [`Self::timesteps`].
    pub fn segment_at(&self, timestep: usize) -> usize {
        assert!(self.timesteps().contains(&timestep), "timestep {timestep} of {:?}", self.timesteps());
        (timestep - self.head.start) / self.head.segment_length()
    }

    /// Range of the file that [`Self::read_shared`] needs to read the shared layers up to number `layers`. Layers that
    /// were already read are not part of it.
    ///
    /// # Panics
    /// If `layers` exceeds [`Self::num_layers`].
    pub fn shared_range(&self, layers: usize) -> Range<u64> {
        assert!(layers <= self.num_layers(), "{layers} layers of {}", self.num_layers());
        self.range_of(self.layers_read.min(layers)..layers)
    }

    /// Range of the file that [`Self::read_segment`] needs for the first `layers` layers of a segment.
    ///
    /// # Panics
    /// If `segment` is not below [`Self::num_segments`], or `layers` exceeds [`Self::num_layers`].
    pub fn segment_range(&self, segment: usize, layers: usize) -> Range<u64> {
        let (num_layers, num_segments) = (self.num_layers(), self.num_segments());
        assert!(
            layers <= num_layers && segment < num_segments,
            "{layers} of {num_layers}, {segment} of {num_segments}"
        );
        let first = num_layers * (1 + segment);
        self.range_of(first..first + layers)
    }

    /// Byte range of consecutive groups of sections: shared layers, or layers of one segment.
    pub(super) fn range_of(&self, groups: Range<usize>) -> Range<u64> {
        let end = self.sections.last().map_or(0, |e| e.range.end);
        let sections = self.group(groups.start).start..self.group(groups.end.max(1) - 1).end;
        let start = self.sections.get(sections.start).map_or(end, |e| e.range.start);
        if groups.is_empty() || sections.is_empty() {
            start..start
        } else {
            start..self.sections[sections.end - 1].range.end
        }
    }

    /// Indices of the sections of a group. The first groups are the shared layers, the following ones the layers of
    /// segments.
    fn group(&self, group: usize) -> Range<usize> {
        let (layers, of_layer) = (self.num_layers(), sections_of_layer(&self.head));
        let (start, count) = match group.checked_sub(layers) {
            None => (group * of_layer, of_layer),
            Some(group) => (layers * of_layer + group * self.of_segment, self.of_segment),
        };
        start..start + count
    }

    /// Number of groups of sections.
    pub(super) fn num_groups(&self) -> usize {
        self.num_layers() * (1 + self.num_segments())
    }

    /// Sections of a group with their bytes. Sections of skipped attributes are omitted; only their checksums are
    /// verified.
    ///
    /// - `bytes`: start at `offset` of the file
    pub(super) fn sections<'a>(
        &self,
        group: usize,
        offset: u64,
        bytes: &'a [u8],
    ) -> Result<Vec<Cursor<'a>>, DecodeError> {
        let mut cursors = Vec::new();
        for entry in &self.sections[self.group(group)] {
            let range = (entry.range.start - offset) as usize..(entry.range.end - offset) as usize;
            let section = bytes.get(range);
            let early = || Cursor::new(section::name(entry.tag), entry.range.start, &[]).invalid("length", ENDS_EARLY);
            let cursor = entry.open(section.ok_or_else(early)?)?;
            if entry.tag != SKIPPED {
                cursors.push(cursor);
            }
        }
        Ok(cursors)
    }

    /// Reads the shared layers that follow those read so far.
    ///
    /// - `bytes`: the bytes of a [`Self::shared_range`]; further bytes are ignored, and a layer that is incomplete is
    ///   not read
    ///
    /// # Errors
    /// [`DecodeError::Format`] if a section is damaged, [`DecodeError::Limit`] if decoding exceeds the limits.
    pub fn read_shared(&mut self, bytes: &[u8]) -> Result<(), DecodeError> {
        let start = self.range_of(self.layers_read..self.layers_read).start;
        while self.layers_read < self.num_layers()
            && self.range_of(self.layers_read..self.layers_read + 1).end - start <= bytes.len() as u64
        {
            let sections = self.sections(self.layers_read, start, bytes)?;
            let layer = self.head.layer(self.layers_read);
            // Segments already returned keep the layers they had.
            let shared = Arc::make_mut(&mut self.shared);
            let models = self.models.get_or_insert_with(|| SharedModels::new(&self.head.plan));
            models.read(&self.head, layer, sections, shared, &self.budget)?;
            self.layers_read += 1;
        }
        if self.layers_read == self.num_layers() {
            self.models = None;
        }
        Ok(())
    }

    /// Decodes the first layers of a segment.
    ///
    /// - `bytes`: the bytes of a [`Self::segment_range`]. Layers beyond [`Self::layers_read`] and layers that are
    ///   incomplete are left out
    /// - returns: the segment, of as many layers as were decoded
    ///
    /// # Errors
    /// [`DecodeError::Format`] if a section is damaged, [`DecodeError::Limit`] if decoding exceeds the limits.
    ///
    /// # Panics
    /// If `segment` is not below [`Self::num_segments`].
    pub fn read_segment(&self, segment: usize, bytes: &[u8]) -> Result<Segment, DecodeError> {
        assert!(segment < self.num_segments(), "segment {segment} of {}", self.num_segments());
        let mut reader = SegmentReader::new(self, segment);
        // Segments are temporary, so each may use the budget that the shared layers leave.
        let budget = self.budget.fork();
        let start = self.segment_range(segment, 0).start;
        for layer in 0..self.layers_read {
            if self.segment_range(segment, layer + 1).end - start > bytes.len() as u64 {
                break;
            }
            reader.read(self, start, bytes, &budget)?;
        }
        Ok(reader.finish(self))
    }

    /// Upper bound on the memory of the shared layers read so far, bytes.
    pub fn bytes(&self) -> usize {
        self.head.plan.bytes_per_gaussian() * self.shared.num_gaussians()
    }

    pub(super) fn head(&self) -> &Arc<Head> {
        &self.head
    }

    pub(super) fn shared(&self) -> &Arc<Shared> {
        &self.shared
    }

    pub(super) fn budget(&self) -> &Budget {
        &self.budget
    }

    /// Names of all sections, in the order of [`Self::entries`].
    pub(super) fn entry_names(&self) -> impl Iterator<Item = String> {
        let plan = &self.head.plan;
        let name_of = |listed| plan.name_of(listed);
        let layer: Vec<&str> = std::iter::once(section::name(MAPS)).chain(plan.listed().map(name_of)).collect();
        let varying: Vec<&str> = plan.listed_varying().map(name_of).collect();
        let of_layers = layer.len() * self.num_layers();
        (0..self.sections.len()).map(move |i| {
            if i < of_layers { layer[i % layer.len()] } else { varying[(i - of_layers) % varying.len()] }.to_owned()
        })
    }

    /// All sections.
    pub(super) fn entries(&self) -> &[Entry] {
        &self.sections
    }
}

/// Number of sections of a shared layer: its maps, and the first codes of every attribute.
fn sections_of_layer(head: &Head) -> usize {
    1 + head.plan.num_listed()
}
