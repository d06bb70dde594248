//! A camera that a person moves: orbit, look, pan, zoom, fly.
//!
//! Lengths are in scene units, angles in radians. The scene follows the pointer: a drag to the right moves the camera
//! to the left.

use tcgs_core::{Camera, CameraError, add_scaled, cross, dot, length, normalize, sub};

use crate::start_view::StartView;

/// The axis that points up and the line of sight stay at least this far apart, so that the picture never flips.
const MIN_POLE_ANGLE: f64 = 0.05;
/// The camera comes no nearer to its pivot than this share of the distance that it started from.
const MIN_DISTANCE: f64 = 1e-3;
/// The camera goes no farther from its pivot than this many times the distance that it started from.
const MAX_DISTANCE: f64 = 1e3;

type Vector = [f64; 3];

/// Where a camera stands and what it turns around.
#[derive(Clone, Debug, PartialEq)]
struct CameraPose {
    /// Right, down, forward in the world: rows of the rotation of `camera_from_world`.
    axes: [Vector; 3],
    position: Vector,
    /// Distance of the pivot, straight ahead.
    distance: f64,
    /// The camera as given. Its intrinsics always apply; its transform applies until the pose is moved.
    given: Camera,
    /// Until the pose is moved, the transform is bit for bit the given one; rebuilding it from the axes would round.
    is_moved: bool,
}

impl CameraPose {
    fn of(camera: &Camera, distance: f64) -> Self {
        let m = &camera.camera_from_world;
        Self {
            axes: [0, 1, 2].map(|i| [m[i][0], m[i][1], m[i][2]]),
            position: camera.center(),
            distance,
            given: camera.clone(),
            is_moved: false,
        }
    }

    fn pivot(&self) -> Vector {
        add_scaled(self.position, self.distance, self.axes[2])
    }
}

/// A camera that a person moves.
#[derive(Clone, Debug, PartialEq)]
pub struct Controls {
    start: CameraPose,
    pose: CameraPose,
    up: Vector,
}

impl Controls {
    /// Controls of a camera that begins at `start` and returns there at [`Self::reset`].
    ///
    /// - `up`: direction in the world that stays up in the picture
    /// - `pivot`: point in the world around which the camera orbits
    ///
    /// ```
    /// use tcgs_core::Camera;
    /// let start = Camera::look_at([0.0, 0.0, -2.0], [0.0; 3], [0.0, -1.0, 0.0], 50.0, 64, 48);
    /// let mut controls = tcgs_play::Controls::new(&start, [0.0, -1.0, 0.0], [0.0; 3]);
    /// controls.orbit(std::f64::consts::PI, 0.0);
    /// assert!((controls.camera([64, 48]).center()[2] - 2.0).abs() < 1e-9, "on the other side");
    /// controls.reset();
    /// assert_eq!(controls.camera([64, 48]), start);
    /// ```
    pub fn new(start: &Camera, up: Vector, pivot: Vector) -> Self {
        let pose = CameraPose::of(start, ahead(start, pivot));
        Self { start: pose.clone(), pose, up: normalize(up) }
    }

    /// The camera for a picture of some size; it shows at least all that the camera given last shows.
    ///
    /// - `[width, height]`: pixels
    pub fn camera(&self, [width, height]: [usize; 2]) -> Camera {
        let CameraPose { axes, position, given, is_moved, .. } = &self.pose;
        let camera = given.fitted(width, height);
        if !is_moved {
            return camera;
        }
        let row = |axis: Vector| [axis[0], axis[1], axis[2], -dot(axis, *position)];
        Camera { camera_from_world: [row(axes[0]), row(axes[1]), row(axes[2]), [0.0, 0.0, 0.0, 1.0]], ..camera }
    }

    /// Moves to another camera. The new pivot lies straight ahead of it, as far ahead as the old pivot is.
    ///
    /// # Errors
    /// [`CameraError`] if the numbers of `camera` are no camera. The old one stays then.
    pub fn set_camera(&mut self, camera: &Camera) -> Result<(), CameraError> {
        let Camera { width, height, focal: [fx, fy], principal: [cx, cy], camera_from_world } = *camera;
        let intrinsics = [[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]];
        let camera = Camera::new(width, height, intrinsics, camera_from_world)?;
        self.pose = CameraPose::of(&camera, ahead(&camera, self.pose.pivot()));
        Ok(())
    }

    /// The view to which [`Self::reset`] returns; its pivot lies straight ahead of the camera.
    pub fn start_view(&self) -> StartView {
        StartView { camera: self.start.given.clone(), up: self.up, pivot: self.start.pivot() }
    }

