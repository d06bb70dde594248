//! `tcgs prepare`: a capture without points gets some, and the check has its exit codes.

use std::path::{Path, PathBuf};

use crate::support::*;
use tcgs_capture::{Capture, SyntheticSettings, write_synthetic};
use tempfile::{TempDir, tempdir};

/// A capture with points and enough texture for the check.
fn footage(folder: &TempDir) -> PathBuf {
    let path = folder.path().join("footage");
    let settings = SyntheticSettings { num_timesteps: 2, ..SyntheticSettings::default() };
    write_synthetic(&path, &settings).unwrap();
    path
}

fn points(path: &Path) -> PathBuf {
    path.join("init_pt_cld.npz")
}

#[test]
fn footage_becomes_a_capture_that_trains() {
    let folder = tempdir().unwrap();
    let source = footage(&folder);
    std::fs::remove_file(points(&source)).unwrap();
    let (out, result) = (folder.path().join("capture"), folder.path().join("result.json"));
    let prepare = ["prepare", text(&source), "--out", text(&out), "--points", "4000"];
    let said = succeed(&[&prepare[..], &["--json", text(&result), "--threads", "2"]].concat());
    assert!(said.contains("triangulated") && said.contains("next: tcgs train"), "{said}");
    assert!(
        said.contains("% of the points have no measured depth: expect good pictures between the cameras"),
        "{said}"
    );

    let result = json(&result);
    let expected = ["source", "out", "num_points", "num_foreground", "origins", "agreement", "seconds", "check"];
    assert_keys(&result, &expected);
    assert_eq!(result["check"]["healthy"], true);
    let page = std::fs::read_to_string(out.join("check.html")).unwrap();
    let images = page.matches("data:image/jpeg;base64,").count();
    assert!(page.contains("healthy, 14 cameras fit") && images == 3 * 14, "{images}");
    assert_keys(&result["origins"], &["triangulated", "hull", "filled", "shell"]);
    let cloud = Capture::open(&out).unwrap().point_cloud().unwrap();
    let foreground = cloud.foreground.iter().filter(|&&foreground| foreground).count();
    assert_eq!(
        (result["num_points"].as_u64(), result["num_foreground"].as_u64()),
        (Some(cloud.points.len() as u64), Some(foreground as u64))
    );
    assert!((2000..5000).contains(&cloud.points.len()) && foreground > 300, "{result}");
    assert!(!points(&source).exists(), "the source is not touched");

    // The command replaces only its own output, and only with --force. The bytes do not depend on the number of
    // threads.
    let before = std::fs::read(points(&out)).unwrap();
    fail(2, &prepare);
    succeed(&[&prepare[..], &["--force", "--threads", "1"]].concat());
    assert_eq!(std::fs::read(points(&out)).unwrap(), before);
    std::fs::create_dir(out.join("run")).unwrap();
    let message = fail(2, &[&prepare[..], &["--force"]].concat());
    assert!(message.contains("run: is neither of the source nor of prepare"), "{message}");
    std::fs::remove_dir(out.join("run")).unwrap();
    let other = folder.path().join("other");
    std::fs::create_dir(&other).unwrap();
    std::fs::write(other.join("diary.txt"), "x").unwrap();
    let message = fail(2, &["prepare", text(&source), "--out", text(&other), "--force"]);
    assert!(message.contains("was not made by prepare"), "{message}");

    let run = folder.path().join("run");
    succeed(&["train", text(&out), "--out", text(&run), "--iterations", "30,10", "--backend", "cpu"]);
}

#[test]
fn points_may_be_written_alone() {
    let folder = tempdir().unwrap();
    let (source, file) = (footage(&folder), folder.path().join("points.npz"));
    let said = succeed(&["prepare", text(&source), "--points-only", text(&file), "--points", "3000"]);
    assert!(said.contains("the points that the source has are not used"), "{said}");
    std::fs::rename(&file, points(&source)).unwrap();
    assert!(Capture::open(&source).unwrap().point_cloud().unwrap().points.len() > 1500);
    // Cameras that are left out of the points are left out of the training too.
    let arguments = ["prepare", text(&source), "--points-only", text(&file), "--hold-out", "2,5", "--points", "1000"];
    let said = succeed(&arguments);
    assert!(said.contains("--hold-out 2,5 --out"), "{said}");
    assert!(fail(2, &[&arguments[..], &["--force", "--hold-out", "99"]].concat()).contains("has no camera 99"));
    let out = folder.path().join("capture");
    let message = fail(2, &["prepare", text(&source), "--out", text(&out), "--hold-out", "2"]);
    assert!(message.contains("hold_out: is given for a capture, expected a folder of videos"), "{message}");
}

