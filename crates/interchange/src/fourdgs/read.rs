//! Reads a `.4dgs` file into memory, and gives its state at each timestep.

use std::cmp::Ordering;
use std::io::Read;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use ::fourdgs::ReadOptions;
use ::fourdgs::keyframe_delta_file::peek_temporal_model;
use ::fourdgs::quantization::sh_coefficient;
use tcgs_core::{Gaussians, Layout, SceneReader};

use super::bounds::{self, Model};
use super::{Y_UP, one_line, states};
use crate::axes::Axes;
use crate::notes::ReplacedByTimestep;
use crate::stored::{checked, logit};
use crate::{HigherHarmonics, InterchangeError, ReadNote, ReadSettings, input};

/// The longest window that counts as a frame, seconds: a tenth, plus the rounding of a float.
const LONGEST_FRAME_SECS: f64 = 0.1 + 1e-4;
/// Timesteps a second if the file does not say.
const USUAL_RATE: f64 = 30.0;
/// Most timesteps under any limits: nine hours at thirty a second.
const MAX_TIMESTEPS: f64 = 1e6;

/// A scene in a `.4dgs` file, in memory.
///
/// ```no_run
/// use tcgs_core::SceneReader;
/// use tcgs_interchange::{FourdgsFile, ReadSettings};
/// let file = FourdgsFile::open("scene.4dgs".as_ref(), ReadSettings::default())?;
/// println!("{} timesteps, {} a second", file.num_timesteps(), file.frame_rate());
/// # Ok::<(), tcgs_interchange::InterchangeError>(())
/// ```
#[derive(Debug)]
pub struct FourdgsFile {
    path: PathBuf,
    content: Content,
    /// Times of the timesteps, seconds.
    times: Vec<f64>,
    /// Gaussians at each timestep.
    numbers: Vec<usize>,
    frame_rate: f64,
    layout: Arc<Layout>,
    axes: Axes,
    replaced: ReplacedByTimestep,
}

#[derive(Debug)]
enum Content {
    /// The content of a file of the model `gaussian-birth`.
    Births(Box<::fourdgs::Scene>),
    /// The states of a file of the model `keyframe-delta`.
    States(Vec<Gaussians>),
}

impl FourdgsFile {
    /// Reads a file.
    ///
    /// # Errors
    /// [`InterchangeError::Read`] if the file cannot be read; [`InterchangeError::File`] if it is no whole `.4dgs`
    /// file, is of a model or packed in a way that is not read, or has no Gaussian at any timestep;
    /// [`InterchangeError::Limit`] if it claims more memory or timesteps than the settings allow.
    pub fn open(path: &Path, settings: ReadSettings) -> Result<Self, InterchangeError> {
        let invalid = |problem: String| InterchangeError::File { path: path.into(), problem };
        let refused = |error: ::fourdgs::Error| invalid(format!("{}, expected a whole .4dgs file", one_line(&error)));
        let (file, length) = input::open(path)?;
        let mut bytes = Vec::new();
        let read = file.take(length).read_to_end(&mut bytes);
        read.map_err(|error| InterchangeError::Read { path: path.into(), error })?;
        // Readers of the crate keep the complete records of a truncated file.
        if bytes.starts_with(&::fourdgs::MAGIC) && !bytes.ends_with(&::fourdgs::MAGIC) {
            return Err(invalid("ends early, expected a whole .4dgs file".into()));
        }
        let model = match &*peek_temporal_model(&bytes).map_err(refused)? {
            "keyframe-delta" => Model::States,
            _ => Model::Births,
        };
        let needed = bounds::held_bytes(&bytes, model, settings.limits.bytes(length)).map_err(refused)?;
        settings.limits.check_bytes(path, length, needed)?;
        let (content, header, times, frame_rate) = if model == Model::States {
            let states::States { header, times, timesteps } = states::decode(&bytes).map_err(refused)?;
            settings.limits.check_timesteps(path, times.len() as u64)?;
            let rate = times.len() as f64 / header.duration_sec;
            (Content::States(timesteps), header, times, rate)
        } else {
            let max_sh_band = if settings.higher_harmonics == HigherHarmonics::Keep { 3 } else { 0 };
            let options = ReadOptions { recover_truncated: false, max_sh_band };
            let scene = ::fourdgs::stream_reader::read_from(&bytes[..], &options).map_err(refused)?;
            let length = frame_secs(&scene.windows);
            let count = (scene.duration_sec / length).round().max(1.0);
            if count > MAX_TIMESTEPS {
                return Err(invalid(format!(
                    "lasts {} s, expected at most {MAX_TIMESTEPS} timesteps",
                    scene.duration_sec
                )));
            }
            settings.limits.check_timesteps(path, count as u64)?;
            let length = scene.duration_sec / count;
            let times: Vec<f64> = (0..count as usize).map(|t| (t as f64 + 0.5) * length).collect();
            let header = scene.header.clone();
            (Content::Births(Box::new(scene)), header, times, 1.0 / length)
        };
        let said = |key: &str| header.attributes.get(key).map(String::as_str);
        if let Some(space) = said("color_space").filter(|space| !space.starts_with("srgb")) {
            return Err(invalid(format!("has colours in {space:?}, expected \"srgb-rec709-display\"")));
        }
        let declared = match said("coordinate_system") {
            Some(Y_UP) => Axes::LUF,
            _ => Axes::RDF,
        };
        let axes = settings.axes.unwrap_or(declared);
        let sh_degree = match &content {
            Content::Births(scene)
                if settings.higher_harmonics == HigherHarmonics::Keep && scene.gaussians.sh.is_some() =>
            {
                // Writers may leave out bands that the header declares.
                let stored = (scene.gaussians.sh_coefficients + 1).isqrt() - 1;
                stored.min(scene.gaussians.sh_degree.into())
            }
            _ => 0,
        };
        let frame_rate = if frame_rate.is_finite() { frame_rate } else { USUAL_RATE };
        let layout = Layout::with_harmonics(sh_degree.min(tcgs_core::MAX_SH_DEGREE));
        let (path, numbers, replaced) = (path.into(), vec![], ReplacedByTimestep::default());
        let mut file = Self { path, content, times, numbers, frame_rate, layout, axes, replaced };
        file.numbers = match &file.content {
            Content::Births(scene) => living(scene, &file.times),
            Content::States(timesteps) => timesteps.iter().map(Gaussians::num_gaussians).collect(),
        };
        if file.numbers.iter().all(|&number| number == 0) {
            return Err(invalid("holds no Gaussian, expected at least one".into()));
        }
        Ok(file)
    }

