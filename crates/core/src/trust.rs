//! From where pictures of a scene can be trusted: from between the cameras that it was trained from, and little beyond.

use std::f64::consts::PI;

use crate::{Camera, add_scaled, cross, distance, dot, normalize, sub};

/// [`Trust::ASIDE_DEGREES`] in radians.
const ASIDE: f64 = Trust::ASIDE_DEGREES / 180.0 * PI;
/// Directions nearer than this to one that is kept are left out, radians: 5 degrees.
const SAME: f64 = 5.0 / 180.0 * PI;
/// Most directions that are kept.
const MAX_DIRECTIONS: usize = 64;
/// Nearest and farthest trusted distances, in distances of the nearest and of the farthest camera. Much nearer views
/// show single Gaussians, much farther ones the space behind the cameras.
const NEARER: f64 = 0.4;
const FARTHER: f64 = 1.25;
/// Beyond a trusted direction [`Trust::doubt`] reaches 1 at this angle, radians: 25 degrees.
const FADE: f64 = 25.0 / 180.0 * PI;
/// Beyond a trusted distance [`Trust::doubt`] reaches 1 at this factor.
const FADE_FACTOR: f64 = 2.0;

/// The positions from which pictures of a scene can be trusted.
///
/// A position is trusted if its direction from [`Self::center`] is at most 10 degrees from a camera's, from the arc
/// between two cameras, or from the triangle between three. Arcs and triangles count if any two of their cameras are at
/// most [`Self::between`] apart. The distance may be 0.4 of the nearest camera's to 1.25 of the farthest camera's.
///
/// ```
/// use tcgs_core::{Camera, Trust};
/// let camera = |x: f64| Camera::look_at([x, 0.0, -4.0], [0.0; 3], [0.0, -1.0, 0.0], 50.0, 64, 48);
/// let trust = Trust::of(&[camera(-1.5), camera(1.5)], [0.0; 3], 1.0);
/// assert_eq!(trust.doubt([0.3, 0.0, -3.0]), 0.0);
/// assert!(trust.doubt([0.0, 0.0, 4.0]) == 1.0 && trust.doubt([4.0, 0.0, -4.0]) > 0.3);
/// ```
#[derive(Clone, Debug, PartialEq)]
pub struct Trust {
    center: [f64; 3],
    directions: Vec<[f64; 3]>,
    distances: [f64; 2],
    between: f64,
    /// Pairs and triples of directions, each two of which are at most `between` apart.
    arcs: Vec<[usize; 2]>,
    triangles: Vec<[usize; 3]>,
}

impl Trust {
    /// Pictures are trusted up to this angle from a trusted direction.
    pub const ASIDE_DEGREES: f64 = 10.0;

    /// Trust in pictures of a scene that was trained from some cameras.
    ///
    /// - `cameras`: of the training
    /// - `center`: the point that they look at, world, scene units
    /// - `between`: largest angle between two cameras between which the geometry is known, radians
    pub fn of(cameras: &[Camera], center: [f64; 3], between: f64) -> Self {
        let mut directions: Vec<[f64; 3]> = Vec::new();
        let mut distances = [f64::INFINITY, 0.0];
        for camera in cameras {
            let far = distance(camera.center(), center);
            if far > 0.0 {
                distances = [distances[0].min(far), distances[1].max(far)];
                let direction = normalize(sub(camera.center(), center));
                let is_new = directions.iter().all(|&held| angle(held, direction) > SAME);
                if is_new && directions.len() < MAX_DIRECTIONS {
                    directions.push(direction);
                }
            }
        }
        Self::new(center, directions, distances, between)
    }

    /// Trust with all its numbers, as a file has them.
    ///
    /// - `center`: world, scene units
    /// - `directions`: unit vectors from the centre to the cameras
    /// - `distances`: from the centre to the nearest and to the farthest camera, scene units
    /// - `between`: as for [`Self::of`]
    pub fn new(center: [f64; 3], directions: Vec<[f64; 3]>, distances: [f64; 2], between: f64) -> Self {
        let is_near = |i: usize, j: usize| angle(directions[i], directions[j]) <= between;
        let (mut arcs, mut triangles) = (Vec::new(), Vec::new());
        for i in 0..directions.len() {
            for j in (i + 1..directions.len()).filter(|&j| is_near(i, j)) {
                arcs.push([i, j]);
                triangles
                    .extend((j + 1..directions.len()).filter(|&k| is_near(i, k) && is_near(j, k)).map(|k| [i, j, k]));
            }
        }
        Self { center, directions, distances, between, arcs, triangles }
    }

    /// The point that the cameras look at, world, scene units.
    pub fn center(&self) -> [f64; 3] {
        self.center
    }