    /// Moves back to the start.
    pub fn reset(&mut self) {
        self.pose = self.start.clone();
    }

    /// Moves around the pivot, which stays where it is in the picture.
    ///
    /// - `dx`, `dy`: radians to the right and down
    pub fn orbit(&mut self, dx: f64, dy: f64) {
        let pivot = self.pose.pivot();
        if self.turn(-dx, dy) {
            self.pose.position = add_scaled(pivot, -self.pose.distance, self.pose.axes[2]);
        }
    }

    /// Turns on the spot, together with the pivot.
    ///
    /// - `dx`, `dy`: radians to the right and down
    pub fn look(&mut self, dx: f64, dy: f64) {
        self.turn(dx, -dy);
    }

    /// Moves sideways, together with the pivot.
    ///
    /// - `dx`, `dy`: shift of a point at the pivot's depth to the right and down in the picture, in picture heights
    pub fn pan(&mut self, dx: f64, dy: f64) {
        let height = self.pose.distance * self.pose.given.height as f64 / self.pose.given.focal[1];
        self.shift([-dx * height, -dy * height, 0.0]);
    }

    /// Moves towards the pivot or away from it.
    ///
    /// - `factor`: divides the distance: above 1 moves nearer. Values other than positive numbers change nothing
    pub fn zoom(&mut self, factor: f64) {
        if !(factor.is_finite() && factor > 0.0) {
            return;
        }
        let range = MIN_DISTANCE * self.start.distance..=MAX_DISTANCE * self.start.distance;
        let distance = (self.pose.distance / factor).clamp(*range.start(), *range.end());
        let pivot = self.pose.pivot();
        self.pose.distance = distance;
        self.pose.position = add_scaled(pivot, -distance, self.pose.axes[2]);
        self.pose.is_moved = true;
    }

    /// Moves through the scene, together with the pivot.
    ///
    /// - `dx`, `dy`, `dz`: to the right, down, forward, in distances of the start view from its pivot
    pub fn fly(&mut self, dx: f64, dy: f64, dz: f64) {
        self.shift([dx, dy, dz].map(|d| d * self.start.distance));
    }

    /// Where the camera stands, world, scene units.
    pub fn position(&self) -> Vector {
        self.pose.position
    }

    /// Moves part of the way to a position. The pivot stays where it is in the picture, and up stays up.
    ///
    /// - `to`: world, scene units
    /// - `share`: of the way, in `[0, 1]`
    pub fn approach(&mut self, to: Vector, share: f64) {
        let pivot = self.pose.pivot();
        let position = add_scaled(self.pose.position, share, sub(to, self.pose.position));
        let (offset, distance) = (sub(pivot, position), length(sub(pivot, position)));
        let across = cross(offset, self.up);
        // Straight above or below the pivot the picture has no upright direction.
        if !(distance.is_finite() && length(across) > MIN_POLE_ANGLE.sin() * distance) {
            return;
        }
        let (forward, right) = (normalize(offset), normalize(across));
        self.pose.axes = [right, cross(forward, right), forward];
        (self.pose.position, self.pose.distance, self.pose.is_moved) = (position, distance, true);
    }

    fn shift(&mut self, along: Vector) {
        if along.iter().all(|d| d.is_finite()) {
            for (axis, d) in self.pose.axes.into_iter().zip(along) {
                self.pose.position = add_scaled(self.pose.position, d, axis);
            }
            self.pose.is_moved = true;
        }
    }

    /// Turns the axes about the up direction, then about the right axis.
    ///
    /// - `yaw`, `pitch`: radians to the left and down
    /// - returns: whether both angles are finite; otherwise nothing changes
    fn turn(&mut self, yaw: f64, pitch: f64) -> bool {
        if !(yaw.is_finite() && pitch.is_finite()) {
            return false;
        }
        let axes = &mut self.pose.axes;
        *axes = axes.map(|axis| rotated(axis, self.up, yaw));
        // From straight up to the line of sight. A camera that was put nearer to a pole may stay, or leave it.
        let angle = dot(self.up, axes[2]).clamp(-1.0, 1.0).acos();
        let (low, high) = (MIN_POLE_ANGLE.min(angle), (std::f64::consts::PI - MIN_POLE_ANGLE).max(angle));
        // A camera that lies on its side leaves the poles alone.
        let upright = -dot(self.up, axes[1]) / angle.sin().max(1e-9);
        let pitch = if upright > 0.5 { pitch.clamp(low - angle, high - angle) } else { pitch };
        let right = axes[0];
        *axes = axes.map(|axis| rotated(axis, right, -pitch));
        *axes = orthonormal(*axes);
        self.pose.is_moved = true;
        true
    }
}

