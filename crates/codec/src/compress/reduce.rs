//! The second pass over a scene: keypoint selection for all tracks, as floats. Quantisation follows in the parent
//! module.

use rayon::prelude::*;
use tcgs_core::{Attribute, SceneReader};

use super::CompressSettings;
use super::gather::{BLOCK, IDENTITY, gather};
use super::statistics::{Statistics, Stillness, chunks, read};
use super::tolerances::Tolerances;
use crate::compact::Tracks;
use crate::error::CompressError;
use crate::keypoints::{Selector, fit_values};

/// Memory for whole tracks that are held together, in bytes.
const TRACK_BYTES: usize = 256 << 20;

/// Keypoints of one column.
pub(super) enum Reduced {
    /// Each track has its own keypoints.
    Apart {
        /// Number of tracks of a Gaussian.
        components: usize,
        /// `[N * components]` tracks.
        tracks: Tracks<f32>,
    },
    /// The components of an attribute of a Gaussian share their keypoints.
    Joint(JointKeypoints),
}

/// Keypoints shared by the components of each Gaussian, segment by segment.
pub(super) struct JointKeypoints {
    components: usize,
    /// `[N]` index of a Gaussian's unit in every segment; [`STILL`] if the Gaussian is constant.
    units: Vec<u32>,
    /// `[N, components]` values of constant Gaussians.
    constants: Vec<f32>,
    segments: Vec<SegmentKeypoints>,
}

/// Value in [`JointKeypoints::units`] of a constant Gaussian.
const STILL: u32 = u32::MAX;

/// Keypoints of the moving units within a span of timesteps.
#[derive(Default)]
struct SegmentKeypoints {
    /// `[units]` end of each unit's range in `times`.
    ends: Vec<u32>,
    /// `[keypoints]` timesteps.
    times: Vec<u16>,
    /// `[keypoints, components]` values.
    values: Vec<f32>,
}

impl Reduced {
    /// Appends the values of a track at its keypoints, and their timesteps if `times` is given.
    pub(super) fn append(
        &self,
        gaussian: usize,
        channel: usize,
        mut times: Option<&mut Vec<u16>>,
        values: &mut Vec<f32>,
    ) {
        let joint = match self {
            Self::Apart { components, tracks } => {
                let (of_track, values_of_track) = tracks.track(gaussian * components + channel);
                if let Some(times) = times {
                    times.extend_from_slice(of_track);
                }
                return values.extend_from_slice(values_of_track);
            }
            Self::Joint(joint) => joint,
        };
        let (unit, components) = (joint.units[gaussian], joint.components);
        if unit == STILL {
            if let Some(times) = times {
                times.push(0);
            }
            return values.push(joint.constants[gaussian * components + channel]);
        }
        for segment in &joint.segments {
            let keypoints = segment.unit(unit as usize);
            if let Some(times) = &mut times {
                times.extend_from_slice(&segment.times[keypoints.clone()]);
            }
            values.extend(keypoints.map(|k| segment.values[k * components + channel]));
        }
    }

    /// Value of a track at its first keypoint.
    pub(super) fn first(&self, gaussian: usize, channel: usize) -> f32 {
        match self {
            Self::Apart { components, tracks } => tracks.track(gaussian * components + channel).1[0],
            Self::Joint(joint) => match joint.units[gaussian] {
                STILL => joint.constants[gaussian * joint.components + channel],
                unit => {
                    let segment = &joint.segments[0];
                    segment.values[segment.unit(unit as usize).start * joint.components + channel]
                }
            },
        }
    }
}

impl SegmentKeypoints {
    fn unit(&self, unit: usize) -> std::ops::Range<usize> {
        let start = if unit == 0 { 0 } else { self.ends[unit - 1] as usize };
        start..self.ends[unit] as usize
    }

    fn append(&mut self, other: &Self) {
        let base = self.times.len() as u32;
        self.ends.extend(other.ends.iter().map(|end| base + end));
        self.times.extend_from_slice(&other.times);
        self.values.extend_from_slice(&other.values);
    }

    fn concat(blocks: &[Self]) -> Self {
        let total = |len: fn(&Self) -> usize| blocks.iter().map(len).sum();
        let mut all = Self {
            ends: Vec::with_capacity(total(|b| b.ends.len())),
            times: Vec::with_capacity(total(|b| b.times.len())),
            values: Vec::with_capacity(total(|b| b.values.len())),
        };
        blocks.iter().for_each(|block| all.append(block));
        all
    }
}

