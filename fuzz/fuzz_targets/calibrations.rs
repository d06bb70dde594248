//! Any bytes as a calibration, a description or the cameras of a capture: read or refused in a line that names a file.
#![no_main]

use std::error::Error;
use std::fs;
use std::path::Path;

use libfuzzer_sys::fuzz_target;
use tcgs_capture::{Calibration, Capture, CaptureDescription};
use tcgs_prepare::Clocks;

/// The files of a format: the first and the second part of the input.
const FORMATS: [[&str; 2]; 11] = [
    ["intri.yml", "extri.yml"],
    ["camera_array.toml", ""],
    ["Calib.toml", ""],
    ["a.qca.txt", ""],
    ["cameras.bin", "images.bin"],
    ["cameras.txt", "images.txt"],
    ["transforms.json", ""],
    ["transforms_train.json", "transforms_test.json"],
    ["capture.toml", ""],
    ["train_meta.json", "test_meta.json"],
    ["cameras_parameters.txt", ""],
];

fn look<T>(result: Result<T, impl Error>, folder: &Path) {
    if let Err(error) = result {
        let message = error.to_string();
        assert!(message.starts_with(folder.to_str().expect("a name in UTF-8")), "{message}");
        assert!(!message.contains('\n'), "{message}");
    }
}

// A format, the length of the first file in two bytes, and both files.
fuzz_target!(|bytes: &[u8]| {
    let [format, low, high, files @ ..] = bytes else { return };
    let names = FORMATS[usize::from(*format) % FORMATS.len()];
    let (first, second) = files.split_at(usize::from(u16::from_le_bytes([*low, *high])).min(files.len()));
    // Readers take paths. One folder a process.
    let folder = std::env::temp_dir().join(format!("tcgs-fuzz-{}", std::process::id()));
    let _ = fs::remove_dir_all(&folder);
    fs::create_dir_all(&folder).expect("a temporary folder");
    for (name, bytes) in names.into_iter().zip([first, second]).filter(|(name, _)| !name.is_empty()) {
        fs::write(folder.join(name), bytes).expect("a temporary file");
    }
    let path = folder.join(names[0]);
    look(CaptureDescription::read(&path), &folder);
    look(Clocks::read(&path, &["a".into(), "b".into()]), &folder);
    look(Calibration::read(&path), &folder);
    look(Capture::open(&folder), &folder);
    let _ = fs::remove_dir_all(&folder);
});
