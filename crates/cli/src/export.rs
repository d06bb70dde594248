//! `tcgs export`: a scene for other programs.

use std::fs::File;
use std::io::{BufWriter, Write};
use std::ops::Range;
use std::path::{Path, PathBuf};

use anyhow::Context;
use serde_json::json;
use tcgs_core::{Attribute, DynamicGaussians, Gaussians};
use tcgs_interchange::{ParamsExtras, ParamsOrigin, write_params_npz_to, write_ply_to};
use tcgs_pipeline::{OpenScene, PipelineError, SceneContent};

use crate::compress::kept_gaussians;
use crate::error::wrong_input;
use crate::options::{Frames, JobOptions};
use crate::output::{NewFolder, check_file, is_numbered, say, show_bytes, write_file_with};
use crate::progress::Progress;
use crate::scene::{SceneOptions, describe};

/// Export a scene for other programs
///
/// A params.npz is what Dynamic 3D Gaussians writes and its viewer reads; it holds scales and opacities once.
/// A PLY file is what 3D Gaussian splatting writes and most viewers read: one timestep, named by its frame in a
/// folder of many. A run is exported in floats, without the Gaussians that its masks leave out over time: such
/// files have no place for masks.
#[derive(clap::Args)]
#[command(after_help = "\
Example:
  tcgs export my_run --to params.npz
  tcgs export scene.tcgs --to plys
  tcgs export scene.tcgs --frames 7..8 --to frame_7.ply")]
pub struct Arguments {
    /// .tcgs file, run folder, params.npz or folder of PLY files
    scene: PathBuf,
    #[command(flatten)]
    reading: SceneOptions,
    /// File or folder to write; its ending says what: .npz, .ply for one timestep, none for a folder of PLY files
    #[arg(long, value_name = "FILE|DIR")]
    to: PathBuf,
    /// Frames of the capture, from A up to but not including B [default: all of the scene]
    #[arg(long, value_name = "A..B")]
    frames: Option<Frames>,
    #[command(flatten)]
    job: JobOptions,
}

/// What is written.
enum Target {
    ParamsNpz,
    Ply,
    PlyFolder(NewFolder),
}

/// Runs the command.
pub fn run(arguments: &Arguments) -> anyhow::Result<()> {
    arguments.job.begin()?;
    let (to, force) = (&arguments.to, arguments.job.force);
    let target = target(to, force)?;
    let scene = arguments.reading.open(&arguments.scene)?;
    let frames = scene.choose_frames(arguments.frames.as_ref().map(|frames| &frames.0))?;
    say(&describe(&scene))?;
    let keep = kept_gaussians(&scene, None)?;
    if keep.is_empty() {
        return Err(wrong_input(format!("{}: has no Gaussians, expected at least one", scene.path.display())));
    }
    if keep.len() < scene.num_gaussians() {
        say(&format!("{} of {} Gaussians are not masked out", keep.len(), scene.num_gaussians()))?;
    }
    let bytes = match target {
        Target::ParamsNpz => write_params(arguments, &scene, &keep, &frames)?,
        Target::Ply if frames.len() > 1 => {
            let (count, start) = (frames.len(), frames.start);
            let expected = format!("--frames {start}..{} for one, or a folder", start + 1);
            return Err(wrong_input(format!("{}: a file for {count} timesteps, expected {expected}", to.display())));
        }
        Target::Ply => {
            let gaussians = kept(&scene, &keep, frames.start)?;
            write_file_with(to, force, |file| write_ply(file, &gaussians))?;
            std::fs::metadata(to).map_or(0, |written| written.len())
        }
        Target::PlyFolder(folder) => write_ply_folder(folder, &scene, &keep, &frames)?,
    };
    say(&format!("{}: {}", to.display(), show_bytes(bytes)))?;
    arguments.job.write_json(&json!({ "out": to.display().to_string(), "bytes": bytes }))
}