/// How far ahead of a camera a point is; a positive number in any case.
fn ahead(camera: &Camera, point: Vector) -> f64 {
    let offset = sub(point, camera.center());
    let distance = length(offset);
    let depth = dot(offset, camera.forward());
    // A point beside or behind the camera has no useful depth, so its distance counts instead.
    let found = if depth > 0.2 * distance { depth } else { distance };
    if found.is_finite() && found > 0.0 { found } else { 1.0 }
}

/// Rodrigues' formula.
///
/// - `axis`: of unit length
fn rotated(v: Vector, axis: Vector, angle: f64) -> Vector {
    let (sin, cos) = angle.sin_cos();
    let (across, along) = (cross(axis, v), (1.0 - cos) * dot(axis, v));
    std::array::from_fn(|i| cos * v[i] + sin * across[i] + along * axis[i])
}

/// Restores orthonormal axes, because the rounding of many small turns would accumulate.
fn orthonormal([right, _, forward]: [Vector; 3]) -> [Vector; 3] {
    let forward = normalize(forward);
    let right = normalize(add_scaled(right, -dot(right, forward), forward));
    [right, cross(forward, right), forward]
}

#[cfg(test)]
mod tests {
    use super::*;

    const UP: Vector = [0.0, -1.0, 0.0];
    const PIVOT: Vector = [1.0, 2.0, 3.0];
    const SIZE: [usize; 2] = [64, 48];

    fn start() -> Camera {
        Camera::look_at([1.0, 1.0, -2.0], PIVOT, UP, 50.0, 64, 48)
    }

    fn controls() -> Controls {
        Controls::new(&start(), UP, PIVOT)
    }

    fn to_pivot(camera: &Camera) -> Vector {
        sub(PIVOT, camera.center())
    }

    /// Where a point is seen, pixels.
    fn seen(camera: &Camera, point: Vector) -> [f64; 2] {
        camera.project(point).unwrap().0
    }

    fn is_rotation(camera: &Camera) -> bool {
        let k = [[50.0, 0.0, 32.0], [0.0, 50.0, 24.0], [0.0, 0.0, 1.0]];
        Camera::new(64, 48, k, camera.camera_from_world).is_ok()
    }

    #[test]
    fn a_camera_that_approaches_a_position_keeps_its_pivot_and_stands_upright() {
        let mut controls = controls();
        controls.orbit(0.7, -0.2);
        let (from, to) = (controls.position(), [4.0, 1.0, -1.0]);
        controls.approach(to, 0.25);
        assert!(length(sub(controls.position(), add_scaled(from, 0.25, sub(to, from)))) < 1e-12);
        controls.approach(to, 1.0);
        let camera = controls.camera(SIZE);
        assert!(length(sub(camera.center(), to)) < 1e-9 && is_rotation(&camera));
        let [x, y] = seen(&camera, PIVOT);
        assert!((x - 32.0).abs() < 1e-9 && (y - 24.0).abs() < 1e-9, "{x} {y}");
        // A point above the pivot is above it in the picture.
        let [above_x, above_y] = seen(&camera, add_scaled(PIVOT, 0.1, UP));
        assert!((above_x - x).abs() < 1e-9 && above_y < y, "{above_x} {above_y}");
        // There is no upright picture from straight above.
        controls.approach(add_scaled(PIVOT, 3.0, UP), 1.0);
        assert_eq!(controls.camera(SIZE), camera);
    }

    #[test]
    fn nothing_moved_is_the_camera_given_to_the_bit() {
        let mut controls = controls();
        assert_eq!(controls.camera(SIZE), start());
        let mut other = Camera::look_at([0.3, -0.2, 0.1], [5.0, 0.0, 1.0], UP, 77.0, 30, 20);
        other.principal = [14.3, 10.9];
        controls.set_camera(&other).unwrap();
        assert_eq!(controls.camera([30, 20]), other);
        controls.reset();
        assert_eq!(controls.camera(SIZE), start());
        let mut broken = other;
        broken.camera_from_world[0][0] = f64::NAN;
        assert!(controls.set_camera(&broken).is_err());
    }

    #[test]
    fn orbiting_keeps_the_pivot_in_the_middle_and_as_far() {
        let mut controls = controls();
        let distance = length(to_pivot(&start()));
        for (dx, dy) in [(0.3, 0.1), (-2.0, 0.4), (9.0, -0.7)] {
            controls.orbit(dx, dy);
            let camera = controls.camera(SIZE);
            assert!((length(to_pivot(&camera)) - distance).abs() < 1e-9);
            assert!(dot(normalize(to_pivot(&camera)), camera.forward()) > 1.0 - 1e-9);
            assert!(is_rotation(&camera));
        }
    }

