//! Real and rendered captures, where available.

use std::ops::Range;

use tcgs_capture::{Capture, CaptureKind, Split};
#[cfg(feature = "video")]
use tcgs_core::Image;
use tcgs_core::{Camera, Pinhole, PointCloud, View};

use crate::support::real_folder;

const TEST_CAMERAS: [usize; 4] = [0, 10, 15, 30];

/// Opens a capture and checks the properties that real and rendered captures share.
///
/// - `num_masks`: number of masks of one frame; the test cameras' masks are not published for basketball
/// - `foreground_share`: share of the foreground in images with a mask
fn check(name: &str, num_frames: usize, size: (usize, usize), num_masks: usize, foreground_share: Range<f64>) {
    let Some(path) = real_folder(name) else { return };
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

/// Projection of a point into a camera: column and row. `None` behind the camera or outside the image.
fn pixel(camera: &Camera, point: [f32; 3]) -> Option<(usize, usize)> {
    let (pixel, _) = Pinhole::new(camera).pixel(point.map(f64::from))?;
    Some((pixel % camera.width, pixel / camera.width))
}

/// Median difference between the colours of points and of their pixels, and the number of points in sight.
fn color_error(view: &View, camera: &Camera, cloud: &PointCloud) -> (f32, usize) {
    let mut errors: Vec<f32> = cloud
        .points
        .iter()
        .zip(&cloud.colors)
        .filter_map(|(&point, color)| {
            let (x, y) = pixel(camera, point)?;
            let at = |c: usize| view.image.plane(c)[y * view.image.width + x];
            Some((0..3).map(|c| (at(c) - color[c]).abs()).sum::<f32>() / 3.0)
        })
        .collect();
    errors.sort_by(f32::total_cmp);
    (errors.get(errors.len() / 2).copied().unwrap_or(1.0), errors.len())
}

/// Asserts that points have the colours of their pixels. They must not if images are mirrored, upside down, or have
/// another principal point.
fn assert_in_place(views: &[View], cloud: &PointCloud, most: f32) {
    for view in views {
        let camera = &view.camera;
        let (error, count) = color_error(view, camera, cloud);
        assert!(error < most && count > cloud.points.len() / 4, "camera {}: {error}, {count} points", view.camera_id);
        let [cx, cy] = camera.principal;
        let turned = |focal: [f64; 2], principal: [f64; 2]| {
            color_error(view, &Camera { focal, principal, ..camera.clone() }, cloud).0
        };
        let [fx, fy] = camera.focal;
        let shift = camera.width as f64 / 20.0;
        for wrong in [turned([-fx, fy], [cx, cy]), turned([fx, -fy], [cx, cy]), turned([fx, fy], [cx + shift, cy])] {
            assert!(wrong > 1.5 * error, "camera {}: {error} as it is, {wrong} changed", view.camera_id);
        }
    }
}

#[cfg(feature = "video")]
fn psnr(a: &Image, b: &Image) -> f64 {
    let squared: f64 = a.data.iter().zip(&b.data).map(|(a, b)| f64::from(a - b).powi(2)).sum();
    -10.0 * (squared / a.data.len() as f64).log10()
}

#[cfg(feature = "video")]
#[test]
fn kitchen_opens() {
    let Some(path) = real_folder("kitchen") else { return };
    let capture = Capture::open(&path).unwrap();
    assert_eq!((capture.kind(), capture.num_frames(), capture.frame_rate()), (CaptureKind::NEURAL3D, 100, 30.0));
    let exact: serde_json::Value = serde_json::from_slice(&std::fs::read(path.join("cameras.json")).unwrap()).unwrap();
    let number = |value: &serde_json::Value| value.as_f64().unwrap();
    let views = capture.views(Split::All, 0, 1).unwrap();
    assert_eq!(views.iter().map(|view| view.camera_id).collect::<Vec<_>>(), (1..19).chain([0]).collect::<Vec<_>>());
    for view in &views {
        let exact = &exact[view.camera_id];
        for i in 0..3 {
            for j in 0..4 {
                let (found, expected) = (view.camera.camera_from_world[i][j], number(&exact["w2c"][i][j]));
                assert!((found - expected).abs() < 1e-6, "camera {}", view.camera_id);
            }
        }
        assert_eq!(view.camera.principal, [number(&exact["k"][0][2]), number(&exact["k"][1][2])]);
        // The image before it was coded.
        let lossless = image::open(path.join(format!("frame0/cam{:02}.png", view.camera_id))).unwrap().into_rgb8();
        let lossless = Image::from_rgb8(view.image.width, view.image.height, lossless.as_raw());
        let psnr = psnr(&view.image, &lossless);
        assert!(psnr > 40.0, "camera {}: {psnr} dB", view.camera_id);
    }
    assert_in_place(&views[..6], &capture.point_cloud().unwrap(), 0.05);
    // A later frame differs, and is the same when it is decoded after others.
    let later = |frame: usize| capture.views(Split::Test, frame, 1).unwrap().remove(0).image;
    let first = later(60);
    assert!(psnr(&first, &views[18].image) < 40.0);
    later(99);
    assert_eq!(later(60), first);
}

#[test]
fn beercan_opens() {
    let Some(path) = real_folder("beercan_colmap") else { return };
    let capture = Capture::open(&path).unwrap();
    assert_eq!((capture.kind(), capture.num_frames()), (CaptureKind::COLMAP, 1));
    let views = capture.views(Split::All, 0, 1).unwrap();
    assert_eq!((views.len(), capture.cameras(Split::Test, 0, 1).unwrap().len()), (71, 9));
    // Hidden points count as well.
    assert_in_place(&views[..6], &capture.point_cloud().unwrap(), 0.08);

    // The same poses in the form of LLFF.
    let llff = tempfile::tempdir().unwrap();
    std::fs::copy(path.join("poses_bounds.npy"), llff.path().join("poses_bounds.npy")).unwrap();
    for id in 0..71 {
        let folder = llff.path().join(format!("cam{id:02}"));
        std::fs::create_dir(&folder).unwrap();
        std::fs::copy(path.join(format!("images/{id:04}.jpg")), folder.join("0000.jpg")).unwrap();
    }
    let mut by_llff = Capture::open(llff.path()).unwrap().cameras(Split::All, 0, 1).unwrap();
    let mut by_colmap = capture.cameras(Split::All, 0, 1).unwrap();
    by_llff.sort_by_key(|(id, _)| *id);
    by_colmap.sort_by_key(|(id, _)| *id);
    for ((id, a), (_, b)) in by_llff.iter().zip(&by_colmap) {
        let pairs = a.camera_from_world.as_flattened().iter().zip(b.camera_from_world.as_flattened());
        let worst = pairs.map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        assert!(worst < 1e-4, "camera {id}: {worst}");
        // LLFF gives all cameras the focal length of the first.
        let expected = by_colmap[0].1.focal[0];
        assert!((a.focal[0] / expected - 1.0).abs() < 1e-6, "camera {id}: {}, expected {expected}", a.focal[0]);
    }
}

#[test]
fn temple_opens() {
    let Some(path) = real_folder("temple_sparse_ring") else { return };
    let capture = Capture::open(&path).unwrap();
    assert_eq!((capture.kind(), capture.num_frames(), capture.has_points()), (CaptureKind::MIDDLEBURY, 1, false));
    let views = capture.views(Split::All, 0, 1).unwrap();
    assert_eq!(views.len(), 16);
    // Its README gives a box around the temple; the rest of the pictures is black. Bright pixels lie in the box.
    let (low, high) = ([-0.073568_f32, 0.021728, -0.012445], [0.028855_f32, 0.181892, 0.062736]);
    for view in &views {
        let corners: Vec<(usize, usize)> = (0..8)
            .map(|i| std::array::from_fn(|j| if i >> j & 1 == 0 { low[j] } else { high[j] }))
            .map(|corner| pixel(&view.camera, corner).unwrap_or_else(|| panic!("camera {}", view.camera_id)))
            .collect();
        let range = |of: fn(&(usize, usize)) -> usize| {
            let values = || corners.iter().map(of);
            values().min().unwrap()..values().max().unwrap() + 1
        };
        let (columns, rows) = (range(|c| c.0), range(|c| c.1));
        let bright: Vec<(usize, usize)> = (0..view.image.num_pixels())
            .filter(|&i| view.image.plane(0)[i] > 0.25)
            .map(|i| (i % view.image.width, i / view.image.width))
            .collect();
        let inside = bright.iter().filter(|(x, y)| columns.contains(x) && rows.contains(y)).count();
        assert!(bright.len() > 5000 && inside as f64 > 0.95 * bright.len() as f64, "camera {}", view.camera_id);
    }
}
