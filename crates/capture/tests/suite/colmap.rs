//! COLMAP models, and other static scenes: the contents of a whole capture, and the errors of a spoilt one.

use std::fs;
use std::path::Path;

use crate::support::{assert_close, camera_of, problem, quat, shorten, write_image, write_ply};
use tcgs_capture::{Capture, CaptureKind, Split};
use tempfile::TempDir;

const NUM_CAMERAS: usize = 9;

fn name(id: usize) -> String {
    format!("img{id:02}.png")
}

/// Number, rotation, translation of an image.
fn pose(id: usize) -> ([f64; 4], [f64; 3]) {
    let camera = camera_of(id, NUM_CAMERAS, 32, 24);
    (quat(&camera), [0, 1, 2].map(|i| camera.camera_from_world[i][3]))
}

fn write_images(folder: &Path) {
    for id in 0..NUM_CAMERAS {
        write_image(&folder.join("images").join(name(id)), 32, 24, [id as u8, 100, 0]);
    }
}

/// A model as text.
fn text(camera: &str) -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    let sparse = folder.path().join("sparse/0");
    fs::create_dir_all(&sparse).unwrap();
    write_images(folder.path());
    fs::write(sparse.join("cameras.txt"), format!("# CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]\n{camera}\n")).unwrap();
    let mut images = String::from("# IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME\n");
    // In another order than that of the names.
    for id in (0..NUM_CAMERAS).rev() {
        let ([qw, qx, qy, qz], [tx, ty, tz]) = pose(id);
        images += &format!("{} {qw} {qx} {qy} {qz} {tx} {ty} {tz} 1 {}\n1.5 2.5 -1\n", id + 1, name(id));
    }
    fs::write(sparse.join("images.txt"), images).unwrap();
    fs::write(sparse.join("points3D.txt"), "1 0.1 0 0 255 0 0 0.5 1 1\n2 0 0.1 0 0 255 0 0.5\n").unwrap();
    folder
}

/// The same model as bytes, in `sparse/`.
fn binary() -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    let sparse = folder.path().join("sparse");
    fs::create_dir_all(&sparse).unwrap();
    write_images(folder.path());
    let floats = |values: &[f64]| values.iter().flat_map(|x| x.to_le_bytes()).collect::<Vec<u8>>();
    let mut cameras =
        [1_u64.to_le_bytes().to_vec(), 1_u32.to_le_bytes().to_vec(), 1_u32.to_le_bytes().to_vec()].concat();
    cameras.extend([32_u64, 24].iter().flat_map(|x| x.to_le_bytes()));
    cameras.extend(floats(&[28.0, 28.0, 16.0, 12.0]));
    fs::write(sparse.join("cameras.bin"), cameras).unwrap();
    let mut images = (NUM_CAMERAS as u64).to_le_bytes().to_vec();
    for id in 0..NUM_CAMERAS {
        let (quat, translation) = pose(id);
        images.extend((id as u32 + 1).to_le_bytes());
        images.extend(floats(&quat));
        images.extend(floats(&translation));
        images.extend(1_u32.to_le_bytes());
        images.extend(name(id).as_bytes());
        images.push(0);
        images.extend(1_u64.to_le_bytes());
        images.extend(floats(&[1.5, 2.5]));
        images.extend((-1_i64).to_le_bytes());
    }
    fs::write(sparse.join("images.bin"), images).unwrap();
    let mut points = [1_u64.to_le_bytes(), 1_u64.to_le_bytes()].concat();
    points.extend(floats(&[0.1, 0.0, 0.0]));
    points.extend([255, 0, 0]);
    points.extend(floats(&[0.5]));
    points.extend(0_u64.to_le_bytes());
    fs::write(sparse.join("points3D.bin"), points).unwrap();
    folder
}

const PINHOLE: &str = "1 PINHOLE 32 24 28 28 16 12";

#[test]
fn text_and_binary_models_are_captures() {
    for (folder, num_points) in [(text(PINHOLE), 2), (binary(), 1)] {
        let capture = Capture::open(folder.path()).unwrap();
        assert_eq!((capture.kind(), capture.num_frames()), (CaptureKind::COLMAP, 1));
        let ids = |split| capture.cameras(split, 0, 1).unwrap().into_iter().map(|(id, _)| id).collect::<Vec<_>>();
        assert_eq!((ids(Split::Train), ids(Split::Test)), ((1..8).collect(), vec![0, 8]));
        for view in capture.views(Split::All, 0, 1).unwrap() {
            assert_close(&view.camera, &camera_of(view.camera_id, NUM_CAMERAS, 32, 24));
            assert_eq!(view.image.to_rgb8()[0], view.camera_id as u8);
        }
        let cloud = capture.point_cloud().unwrap();
        assert_eq!(
            (cloud.points.len(), cloud.points[0], cloud.colors[0]),
            (num_points, [0.1, 0.0, 0.0], [1.0, 0.0, 0.0])
        );
    }
}