    /// `[N, 3]` unit vectors from the centre to the cameras. One stands for all within 5 degrees.
    pub fn directions(&self) -> &[[f64; 3]] {
        &self.directions
    }

    /// Distances from the centre to the nearest and to the farthest camera, scene units.
    pub fn distances(&self) -> [f64; 2] {
        self.distances
    }

    /// Largest angle between two cameras between which pictures are trusted, radians.
    pub fn between(&self) -> f64 {
        self.between
    }

    /// How little a picture from a position can be trusted, in `[0, 1]`.
    ///
    /// It is 0 at trusted positions. It reaches 1 at 25 degrees beyond, and at half of the nearest or twice the
    /// farthest trusted distance.
    ///
    /// - `position`: world, scene units
    pub fn doubt(&self, position: [f64; 3]) -> f64 {
        let far = distance(position, self.center);
        if self.directions.is_empty() || far <= 0.0 {
            return 0.0;
        }
        let direction = normalize(sub(position, self.center));
        let aside = (angle(direction, self.nearest_direction(direction)) - ASIDE) / FADE;
        let [near_end, far_end] = self.trusted_distances();
        let beyond = (near_end / far).max(far / far_end).ln() / FADE_FACTOR.ln();
        aside.max(beyond).clamp(0.0, 1.0)
    }

    /// The trusted position that is nearest to one by its direction, and by its distance from the centre.
    ///
    /// - `position`: world, scene units
    pub fn nearest(&self, position: [f64; 3]) -> [f64; 3] {
        let far = distance(position, self.center);
        if self.directions.is_empty() || far <= 0.0 {
            return position;
        }
        let direction = normalize(sub(position, self.center));
        let known = self.nearest_direction(direction);
        let between = angle(direction, known);
        let led = if between > ASIDE { turned(known, direction, ASIDE / between) } else { direction };
        let [near_end, far_end] = self.trusted_distances();
        add_scaled(self.center, far.clamp(near_end, far_end), led)
    }

    /// Numbers of cameras in groups between which pictures are trusted, the largest group first. A group of one is
    /// trusted around that camera alone.
    pub fn groups(&self) -> Vec<usize> {
        let mut group: Vec<usize> = (0..self.directions.len()).collect();
        for &[i, j] in &self.arcs {
            let (from, to) = (group[j], group[i]);
            group.iter_mut().filter(|held| **held == from).for_each(|held| *held = to);
        }
        let size = |of: usize| group.iter().filter(|&&held| held == of).count();
        let mut sizes: Vec<usize> = (0..group.len()).map(size).filter(|&size| size > 0).collect();
        sizes.sort_unstable_by(|a, b| b.cmp(a));
        sizes
    }

    fn trusted_distances(&self) -> [f64; 2] {
        [NEARER * self.distances[0], FARTHER * self.distances[1]]
    }

    /// The direction nearest to one among those of cameras, of arcs and of triangles.
    fn nearest_direction(&self, direction: [f64; 3]) -> [f64; 3] {
        if self.triangles.iter().any(|triangle| is_within(direction, triangle.map(|i| self.directions[i]))) {
            return direction;
        }
        let on_arcs = self.arcs.iter().filter_map(|arc| nearest_on_arc(direction, arc.map(|i| self.directions[i])));
        let candidates = self.directions.iter().copied().chain(on_arcs);
        candidates.max_by(|&a, &b| dot(a, direction).total_cmp(&dot(b, direction))).unwrap_or(direction)
    }
}

/// Between unit vectors, radians.
fn angle(a: [f64; 3], b: [f64; 3]) -> f64 {
    dot(a, b).clamp(-1.0, 1.0).acos()
}

/// The unit vector at a share of the way from one to another, along the arc.
fn turned(from: [f64; 3], to: [f64; 3], share: f64) -> [f64; 3] {
    let whole = angle(from, to);
    if whole < 1e-9 {
        return from;
    }
    let weight = |part: f64| (part * whole).sin() / whole.sin();
    normalize(add_scaled(to.map(|x| weight(share) * x), weight(1.0 - share), from))
}

/// Whether a unit vector lies in the spherical triangle of three.
fn is_within(direction: [f64; 3], [a, b, c]: [[f64; 3]; 3]) -> bool {
    let sides = [(a, b), (b, c), (c, a)].map(|(from, to)| dot(cross(from, to), direction));
    // The triangle opposite has the same signs.
    dot(direction, a) > 0.0 && (sides.iter().all(|&side| side >= 0.0) || sides.iter().all(|&side| side <= 0.0))
}

