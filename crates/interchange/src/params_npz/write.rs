//! Writes `params.npz`.

use std::fs::File;
use std::io::{self, BufWriter, Seek, Write};
use std::path::Path;

use tcgs_core::{Attribute, DynamicGaussians, SceneReader};

use super::{ANTIALIASED, BACKGROUND, DOWNSCALE, FIRST_FRAME, FRAME_RATE, ParamsOrigin};
use crate::{Existing, InterchangeError, NpzWriter, write_whole};

/// Rows of `cam_m` and `cam_c`: the source always has 50, whatever the number of cameras.
const MIN_CAMERA_ROWS: usize = 50;

/// The arrays of `params.npz` other than the Gaussians' attributes. By default: all foreground, no cameras, no origin.
#[derive(Clone, Copy, Debug, Default)]
pub struct ParamsExtras<'a> {
    /// `[N]`, whether each Gaussian belongs to the foreground; with `None` all do.
    pub foreground: Option<&'a [bool]>,
    /// `[C, 3]`, logarithm of each training camera's colour gain, written as `cam_m`.
    pub log_gains: &'a [[f32; 3]],
    /// `[C, 3]`, colour offset of each training camera, written as `cam_c`.
    pub offsets: &'a [[f32; 3]],
    /// The frames and the resolution that the scene was trained on, for readers that know
    /// [`read_params_origin`](crate::read_params_origin).
    pub origin: Option<ParamsOrigin>,
}

/// Writes a scene as a `params.npz` that the viewer of Dynamic 3D Gaussians can show. The write is atomic: a temporary
/// file is renamed to `path` and replaces an existing file.
///
/// # Errors
/// [`InterchangeError::Write`] if the file cannot be written; an existing file is then unchanged.
///
/// # Panics
/// As [`write_params_npz_to`].
pub fn write_params_npz(path: &Path, scene: &DynamicGaussians, extras: &ParamsExtras) -> Result<(), InterchangeError> {
    let write = |file: &mut File| write_params_npz_to(BufWriter::new(file), scene, extras)?.flush();
    let written = write_whole(path, Existing::Replace, write);
    written.map_err(|error| InterchangeError::Write { path: path.into(), error })
}

/// Writes the bytes of a `params.npz`. Equal scenes and extras give equal bytes.
///
/// - `writer`: should be buffered
///
/// # Errors
/// The errors of `writer`.
///
/// # Panics
/// If the scene has no timestep or no Gaussian. If scales or opacities vary with time (the format holds them once). If
/// `extras.foreground` does not have one label per Gaussian.
pub fn write_params_npz_to<W: Write + Seek>(
    writer: W,
    scene: &DynamicGaussians,
    extras: &ParamsExtras,
) -> io::Result<W> {
    let t = scene.num_timesteps();
    for attribute in [Attribute::LogScale, Attribute::LogitOpacity] {
        assert!(!scene.varies(attribute), "{} vary over {t} timesteps, params.npz holds one", attribute.name());
    }
    write_params_npz_from(writer, &mut &*scene, extras)
}

/// Writes the bytes of a `params.npz` of a scene that is read a timestep at a time, three times over. Scales and
/// opacities are those of the first timestep.
///
/// - `writer`: should be buffered
///
/// # Errors
/// The errors of `writer` and, as [`io::ErrorKind::Other`], of `scene`.
///
/// # Panics
/// If the scene has no timestep or no Gaussian, or if `extras.foreground` does not have one label per Gaussian.
pub fn write_params_npz_from<W: Write + Seek, R: SceneReader>(
    writer: W,
    scene: &mut R,
    extras: &ParamsExtras,
) -> io::Result<W> {
    let t = scene.num_timesteps();
    let n = if t > 0 { scene.num_gaussians_at(0) } else { 0 };
    assert!(t > 0 && n > 0, "a scene of {t} timesteps of {n} gaussians");
    let seg_colors: Vec<[f32; 3]> = match extras.foreground {
        Some(foreground) => {
            assert_eq!(foreground.len(), n, "foreground: [{}] against [{n}]", foreground.len());
            foreground.iter().map(|&f| if f { [1.0, 0.0, 0.0] } else { [0.0, 0.0, 1.0] }).collect()
        }
        None => vec![[1.0, 0.0, 0.0]; n],
    };
    let camera_rows = MIN_CAMERA_ROWS.max(extras.log_gains.len()).max(extras.offsets.len());
    let padded = |rows: &[[f32; 3]]| {
        let mut rows = rows.to_vec();
        rows.resize(camera_rows, [0.0; 3]);
        rows
    };

    let mut npz = NpzWriter::new(writer);
    for (key, attribute) in
        [("means3D", Attribute::Mean), ("rgb_colors", Attribute::Color), ("unnorm_rotations", Attribute::Quat)]
    {
        npz.array_with(key, &[t, n, attribute.components()], |put| {
            (0..t).try_for_each(|timestep| put(scene.at(timestep).map_err(io::Error::other)?.values(attribute)))
        })?;
    }
    let first = scene.at(0).map_err(io::Error::other)?;
    npz.array("logit_opacities", &[n, 1], [first.logit_opacities()])?;
    npz.array("log_scales", &[n, 3], [first.log_scales().as_flattened()])?;
    npz.array("seg_colors", &[n, 3], [seg_colors.as_flattened()])?;
    npz.array("cam_m", &[camera_rows, 3], [padded(extras.log_gains).as_flattened()])?;
    npz.array("cam_c", &[camera_rows, 3], [padded(extras.offsets).as_flattened()])?;
    if let Some(origin) = &extras.origin {
        let values = [origin.first_frame as f32, origin.downscale as f32, origin.frame_rate];
        for (key, value) in [FIRST_FRAME, DOWNSCALE, FRAME_RATE].into_iter().zip(values) {
            npz.array(key, &[1], [[value].as_slice()])?;
        }
    }
    if scene.layout().is_antialiased() {
        npz.array(ANTIALIASED, &[1], [[1.0].as_slice()])?;
    }
    if scene.layout().background() != [0; 3] {
        npz.array(BACKGROUND, &[3], [scene.layout().background().map(f32::from).as_slice()])?;
    }
    npz.finish()
}
