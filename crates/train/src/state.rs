//! The optimisation's state: what checkpoints, density control and evaluation look at, and what engines
//! compute with. What lives here: memory of the host, and what changes it without looking at an image.

use std::sync::Arc;

use rayon::prelude::*;
use tcgs_core::{Attribute, Gaussians, normalize};

use crate::engine::cpu::{FakeQuantizers, Moments, Neighbors};
use crate::parameters::Parameters;

/// Adam's moments of every group.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Optimizer {
    /// By [`Attribute::index`].
    pub attributes: [Moments; 5],
    /// Mask logits.
    pub mask: Moments,
    /// Camera gains.
    pub gains: Moments,
    /// Camera offsets.
    pub offsets: Moments,
    /// Quantizers' steps.
    pub quantizer_steps: Moments,
    /// Quantizers' offsets.
    pub quantizer_offsets: Moments,
}

impl Optimizer {
    /// Zero moments for `parameters`.
    pub fn new(parameters: &Parameters, num_quantizers: usize) -> Self {
        let cameras = 3 * parameters.camera_gains.len();
        Self {
            attributes: Attribute::BASE.map(|a| Moments::new(parameters.gaussians.values(a).len())),
            mask: Moments::new(parameters.num_gaussians()),
            gains: Moments::new(cameras),
            offsets: Moments::new(cameras),
            quantizer_steps: Moments::new(num_quantizers),
            quantizer_offsets: Moments::new(num_quantizers),
        }
    }

    /// Rows of the Gaussians' moments taken from `sources`; a fresh row starts from zero.
    pub fn gather(&mut self, sources: &[(usize, bool)]) {
        for attribute in Attribute::BASE {
            self.attributes[attribute.index()].gather(sources, attribute.components());
        }
        self.mask.gather(sources, 1);
    }
}

/// The densification statistic: NDC gradients of visible Gaussians, summed, and how often.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct GradientStatistic {
    /// `[N]` sum of norms.
    pub sum: Vec<f32>,
    /// `[N]` times visible.
    pub count: Vec<u32>,
}

impl GradientStatistic {
    /// Nothing counted for `num_gaussians`.
    pub fn new(num_gaussians: usize) -> Self {
        Self { sum: vec![0.0; num_gaussians], count: vec![0; num_gaussians] }
    }
}

/// Where every Gaussian was at one timestep.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Pose {
    /// `[N, 3]` centres, scene units.
    pub means: Vec<[f32; 3]>,
    /// `[N, 4]` rotations, `w, x, y, z`.
    pub quats: Vec<[f32; 4]>,
}

impl Pose {
    /// Where `gaussians` are.
    pub fn of(gaussians: &Gaussians) -> Self {
        Self { means: gaussians.means().to_vec(), quats: gaussians.quats().to_vec() }
    }
}

/// What the losses on motion compare with.
#[derive(Clone, Debug)]
pub struct Past {
    /// Of the first timestep.
    pub first: Arc<Pose>,
    /// Who was near whom then; fixed from then on.
    pub neighbors: Arc<Neighbors<f32>>,
    /// The timestep before.
    pub previous: Gaussians,
}

/// State of the optimisation, in the host's memory.
#[derive(Clone, Debug)]
pub struct State {
    /// What is optimised.
    pub parameters: Parameters,
    /// Adam.
    pub optimizer: Optimizer,
    /// Quantisation, once it has started.
    pub quantizers: Option<FakeQuantizers>,
    /// After the first timestep.
    pub past: Option<Past>,
    /// Mask logits of the timestep before, after the first.
    pub previous_mask_logits: Option<Vec<f32>>,
    /// For densification.
    pub statistic: GradientStatistic,
}

impl State {
    /// A fresh optimisation.
    pub fn new(parameters: Parameters) -> Self {
        Self {
            optimizer: Optimizer::new(&parameters, 0),
            statistic: GradientStatistic::new(parameters.num_gaussians()),
            parameters,
            quantizers: None,
            past: None,
            previous_mask_logits: None,
        }
    }

    /// Rows taken from `sources`, with their moments, their share of the statistic and their bit widths.
    ///
    /// - `sources`: index of each new row's old one, and whether it is fresh: then its moments are zero
    pub fn gather(&mut self, sources: &[(usize, bool)]) {
        let indices: Vec<usize> = sources.iter().map(|s| s.0).collect();
        self.parameters = self.parameters.select(&indices);
        self.optimizer.gather(sources);
        if let Some(quantizers) = &mut self.quantizers {
            quantizers.select(&indices);
        }
        let old = &self.statistic;
        self.statistic = GradientStatistic {
            sum: indices.iter().map(|&i| old.sum[i]).collect(),
            count: indices.iter().map(|&i| old.count[i]).collect(),
        };
    }

    /// Brings rotations into the form that files hold: unit length, `w >= 0`. To be done before anything
    /// is measured for quantisation, so that quantizers are fitted to what they will round.
    pub fn canonicalize_quats(&mut self) {
        self.parameters.gaussians.quats_mut().par_iter_mut().for_each(|quat| {
            let unit = normalize(*quat);
            *quat = if unit[0] < 0.0 { unit.map(|x| -x) } else { unit };
        });
    }

    /// Starts quantising: Adam begins anew at that moment, as in the authors' fork.
    ///
    /// - `quantizers`: for the Gaussians as they are now, after [`Self::canonicalize_quats`]
    pub fn start_quantization(&mut self, quantizers: FakeQuantizers) {
        self.optimizer = Optimizer::new(&self.parameters, quantizers.quantizers.len());
        self.quantizers = Some(quantizers);
    }
}
