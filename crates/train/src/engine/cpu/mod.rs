//! The optimisation on the CPU. Same bits for any number of threads.

mod adam;
mod fake_quant;
mod image_loss;
mod mask;
mod motion_prior;

pub use adam::Moments;
pub use fake_quant::{FakeQuantizers, fake_quant, fake_quant_vjp, step_gradient_scale};
pub use image_loss::{ImageLoss, Target, image_loss};
pub use mask::{mask, mask_consistency_loss, mask_loss, mask_vjp};
pub use motion_prior::{MotionPrior, Neighbors, PriorGrads, PriorLosses, PriorWeights, predict};

use rayon::prelude::*;
use tcgs_core::{Activated, ActivatedGrads, Attribute, Gaussians, activate, activate_bwd, normalize};
use tcgs_render::{CpuRasterizer, Rasterizer, RenderSettings};

use crate::config::{MaskConfig, WeightConfig};
use crate::parameters::Parameters;
use crate::schedule::Rates;

/// Fewest Gaussians that one task copies.
const CHUNK: usize = 1 << 12;

/// Values of every loss of one iteration, before their weights; 0 where a loss is off.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct LossTerms {
    /// Colour image.
    pub image: f64,
    /// Segmentation image.
    pub segmentation: f64,
    /// Motion.
    pub prior: PriorLosses,
    /// `L_mask`
    pub mask: f64,
    /// `L_mc`
    pub mask_consistency: f64,
}

