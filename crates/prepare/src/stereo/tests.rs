use tcgs_capture::{SyntheticSettings, distance_from_surface, write_synthetic};
use tcgs_core::{PointCloud, distance, dot, normalize};

use super::*;

/// One frame without points.
fn synthetic(settings: &SyntheticSettings) -> (tempfile::TempDir, Capture) {
    let folder = tempfile::tempdir().unwrap();
    write_synthetic(folder.path(), &SyntheticSettings { num_timesteps: 1, ..settings.clone() }).unwrap();
    std::fs::remove_file(folder.path().join("init_pt_cld.npz")).unwrap();
    let capture = Capture::open(folder.path()).unwrap();
    (folder, capture)
}

fn prepared(capture: &Capture, settings: &StereoSettings) -> Prepared {
    stereo_points(capture, settings, &mut |_| ()).unwrap()
}

/// Distances from the true surfaces of the points of an origin, ascending.
fn distances(prepared: &Prepared, foreground: bool, origin: Origin) -> Vec<f64> {
    let cloud = &prepared.cloud;
    let chosen =
        (0..cloud.points.len()).filter(|&i| prepared.origins[i] == origin && cloud.foreground[i] == foreground);
    let mut distances: Vec<f64> = chosen.map(|i| distance_from_surface(cloud.points[i], foreground)).collect();
    distances.sort_by(f64::total_cmp);
    distances
}

/// Checks the number of points of an origin, and limits of their distances at some shares of them, metres. The room is
/// 5.4 m wide, and a pixel of 128 sees 2 to 4 cm.
fn check(prepared: &Prepared, foreground: bool, origin: Origin, at_least: usize, limits: [(f64, f64); 2]) {
    let distances = distances(prepared, foreground, origin);
    assert!(distances.len() >= at_least, "{foreground} {origin:?}: {} points", distances.len());
    for (share, limit) in limits {
        let found = distances[(share * (distances.len() - 1) as f64) as usize];
        assert!(found < limit, "{foreground} {origin:?}: {share} of the points within {found}");
    }
}

#[test]
fn points_lie_on_the_true_surfaces() {
    let (_folder, capture) = synthetic(&SyntheticSettings::default());
    let prepared = prepared(&capture, &StereoSettings { num_points: 8000, ..StereoSettings::default() });
    check(&prepared, true, Origin::Triangulated, 1500, [(0.5, 0.015), (0.9, 0.05)]);
    check(&prepared, true, Origin::Hull, 100, [(0.5, 0.03), (0.9, 0.06)]);
    check(&prepared, false, Origin::Triangulated, 3000, [(0.5, 0.015), (0.9, 0.1)]);
    check(&prepared, false, Origin::Filled, 300, [(0.5, 0.16), (0.9, 0.45)]);
    // Some close holes that only cameras around see. Their depth is a guess.
    check(&in_images(&prepared, &capture), false, Origin::Shell, 100, [(0.5, 0.25), (0.9, 0.65)]);
    let views = capture.views(Split::Train, 0, 1).unwrap();
    assert!(!are_far_apart(&views) && !are_all_around(&views));
    assert!((6000..=8000).contains(&prepared.cloud.points.len()), "{}", prepared.cloud.points.len());
    assert!((0.2..1.0).contains(&prepared.agreement), "{}", prepared.agreement);
}

/// The points that some training image holds.
fn in_images(prepared: &Prepared, capture: &Capture) -> Prepared {
    let views = capture.views(Split::Train, 0, 1).unwrap();
    let vantages: Vec<Vantage> = views.iter().map(|view| Vantage::new(view, 1)).collect();
    let cloud = &prepared.cloud;
    let is_in = |&i: &usize| vantages.iter().any(|vantage| vantage.pinhole.pixel(cloud.points[i]).is_some());
    let mut kept = Prepared { agreement: prepared.agreement, ..Prepared::default() };
    for i in (0..cloud.points.len()).filter(is_in) {
        kept.cloud.points.push(cloud.points[i]);
        kept.cloud.colors.push(cloud.colors[i]);
        kept.cloud.foreground.push(cloud.foreground[i]);
        kept.origins.push(prepared.origins[i]);
    }
    kept
}

