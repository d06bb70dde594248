//! Tests each format on a small text after its writer's documentation: a known point must project to the right pixel.

use std::path::MAIN_SEPARATOR;

use super::*;
use crate::lens::{Crop, Lens};

/// A camera at (1, 2, -5) that looks along z and is turned by a quarter about its axis: right is the world's y, down
/// its -x. Focal length 1000, principal point (640, 360), pixel centres at whole numbers.
const CENTER: [f64; 3] = [1.0, 2.0, -5.0];

/// Projection of a point of the world, with distortion; pixel centres at +0.5.
fn seen(camera: &CalibratedCamera, point: [f64; 3]) -> [f64; 2] {
    let at = camera.camera_from_world.map(|[a, b, c, t]| a * point[0] + b * point[1] + c * point[2] + t);
    let k = camera.distortion;
    let lens = Lens {
        width: 1280,
        height: 720,
        focal: camera.focal,
        principal: camera.principal,
        radial: [k[0], k[1], k[4], k[5], k[6], k[7]],
        tangential: [k[2], k[3]],
        crop: Crop::default(),
    };
    let straight: [f64; 2] = std::array::from_fn(|i| camera.focal[i] * at[i] / at[2] + camera.principal[i]);
    lens.bend(straight)
}

/// The point lies a tenth of its depth to the right, a fifth of it down. With `k1 = 0.1`, `r² = 0.05` it is seen
/// `1 + 0.1 * 0.05` times as far from the principal point: 100.5 right, 201 down.
#[track_caller]
fn check(camera: &CalibratedCamera) {
    let depth = 10.0;
    let point = [CENTER[0] - 0.2 * depth, CENTER[1] + 0.1 * depth, CENTER[2] + depth];
    let [u, v] = seen(camera, point);
    let expected = [640.5 + 100.5, 360.5 + 201.0];
    assert!((u - expected[0]).abs() < 1e-6 && (v - expected[1]).abs() < 1e-6, "{u} {v}, expected {expected:?}");
}

fn folder(files: &[(&str, &str)]) -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    for (name, text) in files {
        let path = folder.path().join(name);
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(path, text).unwrap();
    }
    folder
}

#[track_caller]
fn found(files: &[(&str, &str)], format: &str) -> Calibration {
    let folder = folder(files);
    let found = Calibration::find(folder.path()).unwrap().expect("one");
    assert_eq!(found.format, format);
    let again = Calibration::read(&found.path).unwrap();
    assert_eq!((again.format, &again.cameras), (format, &found.cameras));
    found
}

fn problem(files: &[(&str, &str)]) -> String {
    let folder = folder(files);
    let message = Calibration::find(folder.path()).unwrap_err().to_string();
    message.strip_prefix(&format!("{}{MAIN_SEPARATOR}", folder.path().display())).unwrap_or(&message).to_owned()
}

/// `R` of the camera is `[[0, 1, 0], [-1, 0, 0], [0, 0, 1]]`, a quarter turn about -z; `T = -R C = (-2, 1, 5)`.
const INTRI: &str = "%YAML:1.0
---
names:
   - \"01\"
   - \"2\"
K_01: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 1000., 0., 640., 0., 1000., 360., 0., 0., 1. ]
dist_01: !!opencv-matrix
   rows: 1
   cols: 5
   dt: d
   data: [ 1.0e-01, 0., 0., 0., 0. ]
K_2: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 1000., 0., 640., 0., 1000.,
       360., 0., 0., 1. ]
H_2: 720
W_2: 1280
dist_2: !!opencv-matrix
   rows: 5
   cols: 1
   dt: d
   data: [ 0.1, 0, 0, 0, 0 ]
";
const EXTRI: &str = "%YAML:1.0
---
names:
   - \"01\"
   - \"2\"
R_01: !!opencv-matrix
   rows: 3
   cols: 1
   dt: d
   data: [ 0., 0., -1.5707963267948966 ]
Rot_01: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 0., 1., 0., -1., 0., 0., 0., 0., 1. ]
T_01: !!opencv-matrix
   rows: 3
   cols: 1
   dt: d
   data: [ -2., 1., 5. ]
