//! Values that no kind of capture may accept: frame rates without a meaning, and names that lead out of the folder.

use std::fs;
use std::path::Path;

use crate::support::{Small, problem};
use serde_json::json;
use tcgs_capture::CaptureKind;
use tempfile::TempDir;

/// Row by row: `world_from_camera` and `camera_from_world` of a camera at the origin.
const IDENTITY: [[f64; 4]; 4] =
    [[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]];

fn folder(files: &[(&str, String)]) -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    for (name, text) in files {
        let path = folder.path().join(name);
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(path, text).unwrap();
    }
    folder
}

fn transforms(image: &str, fps: &str, points: &str) -> TempDir {
    let frame = json!({ "file_path": image, "transform_matrix": IDENTITY });
    let (image, points) = (frame.to_string(), json!(points).to_string());
    let text =
        format!(r#"{{"w": 4, "h": 4, "fl_x": 4, "fps": {fps}, "ply_file_path": {points}, "frames": [{image}]}}"#);
    folder(&[("transforms.json", text)])
}

fn described(file: &str, frame_rate: &str) -> TempDir {
    let text = format!(
        "version = 1\nframe_rate = {frame_rate}\nnum_frames = 1\n[[camera]]\nid = 0\nname = \"a\"\nfile = {file:?}\n\
         size = [4, 4]\nfocal = [4, 4]\nprincipal = [2, 2]\n\
         camera_from_world = [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0]]\n"
    );
    folder(&[("capture.toml", text)])
}

/// A capture whose files have the frame rate `fps`; `None` for kinds whose files have none. A video of Neural 3D Video
/// has a duration, from which no rate but a positive one can follow.
fn with_fps(kind: CaptureKind, fps: &str) -> Option<(TempDir, &'static str)> {
    match kind.name {
        "panoptic" => {
            let small = Small::new();
            small.write();
            let meta = small.path().join("train_meta.json");
            let text = fs::read_to_string(&meta).unwrap();
            fs::write(meta, text.replacen('{', &format!("{{\"fps\": {fps}, "), 1)).unwrap();
            Some((small.folder, "train_meta.json"))
        }
        "nerfstudio" => Some((transforms("a.png", fps, "a.ply"), "transforms.json")),
        // TOML has numbers that JSON has not, and the field another name: tested below.
        "described" => None,
        "neural3d" | "technicolor" | "colmap" | "middlebury" => None,
        other => panic!("{other:?} is new: does a file of it have a frame rate?"),
    }
}

/// A capture whose files name the image `name`; `None` for kinds whose images are found by listing a folder.
fn with_image(kind: CaptureKind, name: &str) -> Option<(TempDir, &'static str)> {
    match kind.name {
        "panoptic" => {
            let mut small = Small::new();
            small.train_meta["fn"][1][2] = json!(name);
            small.write();
            Some((small.folder, "train_meta.json"))
        }
        "nerfstudio" => Some((transforms(name, "30", "a.ply"), "transforms.json")),
        "colmap" => {
            let images = format!("1 1 0 0 0 0 0 0 1 {name}\n\n");
            let files = [
                ("sparse/0/cameras.txt", "1 PINHOLE 4 4 4 4 2 2\n".into()),
                ("sparse/0/images.txt", images),
                ("sparse/0/points3D.txt", String::new()),
                ("images/a.png", String::new()),
            ];
            Some((folder(&files), "sparse/0/images.txt"))
        }
        "middlebury" => {
            let line = format!("1\n{name} 4 0 2 0 4 2 0 0 1 1 0 0 0 1 0 0 0 1 0 0 0\n");
            Some((folder(&[("a_par.txt", line)]), "a_par.txt"))
        }
        "described" => Some((described(name, "30"), "capture.toml")),
        "neural3d" | "technicolor" => None,
        other => panic!("{other:?} is new: does a file of it name images?"),
    }
}

#[track_caller]
fn check(capture: &Path, file: &str, found: &str, expected: &str) {
    let message = problem(capture);
    assert!(message.starts_with(&format!("{file}: ")), "{message}");
    assert!(message.contains(found) && message.contains(&format!("expected {expected}")), "{message}");
}

#[test]
fn a_frame_rate_without_a_meaning_is_refused() {
    let mut num_checked = 0;
    for kind in CaptureKind::ALL {
        for fps in ["0", "-25", "-0.0"] {
            let Some((capture, file)) = with_fps(kind, fps) else { continue };
            let found = format!("fps is {}", fps.trim_end_matches(".0"));
            check(capture.path(), file, &found, "more than 0");
            num_checked += 1;
        }
        // Python writes these into JSON, which has none of them.
        for fps in ["NaN", "Infinity", "-Infinity"] {
            let Some((capture, file)) = with_fps(kind, fps) else { continue };
            check(capture.path(), file, fps, "a finite number");
            num_checked += 1;
        }
    }
    assert_eq!(num_checked, 2 * 6);
}

#[test]
fn a_described_frame_rate_without_a_meaning_is_refused() {
    for (written, found) in [("0.0", "0"), ("-25", "-25"), ("nan", "NaN"), ("inf", "inf"), ("-inf", "-inf")] {
        let capture = described("a", written);
        check(capture.path(), "capture.toml", &format!("frame_rate is {found}"), "more than 0");
    }
}

#[test]
fn a_name_that_leads_out_of_the_folder_is_refused() {
    // The file exists: the path to it is refused.
    let outside = tempfile::tempdir().unwrap();
    let secret = outside.path().join("secret.png");
    fs::write(&secret, "x").unwrap();
    let mut num_checked = 0;
    for kind in CaptureKind::ALL {
        for name in ["../secret.png", "1/../../secret.png", ".", secret.to_str().unwrap()] {
            let Some((capture, file)) = with_image(kind, name) else { continue };
            check(capture.path(), file, &format!("is {name:?}"), "the path of a file inside ");
            num_checked += 1;
        }
    }
    assert_eq!(num_checked, 5 * 4);
    for points in ["../points.ply", "/points.ply"] {
        let capture = transforms("a.png", "30", points);
        let found = format!("ply_file_path is {points:?}");
        check(capture.path(), "transforms.json", &found, "the path of a file inside the capture");
    }
}
