//! Calibrations, descriptions and files of cameras with wrong bytes, and short texts that expand to long ones. Each is
//! read, or refused in one line that names a file.

use std::fs;
use std::path::Path;
use std::time::{Duration, Instant};

use rand::RngExt;
use rand_pcg::Pcg64Mcg;
use tcgs_capture::{Calibration, Capture, CaptureDescription, CaptureError};
use tempfile::tempdir;

/// The seeds of the fuzz target `calibrations`, with the names of their files.
const SEEDS: [(&str, [&str; 2]); 11] = [
    ("opencv", ["intri.yml", "extri.yml"]),
    ("caliscope", ["camera_array.toml", ""]),
    ("aniposelib", ["Calib.toml", ""]),
    ("qualisys", ["a.qca.txt", ""]),
    ("colmap_binary", ["cameras.bin", "images.bin"]),
    ("colmap_text", ["cameras.txt", "images.txt"]),
    ("nerfstudio", ["transforms.json", ""]),
    ("blender", ["transforms_train.json", "transforms_test.json"]),
    ("description", ["capture.toml", ""]),
    ("panoptic", ["train_meta.json", "test_meta.json"]),
    ("technicolor", ["cameras_parameters.txt", ""]),
];

/// A seed without its first byte, which is the format: the length of the first file, and both files.
fn seed(name: &str) -> [Vec<u8>; 2] {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../fuzz/seeds/calibrations").join(name);
    let bytes = fs::read(path).unwrap();
    let length = usize::from(u16::from_le_bytes([bytes[1], bytes[2]]));
    [bytes[3..3 + length].to_vec(), bytes[3 + length..].to_vec()]
}

/// Whether any of its readers can read a file.
fn read(folder: &Path, names: [&str; 2], files: &[Vec<u8>; 2]) -> bool {
    for (name, bytes) in names.iter().zip(files).filter(|(name, _)| !name.is_empty()) {
        fs::write(folder.join(name), bytes).unwrap();
    }
    let path = folder.join(names[0]);
    let begin = Instant::now();
    let results: [Result<(), CaptureError>; 3] = [
        CaptureDescription::read(&path).map(drop),
        Calibration::read(&path).map(drop),
        Capture::open(folder).map(drop),
    ];
    assert!(begin.elapsed() < Duration::from_secs(10), "{names:?}: {:?}", begin.elapsed());
    for message in results.iter().filter_map(|result| result.as_ref().err()).map(ToString::to_string) {
        assert!(message.starts_with(folder.to_str().unwrap()) && !message.contains('\n'), "{message}");
    }
    results.iter().any(Result::is_ok)
}

#[test]
fn files_of_any_bytes_are_read_or_refused() {
    let mut random = Pcg64Mcg::new(9);
    for (name, names) in SEEDS {
        let folder = tempdir().unwrap();
        let whole = seed(name);
        // Captures need images beside their files.
        assert!(read(folder.path(), names, &whole) || ["panoptic", "technicolor"].contains(&name), "{name}");
        for _ in 0..400 {
            let mut files = whole.clone();
            for _ in 0..random.random_range(1..4) {
                let file = &mut files[usize::from(!names[1].is_empty() && random.random())];
                let at = random.random_range(0..file.len());
                let numbers =
                    [&b"1e300"[..], b"-1", b"nan", b"65536", b"99999999999", b"\xff\xff\xff\xff", b"\0\0\0\0"];
                match random.random_range(0..4) {
                    0 => file[at] = random.random(),
                    1 => file[at] ^= 1 << random.random_range(0..8),
                    2 => file.truncate(at + 1),
                    _ => {
                        let new = numbers[random.random_range(0..numbers.len())];
                        let end = (at + new.len()).min(file.len());
                        file.splice(at..end, new.iter().copied());
                    }
                }
            }
            read(folder.path(), names, &files);
        }
    }
}

