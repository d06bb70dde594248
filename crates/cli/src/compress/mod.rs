//! `tcgs compress`: floats become a `.tcgs` file.

mod attachment;
pub mod target;

use std::path::{Path, PathBuf};

use clap::ValueEnum;
use serde_json::{Value, json};
use tcgs_codec::{CompactFile, CompressSettings, FORMAT_VERSION, UpAxis};
use tcgs_pipeline::{
    Allowance, CompressOptions, CompressPreset, Compressed, ErrorTrial, Judge, JudgeImages, Marks, OpenScene,
    PrunedScene, RefineOptions, Refined, Target, capture_kind_of, position_step_remark, refine, refine_within, search,
    search_errors, settings_of, tune,
};
use tcgs_train::{Preset, RefineConfig, Run};

use self::attachment::Attachment;
use crate::attribute_errors::{self, Bounds};
use crate::backend::{BackendName, BackendOptions};
use crate::error::wrong_input;
use crate::interrupt;
use crate::options::{self, Cameras, Frames, JobOptions, Pair, Refining};
use crate::output::{show_bytes, write_file};
use crate::scene::{SourceOptions, describe, note_replaced};
use crate::teller::Teller;
use crate::terminal::{note, say};

/// Compress a trained scene into a .tcgs file
///
/// A run is pruned by its masks and quantised with its learned bits. A scene without learned bits gets them by a
/// measurement: how much do images of the capture's cameras, or of cameras around the scene, depend on each parameter?
///
/// A folder has one file a timestep, in the natural order of their names: PLY of 3D Gaussian splatting, compressed PLY
/// of SuperSplat, SPZ of versions 2 to 4, glTF with KHR_gaussian_splatting, SOG of version 2, .splat or .ksplat, with
/// spherical harmonics or without. Names that are numbers and count up, such as 000012.ply, are frames. Where the
/// number or the order of Gaussians changes from file to file, those that are found again are followed, and the others
/// come and go.
#[derive(clap::Args)]
#[command(group = clap::ArgGroup::new("target").args(["target_bytes", "target_psnr"]))]
#[command(group = clap::ArgGroup::new("measured").args(["target_bytes", "target_psnr", "tune"]).multiple(true))]
#[command(after_help = "\
Example:
  tcgs compress my_run
  tcgs compress my_run --target-bytes 2MB --capture my_capture
  tcgs compress my_run --tune --capture my_capture
  tcgs compress my_run --quality -1 --refine 5m
  tcgs compress my_run --target-psnr 30 --refine 5m --capture my_capture
  tcgs compress params.npz --capture my_capture --bits 4,8 --out small.tcgs
  tcgs compress my_plys --frame-rate 24 --out scene.tcgs
  tcgs compress my_plys --max-error mean=0.001,rotation=0.01,color=0.02
  tcgs compress chapter0 chapter1 chapter2 --out scene.tcgs")]
