//! The differentiable rasterizer on arrays, in the conventions of gsplat.

use numpy::PyArrayDyn;
use pyo3::exceptions::{PyTypeError, PyValueError};
use pyo3::prelude::*;
use tcgs_core::{Activated, Image, MAX_SH_DEGREE, normalize};
use tcgs_render::settings::MAX_CHANNELS;

use crate::arrays::{ArrayLike, Numbers, add_pixels, array, frozen, planes};
use crate::camera::cameras;
use crate::detached::detached;
use crate::memory::{image_size, reserve, reserve_images, reserve_pairs};
use crate::numbers::{Number, Whole, one_of};
use crate::views::{Given, Grads, NearPlane, View};

/// The result of `rasterize`: an image, its alpha, and gradients (`vjp`). `image, alpha = tcgs.rasterize(...)` unpacks
/// it.
#[pyclass(name = "Rasterized", module = "tcgs", frozen)]
pub struct PyRasterized {
    given: Given,
    views: Vec<View>,
    shapes: Shapes,
    image: Py<PyArrayDyn<f32>>,
    alpha: Py<PyArrayDyn<f32>>,
}

/// Shapes of the arguments and results beside the Gaussians.
#[derive(Clone)]
struct Shapes {
    width: usize,
    height: usize,
    /// Shape of the cameras: `[]` for one camera, `[C]` for several.
    cameras: Vec<usize>,
    /// Shape of the colours: `[N, C]`, or `[N, K, 3]` for harmonics.
    colors: Vec<usize>,
}

impl Shapes {
    /// Shape of images with `num_channels`.
    fn image(&self, num_channels: usize) -> Vec<usize> {
        [&self.cameras[..], &[self.height, self.width, num_channels]].concat()
    }

    /// Shape of the background.
    fn background(&self, num_channels: usize) -> Vec<usize> {
        [&self.cameras[..], &[num_channels]].concat()
    }

    /// An image for each camera, from an array of [`Self::image`]'s shape.
    fn planes(&self, pixels: &[f32], num_channels: usize) -> Vec<Image> {
        let images = pixels.chunks_exact(self.width * self.height * num_channels);
        images.map(|pixels| planes(pixels, self.width, self.height, num_channels)).collect()
    }
}

/// Gradients of a loss to the arguments of `rasterize`, float32 of their shapes, summed over cameras.
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
    /// [N, D], or [N, K, 3] for harmonics
    v_colors: Py<PyArrayDyn<f32>>,
    /// [D], or [C, D] for several cameras
    v_background: Py<PyArrayDyn<f32>>,
}

/// Renders Gaussians on the CPU, with gradients of a loss on the images.
///
/// Order and meaning of the arguments are those of gsplat. A single camera may lack the axis C:
///
/// - means: [N, 3], world, scene units
/// - quats: [N, 4], w, x, y, z; normalised here
/// - scales: [N, 3], standard deviations in scene units, 0 or more
/// - opacities: [N], in [0, 1]
/// - colors: [N, D], 1 to 8 channels of anything that blends like colour; with sh_degree [N, K, 3], coefficients
/// - viewmat, or viewmats: [4, 4] or [C, 4, 4], world to camera; camera space has x to the right, y down, z forward
/// - K, or Ks: [3, 3] or [C, 3, 3], intrinsics in pixels
/// - width, height: size of the images, pixels
/// - background, or backgrounds: [D], or [C, D] for several cameras, behind everything; black if None
/// - near_plane: depth up to which Gaussians are not drawn, scene units; gsplat's is 0.01
/// - sh_degree: 0 to 3: colors are coefficients of spherical harmonics, of which the first (sh_degree + 1)² count. A
///   camera sees their sum in the direction from its centre to the mean, plus 0.5, clamped to 0 from below
/// - rasterize_mode: "classic", or "antialiased" as the scene's own flag says (`Scene.antialiased`): a splat that is
///   widened by a pixel's extent loses as much opacity
///
/// Returns a Rasterized: `image` [height, width, D] and `alpha` [height, width, 1], float32, not clamped; several
/// cameras have [C, height, width, …]. `vjp` gives the gradients. The images have the same bits for any number of
/// threads.
///
/// An alpha is at most 0.99; gsplat has 0.999.
///
/// Raises ValueError or TypeError if an argument is wrong, MemoryError if the images do not fit into memory.
#[pyfunction]
#[pyo3(signature = (
    means, quats, scales, opacities, colors, viewmat = None, K = None, width = None, height = None, *, viewmats = None,
    Ks = None, background = None, backgrounds = None, near_plane = Number::of(0.2), sh_degree = None,
    rasterize_mode = "classic"
), text_signature = "(means, quats, scales, opacities, colors, viewmat=None, K=None, width=None, height=None, *, \
    viewmats=None, Ks=None, background=None, backgrounds=None, near_plane=0.2, sh_degree=None, \
    rasterize_mode='classic')")]
