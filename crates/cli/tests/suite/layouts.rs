//! Captures of every layout, from the folder to the numbers of `tcgs eval`.

use std::fs;
use std::path::Path;

use crate::support::*;
use serde_json::json;
use tcgs_capture::{Capture, Split, SyntheticSettings, write_synthetic};
use tcgs_core::{Camera, View};
use tempfile::{TempDir, tempdir};

/// Trains a little and evaluates on the held-out cameras.
///
/// - returns: the output, and the mean PSNR
fn train_and_judge(capture: &Path, more: &[&str]) -> (String, f64) {
    let folder = tempdir().unwrap();
    let (run, result) = (folder.path().join("run"), folder.path().join("eval.json"));
    let said = succeed(&[&["train", text(capture), "--out", text(&run), "--backend", "cpu"], more].concat());
    succeed(&["eval", text(&run), "--capture", text(capture), "--json", text(&result)]);
    (said, json(&result)["psnr"].as_f64().unwrap())
}

/// The synthetic capture with 16 cameras, one of them held out, without masks.
fn synthetic() -> TempDir {
    let folder = tempdir().unwrap();
    let settings = SyntheticSettings { num_train_cameras: 15, num_timesteps: 2, num_points: 3000, ..SETTINGS };
    write_synthetic(folder.path(), &settings).unwrap();
    fs::remove_dir_all(folder.path().join("seg")).unwrap();
    folder
}

/// Its images of one frame, that of the held-out camera at index 10.
fn views(capture: &Capture, frame: usize) -> Vec<View> {
    let mut views = capture.views(Split::Train, frame, 1).unwrap();
    views.insert(10, capture.views(Split::Test, frame, 1).unwrap().remove(0));
    views
}

fn save(view: &View, path: &Path) {
    fs::create_dir_all(path.parent().unwrap()).unwrap();
    let (width, height) = (view.image.width as u32, view.image.height as u32);
    image::save_buffer(path, &view.image.to_rgb8(), width, height, image::ColorType::Rgb8).unwrap();
}

/// `transforms.json`, an image a frame and camera.
fn as_nerfstudio(capture: &Capture, folder: &Path) {
    let (mut frames, mut held_out) = (Vec::new(), Vec::new());
    for t in 0..capture.num_frames() {
        for (i, view) in views(capture, t).iter().enumerate() {
            let name = format!("images/{t:03}_{i:02}.png");
            save(view, &folder.join(&name));
            let Camera { camera_from_world: m, focal, principal, width, height } = &view.camera;
            let center = view.camera.center();
            let row = |j: usize| json!([m[0][j], -m[1][j], -m[2][j], center[j]]);
            frames.push(json!({
                "file_path": name, "time": t, "transform_matrix": [row(0), row(1), row(2), [0.0, 0.0, 0.0, 1.0]],
                "w": width, "h": height, "fl_x": focal[0], "fl_y": focal[1], "cx": principal[0], "cy": principal[1],
            }));
            if i == 10 {
                held_out.push(name);
            }
        }
    }
    let transforms = json!({ "frames": frames, "test_filenames": held_out });
    fs::write(folder.join("transforms.json"), transforms.to_string()).unwrap();
}

/// `cameras_parameters.txt`, an image a frame and camera.
fn as_technicolor(capture: &Capture, folder: &Path) {
    let mut lines = String::from("f cu cv ar sk qw qx qy qz tx ty tz\n");
    for t in 0..capture.num_frames() {
        for (i, view) in views(capture, t).iter().enumerate() {
            save(view, &folder.join(format!("Room_undist_{t:05}_{i:02}.png")));
            if t == 0 {
                let Camera { camera_from_world: m, focal, principal, .. } = &view.camera;
                // No camera of the room is turned by half a turn, so that w is not small.
                let w = (1.0 + m[0][0] + m[1][1] + m[2][2]).sqrt() / 2.0;
                assert!(w > 0.1, "{w}");
                let [x, y, z] = [[2, 1], [0, 2], [1, 0]].map(|[i, j]| (m[i][j] - m[j][i]) / (4.0 * w));
                let [tx, ty, tz] = [0, 1, 2].map(|i| m[i][3]);
                lines +=
                    &format!("{} {} {} 1 0 {w} {x} {y} {z} {tx} {ty} {tz}\n", focal[0], principal[0], principal[1]);
            }
        }
    }
    fs::write(folder.join("cameras_parameters.txt"), lines).unwrap();
}

