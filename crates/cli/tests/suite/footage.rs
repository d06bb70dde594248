//! `tcgs prepare` on a folder of videos: masks of moving things, differing colours, moving cameras.

use std::fs;
use std::path::Path;

use crate::support::videos::*;
use crate::support::*;
use tcgs_capture::{Capture, Split};
use tempfile::tempdir;

fn train(capture: &Path, run: &Path, more: &[&str]) {
    succeed(&[&["train", text(capture), "--out", text(run), "--backend", "cpu"][..], more].concat());
}

#[test]
fn masks_are_made_of_videos_and_trained_with() {
    if !has_ffmpeg() {
        return;
    }
    let folder = tempdir().unwrap();
    let (source, offsets) = (videos(&folder, 12), folder.path().join("offsets.txt"));
    let (out, result) = (folder.path().join("capture"), folder.path().join("result.json"));
    let prepare = ["prepare", text(&source), "--out", text(&out), "--offsets", text(&offsets), "--points", "3000"];
    let masked = ["--hold-out", "cam3", "--json", text(&result)];
    let said = succeed(&[&prepare[..], &masked].concat());
    assert!(said.contains("capture: 10 frames") && said.contains("masks: 120, "), "{said}");
    assert_keys(&json(&result)["masks"], &["num_masks", "foreground", "seconds"]);

    // Each mask belongs to its camera and frame: it overlaps the motion in the rendered scene, two frames later than
    // the capture's frame.
    let (capture, truth) = (Capture::open(&out).unwrap(), Capture::open(&folder.path().join("truth")).unwrap());
    assert!(capture.has_segmentation() && capture.facts().labels_motion);
    let (mut both, mut either) = (0, 0);
    for frame in 0..10 {
        let expected = truth.views(Split::Train, frame + 2, 1).unwrap();
        for view in capture.views(Split::All, frame, 1).unwrap() {
            let file = out.join(format!("masks/cam{}/{frame:06}.png", view.camera_id));
            assert!(file.is_file(), "{}", file.display());
            let (found, expected) =
                (view.segmentation.unwrap(), expected[view.camera_id].segmentation.as_ref().unwrap());
            for (&found, &expected) in found.foreground.iter().zip(&expected.foreground) {
                both += usize::from(found && expected);
                either += usize::from(found || expected);
            }
        }
    }
    let overlap = f64::from(u32::try_from(both).unwrap()) / f64::from(u32::try_from(either).unwrap());
    assert!(overlap > 0.3, "intersection over union {overlap}");

    let run = folder.path().join("run");
    train(&out, &run, &["--iterations", "30,10", "--frames", "0..2"]);
    let said = succeed(&["eval", text(&run), "--capture", text(&out), "--backend", "cpu"]);
    assert!(said.contains("PSNR of foreground") && !said.contains("colours: "), "{said}");
}

