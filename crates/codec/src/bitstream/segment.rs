//! A decoded segment, and its conversion to floats at single timesteps (`docs/FORMAT.md`, "Reconstruction").

use std::ops::Range;
use std::sync::Arc;

use tcgs_core::{Attribute, Gaussians, Layout, Life};

use super::head::Head;
use super::keypoints::UnitTracks;
use super::neighbors::NONE;
use super::shared::Shared;
use crate::compact::{SceneInfo, unit_quat};
use crate::keypoints::{fraction, lerp, sample};
use crate::quantize::Quantizers;

/// A decoded segment: a span of timesteps, with all Gaussians of the cohort or those of the first layers.
///
/// The segment holds codes at keypoints. [`Self::at`] gives one timestep as floats, a [`Sampler`] many timesteps
/// faster.
#[derive(Clone, Debug)]
pub struct Segment {
    head: Arc<Head>,
    shared: Arc<Shared>,
    index: usize,
    num_layers: usize,
    num_gaussians: usize,
    /// Units by attribute.
    tracks: Vec<UnitTracks>,
}

impl Segment {
    pub(super) fn new(
        head: Arc<Head>,
        shared: Arc<Shared>,
        index: usize,
        num_layers: usize,
        tracks: Vec<UnitTracks>,
    ) -> Self {
        let num_gaussians = head.layers[..num_layers].iter().map(|&n| n as usize).sum();
        Self { head, shared, index, num_layers, num_gaussians, tracks }
    }

    /// Counts and provenance of the whole scene.
    pub fn info(&self) -> &SceneInfo {
        &self.head.info.scene
    }

    /// Index of the cohort in the file, from 0.
    pub fn cohort(&self) -> usize {
        self.head.index
    }

    /// Index of the segment in its cohort, from 0.
    pub fn index(&self) -> usize {
        self.index
    }

    /// Number of layers of the segment that were decoded.
    pub fn num_layers(&self) -> usize {
        self.num_layers
    }

    /// Number of Gaussians of the decoded layers, which are the first Gaussians of the cohort.
    pub fn num_gaussians(&self) -> usize {
        self.num_gaussians
    }

    /// Timesteps of the scene that the segment spans.
    pub fn timesteps(&self) -> Range<usize> {
        let Range { start, end } = self.head.span(self.index);
        self.start() + start..self.start() + end
    }

    /// First timestep of the cohort, from which the times of [`Self::keypoints`] and [`Self::lives`] count.
    pub fn start(&self) -> usize {
        self.head.start
    }

    /// Which columns the Gaussians have.
    pub fn layout(&self) -> &Arc<Layout> {
        &self.head.plan.layout
    }

    /// `[N]` lives, counted from [`Self::start`]; `None` if all Gaussians live in all timesteps of the cohort.
    pub fn lives(&self) -> Option<&[Life]> {
        self.shared.lives.as_ref().map(|lives| &lives[..self.num_gaussians])
    }

    /// Indices of the Gaussians that live at a timestep of the scene, ascending; `None` if all live in all timesteps.
    ///
    /// # Panics
    /// If `timestep` is before [`Self::start`].
    pub fn alive(&self, timestep: usize) -> Option<Vec<usize>> {
        let now = timestep - self.start();
        let lives = self.lives()?;
        Some((0..lives.len()).filter(|&g| lives[g].contains(now)).collect())
    }

    pub(super) fn tracks(&self, attribute: Attribute) -> &UnitTracks {
        &self.tracks[attribute.index()]
    }

    /// Quantizers of the scene, which convert codes to floats.
    pub fn quantizers(&self) -> &Quantizers {
        &self.head.plan.quantizers
    }

