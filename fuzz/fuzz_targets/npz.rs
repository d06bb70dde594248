//! Any bytes as the arrays of an archive with valid checksums, and as an archive.
//!
//! An array is two bytes of length, a byte for the packing, a byte for the number of zeros behind it, and its bytes.
#![no_main]

mod files;

use std::io::{Cursor, Write};

use libfuzzer_sys::fuzz_target;
use tcgs_interchange::{NpzReader, ParamsNpz, read_npy};
use zip::{CompressionMethod, ZipWriter, write::SimpleFileOptions};

const NAMES: [&str; 7] =
    ["means3D", "rgb_colors", "unnorm_rotations", "logit_opacities", "log_scales", "seg_colors", "data"];

fuzz_target!(|bytes: &[u8]| {
    read(bytes);
    let _ = files::read("a.npy", bytes, read_npy);
    let mut archive = ZipWriter::new(Cursor::new(Vec::new()));
    let mut rest = bytes;
    for name in NAMES {
        let Some((&[low, high, packing, zeros], behind)) = rest.split_first_chunk::<4>() else { break };
        let (array, behind) = behind.split_at(usize::from(u16::from_le_bytes([low, high])).min(behind.len()));
        rest = behind;
        let method = if packing % 2 == 0 { CompressionMethod::Stored } else { CompressionMethod::Deflated };
        let options = SimpleFileOptions::default().compression_method(method);
        archive.start_file(format!("{name}.npy"), options).expect("memory");
        archive.write_all(array).and_then(|()| archive.write_all(&files::zeros(zeros))).expect("memory");
    }
    read(&archive.finish().expect("memory").into_inner());
});

fn read(archive: &[u8]) {
    let arrays = files::read("a.npz", archive, |path| {
        let mut npz = NpzReader::open_with(path, files::LIMITS)?;
        let names: Vec<String> = npz.array_names().take(NAMES.len()).collect();
        // A caller may keep all.
        Ok(names.iter().map(|name| npz.array(name).ok()).collect::<Vec<_>>())
    });
    drop(arrays);
    if let Ok(mut scene) = files::read("a.npz", archive, |path| ParamsNpz::open(path, files::LIMITS)) {
        files::check_scene(&mut scene);
    }
}
