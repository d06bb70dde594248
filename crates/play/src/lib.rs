//! The player of `.tcgs` scenes, natively and in a browser.
//!
//! - `source`: where the bytes of a file come from; `download`: a server's answers
//! - `player`: from bytes to a timestep that can be drawn; the `clock`
//! - `holdings`: which part is fetched next, which parts are kept
//! - `start_view`, `controls`: the view of the scene at the start, and how a person moves it
//! - `viewer`: all of these together with a renderer; `web`: the same for a page
//! - feature `webgpu`: `reconstruct`, `segment_renderer`, `blit` draw with the shaders that training uses
//! - feature `webgl2`: `arrange` prepares a timestep for drawing as quads from back to front, in the worker of a page
//!   (`scene_worker`); `remote` is the player on the side of the page
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

#[cfg(feature = "webgl2")]
mod arrange;
#[cfg(feature = "webgpu")]
mod blit;
mod clock;
mod controls;
// Only browsers download; natively nothing but the module's own tests uses it.
#[cfg(any(all(target_family = "wasm", any(feature = "webgpu", feature = "webgl2")), test))]
mod download;
mod error;
mod holdings;
mod player;
#[cfg(feature = "webgpu")]
mod reconstruct;
#[cfg(feature = "webgl2")]
mod remote;
mod renderer;
#[cfg(feature = "webgl2")]
mod scene_worker;
#[cfg(feature = "webgpu")]
mod segment_renderer;
mod source;
mod start_view;
mod viewer;
#[cfg(all(target_family = "wasm", any(feature = "webgpu", feature = "webgl2")))]
mod web;

#[cfg(feature = "webgl2")]
pub use arrange::{Arranger, Changes, LINE, ROW_WORDS, ground};
pub use clock::Clock;
pub use controls::Controls;
pub use error::{BadCamera, ErrorCode, PlayError};
pub use holdings::Moment;
pub use player::{Player, PlayerSettings};
#[cfg(feature = "webgpu")]
pub use reconstruct::Reconstruction;
#[cfg(feature = "webgl2")]
pub use remote::{Arranged, Link, RemotePlayer, Reply, Request};
pub use renderer::{PictureRequest, Renderer};
#[cfg(feature = "webgl2")]
pub use scene_worker::SceneWorker;
#[cfg(feature = "webgpu")]
pub use segment_renderer::{SegmentRenderer, Still};
pub use source::{BytesSource, FileSource, Piece, RangeSource, SourceError};
pub use start_view::{StartView, start_view};
pub use viewer::{Feed, FrameReport, Viewer};

/// Name and WGSL source of every shader of this crate, as the GPU gets it. [`tcgs_render::device::sources`] has the
/// renderer's shaders.
#[cfg(feature = "webgpu")]
pub fn sources() -> Vec<(String, String)> {
    let mut sources = reconstruct::sources();
    sources.push(("blit".into(), blit::SOURCE.into()));
    sources
}