    /// Timesteps a second.
    pub fn frame_rate(&self) -> f64 {
        self.frame_rate
    }

    /// Axes of the Gaussians in the file. They are rotated to those of PLY files.
    pub fn axes(&self) -> Axes {
        self.axes
    }

    /// Replacements at the timesteps read so far.
    pub fn notes(&self) -> Vec<ReadNote> {
        self.replaced.note().into_iter().collect()
    }

    /// Size as plain 32-bit floats ([`Layout::raw_bytes_of_changing`]).
    pub fn raw_bytes(&self) -> u64 {
        self.layout.raw_bytes_of_changing(&self.numbers)
    }

    /// The Gaussians at a timestep, in stored form and in the axes of PLY files.
    ///
    /// # Errors
    /// [`InterchangeError::File`] if a number is not finite.
    ///
    /// # Panics
    /// If `timestep` is not below [`SceneReader::num_timesteps`].
    pub fn at(&self, timestep: usize) -> Result<Gaussians, InterchangeError> {
        let mut gaussians = match &self.content {
            Content::Births(scene) => self.born(scene, self.times[timestep])?,
            Content::States(timesteps) => timesteps[timestep].clone(),
        };
        self.axes.turn(&mut gaussians);
        let (gaussians, replaced) = checked(&self.path, gaussians)?;
        self.replaced.record(timestep, replaced);
        Ok(gaussians)
    }

    /// The Gaussians that live at a time, in the axes of the file.
    fn born(&self, scene: &::fourdgs::Scene, time: f64) -> Result<Gaussians, InterchangeError> {
        let rows = births(scene, time).map_err(|error| {
            let problem = format!("{}, expected a whole .4dgs file", one_line(&error));
            InterchangeError::File { path: self.path.clone(), problem }
        })?;
        let mut gaussians = gaussians_of(&rows, &self.layout, scene.quantization.step_alpha);
        let Some(sh) = &scene.gaussians.sh else { return Ok(gaussians) };
        let per_channel = scene.gaussians.sh_coefficients;
        for (l, band) in (1..).zip(self.layout.harmonics()) {
            let values = gaussians.values_mut(band).chunks_exact_mut(band.components());
            for (to, row) in values.zip(&rows) {
                let from = &sh[3 * per_channel * row.index..][..3 * per_channel];
                for (k, rgb) in to.as_chunks_mut::<3>().0.iter_mut().enumerate() {
                    let place = |channel: usize| from[channel * per_channel + l * l - 1 + k];
                    *rgb = [0, 1, 2].map(|channel| sh_coefficient(place(channel)) as f32);
                }
            }
        }
        Ok(gaussians)
    }
}