R_2: !!opencv-matrix
   rows: 3
   cols: 1
   dt: d
   data: [ 0., 0., -1.5707963267948966 ]
T_2: !!opencv-matrix
   rows: 3
   cols: 1
   dt: d
   data: [ -2., 1., 5. ]
";

#[test]
fn opencv_files_have_matrices_or_rotation_vectors() {
    let found = found(&[("intri.yml", INTRI), ("extri.yml", EXTRI)], "opencv");
    let [one, two] = found.cameras.as_slice() else { panic!("{found:?}") };
    assert_eq!((&one.names[..], one.size, two.size), (&["01".to_owned()][..], None, Some((1280, 720))));
    check(one);
    check(two);
}

#[test]
fn opencv_files_that_lack_something_are_named() {
    assert!(problem(&[("intri.yml", INTRI)]).starts_with("extri.yml: reading failed"));
    let without = EXTRI.replace("T_2", "T_3");
    assert_eq!(problem(&[("intri.yml", INTRI), ("extri.yml", &without)]), "extri.yml: has no matrix T_2, expected one");
    let short = INTRI.replacen("data: [ 1000., 0., 640.", "data: [ 1000.", 1);
    assert_eq!(problem(&[("intri.yml", &short), ("extri.yml", EXTRI)]), "intri.yml: K_01 has 7 numbers, expected 9");
    let mirrored = EXTRI.replace("0., 1., 0., -1., 0., 0., 0., 0., 1.", "0., 1., 0., 1., 0., 0., 0., 0., 1.");
    assert_eq!(
        problem(&[("intri.yml", INTRI), ("extri.yml", &mirrored)]),
        "intri.yml: camera 01: its rotation has the determinant -1, expected 1: the axes are left-handed"
    );
    let squeezed = EXTRI.replace("0., 1., 0., -1., 0., 0., 0., 0., 1.", "0., 1., 0., -1., 0., 0., 0., 0., 2.");
    let squeezed = problem(&[("intri.yml", INTRI), ("extri.yml", &squeezed)]);
    assert!(squeezed.ends_with("expected rows of length 1 at right angles"), "{squeezed}");
    assert!(problem(&[("intri.yml", "%YAML:1.0\n---\nK_1: [1, 2"), ("extri.yml", EXTRI)]).contains("is no YAML"));
}

const CALIB: &str = "[cam_1]
name = \"int_left_img\"
size = [ 1280.0, 720.0]
matrix = [ [ 1000.0, 0.0, 640.0], [ 0.0, 1000.0, 360.0], [ 0.0, 0.0, 1.0]]
distortions = [ 0.1, 0.0, 0.0, 0.0]
rotation = [ 0.0, 0.0, -1.5707963267948966]
translation = [ -2.0, 1.0, 5.0]
fisheye = false

[metadata]
adjusted = false
error = 0.0
";

#[test]
fn aniposelib_files_have_a_table_for_each_camera() {
    let found = found(&[("Calib_scene.toml", CALIB), ("Config.toml", "[project]\nfps = 30\n")], "aniposelib");
    assert_eq!(found.cameras[0].names, ["int_left_img", "cam_1"]);
    check(&found.cameras[0]);
    let fisheye = problem(&[("Calib.toml", &CALIB.replace("fisheye = false", "fisheye = true"))]);
    assert!(fisheye.starts_with("Calib.toml: [cam_1]: is a fisheye, expected"), "{fisheye}");
    let size = problem(&[("Calib.toml", &CALIB.replace("1280.0", "1280.5"))]);
    assert_eq!(size, "Calib.toml: [cam_1]: its size is not one in pixels, expected [width, height]");
    let focal = problem(&[("Calib.toml", &CALIB.replace("[ 1000.0, 0.0", "[ -1000.0, 0.0"))]);
    assert!(focal.contains("has the focal lengths -1000 and 1000, expected more than 0"), "{focal}");
}