/// Checks that there are points all around the cameras.
fn assert_closed(cloud: &PointCloud, cameras: &[Camera]) {
    let middle = [0, 1, 2].map(|c| cameras.iter().map(|camera| camera.center()[c]).sum::<f64>() / cameras.len() as f64);
    let rays: Vec<[f64; 3]> =
        cloud.points.iter().map(|point| normalize(std::array::from_fn(|c| f64::from(point[c]) - middle[c]))).collect();
    for direction in [[1.0, 0.0, 0.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, 1.0], [0.0, 0.0, -1.0]] {
        let nearest = rays.iter().map(|ray| dot(*ray, direction)).fold(-1.0, f64::max);
        assert!(nearest > 0.9, "{direction:?}: {} degrees to the nearest point", nearest.acos().to_degrees());
    }
}

#[test]
fn the_shell_is_closed_in_all_directions() {
    let settings = SyntheticSettings { num_train_cameras: 4, num_test_cameras: 0, ..SyntheticSettings::default() };
    let (_folder, capture) = synthetic(&settings);
    let prepared = prepared(&capture, &StereoSettings { num_points: 8000, ..StereoSettings::default() });
    let cloud = &prepared.cloud;
    let num_outside = cloud.points.len() - in_images(&prepared, &capture).cloud.points.len();
    // 80 directions lie evenly, up to a fiftieth of the points beside images, and up to a fortieth in holes.
    assert!((100..=440).contains(&num_outside), "{num_outside} points are outside of all images");
    let cameras: Vec<Camera> = capture.cameras(Split::Train, 0, 1).unwrap().into_iter().map(|(_, at)| at).collect();
    assert_closed(cloud, &cameras);
    // Colours of walls, not black.
    assert!(cloud.colors.iter().all(|color| color.iter().sum::<f32>() > 0.1));
}

#[test]
fn holes_of_given_points_are_closed_where_no_image_shows_them() {
    let settings = SyntheticSettings { num_train_cameras: 4, num_test_cameras: 0, ..SyntheticSettings::default() };
    let (_folder, capture) = synthetic(&settings);
    let cameras: Vec<Camera> = capture.cameras(Split::Train, 0, 1).unwrap().into_iter().map(|(_, at)| at).collect();
    let prepared = prepared(&capture, &StereoSettings { num_points: 8000, ..StereoSettings::default() });
    let given = in_images(&prepared, &capture).cloud;
    let closed = close_holes(&given, &cameras);
    let n = given.points.len();
    assert_eq!((&closed.points[..n], &closed.colors[..n]), (&given.points[..], &given.colors[..]));
    let added = &closed.points[n..];
    assert!((20..=n / 20).contains(&added.len()), "{} points added to {n}", added.len());
    let pinholes: Vec<Pinhole<f32>> = cameras.iter().map(Pinhole::new).collect();
    assert!(added.iter().all(|&point| pinholes.iter().all(|pinhole| pinhole.pixel(point).is_none())));
    assert!(closed.foreground[n..].iter().all(|&foreground| !foreground));
    assert!(closed.colors[n..].iter().all(|color| color.iter().sum::<f32>() > 0.1), "a wall's colours, not black");
    assert_closed(&closed, &cameras);
}

#[test]
fn two_views_have_to_do_where_cameras_stand_far_apart() {
    let settings = SyntheticSettings { num_train_cameras: 4, num_test_cameras: 0, ..SyntheticSettings::default() };
    let (_folder, capture) = synthetic(&settings);
    let prepared = prepared(&capture, &StereoSettings { num_points: 8000, ..StereoSettings::default() });
    assert!(are_far_apart(&capture.views(Split::Train, 0, 1).unwrap()));
    check(&prepared, true, Origin::Triangulated, 1000, [(0.5, 0.015), (0.9, 0.05)]);
    check(&prepared, false, Origin::Triangulated, 1800, [(0.5, 0.015), (0.9, 0.06)]);
}

