//! `tcgs demo`: the whole pipeline on a capture that it synthesises itself.

mod late;
mod page;

use std::fs;
use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::Context;
use serde_json::json;
use tcgs_capture::{Capture, Split, SyntheticSettings, write_synthetic};
use tcgs_codec::CompressSettings;
use tcgs_pipeline::{
    Allowance, Backend, CompressOptions, Compressed, EvaluateSettings, Evaluation, NewFolder, OpenScene, OpenSettings,
    PrunedScene, RefineBudget, RefineOptions, compress_scene, evaluate, fit, kept_gaussians, new_trainer, refine,
};
use tcgs_train::{Preset, RefineConfig, Run, TrainConfig};

use self::late::{LateQuality, LateViews};
use crate::backend::{BackendName, BackendOptions};
use crate::error::wrong_input;
use crate::options::JobOptions;
use crate::output::{self, show_bytes};
use crate::teller::Teller;
use crate::terminal::say;

/// Iterations of the first and of every later timestep: a minute on two cores.
const ITERATIONS: [usize; 2] = [1000, 80];
/// Iterations of the refinement: nearly a minute on two cores.
const REFINE_ITERATIONS: usize = 2500;
/// Marks a folder as made by this command.
const MARKER: &str = ".tcgs-demo";
const MARKER_TEXT: &str = "made by tcgs demo\n";
/// Entries of the folder that the demo writes. All other entries are the user's, and stay when the demo runs again.
const OURS: [&str; 6] = [MARKER, "capture", "run", "scene.tcgs", "frames", "report.html"];

/// Run everything on a small synthetic capture: no data, no GPU, about two minutes on two cores
///
/// Ray-traces moving objects in a room, one of which enters later, trains on the images, compresses, refines the codes
/// on the images of all timesteps, and measures on held-out cameras. The folder then holds capture/, run/, scene.tcgs,
/// frames/ (ground truth beside render) and report.html.
#[derive(clap::Args)]
#[command(mut_arg("backend", |backend| backend.help("Device of the computation [default: cpu; with --device: gpu]")))]
#[command(after_help = "\
Example:
  tcgs demo
  tcgs info tcgs-demo/scene.tcgs
  tcgs render tcgs-demo/scene.tcgs --path orbit --out orbit")]
pub struct Arguments {
    /// Folder to write; one that demo made is replaced, any other is not
    #[arg(long, value_name = "DIR", default_value = "tcgs-demo")]
    out: PathBuf,
    #[command(flatten)]
    backend: BackendOptions,
    #[command(flatten)]
    job: JobOptions,
}

/// A step of the compression, with its quality on the held-out cameras.
struct Measured {
    name: &'static str,
    bytes: u64,
    quality: Quality,
}

#[derive(Clone, Copy)]
struct Quality {
    psnr: f64,
    ssim: f64,
    psnr_foreground: f64,
    late: LateQuality,
}

impl Quality {
    fn of(evaluation: &Evaluation, late: LateQuality) -> Self {
        let mean = |value: Option<f64>| value.unwrap_or(f64::NAN);
        Self {
            psnr: mean(evaluation.mean(|i| Some(i.psnr))),
            ssim: mean(evaluation.mean(|i| Some(i.ssim))),
            psnr_foreground: psnr_foreground(evaluation),
            late,
        }
    }
}

/// PSNR over the pixels of moving objects.
fn psnr_foreground(evaluation: &Evaluation) -> f64 {
    evaluation.mean(|i| i.psnr_foreground).unwrap_or(f64::NAN)
}

/// Contents of the table, the page and the JSON.
struct Outcome {
    /// Stages from the run's floats to the file.
    stages: Vec<Measured>,
    compressed: Compressed,
    uncompressed: Evaluation,
    final_: Evaluation,
    frozen: Evaluation,
    seconds: Vec<(&'static str, f64)>,
}

impl Outcome {
    fn uncompressed_quality(&self) -> Quality {
        self.stages[0].quality
    }

    fn quality(&self) -> Quality {
        self.stages[self.stages.len() - 1].quality
    }

    fn ratio(&self) -> f64 {
        self.stages[0].bytes as f64 / self.compressed.file.len() as f64
    }

