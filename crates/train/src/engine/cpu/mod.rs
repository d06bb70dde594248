//! The CPU engine. The number of threads does not change any bit of the result.

mod image_loss;
mod look;
mod motion_prior;
mod stage;

pub use image_loss::{ImageLoss, image_loss, image_loss_in};
pub(crate) use look::CpuLook;
pub use motion_prior::{MotionPrior, PriorGrads};

use std::sync::Arc;

use rayon::prelude::*;
use tcgs_core::{
    Activated, ActivatedGrads, Camera, GaussianGrads, Gaussians, Image, Sensitivity, activate, activate_bwd, normalize,
    seen_colors, seen_colors_bwd,
};
use tcgs_render::settings::COLOR_CHANNELS;
use tcgs_render::{CpuRasterizer, Laps, Rasterizer, RenderGrads, RenderSettings, Scope, StageTimes};

use self::stage::Stage;
use super::{Engine, LookRenderer, Scenery, Step, Target};
use crate::TrainError;
use crate::config::MaskConfig;
use crate::dropout::Dropout;
use crate::losses::{LossTerms, WeightConfig};
use crate::mask::{mask, mask_consistency_loss, mask_loss, mask_vjp};
use crate::parameters::Parameters;
use crate::sensitivity::sensitivity;
use crate::state::{GradientStatistic, State};

/// Fewest Gaussians that one task copies.
const CHUNK: usize = 1 << 12;

/// Gradients of one iteration's weighted loss with respect to all learned parameters, in stored form.
#[derive(Clone, Debug)]
pub struct StepGrads {
    gaussians: GaussianGrads,
    mask_logits: Vec<f32>,
    v_gain: [f32; 3],
    v_offset: [f32; 3],
    quantizers: Option<(Vec<f32>, Vec<f32>)>,
}

/// A timestep that trains a part of the scene.
#[derive(Clone, Debug)]
struct Staged {
    num_active: usize,
    views: Vec<Stage>,
}

/// Intermediate results of the forward chain that the backward chain needs.
struct DrawnChain {
    quantized: Option<Gaussians>,
    drawn: Activated,
    /// Scales and opacities before the mask, if there is one.
    unmasked: Option<(Vec<[f32; 3]>, Vec<f32>)>,
}

/// The Gaussians that a state renders: fake-quantised if quantisation has started, activated, and masked if masks are
/// on.
///
/// - `with_segmentation`: whether to append two channels to the colours: foreground, background, each 0 or 1
/// - returns: `[N]`, activated; with the colours of degree 0, whatever the direction of view
pub fn drawn(state: &State, mask: &MaskConfig, with_segmentation: bool) -> Activated {
    chain(state, mask, with_segmentation, None).drawn
}

/// The Gaussians that a state renders, and their colours as each camera sees them.
#[derive(Clone, Debug)]
pub(crate) struct Drawn {
    /// With the colours of degree 0.
    activated: Arc<Activated>,
    /// As quantised; none without harmonics.
    seen: Option<Gaussians>,
}

impl Drawn {
    /// - `with_segmentation`: as for [`drawn`]
    pub fn new(state: &State, mask: &MaskConfig, with_segmentation: bool) -> Self {
        let DrawnChain { quantized, drawn, .. } = chain(state, mask, with_segmentation, None);
        let gaussians = &state.parameters.gaussians;
        let has_harmonics = gaussians.layout().sh_degree() > 0;
        Self { activated: Arc::new(drawn), seen: has_harmonics.then(|| quantized.unwrap_or_else(|| gaussians.clone())) }
    }

    /// With the colours of degree 0, for uses that do not depend on colours.
    pub fn activated(&self) -> &Arc<Activated> {
        &self.activated
    }

    /// The Gaussians with the colours that a camera sees.
    pub fn seen_by(&self, camera: &Camera) -> Arc<Activated> {
        match self.colors_seen_by(camera) {
            Some(colors) => Arc::new(Activated { colors, ..Activated::clone(&self.activated) }),
            None => Arc::clone(&self.activated),
        }
    }

    /// The colours that a camera sees, with the channels of segmentation; none if all cameras see the same.
    pub fn colors_seen_by(&self, camera: &Camera) -> Option<Vec<f32>> {
        let seen = seen_colors(self.seen.as_ref()?, camera);
        let mut colors = self.activated.colors.clone();
        let rows = colors.par_chunks_exact_mut(self.activated.num_channels).zip(seen.par_chunks_exact(3));
        rows.with_min_len(CHUNK).for_each(|(row, seen)| row[..3].copy_from_slice(seen));
        Some(colors)
    }

