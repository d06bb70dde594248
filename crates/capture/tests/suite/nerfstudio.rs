//! `transforms.json`: the contents of a whole capture, and the errors of a spoilt one.

use std::fs;
use std::path::Path;

use crate::support::{assert_close, camera_of, problem, shorten, write_image, write_ply};
use serde_json::{Value, json};
use tcgs_capture::{Capture, CaptureKind, Split};
use tempfile::TempDir;

const NUM_CAMERAS: usize = 8;
const NUM_FRAMES: usize = 3;

/// `world_from_camera`, camera axes right, up, backward.
fn matrix(id: usize) -> Value {
    let camera = camera_of(id, NUM_CAMERAS, 32, 24);
    let (m, center) = (camera.camera_from_world, camera.center());
    let row = |i: usize| json!([m[0][i], -m[1][i], -m[2][i], center[i]]);
    json!([row(0), row(1), row(2), [0.0, 0.0, 0.0, 1.0]])
}

fn file(id: usize, t: usize) -> String {
    format!("images/cam{id}_{t}.png")
}

/// Frames of a moving scene, cameras and times mixed up.
fn transforms() -> Value {
    let mut frames: Vec<Value> = (0..NUM_CAMERAS * NUM_FRAMES)
        .map(|i| {
            let (id, t) = (i % NUM_CAMERAS, i / NUM_CAMERAS);
            json!({ "file_path": file(id, t), "transform_matrix": matrix(id), "time": t as f64 / 2.0 })
        })
        .collect();
    frames.rotate_left(5);
    frames.reverse();
    json!({ "w": 32, "h": 24, "fl_x": 28.0, "fl_y": 28.0, "cx": 16.0, "cy": 12.0, "frames": frames })
}

fn write(transforms: &Value) -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    for id in 0..NUM_CAMERAS {
        for t in 0..NUM_FRAMES {
            write_image(&folder.path().join(file(id, t)), 32, 24, [id as u8, 10 * t as u8, 0]);
        }
    }
    write_transforms(folder.path(), transforms);
    folder
}

fn write_transforms(folder: &Path, transforms: &Value) {
    fs::write(folder.join("transforms.json"), transforms.to_string()).unwrap();
}

fn ids(capture: &Capture, split: Split) -> Vec<usize> {
    capture.cameras(split, 0, 1).unwrap().into_iter().map(|(id, _)| id).collect()
}

#[test]
fn images_of_a_time_are_a_timestep() {
    let mut with_points = transforms();
    with_points["ply_file_path"] = json!("sparse_pc.ply");
    with_points["fps"] = json!(24);
    let folder = write(&with_points);
    write_ply(&folder.path().join("sparse_pc.ply"));
    let capture = Capture::open(folder.path()).unwrap();
    assert_eq!((capture.kind(), capture.num_frames(), capture.frame_rate()), (CaptureKind::NERFSTUDIO, 3, 24.0));
    assert_eq!((ids(&capture, Split::Train), ids(&capture, Split::Test)), ((1..8).collect(), vec![0]));
    assert_eq!(capture.point_cloud().unwrap().points.len(), 50);
    for frame in 0..NUM_FRAMES {
        for view in capture.views(Split::All, frame, 1).unwrap() {
            assert_close(&view.camera, &camera_of(view.camera_id, NUM_CAMERAS, 32, 24));
            assert_eq!(view.image.to_rgb8()[..2], [view.camera_id as u8, 10 * frame as u8]);
        }
    }
}

#[test]
fn times_may_be_in_any_unit() {
    // Since 1970: seconds, microseconds and nanoseconds; and seconds that were rounded on the way.
    for (first, step) in [(1.7e9, 0.04), (1.7e15, 4e4), (1.7e18, 4e7), (0.000_000_5, 0.04)] {
        let mut timed = transforms();
        for (i, frame) in timed["frames"].as_array_mut().unwrap().iter_mut().enumerate() {
            let t = 2.0 * frame["time"].as_f64().unwrap();
            let rounding = if first < 1.0 && i % 2 == 0 { 1e-9 } else { 0.0 };
            frame["time"] = json!(first + t * step - rounding);
        }
        let folder = write(&timed);
        let capture = Capture::open(folder.path()).unwrap();
        assert_eq!(capture.num_frames(), NUM_FRAMES, "from {first}");
        for frame in 0..NUM_FRAMES {
            let views = capture.views(Split::All, frame, 1).unwrap();
            assert!(views.iter().all(|view| view.image.to_rgb8()[1] == 10 * frame as u8), "from {first}");
        }
    }
}

