//! Captures that `capture.toml` describes: recordings of several codecs, turned, cut, with uneven frame rates. The
//! tests need the program `ffmpeg`. Every frame shows its number, so that no frame can be taken for another.

use std::path::{MAIN_SEPARATOR, Path};
use std::process::Command;

use tcgs_capture::{Capture, Split};
use tempfile::TempDir;

use crate::support::has_ffmpeg;
use crate::support::numbered::{H264, HEIGHT, RATE, WIDTH, convert, encode, number_of, numbered};

/// A description of some recordings on a capture of so many frames at [`RATE`].
///
/// - `cameras`: file, and lines of its own
fn describe(folder: &Path, num_frames: usize, cameras: &[(&str, &str)]) {
    let mut text = format!("version = 1\nframe_rate = {RATE}\nnum_frames = {num_frames}\n");
    for (id, (file, more)) in cameras.iter().enumerate() {
        text += &format!("[[camera]]\nid = {id}\nname = \"{file}\"\nfile = \"{file}\"\nfocal = [100, 100]\n{more}\n");
        if !more.contains("size") {
            text += &format!("size = [{WIDTH}, {HEIGHT}]\n");
        }
        text += &format!("principal = [64, 32]\ncamera_from_world = [[1, 0, 0, {id}], [0, 1, 0, 0], [0, 0, 1, 5]]\n");
    }
    std::fs::write(folder.join("capture.toml"), text).unwrap();
}

/// The numbers in the first camera's frames.
fn shown(folder: &Path, frames: &[usize]) -> Vec<usize> {
    let capture = Capture::open(folder).unwrap();
    frames.iter().map(|&frame| number_of(&capture.views(Split::Train, frame, 1).unwrap()[0].image)).collect()
}

#[test]
fn frames_of_every_codec_are_found_in_any_order() {
    if !has_ffmpeg() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let codecs: [(&str, &[&str]); 7] = [
        ("built_in.mp4", H264),
        ("h264.mkv", H264),
        ("ten_bits.mp4", &["-c:v", "libx264", "-bf", "3", "-pix_fmt", "yuv420p10le"]),
        ("part2.mp4", &["-c:v", "mpeg4", "-q:v", "3", "-g", "10"]),
        ("part2.avi", &["-c:v", "mpeg4", "-q:v", "3", "-bf", "2"]),
        ("vp9.webm", &["-c:v", "libvpx-vp9", "-deadline", "realtime", "-b:v", "500k"]),
        ("photos.mov", &["-c:v", "mjpeg", "-q:v", "3"]),
    ];
    let order = [0, 1, 2, 40, 41, 7, 6, 59, 0, 30, 31];
    for (file, arguments) in codecs {
        encode(0..60, arguments, &folder.path().join(file));
        describe(folder.path(), 60, &[(file, "")]);
        assert_eq!(shown(folder.path(), &order), order, "{file}");
    }
}

#[test]
fn folders_of_images_are_recordings() {
    let folder = tempfile::tempdir().unwrap();
    let images = folder.path().join("left");
    std::fs::create_dir(&images).unwrap();
    for number in 0..12 {
        numbered(number).save(images.join(format!("shot{number}.png"))).unwrap();
    }
    describe(folder.path(), 12, &[("left", "")]);
    assert_eq!(shown(folder.path(), &[0, 11, 2]), [0, 11, 2]);
    // Images at half the rate of the capture's clock.
    describe(folder.path(), 22, &[("left", "images_per_sec = 10")]);
    assert_eq!(shown(folder.path(), &[0, 2, 20, 21]), [0, 1, 10, 10]);
    describe(folder.path(), 10, &[("left", "start_secs = 0.1")]);
    assert_eq!(shown(folder.path(), &[0, 9]), [2, 11]);
}

#[test]
fn frames_are_chosen_by_when_they_are_shown() {
    if !has_ffmpeg() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    encode(0..60, H264, &path("whole.mp4"));
    // Cut without re-encoding: frames that are not shown stay in the file.
    convert(&path("whole.mp4"), &["-c", "copy", "-t", "1.5"], &path("short.mp4"));
    Command::new("ffmpeg")
        .args(["-v", "error", "-y", "-ss", "0.8", "-i"])
        .arg(path("whole.mp4"))
        .args(["-c", "copy"])
        .arg(path("cut.mp4"))
        .status()
        .unwrap();
    describe(folder.path(), 30, &[("short.mp4", "")]);
    assert_eq!(shown(folder.path(), &[0, 29]), [0, 29]);
    describe(folder.path(), 40, &[("cut.mp4", "")]);
    // The program that cut the file decides which frame is first.
    convert(&path("cut.mp4"), &["-frames:v", "1"], &path("first.png"));
    let first = image::open(path("first.png")).unwrap().into_rgb8();
    let first = number_of(&tcgs_core::Image::from_rgb8(WIDTH as usize, HEIGHT as usize, first.as_raw()));
    assert_eq!(first, 16);
    assert_eq!(shown(folder.path(), &[0, 1, 39]), [first, first + 1, first + 39]);

    // A phone that leaves out frames, read by the built-in decoder and by ffmpeg.
    let uneven = ["-vf", "select='not(between(n,10,14))'", "-fps_mode", "vfr"];
    for (file, codec) in [("uneven.mp4", H264), ("uneven.mkv", H264)] {
        encode(0..60, &[&uneven, codec].concat(), &path(file));
        describe(folder.path(), 60, &[(file, "")]);
        assert_eq!(shown(folder.path(), &[9, 11, 12, 13, 15, 59]), [9, 9, 9, 15, 15, 59], "{file}");
    }
    // Twice as many frames as the capture's clock has.
    encode(0..60, &[&["-vf", "setpts=PTS/2", "-r", "40"], H264].concat(), &path("fast.mp4"));
    describe(folder.path(), 30, &[("fast.mp4", "start_secs = 0.025")]);
    assert_eq!(shown(folder.path(), &[0, 1, 29]), [1, 3, 59]);
}