/// The problem that reading a calibration reports, within the time limit.
#[track_caller]
fn problem(names: [&str; 2], files: [Vec<u8>; 2]) -> String {
    let folder = tempdir().unwrap();
    for (name, bytes) in names.iter().zip(&files).filter(|(name, _)| !name.is_empty()) {
        fs::write(folder.path().join(name), bytes).unwrap();
    }
    let begin = Instant::now();
    let message = Calibration::read(&folder.path().join(names[0])).unwrap_err().to_string();
    assert!(begin.elapsed() < Duration::from_secs(5) && !message.contains('\n'), "{:?} {message}", begin.elapsed());
    message.replace(&format!("{}/", folder.path().display()), "")
}

#[test]
fn few_bytes_that_stand_for_many_are_refused() {
    let [_, poses] = seed("opencv");
    let yaml = |text: String| problem(["intri.yml", "extri.yml"], [text.into_bytes(), poses.clone()]);
    let mut references = String::from("a0: &a0 [x, x, x, x, x, x, x, x]\n");
    for i in 1..12 {
        let list = vec![format!("*a{}", i - 1); 8].join(", ");
        references += &format!("a{i}: &a{i} [{list}]\n");
    }
    assert_eq!(yaml(references), "intri.yml: has a reference, expected matrices of OpenCV");
    let deep = yaml(format!("a: {}", "[".repeat(100)));
    assert!(deep.starts_with("intri.yml: has lists inside lists, more than 8 deep"), "{deep}");
    let deep = yaml((0..2000).map(|depth| format!("{}- \n", " ".repeat(depth))).collect());
    assert!(deep.starts_with("intri.yml: "), "{deep}");

    for name in ["camera_array.toml", "transforms.json"] {
        for deep in ["[".repeat(100_000), format!("[{}a]\n", "a.".repeat(100_000)), "{\"a\":".repeat(100_000)] {
            let message = problem([name, ""], [deep.into_bytes(), Vec::new()]);
            assert!(message.starts_with(&format!("{name}: ")), "{message}");
        }
    }
    let entities = "<!DOCTYPE a [<!ENTITY x \"xxxxxxxx\"><!ENTITY y \"&x;&x;&x;&x;&x;&x;\">]><a>&y;</a>";
    let message = problem(["a.qca.txt", ""], [entities.into(), Vec::new()]);
    assert!(message.starts_with("a.qca.txt: is no XML: "), "{message}");
    let message = problem(["a.qca.txt", ""], ["<a>".repeat(100_000).into_bytes(), Vec::new()]);
    assert!(message.starts_with("a.qca.txt: "), "{message}");
}

#[test]
fn counts_of_a_binary_model_are_bounded_by_its_bytes() {
    let [cameras, images] = seed("colmap_binary");
    for count in [2_u64, 1 << 32, u64::MAX] {
        let mut many = cameras.clone();
        many[..8].copy_from_slice(&count.to_le_bytes());
        let message = problem(["cameras.bin", "images.bin"], [many, images.clone()]);
        assert_eq!(message, "cameras.bin: ends early, expected a whole file of COLMAP");
        // The number of images, and that of the points of the first.
        for at in [0, images.len() - 32] {
            let mut many = images.clone();
            many[at..at + 8].copy_from_slice(&count.to_le_bytes());
            let message = problem(["cameras.bin", "images.bin"], [cameras.clone(), many]);
            assert_eq!(message, "images.bin: ends early, expected a whole file of COLMAP");
        }
    }
}

#[test]
fn a_calibrated_camera_beyond_reach_is_named() {
    let [calibration, _] = seed("aniposelib");
    let text = String::from_utf8(calibration).unwrap();
    let far = text.replace("translation = [1.0", "translation = [1e300");
    let message = problem(["Calib.toml", ""], [far.into_bytes(), Vec::new()]);
    assert_eq!(message, "Calib.toml: [cam_0]: its translation has 1e300, expected 1e12 or less in magnitude");
    let long = text.replace("[[50.0", "[[5e10");
    let message = problem(["Calib.toml", ""], [long.into_bytes(), Vec::new()]);
    assert_eq!(message, "Calib.toml: [cam_0]: its matrix has 5e10, expected 1e6 or less in magnitude");
}