const CAMERA_ARRAY: &str = "[cameras.0]
cam_id = 0
rotation_count = -1
ignore = false
size = [1280, 720]
matrix = [[1000.0, 0.0, 640.0], [0.0, 1000.0, 360.0], [0.0, 0.0, 1.0]]
distortions = [0.1, 0.0, 0.0, 0.0, 0.0]
translation = [-2.0, 1.0, 5.0]
rotation = [[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]

[cameras.7]
size = [1280, 720]
ignore = true
";

#[test]
fn caliscope_files_may_have_cameras_that_are_ignored() {
    let found = found(&[("camera_array.toml", CAMERA_ARRAY)], "caliscope");
    assert_eq!((found.cameras.len(), found.in_metres), (1, true));
    check(&found.cameras[0]);
    let unfinished = problem(&[("camera_array.toml", &CAMERA_ARRAY.replace("ignore = true", "ignore = false"))]);
    let expected =
        "camera_array.toml: camera 7: has no matrix, rotation or translation, expected a finished calibration";
    assert_eq!(unfinished, expected);
}

/// The axes of the camera in the world are the rows: right +y, up +x, backward -z; millimetres, 1/64 pixels.
const QCA: &str = "<?xml version='1.0'?>
<calibration><cameras>
  <camera serial=\"left\">
    <fov_video bottom=\"721\" left=\"0\" right=\"1279\" top=\"2\"/>
    <transform r11=\"0\" r12=\"1\" r13=\"0\" r21=\"1\" r22=\"0\" r23=\"0\" r31=\"0\" r32=\"0\" r33=\"-1\" x=\"1000\" y=\"2000\" z=\"-5000\"/>
    <intrinsic centerPointU=\"40960\" centerPointV=\"23168\" focalLengthU=\"64000\" focalLengthV=\"64000\"
      radialDistortion1=\"0.1\" radialDistortion2=\"0\" radialDistortion3=\"0\" tangentalDistortion1=\"0\" tangentalDistortion2=\"0\"/>
  </camera>
  <camera serial=\"markers only\"/>
</cameras></calibration>";

#[test]
fn qualisys_files_have_poses_of_cameras_and_parts_of_pixels() {
    let found = found(&[("Calib.qca.txt", QCA)], "qualisys");
    assert_eq!((found.cameras.len(), found.cameras[0].size), (1, Some((1280, 720))));
    check(&found.cameras[0]);
    let mirrored = problem(&[("a.qca.txt", &QCA.replace("r33=\"-1\"", "r33=\"1\""))]);
    assert!(mirrored.starts_with("a.qca.txt: camera left: its rotation has the determinant -1"), "{mirrored}");
    let missing = problem(&[("a.qca.txt", &QCA.replace("focalLengthU", "focalLength"))]);
    assert_eq!(missing, "a.qca.txt: camera left: <intrinsic> has no focalLengthU");
    assert!(problem(&[("a.qca.txt", "<calibration>")]).starts_with("a.qca.txt: is no XML"));
}

/// COLMAP's principal point counts from the corner of the first pixel.
const COLMAP_CAMERAS: &str = "1 OPENCV 1280 720 1000 1000 640.5 360.5 0.1 0 0 0\n";
const COLMAP_IMAGES: &str = "1 0.7071067811865476 0 0 -0.7071067811865476 -2 1 5 1 images/left.png\n\n";

#[test]
fn colmap_models_name_videos_by_images_or_folders() {
    let files = [("sparse/0/cameras.txt", COLMAP_CAMERAS), ("sparse/0/images.txt", COLMAP_IMAGES)];
    let found = found(&files, "colmap");
    assert_eq!(found.cameras[0].names, ["left"]);
    check(&found.cameras[0]);
    assert_eq!(colmap::names_of("left/000012.png"), ["000012", "left"]);
}

/// The columns are the camera's right (+y), up (+x), backward (-z) and centre.
const TRANSFORMS: &str =
    "{\"w\": 1280, \"h\": 720, \"fl_x\": 1000, \"fl_y\": 1000, \"cx\": 640.5, \"cy\": 360.5, \"k1\": 0.1,
  \"frames\": [{\"file_path\": \"images/left.png\",
    \"transform_matrix\": [[0, 1, 0, 1], [1, 0, 0, 2], [0, 0, -1, -5], [0, 0, 0, 1]]}]}";

#[test]
fn nerfstudio_files_have_poses_of_cameras() {
    let found = found(&[("transforms.json", TRANSFORMS)], "nerfstudio");
    check(&found.cameras[0]);
    let without = problem(&[("transforms.json", &TRANSFORMS.replace("\"w\"", "\"wide\""))]);
    assert_eq!(
        without,
        "transforms.json: images/left.png: has no w and h, expected the size of its image in pixels, or \
                         camera_angle_x"
    );
}

/// A camera in the form in which Blender's are exported for NeRF (Mildenhall et al. 2020).
const BLENDER: &str = "{ \"camera_angle_x\": 0.6911112070083618, \"frames\": [ {
    \"file_path\": \"./train/r_0\", \"rotation\": 0.012566370614359171, \"transform_matrix\": [
    [-0.9999021887779236, 0.004192245192825794, -0.013345719315111637, -0.05379832163453102],
    [-0.013988681137561798, -0.2996590733528137, 0.95394366979599, 3.845470428466797],
    [-4.656612873077393e-10, 0.9540371894836426, 0.29968830943107605, 1.2080823183059692], [0.0, 0.0, 0.0, 1.0]] } ] }";

