//! The values of a compressed PLY file, as written by `SuperSplat` and splat-transform of `PlayCanvas`.
//!
//! There are three elements, of which the last may be missing. 256 consecutive rows of `vertex` share a row of `chunk`,
//! which gives the range of their values; `unorm` of `b` bits is an integer over `2^b - 1`.
//!
//! | element | property | bits, from the highest | here |
//! |---|---|---|---|
//! | `chunk` | `min_x` to `max_z` | floats | range of `means` |
//! | | `min_scale_x` to `max_scale_z` | floats | range of `log_scales` |
//! | | `min_r` to `max_b` | floats; in newer files | range of `colors`, else `[0, 1]` |
//! | `vertex` | `packed_position`, `packed_scale` | 11, 10, 11: x, y, z | unorm of the range |
//! | | `packed_color` | 8, 8, 8, 8: red, green, blue, opacity | unorm of the range; opacity activated, unorm |
//! | | `packed_rotation` | 2: which of `w, x, y, z` is largest; 10, 10, 10: the others | `√2 (unorm - ½)`; the largest follows, positive |
//! | `sh` | `f_rest_0` to `f_rest_44` | 8 | `8 (n - ½)` with `n = (byte + ½) / 256`, and 0 or 1 for bytes 0 and 255 |
//!
//! Errors of positions, scales, colours and opacities are therefore at most half a step. If a writer takes the nearest
//! byte, errors of `f_rest` between -4 and 4 are at most 1/64, and 3/128 next to -4 and 4. What does not live here:
//! writing (`pack`).

use std::fs::File;
use std::io::BufReader;

use serde::Deserialize;
use serde_ply::{DeserializeError, ElementDef, PlyHeader, PlyReader};
use tcgs_core::{Gaussians, Layout, MAX_SH_DEGREE};

use super::rest_of_band;
use super::vertex::{REQUIRED, Vertex};
use crate::stored::logit_of_byte;

/// Rows of `vertex` that share a row of `chunk`.
pub const CHUNK: usize = 256;

/// Properties that a row of `chunk` has in every file.
pub const RANGES: [&str; 12] = [
    "min_x",
    "min_y",
    "min_z",
    "max_x",
    "max_y",
    "max_z",
    "min_scale_x",
    "min_scale_y",
    "min_scale_z",
    "max_scale_x",
    "max_scale_y",
    "max_scale_z",
];
/// Further properties of a row of `chunk` in newer files.
pub const COLOR_RANGES: [&str; 6] = ["min_r", "min_g", "min_b", "max_r", "max_g", "max_b"];
/// Properties of a row of `vertex`.
pub const PACKED: [&str; 4] = ["packed_position", "packed_rotation", "packed_scale", "packed_color"];

/// The range of a chunk's values.
#[derive(Deserialize)]
struct Ranges {
    min_x: f32,
    min_y: f32,
    min_z: f32,
    max_x: f32,
    max_y: f32,
    max_z: f32,
    min_scale_x: f32,
    min_scale_y: f32,
    min_scale_z: f32,
    max_scale_x: f32,
    max_scale_y: f32,
    max_scale_z: f32,
    #[serde(default)]
    min_r: Option<f32>,
    #[serde(default)]
    min_g: Option<f32>,
    #[serde(default)]
    min_b: Option<f32>,
    #[serde(default)]
    max_r: Option<f32>,
    #[serde(default)]
    max_g: Option<f32>,
    #[serde(default)]
    max_b: Option<f32>,
}

/// One Gaussian.
#[derive(Deserialize)]
#[expect(clippy::struct_field_names, reason = "the names are those of the file")]
struct Packed {
    packed_position: u32,
    packed_rotation: u32,
    packed_scale: u32,
    packed_color: u32,
}

/// Checks a header.
///
/// - returns: the element of the Gaussians, and that of the harmonics if there are any
pub fn check(header: &PlyHeader) -> Result<(&ElementDef, Option<&ElementDef>), String> {
    let [chunk, vertex, rest @ ..] = &header.elem_defs[..] else {
        return Err("holds the element chunk alone, expected chunk and vertex".into());
    };
    if vertex.name != "vertex" {
        return Err(format!("holds {} after chunk, expected the element vertex", vertex.name));
    }
    for (element, names) in [(chunk, &RANGES[..]), (vertex, &PACKED[..])] {
        if let Some(missing) = names.iter().find(|name| !element.has_property(name)) {
            return Err(format!("has no property {missing}, expected {}", names.join(", ")));
        }
    }
    let expected = vertex.count.div_ceil(CHUNK);
    if chunk.count != expected {
        let (found, of) = (chunk.count, vertex.count);
        return Err(format!("has {found} chunks for {of} Gaussians, expected {expected}"));
    }
    let harmonics = rest.first().filter(|element| element.name == "sh");
    match harmonics {
        Some(sh) if sh.count != vertex.count => {
            Err(format!("has harmonics of {} Gaussians, expected {}", sh.count, vertex.count))
        }
        _ => Ok((vertex, harmonics)),
    }
}

