use std::path::PathBuf;

use tcgs_core::{Pinhole, View, distance};

use super::*;
use crate::{Capture, Split};

fn small() -> SyntheticSettings {
    SyntheticSettings { width: 64, height: 48, num_timesteps: 2, num_points: 3000, ..SyntheticSettings::default() }
}

fn written(settings: &SyntheticSettings) -> (tempfile::TempDir, Capture) {
    let dir = tempfile::tempdir().unwrap();
    write_synthetic(dir.path(), settings).unwrap();
    let capture = Capture::open(dir.path()).unwrap();
    (dir, capture)
}

fn foreground_share(view: &View) -> f64 {
    let mask = &view.segmentation.as_ref().unwrap().foreground;
    mask.iter().filter(|&&m| m).count() as f64 / mask.len() as f64
}

#[test]
fn the_capture_opens_with_all_that_was_asked_for() {
    let settings = SyntheticSettings { num_train_cameras: 5, num_test_cameras: 3, ..small() };
    let (_dir, capture) = written(&settings);
    assert_eq!((capture.num_frames(), capture.frame_rate()), (2, SYNTHETIC_FRAME_RATE));
    let views = capture.views(Split::All, 1, 1).unwrap();
    assert_eq!(views.len(), 8);
    let ids = |split| capture.cameras(split, 0, 1).unwrap().into_iter().map(|(id, _)| id).collect::<Vec<_>>();
    assert_eq!((ids(Split::Train), ids(Split::Test)), (vec![0, 1, 3, 5, 7], vec![2, 4, 6]));
    for view in &views {
        assert_eq!((view.image.width, view.image.height), (64, 48));
        assert!(foreground_share(view) > 0.02, "camera {}", view.camera_id);
    }
    let cloud = capture.point_cloud().unwrap();
    assert_eq!((cloud.points.len(), cloud.foreground.iter().filter(|&&f| f).count()), (3000, 1000));
}

#[test]
fn moving_objects_cover_a_tenth_of_the_pixels() {
    let cameras = cameras(&SyntheticSettings::default());
    let masks = (0..24).flat_map(|timestep| cameras.iter().map(move |camera| (timestep, camera)));
    let shares: Vec<f64> = masks
        .map(|(timestep, camera)| {
            let (_, mask) = render(&SyntheticScene::at(timestep), &camera.camera.resized(64, 48));
            mask.iter().filter(|&&m| m).count() as f64 / mask.len() as f64
        })
        .collect();
    let mean = shares.iter().sum::<f64>() / shares.len() as f64;
    assert!(mean >= 0.10, "{mean}");
}

#[test]
fn the_ball_travels_three_of_its_diameters_in_small_steps() {
    let centers: Vec<_> = (0..24).map(|t| ball_at(t).0).collect();
    let diameter = 2.0 * ball_at(0).1;
    assert!(distance(centers[0], centers[23]) >= 3.0 * diameter);
    for step in centers.windows(2) {
        assert!(distance(step[0], step[1]) < 0.25 * diameter, "{step:?}");
    }
    // Never into the floor, on it twice, in the air between.
    let gaps: Vec<f64> = centers.iter().map(|c| -c[1] - diameter / 2.0).collect();
    assert!(gaps.iter().all(|&gap| gap > -1e-12));
    assert!(gaps.iter().cloned().fold(0.0, f64::max) > 0.3);
}

#[test]
fn bodies_stay_apart_from_each_other_and_from_the_cameras() {
    let cameras = cameras(&SyntheticSettings::default());
    for timestep in 0..300 {
        let bodies = SyntheticScene::at(timestep).bodies;
        for (i, a) in bodies.iter().enumerate() {
            let outside = |b: &scene::Body| {
                // Seen along the line between the centres, each within its largest radius.
                let gap: [f64; 3] = std::array::from_fn(|i| a.center[i] - b.center[i]);
                tcgs_core::dot(gap, gap).sqrt() - a.reach() - b.reach()
            };
            for b in bodies[..i].iter().filter(|b| a.moving || b.moving) {
                assert!(outside(b) > 0.0, "{a:?} and {b:?} at timestep {timestep}");
            }
            for camera in &cameras {
                let offset: [f64; 3] = std::array::from_fn(|i| a.center[i] - camera.camera.center()[i]);
                assert!(tcgs_core::dot(offset, offset).sqrt() > a.reach() + 0.3, "{a:?} at timestep {timestep}");
            }
        }
    }
}

/// Differences of colour between the points that a camera sees and the pixels they fall on, ascending.
fn color_differences(capture: &Capture, mirror: bool) -> Vec<f32> {
    let cloud = capture.point_cloud().unwrap();
    let scene = SyntheticScene::at(0);
    let mut differences = Vec::new();
    for View { camera, image, .. } in capture.views(Split::All, 0, 1).unwrap() {
        for (point, color) in cloud.points.iter().zip(&cloud.colors) {
            let world = point.map(f64::from);
            let Some((pixel, _)) = Pinhole::new(&camera).pixel(world) else { continue };
            let (u, v) = (pixel % camera.width, pixel / camera.width);
            let center = camera.center();
            let away: [f64; 3] = std::array::from_fn(|i| world[i] - center[i]);
            let first = scene.hit(center, tcgs_core::normalize(away)).position();
            if (0..3).any(|i| (first[i] - world[i]).abs() > 0.03) {
                continue; // hidden
            }
            let column = if mirror { camera.width - 1 - u } else { u };
            let pixel = v * camera.width + column;
            differences.extend((0..3).map(|channel| (image.plane(channel)[pixel] - color[channel]).abs()));
        }
    }
    differences.sort_by(f32::total_cmp);
    differences
}