#[test]
fn cameras_of_blender_have_an_angle_and_look_at_the_middle() {
    let test = BLENDER.replace("./train/r_0", "./test/r_7");
    let found = found(&[("transforms_train.json", BLENDER), ("transforms_test.json", &test)], "nerfstudio");
    let [camera, of_test] = found.cameras.as_slice() else { panic!("{found:?}") };
    assert_eq!((camera.size, camera.angle_x), (None, Some(0.6911112070083618)));
    assert!(camera.names.contains(&"r_0".to_owned()) && of_test.names.contains(&"r_7".to_owned()), "{found:?}");
    // It looks at the origin, from a distance of 4.03.
    let origin = camera.camera_from_world.map(|row| row[3]);
    assert!(origin[0].abs() < 1e-3 && origin[1].abs() < 1e-3 && (origin[2] - 4.031).abs() < 1e-3, "{origin:?}");
    // The world's z is up, which is against y in the image.
    assert!(camera.camera_from_world[1][2] < -0.9, "{camera:?}");
    let without = problem(&[("transforms_train.json", &BLENDER.replace("camera_angle_x", "angle"))]);
    assert!(without.starts_with("transforms_train.json: ./train/r_0: has no w and h"), "{without}");
}

#[test]
fn several_calibrations_are_refused_and_none_is_none() {
    let several = folder(&[("Calib.toml", CALIB), ("a.qca.txt", QCA)]);
    let problem = Calibration::find(several.path()).unwrap_err().to_string();
    assert!(problem.ends_with("has several calibrations (Calib.toml, a.qca.txt), expected one, or to be told which"));
    let none = folder(&[("notes.txt", "x")]);
    assert!(Calibration::find(none.path()).unwrap().is_none());
    let unknown = Calibration::read(&none.path().join("notes.txt")).unwrap_err().to_string();
    assert!(unknown.contains("is no calibration of a known format, expected intri.yml"), "{unknown}");
}

#[test]
fn distortion_is_as_long_as_opencv_writes_it() {
    use super::numbers::distortion;
    assert_eq!(distortion(&[]), Ok([0.0; 8]));
    assert_eq!(distortion(&[1.0, 2.0, 3.0, 4.0, 5.0]), Ok([1.0, 2.0, 3.0, 4.0, 5.0, 0.0, 0.0, 0.0]));
    assert!(distortion(&[0.0; 14]).is_ok(), "a model with room for a thin prism, of which there is none");
    let prism = distortion(&[0.1, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.5, 0.0, 0.0, 0.0]);
    assert_eq!(prism.unwrap_err(), "has 12 distortion coefficients, expected 4, 5 or 8: k1 k2 p1 p2 k3 k4 k5 k6");
    assert!(distortion(&[0.1, 0.2]).is_err() && distortion(&[f64::NAN; 4]).is_err());
}
