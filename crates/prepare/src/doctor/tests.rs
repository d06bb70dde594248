use std::path::{Path, PathBuf};
use std::sync::OnceLock;

use serde_json::{Value, json};
use tcgs_capture::{POINTS_FILE, SyntheticSettings, write_synthetic};
use tempfile::TempDir;

use super::*;

const NUM_CAMERAS: usize = 12;
const NUM_TEST_CAMERAS: usize = 2;

/// A healthy capture for all tests; no test writes to it.
fn healthy() -> &'static Path {
    static CAPTURE: OnceLock<TempDir> = OnceLock::new();
    CAPTURE
        .get_or_init(|| {
            let folder = tempfile::tempdir().unwrap();
            let settings = SyntheticSettings {
                num_train_cameras: NUM_CAMERAS,
                num_test_cameras: NUM_TEST_CAMERAS,
                num_points: 20_000,
                ..SyntheticSettings::default()
            };
            write_synthetic(folder.path(), &settings).unwrap();
            folder
        })
        .path()
}

/// A capture to spoil.
struct Patient {
    folder: TempDir,
    meta: Value,
}

impl Patient {
    fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        link(healthy(), folder.path());
        let meta = serde_json::from_slice(&std::fs::read(folder.path().join("train_meta.json")).unwrap()).unwrap();
        Self { folder, meta }
    }

    fn without_points(self) -> Self {
        std::fs::remove_file(self.folder.path().join(POINTS_FILE)).unwrap();
        self
    }

    fn id(&self, camera: usize) -> usize {
        self.meta["cam_id"][0][camera].as_u64().unwrap() as usize
    }

    fn ids(&self, cameras: &[usize]) -> Vec<usize> {
        cameras.iter().map(|&camera| self.id(camera)).collect()
    }

    /// Changes an entry of a camera at every timestep.
    fn change(&mut self, key: &str, camera: usize, change: impl Fn(&mut Value)) {
        for entries in self.meta[key].as_array_mut().unwrap() {
            change(&mut entries[camera]);
        }
    }

    fn invert(&mut self, camera: usize) {
        self.change("w2c", camera, |matrix| {
            let m: [[f64; 4]; 4] = serde_json::from_value(matrix.clone()).unwrap();
            let center = |j: usize| -(0..3).map(|i| m[i][j] * m[i][3]).sum::<f64>();
            let row = |i: usize| [m[0][i], m[1][i], m[2][i], center(i)];
            *matrix = json!([row(0), row(1), row(2), [0.0, 0.0, 0.0, 1.0]]);
        });
    }

    /// Rewrites a camera's masks.
    fn repaint(&self, camera: usize, paint: impl Fn(bool) -> bool) {
        for names in self.meta["fn"].as_array().unwrap() {
            let path = self.folder.path().join("seg").join(names[camera].as_str().unwrap());
            let mut mask = image::open(&path).unwrap().into_luma8();
            mask.iter_mut().for_each(|pixel| *pixel = u8::from(paint(*pixel != 0)));
            // The file is shared with the healthy capture.
            std::fs::remove_file(&path).unwrap();
            mask.save(&path).unwrap();
        }
    }

    fn diagnosis(&self) -> Diagnosis {
        let path = self.folder.path().join("train_meta.json");
        std::fs::remove_file(&path).unwrap();
        std::fs::write(&path, self.meta.to_string()).unwrap();
        check(&Capture::open_unseen(self.folder.path()).unwrap(), &mut |_| ()).unwrap()
    }

    /// The only finding there is.
    #[track_caller]
    fn finding(&self) -> Finding {
        let findings = self.diagnosis().findings;
        assert_eq!(findings.len(), 1, "{findings:?}");
        findings[0].clone()
    }
}

fn link(from: &Path, to: &Path) {
    for entry in std::fs::read_dir(from).unwrap() {
        let path: PathBuf = entry.unwrap().path();
        let target = to.join(path.file_name().unwrap());
        if path.is_dir() {
            std::fs::create_dir(&target).unwrap();
            link(&path, &target);
        } else {
            std::fs::hard_link(&path, &target).unwrap();
        }
    }
}

