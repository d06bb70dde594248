//! `tcgs view`: shows a local scene, or the cameras and points of a capture, in a browser.

mod cameras;

use std::io::Read;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use anyhow::{Context, anyhow};
use tcgs_capture::{Capture, CaptureError, Split};
use tcgs_codec::{Archive, DecodeLimits, MAGIC, Opening};
use tcgs_core::open_file;
use tcgs_pipeline::points_scene;
use tcgs_prepare::RawFootage;
use tcgs_serve::{NO_PAGE, PAGE, SceneSource, Server};

use crate::error::wrong_input;
use crate::scene::unreadable;
use crate::terminal::{note, say};

/// Show a scene or a capture in a browser
///
/// Serves the player on this machine only (127.0.0.1), prints its address, opens a browser if there is one, and serves
/// until it is stopped (Ctrl-C).
///
/// For a capture it shows the cameras, each with its image of the first frame, and the points that training starts
/// from. Cameras are right if their images and the points fit together, which shows before training. Key C shows
/// cameras without images, and hides them.
#[derive(clap::Args)]
#[command(after_help = "\
Example:
  tcgs view scene.tcgs
  tcgs view my_capture                           before training
  tcgs view scene.tcgs --capture my_capture      the scene among the cameras that saw it
  tcgs view scene.tcgs --no-open --port 8000")]
pub struct Arguments {
    /// .tcgs file, or the folder of a capture
    scene: PathBuf,
    /// Capture of the scene, to show its cameras and images
    #[arg(long, value_name = "CAPTURE")]
    capture: Option<PathBuf>,
    /// Port to serve at; 0: any free port
    #[arg(long, value_name = "PORT", default_value_t = 0)]
    port: u16,
    /// Open no browser
    #[arg(long)]
    no_open: bool,
}

/// Runs the command.
pub fn run(arguments: &Arguments) -> anyhow::Result<()> {
    let (scene, cameras) = shown(arguments)?;
    if PAGE.is_empty() {
        return Err(anyhow!(NO_PAGE));
    }
    let mut server = Server::bind(arguments.port, scene, PAGE)
        .with_context(|| format!("serving at port {} of 127.0.0.1", arguments.port))?;
    if let Some(cameras) = cameras {
        server = server.with_cameras(cameras);
    }
    let address = server.address()?;
    say(&address)?;
    if !arguments.no_open {
        open_browser(&address);
    }
    server.run(|error| note(&format!("a connection failed: {error}")))
}

/// The scene, and the cameras to show with it.
fn shown(arguments: &Arguments) -> anyhow::Result<(SceneSource, Option<Vec<u8>>)> {
    let path = &arguments.scene;
    if path.is_dir() {
        let capture = opened(path)?;
        if let Some(other) = &arguments.capture {
            let problem = format!("is a capture, expected a scene beside --capture {}", other.display());
            return Err(wrong_input(format!("{}: {problem}", path.display())));
        }
        let names = capture.camera_names(Split::All, 0)?;
        if !capture.has_points() {
            note("the capture has no points yet, so only its cameras are shown; tcgs prepare makes points");
        }
        let file = cameras::cameras_file(&capture, &names)?;
        return Ok((SceneSource::Bytes(points_scene(&capture, &names)?), Some(file)));
    }
    check_scene(path)?;
    let cameras = match &arguments.capture {
        Some(folder) => {
            let capture = Capture::open_unseen(folder)?;
            let names = capture.camera_names(Split::All, 0)?;
            Some(cameras::cameras_file(&capture, &names)?)
        }
        None => None,
    };
    Ok((path.as_path().into(), cameras))
}

/// Opens a capture without judging its cameras: finding wrong ones is the purpose of the view.
fn opened(path: &Path) -> anyhow::Result<Capture> {
    if RawFootage::is_in(path)? {
        let problem = "is a folder of videos, expected a capture, which `tcgs prepare` makes of it";
        return Err(wrong_input(format!("{}: {problem}", path.display())));
    }
    match Capture::open_unseen(path) {
        Err(CaptureError::NotCapture { .. }) => {
            Err(wrong_input(format!("{}: is a folder of no capture, expected {EXPECTED}", path.display())))
        }
        other => Ok(other?),
    }
}

/// Scenes that can be shown, for messages.
const EXPECTED: &str = "a .tcgs file, which `tcgs compress` makes of other scenes, or a capture";

/// Refuses a file that the player could not open: one without the tables of a `.tcgs` file. The player itself reports
/// damage after the tables.
pub fn check_scene(path: &Path) -> anyhow::Result<()> {
    let refuse = |found: String| Err(wrong_input(format!("{}: {found}, expected {EXPECTED}", path.display())));
    let mut file = open_file(path).map_err(|error| unreadable(path, error, EXPECTED))?;
    let (mut start, mut needed) = (Vec::new(), MAGIC.len() as u64);
    loop {
        let missing = needed - start.len() as u64;
        let read = (&mut file).take(missing).read_to_end(&mut start);
        read.map_err(|error| unreadable(path, error, EXPECTED))?;
        if !start.starts_with(&MAGIC) {
            return refuse("a file of another kind".into());
        }
        if (start.len() as u64) < needed {
            return refuse(format!("ends after {} bytes, within its header", start.len()));
        }
        match Archive::open(&start, &DecodeLimits::default()) {
            Ok(Opening::Ready(_)) => return Ok(()),
            Ok(Opening::More(more)) => needed = more,
            Err(error) => return Err(wrong_input(format!("{}: {error}, expected a whole .tcgs file", path.display()))),
        }
    }
}

/// Opens an address in the desktop's browser, if there is a desktop. Without one the printed address must do.
fn open_browser(address: &str) {
    let program = if cfg!(target_os = "macos") {
        "open"
    } else if cfg!(windows) {
        "explorer"
    } else if ["DISPLAY", "WAYLAND_DISPLAY"].iter().any(|name| std::env::var_os(name).is_some()) {
        "xdg-open"
    } else {
        return;
    };
    let mut command = Command::new(program);
    command.arg(address).stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null());
    if let Err(error) = command.spawn() {
        note(&format!("{program}: {error}; open the address yourself"));
    }
}
