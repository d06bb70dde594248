//! Technicolor: the contents of a whole capture, and the errors of a spoilt one.

use std::fs;
use std::path::{Path, PathBuf};

use crate::support::{assert_close, camera_of, problem, quat, shorten, write_image, write_ply};
use tcgs_capture::{Capture, CaptureKind, Split};
use tempfile::TempDir;

const NUM_CAMERAS: usize = 16;

fn image(folder: &Path, frame: usize, camera: usize) -> PathBuf {
    folder.join(format!("Birthday_undist_{frame:05}_{camera:02}.png"))
}

fn parameters(camera: usize) -> String {
    let c = camera_of(camera, NUM_CAMERAS, 16, 12);
    let [qw, qx, qy, qz] = quat(&c);
    let [tx, ty, tz] = [0, 1, 2].map(|i| c.camera_from_world[i][3]);
    format!("{} {} {} 1 0 {qw} {qx} {qy} {qz} {tx} {ty} {tz}", c.focal[0], c.principal[0], c.principal[1])
}

fn write_cameras(folder: &Path, lines: &[String]) {
    let text = format!("f(pix) cu(pix) cv(pix) ar sk qw qx qy qz tx ty tz\n{}\n", lines.join("\n"));
    fs::write(folder.join("cameras_parameters.txt"), text).unwrap();
}

fn lines() -> Vec<String> {
    (0..NUM_CAMERAS).map(parameters).collect()
}

/// Frames 149 to 152 and 172 to 174 of Birthday.
fn small() -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    write_cameras(folder.path(), &lines());
    for frame in [149, 150, 151, 152, 172, 173, 174] {
        for camera in 0..NUM_CAMERAS {
            write_image(&image(folder.path(), frame, camera), 16, 12, [frame as u8, camera as u8, 7]);
        }
    }
    write_ply(&folder.path().join("points3D.ply"));
    folder
}

#[test]
fn images_and_parameters_are_a_capture() {
    let folder = small();
    let capture = Capture::open(folder.path()).unwrap();
    assert_eq!((capture.kind(), capture.num_frames(), capture.frame_rate()), (CaptureKind::TECHNICOLOR, 7, 30.0));
    // Publications begin with 151.
    assert_eq!(capture.usual_frames(), 2..7);
    let ids = |split| capture.cameras(split, 0, 1).unwrap().into_iter().map(|(id, _)| id).collect::<Vec<_>>();
    assert_eq!((ids(Split::Train).len(), ids(Split::Test)), (15, vec![10]));
    for (id, found) in capture.cameras(Split::All, 3, 1).unwrap() {
        assert_close(&found, &camera_of(id, NUM_CAMERAS, 16, 12));
    }
    let views = capture.views(Split::All, 3, 1).unwrap();
    for view in &views {
        assert_eq!(view.image.to_rgb8()[..3], [152, view.camera_id as u8, 7]);
    }
    assert_eq!(capture.point_cloud().unwrap().points.len(), 50);
}

#[test]
fn the_damaged_file_is_mended_with_the_frame_before() {
    let folder = small();
    let cut = |frame: usize, camera: usize| {
        let path = image(folder.path(), frame, camera);
        // Noise, so that half of the bytes are half of the rows.
        let noise = |x: u32, y: u32, c: u32| ((x * 7919 + y * 104_729 + c * 1299 + x * y * 31) % 251) as u8;
        let picture = image::RgbImage::from_fn(16, 12, |x, y| image::Rgb([0, 1, 2].map(|c| noise(x, y, c))));
        picture.save(&path).unwrap();
        let bytes = fs::read(&path).unwrap();
        fs::write(&path, &bytes[..bytes.len() * 6 / 10]).unwrap();
        picture
    };
    let capture = Capture::open(folder.path()).unwrap();
    let picture = cut(173, 9);
    let mended = capture.views(Split::Train, 5, 1).unwrap()[9].image.to_rgb8();
    let row = |y: usize| mended[y * 48..][..48].to_vec();
    assert_eq!(row(0), picture.as_raw()[..48]);
    assert_eq!(row(11), [172, 9, 7].repeat(16));
    let own = (0..12).filter(|&y| row(y) == picture.as_raw()[y * 48..][..48]).count();
    assert!((3..10).contains(&own) && (own..12).all(|y| row(y) == row(11)), "{own} rows are its own");
    // No other file is repaired.
    cut(173, 8);
    let message = shorten(folder.path(), &capture.views(Split::Train, 5, 1).unwrap_err());
    assert!(message.starts_with("Birthday_undist_00173_08.png: cannot be decoded"), "{message}");
}

#[test]
fn what_is_missing_is_named() {
    let folder = small();
    fs::remove_file(image(folder.path(), 172, 5)).unwrap();
    assert_eq!(
        problem(folder.path()),
        "Birthday_undist_00172_05.png: no such file, expected an image for each of the 16 cameras in \
         cameras_parameters.txt"
    );
    write_image(&image(folder.path(), 172, 5), 16, 12, [0; 3]);
    write_cameras(folder.path(), &lines()[..15]);
    assert_eq!(
        problem(folder.path()),
        "cameras_parameters.txt: has 15 cameras, expected more: Birthday_undist_00149_15.png is of camera 15"
    );
    for entry in fs::read_dir(folder.path()).unwrap().map(|entry| entry.unwrap().path()) {
        if entry.extension().is_some_and(|e| e == "png") {
            fs::remove_file(entry).unwrap();
        }
    }
    let message = problem(folder.path());
    assert!(message.contains("no images, expected <Scene>_undist_<frame>_<camera>.png"), "{message}");
}

#[test]
fn two_scenes_in_one_folder_are_refused() {
    let folder = small();
    write_image(&folder.path().join("Train_undist_00151_00.png"), 16, 12, [0; 3]);
    let found = "Train_undist_00151_00.png: is of the scene Train, expected Birthday as the files before it";
    assert_eq!(problem(folder.path()), found);
}

#[test]
fn wrong_parameters_are_named() {
    let folder = small();
    let spoilt = |change: &dyn Fn(&mut String)| {
        let mut lines = lines();
        change(&mut lines[3]);
        write_cameras(folder.path(), &lines);
        problem(folder.path())
    };
    let message = spoilt(&|line| line.push_str(" 1 2"));
    assert!(message.starts_with("cameras_parameters.txt: line 5: has 14 numbers, those of the original images"));
    let message = spoilt(&|line| line.push_str(" 1"));
    assert!(message.starts_with("cameras_parameters.txt: line 5: has 13 numbers, expected 12 numbers: f cu cv"));
    let message = spoilt(&|line| *line = line.replacen(" 1 0 ", " x 0 ", 1));
    assert!(message.starts_with("cameras_parameters.txt: line 5: found x, expected 12 numbers"), "{message}");
    let message = spoilt(&|line| *line = "14 8 6 1 0 2 0 0 0 1 2 3".into());
    assert_eq!(message, "cameras_parameters.txt: line 5, camera 3: the quaternion has the length 2, expected 1");
    let message = spoilt(&|line| *line = "14 8 6 1 5 1 0 0 0 1 2 3".into());
    assert!(message.contains("camera 3: k is not a pinhole matrix"), "{message}");
}