#[test]
fn points_have_the_colours_that_cameras_see() {
    let (_folder, capture) = synthetic(&SyntheticSettings::default());
    let prepared = prepared(&capture, &StereoSettings { num_points: 4000, ..StereoSettings::default() });
    // A held-out camera sees the same ball from where no other camera stands.
    let view = &capture.views(Split::Test, 0, 1).unwrap()[0];
    let (vantage, mut differences) = (Vantage::new(view, 1), Vec::new());
    for i in (0..prepared.cloud.points.len()).filter(|&i| prepared.cloud.foreground[i]) {
        if let Some((pixel, depth)) = vantage.pinhole.pixel(prepared.cloud.points[i])
            && vantage.is_foreground(pixel)
            && depth < 2.2
        {
            let color = prepared.cloud.colors[i];
            differences.push((0..3).map(|c| (vantage.colors[pixel][c] - color[c]).abs()).fold(0.0, f32::max));
        }
    }
    differences.sort_by(f32::total_cmp);
    assert!(differences.len() > 100, "{}", differences.len());
    assert!(differences[differences.len() / 2] < 0.08, "{}", differences[differences.len() / 2]);
}

#[test]
fn equal_images_give_equal_points_whatever_the_threads() {
    let (_folder, capture) = synthetic(&SyntheticSettings { width: 64, height: 48, ..SyntheticSettings::default() });
    let with = |num_threads: usize, seed: u64| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(num_threads).build().unwrap();
        let settings = StereoSettings { num_points: 2000, seed, ..StereoSettings::default() };
        pool.install(|| prepared(&capture, &settings)).cloud
    };
    let one = with(1, 0);
    assert_eq!(one, with(3, 0));
    assert_ne!(one, with(2, 1));
}

#[test]
fn without_masks_anything_may_move() {
    let settings = SyntheticSettings { width: 64, height: 48, ..SyntheticSettings::default() };
    let (folder, _) = synthetic(&settings);
    std::fs::remove_dir_all(folder.path().join("seg")).unwrap();
    let capture = Capture::open(folder.path()).unwrap();
    let prepared = prepared(&capture, &StereoSettings { num_points: 2000, ..StereoSettings::default() });
    assert!(prepared.count(Origin::Hull) == 0 && prepared.count(Origin::Triangulated) > 200);
    assert!(prepared.cloud.foreground.iter().all(|&foreground| foreground));
}

#[test]
fn cameras_that_fit_nothing_are_refused() {
    let (folder, _) = synthetic(&SyntheticSettings { width: 64, height: 48, ..SyntheticSettings::default() });
    // Every image becomes the same grey.
    for camera in 0..14 {
        image::GrayImage::from_pixel(64, 48, image::Luma([128]))
            .save(folder.path().join(format!("ims/{camera}/000000.png")))
            .unwrap();
    }
    std::fs::remove_dir_all(folder.path().join("seg")).unwrap();
    let capture = Capture::open(folder.path()).unwrap();
    let problem = stereo_points(&capture, &StereoSettings::default(), &mut |_| ()).unwrap_err().to_string();
    assert!(problem.contains("no views agree on any depth"), "{problem}");
}

/// Rewrites the matrices of all training cameras.
fn change_matrices(folder: &tempfile::TempDir, change: impl Fn(usize, &mut [[f64; 4]; 4])) {
    let path = folder.path().join("train_meta.json");
    let mut meta: serde_json::Value = serde_json::from_slice(&std::fs::read(&path).unwrap()).unwrap();
    for (i, matrix) in meta["w2c"][0].as_array_mut().unwrap().iter_mut().enumerate() {
        let mut changed = serde_json::from_value(matrix.clone()).unwrap();
        change(i, &mut changed);
        *matrix = serde_json::json!(changed);
    }
    std::fs::write(path, meta.to_string()).unwrap();
}