/// By the ending. Refuses early what could not be written at the end.
fn target(to: &Path, force: bool) -> anyhow::Result<Target> {
    match to.extension().map(|extension| extension.to_string_lossy().to_lowercase()).as_deref() {
        Some("npz") => check_file(to, force).map(|()| Target::ParamsNpz),
        Some("ply") => check_file(to, force).map(|()| Target::Ply),
        other if other.is_none() || to.is_dir() => {
            NewFolder::begin(to, force, |path| is_numbered(path, ".ply")).map(Target::PlyFolder)
        }
        _ => {
            let problem = "not a kind of file that this version writes";
            let expected = "NAME.npz, NAME.ply, or a folder's name without an ending";
            Err(wrong_input(format!("{}: {problem}, expected {expected}", to.display())))
        }
    }
}

/// The Gaussians that are not masked out, at one frame.
fn kept(scene: &OpenScene, keep: &[usize], frame: usize) -> Result<Gaussians, PipelineError> {
    let gaussians = scene.at(frame - scene.first_frame)?;
    Ok(if keep.len() < gaussians.num_gaussians() { gaussians.select(keep) } else { gaussians })
}

/// It holds floats, of which the whole numbers end here.
const MAX_FRAME_OF_PARAMS: usize = 1 << 24;

fn write_params(
    arguments: &Arguments,
    scene: &OpenScene,
    keep: &[usize],
    frames: &Range<usize>,
) -> anyhow::Result<u64> {
    let to = &arguments.to;
    let mut floats = DynamicGaussians::default();
    for frame in frames.clone() {
        floats.push(kept(scene, keep, frame)?);
    }
    for attribute in [Attribute::LogScale, Attribute::LogitOpacity] {
        if floats.varies(attribute) {
            let problem = format!("{} vary with time, which a params.npz cannot hold", attribute.name());
            let expected = format!("a folder to export PLY files to, not {}", to.display());
            return Err(wrong_input(format!("{}: {problem}, expected {expected}", scene.path.display())));
        }
    }
    // A number of 32 bits, where frames are counted by dates or clocks, would be another one.
    if frames.start >= MAX_FRAME_OF_PARAMS {
        let problem = format!("begins at frame {}, which a params.npz cannot hold", frames.start);
        let expected = format!("a frame below {MAX_FRAME_OF_PARAMS}, or a folder to export PLY files to");
        return Err(wrong_input(format!("{}: {problem}, expected {expected}", scene.path.display())));
    }
    let foreground: Vec<bool>;
    let origin = ParamsOrigin {
        first_frame: frames.start as u32,
        downscale: scene.downscale as u32,
        frame_rate: scene.frame_rate as f32,
    };
    let mut extras = ParamsExtras { origin: Some(origin), ..ParamsExtras::default() };
    if let SceneContent::Run(run) = &scene.content {
        foreground = keep.iter().map(|&i| run.1.foreground[i]).collect();
        extras.foreground = Some(&foreground);
        (extras.log_gains, extras.offsets) = (&run.1.camera_gains, &run.1.camera_offsets);
    }
    write_file_with(to, arguments.job.force, |file| {
        write_params_npz_to(BufWriter::new(file), &floats, &extras)?.flush()
    })?;
    Ok(std::fs::metadata(to).map_or(0, |written| written.len()))
}

fn write_ply_folder(
    folder: NewFolder,
    scene: &OpenScene,
    keep: &[usize],
    frames: &Range<usize>,
) -> anyhow::Result<u64> {
    let mut progress = Progress::new("exporting", frames.len());
    let mut bytes = 0;
    for frame in frames.clone() {
        let path = folder.path().join(format!("{frame:06}.ply"));
        let context = || format!("writing {}", path.display());
        let file = File::create(&path).with_context(context)?;
        write_ply(&file, &kept(scene, keep, frame)?).with_context(context)?;
        bytes += file.metadata().with_context(context)?.len();
        progress.step(|| format!("frame {frame}"));
    }
    drop(progress);
    folder.finish()?;
    Ok(bytes)
}

fn write_ply(file: &File, gaussians: &Gaussians) -> std::io::Result<()> {
    let mut writer = BufWriter::new(file);
    write_ply_to(&mut writer, gaussians)?;
    writer.flush()
}
