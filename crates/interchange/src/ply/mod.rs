//! One PLY file of 3D Gaussian splatting (Kerbl et al. 2023): one timestep. What does not live here: the numbers of
//! compressed files, which the same functions read (`compressed`), and writing these (`pack`).
//!
//! | property of `vertex` | here |
//! |---|---|
//! | `x`, `y`, `z` | `means` |
//! | `nx`, `ny`, `nz` | written as 0, not read |
//! | `f_dc_0` to `f_dc_2` | `colors`, as `(color - 0.5) / 0.28209…`: the coefficient of degree 0 |
//! | `f_rest_0` to `f_rest_8`, `_23` or `_44` | `sh1`, `sh2`, `sh3`: spherical harmonics up to degree 1, 2 or 3 |
//! | `opacity` | `logit_opacities` |
//! | `scale_0` to `scale_2` | `log_scales` |
//! | `rot_0` to `rot_3` | `quats`, `w, x, y, z` |
//!
//! | comment | here |
//! |---|---|
//! | `SplatRenderMode: mip`, of Brush and splat-transform | [`Layout::is_antialiased`]; written for such Gaussians |
//! | `antialiased 1` or `true`, of Postshot | the same; not written |
//! | `tcgs background 118 120 103`, ours alone | [`Layout::background`], unless it is black |
//!
//! Files hold all `f_rest` of red, then of green, then of blue: coefficient `k` of channel `c` is `f_rest_{c K + k}`
//! with `K` of 3, 8 or 15. The columns hold red, green and blue of each coefficient together.
//!
//! Writing and reading again keeps the bits of everything but colours. A colour changes by up to 3e-8, by the rounding
//! of its offset. In a file without `f_rest` a negative colour is read as zero, since renderers of such files clamp
//! colours at zero; with them they clamp the sum.

mod compressed;
mod header;
mod pack;
mod vertex;

use std::fs::File;
use std::io::{self, BufReader, ErrorKind, Write};
use std::path::Path;

use serde_ply::{DeserializeError, ElementDef, PlyReader};
use tcgs_core::{Gaussians, Layout, MAX_SH_DEGREE};

pub(crate) use self::header::{least_bytes, open_header};
pub use self::pack::write_compressed_ply_to;
use self::vertex::{PROPERTIES, REQUIRED, Vertex};
use crate::stored::{Head, checked, color_from_sh0, sh0_from_color};
use crate::{Axes, HigherHarmonics, InterchangeError, ReadSettings};

/// Start of a comment with the colour behind all Gaussians.
const BACKGROUND: &str = "tcgs background ";

/// The comments of a header that say how Gaussians are drawn.
fn comments(layout: &Layout) -> String {
    let antialiased = if layout.is_antialiased() { "comment SplatRenderMode: mip\n" } else { "" };
    match layout.background() {
        [0, 0, 0] => antialiased.into(),
        [red, green, blue] => format!("{antialiased}comment {BACKGROUND}{red} {green} {blue}\n"),
    }
}

/// Reads the Gaussians of one PLY file, in stored form. The file is binary of either byte order, or ASCII; it has the
/// properties of 3D Gaussian splatting, or is compressed. Unknown properties are ignored. Comments may say that the
/// Gaussians are drawn with antialiasing ([`Layout::is_antialiased`]), and on which background.
///
/// ```
/// use tcgs_core::{Gaussians, Layout};
/// use tcgs_interchange::{HigherHarmonics, ReadSettings, read_ply, write_ply_to};
/// let folder = tempfile::tempdir()?;
/// let path = folder.path().join("a.ply");
/// let mut gaussians = Gaussians::zeros_of(&Layout::with_harmonics(3), 5);
/// gaussians.colors_mut().fill([0.5; 3]);
/// write_ply_to(std::fs::File::create(&path)?, &gaussians)?;
/// assert_eq!(read_ply(&path, ReadSettings::default())?, gaussians);
/// assert_eq!(*read_ply(&path, HigherHarmonics::Drop.into())?.layout(), Layout::base());
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// [`InterchangeError::Read`] if the file cannot be read; [`InterchangeError::File`] if the file is not a complete PLY
/// file, lacks a property, has harmonics of no known degree, holds a number that is not finite, or has no Gaussian;
/// [`InterchangeError::Limit`] if its header claims more memory than the settings allow. Infinite numbers that
/// [`ReadNote::Replaced`](crate::ReadNote) names are replaced.
pub fn read_ply(path: &Path, settings: ReadSettings) -> Result<Gaussians, InterchangeError> {
    Ok(checked(path, read_unchecked(path, settings)?)?.0)
}

