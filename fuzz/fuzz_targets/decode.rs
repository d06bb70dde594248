//! Any bytes: no panic, no memory beyond the limits, and what is a scene can be used. Checksums are off.
#![no_main]

use libfuzzer_sys::fuzz_target;
use tcgs_codec::{Archive, DecodeLimits, Opening, decode, encode, inspect};

fuzz_target!(|bytes: &[u8]| {
    let limits = DecodeLimits { max_bytes: 1 << 24, ..Default::default() };
    let _ = inspect(bytes, &limits);
    if let Ok(scene) = decode(bytes, &limits) {
        scene.at(scene.num_timesteps() - 1);
        // Small ones only: encoding tries much.
        if scene.num_gaussians() <= 64 && scene.num_timesteps() <= 64 {
            // Codes may stand for positions beyond all floats, which no file states the bounds of.
            if let Ok(file) = encode(&scene) {
                assert_eq!(decode(&file, &DecodeLimits::none()).expect("a file just written"), scene);
            }
        }
    }
    if let Ok(Opening::Ready(mut archive)) = Archive::open(bytes, &limits) {
        let range =
            |r: std::ops::Range<u64>| bytes.get(r.start as usize..(r.end as usize).min(bytes.len())).unwrap_or(&[]);
        let layers = archive.num_layers();
        if archive.read_shared(range(archive.shared_range(layers))).is_ok() {
            let last = archive.num_segments() - 1;
            if let Ok(segment) = archive.read_segment(last, range(archive.segment_range(last, layers))) {
                segment.at(segment.timesteps().start);
            }
        }
    }
});
