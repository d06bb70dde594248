//! Published raw footage, where available: calibrations of other programs, and clocks.

use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use rand::{RngExt, SeedableRng};
use tcgs_capture::{Calibration, Capture, Split};
use tcgs_prepare::{Clocks, ClocksFrom, DescribeSettings, RawFootage};
use tempfile::TempDir;

use crate::support::{has_ffmpeg, real_folder};

/// The folder of some footage. `None` skips the test, unless the footage is required.
fn folder(name: &str) -> Option<PathBuf> {
    real_folder(name).filter(|_| has_ffmpeg())
}

/// A folder with links to the files of another.
fn linked(source: &Path) -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    for entry in std::fs::read_dir(source).unwrap() {
        let entry = entry.unwrap();
        std::os::unix::fs::symlink(entry.path(), folder.path().join(entry.file_name())).unwrap();
    }
    folder
}

/// Describes footage whose cameras began at once, and opens it.
fn prepared(source: &Path) -> (TempDir, Capture, Vec<String>) {
    let folder = linked(source);
    let raw = RawFootage::find(folder.path(), None).unwrap().unwrap();
    let placed = raw.place(&Calibration::find(folder.path()).unwrap().unwrap()).unwrap();
    let clocks = Clocks::assumed(raw.cameras().len());
    let description = raw.describe(&placed, &clocks, &DescribeSettings::default()).unwrap();
    std::fs::write(folder.path().join("capture.toml"), description.to_toml()).unwrap();
    let capture = Capture::open(folder.path()).unwrap();
    (folder, capture, placed.source.changes)
}

#[test]
fn videos_of_two_shapes_fit_one_calibration_of_qualisys() {
    let Some(source) = folder("balance_raw") else { return };
    let (_folder, capture, changes) = prepared(&source);
    assert_eq!((capture.num_frames(), capture.frame_rate()), (100, 60.0));
    // Two videos were converted to another width, which left bars above and below.
    assert_eq!(changes.len(), 2, "{changes:?}");
    assert!(changes[0].starts_with("cam01: black bars are cropped, which leaves 1080x1906 of 1080x1920 pixels"));
    let cameras = capture.cameras(Split::Train, 0, 1).unwrap();
    // The cameras stand around the beam and look at it: at a place about a metre above the floor, within two metres.
    for (id, camera) in &cameras {
        let (center, forward) = (camera.center(), camera.forward());
        let distance = (center[0] * center[0] + center[1] * center[1]).sqrt();
        assert!((2.0..4.5).contains(&distance) && (1.5..2.2).contains(&center[2]), "camera {id} at {center:?}");
        let towards = -(forward[0] * center[0] + forward[1] * center[1]) / distance;
        assert!(towards > 0.7, "camera {id} looks away: {towards}");
        let ([u, v], _) = camera.project([0.0, 0.0, 1.0]).unwrap();
        assert!((0.0..camera.width as f64).contains(&u) && (0.0..camera.height as f64).contains(&v), "camera {id}");
    }
    for view in capture.views(Split::Train, 99, 4).unwrap() {
        let mean = view.image.data.iter().sum::<f32>() / view.image.data.len() as f32;
        assert!((0.1..0.7).contains(&mean), "camera {}: mean {mean}", view.camera_id);
        // No bar is left.
        let row = |y: usize| view.image.data[y * view.image.width..][..view.image.width].iter().sum::<f32>();
        assert!(row(0) > 0.1 * view.image.width as f32 && row(view.image.height - 1) > 0.1 * view.image.width as f32);
    }
}

#[test]
fn videos_of_part_2_have_a_calibration_of_caliscope() {
    let Some(source) = folder("board_raw") else { return };
    let (_folder, capture, changes) = prepared(&source);
    assert_eq!((capture.num_frames(), capture.frame_rate(), changes.len()), (48, 6.0, 0));
    let cameras = capture.cameras(Split::Train, 0, 1).unwrap();
    assert_eq!(cameras.iter().map(|(id, _)| *id).collect::<Vec<_>>(), [0, 1, 2, 3]);
    // Camera 1 is the origin of the calibration.
    assert!(cameras[1].1.center().iter().all(|x| x.abs() < 0.01));
    assert_eq!(capture.views(Split::Train, 47, 2).unwrap().len(), 4);
}

