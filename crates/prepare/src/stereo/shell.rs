//! The surroundings of all measured points: a sphere around the scene, and its floor.

use tcgs_core::{Pinhole, cross, distance, dot, length, normalize, sub};

use super::patchmatch::Random;

/// RANSAC trials for the floor.
const NUM_TRIALS: u64 = 300;
/// Number of points that judge a plane.
const NUM_JUDGES: usize = 2000;
/// A plane's thickness, as a share of the scene's size.
const THICKNESS: f32 = 0.01;
/// Minimum share of the points on a floor.
const MIN_FLOOR_SHARE: f32 = 0.08;
/// Largest mean distance of points from a sphere, relative, for a sphere to count.
const MAX_MISS: f32 = 0.1;
/// Radius of an unknown background, over the distance between the farthest cameras.
const UNKNOWN_DISTANCE: f32 = 3.0;

/// The surface on which background rays end.
#[derive(Clone, Debug)]
pub(super) struct Shell {
    center: [f32; 3],
    radius: f32,
    /// Unit normal towards the cameras, and its dot product with the points of the plane.
    floor: Option<([f32; 3], f32)>,
}

impl Shell {
    /// A sphere without a floor.
    pub fn around(center: [f32; 3], radius: f32) -> Self {
        Self { center, radius, floor: None }
    }

    /// Fits a shell to points of the background.
    ///
    /// - `min_radius`: least radius of a shell that is no sphere through points, in distances of the farthest camera
    ///   from the middle of all
    pub fn fit(cameras: &[Pinhole<f32>], points: &[[f32; 3]], min_radius: f32) -> Self {
        let middle = mean(cameras.iter().map(|camera| camera.center));
        let spread = cameras.iter().map(|camera| distance(camera.center, middle)).fold(0.0, f32::max);
        let step = points.len().div_ceil(NUM_JUDGES).max(1);
        let judges: Vec<[f32; 3]> = points.iter().step_by(step).copied().collect();
        let mut distances: Vec<f32> = judges.iter().map(|&point| distance(point, middle)).collect();
        distances.sort_by(f32::total_cmp);
        let Some(&far) = distances.get(distances.len() * 95 / 100) else {
            return Self { center: middle, radius: UNKNOWN_DISTANCE * 2.0 * spread, floor: None };
        };
        let floor = find_floor(cameras, &judges, far);
        let off_floor = |point: &[f32; 3]| {
            floor.is_none_or(|(normal, offset)| (dot(normal, *point) - offset).abs() > 3.0 * THICKNESS * far)
        };
        let rest: Vec<[f32; 3]> = judges.iter().copied().filter(off_floor).collect();
        // Every camera must be inside the sphere. Without such a sphere rays end all around at the far distance.
        let inside = |&(center, radius): &([f32; 3], f32)| {
            cameras.iter().all(|camera| distance(camera.center, center) < 1.1 * radius)
        };
        let (center, radius) = find_sphere(&rest).filter(inside).unwrap_or((middle, far.max(min_radius * spread)));
        Self { center, radius, floor }
    }

    /// Depth at which a ray ends.
    ///
    /// - `ray`: direction; its length is the unit of depth
    pub fn depth(&self, from: [f32; 3], ray: [f32; 3]) -> Option<f32> {
        let offset = sub(from, self.center);
        let (a, b, c) = (dot(ray, ray), dot(offset, ray), dot(offset, offset) - self.radius * self.radius);
        let discriminant = b * b - a * c;
        let sphere = (discriminant > 0.0).then(|| (discriminant.sqrt() - b) / a).filter(|&depth| depth > 0.0);
        let floor = self.floor.and_then(|(normal, offset)| {
            let depth = (offset - dot(normal, from)) / dot(normal, ray);
            (depth > 0.0).then_some(depth)
        });
        match (sphere, floor) {
            (Some(a), Some(b)) => Some(a.min(b)),
            (sphere, _) => sphere,
        }
    }
}

fn mean(points: impl Iterator<Item = [f32; 3]>) -> [f32; 3] {
    let (mut sum, mut count) = ([0.0; 3], 0.0_f32);
    for point in points {
        sum = std::array::from_fn(|i| sum[i] + point[i]);
        count += 1.0;
    }
    sum.map(|x| x / count.max(1.0))
}

/// The plane with most points on it and all cameras on one side (Fischler and Bolles 1981).
fn find_floor(cameras: &[Pinhole<f32>], points: &[[f32; 3]], size: f32) -> Option<([f32; 3], f32)> {
    let mut best = (MIN_FLOOR_SHARE * points.len() as f32, None);
    for trial in 0..NUM_TRIALS {
        let mut random = Random::new(1, trial);
        let mut pick = || points[((random.unit() * points.len() as f32) as usize).min(points.len() - 1)];
        let (a, b, c) = (pick(), pick(), pick());
        let across = cross(sub(b, a), sub(c, a));
        if length(across) < 1e-3 * size * size {
            continue;
        }
        let mut normal = normalize(across);
        if dot(normal, cameras[0].center) < dot(normal, a) {
            normal = normal.map(|x| -x);
        }
        let offset = dot(normal, a);
        let above = |camera: &Pinhole<f32>| dot(normal, camera.center) > offset + THICKNESS * size;
        let count = points.iter().filter(|&&p| (dot(normal, p) - offset).abs() < THICKNESS * size).count() as f32;
        if count > best.0 && cameras.iter().all(above) {
            best = (count, Some((normal, offset)));
        }
    }
    best.1
}

/// The sphere through points, by least squares of `|p|² = 2 c·p + (r² − |c|²)`; nothing if they are on none.
fn find_sphere(points: &[[f32; 3]]) -> Option<([f32; 3], f32)> {
    let middle = mean(points.iter().copied());
    let mut rows = [[0.0_f64; 5]; 4];
    for &point in points {
        let [x, y, z] = sub(point, middle).map(f64::from);
        let row = [2.0 * x, 2.0 * y, 2.0 * z, 1.0, x * x + y * y + z * z];
        for i in 0..4 {
            for j in 0..5 {
                rows[i][j] += row[i] * row[j];
            }
        }
    }
    let [x, y, z, rest] = super::solve(rows)?;
    let radius = (rest + x * x + y * y + z * z).max(0.0).sqrt() as f32;
    let center: [f32; 3] = std::array::from_fn(|i| middle[i] + [x, y, z][i] as f32);
    let misses = points.iter().map(|&point| (distance(point, center) - radius).abs());
    let miss = misses.sum::<f32>() / points.len() as f32;
    (points.len() >= 100 && miss < MAX_MISS * radius).then_some((center, radius))
}
