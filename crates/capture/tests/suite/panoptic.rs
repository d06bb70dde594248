//! The Panoptic layout: the contents of a whole capture, and the errors of a spoilt one.

use crate::support::{HEIGHT, NUM_FRAMES, Small, WIDTH, camera, color};
use serde_json::{Value, json};
use tcgs_capture::{Capture, CaptureError, CaptureKind, Split};
use tcgs_core::Camera;

fn small() -> Small {
    let small = Small::new();
    small.write();
    small
}

/// The error of a capture with a changed `train_meta.json`.
fn problem_of_meta(change: impl Fn(&mut Value)) -> String {
    let mut small = Small::new();
    change(&mut small.train_meta);
    small.write();
    small.problem()
}

/// The error of a capture with these points.
fn problem_of_points(shape: &[usize], values: &[f32]) -> String {
    let small = small();
    small.write_points(shape, values);
    small.problem()
}

#[test]
fn a_whole_capture_opens() {
    let small = small();
    let capture = small.open().unwrap();
    assert_eq!(capture.kind(), CaptureKind::PANOPTIC);
    assert_eq!(capture.name(), small.path().file_name().unwrap().to_str().unwrap());
    assert_eq!((capture.num_frames(), capture.frame_rate(), capture.has_segmentation()), (NUM_FRAMES, 30.0, true));
    for (split, ids) in [(Split::Train, vec![1, 2, 4, 5]), (Split::Test, vec![3]), (Split::All, vec![1, 2, 4, 5, 3])] {
        let found = capture.cameras(split, 1, 1).unwrap();
        assert_eq!(found.iter().map(|(id, _)| *id).collect::<Vec<_>>(), ids);
        assert!(found.iter().all(|(id, found)| *found == camera(*id)), "{split:?}");
    }
    let cloud = capture.point_cloud().unwrap();
    assert_eq!(cloud.points.len(), small.points.len());
    assert_eq!((cloud.points[7], cloud.colors[7]), (small.points[7][..3].try_into().unwrap(), [0.1, 0.5, 1.0]));
    assert_eq!(cloud.foreground.iter().filter(|&&f| f).count(), 40);
}

#[test]
fn views_come_decoded_in_order() {
    let small = small();
    let views = small.open().unwrap().views(Split::All, 1, 1).unwrap();
    assert_eq!(views.iter().map(|view| view.camera_id).collect::<Vec<_>>(), [1, 2, 4, 5, 3]);
    for view in &views {
        assert_eq!((view.frame, view.camera.clone()), (1, camera(view.camera_id)));
        assert_eq!(view.image.to_rgb8()[..3], color(view.camera_id, 1));
        assert_eq!((view.image.width, view.image.height), (WIDTH as usize, HEIGHT as usize));
        match &view.segmentation {
            Some(mask) => assert_eq!((mask.foreground[7], mask.foreground[8]), (true, false)),
            None => assert_eq!(view.camera_id, 3, "only the test camera has no masks"),
        }
    }
}

#[test]
fn downscaling_shrinks_cameras_images_and_masks_alike() {
    let small = small();
    let capture = small.open().unwrap();
    let (cameras, views) = (capture.cameras(Split::Train, 0, 4).unwrap(), capture.views(Split::Train, 0, 4).unwrap());
    for ((id, camera), view) in cameras.iter().zip(&views) {
        assert_eq!((*id, camera), (view.camera_id, &view.camera));
        assert_eq!((camera.width, camera.height, camera.focal[0], camera.principal), (4, 3, 3.5, [2.0, 1.5]));
        assert_eq!((view.image.width, view.image.height), (4, 3));
        assert_eq!(view.segmentation.as_ref().unwrap().foreground[..4], [true, true, false, false]);
    }
    assert_eq!(capture.cameras(Split::Train, 0, 12).unwrap()[0].1.height, 1);
}

#[test]
fn frames_and_factors_out_of_range_are_refused() {
    let small = small();
    let capture = small.open().unwrap();
    let frame = capture.views(Split::Train, 2, 1).unwrap_err();
    assert_eq!(small.shorten(frame), ": has 2 frames, expected more than 2 to show frame 2");
    for downscale in [0, 13] {
        let message = small.shorten(capture.cameras(Split::Train, 0, downscale).unwrap_err());
        assert_eq!(message, format!(": cannot downscale 16x12 images by {downscale}, expected 1 to 12"));
        assert!(matches!(capture.views(Split::All, 0, downscale), Err(CaptureError::Downscale { .. })));
    }
}

