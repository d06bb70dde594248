//! Cameras.

use numpy::PyArrayDyn;
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use tcgs_core::Camera;

use crate::arrays::{ArrayLike, array, matrix};

/// A pinhole camera without distortion.
///
/// Camera space has x to the right, y down and z forward; the centre of the pixel in the upper left corner lies at
/// (0.5, 0.5).
///
/// - viewmat: [4, 4], world to camera, a rotation and a translation in scene units
/// - K: [3, 3], intrinsics in pixels
/// - width, height: of the image, pixels
#[pyclass(name = "Camera", module = "tcgs", frozen, eq, from_py_object)]
#[derive(Clone, PartialEq)]
pub struct PyCamera(pub Camera);

/// A camera from its matrices, checked.
///
/// # Errors
/// `ValueError` that names the number that is wrong.
pub fn camera(viewmat: &ArrayLike<f64>, k: &ArrayLike<f64>, width: usize, height: usize) -> PyResult<Camera> {
    let (viewmat, k) = (matrix::<4, 4>("viewmat", viewmat)?, matrix::<3, 3>("K", k)?);
    Camera::new(width, height, k, viewmat)
        // Captures call the matrix w2c.
        .map_err(|error| PyValueError::new_err(error.to_string().replace("w2c", "viewmat")))
}

#[pymethods]
impl PyCamera {
    #[new]
    #[pyo3(signature = (viewmat, K, width, height))]
    #[allow(non_snake_case, reason = "the usual name of intrinsics")]
    fn new(viewmat: ArrayLike<f64>, K: ArrayLike<f64>, width: usize, height: usize) -> PyResult<Self> {
        camera(&viewmat, &K, width, height).map(Self)
    }

    /// A camera at `center` that looks at `target`.
    ///
    /// - center, target: [3], world, scene units
    /// - up: [3], the direction in the world that points up in the image; y points down in most captures
    /// - focal: focal length in pixels; the principal point is the middle of the image
    #[staticmethod]
    #[pyo3(signature = (center, target, *, up = [0.0, -1.0, 0.0], focal, width, height))]
    fn look_at(
        center: [f64; 3],
        target: [f64; 3],
        up: [f64; 3],
        focal: f64,
        width: usize,
        height: usize,
    ) -> PyResult<Self> {
        let camera = Camera::look_at(center, target, up, focal, width, height);
        let [[fx, fy], [cx, cy]] = [camera.focal, camera.principal];
        let k = [[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]];
        // Finite, and `up` not along the line of sight.
        let checked = Camera::new(width, height, k, camera.camera_from_world);
        checked.map(Self).map_err(|error| PyValueError::new_err(format!("look_at: {error}").replace("w2c", "viewmat")))
    }

    /// The same camera with an image of another size; the field of view stays along both axes.
    fn resized(&self, width: usize, height: usize) -> PyResult<Self> {
        if width == 0 || height == 0 {
            return Err(PyValueError::new_err(format!(
                "resized: the image is {width}x{height}, expected at least 1x1"
            )));
        }
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
