//! `tcgs compress`: floats become a `.tcgs` file.

mod bits;
mod scene;

use std::path::{Path, PathBuf};

use clap::ValueEnum;
use serde_json::json;
use tcgs_capture::{Capture, CaptureKind};
use tcgs_codec::{BitMapping, CompressSettings};
use tcgs_core::Attribute;
use tcgs_train::Run;

use crate::camera_path::extent;
use crate::error::wrong_input;
use crate::options::{self, JobOptions, Pair};
use crate::output::{check_file, say, show_bytes, write_file};
use crate::scene::{Model, Scene, SceneOptions};

pub use scene::{Compressed, Settings, compress_scene, kept_gaussians};

/// Compress a trained scene into a .tcgs file
///
/// A run is pruned by its masks and quantised with its learned bits. Of a scene without them, how much the
/// images depend on each parameter is measured with the capture's cameras, or with cameras around it.
///
/// PLY files are those of 3D Gaussian splatting, one a timestep, in the natural order of their names; their
/// Gaussians keep their number and order. Names that are numbers and count up, such as 000012.ply, are frames.
#[derive(clap::Args)]
#[command(after_help = "\
Example:
  tcgs compress my_run
  tcgs compress params.npz --capture my_capture --bits 4,8 --out small.tcgs
  tcgs compress my_plys --drop-sh --frame-rate 24 --out scene.tcgs")]
pub struct Arguments {
    /// Run folder, params.npz of Dynamic 3D Gaussians, or folder of PLY files
    source: PathBuf,
    /// File to write [default: RUN/scene.tcgs, or the name of SOURCE with .tcgs]
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
    #[command(flatten)]
    reading: SceneOptions,
    /// Frames a second that the file tells players [default: the source's, else 30]
    #[arg(long, value_name = "F", value_parser = not_negative, allow_negative_numbers = true)]
    frame_rate: Option<f32>,
    /// Settings to start from
    #[arg(long, default_value = "default")]
    preset: PresetName,
    /// Most keypoints of a track, 2 or more [default: 60; paper: 30 for Panoptic Sports, 15 for Technicolor, else 60]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(2..=65536))]
    max_keypoints: Option<u32>,
    /// Mean squared error of a track at which no more keypoints are added [default: a run's positions 2.5e-6,
    /// others' by their extent, rotations 4e-5, scales 1e-4, opacities 1e-3, colours 2e-4; paper: 1e-5 for Panoptic Sports, else
    /// 1e-7]
    #[arg(long, value_name = "MSE", value_parser = not_negative, allow_negative_numbers = true)]
    max_mse: Option<f32>,
    /// Store every timestep
    #[arg(long, conflicts_with_all = ["max_keypoints", "max_mse"])]
    no_keypoints: bool,
    /// Fewest and most bits of a parameter, instead of those learned; equal ones give all the same
    /// [default: those learned, else 4,8]
    #[arg(long, value_name = "MIN,MAX", value_parser = options::bits)]
    bits: Option<Pair<u8>>,
    /// Bits of a position's coordinate [default: by the sizes of the scene and its Gaussians; paper: 16]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u8).range(1..=16))]
    position_bits: Option<u8>,
    /// Leave out Gaussians whose mean mask is not above this [default: the run's mask.threshold]
    #[arg(long, value_name = "EPS", value_parser = share, allow_negative_numbers = true)]
    prune: Option<f32>,
    /// Capture whose training cameras tell how much each parameter matters [default: the run's]
    #[arg(long, value_name = "CAPTURE")]
    capture: Option<PathBuf>,
    /// `plain`: also report the size in the paper's form, without entropy coding; the file is the same
    #[arg(long, default_value = "packed")]
    storage: Storage,
    /// Aim at a size (not in this version)
    #[arg(long, value_name = "BYTES", hide = true)]
    target_bytes: Option<String>,
    /// Aim at a quality (not in this version)
    #[arg(long, value_name = "DB", hide = true)]
    target_psnr: Option<String>,
    #[command(flatten)]
    job: JobOptions,
}

