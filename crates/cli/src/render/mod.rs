//! `tcgs render`: pictures or a video of a scene, from a capture's cameras or along a path.

mod path_file;
mod video;

use std::fs;
use std::path::{Path, PathBuf};
use std::str::FromStr;
use std::sync::Arc;

use anyhow::Context;
use serde_json::json;
use tcgs_capture::{Capture, Split};
use tcgs_core::{Activated, Camera, CameraPathError, Tour};
use tcgs_pipeline::OpenScene;
use tcgs_render::RenderSettings;

use crate::backend::{BackendName, BackendOptions};
use crate::error::wrong_input;
use crate::options::{Frames, JobOptions, Size};
use crate::output::{NewFolder, is_numbered, say};
use crate::progress::Progress;
use crate::scene::{SceneOptions, describe};
use path_file::read_camera_path;
use video::Video;

/// Size of pictures along a path around the scene.
const PATH_SIZE: Size = Size { width: 640, height: 360 };

/// Render pictures or a video of a scene
///
/// Along a path the camera moves on with every frame; orbit and spiral come around once. The pictures are
/// DIR/FRAME.png; with --cameras they are DIR/CAMERA/FRAME.png, and a video shows one camera after the other.
/// Videos need the program ffmpeg; an odd size loses a row or a column there.
#[derive(clap::Args)]
#[command(after_help = "\
Example:
  tcgs render scene.tcgs --out frames --path spiral --size 1280x720
  tcgs render scene.tcgs --out clip.mp4 --path camera-path.json
  tcgs render my_run --out frames --cameras my_capture --frames 0..10")]
pub struct Arguments {
    /// .tcgs file, run folder, params.npz or folder of PLY files
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
    /// Size of the pictures [default: 640x360; with --cameras as the scene was trained, of a saved path as it was saved]
    #[arg(long, value_name = "WxH")]
    size: Option<Size>,
    #[command(flatten)]
    backend: BackendOptions,
    #[command(flatten)]
    job: JobOptions,
}

/// What `--path` takes.
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

/// A picture to take.
struct Shot {
    frame: usize,
    camera: Camera,
    /// Within the folder.
    name: PathBuf,
}

/// Runs the command.
pub fn run(arguments: &Arguments) -> anyhow::Result<()> {
    arguments.job.begin()?;
    if let Some(path) = arguments.cameras.as_ref().filter(|path| path.extension().is_some_and(|e| e == "json")) {
        let problem = "no camera files in this version, expected the folder of a capture";
        return Err(wrong_input(format!("{}: {problem}", path.display())));
    }
    let mut output = Output::begin(&arguments.out, arguments.job.force)?;
    let renderer = arguments.backend.open(BackendName::Auto)?.renderer();
    let scene = arguments.reading.open(&arguments.scene)?;
    let shots = shots(arguments, &scene, matches!(output, Output::Video(_)))?;
    if let Output::Video(video) = &mut output {
        video.set_frame_rate(scene.frame_rate);
    }
    say(&describe(&scene))?;

    let mut progress = Progress::new("rendering", shots.len());
    let mut drawn: Option<(usize, Arc<Activated>)> = None;
    for shot in &shots {
        let gaussians = match &drawn {
            Some((frame, gaussians)) if *frame == shot.frame => Arc::clone(gaussians),
            _ => scene.drawn(shot.frame - scene.first_frame)?,
        };
        let (picture, _) = renderer.draw(&gaussians, &shot.camera, &RenderSettings::default())?;
        output.add(&shot.name, &picture.image.to_rgb8(), &shot.camera)?;
        drawn = Some((shot.frame, gaussians));
        progress.step(|| format!("frame {}", shot.frame));
    }
    drop(progress);
    output.finish()?;
    let out = arguments.out.display().to_string();
    say(&format!("{out}: {} pictures", shots.len()))?;
    arguments.job.write_json(&json!({ "out": out, "pictures": shots.len() }))
}

/// All pictures, in the order in which they are taken.
///
/// - `by_camera`: of a capture, one camera after the other; else one frame after the other
fn shots(arguments: &Arguments, scene: &OpenScene, by_camera: bool) -> anyhow::Result<Vec<Shot>> {
    let frames = scene.choose_frames(arguments.frames.as_ref().map(|frames| &frames.0))?;
    let png = |frame| PathBuf::from(format!("{frame:06}.png"));
    let shot = |frame, camera| Shot { frame, camera, name: png(frame) };
    if let Some(path) = &arguments.cameras {
        let capture = Capture::open(path)?;
        let mut shots = Vec::new();
        for frame in frames {
            for (place, (id, camera)) in cameras(&capture, scene, frame, arguments.size)?.into_iter().enumerate() {
                let name = Path::new(&id.to_string()).join(png(frame));
                shots.push((place, Shot { frame, camera, name }));
            }
        }
        if by_camera {
            shots.sort_by_key(|(place, shot)| (*place, shot.frame));
        }
        return Ok(shots.into_iter().map(|(_, shot)| shot).collect());
    }
    match arguments.path.as_ref().unwrap_or(&PathOption::Around(Tour::Orbit)) {
        PathOption::Around(tour) => {
            let gaussians = scene.at(frames.start - scene.first_frame)?;
            let Size { width, height } = arguments.size.unwrap_or(PATH_SIZE);
            let cameras = tour.cameras(&gaussians.means, scene.up().direction(), frames.len(), [width, height]);
            Ok(frames.zip(cameras).map(|(frame, camera)| shot(frame, camera)).collect())
        }
        PathOption::Saved(file) => {
            let path = read_camera_path(file)?;
            let first = path.keyframes().first().map(|first| [first.camera.width, first.camera.height]);
            let size = arguments.size.map(|size| [size.width, size.height]).or(first).unwrap_or_default();
            let camera_at = |frame| path.camera_at((frame - scene.first_frame) as f64, size);
            let shots = frames.map(|frame| Ok(shot(frame, camera_at(frame)?)));
            let shots: Result<_, CameraPathError> = shots.collect();
            shots.map_err(|problem| wrong_input(format!("{}: {problem}", file.display())))
        }
    }
}

fn cameras(
    capture: &Capture,
    scene: &OpenScene,
    frame: usize,
    size: Option<Size>,
) -> anyhow::Result<Vec<(usize, Camera)>> {
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

/// Where the pictures go.
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
                    fs::create_dir_all(of_camera).with_context(|| format!("creating {}", of_camera.display()))?;
                }
                image::save_buffer(&path, rgb, width as u32, height as u32, image::ColorType::Rgb8)
                    .with_context(|| format!("writing {}", path.display()))
            }
        }
    }

    fn finish(self) -> anyhow::Result<()> {
        match self {
            Self::Video(video) => video.finish(),
            Self::Folder(folder) => folder.finish(),
        }
    }
}

/// What rendering writes, and so may replace: `000123.png`.
fn is_png(path: &Path) -> bool {
    is_numbered(path, ".png")
}
