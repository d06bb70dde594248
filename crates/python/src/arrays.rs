//! Arrays of numpy from floats and back. A caller's arrays are checked: real and finite numbers, in the shape of the
//! argument.

use numpy::{Element, PyArray, PyArrayDescrMethods, PyArrayDyn, PyArrayMethods, PyUntypedArray, PyUntypedArrayMethods};
use pyo3::exceptions::{PyMemoryError, PyTypeError, PyValueError};
use pyo3::prelude::*;
use tcgs_core::{Image, Real};

use crate::memory::no_memory;

/// Any argument that numpy converts to an array: an array, a list of lists, a tensor of torch on the CPU.
pub type ArrayLike<'py> = Bound<'py, PyAny>;

/// An argument that is an array of finite numbers.
#[derive(Clone, Debug)]
pub struct Numbers<T = f32> {
    /// Name of the argument.
    pub name: &'static str,
    /// In the order of rows.
    pub values: Vec<T>,
    pub shape: Vec<usize>,
}

impl<T: Real> Numbers<T> {
    /// Reads an argument.
    ///
    /// # Errors
    /// The message names the argument: `TypeError` if it is no array of real numbers, `ValueError` if one of them is
    /// not finite as `T`, `MemoryError` if there is no room for a copy.
    pub fn read(name: &'static str, given: &ArrayLike<'_>) -> PyResult<Self> {
        let array = as_array(name, given)?;
        let shape = array.shape().to_vec();
        let values = match array.cast::<PyArrayDyn<f32>>() {
            Ok(singles) => copied(name, singles.readonly().as_array().iter().map(|&value| T::of(value.into()))),
            Err(_) => {
                let doubles = array.call_method1("astype", ("f8",)).map_err(|error| named(name, given, error))?;
                let doubles = doubles.cast::<PyArrayDyn<f64>>()?.readonly();
                copied(name, doubles.as_array().iter().map(|&value| T::of(value)))
            }
        }?;
        let numbers = Self { name, values, shape };
        numbers.check("finite numbers", |value| value.is_finite())?;
        Ok(numbers)
    }

    /// Checks every number.
    ///
    /// - `expected`: the expected numbers, in words
    ///
    /// # Errors
    /// `ValueError` with the first wrong number, and its place.
    pub fn check(&self, expected: &str, is_so: impl Fn(T) -> bool) -> PyResult<()> {
        let Some(index) = self.values.iter().position(|&value| !is_so(value)) else { return Ok(()) };
        let mut place = vec![0; self.shape.len()];
        let mut rest = index;
        for (coordinate, size) in place.iter_mut().zip(&self.shape).rev() {
            (*coordinate, rest) = (rest % size, rest / size);
        }
        let (name, found) = (self.name, self.values[index]);
        Err(PyValueError::new_err(format!("{name}: holds {found:?} at {place:?}, expected {expected}")))
    }

    /// The values of an array of `shape`.
    ///
    /// # Errors
    /// `ValueError` for any other shape.
    pub fn of_shape(self, shape: &[usize]) -> PyResult<Vec<T>> {
        if self.shape == shape {
            return Ok(self.values);
        }
        Err(self.wrong_shape(&format!("{shape:?}")))
    }

    /// The rows of an array of `shape`, whose last size is `C`.
    ///
    /// # Errors
    /// `ValueError` for any other shape.
    pub fn rows<const C: usize>(self, shape: &[usize]) -> PyResult<Vec<[T; C]>> {
        Ok(self.of_shape(shape)?.as_chunks().0.to_vec())
    }

    /// - `expected`: shape, in words
    pub fn wrong_shape(&self, expected: &str) -> PyErr {
        let Self { name, shape, .. } = self;
        PyValueError::new_err(format!("{name}: has shape {shape:?}, expected {expected}"))
    }
}

/// A point or direction, or a colour.
///
/// # Errors
/// As for [`Numbers`].
pub fn triple<T: Real>(name: &'static str, given: &ArrayLike<'_>) -> PyResult<[T; 3]> {
    let values = Numbers::read(name, given)?.of_shape(&[3])?;
    Ok(std::array::from_fn(|i| values[i]))
}

/// An array of real numbers of any kind.
fn as_array<'py>(name: &str, given: &ArrayLike<'py>) -> PyResult<Bound<'py, PyUntypedArray>> {
    let array = given.py().import("numpy")?.call_method1("asarray", (given,));
    let array = array.map_err(|error| named(name, given, error))?.cast_into::<PyUntypedArray>()?;
    let kind = array.dtype();
    if b"biuf".contains(&kind.kind()) {
        return Ok(array);
    }
    Err(PyTypeError::new_err(format!("{name}: is an array of {kind}, expected one of real numbers")))
}

/// The exception that numpy, or the argument itself, raised, with the argument's name.
fn named(name: &str, given: &ArrayLike<'_>, error: PyErr) -> PyErr {
    let py = given.py();
    let message = format!("{name}: {}", error.value(py));
    let named = if error.is_instance_of::<PyMemoryError>(py) {
        PyMemoryError::new_err(message)
    } else if error.is_instance_of::<PyValueError>(py) {
        PyValueError::new_err(message)
    } else {
        PyTypeError::new_err(message)
    };
    named.set_cause(py, Some(error));
    named
}

/// A copy, if there is room for one: a numpy array may be a view that repeats a few numbers endlessly.
fn copied<T>(name: &str, values: impl ExactSizeIterator<Item = T>) -> PyResult<Vec<T>> {
    let mut copy = Vec::new();
    let bytes = values.len().saturating_mul(size_of::<T>());
    copy.try_reserve_exact(values.len()).map_err(|_| no_memory(name, bytes))?;
    copy.extend(values);
    Ok(copy)
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
    let mut pixels = Vec::new();
    add_pixels(image, &mut pixels);
    pixels
}

/// Appends the pixels `[H, W, C]` of planes `[C, H, W]`.
pub fn add_pixels(image: &Image, pixels: &mut Vec<f32>) {
    let (before, channels) = (pixels.len(), image.num_channels);
    pixels.resize(before + image.num_pixels() * channels, 0.0);
    for channel in 0..channels {
        for (pixel, &value) in pixels[before..].chunks_exact_mut(channels).zip(image.plane(channel)) {
            pixel[channel] = value;
        }
    }
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
