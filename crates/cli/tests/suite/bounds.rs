//! Files and numbers that would never end or take all memory. The refusal is exit code 2 and one line that names the
//! culprit, soon and within little memory.

use std::fs;
use std::io::Read;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::thread;
use std::time::{Duration, Instant};

use crate::support::*;
use tcgs_capture::write_synthetic;
use tempfile::{TempDir, tempdir};

/// Time limit of a refusal: two seconds, doubled where tests share the processors.
const MOST: Duration = Duration::from_secs(4);
/// Largest memory of a refusal, kilobytes.
const MOST_MEMORY: u64 = 200_000;

/// Runs a command that must exit with 2, soon and within little memory, with one line that contains all of `expected`.
fn refused(arguments: &[&str], expected: &[&str]) {
    let begin = Instant::now();
    let mut child = tcgs().args(arguments).stdout(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap();
    let mut memory = 0;
    let status = loop {
        let status = fs::read_to_string(format!("/proc/{}/status", child.id())).unwrap_or_default();
        let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"));
        memory = line.and_then(|line| line.trim().trim_end_matches(" kB").parse().ok()).unwrap_or(memory);
        if let Some(status) = child.try_wait().unwrap() {
            break status;
        }
        if begin.elapsed() > MOST {
            child.kill().unwrap();
            panic!("{arguments:?} goes on after {:?} in {memory} kB", begin.elapsed());
        }
        thread::sleep(Duration::from_millis(2));
    };
    let mut message = String::new();
    child.stderr.take().unwrap().read_to_string(&mut message).unwrap();
    assert_eq!(status.code(), Some(2), "{arguments:?}: {message}");
    assert!(memory < MOST_MEMORY, "{arguments:?}: {memory} kB");
    let message = message.trim_end();
    let last = message.lines().last().unwrap_or_default();
    let remarks = message.lines().filter(|line| !line.starts_with("computing on ") && !line.starts_with("warning: "));
    assert!(last.starts_with("tcgs: ") && remarks.count() == 1, "{arguments:?}: {message}");
    for part in expected {
        assert!(last.contains(part), "{arguments:?}: {last}\nexpected: {part}");
    }
}

/// Paths of an endless device, a pipe without a writer, a folder, and a sparse file of a terabyte.
fn endless(folder: &Path) -> [(PathBuf, &'static str); 4] {
    let (pipe, long) = (folder.join("pipe.json"), folder.join("long.json"));
    assert!(Command::new("mkfifo").arg(&pipe).status().unwrap().success());
    fs::File::create(&long).unwrap().set_len(1 << 40).unwrap();
    [
        ("/dev/zero".into(), "is a device or a pipe"),
        (pipe, "is a device or a pipe"),
        (folder.join("."), "is a folder"),
        (long, "has 1099511627776 bytes"),
    ]
}

#[test]
fn files_that_never_end_are_refused_as_arguments() {
    let folder = tempdir().unwrap();
    let run = train(&folder, "run", &[]);
    let (capture, out) = (text(capture()), folder.path().join("out"));
    for (path, problem) in endless(folder.path()) {
        let file = text(&path);
        refused(&["train", capture, "--out", text(&out), "--config", file], &[file, problem]);
        let attached = format!("my.data={file}");
        refused(&["compress", text(&run), "--out", text(&out), "--attach", &attached], &[file, problem]);
        refused(&["eval", text(&run), "--capture", capture, "--lpips-weights", file], &[file, problem]);
        if path.extension().is_some() {
            refused(&["render", text(&run), "--out", text(&out), "--path", file], &[file, problem]);
        }
        if problem.contains("pipe") {
            for command in [&["info", file][..], &["verify", file], &["render", file, "--out", text(&out)]] {
                refused(command, &[file, problem]);
            }
            refused(&["train", capture, "--out", text(&out), "--start-from", file], &[file, problem]);
            refused(&["view", file], &[file, problem]);
        }
    }
    let named = tcgs().env("TCGS_LPIPS_WEIGHTS", "/dev/zero").args(["eval", text(&run), "--capture", capture]).output();
    let message = String::from_utf8(named.unwrap().stderr).unwrap();
    assert!(message.contains("/dev/zero: ") && message.contains("is a device or a pipe"), "{message}");
    assert!(!out.exists());
}

#[test]
fn files_that_never_end_are_refused_inside_captures() {
    let endless_files = tempdir().unwrap();
    for (path, problem) in endless(endless_files.path()) {
        for name in ["train_meta.json", "capture.toml", "init_pt_cld.npz", "image", "transforms.json"] {
            // A folder is not one of these files, and may belong to another kind of capture.
            if problem == "is a folder" && name != "train_meta.json"
                || name.ends_with("npz") && problem.starts_with("has ")
            {
                continue;
            }
            let folder = tempdir().unwrap();
            write_synthetic(folder.path(), &SETTINGS).unwrap();
            let image = json(&folder.path().join("train_meta.json"))["fn"][0][0].as_str().unwrap().to_owned();
            let file = folder.path().join(if name == "image" { format!("ims/{image}") } else { name.into() });
            let _ = fs::remove_file(&file);
            if name == "transforms.json" {
                fs::remove_file(folder.path().join("train_meta.json")).unwrap();
            }
            std::os::unix::fs::symlink(&path, &file).unwrap();
            let out = folder.path().join("out");
            // A capture skips images and points that are not regular files.
            let is_absent = ["init_pt_cld.npz", "image"].contains(&name) && problem.contains("pipe");
            let expected = if is_absent { "expected" } else { problem };
            refused(&["train", text(folder.path()), "--out", text(&out), "--iterations", "2,1"], &[expected]);
        }
    }
}

/// A described capture of three cameras, one of which has the video `bad`.
fn described(bad: &[u8], ending: &str) -> TempDir {
    let folder = tempdir().unwrap();
    let good = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../testdata/video/frames.mp4");
    let mut description = String::from("version = 1\nframe_rate = 25.0\nnum_frames = 4\n");
    for id in 0..3 {
        let file = format!("cam{id}.{}", if id == 1 { ending } else { "mp4" });
        match id {
            1 => fs::write(folder.path().join(&file), bad).unwrap(),
            _ => drop(fs::copy(&good, folder.path().join(&file)).unwrap()),
        }
        description += &format!(
            "[[camera]]\nid = {id}\nname = \"cam{id}\"\nfile = \"{file}\"\nsize = [64, 48]\nfocal = [60, 60]\n\
             principal = [32, 24]\ncamera_from_world = [[1, 0, 0, 0.{id}], [0, 1, 0, 0], [0, 0, 1, 2]]\n"
        );
    }
    fs::write(folder.path().join("capture.toml"), description).unwrap();
    folder
}

#[test]
fn a_video_with_a_box_of_no_size_is_refused() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../testdata/video/frames.mp4");
    let mut bytes = fs::read(path).unwrap();
    bytes[1328] = 0;
    refuses_video(&bytes);
}

/// Checks a video in which a box inside `mdia` has no size; the kind of the box may be damaged, too.
fn refuses_video(bad: &[u8]) {
    let folder = described(bad, "mp4");
    let out = folder.path().join("out");
    let expected = ["cam1.mp4: cannot be read: its box ", "inside mdia has the size 0", "expected a whole MP4 file"];
    refused(&["train", text(folder.path()), "--out", text(&out)], &expected);
    refused(&["prepare", text(folder.path()), "--points-only", text(&folder.path().join("points.npz"))], &expected);
    assert!(!out.exists());
}

#[test]
fn the_video_that_never_ended_is_refused() {
    let Some(path) = shared("hostile/bad2.mp4") else { return };
    refuses_video(&fs::read(path).unwrap());
}

/// Sends Ctrl-C once a hanging program has written its process id into a file, and checks that both processes end.
fn ctrl_c_ends(command: &mut Command, number: &Path, hanging: &str) {
    let mut child = command.stdout(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap();
    let begin = Instant::now();
    let hung = loop {
        match fs::read_to_string(number) {
            Ok(number) if number.ends_with('\n') => break number,
            _ if begin.elapsed() > Duration::from_secs(20) => {
                child.kill().unwrap();
                panic!("{hanging} was never asked");
            }
            _ => thread::sleep(Duration::from_millis(5)),
        }
    };
    assert!(Command::new("kill").args(["-INT", &child.id().to_string()]).status().unwrap().success());
    let asked = Instant::now();
    let status = loop {
        if let Some(status) = child.try_wait().unwrap() {
            break status;
        }
        if asked.elapsed() > Duration::from_secs(10) {
            child.kill().unwrap();
            panic!("{hanging}: Ctrl-C ends nothing");
        }
        thread::sleep(Duration::from_millis(5));
    };
    let mut said = String::new();
    child.stderr.take().unwrap().read_to_string(&mut said).unwrap();
    // Ctrl-C ends a command at once before the command catches it.
    assert!([Some(130), None].contains(&status.code()), "{hanging}: {status:?} {said}");
    // A killed process ends when it is scheduled next. Its adopting process may collect the exit status later.
    let goes_on = || {
        let stat = fs::read_to_string(format!("/proc/{}/stat", hung.trim())).unwrap_or_default();
        !stat.is_empty() && !stat.contains(") Z ")
    };
    while status.code() == Some(130) && goes_on() {
        assert!(asked.elapsed() < Duration::from_secs(10), "{hanging} goes on");
        thread::sleep(Duration::from_millis(5));
    }
}

/// The search path with this folder first.
fn path_with(bin: &Path) -> String {
    format!("{}:{}", text(bin), std::env::var("PATH").unwrap())
}

/// One Ctrl-C ends the command and `ffmpeg` if `ffmpeg` hangs while it encodes.
#[test]
fn an_encoder_that_hangs_ends_with_ctrl_c() {
    let folder = tempdir().unwrap();
    let number = folder.path().join("number");
    let hang = format!("trap '' INT\necho $$ > {}\nexec sleep 1000", text(&number));
    write_program(&folder.path().join("ffmpeg"), &hang);
    let ply = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../testdata/interchange/original.ply");
    let video = folder.path().join("new.mp4");
    let mut command = tcgs();
    command.env("PATH", path_with(folder.path())).args(["render", text(&ply)]);
    command.args(["--backend", "cpu", "--size", "640x480", "--out", text(&video)]);
    ctrl_c_ends(&mut command, &number, "ffmpeg");
    assert!(!video.exists());
}

/// One Ctrl-C ends the command and the program if `ffmpeg` or `ffprobe` hangs.
#[test]
fn a_program_that_hangs_ends_with_ctrl_c() {
    for hanging in ["ffprobe", "ffmpeg"] {
        let folder = described(b"RIFF, which is no MP4 file", "avi");
        let bin = folder.path().join("bin");
        fs::create_dir(&bin).unwrap();
        let number = folder.path().join("number");
        let hang = format!("trap '' INT\necho $$ > {}\nexec sleep 1000", text(&number));
        let probe = r#"echo '{"streams": [{"codec_name": "x", "width": 64, "height": 48}], "packets": ['
for i in 0 1 2; do echo "{\"pts_time\": \"0.0$((4 * i))\"},"; done
echo '{"pts_time": "0.12"}]}'"#;
        for name in ["ffprobe", "ffmpeg"] {
            let script = match (name == hanging, name) {
                (true, _) => hang.clone(),
                (false, "ffprobe") => probe.to_owned(),
                (false, _) => "exit 1".to_owned(),
            };
            write_program(&bin.join(name), &script);
        }
        let points = folder.path().join("points.npz");
        let mut command = tcgs();
        command.env("PATH", path_with(&bin)).args(["prepare", text(folder.path()), "--points-only", text(&points)]);
        ctrl_c_ends(&mut command, &number, hanging);
        assert!(!points.exists());
    }
}

#[test]
fn cameras_and_points_beyond_reach_are_named() {
    let copy = || {
        let folder = tempdir().unwrap();
        write_synthetic(folder.path(), &SETTINGS).unwrap();
        folder
    };
    let out = tempdir().unwrap();
    let train = |folder: &TempDir, more: &[&str], expected: &[&str]| {
        let arguments = ["train", text(folder.path()), "--out", text(out.path())];
        refused(&[&arguments[..], &["--force"], more].concat(), expected);
    };
    let folder = copy();
    let meta = folder.path().join("train_meta.json");
    let mut value = json(&meta);
    value["w2c"][0][0][0][3] = 1e300.into();
    fs::write(&meta, value.to_string()).unwrap();
    train(&folder, &[], &["train_meta.json: ", "w2c row 0 column 3 is 1e300, expected 1e12 or less"]);

    let ply = folder.path().join("far.ply");
    let head = "ply\nformat ascii 1.0\nelement vertex 2\nproperty float x\nproperty float y\nproperty float z\n\
                property uchar red\nproperty uchar green\nproperty uchar blue\nend_header\n";
    fs::write(&ply, format!("{head}0 0 0 1 2 3\n0 1e30 0 1 2 3\n")).unwrap();
    train(&copy(), &["--points", text(&ply)], &["far.ply: point 1 has the coordinate 1e30, expected 1e12 or less"]);
}

#[test]
fn numbers_beyond_their_bounds_are_named() {
    let capture = text(capture());
    let out = tempdir().unwrap();
    let out = out.path().join("out");
    let train = |more: &[&str], expected: &[&str]| {
        refused(&[&["train", capture, "--out", text(&out)], more].concat(), expected);
    };
    train(&["--threads", "100000"], &["--threads", "'100000'", "a whole number from 1 to 1024"]);
    train(&["--iterations", "999999999999,1"], &["999999999999", "a whole number from 1 to 100000000"]);
    train(&["--set", "quantize.max_bits=100000"], &["quantize.max_bits is 100000", "from 1 to 16"]);
    train(&["--set", "densify.split_children=3"], &["densify.split_children is 3, expected 2"]);
    train(&["--frames", "0..4000000000"], &["data.end_frame is 4000000000"]);
    train(&["--downscale", "4000000000"], &["4000000000"]);
    refused(&["render", "x", "--out", text(&out), "--size", "16384x16384"], &["'16384x16384'", "67108864 at most"]);
    refused(&["compress", "x", "--max-keypoints", "4000000000"], &["2..=65536"]);
    refused(&["bench", "--gaussians", "1000000000000"], &["a whole number from 1 to 100000000"]);
    refused(&["prepare", capture, "--points", "1000000000000"], &["a whole number from 1 to 100000000"]);
}
