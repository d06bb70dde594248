//! Writes a SOG, packed or not.

use std::f64::consts::SQRT_2;
use std::io::{self, Cursor, ErrorKind, Write};

use image_webp::{ColorType, EncoderParams, WebPEncoder};
use tcgs_core::{Gaussians, normalize, sigmoid};
use zip::{CompressionMethod, DateTime, ZipWriter, write::SimpleFileOptions};

use super::codebook::Codebook;
use super::palette::palette;
use super::{
    ANTIALIASED, Asset, Coded, FIRST_ROTATION, Harmonics, MAX_PALETTE, MAX_POSITION, MAX_SIDE, META, Means, Meta,
    Quats, ROWS_A_LINE, VERSION, coefficients,
};
use crate::stored::{harmonics_in_rows, sh0_from_color, smallest_three};

/// Writes the Gaussians of one timestep as a SOG file of version 2, for viewers such as `SuperSplat`. The file has the
/// harmonics of their layout, and a mark if they are drawn with antialiasing. Further columns are left out. Equal
/// Gaussians give equal bytes.
///
/// A coordinate `x` errs by at most `(1 + |x|) / 131070` of the range of `sign(x) ln(1 + |x|)` over all Gaussians, a
/// component of a rotation by `1 / 361`, an opacity by `1 / 510`. Log scales, colours and harmonics have a codebook of
/// 256 numbers each. Up to 256 different values are not rounded. More than that err by at most 1/64 of their range.
/// Beyond 65536 Gaussians similar ones share their harmonics. Images are smaller if neighbours in space are neighbours
/// in the file ([`space_order`](crate::space_order)); the writer keeps the order.
///
/// - `gaussians`: `[N]`, stored form, in the axes of PLY files; at least one
///
/// ```
/// use tcgs_core::Gaussians;
/// use tcgs_interchange::{ReadSettings, read_gaussians, write_sog_to};
/// let folder = tempfile::tempdir()?;
/// let path = folder.path().join("a.sog");
/// let mut gaussians = Gaussians::zeros(5);
/// gaussians.log_scales_mut()[3] = [-1.0, -2.0, -3.0];
/// write_sog_to(std::fs::File::create(&path)?, &gaussians)?;
/// assert_eq!(read_gaussians(&path, ReadSettings::default())?.log_scales(), gaussians.log_scales());
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// The errors of `writer`; [`io::ErrorKind::InvalidInput`] if there are more Gaussians than a WebP image has pixels,
/// 268 million.
pub fn write_sog_to(mut writer: impl Write, gaussians: &Gaussians) -> io::Result<()> {
    writer.write_all(&archive(&sog_files(gaussians)?)?)
}

/// The files of an unpacked SOG: the content of [`write_sog_to`]'s archive, for viewers that load a `meta.json` and the
/// images beside it.
///
/// - `gaussians`: as for [`write_sog_to`]
/// - returns: name and content of each file, `meta.json` first
///
/// ```
/// use tcgs_core::Gaussians;
/// use tcgs_interchange::{ReadSettings, read_gaussians, sog_files};
/// let folder = tempfile::tempdir()?;
/// for (name, bytes) in sog_files(&Gaussians::zeros(5))? {
///     std::fs::write(folder.path().join(name), bytes)?;
/// }
/// let found = read_gaussians(&folder.path().join("meta.json"), ReadSettings::default())?;
/// assert_eq!(found.num_gaussians(), 5);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// As [`write_sog_to`].
pub fn sog_files(gaussians: &Gaussians) -> io::Result<Vec<(String, Vec<u8>)>> {
    let n = gaussians.num_gaussians();
    let width = n.isqrt().next_multiple_of(4).max(4);
    // Sides are multiples of four pixels, as those of other writers.
    let size = [width, n.div_ceil(width).next_multiple_of(4)];
    if size[0].max(size[1]) > MAX_SIDE {
        return Err(io::Error::new(ErrorKind::InvalidInput, "a SOG file holds at most 268 million Gaussians"));
    }
    let mut files = vec![(META.to_owned(), Vec::new())];
    let mut image = |name: &str, size: [usize; 2], pixels: Vec<[u8; 4]>| {
        files.push((name.to_owned(), webp(size, pixels)?));
        io::Result::Ok(name.to_owned())
    };

    let (mins, maxs, positions) = positions(gaussians.means());
    let bytes = |of: fn(u16) -> u8| positions.iter().map(|&[x, y, z]| [of(x), of(y), of(z), 255]).collect();
    let means = Means {
        mins,
        maxs,
        files: [
            image("means_l.webp", size, bytes(|x| x as u8))?,
            image("means_u.webp", size, bytes(|x| (x >> 8) as u8))?,
        ],
    };
    let quats = Quats { files: [image("quats.webp", size, gaussians.quats().iter().map(|&q| rotation(q)).collect())?] };
    let book = Codebook::of(gaussians.log_scales().as_flattened().iter().copied());
    let pixels = gaussians.log_scales().iter().map(|s| places(&book, *s, 255)).collect();
    let scales = Coded { files: [image("scales.webp", size, pixels)?], codebook: book.into_values() };
    let sh0: Vec<[f32; 3]> = gaussians.colors().iter().map(|color| color.map(sh0_from_color)).collect();
    let book = Codebook::of(sh0.as_flattened().iter().copied());
    let opacities = gaussians.logit_opacities().iter().map(|&o| (sigmoid(f64::from(o)) * 255.0).round() as u8);
    let pixels = sh0.iter().zip(opacities).map(|(&sh0, opacity)| places(&book, sh0, opacity)).collect();
    let sh0 = Coded { files: [image("sh0.webp", size, pixels)?], codebook: book.into_values() };

    let bands = gaussians.layout().sh_degree();
    let sh_n = if bands > 0 {
        let width = 3 * coefficients(bands);
        let palette = palette(&harmonics_in_rows(gaussians), width, MAX_PALETTE);
        let book = Codebook::of(palette.rows.iter().copied());
        let count = palette.rows.len() / width;
        let centroids = palette.rows.as_chunks::<3>().0.iter().map(|&rgb| places(&book, rgb, 255)).collect();
        let of_palette = [ROWS_A_LINE * coefficients(bands), count.div_ceil(ROWS_A_LINE)];
        let labels = palette.places.iter().map(|place| [*place as u8, (place >> 8) as u8, 0, 255]).collect();
        let files = [image("shN_centroids.webp", of_palette, centroids)?, image("shN_labels.webp", size, labels)?];
        Some(Harmonics { count, bands, codebook: book.into_values(), files })
    } else {
        None
    };
    let meta = Meta {
        version: VERSION,
        asset: Asset { generator: concat!("tcgs ", env!("CARGO_PKG_VERSION")) },
        count: n,
        model: gaussians.layout().is_antialiased().then(|| ANTIALIASED.into()),
        means,
        scales,
        quats,
        sh0,
        sh_n,
    };
    files[0].1 = serde_json::to_vec(&meta)?;
    Ok(files)
}