#[test]
fn what_cannot_be_prepared_is_named() {
    let folder = tempdir().unwrap();
    let source = footage(&folder);
    let inside = source.join("capture");
    let refuse = |arguments: &[&str], expected: &[&str]| {
        let message = fail(2, &[&["prepare"], arguments].concat());
        assert!(expected.iter().all(|part| message.contains(part)), "{arguments:?}: {message}");
    };
    refuse(&[text(&source)], &["--out <CAPTURE>", "--points-only <FILE>", "--check"]);
    refuse(&[text(&source), "--check", "--out", "x"], &["cannot be used with"]);
    refuse(&[text(&source), "--out", "x", "--sheet", "y.png"], &["cannot be used with"]);
    refuse(&[text(&source), "--out", text(&inside)], &["lies in", "expected a place outside the source"]);
    refuse(&[text(&source), "--points-only", "points.xyz"], &["points.xyz", "expected NAME.npz"]);
    let empty = folder.path().join("empty");
    std::fs::create_dir(&empty).unwrap();
    refuse(&[text(&empty), "--out", "x"], &["empty: no videos here, expected one for each camera"]);
    refuse(&[text(&empty), "--out", "x", "--fps", "30"], &["empty: no videos here"]);
    // A dry run reports the errors of the real run.
    let taken = folder.path().join("taken");
    std::fs::create_dir(&taken).unwrap();
    std::fs::write(taken.join("diary.txt"), "x").unwrap();
    refuse(&[text(&source), "--out", text(&taken), "--dry-run"], &["taken: exists already"]);
    refuse(&[text(&source), "--out", "nowhere/x", "--dry-run"], &["nowhere: no such folder"]);
    assert_eq!(std::fs::read_dir(&taken).unwrap().count(), 1);
    refuse(&["nowhere", "--check"], &["nowhere", "no such folder"]);
    assert!(!inside.exists() && !Path::new("x").exists());

    let mut meta = json(&source.join("train_meta.json"));
    for key in ["k", "w2c", "fn", "cam_id"] {
        meta[key].as_array_mut().unwrap().iter_mut().for_each(|cameras| cameras.as_array_mut().unwrap().truncate(2));
    }
    std::fs::write(source.join("train_meta.json"), meta.to_string()).unwrap();
    let out = folder.path().join("capture");
    refuse(&[text(&source), "--out", text(&out)], &["has 2 training cameras, expected at least 3"]);
    assert!(!out.exists());
}

#[test]
fn the_doctor_says_healthy_or_what_is_wrong() {
    let folder = tempdir().unwrap();
    let (source, sheet, page) = (footage(&folder), folder.path().join("check.png"), folder.path().join("check.html"));
    let said = succeed(&["prepare", "--check", text(&source)]);
    assert!(said.contains("healthy, 14 cameras fit"), "{said}");

    let mut meta = json(&source.join("train_meta.json"));
    meta["fn"].as_array_mut().unwrap().iter_mut().for_each(|names| names.as_array_mut().unwrap().swap(1, 9));
    std::fs::write(source.join("train_meta.json"), meta.to_string()).unwrap();
    let result = folder.path().join("result.json");
    let files = ["--sheet", text(&sheet), "--page", text(&page), "--json", text(&result)];
    let output = run(&[&["prepare", text(&source), "--check"], &files[..]].concat());
    let (said, complaint) = (String::from_utf8(output.stdout).unwrap(), String::from_utf8(output.stderr).unwrap());
    assert_eq!(output.status.code(), Some(1), "{complaint}");
    assert!(said.contains("the image is what is seen from another camera's place"), "{said}");
    assert!(complaint.contains("1 finding, expected a healthy capture"), "{complaint}");
    let result = json(&result);
    assert_keys(&result, &["capture", "healthy", "undecided", "made_points", "measured_share", "findings", "cameras"]);
    assert_eq!(result["healthy"], false);
    assert_eq!(result["findings"][0]["kind"], "exchanged_cameras");
    assert_keys(&result["findings"][0], &["kind", "cameras", "names", "problem", "fix"]);
    assert_eq!(result["cameras"].as_array().unwrap().len(), 14);
    assert!(image::open(&sheet).unwrap().width() > 500);
    let page = std::fs::read_to_string(&page).unwrap();
    let marked =
        page.split("<section").skip(1).filter(|text| text.lines().next().is_some_and(|line| line.contains("bad")));
    assert_eq!(marked.count(), 2, "two cameras are marked");
    assert!(page.contains("<li>cameras 1, 11: the image is what is seen from another camera's place"), "{page}");
    assert!(!page.contains("src=\"http") && !page.contains("href=\"http"), "it needs no other file");
}

