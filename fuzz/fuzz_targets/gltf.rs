//! Any bytes as a glTF file: as they are, and as the JSON and, behind a zero, the buffer of a `.glb` file.
#![no_main]

mod files;

use libfuzzer_sys::fuzz_target;
use tcgs_interchange::read_gaussians;

fuzz_target!(|bytes: &[u8]| {
    let read = |name: &str, bytes: &[u8]| {
        if let Ok(gaussians) = files::read(name, bytes, |path| read_gaussians(path, files::settings())) {
            files::check(&gaussians);
        }
    };
    read("a.gltf", bytes);
    let Some(end) = bytes.iter().position(|&byte| byte == 0) else { return };
    let (json, buffer) = (&bytes[..end], &bytes[end + 1..]);
    let chunk = |kind: &[u8; 4], content: &[u8]| [&(content.len() as u32).to_le_bytes()[..], kind, content].concat();
    read("a.glb", &[&b"glTF\x02\0\0\0\0\0\0\0"[..], &chunk(b"JSON", json), &chunk(b"BIN\0", buffer)].concat());
});
