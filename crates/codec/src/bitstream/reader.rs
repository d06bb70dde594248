//! Decoding of one shared layer, or of one layer of a segment, from the bytes of its sections.

use std::ops::Range;

use tcgs_core::Attribute;

use super::coder::{Coder, Decoder as SymbolDecoder};
use super::cohort::Cohort;
use super::head::Head;
use super::keypoints::{KeypointModels, Motion, Problem, Scope, UnitTracks};
use super::plan::Plan;
use super::section::Cursor;
use super::segment::Segment;
use super::shared::{CurveModels, FirstModels, MapModels, Shared};
use crate::error::{DecodeError, NEWER};
use crate::limits::Budget;
use crate::parallel;

/// Models that continue from layer to layer.
#[derive(Clone, Debug)]
pub(super) struct SharedModels {
    maps: MapModels,
    curve: CurveModels,
    /// Models of first codes, of all attributes but means.
    others: Vec<FirstModels>,
}

impl SharedModels {
    pub(super) fn new(plan: &Plan) -> Self {
        let others = plan.layout.attributes().skip(1).map(|a| FirstModels::new(plan, a)).collect();
        Self { maps: MapModels::new(plan), curve: CurveModels::new(), others }
    }

    /// - `sections`: maps, then every attribute
    pub(super) fn read(
        &mut self,
        head: &Head,
        layer: Range<usize>,
        sections: Vec<Cursor<'_>>,
        shared: &mut Shared,
        budget: &Budget,
    ) -> Result<(), DecodeError> {
        let plan = &*head.plan;
        budget.reserve("layer", layer.len() as u64, plan.bytes_per_gaussian())?;
        shared.extend(plan, &layer);
        let mut sections = sections.into_iter();
        let mut next = || sections.next().expect("a section for every attribute");

        let mut cursor = next();
        let mut decoder = SymbolDecoder::new(cursor.rest());
        if !self.maps.code(&mut decoder, plan, head.num_timesteps, layer.clone(), shared) {
            return Err(cursor.invalid("lives", "not within the timesteps of the cohort"));
        }
        complete(&decoder, &cursor)?;
        for attribute in plan.layout.attributes() {
            let (a, known) = (attribute.index(), plan.quantizers.by_width(attribute));
            // An attribute that a Gaussian lacks has the width 0.
            let is_known = |&width: &u8| width == 0 || !known[usize::from(width)].is_empty();
            if !shared.bit_map.widths[a][layer.clone()].iter().all(is_known) {
                return Err(cursor.invalid("bit widths", "a width without quantizers"));
            }
        }
        shared.count_units(plan, &layer);

        let mut cursor = next();
        let mut decoder = SymbolDecoder::new(cursor.rest());
        self.curve.code(&mut decoder, plan, layer.clone(), shared);
        complete(&decoder, &cursor)?;
        let points: Vec<_> = shared.points(layer.clone()).collect();
        shared.neighbors.extend(points.into_iter());

        let Shared { bit_map, neighbors, first_codes, .. } = shared;
        let jobs: Vec<_> = self.others.iter_mut().zip(&mut first_codes[1..]).map(|job| (job, next())).collect();
        let results = parallel::map(jobs, |((models, codes), mut cursor)| {
            let widths = &bit_map.widths[models.attribute().index()];
            let mut decoder = SymbolDecoder::new(cursor.rest());
            models.code(&mut decoder, plan, layer.clone(), neighbors, widths, codes);
            complete(&decoder, &cursor)
        });
        results.into_iter().collect()
    }
}

fn complete(decoder: &SymbolDecoder<'_>, cursor: &Cursor<'_>) -> Result<(), DecodeError> {
    if decoder.finished() { Ok(()) } else { Err(cursor.invalid("symbols", "not exactly as many as there should be")) }
}

/// Reads a segment layer by layer.
pub(super) struct SegmentReader {
    segment: usize,
    layers: usize,
    /// The attributes that vary, with their models and units.
    attributes: Vec<(Attribute, KeypointModels, UnitTracks)>,
}

impl SegmentReader {
    pub(super) fn new(cohort: &Cohort, segment: usize) -> Self {
        let plan = &cohort.head().plan;
        let models = |a| (a, KeypointModels::new(plan, a), UnitTracks::new(plan.channels(a)));
        let attributes = plan.varying().map(models).collect();
        Self { segment, layers: 0, attributes }
    }

    /// Reads the next layer.
    ///
    /// - `bytes`: start at `offset` of the file
    pub(super) fn read(
        &mut self,
        cohort: &Cohort,
        offset: u64,
        bytes: &[u8],
        budget: &Budget,
    ) -> Result<(), DecodeError> {
        let sections = cohort.sections(cohort.num_layers() * (1 + self.segment) + self.layers, offset, bytes)?;
        let jobs = self.attributes.iter_mut().zip(sections).collect();
        let results = parallel::map(jobs, |((attribute, models, units), mut cursor)| {
            let motion = Motion::ALL.get(usize::from(cursor.u8("motion")?)).copied();
            let motion = motion.ok_or_else(|| cursor.invalid("motion", NEWER))?;
            let place = Scope {
                plan: &cohort.head().plan,
                shared: cohort.shared(),
                attribute: *attribute,
                layer: cohort.head().layer(self.layers),
                span: cohort.head().span(self.segment),
                num_timesteps: cohort.head().num_timesteps,
                budget,
            };
            let mut decoder = SymbolDecoder::new(cursor.rest());
            match models.code(&mut decoder, &place, motion, None, units) {
                Ok(()) if decoder.finished() => Ok(()),
                Err(Problem::TooMany(error)) => Err(error),
                Err(Problem::Damaged) if !decoder.exhausted() => {
                    Err(cursor.invalid("keypoint times", "not within the timesteps that are left"))
                }
                _ => Err(cursor.invalid("symbols", "not exactly as many as there should be")),
            }
        });
        self.layers += 1;
        results.into_iter().collect()
    }

    /// The segment with the layers read so far.
    pub(super) fn finish(self, cohort: &Cohort) -> Segment {
        let (segment, layers) = (self.segment, self.layers);
        let units = self.attributes.into_iter().map(|(attribute, _, units)| (attribute, units));
        segment_of(cohort, segment, layers, units)
    }

    /// A copy of the segment with the layers read so far.
    pub(super) fn snapshot(&self, cohort: &Cohort) -> Result<Segment, DecodeError> {
        let bytes: usize = self.attributes.iter().map(|(_, _, units)| units.bytes()).sum();
        cohort.budget().reserve("segment", bytes as u64, 1)?;
        let units = self.attributes.iter().map(|(attribute, _, units)| (*attribute, units.clone()));
        Ok(segment_of(cohort, self.segment, self.layers, units))
    }
}

/// - `units`: of the attributes that vary
fn segment_of(
    cohort: &Cohort,
    segment: usize,
    layers: usize,
    units: impl Iterator<Item = (Attribute, UnitTracks)>,
) -> Segment {
    let plan = &cohort.head().plan;
    let mut tracks: Vec<UnitTracks> = plan.layout.attributes().map(|a| UnitTracks::new(plan.channels(a))).collect();
    for (attribute, mut units) in units {
        units.shrink();
        tracks[attribute.index()] = units;
    }
    Segment::new(cohort.head().clone(), cohort.shared().clone(), segment, layers, tracks)
}