#[test]
fn cameras_may_move_and_change_in_number() {
    let mut small = Small::new();
    let moved = Camera::look_at([0.0, -1.5, 2.0], [0.0; 3], [0.0, -1.0, 0.0], 14.0, 16, 12);
    small.train_meta["w2c"][1][0] = json!(moved.camera_from_world);
    for key in ["k", "w2c", "fn", "cam_id"] {
        small.train_meta[key][1].as_array_mut().unwrap().pop();
    }
    small.write();
    let capture = small.open().unwrap();
    assert_eq!(capture.cameras(Split::Train, 0, 1).unwrap()[0].1, camera(1));
    assert_eq!(capture.cameras(Split::Train, 1, 1).unwrap()[0].1, moved);
    assert_eq!(capture.views(Split::Train, 1, 1).unwrap().len(), 3);
}

#[test]
fn the_test_split_may_be_absent_or_empty() {
    let absent = small();
    std::fs::remove_file(absent.path().join("test_meta.json")).unwrap();
    let mut empty = Small::new();
    for key in ["k", "w2c", "fn", "cam_id"] {
        empty.test_meta[key] = json!([]);
    }
    empty.write();
    for small in [absent, empty] {
        let capture = small.open().unwrap();
        assert_eq!(capture.views(Split::Test, 1, 1).unwrap(), []);
        assert_eq!(capture.cameras(Split::All, 1, 1).unwrap().len(), 4);
    }
}

#[test]
fn a_frame_rate_may_be_given() {
    let mut small = Small::new();
    small.train_meta["fps"] = json!(25);
    small.write();
    assert_eq!(small.open().unwrap().frame_rate(), 25.0);
    assert_eq!(problem_of_meta(|m| m["fps"] = json!(0)), "train_meta.json: fps is 0, expected more than 0");
}

#[test]
fn what_is_no_capture_is_told_what_one_is() {
    let small = Small::new();
    let problem = small.problem();
    let expected = ": has no cameras, expected the folder of a capture with one of capture.toml, \
                    train_meta.json (Panoptic Sports), ";
    assert!(problem.starts_with(expected), "{problem}");
    for mark in ["cam*.mp4 (Neural", "(Technicolor)", "transforms.json", "cameras.bin or .txt (COLMAP)", "*_par.txt"] {
        assert!(problem.contains(mark), "{problem}");
    }
    small.write();
    std::fs::remove_dir_all(small.path().join("ims")).unwrap();
    assert!(small.problem().starts_with("ims: no such folder, expected"));
    let nowhere = Capture::open(&small.path().join("nowhere")).unwrap_err();
    assert!(small.shorten(nowhere).starts_with("nowhere: no such folder, expected the folder of a capture"));
    let file = Capture::open(&small.path().join("train_meta.json")).unwrap_err();
    assert!(small.shorten(file).starts_with("train_meta.json: is a file, expected the folder of a capture"));
}

#[test]
fn points_may_be_missing_or_in_another_file() {
    let small = small();
    std::fs::rename(small.path().join("init_pt_cld.npz"), small.path().join("other.npz")).unwrap();
    let capture = small.open().unwrap();
    assert!(!capture.has_points() && capture.views(Split::Train, 0, 1).is_ok());
    let problem = small.shorten(capture.point_cloud().unwrap_err());
    assert!(problem.starts_with(": has no initial points, expected init_pt_cld.npz, points3D.ply"), "{problem}");
    let with = capture.clone().with_points(&small.path().join("other.npz")).unwrap();
    assert_eq!(with.point_cloud().unwrap().points.len(), small.points.len());
    let text = small.shorten(capture.with_points(&small.path().join("points.obj")).unwrap_err());
    assert!(text.starts_with("points.obj: is of no known kind, expected points as .npz, .ply"), "{text}");
}

#[test]
fn missing_files_are_named() {
    let small = small();
    std::fs::remove_file(small.image(4, 1)).unwrap();
    assert_eq!(small.problem(), "ims/4/000001.png: no such file, expected it as fn[1][2] of train_meta.json");
    std::fs::copy(small.image(4, 0), small.image(4, 1)).unwrap();
    std::fs::remove_file(small.image(3, 0)).unwrap();
    assert_eq!(small.problem(), "ims/3/000000.png: no such file, expected it as fn[0][0] of test_meta.json");
}

