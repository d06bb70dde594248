//! Cameras between those of a capture, where no image tells what a picture should show.

use std::ops::Range;

use crate::camera_path::{camera_of, numbers_of};
use crate::{Camera, dot, squared_distance};

/// Least cosine of the angle between the directions of neighbours. Half-way between cameras that face each other is the
/// subject.
const LEAST_COSINE: f64 = -0.2;
/// Neighbours of a camera, at most.
const MAX_NEIGHBORS: usize = 5;
/// Generates weights that fill a triangle evenly: the plastic number to the power of -1 and of -2 (Roberts 2018).
const STEPS: [f64; 2] = [0.754_877_666_246_693, 0.569_840_290_998_053_3];

/// Cameras between each camera and two of its nearest neighbours. They form a sequence without end, which fills the space
/// between the cameras more and more densely.
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
    let neighbors: Vec<Vec<usize>> = (0..cameras.len()).map(|i| neighbors(cameras, i)).collect();
    let mix = |position: usize| {
        let [turn, i] = [position / cameras.len(), position % cameras.len()];
        let near = neighbors.get(i).filter(|near| !near.is_empty())?;
        let corners = [i, near[turn % near.len()], near[(turn + 1) % near.len()]];
        let [u, v] = STEPS.map(|step| (step * (position + 1) as f64).fract());
        let [u, v] = if u + v > 1.0 { [1.0 - u, 1.0 - v] } else { [u, v] };
        let size = [cameras[i].width, cameras[i].height];
        let numbers = corners.map(|j| numbers_of(&cameras[j].fitted(size[0], size[1])));
        let mixed = std::array::from_fn(|k| (1.0 - u - v) * numbers[0][k] + u * numbers[1][k] + v * numbers[2][k]);
        camera_of(&mixed, size).ok()
    };
    of.filter_map(|position| if cameras.is_empty() { None } else { mix(position) }).collect()
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
