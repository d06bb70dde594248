//! Cameras.

use numpy::PyArrayDyn;
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use tcgs_core::{Camera, CameraError};

use crate::arrays::{ArrayLike, Numbers, array, triple};
use crate::memory::image_size;
use crate::numbers::{Number, Whole};

/// A pinhole camera without distortion.
///
/// Camera space has x to the right, y down and z forward; the centre of the pixel in the upper left corner lies at
/// (0.5, 0.5).
///
/// - viewmat: [4, 4], world to camera, a rotation and a translation in scene units
/// - K: [3, 3], intrinsics in pixels
/// - width, height: size of the image, pixels
#[pyclass(name = "Camera", module = "tcgs", frozen, eq, from_py_object)]
#[derive(Clone, PartialEq)]
pub struct PyCamera(pub Camera);

/// Cameras of one size from their matrices, checked, and their shape: `[]` for one camera, `[C]` for several.
///
/// - `viewmat`, `k`: the names of the arguments, and `[4, 4]` and `[3, 3]`, or `[C, 4, 4]` and `[C, 3, 3]`
///
/// # Errors
/// `ValueError` or `TypeError` that names the argument.
pub fn cameras(
    viewmat: (&'static str, ArrayLike<'_>),
    k: (&'static str, ArrayLike<'_>),
    [width, height]: [usize; 2],
) -> PyResult<(Vec<Camera>, Vec<usize>)> {
    let [viewmats, ks] = [viewmat, k].map(|(name, array)| Numbers::<f64>::read(name, &array));
    let (viewmats, ks) = (viewmats?, ks?);
    let axis = match viewmats.shape[..] {
        [4, 4] => Vec::new(),
        [count @ 1..=usize::MAX, 4, 4] => vec![count],
        _ => return Err(viewmats.wrong_shape("[4, 4], or [C, 4, 4] with C of 1 or more")),
    };
    let (name, k_name) = (viewmats.name, ks.name);
    let viewmats = viewmats.values.as_chunks::<16>().0.iter();
    let ks = ks.of_shape(&[&axis[..], &[3, 3]].concat())?;
    let cameras = viewmats.zip(ks.as_chunks::<9>().0).enumerate().map(|(index, (viewmat, k))| {
        Camera::new(width, height, matrix(k), matrix(viewmat)).map_err(|error| {
            // Captures call the matrices w2c and k.
            let message = error.to_string().replace("w2c", name);
            let message = message.strip_prefix("k ").map(|rest| format!("{k_name} {rest}")).unwrap_or(message);
            let camera = if axis.is_empty() { String::new() } else { format!("camera {index}: ") };
            PyValueError::new_err(camera + &message)
        })
    });
    Ok((cameras.collect::<PyResult<_>>()?, axis.clone()))
}

/// A matrix from its rows.
fn matrix<const R: usize, const C: usize>(values: &[f64]) -> [[f64; C]; R] {
    std::array::from_fn(|row| std::array::from_fn(|column| values[row * C + column]))
}

#[pymethods]
impl PyCamera {
    #[new]
    #[pyo3(signature = (viewmat, K, width, height))]
    #[allow(non_snake_case, reason = "the usual name of intrinsics")]
    fn new(viewmat: ArrayLike<'_>, K: ArrayLike<'_>, width: Whole, height: Whole) -> PyResult<Self> {
        let size = image_size(width, height)?;
        let (mut cameras, axis) = cameras(("viewmat", viewmat), ("K", K), size)?;
        match (cameras.pop(), axis.is_empty()) {
            (Some(camera), true) => Ok(Self(camera)),
            _ => Err(PyValueError::new_err(format!("viewmat: has shape [{}, 4, 4], expected [4, 4]", axis[0]))),
        }
    }

    /// A camera at `center` that looks at `target`.
    ///
    /// - center, target: [3], world, scene units
    /// - up: [3], the direction in the world that points up in the image; -y if None, as y points down in most captures
    /// - focal: focal length in pixels; the principal point is the middle of the image
    #[staticmethod]
    #[pyo3(signature = (center, target, *, up = None, focal, width, height))]
    fn look_at(
        center: ArrayLike<'_>,
        target: ArrayLike<'_>,
        up: Option<ArrayLike<'_>>,
        focal: Number,
        width: Whole,
        height: Whole,
    ) -> PyResult<Self> {
        let (center, target) = (triple("center", &center)?, triple("target", &target)?);
        let up = up.map_or(Ok([0.0, -1.0, 0.0]), |up| triple("up", &up))?;
        let focal = focal.such("focal", "a number above 0", |focal| focal > 0.0)?;
        let [width, height] = image_size(width, height)?;
        let camera = Camera::look_at(center, target, up, focal, width, height);
        let [[fx, fy], [cx, cy]] = [camera.focal, camera.principal];
        let k = [[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]];
        let checked = Camera::new(width, height, k, camera.camera_from_world);
        checked.map(Self).map_err(|error| {
            if let CameraError::TooLarge { matrix: "k", value, most, .. } = error {
                return PyValueError::new_err(format!("focal: is {value:e}, expected at most {most:e}"));
            }
            let found = format!("center {center:?}, target {target:?} and up {up:?}");
            PyValueError::new_err(format!(
                "{found}: give no rotation, expected a target away from center, and not along up"
            ))
        })
    }

    /// The same camera with an image of another size; the field of view stays the same along both axes.
    fn resized(&self, width: Whole, height: Whole) -> PyResult<Self> {
        let [width, height] = image_size(width, height)?;
        Ok(Self(self.0.resized(width, height)))
    }

    /// [4, 4] float64, world to camera.
    #[getter]
    fn viewmat<'py>(&self, py: Python<'py>) -> Bound<'py, PyArrayDyn<f64>> {
        array(py, self.0.camera_from_world.as_flattened().to_vec(), &[4, 4])
    }

    /// [3, 3] float64, intrinsics in pixels.
    #[getter]
    #[pyo3(name = "K")]
    fn intrinsics<'py>(&self, py: Python<'py>) -> Bound<'py, PyArrayDyn<f64>> {
        let ([fx, fy], [cx, cy]) = (self.0.focal, self.0.principal);
        array(py, vec![fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0], &[3, 3])
    }

    /// Pixels in a row.
    #[getter]
    fn width(&self) -> usize {
        self.0.width
    }

    /// Rows.
    #[getter]
    fn height(&self) -> usize {
        self.0.height
    }

    /// [3] float64, position in the world, scene units.
    #[getter]
    fn center<'py>(&self, py: Python<'py>) -> Bound<'py, PyArrayDyn<f64>> {
        array(py, self.0.center().to_vec(), &[3])
    }

    fn __repr__(&self) -> String {
        let Camera { width, height, focal: [fx, fy], .. } = self.0;
        let [x, y, z] = self.0.center();
        format!("Camera({width}x{height}, focal [{fx:.1}, {fy:.1}], center [{x:.3}, {y:.3}, {z:.3}])")
    }
}