/// A Gaussian as the file has it at one time.
pub(super) struct Row {
    /// In the file.
    pub index: usize,
    pub mean: [f32; 3],
    /// `x, y, z, w`
    pub rotation: [f32; 4],
    pub scale: [f32; 3],
    pub color: [f32; 3],
    pub opacity: f64,
}

/// Gaussians in stored form and in the axes of the file; harmonics are zero.
///
/// - `step_alpha`: between opacities
pub(super) fn gaussians_of(rows: &[Row], layout: &Arc<Layout>, step_alpha: f64) -> Gaussians {
    let mut gaussians = Gaussians::zeros_of(layout, rows.len());
    let nearest = [(step_alpha / 4.0).clamp(2.0_f64.powi(-25), 0.1); 2];
    let base = gaussians.views_mut();
    for (i, row) in rows.iter().enumerate() {
        base.means[i] = row.mean;
        let [x, y, z, w] = row.rotation;
        base.quats[i] = [w, x, y, z];
        base.log_scales[i] = row.scale.map(f32::ln);
        base.logit_opacities[i] = logit(row.opacity.clamp(0.0, 1.0), nearest);
        base.colors[i] = row.color;
    }
    gaussians
}

/// Length of a timestep, from the windows of a file, seconds.
///
/// Borders of windows are floats, so lengths err by more the later they are; the errors of neighbours cancel in the
/// mean.
fn frame_secs(windows: &[(f64, f64)]) -> f64 {
    let lengths = || windows.iter().map(|(from, to)| to - from).filter(|length| *length > 0.0);
    let shortest = lengths().fold(f64::INFINITY, f64::min);
    if shortest > LONGEST_FRAME_SECS {
        return 1.0 / USUAL_RATE;
    }
    let frames = lengths().filter(|length| *length <= 1.5 * shortest);
    let (sum, count) = frames.fold((0.0, 0.0), |(sum, count), length| (sum + length, count + 1.0));
    sum / count
}

/// Number of Gaussians that live at each time, as [`births`] gives them, without a test of each Gaussian at each time.
///
/// - `times`: ascending
fn living(scene: &::fourdgs::Scene, times: &[f64]) -> Vec<usize> {
    let of = &scene.gaussians;
    // Difference of the number at each time from that at the time before.
    let mut changes = vec![0_i64; times.len() + 1];
    for i in 0..of.count() {
        let (from, until) = (f64::from(of.win_lo[i]), f64::from(of.win_hi[i]));
        // No time lies in a window whose start is NaN.
        let from = times.partition_point(|&t| t < from || from.is_nan());
        let window = &times[from..times.partition_point(|&t| t < until).max(from)];
        let (mu, sigma) = (f64::from(of.mu_t[i]), f64::from(of.sigma_t[i]));
        // It fades to both sides of its middle; the term is that of the crate.
        let is_visible = |t: f64| {
            let z = (t - mu) / sigma.max(1e-30);
            let share = if sigma.is_finite() { (-0.5 * z * z).exp() } else { 1.0 };
            share.partial_cmp(&scene.header.cutoff) != Some(Ordering::Less)
        };
        let middle = window.partition_point(|&t| t < mu);
        let first = window[..middle].partition_point(|&t| !is_visible(t));
        let last = middle + window[middle..].partition_point(|&t| is_visible(t));
        if last > first {
            changes[from + first] += 1;
            changes[from + last] -= 1;
        }
    }
    let mut alive = 0;
    let sums = changes[..times.len()].iter().map(|change| {
        alive += change;
        alive as usize
    });
    sums.collect()
}

fn births(scene: &::fourdgs::Scene, time: f64) -> Result<Vec<Row>, ::fourdgs::Error> {
    let state = scene.state_at(time)?;
    let of = &scene.gaussians;
    let row = |(i, index): (usize, &u32)| {
        let index = *index as usize;
        Row {
            index,
            mean: std::array::from_fn(|c| state.centers[3 * i + c]),
            rotation: std::array::from_fn(|c| state.orientations[4 * i + c]),
            scale: std::array::from_fn(|c| of.scales[3 * index + c]),
            color: std::array::from_fn(|c| of.colors[4 * index + c]),
            opacity: f64::from(state.opacity[i]),
        }
    };
    Ok(state.indices.iter().enumerate().map(row).collect())
}

impl SceneReader for FourdgsFile {
    type Error = InterchangeError;

    fn layout(&self) -> &Arc<Layout> {
        &self.layout
    }

    fn num_gaussians_at(&self, timestep: usize) -> usize {
        self.numbers[timestep]
    }

    fn num_timesteps(&self) -> usize {
        self.times.len()
    }

    fn at(&mut self, timestep: usize) -> Result<Gaussians, InterchangeError> {
        Self::at(self, timestep)
    }
}
