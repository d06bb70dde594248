//! Memory of a call is reserved before the call begins. If an allocation fails later, the process ends, and with it a
//! notebook's kernel.

use std::hint::black_box;

use pyo3::exceptions::{PyMemoryError, PyValueError};
use pyo3::prelude::*;
use tcgs_core::{Activated, Camera};
use tcgs_render::{count_pairs, tile_grid};

use crate::numbers::Whole;

/// Most pixels along a side of an image: beyond, a float32 has less than 8 bits for the place within a pixel.
pub const MAX_SIDE: usize = 1 << 16;
/// Most pixels of an image: a panorama of 16384 x 8192. Drawing it takes 8 GB.
const MAX_PIXELS: usize = 1 << 27;
/// Most bytes of a pair of a splat and a tile while pairs are sorted; and its gradients backward.
const PAIR_BYTES: usize = 40;
/// Below this product of Gaussians and tiles, at most 3 GB of pairs, pairs are not counted before drawing.
const FEW_PAIRS: usize = 1 << 28;

/// Width and height of an image.
///
/// # Errors
/// `ValueError` for a number out of range, or more than [`MAX_PIXELS`].
pub fn image_size(width: Whole, height: Whole) -> PyResult<[usize; 2]> {
    let [width, height] = [width.within("width", 1..=MAX_SIDE)?, height.within("height", 1..=MAX_SIDE)?];
    if width * height <= MAX_PIXELS {
        return Ok([width, height]);
    }
    let found = format!("width and height: are {width} and {height}, {} pixels", width * height);
    Err(PyValueError::new_err(format!("{found}, expected at most {MAX_PIXELS}")))
}

/// Checks that memory can be allocated; frees it again.
///
/// - `what`: needs the memory
///
/// # Errors
/// `MemoryError` if there is less.
pub fn reserve(what: &str, bytes: usize) -> PyResult<()> {
    let mut memory = Vec::<u8>::new();
    memory.try_reserve_exact(bytes).map_err(|_| no_memory(what, bytes))?;
    // Otherwise the compiler would leave the allocation out.
    black_box(memory.as_ptr());
    Ok(())
}

/// A `MemoryError`.
pub fn no_memory(what: &str, bytes: usize) -> PyErr {
    PyMemoryError::new_err(format!("{what}: needs {bytes} bytes of memory, expected as many to be free"))
}

/// Checks that the memory for images of a size is free.
///
/// # Errors
/// `MemoryError` if there is less.
pub fn reserve_images(count: usize, [width, height]: [usize; 2], num_channels: usize) -> PyResult<()> {
    // Planes, planes of the tiles, a copy for the backward pass, and pixels for numpy; and three copies of the
    // transmittance.
    let bytes = count.saturating_mul(width * height * size_of::<f32>() * (4 * num_channels + 3));
    reserve("image", bytes)
}

/// Checks that the memory for the splats of an image is free.
///
/// # Errors
/// `MemoryError` if there is less.
pub fn reserve_pairs(gaussians: &Activated, camera: &Camera) -> PyResult<()> {
    let [columns, rows] = tile_grid(camera.width, camera.height);
    if gaussians.num_gaussians().saturating_mul(columns * rows) < FEW_PAIRS {
        return Ok(());
    }
    let num_pairs = count_pairs(gaussians, camera).pairs;
    let bytes = num_pairs.saturating_mul(PAIR_BYTES);
    if num_pairs > u32::MAX as usize { Err(no_memory("splats", bytes)) } else { reserve("splats", bytes) }
}
