//! Refinement of what a file stores: the codes of a compressed scene are trained through the renderer.
//!
//! A timestep is drawn as a decoder reconstructs it: codes are rounded and dequantised, tracks interpolated between
//! their keypoints. The gradient of the image goes back to the keypoints before and after the timestep, each by its
//! share. For codes, rounding counts as the identity (straight-through, as in training). A keypoint that never moves is
//! trained by the images of all timesteps. Keypoints, quantizers and bits stay.
//!
//! One gain for red, green and blue at each timestep is trained with them, for the whole scene. If all cameras record a
//! timestep darker, these gains show it, and no Gaussian needs another colour. Training has learned a gain and an
//! offset of each camera. They are trained on if the cameras differ; no file holds them.

use rand::SeedableRng;
use rand::seq::SliceRandom;
use rand_pcg::Pcg64Mcg;
use rayon::prelude::*;
use tcgs_codec::{CompactScene, Light, MAX_BITS, Quantizer, Tracks, locate};
use tcgs_core::{Attribute, GaussianGrads, Image, View, activate, activate_bwd, seen_colors, seen_colors_bwd};
use tcgs_render::{Rasterizer, RenderSettings};

use crate::adam::BETA1;
use crate::dropout::Dropout;
use crate::engine::cpu::{ImageLoss, drop_out, image_loss};
use crate::parameters::{DIFFERENT, spread_of_cameras};
use crate::schedule::cosine;

/// Decay of the second moments: a keypoint is trained in a few of the timesteps only, so they settle faster than those
/// of a whole training.
const BETA2: f32 = 0.99;
/// Updates after which a moment has no bias left, to a float's precision.
const NUM_CORRECTIONS: usize = 2048;
/// Learning rate of gains, in their logarithms, and of offsets.
const GAIN_RATE: f32 = 2e-3;
/// Gaussians whose tracks one task updates.
const CHUNK: usize = 1 << 11;

/// Settings of a refinement.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RefineConfig {
    /// Learning rate of Adam, in steps of the quantizer. Default 0.2.
    pub rate: f32,
    /// Share of the rate that is left at the end, reached along a cosine. Default 0.002: a rate that stays makes codes
    /// jump to and fro between neighbouring values.
    pub decay: f32,
    /// Adam's ε, relative to the root mean second moment of the attribute. It keeps codes still whose gradients are
    /// mostly noise, since each move costs bits. Default 0.5.
    pub damping: f32,
    /// Share of the Gaussians that an iteration leaves out at random. It falls from this to 0: at the end all Gaussians
    /// fit the images together. It is multiplied by the sparsity of the views
    /// ([`view_sparsity`](crate::view_sparsity)). Default 0.4.
    pub dropout: f32,
}

impl Default for RefineConfig {
    fn default() -> Self {
        Self { rate: 0.2, decay: 0.002, damping: 0.5, dropout: 0.4 }
    }
}

/// Adam's state of one code, of one gain of the light, or of one gain or offset of a camera.
#[derive(Clone, Copy, Debug, Default)]
struct Latent {
    /// The code before rounding, in steps of the quantizer; the logarithm of the gain; the offset.
    value: f32,
    /// Moments of the gradient.
    first: f32,
    second: f32,
    /// Updates so far.
    count: u32,
}

/// Trains the codes of a compressed scene.
#[derive(Clone, Debug)]
pub struct Refiner {
    scene: CompactScene,
    config: RefineConfig,
    /// By [`Attribute::index`]: one for each keypoint.
    latents: Vec<Vec<Latent>>,
    /// By [`Attribute::index`]: mean second moment of the keypoints that the last iteration moved.
    mean_second: Vec<f32>,
    /// `[T, 3]` logarithms of gains by which the picture of a timestep is multiplied.
    light: Vec<[Latent; 3]>,
    /// `[cameras, 2, 3]` logarithms of gains, and offsets, as for [`image_loss`].
    cameras: Vec<[[Latent; 3]; 2]>,
    /// Whether gains and offsets of the cameras are trained.
    cameras_differ: bool,
    /// By the number of updates less 1: what corrects the bias of both moments.
    corrections: Vec<[f32; 2]>,
    /// Its share is that of the first iteration, its draw that of the next one.
    dropout: Dropout,
}