#[test]
fn a_healthy_capture_is_healthy_with_and_without_points() {
    let with = Patient::new().diagnosis();
    assert_eq!((with.findings, with.made_points), (vec![], false));
    assert_eq!(with.cameras.len(), NUM_CAMERAS + NUM_TEST_CAMERAS);
    assert!(with.cameras.iter().all(|camera| camera.fit.unwrap() > 0.5), "{:?}", with.cameras);
    let without = Patient::new().without_points().diagnosis();
    assert_eq!((without.findings, without.made_points), (vec![], true));
}

#[test]
fn pictures_show_image_points_and_mask() {
    let capture = Capture::open(healthy()).unwrap();
    let diagnosis = check(&capture, &mut |_| ()).unwrap();
    let view = &capture.views(Split::All, 0, 1).unwrap()[1];
    let CameraPictures { image, points, mask } = diagnosis.pictures(&capture, 1).unwrap();
    assert_eq!((image.width, points.height), (view.image.width, view.image.height));
    let same = |a: &Image, pixel: usize| (0..3).all(|c| a.plane(c)[pixel] == view.image.plane(c)[pixel]);
    let num_dots = (0..image.num_pixels()).filter(|&pixel| !same(&image, pixel)).count();
    assert!((20..=image.num_pixels() / 20).contains(&num_dots), "{num_dots}");
    let seen = (0..points.num_pixels()).filter(|&pixel| (0..3).any(|c| points.plane(c)[pixel] > 0.0)).count();
    assert!(seen > points.num_pixels() / 2, "{seen}");
    let (mask, truth) = (mask.unwrap(), &view.segmentation.as_ref().unwrap().foreground);
    assert!((0..mask.num_pixels()).all(|pixel| !truth[pixel] || same(&mask, pixel)), "foreground stays");
    assert!((0..mask.num_pixels()).any(|pixel| !truth[pixel] && !same(&mask, pixel)), "background does not");
}

#[test]
fn a_matrix_the_wrong_way_round_is_found() {
    let mut patient = Patient::new();
    patient.invert(3);
    let finding = patient.finding();
    assert_eq!((finding.kind, &finding.cameras), (FindingKind::InvertedExtrinsics, &patient.ids(&[3])));
    let text = finding.to_string();
    assert!(text.starts_with("camera 3: the matrix is the wrong way round") && text.contains("likely fix: "), "{text}");
}

#[test]
fn all_matrices_the_wrong_way_round_are_found_with_and_without_points() {
    let all: Vec<usize> = (0..NUM_CAMERAS).collect();
    for has_points in [true, false] {
        let mut patient = if has_points { Patient::new() } else { Patient::new().without_points() };
        all.iter().for_each(|&camera| patient.invert(camera));
        let finding = patient.finding();
        assert_eq!((finding.kind, &finding.cameras), (FindingKind::InvertedExtrinsics, &patient.ids(&all)));
    }
}

#[test]
fn exchanged_images_are_found() {
    for has_points in [true, false] {
        let mut patient = if has_points { Patient::new() } else { Patient::new().without_points() };
        for names in patient.meta["fn"].as_array_mut().unwrap() {
            names.as_array_mut().unwrap().swap(2, 7);
        }
        let finding = patient.finding();
        assert_eq!((finding.kind, &finding.cameras), (FindingKind::ExchangedCameras, &patient.ids(&[2, 7])));
        let [a, b] = [patient.id(2), patient.id(7)];
        assert!(finding.problem.contains(&format!("{a} from that of {b}, {b} from that of {a}")), "{finding}");
    }
}

#[test]
fn images_in_another_order_are_found() {
    let mut patient = Patient::new();
    for names in patient.meta["fn"].as_array_mut().unwrap() {
        names.as_array_mut().unwrap().rotate_left(1);
    }
    let finding = patient.finding();
    let all: Vec<usize> = (0..NUM_CAMERAS).collect();
    assert_eq!((finding.kind, finding.cameras.clone()), (FindingKind::ExchangedCameras, patient.ids(&all)));
}

#[test]
fn a_wrong_principal_point_is_found() {
    for (axis, change, said, fix) in [(0, 12.0, "12 px left", "add about -12 to cx"), (1, -4.0, "4 px down", "4 to cy")]
    {
        let mut patient = Patient::new();
        patient.change("k", 5, |k| k[axis][2] = json!(k[axis][2].as_f64().unwrap() + change));
        let finding = patient.finding();
        assert_eq!((finding.kind, &finding.cameras), (FindingKind::PrincipalPoint, &patient.ids(&[5])));
        assert!(finding.problem.contains(said) && finding.fix.contains(fix), "{finding}");
    }
}

