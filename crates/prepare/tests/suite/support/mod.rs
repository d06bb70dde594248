//! Helpers that these tests share with those of `tcgs-capture`.

#[path = "../../../../capture/tests/suite/support/needs.rs"]
mod needs;
#[cfg(feature = "video")]
#[path = "../../../../capture/tests/suite/support/numbered.rs"]
pub mod numbered;

#[cfg(feature = "video")]
pub use needs::has_ffmpeg;
pub use needs::real_folder;