/// Keypoints of a column that does not vary: one per track.
pub(super) fn constant(statistics: &Statistics, attribute: Attribute, settings: &CompressSettings) -> Reduced {
    let (mut tracks, mut selector) = (Tracks::default(), Selector::default());
    let components = attribute.components();
    let gaussians: Vec<u32> = (0..statistics.first.num_gaussians() as u32).collect();
    let mut before = vec![IDENTITY; gaussians.len()];
    let values = gather(std::slice::from_ref(&statistics.first), attribute, &gaussians, &mut before);
    for value in &values {
        let (times, values) = reduce(std::slice::from_ref(value), 0.0, settings, &mut selector);
        tracks.push(&times, &values);
    }
    Reduced::Apart { components, tracks }
}

/// Keypoints of the columns that vary, selected for each track separately.
///
/// Reads the scene once for each block of Gaussians whose whole tracks fit into [`TRACK_BYTES`].
pub(super) fn apart<R: SceneReader>(
    reader: &mut R,
    columns: &[(Attribute, &Tolerances<'_>)],
    settings: &CompressSettings,
) -> Result<Vec<Reduced>, CompressError> {
    let (num_gaussians, num_timesteps) = (reader.num_gaussians_at(0), reader.num_timesteps());
    let components: usize = columns.iter().map(|(attribute, _)| attribute.components()).sum();
    let at_once = (TRACK_BYTES / (size_of::<f32>() * components.max(1) * num_timesteps)).max(BLOCK);
    let mut tracks: Vec<Tracks<f32>> = columns.iter().map(|_| Tracks::default()).collect();
    for start in (0..num_gaussians).step_by(at_once) {
        let gaussians: Vec<u32> = (start as u32..(start + at_once).min(num_gaussians) as u32).collect();
        // `[gaussians, components, T]` values.
        let mut values: Vec<Vec<f32>> =
            columns.iter().map(|(a, _)| vec![0.0; gaussians.len() * a.components() * num_timesteps]).collect();
        let mut rotations = vec![IDENTITY; gaussians.len()];
        let layout = reader.layout().clone();
        for chunk in chunks(&layout, num_gaussians, num_timesteps) {
            let timesteps = read(reader, chunk.clone())?;
            for ((attribute, _), values) in columns.iter().zip(&mut values) {
                let blocks = values.par_chunks_mut(BLOCK * attribute.components() * num_timesteps);
                let gaussians = gaussians.par_chunks(BLOCK).zip(rotations.par_chunks_mut(BLOCK));
                blocks.zip(gaussians).for_each(|(values, (gaussians, before))| {
                    let now = gather(&timesteps, *attribute, gaussians, before);
                    for (to, from) in values.chunks_exact_mut(num_timesteps).zip(now.chunks_exact(chunk.len())) {
                        to[chunk.clone()].copy_from_slice(from);
                    }
                });
            }
        }
        for (((attribute, tolerances), values), tracks) in columns.iter().zip(&values).zip(&mut tracks) {
            let components = attribute.components();
            let blocks = values.par_chunks(BLOCK * components * num_timesteps).zip(gaussians.par_chunks(BLOCK));
            let blocks: Vec<Tracks<f32>> = blocks
                .map_init(Selector::default, |selector, (values, gaussians)| {
                    let mut tracks = Tracks::default();
                    for (values, &gaussian) in values.chunks_exact(components * num_timesteps).zip(gaussians) {
                        let tolerances = tolerances.of(gaussian as usize);
                        for (track, max_mse) in values.chunks_exact(num_timesteps).zip(tolerances) {
                            let (times, values) = reduce(track, max_mse, settings, selector);
                            tracks.push(&times, &values);
                        }
                    }
                    tracks
                })
                .collect();
            blocks.iter().for_each(|block| tracks.append(block));
        }
    }
    let reduced = columns.iter().zip(tracks);
    Ok(reduced.map(|((a, _), tracks)| Reduced::Apart { components: a.components(), tracks }).collect())
}

/// Selects the keypoints of one track.
fn reduce(track: &[f32], max_mse: f32, settings: &CompressSettings, selector: &mut Selector) -> (Vec<u16>, Vec<f32>) {
    if !settings.keypoints {
        return ((0..track.len()).map(|t| t as u16).collect(), track.to_vec());
    }
    if settings.constant_tracks {
        let count = track.len() as f64;
        let mean = (track.iter().map(|&x| f64::from(x)).sum::<f64>() / count) as f32;
        let mse = track.iter().map(|&x| (f64::from(x) - f64::from(mean)).powi(2)).sum::<f64>() / count;
        if mse <= f64::from(max_mse) {
            return (vec![0], vec![mean]);
        }
    }
    let indices = selector.select(track, settings.max_keypoints, max_mse);
    (indices.iter().map(|&i| i as u16).collect(), indices.iter().map(|&i| track[i]).collect())
}

/// A column whose keypoints are selected segment by segment.
struct Column<'a> {
    attribute: Attribute,
    tolerances: &'a Tolerances<'a>,
    /// Gaussians that are not certain to be constant.
    gaussians: Vec<u32>,
    /// `[gaussians]` whether the test for a constant Gaussian is within rounding error.
    uncertain: Vec<bool>,
    /// `[gaussians, components]` means over all timesteps.
    means: Vec<f32>,
    /// `[gaussians, components]` sums of squared distances to `means`, for the uncertain Gaussians.
    errors: Vec<f64>,
    /// Quaternions at the last timestep read, from which [`gather`] continues.
    rotations: Vec<[f32; 4]>,
    segments: Vec<SegmentKeypoints>,
}

/// Keypoints of the columns that vary, shared by a Gaussian's components, segment by segment.
///
/// Reads the scene once, and holds the timesteps of one segment.
pub(super) fn jointly<R: SceneReader>(
    reader: &mut R,
    statistics: &Statistics,
    columns: &[(Attribute, &Tolerances<'_>)],
    segment_length: usize,
    settings: &CompressSettings,
) -> Result<Vec<Reduced>, CompressError> {
    let num_timesteps = reader.num_timesteps();
    let mut columns: Vec<Column<'_>> =
        columns.iter().map(|&(a, tolerances)| Column::new(statistics, a, tolerances, settings)).collect();
    for start in (0..num_timesteps).step_by(segment_length) {
        let timesteps = read(reader, start..(start + segment_length).min(num_timesteps))?;
        for column in &mut columns {
            column.reduce(&timesteps, start, settings);
        }
    }
    Ok(columns.into_iter().map(|column| column.finish(statistics)).collect())
}

impl<'a> Column<'a> {
    fn new(
        statistics: &Statistics,
        attribute: Attribute,
        tolerances: &'a Tolerances<'a>,
        settings: &CompressSettings,
    ) -> Self {
        let components = attribute.components();
        let stillness = |gaussian: u32| {
            if !settings.constant_tracks {
                return Stillness::Moves;
            }
            statistics.stillness(attribute, gaussian as usize, &weights(tolerances, gaussian))
        };
        let all = 0..statistics.first.num_gaussians() as u32;
        let (gaussians, uncertain): (Vec<u32>, Vec<bool>) = all
            .into_par_iter()
            .map(|gaussian| (gaussian, stillness(gaussian)))
            .filter(|(_, stillness)| *stillness != Stillness::Still)
            .map(|(gaussian, stillness)| (gaussian, stillness == Stillness::Uncertain))
            .unzip();
        let tracks = gaussians.iter().flat_map(|&g| g as usize * components..(g as usize + 1) * components);
        Self {
            attribute,
            tolerances,
            means: tracks.map(|track| statistics.mean(attribute, track)).collect(),
            errors: vec![0.0; gaussians.len() * components],
            rotations: vec![IDENTITY; gaussians.len()],
            segments: Vec::new(),
            gaussians,
            uncertain,
        }
    }

    /// Selects the keypoints of a segment.
    fn reduce(&mut self, timesteps: &[tcgs_core::Gaussians], start: usize, settings: &CompressSettings) {
        let (attribute, tolerances, components) = (self.attribute, self.tolerances, self.attribute.components());
        let gaussians = self.gaussians.par_chunks(BLOCK).zip(self.rotations.par_chunks_mut(BLOCK));
        let exact = self.errors.par_chunks_mut(BLOCK * components).zip(self.means.par_chunks(BLOCK * components));
        let exact = exact.zip(self.uncertain.par_chunks(BLOCK));
        let blocks: Vec<SegmentKeypoints> = gaussians
            .zip(exact)
            .map_init(Selector::default, |selector, ((gaussians, before), ((errors, means), uncertain))| {
                let values = gather(timesteps, attribute, gaussians, before);
                let mut keypoints = SegmentKeypoints::default();
                for (i, values) in values.chunks_exact(components * timesteps.len()).enumerate() {
                    let tracks: Vec<&[f32]> = values.chunks_exact(timesteps.len()).collect();
                    reduce_segment(
                        &tracks,
                        &weights(tolerances, gaussians[i]),
                        start,
                        settings,
                        selector,
                        &mut keypoints,
                    );
                    if uncertain[i] {
                        let place = i * components..(i + 1) * components;
                        for ((error, &mean), track) in errors[place.clone()].iter_mut().zip(&means[place]).zip(&tracks)
                        {
                            for &x in *track {
                                *error += (f64::from(x) - f64::from(mean)).powi(2);
                            }
                        }
                    }
                }
                keypoints
            })
            .collect();
        self.segments.push(SegmentKeypoints::concat(&blocks));
    }

    fn finish(self, statistics: &Statistics) -> Reduced {
        let (components, num_timesteps) = (self.attribute.components(), statistics.num_timesteps);
        let mut units = vec![STILL; statistics.first.num_gaussians()];
        for (unit, &gaussian) in self.gaussians.iter().enumerate() {
            let errors = &self.errors[unit * components..(unit + 1) * components];
            let errors = errors.iter().zip(weights(self.tolerances, gaussian));
            let error: f64 = errors.map(|(error, weight)| weight * (error / num_timesteps as f64)).sum();
            if !(self.uncertain[unit] && error <= components as f64) {
                units[gaussian as usize] = unit as u32;
            }
        }
        let constants = (0..units.len() * components).map(|track| statistics.mean(self.attribute, track)).collect();
        Reduced::Joint(JointKeypoints { components, units, constants, segments: self.segments })
    }
}

/// Weights of the squared errors of a Gaussian's components: the reciprocals of the tolerances.
fn weights(tolerances: &Tolerances<'_>, gaussian: u32) -> Vec<f64> {
    tolerances.of(gaussian as usize).map(|t| 1.0 / f64::from(t).max(1e-30)).collect()
}

/// Selects keypoints within a segment that all components of an attribute of a Gaussian share.
///
/// - `tracks`: `[components][timesteps]`
/// - `start`: the first of these timesteps
fn reduce_segment(
    tracks: &[&[f32]],
    weights: &[f64],
    start: usize,
    settings: &CompressSettings,
    selector: &mut Selector,
    out: &mut SegmentKeypoints,
) {
    let still = settings.constant_tracks && mean_error(tracks, weights) <= tracks.len() as f64;
    let limit = FIT_GAIN * tracks.len() as f64;
    let indices = selector.select_joint(tracks, weights, if still { 2 } else { settings.max_keypoints }, limit);
    out.times.extend(indices.iter().map(|&i| (start + i) as u16));
    out.ends.push(out.times.len() as u32);
    let first = out.values.len();
    out.values.resize(first + indices.len() * tracks.len(), 0.0);
    for (channel, track) in tracks.iter().enumerate() {
        let places = out.values[first + channel..].iter_mut().step_by(tracks.len());
        if still {
            let mean = mean(track);
            places.for_each(|value| *value = mean);
        } else {
            places.zip(fit_values(track, indices)).for_each(|(value, fitted)| *value = fitted);
        }
    }
}

/// Factor by which the squared error of interpolated samples may exceed the tolerance, because least-squares values
/// then lower it.
const FIT_GAIN: f64 = 1.5;

fn mean(track: &[f32]) -> f32 {
    (track.iter().map(|&x| f64::from(x)).sum::<f64>() / track.len() as f64) as f32
}

/// Mean over time of the weighted sum of squared distances to the means.
fn mean_error(tracks: &[&[f32]], weights: &[f64]) -> f64 {
    let error = |track: &&[f32]| {
        let mean = f64::from(mean(track));
        track.iter().map(|&x| (f64::from(x) - mean).powi(2)).sum::<f64>() / track.len() as f64
    };
    tracks.iter().zip(weights).map(|(track, weight)| weight * error(track)).sum()
}