    fn seconds_total(&self) -> f64 {
        self.seconds.iter().map(|s| s.1).sum()
    }
}

/// Runs the command.
pub fn run(arguments: &Arguments) -> anyhow::Result<()> {
    arguments.job.begin(&[], &[])?;
    check_place(&arguments.out)?;
    // The demo's default is the CPU: it shows what two cores can do.
    let backend = arguments.backend.open(BackendName::Cpu)?;
    let folder = NewFolder::begin(&arguments.out, true, |_| true)?;
    let begun = folder.path().join(MARKER);
    fs::write(&begun, MARKER_TEXT).with_context(|| format!("writing {}", begun.display()))?;
    let outcome = pipeline(arguments, &backend, folder.path())?;
    output::finish(folder, |name| OURS.iter().all(|ours| name != *ours))?;
    print_table(arguments, &outcome)?;
    write_json(arguments, &outcome)
}

/// Refuses a folder that the demo did not make.
fn check_place(out: &Path) -> anyhow::Result<()> {
    let is_ours = || fs::read(out.join(MARKER)).is_ok_and(|text| text == MARKER_TEXT.as_bytes());
    if !out.exists() || NewFolder::is_empty(out) || is_ours() {
        return Ok(());
    }
    let problem = "exists and was not made by demo, expected a new name or a folder of an earlier demo";
    Err(wrong_input(format!("{}: {problem}", out.display())))
}

fn pipeline(arguments: &Arguments, backend: &Backend, folder: &Path) -> anyhow::Result<Outcome> {
    let renderer = backend.renderer();
    let mut seconds = Vec::new();
    let mut clock = Instant::now();
    let mut lap = |name: &'static str| {
        seconds.push((name, clock.elapsed().as_secs_f64()));
        clock = Instant::now();
    };

    say("1/4  ray-tracing a capture: moving objects in a room")?;
    let settings = SyntheticSettings { seed: arguments.job.seed.unwrap_or(0), ..SyntheticSettings::default() };
    // A failure here is the disk's, not that of an input.
    write_synthetic(&folder.join("capture"), &settings).map_err(|error| anyhow::anyhow!("{error}"))?;
    let capture = Capture::open(&folder.join("capture"))?;
    lap("synthesise");

    say("2/4  training, one timestep after another")?;
    let run = Run::create(&folder.join("run"), &config(arguments, &capture)?)?;
    let trainer = new_trainer(run.config(), &capture, backend)?;
    Teller::default().watch(|teller| fit(&capture, &run, trainer, teller))?;
    lap("train");

    say("3/4  compressing, and refining what the file stores")?;
    let scene = OpenScene::open(run.folder(), OpenSettings::default())?;
    let unrefined = compress_scene(&scene, &compress_options(folder, true))?;
    let quantized = compress_scene(&scene, &compress_options(folder, false))?;
    let compressed = compress_refined(&scene, folder, backend)?;
    let file = folder.join("scene.tcgs");
    fs::write(&file, &compressed.file).with_context(|| format!("writing {}", file.display()))?;
    let decoded = OpenScene::decode(&file, &compressed.file)?;
    lap("compress");

    say("4/4  measuring on the held-out cameras")?;
    let score = |scene: &OpenScene, frozen: bool| {
        let settings = EvaluateSettings { downscale: 1, frozen, ..EvaluateSettings::of(scene, Split::Test) };
        Teller::default().watch(|teller| evaluate(scene, &capture, &settings, &*renderer, teller))
    };
    let late = LateViews::of(&capture, &settings)?;
    let quality = |scene: &OpenScene, evaluation: &Evaluation| {
        late.measure(scene, &*renderer).map(|late| Quality::of(evaluation, late))
    };
    let uncompressed = score(&scene, false)?;
    let final_ = score(&decoded, false)?;
    let frozen = score(&scene, true)?;
    let raw = quality(&scene, &uncompressed)?;
    let mut stages = measure_stages(&scene, unrefined, quantized, raw, |scene| quality(scene, &score(scene, false)?))?;
    let refined = quality(&decoded, &final_)?;
    stages.push(Measured { name: "refined", bytes: compressed.file.len() as u64, quality: refined });
    lap("evaluate");

    let frames = page::write_frames(&decoded, &capture, &*renderer, &folder.join("frames"))?;
    let mut outcome = Outcome { stages, compressed, uncompressed, final_, frozen, seconds: Vec::new() };
    lap("pictures");
    outcome.seconds = seconds;
    let html = page::html(&outcome, &run, frames)?;
    let path = folder.join("report.html");
    fs::write(&path, html).with_context(|| format!("writing {}", path.display()))?;
    Ok(outcome)
}

fn config(arguments: &Arguments, capture: &Capture) -> anyhow::Result<TrainConfig> {
    let mut config = TrainConfig { seed: arguments.job.seed.unwrap_or(0), ..TrainConfig::default() };
    [config.schedule.first_iterations, config.schedule.rest_iterations] = ITERATIONS;
    // With so few iterations density control adds enough Gaussians only with the reset.
    let paper = TrainConfig::preset(Preset::Paper).densify;
    (config.densify.reset, config.densify.prune_large) = (paper.reset, paper.prune_large);
    // Objects that enter later are cloned and split by the same threshold as the rest, for the same quality.
    config.births.gradient_threshold = config.densify.gradient_threshold;
    config.data.end_frame = capture.num_frames();
    config.data.frame_rate = capture.frame_rate();
    // The capture's path after the folder has its final name.
    let out = std::path::absolute(&arguments.out).with_context(|| format!("{}", arguments.out.display()))?;
    config.data.capture = out.join("capture").display().to_string();
    Ok(config)
}

