//! Cameras between those of a capture, where no image tells what a picture should show.

use std::array::from_fn;
use std::f64::consts::TAU;
use std::ops::Range;

use crate::camera_path::{camera_of, numbers_of};
use crate::subject::{PARALLEL, nearest_to_axes};
use crate::{Camera, add_scaled, cross, distance, dot, normalize, rotmat_from_vector, squared_distance, sub};

/// Least cosine of the angle between the directions of neighbours. Half-way between cameras that face each other is the
/// subject.
const LEAST_COSINE: f64 = -0.2;
/// Neighbours of a camera, at most.
const MAX_NEIGHBORS: usize = 5;
/// Generates weights that fill a triangle evenly: the plastic number to the power of -1 and of -2 (Roberts 2018).
const STEPS: [f64; 2] = [0.754_877_666_246_693, 0.569_840_290_998_053_3];
/// Generates the turns aside likewise: the golden ratio and the square root of two, less one.
const ASIDE_STEPS: [f64; 2] = [0.618_033_988_749_894_9, 0.414_213_562_373_095_1];
/// Largest turn of cameras around others.
const AROUND_DEGREES: f64 = 20.0;
/// A camera looks at a point if the cosine of the angle between its direction and that from the point is at most this.
const LOOKS_AT: f64 = -0.5;
/// Farthest that a camera is moved out, relative to its distance from the point that its neighbours look at.
const MAX_OUTWARD: f64 = 2.0;

/// Cameras between each camera and two of its nearest neighbours. Between cameras on a dome they stand on the dome.
/// They form a sequence without end, which fills the space between the cameras more and more densely.
///
/// - `of`: positions in the sequence; neighbouring positions belong to different cameras
/// - returns: nothing for fewer than two cameras, or if all face each other
///
/// ```
/// use tcgs_core::{Camera, cameras_between};
/// let camera = |x| Camera::look_at([x, 0.0, -4.0], [0.0; 3], [0.0, -1.0, 0.0], 50.0, 64, 48);
/// let between = cameras_between(&[camera(-1.0), camera(0.0), camera(2.0)], 0..50);
/// let x = || between.iter().map(|camera| camera.center()[0]);
/// assert!(x().all(|x| -1.0 < x && x < 2.0) && x().any(|x| x < -0.5) && x().any(|x| x > 1.0));
/// ```
pub fn cameras_between(cameras: &[Camera], of: Range<usize>) -> Vec<Camera> {
    cameras_within(cameras, of, 0.0)
}

/// As [`cameras_between`], each turned around the point that it looks at, by up to 20 degrees. They fill the space from
/// which pictures can be trusted ([`Trust`](crate::Trust)), and some space around it, where holes would show.
pub fn cameras_around(cameras: &[Camera], of: Range<usize>) -> Vec<Camera> {
    cameras_within(cameras, of, AROUND_DEGREES.to_radians())
}

/// - `aside`: largest turn, radians
fn cameras_within(cameras: &[Camera], of: Range<usize>, aside: f64) -> Vec<Camera> {
    let neighbors: Vec<Vec<usize>> = (0..cameras.len()).map(|i| neighbors(cameras, i)).collect();
    let mix = |position: usize| {
        let [turn, i] = [position / cameras.len(), position % cameras.len()];
        let near = neighbors.get(i).filter(|near| !near.is_empty())?;
        let [u, v] = STEPS.map(|step| (step * (position + 1) as f64).fract());
        let [u, v] = if u + v > 1.0 { [1.0 - u, 1.0 - v] } else { [u, v] };
        let size = [cameras[i].width, cameras[i].height];
        let corners = [i, near[turn % near.len()], near[(turn + 1) % near.len()]].map(|j| cameras[j].clone());
        let [share, turn] = ASIDE_STEPS.map(|step| (step * (position + 1) as f64).fract());
        mixed(&corners, [1.0 - u - v, u, v], size, [aside * share.sqrt(), TAU * turn])
    };
    of.filter_map(|position| if cameras.is_empty() { None } else { mix(position) }).collect()
}

