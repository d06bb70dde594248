//! Videos of a scene, by the program `ffmpeg` or a substitute.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use crate::support::videos::has_ffmpeg;
use crate::support::*;
use tempfile::{TempDir, tempdir};

/// A scene of four frames, in `folder`.
fn scene(folder: &TempDir) -> PathBuf {
    let run = train(folder, "run", &[]);
    succeed(&["compress", text(&run)]);
    run.join("scene.tcgs")
}

/// Runs with a PATH of one folder.
fn run_with_path(path: &Path, arguments: &[&str]) -> Output {
    tcgs().env("PATH", path).args(arguments).output().unwrap()
}

#[test]
fn pictures_go_to_ffmpeg_and_errors_come_back() {
    let folder = tempdir().unwrap();
    let scene = scene(&folder);
    let bin = folder.path().join("bin");
    fs::create_dir(&bin).unwrap();
    let clip = folder.path().join("clip.mp4");
    let render = ["render", text(&scene), "--out", text(&clip), "--size", "40x30", "--backend", "cpu"];

    let output = run_with_path(&bin, &render);
    let message = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(1), "{message}");
    let complaint = "tcgs: ffmpeg: No such file or directory (os error 2), expected it on the PATH";
    assert!(message.starts_with(complaint) && message.lines().count() == 1, "{message}");

    // It stores its input: the last argument is the file to write.
    let keep = "for last; do :; done\necho \"$@\" > ARGUMENTS\n/bin/cat > \"$last\"";
    write_program(&bin.join("ffmpeg"), &keep.replace("ARGUMENTS", text(&bin.join("arguments.txt"))));
    assert!(run_with_path(&bin, &render).status.success());
    let pictures = fs::read(&clip).unwrap();
    assert_eq!(pictures.len(), 4 * 40 * 30 * 3);
    let given = fs::read_to_string(bin.join("arguments.txt")).unwrap();
    assert!(given.contains("-s 40x30 -r 30 -i pipe:0") && given.contains("libx264"), "{given}");

    // The same pictures as the PNG files.
    let frames = folder.path().join("frames");
    succeed(&["render", text(&scene), "--out", text(&frames), "--size", "40x30", "--backend", "cpu"]);
    for (frame, picture) in pictures.chunks(40 * 30 * 3).enumerate() {
        let png = image::open(frames.join(format!("{frame:06}.png"))).unwrap().to_rgb8();
        assert!(png.as_raw() == picture, "frame {frame}");
    }

    let output = run_with_path(&bin, &render);
    let message = String::from_utf8(output.stderr).unwrap();
    assert!(output.status.code() == Some(2) && message.contains("clip.mp4: exists already"), "{message}");
    assert!(run_with_path(&bin, &[&render[..], &["--force"]].concat()).status.success());

    for (script, dies) in [
        ("echo 'no such encoder' >&2; exit 3", "at once"),
        ("/bin/cat >/dev/null; echo 'no such encoder' >&2; exit 3", "at the end"),
    ] {
        write_program(&bin.join("ffmpeg"), script);
        let output = run_with_path(&bin, &[&render[..], &["--force"]].concat());
        let message = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(1), "{dies}: {message}");
        assert!(message.contains("clip.mp4: ffmpeg ended with") && message.contains("no such encoder"), "{message}");
        assert_eq!(fs::read(&clip).unwrap(), pictures, "what was there stays");
    }
}

#[test]
fn a_saved_path_is_followed() {
    let folder = tempdir().unwrap();
    let scene = scene(&folder);
    let path = folder.path().join("path.json");
    let camera = |timestep: usize, x: f64| {
        serde_json::json!({
            "timestep": timestep, "width": 48, "height": 36, "fx": 40.0, "fy": 40.0, "cx": 24.0, "cy": 18.0,
            "cameraFromWorld": [1.0, 0.0, 0.0, x, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 4.0, 0.0, 0.0, 0.0, 1.0],
        })
    };
    let document = serde_json::json!({
        "format": "tcgs-camera-path", "version": 1, "cameras": [camera(0, -0.5), camera(3, 0.5)],
    });
    fs::write(&path, document.to_string()).unwrap();
    let frames = folder.path().join("frames");
    succeed(&["render", text(&scene), "--out", text(&frames), "--path", text(&path)]);
    let picture = |frame: usize| fs::read(frames.join(format!("{frame:06}.png"))).unwrap();
    assert_eq!(image::image_dimensions(frames.join("000003.png")).unwrap(), (48, 36));
    assert!(picture(0) != picture(3));

    fs::write(&path, "{}").unwrap();
    let arguments = ["render", text(&scene), "--out", text(&frames), "--path", text(&path), "--force"];
    let message = fail(2, &arguments);
    assert!(message.contains("path.json: missing field `format`") && message.contains("player saved"), "{message}");
    let message = fail(2, &["render", text(&scene), "--out", text(&frames), "--path", "zigzag", "--force"]);
    assert!(message.contains("expected orbit, spiral, or a .json file"), "{message}");
}

#[test]
fn real_videos_show_the_pictures() {
    if !has_ffmpeg() {
        return;
    }
    let folder = tempdir().unwrap();
    let scene = scene(&folder);
    let frames = folder.path().join("frames");
    succeed(&["render", text(&scene), "--out", text(&frames), "--size", "65x48"]);
    for name in ["clip.mp4", "clip.webm"] {
        let clip = folder.path().join(name);
        let said = succeed(&["render", text(&scene), "--out", text(&clip), "--size", "65x48"]);
        assert!(said.contains(&format!("{name}: 4 pictures")), "{said}");
        let decoded = Command::new("ffmpeg")
            .args(["-loglevel", "error", "-i", text(&clip), "-f", "rawvideo", "-pix_fmt", "rgb24", "-"])
            .output()
            .unwrap();
        assert!(decoded.status.success(), "{}", String::from_utf8_lossy(&decoded.stderr));
        assert_eq!(decoded.stdout.len(), 4 * 64 * 48 * 3, "{name}: an even width, every frame");
        for (frame, shown) in decoded.stdout.chunks(64 * 48 * 3).enumerate() {
            let png = image::open(frames.join(format!("{frame:06}.png"))).unwrap().to_rgb8();
            let expected = image::imageops::crop_imm(&png, 0, 0, 64, 48).to_image();
            let squares = shown.iter().zip(expected.as_raw()).map(|(&a, &b)| (f64::from(a) - f64::from(b)).powi(2));
            let psnr = 10.0 * (255.0 * 255.0 * shown.len() as f64 / squares.sum::<f64>()).log10();
            assert!(psnr > 28.0, "{name} frame {frame}: {psnr:.1} dB");
        }
    }
}
