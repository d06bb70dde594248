//! `tcgs eval`: the quality of a scene on the images of a capture.

mod table;

use std::path::{Path, PathBuf};

use clap::ValueEnum;
use tcgs_capture::{Capture, Split};
use tcgs_metrics::{Lpips, Protocol};
use tcgs_pipeline::{EvaluateSettings, Evaluation, PipelineError, evaluate, evaluation_json};

use crate::backend::{BackendName, BackendOptions};
use crate::options::{self, CameraChoice, Frames, JobOptions};
use crate::output::write_file;
use crate::scene::{SceneOptions, describe, describe_trust, note_replaced};
use crate::teller::Teller;
use crate::terminal::{note, say};

/// Environment variable with the file of LPIPS weights, used without `--lpips-weights`; an empty value means none.
const WEIGHTS_VARIABLE: &str = "TCGS_LPIPS_WEIGHTS";

/// Measure the quality of a scene on a capture's images
///
/// Renders every camera at every frame and compares. The defaults of frames and downscale are those of the scene's
/// training.
#[derive(clap::Args)]
#[command(after_help = "\
Example:
  tcgs eval my_run/scene.tcgs --capture my_capture --json quality.json --csv images.csv")]
pub struct Arguments {
    /// .tcgs file, run folder, params.npz, .4dgs file, or PLY, SPZ, glTF or SOG files
    scene: PathBuf,
    #[command(flatten)]
    reading: SceneOptions,
    /// Folder of the capture to compare with
    #[arg(long, value_name = "CAPTURE")]
    capture: PathBuf,
    /// Which cameras: test (held out from training), train, all, or some by their names, such as cam03,cam07
    #[arg(long, default_value = "test", value_name = "CAMERAS")]
    cameras: CameraChoice,
    /// Frames of the capture, from A up to but not including B [default: all of the scene]
    #[arg(long, value_name = "A..B")]
    frames: Option<Frames>,
    /// Average images over N x N pixels [default: as the scene was trained]
    #[arg(long, value_name = "N", value_parser = options::positive)]
    downscale: Option<usize>,
    /// Also compute the metrics of publications that use this protocol, under their names. Colours are then as
    /// recorded, without the gains of capture.toml
    #[arg(long)]
    protocol: Option<ProtocolName>,
    /// Weights of LPIPS, as scripts/fetch_lpips_weights.py makes them [default: the file that TCGS_LPIPS_WEIGHTS names;
    /// without either LPIPS is left out]
    #[arg(long, value_name = "FILE")]
    lpips_weights: Option<PathBuf>,
    /// Also write the metrics of every image to this file
    #[arg(long, value_name = "FILE")]
    csv: Option<PathBuf>,
    #[command(flatten)]
    backend: BackendOptions,
    #[command(flatten)]
    job: JobOptions,
}

/// The table's caption describes each in full.
#[derive(Clone, Copy, PartialEq, Eq, ValueEnum)]
enum ProtocolName {
    /// Temporally Compressed 3D Gaussian Splatting: PSNR of each channel alone, not clamped; LPIPS by VGG
    Tc3dgs,
    /// 4D Gaussian Splatting: 8 bits; MS-SSIM, D-SSIM, LPIPS by both networks
    #[value(name = "4dgs")]
    FourDgs,
    /// Spacetime Gaussians: clamped; LPIPS by AlexNet, a second SSIM
    Stg,
}

impl From<ProtocolName> for Protocol {
    fn from(name: ProtocolName) -> Self {
        match name {
            ProtocolName::Tc3dgs => Self::Tc3dgs,
            ProtocolName::FourDgs => Self::FourDgs,
            ProtocolName::Stg => Self::Stg,
        }
    }
}