impl Refiner {
    /// A refinement that starts from the scene as it is.
    ///
    /// - `cameras`: `[cameras]` gain and offset of each, as for [`image_loss`]; they are trained if the cameras differ
    /// - `sparsity`: of the views ([`view_sparsity`](crate::view_sparsity))
    pub fn new(mut scene: CompactScene, cameras: &[[[f32; 3]; 2]], sparsity: f32, config: RefineConfig) -> Self {
        let latent = |value: f32| Latent { value, ..Latent::default() };
        let of_code = |&code: &i16| latent(f32::from(code));
        let of_tracks = |tracks: &mut Tracks<i16>| tracks.parts_mut().2.iter().map(of_code).collect();
        let latents: Vec<Vec<Latent>> = scene.tracks.iter_mut().map(of_tracks).collect();
        let correction = |count: i32| [BETA1, BETA2].map(|beta| 1.0 / (1.0 - beta.powi(count)));
        let corrections = (1..=NUM_CORRECTIONS as i32).map(correction).collect();
        let light = vec![[Latent::default(); 3]; scene.num_timesteps()];
        let cameras_differ = spread_of_cameras(cameras) > DIFFERENT;
        let cameras: Vec<_> = cameras.iter().map(|camera| camera.map(|values| values.map(latent))).collect();
        let mean_second = vec![0.0; latents.len()];
        let dropout = Dropout { share: sparsity * config.dropout, draw: 0 };
        Self { scene, config, latents, mean_second, light, cameras, cameras_differ, corrections, dropout }
    }

    /// The gains trained so far, which [`Self::into_scene`] does not apply.
    pub fn light(&self) -> Light {
        let gains: Vec<[f32; 3]> = self.light.iter().map(|gains| gains.map(|gain| gain.value.exp())).collect();
        Light::through(&gains)
    }

    /// The scene with the codes trained so far.
    pub fn into_scene(self) -> CompactScene {
        self.scene
    }

    /// One iteration on one view.
    ///
    /// - `timestep`: of the scene, which the view shows
    /// - `camera`: position of the view's camera among the cameras
    /// - `progress`: share of the refinement that is done, 0 to 1
    /// - returns: the loss before the iteration
    ///
    /// # Errors
    /// What the renderer fails with.
    pub fn step<R: Rasterizer>(
        &mut self,
        rasterizer: &R,
        timestep: usize,
        camera: usize,
        view: &View,
        progress: f32,
    ) -> Result<f64, R::Error> {
        let light = &mut self.light[timestep];
        let [gain, offset] = self.cameras[camera].map(|values| values.map(|latent| latent.value));
        let dropout = Dropout { share: self.dropout.share * (1.0 - progress), ..self.dropout };
        let shown = Shown { timestep, light: light.map(|latent| latent.value), gain, offset, dropout };
        self.dropout.draw += 1;
        let Gradients { loss, v_light, grads } = gradients(rasterizer, &self.scene, view, &shown)?;
        let decay = cosine(self.config.decay, progress);
        for (light, v_light) in light.iter_mut().zip(v_light) {
            light.update(v_light, GAIN_RATE * decay, f32::MIN_POSITIVE, &self.corrections);
        }
        self.center_light();
        if self.cameras_differ {
            self.update_camera(camera, [loss.v_gain, loss.v_offset], GAIN_RATE * decay);
        }
        let rate = self.config.rate * decay;
        for attribute in grads.layout().attributes() {
            self.update(attribute, timestep, grads.values(attribute), rate);
        }
        Ok(loss.image)
    }

    /// Makes the mean of each channel's gains over time 1 (the geometric mean): colours alone have what all timesteps
    /// share.
    fn center_light(&mut self) {
        for channel in 0..3 {
            let sum: f32 = self.light.iter().map(|gains| gains[channel].value).sum();
            let mean = sum / self.light.len() as f32;
            self.light.iter_mut().for_each(|gains| gains[channel].value -= mean);
        }
    }

