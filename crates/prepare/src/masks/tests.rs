use tcgs_capture::{SyntheticSettings, write_synthetic};

use super::*;

/// Intersection over union of made and true masks, of all images.
fn agreement(capture: &Capture) -> f64 {
    let (mut both, mut either) = (0, 0);
    let mut truth: Vec<View> = Vec::new();
    let mut write = |frame: usize, camera_id: usize, mask: &Segmentation| {
        if truth.first().is_none_or(|view| view.frame != frame) {
            truth = capture.views(Split::All, frame, 1).unwrap();
        }
        let view = truth.iter().find(|view| view.camera_id == camera_id).unwrap();
        let given = view.segmentation.as_ref().unwrap();
        assert_eq!(
            (mask.width, mask.height, mask.foreground.len()),
            (given.width, given.height, given.foreground.len())
        );
        for (a, b) in mask.foreground.iter().zip(&given.foreground) {
            both += usize::from(*a && *b);
            either += usize::from(*a || *b);
        }
        ControlFlow::Continue(())
    };
    let mut last = 0.0;
    let mut report = |_: &str, share: f64| {
        assert!((last..1.0).contains(&share), "{share} after {last}");
        last = share;
    };
    make_masks(capture, &MaskSettings::default(), &mut write, &mut report).unwrap();
    f64::from(both as u32) / f64::from(either as u32)
}

#[test]
fn masks_of_a_rendered_room_are_the_true_ones() {
    let folder = tempfile::tempdir().unwrap();
    let settings = SyntheticSettings { num_timesteps: 32, num_points: 500, ..SyntheticSettings::default() };
    write_synthetic(folder.path(), &settings).unwrap();
    let found = agreement(&Capture::open(folder.path()).unwrap());
    assert!(found >= 0.8, "intersection over union {found}");
}

#[test]
fn where_a_person_stood_the_background_is_that_of_the_surroundings() {
    let (width, height, num_samples) = (96, 32, 16);
    let camera = Camera::look_at([0.0, 0.0, -3.0], [0.0; 3], [0.0, -1.0, 0.0], 50.0, width, height);
    let mut station = Station::new(0, &camera, 1);
    let wall = |x: usize| if x % 4 < 2 { [150, 120, 90] } else { [60, 80, 140] };
    let person = [210, 40, 40];
    // The person stands still for ten samples, then steps aside but for the feet.
    let (trunk, feet) = (|x: usize, y: usize| (20..26).contains(&x) && (8..20).contains(&y), |y: usize| y >= 18);
    for sample in 0..num_samples {
        let is_person = |x, y| trunk(x, y) && (sample < 10 || feet(y));
        let color = |i: usize| if is_person(i % width, i / width) { person } else { wall(i % width) };
        station.samples.push((0..width * height).map(color).collect());
    }
    let covered: Vec<bool> = (0..width * height).map(|i| trunk(i % width, i / width)).collect();
    station.find_background(Some(&vec![covered; num_samples]));
    for i in (0..width * height).filter(|&i| station.background.known[i]) {
        let found = station.background.colors[i].map(|value| (255.0 * value).round() as u8);
        assert_eq!(found, wall(i % width), "{} {}", i % width, i / width);
    }
    let is_known = |x: usize, y: usize| station.background.known[y * width + x];
    assert!((20..26).all(|x| (8..18).all(|y| is_known(x, y)) && (18..20).all(|y| !is_known(x, y))));

    // Before there is a hull.
    station.find_background(None);
    for (x, y) in (20..26).flat_map(|x| (8..18).map(move |y| (x, y))) {
        let found = station.background.colors[y * width + x].map(|value| (255.0 * value).round() as u8);
        assert_eq!(found, wall(x), "{x} {y}: the person stands there for ten samples of 16");
    }
}

#[test]
fn silhouettes_are_filled_where_gaps_are_narrow_and_holes_closed() {
    let (width, height) = (100, 60);
    let is_ring = |x: usize, y: usize| (20..60).contains(&x) && (10..50).contains(&y);
    let is_hole = |x: usize, y: usize| (30..50).contains(&x) && (20..40).contains(&y);
    // A gap of four pixels opens the hole to the right, one of twenty pixels cuts into the left side.
    let is_gap = |x: usize, y: usize| x >= 50 && (28..32).contains(&y);
    let is_cut = |x: usize, y: usize| x < 26 && (20..40).contains(&y);
    let mask: Vec<bool> = (0..width * height)
        .map(|i| (i % width, i / width))
        .map(|(x, y)| is_ring(x, y) && !is_hole(x, y) && !is_gap(x, y) && !is_cut(x, y))
        .collect();
    let filled = outline::filled(width, &mask);
    assert!(mask.iter().zip(&filled).all(|(mask, filled)| !mask || *filled));
    let at = |x: usize, y: usize| filled[y * width + x];
    assert!((30..50).all(|x| (20..40).all(|y| at(x, y))), "the hole");
    assert!((50..57).all(|x| (28..32).all(|y| at(x, y))), "the gap");
    assert!(!at(22, 30) && !at(62, 30) && !at(5, 5), "outside");
}

#[test]
fn too_few_frames_and_moving_cameras_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let settings =
        SyntheticSettings { width: 32, height: 24, num_timesteps: 8, num_points: 500, ..SyntheticSettings::default() };
    write_synthetic(folder.path(), &settings).unwrap();
    let problem = || {
        let capture = Capture::open_unseen(folder.path()).unwrap();
        let mut write = |_: usize, _: usize, _: &Segmentation| panic!("a mask");
        make_masks(&capture, &MaskSettings::default(), &mut write, &mut |_, _| ()).unwrap_err().to_string()
    };
    let path = folder.path().join("train_meta.json");
    let given: serde_json::Value = serde_json::from_slice(&std::fs::read(&path).unwrap()).unwrap();
    let mut moved = given.clone();
    moved["w2c"][4][2][0][3] = serde_json::json!(0.5);
    std::fs::write(&path, moved.to_string()).unwrap();
    let found = problem();
    assert!(found.contains("camera 2 moves or has no image at frame 4, expected cameras that stand still"), "{found}");

    write_synthetic(folder.path(), &SyntheticSettings { num_timesteps: 7, ..settings }).unwrap();
    let found = problem();
    assert!(found.contains("has 7 frames, expected at least 8 to tell what moves"), "{found}");
}
