//! Any bytes: no panic, no memory beyond the limits, and what is a scene can be used. Checksums are off.
#![no_main]

use libfuzzer_sys::fuzz_target;
use tcgs_codec::{Archive, DecodeLimits, Opening, SceneInfo, decode_cohorts, encode_cohorts, inspect};

fuzz_target!(|bytes: &[u8]| {
    let limits = DecodeLimits { max_bytes: 1 << 24, ..Default::default() };
    let _ = inspect(bytes, &limits);
    for scene in decode_cohorts(bytes, &limits).map(|(_, cohorts)| cohorts).unwrap_or_default() {
        scene.at(scene.num_timesteps() - 1);
        // Small ones only: encoding tries much.
        if scene.num_gaussians() <= 64 && scene.num_timesteps() <= 64 {
            // Codes may stand for positions beyond all floats, which no file states the bounds of.
            let info =
                SceneInfo { num_timesteps: scene.start.saturating_add(scene.info.num_timesteps), ..scene.info.clone() };
            if let Ok(file) = encode_cohorts(&info, std::slice::from_ref(&scene), &[]) {
                assert_eq!(decode_cohorts(&file, &DecodeLimits::none()).expect("a file just written").1, [scene]);
            }
        }
    }
    if let Ok(Opening::Ready(mut archive)) = Archive::open(bytes, &limits) {
        let range =
            |r: std::ops::Range<u64>| bytes.get(r.start as usize..(r.end as usize).min(bytes.len())).unwrap_or(&[]);
        for index in 0..archive.num_cohorts().min(4) {
            let Ok(mut cohort) = archive.open_cohort(index, range(archive.head_range(index))) else { return };
            let layers = cohort.num_layers();
            if cohort.read_shared(range(cohort.shared_range(layers))).is_ok() {
                let last = cohort.num_segments() - 1;
                if let Ok(segment) = cohort.read_segment(last, range(cohort.segment_range(last, layers))) {
                    segment.at(segment.timesteps().start);
                    segment.alive(segment.timesteps().start);
                }
            }
        }
    }
});
