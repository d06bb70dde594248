//! Gaussians in the form of `rasterize`'s arguments, drawn by one camera after another, forward and backward.
//!
//! What lives here: a near plane of the caller's, harmonics in each camera's direction, and sums over cameras. What
//! does not: Python's arrays (`rasterize.rs`) and drawing (`tcgs-render`).

use std::borrow::Cow;

use tcgs_core::{
    Activated, ActivatedGrads, Camera, GaussianGrads, Gaussians, HARMONIC_0, Image, Layout, Pinhole, normalize_vjp,
    seen_colors, seen_colors_bwd,
};
use tcgs_render::settings::NEAR;
use tcgs_render::{CpuRasterizer, CpuSaved, Rasterizer, RenderOutput, RenderSettings};

/// Gaussians nearer than this are not drawn. The renderer culls at [`NEAR`]; for a nearer plane, all lengths are scaled
/// up.
#[derive(Clone, Copy, Debug)]
pub struct NearPlane {
    /// Factor of all lengths, a power of two: no bit of an image depends on it.
    unit: f32,
    /// Depth up to which Gaussians are left out before the renderer does, in these units.
    depth: Option<f32>,
}

impl NearPlane {
    /// Least depth: lengths of 1e33 scene units stay within float32.
    pub const LEAST: f64 = 1e-6;

    /// - `near`: depth, scene units; [`Self::LEAST`] or more
    pub fn new(near: f64) -> Self {
        let mut unit = 1.0;
        while near * unit < NEAR {
            unit *= 2.0;
        }
        let depth = near * unit;
        Self { unit: unit as f32, depth: (depth > NEAR).then_some(depth as f32) }
    }
}

/// Coefficients of the harmonics of all Gaussians, from which each camera sees colours.
#[derive(Debug)]
pub struct Harmonics {
    /// Centres and colours: degree 0 with 0.5 added to its harmonic, and the further degrees. Other columns are not
    /// used.
    gaussians: Gaussians,
    /// Number of coefficients of a channel as given: at least those of the degree.
    given: usize,
}

impl Harmonics {
    /// - `coefficients`: `[N, given, 3]`
    pub fn new(means: &[[f32; 3]], coefficients: &[f32], given: usize, degree: usize) -> Self {
        let mut gaussians = Gaussians::zeros_of(&Layout::with_harmonics(degree), means.len());
        gaussians.means_mut().copy_from_slice(means);
        let rows = || coefficients.chunks_exact(3 * given);
        for (color, row) in gaussians.colors_mut().iter_mut().zip(rows()) {
            *color = std::array::from_fn(|channel| HARMONIC_0 as f32 * row[channel] + 0.5);
        }
        let mut first = 3;
        for band in gaussians.layout().harmonics() {
            let size = band.components();
            for (values, row) in gaussians.values_mut(band).chunks_exact_mut(size).zip(rows()) {
                values.copy_from_slice(&row[first..first + size]);
            }
            first += size;
        }
        Self { gaussians, given }
    }

    /// Accumulates to `v_means`, as directions depend on the centres.
    ///
    /// - `v_seen`: `[N, 3]`, gradient to the colours that the camera sees
    /// - returns: `[N, given, 3]`
    fn backward(&self, camera: &Camera, v_seen: &[f32], v_means: &mut [[f32; 3]]) -> Vec<f32> {
        let (layout, n) = (self.gaussians.layout(), self.gaussians.num_gaussians());
        let mut v = GaussianGrads::zeros_of(layout, n);
        v.colors_mut().as_flattened_mut().copy_from_slice(v_seen);
        seen_colors_bwd(&self.gaussians, camera, &mut v);
        add(v_means.as_flattened_mut(), v.means().as_flattened());
        let mut v_coefficients = vec![0.0; n * self.given * 3];
        let stride = 3 * self.given;
        for (row, color) in v_coefficients.chunks_exact_mut(stride).zip(v.colors()) {
            (0..3).for_each(|channel| row[channel] = HARMONIC_0 as f32 * color[channel]);
        }
        let mut first = 3;
        for band in layout.harmonics() {
            let size = band.components();
            for (row, values) in v_coefficients.chunks_exact_mut(stride).zip(v.values(band).chunks_exact(size)) {
                row[first..first + size].copy_from_slice(values);
            }
            first += size;
        }
        v_coefficients
    }
}

