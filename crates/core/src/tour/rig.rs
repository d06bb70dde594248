//! The cameras of a capture as a path: a ring or an arc around the subject.

use std::f64::consts::TAU;

use super::upright_axes;
use crate::{Camera, CameraPath, Subject, add_scaled, distance, dot, length, sub, upper_median};

/// Cameras with a larger gap between two neighbours form an arc, not a ring, radians: 100 degrees.
const MAX_GAP: f64 = 100.0 / 360.0 * TAU;
/// With fewer cameras the path goes from one to the next. It also does so if most cameras look away from the subject.
const FEW: usize = 8;
/// Widths of the average over cameras, as a share of their arc and in radians: at least 5 degrees.
const SMOOTHING: f64 = 1.0 / 16.0;
const MIN_SMOOTHING: f64 = 5.0 / 360.0 * TAU;
/// The arc of a single camera and of cameras in a column, radians: 10 degrees.
const MIN_ARC: f64 = 10.0 / 360.0 * TAU;
/// Greatest angle between two keyframes of a path from camera to camera, radians. A chord of a longer arc would cut
/// through the scene.
const KEYFRAME: f64 = 30.0 / 360.0 * TAU;
/// A camera of the path stands at least this far from the vertical through the subject, in heights above it, so that up
/// stays up in the picture.
const OFF_VERTICAL: f64 = 0.05;

/// A camera's place relative to the subject.
#[derive(Clone, Copy, Debug)]
struct Place {
    /// Angle around the vertical, radians; 0 is behind the subject along forward.
    angle: f64,
    /// Distance from the vertical, scene units.
    out: f64,
    /// Height above the subject, scene units.
    height: f64,
}

/// Cameras around a subject, in the order of their angles.
pub(super) struct Rig {
    subject: [f64; 3],
    /// Right, up and forward in the world.
    axes: [[f64; 3]; 3],
    /// By ascending angle. On an arc the first stands at its beginning, and the angle grows beyond a turn.
    places: Vec<Place>,
    /// Whether the cameras form a ring.
    is_closed: bool,
    course: Course,
    size: [usize; 2],
}

/// How the path leads from camera to camera.
enum Course {
    /// From camera to camera: the spline, its length, and where on it the first camera given stands.
    Stops { path: CameraPath, length: f64, start: f64 },
    /// By the average over the nearest cameras: angles of the arc, the angle at which a turn begins, and the focal
    /// lengths.
    Average { arc: [f64; 2], start: f64, focal: [f64; 2] },
}

impl Rig {
    /// - `size`: width and height of the path's images, pixels
    /// - returns: `None` without cameras
    pub(super) fn new(subject: &Subject, cameras: &[Camera], up: [f64; 3], size: [usize; 2]) -> Option<Self> {
        let axes = upright_axes(up);
        let mut places: Vec<(Place, usize)> =
            cameras.iter().enumerate().map(|(i, camera)| (Place::of(camera, subject.center, axes), i)).collect();
        places.sort_by(|a, b| a.0.angle.total_cmp(&b.0.angle));
        let count = places.len();
        // The gap before a camera.
        let gap = |i: usize| (places[i].0.angle - places[(i + count - 1) % count].0.angle).rem_euclid(TAU);
        let first = (0..count).max_by(|&a, &b| gap(a).total_cmp(&gap(b)))?;
        // A single camera, or all at one angle: the gap is the turn.
        let widest = if gap(first) > 0.0 { gap(first) } else { TAU };
        let is_closed = widest < MAX_GAP;
        if !is_closed {
            places.rotate_left(first);
        }
        for i in 1..count {
            while places[i].0.angle < places[i - 1].0.angle {
                places[i].0.angle += TAU;
            }
        }
        let order: Vec<usize> = places.iter().map(|&(_, camera)| camera).collect();
        let mut rig = Self {
            subject: subject.center,
            axes,
            places: places.into_iter().map(|(place, _)| place).collect(),
            is_closed,
            course: Course::Average { arc: [0.0; 2], start: 0.0, focal: [1.0; 2] },
            size,
        };
        let facing = cameras.iter().filter(|camera| camera.project(subject.center).is_some()).count();
        let from_camera_to_camera = (2..FEW).contains(&count) || (count > 1 && 2 * facing < count);
        rig.course = if from_camera_to_camera { rig.stops(cameras, &order) } else { rig.average(cameras, &order) };
        Some(rig)
    }

