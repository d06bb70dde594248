//! The decoder of `.tcgs` scenes for JavaScript: the WebAssembly behind `web/src/decoder.js`, which fetches the bytes.
//!
//! A browser allows no blocking reads, but the decoder reads as if all bytes were there. The decoder therefore reads
//! [`Arrived`], the bytes that have arrived. A call that lacks bytes fails and names the missing range; the caller
//! repeats the call when the bytes are there.

mod arrived;
#[cfg(target_family = "wasm")]
mod decoder;

pub use self::arrived::Arrived;