#[test]
fn cameras_too_far_apart_are_refused_unless_masks_give_a_hull() {
    let small = SyntheticSettings { width: 64, height: 48, ..SyntheticSettings::default() };
    // 83 degrees from camera to camera.
    let (folder, capture) =
        synthetic(&SyntheticSettings { num_train_cameras: 3, num_test_cameras: 0, ..small.clone() });
    let masked = prepared(&capture, &StereoSettings { num_points: 2000, ..StereoSettings::default() });
    assert!(masked.origins.iter().all(|origin| [Origin::Hull, Origin::Shell].contains(origin)));
    let distances = distances(&masked, true, Origin::Hull);
    assert!(distances.len() > 50 && distances[distances.len() / 2] < 0.1, "{} points", distances.len());

    let expect_refusal = |folder: &tempfile::TempDir| {
        std::fs::remove_dir_all(folder.path().join("seg")).unwrap();
        let capture = Capture::open_unseen(folder.path()).unwrap();
        let refused = stereo_points(&capture, &StereoSettings::default(), &mut |_| ()).unwrap_err().to_string();
        assert!(refused.contains("has no training camera with two others within 66 degrees"), "{refused}");
        assert_eq!(crate::check(&capture, &mut |_| ()).unwrap_err().to_string(), refused);
    };
    expect_refusal(&folder);
    // All in one place.
    let (folder, _) = synthetic(&small);
    change_matrices(&folder, |_, matrix| (0..3).for_each(|row| matrix[row][3] = 0.0));
    expect_refusal(&folder);
}

#[test]
fn a_camera_that_looks_away_does_no_harm() {
    let (folder, _) = synthetic(&SyntheticSettings { width: 64, height: 48, ..SyntheticSettings::default() });
    std::fs::remove_dir_all(folder.path().join("seg")).unwrap();
    // Turned by half a turn about its own vertical.
    change_matrices(&folder, |i, matrix| {
        if i == 4 {
            [0, 2].into_iter().for_each(|row| matrix[row] = matrix[row].map(|x| -x));
        }
    });
    let capture = Capture::open(folder.path()).unwrap();
    let prepared = prepared(&capture, &StereoSettings { num_points: 2000, ..StereoSettings::default() });
    assert!(prepared.count(Origin::Triangulated) > 200, "{}", prepared.count(Origin::Triangulated));
}

#[test]
fn the_unit_of_length_may_be_tiny() {
    let (folder, _) = synthetic(&SyntheticSettings { width: 64, height: 48, ..SyntheticSettings::default() });
    std::fs::remove_dir_all(folder.path().join("seg")).unwrap();
    change_matrices(&folder, |_, matrix| (0..3).for_each(|row| matrix[row][3] *= 1e7));
    let capture = Capture::open(folder.path()).unwrap();
    let prepared = prepared(&capture, &StereoSettings { num_points: 2000, ..StereoSettings::default() });
    assert!(prepared.count(Origin::Triangulated) > 200, "{}", prepared.count(Origin::Triangulated));
}

#[test]
fn a_search_without_other_views_believes_nothing() {
    let (_folder, capture) = synthetic(&SyntheticSettings { width: 64, height: 48, ..SyntheticSettings::default() });
    let vantage = Vantage::new(&capture.views(Split::Train, 0, 1).unwrap()[0], 1);
    let ranges = vec![[0.1, 1.0]; vantage.gray.len()];
    let map = Search { vantage: &vantage, sources: Vec::new(), ranges: &ranges, seed: 0 }.begin(None);
    assert!(Belief::of(&map, MAX_COST).known.iter().all(|known| !known));
}