#[test]
fn masks_are_made_where_there_are_none() {
    let folder = tempdir().unwrap();
    let source = folder.path().join("footage");
    let settings = SyntheticSettings { width: 96, height: 72, num_timesteps: 10, ..SyntheticSettings::default() };
    write_synthetic(&source, &settings).unwrap();
    std::fs::remove_dir_all(source.join("seg")).unwrap();
    let (out, result) = (folder.path().join("capture"), folder.path().join("result.json"));
    let prepare = ["prepare", text(&source), "--points", "2000", "--out"];
    let said = succeed(&[&prepare[..], &[text(&out), "--dry-run"]].concat());
    assert!(said.contains("masks: would be made") && !out.exists(), "{said}");
    let said = succeed(&[&prepare[..], &[text(&out), "--json", text(&result)]].concat());
    assert!(said.contains("masks: 140, ") && said.contains("on the visual hull"), "{said}");
    let told = &json(&result)["masks"];
    assert_keys(told, &["num_masks", "foreground", "seconds"]);
    assert!((0.02..0.4).contains(&told["foreground"].as_f64().unwrap()), "{told}");
    assert!(!source.join("seg").exists(), "the source is not touched");
    let capture = Capture::open(&out).unwrap();
    let foreground = &capture.point_cloud().unwrap().foreground;
    assert!(capture.has_segmentation() && foreground.contains(&true) && foreground.contains(&false));

    // A mask that the user edits is kept.
    let mask = std::fs::read(out.join("seg/3/000004.png")).unwrap();
    let again = folder.path().join("again");
    let said = succeed(
        &[&prepare[..], &[text(&again)]]
            .concat()
            .iter()
            .map(|&word| if word == text(&source) { text(&out) } else { word })
            .collect::<Vec<_>>(),
    );
    assert!(said.contains("masks: taken as the capture has them"), "{said}");
    assert_eq!(std::fs::read(again.join("seg/3/000004.png")).unwrap(), mask);
    let message = fail(2, &["prepare", text(&source), "--points-only", "p.npz", "--masks", "yes"]);
    assert!(message.contains("--masks"), "{message}");
}

#[test]
fn masks_are_not_made_of_a_few_frames() {
    let folder = tempdir().unwrap();
    let source = folder.path().join("footage");
    let settings = SyntheticSettings { width: 96, height: 72, num_timesteps: 4, ..SyntheticSettings::default() };
    write_synthetic(&source, &settings).unwrap();
    std::fs::remove_dir_all(source.join("seg")).unwrap();
    let out = folder.path().join("capture");
    let prepare = ["prepare", text(&source), "--points", "2000", "--out", text(&out)];
    let problem = "has 4 frames, expected at least 8";
    let message = fail(2, &[&prepare[..], &["--masks", "yes"]].concat());
    assert!(message.contains(problem) && !out.exists(), "{message}");
    let said = succeed(&prepare);
    assert!(said.contains("masks: none are made") && said.contains(problem), "{said}");
    assert!(!Capture::open(&out).unwrap().has_segmentation());
}
