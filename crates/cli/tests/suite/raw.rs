//! `tcgs prepare` on a folder of videos: its messages, its files, and its skipped steps.

use std::path::Path;
use std::process::Command;

use crate::support::videos::*;
use crate::support::*;
use tcgs_capture::{Capture, Split};
use tempfile::tempdir;

fn entries(folder: &Path) -> Vec<String> {
    let mut names: Vec<String> =
        std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().file_name().to_string_lossy().into()).collect();
    names.sort();
    names
}

#[test]
fn videos_become_a_capture_that_trains() {
    if !has_ffmpeg() {
        return;
    }
    let folder = tempdir().unwrap();
    let (source, offsets) = (videos(&folder, 8), folder.path().join("offsets.txt"));
    let (out, result) = (folder.path().join("capture"), folder.path().join("result.json"));
    let prepare = ["prepare", text(&source), "--out", text(&out), "--points", "3000", "--offsets", text(&offsets)];
    let prepare = [&prepare[..], &["--hold-out", "cam3", "--json", text(&result)]].concat();

    let said = succeed(&[&prepare[..], &["--dry-run"]].concat());
    let steps = ["recordings: ", "calibration: ", "clocks: would", "would be refined", "points: would", "check: would"];
    assert!(steps.iter().all(|step| said.contains(step)) && !out.exists() && !result.exists(), "{said}");

    let said = succeed(&prepare);
    for expected in [
        "recordings: 12 cameras",
        "cam11: h264, 96x72, 6 frames, 20.00 frames a second",
        "calibration: Calib.toml (aniposelib), 12 cameras",
        "cam0 0.100 s, cam1 0.050 s, cam2 0.000 s, cam3 0.100 s",
        "capture: 6 frames at 20.00 a second, 11 cameras for training, 1 held out",
        "triangulated",
        "next: tcgs train",
    ] {
        assert!(said.contains(expected), "{expected:?} in {said}");
    }
    let result = json(&result);
    let keys = ["source", "out", "cameras", "num_frames", "frame_rate", "calibration", "refinement", "colors", "clock"];
    let of_points = ["num_points", "num_foreground", "origins", "agreement", "seconds", "check"];
    assert_keys(&result, &[&keys[..], &of_points].concat());
    assert_eq!((result["clock"].as_str(), result["num_frames"].as_u64()), (Some("file"), Some(6)));

    // All cameras show the same moment, two frames after the first of the ground truth.
    let (capture, truth) = (Capture::open(&out).unwrap(), Capture::open(&folder.path().join("truth")).unwrap());
    let found = capture.views(Split::Test, 0, 1).unwrap().remove(0).image.data;
    let error = |frame: usize| {
        let expected = &truth.views(Split::Train, frame, 1).unwrap()[3].image.data;
        found.iter().zip(expected).map(|(a, b)| (a - b).abs()).sum::<f32>() / found.len() as f32
    };
    let errors = [0, 1, 2, 3, 4].map(error);
    assert!(errors[2] < 0.02, "wrong colours, or another camera: {errors:?}");
    assert!([0, 1, 3, 4].iter().all(|&other| errors[2] < errors[other]), "the wrong frame: {errors:?}");

    // Existing results are not made again; the user's edits stay.
    let description = out.join("capture.toml");
    let mended = std::fs::read_to_string(&description).unwrap().replace("num_frames = 6", "num_frames = 5");
    std::fs::write(&description, &mended).unwrap();
    std::fs::remove_file(out.join("init_pt_cld.npz")).unwrap();
    let said = succeed(&[&prepare[..prepare.len() - 2], &["--json", text(&folder.path().join("2.json"))]].concat());
    assert!(said.contains("cameras and clocks: as") && said.contains("triangulated"), "{said}");
    assert_eq!(std::fs::read_to_string(&description).unwrap(), mended);
    let said = succeed(&prepare[..prepare.len() - 2]);
    assert!(said.contains("points: the capture has some already"), "{said}");

    // Masks need at least eight frames. Existing masks are used, all or none.
    let masked = [&prepare[..prepare.len() - 2], &["--masks", "yes"]].concat();
    let message = fail(2, &masked);
    assert!(message.contains("has 5 frames, expected at least 8 to tell what moves"), "{message}");
    assert!(!out.join("masks").exists() && !Capture::open(&out).unwrap().has_segmentation());
    for (camera, frame) in (0..12).flat_map(|camera| (0..5).map(move |frame| (camera, frame))) {
        let file = out.join(format!("masks/cam{camera}/{frame:06}.png"));
        std::fs::create_dir_all(file.parent().unwrap()).unwrap();
        image::GrayImage::from_fn(96, 72, |x, _| image::Luma([255 * u8::from(x > 40)])).save(file).unwrap();
    }
    let said = succeed(&masked);
    assert!(said.contains("masks: taken as the capture has them"), "{said}");
    let capture = Capture::open(&out).unwrap();
    let mask = capture.views(Split::Test, 4, 1).unwrap().remove(0).segmentation.unwrap();
    assert!(capture.has_segmentation() && capture.facts().labels_motion && mask.foreground[41] && !mask.foreground[40]);
    let missing = out.join("masks/cam7/000003.png");
    std::fs::rename(&missing, folder.path().join("mask.png")).unwrap();
    let problem = Capture::open(&out).unwrap_err().to_string();
    assert!(
        problem.contains("000003.png: no such file, expected masks of all 55 training images or of none"),
        "{problem}"
    );
    std::fs::rename(folder.path().join("mask.png"), &missing).unwrap();

    let run = folder.path().join("run");
    succeed(&["train", text(&out), "--out", text(&run), "--iterations", "30,10", "--backend", "cpu"]);
    succeed(&["eval", text(&run), "--capture", text(&out), "--backend", "cpu"]);
}