#[test]
fn without_times_all_is_one_timestep() {
    let mut still = transforms();
    let frames = still["frames"].as_array_mut().unwrap();
    for frame in frames.iter_mut() {
        frame.as_object_mut().unwrap().remove("time");
    }
    let capture = Capture::open(write(&still).path()).unwrap();
    assert_eq!(
        (capture.num_frames(), ids(&capture, Split::Train).len(), ids(&capture, Split::Test)),
        (1, 21, vec![0, 8, 16])
    );
}

#[test]
fn cameras_are_known_by_where_they_stand() {
    let mut renamed = transforms();
    // The last timestep's names are in another order.
    for frame in renamed["frames"].as_array_mut().unwrap() {
        if frame["time"] == 1.0 {
            let id = (0..NUM_CAMERAS).find(|&id| frame["file_path"] == file(id, 2)).unwrap();
            frame["file_path"] = json!(file(NUM_CAMERAS - 1 - id, 2));
        }
    }
    let capture = Capture::open(write(&renamed).path()).unwrap();
    for (id, found) in capture.cameras(Split::All, 2, 1).unwrap() {
        assert_close(&found, &camera_of(id, NUM_CAMERAS, 32, 24));
    }
}

#[test]
fn a_split_may_be_given() {
    let mut split = transforms();
    let names = |id: usize| (0..NUM_FRAMES).map(|t| file(id, t)).collect::<Vec<_>>();
    split["val_filenames"] = json!(names(3));
    split["test_filenames"] = json!(names(5));
    let folder = write(&split);
    assert_eq!(ids(&Capture::open(folder.path()).unwrap(), Split::Test), [3, 5]);
    split["test_filenames"] = json!([file(5, 0)]);
    write_transforms(folder.path(), &split);
    let message = problem(folder.path());
    assert!(message.contains("name other cameras at time 0.5 than at the first"), "{message}");
}

#[test]
fn lenses_and_sizes_may_differ() {
    let mut mixed = transforms();
    for frame in mixed["frames"].as_array_mut().unwrap() {
        if frame["file_path"].as_str().unwrap().contains("cam3_") {
            frame["k1"] = json!(-0.1);
            frame["camera_model"] = json!("OPENCV");
        }
    }
    let folder = write(&mixed);
    let capture = Capture::open(folder.path()).unwrap();
    let views = capture.views(Split::Train, 1, 1).unwrap();
    let [bent, straight] = [3, 4].map(|id| views.iter().find(|view| view.camera_id == id).unwrap());
    assert_eq!((straight.camera.width, straight.image.width), (32, 32));
    assert_eq!((bent.camera.width, bent.camera.height), (bent.image.width, bent.image.height));
    // Barrel distortion shows more than an undistorted image of the same focal length needs: nothing is cut off.
    assert_eq!((bent.camera.width, bent.camera.height), (32, 24));
}

#[test]
fn the_angle_and_the_images_say_what_is_left_out() {
    let mut blender = transforms();
    for key in ["w", "h", "fl_x", "fl_y", "cx", "cy"] {
        blender.as_object_mut().unwrap().remove(key);
    }
    blender["camera_angle_x"] = json!(2.0 * (16.0_f64 / 28.0).atan());
    for frame in blender["frames"].as_array_mut().unwrap() {
        let path = frame["file_path"].as_str().unwrap().trim_end_matches(".png").to_owned();
        frame["file_path"] = json!(format!("./{path}"));
    }
    let capture = Capture::open(write(&blender).path()).unwrap();
    assert_close(&capture.cameras(Split::Train, 0, 1).unwrap()[0].1, &camera_of(1, NUM_CAMERAS, 32, 24));
}

