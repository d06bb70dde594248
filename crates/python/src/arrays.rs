//! Arrays of numpy from floats and back. Arrays that a caller gives are converted to `float32` and checked against the
//! shape that their name stands for.

use numpy::{AllowTypeChange, Element, IxDyn, PyArray, PyArrayDyn, PyArrayLike, PyArrayMethods, PyUntypedArrayMethods};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use tcgs_core::Image;

/// Anything that numpy makes an array of `T` of: an array, a list of lists, a tensor of torch on the CPU.
pub type ArrayLike<'py, T = f32> = PyArrayLike<'py, T, IxDyn, AllowTypeChange>;

/// The values of an array in the order of rows, and its shape.
pub fn values<T: Element + Copy>(array: &ArrayLike<T>) -> (Vec<T>, Vec<usize>) {
    let values = array.as_array().iter().copied().collect();
    (values, array.shape().to_vec())
}

/// The values of an array of `shape`, in the order of rows.
///
/// - `name`: of the argument
///
/// # Errors
/// `ValueError` if the shape is another one.
pub fn values_of<T: Element + Copy>(name: &str, array: &ArrayLike<T>, shape: &[usize]) -> PyResult<Vec<T>> {
    let (values, found) = values(array);
    if found == shape {
        return Ok(values);
    }
    Err(PyValueError::new_err(format!("{name}: has shape {found:?}, expected {shape:?}")))
}

/// A matrix of a camera.
///
/// # Errors
/// `ValueError` if the shape is another one.
pub fn matrix<const R: usize, const C: usize>(name: &str, array: &ArrayLike<f64>) -> PyResult<[[f64; C]; R]> {
    let values = values_of(name, array, &[R, C])?;
    Ok(std::array::from_fn(|row| std::array::from_fn(|column| values[row * C + column])))
}

/// A new array.
///
/// - `values`: in the order of rows
///
/// # Panics
/// If `values` and `shape` disagree.
pub fn array<'py, T: Element>(py: Python<'py>, values: Vec<T>, shape: &[usize]) -> Bound<'py, PyArrayDyn<T>> {
    PyArray::from_vec(py, values).reshape(shape).expect("as many values as the shape has")
}

/// A new array that cannot be written to.
pub fn frozen(py: Python<'_>, values: Vec<f32>, shape: &[usize]) -> Py<PyArrayDyn<f32>> {
    let array = array(py, values, shape);
    array.readwrite().make_nonwriteable();
    array.unbind()
}

/// Planes `[C, H, W]` to pixels `[H, W, C]`.
pub fn pixels(image: &Image) -> Vec<f32> {
    let (count, channels) = (image.num_pixels(), image.num_channels);
    let mut pixels = vec![0.0; count * channels];
    for channel in 0..channels {
        for (pixel, &value) in pixels.chunks_exact_mut(channels).zip(image.plane(channel)) {
            pixel[channel] = value;
        }
    }
    pixels
}

/// Pixels `[H, W, C]` to planes `[C, H, W]`.
pub fn planes(pixels: &[f32], width: usize, height: usize, num_channels: usize) -> Image {
    let mut image = Image::filled(width, height, num_channels, 0.0);
    for channel in 0..num_channels {
        for (pixel, value) in pixels.chunks_exact(num_channels).zip(image.plane_mut(channel)) {
            *value = pixel[channel];
        }
    }
    image
}
