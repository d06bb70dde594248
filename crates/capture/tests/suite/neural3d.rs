//! Neural 3D Video: the contents of a whole capture, and the errors of a spoilt one.

use std::fs;
use std::path::{Path, PathBuf};

use crate::support::{assert_close, camera_of, problem, shorten, write_image, write_ply};
use tcgs_capture::{Capture, CaptureKind, Split};
use tcgs_core::Camera;
use tempfile::TempDir;

const NUM_CAMERAS: usize = 4;
/// Number of frames of the videos.
const NUM_FRAMES: usize = 12;

fn video(name: &str) -> PathBuf {
    Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../../testdata/video")).join(name)
}

/// A row of `poses_bounds.npy`.
fn pose(camera: &Camera) -> [f64; 17] {
    let [right, down, forward, _] = camera.camera_from_world;
    let center = camera.center();
    let mut row = [0.0; 17];
    for i in 0..3 {
        let size = [camera.height as f64, camera.width as f64, camera.focal[0]][i];
        row[5 * i..][..5].copy_from_slice(&[down[i], right[i], -forward[i], center[i], size]);
    }
    row[15..].copy_from_slice(&[0.5, 5.0]);
    row
}

fn write_poses(folder: &Path, rows: &[[f64; 17]]) {
    let mut header = format!("{{'descr': '<f8', 'fortran_order': False, 'shape': ({}, 17), }}", rows.len());
    header += &" ".repeat(63 - (10 + header.len()) % 64);
    let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
    bytes.extend((header.len() as u16 + 1).to_le_bytes());
    bytes.extend(header.as_bytes());
    bytes.push(b'\n');
    bytes.extend(rows.as_flattened().iter().flat_map(|x| x.to_le_bytes()));
    fs::write(folder.join("poses_bounds.npy"), bytes).unwrap();
}

fn camera(id: usize) -> Camera {
    camera_of(id, NUM_CAMERAS, 64, 48)
}

fn poses() -> Vec<[f64; 17]> {
    (0..NUM_CAMERAS).map(|id| pose(&camera(id))).collect()
}

/// A capture of four videos.
fn small() -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    write_poses(folder.path(), &poses());
    for id in 0..NUM_CAMERAS {
        fs::copy(video("frames.mp4"), folder.path().join(format!("cam{id:02}.mp4"))).unwrap();
    }
    write_ply(&folder.path().join("points3D.ply"));
    folder
}

#[test]
fn videos_and_poses_are_a_capture() {
    let folder = small();
    let capture = Capture::open(folder.path()).unwrap();
    assert_eq!((capture.kind(), capture.num_frames(), capture.usual_frames()), (CaptureKind::NEURAL3D, 12, 0..12));
    assert_eq!((capture.frame_rate(), capture.has_segmentation()), (25.0, false));
    for (split, ids) in [(Split::Train, vec![1, 2, 3]), (Split::Test, vec![0])] {
        let found = capture.cameras(split, 5, 1).unwrap();
        assert_eq!(found.iter().map(|(id, _)| *id).collect::<Vec<_>>(), ids);
        for (id, found) in found {
            assert_close(&found, &camera(id));
        }
    }
    let cloud = capture.point_cloud().unwrap();
    assert_eq!((cloud.points.len(), cloud.colors[0], cloud.foreground[0]), (50, [1.0, 0.0, 0.0], true));
}

/// The brightness of an image tells its frame of `frames.mp4`.
fn brightness(capture: &Capture, frame: usize) -> f64 {
    let views = capture.views(Split::Train, frame, 1).unwrap();
    let of =
        |i: usize| views[i].image.data.iter().map(|&x| f64::from(x)).sum::<f64>() / views[i].image.data.len() as f64;
    assert!((of(0) - of(2)).abs() < 1e-9);
    of(0) * 255.0
}

#[test]
fn frames_come_in_any_order() {
    let folder = small();
    let capture = Capture::open(folder.path()).unwrap();
    let orders: [Vec<usize>; 3] = [(0..NUM_FRAMES).collect(), vec![11, 0, 7, 3, 4, 4, 10, 9, 1], vec![6, 6, 5, 11]];
    for frame in orders.concat() {
        // 40 at the left, 71.5 at the right, in limited range; 15 more with every frame.
        let expected = (40.0 + 15.75 - 16.0 + 15.0 * frame as f64) * 255.0 / 219.0;
        let found = brightness(&capture, frame);
        assert!((found - expected).abs() < 1.5, "frame {frame}: {found}, expected {expected}");
    }
}