#[test]
fn the_hull_of_a_ball_is_the_ball() {
    let (radius, center) = (0.3, [0.1, -0.2, 0.05]);
    let cameras: Vec<Camera> = (0..12)
        .map(|i| {
            let angle = f64::from(i) * std::f64::consts::TAU / 12.0;
            let from = [2.0 * angle.cos(), [-1.5, 0.4, 1.0][i as usize % 3], 2.0 * angle.sin()];
            Camera::look_at(from, [0.0; 3], [0.0, -1.0, 0.0], 100.0, 96, 96)
        })
        .collect();
    let pinholes: Vec<Pinhole<f32>> = cameras.iter().map(Pinhole::new).collect();
    let masks: Vec<Vec<bool>> = pinholes
        .iter()
        .map(|pinhole| {
            let sees = |pixel: usize| {
                let ray = normalize(pinhole.ray(pinhole.pixel_center(pixel)));
                let to = tcgs_core::sub(center, pinhole.center);
                let along = dot(to, ray);
                dot(to, to) - along * along < radius * radius
            };
            (0..96 * 96).map(sees).collect()
        })
        .collect();
    let silhouettes: Vec<Silhouette> =
        pinholes.iter().zip(&masks).map(|(pinhole, mask)| Silhouette { pinhole, mask }).collect();
    let hull = Hull::carve(&silhouettes, 1.5);
    let distances: Vec<f32> = hull.surface().iter().map(|&p| distance(p, center)).collect();
    let mean = distances.iter().sum::<f32>() / distances.len() as f32;
    assert!(distances.len() > 300 && (mean - radius).abs() < 0.04, "{} cubes, {mean}", distances.len());
    assert!(distances.iter().all(|&d| d < radius + 0.15), "a hull of 12 views reaches little beyond");
    let [near, far] = hull.depths(&hull.surface(), &pinholes[0])[48 * 96 + 48];
    assert!(near < far && near > 1.0 && far < 3.5, "{near} to {far}");

    // One mask in twelve that lost everything is one too many here; two views alone say nothing.
    assert!(Hull::carve(&[], 1.5).surface().is_empty());
}

#[test]
fn two_lines_of_sight_make_no_hull() {
    let cameras = [[2.0, 0.0], [-2.0, 0.0], [0.0, 2.0], [0.0, -2.0]]
        .map(|[x, z]| Camera::look_at([x, -1.0, z], [0.0; 3], [0.0, -1.0, 0.0], 60.0, 48, 48));
    let pinholes: Vec<Pinhole<f32>> = cameras.iter().map(Pinhole::new).collect();
    let mask = vec![true; 48 * 48];
    let silhouettes: Vec<Silhouette> = pinholes.iter().map(|pinhole| Silhouette { pinhole, mask: &mask }).collect();
    let num_seeing = |silhouettes: &[Silhouette]| {
        let seeing = |&point: &[f32; 3]| silhouettes.iter().filter(|s| s.pinhole.pixel(point).is_some()).count();
        Hull::carve(silhouettes, 1.5).surface().iter().map(seeing).min()
    };
    assert_eq!(num_seeing(&silhouettes), Some(3), "of four cameras three must see a place");
    assert_eq!(num_seeing(&silhouettes[..3]), Some(2), "of three cameras two");
}

#[test]
fn cameras_far_apart_share_a_floor() {
    let small = SyntheticSettings { width: 96, height: 72, ..SyntheticSettings::default() };
    let (_folder, capture) = synthetic(&SyntheticSettings { num_train_cameras: 4, num_test_cameras: 0, ..small });
    let mut views = capture.views(Split::Train, 0, 1).unwrap();
    assert!(are_all_around(&views));
    let floor = sweep::find_floor(&views).unwrap();
    assert!(floor.normal[1] < -0.9998 && floor.offset.abs() < 0.02, "{floor:?}, the floor is at y = 0");
    // Measured points below it are mistakes.
    let prepared = prepared(&capture, &StereoSettings { num_points: 8000, ..StereoSettings::default() });
    let measured = prepared.cloud.points.iter().zip(&prepared.origins).filter(|(_, at)| **at == Origin::Triangulated);
    let lowest = measured.map(|(&point, _)| floor.distance(point)).fold(f32::INFINITY, f32::min);
    assert!((-1e-3..0.3).contains(&lowest), "{lowest}");

    // Cameras that are not where their images are from share nothing.
    let matrices: Vec<_> = views.iter().map(|view| view.camera.camera_from_world).collect();
    for (i, view) in views.iter_mut().enumerate() {
        view.camera.camera_from_world = matrices[(i + 1) % 4];
    }
    assert!(sweep::find_floor(&views).is_none());
}