#[test]
fn a_wrong_focal_length_is_found() {
    for (factor, said) in [(1.5, "1.5 times too large"), (0.9, "1.1 times too small")] {
        let mut patient = Patient::new();
        patient.change("k", 4, |k| {
            for i in 0..2 {
                k[i][i] = json!(k[i][i].as_f64().unwrap() * factor);
            }
        });
        let finding = patient.finding();
        assert_eq!((finding.kind, &finding.cameras), (FindingKind::Focal, &patient.ids(&[4])));
        assert!(finding.problem.contains(said), "{finding}");
    }
}

#[test]
fn intrinsics_of_larger_images_are_found() {
    let mut patient = Patient::new();
    for camera in 0..NUM_CAMERAS {
        patient.change("k", camera, |k| {
            for i in 0..2 {
                k[i][i] = json!(k[i][i].as_f64().unwrap() * 2.0);
                k[i][2] = json!(k[i][2].as_f64().unwrap() * 2.0);
            }
        });
    }
    let finding = patient.finding();
    assert_eq!((finding.kind, finding.cameras.len()), (FindingKind::ImageSize, NUM_CAMERAS));
    assert!(finding.problem.contains("images 2 times as large"), "{finding}");
}

#[test]
fn a_late_camera_is_found_by_masks_and_without() {
    for has_masks in [true, false] {
        let mut patient = Patient::new();
        if !has_masks {
            std::fs::remove_dir_all(patient.folder.path().join("seg")).unwrap();
            assert_eq!(patient.diagnosis().findings, []);
        }
        let names: Vec<Value> = patient.meta["fn"].as_array().unwrap().clone();
        for (t, entries) in patient.meta["fn"].as_array_mut().unwrap().iter_mut().enumerate() {
            entries[6] = names[t.saturating_sub(3)][6].clone();
        }
        let finding = patient.finding();
        assert_eq!((finding.kind, &finding.cameras), (FindingKind::Unsynchronised, &patient.ids(&[6])));
        assert!(finding.problem.starts_with("3 frames late"), "{finding}");
    }
}

#[test]
fn an_early_camera_is_found() {
    let mut patient = Patient::new();
    let names: Vec<Value> = patient.meta["fn"].as_array().unwrap().clone();
    for (t, entries) in patient.meta["fn"].as_array_mut().unwrap().iter_mut().enumerate() {
        entries[3] = names[(t + 2).min(names.len() - 1)][3].clone();
    }
    let finding = patient.finding();
    assert_eq!((finding.kind, &finding.cameras), (FindingKind::Unsynchronised, &patient.ids(&[3])));
    assert!(finding.problem.starts_with("2 frames early") && finding.fix.starts_with("repeat 2 frames"), "{finding}");
}

#[test]
fn empty_and_inverted_masks_are_found() {
    for has_points in [true, false] {
        let patient = if has_points { Patient::new() } else { Patient::new().without_points() };
        patient.repaint(1, |_| false);
        patient.repaint(8, |foreground| !foreground);
        let findings = patient.diagnosis().findings;
        let found: Vec<_> = findings.iter().map(|finding| (finding.kind, finding.cameras.clone())).collect();
        let expected = [(FindingKind::EmptyMask, patient.ids(&[1])), (FindingKind::InvertedMask, patient.ids(&[8]))];
        assert_eq!(found, expected, "{findings:?}");
    }
}

#[test]
fn two_cameras_with_one_pose_are_found() {
    let mut patient = Patient::new();
    let pose = patient.meta["w2c"][0][5].clone();
    patient.change("w2c", 4, |matrix| *matrix = pose.clone());
    let findings = patient.diagnosis().findings;
    let found = findings.iter().find(|finding| finding.kind == FindingKind::SamePose).unwrap();
    assert_eq!(found.cameras, patient.ids(&[4, 5]));
    let [a, b] = [patient.id(4), patient.id(5)];
    assert!(found.to_string().starts_with(&format!("cameras {a}, {b}: they have one pose")), "{found}");
}