#[test]
fn folders_of_images_stand_in_for_videos() {
    let folder = tempfile::tempdir().unwrap();
    write_poses(folder.path(), &poses());
    for id in 0..NUM_CAMERAS {
        for frame in 0..3 {
            // The layout of the preparation for 4D Gaussian Splatting; not all cameras have the same number of frames.
            if (id, frame) != (3, 2) {
                let path = folder.path().join(format!("cam{id:02}/images/{frame:04}.png"));
                write_image(&path, 64, 48, [10 * id as u8, 20 * frame as u8, 0]);
            }
        }
    }
    let capture = Capture::open(folder.path()).unwrap();
    assert_eq!(capture.num_frames(), 2);
    let views = capture.views(Split::All, 1, 1).unwrap();
    assert_eq!(views.iter().map(|view| view.image.to_rgb8()[0]).collect::<Vec<_>>(), [10, 20, 30, 0]);
    assert!(capture.point_cloud().unwrap_err().to_string().contains("has no initial points"));
}

#[test]
fn images_of_the_published_size_are_halved() {
    let folder = tempfile::tempdir().unwrap();
    let published: Vec<Camera> = (0..2).map(|id| camera_of(id, 4, 2704, 2028)).collect();
    write_poses(folder.path(), &published.iter().map(pose).collect::<Vec<_>>());
    for id in 0..2 {
        write_image(&folder.path().join(format!("cam{id:02}/0000.png")), 2704, 2028, [50, 100, 150]);
    }
    let capture = Capture::open(folder.path()).unwrap();
    let view = &capture.views(Split::Test, 0, 1).unwrap()[0];
    assert_eq!((view.image.width, view.image.height), (1352, 1014));
    assert_eq!(view.image.to_rgb8()[..3], [50, 100, 150]);
    assert_close(&view.camera, &published[0].downscaled(2));
    assert_close(&capture.cameras(Split::Test, 0, 2).unwrap()[0].1, &published[0].downscaled(4));
}

#[test]
fn smaller_videos_than_the_poses_say_shrink_the_focal_length() {
    let folder = small();
    let rows: Vec<_> = (0..NUM_CAMERAS).map(|id| pose(&camera_of(id, NUM_CAMERAS, 128, 96))).collect();
    write_poses(folder.path(), &rows);
    assert_close(&Capture::open(folder.path()).unwrap().cameras(Split::Test, 0, 1).unwrap()[0].1, &camera(0));
    let rows: Vec<_> = (0..NUM_CAMERAS).map(|id| pose(&camera_of(id, NUM_CAMERAS, 64, 47))).collect();
    write_poses(folder.path(), &rows);
    assert_eq!(
        problem(folder.path()),
        "poses_bounds.npy: row 0, of cam00.mp4: is for 64x47 pixels, expected the shape of 64x48"
    );
}

#[test]
fn a_missing_video_is_named() {
    let folder = small();
    fs::remove_file(folder.path().join("cam02.mp4")).unwrap();
    assert_eq!(
        problem(folder.path()),
        "poses_bounds.npy: has 4 poses for 3 videos, expected one pose for each camera, in the order of their names; \
         missing: cam02"
    );
    fs::rename(folder.path().join("cam03.mp4"), folder.path().join("cam07.mp4")).unwrap();
    assert!(problem(folder.path()).starts_with("poses_bounds.npy: has 4 poses for 3 videos cam*.mp4, expected"));
    for id in [0, 1, 7] {
        fs::remove_file(folder.path().join(format!("cam{id:02}.mp4"))).unwrap();
    }
    assert!(problem(folder.path()).starts_with("poses_bounds.npy: has 4 poses, but there is no cam*.mp4, expected"));
}