#[test]
fn footage_that_cannot_be_prepared_leaves_nothing() {
    if !has_ffmpeg() {
        return;
    }
    let folder = tempdir().unwrap();
    let (source, out) = (videos(&folder, 8), folder.path().join("capture"));
    let before = entries(folder.path());
    let prepare = ["prepare", text(&source), "--out", text(&out)];
    let refused = |more: &[&str]| {
        let message = fail(2, &[&prepare[..], more].concat());
        assert_eq!(message.lines().count(), 1, "{message}");
        assert_eq!(entries(folder.path()), before);
        message
    };
    assert!(refused(&["--from", "100"]).contains("expected a span within"));
    assert!(refused(&["--hold-out", "cam99"]).contains("has no camera cam99 to hold out"));
    assert!(refused(&["--scale", "cam0,cam99,2"]).contains("has no camera cam99"));
    assert!(fail(2, &[&prepare[..], &["--scale", "cam0,cam1"]].concat()).contains("such as cam1,cam5,2.4"));
    assert!(refused(&["--offsets", text(&source.join("Calib.toml"))]).contains("Calib.toml: line 1: "));
    assert!(refused(&["--calibration", text(&source.join("none.toml"))]).contains("none.toml: no such file"));
    let message = fail(2, &["prepare", text(&source), "--points-only", text(&folder.path().join("p.npz"))]);
    assert!(message.contains("is a folder of videos, expected --out CAPTURE"), "{message}");

    let calibration = source.join("Calib.toml");
    let given = std::fs::read_to_string(&calibration).unwrap();
    std::fs::write(&calibration, given.replace("[cam5]", "[cam55]")).unwrap();
    let message = refused(&[]);
    assert!(message.contains("Calib.toml: has no camera cam5, expected one for each recording"), "{message}");
    std::fs::write(&calibration, given.replace("size = [96, 72]", "size = [100, 72]")).unwrap();
    let message = refused(&[]);
    assert!(message.contains("camera cam0: is calibrated at 100x72 pixels, expected 96x72"), "{message}");
    std::fs::remove_file(&calibration).unwrap();
    let output = tcgs().env("PATH", folder.path().join("nowhere")).args(prepare).output().unwrap();
    let message = String::from_utf8(output.stderr).unwrap();
    assert!(
        output.status.code() == Some(2)
            && message.lines().count() == 1
            && message.contains("has no calibration, expected intri.yml")
            && message.contains("--calibration FILE; or the program colmap"),
        "{message}"
    );
    assert_eq!(entries(folder.path()), before);

    // Without ffmpeg only H.264 in MP4 is read.
    std::fs::write(&calibration, given).unwrap();
    let other = source.join("cam3.mp4");
    Command::new("ffmpeg")
        .args(["-v", "error", "-i", text(&other), "-c:v", "mpeg4", text(&source.join("cam3.avi"))])
        .status()
        .unwrap();
    std::fs::remove_file(other).unwrap();
    let output = tcgs().env("PATH", folder.path().join("nowhere")).args(prepare).output().unwrap();
    let message = String::from_utf8(output.stderr).unwrap();
    assert!(
        output.status.code() == Some(2)
            && message.lines().count() == 1
            && message.contains("cam3.avi: is no MP4 file, expected H.264")
            && message.contains("other videos are read by the programs ffmpeg and ffprobe"),
        "{message}"
    );
}

#[test]
fn bad_recordings_are_named_and_leave_nothing() {
    if !has_ffmpeg() {
        return;
    }
    let folder = tempdir().unwrap();
    let (source, out) = (videos(&folder, 8), folder.path().join("capture"));
    let (offsets, before) = (folder.path().join("offsets.txt"), entries(folder.path()));
    let prepare = ["prepare", text(&source), "--out", text(&out), "--offsets", text(&offsets)];
    let refused = |expected: &str| {
        let message = fail(2, &prepare);
        assert!(message.contains(expected), "{message}, expected {expected:?}");
        assert_eq!(entries(folder.path()), before);
    };
    let (spoilt, whole) = (source.join("cam3.mp4"), folder.path().join("truth/whole.mp4"));
    std::fs::rename(&spoilt, &whole).unwrap();

    ffmpeg(&["-f", "lavfi", "-i", "color=black:size=96x72:rate=20:duration=0.4", "-pix_fmt", "yuv420p", text(&spoilt)]);
    refused("cam3.mp4: is black in all frames that were looked at, expected pictures");

    // Truncates a copy. A table of contents at the end is lost; one at the start lists more than the file holds.
    let cut = |options: &[&str]| {
        ffmpeg(&[&["-i", text(&whole), "-c", "copy"], options, &[text(&spoilt)]].concat());
        let bytes = std::fs::read(&spoilt).unwrap();
        std::fs::write(&spoilt, &bytes[..bytes.len() * 2 / 3]).unwrap();
    };
    cut(&[]);
    refused("cam3.mp4: ");
    cut(&["-movflags", "+faststart"]);
    refused("cam3.mp4: ");

    // First three cameras remain, then two, then one.
    std::fs::rename(&whole, &spoilt).unwrap();
    for id in 2..12 {
        std::fs::remove_file(source.join(format!("cam{id}.mp4"))).unwrap();
    }
    std::fs::write(&offsets, "cam0 0\ncam1 0\n").unwrap();
    refused("has 2 cameras for training and no points, expected at least 3");
    std::fs::remove_file(source.join("cam1.mp4")).unwrap();
    refused("has one recording (cam0.mp4), expected one for each of several cameras");
}
