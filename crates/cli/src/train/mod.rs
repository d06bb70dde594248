//! `tcgs train`: trains a capture into a run folder.

mod settings;
mod view;

use std::path::PathBuf;

use clap::ValueEnum;
use serde_json::{Value, json};
use tcgs_capture::{Capture, Split};
use tcgs_interchange::{Axes, Existing};
use tcgs_pipeline::{Event, LiveRun, Observer, PipelineError, ReadyRun, RunFolder, capture_for, fit, start_state};
use tcgs_train::{Checkpoint, Preset, Run, TrainConfig, TrainError, Trainer};

use crate::backend::{BackendName, BackendOptions};
use crate::error::{stopped, wrong_input};
use crate::interrupt;
use crate::next;
use crate::options::{self, Frames, JobOptions, Pair};
use crate::output::check_folder;
use crate::scene::{SourceOptions, note_replaced};
use crate::teller::Teller;
use crate::terminal::say;

use self::view::View;

/// Least number of training cameras that must remain after holding one out.
const MIN_TRAINED: usize = 2;

/// Train a dynamic scene on a multi-view capture, one timestep after another
///
/// Writes a run folder: config.toml with everything needed to repeat it, a checkpoint per timestep, and metrics.jsonl.
/// Settings come from the preset, then --config, then --set and the other options.
#[derive(clap::Args)]
#[command(after_help = "\
Example:
  tcgs train my_capture --out my_run --preset fast --frames 0..20
  tcgs train my_capture --out my_run --preset fast --frames 0..40 --resume
  tcgs train my_capture --out my_run --view            prints an address that shows the training in a browser
  tcgs train my_capture --out my_run --view=127.0.0.1:8000

A long capture in chapters, on as many machines; see docs/TRAINING.md:
  tcgs train my_capture --out base --preset fast --frames 0..1
  tcgs train my_capture --out chapter0 --config base/config.toml --frames 0..100 --start-from base@0
  tcgs train my_capture --out chapter1 --config base/config.toml --frames 90..200 --start-from base@0
  tcgs compress chapter0 chapter1 --out scene.tcgs")]
pub struct Arguments {
    /// Folder of the capture: Panoptic Sports, Neural 3D Video, Technicolor, nerfstudio, COLMAP, Middlebury, or the
    /// output of tcgs prepare
    capture: PathBuf,
    /// Folder of the run
    #[arg(long, value_name = "RUN")]
    out: PathBuf,
    /// Settings to start from [default: default]
    #[arg(long)]
    preset: Option<PresetName>,
    /// Settings that differ from the preset's, as in a run's config.toml
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// One setting by its name in config.toml, such as weights.rigid=2; may be repeated
    #[arg(long, value_name = "KEY=VALUE")]
    set: Vec<String>,
    /// Initial points, .npz, .ply or points3D.bin of COLMAP, instead of the capture's own
    #[arg(long, value_name = "FILE")]
    points: Option<PathBuf>,
    /// Continue the state of SCENE at timestep T (default: its last): a run folder, .tcgs, params.npz or a folder of
    /// PLY, SPZ, glTF or SOG. The first timestep is trained as a later one, from there. From a run, masks, quantizers
    /// and, at its last two timesteps, the optimizer's state carry over
    #[arg(long, value_name = "SCENE@T", conflicts_with = "points")]
    start_from: Option<String>,
    /// With --start-from: axes of PLY, SPZ, glTF and .4dgs files, such as rub [default: those that the file declares,
    /// else luf of glTF and rdf of all others]
    #[arg(long, value_name = "XYZ", requires = "start_from")]
    axes: Option<Axes>,
    /// With --start-from: read a file of another program that claims more memory than its length warrants, or over
    /// 65,536 timesteps
    #[arg(long, requires = "start_from")]
    no_limits: bool,
    /// Learn no masks: preset paper does
    #[arg(long)]
    no_mask: bool,
    /// Learn no quantisation
    #[arg(long, conflicts_with = "bits")]
    no_quantize: bool,
    /// Fewest and most bits of a parameter; equal values give all parameters the same
    #[arg(long, value_name = "MIN,MAX", value_parser = options::bits)]
    bits: Option<Pair<u8>>,
    /// Cameras to leave out of the training for evaluation: their names, such as cam03,cam07, or ids. Test cameras of
    /// the capture are then neither trained on nor evaluated
    #[arg(long, value_name = "NAME,...", value_delimiter = ',')]
    hold_out: Vec<String>,
    /// Frames of the capture, from A up to but not including B [default: those that publications use, else all]
    #[arg(long, value_name = "A..B")]
    frames: Option<Frames>,
    /// Average images over N x N pixels [default: 1]
    #[arg(long, value_name = "N", value_parser = options::positive)]
    downscale: Option<usize>,
    /// Iterations of the first and of every later timestep [default: the preset's]
    #[arg(long, value_name = "FIRST,REST", value_parser = options::iterations)]
    iterations: Option<Pair<usize>>,
    /// Continue RUN after its last whole checkpoint; begin it if there is none. Options that are not given keep the
    /// run's settings; only the end of --frames may change
    #[arg(long)]
    resume: bool,
    /// Show the training in a browser of this machine while it runs: the current scene, the finished timesteps, curves
    /// of loss and PSNR, and the progress. Prints the address; without ADDRESS any free port. The trained bits are the
    /// same. After the training it shows the whole run until the page is closed
    #[arg(long, value_name = "ADDRESS", num_args = 0..=1, require_equals = true, default_missing_value = "127.0.0.1:0",
        value_parser = view::port)]
    view: Option<u16>,
    #[command(flatten)]
    backend: BackendOptions,
    #[command(flatten)]
    job: JobOptions,
}

