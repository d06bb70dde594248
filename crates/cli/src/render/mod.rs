//! `tcgs render`: pictures or a video of a scene, from a capture's cameras or along a path.

mod video;

use std::path::{Path, PathBuf};
use std::str::FromStr;

use anyhow::Context;
use serde_json::json;
use tcgs_capture::Capture;
use tcgs_core::{Camera, Tour};
use tcgs_interchange::create_folders;
use tcgs_pipeline::{CameraAt, NewFolder, OpenScene, read_camera_path, render};

use crate::backend::{BackendName, BackendOptions};
use crate::error::wrong_input;
use crate::interrupt;
use crate::options::{Frames, JobOptions, Size};
use crate::output::{check_folder, finish, is_numbered};
use crate::scene::{SceneOptions, describe, note_replaced};
use crate::teller::Teller;
use crate::terminal::say;
use video::Video;

/// Size of pictures along a path around the scene.
const PATH_SIZE: [usize; 2] = [640, 360];

/// Render pictures or a video of a scene
///
/// Along a path the camera moves with every frame. Orbit and spiral lead around the moving objects, among the capture's
/// cameras if the scene stores any: all the way round if these form a ring, else along an arc and back. The pictures
/// are DIR/FRAME.png; with --cameras they are DIR/CAMERA/FRAME.png, and a video shows one camera after the other.
/// Videos need the program ffmpeg; an odd size loses a row or a column there.
#[derive(clap::Args)]
#[command(after_help = "\
Example:
  tcgs render scene.tcgs --out frames --path spiral --size 1280x720
  tcgs render scene.tcgs --out clip.mp4 --path camera-path.json
  tcgs render my_run --out frames --cameras my_capture --frames 0..10")]
pub struct Arguments {
    /// .tcgs file, run folder, params.npz, .4dgs file, or PLY, SPZ, glTF or SOG files
    scene: PathBuf,
    #[command(flatten)]
    reading: SceneOptions,
    /// Folder for PNG files, or a .mp4 or .webm file
    #[arg(long, value_name = "DIR|VIDEO")]
    out: PathBuf,
    /// Capture whose test cameras render; its training cameras if it has no others
    #[arg(long, value_name = "CAPTURE", conflicts_with = "path")]
    cameras: Option<PathBuf>,
    /// Camera path: orbit, spiral, or a file that the player saved [default: orbit]
    #[arg(long, value_name = "orbit|spiral|FILE.json")]
    path: Option<PathOption>,
    /// Frames of the capture, from A up to but not including B [default: all of the scene]
    #[arg(long, value_name = "A..B")]
    frames: Option<Frames>,
    /// Size of the pictures [default: 640x360; with --cameras the training's size; with a saved path its size]
    #[arg(long, value_name = "WxH")]
    size: Option<Size>,
    #[command(flatten)]
    backend: BackendOptions,
    #[command(flatten)]
    job: JobOptions,
}

/// Values of `--path`.
#[derive(Clone, Debug)]
enum PathOption {
    Around(Tour),
    Saved(PathBuf),
}

impl FromStr for PathOption {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text {
            "orbit" => Ok(Self::Around(Tour::Orbit)),
            "spiral" => Ok(Self::Around(Tour::Spiral)),
            _ if text.ends_with(".json") => Ok(Self::Saved(text.into())),
            _ => Err("expected orbit, spiral, or a .json file that the player saved".into()),
        }
    }
}

/// Runs the command.
pub fn run(arguments: &Arguments) -> anyhow::Result<()> {
    let path = match &arguments.path {
        Some(PathOption::Saved(path)) => Some(path.as_path()),
        _ => None,
    };
    let sources = [Some(arguments.scene.as_path()), arguments.cameras.as_deref(), path];
    let sources: Vec<&Path> = sources.into_iter().flatten().collect();
    if video::is_named(&arguments.out) {
        arguments.job.begin(&[&arguments.out], &sources)?;
    } else {
        arguments.job.begin(&[], &sources)?;
        check_folder(&arguments.out, &sources)?;
    }
    interrupt::politely(|| draw(arguments))
}

