//! One `.splat` file of antimatter15's viewer: one timestep. It has no header, and 32 bytes a Gaussian.
//!
//! | bytes | number | here |
//! |---|---|---|
//! | 0–11 | three floats | `means` |
//! | 12–23 | three floats, not their logarithms | `log_scales` |
//! | 24–26 | `byte / 255` | `colors` |
//! | 27 | `byte / 255`, activated | `logit_opacities` |
//! | 28–31 | `byte / 128 - 1` | `quats`, `w, x, y, z` |
//!
//! There are no harmonics. Axes are those of PLY files. The first bytes are a position, so the ending of the name alone
//! tells the kind.

use std::io::Read;
use std::path::Path;

use tcgs_core::{Gaussians, Layout};

use crate::axes::Axes;
use crate::stored::{Head, logit_of_byte};
use crate::{InterchangeError, ReadSettings, input};

/// Bytes of a Gaussian.
const ROW: usize = 32;

/// Reads the Gaussians of one `.splat` file, in stored form. Numbers need not be finite.
///
/// # Errors
/// [`InterchangeError::Read`] if the file cannot be read; [`InterchangeError::File`] if its length is not that of whole
/// Gaussians, or it has none; [`InterchangeError::Limit`] if it takes more memory than the settings allow.
pub(crate) fn read_splat(path: &Path, settings: ReadSettings) -> Result<Gaussians, InterchangeError> {
    let failed = |error| InterchangeError::Read { path: path.into(), error };
    let Head { num_gaussians, layout } = read_head(path, settings)?;
    let mut bytes = Vec::new();
    // The file may grow after it was measured.
    let length = (ROW * num_gaussians) as u64;
    input::open(path)?.0.take(length).read_to_end(&mut bytes).map_err(failed)?;
    if bytes.len() as u64 != length {
        return Err(not_whole(path, bytes.len() as u64));
    }
    let mut gaussians = Gaussians::zeros_of(&layout, num_gaussians);
    let base = gaussians.views_mut();
    for (i, row) in bytes.as_chunks::<ROW>().0.iter().enumerate() {
        let float = |at: usize| f32::from_le_bytes([row[at], row[at + 1], row[at + 2], row[at + 3]]);
        base.means[i] = [0, 4, 8].map(float);
        base.log_scales[i] = [12, 16, 20].map(|at| float(at).ln());
        base.colors[i] = [24, 25, 26].map(|at| f32::from(row[at]) / 255.0);
        base.logit_opacities[i] = logit_of_byte(row[27]);
        base.quats[i] = [28, 29, 30, 31].map(|at| f32::from(row[at]) / 128.0 - 1.0);
    }
    settings.axes.unwrap_or(Axes::RDF).turn(&mut gaussians);
    Ok(gaussians)
}

/// The number of Gaussians according to the length of a file.
///
/// # Errors
/// As [`read_splat`].
pub(crate) fn read_head(path: &Path, settings: ReadSettings) -> Result<Head, InterchangeError> {
    let (_, length) = input::open(path)?;
    if length == 0 || length % ROW as u64 != 0 {
        return Err(not_whole(path, length));
    }
    let (num_gaussians, layout) = ((length / ROW as u64) as usize, Layout::base());
    settings.limits.check_bytes(path, length, length + layout.raw_bytes(num_gaussians, 1))?;
    Ok(Head { num_gaussians, layout })
}

fn not_whole(path: &Path, length: u64) -> InterchangeError {
    let problem = format!("has {length} bytes, expected {ROW} for each of one or more Gaussians");
    InterchangeError::File { path: path.into(), problem }
}

#[cfg(test)]
mod tests {
    use std::fs;

    use tcgs_core::sigmoid;

    use super::*;
    use crate::read_gaussians;

    fn row(position: [f32; 3], scales: [f32; 3], bytes: [u8; 8]) -> Vec<u8> {
        let floats = position.into_iter().chain(scales).flat_map(f32::to_le_bytes);
        floats.chain(bytes).collect()
    }

    fn read(bytes: &[u8]) -> Result<Gaussians, String> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.SPLAT");
        fs::write(&path, bytes).unwrap();
        read_gaussians(&path, ReadSettings::default())
            .map_err(|error| error.to_string().strip_prefix(&format!("{}: ", path.display())).unwrap().to_owned())
    }

    #[test]
    fn rows_become_gaussians() {
        let first = row([1.0, -2.0, 3.0], [1.0, 0.5, 2.0], [255, 0, 51, 255, 255, 128, 128, 128]);
        let second = row([0.0; 3], [0.0, 1.0, 1.0], [0, 0, 0, 102, 128, 0, 192, 128]);
        let found = read(&[first, second].concat()).unwrap();
        assert_eq!(found.means(), [[1.0, -2.0, 3.0], [0.0; 3]]);
        assert_eq!(found.log_scales()[0], [0.0, -std::f32::consts::LN_2, std::f32::consts::LN_2]);
        // A scale of zero is replaced.
        assert!(found.log_scales()[1][0] < -19.0);
        assert_eq!(found.colors()[0], [1.0, 0.0, 0.2]);
        assert!((sigmoid(found.logit_opacities()[1]) - 0.4).abs() < 1e-6 && found.logit_opacities()[0] > 6.0);
        assert_eq!(found.quats(), [[127.0 / 128.0, 0.0, 0.0, 0.0], [0.0, -1.0, 0.5, 0.0]]);
    }

    #[test]
    fn what_is_wrong_is_named() {
        for length in [0, 31, 33] {
            let expected = format!("has {length} bytes, expected 32 for each of one or more Gaussians");
            assert_eq!(read(&vec![0; length]).unwrap_err(), expected);
        }
        let problem = read(&row([0.0; 3], [1.0, -1.0, 1.0], [128; 8])).unwrap_err();
        assert_eq!(problem, "log_scales of Gaussian 0: NaN, expected a finite number");
    }
}