#[derive(Clone, Copy, ValueEnum)]
enum PresetName {
    /// Dynamic 3D Gaussians: no masks, no quantisation
    D3dgs,
    /// The paper's settings; docs/PAPER.md lists the departures
    Paper,
    /// The paper with changes that measured better
    Default,
    /// The default in far fewer iterations
    Fast,
}

impl From<PresetName> for Preset {
    fn from(name: PresetName) -> Self {
        match name {
            PresetName::D3dgs => Self::D3dgs,
            PresetName::Paper => Self::Paper,
            PresetName::Default => Self::Default,
            PresetName::Fast => Self::Fast,
        }
    }
}

/// Runs the command.
pub fn run(arguments: &Arguments) -> anyhow::Result<()> {
    let start = arguments.start_from.as_deref().map(settings::scene_and_timestep).transpose()?;
    let start = start.as_ref().map(|(path, _)| path.as_path());
    let files = [Some(arguments.capture.as_path()), start, arguments.config.as_deref(), arguments.points.as_deref()];
    arguments.job.begin(&[], &files.into_iter().flatten().collect::<Vec<_>>())?;
    if !arguments.resume {
        check_folder(&arguments.out, start.as_slice())?;
    }
    interrupt::politely(|| train(arguments))
}

fn train(arguments: &Arguments) -> anyhow::Result<()> {
    let backend = arguments.backend.open(BackendName::Auto)?;
    let capture = Capture::open(&arguments.capture)?;
    let holds_run = RunFolder::holds_run(&arguments.out)?;
    let goes_on = holds_run && arguments.resume;
    if holds_run && !arguments.resume && !arguments.job.force {
        let problem = "holds a run, expected --resume to go on with it or --force to replace it";
        return Err(wrong_input(format!("{}: {problem}", arguments.out.display())));
    }

    let view = arguments.view.map(View::begin).transpose()?;
    let ready = if goes_on {
        let change = |stored: &TrainConfig| settings::resumed(arguments, &capture, stored);
        let ready =
            Teller::default().watch(|teller| ReadyRun::resume(&arguments.out, change, &capture, &backend, teller))?;
        report_resumption(&ready.run, &ready.trainer)?;
        ready
    } else {
        let existing = if arguments.job.force { Existing::Replace } else { Existing::Keep };
        let config = settings::fresh(arguments, &capture)?;
        let chosen = capture_for(&config, &capture)?;
        say(&describe(&chosen, &config)?)?;
        if let Some(hint) = hold_out_hint(&chosen, &config)? {
            say(&hint)?;
        }
        let start = match &arguments.start_from {
            Some(start) => {
                let reading =
                    SourceOptions { axes: arguments.axes, no_limits: arguments.no_limits, ..SourceOptions::default() };
                Some(open_start(start, reading, &config, &capture)?)
            }
            None => None,
        };
        ReadyRun::begin(&arguments.out, existing, &config, &capture, start.as_ref(), &backend)?
    };
    let ReadyRun { capture, run, mut trainer, folder } = ready;
    let live = view.as_ref().map(|_| LiveRun::new(&run, &capture, &mut trainer)).transpose()?;
    if let Some((view, live)) = view.as_ref().zip(live.clone()) {
        view.show(live);
    }
    let watched = Teller::default().watch(|teller| match live {
        Some(live) => fit(&capture, &run, trainer, &mut |event: &Event| {
            live.hear(event);
            teller.hear(event)
        }),
        None => fit(&capture, &run, trainer, teller),
    });
    let trainer = watched.map_err(|e| with_advice(e, &run))?;
    drop(folder);
    report(arguments, &run, &capture, &trainer)?;
    if let Some(view) = view {
        view.finish();
    }
    Ok(())
}

/// Opens the state that a chapter starts from, and prints a description.
fn open_start(
    start: &str,
    reading: SourceOptions,
    config: &TrainConfig,
    capture: &Capture,
) -> anyhow::Result<Checkpoint> {
    let (path, timestep) = settings::scene_and_timestep(start)?;
    let scene = reading.open(&path)?;
    let timestep = timestep.unwrap_or(scene.num_timesteps() - 1);
    let state = start_state(&scene, timestep, config, capture)?;
    note_replaced(&scene);
    let (path, n) = (path.display(), state.parameters.num_gaussians());
    say(&format!(
        "starting from {path} at timestep {timestep}, frame {}: {n} Gaussians",
        scene.first_frame + timestep
    ))?;
    Ok(state)
}