    /// The camera at a share of one turn; of an arc, of the way from its middle to both ends and back.
    pub(super) fn camera_at(&self, share: f64) -> Camera {
        let along = if self.is_closed { share } else { 0.5 + 0.5 * (TAU * share).sin() };
        match &self.course {
            Course::Stops { path, length, start } => {
                let at = along * length;
                let at = if self.is_closed { (start + at) % length } else { at };
                // Neighbours that look in opposite directions have no camera between them.
                path.camera_at(at, self.size).unwrap_or_else(|_| {
                    let after = path.keyframes().partition_point(|keyframe| keyframe.timestep <= at);
                    path.keyframes()[after.max(1) - 1].camera.clone()
                })
            }
            Course::Average { arc: [begin, end], start, focal } => {
                let angle = if self.is_closed { start + TAU * along } else { begin + (end - begin) * along };
                self.looking(self.averaged(angle), *focal)
            }
        }
    }

    /// A spline through the cameras, with keyframes on the arcs between neighbours.
    fn stops(&self, cameras: &[Camera], order: &[usize]) -> Course {
        let (mut path, mut length, mut start) = (CameraPath::default(), 0.0, 0.0);
        let stops = if self.is_closed { order.len() + 1 } else { order.len() };
        let at = |stop: usize| {
            let place = self.places[stop % order.len()];
            let turns = (stop / order.len()) as f64;
            (Place { angle: place.angle + turns * TAU, ..place }, &cameras[order[stop % order.len()]])
        };
        for stop in 0..stops {
            let (to, camera) = at(stop);
            if stop > 0 {
                let (from, before) = at(stop - 1);
                let steps = ((to.angle - from.angle) / KEYFRAME).ceil().max(1.0);
                let step = distance(before.center(), camera.center()).max(MIN_STEP) / steps;
                for i in 1..steps as usize {
                    length += step;
                    let between = self.between((from, before), (to, camera), i as f64 / steps);
                    insert(&mut path, length, between);
                }
                length += step;
            }
            if stop < order.len() && order[stop] == 0 {
                start = length;
            }
            insert(&mut path, length, camera.fitted(self.size[0], self.size[1]));
        }
        Course::Stops { path, length, start }
    }

    /// A camera on the arc between two: it looks and stands upright as they do, by the share of each.
    fn between(&self, from: (Place, &Camera), to: (Place, &Camera), share: f64) -> Camera {
        let mix = |a: f64, b: f64| a + share * (b - a);
        let place = Place {
            angle: mix(from.0.angle, to.0.angle),
            out: mix(from.0.out, to.0.out),
            height: mix(from.0.height, to.0.height),
        };
        let [width, height] = self.size;
        let [a, b] = [from.1, to.1].map(|camera| camera.fitted(width, height));
        let mixed = |a: [f64; 3], b: [f64; 3]| -> [f64; 3] { std::array::from_fn(|i| mix(a[i], b[i])) };
        let target = mixed(self.target(&a), self.target(&b));
        let upward = |camera: &Camera| {
            let [x, y, z, _] = camera.camera_from_world[1];
            [-x, -y, -z]
        };
        let camera = Camera::look_at(self.at(place), target, mixed(upward(&a), upward(&b)), 1.0, width, height);
        Camera {
            focal: std::array::from_fn(|i| mix(a.focal[i], b.focal[i])),
            principal: std::array::from_fn(|i| mix(a.principal[i], b.principal[i])),
            ..camera
        }
    }

    /// The point of a camera's axis that is nearest to the subject, or as far before the camera as the subject is.
    fn target(&self, camera: &Camera) -> [f64; 3] {
        let (center, forward) = (camera.center(), camera.forward());
        let offset = sub(self.subject, center);
        let (along, far) = (dot(offset, forward), length(offset));
        let depth = if along > 0.1 * far { along } else { far };
        add_scaled(center, depth, forward)
    }

