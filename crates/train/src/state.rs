//! The optimisation's state: the data that checkpoints, density control and evaluation read, and with which engines
//! compute. What lives here: host memory, and its changes that need no image.

use std::sync::Arc;

use rayon::prelude::*;
use tcgs_core::{Attribute, Column, Columns, RateGroup, normalize, role};

use crate::adam::{Moments, adam};
use crate::fake_quant::FakeQuantizers;
use crate::lifetimes::Lifetimes;
use crate::motion::{Past, Pose};
use crate::parameters::Parameters;
use crate::row::Row;

/// Adam's moments and counts of updates of all learned parameters.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Optimizer {
    /// `[N]` running means of the gradients of all columns.
    pub first: Columns<role::FirstMoment>,
    /// `[N]` running means of their squares.
    pub second: Columns<role::SecondMoment>,
    /// Number of updates of each column so far, by [`Attribute::index`].
    pub steps: Vec<u64>,
    /// `[N]`, moments of the mask logits.
    pub mask: Moments,
    /// `[cameras * 3]`, moments of the cameras' gains.
    pub gains: Moments,
    /// `[cameras * 3]`, moments of the cameras' offsets.
    pub offsets: Moments,
    /// `[quantizers]`, moments of the quantizers' steps.
    pub quantizer_steps: Moments,
    /// `[quantizers]`, moments of the quantizers' offsets.
    pub quantizer_offsets: Moments,
}

impl Optimizer {
    /// Zero moments for `parameters`.
    pub fn new(parameters: &Parameters, num_quantizers: usize) -> Self {
        let (n, cameras) = (parameters.num_gaussians(), 3 * parameters.camera_gains.len());
        let layout = parameters.gaussians.layout();
        Self {
            first: Columns::zeros_of(layout, n),
            second: Columns::zeros_of(layout, n),
            steps: vec![0; layout.columns().len()],
            mask: Moments::new(n),
            gains: Moments::new(cameras),
            offsets: Moments::new(cameras),
            quantizer_steps: Moments::new(num_quantizers),
            quantizer_offsets: Moments::new(num_quantizers),
        }
    }

    /// One update of a column; see [`adam`].
    ///
    /// - `values`: `[n * components]` of the first `n` Gaussians, updated in place
    /// - `v_values`: likewise, their gradient
    ///
    /// # Panics
    /// If lengths differ, or there are fewer Gaussians.
    pub fn update(&mut self, attribute: Attribute, values: &mut [f32], v_values: &[f32], rate: f32, epsilon: f32) {
        let (first, second) = (self.first.values_mut(attribute), self.second.values_mut(attribute));
        let (first, second) = (&mut first[..values.len()], &mut second[..values.len()]);
        adam(values, v_values, first, second, &mut self.steps[attribute.index()], rate, epsilon);
    }

    /// Sets the moments of a column to zero, as [`Moments::clear`] does.
    pub fn clear(&mut self, attribute: Attribute, count_too: bool) {
        self.first.values_mut(attribute).fill(0.0);
        self.second.values_mut(attribute).fill(0.0);
        if count_too {
            self.steps[attribute.index()] = 0;
        }
    }

    /// Clears the moments that do not carry over to the next timestep: those of poses and of masks.
    ///
    /// - `count_too`: see [`Moments::clear`]
    pub(crate) fn begin_timestep(&mut self, count_too: bool) {
        for column in Arc::clone(self.first.layout()).columns() {
            if !goes_on(column) {
                self.clear(column.attribute, count_too);
            }
        }
        self.mask.clear(count_too);
    }

    /// The part that carries over to the next timestep: moments that [`Self::begin_timestep`] does not clear, and
    /// update counts of all varying columns.
    pub(crate) fn carried_over(&self) -> Self {
        let mut carried = self.clone();
        carried.begin_timestep(false);
        for column in self.first.layout().columns().iter().filter(|column| !column.varies) {
            carried.clear(column.attribute, true);
        }
        let cameras = self.gains.first.len();
        (carried.gains, carried.offsets) = (Moments::new(cameras), Moments::new(cameras));
        carried
    }

    pub(crate) fn gather(&mut self, rows: &[Row]) {
        let kept: Vec<Option<usize>> = rows.iter().map(|row| row.kept()).collect();
        self.first = self.first.select_or_zero(&kept);
        self.second = self.second.select_or_zero(&kept);
        self.mask.gather(rows);
    }
}

/// Whether the moments of a column that varies carry over to the next timestep. Poses were moved by the
/// constant-velocity prediction, so their moments restart at zero.
pub(crate) fn goes_on(column: &Column) -> bool {
    !matches!(column.rate, RateGroup::Mean | RateGroup::Quat)
}

