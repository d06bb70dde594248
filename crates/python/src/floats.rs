//! A scene from arrays of a caller: shapes, and from drawn to stored form.

use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use tcgs_core::{DynamicGaussians, Layout};

use crate::arrays::{ArrayLike, Numbers};

/// Most timesteps of a file. An array without Gaussians may have more timesteps than memory has bytes.
const MAX_TIMESTEPS: usize = 1 << 16;
/// Most Gaussians that indices of 32 bits count.
const MAX_GAUSSIANS: usize = u32::MAX as usize;

/// All timesteps of a scene. Shapes are those of `Scene.from_arrays`.
///
/// - `scales`, `opacities`: in stored form, in activated form; one of the two
///
/// # Errors
/// `ValueError` that names the array whose shape is wrong.
pub fn floats(
    means: &ArrayLike<'_>,
    quats: &ArrayLike<'_>,
    colors: &ArrayLike<'_>,
    scales: [Option<ArrayLike<'_>>; 2],
    opacities: [Option<ArrayLike<'_>>; 2],
    harmonics: Option<ArrayLike<'_>>,
) -> PyResult<DynamicGaussians> {
    let means = Numbers::read("means", means)?;
    let &[num_timesteps @ 1..=MAX_TIMESTEPS, num_gaussians @ 0..=MAX_GAUSSIANS, 3] = &means.shape[..] else {
        let expected = format!("[T, N, 3] with T of 1 to {MAX_TIMESTEPS} and N up to {MAX_GAUSSIANS}");
        return Err(means.wrong_shape(&expected));
    };
    let size = [num_timesteps, num_gaussians];
    let quats = Numbers::read("quats", quats)?;
    check_lengths(&quats)?;
    let quats = samples(quats, size, &[4], true)?;
    let colors = samples(Numbers::read("colors", colors)?, size, &[3], true)?;
    let log_scales = either(["log_scales", "scales"], scales, size, &[3], f32::ln, "numbers above 0")?;
    let logit = |opacity: f32| (opacity / (1.0 - opacity)).ln();
    let expected = "numbers between 0 and 1, without these";
    let logit_opacities = either(["logit_opacities", "opacities"], opacities, size, &[], logit, expected)?;
    let means = samples(means, size, &[3], true)?;
    let mut all = vec![means, quats, log_scales, logit_opacities, colors];
    let mut layout = Layout::base();
    if let Some(harmonics) = harmonics {
        let harmonics = Numbers::read("harmonics", &harmonics)?;
        let (count, degree) = match harmonics.shape[..] {
            [.., 3, 3] => (3, 1),
            [.., 8, 3] => (8, 2),
            [.., 15, 3] => (15, 3),
            _ => return Err(harmonics.wrong_shape("[N, K, 3] or [T, N, K, 3] with K of 3, 8 or 15")),
        };
        layout = Layout::with_harmonics(degree);
        all.extend(bands(samples(harmonics, size, &[count, 3], false)?, degree));
    }
    Ok(DynamicGaussians::from_samples(layout, num_timesteps, all))
}

/// Refuses quaternions that are no rotation in float32.
fn check_lengths(quats: &Numbers) -> PyResult<()> {
    let has_length = |quat: &[f32]| (1e-36..1e36).contains(&quat.iter().map(|x| x * x).sum::<f32>());
    let rows = if quats.shape.last() == Some(&4) { &quats.values[..] } else { &[] };
    match rows.chunks_exact(4).find(|quat| !has_length(quat)) {
        Some(quat) => {
            Err(PyValueError::new_err(format!("quats: holds {quat:?}, expected a length from 1e-18 to 1e18")))
        }
        None => Ok(()),
    }
}

/// Samples of an attribute: of every timestep, or one for all.
///
/// - `size`: timesteps and Gaussians
/// - `row`: shape of a Gaussian's values
/// - `varies`: whether every timestep must have its own
fn samples(array: Numbers, size: [usize; 2], row: &[usize], varies: bool) -> PyResult<Vec<Vec<f32>>> {
    let [num_timesteps, num_gaussians] = size;
    let of_one = [&size[1..], row].concat();
    let of_all = [&size[..], row].concat();
    let count = match &array.shape {
        found if *found == of_all => num_timesteps,
        found if *found == of_one && !varies => 1,
        _ if varies => return Err(array.wrong_shape(&format!("{of_all:?}"))),
        _ => return Err(array.wrong_shape(&format!("{of_one:?} or {of_all:?}"))),
    };
    let length = num_gaussians * row.iter().product::<usize>();
    Ok((0..count).map(|t| array.values[t * length..(t + 1) * length].to_vec()).collect())
}

/// The stored form of one of two arguments: as given, or from the activated form.
///
/// - `names`: of the stored form, of the activated form
/// - `size`, `row`: as of [`samples`]
/// - `expected`: values of the activated form, in words
fn either(
    [of_stored, of_activated]: [&'static str; 2],
    arrays: [Option<ArrayLike<'_>>; 2],
    size: [usize; 2],
    row: &[usize],
    stored: impl Fn(f32) -> f32,
    expected: &str,
) -> PyResult<Vec<Vec<f32>>> {
    match arrays {
        [Some(array), None] => samples(Numbers::read(of_stored, &array)?, size, row, false),
        [None, Some(array)] => {
            let mut array = Numbers::read(of_activated, &array)?;
            array.check(expected, |value| stored(value).is_finite())?;
            array.values.iter_mut().for_each(|value| *value = stored(*value));
            samples(array, size, row, false)
        }
        [given, _] => {
            let found = if given.is_some() { "both given" } else { "neither given" };
            Err(PyValueError::new_err(format!("{of_activated} and {of_stored}: {found}, expected one of the two")))
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
