//! Any bytes as a `.4dgs` file. The first four bytes, if they are not 0, are the number of Gaussians that all chunks
//! and their streams claim. A reader refuses a stream whose number differs from that of its chunk.
#![no_main]

mod files;

use libfuzzer_sys::fuzz_target;
use tcgs_interchange::FourdgsFile;

const MAGIC: [u8; 8] = *b"\x894DGS1\r\n";
/// Record of a chunk.
const CHUNK: u8 = 5;

fuzz_target!(|bytes: &[u8]| {
    let Some((count, file)) = bytes.split_first_chunk::<4>() else { return };
    let mut file = file.to_vec();
    if *count != [0; 4] {
        claim(&mut file, *count);
    }
    if !file.ends_with(&MAGIC) {
        file.extend(MAGIC);
    }
    if let Ok(mut scene) = files::read("a.4dgs", &file, |path| FourdgsFile::open(path, files::settings())) {
        files::check_scene(&mut scene);
    }
});

/// Writes a number of Gaussians into every chunk and stream.
fn claim(file: &mut [u8], count: [u8; 4]) {
    let length = |file: &[u8], at: usize| {
        let bytes = file.get(at..at + 8)?.try_into().ok()?;
        usize::try_from(u64::from_le_bytes(bytes)).ok().filter(|&length| length < file.len())
    };
    let mut at = MAGIC.len();
    while let Some(content) = length(file, at + 1) {
        let end = (at + 9 + content).min(file.len());
        if file[at] == CHUNK && at + 53 <= end {
            file[at + 29..at + 33].copy_from_slice(&count);
            let mut stream = at + 53;
            while stream + 17 <= end {
                file[stream + 5..stream + 9].copy_from_slice(&count);
                let Some(payload) = length(file, stream + 9) else { break };
                stream += 17 + payload;
            }
        }
        at = end;
    }
}
