//! Captures that `capture.toml` describes: recordings of several codecs, turned, cut, with uneven frame rates. The
//! tests need the program `ffmpeg`. Every frame shows its number, so that no frame can be taken for another.

use std::io::Write;
use std::path::{MAIN_SEPARATOR, Path};
use std::process::{Command, Stdio};

use crate::support::has_ffmpeg;
use image::{Rgb, RgbImage};
use tcgs_capture::{Calibration, Capture, ClocksFrom, DescribeSettings, RawFootage, Split};
use tempfile::TempDir;

const WIDTH: u32 = 128;
const HEIGHT: u32 = 64;
/// Bits of a number, each a block of the picture; the last block is always white and marks the upper side.
const BITS: u32 = 7;
const BLOCK: u32 = WIDTH / (BITS + 1);
const RATE: &str = "20";

/// A picture that shows its number as bits in the upper half.
fn numbered(number: usize) -> RgbImage {
    RgbImage::from_fn(WIDTH, HEIGHT, |x, y| {
        let bit = x / BLOCK;
        let lit = y < HEIGHT / 2 && (bit == BITS || number >> bit & 1 == 1);
        Rgb(if lit { [230; 3] } else { [40; 3] })
    })
}

/// The number that a picture shows.
fn number_of(image: &tcgs_core::Image) -> usize {
    assert_eq!((image.width, image.height), (WIDTH as usize, HEIGHT as usize));
    let lit = |bit: u32| {
        let (x, y) = ((bit * BLOCK + BLOCK / 2) as usize, (HEIGHT / 4) as usize);
        image.data[y * image.width + x] > 0.5
    };
    assert!(lit(BITS), "not the right way up");
    (0..BITS).map(|bit| usize::from(lit(bit)) << bit).sum()
}

/// Runs `ffmpeg` with pictures of these numbers as its first input.
fn encode(numbers: impl Iterator<Item = usize>, arguments: &[&str], out: &Path) {
    let size = format!("{WIDTH}x{HEIGHT}");
    let mut command = Command::new("ffmpeg");
    command.args(["-v", "error", "-y", "-f", "rawvideo", "-pix_fmt", "rgb24", "-s", &size, "-r", RATE, "-i", "pipe:0"]);
    let mut child = command.args(arguments).arg(out).stdin(Stdio::piped()).spawn().unwrap();
    let mut pipe = child.stdin.take().unwrap();
    for number in numbers {
        pipe.write_all(numbered(number).as_raw()).unwrap();
    }
    drop(pipe);
    assert!(child.wait().unwrap().success(), "{arguments:?}");
}

/// Runs `ffmpeg` on a file.
fn convert(from: &Path, arguments: &[&str], out: &Path) {
    let mut command = Command::new("ffmpeg");
    command.args(["-v", "error", "-y", "-i"]).arg(from).args(arguments).arg(out).stdin(Stdio::null());
    assert!(command.status().unwrap().success(), "{arguments:?}");
}

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

const H264: &[&str] = &["-c:v", "libx264", "-bf", "2", "-g", "12", "-pix_fmt", "yuv420p"];

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

/// A folder of videos with a calibration of `size`, one camera for each name.
fn raw(names: &[&str], size: [u32; 2], arguments: &[&str]) -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    let mut calibration = String::new();
    for (i, name) in names.iter().enumerate() {
        encode(5 * i..60, arguments, &folder.path().join(format!("{name}.mp4")));
        let (cx, cy) = (size[0] as f64 / 2.0 - 0.5, size[1] as f64 / 2.0 - 0.5);
        calibration += &format!(
            "[{name}]\nsize = [{}, {}]\nmatrix = [[100, 0, {cx:?}], [0, 100, {cy:?}], [0, 0, 1]]\nrotation = [0, 0, 0]\n\
             translation = [{i}, 0, 5]\n",
            size[0], size[1]
        );
    }
    std::fs::write(folder.path().join("Calib.toml"), calibration).unwrap();
    folder
}

/// Describes raw footage, and opens it.
fn prepared(folder: &TempDir, clocks: &str) -> Result<Capture, tcgs_capture::CaptureError> {
    let raw = RawFootage::find(folder.path(), None)?.unwrap();
    let placed = raw.place(&Calibration::find(folder.path())?.unwrap())?;
    let clocks_file = folder.path().join("offsets.txt");
    std::fs::write(&clocks_file, clocks).unwrap();
    let names: Vec<String> = raw.cameras().into_iter().map(|camera| camera.name).collect();
    let clocks = tcgs_capture::Clocks::read(&clocks_file, &names)?;
    assert_eq!(clocks.from, ClocksFrom::File);
    let description = raw.describe(&placed, &clocks, &DescribeSettings::default())?;
    std::fs::write(folder.path().join("capture.toml"), description.to_toml()).unwrap();
    let again = tcgs_capture::CaptureDescription::read(&folder.path().join("capture.toml"))?;
    assert_eq!(again, description);
    Capture::open(folder.path())
}