    /// Keypoints of the moving units of an attribute, for callers that dequantise and interpolate themselves, such as a
    /// renderer on a GPU. `None` if the attribute does not vary.
    pub fn keypoints(&self, attribute: Attribute) -> Option<Keypoints<'_>> {
        let tracks = &self.tracks[attribute.index()];
        self.head.plan.varies[attribute.index()].then(|| tracks.as_keypoints())
    }

    /// The moving units of an attribute, in the order of [`Self::keypoints`]. All segments with the same number of
    /// layers have the same moving units.
    ///
    /// - returns: for each unit the index of its first value in `[N * components]`, and the width of its codes in bits
    pub fn moving_units(&self, attribute: Attribute) -> impl Iterator<Item = (u32, u8)> {
        let (a, components) = (attribute.index(), attribute.components());
        let channels = self.tracks[a].channels;
        let count = if self.head.plan.varies[a] { self.num_gaussians * components / channels } else { 0 };
        let units = self.shared.units[a][..count].iter().enumerate().filter(|(_, unit)| **unit != NONE);
        units.map(move |(i, _)| {
            let place = i * channels;
            (place as u32, self.shared.bit_map.widths[a][place / components])
        })
    }

    /// Value of every track at its first keypoint, at the start of the Gaussian's life, in stored form. Quaternions are
    /// not normalised; an attribute that a Gaussian lacks is 0.
    pub fn first(&self) -> Gaussians {
        let mut first = Gaussians::zeros_of(self.layout(), self.num_gaussians);
        for attribute in self.layout().attributes() {
            let (a, components) = (attribute.index(), attribute.components());
            let table = self.quantizers().by_width(attribute);
            let widths = &self.shared.bit_map.widths[a];
            let codes = &self.shared.first_codes[a];
            for (g, row) in first.values_mut(attribute).chunks_exact_mut(components).enumerate() {
                let quantizers = table[usize::from(widths[g])];
                for (channel, (value, quantizer)) in row.iter_mut().zip(quantizers).enumerate() {
                    *value = quantizer.dequantize(codes[g * components + channel].into());
                }
            }
        }
        first
    }

    /// One timestep as floats, in stored form: the values of [`crate::CompactScene::at`] for the Gaussians of the
    /// decoded layers, whether they live at it ([`Self::alive`]) or not. Dequantises the whole segment at each call; a
    /// [`Sampler`] does so once.
    ///
    /// - `timestep`: timestep of the scene
    ///
    /// # Panics
    /// If `timestep` is not within [`Self::timesteps`].
    pub fn at(&self, timestep: usize) -> Gaussians {
        let mut sampler = Sampler::new(self);
        sampler.at(timestep).clone()
    }

    /// Memory of the segment's keypoints, in bytes, without the shared layers.
    pub fn bytes(&self) -> usize {
        self.tracks.iter().map(UnitTracks::bytes).sum()
    }
}

/// Keypoints of the moving units of an attribute, within one segment.
///
/// A unit is a group of tracks that share their keypoint times: the tracks of all components of an attribute of a
/// Gaussian if these are joint, else one track.
#[derive(Clone, Copy, Debug)]
pub struct Keypoints<'a> {
    /// Number of components of a unit.
    pub channels: usize,
    /// `[units + 1]`; the keypoints of unit `i` have the indices `starts[i]..starts[i + 1]`. The range is empty if the
    /// Gaussian does not live in the segment.
    pub starts: &'a [u32],
    /// `[keypoints]` timesteps, counted from [`Segment::start`], strictly increasing within a unit. The first is at or
    /// before the first timestep of the segment at which the Gaussian lives, the last at or after the last one.
    pub times: &'a [u16],
    /// `[keypoints, channels]` codes.
    pub codes: &'a [i16],
}

/// Moving units of an attribute as floats.
struct Moving {
    attribute: Attribute,
    channels: usize,
    /// `[units]` index of the first value in [`Gaussians::values`].
    places: Vec<u32>,
    /// `[units]` index of the keypoint at or before the timestep of the last call.
    cursors: Vec<u32>,
    /// `[units + 1]`
    starts: Vec<u32>,
    times: Vec<u16>,
    /// `[keypoints, channels]`
    values: Vec<f32>,
}

/// A segment as floats, one timestep after another.
///
/// The sampler dequantises all keypoints once. Each call of [`Self::at`] computes moving tracks only, and starts its
/// search for keypoints at those of the last call.
///
/// ```
/// use tcgs_codec::{CompressSettings, DecodeLimits, Decoder, Event, Sampler, SceneInfo, encode};
/// use tcgs_codec::{BitMap, compress};
/// use tcgs_core::{DynamicGaussians, Gaussians};
/// let mut scene = DynamicGaussians::default();
/// (0..4).for_each(|_| scene.push(Gaussians::zeros(3)));
/// let settings = CompressSettings::default();
/// let compact = compress(&scene, &BitMap::uniform(3, 16, 6), None, SceneInfo::of(&scene), &settings)?;
///
/// for event in Decoder::new(DecodeLimits::default()).push(&encode(&compact)?)? {
///     if let Event::Segment(segment) = event {
///         let mut sampler = Sampler::new(&segment);
///         for timestep in segment.timesteps() {
///             assert_eq!(sampler.at(timestep), &segment.at(timestep));
///         }
///     }
/// }
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub struct Sampler {
    /// First timestep of the cohort.
    start: usize,
    timesteps: Range<usize>,
    now: Gaussians,
    moving: Vec<Moving>,
    /// `[rotating]` Gaussians that rotate, if the components of quaternions are separate units; else empty.
    rotating: Vec<u32>,
    /// `[N]` quaternions before normalisation, if the components of quaternions are separate units; else empty.
    raw_quats: Vec<[f32; 4]>,
}

