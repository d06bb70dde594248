//! A run's settings from the command line.

use std::path::{Path, PathBuf};

use tcgs_capture::Capture;
use tcgs_core::read_text;
use tcgs_pipeline::settings_for;
use tcgs_train::{Preset, TrainConfig};

use super::Arguments;
use crate::error::wrong_input;
use crate::options::{Frames, Pair};
use crate::scene::unreadable;

/// Settings of a new run.
pub fn fresh(arguments: &Arguments, capture: &Capture) -> anyhow::Result<TrainConfig> {
    let config = settings_for(arguments.preset.map_or(Preset::Default, Preset::from), capture);
    let config = apply(arguments, capture, config)?;
    check_frames(capture, &config)?;
    Ok(config)
}

/// Settings of a resumed run: the stored ones, overridden by the command line.
pub fn resumed(arguments: &Arguments, capture: &Capture, stored: &TrainConfig) -> anyhow::Result<TrainConfig> {
    let mut base = stored.clone();
    if let Some(preset) = arguments.preset {
        base.preset = preset.into();
    }
    let config = apply(arguments, capture, base)?;
    check_frames(capture, &config)?;
    Ok(config)
}

/// Applies the settings of the command line to `base`.
fn apply(arguments: &Arguments, capture: &Capture, mut base: TrainConfig) -> anyhow::Result<TrainConfig> {
    if let Some(path) = &arguments.config {
        let text = read_text(path, TrainConfig::MAX_BYTES)
            .map_err(|error| unreadable(path, error, "settings as in a run's config.toml"))?;
        base = base.merge(&text).map_err(|error| wrong_input(format!("{}: {error}", path.display())))?;
    }
    // A --config file may be another run's; the capture is always that of the command line.
    let folder = absolute(&arguments.capture)?;
    base.data.capture.clone_from(&folder);
    base.data.layout = capture.kind().name.into();
    if let Some(points) = &arguments.points {
        base.data.points = absolute(points)?;
    }
    // A --config file may come from a run that was itself a chapter.
    base.data.start_from = match &arguments.start_from {
        Some(start) => {
            let (path, timestep) = scene_and_timestep(start)?;
            let timestep = timestep.map(|timestep| format!("@{timestep}")).unwrap_or_default();
            format!("{}{timestep}", absolute(&path)?)
        }
        None if arguments.resume => base.data.start_from,
        None => String::new(),
    };
    let start_from = base.data.start_from.clone();
    for setting in &arguments.set {
        let Some((key, value)) = setting.split_once('=') else {
            return Err(wrong_input(format!("--set {setting}: no =, expected KEY=VALUE such as weights.rigid=2")));
        };
        base.set(key.trim(), value.trim()).map_err(|error| wrong_input(format!("--set {setting}: {error}")))?;
    }
    if (&base.data.capture, base.data.layout.as_str()) != (&folder, capture.kind().name) {
        return Err(wrong_input("--set data.capture or data.layout: is what CAPTURE says, expected no other"));
    }
    if base.data.start_from != start_from {
        return Err(wrong_input("--set data.start_from: is what --start-from says, expected no other"));
    }
    if arguments.no_mask {
        base.mask.enabled = false;
    }
    if arguments.no_quantize {
        base.quantize.enabled = false;
    }
    if let Some(Pair(min, max)) = arguments.bits {
        let q = &mut base.quantize;
        (q.min_bits, q.max_bits) = (min, max);
        // A mean outside the range would give every parameter the same bits.
        if !(f32::from(min)..=f32::from(max)).contains(&q.mean_bits) {
            q.mean_bits = (f32::from(min) + f32::from(max)) / 2.0;
        }
    }
    if let Some(Frames(frames)) = &arguments.frames {
        (base.data.first_frame, base.data.end_frame) = (frames.start, frames.end);
    }
    if !arguments.hold_out.is_empty() {
        base.data.hold_out.clone_from(&arguments.hold_out);
    }
    if let Some(downscale) = arguments.downscale {
        base.data.downscale = downscale;
    }
    if let Some(Pair(first, rest)) = arguments.iterations {
        (base.schedule.first_iterations, base.schedule.rest_iterations) = (first, rest);
    }
    if let Some(seed) = arguments.job.seed {
        base.seed = seed;
    }
    base.check().map_err(|error| wrong_input(error.to_string()))?;
    Ok(base)
}

/// Splits `SCENE@T` into scene and timestep; `SCENE` alone has no timestep.
pub fn scene_and_timestep(start: &str) -> anyhow::Result<(PathBuf, Option<usize>)> {
    // A file name may contain an @.
    if Path::new(start).exists() {
        return Ok((start.into(), None));
    }
    let parsed =
        start.rsplit_once('@').and_then(|(scene, timestep)| Some((scene.into(), Some(timestep.parse().ok()?))));
    parsed.ok_or_else(|| {
        wrong_input(format!("--start-from {start}: no such scene, expected one, or SCENE@T with its timestep T"))
    })
}

/// An absolute path, so that a run finds its capture and points from any working directory.
fn absolute(path: &Path) -> anyhow::Result<String> {
    let path = path.canonicalize().map_err(|error| wrong_input(format!("{}: {error}", path.display())))?;
    path.into_os_string().into_string().map_err(|path| {
        wrong_input(format!("{}: not a name in UTF-8, expected one that config.toml can hold", path.display()))
    })
}

fn check_frames(capture: &Capture, config: &TrainConfig) -> anyhow::Result<()> {
    let (first, end, has) = (config.data.first_frame, config.data.end_frame, capture.num_frames());
    if first >= end || end > has {
        let path = &config.data.capture;
        return Err(wrong_input(format!("{path}: has the frames 0..{has}, found --frames {first}..{end}")));
    }
    Ok(())
}
