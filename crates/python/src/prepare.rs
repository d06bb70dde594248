//! `tcgs.prepare`.

use std::ffi::CString;
use std::path::PathBuf;

use pyo3::exceptions::PyUserWarning;
use pyo3::prelude::*;
use tcgs_pipeline::{FootageOptions, PrepareOptions, WantMasks, prepare as prepare_capture};
use tcgs_prepare::StereoSettings;

use crate::capture::PyCapture;
use crate::numbers::{Number, Whole};
use crate::watch::Watch;

/// Makes a capture that `tcgs.train` reads, of a folder of videos, or of a capture without points: cameras, clocks,
/// masks of what moves, and initial points by multi-view stereo. It then checks the capture.
///
/// - source: folder of videos, one for each camera, perhaps with a calibration, or of a capture of any kind
/// - out: folder of the new capture. A step whose result it holds from an earlier call is skipped
/// - points: approximate maximal number of points
/// - width: images are shrunk to at most this width, pixels, before points are searched
/// - masks: make masks of what moves; default: if the capture has none, and if that is possible
/// - calibration: its file, if it is not in the folder of the videos
/// - scale: names of two cameras and the distance of their lenses in metres, to which all lengths are scaled
/// - refine_calibration: refine the calibration, if that lowers the errors of held-out points
/// - balance_colors: even out exposure and white balance, if held-out points then agree better
/// - offsets: text file with a line NAME SECONDS for each camera, the time of one common event in its video
/// - start, end: seconds after the moment at which all cameras run
/// - every: use every n-th frame
/// - fps: frames per second of folders of images; default: 30
/// - hold_out: names of the cameras that are held out from training; default: every eighth, of fewer than eight none
/// - seed: of random choices
/// - overwrite: replace a capture in `out` that an earlier call made
/// - progress: show a line in a terminal or notebook
/// - callback: called with a Progress instead of the line; an exception in it ends the call
///
/// Returns the Capture. Each finding of the check is a UserWarning.
///
/// Raises ValueError or OSError if an input is wrong, FileExistsError if `out` exists and is not replaced.
#[pyfunction]
#[pyo3(signature = (source, out, *, points = Whole::of(80_000), width = Whole::of(400), masks = None, calibration = None,
    scale = None, refine_calibration = true, balance_colors = true, offsets = None, start = None, end = None,
    every = Whole::of(1), fps = None, hold_out = Vec::new(), seed = Whole::of(0), overwrite = false, progress = true,
    callback = None),
    text_signature = "(source, out, *, points=80000, width=400, masks=None, calibration=None, scale=None, \
    refine_calibration=True, balance_colors=True, offsets=None, start=None, end=None, every=1, fps=None, hold_out=(), \
    seed=0, overwrite=False, progress=True, callback=None)")]
#[allow(clippy::too_many_arguments, reason = "keywords of Python")]
pub fn prepare(
    py: Python<'_>,
    source: PathBuf,
    out: PathBuf,
    points: Whole,
    width: Whole,
    masks: Option<bool>,
    calibration: Option<PathBuf>,
    scale: Option<(String, String, Number)>,
    refine_calibration: bool,
    balance_colors: bool,
    offsets: Option<PathBuf>,
    start: Option<Number>,
    end: Option<Number>,
    every: Whole,
    fps: Option<Number>,
    hold_out: Vec<String>,
    seed: Whole,
    overwrite: bool,
    progress: bool,
    callback: Option<Py<PyAny>>,
) -> PyResult<PyCapture> {
    let secs = |name: &str, secs: Option<Number>| {
        secs.map(|secs| secs.such(name, "seconds, 0 or more", |secs| secs >= 0.0)).transpose()
    };
    let above_0 = |name: &str, number: Number| number.such(name, "a number above 0", |number| number > 0.0);
    let every = every.within("every", 1..=usize::MAX)?;
    let options = PrepareOptions {
        stereo: StereoSettings {
            num_points: points.within("points", 1..=100_000_000)?,
            image_width: width.within("width", 1..=16_384)?,
            seed: seed.within("seed", 0..=u64::MAX)?,
        },
        masks: match masks {
            None => WantMasks::Auto,
            Some(true) => WantMasks::Yes,
            Some(false) => WantMasks::No,
        },
        replace: overwrite,
        dry_run: false,
        footage: FootageOptions {
            calibration,
            scale: scale.map(|(a, b, metres)| Ok::<_, PyErr>(([a, b], above_0("scale", metres)?))).transpose()?,
            refine_calibration,
            balance_colors,
            offsets,
            from_secs: secs("start", start)?,
            to_secs: secs("end", end)?,
            every: (every > 1).then_some(every),
            images_fps: fps.map(|fps| above_0("fps", fps)).transpose()?,
            hold_out,
        },
    };
    let prepared = Watch::call(py, callback, progress, |watch| prepare_capture(&source, &out, &options, watch))?;
    let prepared = prepared.ok_or_else(|| pyo3::exceptions::PyRuntimeError::new_err("nothing was prepared"))?;
    for finding in &prepared.diagnosis.findings {
        PyErr::warn(py, &py.get_type::<PyUserWarning>(), &CString::new(finding.to_string())?, 1)?;
    }
    Ok(PyCapture { capture: prepared.capture, path: out })
}