/// The densification statistic: NDC gradients of visible Gaussians, summed, and how often.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct GradientStatistic {
    /// `[N]`, sum of the norms of the NDC gradients.
    pub sum: Vec<f32>,
    /// `[N]`, number of iterations in which the Gaussian was visible.
    pub count: Vec<u32>,
}

impl GradientStatistic {
    /// The statistic of `num_gaussians` before any iteration: all zero.
    pub fn new(num_gaussians: usize) -> Self {
        Self { sum: vec![0.0; num_gaussians], count: vec![0; num_gaussians] }
    }
}

/// State of the optimisation, in the host's memory.
#[derive(Clone, Debug)]
pub struct State {
    /// The learned parameters at the current timestep.
    pub parameters: Parameters,
    /// Identity, birth and death of each Gaussian.
    pub lifetimes: Lifetimes,
    /// Adam's moments and counts of updates.
    pub optimizer: Optimizer,
    /// The learned quantizers; `None` before quantisation has started.
    pub quantizers: Option<FakeQuantizers>,
    /// The earlier poses that the losses on motion compare with; `None` in the first timestep.
    pub past: Option<Past>,
    /// The statistic that density control reads.
    pub statistic: GradientStatistic,
    /// Index of the current timestep, counted from the run's first.
    pub timestep: usize,
    /// Number of Gaussians that are drawn but not trained; they are the last ones. In the first timestep these stand in
    /// no training image, and images show only their edges.
    pub num_fixed: usize,
}

impl State {
    /// The state before the first iteration: zero moments, no quantizers, no past, timestep 0.
    pub fn new(parameters: Parameters) -> Self {
        let num_gaussians = parameters.num_gaussians();
        Self {
            optimizer: Optimizer::new(&parameters, 0),
            statistic: GradientStatistic::new(num_gaussians),
            lifetimes: Lifetimes::new(num_gaussians),
            parameters,
            quantizers: None,
            past: None,
            timestep: 0,
            num_fixed: 0,
        }
    }

    /// Number of Gaussians that are trained, the first ones.
    pub(crate) fn num_trained(&self) -> usize {
        self.parameters.num_gaussians() - self.num_fixed
    }

    /// Records the first timestep as the past, if it is the previous one. No motion is known yet. Every Gaussian may be
    /// trained from then on.
    pub(crate) fn begin_past(&mut self) {
        let p = &self.parameters;
        self.num_fixed = 0;
        self.past.get_or_insert_with(|| Past::new(Pose::of(&p.gaussians), p.gaussians.clone(), &p.foreground));
    }

    /// Replaces the Gaussians by `rows` of them, with all data of each: values, identity, moments, bit widths, its past
    /// and its share of the statistic. Gaussians that are not trained stay the last.
    pub fn gather(&mut self, rows: &[Row]) {
        let indices: Vec<usize> = rows.iter().map(|row| row.source()).collect();
        let num_trained = self.num_trained();
        self.num_fixed = indices.iter().rev().take_while(|&&i| i >= num_trained).count();
        self.parameters = self.parameters.select(&indices);
        self.lifetimes.gather(rows, self.timestep as u32);
        self.optimizer.gather(rows);
        if let Some(quantizers) = &mut self.quantizers {
            quantizers.select(&indices);
        }
        if let Some(past) = &mut self.past {
            past.gather(&indices, &self.parameters.foreground, &self.lifetimes.births());
        }
        let old = &self.statistic;
        self.statistic = GradientStatistic {
            sum: indices.iter().map(|&i| old.sum[i]).collect(),
            count: indices.iter().map(|&i| old.count[i]).collect(),
        };
    }

    /// Appends Gaussians that are born at the current timestep: with zero moments, and at rest since their birth.
    pub(crate) fn append(&mut self, born: &Parameters) {
        let (before, count) = (self.parameters.num_gaussians(), born.num_gaussians());
        self.parameters.append(born);
        self.lifetimes.append(count, self.timestep as u32);
        let rows: Vec<Row> =
            (0..before + count).map(|i| if i < before { Row::Kept(i) } else { Row::New { parent: 0 } }).collect();
        self.optimizer.gather(&rows);
        if let Some(quantizers) = &mut self.quantizers {
            quantizers.append(count);
        }
        if let Some(past) = &mut self.past {
            past.append(&Pose::of(&born.gaussians), &born.gaussians, &born.foreground);
            if let Some(logits) = &mut past.previous_mask_logits {
                logits.extend_from_slice(&born.mask_logits);
            }
        }
        self.statistic.sum.resize(before + count, 0.0);
        self.statistic.count.resize(before + count, 0);
    }