pub struct Arguments {
    /// Run folder, params.npz of Dynamic 3D Gaussians, .4dgs file, or folder of PLY, SPZ, glTF or SOG files; several
    /// run folders that are chapters of one capture (train --start-from) are joined
    #[arg(required = true)]
    sources: Vec<PathBuf>,
    /// File to write [default: RUN/scene.tcgs, or the name of SOURCE with .tcgs]
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
    #[command(flatten)]
    reading: SourceOptions,
    /// Frames a second that the file tells players [default: the source's, else 30]
    #[arg(long, value_name = "F", value_parser = not_negative, allow_negative_numbers = true)]
    frame_rate: Option<f32>,
    /// Settings to start from [default: paper for a run of preset paper, else default]
    #[arg(long)]
    preset: Option<PresetName>,
    /// Most keypoints of a track, 2 or more [default: 60; paper: 30 for Panoptic Sports, 15 for Technicolor, else 60]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(2..=65536))]
    max_keypoints: Option<u32>,
    /// Mean squared error of a track at which no more keypoints are added [default: positions 2.5e-6 on
    /// Panoptic Sports, else by the scene's extent, rotations 4e-5, scales 1e-4, opacities 1e-3, colours 2e-4; paper:
    /// 1e-5 for Panoptic Sports, else 1e-7]
    #[arg(long, value_name = "MSE", value_parser = not_negative, allow_negative_numbers = true)]
    max_mse: Option<f32>,
    /// Store every timestep
    #[arg(long, conflicts_with_all = ["max_keypoints", "max_mse"])]
    no_keypoints: bool,
    /// Timesteps of a segment, which decodes alone: fewer make seeking faster and the file larger [default: 50; of more
    /// than 60,000 Gaussians as many as decode in a twentieth of a second, at least 8]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=65536))]
    segment_length: Option<u32>,
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
    /// Leave out Gaussians that at every timestep make up less than this share of the pixels of all training images
    /// together [default: of a file that is refined 1e-6, else 0]
    #[arg(long, value_name = "SHARE", value_parser = share, allow_negative_numbers = true)]
    min_share: Option<f32>,
    /// Capture whose training cameras tell how much each parameter matters [default: the run's], and on whose
    /// images a target is measured
    #[arg(long, value_name = "CAPTURE")]
    capture: Option<PathBuf>,
    /// `plain`: print the size in the paper's form, without entropy coding, as a stage of its own; the file is the same
    #[arg(long, default_value = "packed")]
    storage: Storage,
    /// Quality on one curve of settings, -6 to 8, instead of single settings. A quality 1 higher about halves the
    /// errors and takes a fourth to a third more bytes. A refined file has by default the one from -2 to 2 at which
    /// rounding adds about 15 % to the squared error of training images [default: 0]
    #[arg(long, value_name = "Q", value_parser = target::quality, allow_negative_numbers = true)]
    #[arg(conflicts_with_all = SINGLE_SETTINGS)]
    quality: Option<f32>,
    /// Find the best quality whose file has at most so many bytes: 500000, 500k, 2MB (units of 1000), 2MiB (of 1024)
    #[arg(long, value_name = "SIZE", value_parser = options::size)]
    #[arg(conflicts_with_all = SINGLE_SETTINGS, conflicts_with = "quality")]
    target_bytes: Option<u64>,
    /// Find the smallest file of at least this mean PSNR in dB: on test images of --capture, else on renders of
    /// SOURCE
    #[arg(long, value_name = "DB", value_parser = decibels, allow_negative_numbers = true)]
    #[arg(conflicts_with_all = SINGLE_SETTINGS, conflicts_with = "quality")]
    target_psnr: Option<f64>,
    /// Keep the largest error of attributes over all Gaussians and timesteps within bounds: mean in scene units,
    /// rotation in radians, scale of the natural logarithm, opacity and color of 1, sh1 to sh3. Settings get finer
    /// until it is so. The file declares its errors, which takes format 2, and `tcgs verify` checks them
    #[arg(long, value_name = "ATTRIBUTE=ERROR,...")]
    #[arg(conflicts_with_all = SINGLE_SETTINGS, conflicts_with = "target")]
    max_error: Option<Bounds>,
    /// Fit the settings to this scene: the same PSNR in fewer bytes, or of a target the best of all settings. Measured
    /// on training images of --capture, else on renders of SOURCE. Takes some 100 compressions, and tells each
    #[arg(long)]
    #[arg(conflicts_with_all = SINGLE_SETTINGS, conflicts_with = "max_error")]
    tune: bool,
    /// With a target or --tune: cameras of --capture to measure on [default: test; with --tune train]
    #[arg(long, requires = "capture", requires = "measured")]
    cameras: Option<Cameras>,
    /// With a target or --tune: frames to measure on, from A up to but not including B [default: evenly some of the
    /// scene]
    #[arg(long, value_name = "A..B", requires = "measured")]
    frames: Option<Frames>,
    /// Train what the file stores on the training images of --capture, or of the run's capture, for a time (90s, 5m,
    /// 1h) or a number of iterations: more PSNR in about as many bytes. A number of iterations gives the same file
    /// whenever it is repeated; a time is turned into one, which is printed. Ctrl-C ends the training and writes the
    /// file. With a target the refined file meets it, which may take up to four refinements; with --tune the settings
    /// are fitted before. `off` writes the file within seconds [default: by the run's iterations; off without images,
    /// with a target, --tune, --max-error or
    /// --preset paper]
    #[arg(long, value_name = "BUDGET", value_parser = options::refining)]
    #[arg(conflicts_with = "max_error")]
    refine: Option<Refining>,
    /// Axis of the scene that points up, for players: x, y, z, -x, -y or -z [default: the one along
    /// which the capture's cameras stand upright, without a capture unknown]
    #[arg(long, value_name = "AXIS", value_parser = up_axis, allow_hyphen_values = true)]
    up: Option<UpAxis>,
    /// Version of the format: 2, or 1 for older programs, which holds no spherical harmonics, no Gaussians that come
    /// and go, and no declared errors
    #[arg(long, value_name = "VERSION", default_value_t = FORMAT_VERSION)]
    #[arg(value_parser = clap::value_parser!(u16).range(1..=i64::from(FORMAT_VERSION)))]
    format: u16,
    /// Most cameras of --capture or of the run's capture that the file gives players to start from
    #[arg(long, value_name = "N", default_value_t = 8)]
    views: usize,
    /// Put a file's content into the .tcgs file for other programs; may be repeated. NAME is credits, units, light,
    /// paths, labels, sound or times (docs/FORMAT.md), or an application's own name
    #[arg(long, value_name = "NAME=FILE")]
    attach: Vec<Attachment>,
    /// Keep in the file which Gaussians are foreground. A run knows it from the masks of its capture, a params.npz from
    /// its seg_colors. The file stores it as labels (docs/FORMAT.md), and tcgs export writes it into a params.npz
    #[arg(long)]
    keep_foreground: bool,
    #[command(flatten)]
    backend: BackendOptions,
    #[command(flatten)]
    job: JobOptions,
}

