//! The differentiable rasterizer on arrays, in the conventions of gsplat.

use numpy::PyArrayDyn;
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use tcgs_core::{Activated, ActivatedGrads, Camera, Image, normalize, normalize_vjp};
use tcgs_render::settings::MAX_CHANNELS;
use tcgs_render::{CpuRasterizer, CpuSaved, Rasterizer, RenderOutput, RenderSettings};

use crate::arrays::{ArrayLike, array, frozen, pixels, planes, values, values_of};
use crate::camera::camera;
use crate::detached::detached;

/// What `rasterize` returns: an image, its alpha, and the way back. `image, alpha = tcgs.rasterize(...)` unpacks it.
#[pyclass(name = "Rasterized", module = "tcgs", frozen)]
pub struct PyRasterized {
    /// As given, `[N, 4]`.
    quats: Vec<[f32; 4]>,
    activated: Activated,
    camera: Camera,
    settings: RenderSettings,
    saved: CpuSaved,
    transmittance: Vec<f32>,
    image: Py<PyArrayDyn<f32>>,
    alpha: Py<PyArrayDyn<f32>>,
}

/// Gradients of a loss to the arguments of `rasterize`, float32 of their shapes.
#[pyclass(name = "RasterizeGrads", module = "tcgs", frozen, get_all)]
pub struct PyRasterizeGrads {
    /// [N, 3]
    v_means: Py<PyArrayDyn<f32>>,
    /// [N, 4], to the quaternions as given, of whatever length
    v_quats: Py<PyArrayDyn<f32>>,
    /// [N, 3]
    v_scales: Py<PyArrayDyn<f32>>,
    /// [N]
    v_opacities: Py<PyArrayDyn<f32>>,
    /// [N, C]
    v_colors: Py<PyArrayDyn<f32>>,
    /// [C]
    v_background: Py<PyArrayDyn<f32>>,
}

/// Renders Gaussians with one camera on the CPU, so that a loss on the image can be taken back to them.
///
/// Order and meaning of the arguments are those of gsplat, for one camera:
///
/// - means: [N, 3], world, scene units
/// - quats: [N, 4], w, x, y, z; normalised here
/// - scales: [N, 3], standard deviations in scene units
/// - opacities: [N], in [0, 1]
/// - colors: [N, C], 1 to 8 channels of anything that blends like colour
/// - viewmat: [4, 4], world to camera; camera space has x to the right, y down, z forward
/// - K: [3, 3], intrinsics in pixels
/// - width, height: of the image, pixels
/// - background: [C], behind everything; black if None
/// - rasterize_mode: "classic", or "antialiased" as the scene's own flag says (`Scene.antialiased`): a splat that is widened
///   by a pixel's extent gives up as much opacity
///
/// Returns a Rasterized: `image` [height, width, C] and `alpha` [height, width, 1], float32, not clamped; `vjp` gives the
/// gradients. The image has the same bits for any number of threads.
///
/// Gaussians nearer than 0.2 scene units are not drawn, and an alpha is at most 0.99; gsplat has 0.01 and 0.999.
///
/// Raises ValueError if a shape, a number or the mode is wrong.
#[pyfunction]
#[pyo3(signature = (
    means, quats, scales, opacities, colors, viewmat, K, width, height, *, background = None, rasterize_mode = "classic"
))]
#[allow(clippy::too_many_arguments, non_snake_case, reason = "the signature of gsplat")]
pub fn rasterize(
    py: Python<'_>,
    means: ArrayLike,
    quats: ArrayLike,
    scales: ArrayLike,
    opacities: ArrayLike,
    colors: ArrayLike,
    viewmat: ArrayLike<f64>,
    K: ArrayLike<f64>,
    width: usize,
    height: usize,
    background: Option<ArrayLike>,
    rasterize_mode: &str,
) -> PyResult<PyRasterized> {
    let is_antialiased = match rasterize_mode {
        "classic" => false,
        "antialiased" => true,
        _ => {
            let message = format!("rasterize_mode: {rasterize_mode:?}, expected \"classic\" or \"antialiased\"");
            return Err(PyValueError::new_err(message));
        }
    };
    let camera = camera(&viewmat, &K, width, height)?;
    let (colors, shape) = values(&colors);
    let &[n, num_channels @ 1..=MAX_CHANNELS] = &shape[..] else {
        let message = format!("colors: has shape {shape:?}, expected [N, C] with C of 1 to {MAX_CHANNELS}");
        return Err(PyValueError::new_err(message));
    };
    let quats = rows(values_of("quats", &quats, &[n, 4])?);
    let means = rows(values_of("means", &means, &[n, 3])?);
    let scales = rows(values_of("scales", &scales, &[n, 3])?);
    let opacities = values_of("opacities", &opacities, &[n])?;
    let mut settings = RenderSettings { statistic_channels: 0, ..RenderSettings::default() };
    if let Some(background) = background {
        let background = values_of("background", &background, &[num_channels])?;
        settings.background[..num_channels].copy_from_slice(&background);
    }
    let unit = quats.iter().map(|&quat| normalize(quat)).collect();
    let activated = Activated { means, quats: unit, scales, opacities, colors, num_channels, is_antialiased };
    let (RenderOutput { image, transmittance }, saved) = detached(py, || forward(&activated, &camera, &settings));
    let alpha = transmittance.iter().map(|transmittance| 1.0 - transmittance).collect();
    Ok(PyRasterized {
        image: frozen(py, pixels(&image), &[height, width, num_channels]),
        alpha: frozen(py, alpha, &[height, width, 1]),
        quats,
        activated,
        camera,
        settings,
        saved,
        transmittance,
    })
}