    /// Removes Gaussians, with all their data, and records that they die at the current timestep.
    ///
    /// - `dead`: their indices, ascending
    pub(crate) fn bury(&mut self, dead: &[usize]) {
        self.lifetimes.end(dead, self.timestep as u32);
        let lives = |i: &usize| dead.binary_search(i).is_err();
        let rows: Vec<Row> = (0..self.parameters.num_gaussians()).filter(lives).map(Row::Kept).collect();
        self.gather(&rows);
    }

    /// Poses at birth of the Gaussians born after the first timestep.
    pub(crate) fn born(&self) -> Pose {
        let num_first = self.lifetimes.num_first();
        self.past.as_ref().map_or_else(Pose::default, |past| past.first.range(num_first..past.first.means.len()))
    }

    /// Renumbers the Gaussians from 0 in their order: identities start with the result of the first timestep.
    pub(crate) fn number_anew(&mut self) {
        self.lifetimes = Lifetimes::new(self.parameters.num_gaussians());
    }

    /// Brings rotations into the form of files: unit length, `w >= 0`. Call it before anything is measured for
    /// quantisation, so that quantizers are fitted to the values that they will round.
    pub fn canonicalize_quats(&mut self) {
        self.parameters.gaussians.quats_mut().par_iter_mut().for_each(|quat| {
            let unit = normalize(*quat);
            *quat = if unit[0] < 0.0 { unit.map(|x| -x) } else { unit };
        });
    }

    /// Starts quantising and restarts Adam, as in the authors' fork.
    ///
    /// - `quantizers`: for the current Gaussians, after [`Self::canonicalize_quats`]
    pub fn start_quantization(&mut self, quantizers: FakeQuantizers) {
        self.optimizer = Optimizer::new(&self.parameters, quantizers.quantizers.len());
        self.quantizers = Some(quantizers);
    }
}

#[cfg(test)]
mod tests {
    use tcgs_core::{Gaussians, PointCloud};

    use super::*;
    use crate::motion::Pose;

    /// Every value that belongs to a Gaussian holds the Gaussian's number.
    #[test]
    fn one_gather_moves_everything_that_belongs_to_a_gaussian() {
        let points: Vec<[f32; 3]> = (0..4).map(|i| [i as f32; 3]).collect();
        let cloud = PointCloud { colors: points.clone(), foreground: vec![true; 4], points };
        let mut state = State::new(Parameters::from_cloud(&cloud, 1, 1.0));
        state.timestep = 7;
        state.parameters.mask_logits = vec![0.0, 1.0, 2.0, 3.0];
        let numbered = state.parameters.gaussians.clone();
        state.optimizer.first.means_mut().copy_from_slice(numbered.means());
        state.optimizer.mask.first = vec![0.0, 1.0, 2.0, 3.0];
        state.statistic.count = vec![0, 1, 2, 3];
        let past = Past::new(Pose::of(&numbered), numbered, &[true; 4]);
        state.past = Some(Past { previous_mask_logits: Some(vec![0.0, 1.0, 2.0, 3.0]), ..past });

        state.gather(&[Row::Kept(3), Row::Kept(1), Row::New { parent: 3 }]);
        let numbers = |gaussians: &Gaussians| -> Vec<f32> { gaussians.means().iter().map(|mean| mean[0]).collect() };
        let expected = [3.0, 1.0, 3.0];
        assert_eq!(numbers(&state.parameters.gaussians), expected);
        assert_eq!(state.parameters.mask_logits, expected);
        assert_eq!(state.statistic.count, [3, 1, 3]);
        assert_eq!((&state.lifetimes.ids[..], &state.lifetimes.births()[..]), (&[3, 1, 4][..], &[0, 0, 7][..]));
        // New Gaussians start without moments.
        assert_eq!(state.optimizer.first.means(), [[3.0; 3], [1.0; 3], [0.0; 3]]);
        assert_eq!(state.optimizer.mask.first, [3.0, 1.0, 0.0]);
        let past = state.past.unwrap();
        assert_eq!(numbers(&past.previous), expected);
        assert_eq!(past.first.means.iter().map(|mean| mean[0]).collect::<Vec<_>>(), expected);
        assert_eq!(past.previous_mask_logits.unwrap(), expected);
        assert_eq!(
            (past.neighbors.foreground.len(), past.neighbors.indices[0]),
            (3, 1),
            "the other one of those born at 0"
        );
    }
}