/// The unit vector on the arc between two that is nearest to one; `None` if that is an end.
fn nearest_on_arc(direction: [f64; 3], [a, b]: [[f64; 3]; 2]) -> Option<[f64; 3]> {
    let normal = normalize(cross(a, b));
    let along = add_scaled(direction, -dot(direction, normal), normal);
    let is_between = dot(cross(a, along), normal) > 0.0 && dot(cross(along, b), normal) > 0.0;
    is_between.then(|| normalize(along))
}

#[cfg(test)]
mod tests {
    use super::*;

    const UP: [f64; 3] = [0.0, -1.0, 0.0];

    /// A position at an angle around the vertical and one above the horizon, degrees.
    fn at(around: f64, above: f64, far: f64) -> [f64; 3] {
        let [around, above] = [around, above].map(f64::to_radians);
        [1.0 + far * around.sin() * above.cos(), 2.0 - far * above.sin(), 3.0 - far * around.cos() * above.cos()]
    }

    fn trust(cameras: &[[f64; 3]], between: f64) -> Trust {
        let center = [1.0, 2.0, 3.0];
        let cameras: Vec<Camera> = cameras.iter().map(|&eye| Camera::look_at(eye, center, UP, 50.0, 64, 48)).collect();
        Trust::of(&cameras, center, f64::to_radians(between))
    }

    #[test]
    fn four_cameras_90_degrees_apart_are_trusted_around_each_alone() {
        let ring = [0.0, 90.0, 180.0, 270.0].map(|around| at(around, 0.0, 4.0));
        let trust = trust(&ring, 60.0);
        assert_eq!(trust.groups(), [1, 1, 1, 1]);
        for (around, doubt) in [(0.0, 0.0), (9.9, 0.0), (22.5, 0.5), (45.0, 1.0), (80.1, 0.0), (170.5, 0.0)] {
            assert!((trust.doubt(at(around, 0.0, 4.0)) - doubt).abs() < 1e-6, "{around}: {doubt}");
        }
        let led = trust.nearest(at(40.0, 0.0, 4.0));
        assert!(distance(led, at(10.0, 0.0, 4.0)) < 1e-9 && trust.doubt(led) < 1e-9, "{led:?}");
    }

    #[test]
    fn between_neighbours_everything_is_trusted_and_the_way_back_is_the_shortest() {
        let dome = [at(0.0, 0.0, 4.0), at(50.0, 0.0, 5.0), at(25.0, 40.0, 4.0), at(180.0, 0.0, 4.0)];
        let trust = trust(&dome, 60.0);
        assert_eq!(trust.groups(), [3, 1]);
        // Within the triangle, far from each arc.
        assert_eq!(trust.doubt(at(25.0, 15.0, 4.5)), 0.0);
        // Below the arc, which runs a little higher than the horizon in between.
        let [low, lower] = [-9.0, -20.0].map(|above| at(25.0, above, 4.5));
        assert!(trust.doubt(low) == 0.0 && trust.doubt(lower) > 0.3, "{} {}", trust.doubt(low), trust.doubt(lower));
        let led = trust.nearest(lower);
        assert!(distance(led, at(25.0, -10.0, 4.5)) < 0.03, "{led:?}");
        // A trusted position stays to the bit but for rounding.
        assert!(distance(trust.nearest(low), low) < 1e-12);
        // Opposite to the triangle, though the planes of its sides look the same from there.
        assert!(trust.doubt(at(205.0, -15.0, 4.5)) > 0.5);
    }

    #[test]
    fn distances_count_too() {
        let trust = trust(&[at(0.0, 0.0, 4.0), at(30.0, 0.0, 6.0)], 60.0);
        for (far, doubt) in [(1.6, 0.0), (7.5, 0.0), (15.0, 1.0), (0.8, 1.0), (7.5 * 2.0_f64.sqrt(), 0.5)] {
            assert!((trust.doubt(at(10.0, 0.0, far)) - doubt).abs() < 1e-6, "{far}");
        }
        assert!(distance(trust.nearest(at(10.0, 0.0, 100.0)), at(10.0, 0.0, 7.5)) < 1e-9);
        assert!(distance(trust.nearest(at(10.0, 0.0, 0.1)), at(10.0, 0.0, 1.6)) < 1e-9);
    }

    #[test]
    fn nothing_is_doubted_without_cameras_and_near_cameras_count_once() {
        let none = Trust::of(&[], [0.0; 3], 1.0);
        assert_eq!((none.doubt([5.0, 0.0, 0.0]), none.nearest([5.0, 0.0, 0.0])), (0.0, [5.0, 0.0, 0.0]));
        assert_eq!(trust(&[at(0.0, 0.0, 4.0), at(4.0, 0.0, 4.0), at(8.0, 0.0, 4.0)], 60.0).directions().len(), 2);
    }
}