#[test]
fn pixels_that_agree_by_chance_make_no_points() {
    let camera = Camera::look_at([0.0; 3], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0], 60.0, 64, 48);
    let pinhole = Pinhole::new(&camera);
    let rule = Rule { same_depth: 0.01, same_place_px: 1.0, min_agreeing: 1, min_pixels: 16 };
    let at = |x: usize, y: usize, depth: f32| {
        let pixel = y * 64 + x;
        let position = pinhole.unproject(pinhole.pixel_center(pixel), depth);
        (pixel, Point { position, color: [0.5; 3], foreground: false })
    };
    let wall = (0..20).map(|i| at(10 + i % 5, 10 + i / 5, 4.0));
    // Beside the wall before it, and at its depth far beside it.
    let (before, far) = ([at(15, 12, 3.0), at(16, 12, 3.0)], [at(50, 40, 4.0)]);
    let mut points: Vec<(usize, Point)> = wall.chain(before).chain(far).collect();
    fuse::retain_patches(&mut points, &pinhole, &rule);
    assert_eq!(points.len(), 20);
    let rule = Rule { min_pixels: 21, ..rule };
    fuse::retain_patches(&mut points, &pinhole, &rule);
    assert!(points.is_empty(), "the wall has 20 pixels");
}

#[test]
fn the_shell_is_behind_cameras_whose_points_do_not_tell_of_walls() {
    let view = |x: f64, z: f64| View {
        image: tcgs_core::Image::filled(64, 48, 3, 0.5),
        camera: Camera::look_at([x, 0.0, z], [0.0; 3], [0.0, -1.0, 0.0], 60.0, 64, 48),
        segmentation: None,
        frame: 0,
        camera_id: 0,
    };
    let views = [view(2.0, 0.0), view(-2.0, 0.0), view(0.0, 2.0), view(0.0, -2.0)];
    let pinholes: Vec<Pinhole<f32>> = views.iter().map(|view| Pinhole::new(&view.camera)).collect();
    // A thing in the middle, which is no sphere.
    let points: Vec<[f32; 3]> =
        (0..200).map(|i| [0.004 * i as f32, 0.1 * (i % 7) as f32, 0.05 * (i % 3) as f32]).collect();
    for (min_radius, expected) in [(1.5, 3.0), (0.0, 0.8)] {
        let depth = Shell::fit(&pinholes, &points, min_radius, None).depth([0.0; 3], [0.0, -1.0, 0.0]);
        assert!(depth.is_some_and(|depth| (depth - expected).abs() < 0.1), "{depth:?}");
    }
}