#[test]
fn the_layout_does_not_matter() {
    let source = synthetic();
    let capture = Capture::open(source.path()).unwrap();
    let weights = ["floor=0", "background=0", "segmentation=0", "stillness=0.5"].map(|of| format!("weights.{of}"));
    let weights: Vec<&str> = weights.iter().flat_map(|set| ["--set", set]).collect();
    let iterations = ["--iterations", "120,30"];
    let (said, psnr) = train_and_judge(source.path(), &[&iterations[..], &weights].concat());
    assert!(said.contains("panoptic capture: 15 cameras (held out: "), "{said}");
    assert!(psnr > 18.0, "{psnr} dB");
    for (name, write) in [("nerfstudio", as_nerfstudio as fn(&Capture, &Path)), ("technicolor", as_technicolor)] {
        let folder = tempdir().unwrap();
        write(&capture, folder.path());
        let points = source.path().join("init_pt_cld.npz");
        let more = [&iterations[..], &["--points", text(&points)]].concat();
        let (said, found) = train_and_judge(folder.path(), &more);
        assert!(
            said.contains(&format!("{name} capture: 15 cameras (held out: 10), frames 0..2, 48x36 pixels")),
            "{said}"
        );
        // Cameras differ in their last bits.
        assert!((found - psnr).abs() < 0.2, "{name}: {found} dB, as Panoptic Sports {psnr} dB");
    }
}

#[test]
fn a_cameras_images_may_change_their_size() {
    let source = synthetic();
    let folder = tempdir().unwrap();
    as_nerfstudio(&Capture::open(source.path()).unwrap(), folder.path());
    let (file, run) = (folder.path().join("transforms.json"), folder.path().join("run"));
    let mut transforms = json(&file);
    for frame in transforms["frames"].as_array_mut().unwrap().iter_mut().filter(|frame| frame["time"] == 1) {
        // Pincushion distortion: undistorted images are smaller.
        frame["k1"] = json!(0.2);
    }
    fs::write(&file, transforms.to_string()).unwrap();
    succeed(&["train", text(source.path()), "--out", text(&run), "--iterations", "10,5", "--backend", "cpu"]);
    let result = folder.path().join("eval.json");
    succeed(&["eval", text(&run), "--capture", text(folder.path()), "--json", text(&result)]);
    let found = json(&result);
    assert!(found["psnr"].is_f64() && found["flicker"].is_null(), "{found}");
}

