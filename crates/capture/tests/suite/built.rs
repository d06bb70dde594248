//! Captures that a program builds.

use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

use crate::support::{HEIGHT, NUM_FRAMES, Small, WIDTH, camera};
use tcgs_capture::{CameraBuilder, Capture, CaptureBuilder, CaptureFacts, CaptureKind, Split};
use tcgs_core::{Image, PointCloud, Segmentation, View};

const SIZE: (usize, usize) = (WIDTH as usize, HEIGHT as usize);

fn image(value: f32) -> Image {
    Image::filled(SIZE.0, SIZE.1, 3, value)
}

fn mask() -> Segmentation {
    Segmentation { width: SIZE.0, height: SIZE.1, foreground: (0..SIZE.0 * SIZE.1).map(|i| i % 2 == 0).collect() }
}

/// Camera 0 with two images in memory.
fn in_memory() -> CameraBuilder {
    CameraBuilder::new(0, camera(0)).images(vec![image(0.25), image(0.5)])
}

fn builder() -> CaptureBuilder {
    CaptureBuilder::new("lamp", NUM_FRAMES)
}

fn views(capture: &Capture, split: Split) -> Vec<View> {
    (0..capture.num_frames()).flat_map(|frame| capture.views(split, frame, 1).unwrap()).collect()
}

/// A capture on disk and its copies from files, from memory and from closures give the same views.
#[test]
fn a_copy_from_files_memory_or_closures_is_the_same_capture() {
    let small = Small::new();
    small.write();
    let stored = small.open().unwrap();
    let all = views(&stored, Split::All);
    let of = |id: usize| -> Vec<View> { all.iter().filter(|view| view.camera_id == id).cloned().collect() };
    let masks_of = |id: usize| -> Vec<Segmentation> { of(id).into_iter().map(|v| v.segmentation.unwrap()).collect() };
    let paths = |path: &dyn Fn(usize) -> PathBuf| (0..NUM_FRAMES).map(path).collect::<Vec<_>>();
    let (made, made_masks) = (of(4), masks_of(4));
    let built = builder()
        .facts(CaptureFacts { has_floor: true, in_metres: true, labels_motion: true })
        .train_camera(
            CameraBuilder::new(1, camera(1))
                .image_files(paths(&|t| small.image(1, t)))
                .mask_files(paths(&|t| small.mask(1, t))),
        )
        .train_camera(
            CameraBuilder::new(2, camera(2))
                .images(of(2).into_iter().map(|view| view.image).collect())
                .masks(masks_of(2)),
        )
        .train_camera(
            CameraBuilder::moving(4, vec![camera(4); NUM_FRAMES])
                .images_from(move |frame| Ok(made[frame].image.clone()))
                .masks_from(move |frame| Ok(made_masks[frame].clone())),
        )
        .train_camera(CameraBuilder::new(5, camera(5)).image_files(paths(&|t| small.image(5, t))).masks(masks_of(5)))
        .test_camera(CameraBuilder::new(3, camera(3)).image_files(paths(&|t| small.image(3, t))))
        .points(stored.point_cloud().unwrap())
        .build()
        .unwrap();
    assert_eq!((built.name().as_str(), built.kind(), built.frame_rate()), ("lamp", CaptureKind::BUILT, 30.0));
    assert_eq!((built.facts(), built.has_segmentation()), (stored.facts(), true));
    assert_eq!((built.num_frames(), built.usual_frames()), (stored.num_frames(), stored.usual_frames()));
    for split in [Split::Train, Split::Test, Split::All] {
        assert_eq!(built.cameras(split, 1, 2).unwrap(), stored.cameras(split, 1, 2).unwrap());
        assert_eq!(views(&built, split), views(&stored, split));
        assert_eq!(built.views(split, 0, 2).unwrap(), stored.views(split, 0, 2).unwrap());
    }
    assert_eq!(built.point_cloud().unwrap().points, stored.point_cloud().unwrap().points);
}

#[test]
fn images_are_made_when_they_are_asked_for_and_no_sooner() {
    let made = Arc::new(AtomicUsize::new(0));
    let count = Arc::clone(&made);
    let make = move |frame: usize| {
        count.fetch_add(1, Ordering::Relaxed);
        if frame == 1 { Err("the projector is off".into()) } else { Ok(image(0.5)) }
    };
    let capture = builder().train_camera(CameraBuilder::new(7, camera(0)).images_from(make)).build().unwrap();
    assert_eq!(capture.cameras(Split::Train, 1, 1).unwrap().len(), 1);
    assert_eq!(made.load(Ordering::Relaxed), 0);
    assert_eq!(capture.views(Split::Train, 0, 1).unwrap()[0].image, image(0.5));
    let error = capture.views(Split::Train, 1, 1).unwrap_err();
    assert_eq!(error.to_string(), "camera 7, frame 1: the projector is off");
    assert_eq!(made.load(Ordering::Relaxed), 2);
    let wrong = CameraBuilder::new(7, camera(0)).images_from(|_| Ok(Image::filled(8, 6, 1, 0.0)));
    let error = builder().train_camera(wrong).build().unwrap().views(Split::Train, 0, 1).unwrap_err();
    assert_eq!(
        error.to_string(),
        "camera 7, frame 0: the image is 8x6 pixels of 1 channels, expected 16x12 of 3 as its camera has"
    );
}