/// [`read_ply`], where numbers need not be finite.
pub(crate) fn read_unchecked(path: &Path, settings: ReadSettings) -> Result<Gaussians, InterchangeError> {
    let (mut ply, head) = open(path, settings)?;
    let sh_degree = head.layout.sh_degree();
    let gaussians = if is_compressed(&ply) {
        compressed::read(&mut ply, sh_degree)
    } else {
        match sh_degree {
            0 => read_rows::<REQUIRED>(&mut ply, 0),
            1 => read_rows::<{ REQUIRED + 9 }>(&mut ply, 1),
            2 => read_rows::<{ REQUIRED + 24 }>(&mut ply, 2),
            _ => read_rows::<{ REQUIRED + 45 }>(&mut ply, MAX_SH_DEGREE),
        }
    };
    let mut gaussians = gaussians.map_err(|error| damaged(path, error))?.extended(&head.layout);
    settings.axes.unwrap_or(Axes::RDF).turn(&mut gaussians);
    Ok(gaussians)
}

/// Reads the header of a PLY file.
///
/// # Errors
/// As [`read_ply`], but for what only the numbers show.
pub(crate) fn read_head(path: &Path, settings: ReadSettings) -> Result<Head, InterchangeError> {
    Ok(open(path, settings)?.1)
}