/// Error of positions between keypoints, in the scene's radius, where the unit of lengths is not known: in the
/// 2.8 m of Panoptic Sports nearly the 1.6 mm of a run.
const POSITION_TOLERANCE: f32 = 5e-4;
/// Step of positions, in the scene's radius, from which on it is worth a remark: rounding errs as much as the
/// tolerance allows.
const MAX_POSITION_STEP: f32 = 3e-3;

#[derive(Clone, Copy, PartialEq, Eq, ValueEnum)]
enum PresetName {
    /// The paper's: linear bits, two keypoints at least
    Paper,
    /// What measured better
    Default,
}

#[derive(Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Storage {
    /// Entropy-coded
    Packed,
    /// The paper's form
    Plain,
}

fn not_negative(text: &str) -> Result<f32, String> {
    text.parse().ok().filter(|x: &f32| x.is_finite() && *x >= 0.0).ok_or_else(|| "expected a number, 0 or more".into())
}

fn share(text: &str) -> Result<f32, String> {
    not_negative(text).ok().filter(|&x| x < 1.0).ok_or_else(|| "expected a number from 0 to 1".into())
}

/// Runs the command.
pub fn run(arguments: &Arguments) -> anyhow::Result<()> {
    arguments.job.begin()?;
    for (name, value) in [("--target-bytes", &arguments.target_bytes), ("--target-psnr", &arguments.target_psnr)] {
        if let Some(value) = value {
            let problem = "not in this version, expected --bits, --max-mse or --max-keypoints";
            return Err(wrong_input(format!("{name} {value}: {problem}")));
        }
    }
    let out = arguments.out.clone().unwrap_or_else(|| default_out(&arguments.source));
    check_file(&out, arguments.job.force)?;
    let mut scene = Scene::load(&arguments.source, arguments.reading)?;
    if let Some(frame_rate) = arguments.frame_rate {
        scene.frame_rate = f64::from(frame_rate);
    }
    check_source(arguments, &scene)?;
    say(&scene.describe())?;

    let kind = kind(arguments, &scene)?;
    let mut settings = settings(arguments, kind);
    let radius = extent(&scene.at(0)).1 as f32;
    let of_unknown_unit = matches!(scene.model, Model::Floats { .. }) || kind != CaptureKind::Panoptic;
    if of_unknown_unit && arguments.preset == PresetName::Default && arguments.max_mse.is_none() {
        settings.keypoints.max_mse[Attribute::Mean.index()] = (POSITION_TOLERANCE * radius).powi(2);
    }
    let compressed = compress_scene(&scene, &settings)?;
    say(&compressed.bits_from)?;
    let steps = compressed.compact.quantizers.attributes[Attribute::Mean.index()].values().flatten().map(|q| q.step);
    let step = steps.fold(0.0, f32::max);
    if step > MAX_POSITION_STEP * radius {
        say(&format!(
            "positions are rounded to {step:.2e}, and most of the scene lies within {radius:.2e} of its middle: \
             some Gaussians are far away"
        ))?;
    }
    write_file(&out, &compressed.file, arguments.job.force)?;
    report(arguments, &compressed, &out)
}

fn default_out(source: &Path) -> PathBuf {
    // A folder of PLY files holds nothing else.
    if Run::is_run(source) { source.join("scene.tcgs") } else { source.with_extension("tcgs") }
}

fn check_source(arguments: &Arguments, scene: &Scene) -> anyhow::Result<()> {
    let source = scene.path.display();
    match &scene.model {
        Model::Compact(_) => Err(wrong_input(format!(
            "{source}: is compressed already, expected a run folder, a params.npz or PLY files"
        ))),
        Model::Floats { .. } if arguments.prune.is_some() => {
            Err(wrong_input(format!("{source}: has no masks to prune by, expected a run folder with --prune")))
        }
        Model::Run(run) if arguments.prune.is_some() && !run.0.config().mask.enabled => {
            Err(wrong_input(format!("{source}: was trained without masks, expected a run with masks with --prune")))
        }
        _ => Ok(()),
    }
}

