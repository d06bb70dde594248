//! Checks that the cameras see the points. The commonest mistake in a new capture is a matrix the wrong way round. It
//! shows here rather than as a black image after an hour of training.

use tcgs_core::{Camera, Pinhole, PointCloud};

/// A camera is blind below this share of the points in its image.
///
/// The share is low, since a camera that stands close to the wall of a room sees little of it. In a real and in a
/// rendered capture the given matrices put at least 0.34 of all points, and 0.51 of the foreground, into each image.
/// Inverted matrices put less than this share of the foreground into 25 of 27 images.
const BLIND_SHARE: f64 = 0.001;

/// From this share on a camera sees on purpose and not by accident. The field of view of a usual lens is 5 to 10 % of
/// all directions, and cameras turned round in a room keep 0.002 to 0.004 of the points in sight.
const SEEING_SHARE: f64 = 0.02;

/// Number of tested points: enough to measure [`BLIND_SHARE`].
const MAX_POINTS: usize = 5000;

/// Checks that most cameras see the foreground, or the points as a whole.
///
/// - returns: the fault, if there is one
pub(crate) fn check(cameras: &[&Camera], cloud: &PointCloud) -> Result<(), String> {
    let num_cameras = cameras.len();
    let all = thinned(cloud.points.iter().copied());
    let mut subject = thinned(cloud.points.iter().zip(&cloud.foreground).filter(|(_, f)| **f).map(|(p, _)| *p));
    if subject.is_empty() {
        subject = all.clone();
    }
    let count = |sees: &dyn Fn(&Camera) -> bool| cameras.iter().filter(|camera| sees(camera)).count();
    let most = |count: usize| 2 * count > num_cameras;
    let given = count(&|camera| share_seen(camera, &subject) >= BLIND_SHARE);
    if !most(num_cameras - given) {
        return Ok(());
    }
    let inverted = count(&|camera| share_seen(&camera.inverse(), &subject) >= SEEING_SHARE);
    if most(inverted) {
        return Err(format!(
            "the matrices look like c2w (camera to world), expected w2c (world to camera); cameras look outward: \
             {given} of {num_cameras} see the points, {inverted} would if inverted"
        ));
    }
    // Moving objects may start out of sight of most cameras; the whole scene may not.
    if most(count(&|camera| share_seen(camera, &all) < SEEING_SHARE)) {
        return Err(format!(
            "the cameras look away from the point cloud: {given} of {num_cameras} see it, expected most; camera axes \
             are x right, y down, z forward"
        ));
    }
    Ok(())
}

/// Takes every n-th point, so that about [`MAX_POINTS`] remain.
fn thinned(points: impl Iterator<Item = [f32; 3]> + Clone) -> Vec<[f32; 3]> {
    let step = points.clone().count().div_ceil(MAX_POINTS).max(1);
    points.step_by(step).collect()
}

fn share_seen(camera: &Camera, points: &[[f32; 3]]) -> f64 {
    let pinhole = Pinhole::<f64>::new(camera);
    let seen = points.iter().filter(|point| pinhole.pixel(point.map(f64::from)).is_some());
    seen.count() as f64 / points.len() as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    const UP: [f64; 3] = [0.0, -1.0, 0.0];

    /// Cameras on a circle, looking at `target(center)`.
    fn ring(radius: f64, target: impl Fn([f64; 3]) -> [f64; 3]) -> Vec<Camera> {
        (0..12)
            .map(|i| {
                let angle = f64::from(i) * std::f64::consts::TAU / 12.0;
                let center = [radius * angle.cos(), -0.5, radius * angle.sin()];
                Camera::look_at(center, target(center), UP, 60.0, 64, 48)
            })
            .collect()
    }

    /// The walls of a box of half-width `half`, and a small ball of foreground at its centre.
    fn room(half: f32, with_foreground: bool) -> PointCloud {
        let mut cloud = PointCloud::default();
        for i in 0..3000 {
            // Irrational steps spread points evenly (Roberts 2018, the R3 sequence).
            let unit = [0.819_172_5, 0.671_043_6, 0.549_700_5].map(|step: f32| (i as f32 * step).fract() * 2.0 - 1.0);
            let mut wall = unit.map(|x| x * half);
            wall[i % 3] = if i % 2 == 0 { half } else { -half };
            cloud.points.push(wall);
            cloud.foreground.push(false);
            if with_foreground && i % 10 == 0 {
                cloud.points.push(unit.map(|x| 0.3 * x));
                cloud.foreground.push(true);
            }
        }
        cloud.colors = vec![[0.5; 3]; cloud.points.len()];
        cloud
    }

    fn judge(cameras: &[Camera], cloud: &PointCloud) -> Result<(), String> {
        check(&cameras.iter().collect::<Vec<_>>(), cloud)
    }

    fn swapped(cameras: &[Camera]) -> Vec<Camera> {
        cameras.iter().map(Camera::inverse).collect()
    }

    #[test]
    fn cameras_in_a_room_that_look_at_something_pass_and_swapped_ones_do_not() {
        let cameras = ring(3.0, |_| [0.0; 3]);
        for with_foreground in [true, false] {
            let cloud = room(4.0, with_foreground);
            judge(&cameras, &cloud).unwrap();
            // Without foreground a swapped camera still sees some wall: no verdict is better than a wrong one.
            if with_foreground {
                let problem = judge(&swapped(&cameras), &cloud).unwrap_err();
                assert!(problem.starts_with("the matrices look like c2w (camera to world), expected w2c"), "{problem}");
                assert!(problem.ends_with("12 would if inverted"), "{problem}");
            }
        }
    }

    #[test]
    fn cameras_that_look_at_the_walls_around_them_pass() {
        let outward = |radius: f64| ring(radius, |center| center.map(|x| 2.0 * x));
        judge(&outward(3.0), &room(4.0, false)).unwrap();
        // Nor must they see the foreground, as long as they see enough of the scene.
        judge(&outward(0.5), &room(4.0, true)).unwrap();
        judge(&outward(3.0), &room(4.0, true)).unwrap_err();
    }

    #[test]
    fn cameras_that_turn_their_back_on_everything_do_not_pass() {
        let outward = ring(3.0, |center| center.map(|x| 2.0 * x));
        let problem = judge(&outward, &room(0.5, false)).unwrap_err();
        assert!(problem.starts_with("the cameras look away from the point cloud: 0 of 12 see it"), "{problem}");
    }

    #[test]
    fn a_few_cameras_that_look_elsewhere_do_not_matter() {
        let mut cameras = ring(3.0, |_| [0.0; 3]);
        let away = ring(3.0, |center| center.map(|x| 2.0 * x));
        cameras.truncate(6);
        cameras.extend_from_slice(&away[6..]);
        judge(&cameras, &room(0.5, false)).unwrap();
        cameras[5] = away[5].clone();
        judge(&cameras, &room(0.5, false)).unwrap_err();
    }
}
