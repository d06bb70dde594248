//! Cameras placed at some timesteps, and the smooth motion between them.

use crate::{Camera, CameraError, cross, dot, normalize};

/// Keyframes by increasing timestep, and the cameras between them.
///
/// The player's page and `tcgs render` show the same path by this one interpolation.
///
/// ```
/// use tcgs_core::{Camera, CameraPath};
/// let at = |x: f64| Camera::look_at([x, 0.0, -4.0], [x, 0.0, 0.0], [0.0, -1.0, 0.0], 50.0, 64, 48);
/// let mut path = CameraPath::default();
/// path.insert(10.0, at(2.0))?;
/// path.insert(0.0, at(0.0))?;
/// assert_eq!(path.camera_at(0.0, [64, 48])?, at(0.0));
/// assert!((path.camera_at(5.0, [64, 48])?.center()[0] - 1.0).abs() < 1e-9);
/// # Ok::<(), tcgs_core::CameraPathError>(())
/// ```
#[derive(Clone, Debug, Default, PartialEq)]
pub struct CameraPath {
    keyframes: Vec<CameraKeyframe>,
}

/// A camera at a timestep.
#[derive(Clone, Debug, PartialEq)]
pub struct CameraKeyframe {
    /// Finite; whole numbers are the timesteps of a scene.
    pub timestep: f64,
    /// Its intrinsics belong to its own image size; [`Camera::fitted`] adapts them.
    pub camera: Camera,
}

/// Why a path has no camera.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum CameraPathError {
    /// The timestep of a keyframe is not finite.
    #[error("the timestep of a keyframe is {0}, expected a finite number")]
    Timestep(f64),
    /// There are no keyframes.
    #[error("the camera path has no keyframes")]
    Empty,
    /// The interpolated axes are no rotation, such as halfway between two opposite directions.
    #[error("between two keyframes, at timestep {timestep}, there is no camera: {problem}")]
    Between {
        /// The timestep of the requested camera.
        timestep: f64,
        /// Why the interpolated camera is not valid.
        #[source]
        problem: CameraError,
    },
}

/// The interpolated numbers of a camera: centre, forward axis, down axis, focal lengths, principal point.
const NUMBERS: usize = 13;

impl CameraPath {
    /// Adds a keyframe; it replaces the one at the same timestep, if there is one.
    ///
    /// # Errors
    /// [`CameraPathError::Timestep`] if the timestep is not finite.
    pub fn insert(&mut self, timestep: f64, camera: Camera) -> Result<(), CameraPathError> {
        if !timestep.is_finite() {
            return Err(CameraPathError::Timestep(timestep));
        }
        let keyframe = CameraKeyframe { timestep, camera };
        let index = self.keyframes.partition_point(|other| other.timestep < timestep);
        match self.keyframes.get_mut(index) {
            Some(other) if other.timestep == timestep => *other = keyframe,
            _ => self.keyframes.insert(index, keyframe),
        }
        Ok(())
    }

    /// All keyframes, by increasing timestep.
    pub fn keyframes(&self) -> &[CameraKeyframe] {
        &self.keyframes
    }

    /// The camera at a timestep; before the first keyframe and after the last it stands still.
    ///
    /// Centre, axes and intrinsics follow cubic Hermite splines whose slope at a keyframe is that of the parabola
    /// through it and its neighbours. The interpolated axes are made orthonormal.
    ///
    /// - `size`: width and height of the picture, pixels. A picture of another shape than a keyframe's shows at least
    ///   everything that the keyframe shows
    ///
    /// # Errors
    /// [`CameraPathError::Empty`] without keyframes; [`CameraPathError::Between`] if the interpolated camera is not
    /// valid.
    pub fn camera_at(&self, timestep: f64, size: [usize; 2]) -> Result<Camera, CameraPathError> {
        let [width, height] = size;
        let after = self.keyframes.partition_point(|keyframe| keyframe.timestep <= timestep);
        let before = self.keyframes.get(after.saturating_sub(1)).ok_or(CameraPathError::Empty)?;
        if after == 0 || after == self.keyframes.len() || before.timestep == timestep {
            return Ok(before.camera.fitted(width, height));
        }
        let (from, to) = (self.numbers(after - 1, size), self.numbers(after, size));
        let (from_slope, to_slope) = (self.slopes(after - 1, size), self.slopes(after, size));
        let span = self.keyframes[after].timestep - before.timestep;
        let s = (timestep - before.timestep) / span;
        let (s2, s3) = (s * s, s * s * s);
        let mixed: [f64; NUMBERS] = std::array::from_fn(|i| {
            (2.0 * s3 - 3.0 * s2 + 1.0) * from[i]
                + (s3 - 2.0 * s2 + s) * span * from_slope[i]
                + (3.0 * s2 - 2.0 * s3) * to[i]
                + (s3 - s2) * span * to_slope[i]
        });
        camera_of(&mixed, size).map_err(|problem| CameraPathError::Between { timestep, problem })
    }