#[pymethods]
impl PyRasterized {
    /// [height, width, C] float32, background included, not clamped.
    #[getter]
    fn image(&self, py: Python<'_>) -> Py<PyArrayDyn<f32>> {
        self.image.clone_ref(py)
    }

    /// [height, width, 1] float32: 1 less the light that passes all Gaussians.
    #[getter]
    fn alpha(&self, py: Python<'_>) -> Py<PyArrayDyn<f32>> {
        self.alpha.clone_ref(py)
    }

    fn __iter__<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, pyo3::types::PyIterator>> {
        (self.image(py), self.alpha(py)).into_pyobject(py)?.try_iter()
    }

    /// Vector-Jacobian product: the gradients of a loss whose gradient to the image is `v_image`, and to alpha `v_alpha`.
    ///
    /// - v_image: [height, width, C]
    /// - v_alpha: [height, width, 1]; None: alpha is not used. It takes a pass of its own
    ///
    /// Returns a RasterizeGrads.
    #[pyo3(signature = (v_image, v_alpha = None))]
    fn vjp(&self, py: Python<'_>, v_image: ArrayLike, v_alpha: Option<ArrayLike>) -> PyResult<PyRasterizeGrads> {
        let Camera { width, height, .. } = self.camera;
        let channels = self.activated.num_channels;
        let v_image = values_of("v_image", &v_image, &[height, width, channels])?;
        let v_alpha = v_alpha.map(|v_alpha| values_of("v_alpha", &v_alpha, &[height, width, 1])).transpose()?;
        let (grads, v_background) = detached(py, || self.backward(&v_image, v_alpha));
        let n = grads.v_means.len();
        let of = |values: Vec<f32>, shape: &[usize]| array(py, values, shape).unbind();
        Ok(PyRasterizeGrads {
            v_means: of(grads.v_means.into_flattened(), &[n, 3]),
            v_quats: of(grads.v_quats.into_flattened(), &[n, 4]),
            v_scales: of(grads.v_scales.into_flattened(), &[n, 3]),
            v_opacities: of(grads.v_opacities, &[n]),
            v_colors: of(grads.v_colors, &[n, channels]),
            v_background: of(v_background, &[channels]),
        })
    }

    fn __repr__(&self) -> String {
        let (Camera { width, height, .. }, channels) = (&self.camera, self.activated.num_channels);
        format!("Rasterized({} Gaussians, {width}x{height}, {channels} channels)", self.quats.len())
    }
}

impl PyRasterized {
    /// Gradients to the Gaussians as given, and to the background.
    fn backward(&self, v_image: &[f32], v_alpha: Option<Vec<f32>>) -> (ActivatedGrads, Vec<f32>) {
        let (camera, channels) = (&self.camera, self.activated.num_channels);
        let planes = planes(v_image, camera.width, camera.height, channels);
        let Ok(grads) = CpuRasterizer.backward(&self.activated, camera, &self.settings, &self.saved, &planes);
        let mut grads = grads.activated;
        if let Some(v_alpha) = v_alpha {
            self.add_alpha(&mut grads, v_alpha);
        }
        for (v_quat, &quat) in grads.v_quats.iter_mut().zip(&self.quats) {
            *v_quat = normalize_vjp(quat, *v_quat);
        }
        // The background is seen through what passes all Gaussians.
        let through = |channel| -> f64 {
            let pairs = planes.plane(channel).iter().zip(&self.transmittance);
            pairs.map(|(&v, &transmittance)| f64::from(v) * f64::from(transmittance)).sum()
        };
        (grads, (0..channels).map(|channel| through(channel) as f32).collect())
    }

    /// Accumulates: the gradients of alpha, which is the image of white Gaussians before black.
    fn add_alpha(&self, grads: &mut ActivatedGrads, v_alpha: Vec<f32>) {
        let (camera, n) = (&self.camera, self.quats.len());
        let white = Activated { colors: vec![1.0; n], num_channels: 1, ..self.activated.clone() };
        let settings = RenderSettings { statistic_channels: 0, ..RenderSettings::default() };
        let (_, saved) = forward(&white, camera, &settings);
        let v_image = Image { width: camera.width, height: camera.height, num_channels: 1, data: v_alpha };
        let Ok(more) = CpuRasterizer.backward(&white, camera, &settings, &saved, &v_image);
        let more = more.activated;
        add(grads.v_means.as_flattened_mut(), more.v_means.as_flattened());
        add(grads.v_quats.as_flattened_mut(), more.v_quats.as_flattened());
        add(grads.v_scales.as_flattened_mut(), more.v_scales.as_flattened());
        add(&mut grads.v_opacities, &more.v_opacities);
    }
}

fn forward(activated: &Activated, camera: &Camera, settings: &RenderSettings) -> (RenderOutput, CpuSaved) {
    let Ok(drawn) = CpuRasterizer.forward(activated, camera, settings);
    drawn
}

fn add(sums: &mut [f32], terms: &[f32]) {
    sums.iter_mut().zip(terms).for_each(|(sum, term)| *sum += term);
}

fn rows<const C: usize>(values: Vec<f32>) -> Vec<[f32; C]> {
    values.as_chunks().0.to_vec()
}