#[test]
fn raw_footage_becomes_a_capture_on_one_clock() {
    if !has_ffmpeg() {
        return;
    }
    // Each camera begins five frames after the previous one; the calibration has twice the size.
    let folder = raw(&["a", "b", "c"], [256, 128], H264);
    assert!(RawFootage::is_in(folder.path()).unwrap());
    // Frame 20 is the 21st of a, the 16th of b, the 11th of c.
    let capture = prepared(&folder, "a 1.0\nb 0.75\nc 0.5").unwrap();
    assert_eq!((capture.num_frames(), capture.frame_rate()), (50, 20.0));
    for (frame, expected) in [(0, 10), (49, 59)] {
        let views = capture.views(Split::Train, frame, 1).unwrap();
        let numbers: Vec<usize> = views.iter().map(|view| number_of(&view.image)).collect();
        assert_eq!(numbers, [expected; 3]);
        assert_eq!((views[1].camera.focal, views[1].camera.principal), ([50.0; 2], [64.0, 32.0]));
    }
    assert!(!RawFootage::is_in(folder.path()).unwrap(), "it is a capture now");
}

#[test]
fn what_players_turn_is_turned_unless_the_calibration_is_of_the_stored_image() {
    if !has_ffmpeg() {
        return;
    }
    let turned = |size: [u32; 2]| {
        let folder = raw(&["a", "b"], size, H264);
        for name in ["a", "b"] {
            let (file, plain) = (folder.path().join(format!("{name}.mp4")), folder.path().join("plain"));
            std::fs::rename(&file, &plain).unwrap();
            convert(&plain, &["-c", "copy", "-metadata:s:v:0", "rotate=90"], &file);
            std::fs::remove_file(plain).unwrap();
        }
        folder
    };
    let folder = turned([64, 128]);
    let cameras = RawFootage::find(folder.path(), None).unwrap().unwrap().cameras();
    let [camera, _] = cameras.as_slice() else { panic!("{cameras:?}") };
    if camera.turn_degrees == 0 {
        // Newer versions of ffmpeg write the turn with an option that older ones lack.
        return;
    }
    assert_eq!(camera.size, (64, 128));
    let capture = prepared(&folder, "a 0\nb 0").unwrap();
    let view = &capture.views(Split::Train, 0, 1).unwrap()[0];
    assert_eq!((view.image.width, view.image.height), (64, 128));
    let stored = turned([128, 64]);
    let capture = prepared(&stored, "a 0\nb 0").unwrap();
    assert_eq!(number_of(&capture.views(Split::Train, 7, 1).unwrap()[0].image), 7);
}

#[test]
fn raw_footage_that_makes_no_capture_is_named() {
    if !has_ffmpeg() {
        return;
    }
    let short = |folder: &TempDir, error: tcgs_capture::CaptureError| {
        error.to_string().replace(&format!("{}{MAIN_SEPARATOR}", folder.path().display()), "")
    };
    let folder = raw(&["a", "b"], [128, 96], H264);
    let found = short(&folder, prepared(&folder, "a 0\nb 0").unwrap_err());
    assert_eq!(
        found,
        "Calib.toml: camera a: is calibrated at 128x96 pixels, expected 128x64 as the recording has, or a size of which \
         that is a scaled copy"
    );
    let folder = raw(&["a", "b"], [128, 64], H264);
    let found = prepared(&folder, "a 0\nb 100").unwrap_err().to_string();
    assert!(found.ends_with("s before another camera begins, expected a time at which all run"), "{found}");

    let folder = raw(&["a", "b"], [128, 64], &[&["-vf", "drawbox=t=fill:color=black"], H264].concat());
    let black = short(&folder, RawFootage::find(folder.path(), None).unwrap_err());
    assert_eq!(black, "a.mp4: is black in all frames that were looked at, expected pictures");

    let folder = raw(&["a"], [128, 64], H264);
    let one = RawFootage::find(folder.path(), None).unwrap_err().to_string();
    assert!(one.ends_with("has one recording (a.mp4), expected one for each of several cameras"), "{one}");

    // The end of a file is missing.
    let folder = raw(&["a", "b"], [128, 64], &[&["-movflags", "+faststart"], H264].concat());
    let file = folder.path().join("b.mp4");
    let whole = std::fs::read(&file).unwrap();
    std::fs::write(&file, &whole[..whole.len() * 2 / 3]).unwrap();
    let early = short(&folder, RawFootage::find(folder.path(), None).unwrap_err());
    assert!(early.starts_with("b.mp4: ends inside its frame "), "{early}");
}
