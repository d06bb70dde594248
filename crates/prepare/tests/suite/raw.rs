//! Folders of videos that become captures. The tests need the program `ffmpeg`.

use std::path::MAIN_SEPARATOR;

use tcgs_capture::{Calibration, Capture, CaptureDescription, Split};
use tcgs_prepare::{Clocks, ClocksFrom, DescribeSettings, PrepareError, RawFootage};
use tempfile::TempDir;

use crate::support::has_ffmpeg;
use crate::support::numbered::{H264, convert, encode, number_of};

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
fn prepared(folder: &TempDir, clocks: &str) -> Result<Capture, PrepareError> {
    let raw = RawFootage::find(folder.path(), None)?.unwrap();
    let placed = raw.place(&Calibration::find(folder.path())?.unwrap())?;
    let clocks_file = folder.path().join("offsets.txt");
    std::fs::write(&clocks_file, clocks).unwrap();
    let names: Vec<String> = raw.cameras().into_iter().map(|camera| camera.name).collect();
    let clocks = Clocks::read(&clocks_file, &names)?;
    assert_eq!(clocks.from, ClocksFrom::File);
    let description = raw.describe(&placed, &clocks, &DescribeSettings::default())?;
    std::fs::write(folder.path().join("capture.toml"), description.to_toml()).unwrap();
    let again = CaptureDescription::read(&folder.path().join("capture.toml"))?;
    assert_eq!(again, description);
    Ok(Capture::open(folder.path())?)
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
    let short = |folder: &TempDir, error: PrepareError| {
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
