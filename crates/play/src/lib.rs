//! The player of `.tcgs` scenes.

#[cfg(target_family = "wasm")]
mod web;
