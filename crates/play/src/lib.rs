//! The player of `.tcgs` scenes, natively and in a browser.
//!
//! - `source`: where bytes come from; `download`: what servers send
//! - `player`: which bytes are needed, decoded segments (`buffer`), the `clock`
//! - `reconstruct`, `blit`, `stage`: a timestep of a segment to a picture, with the renderer that training uses
//! - `start_view`, `cameras`, `controls`: from where it is seen
//! - `viewer`: all of these together; `web`: the same as a page sees it
//!
//! No training, no captures, no encoder: what a browser has to load.

// The browser's bindings are made by macros that are not.
#![cfg_attr(not(target_family = "wasm"), forbid(unsafe_code))]

mod blit;
mod buffer;
mod cameras;
mod clock;
mod controls;
// Only browsers download; tests need none.
#[cfg(any(target_family = "wasm", test))]
mod download;
mod error;
mod player;
mod reconstruct;
mod source;
mod stage;
mod start_view;
mod viewer;
#[cfg(target_family = "wasm")]
mod web;

pub use buffer::{Buffer, Order};
pub use cameras::{FileCamera, VIEWS, read_cameras};
pub use clock::Clock;
pub use controls::Controls;
pub use error::PlayError;
pub use player::{Player, PlayerSettings};
pub use reconstruct::Reconstruction;
pub use source::{BytesSource, FileSource, Piece, Source, SourceError};
pub use stage::{Shot, Stage, Still};
pub use start_view::start_view;
pub use viewer::{Frame, Viewer};

/// Every shader of this crate with its name, as the GPU gets it; see [`tcgs_render::device::sources`] for the others.
pub fn sources() -> Vec<(String, String)> {
    let mut sources = reconstruct::sources();
    sources.push(("blit".into(), blit::SOURCE.into()));
    sources
}