/// Writes the Gaussians of one timestep as a binary little-endian PLY file for viewers of 3D Gaussian splatting. It has
/// the harmonics of their layout, and a comment if they are drawn with antialiasing. Further columns are left out.
/// Equal Gaussians give equal bytes.
///
/// - `writer`: should be buffered
/// - `gaussians`: `[N]`, stored form
///
/// # Errors
/// The errors of `writer`.
pub fn write_ply_to(mut writer: impl Write, gaussians: &Gaussians) -> io::Result<()> {
    let (n, bands) = (gaussians.num_gaussians(), gaussians.layout().harmonics());
    let num_rest = num_rest(bands.len());
    let rest = PROPERTIES[REQUIRED..][..num_rest].iter().copied();
    let names = ["x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2"].into_iter().chain(rest);
    let names = names.chain(["opacity", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"]);
    let properties: String = names.map(|name| format!("property float {name}\n")).collect();
    let comments = comments(gaussians.layout());
    write!(writer, "ply\nformat binary_little_endian 1.0\n{comments}element vertex {n}\n{properties}end_header\n")?;
    for i in 0..n {
        let mut row = Vec::with_capacity(17 + num_rest);
        row.extend(gaussians.means()[i]);
        row.extend([0.0; 3]);
        row.extend(gaussians.colors()[i].map(sh0_from_color));
        for channel in 0..3 {
            for &band in &bands {
                let of_gaussian = &gaussians.values(band)[i * band.components()..][..band.components()];
                row.extend(of_gaussian.as_chunks::<3>().0.iter().map(|sh| sh[channel]));
            }
        }
        row.push(gaussians.logit_opacities()[i]);
        row.extend(gaussians.log_scales()[i]);
        row.extend(gaussians.quats()[i]);
        let bytes: Vec<u8> = row.into_iter().flat_map(f32::to_le_bytes).collect();
        writer.write_all(&bytes)?;
    }
    Ok(())
}

/// Number of properties `f_rest` of harmonics up to a degree.
const fn num_rest(sh_degree: usize) -> usize {
    3 * ((sh_degree + 1) * (sh_degree + 1) - 1)
}

/// Which `f_rest` the coefficients of one degree are, in the order of the column.
///
/// - `sh_degree`: of the file's harmonics
/// - `l`: from 1 to that
fn rest_of_band(sh_degree: usize, l: usize) -> impl Iterator<Item = usize> {
    let per_channel = num_rest(sh_degree) / 3;
    (l * l - 1..(l + 1) * (l + 1) - 1).flat_map(move |k| [0, 1, 2].map(|channel| channel * per_channel + k))
}

/// Opens a file, and checks what its header says.
fn open(path: &Path, settings: ReadSettings) -> Result<(PlyReader<BufReader<File>>, Head), InterchangeError> {
    let invalid = |problem| InterchangeError::File { path: path.into(), problem };
    let (ply, length) = open_header(path, |error| damaged(path, error))?;
    let (element, harmonic) = if is_compressed(&ply) {
        compressed::check(ply.header()).map_err(invalid)?
    } else {
        let Some(element) = ply.current_element().filter(|element| element.name == "vertex") else {
            let found = ply.current_element().map_or("nothing", |element| &element.name);
            return Err(invalid(format!("holds {found} first, expected the element vertex")));
        };
        if let Some(missing) = PROPERTIES[..REQUIRED].iter().find(|name| !element.has_property(name)) {
            let expected = PROPERTIES[..REQUIRED].join(", ");
            return Err(invalid(format!("has no property {missing}, expected {expected}")));
        }
        (element, Some(element))
    };
    let sh_degree = match (settings.higher_harmonics, harmonic) {
        (HigherHarmonics::Keep, Some(element)) => sh_degree(element).map_err(invalid)?,
        _ => 0,
    };
    if element.count == 0 {
        return Err(invalid("holds no Gaussian, expected at least one".into()));
    }
    if least_bytes(ply.header()).is_none_or(|least| least > length) {
        return Err(ends_early(path));
    }
    let comments = &ply.header().comments;
    let layout =
        Layout::with_harmonics(sh_degree).antialiased(is_antialiased(comments)).with_background(background(comments));
    let head = Head { num_gaussians: element.count, layout };
    // The rows as they are read, and the columns of the Gaussians.
    settings.limits.check_bytes(path, length, 2 * head.layout.raw_bytes(head.num_gaussians, 1))?;
    Ok((ply, head))
}

/// Whether comments of a header, by Brush or by Postshot, say that the Gaussians are drawn with antialiasing. The last
/// one counts, as in other readers.
fn is_antialiased(comments: &[String]) -> bool {
    let says = |comment: &String| {
        let (key, value) = comment.trim().split_once([' ', ':'])?;
        let value = value.trim_start_matches(':').trim().to_ascii_lowercase();
        match (&*key.to_ascii_lowercase(), &*value) {
            ("splatrendermode", mode) => Some(mode == "mip"),
            ("antialiased", "1" | "true") => Some(true),
            ("antialiased", "0" | "false") => Some(false),
            _ => None,
        }
    };
    comments.iter().rev().find_map(says).unwrap_or(false)
}

/// The colour behind all Gaussians by the last comment that says one; else black.
fn background(comments: &[String]) -> [u8; 3] {
    let says = |comment: &String| {
        let levels = comment.trim().strip_prefix(BACKGROUND)?.split_whitespace();
        levels.map(|level| level.parse().ok()).collect::<Option<Vec<u8>>>()?.try_into().ok()
    };
    comments.iter().rev().find_map(says).unwrap_or_default()
}

/// The degree of a file's harmonics, or what is wrong with them.
fn sh_degree(element: &ElementDef) -> Result<usize, String> {
    let found = element.properties.iter().filter(|property| property.name.starts_with("f_rest_")).count();
    let Some(degree) = (0..=MAX_SH_DEGREE).find(|&degree| num_rest(degree) == found) else {
        return Err(format!(
            "has {found} properties f_rest, expected 0, 9, 24 or 45: spherical harmonics of degree 0 to 3"
        ));
    };
    let names = &PROPERTIES[REQUIRED..][..found];
    match names.iter().find(|name| !element.has_property(name)) {
        Some(missing) => Err(format!("has no property {missing}, expected f_rest_0 to f_rest_{}", found - 1)),
        None => Ok(degree),
    }
}

/// Whether the next element is that of compressed files.
fn is_compressed(ply: &PlyReader<BufReader<File>>) -> bool {
    ply.current_element().is_some_and(|element| element.name == "chunk")
}

fn ends_early(path: &Path) -> InterchangeError {
    InterchangeError::File { path: path.into(), problem: "ends early, expected a whole PLY file".into() }
}

fn damaged(path: &Path, DeserializeError(error): DeserializeError) -> InterchangeError {
    match error.kind() {
        ErrorKind::UnexpectedEof => ends_early(path),
        ErrorKind::InvalidData => {
            let problem = format!("{error}, expected a PLY file of 3D Gaussians");
            InterchangeError::File { path: path.into(), problem }
        }
        _ => InterchangeError::Read { path: path.into(), error },
    }
}

/// Reads the rows of the element `vertex`.
///
/// - `LEN`: number of properties with harmonics up to `sh_degree`
fn read_rows<const LEN: usize>(
    ply: &mut PlyReader<BufReader<File>>,
    sh_degree: usize,
) -> Result<Gaussians, DeserializeError> {
    let rows: Vec<Vertex<0, LEN>> = ply.next_element()?;
    let columns = |places: &[usize]| -> Vec<f32> {
        rows.iter().flat_map(|Vertex(row)| places.iter().map(|&place| row[place])).collect()
    };
    let mut values = vec![
        columns(&[0, 1, 2]),
        columns(&[10, 11, 12, 13]),
        columns(&[7, 8, 9]),
        columns(&[6]),
        columns(&[3, 4, 5]).into_iter().map(color_from_sh0).collect(),
    ];
    values.extend(
        (1..=sh_degree).map(|l| columns(&rest_of_band(sh_degree, l).map(|k| REQUIRED + k).collect::<Vec<_>>())),
    );
    Ok(Gaussians::new(Layout::with_harmonics(sh_degree), rows.len(), values))
}

#[cfg(test)]
mod tests;