#[test]
fn what_is_wrong_is_named() {
    let of = |change: &dyn Fn(&mut Value)| {
        let mut transforms = transforms();
        change(&mut transforms);
        problem(write(&transforms).path())
    };
    let message = of(&|t| drop(t["frames"][3].as_object_mut().unwrap().remove("time")));
    assert_eq!(message, "transforms.json: 23 of 24 frames have a time, expected all or none");
    let message = of(&|t| drop(t["frames"].as_array_mut().unwrap().pop()));
    assert!(message.starts_with("transforms.json: time 0") && message.contains("frames, expected"), "{message}");
    let message = of(&|t| t["camera_model"] = json!("OPENCV_FISHEYE"));
    assert!(message.contains("has the camera model OPENCV_FISHEYE, expected OPENCV or PINHOLE"), "{message}");
    let message = of(&|t| drop(t.as_object_mut().unwrap().remove("fl_x")));
    assert!(message.contains("has neither fl_x nor camera_angle_x"), "{message}");
    let message = of(&|t| t["w"] = json!(1e12));
    assert!(message.starts_with("transforms.json: images/cam"), "{message}");
    assert!(message.ends_with(".png: is for 1000000000000x24 pixels, expected 1 to 16384 a side"), "{message}");
    let message = of(&|t| t["h"] = json!(-3));
    assert!(message.ends_with("is for 32x-3 pixels, expected 1 to 16384 a side"), "{message}");
    let message = of(&|t| t["fl_x"] = json!(0));
    assert!(message.ends_with("has the focal lengths 0 and 28, expected more than 0"), "{message}");
    let message = of(&|t| t["frames"] = json!([]));
    assert_eq!(message, "transforms.json: has no frames, expected at least one");
    let message = of(&|t| t["frames"][0]["file_path"] = json!("../secret.png"));
    let expected = "file_path is \"../secret.png\", expected the path of a file inside the capture";
    assert_eq!(message, format!("transforms.json: {expected}"));
    let message = of(&|t| t["frames"][0]["transform_matrix"] = json!([[1.0, 0.0, 0.0, 0.0]]));
    assert!(message.contains("transform_matrix has 1 rows, expected 3 or 4"), "{message}");
    let message = of(&|t| t["frames"][0]["transform_matrix"][0][0] = json!(3.0));
    assert!(message.contains("is not a rotation"), "{message}");
    let message = of(&|t| t["frames"] = json!(5));
    assert!(message.starts_with("transforms.json: ") && message.contains("expected a sequence"), "{message}");
    let folder = write(&transforms());
    fs::remove_file(folder.path().join(file(2, 1))).unwrap();
    assert_eq!(problem(folder.path()), "images/cam2_1.png: no such file, expected it as transforms.json names it");
    write_image(&folder.path().join(file(2, 1)), 16, 12, [0; 3]);
    let capture = Capture::open(folder.path()).unwrap();
    let message = shorten(folder.path(), &capture.views(Split::Train, 1, 1).unwrap_err());
    assert_eq!(message, "images/cam2_1.png: is 16x12 pixels, expected 32x24 as its camera has");
}

#[test]
fn cameras_of_blender_lie_in_two_files() {
    let folder = tempfile::tempdir().unwrap();
    let angle = 2.0 * (0.5 * 32.0 / 28.0_f64).atan();
    for (split, ids) in [("train", 0..5), ("test", 5..8)] {
        let frames: Vec<Value> = ids
            .clone()
            .map(|id| json!({ "file_path": format!("./{split}/r_{id}"), "rotation": 0.01, "transform_matrix": matrix(id) }))
            .collect();
        let file = folder.path().join(format!("transforms_{split}.json"));
        fs::write(file, json!({ "camera_angle_x": angle, "frames": frames }).to_string()).unwrap();
        for id in ids {
            write_image(&folder.path().join(format!("{split}/r_{id}.png")), 32, 24, [id as u8, 0, 0]);
        }
    }
    let capture = Capture::open(folder.path()).unwrap();
    assert_eq!((capture.kind(), capture.num_frames()), (CaptureKind::NERFSTUDIO, 1));
    let all = capture.views(Split::All, 0, 1).unwrap();
    assert_eq!((ids(&capture, Split::Train).len(), ids(&capture, Split::Test).len()), (5, 3));
    for view in all {
        // The image tells which camera it is.
        assert_close(&view.camera, &camera_of(usize::from(view.image.to_rgb8()[0]), NUM_CAMERAS, 32, 24));
    }
    // Without the second file every eighth camera is a test camera, and none of fewer than eight.
    fs::remove_file(folder.path().join("transforms_test.json")).unwrap();
    assert_eq!(ids(&Capture::open(folder.path()).unwrap(), Split::Test), [0; 0]);
}
