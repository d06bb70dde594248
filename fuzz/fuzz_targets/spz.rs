//! Any bytes as the content of an SPZ file, packed as its version asks for, with valid checksums. Zeros behind them
//! make a bomb.
//!
//! The first byte is the number of zeros, the second the packing: none, gzip, or Zstandard frames.
#![no_main]

mod files;

use std::io::Write;

use flate2::{Compression, write::GzEncoder};
use libfuzzer_sys::fuzz_target;
use tcgs_interchange::read_gaussians;

/// Length of the header of version 4.
const HEADER: usize = 32;
const BLOCK: usize = 1 << 17;

fuzz_target!(|bytes: &[u8]| {
    let Some((&[zeros, packing], content)) = bytes.split_first_chunk::<2>() else { return };
    let content = [content, &files::zeros(zeros)].concat();
    let packed = match packing % 3 {
        0 => content,
        1 => {
            let mut gzip = GzEncoder::new(Vec::new(), Compression::fast());
            gzip.write_all(&content).expect("memory");
            gzip.finish().expect("memory")
        }
        _ => version_4(&content),
    };
    if let Ok(gaussians) = files::read("a.spz", &packed, |path| read_gaussians(path, files::settings())) {
        files::check(&gaussians);
    }
});

/// The header as it is, a table that is right, and the rest in as many frames as the header says.
fn version_4(content: &[u8]) -> Vec<u8> {
    if content.len() < HEADER {
        return content.to_vec();
    }
    let (header, mut rest) = content.split_at(HEADER);
    let num_gaussians = u32::from_le_bytes([header[8], header[9], header[10], header[11]]) as usize;
    let harmonics = 3 * ((usize::from(header[12]) + 1).pow(2) - 1);
    let (mut table, mut frames) = (Vec::new(), Vec::new());
    for row in [9, 1, 3, 3, 4, harmonics].into_iter().filter(|row| *row > 0) {
        let length = row * num_gaussians;
        let (own, behind) = rest.split_at(length.min(rest.len()));
        rest = behind;
        // Missing bytes are zeros, of a few megabytes at most.
        let frame = frame(own, (length - own.len()).min(8 << 20));
        table.extend([frame.len() as u64, length as u64].map(u64::to_le_bytes).concat());
        frames.extend(frame);
    }
    [header, &table, &frames].concat()
}

/// A Zstandard frame of bytes as they are, then of zeros.
fn frame(bytes: &[u8], zeros: usize) -> Vec<u8> {
    let mut frame = b"\x28\xB5\x2F\xFD\x00\x38".to_vec();
    let mut block = |kind: u32, size: usize, content: &[u8], last: bool| {
        let head = u32::from(last) | kind << 1 | (size as u32) << 3;
        frame.extend(&head.to_le_bytes()[..3]);
        frame.extend(content);
    };
    bytes.chunks(BLOCK).for_each(|chunk| block(0, chunk.len(), chunk, false));
    (0..zeros).step_by(BLOCK).for_each(|at| block(1, (zeros - at).min(BLOCK), &[0], false));
    block(0, 0, &[], true);
    frame
}
