//! The surroundings of all measured points: a sphere around the scene, and the flat walls of a room.

use tcgs_core::{Pinhole, cross, distance, dot, length, mean_vector, normalize, sub};

use super::patchmatch::Random;

/// RANSAC trials for a wall.
const NUM_TRIALS: u64 = 2000;
/// Number of points that judge the walls.
const NUM_JUDGES: usize = 2000;
/// Most walls: the sides of a box.
const MAX_WALLS: usize = 6;
/// A wall's thickness, as a share of the scene's size.
const THICKNESS: f32 = 0.01;
/// Minimum shares of the points on the first wall, and on each other.
const MIN_WALL_SHARES: [f32; 2] = [0.08, 0.04];
/// Largest shares of the points behind the first wall, and behind each other. These are mistakes, or belong to what
/// stands there. Where few depths are right, as with four cameras, many mistakes lie behind the floor.
const MAX_BEHIND: [f32; 2] = [1.0, 0.02];
/// Largest mean distance of points from a sphere, relative, for a sphere to count.
const MAX_MISS: f32 = 0.1;
/// Radius of an unknown background, over the distance between the farthest cameras.
const UNKNOWN_DISTANCE: f32 = 3.0;

/// The surface on which background rays end.
#[derive(Clone, Debug)]
pub(super) struct Shell {
    center: [f32; 3],
    radius: f32,
    walls: Vec<Wall>,
}

/// A plane with all cameras on one side: a floor, a wall or a ceiling. Hardly any point is behind it. The first one has
/// the most points, or is known, and may have many behind it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Wall {
    /// Unit normal towards the cameras.
    pub normal: [f32; 3],
    /// Dot product of the normal with the points of the plane, scene units.
    pub offset: f32,
}

impl Wall {
    /// Distance of a point from the plane, negative behind it. Scene units.
    pub fn distance(self, point: [f32; 3]) -> f32 {
        dot(self.normal, point) - self.offset
    }

    /// Depth at which a ray meets the plane, if it does.
    fn depth(self, from: [f32; 3], ray: [f32; 3]) -> Option<f32> {
        Some(-self.distance(from) / dot(self.normal, ray)).filter(|&depth| depth > 0.0 && depth.is_finite())
    }
}

impl Shell {
    /// A sphere without walls.
    pub fn around(center: [f32; 3], radius: f32) -> Self {
        Self { center, radius, walls: Vec::new() }
    }

    /// Fits a shell to points of the background.
    ///
    /// - `min_radius`: least radius of a shell that is no sphere through points, in distances of the farthest camera
    ///   from the middle of all
    /// - `floor`: the first wall, if it is known
    pub fn fit(cameras: &[Pinhole<f32>], points: &[[f32; 3]], min_radius: f32, floor: Option<Wall>) -> Self {
        let middle = mean_vector(cameras.iter().map(|camera| camera.center));
        let spread = cameras.iter().map(|camera| distance(camera.center, middle)).fold(0.0, f32::max);
        let step = points.len().div_ceil(NUM_JUDGES).max(1);
        let judges: Vec<[f32; 3]> = points.iter().step_by(step).copied().collect();
        let mut distances: Vec<f32> = judges.iter().map(|&point| distance(point, middle)).collect();
        distances.sort_by(f32::total_cmp);
        let Some(&far) = distances.get(distances.len() * 95 / 100) else {
            return Self::around(middle, UNKNOWN_DISTANCE * 2.0 * spread);
        };
        let (mut walls, mut rest) = (Vec::new(), judges.clone());
        let mut known = floor;
        while walls.len() < MAX_WALLS
            && let Some(wall) = known.take().or_else(|| find_wall(cameras, &rest, &judges, far, walls.is_empty()))
        {
            rest.retain(|&point| wall.distance(point).abs() > 3.0 * THICKNESS * far);
            walls.push(wall);
        }
        // Every camera must be inside the sphere. Without such a sphere rays end all around at the far distance.
        let inside = |&(center, radius): &([f32; 3], f32)| {
            cameras.iter().all(|camera| distance(camera.center, center) < 1.1 * radius)
        };
        let (center, radius) = find_sphere(&rest).filter(inside).unwrap_or((middle, far.max(min_radius * spread)));
        Self { center, radius, walls }
    }

    /// Depth at which a ray ends.
    ///
    /// - `ray`: direction; its length is the unit of depth
    pub fn depth(&self, from: [f32; 3], ray: [f32; 3]) -> Option<f32> {
        let offset = sub(from, self.center);
        let (a, b, c) = (dot(ray, ray), dot(offset, ray), dot(offset, offset) - self.radius * self.radius);
        let discriminant = b * b - a * c;
        let sphere = (discriminant > 0.0).then(|| (discriminant.sqrt() - b) / a).filter(|&depth| depth > 0.0);
        let walls = self.walls.iter().filter_map(|wall| wall.depth(from, ray));
        sphere.into_iter().chain(walls).min_by(f32::total_cmp)
    }
}

/// The wall on which most points are (Fischler and Bolles 1981).
///
/// - `points`: those on no wall so far, among `all`
/// - `size`: of the scene, scene units
/// - `is_first`: whether no wall is known
fn find_wall(
    cameras: &[Pinhole<f32>],
    points: &[[f32; 3]],
    all: &[[f32; 3]],
    size: f32,
    is_first: bool,
) -> Option<Wall> {
    let thickness = THICKNESS * size;
    let [min_share, max_behind] = [MIN_WALL_SHARES, MAX_BEHIND].map(|shares| shares[usize::from(!is_first)]);
    let mut most = (min_share * all.len() as f32) as usize;
    let mut best = None;
    for trial in 0..if points.len() > most { NUM_TRIALS } else { 0 } {
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
        let wall = Wall { normal, offset: dot(normal, a) };
        let count = points.iter().filter(|&&point| wall.distance(point).abs() < thickness).count();
        let is_before = |camera: &Pinhole<f32>| wall.distance(camera.center) > thickness;
        let is_behind = |point: &&[f32; 3]| wall.distance(**point) < -3.0 * thickness;
        if count > most
            && cameras.iter().all(is_before)
            && all.iter().filter(is_behind).count() as f32 <= max_behind * all.len() as f32
        {
            (most, best) = (count, Some(wall));
        }
    }
    best
}

/// The sphere through points, by least squares of `|p|² = 2 c·p + (r² − |c|²)`; nothing if they are on none.
fn find_sphere(points: &[[f32; 3]]) -> Option<([f32; 3], f32)> {
    let middle = mean_vector(points.iter().copied());
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