    /// One step of Adam for a camera. The means over all cameras stay: colours alone have what all cameras share.
    fn update_camera(&mut self, camera: usize, v_values: [[f32; 3]; 2], rate: f32) {
        let num_cameras = self.cameras.len() as f32;
        for (kind, v_values) in v_values.iter().enumerate() {
            for (channel, &v) in v_values.iter().enumerate() {
                let latent = &mut self.cameras[camera][kind][channel];
                let before = latent.value;
                latent.update(v, rate, f32::MIN_POSITIVE, &self.corrections);
                let shift = (latent.value - before) / num_cameras;
                self.cameras.iter_mut().for_each(|camera| camera[kind][channel].value -= shift);
            }
        }
    }

    /// One step of Adam for the keypoints of an attribute around a timestep.
    ///
    /// - `v_values`: `[N * components]` gradient to the values at the timestep
    fn update(&mut self, attribute: Attribute, timestep: usize, v_values: &[f32], rate: f32) {
        let (index, components) = (attribute.index(), attribute.components());
        let quantizers = &self.scene.quantizers.attributes[index];
        let by_width: [&[Quantizer]; MAX_BITS as usize + 1] =
            std::array::from_fn(|width| quantizers.get(&(width as u8)).map_or(&[][..], Vec::as_slice));
        let widths = &self.scene.bit_map.widths[index];
        let epsilon = self.config.damping * self.mean_second[index].sqrt() + f32::MIN_POSITIVE;
        let corrections = &self.corrections;
        let pieces = pieces(&mut self.scene.tracks[index], &mut self.latents[index], CHUNK * components);
        let sums: Vec<(f64, usize)> = pieces
            .into_par_iter()
            .map(|piece| {
                let mut sum = (0.0, 0);
                for i in 0..piece.starts.len() - 1 {
                    let track = piece.first_track + i;
                    // Gaussians outside of the view do not change.
                    if v_values[track] == 0.0 {
                        continue;
                    }
                    let quantizers = by_width[usize::from(widths[track / components])];
                    let Some(quantizer) = quantizers.get(track % components) else { continue };
                    let range = piece.starts[i] - piece.starts[0]..piece.starts[i + 1] - piece.starts[0];
                    let (before, fraction) = locate(&piece.times[range.clone()], timestep);
                    let v_code = v_values[track] * quantizer.step;
                    for (keypoint, share) in [(before, 1.0 - fraction), (before + 1, fraction)] {
                        if share > 0.0 {
                            let latent = &mut piece.latents[range.start + keypoint];
                            latent.update(v_code * share, rate, epsilon, corrections);
                            let bounds = [quantizer.min_code() as f32, quantizer.max_code() as f32];
                            latent.value = latent.value.clamp(bounds[0], bounds[1]);
                            piece.codes[range.start + keypoint] = latent.value.round() as i16;
                            sum = (sum.0 + f64::from(latent.second), sum.1 + 1);
                        }
                    }
                }
                sum
            })
            .collect();
        let sum = sums.iter().fold((0.0, 0), |a, b| (a.0 + b.0, a.1 + b.1));
        self.mean_second[index] = (sum.0 / sum.1.max(1) as f64) as f32;
    }
}

impl Latent {
    fn update(&mut self, v: f32, rate: f32, epsilon: f32, corrections: &[[f32; 2]]) {
        self.count += 1;
        self.first = BETA1 * self.first + (1.0 - BETA1) * v;
        self.second = BETA2 * self.second + (1.0 - BETA2) * v * v;
        let [first, second] = corrections[(self.count as usize).min(NUM_CORRECTIONS) - 1];
        self.value -= rate * self.first * first / ((self.second * second).sqrt() + epsilon);
    }
}

/// Neighbouring tracks that one task updates.
struct Piece<'a> {
    first_track: usize,
    /// `[tracks + 1]`, among all tracks.
    starts: &'a [usize],
    times: &'a [u16],
    codes: &'a mut [i16],
    latents: &'a mut [Latent],
}