#[test]
fn what_a_lens_bends_is_straightened() {
    let folder = text("1 OPENCV 32 24 28 29 16.5 12 -0.1 0.02 0.001 -0.001");
    // The colours of the picture encode the original place of each pixel.
    for id in 0..NUM_CAMERAS {
        let picture = image::RgbImage::from_fn(32, 24, |x, y| image::Rgb([8 * x as u8, 10 * y as u8, 0]));
        picture.save(folder.path().join("images").join(name(id))).unwrap();
    }
    let capture = Capture::open(folder.path()).unwrap();
    let view = &capture.views(Split::Train, 0, 1).unwrap()[0];
    let (width, height) = (view.camera.width, view.camera.height);
    assert_eq!((view.image.width, view.image.height, view.camera.focal), (width, height, [28.0, 29.0]));
    let [cx, cy] = view.camera.principal;
    for y in 1..height - 1 {
        for x in 1..width - 1 {
            let (u, v) = ((x as f64 + 0.5 - cx) / 28.0, (y as f64 + 0.5 - cy) / 29.0);
            let r2 = u * u + v * v;
            let radial = 1.0 - 0.1 * r2 + 0.02 * r2 * r2;
            let bent_x = 28.0 * (u * radial + 2.0 * 0.001 * u * v - 0.001 * (r2 + 2.0 * u * u)) + 16.5;
            let bent_y = 29.0 * (v * radial + 0.001 * (r2 + 2.0 * v * v) - 2.0 * 0.001 * u * v) + 12.0;
            let at = |channel: usize| f64::from(view.image.plane(channel)[y * width + x]) * 255.0;
            assert!((at(0) - 8.0 * (bent_x - 0.5)).abs() < 1e-3 && (at(1) - 10.0 * (bent_y - 0.5)).abs() < 1e-3);
        }
    }
}

#[test]
fn what_is_wrong_is_named() {
    let message = problem(text("1 FOV 32 24 28 28 16 12 0.1").path());
    assert!(
        message.starts_with("sparse/0/cameras.txt: line 2: has the camera model FOV, expected one of SIMPLE_PINHOLE")
    );
    let folder = text(PINHOLE);
    let remove = |name: &str| fs::remove_file(folder.path().join(name)).unwrap();
    remove("images/img04.png");
    assert_eq!(problem(folder.path()), "images/img04.png: no such file, expected it as images.txt names it");
    write_image(&folder.path().join("images/img04.png"), 16, 12, [0; 3]);
    let capture = Capture::open(folder.path()).unwrap();
    let message = shorten(folder.path(), &capture.views(Split::Train, 0, 1).unwrap_err());
    assert_eq!(message, "images/img04.png: is 16x12 pixels, expected 32x24 as its camera has");
    remove("sparse/0/points3D.txt");
    let message = shorten(folder.path(), &Capture::open(folder.path()).unwrap().point_cloud().unwrap_err());
    assert!(message.starts_with(": has no initial points"), "{message}");
    fs::write(folder.path().join("sparse/0/points3D.txt"), "# none\n").unwrap();
    assert_eq!(problem(folder.path()), "sparse/0/points3D.txt: has no points, expected at least one");
    remove("sparse/0/images.txt");
    assert_eq!(problem(folder.path()), "sparse/0: has no images.bin or images.txt, expected a COLMAP model");
    fs::remove_dir_all(folder.path().join("images")).unwrap();
    assert!(problem(folder.path()).starts_with(": has a COLMAP model, but no folder images/"));
    let folder = text("2 PINHOLE 32 24 28 28 16 12");
    assert!(
        problem(folder.path()).starts_with("sparse/0/images.txt: image img00.png: has the camera 1, expected one of")
    );
}

#[test]
fn a_cut_binary_model_is_refused_at_every_length() {
    let folder = binary();
    for name in ["cameras.bin", "images.bin", "points3D.bin"] {
        let path = folder.path().join("sparse").join(name);
        let whole = fs::read(&path).unwrap();
        for length in (0..whole.len()).step_by(7) {
            fs::write(&path, &whole[..length]).unwrap();
            let message = problem(folder.path());
            assert!(message.starts_with(&format!("sparse/{name}: ends early")), "{length}: {message}");
        }
        fs::write(&path, whole).unwrap();
    }
}

/// A set in Middlebury's layout.
fn middlebury(count: &str) -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    let mut lines = format!("{count}\n");
    for id in 0..NUM_CAMERAS {
        let camera = camera_of(id, NUM_CAMERAS, 32, 24);
        write_image(&folder.path().join(name(id)), 32, 24, [id as u8, 100, 0]);
        let [fx, fy] = camera.focal;
        let [cx, cy] = camera.principal;
        lines += &format!("{} {fx} 0 {cx} 0 {fy} {cy} 0 0 1", name(id));
        for i in 0..3 {
            lines += &camera.camera_from_world[i][..3].iter().map(|x| format!(" {x}")).collect::<String>();
        }
        lines += &(0..3).map(|i| format!(" {}", camera.camera_from_world[i][3])).collect::<String>();
        lines += "\n";
    }
    fs::write(folder.path().join("ring_par.txt"), lines).unwrap();
    folder
}

#[test]
fn a_set_of_middlebury_is_a_capture() {
    let folder = middlebury("9");
    let capture = Capture::open(folder.path()).unwrap();
    assert_eq!((capture.kind(), capture.num_frames(), capture.has_points()), (CaptureKind::MIDDLEBURY, 1, false));
    for (id, found) in capture.cameras(Split::All, 0, 1).unwrap() {
        assert_close(&found, &camera_of(id, NUM_CAMERAS, 32, 24));
    }
    let points = folder.path().join("any.ply");
    write_ply(&points);
    assert_eq!(capture.with_points(&points).unwrap().point_cloud().unwrap().points.len(), 50);

    assert!(problem(middlebury("10").path()).ends_with("has 9 images, expected 10 as its first line says"));
    assert_eq!(problem(middlebury("many").path()), "ring_par.txt: line 1: expected the number of images");
    fs::remove_file(folder.path().join(name(3))).unwrap();
    assert_eq!(problem(folder.path()), "img03.png: no such file, expected it as line 5 of ring_par.txt names it");
    fs::write(folder.path().join("ring_par.txt"), "1\nimg00.png 1 2 3\n").unwrap();
    assert!(problem(folder.path()).starts_with("ring_par.txt: line 2: expected a name and 21 numbers"));
}