#[test]
fn the_papers_settings_follow_the_layout() {
    let source = synthetic();
    let folder = tempdir().unwrap();
    as_technicolor(&Capture::open(source.path()).unwrap(), folder.path());
    let message = fail(2, &["train", text(folder.path()), "--out", text(&folder.path().join("run"))]);
    assert!(message.contains("has no initial points") && message.contains("--points FILE"), "{message}");
    let points = source.path().join("init_pt_cld.npz");
    let train = |preset: &str| {
        let run = folder.path().join(preset);
        let iterations = ["--iterations", "10,5", "--frames", "0..1", "--preset", preset];
        succeed(
            &[&["train", text(folder.path()), "--out", text(&run), "--points", text(&points)], &iterations[..]]
                .concat(),
        );
        run
    };
    let run = train("paper");
    let config = tcgs_train::Run::open(&run).unwrap().config().clone();
    assert_eq!((config.data.layout.as_str(), config.rates.log_scale), ("technicolor", 0.005));
    assert_eq!((config.weights.floor, config.weights.segmentation, config.weights.background), (0.0, 0.0, 0.0));
    assert_eq!(config.data.points, text(&points.canonicalize().unwrap()));
    assert_eq!(config.weights.stillness, 0.0);
    let config = tcgs_train::Run::open(&train("default")).unwrap().config().clone();
    assert_eq!((config.rates.log_scale, config.weights.stillness), (0.001, 0.5));
    succeed(&["compress", text(&run), "--preset", "paper"]);
    // A resumed run uses its own points.
    let more = ["--resume", "--frames", "0..2"];
    succeed(&[&["train", text(folder.path()), "--out", text(&run)], &more[..]].concat());
    let wrong = folder.path().join("cameras_parameters.txt");
    let other = ["--resume", "--points", text(&wrong)];
    let message = fail(2, &[&["train", text(folder.path()), "--out", text(&run)], &other[..]].concat());
    assert!(message.contains("data.points differs from the run's"), "{message}");
}

/// Disables pruning, so that so few iterations leave something visible.
const KEEP: [&str; 5] = ["--no-mask", "--set", "densify.prune_opacity_end=0.005", "--set", "densify.reset=1000000"];

#[test]
fn kitchen_trains() {
    let Some(path) = shared("data/kitchen") else { return };
    let (said, psnr) = train_and_judge(
        &path,
        &[&["--downscale", "8", "--frames", "0..2", "--iterations", "60,20"], &KEEP[..]].concat(),
    );
    assert!(said.contains("neural3d capture: 18 cameras (held out: cam00), frames 0..2, 84x63 pixels"), "{said}");
    assert!(psnr > 27.0, "{psnr} dB");
}

#[test]
fn beercan_trains() {
    let Some(path) = shared("data/beercan_colmap") else { return };
    let (said, psnr) = train_and_judge(&path, &[&["--downscale", "8", "--iterations", "150,1"], &KEEP[..]].concat());
    assert!(
        said.contains(
            "colmap capture: 62 cameras (held out: 0000, 0008, 0016, 0024, 0032, 0040, 0048, 0056, 0064), frames 0..1"
        ),
        "{said}"
    );
    assert!(psnr > 20.5, "{psnr} dB");
}

#[test]
fn temple_trains() {
    let Some(path) = shared("data/temple_sparse_ring") else { return };
    let folder = tempdir().unwrap();
    let points = folder.path().join("points.ply");
    write_box(&points);
    let more = ["--points", text(&points), "--downscale", "8", "--iterations", "150,1"];
    let (said, psnr) = train_and_judge(&path, &[&more[..], &KEEP].concat());
    assert!(
        said.contains(
            "middlebury capture: 14 cameras (held out: templeSR0001, templeSR0009), frames 0..1, 80x60 pixels"
        ),
        "{said}"
    );
    assert!(psnr > 18.5, "{psnr} dB");
}

/// Grey points all over the bounding box in the temple's README.
fn write_box(path: &Path) {
    const NUM_POINTS: usize = 4000;
    let (low, high) = ([-0.073568, 0.021728, -0.012445], [0.028855, 0.181892, 0.062736]);
    let mut ply = format!("ply\nformat ascii 1.0\nelement vertex {NUM_POINTS}\n");
    for axis in ["x", "y", "z"] {
        ply += &format!("property float {axis}\n");
    }
    ply += "end_header\n";
    for i in 0..NUM_POINTS {
        // Irrational steps spread points evenly (Roberts 2018, the R3 sequence).
        let unit = [0.819_172_513_396, 0.671_043_606_703, 0.549_700_477_901].map(|step: f64| (i as f64 * step).fract());
        let [x, y, z]: [f64; 3] = std::array::from_fn(|j| low[j] + unit[j] * (high[j] - low[j]));
        ply += &format!("{x} {y} {z}\n");
    }
    fs::write(path, ply).unwrap();
}