/// Runs the command.
pub fn run(arguments: &Arguments) -> anyhow::Result<()> {
    let weights = arguments.lpips_weights.clone();
    let weights =
        weights.or_else(|| std::env::var_os(WEIGHTS_VARIABLE).filter(|name| !name.is_empty()).map(Into::into));
    let csv: Vec<&Path> = arguments.csv.as_deref().into_iter().collect();
    let sources = [Some(arguments.scene.as_path()), Some(&arguments.capture), weights.as_deref()];
    arguments.job.begin(&csv, &sources.into_iter().flatten().collect::<Vec<_>>())?;
    let lpips = weights.as_ref().map(|path| Lpips::read(path)).transpose()?;
    if let Some(path) = &weights {
        note(&format!("measuring LPIPS with {}, which takes most of the time", path.display()));
    }
    let renderer = arguments.backend.open(BackendName::Auto)?.renderer();
    let (capture, split) = arguments.cameras.choose(Capture::open(&arguments.capture)?)?;
    let scene = arguments.reading.open(&arguments.scene)?;
    let settings = EvaluateSettings {
        split,
        frames: scene.choose_frames(arguments.frames.as_ref().map(|frames| &frames.0))?,
        downscale: arguments.downscale.unwrap_or(scene.downscale),
        frozen: false,
        lpips: lpips.as_ref(),
        protocol: arguments.protocol.map(Protocol::from),
    };
    if capture.cameras(settings.split, settings.frames.start, settings.downscale)?.is_empty() {
        return Err(PipelineError::NoCameras { path: arguments.capture.clone(), split: settings.split }.into());
    }
    let evaluation = Teller::default().watch(|teller| evaluate(&scene, &capture, &settings, &*renderer, teller))?;
    say(&describe(&scene))?;
    if let Some(trust) = scene.trust()? {
        say(&describe_trust(&trust))?;
    }
    say(&table::text(&evaluation, lpips.is_some()))?;
    if let CameraChoice::Split(split @ (Split::Train | Split::All)) = arguments.cameras {
        say(flattery(split))?;
    }
    if let Some(protocol) = settings.protocol {
        say(&protocol.describe())?;
        say(&format!("  {:<10}  {}", "here", here(&arguments.cameras, &capture, &settings, &evaluation)?))?;
        say(&table::protocol_line(protocol, &evaluation))?;
    }
    note_replaced(&scene);
    if let Some(csv) = &arguments.csv {
        write_file(csv, table::csv(&evaluation, settings.protocol).as_bytes(), arguments.job.force)?;
    }
    arguments.job.write_json(&evaluation_json(&scene, &evaluation, settings.protocol))
}

/// A warning about measurements on training cameras.
fn flattery(split: Split) -> &'static str {
    match split {
        Split::Train => {
            "cameras: those that were trained on, which flatters; `tcgs train --hold-out NAME` leaves one out to measure with"
        }
        _ => "cameras: all, also those that were trained on, which flatters",
    }
}

/// Describes this evaluation in the terms of a protocol, for comparison with the protocol's own rules.
fn here(
    chosen: &CameraChoice,
    capture: &Capture,
    settings: &EvaluateSettings,
    evaluation: &Evaluation,
) -> anyhow::Result<String> {
    let cameras = capture.camera_names(settings.split, settings.frames.start)?;
    let held_out = match chosen {
        CameraChoice::Split(Split::Test) => "held out",
        CameraChoice::Split(Split::Train) => "NOT held out: trained on",
        CameraChoice::Split(Split::All) => "NOT held out: all",
        CameraChoice::Named(_) => "chosen by name",
    };
    let (frames, [width, height]) = (&settings.frames, evaluation.size);
    let size = match settings.downscale {
        1 => format!("{width}x{height} as captured"),
        factor => format!("{width}x{height}, averaged over {factor}x{factor} pixels"),
    };
    let of = capture.num_frames();
    let (cameras, [start, end]) = (cameras.join(", "), [frames.start, frames.end]);
    Ok(format!("cameras {cameras} ({held_out}); frames {start}..{end} of {of}; {size}"))
}
