//! Matching on numbers alone; the integration tests use recordings.

use tcgs_capture::CalibratedCamera;

use super::matching::{matched, number_in};
use super::*;

fn camera(names: &[&str], shift: f64) -> CalibratedCamera {
    CalibratedCamera {
        names: names.iter().map(|name| (*name).to_owned()).collect(),
        size: None,
        angle_x: None,
        focal: [1.0; 2],
        principal: [0.0; 2],
        distortion: [0.0; 8],
        camera_from_world: [[1.0, 0.0, 0.0, shift], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0]],
    }
}

fn names(names: &[&str]) -> Vec<String> {
    names.iter().map(|name| (*name).to_owned()).collect()
}

/// The places of the cameras that were matched.
#[track_caller]
fn check(recordings: &[&str], cameras: &[CalibratedCamera], expected: &[f64]) {
    let (found, _) = matched(&names(recordings), cameras).unwrap();
    let found: Vec<f64> = found.iter().map(|camera| camera.camera_from_world[0][3]).collect();
    assert_eq!(found, expected);
}

#[test]
fn cameras_are_matched_by_name_and_then_by_number() {
    let cameras = [camera(&["Cam-02"], 2.0), camera(&["cam_10"], 10.0), camera(&["cam1"], 1.0)];
    check(&["cam02", "cam10", "CAM_1"], &cameras, &[2.0, 10.0, 1.0]);
    check(&["video1", "video2", "video10"], &cameras, &[1.0, 2.0, 10.0]);
    check(&["left", "right"], &[camera(&["right"], 1.0), camera(&["left", "cam_7"], 0.0)], &[0.0, 1.0]);
    check(&["cam_0", "cam_1"], &[camera(&["0", "cam_0"], 0.0), camera(&["1", "cam_1"], 1.0)], &[0.0, 1.0]);
    let (_, unused) = matched(&names(&["cam1"]), &cameras).unwrap();
    assert_eq!(unused, ["Cam-02", "cam_10"]);
    // Several images of a camera that stands still.
    check(&["a"], &[camera(&["0000", "a"], 3.0), camera(&["0001", "a"], 3.0)], &[3.0]);
}

#[test]
fn cameras_that_cannot_be_matched_are_named() {
    let cameras = [camera(&["cam1"], 1.0), camera(&["cam2"], 2.0)];
    let problem = |recordings: &[&str]| matched(&names(recordings), &cameras).unwrap_err();
    assert_eq!(problem(&["cam1", "cam3"]), "has no camera cam3, expected one for each recording; it has cam1, cam2");
    // Two recordings with one number: the assignment is ambiguous.
    assert!(problem(&["a1", "b1"]).starts_with("has no camera a1"));
    let moving = [camera(&["0000", "a"], 1.0), camera(&["0001", "a"], 1.5)];
    let moves = matched(&names(&["a"]), &moving).unwrap_err();
    assert_eq!(moves, "has several poses of a (0000, 0001), expected a camera that stands still");
}

#[test]
fn the_last_number_in_a_name_counts() {
    let found = ["cam01", "take2_cam12_raw", "é7", "none", "3d_left"].map(number_in);
    assert_eq!(found, [Some(1), Some(12), Some(7), None, Some(3)]);
    assert_eq!(ids_of(&names(&["cam3", "cam1"])), [3, 1]);
    assert_eq!(ids_of(&names(&["a1", "b1"])), [0, 1]);
}