#[allow(clippy::too_many_arguments, non_snake_case, reason = "the signature of gsplat")]
pub fn rasterize(
    py: Python<'_>,
    means: ArrayLike<'_>,
    quats: ArrayLike<'_>,
    scales: ArrayLike<'_>,
    opacities: ArrayLike<'_>,
    colors: ArrayLike<'_>,
    viewmat: Option<ArrayLike<'_>>,
    K: Option<ArrayLike<'_>>,
    width: Option<Whole>,
    height: Option<Whole>,
    viewmats: Option<ArrayLike<'_>>,
    Ks: Option<ArrayLike<'_>>,
    background: Option<ArrayLike<'_>>,
    backgrounds: Option<ArrayLike<'_>>,
    near_plane: Number,
    sh_degree: Option<Whole>,
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
    let near = format!("a number of {} or more", NearPlane::LEAST);
    let near = NearPlane::new(near_plane.such("near_plane", &near, |near| near >= NearPlane::LEAST)?);
    let degree = sh_degree.map(|degree| degree.within("sh_degree", 0..=MAX_SH_DEGREE)).transpose()?;
    let [width, height] = [("width", width), ("height", height)].map(|(name, size)| missing(name, size));
    let [width, height] = image_size(width?, height?)?;
    let viewmat = one_of(["viewmat", "viewmats"], [viewmat, viewmats])?;
    let (all, axis) = cameras(viewmat, one_of(["K", "Ks"], [K, Ks])?, [width, height])?;

    let colors = Numbers::read("colors", &colors)?;
    let num_channels = check_colors(&colors, degree)?;
    let n = colors.shape[0];
    let shapes = Shapes { width, height, cameras: axis, colors: colors.shape.clone() };
    let quats = Numbers::read("quats", &quats)?.rows(&[n, 4])?;
    let means = Numbers::read("means", &means)?.rows(&[n, 3])?;
    let scales = Numbers::read("scales", &scales)?;
    scales.check("numbers of 0 or more", |scale| scale >= 0.0)?;
    let opacities = Numbers::read("opacities", &opacities)?;
    opacities.check("numbers from 0 to 1", |opacity| (0.0..=1.0).contains(&opacity))?;
    let background = match [background, backgrounds] {
        [None, None] => vec![0.0; all.len() * num_channels],
        given => {
            let (name, background) = one_of(["background", "backgrounds"], given)?;
            Numbers::read(name, &background)?.of_shape(&shapes.background(num_channels))?
        }
    };
    let activated = Activated {
        means,
        quats: quats.iter().map(|&quat| normalize(quat)).collect(),
        scales: scales.rows(&[n, 3])?,
        opacities: opacities.of_shape(&[n])?,
        colors: if degree.is_none() { colors.values.clone() } else { Vec::new() },
        num_channels,
        is_antialiased,
        background: Vec::new(),
    };
    let coefficients = degree.map(|degree| (&colors.values[..], shapes.colors[1], degree));
    let given = Given::new(activated, quats, coefficients, near);
    reserve_images(all.len(), [width, height], num_channels)?;

    let (mut image, mut alpha, mut views) = (Vec::new(), Vec::new(), Vec::with_capacity(all.len()));
    detached(py, || -> PyResult<()> {
        for (camera, background) in all.into_iter().zip(background.chunks_exact(num_channels)) {
            let camera = given.camera(camera);
            let seen = given.seen_by(&camera);
            reserve_pairs(&seen, &camera)?;
            let (drawn, view) = Given::forward(&seen, camera, background);
            add_pixels(&drawn, &mut image);
            alpha.extend(view.alpha());
            views.push(view);
        }
        Ok(())
    })?;
    Ok(PyRasterized {
        image: frozen(py, image, &shapes.image(num_channels)),
        alpha: frozen(py, alpha, &shapes.image(1)),
        given,
        views,
        shapes,
    })
}