#[test]
fn what_does_not_fit_together_is_named() {
    let problem = |builder: CaptureBuilder| builder.build().unwrap_err().to_string();
    let with = |camera: CameraBuilder| problem(builder().train_camera(camera));
    let empty = |id: usize| CameraBuilder::new(id, camera(0));
    assert_eq!(problem(builder()), "capture lamp: has no training cameras, expected at least one");
    assert_eq!(problem(CaptureBuilder::new("lamp", 0)), "capture lamp: has no frames, expected at least one");
    assert_eq!(with(empty(3)), "capture lamp: camera 3 has no images, expected one for each frame");
    assert_eq!(
        with(empty(3).images(vec![image(0.0)])),
        "capture lamp: camera 3 has 1 images, expected one for each of 2 frames"
    );
    assert_eq!(
        with(empty(3).images(vec![image(0.0), Image::filled(8, 6, 3, 0.0)])),
        "capture lamp: camera 3 at frame 1: the image is 8x6 pixels of 3 channels, expected 16x12 of 3 as its camera \
         has"
    );
    assert_eq!(
        with(in_memory().masks(vec![mask()])),
        "capture lamp: camera 0 has 1 masks, expected one for each of 2 frames"
    );
    assert_eq!(
        with(CameraBuilder::moving(3, vec![camera(0); 3]).images_from(|_| Ok(image(0.0)))),
        "capture lamp: camera 3 stands at 3 places, expected one, or one for each of 2 frames"
    );
    assert_eq!(
        problem(builder().train_camera(in_memory()).test_camera(in_memory())),
        "capture lamp: has the camera 0 twice, expected every camera once"
    );
    assert_eq!(
        with(empty(3).image_files(vec!["a.png".into(), "b.png".into()])),
        "a.png: no such file, expected frame 0 of camera 3"
    );
    let cloud = |points: Vec<[f32; 3]>| PointCloud { colors: vec![[0.5; 3]], foreground: vec![true], points };
    let with_points = |points| problem(builder().train_camera(in_memory()).points(cloud(points)));
    assert_eq!(
        with_points(vec![[0.0; 3]; 2]),
        "capture lamp: has 1 colours and 1 labels of points, expected 2 of each as there are points"
    );
    assert_eq!(
        with_points(vec![[f32::NAN, 0.0, 0.0]]),
        "capture lamp: has the point [NaN, 0.0, 0.0] of colour [0.5, 0.5, 0.5] at 0, expected finite numbers"
    );
    // Behind the camera.
    assert!(with_points(vec![[9.0, 0.0, 0.0]]).starts_with("lamp: the "));
}

#[test]
fn cameras_are_held_out_by_name_or_id() {
    let of = |id: usize| CameraBuilder::new(id, camera(0)).images(vec![image(0.25), image(0.5)]);
    let capture = builder().train_camera(of(3)).train_camera(of(5)).train_camera(of(8)).test_camera(of(9));
    let capture = capture.build().unwrap();
    let ids = |capture: &Capture, split| -> Vec<usize> {
        capture.cameras(split, 1, 1).unwrap().into_iter().map(|(id, _)| id).collect()
    };
    assert_eq!(capture.camera_names(Split::All, 0).unwrap(), ["3", "5", "8", "9"]);
    let chosen = capture.with_test_cameras(&["8".into(), "3".into()]).unwrap();
    assert_eq!((ids(&chosen, Split::Train), ids(&chosen, Split::Test)), (vec![5], vec![3, 8]));
    assert_eq!(chosen.views(Split::Test, 1, 1).unwrap().len(), 2);
    let chosen = capture.with_test_cameras(&["9".into(), "5".into()]).unwrap();
    assert_eq!((ids(&chosen, Split::Train), ids(&chosen, Split::Test)), (vec![3, 8], vec![5, 9]));
    let error = capture.with_test_cameras(&["4".into()]).unwrap_err().to_string();
    assert_eq!(error, "lamp: has no camera 4, expected some of 3, 5, 8, 9");
}