/// Reads the elements of a file whose header was checked.
pub fn read(ply: &mut PlyReader<BufReader<File>>, sh_degree: usize) -> Result<Gaussians, DeserializeError> {
    let ranges: Vec<Ranges> = ply.next_element()?;
    let packed: Vec<Packed> = ply.next_element()?;
    let sh = match sh_degree {
        0 => vec![],
        1 => read_harmonics::<9>(ply, 1)?,
        2 => read_harmonics::<24>(ply, 2)?,
        _ => read_harmonics::<45>(ply, MAX_SH_DEGREE)?,
    };
    let layout = Layout::with_harmonics(sh_degree);
    let mut gaussians = Gaussians::zeros_of(&layout, packed.len());
    let base = gaussians.views_mut();
    for (i, row) in packed.iter().enumerate() {
        let range = &ranges[i / CHUNK];
        let position = ([range.min_x, range.min_y, range.min_z], [range.max_x, range.max_y, range.max_z]);
        let scale = (
            [range.min_scale_x, range.min_scale_y, range.min_scale_z],
            [range.max_scale_x, range.max_scale_y, range.max_scale_z],
        );
        let color = (
            [range.min_r, range.min_g, range.min_b].map(|x| x.unwrap_or(0.0)),
            [range.max_r, range.max_g, range.max_b].map(|x| x.unwrap_or(1.0)),
        );
        base.means[i] = between(position, point(row.packed_position));
        base.log_scales[i] = between(scale, point(row.packed_scale));
        let [red, green, blue, opacity] = row.packed_color.to_be_bytes();
        base.colors[i] = between(color, [red, green, blue].map(|byte| f64::from(byte) / 255.0));
        base.logit_opacities[i] = logit_of_byte(opacity);
        base.quats[i] = rotation(row.packed_rotation);
    }
    for (band, values) in layout.harmonics().into_iter().zip(sh) {
        gaussians.values_mut(band).copy_from_slice(&values);
    }
    Ok(gaussians)
}

/// The column of each degree.
fn read_harmonics<const LEN: usize>(
    ply: &mut PlyReader<BufReader<File>>,
    sh_degree: usize,
) -> Result<Vec<Vec<f32>>, DeserializeError> {
    let rows: Vec<Vertex<REQUIRED, LEN>> = ply.next_element()?;
    let coefficient = |byte: f32| match byte {
        0.0 => -4.0,
        255.0 => 4.0,
        byte => 8.0 * ((byte + 0.5) / 256.0 - 0.5),
    };
    let column = |l: usize| {
        let places: Vec<usize> = rest_of_band(sh_degree, l).collect();
        rows.iter().flat_map(|Vertex(row)| places.iter().map(|&place| coefficient(row[place]))).collect()
    };
    Ok((1..=sh_degree).map(column).collect())
}

/// The lowest `bits` of a number, divided by the largest value of that many bits.
fn unorm(number: u32, bits: u32) -> f64 {
    let largest = (1_u32 << bits) - 1;
    f64::from(number & largest) / f64::from(largest)
}

fn point(packed: u32) -> [f64; 3] {
    [unorm(packed >> 21, 11), unorm(packed >> 11, 10), unorm(packed, 11)]
}

fn between((low, high): ([f32; 3], [f32; 3]), share: [f64; 3]) -> [f32; 3] {
    std::array::from_fn(|c| (f64::from(low[c]) * (1.0 - share[c]) + f64::from(high[c]) * share[c]) as f32)
}

/// `w, x, y, z`, unit up to rounding.
fn rotation(packed: u32) -> [f32; 4] {
    let others = [20, 10, 0].map(|shift| std::f64::consts::SQRT_2 * (unorm(packed >> shift, 10) - 0.5));
    let largest = (1.0 - others.iter().map(|x| x * x).sum::<f64>()).max(0.0).sqrt();
    let which = (packed >> 30) as usize;
    let mut others = others.into_iter();
    std::array::from_fn(|c| if c == which { largest } else { others.next().unwrap_or(0.0) } as f32)
}