/// The camera between three. Its distance from the point that they look at is their mean distance. It would
/// stand inside of their dome otherwise.
///
/// - `angle`, `tilt`: by which the camera turns around that point, and of the turn's axis in the image, radians
fn mixed(
    cameras: &[Camera; 3],
    weights: [f64; 3],
    [width, height]: [usize; 2],
    [angle, tilt]: [f64; 2],
) -> Option<Camera> {
    let mean = |values: [f64; 3]| dot(values, weights);
    let numbers = cameras.each_ref().map(|camera| numbers_of(&camera.fitted(width, height)));
    let mut mixed = from_fn(|k| mean(numbers.map(|numbers| numbers[k])));
    let center = [mixed[0], mixed[1], mixed[2]];
    let focus = nearest_to_axes(cameras, PARALLEL, center);
    let looks_at = |c: &Camera| dot(sub(c.center(), focus), c.forward()) < LOOKS_AT * distance(c.center(), focus);
    if cameras.iter().all(looks_at) {
        let outward = mean(cameras.each_ref().map(|c| distance(c.center(), focus))) / distance(center, focus);
        let moved = add_scaled(focus, outward.clamp(1.0, MAX_OUTWARD), sub(center, focus));
        let [forward, down] = [3, 6].map(|first| from_fn(|i| mixed[first + i]));
        let axis = normalize(add_scaled(cross(down, forward).map(|x| tilt.cos() * x), tilt.sin(), down));
        let rotation = rotmat_from_vector(axis.map(|x| angle * x));
        let turned = [sub(moved, focus), forward, down].map(|v| rotation.map(|row| dot(row, v)));
        mixed[..9].copy_from_slice([add_scaled(focus, 1.0, turned[0]), turned[1], turned[2]].as_flattened());
    }
    camera_of(&mixed, [width, height]).ok()
}

/// The nearest cameras that do not face a camera, the nearest first.
fn neighbors(cameras: &[Camera], i: usize) -> Vec<usize> {
    let distance = |j: usize| squared_distance(cameras[i].center(), cameras[j].center());
    let is_neighbor = |&j: &usize| j != i && dot(cameras[i].forward(), cameras[j].forward()) >= LEAST_COSINE;
    let mut others: Vec<usize> = (0..cameras.len()).filter(is_neighbor).collect();
    others.sort_by(|&a, &b| distance(a).total_cmp(&distance(b)));
    others.truncate(MAX_NEIGHBORS);
    others
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::length;

    /// Cameras that look at one point.
    fn ring(degrees: &[f64]) -> Vec<Camera> {
        let camera = |degrees: &f64| {
            let (sin, cos) = degrees.to_radians().sin_cos();
            Camera::look_at([1.0 + 4.0 * sin, 2.0, 3.0 - 4.0 * cos], [1.0, 2.0, 3.0], [0.0, -1.0, 0.0], 50.0, 64, 48)
        };
        degrees.iter().map(camera).collect()
    }

    #[test]
    fn between_cameras_on_a_ring_is_the_ring() {
        let between = cameras_between(&ring(&[0.0, 50.0, 90.0]), 5..45);
        assert_eq!(between.len(), 40);
        for camera in between {
            let out = sub(camera.center(), [1.0, 2.0, 3.0]);
            assert!((length(out) - 4.0).abs() < 0.05, "{out:?}");
            assert!(dot(out, camera.forward()) < -4.0 * 0.98, "{:?}", camera.forward());
        }
    }

    #[test]
    fn parallel_cameras_stay_in_their_plane() {
        let plane: Vec<Camera> = [[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [1.0, 1.0]]
            .map(|[x, y]| Camera::look_at([x, y, 0.0], [x, y, 1.0], [0.0, -1.0, 0.0], 50.0, 64, 48))
            .into();
        assert!(cameras_between(&plane, 0..40).iter().all(|camera| camera.center()[2].abs() < 1e-9));
    }

    #[test]
    fn cameras_around_a_ring_are_turned_aside_by_twenty_degrees_at_most() {
        let [between, around] = [cameras_between, cameras_around].map(|of| of(&ring(&[0.0, 30.0]), 0..60));
        let turns = between.iter().zip(&around).map(|(between, around)| {
            let [a, b] = [between, around].map(|camera| sub(camera.center(), [1.0, 2.0, 3.0]));
            // The turn is around the point nearest to the axes. That is about the middle of the ring, not exactly.
            assert!((length(b) - length(a)).abs() < 0.05, "{b:?} instead of {a:?}");
            let looks = [between, around].map(|camera| dot(sub(camera.center(), [1.0, 2.0, 3.0]), camera.forward()));
            assert!((looks[0] - looks[1]).abs() < 0.05, "what is looked at stays in its place");
            (dot(a, b) / (length(a) * length(b))).min(1.0).acos().to_degrees()
        });
        let turns: Vec<f64> = turns.collect();
        assert!(turns.iter().all(|&turn| turn <= AROUND_DEGREES + 0.2));
        assert!(turns.iter().filter(|&&turn| turn > 0.7 * AROUND_DEGREES).count() > 20, "{turns:?}");
        let lowest = around.iter().map(|camera| camera.center()[1]).fold(f64::INFINITY, f64::min);
        assert!(lowest < 2.0 - 4.0 * 0.2, "out of the ring's plane, too: {lowest}");
    }

    #[test]
    fn between_cameras_that_face_each_other_is_nothing() {
        assert_eq!(cameras_between(&ring(&[0.0, 180.0]), 0..9), []);
        assert_eq!(cameras_between(&ring(&[0.0]), 0..9), []);
        assert_eq!(cameras_between(&[], 0..9), []);
    }
}
