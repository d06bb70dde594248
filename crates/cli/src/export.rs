//! `tcgs export`: a scene for other programs.

use std::io::{BufWriter, Write};
use std::path::PathBuf;

use serde_json::json;
use tcgs_interchange::{ParamsExtras, write_params_npz_to};

use crate::compress::kept_gaussians;
use crate::error::wrong_input;
use crate::options::JobOptions;
use crate::output::{check_file, say, show_bytes, write_file_with};
use crate::scene::{Model, Scene};

/// Export a scene for other programs
///
/// A params.npz is what Dynamic 3D Gaussians writes and its viewer reads. A run is exported in floats,
/// without the Gaussians that its masks leave out over time: such a file has no place for masks.
#[derive(clap::Args)]
#[command(after_help = "\
Example:
  tcgs export my_run --to params.npz")]
pub struct Arguments {
    /// .tcgs file, run folder or params.npz
    scene: PathBuf,
    /// File to write; its ending says what: .npz
    #[arg(long, value_name = "FILE")]
    to: PathBuf,
    #[command(flatten)]
    job: JobOptions,
}

/// Runs the command.
pub fn run(arguments: &Arguments) -> anyhow::Result<()> {
    arguments.job.begin()?;
    let to = arguments.to.display();
    if arguments.to.extension().is_none_or(|e| e != "npz") {
        return Err(wrong_input(format!("{to}: not a kind of file that this version writes, expected NAME.npz")));
    }
    check_file(&arguments.to, arguments.job.force)?;
    let scene = Scene::load(&arguments.scene)?;
    say(&scene.describe())?;
    let foreground: Vec<bool>;
    let (floats, extras) = match &scene.model {
        Model::Run(run) => {
            let trained = &run.1;
            let keep = kept_gaussians(&scene, None)?;
            foreground = keep.iter().map(|&i| trained.foreground[i]).collect();
            if keep.len() < scene.num_gaussians() {
                say(&format!("{} of {} Gaussians are not masked out", keep.len(), scene.num_gaussians()))?;
            }
            let extras = ParamsExtras {
                foreground: Some(&foreground),
                log_gains: &trained.camera_gains,
                offsets: &trained.camera_offsets,
            };
            (&trained.scene.select(&keep), extras)
        }
        Model::Params(floats) => (&**floats, ParamsExtras::default()),
        Model::Compact(compact) => (&compact.reconstruct(), ParamsExtras::default()),
    };
    write_file_with(&arguments.to, arguments.job.force, |file| {
        write_params_npz_to(BufWriter::new(file), floats, &extras)?.flush()
    })?;
    let bytes = std::fs::metadata(&arguments.to).map_or(0, |written| written.len());
    say(&format!("{to}: {}", show_bytes(bytes)))?;
    arguments.job.write_json(&json!({ "out": to.to_string(), "bytes": bytes }))
}