#[test]
fn walls_of_a_room_go_on_where_no_point_is() {
    // A room of 6 x 3 x 6 units with its floor at y = 0, and a table. Points lie on the left half of the wall ahead, on
    // a part of the floor and on the table.
    let camera = |x: f64| Camera::look_at([x, -1.5, -2.5], [0.0, -1.0, 3.0], [0.0, -1.0, 0.0], 60.0, 64, 48);
    let pinholes: Vec<Pinhole<f32>> = [-0.5, 0.5].map(|x| Pinhole::new(&camera(x))).into();
    let grid = || (0..400).map(|i| [(i % 20) as f32 / 19.0, (i / 20) as f32 / 19.0]);
    let table = |[u, v]: [f32; 2]| [u - 0.5, -0.8, v];
    let floor = grid().map(|[u, v]| [6.0 * u - 3.0, 0.0, 4.0 * v - 1.0]);
    let points: Vec<[f32; 3]> =
        grid().map(|[u, v]| [3.0 * u - 3.0, -3.0 * v, 3.0]).chain(grid().map(table)).chain(floor).collect();
    let shell = Shell::fit(&pinholes, &points, 0.0, None);
    let depth = |ray| shell.depth([0.5, -1.5, -2.5], ray).unwrap();
    for (ray, expected, what) in [
        ([0.2, -0.1, 1.0], 5.5, "the right half of the wall has no point"),
        ([0.2, 1.0, 0.2], 1.5, "the floor between the camera and the table has none"),
        ([-0.1, 0.5, 1.0], 3.0, "the table is not a wall: the floor is behind it"),
    ] {
        assert!((depth(ray) - expected).abs() < 0.05, "{}, {what}", depth(ray));
    }
}

#[test]
fn filling_continues_a_plane() {
    let view = |camera: Camera| View {
        image: tcgs_core::Image::filled(camera.width, camera.height, 3, 0.5),
        camera,
        segmentation: None,
        frame: 0,
        camera_id: 0,
    };
    let camera = Camera::look_at([0.0; 3], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0], 60.0, 64, 48);
    let vantage = Vantage::new(&view(camera), 1);
    // A floor seen from above: inverse depth grows downwards. Its middle is not known.
    let inverse_depth = |pixel: usize| 0.2 + 0.01 * (pixel / 64) as f32;
    let hole = |pixel: usize| (20..36).contains(&(pixel % 64)) && (16..32).contains(&(pixel / 64));
    let known = |pixel: usize| if hole(pixel) { 0.0 } else { 1.0 / inverse_depth(pixel) };
    let sure = SureDepths { depths: (0..64 * 48).map(known).collect() };
    let filled = fill::fill(&vantage, &sure, 5);
    for pixel in 0..64 * 48 {
        if hole(pixel) {
            assert!((filled[pixel] / inverse_depth(pixel) - 1.0).abs() < 0.12, "{pixel}: {}", filled[pixel]);
        } else {
            assert_eq!(filled[pixel], 0.0);
        }
    }
    // Not further than it is told to.
    let alone = SureDepths { depths: (0..64 * 48).map(|pixel| f32::from(u8::from(pixel == 0))).collect() };
    let filled = fill::fill(&vantage, &alone, 3);
    assert!(filled[5] > 0.0 && filled[40] == 0.0);
}

#[test]
fn thinning_keeps_the_best_and_the_count() {
    let point = |x: f32, y: f32, z: f32| Point { position: [x, y, z], color: [x, 0.0, 0.0], foreground: true };
    let grid = |z: f32| (0..10_000).map(|i| point((i % 100) as f32, (i / 100) as f32, z)).collect::<Vec<_>>();
    let lists = [grid(0.0), [grid(0.3), grid(50.0)].concat()];
    let thinned = thin::thin(&lists, 1000);
    assert!((600..=1000).contains(&thinned.len()), "{}", thinned.len());
    for (list, point) in &thinned {
        // Where both lists have points the first one wins.
        assert_eq!(point.position[2] > 25.0, *list == 1, "{point:?}");
    }
    assert_eq!(thin::thin(&[grid(0.0)], 20_000).len(), 10_000);
    // Far out, as in millimetres.
    let far = grid(0.0).into_iter().map(|p| Point { position: p.position.map(|x| 5000.0 + x), ..p }).collect();
    assert_eq!(thin::thin(&[far], 20_000).len(), 10_000);
}

#[test]
fn equations_are_solved_or_not() {
    let found = solve([[0.0, 2.0, 4.0], [1.0, 1.0, 5.0]]).unwrap();
    assert!((found[0] - 3.0).abs() < 1e-12 && (found[1] - 2.0).abs() < 1e-12);
    assert_eq!(solve([[1.0, 2.0, 4.0], [2.0, 4.0, 5.0]]), None);
}
