//! The decoder of `.tcgs` scenes for JavaScript: the WebAssembly behind `web/src/decoder.js`, which fetches the bytes.
//!
//! A browser allows no blocking reads, and the decoder reads as if all bytes were there. So it is given what has arrived
//! ([`Arrived`]): a call that lacks bytes fails and says which, and is made again when they are there.

mod arrived;
#[cfg(target_family = "wasm")]
mod decoder;

pub use self::arrived::Arrived;