    fn numbers(&self, index: usize, [width, height]: [usize; 2]) -> [f64; NUMBERS] {
        numbers_of(&self.keyframes[index].camera.fitted(width, height))
    }

    /// Slopes of the parabolas through a keyframe and its neighbours; at an end of the path, through the three
    /// keyframes there. With two keyframes, the slopes of the lines.
    fn slopes(&self, index: usize, size: [usize; 2]) -> [f64; NUMBERS] {
        let count = self.keyframes.len();
        if count == 2 {
            let span = self.keyframes[1].timestep - self.keyframes[0].timestep;
            let (from, to) = (self.numbers(0, size), self.numbers(1, size));
            return std::array::from_fn(|i| (to[i] - from[i]) / span);
        }
        let first = index.saturating_sub(1).min(count - 3);
        let [t0, t1, t2] = [0, 1, 2].map(|i| self.keyframes[first + i].timestep);
        let at = self.keyframes[index].timestep;
        let weights = [
            (2.0 * at - t1 - t2) / ((t0 - t1) * (t0 - t2)),
            (2.0 * at - t0 - t2) / ((t1 - t0) * (t1 - t2)),
            (2.0 * at - t0 - t1) / ((t2 - t0) * (t2 - t1)),
        ];
        let points = [0, 1, 2].map(|i| self.numbers(first + i, size));
        std::array::from_fn(|i| (0..3).map(|k| weights[k] * points[k][i]).sum())
    }
}

impl Camera {
    /// The same view in a picture of another size. Both focal lengths are scaled by one factor, and the picture's
    /// middle stays in the middle, so the new picture shows at least everything that this one shows. The same size
    /// gives the same camera.
    ///
    /// - `width`, `height`: pixels, at least 1
    pub fn fitted(&self, width: usize, height: usize) -> Self {
        if [self.width, self.height] == [width, height] {
            return self.clone();
        }
        let (from, to) = ([self.width, self.height], [width, height]);
        let ratio = [0, 1].map(|i| to[i] as f64 / from[i] as f64);
        let scale = ratio[0].min(ratio[1]);
        let middle = |size: [usize; 2], i: usize| size[i] as f64 / 2.0;
        Self {
            width,
            height,
            focal: self.focal.map(|f| scale * f),
            principal: [0, 1].map(|i| middle(to, i) + scale * (self.principal[i] - middle(from, i))),
            camera_from_world: self.camera_from_world,
        }
    }
}

/// Centre, axes forward and down, focal lengths and principal point.
pub(crate) fn numbers_of(camera: &Camera) -> [f64; NUMBERS] {
    let [x, y, z] = camera.center();
    let [_, down, forward, _] = camera.camera_from_world;
    let ([fx, fy], [cx, cy]) = (camera.focal, camera.principal);
    [x, y, z, forward[0], forward[1], forward[2], down[0], down[1], down[2], fx, fy, cx, cy]
}

/// The camera of [`numbers_of`], whose axes need not be orthonormal.
pub(crate) fn camera_of(numbers: &[f64; NUMBERS], [width, height]: [usize; 2]) -> Result<Camera, CameraError> {
    let vector = |first: usize| [numbers[first], numbers[first + 1], numbers[first + 2]];
    let (center, z) = (vector(0), normalize(vector(3)));
    let x = normalize(cross(vector(6), z));
    let y = cross(z, x);
    let row = |axis: [f64; 3]| [axis[0], axis[1], axis[2], -dot(axis, center)];
    let &[.., fx, fy, cx, cy] = numbers;
    let intrinsics = [[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]];
    Camera::new(width, height, intrinsics, [row(x), row(y), row(z), [0.0, 0.0, 0.0, 1.0]])
}