    /// Appends other Gaussians of the same columns.
    pub fn extend(&mut self, others: &Self) {
        Arc::make_mut(&mut self.activated).extend(&others.activated);
        if let (Some(own), Some(others)) = (&mut self.seen, &others.seen) {
            let layout = Arc::clone(own.layout());
            *own = Gaussians::concat(&layout, &[std::mem::take(own), others.clone()]);
        }
    }
}

/// The forward chain: quantises (if on), activates and masks.
///
/// - `camera`: its direction gives the colours of harmonics; none for those of degree 0
fn chain(state: &State, mask_config: &MaskConfig, with_segmentation: bool, camera: Option<&Camera>) -> DrawnChain {
    let p = &state.parameters;
    let quantized = state.quantizers.as_ref().map(|q| q.forward(&p.gaussians));
    let gaussians = quantized.as_ref().unwrap_or(&p.gaussians);
    let mut drawn = activate(gaussians);
    if let Some(camera) = camera.filter(|_| gaussians.layout().sh_degree() > 0) {
        drawn.colors = seen_colors(gaussians, camera);
    }
    let unmasked = mask_config.enabled.then(|| (drawn.scales.clone(), drawn.opacities.clone()));
    if mask_config.enabled {
        (&mut drawn.scales, &mut drawn.opacities, &p.mask_logits).into_par_iter().for_each(
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
            .zip(&p.foreground)
            .with_min_len(CHUNK)
            .for_each(|((five, color), &f)| {
                five[..3].copy_from_slice(color);
                five[3..].copy_from_slice(&[f32::from(u8::from(f)), f32::from(u8::from(!f))]);
            });
        (drawn.colors, drawn.num_channels) = (colors, 5);
    }
    DrawnChain { quantized, drawn, unmasked }
}

/// The CPU engine: [`Engine::step`] computes the iteration before it returns.
#[derive(Clone, Debug)]
pub struct CpuEngine {
    state: State,
    targets: Arc<[Target]>,
    /// Losses on motion, after the first timestep.
    prior: Option<MotionPrior<f32>>,
    /// The scenery, if the state holds only a part of the scene.
    staged: Option<Staged>,
    /// The image rendered last, unless a part of the scene is trained.
    picture: Image,
    /// Gradient of the image rendered last, valid in the tiles drawn and undefined in the others.
    v_image: Image,
    /// Losses not yet returned.
    losses: Vec<LossTerms>,
}

impl CpuEngine {
    /// An engine that continues from `state`.
    pub fn new(state: State) -> Self {
        Self {
            state,
            targets: Arc::default(),
            prior: None,
            staged: None,
            picture: Image::default(),
            v_image: Image::default(),
            losses: Vec::new(),
        }
    }

    /// Computes the losses and gradients on one image, without updating the parameters; adds to the densification
    /// statistic if `step` demands it.
    ///
    /// # Errors
    /// None; see [`Engine`].
    pub fn forward_backward(&mut self, step: &Step<'_>) -> Result<(LossTerms, StepGrads), TrainError> {
        Ok(self.timed_forward_backward(step, &mut Laps::begin()))
    }

    fn timed_forward_backward(&mut self, step: &Step<'_>, laps: &mut Laps) -> (LossTerms, StepGrads) {
        let target = &self.targets[step.camera];
        let with_segmentation = target.image.num_channels == 5;
        let DrawnChain { quantized, mut drawn, mut unmasked } =
            chain(&self.state, step.mask, with_segmentation, Some(&target.camera));
        let p = &self.state.parameters;
        if step.dropout.share > 0.0 {
            unmasked.get_or_insert_with(|| (drawn.scales.clone(), drawn.opacities.clone()));
            drop_out(&mut drawn.opacities, step.dropout);
        }
        laps.lap("activate");
        let (loss, mut grads) = match &mut self.staged {
            Some(staged) => staged.views[step.camera].render(&drawn, target, p, step, &mut self.v_image, laps),
            None => render_whole(&drawn, target, p, step, [&mut self.picture, &mut self.v_image], laps),
        };
        if step.counts_gradients {
            count_gradients(&grads, &mut self.state.statistic);
        }
        if step.dropout.share > 0.0 {
            drop_out(&mut grads.activated.v_opacities, step.dropout);
        }

        let mut terms = LossTerms { image: loss.image, segmentation: loss.segmentation, ..LossTerms::default() };
        let mut v_activated = colors_alone(grads.activated, drawn.num_channels);
        // Drawing is over: from here on scales and opacities are those before the mask and without dropout.
        let activated = match unmasked {
            Some((scales, opacities)) => Activated { scales, opacities, ..drawn },
            None => drawn,
        };
        let mut v_mask_logits = vec![0.0; p.num_gaussians()];
        if step.mask.enabled {
            self.mask_bwd(step, &activated, &mut v_activated, &mut v_mask_logits, &mut terms);
        }
        let gaussians = quantized.as_ref().unwrap_or(&p.gaussians);
        let mut v_gaussians = activate_bwd(gaussians, &activated, &v_activated);
        if gaussians.layout().sh_degree() > 0 {
            seen_colors_bwd(gaussians, &target.camera, &mut v_gaussians);
        }
        let quantizers = self.state.quantizers.as_ref().map(|q| q.backward(&p.gaussians, &mut v_gaussians));
        laps.lap("activate backward");
        if let Some(prior) = &self.prior {
            // Without segmentation the foreground, which alone stands on the floor, is unknown.
            let floor = if with_segmentation { step.weights.floor } else { 0.0 };
            let weights = WeightConfig { floor, ..*step.weights };
            let v = v_gaussians.views_mut();
            let grads = PriorGrads { v_means: v.means, v_quats: v.quats, v_colors: v.colors };
            let g = &p.gaussians;
            terms += prior.losses(g.means(), g.quats(), g.colors(), &weights, grads);
        }
        laps.lap("motion losses");
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
        let logits = &self.state.parameters.mask_logits;
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
        if let Some(previous) = self.state.past.as_ref().and_then(|past| past.previous_mask_logits.as_ref()) {
            terms.mask_consistency = mask_consistency_loss(logits, previous, |n, v| {
                v_mask_logits[n] += step.weights.mask_consistency * v;
            });
        }
    }

    /// Number of trained Gaussians: the first rows of the state.
    fn num_active(&self) -> usize {
        self.staged.as_ref().map_or(self.state.num_trained(), |staged| staged.num_active)
    }

    /// Updates the parameters by one step of Adam.
    ///
    /// - `grads`: as returned by [`Self::forward_backward`] for `step`
    pub fn update(&mut self, grads: &StepGrads, step: &Step<'_>) {
        let num_active = self.num_active();
        let State { parameters: p, optimizer: o, quantizers, .. } = &mut self.state;
        let rates = &step.rates;
        if step.moves_gaussians {
            let layout = Arc::clone(p.gaussians.layout());
            for column in layout.columns() {
                let (attribute, rate) = (column.attribute, rates.of(column));
                let count = num_active * column.components();
                let v = &grads.gaussians.values(attribute)[..count];
                let values = &mut p.gaussians.values_mut(attribute)[..count];
                o.update(attribute, values, v, rate, rates.epsilon_of(column));
            }
            if step.mask.enabled {
                o.mask.update(&mut p.mask_logits[..num_active], &grads.mask_logits[..num_active], rates.mask);
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
            if rates.centers_cameras {
                center(&mut p.camera_gains);
                center(&mut p.camera_offsets);
            }
        }
        if let (Some(q), Some((v_steps, v_offsets))) = (quantizers, &grads.quantizers) {
            q.update(v_steps, v_offsets, &mut o.quantizer_steps, &mut o.quantizer_offsets, rates.step);
            // Codes are those of unit quaternions.
            p.gaussians.quats_mut()[..num_active].par_iter_mut().for_each(|quat| *quat = normalize(*quat));
        }
    }
}

impl Engine for CpuEngine {
    fn name(&self) -> String {
        format!("the CPU, {} threads", rayon::current_num_threads())
    }

    fn begin(&mut self, targets: Arc<[Target]>, scenery: Option<Scenery>) -> Result<(), TrainError> {
        self.end();
        self.targets = targets;
        self.staged =
            scenery.map(|scenery| Staged { num_active: scenery.num_active, views: Stage::all(scenery, &self.targets) });
        let foreground = &self.state.parameters.foreground;
        self.prior =
            self.state.past.as_ref().map(|past| {
                let (first, now) = (&past.first, &past.previous);
                let neighbors = Arc::clone(&past.neighbors);
                let (means, quats, colors) = (now.means(), now.quats(), now.colors());
                MotionPrior::new(neighbors, foreground, &first.means, &first.quats, means, quats, colors)
                    .with_stillness(&past.stillness, means, quats)
            });
        Ok(())
    }

    fn end(&mut self) {
        self.targets = Arc::default();
        self.staged = None;
    }

    fn step(&mut self, step: &Step<'_>) -> Result<(), TrainError> {
        let (terms, grads) = self.forward_backward(step)?;
        self.update(&grads, step);
        self.losses.push(terms);
        Ok(())
    }

    fn profile(&mut self, step: &Step<'_>) -> Result<StageTimes, TrainError> {
        let mut laps = Laps::begin();
        let (terms, grads) = self.timed_forward_backward(step, &mut laps);
        self.update(&grads, step);
        laps.lap("Adam");
        self.losses.push(terms);
        Ok(laps.finish())
    }

    fn losses(&mut self) -> Result<Vec<LossTerms>, TrainError> {
        Ok(std::mem::take(&mut self.losses))
    }

    fn wait(&mut self) -> Result<(), TrainError> {
        Ok(())
    }

    fn state(&mut self) -> Result<&State, TrainError> {
        Ok(&self.state)
    }

    fn state_mut(&mut self) -> Result<&mut State, TrainError> {
        Ok(&mut self.state)
    }

    fn sensitivity(&mut self, cameras: &[Camera]) -> Result<Sensitivity, TrainError> {
        let Ok(sensitivity) = sensitivity(&CpuRasterizer, &self.state.parameters.gaussians, cameras);
        Ok(sensitivity)
    }

    fn look_renderer(&self) -> Arc<dyn LookRenderer> {
        Arc::new(CpuLook)
    }

    fn draw(&mut self, mask: &MaskConfig, camera: &Camera) -> Result<Image, TrainError> {
        let drawn = chain(&self.state, mask, false, Some(camera)).drawn;
        let Ok((output, _)) = CpuRasterizer.forward(&drawn, camera, &RenderSettings::default());
        Ok(output.image)
    }
}

/// Subtracts the mean of all rows.
pub(crate) fn center(rows: &mut [[f32; 3]]) {
    let share = 1.0 / rows.len() as f32;
    let mean: [f32; 3] = std::array::from_fn(|channel| share * rows.iter().map(|row| row[channel]).sum::<f32>());
    rows.iter_mut().for_each(|row| *row = std::array::from_fn(|channel| row[channel] - mean[channel]));
}

/// Multiplies each Gaussian's opacity, or the gradient to it, by its factor.
pub(crate) fn drop_out(opacities: &mut [f32], dropout: Dropout) {
    opacities.par_iter_mut().enumerate().with_min_len(CHUNK).for_each(|(i, x)| *x *= dropout.factor(i as u32));
}

/// Render settings of an iteration: the densification statistic is computed only if it is counted, and segmentation is
/// not learned.
fn settings_of(step: &Step<'_>) -> RenderSettings {
    let settings = RenderSettings::default();
    RenderSettings {
        statistic_channels: if step.counts_gradients { settings.statistic_channels } else { 0 },
        learned_channels: COLOR_CHANNELS,
        ..settings
    }
}

/// Renders the whole image and its losses, and propagates these back to the Gaussians.
///
/// - `picture`, `v_image`: memory for the image and for its gradient; overwritten
fn render_whole(
    drawn: &Activated,
    target: &Target,
    p: &Parameters,
    step: &Step<'_>,
    [picture, v_image]: [&mut Image; 2],
    laps: &mut Laps,
) -> (ImageLoss, RenderGrads) {
    let (settings, camera) = (settings_of(step), &target.camera);
    picture.ensure_shape(target.image.shape());
    let tiles = CpuRasterizer.forward_in(drawn, camera, &settings, Scope::Whole, picture, laps);
    let [gain, offset] = [p.camera_gains[step.camera], p.camera_offsets[step.camera]];
    let (image, segmentation) = (step.weights.image, step.weights.segmentation);
    let loss = image_loss(picture, &target.image, gain, offset, image, segmentation, v_image);
    laps.lap("image losses");
    let grads = CpuRasterizer.backward_in(drawn, camera, &settings, &tiles, picture, v_image, None, laps);
    (loss, grads)
}

/// Adds to the statistic of densification. *Accumulates*.
fn count_gradients(grads: &RenderGrads, statistic: &mut GradientStatistic) {
    (&mut statistic.sum, &mut statistic.count, &grads.v_means2d_ndc, &grads.visible).into_par_iter().for_each(
        |(sum, count, v, &visible)| {
            if visible {
                *sum += (v[0] * v[0] + v[1] * v[1]).sqrt();
                *count += 1;
            }
        },
    );
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
