//! `tcgs view`: shows a scene of this machine in a browser.

use std::fs::File;
use std::io::Read;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use anyhow::{Context, anyhow};
use tcgs_codec::{Archive, DecodeLimits, MAGIC, Opening};
use tcgs_serve::{NO_PAGE, PAGE, Server};

use crate::error::wrong_input;
use crate::scene::unreadable;
use crate::terminal::{note, say};

/// Show a scene in a browser
///
/// Serves the player on this machine alone (127.0.0.1), prints its address, opens a browser if there is one, and
/// serves until it is stopped (Ctrl-C).
#[derive(clap::Args)]
#[command(after_help = "\
Example:
  tcgs view scene.tcgs
  tcgs view scene.tcgs --no-open --port 8000")]
pub struct Arguments {
    /// .tcgs file
    scene: PathBuf,
    /// Port to serve at; 0: any that is free
    #[arg(long, value_name = "PORT", default_value_t = 0)]
    port: u16,
    /// Open no browser
    #[arg(long)]
    no_open: bool,
}

/// Runs the command.
pub fn run(arguments: &Arguments) -> anyhow::Result<()> {
    check_scene(&arguments.scene)?;
    if PAGE.is_empty() {
        return Err(anyhow!(NO_PAGE));
    }
    let server = Server::bind(arguments.port, &arguments.scene, PAGE)
        .with_context(|| format!("serving at port {} of 127.0.0.1", arguments.port))?;
    let address = server.address()?;
    say(&address)?;
    if !arguments.no_open {
        open_browser(&address);
    }
    server.run(|error| note(&format!("a connection failed: {error}")))
}

/// Refuses a file that the player could not open: one without the tables of a `.tcgs` file. The player itself tells of
/// damage behind the tables.
fn check_scene(path: &Path) -> anyhow::Result<()> {
    let expected = "a .tcgs file, which `tcgs compress` makes of other scenes";
    let refuse = |found: String| Err(wrong_input(format!("{}: {found}, expected {expected}", path.display())));
    if path.is_dir() {
        return refuse("is a folder".into());
    }
    let mut file = File::open(path).map_err(|error| unreadable(path, error, expected))?;
    let (mut start, mut needed) = (Vec::new(), MAGIC.len() as u64);
    loop {
        let missing = needed - start.len() as u64;
        let read = (&mut file).take(missing).read_to_end(&mut start);
        read.map_err(|error| unreadable(path, error, expected))?;
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

/// Asks the desktop, if there is one, to show an address. On other machines the printed address must do.
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