/// Cuts tracks into pieces of `length` tracks.
fn pieces<'a>(tracks: &'a mut Tracks<i16>, mut latents: &'a mut [Latent], length: usize) -> Vec<Piece<'a>> {
    let (starts, times, mut codes) = tracks.parts_mut();
    let num_tracks = starts.len() - 1;
    (0..num_tracks)
        .step_by(length)
        .map(|first_track| {
            let starts = &starts[first_track..=(first_track + length).min(num_tracks)];
            let range = starts[0]..starts[starts.len() - 1];
            let (piece, rest) = std::mem::take(&mut codes).split_at_mut(range.len());
            codes = rest;
            let (of_piece, rest) = std::mem::take(&mut latents).split_at_mut(range.len());
            latents = rest;
            Piece { first_track, starts, times: &times[range], codes: piece, latents: of_piece }
        })
        .collect()
}

/// How a timestep is shown to a camera: `exp(gain) * (exp(light) * Gaussians + background) + offset`.
#[derive(Clone, Copy, Debug)]
struct Shown {
    timestep: usize,
    light: [f32; 3],
    gain: [f32; 3],
    offset: [f32; 3],
    dropout: Dropout,
}

/// The loss of a picture, with the gradient to gain and offset of the camera.
struct Gradients {
    loss: ImageLoss,
    /// Gradient to the logarithm of the light.
    v_light: [f32; 3],
    /// Gradient to the values at the timestep.
    grads: GaussianGrads,
}

/// Loss of a timestep's picture, and its gradient to the values at that timestep.
///
/// A quaternion is interpolated, then divided by its length, which is 1 to within a percent: the gradient leaves out
/// that last factor.
fn gradients<R: Rasterizer>(
    rasterizer: &R,
    scene: &CompactScene,
    view: &View,
    &Shown { timestep, light, gain, offset, dropout }: &Shown,
) -> Result<Gradients, R::Error> {
    let (gaussians, camera) = (scene.at(timestep), &view.camera);
    let has_harmonics = gaussians.layout().sh_degree() > 0;
    let mut drawn = activate(&gaussians);
    if has_harmonics {
        drawn.colors = seen_colors(&gaussians, camera);
    }
    if scene.lives.is_some() {
        drawn.opacities.par_iter_mut().enumerate().for_each(|(i, opacity)| {
            if !scene.is_alive(i, timestep) {
                *opacity = 0.0;
            }
        });
    }
    let kept_opacities = (dropout.share > 0.0).then(|| drawn.opacities.clone());
    if kept_opacities.is_some() {
        drop_out(&mut drawn.opacities, dropout);
    }
    // The light multiplies the whole picture, and is not to change the background.
    drawn.background.iter_mut().zip(light).for_each(|(background, light)| *background /= light.exp());
    let settings = RenderSettings { statistic_channels: 0, ..RenderSettings::default() };
    let (output, saved) = rasterizer.forward(&drawn, camera, &settings)?;
    let whole = std::array::from_fn(|channel| gain[channel] + light[channel]);
    let mut v_image = Image::default();
    let loss = image_loss(&output.image, &view.image, whole, offset, 1.0, 0.0, &mut v_image);
    let mut v_light = loss.v_gain;
    for (channel, v_light) in v_light.iter_mut().enumerate().filter(|(channel, _)| drawn.background[*channel] > 0.0) {
        let of_pixels = v_image.plane(channel).iter().zip(&output.transmittance);
        *v_light -= drawn.background[channel] * of_pixels.map(|(v, passed)| v * passed).sum::<f32>();
    }
    let mut grads = rasterizer.backward(&drawn, camera, &settings, &saved, &v_image)?;
    if let Some(opacities) = kept_opacities {
        drop_out(&mut grads.activated.v_opacities, dropout);
        drawn.opacities = opacities;
    }
    let mut v_gaussians = activate_bwd(&gaussians, &drawn, &grads.activated);
    if has_harmonics {
        seen_colors_bwd(&gaussians, camera, &mut v_gaussians);
    }
    Ok(Gradients { loss, v_light, grads: v_gaussians })
}

