//! The player of `.tcgs` scenes, natively and in a browser.
//!
//! - `source`: where the bytes of a file come from; `download`: a server's answers
//! - `player`: from bytes to a timestep that can be drawn; the `clock`
//! - `holdings`: which part is fetched next, which parts are kept
//! - `reconstruct`, `segment_renderer`, `blit`: from a timestep to a picture, with the renderer that training uses
//! - `start_view`, `controls`: the view of the scene at the start, and how a person moves it
//! - `viewer`: all of these together; `web`: the same for a page
//!
//! There is no training, no capture and no encoder in this crate, because a browser has to load all of it.
//!
//! Without a GPU a player still fetches and decodes:
//!
//! ```
//! use tcgs_play::{BytesSource, Player, PlayerSettings};
//! let file = include_bytes!("../../../testdata/bitstream/v1/room_default.tcgs");
//! let mut player = Player::new(BytesSource::new(*file), PlayerSettings::default(), 0);
//! let mut now_ms = 0.0;
//! let gaussians = loop {
//!     player.update(now_ms)?;
//!     if let Some(moment) = player.current() {
//!         assert_eq!(moment.timestep, 0);
//!         break moment.gaussians();
//!     }
//!     now_ms += 10.0;
//! };
//! assert!(gaussians.num_gaussians() > 0);
//! # Ok::<(), tcgs_play::PlayError>(())
//! ```

// The code that `wasm_bindgen`'s macros generate for the browser is unsafe, so only native builds forbid it.
#![cfg_attr(not(target_family = "wasm"), forbid(unsafe_code))]

mod blit;
mod clock;
mod controls;
// Only browsers download; natively nothing but the module's own tests uses it.
#[cfg(any(target_family = "wasm", test))]
mod download;
mod error;
mod holdings;
mod player;
mod reconstruct;
mod segment_renderer;
mod source;
mod start_view;
mod viewer;
#[cfg(target_family = "wasm")]
mod web;

pub use clock::Clock;
pub use controls::Controls;
pub use error::{BadCamera, ErrorCode, PlayError};
pub use holdings::Moment;
pub use player::{Player, PlayerSettings};
pub use reconstruct::Reconstruction;
pub use segment_renderer::{PictureRequest, SegmentRenderer, Still};
pub use source::{BytesSource, FileSource, Piece, RangeSource, SourceError};
pub use start_view::start_view;
pub use viewer::{FrameReport, Viewer};

/// Name and WGSL source of every shader of this crate, as the GPU gets it. [`tcgs_render::device::sources`] has the
/// renderer's shaders.
pub fn sources() -> Vec<(String, String)> {
    let mut sources = reconstruct::sources();
    sources.push(("blit".into(), blit::SOURCE.into()));
    sources
}
