//! Reads `params.npz`: a whole scene, a timestep at a time, and the arrays beside the Gaussians' attributes.

use std::path::Path;
use std::sync::Arc;

use tcgs_core::{DynamicGaussians, Gaussians, Layout, SceneReader};

use super::{ANTIALIASED, BACKGROUND, DOWNSCALE, FIRST_FRAME, FRAME_RATE, ParamsOrigin};
use crate::npy::show_shape;
use crate::npz::NpzRows;
use crate::{InterchangeError, NpzReader, ReadLimits};

/// Reads the scene of a `params.npz` that Dynamic 3D Gaussians, or [`write_params_npz`](crate::write_params_npz),
/// wrote.
///
/// ```
/// use tcgs_core::{DynamicGaussians, Gaussians};
/// use tcgs_interchange::{ParamsExtras, read_params_npz, write_params_npz};
/// let mut scene = DynamicGaussians::default();
/// scene.push(Gaussians::zeros(5));
/// let folder = tempfile::tempdir()?;
/// let path = folder.path().join("params.npz");
/// write_params_npz(&path, &scene, &ParamsExtras::default())?;
/// assert_eq!(read_params_npz(&path)?, scene);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// Accepts float64, Fortran order, `logit_opacities` of shape `(N,)`, and a leading axis of length 1 on the arrays that
/// do not vary with time.
///
/// # Errors
/// [`InterchangeError`] if the file cannot be read or is incomplete, an array is missing, shapes disagree, a number is
/// not finite, or the scene has no timestep or no Gaussian.
pub fn read_params_npz(path: &Path) -> Result<DynamicGaussians, InterchangeError> {
    ParamsNpz::open(path, ReadLimits::default())?.read_all()
}

/// A scene in a `params.npz` that is read a timestep at a time.
///
/// [`Self::open`] reads through the file once, and checks what [`read_params_npz`] checks. Arrays that are stored
/// without compression stay on disk: the source and [`write_params_npz`](crate::write_params_npz) store them so.
/// Compressed arrays (`numpy.savez_compressed`) and arrays in Fortran order are held in memory, since a timestep of
/// them cannot be read alone.
///
/// ```
/// use tcgs_core::{DynamicGaussians, Gaussians, SceneReader};
/// use tcgs_interchange::{ParamsExtras, ParamsNpz, ReadLimits, write_params_npz};
/// let mut scene = DynamicGaussians::default();
/// scene.push(Gaussians::zeros(5));
/// scene.push(Gaussians::zeros(5));
/// let folder = tempfile::tempdir()?;
/// let path = folder.path().join("params.npz");
/// write_params_npz(&path, &scene, &ParamsExtras::default())?;
/// let mut params = ParamsNpz::open(&path, ReadLimits::default())?;
/// assert_eq!((params.num_timesteps(), params.at(1)?), (2, scene.at(1)));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug)]
pub struct ParamsNpz {
    npz: NpzReader,
    num_timesteps: usize,
    num_gaussians: usize,
    layout: Arc<Layout>,
    pub(super) means: NpzRows,
    pub(super) quats: NpzRows,
    /// `[N, 3]`
    log_scales: Vec<f32>,
    /// `[N]`
    logit_opacities: Vec<f32>,
    pub(super) colors: NpzRows,
}

impl ParamsNpz {
    /// Opens a `params.npz`, and checks all of it.
    ///
    /// # Errors
    /// As [`read_params_npz`]; [`InterchangeError::Limit`] if it has larger arrays or more timesteps than `limits`
    /// allow.
    pub fn open(path: &Path, limits: ReadLimits) -> Result<Self, InterchangeError> {
        open_params(path, limits)
    }

    /// All timesteps.
    ///
    /// # Errors
    /// [`InterchangeError::Array`] if the file has changed since it was opened, or cannot be read.
    pub fn read_all(mut self) -> Result<DynamicGaussians, InterchangeError> {
        let Self { npz, num_timesteps, means, quats, colors, .. } = &mut self;
        let mut over_time =
            |rows: &NpzRows| (0..*num_timesteps).map(|t| npz.row(rows, t)).collect::<Result<Vec<_>, _>>();
        let (means, quats, colors) = (over_time(means)?, over_time(quats)?, over_time(colors)?);
        let samples = vec![means, quats, vec![self.log_scales], vec![self.logit_opacities], colors];
        Ok(DynamicGaussians::from_samples(self.layout, self.num_timesteps, samples))
    }
}

impl SceneReader for ParamsNpz {
    type Error = InterchangeError;

    fn layout(&self) -> &Arc<Layout> {
        &self.layout
    }

    fn num_gaussians_at(&self, _: usize) -> usize {
        self.num_gaussians
    }

    fn num_timesteps(&self) -> usize {
        self.num_timesteps
    }

    fn at(&mut self, timestep: usize) -> Result<Gaussians, InterchangeError> {
        let mut row = |rows: &NpzRows| self.npz.row(rows, timestep);
        let (means, quats, colors) = (row(&self.means)?, row(&self.quats)?, row(&self.colors)?);
        let values = vec![means, quats, self.log_scales.clone(), self.logit_opacities.clone(), colors];
        Ok(Gaussians::new(Arc::clone(&self.layout), self.num_gaussians, values))
    }
}