/// The archive of the table and the images. Images are compressed already.
fn archive(files: &[(String, Vec<u8>)]) -> io::Result<Vec<u8>> {
    let mut archive = ZipWriter::new(Cursor::new(Vec::new()));
    let options = SimpleFileOptions::default().last_modified_time(DateTime::default());
    for (name, bytes) in files {
        let method = if name == META { CompressionMethod::Deflated } else { CompressionMethod::Stored };
        archive.start_file(name, options.compression_method(method))?;
        archive.write_all(bytes)?;
    }
    Ok(archive.finish()?.into_inner())
}

/// A lossless image, without or with the prediction of pixels by their neighbours: whichever is shorter. Places in a
/// codebook of unsorted Gaussians are no smooth image.
///
/// - `size`: width and height
/// - `pixels`: as many at most; the others are empty
fn webp([width, height]: [usize; 2], mut pixels: Vec<[u8; 4]>) -> io::Result<Vec<u8>> {
    pixels.resize(width * height, [0, 0, 0, 255]);
    let encode = |use_predictor_transform: bool| {
        let mut bytes = Vec::new();
        let mut encoder = WebPEncoder::new(&mut bytes);
        let mut params = EncoderParams::default();
        params.use_predictor_transform = use_predictor_transform;
        encoder.set_params(params);
        encoder
            .encode(pixels.as_flattened(), width as u32, height as u32, ColorType::Rgba8)
            .map_err(|error| io::Error::other(error.to_string()))?;
        io::Result::Ok(bytes)
    };
    let (plain, predicted) = (encode(false)?, encode(true)?);
    Ok(if predicted.len() < plain.len() { predicted } else { plain })
}

/// The range of the positions' logarithms, and the share of the range that each has.
///
/// - `means`: at least one
fn positions(means: &[[f32; 3]]) -> ([f64; 3], [f64; 3], Vec<[u16; 3]>) {
    let logarithms = |mean: &[f32; 3]| mean.map(|x| f64::from(x).abs().ln_1p().copysign(f64::from(x)));
    let (mut mins, mut maxs) = ([f64::INFINITY; 3], [f64::NEG_INFINITY; 3]);
    for mean in means.iter().map(logarithms) {
        for c in 0..3 {
            (mins[c], maxs[c]) = (mins[c].min(mean[c]), maxs[c].max(mean[c]));
        }
    }
    let share = |mean: [f64; 3]| {
        std::array::from_fn(|c| {
            let range = maxs[c] - mins[c];
            if range > 0.0 { ((mean[c] - mins[c]) / range * MAX_POSITION).round() as u16 } else { 0 }
        })
    };
    (mins, maxs, means.iter().map(logarithms).map(share).collect())
}

/// The identity of a rotation without a direction.
fn rotation(quat: [f32; 4]) -> [u8; 4] {
    let (which, others) = smallest_three(normalize(quat.map(f64::from)));
    let [a, b, c] = others.map(|x| ((x * SQRT_2 / 2.0 + 0.5) * 255.0).round() as u8);
    [a, b, c, FIRST_ROTATION + which as u8]
}

fn places(book: &Codebook, values: [f32; 3], alpha: u8) -> [u8; 4] {
    let [red, green, blue] = values.map(|x| book.place(x));
    [red, green, blue, alpha]
}