/// Number of frames that are cut off at the beginning of each camera of kitchen, each different from its neighbours'.
fn cuts(num_cameras: usize) -> Vec<usize> {
    (0..num_cameras).map(|i| (7 * i + 5) % 31).collect()
}

/// Kitchen's videos without their first frames, small, with sound if there is some.
///
/// - `sound`: samples of the whole scene, 48000 per second
fn uneven_kitchen(source: &Path, sound: Option<&[i16]>) -> (TempDir, Vec<usize>) {
    let folder = tempfile::tempdir().unwrap();
    let cuts = cuts(19);
    for (i, cut) in cuts.iter().enumerate() {
        let name = format!("cam{i:02}.mp4");
        let mut command = Command::new("ffmpeg");
        command.args(["-v", "error", "-y", "-i"]).arg(source.join(&name));
        if let Some(sound) = sound {
            let file = folder.path().join("sound.raw");
            let heard = &sound[cut * 1600..];
            std::fs::write(&file, heard.iter().flat_map(|sample| sample.to_le_bytes()).collect::<Vec<u8>>()).unwrap();
            command.args(["-f", "s16le", "-ar", "48000", "-i"]).arg(file).args(["-c:a", "aac", "-map", "1:a"]);
        }
        let filter = format!("trim=start_frame={cut},setpts=PTS-STARTPTS,scale=338:254");
        command.args(["-map", "0:v", "-vf", &filter, "-c:v", "libx264", "-preset", "veryfast", "-crf", "20"]);
        assert!(command.arg(folder.path().join(&name)).stdin(Stdio::null()).status().unwrap().success());
    }
    (folder, cuts)
}

/// Number of frames of kitchen by which each camera begins after the first, rounded, and the largest rounding error.
fn measured(folder: &TempDir, expected: ClocksFrom) -> (Vec<i64>, f64) {
    let raw = RawFootage::find(folder.path(), None).unwrap().unwrap();
    let most = std::sync::Mutex::new(0.0_f64);
    let clocks = raw.measure_clocks(&|share| {
        let mut most = most.lock().unwrap();
        *most = most.max(share);
    });
    let clocks = clocks.unwrap();
    assert_eq!(most.into_inner().unwrap(), 1.0, "it says how far it is, to the end");
    assert_eq!(clocks.from, expected);
    let frames: Vec<f64> = clocks.event_secs.iter().map(|secs| 30.0 * (clocks.event_secs[0] - secs)).collect();
    let worst = frames.iter().map(|frames| (frames - frames.round()).abs()).fold(0.0, f64::max);
    (frames.into_iter().map(|frames| frames.round() as i64).collect(), worst)
}

#[test]
fn kitchens_cameras_are_synchronised_by_what_moves() {
    let Some(source) = folder("kitchen") else { return };
    let (folder, cuts) = uneven_kitchen(&source, None);
    let expected: Vec<i64> = cuts.iter().map(|&cut| cut as i64 - cuts[0] as i64).collect();
    assert_eq!(measured(&folder, ClocksFrom::Motion).0, expected);
}

#[test]
fn kitchens_cameras_are_synchronised_by_sound() {
    let Some(source) = folder("kitchen") else { return };
    // Steps and clatter: short noises of random loudness over a hum.
    let mut random = rand_pcg::Pcg32::seed_from_u64(5);
    let mut loudness = 0.0_f32;
    let sound: Vec<i16> = (0..100 * 1600)
        .map(|i| {
            loudness *= 0.9995;
            if random.random_range(0..4000) == 0 {
                loudness = random.random_range(0.1..1.0);
            }
            let hum = 0.02 * (i as f32 * 0.0065).sin();
            (12000.0 * (loudness * random.random_range(-1.0_f32..1.0) + hum)) as i16
        })
        .collect();
    let (folder, cuts) = uneven_kitchen(&source, Some(&sound));
    let expected: Vec<i64> = cuts.iter().map(|&cut| cut as i64 - cuts[0] as i64).collect();
    let (found, worst) = measured(&folder, ClocksFrom::Sound);
    assert_eq!(found, expected);
    assert!(worst < 0.05, "off by {worst} of a frame");
}
