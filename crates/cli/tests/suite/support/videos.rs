//! Videos like those of users, made from a synthetic capture. Needs the program `ffmpeg`.

use std::io::Write;
use std::path::PathBuf;
use std::process::{Command, Stdio};

use crate::support::skip;
use tcgs_capture::{Capture, Split, SyntheticSettings, write_synthetic};
use tempfile::TempDir;

/// Frames per second.
const RATE: u32 = 20;

/// Whether `ffmpeg` is installed; without it a test is skipped, unless `REQUIRE_FFMPEG` is set.
pub fn has_ffmpeg() -> bool {
    let found = Command::new("ffmpeg").arg("-version").stdout(Stdio::null()).status().is_ok();
    if !found {
        skip("REQUIRE_FFMPEG", "there is no ffmpeg");
    }
    found
}

/// Videos `videos/cam0.mp4` … of a synthetic capture in `truth`, with a calibration, and a file `offsets.txt` beside
/// them. Camera `i` lacks its first `i % 3` frames.
///
/// - `num_frames`: of the first camera
pub fn videos(folder: &TempDir, num_frames: usize) -> PathBuf {
    videos_of(folder, num_frames, [96, 72])
}

/// As [`videos`], with a given size in pixels.
pub fn videos_of(folder: &TempDir, num_frames: usize, [width, height]: [usize; 2]) -> PathBuf {
    let (truth, path) = (folder.path().join("truth"), folder.path().join("videos"));
    let settings = SyntheticSettings { width, height, num_timesteps: num_frames, ..SyntheticSettings::default() };
    write_synthetic(&truth, &settings).unwrap();
    std::fs::create_dir(&path).unwrap();
    let capture = Capture::open(&truth).unwrap();
    let (size, rate) = (format!("{width}x{height}"), RATE.to_string());
    let (mut calibration, mut offsets) = (String::new(), String::from("# when the ball is thrown\n"));
    for (i, (_, camera)) in capture.cameras(Split::Train, 0, 1).unwrap().into_iter().enumerate() {
        let ([fx, fy], [cx, cy]) = (camera.focal, camera.principal.map(|c| c - 0.5));
        let rows = camera.camera_from_world.map(|[a, b, c, _]| [a, b, c]);
        let translation = [0, 1, 2].map(|row| camera.camera_from_world[row][3]);
        calibration += &format!(
            "[cam{i}]\nsize = [{width}, {height}]\nmatrix = [[{fx:?}, 0, {cx:?}], [0, {fy:?}, {cy:?}], [0, 0, 1]]\n\
             rotation = {:?}\ntranslation = {translation:?}\n",
            &rows[..3]
        );
        offsets += &format!("cam{i} {}\n", 1.0 - (i % 3) as f64 / f64::from(RATE));
        let mut child = Command::new("ffmpeg")
            .args(["-v", "error", "-f", "rawvideo", "-pix_fmt", "rgb24", "-s", &size, "-r", &rate, "-i"])
            .args(["pipe:0", "-c:v", "libx264", "-crf", "8", "-pix_fmt", "yuv420p"])
            .arg(path.join(format!("cam{i}.mp4")))
            .stdin(Stdio::piped())
            .spawn()
            .unwrap();
        let mut pipe = child.stdin.take().unwrap();
        for frame in i % 3..num_frames {
            let views = capture.views(Split::Train, frame, 1).unwrap();
            pipe.write_all(&views[i].image.to_rgb8()).unwrap();
        }
        drop(pipe);
        assert!(child.wait().unwrap().success());
    }
    std::fs::write(path.join("Calib.toml"), calibration).unwrap();
    std::fs::write(folder.path().join("offsets.txt"), offsets).unwrap();
    path
}

/// Runs `ffmpeg`.
pub fn ffmpeg(arguments: &[&str]) {
    assert!(Command::new("ffmpeg").args(["-v", "error", "-y"]).args(arguments).status().unwrap().success());
}