/// Gaussians as given, in units of the near plane.
#[derive(Debug)]
pub struct Given {
    /// `[N, 4]`, of any length.
    quats: Vec<[f32; 4]>,
    /// With unit quats; without colours where there are harmonics.
    activated: Activated,
    harmonics: Option<Harmonics>,
    near: NearPlane,
}

/// A camera's rendering, with the state for its backward pass.
#[derive(Debug)]
pub struct View {
    /// In units of the near plane.
    camera: Camera,
    settings: RenderSettings,
    saved: CpuSaved,
    transmittance: Vec<f32>,
}

impl View {
    /// `[H, W]`: 1 minus the share of light that passes all Gaussians.
    pub fn alpha(&self) -> impl Iterator<Item = f32> {
        self.transmittance.iter().map(|transmittance| 1.0 - transmittance)
    }

    /// Pairs of a splat and a tile: each takes memory in the backward pass.
    pub fn num_pairs(&self) -> usize {
        self.saved.counts().pairs
    }
}

/// Gradients to the Gaussians as given, and to the background of each camera.
#[derive(Debug)]
pub struct Grads {
    /// `v_colors` is `[N, C]`, or of harmonics `[N, K, 3]`.
    pub gaussians: ActivatedGrads,
    /// `[cameras, C]`
    pub v_backgrounds: Vec<f32>,
}

impl Given {
    /// - `activated`: in scene units, with unit quats; its colours are not used with coefficients
    /// - `quats`: `[N, 4]`, of any length
    /// - `coefficients`: `[N, K, 3]`, their `K` and the degree
    pub fn new(
        mut activated: Activated,
        quats: Vec<[f32; 4]>,
        coefficients: Option<(&[f32], usize, usize)>,
        near: NearPlane,
    ) -> Self {
        for length in activated.means.as_flattened_mut().iter_mut().chain(activated.scales.as_flattened_mut()) {
            *length *= near.unit;
        }
        let harmonics = coefficients.map(|(all, given, degree)| Harmonics::new(&activated.means, all, given, degree));
        Self { quats, activated, harmonics, near }
    }

    pub fn num_gaussians(&self) -> usize {
        self.quats.len()
    }

    pub fn num_channels(&self) -> usize {
        self.activated.num_channels
    }

    /// A camera in units of the near plane.
    pub fn camera(&self, mut camera: Camera) -> Camera {
        for row in &mut camera.camera_from_world[..3] {
            row[3] *= f64::from(self.near.unit);
        }
        camera
    }

