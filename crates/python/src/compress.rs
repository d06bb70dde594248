//! `tcgs.compress`.

use std::collections::BTreeMap;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::time::Duration;

use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use tcgs_capture::Split;
use tcgs_pipeline::{
    Allowance, Backend, CompressOptions, CompressPreset, Judge, JudgeImages, OpenScene, OpenSettings, PipelineError,
    PrunedScene, QUALITY_RANGE, RefineBudget, RefineOptions, Target, capture_kind_of, refine, refine_within, search,
    search_errors, settings_of, tune,
};
use tcgs_train::RefineConfig;

use crate::capture::CaptureLike;
use crate::errors::exception;
use crate::numbers::{Number, Whole};
use crate::save::{check_out, write, wrong};
use crate::scene::{PyScene, SceneLike, check_segment_length};
use crate::watch::Watch;

/// `off`, iterations as a whole number, or a time as a `datetime.timedelta`.
#[derive(FromPyObject)]
pub enum Budget {
    Word(String),
    Iterations(Whole),
    Time(Duration),
}

impl Budget {
    /// None for `off`.
    fn check(self) -> PyResult<Option<RefineBudget>> {
        Ok(Some(match self {
            Self::Iterations(count) => RefineBudget::Iterations(count.within("refine", 1..=u32::MAX as usize)?),
            Self::Time(time) => RefineBudget::Time(time),
            Self::Word(word) if word == "off" => return Ok(None),
            Self::Word(word) => {
                let problem =
                    format!("refine: is {word:?}, expected \"off\", a number of iterations or a datetime.timedelta");
                return Err(PyValueError::new_err(problem));
            }
        }))
    }
}

/// Compresses a scene into a .tcgs file.
///
/// - source: a Scene, a dict of arrays (`Scene.from_arrays`), or any name that `open` accepts
/// - out: file to write
/// - quality: -6 to 8; 1 more about halves the errors and takes a fourth to a third more bytes. None chooses, for a
///   file that is refined, the one at which rounding adds about 15 % to the squared error of training images; else 0
/// - target_bytes: choose the best quality whose file has at most this many bytes
/// - target_psnr: choose the smallest file of at least this mean PSNR in dB, on test images of `capture`, else on
///   renders of `source`
/// - max_error: bounds on the largest errors over all Gaussians and timesteps, by attribute: means in scene units,
///   quats in radians, log_scales as stored, logit_opacities as opacity, colors of 1
/// - refine: train the stored values on the training images of `capture`, or of the run's: a number of iterations, a
///   datetime.timedelta, or "off". None uses the run's iterations where there are images, but not with a target,
///   `tune`, `max_error` or preset "paper"
/// - tune: fit the settings to the scene; takes some 100 compressions
/// - min_share: leave out Gaussians whose share of the pixels of all training images together is below this at every
///   timestep; the default is 1e-6 for a file that is refined, else 0
/// - capture: a Capture or the name of its folder; its cameras determine the sensitivity of each parameter
/// - preset: "default" or "paper"
/// - segment_length: timesteps of a segment, which decodes alone
/// - overwrite: replace `out`
/// - backend, device, progress, callback: as for `train`
///
/// Returns the Scene of the file.
///
/// Raises ValueError or OSError if an input is wrong or a target cannot be reached, FileExistsError if `out` exists.
/// No partial file is left.
#[pyfunction]
#[pyo3(signature = (source, out, *, quality = None, target_bytes = None, target_psnr = None, max_error = None,
    refine = None, tune = false, min_share = None, capture = None, preset = "default", segment_length = None, overwrite = false,
    backend = "auto", device = None, progress = true, callback = None))]