fn compress_options(folder: &Path, keypoints: bool) -> CompressOptions {
    CompressOptions {
        keypoints: CompressSettings { keypoints, ..CompressSettings::default() },
        // The run's config names the final path of the capture, which does not exist yet.
        capture: Some(folder.join("capture")),
        ..CompressOptions::default()
    }
}

/// The file that the demo writes.
fn compress_refined(scene: &OpenScene, folder: &Path, backend: &Backend) -> anyhow::Result<Compressed> {
    let options = CompressOptions { min_share: RefineOptions::MIN_SHARE, ..compress_options(folder, true) };
    let pruned = PrunedScene::new(scene, &options)?;
    let budget = RefineBudget::Iterations(REFINE_ITERATIONS);
    let (config, allowance) = (RefineConfig::default(), Allowance::default());
    let refining = RefineOptions { capture: folder.join("capture"), budget, config, allowance };
    let refined =
        Teller::default().watch(|teller| refine(scene, &pruned, &options.keypoints, &refining, backend, teller))?;
    Ok(pruned.account(&options, refined.compact, refined.file)?)
}

/// Quality after every stage up to the file that is not refined. The stages keypoints and file differ only in bytes:
/// the last step is lossless.
fn measure_stages(
    scene: &OpenScene,
    unrefined: Compressed,
    quantized: Compressed,
    raw: Quality,
    quality: impl Fn(&OpenScene) -> anyhow::Result<Quality>,
) -> anyhow::Result<Vec<Measured>> {
    let pruned = quality(&scene.pruned(&kept_gaussians(scene, None)?)?)?;
    let quantized = quality(&scene.with_symbols(quantized.compact))?;
    let file = quality(&scene.with_symbols(unrefined.compact))?;
    let stages = unrefined.stages.iter().zip([raw, pruned, quantized, file, file]);
    Ok(stages.map(|(stage, quality)| Measured { name: stage.name, bytes: stage.bytes, quality }).collect())
}

fn print_table(arguments: &Arguments, outcome: &Outcome) -> anyhow::Result<()> {
    say("")?;
    say("                                       PSNR on the held-out cameras, dB")?;
    say("stage            size   ratio    SSIM    whole   moving  arrived  uncovered")?;
    let raw = outcome.stages[0].bytes as f64;
    for Measured { name, bytes, quality: Quality { psnr, ssim, psnr_foreground, late } } in &outcome.stages {
        let (size, ratio) = (show_bytes(*bytes), raw / *bytes as f64);
        let LateQuality { arrived, uncovered } = late;
        say(&format!(
            "{name:<10} {size:>10}  {ratio:>6.1}  {ssim:>6.4}  {psnr:>7.2}  {psnr_foreground:>7.2}  {arrived:>7.2}  {uncovered:>9.2}"
        ))?;
    }
    let frozen = psnr_foreground(&outcome.frozen);
    say(&format!("moving, if every timestep shows the first one: {frozen:.2} dB"))?;
    let seconds: Vec<String> = outcome.seconds.iter().map(|(name, s)| format!("{name} {s:.1} s")).collect();
    say(&format!("{}; {:.1} s in all", seconds.join(", "), outcome.seconds_total()))?;
    say(&format!("open {}", arguments.out.join("report.html").display()))
}

fn write_json(arguments: &Arguments, outcome: &Outcome) -> anyhow::Result<()> {
    let at = |name: &str| arguments.out.join(name).display().to_string();
    let quality = outcome.quality();
    let stages: Vec<_> = outcome
        .stages
        .iter()
        .map(|Measured { name, bytes, quality: Quality { psnr, ssim, psnr_foreground, late } }| {
            json!({
                "name": name,
                "bytes": bytes,
                "psnr": psnr,
                "ssim": ssim,
                "psnr_foreground": psnr_foreground,
                "psnr_arrived": late.arrived,
                "psnr_uncovered": late.uncovered,
            })
        })
        .collect();
    let seconds: serde_json::Map<_, _> =
        outcome.seconds.iter().map(|(name, s)| ((*name).to_owned(), json!(s))).collect();
    arguments.job.write_json(&json!({
        "capture": at("capture"),
        "run": at("run"),
        "scene": at("scene.tcgs"),
        "report": at("report.html"),
        "psnr_uncompressed": outcome.uncompressed_quality().psnr,
        "psnr": quality.psnr,
        "psnr_foreground": quality.psnr_foreground,
        "psnr_frozen_foreground": psnr_foreground(&outcome.frozen),
        "psnr_arrived": quality.late.arrived,
        "psnr_uncovered": quality.late.uncovered,
        "ssim": quality.ssim,
        "stages": stages,
        "ratio": outcome.ratio(),
        "seconds": seconds,
        "seconds_total": outcome.seconds_total(),
    }))
}