#[test]
fn the_vase_shines_where_the_lamp_reflects_and_nothing_else_does() {
    let scene = SyntheticScene::at(0);
    // For each camera: the largest gain in brightness by reflections, on the vase and elsewhere.
    let shines: Vec<[f64; 2]> = cameras(&SyntheticSettings::default())
        .iter()
        .map(|camera| {
            let (center, pinhole) = (camera.camera.center(), Pinhole::new(&camera.camera));
            let (mut vase, mut rest) = (0.0_f64, 0.0_f64);
            for pixel in 0..128 * 96 {
                let at = [(pixel % 128) as f64 + 0.5, (pixel / 128) as f64 + 0.5];
                let direction = tcgs_core::normalize(pinhole.ray(at));
                let hit = scene.hit(center, direction);
                let more = scene.color_along(direction, &hit)[2] - scene.matt_color(&hit)[2];
                let place = if hit.texture(&scene) == Some(texture::Texture::Vase) { &mut vase } else { &mut rest };
                *place = place.max(more);
            }
            [vase, rest]
        })
        .collect();
    assert!(shines.iter().all(|[_, rest]| *rest == 0.0));
    assert!(shines.iter().any(|[vase, _]| *vase > 0.3), "{shines:?}");
}

#[test]
fn points_fall_on_pixels_of_their_colour() {
    let (_dir, capture) = written(&SyntheticSettings { num_timesteps: 1, ..small() });
    let differences = color_differences(&capture, false);
    assert!(differences.len() > 10_000, "{}", differences.len());
    assert!(differences[differences.len() / 2] < 0.015, "median {}", differences[differences.len() / 2]);
    // The same measure reveals a wrong convention.
    let mirrored = color_differences(&capture, true);
    assert!(mirrored[mirrored.len() / 2] > 0.05, "median {}", mirrored[mirrored.len() / 2]);
}

#[test]
fn foreground_points_are_seen_in_the_mask() {
    let (_dir, capture) = written(&SyntheticSettings { num_timesteps: 1, num_points: 30_000, ..small() });
    let (cloud, view) = (capture.point_cloud().unwrap(), &capture.views(Split::Test, 0, 1).unwrap()[0]);
    let (mask, camera) = (&view.segmentation.as_ref().unwrap().foreground, &view.camera);
    let mut covered = vec![false; mask.len()];
    for (point, _) in cloud.points.iter().zip(&cloud.foreground).filter(|(_, foreground)| **foreground) {
        if let Some((pixel, _)) = Pinhole::new(camera).pixel(point.map(f64::from)) {
            covered[pixel] = true;
        }
    }
    // Nothing static stands before the objects: their points fall on the mask, or, near an outline, on a
    // pixel whose centre just misses; and nearly fill it.
    let near_mask = |pixel: usize| {
        let (column, row) = (pixel % camera.width, pixel / camera.width);
        let mut rows = row.saturating_sub(1)..=(row + 1).min(camera.height - 1);
        rows.any(|row| {
            (column.saturating_sub(1)..=(column + 1).min(camera.width - 1)).any(|c| mask[row * camera.width + c])
        })
    };
    assert!((0..mask.len()).all(|pixel| !covered[pixel] || near_mask(pixel)));
    let missed = mask.iter().zip(&covered).filter(|&(&m, &c)| m && !c).count();
    let all = mask.iter().filter(|&&m| m).count();
    assert!(50 * missed < all, "{missed} of {all} not covered");
}

#[test]
fn equal_settings_give_equal_bytes_whatever_the_threads() {
    let files = |num_threads: usize, seed: u64| -> Vec<(PathBuf, Vec<u8>)> {
        let dir = tempfile::tempdir().unwrap();
        let pool = rayon::ThreadPoolBuilder::new().num_threads(num_threads).build().unwrap();
        pool.install(|| write_synthetic(dir.path(), &SyntheticSettings { seed, ..small() })).unwrap();
        let names = ["train_meta.json", "test_meta.json", "ims/3/000001.png", "seg/4/000000.png", "init_pt_cld.npz"];
        names.iter().map(|name| (name.into(), std::fs::read(dir.path().join(name)).unwrap())).collect()
    };
    let first = files(1, 7);
    assert_eq!(first, files(4, 7));
    let changed: Vec<bool> = first.iter().zip(files(2, 8)).map(|(a, b)| *a != b).collect();
    assert_eq!(changed, [false, false, false, false, true]);
}

#[test]
fn a_folder_that_cannot_be_written_is_named() {
    let file = tempfile::NamedTempFile::new().unwrap();
    let error = write_synthetic(&file.path().join("inside"), &small()).unwrap_err().to_string();
    assert!(error.starts_with(&file.path().display().to_string()) && error.contains("writing failed: "), "{error}");
}

#[test]
#[should_panic(expected = "3 training cameras for 2 test cameras")]
fn test_cameras_need_training_cameras_around_them() {
    cameras(&SyntheticSettings { num_train_cameras: 3, ..small() });
}
