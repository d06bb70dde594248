//! Real and rendered captures, where available: the doctor finds nothing, and points come from images alone.

use tcgs_capture::{
    CameraBuilder, Capture, CaptureBuilder, CaptureError, Origin, Split, SyntheticSettings, write_synthetic,
};
use tcgs_core::View;
use tcgs_prepare::{StereoSettings, check, stereo_points};

use crate::support::real_folder;

#[test]
fn real_captures_are_healthy() {
    for name in ["panoptic_basketball", "toss"] {
        let Some(path) = real_folder(name) else { return };
        let diagnosis = check(&Capture::open(&path).unwrap(), &mut |_| ()).unwrap();
        assert_eq!(diagnosis.findings, [], "{name}");
        assert!(diagnosis.cameras.iter().all(|camera| camera.fit.unwrap() > 0.5), "{name}: {:?}", diagnosis.cameras);
    }
}

#[test]
fn basketball_is_prepared_from_its_images() {
    let Some(path) = real_folder("panoptic_basketball") else { return };
    let capture = Capture::open(&path).unwrap();
    // Coarser than by default, to save time.
    let settings = StereoSettings { image_width: 160, ..StereoSettings::default() };
    let prepared = stereo_points(&capture, &settings, &mut |_| ()).unwrap();
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

#[test]
fn a_capture_made_in_memory_is_prepared() {
    let folder = tempfile::tempdir().unwrap();
    let settings =
        SyntheticSettings { num_timesteps: 1, num_train_cameras: 6, num_test_cameras: 1, ..Default::default() };
    write_synthetic(folder.path(), &settings).unwrap();
    let stored = Capture::open(folder.path()).unwrap();
    let mut built = CaptureBuilder::new("room", 1);
    for View { camera, image, camera_id, .. } in stored.views(Split::Train, 0, 1).unwrap() {
        built = built.train_camera(CameraBuilder::new(camera_id, camera).images(vec![image]));
    }
    let built = built.build().unwrap();
    assert!(matches!(built.point_cloud(), Err(CaptureError::NoPoints { .. })));
    let settings = StereoSettings { num_points: 2000, image_width: 64, ..StereoSettings::default() };
    let prepared = stereo_points(&built, &settings, &mut |_| ()).unwrap();
    assert!(prepared.cloud.points.len() > 1000, "{}", prepared.cloud.points.len());
}