#[test]
fn masks_are_there_for_all_or_for_none() {
    let small = small();
    std::fs::remove_file(small.mask(2, 1)).unwrap();
    std::fs::remove_file(small.mask(5, 1)).unwrap();
    assert_eq!(
        small.problem(),
        "seg/2/000001.png: no such file, expected masks of all 8 training images or of none, found 6"
    );
    std::fs::remove_dir_all(small.path().join("seg")).unwrap();
    let capture = small.open().unwrap();
    assert!(!capture.has_segmentation());
    assert!(capture.views(Split::All, 0, 1).unwrap().iter().all(|view| view.segmentation.is_none()));
}

#[test]
fn masks_of_every_encoding_read_alike() {
    let small = small();
    let foreground = |x: u32| x < WIDTH / 2;
    let images: [image::DynamicImage; 4] = [
        image::GrayImage::from_fn(WIDTH, HEIGHT, |x, _| image::Luma([if foreground(x) { 255 } else { 0 }])).into(),
        image::RgbImage::from_fn(WIDTH, HEIGHT, |x, _| image::Rgb([u8::from(foreground(x)), 0, 0])).into(),
        image::RgbaImage::from_fn(WIDTH, HEIGHT, |x, _| image::Rgba([0, u8::from(foreground(x)), 0, 255])).into(),
        image::ImageBuffer::from_fn(WIDTH, HEIGHT, |x, _| image::Luma([u16::from(foreground(x))])).into(),
    ];
    let capture = small.open().unwrap();
    let expected = capture.views(Split::Train, 0, 1).unwrap()[0].segmentation.clone();
    assert_eq!(expected.as_ref().unwrap().foreground.iter().filter(|&&f| f).count(), 96);
    for image in images {
        image.save(small.mask(1, 0)).unwrap();
        assert_eq!(capture.views(Split::Train, 0, 1).unwrap()[0].segmentation, expected, "{:?}", image.color());
    }
}

#[test]
fn images_of_another_size_are_named() {
    let small = small();
    let capture = small.open().unwrap();
    let problem = || small.shorten(capture.views(Split::Train, 0, 1).unwrap_err());
    image::GrayImage::new(WIDTH, HEIGHT / 2).save(small.mask(5, 0)).unwrap();
    assert_eq!(problem(), "seg/5/000000.png: is 16x6 pixels, expected 16x12 as its camera has");
    // The error names the first image in order, whichever is decoded first.
    image::RgbImage::new(WIDTH + 1, HEIGHT).save(small.image(2, 0)).unwrap();
    assert_eq!(problem(), "ims/2/000000.png: is 17x12 pixels, expected 16x12 as its camera has");
}

#[test]
fn damaged_images_are_named() {
    let small = small();
    let capture = small.open().unwrap();
    let whole = std::fs::read(small.image(1, 0)).unwrap();
    for length in [0, 20, whole.len() / 2] {
        std::fs::write(small.image(1, 0), &whole[..length]).unwrap();
        let problem = small.shorten(capture.views(Split::Train, 0, 1).unwrap_err());
        assert!(problem.starts_with("ims/1/000000.png: cannot be decoded: "), "{problem}");
    }
}

#[test]
fn a_cut_jpeg_is_refused() {
    let mut small = Small::new();
    small.train_meta["fn"][0][0] = json!("1/cut.jpg");
    let jpeg = small.path().join("ims/1/cut.jpg");
    let picture = image::RgbImage::from_fn(WIDTH, HEIGHT, |x, y| image::Rgb([(x * 16) as u8, (y * 20) as u8, 99]));
    picture.save(&jpeg).unwrap();
    std::fs::copy(small.mask(1, 0), small.path().join("seg/1/cut.png")).unwrap();
    small.write();
    let capture = small.open().unwrap();
    capture.views(Split::Train, 0, 1).unwrap();
    let whole = std::fs::read(&jpeg).unwrap();
    for length in 0..whole.len() {
        std::fs::write(&jpeg, &whole[..length]).unwrap();
        let problem = small.shorten(capture.views(Split::Train, 0, 1).unwrap_err());
        assert!(problem.starts_with("ims/1/cut.jpg: "), "{length}: {problem}");
    }
    // Bytes after the picture do not matter.
    std::fs::write(&jpeg, [whole.as_slice(), b"more\xff\xda\x00"].concat()).unwrap();
    capture.views(Split::Train, 0, 1).unwrap();
}

