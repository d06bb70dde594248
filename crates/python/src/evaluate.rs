//! `tcgs.render` and `tcgs.evaluate`: scenes become images, and images numbers.

use std::path::PathBuf;

use numpy::PyArrayDyn;
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use tcgs_metrics::{Lpips, Protocol};
use tcgs_pipeline::{Backend, EvaluateSettings, PipelineError};
use tcgs_render::RenderSettings;

use crate::arrays::{ArrayLike, array, pixels, triple};
use crate::camera::PyCamera;
use crate::capture::{CaptureLike, check_downscale, split};
use crate::detached::detached;
use crate::errors::exception;
use crate::memory::{reserve_images, reserve_pairs};
use crate::numbers::{Whole, check_pair};
use crate::scene::{PyScene, SceneLike};
use crate::watch::Watch;

/// Renders one timestep of a scene; of a run without the Gaussians that its masks leave out.
///
/// - scene: a Scene
/// - camera: a Camera
/// - timestep: from 0; negative ones count from the end
/// - background: red, green and blue behind everything, sRGB; the scene's own if None
/// - backend: "auto" (the GPU if there is one), "gpu" or "cpu"
/// - device: a part of the name of the GPU to compute on
///
/// Returns [height, width, 3] float32, sRGB, not clamped.
///
/// Raises MemoryError if the image does not fit into memory.
#[pyfunction]
#[pyo3(signature = (scene, camera, timestep = Whole::of(0), *, background = None, backend = "auto", device = None),
    text_signature = "(scene, camera, timestep=0, *, background=None, backend='auto', device=None)")]
#[allow(clippy::too_many_arguments, reason = "keywords of Python")]
pub fn render<'py>(
    py: Python<'py>,
    scene: PyRef<'py, PyScene>,
    camera: PyCamera,
    timestep: Whole,
    background: Option<ArrayLike<'py>>,
    backend: &str,
    device: Option<&str>,
) -> PyResult<Bound<'py, PyArrayDyn<f32>>> {
    let timestep = scene.timestep(timestep.index())?;
    let settings = match background {
        Some(background) => RenderSettings::default().or_background(&triple::<f32>("background", &background)?),
        None => RenderSettings::default(),
    };
    reserve_images(1, [camera.0.width, camera.0.height], 3)?;
    let backend = crate::backend::backend(py, backend, device)?;
    let (scene, PyCamera(camera)) = (&*scene.0, &camera);
    let draw = || -> PyResult<_> {
        let seen = scene.drawn(timestep).map_err(exception)?.seen_by(camera);
        if matches!(*backend, Backend::Cpu) {
            reserve_pairs(&seen, camera)?;
        }
        Ok(pixels(&backend.renderer().draw(&seen, camera, &settings).map_err(exception)?.0.image))
    };
    Ok(array(py, detached(py, draw)?, &[camera.height, camera.width, 3]))
}

/// Renders every camera of a capture at every frame of a scene, and compares with the capture's images.
///
/// - scene: a Scene, a dict of arrays (`Scene.from_arrays`), or the name of what `open` opens
/// - capture: a Capture, or the name of its folder
/// - cameras: "test" (held out from training), "train" or "all"
/// - frames: first frame and the one after the last; all of the scene
/// - downscale: average images over n x n pixels; as the scene was trained
/// - frozen: let the first frame stand for all
/// - protocol: also measure as publications do: "tc3dgs", "4dgs" or "stg"
/// - lpips_weights: file that scripts/fetch_lpips_weights.py makes; LPIPS is left out without it
/// - backend, device, progress, callback: as of `train`
///
/// Returns a dict: means under "psnr" (dB), "psnr_per_channel", "ssim", "ms_ssim", "dssim", "lpips_vgg", "lpips_alex"
/// and "flicker", None where not measured; "bytes", "fps" of rendering; and under "images" the same of every image.
#[pyfunction]
#[pyo3(signature = (scene, capture, *, cameras = "test", frames = None, downscale = None, frozen = false, protocol = None,
    lpips_weights = None, backend = "auto", device = None, progress = true, callback = None))]
#[allow(clippy::too_many_arguments, reason = "keywords of Python")]
pub fn evaluate<'py>(
    py: Python<'py>,
    scene: SceneLike<'py>,
    capture: CaptureLike<'py>,
    cameras: &str,
    frames: Option<(Whole, Whole)>,
    downscale: Option<Whole>,
    frozen: bool,
    protocol: Option<&str>,
    lpips_weights: Option<PathBuf>,
    backend: &str,
    device: Option<&str>,
    progress: bool,
    callback: Option<Py<PyAny>>,
) -> PyResult<Bound<'py, PyAny>> {
    let split = split("cameras", cameras)?;
    let frames = frames.map(|frames| check_pair("frames", frames)).transpose()?;
    let downscale = downscale.map(check_downscale).transpose()?;
    let protocol = protocol.map(protocol_named).transpose()?;
    let backend = crate::backend::backend(py, backend, device)?;
    let folder = capture.path().to_path_buf();
    let (scene, capture) = (scene.open(py)?, capture.open(py)?);
    let text = Watch::call(py, callback, progress, |watch| {
        let lpips = lpips_weights.map(|path| Lpips::read(&path)).transpose()?;
        let wanted = frames.map(|(first, end)| first..end);
        let frames = scene.choose_frames(wanted.as_ref())?;
        let downscale = downscale.unwrap_or(scene.downscale);
        let settings = EvaluateSettings { split, frames, downscale, frozen, lpips: lpips.as_ref(), protocol };
        if capture.cameras(split, settings.frames.start, downscale)?.is_empty() {
            return Err(PipelineError::NoCameras { path: folder, split });
        }
        let evaluation = tcgs_pipeline::evaluate(&scene, &capture, &settings, &*backend.renderer(), watch)?;
        Ok(tcgs_pipeline::evaluation_json(&scene, &evaluation, protocol).to_string())
    })?;
    py.import("json")?.call_method1("loads", (text,))
}

fn protocol_named(name: &str) -> PyResult<Protocol> {
    match name {
        "tc3dgs" => Ok(Protocol::Tc3dgs),
        "4dgs" => Ok(Protocol::FourDgs),
        "stg" => Ok(Protocol::Stg),
        other => Err(PyValueError::new_err(format!("protocol: is {other}, expected tc3dgs, 4dgs or stg"))),
    }
}