/// Share of a timestep's views that are trained on at one visit to it.
const VIEWS_SHARE: f64 = 1.0 / 3.0;

/// The order of a refinement, without end: a timestep, and which of its views to train on. All timesteps are visited
/// equally often, and so are their views in the mean.
///
/// - `num_timesteps`, `num_views`: at least 1
/// - `num_iterations`: the number of iterations to come, for timesteps in ascending order, in which videos are decoded
///   fastest. If that is less than one pass, every second, third or further timestep is visited. None: a random order
pub fn refine_order(
    seed: u64,
    num_timesteps: usize,
    num_views: usize,
    num_iterations: Option<usize>,
) -> impl Iterator<Item = (usize, Vec<usize>)> {
    let num_at_once = (num_views as f64 * VIEWS_SHARE).ceil() as usize;
    let mut random = Pcg64Mcg::seed_from_u64(seed);
    (0..).flat_map(move |_| {
        let mut timesteps: Vec<usize> = (0..num_timesteps).collect();
        match num_iterations {
            Some(count) => {
                let stride = (num_timesteps * num_at_once).div_ceil(count.max(1));
                timesteps = timesteps.into_iter().step_by(stride).collect();
            }
            None => timesteps.shuffle(&mut random),
        }
        let mut views: Vec<usize> = (0..num_views).collect();
        let visit = |timestep| {
            views.shuffle(&mut random);
            (timestep, views[..num_at_once].to_vec())
        };
        timesteps.into_iter().map(visit).collect::<Vec<_>>()
    })
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use tcgs_codec::{BitMap, CompressSettings, SceneInfo, compress};
    use tcgs_core::{Activated, BaseColumns, Camera, DynamicGaussians, Gaussians, Image, Layout};
    use tcgs_render::CpuRasterizer;

    use super::*;

    const NUM_TIMESTEPS: usize = 9;

    fn camera() -> Camera {
        Camera::look_at([0.3, -0.4, -3.0], [0.0; 3], [0.0, -1.0, 0.0], 60.0, 48, 40)
    }

    /// Gaussians of which every other one moves to and fro and turns.
    fn floats(num_gaussians: usize) -> DynamicGaussians {
        let layout = Layout::with_harmonics(1);
        let at = |t: usize| {
            let mut columns = BaseColumns::default();
            for i in 0..num_gaussians {
                let (x, turn) = (
                    6.0 * i as f32 / num_gaussians as f32,
                    if i % 2 == 0 { 0.3 * (t as f32 - 4.0).abs() } else { 0.0 },
                );
                columns.means.push([0.3 * x - 0.8 + 0.2 * turn, 0.25 * (x * 2.1).sin(), 0.1 * x]);
                columns.quats.push([1.0, 0.2 * x, turn, 0.1]);
                columns.log_scales.push([-2.0 + 0.1 * x, -1.6, -2.2]);
                columns.logit_opacities.push(0.3 * x - 0.5);
                columns.colors.push([0.1 + 0.1 * x, 0.7 - 0.1 * x, 0.5]);
            }
            let mut gaussians = Gaussians::from(columns).extended(&layout);
            for band in layout.harmonics() {
                gaussians.values_mut(band).iter_mut().enumerate().for_each(|(i, sh)| *sh = 0.2 * (i as f32).sin());
            }
            gaussians
        };
        let mut scene = DynamicGaussians::new(Arc::clone(&layout));
        (0..NUM_TIMESTEPS).for_each(|t| scene.push(at(t)));
        scene
    }

    fn compact(num_gaussians: usize, bits: u8) -> CompactScene {
        let floats = floats(num_gaussians);
        let settings = CompressSettings {
            position_fineness: 0.0,
            coarser: [0.0; 5],
            harmonic_error: 0.0,
            ..CompressSettings::default()
        };
        compress(
            &floats,
            &BitMap::uniform_of(floats.layout(), num_gaussians, 16, bits),
            None,
            SceneInfo::of(&floats),
            &settings,
        )
        .unwrap()
    }

    #[test]
    fn gradients_to_codes_and_light_match_central_differences() {
        assert_eq!(gradients_match_central_differences(0.0), 0);
    }

    #[test]
    fn gradients_match_central_differences_where_gaussians_are_left_out() {
        assert_eq!(gradients_match_central_differences(0.2), 2);
    }

    /// - `dropout`: share
    /// - returns: the number of Gaussians that were left out
    fn gradients_match_central_differences(dropout: f32) -> usize {
        let mut scene = compact(6, 14);
        scene.layout = scene.layout.with_background([200, 0, 120]);
        // Brighter than anything drawn, away from the kink of L1.
        let image = Image::filled(48, 40, 3, 1.5);
        let timestep = 2;
        let correction = [[0.05, -0.1, 0.0], [0.01, 0.0, -0.02]];
        let view = View { camera: camera(), image, segmentation: None, frame: 0, camera_id: 0 };
        let config = RefineConfig { rate: 0.0, dropout, ..RefineConfig::default() };
        let dropout = Dropout { share: dropout, draw: 0 };
        let is_left_out = |i: usize| dropout.factor(i as u32) == 0.0;
        let lit = |scene: &CompactScene, light: [f32; 3]| {
            let [gain, offset] = correction;
            let Ok(found) = gradients(&CpuRasterizer, scene, &view, &Shown { timestep, light, gain, offset, dropout });
            found.loss.image
        };
        let loss = |scene: &CompactScene| lit(scene, [0.0; 3]);
        let mut refiner = Refiner::new(scene.clone(), &[correction], 1.0, config);
        let Ok(_) = refiner.step(&CpuRasterizer, timestep, 0, &view, 0.0);
        let (mut num_shared, mut num_compared) = (0, 0);
        for attribute in scene.layout.attributes() {
            let components = attribute.components();
            let latents = &refiner.latents[attribute.index()];
            let starts = scene.tracks[attribute.index()].clone().parts_mut().0.to_vec();
            for track in 0..6 * components {
                let width = scene.bit_map.widths[attribute.index()][track / components];
                let quantizer = scene.quantizers.get(attribute, width, track % components).unwrap();
                let step = quantizer.step;
                // About a hundredth of what the attribute ranges over.
                let by = (0.01 / step).ceil().max(1.0) as i16;
                let moved = |keypoint: usize, by: i16| {
                    let mut scene = scene.clone();
                    scene.tracks[attribute.index()].parts_mut().2[keypoint] += by;
                    loss(&scene)
                };
                let near: Vec<usize> = (starts[track]..starts[track + 1]).filter(|&k| latents[k].count > 0).collect();
                if is_left_out(track / components) {
                    assert!(near.is_empty(), "{attribute:?} {track}: no picture shows it");
                    continue;
                }
                assert!((1..=2).contains(&near.len()), "{attribute:?} {track}: {} keypoints are trained", near.len());
                num_shared += usize::from(near.len() == 2);
                for keypoint in near {
                    let code = scene.tracks[attribute.index()].clone().parts_mut().2[keypoint];
                    let legal = quantizer.min_code()..=quantizer.max_code();
                    if [-by, by].iter().any(|&by| !legal.contains(&(i32::from(code) + i32::from(by)))) {
                        continue;
                    }
                    num_compared += 1;
                    let difference = (moved(keypoint, by) - moved(keypoint, -by)) / (2.0 * f64::from(by));
                    let found = f64::from(latents[keypoint].first / (1.0 - BETA1));
                    let scale = f64::from(step);
                    assert!(
                        (difference - found).abs() < 0.05 * difference.abs() + 2e-4 * scale,
                        "{attribute:?} {track}: {:.3e} against {:.3e}",
                        difference / scale,
                        found / scale
                    );
                }
            }
        }
        for (channel, latent) in refiner.light[timestep].iter().enumerate() {
            let moved = |by: f32| lit(&scene, std::array::from_fn(|c| if c == channel { by } else { 0.0 }));
            let (difference, found) = ((moved(1e-2) - moved(-1e-2)) / 2e-2, f64::from(latent.first / (1.0 - BETA1)));
            assert!(
                (difference - found).abs() < 0.01 * difference.abs(),
                "light: {difference:.3e} against {found:.3e}"
            );
        }
        assert!(num_compared > 40, "{num_compared} codes are compared");
        assert!(num_shared > 5, "{num_shared} tracks lie between two keypoints");
        (0..6).filter(|&i| is_left_out(i)).count()
    }

    #[test]
    fn codes_that_are_off_come_back_and_on_any_number_of_threads_alike() {
        let (truth, mut off) = (floats(60), compact(60, 7));
        for (attribute, by) in [(Attribute::Color, 8), (Attribute::LogitOpacity, -9), (Attribute::LogScale, 7)] {
            let most = off.quantizers.get(attribute, 7, 0).unwrap().max_code() as i16;
            let codes = off.tracks[attribute.index()].parts_mut().2;
            codes.iter_mut().for_each(|code| *code = (*code + by).clamp(-most, most));
        }
        let cameras: Vec<Camera> = [-0.9, -0.3, 0.3, 0.9]
            .map(|x| Camera::look_at([x, -0.4, -3.0], [0.0; 3], [0.0, -1.0, 0.0], 60.0, 48, 40))
            .to_vec();
        let drawn = |gaussians: &Gaussians, camera: &Camera| {
            let seen = tcgs_core::Drawable::new(gaussians).seen_by(camera);
            let Ok((output, _)) = CpuRasterizer.forward(&seen, camera, &RenderSettings::default());
            output.image
        };
        let view = |t: usize, of: usize| View {
            camera: cameras[of].clone(),
            image: drawn(&truth.at(t), &cameras[of]),
            segmentation: None,
            frame: t,
            camera_id: of,
        };
        // The last camera is held out.
        let error = |scene: &CompactScene| -> f64 {
            let of = |t| {
                let (a, b) = (drawn(&scene.at(t), &cameras[3]), view(t, 3).image);
                a.data.iter().zip(&b.data).map(|(a, b)| f64::from(a - b).powi(2)).sum::<f64>()
            };
            (0..NUM_TIMESTEPS).map(of).sum()
        };
        let refined = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| {
                let mut refiner = Refiner::new(off.clone(), &[[[0.0; 3]; 2]; 3], 1.0, RefineConfig::default());
                let order = refine_order(1, NUM_TIMESTEPS, 3, None).take(400).enumerate();
                for (i, (t, views)) in order {
                    for of in views {
                        let step = refiner.step(&CpuRasterizer, t, of, &view(t, of), i as f32 / 400.0);
                        let Ok(_) = step;
                    }
                }
                refiner.into_scene()
            })
        };
        let one = refined(1);
        assert!(error(&one) < 0.4 * error(&off), "{} from {}", error(&one), error(&off));
        assert_eq!(one, refined(3));
        assert_eq!(one.bit_map, off.bit_map);
        for (after, before) in one.tracks.iter().zip(&off.tracks) {
            assert_eq!(after.len(), before.len());
            assert!((0..after.len()).all(|i| after.track(i).0 == before.track(i).0), "keypoints stay where they are");
        }
    }

    #[test]
    fn what_all_images_of_a_timestep_have_darker_becomes_light() {
        let mut scene = compact(20, 12);
        // The light does not change what lies behind the Gaussians.
        scene.layout = scene.layout.with_background([200, 0, 120]);
        // Their mean is 1: colours would learn the mean, and are not trained here.
        let dark = |t: usize| [-0.006, 0.0, 0.004].map(|slope: f32| (slope * (t as f32 - 4.0)).exp());
        let view = |t: usize| {
            let lit = scene.at(t).lit(dark(t));
            let drawn = Activated { colors: seen_colors(&lit, &camera()), ..activate(&lit) };
            let Ok((output, _)) = CpuRasterizer.forward(&drawn, &camera(), &RenderSettings::default());
            View { camera: camera(), image: output.image, segmentation: None, frame: t, camera_id: 0 }
        };
        let views: Vec<View> = (0..NUM_TIMESTEPS).map(view).collect();
        let still = RefineConfig { rate: 0.0, ..RefineConfig::default() };
        let mut refiner = Refiner::new(scene.clone(), &[[[0.0; 3]; 2]], 0.0, still);
        let count = 60 * NUM_TIMESTEPS;
        for (i, t) in (0..NUM_TIMESTEPS).cycle().take(count).enumerate() {
            let Ok(_) = refiner.step(&CpuRasterizer, t, 0, &views[t], i as f32 / count as f32);
        }
        let light = refiner.light();
        for t in 0..NUM_TIMESTEPS {
            let (found, expected) = (light.at(t), dark(t));
            assert!((0..3).all(|c| (found[c] - expected[c]).abs() < 0.005), "{t}: {found:?} for {expected:?}");
        }
        assert_eq!(refiner.into_scene(), scene);
    }

    #[test]
    fn gaussians_are_left_out_as_far_as_views_are_sparse() {
        let scene = compact(6, 7);
        let share =
            |sparsity| Refiner::new(scene.clone(), &[[[0.0; 3]; 2]], sparsity, RefineConfig::default()).dropout.share;
        assert_eq!([0.0, 0.5, 1.0].map(share), [0.0, 0.2, 0.4]);
    }

    #[test]
    fn what_a_camera_has_brighter_than_others_becomes_its_gain() {
        let scene = compact(20, 12);
        let view = |bright: f32| {
            let lit = scene.at(0).lit([bright.exp(); 3]);
            let drawn = Activated { colors: seen_colors(&lit, &camera()), ..activate(&lit) };
            let Ok((output, _)) = CpuRasterizer.forward(&drawn, &camera(), &RenderSettings::default());
            View { camera: camera(), image: output.image, segmentation: None, frame: 0, camera_id: 0 }
        };
        let brightness = [0.05, -0.05];
        let views = brightness.map(view);
        let still = RefineConfig { rate: 0.0, ..RefineConfig::default() };
        let learned = |begin: f32| {
            let cameras = [begin, -begin].map(|gain| [[gain; 3], [0.0; 3]]);
            let mut refiner = Refiner::new(scene.clone(), &cameras, 0.0, still);
            for i in 0..600 {
                let Ok(_) = refiner.step(&CpuRasterizer, 0, i % 2, &views[i % 2], i as f32 / 600.0);
            }
            let gains = [0, 1].map(|camera| refiner.cameras[camera][0].map(|gain| gain.value));
            assert_eq!(refiner.into_scene(), scene);
            gains
        };
        let gains = learned(0.01);
        for channel in 0..3 {
            for (found, expected) in gains.iter().zip(brightness) {
                assert!((found[channel] - expected).abs() < 0.02, "{gains:?}");
            }
            assert!((gains[0][channel] + gains[1][channel]).abs() < 1e-4, "their mean stays: {gains:?}");
        }
        assert_eq!(learned(0.001), [[0.001; 3], [-0.001; 3]], "too alike to be told apart");
    }

    #[test]
    fn every_timestep_and_view_has_its_turn() {
        let visits: Vec<(usize, Vec<usize>)> = refine_order(5, 4, 7, None).take(400).collect();
        assert_eq!(visits, refine_order(5, 4, 7, None).take(400).collect::<Vec<_>>());
        for t in 0..4 {
            assert_eq!(visits.iter().filter(|(timestep, _)| *timestep == t).count(), 100);
            for view in 0..7 {
                let turns = visits.iter().filter(|(timestep, views)| *timestep == t && views.contains(&view)).count();
                assert!((25..60).contains(&turns), "view {view} of timestep {t}: {turns} of 100");
            }
        }
        assert_eq!(refine_order(0, 1, 1, None).next(), Some((0, vec![0])));
        // In order: whole passes, or one that leaves timesteps out. Two views are used at a time.
        let in_order = |num_iterations| -> Vec<usize> {
            refine_order(0, 10, 6, Some(num_iterations))
                .map(|(timestep, _)| timestep)
                .take(num_iterations / 2)
                .collect()
        };
        assert_eq!(in_order(30), (0..10).chain(0..5).collect::<Vec<_>>());
        assert_eq!(in_order(7), [0, 3, 6]);
    }
}