#[test]
fn numbers_that_are_not_finite_are_located() {
    let small = small();
    let meta = small.path().join("train_meta.json");
    let marked = {
        let mut meta = small.train_meta.clone();
        meta["w2c"][1][2][0][3] = json!(12345.5);
        meta.to_string()
    };
    let column = marked.find("12345.5").unwrap() + 1;
    for literal in ["NaN", "Infinity", "-Infinity"] {
        std::fs::write(&meta, marked.replace("12345.5", literal)).unwrap();
        let problem = small.problem();
        let start = format!("train_meta.json: w2c[1][2][0][3]: {literal} at line 1 column ");
        let found: usize = problem
            .strip_prefix(&start)
            .and_then(|rest| rest.strip_suffix(", expected a finite number"))
            .unwrap_or_else(|| panic!("{problem}"))
            .parse()
            .unwrap();
        assert!(found == column || literal == "-Infinity" && found == column + 1, "{found} against {column}");
    }
    std::fs::write(&meta, marked.replace("12345.5", "\n  NaN")).unwrap();
    assert_eq!(small.problem(), "train_meta.json: w2c[1][2][0][3]: NaN at line 2 column 3, expected a finite number");
    std::fs::write(&meta, marked.replace("12345.5", "null")).unwrap();
    let problem = small.problem();
    assert!(problem.starts_with("train_meta.json: w2c[1][2][0][3]: invalid type: null, expected f64 at line 1"));
}

#[test]
fn metas_of_wrong_types_are_located() {
    let message = problem_of_meta(|m| drop(m.as_object_mut().unwrap().remove("w2c")));
    assert!(message.starts_with("train_meta.json: missing field `w2c`"), "{message}");
    let message = problem_of_meta(|m| m["k"][0][1] = json!([[1, 0, 0], [0, 1, 0]]));
    assert!(
        message.starts_with("train_meta.json: k[0][1]: invalid length 2, expected an array of length 3"),
        "{message}"
    );
    let message = problem_of_meta(|m| m["cam_id"][1][0] = json!("one"));
    assert!(
        message.starts_with("train_meta.json: cam_id[1][0]: invalid type: string \"one\", expected usize"),
        "{message}"
    );
    let message = problem_of_meta(|m| m["w"] = json!(-16));
    assert!(message.starts_with("train_meta.json: w: invalid value: integer `-16`, expected usize"), "{message}");
    let small = small();
    std::fs::write(small.path().join("train_meta.json"), &small.train_meta.to_string()[..500]).unwrap();
    assert!(small.problem().contains("EOF while parsing"), "{}", small.problem());
    std::fs::write(small.path().join("train_meta.json"), small.train_meta.to_string() + "}").unwrap();
    assert!(small.problem().contains("trailing characters"), "{}", small.problem());
}

#[test]
fn lists_that_disagree_are_named() {
    let pop = |list: &mut Value| drop(list.as_array_mut().unwrap().pop());
    assert_eq!(problem_of_meta(|m| pop(&mut m["fn"])), "train_meta.json: fn has 1 timesteps, expected 2 as k has");
    assert_eq!(
        problem_of_meta(|m| pop(&mut m["w2c"][1])),
        "train_meta.json: w2c[1] has 3 cameras, expected 4 as k[1] has"
    );
    assert_eq!(
        problem_of_meta(|m| m["cam_id"][0][3] = json!(2)),
        "train_meta.json: cam_id[0] has 2 twice, expected every camera once"
    );
    let mut small = Small::new();
    for key in ["k", "w2c", "fn", "cam_id"] {
        pop(&mut small.test_meta[key]);
    }
    small.write();
    assert_eq!(small.problem(), "test_meta.json: has 1 timesteps, expected 2 as train_meta.json has");
}

#[test]
fn an_empty_train_split_is_refused() {
    let empty =
        |value: Value| problem_of_meta(|m| ["k", "w2c", "fn", "cam_id"].iter().for_each(|&key| m[key] = value.clone()));
    assert_eq!(empty(json!([])), "train_meta.json: has no timesteps, expected at least one");
    assert_eq!(empty(json!([[], []])), "train_meta.json: fn[0] is empty, expected at least one camera");
}