    #[test]
    fn what_is_dragged_follows_the_pointer() {
        // A point in front of the pivot is dragged to the right and down.
        let near = add_scaled(PIVOT, -0.5, start().forward());
        for (x, y) in [(0.01, 0.0), (0.0, 0.01)] {
            for motion in [Controls::orbit, Controls::look, Controls::pan] {
                let mut controls = controls();
                let before = seen(&controls.camera(SIZE), near);
                motion(&mut controls, x, y);
                let after = seen(&controls.camera(SIZE), near);
                let moved = [after[0] - before[0], after[1] - before[1]];
                assert!(moved[0] * x + moved[1] * y > 0.0, "{moved:?} by {x}, {y}");
            }
        }
        // And by just as much as the pointer, at the pivot.
        let mut controls = controls();
        controls.pan(0.25, -0.5);
        let at = seen(&controls.camera(SIZE), PIVOT);
        assert!((at[0] - (32.0 + 12.0)).abs() < 1e-9 && (at[1] - (24.0 - 24.0)).abs() < 1e-9, "{at:?}");
    }

    #[test]
    fn the_picture_never_flips_over_a_pole() {
        let mut controls = controls();
        for dy in [0.4; 100].into_iter().chain([-0.4; 100]) {
            controls.orbit(0.1, dy);
            let camera = controls.camera(SIZE);
            let down = [camera.camera_from_world[1][0], camera.camera_from_world[1][1], camera.camera_from_world[1][2]];
            assert!(dot(down, UP) < 0.0, "up is up");
            assert!(is_rotation(&camera));
        }
    }

    #[test]
    fn a_camera_on_its_side_keeps_its_roll() {
        let mut controls = controls();
        controls.set_camera(&Camera::look_at([0.0, 0.0, -3.0], [0.0; 3], [1.0, 0.0, 0.0], 50.0, 64, 48)).unwrap();
        let before = controls.camera(SIZE);
        controls.orbit(0.0, 1e-6);
        let after = controls.camera(SIZE);
        for (a, b) in before.camera_from_world.as_flattened().iter().zip(after.camera_from_world.as_flattened()) {
            assert!((a - b).abs() < 1e-4);
        }
    }

    #[test]
    fn zooming_comes_nearer_and_stops_before_the_pivot() {
        let mut controls = controls();
        controls.zoom(2.0);
        let half = length(to_pivot(&start())) / 2.0;
        assert!((length(to_pivot(&controls.camera(SIZE))) - half).abs() < 1e-9);
        for factor in [0.0, -1.0, f64::NAN, f64::INFINITY] {
            let before = controls.clone();
            controls.zoom(factor);
            assert_eq!(controls, before);
        }
        (0..1000).for_each(|_| controls.zoom(3.0));
        let camera = controls.camera(SIZE);
        assert!(length(to_pivot(&camera)) > 0.0 && dot(to_pivot(&camera), camera.forward()) > 0.0);
    }

    #[test]
    fn flying_goes_along_the_cameras_axes() {
        let mut controls = controls();
        let distance = length(to_pivot(&start()));
        controls.fly(0.1, -0.2, 0.5);
        let camera = controls.camera(SIZE);
        let m = start().camera_from_world;
        let center = camera.center();
        let at = [0, 1, 2].map(|i| (dot([m[i][0], m[i][1], m[i][2]], center) + m[i][3]) / distance);
        for (found, expected) in at.iter().zip([0.1, -0.2, 0.5]) {
            assert!((found - expected).abs() < 1e-9, "{at:?}");
        }
        controls.fly(f64::NAN, 0.0, 0.0);
        controls.orbit(f64::INFINITY, 0.0);
        assert_eq!(controls.camera(SIZE), camera);
    }

    #[test]
    fn another_size_shows_at_least_as_much() {
        let controls = controls();
        for size in [[640, 480], [480, 480], [1000, 300], [33, 17]] {
            let camera = controls.camera(size);
            let share = [0, 1].map(|i| size[i] as f64 / camera.focal[i]);
            assert!(share[0] >= 64.0 / 50.0 - 1e-9 && share[1] >= 48.0 / 50.0 - 1e-9, "{share:?}");
            assert_eq!(camera.focal[0], camera.focal[1]);
            assert_eq!(camera.principal, size.map(|s| s as f64 / 2.0));
        }
    }
}