fn draw(arguments: &Arguments) -> anyhow::Result<()> {
    if let Some(path) = arguments.cameras.as_ref().filter(|path| path.extension().is_some_and(|e| e == "json")) {
        let problem = "no camera files in this version, expected the folder of a capture";
        return Err(wrong_input(format!("{}: {problem}", path.display())));
    }
    let mut output = Output::begin(&arguments.out, arguments.job.force)?;
    let renderer = arguments.backend.open(BackendName::Auto)?.renderer();
    let scene = arguments.reading.open(&arguments.scene)?;
    let cameras = cameras(arguments, &scene, matches!(output, Output::Video(_)))?;
    if let Output::Video(video) = &mut output {
        video.set_frame_rate(scene.frame_rate);
    }
    say(&describe(&scene))?;
    Teller::default().watch(|teller| {
        render(&scene, &cameras, &*renderer, teller, |at, image| output.add(&name(at), &image.to_rgb8(), &at.camera))
    })?;
    output.finish()?;
    let out = arguments.out.display().to_string();
    say(&format!("{out}: {} pictures", cameras.len()))?;
    note_replaced(&scene);
    arguments.job.write_json(&json!({ "out": out, "pictures": cameras.len() }))
}

/// The relative path of a picture within the folder.
fn name(at: &CameraAt) -> PathBuf {
    let png = format!("{:06}.png", at.frame);
    at.camera_id.map_or_else(|| PathBuf::from(&png), |id| Path::new(&id.to_string()).join(&png))
}

/// All cameras, in the order in which they are rendered.
///
/// - `by_camera`: with a capture, one camera after the other instead of one frame after the other
fn cameras(arguments: &Arguments, scene: &OpenScene, by_camera: bool) -> anyhow::Result<Vec<CameraAt>> {
    let frames = scene.choose_frames(arguments.frames.as_ref().map(|frames| &frames.0))?;
    let size = arguments.size.map(|size| [size.width, size.height]);
    if let Some(path) = &arguments.cameras {
        let mut cameras = CameraAt::of_capture(scene, frames, &Capture::open(path)?, size)?;
        if by_camera {
            // Cameras in the order of the first frame, independent of their ids.
            let first = cameras.first().map(|at| at.frame);
            let order: Vec<_> = cameras.iter().filter(|at| Some(at.frame) == first).map(|at| at.camera_id).collect();
            let place = |at: &CameraAt| order.iter().position(|id| *id == at.camera_id).unwrap_or(order.len());
            cameras.sort_by_key(|at| (place(at), at.camera_id, at.frame));
        }
        return Ok(cameras);
    }
    Ok(match arguments.path.as_ref().unwrap_or(&PathOption::Around(Tour::Orbit)) {
        PathOption::Around(tour) => CameraAt::of_tour(scene, frames, *tour, size.unwrap_or(PATH_SIZE))?,
        PathOption::Saved(file) => CameraAt::of_path(scene, frames, &read_camera_path(file)?, size)?,
    })
}

/// Destination of the pictures.
enum Output {
    Folder(NewFolder),
    Video(Box<Video>),
}

impl Output {
    fn begin(place: &Path, force: bool) -> anyhow::Result<Self> {
        match Video::begin(place, force)? {
            Some(video) => Ok(Self::Video(Box::new(video))),
            None => Ok(Self::Folder(NewFolder::begin(place, force, is_png)?)),
        }
    }

    fn add(&mut self, name: &Path, rgb: &[u8], camera: &Camera) -> anyhow::Result<()> {
        let (width, height) = (camera.width, camera.height);
        match self {
            Self::Video(video) => video.add(rgb, Size { width, height }),
            Self::Folder(folder) => {
                let path = folder.path().join(name);
                if let Some(of_camera) = path.parent() {
                    create_folders(of_camera).with_context(|| format!("creating {}", of_camera.display()))?;
                }
                image::save_buffer(&path, rgb, width as u32, height as u32, image::ColorType::Rgb8)
                    .with_context(|| format!("writing {}", path.display()))
            }
        }
    }

    fn finish(self) -> anyhow::Result<()> {
        match self {
            Self::Video(video) => video.finish(),
            Self::Folder(folder) => finish(folder, |_| false),
        }
    }
}

/// Whether a file has the name of a picture, such as `000123.png`, and so may be replaced.
fn is_png(path: &Path) -> bool {
    is_numbered(path, ".png")
}