#[test]
fn files_outside_the_capture_are_refused() {
    for name in ["../secret.png", "/etc/passwd", "", "1/../../x.png"] {
        let message = problem_of_meta(|m| m["fn"][0][1] = json!(name));
        let expected = format!("train_meta.json: fn[0][1] is {name:?}, expected the path of a file inside ims/");
        assert_eq!(message, expected);
    }
}

#[test]
fn matrices_that_make_no_camera_are_named() {
    let message = problem_of_meta(|m| m["w2c"][1][2][0][0] = json!(2.0));
    assert!(message.starts_with("train_meta.json: camera 4 at [1][2]: the upper left 3x3 of w2c is not a rotation"));
    let message = problem_of_meta(|m| m["k"][0][0][1][1] = json!(0.0));
    assert!(message.starts_with("train_meta.json: camera 1 at [0][0]: k is not a pinhole matrix"), "{message}");
    let message = problem_of_meta(|m| m["h"] = json!(0));
    assert!(message.ends_with("the image is 16x0, expected at least 1x1"), "{message}");
}

/// `world_from_camera` of a rigid transform.
fn inverse(m: [[f64; 4]; 4]) -> [[f64; 4]; 4] {
    let row = |i: usize| [m[0][i], m[1][i], m[2][i], -(0..3).map(|j| m[j][i] * m[j][3]).sum::<f64>()];
    [row(0), row(1), row(2), [0.0, 0.0, 0.0, 1.0]]
}

#[test]
fn swapped_matrices_are_recognised() {
    let swap = |meta: &mut Value, ids: &[usize]| {
        for t in 0..NUM_FRAMES {
            for (c, &id) in ids.iter().enumerate() {
                meta["w2c"][t][c] = json!(inverse(camera(id).camera_from_world));
            }
        }
    };
    let message = problem_of_meta(|m| swap(m, &[1, 2, 4, 5]));
    assert!(
        message.starts_with(
            "train_meta.json: the matrices look like c2w (camera to world), expected w2c (world to camera); cameras look \
             outward"
        ),
        "{message}"
    );
    // Camera 3 sees nothing when inverted, so a swapped test split is noticed as well.
    let mut small = Small::new();
    swap(&mut small.test_meta, &[3]);
    small.write();
    assert!(small.problem().starts_with("test_meta.json: the matrices look like c2w"), "{}", small.problem());
}

#[test]
fn cameras_that_look_away_are_recognised() {
    let message = problem_of_meta(|m| {
        for (c, id) in [1, 2, 4, 5].into_iter().enumerate() {
            let center = camera(id).center();
            let away = Camera::look_at(center, center.map(|x| 2.0 * x), [0.0, -1.0, 0.0], 14.0, 16, 12);
            m["w2c"][0][c] = json!(away.camera_from_world);
        }
    });
    assert!(
        message.starts_with("train_meta.json: the cameras look away from the point cloud: 0 of 4 see it"),
        "{message}"
    );
}

#[test]
fn broken_points_are_named() {
    let row = [0.0, 0.0, 0.0, 0.5, 0.5, 0.5, 1.0];
    assert_eq!(problem_of_points(&[0, 7], &[]), "init_pt_cld.npz: data has no points, expected at least one");
    assert_eq!(
        problem_of_points(&[1, 6], &row[..6]),
        "init_pt_cld.npz: data has the shape [1, 6], expected [points, 7]: x y z r g b seg"
    );
    assert_eq!(
        problem_of_points(&[7], &row),
        "init_pt_cld.npz: data has the shape [7], expected [points, 7]: x y z r g b seg"
    );
    assert_eq!(
        problem_of_points(&[1, 7], &[0.0, f32::NAN, 0.0, 0.5, 0.5, 0.5, 1.0]),
        "init_pt_cld.npz: data [0, 1] is NaN, expected a finite number"
    );
    assert_eq!(
        problem_of_points(&[1, 7], &[0.0, 0.0, 0.0, 128.0, 0.5, 0.5, 1.0]),
        "init_pt_cld.npz: data has the colour 128 in row 0, expected 0 to 1"
    );
}

#[test]
fn a_cut_point_file_is_refused_at_every_length() {
    let small = small();
    let path = small.path().join("init_pt_cld.npz");
    let whole = std::fs::read(&path).unwrap();
    for length in (0..whole.len()).step_by(41).chain(whole.len() - 30..whole.len()) {
        std::fs::write(&path, &whole[..length]).unwrap();
        assert!(small.problem().starts_with("init_pt_cld.npz: "), "{length}: {}", small.problem());
    }
}