    /// The Gaussians behind the near plane, with the colours that a camera sees.
    ///
    /// - `camera`: in units of the near plane
    pub fn seen_by(&self, camera: &Camera) -> Cow<'_, Activated> {
        let mut seen = Cow::Borrowed(&self.activated);
        if let Some(harmonics) = &self.harmonics {
            seen.to_mut().colors = seen_colors(&harmonics.gaussians, camera);
        }
        if let Some(depth) = self.near.depth {
            let pinhole = Pinhole::<f32>::new(camera);
            for (opacity, &mean) in seen.to_mut().opacities.iter_mut().zip(&self.activated.means) {
                if pinhole.camera_point(mean)[2] <= depth {
                    *opacity = 0.0;
                }
            }
        }
        seen
    }

    /// Draws.
    ///
    /// - `seen`: result of `seen_by`
    /// - `background`: `[C]`
    pub fn forward(seen: &Activated, camera: Camera, background: &[f32]) -> (Image, View) {
        let settings = RenderSettings { statistic_channels: 0, ..RenderSettings::default() }.or_background(background);
        let (RenderOutput { image, transmittance }, saved) = forward(seen, &camera, &settings);
        (image, View { camera, settings, saved, transmittance })
    }

    /// Gradients of a loss on all views.
    ///
    /// - `v_images`: of every view
    /// - `v_alphas`: `[H, W]` for every view; they take another backward pass
    pub fn backward(&self, views: &[View], v_images: &[Image], v_alphas: Option<Vec<Image>>) -> Grads {
        let mut v_alphas = v_alphas.into_iter().flatten();
        let mut sums: Option<ActivatedGrads> = None;
        let mut v_backgrounds = Vec::new();
        for (view, v_image) in views.iter().zip(v_images) {
            let grads = self.backward_of(view, v_image, v_alphas.next());
            sums = Some(match sums {
                None => grads,
                Some(mut sums) => {
                    add_geometry(&mut sums, &grads);
                    add(&mut sums.v_colors, &grads.v_colors);
                    sums
                }
            });
            // The weight of the background is the light that passes all Gaussians.
            v_backgrounds.extend((0..self.num_channels()).map(|channel| {
                let pairs = v_image.plane(channel).iter().zip(&view.transmittance);
                pairs.map(|(&v, &transmittance)| f64::from(v) * f64::from(transmittance)).sum::<f64>() as f32
            }));
        }
        let mut gaussians = sums.expect("at least one view");
        for (v_quat, &quat) in gaussians.v_quats.iter_mut().zip(&self.quats) {
            *v_quat = normalize_vjp(quat, *v_quat);
        }
        for v in gaussians.v_means.as_flattened_mut().iter_mut().chain(gaussians.v_scales.as_flattened_mut()) {
            *v *= self.near.unit;
        }
        Grads { gaussians, v_backgrounds }
    }

    /// Gradients from one view, to unit quats, in units of the near plane.
    fn backward_of(&self, view: &View, v_image: &Image, v_alpha: Option<Image>) -> ActivatedGrads {
        let View { camera, settings, saved, .. } = view;
        let seen = self.seen_by(camera);
        let Ok(grads) = CpuRasterizer.backward(&seen, camera, settings, saved, v_image);
        let mut grads = grads.activated;
        if let Some(v_alpha) = v_alpha {
            add_alpha(&seen, camera, &v_alpha, &mut grads);
        }
        if let Some(harmonics) = &self.harmonics {
            grads.v_colors = harmonics.backward(camera, &grads.v_colors, &mut grads.v_means);
        }
        grads
    }
}

/// Accumulates the gradients of alpha, which is the image of white Gaussians on black.
fn add_alpha(seen: &Activated, camera: &Camera, v_alpha: &Image, grads: &mut ActivatedGrads) {
    let colors = vec![1.0; seen.num_gaussians()];
    let white = Activated { colors, num_channels: 1, background: Vec::new(), ..seen.clone() };
    let settings = RenderSettings { statistic_channels: 0, ..RenderSettings::default() };
    let (_, saved) = forward(&white, camera, &settings);
    let Ok(more) = CpuRasterizer.backward(&white, camera, &settings, &saved, v_alpha);
    add_geometry(grads, &more.activated);
}

fn forward(activated: &Activated, camera: &Camera, settings: &RenderSettings) -> (RenderOutput, CpuSaved) {
    let Ok(drawn) = CpuRasterizer.forward(activated, camera, settings);
    drawn
}

/// Adds all gradients except those to colours.
fn add_geometry(sums: &mut ActivatedGrads, terms: &ActivatedGrads) {
    add(sums.v_means.as_flattened_mut(), terms.v_means.as_flattened());
    add(sums.v_quats.as_flattened_mut(), terms.v_quats.as_flattened());
    add(sums.v_scales.as_flattened_mut(), terms.v_scales.as_flattened());
    add(&mut sums.v_opacities, &terms.v_opacities);
}

fn add(sums: &mut [f32], terms: &[f32]) {
    sums.iter_mut().zip(terms).for_each(|(sum, term)| *sum += term);
}
