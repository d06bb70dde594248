//! Any scene: its bytes give it back, the same twice.
#![no_main]

use libfuzzer_sys::fuzz_target;
use tcgs_codec::{DecodeLimits, decode, encode};

#[path = "../../crates/codec/tests/any_scene/mod.rs"]
mod any_scene;

fuzz_target!(|input: (u8, u8, u64)| {
    let (num_gaussians, num_timesteps, seed) = input;
    let scene = any_scene::any_scene(num_gaussians as usize % 32, 1 + num_timesteps as usize % 48, seed);
    let file = encode(&scene).expect("a legal scene");
    assert_eq!(encode(&scene).expect("a legal scene"), file);
    assert_eq!(decode(&file, &DecodeLimits::default()).expect("a file just written"), scene);
});