#[allow(clippy::too_many_arguments, reason = "keywords of Python")]
pub fn compress(
    py: Python<'_>,
    source: SceneLike,
    out: PathBuf,
    quality: Option<Number>,
    target_bytes: Option<Whole>,
    target_psnr: Option<Number>,
    max_error: Option<BTreeMap<String, Number>>,
    refine: Option<Budget>,
    tune: bool,
    min_share: Option<Number>,
    capture: Option<CaptureLike<'_>>,
    preset: &str,
    segment_length: Option<Whole>,
    overwrite: bool,
    backend: &str,
    device: Option<&str>,
    progress: bool,
    callback: Option<Py<PyAny>>,
) -> PyResult<PyScene> {
    check_out(&out, overwrite)?;
    let preset = match preset {
        "default" => CompressPreset::Default,
        "paper" => CompressPreset::Paper,
        other => return Err(PyValueError::new_err(format!("preset: is {other}, expected default or paper"))),
    };
    let quality = quality.map(check_quality).transpose()?;
    let target_bytes = target_bytes.map(|bytes| bytes.within("target_bytes", 1..=u64::MAX)).transpose()?;
    let target_psnr = target_psnr
        .map(|psnr| psnr.such("target_psnr", "a number from 0 to 100 dB", |psnr| (0.0..=100.0).contains(&psnr)))
        .transpose()?;
    let is_unsaid = refine.is_none();
    let refine = refine.map(Budget::check).transpose()?.flatten();
    let min_share = min_share
        .map(|share| share.such("min_share", "a number from 0 to less than 1", |share| (0.0..1.0).contains(&share)))
        .transpose()?
        .map(|share| share as f32);
    let wanted = Wanted {
        quality,
        target: target_bytes.map(Target::Bytes).or(target_psnr.map(Target::Psnr)),
        max_error: max_error.map(|bounds| bounds.into_iter().map(check_bound).collect()).transpose()?,
        min_share,
        refine,
        is_refined_if_possible: is_unsaid,
        tune,
        capture: capture.as_ref().map(|capture| capture.path().to_path_buf()),
        preset,
        segment_length: segment_length.map(check_segment_length).transpose()?,
    };
    wanted.check(target_bytes.is_some() && target_psnr.is_some())?;
    // Without images, no GPU is needed.
    let scene = source.open(py)?;
    let refining = wanted.refining(&scene).map_err(exception)?;
    let draws = wanted.target.is_some() || refining.is_some() || wanted.tune;
    let backend = crate::backend::backend(py, if draws { backend } else { "cpu" }, device.filter(|_| draws))?;
    let opened = Watch::call(py, callback, progress, |watch| {
        let file = wanted.compress(&scene, refining.as_ref(), &backend, watch)?;
        watch.check()?;
        write(&out, overwrite, |mut to| to.write_all(&file))?;
        OpenScene::open(&out, OpenSettings::default())
    })?;
    Ok(PyScene(opened.into()))
}

fn check_quality(quality: Number) -> PyResult<f32> {
    let expected = format!("a number from {} to {}", QUALITY_RANGE.start(), QUALITY_RANGE.end());
    Ok(quality.such("quality", &expected, |quality| QUALITY_RANGE.contains(&(quality as f32)))? as f32)
}

/// The bound of an attribute.
fn check_bound((attribute, bound): (String, Number)) -> PyResult<(String, f64)> {
    let bound = bound.such(&format!("max_error[{attribute:?}]"), "a number above 0", |bound| bound > 0.0)?;
    Ok((attribute, bound))
}

/// How a scene is to be compressed.
struct Wanted {
    quality: Option<f32>,
    target: Option<Target>,
    max_error: Option<Vec<(String, f64)>>,
    refine: Option<RefineBudget>,
    /// Whether nothing is said of refining.
    is_refined_if_possible: bool,
    tune: bool,
    min_share: Option<f32>,
    capture: Option<PathBuf>,
    preset: CompressPreset,
    segment_length: Option<u32>,
}