#[cfg(test)]
mod tests {
    use super::*;

    const UP: [f64; 3] = [0.0, -1.0, 0.0];
    const SIZE: [usize; 2] = [100, 60];

    fn path() -> CameraPath {
        let at =
            |angle: f64| Camera::look_at([3.0 * angle.sin(), -1.0, -3.0 * angle.cos()], [0.0; 3], UP, 80.0, 100, 60);
        let mut path = CameraPath::default();
        for (timestep, angle) in [(4.0, 0.5), (2.0, 0.0), (8.0, 9.9), (7.0, 1.25), (8.0, 1.5)] {
            path.insert(timestep, at(angle)).unwrap();
        }
        path
    }

    fn distance(a: &[f64], b: &[f64]) -> f64 {
        a.iter().zip(b).map(|(a, b)| (a - b).powi(2)).sum::<f64>().sqrt()
    }

    #[test]
    fn keyframes_are_ordered_met_exactly_and_held_beyond_the_ends() {
        let path = path();
        let timesteps: Vec<f64> = path.keyframes().iter().map(|keyframe| keyframe.timestep).collect();
        assert_eq!(timesteps, [2.0, 4.0, 7.0, 8.0], "one at the same timestep is replaced");
        for CameraKeyframe { timestep, camera } in path.keyframes() {
            assert_eq!(&path.camera_at(*timestep, SIZE).unwrap(), camera);
        }
        assert_eq!(path.camera_at(0.0, SIZE).unwrap(), path.keyframes()[0].camera);
        assert_eq!(path.camera_at(9.5, SIZE).unwrap(), path.keyframes()[3].camera);
    }

    #[test]
    fn between_keyframes_the_camera_moves_smoothly_and_keeps_looking() {
        let path = path();
        for i in 0..=60 {
            let timestep = 2.0 + 0.1 * f64::from(i);
            let camera = path.camera_at(timestep, SIZE).unwrap();
            // The keyframes lie on a circle, a quarter of a radian a timestep apart.
            let angle = 0.25 * (timestep - 2.0);
            let center = [3.0 * angle.sin(), -1.0, -3.0 * angle.cos()];
            assert!(distance(&camera.center(), &center) < 0.05, "{timestep}: {:?}", camera.center());
            let to_middle = normalize(camera.center().map(|x| -x));
            assert!(dot(camera.forward(), to_middle) > 0.999);
            let [fx, fy] = camera.focal;
            assert!((fx - 80.0).abs() < 1e-9 && (fy - 80.0).abs() < 1e-9);
            let next = path.camera_at(timestep + 1e-6, SIZE).unwrap();
            assert!(distance(&camera.center(), &next.center()) < 1e-5, "no jump");
        }
    }

    #[test]
    fn another_size_shows_all_that_a_keyframe_shows() {
        let wide = path().camera_at(2.0, [400, 120]).unwrap();
        assert_eq!((wide.focal, wide.principal), ([160.0; 2], [200.0, 60.0]));
        let tall = path().camera_at(2.0, [50, 120]).unwrap();
        assert_eq!((tall.focal, tall.principal), ([40.0; 2], [25.0, 60.0]));
        assert_eq!(wide.camera_from_world, path().keyframes()[0].camera.camera_from_world);
    }

    #[test]
    fn where_there_is_no_camera_an_error_says_so() {
        let mut path = CameraPath::default();
        assert_eq!(path.camera_at(0.0, SIZE), Err(CameraPathError::Empty));
        let ahead = Camera::look_at([0.0, 0.0, -3.0], [0.0; 3], UP, 80.0, 100, 60);
        let behind = Camera::look_at([0.0, 0.0, 3.0], [0.0; 3], UP, 80.0, 100, 60);
        assert!(matches!(path.insert(f64::NAN, ahead.clone()), Err(CameraPathError::Timestep(_))));
        path.insert(0.0, ahead).unwrap();
        path.insert(8.0, behind).unwrap();
        let error = path.camera_at(4.0, SIZE).unwrap_err();
        assert!(matches!(error, CameraPathError::Between { timestep: 4.0, .. }), "{error}");
    }
}
