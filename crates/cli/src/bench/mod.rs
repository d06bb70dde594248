//! `tcgs bench`: how fast this computer draws and trains, stage by stage.

mod files;
mod measure;
mod part;
mod scene;
mod table;

use std::path::PathBuf;

use tcgs_capture::Capture;
use tcgs_pipeline::Backend;

use self::measure::{Counts, STEPS, measure};
use crate::backend::{BackendName, BackendOptions};
use crate::options::{self, JobOptions, Size};
use crate::output::check_folder;
use crate::progress::Progress;
use crate::terminal::say;

/// Gaussians of the built-in scene.
const NUM_GAUSSIANS: usize = 300_000;
/// The same on a software GPU: more Gaussians take minutes, and Mesa allows no buffer that holds them.
const NUM_GAUSSIANS_SOFTWARE: usize = 30_000;
/// Image sizes of the built-in scene.
const SIZES: [Size; 2] = [Size { width: 640, height: 360 }, Size { width: 1352, height: 1014 }];
/// Initial mask logit; with it all Gaussians are drawn.
const START_LOGIT: f32 = 1.0;

/// Measure the speed of drawing and training, stage by stage
///
/// Draws a built-in scene of random Gaussians that fill the view; the scene is the same on every computer. Measures
/// drawing three channels (forward), and drawing with the gradient (forward + backward). Measures an iteration of
/// training as in every timestep after the first: colours and segmentation, with masks, quantisation and the losses on
/// motion. Measures an iteration of the first timestep, which has neither quantisation nor losses on motion. Measures
/// an iteration that trains 15 % of the Gaussians in the tiles that these reach, as the gate does.
///
/// Stages are timed by the GPU's own clock where it has one. The last line is the time of an iteration when many follow
/// each other without a timer between them, as in a training.
#[derive(clap::Args)]
#[command(after_help = "\
Example:
  tcgs bench --json bench.json
  tcgs bench --backend cpu --gaussians 50000 --size 320x180
  tcgs bench --capture my_capture --downscale 2
  tcgs bench --size 640x360 --write-scene scene")]
pub struct Arguments {
    /// Gaussians of the built-in scene [default: 300000; 30000 on software that acts as a GPU]
    #[arg(long, value_name = "N", value_parser = options::up_to::<100_000_000>, conflicts_with = "capture")]
    gaussians: Option<usize>,
    /// Sizes of its image, separated by commas [default: 640x360,1352x1014]
    #[arg(long, value_name = "WxH", value_delimiter = ',', conflicts_with = "capture")]
    size: Vec<Size>,
    /// Measure on this capture's points, training cameras and images of the first frame instead
    #[arg(long, value_name = "CAPTURE")]
    capture: Option<PathBuf>,
    /// Average the capture's images over N x N pixels [default: 1]
    #[arg(long, value_name = "N", requires = "capture", value_parser = options::positive)]
    downscale: Option<usize>,
    /// Repetitions of each measurement, after a warm-up [default: 20; 5 on the CPU, 3 on a software GPU]
    #[arg(long, value_name = "N", value_parser = options::up_to::<1_000_000>)]
    iterations: Option<usize>,
    /// Also write the scene, for other renderers to draw: Gaussians (PLY), camera (JSON), image (npz)
    #[arg(long, value_name = "DIR")]
    write_scene: Option<PathBuf>,
    #[command(flatten)]
    backend: BackendOptions,
    #[command(flatten)]
    job: JobOptions,
}

/// Runs the command.
pub fn run(arguments: &Arguments) -> anyhow::Result<()> {
    let sources = arguments.capture.as_deref();
    arguments.job.begin(&[], sources.as_slice())?;
    if let Some(folder) = &arguments.write_scene {
        check_folder(folder, sources.as_slice())?;
    }
    let capture = arguments.capture.as_deref().map(Capture::open).transpose()?;
    let backend = arguments.backend.open(BackendName::Auto)?;
    say(&table::device_line(&backend))?;
    let seed = arguments.job.seed.unwrap_or(0);
    let scenes = match &capture {
        Some(capture) => vec![scene::of_capture(capture, arguments.downscale.unwrap_or(1), seed)?],
        None => {
            let sizes = if arguments.size.is_empty() { &SIZES[..] } else { &arguments.size };
            let default = if is_software(&backend) { NUM_GAUSSIANS_SOFTWARE } else { NUM_GAUSSIANS };
            scene::built_in(arguments.gaussians.unwrap_or(default), sizes, seed)?
        }
    };
    let folder = arguments.write_scene.as_deref();
    let written = folder.map(|folder| files::write(folder, &scenes, &backend, arguments.job.force)).transpose()?;
    let counts = counts(&backend, arguments.iterations);
    let mut progress = Progress::new("measuring", STEPS * scenes.len());
    let mut results = Vec::with_capacity(scenes.len());
    for (i, scene) in scenes.iter().enumerate() {
        let measured = measure(&backend, scene, counts, &mut |part| progress.step(|| part.into()))?;
        progress.say(&table::text(scene, &measured, counts))?;
        results.push(table::scene_json(scene, &measured, counts, written.as_ref().map(|folders| folders[i].as_path())));
    }
    drop(progress);
    arguments.job.write_json(&table::json(&backend, results))
}

fn is_software(backend: &Backend) -> bool {
    backend.gpu_info().is_some_and(|info| info.is_software)
}

/// The requested number of samples. The default takes two CPU cores about two minutes; a GPU takes more samples.
fn counts(backend: &Backend, samples: Option<usize>) -> Counts {
    if backend.gpu_info().is_some_and(|info| !info.is_software) {
        return Counts { warm_up: 10, samples: samples.unwrap_or(20), in_a_row: 100 };
    }
    let samples = samples.unwrap_or(if is_software(backend) { 3 } else { 5 });
    Counts { warm_up: 1, samples, in_a_row: samples }
}