#[test]
fn points_of_assumed_depth_are_no_evidence() {
    let folder = tempfile::tempdir().unwrap();
    // 55 degrees from camera to camera.
    let settings = SyntheticSettings {
        num_train_cameras: 4,
        num_test_cameras: 0,
        num_timesteps: 1,
        ..SyntheticSettings::default()
    };
    write_synthetic(folder.path(), &settings).unwrap();
    std::fs::remove_dir_all(folder.path().join("seg")).unwrap();
    let path = folder.path().join(POINTS_FILE);
    std::fs::remove_file(&path).unwrap();
    let capture = Capture::open_unseen(folder.path()).unwrap();
    let settings = StereoSettings { num_points: 5000, ..StereoSettings::default() };
    let strewn = crate::spread_points(&capture, &settings).unwrap();
    tcgs_capture::write_prepared(std::fs::File::create(&path).unwrap(), &strewn).unwrap();
    let capture = Capture::open_unseen(folder.path()).unwrap();
    assert_eq!(capture.point_cloud().unwrap().points.len(), strewn.cloud.points.len());
    assert_eq!(capture.measured_share().unwrap(), Some(0.0));
    let diagnosis = check(&capture, &mut |_| ()).unwrap();
    assert_eq!((diagnosis.findings, diagnosis.undecided), (vec![], vec![0, 1, 2, 3]));
    assert!(diagnosis.cameras.iter().all(|camera| camera.fit.is_none() && camera.brightness.is_none()));
}

#[test]
fn masks_that_are_all_inverted_are_found() {
    for has_points in [true, false] {
        let patient = if has_points { Patient::new() } else { Patient::new().without_points() };
        (0..NUM_CAMERAS).for_each(|camera| patient.repaint(camera, |foreground| !foreground));
        let finding = patient.finding();
        assert_eq!((finding.kind, finding.cameras.len()), (FindingKind::InvertedMask, NUM_CAMERAS));
    }
}

#[test]
fn the_picture_shows_every_camera_and_marks_the_suspect() {
    let mut patient = Patient::new();
    patient.invert(3);
    let diagnosis = patient.diagnosis();
    let (width, height) = (128 + 6, 2 * 96 + 9);
    assert_eq!((diagnosis.sheet.width, diagnosis.sheet.height), (6 * width, 3 * height));
    let red_frame = |tile: usize| {
        let pixel = tile / 6 * height * diagnosis.sheet.width + tile % 6 * width;
        diagnosis.sheet.plane(0)[pixel] > diagnosis.sheet.plane(1)[pixel]
    };
    let framed: Vec<usize> = (0..NUM_CAMERAS + NUM_TEST_CAMERAS).filter(|&tile| red_frame(tile)).collect();
    assert_eq!(framed, [3]);
}

/// Noise of a pixel or a point, -1 to 1.
fn noise(seed: usize, i: usize) -> f64 {
    let x = (seed as f64 * 78.233 + i as f64 * 12.9898).sin() * 43_758.545_3;
    2.0 * (x - x.floor()) - 1.0
}

/// Grey images of one frame, made ray by ray.
///
/// - `shade`: from a camera's centre and the unit direction of a ray to brightness
/// - `grain`: of the sensor, largest deviation
fn grey_capture(
    cameras: &[Camera],
    shade: impl Fn([f64; 3], [f64; 3]) -> f64,
    grain: f64,
    points: tcgs_core::PointCloud,
) -> Capture {
    let mut builder = tcgs_capture::CaptureBuilder::new("grey", 1).points(points);
    for (id, camera) in cameras.iter().enumerate() {
        let pinhole = tcgs_core::Pinhole::<f64>::new(camera);
        let num_pixels = camera.width * camera.height;
        let values: Vec<f32> = (0..num_pixels)
            .map(|pixel| {
                let ray = tcgs_core::normalize(pinhole.ray(pinhole.pixel_center(pixel)));
                // As eight bits keep it.
                let value = shade(pinhole.center, ray) + grain * noise(id, pixel);
                ((value.clamp(0.0, 1.0) * 255.0).round() / 255.0) as f32
            })
            .collect();
        let image = Image { width: camera.width, height: camera.height, num_channels: 3, data: values.repeat(3) };
        builder = builder.train_camera(tcgs_capture::CameraBuilder::new(id, camera.clone()).images(vec![image]));
    }
    builder.build().unwrap()
}