#[test]
fn wrong_poses_are_named() {
    let folder = small();
    let mut rows = poses();
    rows[2][0] += 0.5;
    write_poses(folder.path(), &rows);
    let message = problem(folder.path());
    assert!(message.starts_with("poses_bounds.npy: row 2, of cam02.mp4: the upper left 3x3"), "{message}");
    fs::write(folder.path().join("poses_bounds.npy"), b"\x93NUMPY").unwrap();
    assert_eq!(problem(folder.path()), "poses_bounds.npy: ends inside its header");
    // Backward and forward confused: the cameras look away.
    let turned: Vec<_> = (0..NUM_CAMERAS)
        .map(|id| {
            let center = camera(id).center();
            let away = Camera::look_at(center, center.map(|x| 2.0 * x), [0.0, -1.0, 0.0], 56.0, 64, 48);
            pose(&away)
        })
        .collect();
    write_poses(folder.path(), &turned);
    let message = problem(folder.path());
    assert!(message.starts_with("poses_bounds.npy: the cameras look away from the point cloud"), "{message}");
}

#[test]
fn videos_that_cannot_be_decoded_are_named() {
    let folder = small();
    let spoilt = folder.path().join("cam01.mp4");
    fs::copy(video("hevc.mp4"), &spoilt).unwrap();
    let message = problem(folder.path());
    assert!(
        message.starts_with("cam01.mp4: has the codec hvc1") || message.starts_with("cam01.mp4: has the codec hev1")
    );
    assert!(message.contains("expected H.264 of 8 bits, 4:2:0, such as `ffmpeg -i"), "{message}");
    fs::copy(video("halves.mp4"), &spoilt).unwrap();
    assert!(problem(folder.path()).starts_with("cam01.mp4: does not have colours of half width and height (4:2:0)"));
    fs::write(&spoilt, b"not a video at all").unwrap();
    assert!(problem(folder.path()).starts_with("cam01.mp4: cannot be read: "), "{}", problem(folder.path()));
}

#[test]
fn a_spoilt_video_gives_an_error_and_never_a_wrong_frame() {
    let folder = small();
    let spoilt = folder.path().join("cam01.mp4");
    let whole = fs::read(video("frames.mp4")).unwrap();
    for length in (0..whole.len()).step_by(97) {
        fs::write(&spoilt, &whole[..length]).unwrap();
        assert!(problem(folder.path()).starts_with("cam01.mp4: "), "{length}");
    }
    // The coded frames stand between the two; the units have impossible lengths.
    let start = whole.windows(4).position(|w| w == b"mdat").unwrap() + 4;
    let mut bytes = whole;
    bytes[start..start + 400].fill(0xff);
    fs::write(&spoilt, &bytes).unwrap();
    let capture = Capture::open(folder.path()).unwrap();
    let message = shorten(folder.path(), &capture.views(Split::Train, 0, 1).unwrap_err());
    assert!(message.starts_with("cam01.mp4: "), "{message}");
}

#[test]
fn spoilt_bytes_of_a_video_do_no_harm() {
    let folder = small();
    let spoilt = folder.path().join("cam01.mp4");
    let whole = fs::read(video("frames.mp4")).unwrap();
    // Every byte would take minutes, since each needs a new decoder.
    for at in (0..whole.len()).step_by(13) {
        let mut bytes = whole.clone();
        bytes[at] ^= 0xff;
        fs::write(&spoilt, &bytes).unwrap();
        // The file, and each of its frames, opens or gives an error that names it.
        let result = Capture::open(folder.path()).and_then(|capture| capture.views(Split::Train, 7, 1));
        if let Err(error) = result {
            let message = shorten(folder.path(), &error);
            assert!(message.contains("cam01.mp4"), "byte {at}: {message}");
        }
    }
}

#[test]
fn points_come_from_a_model_beside_the_videos() {
    let folder = small();
    fs::remove_file(folder.path().join("points3D.ply")).unwrap();
    let sparse = folder.path().join("sparse/0");
    fs::create_dir_all(&sparse).unwrap();
    fs::write(sparse.join("cameras.txt"), "").unwrap();
    fs::write(sparse.join("points3D.txt"), "# c\n1 0.1 0 0 0 255 0 0.5\n2 0 0.1 0 0 0 255 0.5 1 2\n").unwrap();
    let capture = Capture::open(folder.path()).unwrap();
    assert_eq!(capture.kind(), CaptureKind::NEURAL3D);
    assert_eq!(capture.point_cloud().unwrap().colors, [[0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]);
}
