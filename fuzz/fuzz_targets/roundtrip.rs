//! Any scene, in version 1, and any cohorts, in version 2: their bytes give them back, the same twice.
#![no_main]

use libfuzzer_sys::fuzz_target;
use tcgs_codec::{DecodeLimits, decode, decode_cohorts, encode, encode_cohorts};

#[path = "../../crates/codec/tests/suite/support/any_scene.rs"]
mod any_scene;

fuzz_target!(|input: (u8, u8, u8, u64)| {
    let (num_cohorts, num_gaussians, num_timesteps, seed) = input;
    let limits = DecodeLimits::default();
    if num_cohorts % 8 > 0 {
        let (info, cohorts) = any_scene::any_cohorts(num_cohorts as usize % 8, seed);
        let file = encode_cohorts(&info, &cohorts, &[]).expect("legal cohorts");
        assert_eq!(encode_cohorts(&info, &cohorts, &[]).expect("legal cohorts"), file);
        assert_eq!(decode_cohorts(&file, &limits).expect("a file just written"), (info, cohorts));
        return;
    }
    let scene = any_scene::any_scene(num_gaussians as usize % 32, 1 + num_timesteps as usize % 48, seed);
    let file = encode(&scene).expect("a legal scene");
    assert_eq!(encode(&scene).expect("a legal scene"), file);
    assert_eq!(decode(&file, &limits).expect("a file just written"), scene);
});