impl Sampler {
    /// Dequantises all keypoints of a segment.
    pub fn new(segment: &Segment) -> Self {
        let mut now = segment.first();
        let moving: Vec<Moving> =
            segment.head.plan.varying().map(|attribute| Moving::new(segment, attribute)).collect();
        let (mut rotating, mut raw_quats) = (Vec::new(), Vec::new());
        if let Some(quats) = moving.iter().find(|m| m.attribute == Attribute::Quat && m.channels == 1) {
            rotating = quats.places.iter().map(|place| place / 4).collect();
            rotating.dedup();
            raw_quats = now.quats().to_vec();
        }
        for quat in now.quats_mut() {
            *quat = unit_quat(*quat);
        }
        Self { start: segment.start(), timesteps: segment.timesteps(), now, moving, rotating, raw_quats }
    }

    /// One timestep as floats, in stored form: the values of [`Segment::at`]. Fastest if successive calls ask for
    /// successive timesteps.
    ///
    /// # Panics
    /// If `timestep` is not within [`Segment::timesteps`].
    pub fn at(&mut self, timestep: usize) -> &Gaussians {
        assert!(self.timesteps.contains(&timestep), "timestep {timestep} of {:?}", self.timesteps);
        let timestep = timestep - self.start;
        for moving in &mut self.moving {
            let attribute = moving.attribute;
            match (attribute, moving.channels) {
                (Attribute::Quat, 1) => moving.write::<1>(timestep, self.raw_quats.as_flattened_mut(), |x| x),
                (Attribute::Quat, _) => moving.write::<4>(timestep, self.now.values_mut(attribute), unit_quat),
                (_, 3) => moving.write::<3>(timestep, self.now.values_mut(attribute), |x| x),
                (_, 1) => moving.write::<1>(timestep, self.now.values_mut(attribute), |x| x),
                _ => moving.write_row(timestep, self.now.values_mut(attribute)),
            }
        }
        for &gaussian in &self.rotating {
            self.now.quats_mut()[gaussian as usize] = unit_quat(self.raw_quats[gaussian as usize]);
        }
        &self.now
    }
}

impl Moving {
    fn new(segment: &Segment, attribute: Attribute) -> Self {
        let (a, components) = (attribute.index(), attribute.components());
        let tracks = &segment.tracks[a];
        let channels = tracks.channels;
        let table = segment.quantizers().by_width(attribute);
        let (places, widths): (Vec<u32>, Vec<u8>) = segment.moving_units(attribute).unzip();
        let mut of = Self {
            attribute,
            channels,
            places,
            cursors: vec![0; tracks.num_units()],
            starts: vec![0],
            times: Vec::with_capacity(tracks.num_keypoints()),
            values: Vec::with_capacity(tracks.num_keypoints() * channels),
        };
        for (unit, &place) in of.places.iter().enumerate() {
            let (times, codes) = tracks.unit(unit);
            let channel = place as usize % components;
            let quantizers = &table[usize::from(widths[unit])][channel..channel + channels];
            of.times.extend(times);
            for codes in codes.chunks_exact(channels) {
                of.values.extend(codes.iter().zip(quantizers).map(|(&c, q)| q.dequantize(c.into())));
            }
            of.starts.push(of.times.len() as u32);
        }
        of
    }

    /// Writes the values of the moving units at a timestep, for any number of components.
    ///
    /// - `timestep`: counted from the first of the cohort
    /// - `values`: `[N * components]` values of the attribute
    fn write_row(&mut self, timestep: usize, values: &mut [f32]) {
        for (unit, &place) in self.places.iter().enumerate() {
            let range = self.starts[unit] as usize..self.starts[unit + 1] as usize;
            let times = &self.times[range.clone()];
            for channel in 0..if times.is_empty() { 0 } else { self.channels } {
                let value = |k: usize| self.values[(range.start + k) * self.channels + channel];
                values[place as usize + channel] = sample(times, timestep, value);
            }
        }
    }

    /// Writes the values of the moving units at a timestep.
    ///
    /// - `timestep`: counted from the first of the cohort
    /// - `values`: `[N * components]` values of the attribute
    /// - `finish`: applied to each interpolated value before it is written
    fn write<const C: usize>(&mut self, timestep: usize, values: &mut [f32], finish: impl Fn([f32; C]) -> [f32; C]) {
        let keypoints = self.values.as_chunks::<C>().0;
        for (unit, (cursor, &place)) in self.cursors.iter_mut().zip(&self.places).enumerate() {
            let range = self.starts[unit] as usize..self.starts[unit + 1] as usize;
            let (times, keypoints) = (&self.times[range.clone()], &keypoints[range]);
            if times.is_empty() {
                continue;
            }
            let mut k = *cursor as usize;
            while k + 1 < times.len() && usize::from(times[k + 1]) <= timestep {
                k += 1;
            }
            while k > 0 && usize::from(times[k]) > timestep {
                k -= 1;
            }
            *cursor = k as u32;
            let before = keypoints[k];
            let fraction = fraction(times, k, timestep);
            let value = if fraction > 0.0 {
                std::array::from_fn(|c| lerp(before[c], keypoints[k + 1][c], fraction))
            } else {
                before
            };
            values[place as usize..place as usize + C].copy_from_slice(&finish(value));
        }
    }
}
