//! `tcgs render`: pictures of a scene, from a capture's cameras or along a path.

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use anyhow::Context;
use serde_json::json;
use tcgs_capture::{Capture, Split};
use tcgs_core::{Activated, Camera};
use tcgs_render::{Draw, RenderSettings};

use crate::backend::{BackendName, BackendOptions};
use crate::camera_path::CameraPath;
use crate::error::wrong_input;
use crate::options::{Frames, JobOptions, Size};
use crate::output::{NewFolder, is_numbered, say};
use crate::progress::Progress;
use crate::scene::{Scene, SceneOptions};

/// Size of pictures along a path.
const PATH_SIZE: Size = Size { width: 640, height: 360 };

/// Render pictures of a scene
///
/// Along a path the camera moves on with every frame and comes around once; the pictures are
/// DIR/FRAME.png. With --cameras they are DIR/CAMERA/FRAME.png.
#[derive(clap::Args)]
#[command(after_help = "\
Example:
  tcgs render scene.tcgs --out frames --path spiral --size 1280x720
  tcgs render my_run --out frames --cameras my_capture --frames 0..10")]
pub struct Arguments {
    /// .tcgs file, run folder, params.npz or folder of PLY files
    scene: PathBuf,
    #[command(flatten)]
    reading: SceneOptions,
    /// Folder for the PNG files
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Capture whose test cameras render; its training cameras if it has no others
    #[arg(long, value_name = "CAPTURE", conflicts_with = "path")]
    cameras: Option<PathBuf>,
    /// Camera path [default: orbit]
    #[arg(long)]
    path: Option<CameraPath>,
    /// Frames of the capture, from A up to but not including B [default: all of the scene]
    #[arg(long, value_name = "A..B")]
    frames: Option<Frames>,
    /// Size of the pictures [default: 640x360; with --cameras, as the scene was trained]
    #[arg(long, value_name = "WxH")]
    size: Option<Size>,
    #[command(flatten)]
    backend: BackendOptions,
    #[command(flatten)]
    job: JobOptions,
}

/// Runs the command.
pub fn run(arguments: &Arguments) -> anyhow::Result<()> {
    arguments.job.begin()?;
    check_kinds(arguments)?;
    let renderer = arguments.backend.open(BackendName::Auto)?.renderer();
    let folder = NewFolder::begin(&arguments.out, arguments.job.force, is_png)?;
    let capture = arguments.cameras.as_ref().map(|path| Capture::open(path)).transpose()?;
    let scene = Scene::load(&arguments.scene, arguments.reading)?;
    let frames = scene.choose_frames(arguments.frames.as_ref().map(|frames| &frames.0))?;
    say(&scene.describe())?;

    let path = match capture {
        Some(_) => Vec::new(),
        None => {
            let path = arguments.path.unwrap_or(CameraPath::Orbit);
            let gaussians = scene.at(frames.start - scene.first_frame);
            path.cameras(&gaussians, frames.len(), arguments.size.unwrap_or(PATH_SIZE))
        }
    };
    let mut progress = Progress::new("rendering", frames.len());
    let mut count = 0;
    for frame in frames.clone() {
        let drawn = scene.drawn(frame - scene.first_frame);
        let name = format!("{frame:06}.png");
        match &capture {
            None => {
                write_png(&*renderer, &drawn, &path[frame - frames.start], &folder.path().join(name))?;
                count += 1;
            }
            Some(capture) => {
                for (id, camera) in cameras(capture, &scene, frame, arguments.size)? {
                    let of_camera = folder.path().join(id.to_string());
                    fs::create_dir_all(&of_camera).with_context(|| format!("creating {}", of_camera.display()))?;
                    write_png(&*renderer, &drawn, &camera, &of_camera.join(&name))?;
                    count += 1;
                }
            }
        }
        progress.step(|| format!("frame {frame}"));
    }
    drop(progress);
    folder.finish()?;
    let out = arguments.out.display().to_string();
    say(&format!("{out}: {count} pictures"))?;
    arguments.job.write_json(&json!({ "out": out, "pictures": count }))
}

fn check_kinds(arguments: &Arguments) -> anyhow::Result<()> {
    let is = |path: &Path, kind: &str| path.extension().is_some_and(|e| e.eq_ignore_ascii_case(kind));
    if is(&arguments.out, "mp4") {
        let problem = "no video in this version, expected the name of a folder for PNG files";
        return Err(wrong_input(format!("{}: {problem}", arguments.out.display())));
    }
    match &arguments.cameras {
        Some(path) if is(path, "json") => {
            let problem = "no camera files in this version, expected the folder of a capture";
            Err(wrong_input(format!("{}: {problem}", path.display())))
        }
        _ => Ok(()),
    }
}

/// What rendering writes, and so may replace: `000123.png`.
fn is_png(path: &Path) -> bool {
    is_numbered(path, ".png")
}

fn cameras(capture: &Capture, scene: &Scene, frame: usize, size: Option<Size>) -> anyhow::Result<Vec<(usize, Camera)>> {
    let mut cameras = capture.cameras(Split::Test, frame, scene.downscale)?;
    if cameras.is_empty() {
        cameras = capture.cameras(Split::Train, frame, scene.downscale)?;
    }
    if let Some(size) = size {
        for (_, camera) in &mut cameras {
            *camera = camera.resized(size.width, size.height);
        }
    }
    Ok(cameras)
}

fn write_png(renderer: &dyn Draw, drawn: &Arc<Activated>, camera: &Camera, path: &Path) -> anyhow::Result<()> {
    let (output, _) = renderer.draw(drawn, camera, &RenderSettings::default())?;
    let (width, height) = (camera.width as u32, camera.height as u32);
    image::save_buffer(path, &output.image.to_rgb8(), width, height, image::ColorType::Rgb8)
        .with_context(|| format!("writing {}", path.display()))
}