fn arc(num_cameras: usize, distance: f64, angle: f64, focal_px: f64) -> Vec<Camera> {
    (0..num_cameras)
        .map(|i| {
            let at = angle * (i as f64 / (num_cameras - 1) as f64 - 0.5);
            let center = [distance * at.sin(), -0.1 * distance, -distance * at.cos()];
            Camera::look_at(center, [0.0; 3], [0.0, -1.0, 0.0], focal_px, 160, 120)
        })
        .collect()
}

/// Seven telephoto cameras (a focal length of 10,700 pixels at a width of 1280) on a dark ball before black.
fn telephoto(reach: f64) -> Capture {
    let cameras = arc(7, 30.0, 1.0, 10_700.0 / 8.0);
    let albedo = |p: [f64; 3]| 0.02 + 0.006 * (7.0 * p[0]).sin() * (6.0 * p[1] + 4.0 * p[2]).cos();
    let shade = move |center: [f64; 3], ray: [f64; 3]| {
        let along = tcgs_core::dot(center, ray);
        let inside = along * along - tcgs_core::dot(center, center) + reach * reach;
        if inside < 0.0 {
            return 0.004;
        }
        albedo(std::array::from_fn(|i| center[i] + (-along - inside.sqrt()) * ray[i]))
    };
    let mut cloud = tcgs_core::PointCloud::default();
    for i in 0..3000 {
        let direction = tcgs_core::normalize([noise(1, i), noise(2, i), noise(3, i)]);
        let point = direction.map(|x| reach * x);
        // Stereo on noise: colours that scatter as much as they differ.
        cloud.points.push(point.map(|x| x as f32));
        cloud.colors.push([(albedo(point) + 0.012 * noise(4, i)).max(0.0) as f32; 3]);
        cloud.foreground.push(true);
    }
    grey_capture(&cameras, shade, 0.008, cloud)
}

/// Five cameras on a cloud of smoke before black.
fn smoke(num_points: usize) -> Capture {
    let cameras = arc(5, 4.0, 1.6, 130.0);
    let puffs: Vec<([f64; 3], f64)> =
        (0..6).map(|i| ([noise(5, i), noise(6, i), noise(7, i)].map(|x| 0.5 * x), 0.35 + 0.1 * noise(8, i))).collect();
    let shade = move |center: [f64; 3], ray: [f64; 3]| {
        let through = |(puff, size): &([f64; 3], f64)| {
            let away: [f64; 3] = std::array::from_fn(|i| puff[i] - center[i]);
            let along = tcgs_core::dot(away, ray);
            (-(tcgs_core::dot(away, away) - along * along) / (2.0 * size * size)).exp()
        };
        0.6 * (1.0 - (-0.5 * puffs.iter().map(through).sum::<f64>()).exp())
    };
    let mut cloud = tcgs_core::PointCloud::default();
    for i in 0..num_points {
        // Smoke has no surface: points lie somewhere in it, brighter or darker than its image.
        cloud.points.push([noise(9, i), noise(10, i), noise(11, i)].map(|x| (0.8 * x) as f32));
        cloud.colors.push([(0.25 + 0.2 * noise(12, i)) as f32; 3]);
        cloud.foreground.push(true);
    }
    grey_capture(&cameras, shade, 0.01, cloud)
}

#[test]
fn dark_smooth_and_thin_captures_cannot_be_told() {
    let captures = [
        ("small telephoto", telephoto(0.4)),
        ("telephoto", telephoto(0.9)),
        ("smoke", smoke(4000)),
        ("thin smoke", smoke(66)),
    ];
    let mut num_undecided = Vec::new();
    for (name, capture) in captures {
        let diagnosis = check(&capture, &mut |_| ()).unwrap();
        println!("{name}: undecided {:?}, {:?}", diagnosis.undecided, diagnosis.cameras);
        assert_eq!(diagnosis.findings, [], "{name}");
        num_undecided.push(diagnosis.undecided.len());
    }
    // No point of the small ball's covers enough of an image to compare.
    assert_eq!(num_undecided[0], 7);
}
