//! One file of Gaussians at one timestep, of any supported kind. Its content determines the kind, except those of
//! `.splat`, `.ksplat` and `meta.json`, which the name tells.

use std::io::Read;
use std::path::Path;

use tcgs_core::Gaussians;

use crate::notes::Replaced;
use crate::stored::{Head, checked};
use crate::{InterchangeError, ReadSettings, gltf, input, ksplat, ply, sog, splat, spz};

/// Kinds of files that hold one timestep.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum FileKind {
    /// PLY, compressed or not.
    Ply,
    Spz,
    Gltf,
    Sog,
    /// `.splat`.
    Splat,
    /// `.ksplat`.
    Ksplat,
}

impl FileKind {
    /// The kind according to the first bytes; that of a `.splat`, a `.ksplat` or an unpacked SOG by its name.
    fn of(path: &Path) -> Result<Self, InterchangeError> {
        let has_ending = |known| path.extension().is_some_and(|ending| ending.eq_ignore_ascii_case(known));
        for (ending, kind) in [("splat", Self::Splat), ("ksplat", Self::Ksplat)] {
            if has_ending(ending) {
                return Ok(kind);
            }
        }
        if sog::is_table(path) {
            return Ok(Self::Sog);
        }
        let mut start = Vec::new();
        let read = input::open(path)?.0.take(64).read_to_end(&mut start);
        read.map_err(|error| InterchangeError::Read { path: path.into(), error })?;
        match &start[..] {
            start if start.starts_with(b"ply") => Ok(Self::Ply),
            start if start.starts_with(b"NGSP") || start.starts_with(&[0x1F, 0x8B]) => Ok(Self::Spz),
            start if gltf::is_gltf(start) => Ok(Self::Gltf),
            start if start.starts_with(b"PK\x03\x04") => Ok(Self::Sog),
            _ => {
                let problem = "is none of PLY, SPZ, glTF and SOG, expected one of these".into();
                Err(InterchangeError::File { path: path.into(), problem })
            }
        }
    }
}

/// Reads the Gaussians of one file in stored form. The file is one of these:
///
/// - a PLY file of 3D Gaussian splatting, or a compressed one
/// - an SPZ file
/// - a glTF file with `KHR_gaussian_splatting`
/// - a SOG file, or the `meta.json` of an unpacked SOG
/// - a `.splat` or a `.ksplat` file
///
/// All come in the axes of PLY files: x right, y down, z forward. A file's own axes are those of the settings, else
/// those that it declares, else those of its kind ([`ReadSettings::axes`]).
///
/// ```no_run
/// use tcgs_interchange::{ReadSettings, read_gaussians};
/// let gaussians = read_gaussians("garden.spz".as_ref(), ReadSettings::default())?;
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// [`InterchangeError::Read`] if the file cannot be read; [`InterchangeError::File`] if it is none of these, not
/// complete, has no Gaussian, or holds a number that is not finite; [`InterchangeError::Limit`] if it claims more
/// memory than the settings allow. Infinite numbers that [`ReadNote::Replaced`](crate::ReadNote) names are replaced.
pub fn read_gaussians(path: &Path, settings: ReadSettings) -> Result<Gaussians, InterchangeError> {
    Ok(read_and_count(path, settings)?.0)
}

/// [`read_gaussians`], with the number of replaced numbers.
pub(crate) fn read_and_count(path: &Path, settings: ReadSettings) -> Result<(Gaussians, Replaced), InterchangeError> {
    let gaussians = match FileKind::of(path)? {
        FileKind::Ply => ply::read_unchecked(path, settings),
        FileKind::Spz => spz::read_spz(path, settings),
        FileKind::Gltf => gltf::read_gltf(path, settings),
        FileKind::Sog => sog::read_sog(path, settings),
        FileKind::Splat => splat::read_splat(path, settings),
        FileKind::Ksplat => ksplat::read_ksplat(path, settings),
    };
    checked(path, gaussians?)
}

/// The kind of a file, and its header's data.
///
/// # Errors
/// As [`read_gaussians`], except for errors that only the numbers show.
pub(crate) fn read_head(path: &Path, settings: ReadSettings) -> Result<(FileKind, Head), InterchangeError> {
    let kind = FileKind::of(path)?;
    let head = match kind {
        FileKind::Ply => ply::read_head(path, settings),
        FileKind::Spz => spz::read_head(path, settings),
        FileKind::Gltf => gltf::read_head(path, settings),
        FileKind::Sog => sog::read_head(path, settings),
        FileKind::Splat => splat::read_head(path, settings),
        FileKind::Ksplat => ksplat::read_head(path, settings),
    };
    Ok((kind, head?))
}