/// The layout of what the scene was trained on; where nothing is known, the paper's main one.
fn kind(arguments: &Arguments, scene: &Scene) -> anyhow::Result<CaptureKind> {
    if let Some(capture) = &arguments.capture {
        return Ok(Capture::open(capture)?.kind());
    }
    let of_run = match &scene.model {
        Model::Run(run) => CaptureKind::named(&run.0.config().data.layout),
        _ => None,
    };
    Ok(of_run.unwrap_or(CaptureKind::Panoptic))
}

/// The paper's settings, which differ between its data sets.
fn paper(kind: CaptureKind) -> CompressSettings {
    let (max_keypoints, max_mse) = match kind {
        CaptureKind::Panoptic => (30, 1e-5),
        CaptureKind::Technicolor => (15, 1e-7),
        _ => (60, 1e-7),
    };
    CompressSettings { max_keypoints, max_mse: [max_mse; 5], ..CompressSettings::paper() }
}

fn settings(arguments: &Arguments, kind: CaptureKind) -> Settings {
    let (mut keypoints, mapping) = match arguments.preset {
        PresetName::Paper => (paper(kind), BitMapping::Linear),
        PresetName::Default => (CompressSettings::default(), BitMapping::Log),
    };
    keypoints.keypoints = !arguments.no_keypoints;
    if arguments.bits.is_some() {
        keypoints.coarser = [0; 5];
    }
    if arguments.position_bits.is_some() {
        keypoints.position_fineness = 0.0;
    }
    if let Some(max_keypoints) = arguments.max_keypoints {
        keypoints.max_keypoints = max_keypoints as usize;
    }
    if let Some(max_mse) = arguments.max_mse {
        keypoints.max_mse = [max_mse; 5];
    }
    Settings {
        keypoints,
        mapping,
        bits: arguments.bits.map(|Pair(min, max)| (min, max)),
        position_bits: arguments.position_bits,
        prune: arguments.prune,
        capture: arguments.capture.clone(),
        plain: arguments.storage == Storage::Plain,
    }
}

fn report(arguments: &Arguments, compressed: &Compressed, out: &Path) -> anyhow::Result<()> {
    let raw = compressed.stages[0].bytes;
    let ratio = |bytes: u64| raw as f64 / bytes as f64;
    say(&format!("{:<15} {:>11}  {:>9}  {:>8}", "stage", "bytes", "", "ratio"))?;
    for stage in &compressed.stages {
        let (name, bytes) = (stage.name, stage.bytes);
        say(&format!("{name:<15} {bytes:>11}  {:>9}  {:>8.1}", show_bytes(bytes), ratio(bytes)))?;
    }
    let compact = &compressed.compact;
    let keypoints = compact.keypoints_mean();
    say(&format!("{:<15} {:>11}  {:>9}  {:>18}", "attribute", "bytes", "", "keypoints a track"))?;
    for (attribute, bytes) in Attribute::ALL.into_iter().zip(compressed.bytes_by_attribute) {
        let (name, keypoints) = (attribute.name(), keypoints[attribute.index()]);
        say(&format!("{name:<15} {bytes:>11}  {:>9}  {keypoints:>18.2}", show_bytes(bytes)))?;
    }
    let (before, after) = (compressed.num_gaussians_before, compact.num_gaussians());
    let size = compressed.file.len() as u64;
    say(&format!(
        "{}: {after} of {before} Gaussians, {:.2} bits a parameter, {}, {:.1} times smaller",
        out.display(),
        compact.bit_map.mean_bits(),
        show_bytes(size),
        ratio(size)
    ))?;
    arguments.job.write_json(&json!({
        "out": out.display().to_string(),
        "num_gaussians_before": before,
        "num_gaussians": after,
        "stages": compressed.stages.iter().map(|s| json!({ "name": s.name, "bytes": s.bytes })).collect::<Vec<_>>(),
        "ratio": ratio(size),
    }))
}
