//! The first pass over a scene: ranges, means and variances over time, and which columns vary. The second pass
//! (`reduce`) needs these before it reads the first timestep.

use std::ops::Range;
use std::sync::Arc;

use rayon::prelude::*;
use tcgs_core::{Attribute, Gaussians, Layout, SceneReader};

use super::gather::{BLOCK, IDENTITY, gather};
use crate::error::CompressError;

/// Memory for timesteps that are read together, in bytes, unless a segment needs more.
const CHUNK_BYTES: usize = 64 << 20;

/// Result of the first pass.
pub(super) struct Statistics {
    /// The first timestep.
    pub(super) first: Gaussians,
    /// Smallest and largest coordinates of all means at all timesteps.
    pub(super) bounds: [[f32; 3]; 2],
    pub(super) columns: Vec<ColumnStatistics>,
    pub(super) num_timesteps: usize,
    /// [`UNCERTAINTY`] of the sums.
    uncertainty: f64,
}

/// Statistics of one column.
#[derive(Clone, Default)]
pub(super) struct ColumnStatistics {
    /// Whether the column has a value for every timestep.
    pub(super) varies: bool,
    /// `[N * components]`; empty if the column does not vary.
    sums: Vec<Sums>,
    /// `[N * components]` values at the first, the middle and the last timestep; empty if the column does not vary.
    pub(super) samples: Vec<[f32; 3]>,
}

/// Sums over the values of one track.
#[derive(Clone, Copy)]
struct Sums {
    /// Sum of all values, added in the order of time.
    values: f64,
    /// Sum of differences to the first value.
    differences: f64,
    /// Sum of squared differences to the first value.
    squares: f64,
    first: f32,
}

/// Bound on the relative error of sums; the actual error is far below.
const UNCERTAINTY: f64 = 1e-9;

/// Whether a Gaussian's tracks count as constant over time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Stillness {
    Still,
    Moves,
    /// The result is within rounding error: the squared distances to the mean must be summed exactly.
    Uncertain,
}

impl Statistics {
    /// Reads all timesteps once.
    ///
    /// - `varies`: by [`Attribute::index`], whether a column is known to vary; the others vary if a bit of them changes
    pub(super) fn read<R: SceneReader>(reader: &mut R, varies: &[bool]) -> Result<Self, CompressError> {
        let num_timesteps = reader.num_timesteps();
        let first = read_one(reader, 0)?;
        let layout = first.layout().clone();
        let columns = layout.attributes().zip(varies).map(|(attribute, &varies)| {
            let mut column = ColumnStatistics::default();
            if varies {
                column.begin(first.values(attribute), 0);
            }
            column
        });
        let mut of = Self {
            columns: columns.collect(),
            bounds: [[f32::MAX; 3], [f32::MIN; 3]],
            first,
            num_timesteps,
            uncertainty: UNCERTAINTY,
        };
        let mut rotations = vec![IDENTITY; of.first.num_gaussians()];
        let all: Vec<u32> = (0..of.first.num_gaussians() as u32).collect();
        for chunk in chunks(&layout, of.first.num_gaussians(), num_timesteps) {
            let timesteps = read(reader, chunk.clone())?;
            for (gaussians, timestep) in timesteps.iter().zip(chunk.clone()) {
                of.check_finite(gaussians, timestep)?;
                for mean in gaussians.means() {
                    of.bounds[0] = std::array::from_fn(|i| of.bounds[0][i].min(mean[i]));
                    of.bounds[1] = std::array::from_fn(|i| of.bounds[1][i].max(mean[i]));
                }
            }
            for attribute in layout.attributes() {
                of.add(attribute, &timesteps, chunk.start, &all, &mut rotations);
            }
        }
        Ok(of)
    }

    fn check_finite(&self, gaussians: &Gaussians, timestep: usize) -> Result<(), CompressError> {
        for column in gaussians.layout().columns() {
            let values = gaussians.values(column.attribute);
            if let Some(i) = values.iter().position(|x| !x.is_finite()) {
                return Err(CompressError::Gaussian {
                    what: column.name.clone(),
                    gaussian: i / column.components(),
                    timestep: Some(timestep),
                    found: values[i].into(),
                    expected: "a finite number",
                });
            }
        }
        Ok(())
    }