    /// The arc of the cameras, and the median of the share that they show.
    fn average(&self, cameras: &[Camera], order: &[usize]) -> Course {
        let ends = [self.places[0].angle, self.places[order.len() - 1].angle];
        let lacking = (MIN_ARC - (ends[1] - ends[0])).max(0.0) / 2.0;
        let first = order.iter().position(|&camera| camera == 0).map_or(0.0, |place| self.places[place].angle);
        let focal = std::array::from_fn(|i| {
            let focal = cameras.iter().map(|camera| camera.fitted(self.size[0], self.size[1]).focal[i]);
            upper_median(focal).unwrap_or_default()
        });
        Course::Average { arc: [ends[0] - lacking, ends[1] + lacking], start: first, focal }
    }

    /// The mean place of the cameras near an angle, at that angle.
    fn averaged(&self, angle: f64) -> Place {
        let count = self.places.len();
        let arc = if self.is_closed { TAU } else { self.places[count - 1].angle - self.places[0].angle };
        let width = (SMOOTHING * arc).max(MIN_SMOOTHING);
        let away = |place: &Place| {
            let away = (place.angle - angle).rem_euclid(TAU);
            away.min(TAU - away)
        };
        // The nearest has weight 1, so that the weights do not vanish in a gap.
        let nearest = self.places.iter().map(away).fold(TAU, f64::min);
        let weight = |place: &Place| (0.5 * (nearest.powi(2) - away(place).powi(2)) / width.powi(2)).exp();
        let total: f64 = self.places.iter().map(weight).sum();
        let mean =
            |of: fn(&Place) -> f64| self.places.iter().map(|place| weight(place) * of(place)).sum::<f64>() / total;
        Place { angle, out: mean(|place| place.out), height: mean(|place| place.height) }
    }

    /// A camera at a place that looks at the subject.
    fn looking(&self, place: Place, focal: [f64; 2]) -> Camera {
        let out = place.out.max(OFF_VERTICAL * place.height.abs());
        let [width, height] = self.size;
        let position = self.at(Place { out, ..place });
        Camera { focal, ..Camera::look_at(position, self.subject, self.axes[1], focal[0], width, height) }
    }

    fn at(&self, Place { angle, out, height }: Place) -> [f64; 3] {
        let [right, up, forward] = self.axes;
        let offset = |i: usize| out * (angle.sin() * right[i] - angle.cos() * forward[i]) + height * up[i];
        std::array::from_fn(|i| self.subject[i] + offset(i))
    }
}

/// Least length of a step of a path, scene units: cameras may stand at one place.
const MIN_STEP: f64 = 1e-6;

impl Place {
    fn of(camera: &Camera, subject: [f64; 3], [right, up, forward]: [[f64; 3]; 3]) -> Self {
        let offset = sub(camera.center(), subject);
        let (across, ahead) = (dot(offset, right), dot(offset, forward));
        Self { angle: across.atan2(-ahead), out: across.hypot(ahead), height: dot(offset, up) }
    }
}