/// Describes the training data in words.
fn describe(capture: &Capture, config: &TrainConfig) -> anyhow::Result<String> {
    let data = &config.data;
    let cameras = |split| capture.cameras(split, data.first_frame, data.downscale);
    let (train, test) = (cameras(Split::Train)?, capture.camera_names(Split::Test, data.first_frame)?);
    let size = train.first().map_or((0, 0), |(_, camera)| (camera.width, camera.height));
    let held_out = match test.as_slice() {
        [] => "none held out".into(),
        names => format!("held out: {}", names.join(", ")),
    };
    let (first, end) = (data.first_frame, data.end_frame);
    let (count, layout) = (train.len(), capture.kind().name);
    Ok(format!("{layout} capture: {count} cameras ({held_out}), frames {first}..{end}, {}x{} pixels", size.0, size.1))
}

/// Advice to hold out a camera; `None` if the capture holds one out, or has none to spare.
fn hold_out_hint(capture: &Capture, config: &TrainConfig) -> anyhow::Result<Option<String>> {
    let names = |split| capture.camera_names(split, config.data.first_frame);
    let (train, test) = (names(Split::Train)?, names(Split::Test)?);
    let middle = train.get(train.len() / 2).filter(|_| test.is_empty() && train.len() > MIN_TRAINED);
    Ok(middle.map(|name| {
        format!(
            "no camera is held out: PSNR is that of images that are trained on, which flatters; --hold-out {} measures \
             with a camera that is not",
            next::word(name)
        )
    }))
}

/// Adds advice on a run that stopped half-way. Finished timesteps have whole checkpoints after any error.
fn with_advice(error: anyhow::Error, run: &Run) -> anyhow::Error {
    let advice = match error.downcast_ref::<PipelineError>() {
        Some(PipelineError::Stopped) => {
            let (data, finished) = (&run.config().data, run.timesteps());
            let wanted = data.end_frame - data.first_frame;
            return stopped(format!("{finished} of {wanted} timesteps are trained; --resume goes on after them"));
        }
        Some(PipelineError::Train(TrainError::NotFinite { .. })) => {
            "begin again with lower rates, such as --set rates.mean=8e-5"
        }
        Some(PipelineError::Train(TrainError::Write { .. })) => {
            "make room, then --resume goes on after the last whole checkpoint"
        }
        Some(PipelineError::Train(TrainError::Gpu(_))) => {
            "--resume goes on after the last whole checkpoint, with --backend cpu on any computer"
        }
        _ => return error,
    };
    error.context(format!("training stopped; {advice}"))
}

fn report_resumption(run: &Run, trainer: &Trainer) -> anyhow::Result<()> {
    let data = &run.config().data;
    let (finished, wanted) = (trainer.timesteps(), data.end_frame - data.first_frame);
    say(&match finished {
        _ if finished >= wanted => format!("the run is complete: {finished} timesteps are trained"),
        _ => format!("going on after {finished} of {wanted} timesteps"),
    })
}

fn report(arguments: &Arguments, run: &Run, capture: &Capture, trainer: &Trainer) -> anyhow::Result<()> {
    let num_gaussians = trainer.num_gaussians();
    // A line may be missing after a power cut: metrics are written before the checkpoint, but without its guarantees.
    let mut timesteps: Vec<[Value; 2]> = vec![[Value::Null, Value::Null]; trainer.timesteps()];
    for metrics in run.metrics()? {
        let mut metrics = metrics?;
        let timestep = metrics["timestep"].as_u64().and_then(|timestep| timesteps.get_mut(timestep as usize));
        if let Some(of_timestep) = timestep {
            *of_timestep = ["psnr", "seconds"].map(|key| metrics[key].take());
        }
    }
    let of_all = |key: usize| timesteps.iter().filter_map(|t| t[key].as_f64()).collect::<Vec<_>>();
    let (psnr, seconds) = (of_all(0), of_all(1));
    say(&format!(
        "{} timesteps, {num_gaussians} Gaussians, mean PSNR {:.2} dB, {:.1} s of training",
        timesteps.len(),
        psnr.iter().sum::<f64>() / psnr.len() as f64,
        seconds.iter().sum::<f64>()
    ))?;
    next::compress(run, &arguments.capture, capture)?;
    let described =
        |(t, [psnr, seconds]): (usize, &[Value; 2])| json!({ "timestep": t, "psnr": psnr, "seconds": seconds });
    arguments.job.write_json(&json!({
        "run": arguments.out.display().to_string(),
        "num_gaussians": num_gaussians,
        "timesteps": timesteps.iter().enumerate().map(described).collect::<Vec<_>>(),
    }))
}