/// Options that a quality stands for.
const SINGLE_SETTINGS: [&str; 5] = ["max_keypoints", "max_mse", "no_keypoints", "bits", "position_bits"];

#[derive(Clone, Copy, PartialEq, Eq, ValueEnum)]
enum PresetName {
    /// The paper's: linear bits, two keypoints at least
    Paper,
    /// What measured better
    Default,
}

impl From<PresetName> for CompressPreset {
    fn from(name: PresetName) -> Self {
        match name {
            PresetName::Paper => Self::Paper,
            PresetName::Default => Self::Default,
        }
    }
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

fn decibels(text: &str) -> Result<f64, String> {
    // Images that are the same have 100 dB.
    let number = text.parse().ok().filter(|x: &f64| (0.0..=100.0).contains(x));
    number.ok_or_else(|| "expected a number from 0 to 100".into())
}

fn up_axis(text: &str) -> Result<UpAxis, String> {
    let axes = [UpAxis::PlusX, UpAxis::PlusY, UpAxis::PlusZ, UpAxis::MinusX, UpAxis::MinusY, UpAxis::MinusZ];
    axes.into_iter().find(|axis| axis.name() == text).ok_or_else(|| "expected x, y, z, -x, -y or -z".into())
}

fn share(text: &str) -> Result<f32, String> {
    not_negative(text).ok().filter(|&x| x < 1.0).ok_or_else(|| "expected a number from 0 to 1".into())
}

/// Runs the command.
pub fn run(arguments: &Arguments) -> anyhow::Result<()> {
    let is_searched = arguments.is_searched() || arguments.quality.is_some();
    if arguments.preset == Some(PresetName::Paper) && is_searched {
        let problem = "has its own settings, expected --preset default with --quality, --target-bytes, --target-psnr, --max-error or --tune";
        return Err(wrong_input(format!("--preset paper: {problem}")));
    }
    if arguments.format == 1 && arguments.max_error.is_some() {
        return Err(wrong_input("--format 1: declares no errors, expected --format 2 with --max-error"));
    }
    let out = match (&arguments.out, &arguments.sources[..]) {
        (Some(out), _) => out.clone(),
        (None, [source]) => default_out(source),
        (None, _) => return Err(wrong_input("compress: several sources, expected --out with the file to write")),
    };
    let read = arguments.sources.iter().chain(&arguments.capture).map(PathBuf::as_path);
    let read: Vec<&Path> = read.chain(arguments.attach.iter().map(Attachment::path)).collect();
    arguments.job.begin(&[&out], &read)?;
    let scenes = arguments.sources.iter().map(|source| arguments.reading.open(source));
    let mut scene = OpenScene::join(scenes.collect::<Result<_, _>>()?, arguments.segment_length)?;
    if let Some(frame_rate) = arguments.frame_rate {
        scene.frame_rate = f64::from(frame_rate);
    }
    check_source(arguments, &scene)?;
    say(&describe(&scene))?;

    let refining = refining(arguments, &scene)?;
    let options = options(arguments, &scene, refining.is_some())?;
    let pruned = PrunedScene::new(&scene, &options)?;
    say(&pruned.bits_from)?;
    if arguments.keep_foreground && !pruned.has_marks() {
        note(&format!("{}: no Gaussian is marked as background, so the file gets no marks", scene.path.display()));
    }
    let (compact, file, results) = compress(arguments, &scene, &pruned, &options.keypoints, refining.as_ref())?;
    let compressed = pruned.account(&options, compact, file)?;
    if let Some((step, radius)) = position_step_remark(&scene, &compressed.compact)? {
        say(&format!(
            "positions are rounded to {step:.2e}, and most of the scene lies within {radius:.2e} of its middle: \
             some Gaussians are far away"
        ))?;
    }
    write_file(&out, &compressed.file, arguments.job.force)?;
    note_replaced(&scene);
    report(arguments, &compressed, results, &out)
}

impl Arguments {
    fn target(&self) -> Option<Target> {
        self.target_bytes.map(Target::Bytes).or(self.target_psnr.map(Target::Psnr))
    }