#[test]
fn colours_are_evened_out_but_not_where_a_protocol_compares() {
    if !has_ffmpeg() {
        return;
    }
    let folder = tempdir().unwrap();
    // Large enough for points to be matched between several cameras.
    let (source, offsets) = (videos_of(&folder, 4, [240, 180]), folder.path().join("offsets.txt"));
    // One camera is too dark.
    let (dark, bright) = (source.join("cam3.mp4"), folder.path().join("truth/bright.mp4"));
    fs::rename(&dark, &bright).unwrap();
    let darker = "lutrgb=r=val*0.6:g=val*0.7:b=val*0.8,format=yuv420p";
    ffmpeg(&["-i", text(&bright), "-vf", darker, "-c:v", "libx264", "-crf", "8", text(&dark)]);
    let (out, result) = (folder.path().join("capture"), folder.path().join("result.json"));
    let prepare = ["prepare", text(&source), "--out", text(&out), "--offsets", text(&offsets), "--points", "3000"];
    let more = ["--hold-out", "cam3", "--refine-calibration", "no", "--width", "120"];
    let prepare = [&prepare[..], &more].concat();
    let said = succeed(&[&prepare[..], &["--dry-run"]].concat());
    assert!(said.contains("colours: would be compared"), "{said}");

    let said = succeed(&[&prepare[..], &["--colors", "no"]].concat());
    assert!(!said.contains("colours: ") && said.contains("camera cam3: red, green and blue differ by -"), "{said}");
    let said = succeed(&[&prepare[..], &["--force", "--json", text(&result)]].concat());
    assert!(said.contains("colours: evened out by gains") && said.contains("  cam3: gains 1."), "{said}");
    assert!(!said.contains("red, green and blue differ"), "the doctor sees nothing that is left: {said}");
    let colors = &json(&result)["colors"];
    let keys = ["taken", "before_levels", "after_levels", "num_fitted", "num_judging", "cameras"];
    assert_keys(colors, &keys);
    let of_camera = &colors["cameras"][3];
    assert_keys(of_camera, &["name", "gains", "offsets", "before_levels", "after_levels"]);
    for (gain, darkened) in of_camera["gains"].as_array().unwrap().iter().zip([0.6, 0.7, 0.8]) {
        assert!((gain.as_f64().unwrap() * darkened - 1.0).abs() < 0.05, "{of_camera}");
    }
    let page = fs::read_to_string(out.join("check.html")).unwrap();
    assert!(
        page.contains("<dt>gains</dt>") && page.contains("<dt>brightness</dt>") && page.contains("Colours: evened")
    );

    let run = folder.path().join("run");
    train(&out, &run, &["--iterations", "60,10", "--frames", "0..1", "--downscale", "4"]);
    let eval = ["eval", text(&run), "--capture", text(&out), "--backend", "cpu", "--force", "--json", text(&result)];
    let psnr = |more: &[&str], is_changed: bool| {
        let said = succeed(&[&eval[..], more].concat());
        assert_eq!(said.contains("colours: compared as capture.toml evens them out"), is_changed, "{said}");
        assert_eq!(json(&result)["changed_colors"], is_changed);
        json(&result)["psnr"].as_f64().unwrap()
    };
    let (even, of_protocol) = (psnr(&[], true), psnr(&["--protocol", "stg"], false));
    // After so short a training both are poor; the two PSNR values compare with different images.
    assert!((even - of_protocol).abs() > 0.5, "{even} dB with even colours, {of_protocol} dB as recorded");
    let description = out.join("capture.toml");
    let off = fs::read_to_string(&description).unwrap().replace("used = true", "used = false");
    fs::write(&description, off).unwrap();
    assert_eq!(psnr(&[], false), of_protocol);
}

#[test]
fn a_camera_that_moves_in_blocky_video_is_refused() {
    if !has_ffmpeg() {
        return;
    }
    let folder = tempdir().unwrap();
    let (source, out, wide) = (folder.path().join("videos"), folder.path().join("out"), folder.path().join("wide.png"));
    fs::create_dir(&source).unwrap();
    // Tiles of many greys, in two sizes on top of each other.
    let tile = |x: u32, y: u32, size: u32| {
        let hash = (x / size).wrapping_mul(0x9E37_79B9) ^ (y / size).wrapping_mul(0x85EB_CA6B);
        (hash ^ (hash >> 15)).wrapping_mul(0x2C1B_3C6D) >> 12 & 255
    };
    let grey = |x: u32, y: u32| image::Luma([((2 * tile(x, y, 24) + tile(x, y, 9)) / 3) as u8]);
    image::GrayImage::from_fn(800, 360, grey).save(&wide).unwrap();
    let (mut calibration, mut offsets) = (String::new(), String::new());
    for camera in 0..4 {
        let at = if camera == 2 { "3*n" } else { "200" };
        let filter = format!("crop=480:360:x='{at}':y=0,noise=alls=30:allf=t,format=yuv420p");
        let video = source.join(format!("cam{camera}.mp4"));
        let arguments = ["-loop", "1", "-framerate", "20", "-i", text(&wide), "-frames:v", "40", "-vf", &filter];
        // Compressed like an early camera's video, with strong blocking.
        ffmpeg(&[&arguments[..], &["-c:v", "libx264", "-crf", "38", text(&video)]].concat());
        calibration += &format!(
            "[cam{camera}]\nsize = [480, 360]\nmatrix = [[450, 0, 239.5], [0, 450, 179.5], [0, 0, 1]]\n\
             rotation = [[1, 0, 0], [0, 1, 0], [0, 0, 1]]\ntranslation = [{camera}, 0, 0]\n"
        );
        offsets += &format!("cam{camera} 0\n");
    }
    fs::write(source.join("Calib.toml"), calibration).unwrap();
    fs::write(folder.path().join("offsets.txt"), offsets).unwrap();
    let message = fail(
        2,
        &["prepare", text(&source), "--out", text(&out), "--offsets", text(&folder.path().join("offsets.txt"))],
    );
    assert!(
        message.contains("videos: cam2: what it shows is elsewhere later on, expected a camera that stands still"),
        "{message}"
    );
    assert!(!out.exists());
}
