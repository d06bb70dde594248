//! The player's page in a program, and a web server that shows a scene with it on this machine.
//!
//! What lives here: the built page (`web/dist`), embedded by the build, and the part of HTTP to serve it. Beside the
//! page the server offers one scene and the cameras of its capture, or the files of a training. What does not: the
//! player itself, which is `tcgs-play` in the page. The command line and the Python package show scenes with this
//! server.
//!
//! ```
//! use std::path::Path;
//! use tcgs_serve::Server;
//! let server = Server::bind(0, Path::new("scene.tcgs"), tcgs_serve::PAGE)?;
//! assert!(server.address()?.starts_with("http://127.0.0.1:"));
//! # Ok::<(), std::io::Error>(())
//! ```

mod http;
mod server;
mod single_file;
mod training;

pub use server::{FrameAncestors, PageFile, SceneSource, Server};
pub use single_file::single_file;
pub use training::{TRAINING_FILES, Training, TrainingFile};

/// Files of the built page; empty if the page was not built before this program.
pub const PAGE: &[PageFile] = include!(concat!(env!("OUT_DIR"), "/page.rs"));

/// Instruction for the user where [`PAGE`] is empty.
pub const NO_PAGE: &str = "this program was built without the player: run web/build.sh, then build tcgs again";