fn open_params(path: &Path, limits: ReadLimits) -> Result<ParamsNpz, InterchangeError> {
    let mut npz = NpzReader::open_with(path, limits)?;
    let invalid = |key: &str, problem| InterchangeError::Array { path: path.into(), key: key.into(), problem };

    let means = npz.rows("means3D")?;
    let &[num_timesteps, num_gaussians, 3] = means.shape.as_slice() else {
        let problem = format!("has the shape {}, expected (timesteps, gaussians, 3)", show_shape(&means.shape));
        return Err(invalid("means3D", problem));
    };
    if num_timesteps == 0 || num_gaussians == 0 {
        let problem = format!("has {num_timesteps} timesteps of {num_gaussians} gaussians, expected at least one each");
        return Err(invalid("means3D", problem));
    }
    limits.check_timesteps(path, num_timesteps as u64)?;

    let mut varying = |key: &str, components: usize| {
        let array = npz.rows(key)?;
        let expected = [num_timesteps, num_gaussians, components];
        if array.shape != expected {
            let (found, expected) = (show_shape(&array.shape), show_shape(&expected));
            return Err(invalid(key, format!("has the shape {found}, expected {expected} to agree with means3D")));
        }
        Ok(array)
    };
    let colors = varying("rgb_colors", 3)?;
    let quats = varying("unnorm_rotations", 4)?;

    let mut constant = |key: &str, components: usize| {
        let array = npz.array(key)?;
        let shape = match array.shape.as_slice() {
            [1, rest @ ..] if rest.first() == Some(&num_gaussians) => rest,
            whole => whole,
        };
        let expected = [num_gaussians, components];
        if shape != expected && !(components == 1 && shape == [num_gaussians]) {
            let (found, expected) = (show_shape(&array.shape), show_shape(&expected));
            return Err(invalid(key, format!("has the shape {found}, expected {expected} to agree with means3D")));
        }
        Ok(array.values)
    };
    let (log_scales, logit_opacities) = (constant("log_scales", 3)?, constant("logit_opacities", 1)?);
    let background = match npz.contains(BACKGROUND) {
        true => {
            let levels = npz.array(BACKGROUND)?.values;
            let is_level = |level: &f32| level.fract() == 0.0 && (0.0..=255.0).contains(level);
            let color =
                levels.first_chunk().filter(|color: &&[f32; 3]| levels.len() == 3 && color.iter().all(is_level));
            let problem = || format!("is {levels:?}, expected red, green and blue of 0 to 255");
            color.ok_or_else(|| invalid(BACKGROUND, problem()))?.map(|level| level as u8)
        }
        false => [0; 3],
    };
    let layout = Layout::base().antialiased(npz.contains(ANTIALIASED)).with_background(background);
    Ok(ParamsNpz { npz, num_timesteps, num_gaussians, layout, means, quats, log_scales, logit_opacities, colors })
}

/// Reads the origin of the scene in a `params.npz`; `None` if the file has no array `tcgs_first_frame`, as when another
/// program wrote the file.
///
/// # Errors
/// [`InterchangeError`] if the file cannot be read, one of the three arrays is missing, or a number is out of its
/// range.
pub fn read_params_origin(path: &Path, limits: ReadLimits) -> Result<Option<ParamsOrigin>, InterchangeError> {
    let mut npz = NpzReader::open_with(path, limits)?;
    if !npz.contains(FIRST_FRAME) {
        return Ok(None);
    }
    let mut number = |key: &str, expected: &str, legal: fn(f32) -> bool| {
        let array = npz.array(key)?;
        match array.values.as_slice() {
            &[value] if legal(value) => Ok(value),
            values => {
                let problem = format!("is {values:?}, expected {expected}");
                Err(InterchangeError::Array { path: path.into(), key: key.into(), problem })
            }
        }
    };
    Ok(Some(ParamsOrigin {
        first_frame: number(FIRST_FRAME, "a whole number from 0", |x| {
            x.fract() == 0.0 && (0.0..16_777_216.0).contains(&x)
        })? as u32,
        downscale: number(DOWNSCALE, "a whole number of 1 to 65536", |x| {
            x.fract() == 0.0 && (1.0..=65_536.0).contains(&x)
        })? as u32,
        frame_rate: number(FRAME_RATE, "a number, 0 or more", |x| x >= 0.0)?,
    }))
}

/// Reads which Gaussians of a `params.npz` are foreground: those that `seg_colors` paints red; `None` if the file has
/// no such array.
///
/// - returns: `[N]`
///
/// # Errors
/// [`InterchangeError`] if the file cannot be read or the array is damaged.
pub fn read_params_foreground(path: &Path, limits: ReadLimits) -> Result<Option<Vec<bool>>, InterchangeError> {
    let mut npz = NpzReader::open_with(path, limits)?;
    if !npz.contains("seg_colors") {
        return Ok(None);
    }
    let colors = npz.array("seg_colors")?;
    Ok(Some(colors.values.chunks_exact(3).map(|color| color[0] > 0.5).collect()))
}