#[test]
fn pictures_are_turned_cropped_and_evened_out() {
    if !has_ffmpeg() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    for (degrees, filter) in [(90, "transpose=2"), (180, "hflip,vflip"), (270, "transpose=1")] {
        encode(0..4, &[&["-vf", filter], H264].concat(), &path("turned.mp4"));
        describe(folder.path(), 4, &[("turned.mp4", &format!("turn_degrees = {degrees}"))]);
        assert_eq!(shown(folder.path(), &[0, 3]), [0, 3], "{degrees}");
    }
    encode(0..4, &[&["-vf", "pad=160:80:10:4"], H264].concat(), &path("framed.mp4"));
    describe(folder.path(), 4, &[("framed.mp4", "crop = [10, 4, 128, 64]")]);
    assert_eq!(shown(folder.path(), &[3]), [3]);
    let shown = |capture: &Capture| {
        let views = capture.views(Split::Train, 0, 1).unwrap();
        [0, 1, 2].map(|channel| views[0].image.plane(channel)[60 * 128 + 5])
    };
    let at = |gains: &str| {
        describe(folder.path(), 4, &[("framed.mp4", &format!("crop = [10, 4, 128, 64]\ngains = {gains}"))]);
        shown(&Capture::open(folder.path()).unwrap())
    };
    let (plain, gained) = (at("[1, 1, 1]"), at("[2, 0.5, 9]"));
    let expected = [2.0 * plain[0], 0.5 * plain[1], 1.0];
    assert!(gained.iter().zip(expected).all(|(found, expected)| (found - expected).abs() < 0.003), "{gained:?}");
    let moved = at("[1, 0.5, 1]\noffsets = [0.1, 0.2, -1]");
    let expected = [plain[0] + 0.1, 0.5 * plain[1] + 0.2, 0.0];
    assert!(moved.iter().zip(expected).all(|(found, expected)| (found - expected).abs() < 0.003), "{moved:?}");

    // Publications compare with recorded colours. One key turns all changes off.
    let capture = Capture::open(folder.path()).unwrap();
    let recorded = capture.with_recorded_colors();
    assert!(capture.changes_colors() && !recorded.changes_colors());
    assert_eq!((shown(&capture), shown(&recorded)), (moved, plain));
    let file = folder.path().join("capture.toml");
    let text = std::fs::read_to_string(&file).unwrap();
    std::fs::write(&file, text.replacen("[[camera]]", "[colors]\nused = false\n[[camera]]", 1)).unwrap();
    let capture = Capture::open(folder.path()).unwrap();
    assert!(!capture.changes_colors());
    assert_eq!(shown(&capture), plain);
}

/// The error of opening a folder, without the folder's name.
fn problem(folder: &TempDir) -> String {
    let message = Capture::open(folder.path()).unwrap_err().to_string();
    assert!(!message.contains('\n'), "{message}");
    message.replace(&format!("{}{MAIN_SEPARATOR}", folder.path().display()), "")
}

#[test]
fn what_does_not_fit_the_files_is_named() {
    if !has_ffmpeg() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("a.mkv");
    encode(0..20, &[&["-cluster_time_limit", "100"], H264].concat(), &file);
    describe(folder.path(), 25, &[("a.mkv", "")]);
    let expected = "a.mkv: has frames from 0.000 s to 0.950 s, expected frames from 0.000 s to 1.200 s: 25 frames at 20 \
                    a second from start_secs on";
    assert_eq!(problem(&folder), expected);
    describe(folder.path(), 5, &[("a.mkv", "size = [64, 64]")]);
    let expected = "capture.toml: camera a.mkv: size is 64x64 pixels, but a.mkv has 128x64, expected the same";
    assert_eq!(problem(&folder), expected);
    describe(folder.path(), 5, &[("a.mkv", "crop = [100, 0, 64, 64]\nsize = [64, 64]")]);
    assert!(problem(&folder).contains("exceeds the image of 128x64 pixels"));
    describe(folder.path(), 5, &[("../a.mkv", "")]);
    assert!(problem(&folder).contains("expected the path of a file inside the capture"));
    describe(folder.path(), 5, &[("b.mkv", "")]);
    assert_eq!(problem(&folder), "b.mkv: no such file, expected a video or a folder of images");
    std::fs::write(folder.path().join("b.mkv"), "not a video").unwrap();
    assert!(problem(&folder).starts_with("b.mkv: is no video: ffprobe said: "));

    // A video that ends early: its table of contents promises more than there is.
    let whole = std::fs::read(&file).unwrap();
    std::fs::write(folder.path().join("b.mkv"), &whole[..whole.len() * 2 / 3]).unwrap();
    describe(folder.path(), 20, &[("b.mkv", "")]);
    assert!(problem(&folder).starts_with("b.mkv: has frames from 0.000 s to "), "{}", problem(&folder));
}