    /// Adds some timesteps of a column.
    ///
    /// - `start`: the first of them
    /// - `all`: indices of all Gaussians
    /// - `rotations`: state of [`gather`]: the last rotations
    fn add(
        &mut self,
        attribute: Attribute,
        timesteps: &[Gaussians],
        start: usize,
        all: &[u32],
        rotations: &mut [[f32; 4]],
    ) {
        let (components, num_timesteps) = (attribute.components(), self.num_timesteps);
        let column = &mut self.columns[attribute.index()];
        let first = self.first.values(attribute);
        if !column.varies {
            // Compared bit by bit: a column that is stored once must be restored exactly.
            let same = |x: &f32, y: &f32| x.to_bits() == y.to_bits();
            let as_first = |now: &Gaussians| now.values(attribute).iter().zip(first).all(|(x, y)| same(x, y));
            if timesteps.iter().all(as_first) {
                return;
            }
            column.begin(first, start);
        }
        let last = num_timesteps - 1;
        let count = timesteps.len();
        let blocks =
            column.sums.par_chunks_mut(BLOCK * components).zip(column.samples.par_chunks_mut(BLOCK * components));
        let gaussians = all.par_chunks(BLOCK).zip(rotations.par_chunks_mut(BLOCK));
        blocks.zip(gaussians).for_each(|((sums, samples), (gaussians, before))| {
            let values = gather(timesteps, attribute, gaussians, before);
            for ((sums, samples), track) in sums.iter_mut().zip(samples).zip(values.chunks_exact(count)) {
                if start == 0 {
                    sums.first = track[0];
                }
                for &x in track {
                    let difference = f64::from(x) - f64::from(sums.first);
                    sums.values += f64::from(x);
                    sums.differences += difference;
                    sums.squares += difference * difference;
                }
                for (sample, at) in samples.iter_mut().zip([0, last / 2, last]) {
                    if let Some(&x) = at.checked_sub(start).and_then(|i| track.get(i)) {
                        *sample = x;
                    }
                }
            }
        });
    }

    /// Mean of a track over time.
    pub(super) fn mean(&self, attribute: Attribute, track: usize) -> f32 {
        (self.columns[attribute.index()].sums[track].values / self.num_timesteps as f64) as f32
    }

    /// Whether the sum over a Gaussian's tracks of weighted mean squared distances to their means is at most their
    /// number.
    pub(super) fn stillness(&self, attribute: Attribute, gaussian: usize, weights: &[f64]) -> Stillness {
        let (components, count) = (attribute.components(), self.num_timesteps as f64);
        let (mut error, mut added) = (0.0, 0.0);
        for (channel, weight) in weights.iter().enumerate() {
            let track = gaussian * components + channel;
            let Sums { differences, squares, first, .. } = self.columns[attribute.index()].sums[track];
            let shift = f64::from(self.mean(attribute, track)) - f64::from(first);
            error += weight * (squares / count - 2.0 * shift * differences / count + shift * shift);
            added += weight * (squares / count + shift * shift);
        }
        let (uncertainty, limit) = (self.uncertainty * added, components as f64);
        if error + uncertainty < limit {
            Stillness::Still
        } else if error - uncertainty > limit {
            Stillness::Moves
        } else {
            Stillness::Uncertain
        }
    }

    /// These statistics with every decision about constant tracks made uncertain.
    #[cfg(test)]
    pub(super) fn all_uncertain(self) -> Self {
        Self { uncertainty: f64::INFINITY, ..self }
    }
}

impl ColumnStatistics {
    /// Starts the sums after `num_before` timesteps that were equal to the first.
    fn begin(&mut self, first: &[f32], num_before: usize) {
        self.varies = true;
        self.samples = first.iter().map(|&x| [x; 3]).collect();
        let values = |x: f32| std::iter::repeat_n(f64::from(x), num_before).sum();
        let sums = first.iter().map(|&x| Sums { values: values(x), differences: 0.0, squares: 0.0, first: x });
        self.sums = sums.collect();
    }
}

/// Divides all timesteps into spans that are read together.
pub(super) fn chunks(
    layout: &Layout,
    num_gaussians: usize,
    num_timesteps: usize,
) -> impl Iterator<Item = Range<usize>> {
    let bytes = size_of::<f32>() * layout.components() * num_gaussians.max(1);
    let length = (CHUNK_BYTES / bytes).clamp(1, num_timesteps.max(1));
    (0..num_timesteps).step_by(length).map(move |start| start..(start + length).min(num_timesteps))
}

/// Reads some timesteps of a scene.
pub(super) fn read<R: SceneReader>(reader: &mut R, timesteps: Range<usize>) -> Result<Vec<Gaussians>, CompressError> {
    timesteps.map(|timestep| read_one(reader, timestep)).collect()
}

pub(super) fn read_one<R: SceneReader>(reader: &mut R, timestep: usize) -> Result<Gaussians, CompressError> {
    let gaussians = reader.at(timestep).map_err(|error| CompressError::Read { timestep, error: Box::new(error) })?;
    let (found, expected) = (gaussians.num_gaussians(), reader.num_gaussians_at(timestep));
    if found != expected {
        let what = format!("Gaussians at timestep {timestep}");
        return Err(CompressError::Count { what, found, expected });
    }
    if !Arc::ptr_eq(gaussians.layout(), reader.layout()) && gaussians.layout() != reader.layout() {
        let (found, expected) = (gaussians.layout().to_string(), reader.layout().to_string());
        return Err(CompressError::Layout { timestep, found, expected });
    }
    Ok(gaussians)
}