fn missing(name: &str, given: Option<Whole>) -> PyResult<Whole> {
    given.ok_or_else(|| PyTypeError::new_err(format!("{name}: missing, expected a number of pixels")))
}

/// Number of channels.
///
/// # Errors
/// `ValueError` for another shape than `[N, D]`, or `[N, K, 3]` of harmonics.
fn check_colors(colors: &Numbers, degree: Option<usize>) -> PyResult<usize> {
    let least = degree.map_or(0, |degree| (degree + 1).pow(2));
    match (degree, &colors.shape[..]) {
        (None, &[_, num_channels @ 1..=MAX_CHANNELS]) => Ok(num_channels),
        (None, _) => Err(colors.wrong_shape(&format!("[N, C] with C of 1 to {MAX_CHANNELS}, or a sh_degree"))),
        (Some(_), &[_, count, 3]) if count >= least => Ok(3),
        (Some(degree), _) => {
            Err(colors.wrong_shape(&format!("[N, K, 3] with K of {least} or more for sh_degree {degree}")))
        }
    }
}

#[pymethods]
impl PyRasterized {
    /// [height, width, D] float32, or [C, height, width, D] for several cameras; background included, not clamped.
    #[getter]
    fn image(&self, py: Python<'_>) -> Py<PyArrayDyn<f32>> {
        self.image.clone_ref(py)
    }

    /// [height, width, 1] float32, or [C, height, width, 1] for several cameras: 1 minus the share of light that passes
    /// all Gaussians.
    #[getter]
    fn alpha(&self, py: Python<'_>) -> Py<PyArrayDyn<f32>> {
        self.alpha.clone_ref(py)
    }

    fn __iter__<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, pyo3::types::PyIterator>> {
        (self.image(py), self.alpha(py)).into_pyobject(py)?.try_iter()
    }

    /// Vector-Jacobian product: the gradients of a loss whose gradient to the image is `v_image`, and to alpha
    /// `v_alpha`.
    ///
    /// - v_image: of the shape of `image`
    /// - v_alpha: of the shape of `alpha`; None if the loss does not use alpha. It costs another backward pass
    ///
    /// Returns a RasterizeGrads. The gradients reach the means also through the directions in which harmonics are seen.
    #[pyo3(signature = (v_image, v_alpha = None))]
    fn vjp(
        &self,
        py: Python<'_>,
        v_image: ArrayLike<'_>,
        v_alpha: Option<ArrayLike<'_>>,
    ) -> PyResult<PyRasterizeGrads> {
        let (shapes, channels) = (&self.shapes, self.given.num_channels());
        let v_image = Numbers::read("v_image", &v_image)?.of_shape(&shapes.image(channels))?;
        let v_alpha = v_alpha.map(|v_alpha| Numbers::read("v_alpha", &v_alpha)?.of_shape(&shapes.image(1)));
        let v_alpha = v_alpha.transpose()?;
        let most_pairs = self.views.iter().map(View::num_pairs).max().unwrap_or(0);
        reserve("gradients", most_pairs.saturating_mul(size_of::<f32>() * (8 + channels)))?;
        let Grads { gaussians, v_backgrounds } = detached(py, || {
            let v_alphas = v_alpha.map(|v_alpha| shapes.planes(&v_alpha, 1));
            self.given.backward(&self.views, &shapes.planes(&v_image, channels), v_alphas)
        });
        let n = self.given.num_gaussians();
        let of = |values: Vec<f32>, shape: &[usize]| array(py, values, shape).unbind();
        Ok(PyRasterizeGrads {
            v_means: of(gaussians.v_means.into_flattened(), &[n, 3]),
            v_quats: of(gaussians.v_quats.into_flattened(), &[n, 4]),
            v_scales: of(gaussians.v_scales.into_flattened(), &[n, 3]),
            v_opacities: of(gaussians.v_opacities, &[n]),
            v_colors: of(gaussians.v_colors, &shapes.colors),
            v_background: of(v_backgrounds, &shapes.background(channels)),
        })
    }

    fn __repr__(&self) -> String {
        let Shapes { width, height, cameras, .. } = &self.shapes;
        let count = cameras.first().map(|count| format!("{count} images of ")).unwrap_or_default();
        let (n, channels) = (self.given.num_gaussians(), self.given.num_channels());
        format!("Rasterized({n} Gaussians, {count}{width}x{height}, {channels} channels)")
    }
}