impl LossTerms {
    /// Names, values and weights of all terms.
    pub fn terms(&self, w: &WeightConfig) -> [(&'static str, f64, f32); 10] {
        [
            ("image", self.image, w.image),
            ("segmentation", self.segmentation, w.segmentation),
            ("rigid", self.prior.rigid, w.rigid),
            ("rot", self.prior.rot, w.rot),
            ("iso", self.prior.iso, w.iso),
            ("floor", self.prior.floor, w.floor),
            ("background", self.prior.background, w.background),
            ("soft_color", self.prior.soft_color, w.soft_color),
            ("mask", self.mask, w.mask),
            ("mask_consistency", self.mask_consistency, w.mask_consistency),
        ]
    }

    /// Weighted sum.
    pub fn total(&self, weights: &WeightConfig) -> f64 {
        self.terms(weights).iter().map(|(_, value, weight)| value * f64::from(*weight)).sum()
    }
}

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
            attributes: Attribute::ALL.map(|a| Moments::new(parameters.gaussians.values(a).len())),
            mask: Moments::new(parameters.num_gaussians()),
            gains: Moments::new(cameras),
            offsets: Moments::new(cameras),
            quantizer_steps: Moments::new(num_quantizers),
            quantizer_offsets: Moments::new(num_quantizers),
        }
    }

    /// Rows of the Gaussians' moments taken from `sources`; a fresh row starts from zero.
    pub fn gather(&mut self, sources: &[(usize, bool)]) {
        for attribute in Attribute::ALL {
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

/// What one iteration is asked for, beside its target.
#[derive(Clone, Copy, Debug)]
pub struct Step<'a> {
    /// Position of the camera in the timestep's list.
    pub camera: usize,
    /// Learning rates.
    pub rates: Rates,
    /// Weights of the losses.
    pub weights: &'a WeightConfig,
    /// Masks.
    pub mask: &'a MaskConfig,
    /// Whether to count gradients for densification.
    pub counts_gradients: bool,
}

/// Gradients of one iteration, in stored form.
#[derive(Clone, Debug)]
pub struct StepGrads {
    gaussians: Gaussians,
    mask_logits: Vec<f32>,
    v_gain: [f32; 3],
    v_offset: [f32; 3],
    quantizers: Option<(Vec<f32>, Vec<f32>)>,
}

/// What one forward chain leaves for the backward one.
struct Chain {
    quantized: Option<Gaussians>,
    drawn: Activated,
    /// Scales and opacities before the mask, if there is one.
    unmasked: Option<(Vec<[f32; 3]>, Vec<f32>)>,
}

/// State of the optimisation on the CPU.
#[derive(Clone, Debug)]
pub struct CpuEngine {
    /// What is optimised.
    pub parameters: Parameters,
    /// Adam.
    pub optimizer: Optimizer,
    /// Quantisation, once it has started.
    pub quantizers: Option<FakeQuantizers>,
    /// Losses on motion, after the first timestep.
    pub prior: Option<MotionPrior<f32>>,
    /// Mask logits of the timestep before, after the first.
    pub previous_mask_logits: Option<Vec<f32>>,
    /// For densification.
    pub statistic: GradientStatistic,
}

impl CpuEngine {
    /// A fresh optimisation.
    pub fn new(parameters: Parameters) -> Self {
        Self {
            optimizer: Optimizer::new(&parameters, 0),
            statistic: GradientStatistic::new(parameters.num_gaussians()),
            parameters,
            quantizers: None,
            prior: None,
            previous_mask_logits: None,
        }
    }

    /// What the model draws now: stored, fake-quantised, activated, masked; with two channels of
    /// segmentation beside the colours if asked for.
    pub fn drawn(&self, mask: &MaskConfig, with_segmentation: bool) -> Activated {
        self.chain(mask, with_segmentation).drawn
    }

    /// The forward chain: quantised (if on), activated, and what is drawn.
    fn chain(&self, mask_config: &MaskConfig, with_segmentation: bool) -> Chain {
        let quantized = self.quantizers.as_ref().map(|q| q.forward(&self.parameters.gaussians));
        let mut drawn = activate(quantized.as_ref().unwrap_or(&self.parameters.gaussians));
        let unmasked = mask_config.enabled.then(|| (drawn.scales.clone(), drawn.opacities.clone()));
        if mask_config.enabled {
            (&mut drawn.scales, &mut drawn.opacities, &self.parameters.mask_logits).into_par_iter().for_each(
                |(scale, opacity, &logit)| {
                    let m = mask(logit, mask_config.threshold);
                    *scale = scale.map(|s| s * m);
                    *opacity *= m;
                },
            );
        }
        if with_segmentation {
            let mut colors = vec![0.0; 5 * drawn.num_gaussians()];
            colors
                .par_chunks_exact_mut(5)
                .zip(drawn.colors.par_chunks_exact(3))
                .zip(&self.parameters.foreground)
                .with_min_len(CHUNK)
                .for_each(|((five, color), &f)| {
                    five[..3].copy_from_slice(color);
                    five[3..].copy_from_slice(&[f32::from(u8::from(f)), f32::from(u8::from(!f))]);
                });
            (drawn.colors, drawn.num_channels) = (colors, 5);
        }
        Chain { quantized, drawn, unmasked }
    }

    /// Losses and gradients on one image; counts the densification statistic.
    pub fn forward_backward(&mut self, target: &Target, step: &Step<'_>) -> (LossTerms, StepGrads) {
        let with_segmentation = target.image.num_channels == 5;
        let Chain { quantized, drawn, unmasked } = self.chain(step.mask, with_segmentation);
        let settings = RenderSettings::default();
        let (output, saved) = CpuRasterizer.forward(&drawn, &target.camera, &settings);
        let loss = image_loss(
            &output.image,
            &target.image,
            self.parameters.camera_gains[step.camera],
            self.parameters.camera_offsets[step.camera],
            step.weights.image,
            step.weights.segmentation,
        );
        let render = CpuRasterizer.backward(&drawn, &target.camera, &settings, &saved, &loss.v_image);
        if step.counts_gradients {
            (&mut self.statistic.sum, &mut self.statistic.count, &render.v_means2d_ndc, &render.visible)
                .into_par_iter()
                .for_each(|(sum, count, v, &visible)| {
                    if visible {
                        *sum += (v[0] * v[0] + v[1] * v[1]).sqrt();
                        *count += 1;
                    }
                });
        }

        let mut terms = LossTerms { image: loss.image, segmentation: loss.segmentation, ..LossTerms::default() };
        let mut v_activated = colors_alone(render.activated, drawn.num_channels);
        // Drawing is over: from here on scales and opacities are those before the mask.
        let activated = match unmasked {
            Some((scales, opacities)) => Activated { scales, opacities, ..drawn },
            None => drawn,
        };
        let mut v_mask_logits = vec![0.0; self.parameters.num_gaussians()];
        if step.mask.enabled {
            self.mask_bwd(step, &activated, &mut v_activated, &mut v_mask_logits, &mut terms);
        }
        let mut v_gaussians =
            activate_bwd(quantized.as_ref().unwrap_or(&self.parameters.gaussians), &activated, &v_activated);
        let quantizers = self.quantizers.as_ref().map(|q| q.backward(&self.parameters.gaussians, &mut v_gaussians));
        if let Some(prior) = &self.prior {
            let Gaussians { means, quats, colors, .. } = &self.parameters.gaussians;
            let w = step.weights;
            let weights = PriorWeights {
                rigid: w.rigid,
                rot: w.rot,
                iso: w.iso,
                floor: if with_segmentation { w.floor } else { 0.0 },
                background: w.background,
                soft_color: w.soft_color,
            };
            let grads = PriorGrads {
                v_means: &mut v_gaussians.means,
                v_quats: &mut v_gaussians.quats,
                v_colors: &mut v_gaussians.colors,
            };
            terms.prior = prior.losses(means, quats, colors, &weights, grads);
        }
        let grads = StepGrads {
            gaussians: v_gaussians,
            mask_logits: v_mask_logits,
            v_gain: loss.v_gain,
            v_offset: loss.v_offset,
            quantizers,
        };
        (terms, grads)
    }

    /// Backward of the mask, and its own losses. `v_activated` comes in as the gradient to masked
    /// scales and opacities.
    fn mask_bwd(
        &self,
        step: &Step<'_>,
        activated: &Activated,
        v_activated: &mut ActivatedGrads,
        v_mask_logits: &mut [f32],
        terms: &mut LossTerms,
    ) {
        let logits = &self.parameters.mask_logits;
        (
            &mut *v_mask_logits,
            logits,
            &activated.scales,
            &activated.opacities,
            &mut v_activated.v_scales,
            &mut v_activated.v_opacities,
        )
            .into_par_iter()
            .for_each(|(v_logit, &logit, scale, &opacity, v_scale, v_opacity)| {
                let v_mask =
                    scale[0] * v_scale[0] + scale[1] * v_scale[1] + scale[2] * v_scale[2] + opacity * *v_opacity;
                *v_logit = mask_vjp(logit, v_mask);
                let m = mask(logit, step.mask.threshold);
                *v_scale = v_scale.map(|v| v * m);
                *v_opacity *= m;
            });
        terms.mask = mask_loss(logits, |n, v| v_mask_logits[n] += step.weights.mask * v);
        if let Some(previous) = &self.previous_mask_logits {
            terms.mask_consistency = mask_consistency_loss(logits, previous, |n, v| {
                v_mask_logits[n] += step.weights.mask_consistency * v;
            });
        }
    }

    /// Moves the parameters.
    ///
    /// - `gaussians_too`: false right after densification, whose new Gaussians have no gradient
    pub fn update(&mut self, grads: &StepGrads, step: &Step<'_>, gaussians_too: bool) {
        let p = &mut self.parameters;
        let o = &mut self.optimizer;
        let rates = &step.rates;
        if gaussians_too {
            for attribute in Attribute::ALL {
                let rate = match attribute {
                    Attribute::Mean => rates.mean,
                    Attribute::Quat => rates.quat,
                    Attribute::LogScale => rates.log_scale,
                    Attribute::LogitOpacity => rates.logit_opacity,
                    Attribute::Color => rates.color,
                };
                let v = grads.gaussians.values(attribute);
                o.attributes[attribute.index()].update(p.gaussians.values_mut(attribute), v, rate);
            }
            if step.mask.enabled {
                o.mask.update(&mut p.mask_logits, &grads.mask_logits, rates.mask);
            }
        }
        if rates.camera > 0.0 {
            // As in the reference, the other cameras have a zero gradient rather than none.
            let mut v_gains = vec![[0.0; 3]; p.camera_gains.len()];
            let mut v_offsets = v_gains.clone();
            v_gains[step.camera] = grads.v_gain;
            v_offsets[step.camera] = grads.v_offset;
            o.gains.update(p.camera_gains.as_flattened_mut(), v_gains.as_flattened(), rates.camera);
            o.offsets.update(p.camera_offsets.as_flattened_mut(), v_offsets.as_flattened(), rates.camera);
        }
        if let (Some(q), Some((v_steps, v_offsets))) = (&mut self.quantizers, &grads.quantizers) {
            q.update(v_steps, v_offsets, &mut o.quantizer_steps, &mut o.quantizer_offsets, rates.step);
            // Codes are those of unit quaternions.
            p.gaussians.quats.par_iter_mut().for_each(|quat| *quat = normalize(*quat));
        }
    }

    /// Brings rotations into the form that files hold: unit length, `w >= 0`. To be done before anything
    /// is measured for quantisation, so that quantizers are fitted to what they will round.
    pub fn canonicalize_quats(&mut self) {
        self.parameters.gaussians.quats.par_iter_mut().for_each(|quat| {
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

/// Drops the gradients of channels beyond the colours: segmentation is not learned.
fn colors_alone(mut grads: ActivatedGrads, num_channels: usize) -> ActivatedGrads {
    if num_channels > 3 {
        let mut v_colors = vec![0.0; grads.v_colors.len() / num_channels * 3];
        v_colors
            .par_chunks_exact_mut(3)
            .zip(grads.v_colors.par_chunks_exact(num_channels))
            .with_min_len(CHUNK)
            .for_each(|(three, all)| three.copy_from_slice(&all[..3]));
        grads.v_colors = v_colors;
    }
    grads
}
