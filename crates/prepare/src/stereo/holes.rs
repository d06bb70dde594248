//! Closes what no training image shows, by the shell in the colours around: holes that cameras around the training
//! cameras see, and all directions outside of the images.

use tcgs_core::{Camera, Pinhole, PointCloud, cameras_around, mean_vector, squared_distance};

use super::{BLOCK_PX, StereoSettings, fuse::Point, median, shell::Shell, thin, unmet};

/// Cameras around the training cameras, which look for holes.
const NUM_AROUND: usize = 64;
/// One point in so many, at most, lies in a hole. These points stand for what is unknown, so they are few and large.
const POINTS_PER_HOLE: usize = 40;
/// The shell is closed in one direction for so many points: with 80,000 points every seven degrees.
const POINTS_PER_DIRECTION: usize = 100;
/// Beside images there are so many times as many directions. Gaussians there may not reach into an image, so only small
/// ones close the shell.
const DENSER: usize = 16;
/// At most one point in so many lies beside images.
const POINTS_PER_BESIDE: usize = 50;
/// Width of what lies beside an image, as a share of its longer side.
const BESIDE: f32 = 0.2;
/// Number of points that lend their colours.
const NUM_SAMPLES: usize = 2000;
/// Number of the nearest among them whose median colour is taken.
const NUM_NEAREST: usize = 8;

/// Adds a sphere around the scene, or the walls of a room, in directions that no training image shows. These directions
/// lie outside of all images, or cameras around the training cameras meet no point there. Without points, pictures
/// from other cameras are black there. Points by [`stereo_points`](super::stereo_points) have both already.
///
/// - `cloud`: at least one point
/// - `cameras`: of the training images
/// - returns: the points, and then the added ones in the colours of the nearest background. They are foreground only if
///   all points are
#[must_use]
pub fn close_holes(cloud: &PointCloud, cameras: &[Camera]) -> PointCloud {
    let widest = cameras.iter().map(|camera| camera.width).max().unwrap_or(1);
    let factor = widest.div_ceil(StereoSettings::default().image_width).max(1);
    let pinholes: Vec<Pinhole<f32>> = cameras.iter().map(|camera| Pinhole::new(&camera.downscaled(factor))).collect();
    let all_move = cloud.foreground.iter().all(|&foreground| foreground);
    let point = |i: usize| Point { position: cloud.points[i], color: cloud.colors[i], foreground: cloud.foreground[i] };
    let points: Vec<Point> = (0..cloud.points.len()).map(point).collect();
    let background: Vec<Point> = points.iter().filter(|point| all_move || !point.foreground).cloned().collect();
    let positions: Vec<[f32; 3]> = background.iter().map(|point| point.position).collect();
    let shell = Shell::fit(&pinholes, &positions, 0.0, None);

    let mut holes = hole_ends(&around(cameras, factor), std::slice::from_ref(&points), &shell);
    // Given points and density control fill the space that a training image shows.
    holes.retain(|point| pinholes.iter().all(|pinhole| pinhole.pixel(point.position).is_none()));
    let outside = outside_ends(&pinholes, &shell, points.len());
    let mut closed = cloud.clone();
    for Point { position, color, .. } in colored(holes, outside, &[background], points.len()) {
        closed.points.push(position);
        closed.colors.push(color);
        closed.foreground.push(all_move);
    }
    closed
}

/// Cameras around others, with images downscaled by a whole factor.
pub(super) fn around(cameras: &[Camera], factor: usize) -> Vec<Pinhole<f32>> {
    cameras_around(cameras, 0..NUM_AROUND).iter().map(|camera| Pinhole::new(&camera.downscaled(factor))).collect()
}

