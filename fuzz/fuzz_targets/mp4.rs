//! Any bytes as an MP4 file: its tables are read or refused, in little memory, and what they list lies in order.
#![no_main]

use std::io::{BufReader, Cursor};

use libfuzzer_sys::fuzz_target;

// The rest of the crate has a decoder in C++, which is slow to build with sanitizers.
#[allow(dead_code)]
#[path = "../../crates/capture/src/video/mp4/mod.rs"]
mod mp4;

fuzz_target!(|bytes: &[u8]| {
    match mp4::read(BufReader::new(Cursor::new(bytes)), bytes.len() as u64) {
        Ok(Some(track)) => {
            assert!(track.samples.len() <= 1 << 21 && (track.avc.is_some() || track.samples.is_empty()));
            assert!(track.samples.iter().all(|sample| sample.bytes.start <= sample.bytes.end));
        }
        Ok(None) => {}
        Err(mp4::Mp4Error::Format(problem)) => assert!(!problem.contains('\n'), "{problem}"),
        Err(mp4::Mp4Error::Io(error)) => panic!("{error} of bytes in memory"),
    }
});
