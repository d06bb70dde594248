//! A scene from arrays of a caller: shapes, and from drawn to stored form.

use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use tcgs_core::{DynamicGaussians, Layout};

use crate::arrays::{ArrayLike, values};

/// All timesteps of a scene. Shapes as of `Scene.from_arrays`.
///
/// - `scales`, `opacities`: in stored form, in activated form; one of the two
///
/// # Errors
/// `ValueError` that names the array whose shape is wrong.
pub fn floats(
    means: &ArrayLike,
    quats: &ArrayLike,
    colors: &ArrayLike,
    scales: [Option<ArrayLike>; 2],
    opacities: [Option<ArrayLike>; 2],
    harmonics: Option<ArrayLike>,
) -> PyResult<DynamicGaussians> {
    let (means, shape) = values(means);
    let &[num_timesteps @ 1..=usize::MAX, num_gaussians, 3] = &shape[..] else {
        let message = format!("means: has shape {shape:?}, expected [T, N, 3] with T of 1 or more");
        return Err(PyValueError::new_err(message));
    };
    let size = [num_timesteps, num_gaussians];
    let quats = samples("quats", quats, size, &[4], true)?;
    let colors = samples("colors", colors, size, &[3], true)?;
    let log_scales = either(
        ["log_scales", "scales"],
        scales,
        |name, array| samples(name, array, size, &[3], false),
        f32::ln,
        "numbers above 0",
    )?;
    let logit_opacities = either(
        ["logit_opacities", "opacities"],
        opacities,
        |name, array| samples(name, array, size, &[], false),
        |opacity| (opacity / (1.0 - opacity)).ln(),
        "numbers between 0 and 1, without these",
    )?;
    let means = means.chunks_exact((3 * num_gaussians).max(1)).map(<[f32]>::to_vec).collect();
    let means = if num_gaussians == 0 { vec![Vec::new(); num_timesteps] } else { means };
    let mut all = vec![means, quats, log_scales, logit_opacities, colors];
    let mut layout = Layout::base();
    if let Some(harmonics) = harmonics {
        let count = harmonics_count(&harmonics)?;
        let degree = [3, 8, 15].iter().position(|&k| k == count).map_or(0, |place| place + 1);
        layout = Layout::with_harmonics(degree);
        all.extend(bands(samples("harmonics", &harmonics, size, &[count, 3], false)?, degree));
    }
    Ok(DynamicGaussians::from_samples(layout, num_timesteps, all))
}

/// Samples of an attribute: of every timestep, or one for all.
///
/// - `size`: timesteps and Gaussians
/// - `row`: shape of a Gaussian's values
/// - `varies`: whether every timestep must have its own
fn samples(name: &str, array: &ArrayLike, size: [usize; 2], row: &[usize], varies: bool) -> PyResult<Vec<Vec<f32>>> {
    let [num_timesteps, num_gaussians] = size;
    let of_one = [&size[1..], row].concat();
    let of_all = [&size[..], row].concat();
    let (values, found) = values(array);
    let count = match found {
        _ if found == of_all => num_timesteps,
        _ if found == of_one && !varies => 1,
        _ => {
            let expected = if varies { format!("{of_all:?}") } else { format!("{of_one:?} or {of_all:?}") };
            return Err(PyValueError::new_err(format!("{name}: has shape {found:?}, expected {expected}")));
        }
    };
    let length = num_gaussians * row.iter().product::<usize>();
    Ok((0..count).map(|t| values[t * length..(t + 1) * length].to_vec()).collect())
}

/// The stored form of one of two arguments: as given, or from the activated form.
///
/// - `names`: of the stored form, of the activated form
/// - `expected`: values of the activated form, in words
fn either(
    names: [&str; 2],
    arrays: [Option<ArrayLike>; 2],
    read: impl Fn(&str, &ArrayLike) -> PyResult<Vec<Vec<f32>>>,
    stored: impl Fn(f32) -> f32,
    expected: &str,
) -> PyResult<Vec<Vec<f32>>> {
    let [of_stored, of_activated] = names;
    match arrays {
        [Some(array), None] => read(of_stored, &array),
        [None, Some(array)] => {
            let mut samples = read(of_activated, &array)?;
            for value in samples.iter_mut().flatten() {
                let given = *value;
                *value = stored(given);
                if !value.is_finite() {
                    let message = format!("{of_activated}: holds {given}, expected {expected}");
                    return Err(PyValueError::new_err(message));
                }
            }
            Ok(samples)
        }
        [given, _] => {
            let found = if given.is_some() { "both given" } else { "neither given" };
            Err(PyValueError::new_err(format!("{of_activated} and {of_stored}: {found}, expected one of the two")))
        }
    }
}

/// `K` of `[…, K, 3]`.
fn harmonics_count(array: &ArrayLike) -> PyResult<usize> {
    let (_, shape) = values(array);
    match shape[..] {
        [.., k @ (3 | 8 | 15), 3] => Ok(k),
        _ => {
            let expected = "[N, K, 3] or [T, N, K, 3] with K of 3, 8 or 15";
            Err(PyValueError::new_err(format!("harmonics: has shape {shape:?}, expected {expected}")))
        }
    }
}

/// Coefficients side by side to the columns of the degrees.
///
/// - `samples`: `[1 or T][N * ((degree + 1)² - 1) * 3]`
/// - returns: by degree `[1 or T][N * (2 l + 1) * 3]`
fn bands(samples: Vec<Vec<f32>>, degree: usize) -> Vec<Vec<Vec<f32>>> {
    let count = 3 * ((degree + 1).pow(2) - 1);
    let band = |l: usize| {
        let (start, end) = (3 * (l * l - 1), 3 * ((l + 1).pow(2) - 1));
        let of_sample =
            |sample: &Vec<f32>| sample.chunks_exact(count).flat_map(|row| row[start..end].to_vec()).collect();
        samples.iter().map(of_sample).collect()
    };
    (1..=degree).map(band).collect()
}