/// The ends of rays of cameras that meet no point, one for each block of pixels.
///
/// - `points`: all points so far
pub(super) fn hole_ends(cameras: &[Pinhole<f32>], points: &[Vec<Point>], shell: &Shell) -> Vec<Point> {
    let of = |camera: &Pinhole<f32>| -> Vec<Point> {
        let middle = |&pixel: &usize| {
            [pixel % camera.width, pixel / camera.width].iter().all(|at| at % BLOCK_PX == BLOCK_PX / 2)
        };
        let end = |pixel: usize| {
            let place = camera.pixel_center(pixel);
            let depth = shell.depth(camera.center, camera.ray(place))?;
            Some(Point { position: camera.unproject(place, depth), color: [0.0; 3], foreground: false })
        };
        unmet(camera, points).into_iter().filter(middle).filter_map(end).collect()
    };
    cameras.iter().flat_map(of).collect()
}

/// Points of the shell outside of all images, in directions from the middle of the cameras. They lie evenly, and more
/// densely beside images.
///
/// - `num_points`: of the whole cloud
pub(super) fn outside_ends(cameras: &[Pinhole<f32>], shell: &Shell, num_points: usize) -> Vec<Point> {
    let middle = mean_vector(cameras.iter().map(|camera| camera.center));
    let wider: Vec<Pinhole<f32>> = cameras.iter().map(widened).collect();
    let is_in = |cameras: &[Pinhole<f32>], point: &Point| cameras.iter().any(|at| at.pixel(point.position).is_some());
    let end = |ray: [f32; 3]| {
        let depth = shell.depth(middle, ray)?;
        let position = std::array::from_fn(|c| middle[c] + depth * ray[c]);
        Some(Point { position, color: [0.0; 3], foreground: false })
    };
    let count = num_points / POINTS_PER_DIRECTION;
    let far = directions(count).filter_map(end).filter(|point| !is_in(&wider, point));
    let beside = directions(DENSER * count).filter_map(end).filter(|point| is_in(&wider, point));
    let beside: Vec<Point> = beside.filter(|point| !is_in(cameras, point)).collect();
    far.chain(thin::thin(&[beside], num_points / POINTS_PER_BESIDE).into_iter().map(|(_, point)| point)).collect()
}

/// The camera with a larger image: it ends a fifth farther out on each side.
fn widened(camera: &Pinhole<f32>) -> Pinhole<f32> {
    let margin = (BESIDE * camera.width.max(camera.height) as f32) as usize;
    Pinhole {
        width: camera.width + 2 * margin,
        height: camera.height + 2 * margin,
        principal: camera.principal.map(|at| at + margin as f32),
        ..camera.clone()
    }
}

/// So many unit vectors that are spread evenly: a spiral whose turns are golden angles.
fn directions(count: usize) -> impl Iterator<Item = [f32; 3]> {
    (0..count).map(move |i| {
        let z = 1.0 - (2 * i + 1) as f32 / count as f32;
        let (sin, cos) = (i as f32 * std::f32::consts::PI * (3.0 - 5.0_f32.sqrt())).sin_cos();
        let across = (1.0 - z * z).sqrt();
        [across * cos, across * sin, z]
    })
}

/// The points of the shell that close it, in the colours of the background that is nearest to each.
///
/// - `holes`, `outside`: of [`hole_ends`], of which some are taken, and of [`outside_ends`]
/// - `num_points`: of the whole cloud
pub(super) fn colored(
    holes: Vec<Point>,
    outside: Vec<Point>,
    background: &[Vec<Point>],
    num_points: usize,
) -> Vec<Point> {
    let count = background.iter().map(Vec::len).sum::<usize>();
    let samples: Vec<&Point> = background.iter().flatten().step_by(count.div_ceil(NUM_SAMPLES).max(1)).collect();
    let colored = |point: Point| {
        let mut near: Vec<(f32, [f32; 3])> =
            samples.iter().map(|other| (squared_distance(point.position, other.position), other.color)).collect();
        near.sort_by(|a, b| a.0.total_cmp(&b.0));
        let colors: Vec<[f32; 3]> = near.iter().take(NUM_NEAREST).map(|&(_, color)| color).collect();
        Point { color: median(&colors), ..point }
    };
    let holes = thin::thin(&[holes], num_points / POINTS_PER_HOLE).into_iter().map(|(_, point)| point);
    holes.chain(outside).map(colored).collect()
}