    /// Whether settings are chosen by what comes of them.
    fn is_searched(&self) -> bool {
        self.target().is_some() || self.max_error.is_some() || self.tune
    }

    /// Changes that a refinement may make before it begins. Settings of the command line stay.
    fn allowance(&self, scene: &OpenScene) -> Allowance {
        let is_set = self.no_keypoints
            || self.max_keypoints.is_some()
            || self.max_mse.is_some()
            || self.bits.is_some()
            || self.position_bits.is_some();
        match self.quality {
            _ if self.preset(scene) == CompressPreset::Paper => Allowance::NONE,
            Some(quality) => Allowance::at_quality(quality),
            None if is_set || self.is_searched() => Allowance::at_quality(0.0),
            None => Allowance::default(),
        }
    }

    fn preset(&self, scene: &OpenScene) -> CompressPreset {
        let of_run = || {
            let is_paper = scene.run().is_some_and(|run| run.config().preset == Preset::Paper);
            let is_free = self.quality.is_none() && !self.is_searched();
            if is_paper && is_free { PresetName::Paper } else { PresetName::Default }
        };
        self.preset.unwrap_or_else(of_run).into()
    }
}

/// Compresses as the command line asks: fits the settings to the scene, then meets a target, bounds errors or refines.
///
/// - `settings`: to start from
/// - `refining`: none if the file is not refined
/// - returns: the scene as symbols, the file, and what was found on the way
fn compress(
    arguments: &Arguments,
    scene: &OpenScene,
    pruned: &PrunedScene<'_>,
    settings: &CompressSettings,
    refining: Option<&RefineOptions>,
) -> anyhow::Result<(CompactFile, Vec<u8>, Vec<Found>)> {
    let target = arguments.target();
    let judge = (target.is_some() || arguments.tune).then(|| judge(arguments, scene)).transpose()?;
    if let Some(judge) = &judge {
        say(&format!("measuring against {}", judge.of))?;
    }
    let (mut settings, mut results) = (settings.clone(), Vec::new());
    if let Some(judge) = judge.as_ref().filter(|_| arguments.tune) {
        say("setting                       size       PSNR    saved")?;
        let tuned = Teller::default().watch(|teller| tune(pruned, &settings, target, judge, teller))?;
        let (text, value) = target::describe_tuning(&tuned, target, judge);
        results.push(Found { text, name: "tuning", value });
        if refining.is_none() {
            return Ok((tuned.found.compact, tuned.found.file, results));
        }
        settings = tuned.found.settings;
    }
    if let Some(Bounds(bounds)) = &arguments.max_error {
        say("       size  largest errors")?;
        let found = Teller::default().watch(|teller| search_errors(pruned, &settings, bounds, teller))?;
        results.push(describe_search(bounds, &found.trials));
        return Ok((found.compact, found.file, results));
    }
    Ok(match (target.zip(judge), refining) {
        (None, None) => {
            let (compact, file) = pruned.compress(&settings)?;
            (compact, file, results)
        }
        (None, Some(refining)) => {
            let backend = arguments.backend.open(BackendName::Auto)?;
            let refined = interrupt::politely(|| {
                Teller::default().watch(|teller| refine(scene, pruned, &settings, refining, &backend, teller))
            })?;
            results.push(describe_refining(&refined, None));
            (refined.compact, refined.file, results)
        }
        (Some((target, judge)), None) => {
            say("quality         size      PSNR")?;
            let found = Teller::default().watch(|teller| search(pruned, &settings, target, &judge, teller))?;
            let (text, value) = target::describe(&found, target, &judge);
            results.push(Found { text, name: "target", value });
            (found.compact, found.file, results)
        }
        (Some((target, judge)), Some(refining)) => {
            let backend = arguments.backend.open(BackendName::Auto)?;
            say("quality         size      PSNR")?;
            let found = Teller::default()
                .watch(|teller| refine_within(scene, pruned, &settings, target, &judge, refining, &backend, teller))?;
            let (text, value) = target::describe(&found.before, target, &judge);
            results.push(Found { text: format!("before refining: {text}"), name: "target", value });
            results.push(describe_refining(&found.refined, Some(found.psnr)));
            (found.refined.compact, found.refined.file, results)
        }
    })
}

/// The result of a search, in words and for machines.
struct Found {
    text: String,
    /// In the result for machines.
    name: &'static str,
    value: Value,
}

fn describe_search(bounds: &[(String, f64)], trials: &[ErrorTrial]) -> Found {
    let step = |trial: &ErrorTrial| json!({ "bytes": trial.bytes, "errors": attribute_errors::machine_readable(&trial.errors) });
    let value = json!({
        "wanted": attribute_errors::machine_readable(bounds),
        "steps": trials.iter().map(step).collect::<Vec<_>>(),
    });
    Found { text: format!("within the bounds; {} settings tried", trials.len()), name: "max_error", value }
}

/// - `psnr`: afterwards, dB, where it was measured
fn describe_refining(refined: &Refined, psnr: Option<f64>) -> Found {
    let [before, after] = refined.losses;
    let iterations = refined.iterations;
    let measured =
        psnr.map_or(String::new(), |psnr| format!(", {}, {psnr:.2} dB", show_bytes(refined.file.len() as u64)));
    let quality =
        refined.quality.map_or(String::new(), |quality| format!("quality {quality}, chosen by training images; "));
    let text = format!(
        "{quality}refined in {iterations} iterations, which --refine {iterations} repeats{measured}: \
         loss {before:.4} at first, {after:.4} at last"
    );
    let mut value = json!({ "iterations": iterations, "loss_before": before, "loss_after": after });
    if let Some(quality) = refined.quality {
        value["quality"] = json!(quality);
    }
    if let Some(psnr) = psnr {
        value["psnr"] = json!(psnr);
    }
    Found { text, name: "refined", value }
}

/// How the file is refined; none if it is not, which is told where one would expect it.
fn refining(arguments: &Arguments, scene: &OpenScene) -> anyhow::Result<Option<RefineOptions>> {
    let given = arguments.capture.as_deref();
    let allowance = arguments.allowance(scene);
    match arguments.refine {
        Some(Refining::Off) => Ok(None),
        Some(Refining::For(budget)) => {
            let capture = given.or(scene.capture()).ok_or_else(|| {
                let problem = "has no capture of its own, expected --capture with the images to refine on";
                wrong_input(format!("{}: {problem}", scene.path.display()))
            })?;
            Ok(Some(RefineOptions { capture: capture.into(), budget, config: RefineConfig::default(), allowance }))
        }
        None if arguments.is_searched() || arguments.preset(scene) == CompressPreset::Paper => Ok(None),
        None => match RefineOptions::usual(scene, given, allowance) {
            Ok(options) => Ok(Some(options)),
            Err(error) => {
                if given.or(scene.capture()).is_some() {
                    note(&format!("the file is not refined: {error}"));
                }
                Ok(None)
            }
        },
    }
}

fn judge(arguments: &Arguments, scene: &OpenScene) -> anyhow::Result<Judge> {
    let images = JudgeImages {
        capture: arguments.capture.clone(),
        split: arguments.cameras.unwrap_or(if arguments.tune { Cameras::Train } else { Cameras::Test }).split(),
        frames: arguments.frames.as_ref().map(|frames| frames.0.clone()),
    };
    Ok(Judge::new(scene, &images, arguments.backend.open(BackendName::Auto)?.renderer())?)
}

fn default_out(source: &Path) -> PathBuf {
    // A folder of files a timestep holds nothing else.
    if Run::is_run(source) { source.join("scene.tcgs") } else { source.with_extension("tcgs") }
}

fn check_source(arguments: &Arguments, scene: &OpenScene) -> anyhow::Result<()> {
    let source = scene.path.display();
    if scene.is_compressed() {
        let problem =
            "is compressed already, expected a run folder, a params.npz, a .4dgs file, or PLY, SPZ, glTF or SOG files";
        return Err(wrong_input(format!("{source}: {problem}")));
    }
    match scene.run() {
        None if arguments.prune.is_some() => {
            Err(wrong_input(format!("{source}: has no masks to prune by, expected a run folder with --prune")))
        }
        Some(run) if arguments.prune.is_some() && !run.config().mask.enabled => {
            Err(wrong_input(format!("{source}: was trained without masks, expected a run with masks with --prune")))
        }
        _ => Ok(()),
    }
}

/// The options of the command line, over the preset.
///
/// - `is_refined`: whether the file will be
fn options(arguments: &Arguments, scene: &OpenScene, is_refined: bool) -> anyhow::Result<CompressOptions> {
    let (mut keypoints, mapping) =
        settings_of(arguments.preset(scene), capture_kind_of(scene, arguments.capture.as_deref())?, scene)?;
    keypoints.keypoints = !arguments.no_keypoints;
    keypoints.segment_length = arguments.segment_length;
    if arguments.bits.is_some() {
        keypoints.coarser = [0.0; 5];
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
    if let Some(quality) = arguments.quality {
        keypoints = keypoints.with_quality(quality);
    }
    Ok(CompressOptions {
        keypoints,
        mapping,
        bits: arguments.bits.map(|Pair(min, max)| (min, max)),
        position_bits: arguments.position_bits,
        prune: arguments.prune,
        min_share: arguments.min_share.unwrap_or(if is_refined { RefineOptions::MIN_SHARE } else { 0.0 }),
        capture: arguments.capture.clone(),
        plain: arguments.storage == Storage::Plain,
        up: arguments.up,
        version: arguments.format,
        views: arguments.views,
        data: arguments.attach.iter().map(Attachment::read).collect::<Result<_, _>>()?,
        marks: if arguments.keep_foreground { Marks::Keep } else { Marks::Drop },
        ..CompressOptions::default()
    })
}

fn report(arguments: &Arguments, compressed: &Compressed, found: Vec<Found>, out: &Path) -> anyhow::Result<()> {
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
    for ((name, bytes), keypoints) in compressed.bytes_by_attribute.iter().zip(keypoints) {
        say(&format!("{name:<15} {bytes:>11}  {:>9}  {keypoints:>18.2}", show_bytes(*bytes)))?;
    }
    // Without a bound, the largest of millions of errors says nothing about the pictures; `tcgs info` tells it.
    if arguments.max_error.is_some() {
        attribute_errors::print(&compact.declared_errors)?;
    }
    let (before, after) = (compressed.num_gaussians_before, compact.num_identities());
    let size = compressed.file.len() as u64;
    // Those that come and go are more in all than at any time.
    let counts = if after > before {
        format!("{after} Gaussians, at most {before} at a time")
    } else {
        format!("{after} of {before} Gaussians")
    };
    say(&format!(
        "{}: {counts}, {:.2} bits a parameter, {}, {:.1} times smaller",
        out.display(),
        compact.mean_bits(),
        show_bytes(size),
        ratio(size)
    ))?;
    let mut result = json!({
        "out": out.display().to_string(),
        "num_gaussians_before": before,
        "num_gaussians": after,
        "stages": compressed.stages.iter().map(|s| json!({ "name": s.name, "bytes": s.bytes })).collect::<Vec<_>>(),
        "ratio": ratio(size),
    });
    if !compact.declared_errors.is_empty() {
        result["declared_errors"] = attribute_errors::machine_readable(&compact.declared_errors);
    }
    for Found { text, name, value } in found {
        say(&text)?;
        result[name] = value;
    }
    arguments.job.write_json(&result)
}
