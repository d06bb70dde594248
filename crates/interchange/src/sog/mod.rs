//! One SOG of `SuperSplat`, version 2: one timestep. `read` reads it, `write` writes it; `codebook` and `palette`
//! choose the values that a file holds.
//!
//! A `.sog` file is a ZIP archive of `meta.json` ([`Meta`]) and lossless WebP images. An unpacked SOG is a folder of
//! the same files. Pixel `i` of an image, row by row, is Gaussian `i`; an image may have more pixels. `files` of
//! `meta.json` names the images.
//!
//! | part | image | red, green, blue | alpha | here |
//! |---|---|---|---|---|
//! | `means` | first | low bytes of `m` for x, y, z | | `means`: `sign(m) (exp(abs(m)) - 1)` |
//! | | second | high bytes | | |
//! | `quats` | | `(√2 q / 2 + ½) 255`, three smallest | 252 + place of the largest | `quats`, `w, x, y, z` |
//! | `scales` | | places in `codebook` | | `log_scales` |
//! | `sh0` | | places in `codebook` | opacity, activated | `colors`, as coefficients of degree 0 |
//! | `shN` | second | place in the palette of `count` rows, low and high byte | | `sh1` to `sh3`, up to `bands` |
//! | | first | places in `codebook`: for each row of the palette its coefficients; 64 rows a line | | |
//!
//! A codebook has up to 256 numbers. The 16 bits of `m` divide the range from `mins` to `maxs`. `model` is
//! `antialiased` if the Gaussians are drawn with antialiasing
//! ([`Layout::is_antialiased`](tcgs_core::Layout::is_antialiased)). Axes are those of PLY files.

mod codebook;
mod palette;
mod read;
mod write;

pub use read::is_sog_file;
pub(crate) use read::{images_of, is_sog, is_table, read_head, read_sog, table_in};
use serde::{Deserialize, Serialize};
pub use write::{sog_files, write_sog_to};

/// Name of the table.
const META: &str = "meta.json";
/// The version that is read and written. The first had no number.
const VERSION: u32 = 2;
/// [`Meta::model`] of Gaussians that are drawn with antialiasing.
const ANTIALIASED: &str = "antialiased";
/// Rows of the palette in a line of its image.
const ROWS_A_LINE: usize = 64;
/// Most rows of a palette: places have 16 bits.
const MAX_PALETTE: usize = 1 << 16;
/// The alpha of a rotation whose largest component is `w`; those of `x`, `y` and `z` follow.
const FIRST_ROTATION: u8 = 252;
/// Longest side of a WebP image, in pixels.
const MAX_SIDE: usize = 16383;
/// Largest integer of a position.
const MAX_POSITION: f64 = 65535.0;

/// The content of `meta.json`.
#[derive(Serialize, Deserialize)]
struct Meta {
    version: u32,
    #[serde(skip_deserializing)]
    asset: Asset,
    count: usize,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    model: Option<String>,
    means: Means,
    scales: Coded,
    quats: Quats,
    sh0: Coded,
    #[serde(default, rename = "shN", skip_serializing_if = "Option::is_none")]
    sh_n: Option<Harmonics>,
}

#[derive(Default, Serialize)]
struct Asset {
    generator: &'static str,
}

/// Positions.
#[derive(Serialize, Deserialize)]
struct Means {
    mins: [f64; 3],
    maxs: [f64; 3],
    files: [String; 2],
}

/// Scales, or colours.
#[derive(Serialize, Deserialize)]
struct Coded {
    codebook: Vec<f32>,
    files: [String; 1],
}

/// Rotations.
#[derive(Serialize, Deserialize)]
struct Quats {
    files: [String; 1],
}

/// Harmonics of degree 1 and above.
#[derive(Serialize, Deserialize)]
struct Harmonics {
    /// Rows of the palette.
    count: usize,
    bands: usize,
    codebook: Vec<f32>,
    files: [String; 2],
}

/// Coefficients of a row of the palette, each of three colours.
const fn coefficients(bands: usize) -> usize {
    (bands + 1) * (bands + 1) - 1
}

#[cfg(test)]
mod tests;