impl Wanted {
    /// Refuses arguments that exclude one another.
    fn check(&self, two_targets: bool) -> PyResult<()> {
        let refuse = |message: &str| Err(PyValueError::new_err(message.to_owned()));
        let has_target = self.target.is_some();
        if two_targets {
            return refuse("target_bytes and target_psnr: both given, expected one of the two");
        }
        if self.quality.is_some() && (has_target || self.tune || self.max_error.is_some()) {
            return refuse(
                "quality: is what target_bytes, target_psnr, max_error and tune find, expected it without these",
            );
        }
        if self.max_error.is_some() && (has_target || self.tune || self.refine.is_some()) {
            return refuse("max_error: expected it without target_bytes, target_psnr, tune and refine");
        }
        let is_searched = has_target || self.tune || self.quality.is_some() || self.max_error.is_some();
        if self.preset == CompressPreset::Paper && is_searched {
            return refuse(
                "preset: paper has its own settings, expected default with a quality, target, tune or max_error",
            );
        }
        Ok(())
    }

    /// The bytes of the file.
    fn compress(
        &self,
        scene: &OpenScene,
        refining: Option<&RefineOptions>,
        backend: &Backend,
        watch: &mut Watch,
    ) -> Result<Vec<u8>, PipelineError> {
        if scene.is_compressed() {
            return Err(wrong(&scene.path, "is compressed already", "a scene of floats"));
        }
        let kind = capture_kind_of(scene, self.capture.as_deref())?;
        let (mut keypoints, mapping) = settings_of(self.preset, kind, scene)?;
        keypoints.segment_length = self.segment_length;
        if let Some(quality) = self.quality {
            keypoints = keypoints.with_quality(quality);
        }
        let options = CompressOptions {
            keypoints,
            mapping,
            min_share: self.min_share.unwrap_or(if refining.is_some() { RefineOptions::MIN_SHARE } else { 0.0 }),
            capture: self.capture.clone(),
            ..CompressOptions::default()
        };
        let settings = &options.keypoints;
        let pruned = PrunedScene::new(scene, &options)?;
        watch.check()?;
        let judge = |split| {
            let images = JudgeImages { capture: self.capture.clone(), split, frames: None };
            Judge::new(scene, &images, backend.renderer())
        };
        let split = if self.tune { Split::Train } else { Split::Test };
        let mut settings = settings.clone();
        if self.tune {
            let tuned = tune(&pruned, &settings, self.target, &judge(split)?, watch)?.found;
            if refining.is_none() {
                return Ok(tuned.file);
            }
            settings = tuned.settings;
        }
        let settings = &settings;
        Ok(match (self.target, &self.max_error, refining) {
            (_, Some(bounds), _) => search_errors(&pruned, settings, bounds, watch)?.file,
            (Some(target), _, Some(refining)) => {
                let judge = judge(split)?;
                refine_within(scene, &pruned, settings, target, &judge, refining, backend, watch)?.refined.file
            }
            (Some(target), ..) => search(&pruned, settings, target, &judge(Split::Test)?, watch)?.file,
            (None, _, Some(refining)) => refine(scene, &pruned, settings, refining, backend, watch)?.file,
            (None, _, None) => pruned.compress(settings)?.1,
        })
    }

    /// How the file is refined; none if it is not.
    fn refining(&self, scene: &OpenScene) -> Result<Option<RefineOptions>, PipelineError> {
        let Some(budget) = self.refine else {
            let is_searched = self.target.is_some() || self.tune || self.max_error.is_some();
            let is_asked = self.is_refined_if_possible && !is_searched && self.preset == CompressPreset::Default;
            return Ok(is_asked
                .then(|| RefineOptions::usual(scene, self.capture.as_deref(), self.allowance()).ok())
                .flatten());
        };
        let Some(capture) = self.capture.clone().or_else(|| scene.capture().map(Path::to_path_buf)) else {
            return Err(wrong(&scene.path, "has no capture of its own", "capture with the images to refine on"));
        };
        let (config, allowance) = (RefineConfig::default(), self.allowance());
        Ok(Some(RefineOptions { capture, budget, config, allowance }))
    }

    /// Changes that a refinement may make before it begins. Arguments of the caller stay.
    fn allowance(&self) -> Allowance {
        match self.quality {
            _ if self.preset == CompressPreset::Paper => Allowance::NONE,
            Some(quality) => Allowance::at_quality(quality),
            None if self.target.is_some() || self.tune => Allowance::at_quality(0.0),
            None => Allowance::default(),
        }
    }
}