/// Lengths are finite, like the numbers of cameras, so every keyframe is accepted.
fn insert(path: &mut CameraPath, length: f64, camera: Camera) {
    let _ = path.insert(length, camera);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Gaussians, Tour};

    const UP: [f64; 3] = [0.0, -1.0, 0.0];
    const SIZE: [usize; 2] = [64, 48];

    fn subject_at(center: [f64; 3]) -> Subject {
        Subject { center, radius: 0.5, distance: 3.0 }
    }

    /// Cameras at angles around the origin, 3 away and a half above, in degrees.
    fn standing(degrees: impl IntoIterator<Item = u16>) -> Vec<Camera> {
        let at = |angle: f64| [3.0 * angle.sin(), -0.5, -3.0 * angle.cos()];
        degrees
            .into_iter()
            .map(|d| Camera::look_at(at(f64::from(d).to_radians()), [0.0; 3], UP, 50.0, 64, 48))
            .collect()
    }

    /// Degrees around the origin as in [`standing`], from -180 to 180.
    fn degrees(camera: &Camera) -> f64 {
        let [x, _, z] = camera.center();
        x.atan2(-z).to_degrees()
    }

    fn assert_aims(camera: &Camera, at: [f64; 3]) {
        let ([x, y], _) = camera.project(at).expect("before the camera");
        assert!((x - 32.0).abs() < 1.0 && (y - 24.0).abs() < 1.0, "{x}, {y}");
    }

    #[test]
    fn a_ring_is_gone_round_at_its_height_from_the_first_camera_on() {
        // Every other camera higher and farther; the subject stands beside the ring's middle.
        let middle = [0.4, 0.0, 0.2];
        let mut cameras = standing((0..12).map(|i| (90 + 30 * i) % 360));
        for camera in cameras.iter_mut().step_by(2) {
            let [x, _, z] = camera.center();
            *camera = Camera::look_at([1.2 * x, -1.5, 1.2 * z], [0.0; 3], UP, 50.0, 64, 48);
        }
        let path = Tour::Orbit.among(&subject_at(middle), &cameras, UP, 24, SIZE);
        assert!((degrees(&path[0]) - 90.0).abs() < 5.0, "it begins at the first camera");
        let mut passed = 0.0;
        for (camera, next) in path.iter().zip(path.iter().cycle().skip(1)) {
            assert_aims(camera, middle);
            let [x, y, z] = camera.center();
            assert!((2.9..3.7).contains(&x.hypot(z)) && (-1.5..-0.5).contains(&y), "within the cameras: {x} {y} {z}");
            passed += (degrees(next) - degrees(camera)).rem_euclid(360.0);
        }
        assert!((passed - 360.0).abs() < 1e-6, "one turn of {passed} degrees");
    }

    #[test]
    fn an_arc_is_gone_back_and_forth_and_never_left() {
        let cameras = standing((0..9).map(|i| (330 + 7 * i) % 360));
        for tour in [Tour::Orbit, Tour::Spiral] {
            let path = tour.among(&subject_at([0.0; 3]), &cameras, UP, 40, SIZE);
            assert!((degrees(&path[0]) + 2.0).abs() < 1.0, "from the middle: {}", degrees(&path[0]));
            let ends = path.iter().map(degrees).fold([0.0_f64; 2], |[a, b], d| [a.min(d), b.max(d)]);
            assert!((-30.01..-29.0).contains(&ends[0]) && (25.0..26.01).contains(&ends[1]), "{ends:?}");
            path.iter().for_each(|camera| assert_aims(camera, [0.0; 3]));
        }
    }

    #[test]
    fn a_gap_of_a_hundred_degrees_is_not_crossed() {
        for (last, crosses) in [(262, true), (258, false)] {
            let cameras = standing((0..11).map(|i| last * i / 10));
            let path = Tour::Orbit.among(&subject_at([0.0; 3]), &cameras, UP, 90, SIZE);
            let in_gap = |camera: &Camera| (280.0..340.0).contains(&degrees(camera).rem_euclid(360.0));
            assert_eq!(path.iter().any(in_gap), crosses, "cameras to {last} degrees");
        }
    }

    #[test]
    fn a_grid_that_looks_ahead_is_kept_to() {
        // As in front of a kitchen: parallel axes, 4 by 3 cameras, what they look at 2 ahead.
        let cameras: Vec<Camera> = (0..12_u8)
            .map(|i| [f64::from(i % 4) * 0.3 - 0.45, f64::from(i / 4) * 0.2 - 0.2, 0.0])
            .map(|[x, y, z]| Camera::look_at([x, y, z], [x, y, 9.0], UP, 50.0, 64, 48))
            .collect();
        for tour in [Tour::Orbit, Tour::Spiral] {
            let path = tour.among(&subject_at([0.1, 0.0, 2.0]), &cameras, UP, 30, SIZE);
            let nearest = if tour == Tour::Orbit { 0.1 } else { 0.8 };
            for camera in &path {
                let [x, y, z] = camera.center();
                assert!(x.abs() < 0.46 && y.abs() < 0.21 && (-0.1..nearest).contains(&z), "{x} {y} {z}");
                assert_aims(camera, [0.1, 0.0, 2.0]);
            }
            let spread = |i: usize| path.iter().map(|camera| camera.center()[i]).fold(0.0, f64::max);
            assert!(spread(0) > 0.4, "it goes to the ends");
        }
    }

    #[test]
    fn four_cameras_are_passed_one_after_another() {
        // Two of each: on one side, and all around. Each aims a little past the subject.
        for degrees_of in [[350, 10, 30, 50], [0, 90, 180, 270]] {
            let cameras: Vec<Camera> = standing(degrees_of)
                .iter()
                .map(|camera| Camera::look_at(camera.center(), [0.1, -0.1, 0.0], UP, 50.0, 64, 48))
                .collect();
            let path = Tour::Orbit.among(&subject_at([0.0; 3]), &cameras, UP, 400, SIZE);
            for camera in &cameras {
                let nearest = path.iter().map(|other| distance(other.center(), camera.center())).fold(9.0, f64::min);
                assert!(nearest < 0.05, "it misses a camera by {nearest}");
            }
            for camera in &path {
                let [x, y, z] = camera.center();
                assert!((2.85..3.05).contains(&x.hypot(z)) && (y + 0.5).abs() < 0.05, "on their arc: {x} {y} {z}");
                let ([x, y], _) = camera.project([0.0; 3]).expect("before the camera");
                assert!((x - 32.0).hypot(y - 24.0) < 4.0, "past the subject, at {x}, {y}");
            }
            let longest = path.windows(2).map(|pair| distance(pair[0].center(), pair[1].center())).fold(0.0, f64::max);
            assert!(longest < 0.1, "no jump of {longest}");
        }
        let around = standing([0, 90, 180, 270]);
        assert_eq!(Tour::Orbit.among(&subject_at([0.0; 3]), &around, UP, 4, SIZE)[0], around[0]);
    }

    #[test]
    fn a_spiral_comes_closer() {
        let cameras = standing((0..12).map(|i| 30 * i));
        let path = Tour::Spiral.among(&subject_at([0.0; 3]), &cameras, UP, 36, SIZE);
        let far = |camera: &Camera| length(camera.center());
        assert!(path.windows(2).all(|pair| far(&pair[1]) < far(&pair[0])));
        assert!((2.9..3.1).contains(&far(&path[0])) && (1.9..2.2).contains(&far(&path[35])));
        path.iter().for_each(|camera| assert_aims(camera, [0.0; 3]));
    }

    #[test]
    fn any_cameras_make_a_path() {
        let overhead = Camera::look_at([0.0, -3.0, 0.0], [0.0; 3], [0.0, 0.0, 1.0], 50.0, 64, 48);
        let outward: Vec<Camera> = standing((0..12).map(|i| 30 * i))
            .iter()
            .map(|camera| Camera::look_at(camera.center(), camera.center().map(|x| 2.0 * x), UP, 50.0, 64, 48))
            .collect();
        let opposite = [[0.0, 0.0, -1.0], [0.0, 0.0, 1.0]].map(|at| Camera::look_at([0.0; 3], at, UP, 50.0, 64, 48));
        let sets = [vec![overhead.clone()], vec![overhead; 9], outward.clone(), opposite.to_vec(), standing([5])];
        for cameras in &sets {
            let subject = Subject::of(&Gaussians::zeros(1), &[], cameras);
            for tour in [Tour::Orbit, Tour::Spiral] {
                for camera in tour.among(&subject, cameras, UP, 12, [33, 21]) {
                    let finite = camera.camera_from_world.as_flattened().iter().all(|x| x.is_finite());
                    assert!(finite && (camera.width, camera.height) == (33, 21), "{camera:?}");
                }
            }
        }
        // The path follows outward-looking cameras in their direction.
        let path = Tour::Orbit.among(&subject_at([0.0; 3]), &outward, UP, 24, SIZE);
        assert!(path.iter().all(|camera| dot(camera.forward(), camera.center()) > 0.0));
        // The path stays near a single camera.
        let single = Tour::Orbit.among(&subject_at([0.0; 3]), &sets[4], UP, 24, SIZE);
        assert!(single.iter().all(|camera| (-0.01..10.01).contains(&degrees(camera))));
        assert_eq!(Tour::Orbit.among(&subject_at([0.0; 3]), &[], UP, 3, SIZE).len(), 3);
    }
}
