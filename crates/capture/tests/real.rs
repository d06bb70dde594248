//! Real and rendered captures, where they are at hand.

#![allow(clippy::unwrap_used)] // what helps a test may unwrap as a test may

use std::io::Write;
use std::{ops::Range, path::PathBuf};

use tcgs_capture::{Capture, Origin, PrepareSettings, Split, prepare};

const TEST_CAMERAS: [usize; 4] = [0, 10, 15, 30];

/// The folder of a capture, or nothing, which skips the test unless `REQUIRE_GOLDEN=1`.
fn folder(name: &str) -> Option<PathBuf> {
    let path = PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../../../shared/data")).join(name);
    if path.is_dir() {
        return Some(path);
    }
    assert!(std::env::var("REQUIRE_GOLDEN").as_deref() != Ok("1"), "{} is absent", path.display());
    // Past the capture of passing tests: a skip is to be seen.
    let _ = writeln!(std::io::stderr(), "skipped: {} is absent", path.display());
    None
}

/// Opens a capture and checks what both have in common.
///
/// - `num_masks`: masks of one frame; those of the test cameras are not published for basketball
/// - `foreground_share`: of the pixels that have a mask
fn check(name: &str, num_frames: usize, size: (usize, usize), num_masks: usize, foreground_share: Range<f64>) {
    let Some(path) = folder(name) else { return };
    let capture = Capture::open(&path).unwrap();
    assert_eq!((capture.name().as_str(), capture.num_frames(), capture.frame_rate()), (name, num_frames, 30.0));
    assert!(capture.has_segmentation());
    let ids = |split| capture.cameras(split, 0, 1).unwrap().into_iter().map(|(id, _)| id).collect::<Vec<_>>();
    assert_eq!((ids(Split::Train).len(), ids(Split::Test), ids(Split::All).len()), (27, TEST_CAMERAS.to_vec(), 31));

    let cloud = capture.point_cloud().unwrap();
    assert!(cloud.points.len() > 90_000 && cloud.foreground.iter().filter(|&&f| f).count() > 20_000);

    let last = num_frames - 1;
    let views = capture.views(Split::All, last, 1).unwrap();
    for view in &views {
        assert_eq!((view.frame, view.image.width, view.image.height), (last, size.0, size.1));
        assert_eq!((view.camera.width, view.camera.height), size);
        let mean = view.image.data.iter().sum::<f32>() / view.image.data.len() as f32;
        assert!((0.05..0.95).contains(&mean), "camera {}: mean {mean}", view.camera_id);
    }
    let masks: Vec<_> = views.iter().filter_map(|view| view.segmentation.as_ref()).collect();
    assert_eq!(masks.len(), num_masks);
    let foreground: usize = masks.iter().map(|mask| mask.foreground.iter().filter(|&&f| f).count()).sum();
    let share = foreground as f64 / (masks.len() * size.0 * size.1) as f64;
    assert!(foreground_share.contains(&share), "{share} of the pixels are foreground");

    let (cameras, small) = (capture.cameras(Split::All, 0, 4).unwrap(), capture.views(Split::All, 0, 4).unwrap());
    for ((id, camera), view) in cameras.iter().zip(&small) {
        assert_eq!((*id, camera), (view.camera_id, &view.camera));
        assert_eq!((camera.width, camera.height), (size.0 / 4, size.1 / 4));
        assert_eq!((view.image.width, view.image.height), (size.0 / 4, size.1 / 4));
    }
}

#[test]
fn basketball_opens() {
    check("panoptic_basketball", 150, (640, 360), 27, 0.05..0.2);
}

#[test]
fn toss_opens() {
    check("toss", 40, (320, 180), 31, 0.05..0.2);
}

#[test]
fn real_captures_are_healthy() {
    for name in ["panoptic_basketball", "toss"] {
        let Some(path) = folder(name) else { return };
        let diagnosis = tcgs_capture::check(&Capture::open(&path).unwrap(), &mut |_| ()).unwrap();
        assert_eq!(diagnosis.findings, [], "{name}");
        assert!(diagnosis.cameras.iter().all(|camera| camera.fit.unwrap() > 0.5), "{name}: {:?}", diagnosis.cameras);
    }
}

#[test]
fn basketball_is_prepared_from_its_images() {
    let Some(path) = folder("panoptic_basketball") else { return };
    let capture = Capture::open(&path).unwrap();
    // Coarser than by default, for the sake of time.
    let settings = PrepareSettings { image_width: 160, ..PrepareSettings::default() };
    let prepared = prepare(&capture, &settings, &mut |_| ()).unwrap();
    assert!((60_000..=80_000).contains(&prepared.cloud.points.len()), "{}", prepared.cloud.points.len());
    // The given points are made of stereo, a fitted dome and the floor.
    let given = capture.point_cloud().unwrap();
    for (foreground, origin, limit) in [(true, Origin::Triangulated, 0.02), (false, Origin::Triangulated, 0.1)] {
        let chosen = |i: &usize| prepared.cloud.foreground[*i] == foreground && prepared.origins[*i] == origin;
        let points: Vec<[f32; 3]> =
            (0..prepared.origins.len()).filter(chosen).step_by(50).map(|i| prepared.cloud.points[i]).collect();
        let mut distances: Vec<f32> = points
            .iter()
            .map(|p| {
                let alike = (0..given.points.len()).filter(|&i| given.foreground[i] == foreground);
                let squares = alike.map(|i| (0..3).map(|k| (given.points[i][k] - p[k]).powi(2)).sum::<f32>());
                squares.fold(f32::INFINITY, f32::min).sqrt()
            })
            .collect();
        distances.sort_by(f32::total_cmp);
        assert!(distances.len() > 200 && distances[distances.len() / 2] < limit, "{}", distances[distances.len() / 2]);
    }
}
