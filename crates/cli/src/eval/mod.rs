//! `tcgs eval`: how close a scene comes to the images of a capture.

mod measure;
mod table;

use std::path::PathBuf;

use clap::ValueEnum;
use tcgs_capture::{Capture, Split};

use crate::backend::{BackendName, BackendOptions};
use crate::error::wrong_input;
use crate::options::{self, Frames, JobOptions};
use crate::output::{check_file, say, write_file};
use crate::scene::{Scene, SceneOptions};

pub use measure::{Evaluation, ImageScore, Settings, evaluate, mean};

/// Measure the quality of a scene on a capture's images
///
/// Renders every camera at every frame and compares. The defaults for frames and downscale are those that
/// the scene was trained with.
#[derive(clap::Args)]
#[command(after_help = "\
Example:
  tcgs eval my_run/scene.tcgs --capture my_capture --json quality.json --csv images.csv")]
pub struct Arguments {
    /// .tcgs file, run folder, params.npz or folder of PLY files
    scene: PathBuf,
    #[command(flatten)]
    reading: SceneOptions,
    /// Folder of the capture to compare with
    #[arg(long, value_name = "CAPTURE")]
    capture: PathBuf,
    /// Which cameras
    #[arg(long, default_value = "test")]
    cameras: Cameras,
    /// Frames of the capture, from A up to but not including B [default: all of the scene]
    #[arg(long, value_name = "A..B")]
    frames: Option<Frames>,
    /// Average images over N x N pixels [default: as the scene was trained]
    #[arg(long, value_name = "N", value_parser = options::positive)]
    downscale: Option<usize>,
    /// Also report what publications that evaluate this way call their metrics
    #[arg(long)]
    protocol: Option<Protocol>,
    /// Also write the metrics of every image to this file
    #[arg(long, value_name = "FILE")]
    csv: Option<PathBuf>,
    #[command(flatten)]
    backend: BackendOptions,
    #[command(flatten)]
    job: JobOptions,
}

/// Cameras of a capture.
#[derive(Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Cameras {
    /// Those held out from training
    Test,
    /// Those trained on
    Train,
    /// Both
    All,
}

impl Cameras {
    /// The same for a capture.
    pub fn split(self) -> Split {
        match self {
            Self::Test => Split::Test,
            Self::Train => Split::Train,
            Self::All => Split::All,
        }
    }
}

/// A named way to evaluate.
#[derive(Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Protocol {
    /// Temporally Compressed 3D Gaussian Splatting: PSNR of each channel alone, not clamped
    Tc3dgs,
    /// 4D Gaussian Splatting (not in this version)
    #[value(name = "4dgs")]
    FourDgs,
    /// Spacetime Gaussians (not in this version)
    Stg,
}

/// Runs the command.
pub fn run(arguments: &Arguments) -> anyhow::Result<()> {
    arguments.job.begin()?;
    if let Some(protocol) = arguments.protocol.filter(|&p| p != Protocol::Tc3dgs) {
        let name = protocol.to_possible_value().map(|v| v.get_name().to_owned()).unwrap_or_default();
        return Err(wrong_input(format!("--protocol {name}: not in this version, expected tc3dgs")));
    }
    if let Some(csv) = &arguments.csv {
        check_file(csv, arguments.job.force)?;
    }
    let renderer = arguments.backend.open(BackendName::Auto)?.renderer();
    let capture = Capture::open(&arguments.capture)?;
    let scene = Scene::load(&arguments.scene, arguments.reading)?;
    let settings = Settings {
        split: arguments.cameras.split(),
        frames: scene.choose_frames(arguments.frames.as_ref().map(|frames| &frames.0))?,
        downscale: arguments.downscale.unwrap_or(scene.downscale),
        frozen: false,
    };
    if capture.cameras(settings.split, settings.frames.start, settings.downscale)?.is_empty() {
        let problem = "has no test cameras, expected one that has, or --cameras train";
        return Err(wrong_input(format!("{}: {problem}", arguments.capture.display())));
    }
    let evaluation = evaluate(&scene, &capture, &settings, &*renderer)?;
    say(&scene.describe())?;
    say(&table::text(&evaluation))?;
    if arguments.protocol.is_some() {
        say(&table::protocol_line(&evaluation))?;
    }
    if let Some(csv) = &arguments.csv {
        write_file(csv, table::csv(&evaluation).as_bytes(), arguments.job.force)?;
    }
    arguments.job.write_json(&table::json(&scene, &evaluation, arguments.protocol.map(|_| "tc3dgs")))
}
