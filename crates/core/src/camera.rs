//! Pinhole cameras, and the one formula that projects a point of the world to the image.
//!
//! What lives here: [`Camera`], as captures and files have it, and [`Pinhole`], the same numbers in one precision for
//! loops over many points. What does not: `tcgs-render` projects Gaussians and computes the gradient, and
//! `tcgs-capture` handles lens distortion.

use crate::{Real, add_scaled, cross, dot, normalize, sub};

/// A pinhole camera without distortion. Camera space: x right, y down, z forward; pixel centres at +0.5.
#[derive(Clone, Debug, PartialEq)]
pub struct Camera {
    /// Image width in pixels.
    pub width: usize,
    /// Image height in pixels.
    pub height: usize,
    /// Focal lengths `fx, fy`, pixels.
    pub focal: [f64; 2],
    /// Principal point `cx, cy`, pixels.
    pub principal: [f64; 2],
    /// `[4][4]` row-major rigid transform.
    pub camera_from_world: [[f64; 4]; 4],
}

/// Why numbers are not a valid camera.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum CameraError {
    /// NaN or infinity.
    #[error("{matrix} row {row} column {column} is {value}, expected a finite number")]
    NotFinite {
        /// Which matrix.
        matrix: &'static str,
        /// Row, from 0.
        row: usize,
        /// Column, from 0.
        column: usize,
        /// The number found.
        value: f64,
    },
    /// A number so large that its square may overflow.
    #[error("{matrix} row {row} column {column} is {value:e}, expected {most:e} or less in magnitude")]
    TooLarge {
        /// Which matrix.
        matrix: &'static str,
        /// Row, from 0.
        row: usize,
        /// Column, from 0.
        column: usize,
        /// The number found.
        value: f64,
        /// The largest magnitude.
        most: f64,
    },
    /// The upper left 3x3 is not a rotation.
    #[error("the upper left 3x3 of w2c is not a rotation: {0}")]
    NotRotation(String),
    /// Zero or negative focal length, or a skewed or unnormalised matrix.
    #[error("k is not a pinhole matrix: {0}")]
    NotPinhole(String),
    /// No pixels.
    #[error("the image is {0}x{1}, expected at least 1x1")]
    NoPixels(usize, usize),
    /// A side of more than [`MAX_SIDE`].
    #[error("the image is {0}x{1}, expected at most {MAX_SIDE} pixels a side")]
    TooManyPixels(usize, usize),
}

/// Largest width and height of an image, pixels.
pub const MAX_SIDE: usize = 1 << 16;

/// Largest number of pixels of an image that is drawn, 8192 by 8192: drawing holds up to some hundred bytes for each.
pub const MAX_PIXELS: usize = 1 << 26;

/// Largest magnitude of a coordinate of a camera or a point, scene units. With [`MAX_INTRINSIC`] the square of a
/// distance in pixels, `(2e12 * 1e6)²`, is finite in f32. The earth's radius in millimetres is 6e9.
pub const MAX_COORDINATE: f64 = 1e12;

/// Largest magnitude of a focal length or a principal point, pixels.
pub const MAX_INTRINSIC: f64 = 1e6;

/// How far `R Rᵀ` may be from the identity: calibrations are stored with a few decimals.
const ROTATION_TOLERANCE: f64 = 1e-3;

impl Camera {
    /// Checks and builds a camera.
    ///
    /// - `intrinsics`: `[3][3]` row-major, pixels
    /// - `camera_from_world`: `[4][4]` row-major
    ///
    /// # Errors
    /// [`CameraError`] if a number is not finite, or beyond [`MAX_COORDINATE`] or [`MAX_INTRINSIC`]. Also if a side is
    /// beyond [`MAX_SIDE`], the rotation is none, or the intrinsics are not those of a pinhole.
    pub fn new(
        width: usize,
        height: usize,
        intrinsics: [[f64; 3]; 3],
        camera_from_world: [[f64; 4]; 4],
    ) -> Result<Self, CameraError> {
        if width == 0 || height == 0 {
            return Err(CameraError::NoPixels(width, height));
        }
        if width.max(height) > MAX_SIDE {
            return Err(CameraError::TooManyPixels(width, height));
        }
        check_numbers("k", intrinsics.as_flattened(), 3, MAX_INTRINSIC)?;
        check_numbers("w2c", camera_from_world.as_flattened(), 4, MAX_COORDINATE)?;
        let [[fx, skew, cx], [zero, fy, cy], bottom] = intrinsics;
        if fx <= 0.0 || fy <= 0.0 {
            return Err(CameraError::NotPinhole(format!("the focal lengths are {fx} and {fy}, expected more than 0")));
        }
        if skew.abs() > 1e-6 * fx || zero != 0.0 || bottom != [0.0, 0.0, 1.0] {
            return Err(CameraError::NotPinhole(format!(
                "found {intrinsics:?}, expected [[fx, 0, cx], [0, fy, cy], [0, 0, 1]]"
            )));
        }
        check_rotation(&camera_from_world)?;
        Ok(Self { width, height, focal: [fx, fy], principal: [cx, cy], camera_from_world })
    }

    /// Position of the camera in the world: `−Rᵀ t`.
    pub fn center(&self) -> [f64; 3] {
        let m = &self.camera_from_world;
        std::array::from_fn(|j| -(0..3).map(|i| m[i][j] * m[i][3]).sum::<f64>())
    }

    /// Unit direction in the world in which the camera looks.
    pub fn forward(&self) -> [f64; 3] {
        let [x, y, z, _] = self.camera_from_world[2];
        [x, y, z]
    }

    /// The camera with its matrix inverted: `Rᵀ`, `−Rᵀ t`. An inverted matrix is the commonest mistake in a new
    /// capture.
    pub fn inverse(&self) -> Self {
        let (m, center) = (&self.camera_from_world, self.center());
        let row = |i: usize| [m[0][i], m[1][i], m[2][i], center[i]];
        Self { camera_from_world: [row(0), row(1), row(2), [0.0, 0.0, 0.0, 1.0]], ..self.clone() }
    }

    /// Projects a point of the world: its place in the image, and its depth.
    ///
    /// - `point`: `[3]`, world, scene units
    /// - returns: the place `x, y` in pixels, pixel centres at +0.5, possibly outside the image, and the depth in scene
    ///   units; `None` for a point that is not in front of the camera
    ///
    /// For many points make a [`Pinhole`] once.
    ///
    /// ```
    /// use tcgs_core::Camera;
    /// let camera = Camera::look_at([0.0, 0.0, -2.0], [0.0; 3], [0.0, -1.0, 0.0], 50.0, 64, 48);
    /// assert_eq!(camera.project([0.4, 0.0, 0.0]), Some(([42.0, 24.0], 2.0)));
    /// assert_eq!(camera.project([0.0, 0.0, -3.0]), None);
    /// ```
    pub fn project(&self, point: [f64; 3]) -> Option<([f64; 2], f64)> {
        Pinhole::new(self).project(point)
    }

    /// The camera of an image averaged over `factor` x `factor` pixels: intrinsics divided, rest of
    /// the pixels at the right and lower edge dropped.
    ///
    /// # Panics
    /// If `factor` is 0 or larger than the image.
    pub fn downscaled(&self, factor: usize) -> Self {
        assert!(
            factor > 0 && factor <= self.width.min(self.height),
            "downscale {factor} of {}x{}",
            self.width,
            self.height
        );
        let f = factor as f64;
        Self {
            width: self.width / factor,
            height: self.height / factor,
            focal: self.focal.map(|x| x / f),
            principal: self.principal.map(|x| x / f),
            camera_from_world: self.camera_from_world,
        }
    }

    /// The same camera with another image size, the field of view kept along both axes.
    pub fn resized(&self, width: usize, height: usize) -> Self {
        let ratio = [width as f64 / self.width as f64, height as f64 / self.height as f64];
        Self {
            width,
            height,
            focal: std::array::from_fn(|i| self.focal[i] * ratio[i]),
            principal: std::array::from_fn(|i| self.principal[i] * ratio[i]),
            camera_from_world: self.camera_from_world,
        }
    }

    /// A camera at `center` that looks at `target`.
    ///
    /// - `up`: direction in the world that points up in the image; not along the line of sight
    /// - `focal_px`: both focal lengths, pixels; the principal point is the image centre
    ///
    /// ```
    /// use tcgs_core::Camera;
    /// let camera = Camera::look_at([0.0, 0.0, -2.0], [0.0; 3], [0.0, -1.0, 0.0], 50.0, 64, 48);
    /// assert_eq!(camera.forward(), [0.0, 0.0, 1.0]);
    /// ```
    pub fn look_at(
        center: [f64; 3],
        target: [f64; 3],
        up: [f64; 3],
        focal_px: f64,
        width: usize,
        height: usize,
    ) -> Self {
        let z = normalize(sub(target, center));
        let x = normalize(cross(z, up));
        let y = cross(z, x);
        let row = |axis: [f64; 3]| [axis[0], axis[1], axis[2], -dot(axis, center)];
        Self {
            width,
            height,
            focal: [focal_px; 2],
            principal: [width as f64 / 2.0, height as f64 / 2.0],
            camera_from_world: [row(x), row(y), row(z), [0.0, 0.0, 0.0, 1.0]],
        }
    }
}

/// A [`Camera`] in one precision, ready for loops over many points: `f32` where images are searched, `f64` where a
/// result is compared with numbers of a file.
///
/// ```
/// use tcgs_core::{Camera, Pinhole};
/// let camera = Camera::look_at([0.0, 0.0, -2.0], [0.0; 3], [0.0, -1.0, 0.0], 50.0, 64, 48);
/// let pinhole = Pinhole::<f32>::new(&camera);
/// let (pixel, depth) = pinhole.pixel([0.0, 0.0, 0.0]).expect("the camera looks at it");
/// assert_eq!((pixel, depth), (24 * 64 + 32, 2.0));
/// assert_eq!(pinhole.unproject([32.0, 24.0], depth), [0.0, 0.0, 0.0]);
/// ```
#[derive(Clone, Debug, PartialEq)]
pub struct Pinhole<R> {
    /// Image width in pixels.
    pub width: usize,
    /// Image height in pixels.
    pub height: usize,
    /// Focal lengths `fx, fy`, pixels.
    pub focal: [R; 2],
    /// Principal point `cx, cy`, pixels.
    pub principal: [R; 2],
    /// The rotation of `camera_from_world`, `[3][3]` row-major.
    pub rotation: [[R; 3]; 3],
    /// The translation of `camera_from_world`, `[3]`, scene units.
    pub translation: [R; 3],
    /// Position of the camera in the world, `[3]`, scene units.
    pub center: [R; 3],
}

impl<R: Real> Pinhole<R> {
    /// Rounds every number of a camera to this precision; the centre is computed in `f64` before.
    pub fn new(camera: &Camera) -> Self {
        let m = &camera.camera_from_world;
        Self {
            width: camera.width,
            height: camera.height,
            focal: camera.focal.map(R::of),
            principal: camera.principal.map(R::of),
            rotation: std::array::from_fn(|i| std::array::from_fn(|j| R::of(m[i][j]))),
            translation: std::array::from_fn(|i| R::of(m[i][3])),
            center: camera.center().map(R::of),
        }
    }

    /// Unit direction in the world in which the camera looks, `[3]`.
    pub fn forward(&self) -> [R; 3] {
        self.rotation[2]
    }

    /// A point of the world in camera space, `[3]`, scene units: x right, y down, z forward.
    pub fn camera_point(&self, point: [R; 3]) -> [R; 3] {
        std::array::from_fn(|i| dot(self.rotation[i], point) + self.translation[i])
    }

    /// Where a point of the world is seen, and its depth: [`Camera::project`] in this precision.
    ///
    /// - `point`: `[3]`, world, scene units
    /// - returns: the place `x, y` in pixels, possibly outside the image, and the depth in scene units; `None` for a
    ///   point that is not before the camera
    pub fn project(&self, point: [R; 3]) -> Option<([R; 2], R)> {
        let [x, y, z] = self.camera_point(point);
        let at = |value: R, i: usize| self.focal[i] * value / z + self.principal[i];
        (z > R::zero()).then(|| ([at(x, 0), at(y, 1)], z))
    }

    /// The pixel on which a point of the world falls, and its depth.
    ///
    /// - `point`: `[3]`, world, scene units
    /// - returns: the index `row * width + column` and the depth in scene units; `None` outside the image and behind
    ///   the camera
    pub fn pixel(&self, point: [R; 3]) -> Option<(usize, R)> {
        let ([x, y], z) = self.project(point)?;
        // NaN compares false.
        let inside = x >= R::zero() && y >= R::zero() && x < R::of(self.width as f64) && y < R::of(self.height as f64);
        let (column, row) = inside.then(|| (x.to_usize(), y.to_usize()))?;
        Some((row? * self.width + column?, z))
    }

    /// The direction in the world of the ray through a place in the image, `[3]`; its component along
    /// [`forward`](Self::forward) is 1, so that a multiple of it is a depth.
    ///
    /// - `place`: `x, y`, pixels; pixel centres at +0.5
    pub fn ray(&self, place: [R; 2]) -> [R; 3] {
        let [x, y] = std::array::from_fn(|i| (place[i] - self.principal[i]) / self.focal[i]);
        let r = &self.rotation;
        std::array::from_fn(|j| r[0][j] * x + r[1][j] * y + r[2][j])
    }

    /// The point of the world that is seen at a place and a depth, `[3]`, scene units: undoes
    /// [`project`](Self::project).
    ///
    /// - `place`: `x, y`, pixels; pixel centres at +0.5
    /// - `depth`: along [`forward`](Self::forward), scene units
    pub fn unproject(&self, place: [R; 2], depth: R) -> [R; 3] {
        add_scaled(self.center, depth, self.ray(place))
    }

    /// The centre `x, y` of a pixel.
    ///
    /// - `pixel`: the index `row * width + column`
    pub fn pixel_center(&self, pixel: usize) -> [R; 2] {
        [(pixel % self.width) as f64, (pixel / self.width) as f64].map(|at| R::of(at) + R::of(0.5))
    }
}

fn check_numbers(matrix: &'static str, values: &[f64], columns: usize, most: f64) -> Result<(), CameraError> {
    for (i, &value) in values.iter().enumerate() {
        let (row, column) = (i / columns, i % columns);
        if !value.is_finite() {
            return Err(CameraError::NotFinite { matrix, row, column, value });
        }
        if value.abs() > most {
            return Err(CameraError::TooLarge { matrix, row, column, value, most });
        }
    }
    Ok(())
}

fn check_rotation(m: &[[f64; 4]; 4]) -> Result<(), CameraError> {
    if m[3] != [0.0, 0.0, 0.0, 1.0] {
        return Err(CameraError::NotRotation(format!("the last row is {:?}, expected [0, 0, 0, 1]", m[3])));
    }
    let row = |i: usize| [m[i][0], m[i][1], m[i][2]];
    for i in 0..3 {
        for j in i..3 {
            let found = dot(row(i), row(j));
            let expected = f64::from(u8::from(i == j));
            if (found - expected).abs() > ROTATION_TOLERANCE {
                return Err(CameraError::NotRotation(format!(
                    "row {i} times row {j} is {found:.4}, expected {expected}"
                )));
            }
        }
    }
    let [a, b, c] = [row(0), row(1), row(2)];
    let determinant =
        a[0] * (b[1] * c[2] - b[2] * c[1]) - a[1] * (b[0] * c[2] - b[2] * c[0]) + a[2] * (b[0] * c[1] - b[1] * c[0]);
    if determinant < 0.0 {
        return Err(CameraError::NotRotation("it mirrors (determinant -1)".into()));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    const K: [[f64; 3]; 3] = [[50.0, 0.0, 32.0], [0.0, 50.0, 24.0], [0.0, 0.0, 1.0]];

    fn identity() -> [[f64; 4]; 4] {
        std::array::from_fn(|i| std::array::from_fn(|j| f64::from(u8::from(i == j))))
    }

    #[test]
    fn center_and_forward_invert_the_transform() {
        let camera = Camera::look_at([1.0, -2.0, 3.0], [0.2, 0.1, -0.5], [0.0, -1.0, 0.0], 60.0, 64, 48);
        assert!(Camera::new(64, 48, K, camera.camera_from_world).is_ok());
        for (found, expected) in camera.center().iter().zip([1.0, -2.0, 3.0]) {
            assert!((found - expected).abs() < 1e-12);
        }
        // Up in the world is up (negative y) in the image.
        assert!(camera.camera_from_world[1][1] > 0.0);
    }

    #[test]
    fn bad_numbers_are_named() {
        let mut nan = identity();
        nan[1][3] = f64::NAN;
        assert_eq!(
            Camera::new(64, 48, K, nan).unwrap_err().to_string(),
            "w2c row 1 column 3 is NaN, expected a finite number"
        );
        let mut far = identity();
        far[0][3] = -1e300;
        let expected = "w2c row 0 column 3 is -1e300, expected 1e12 or less in magnitude";
        assert_eq!(Camera::new(64, 48, K, far).unwrap_err().to_string(), expected);
        far[0][3] = -MAX_COORDINATE;
        assert!(Camera::new(64, 48, K, far).is_ok());
        assert!((12.0 * (MAX_COORDINATE * MAX_INTRINSIC).powi(2)) < f64::from(f32::MAX));
        let mut long = K;
        long[1][1] = 1e7;
        let expected = "k row 1 column 1 is 1e7, expected 1e6 or less in magnitude";
        assert_eq!(Camera::new(64, 48, long, identity()).unwrap_err().to_string(), expected);
        let mut scaled = identity();
        scaled[0][0] = 1.1;
        assert!(
            Camera::new(64, 48, K, scaled).unwrap_err().to_string().contains("row 0 times row 0 is 1.2100, expected 1")
        );
        let mut mirrored = identity();
        mirrored[2][2] = -1.0;
        assert!(Camera::new(64, 48, K, mirrored).unwrap_err().to_string().contains("mirrors"));
        let mut k = K;
        k[0][0] = -1.0;
        assert!(matches!(Camera::new(64, 48, k, identity()), Err(CameraError::NotPinhole(_))));
        assert!(matches!(Camera::new(1 << 40, 48, K, identity()), Err(CameraError::TooManyPixels(..))));
        assert!(matches!(Camera::new(0, 48, K, identity()), Err(CameraError::NoPixels(0, 48))));
    }

    #[test]
    fn a_point_is_projected_and_brought_back_in_both_precisions() {
        let camera = Camera::look_at([1.0, -2.0, 3.0], [0.2, 0.1, -0.5], [0.0, -1.0, 0.0], 60.0, 64, 48);
        let point = [0.5, -0.25, 0.125];
        let (place, depth) = camera.project(point).unwrap();
        for (found, expected) in Pinhole::new(&camera).unproject(place, depth).iter().zip(point) {
            assert!((found - expected).abs() < 1e-12, "{found}, expected {expected}");
        }
        let single = Pinhole::<f32>::new(&camera);
        let (near, _) = single.project(point.map(|x| x as f32)).unwrap();
        assert!((0..2).all(|i| (f64::from(near[i]) - place[i]).abs() < 1e-3), "{near:?}, expected {place:?}");
        let (pixel, _) = single.pixel(point.map(|x| x as f32)).unwrap();
        assert_eq!(pixel, place[1] as usize * 64 + place[0] as usize);
        assert_eq!(single.pixel_center(pixel), [place[0].floor() as f32 + 0.5, place[1].floor() as f32 + 0.5]);
        // Behind the camera, outside the image, and not a number.
        assert_eq!(camera.project([2.0, -4.0, 7.0]), None);
        assert_eq!(single.pixel([0.2, 3.0, -0.5]), None);
        assert_eq!(single.pixel([f32::NAN; 3]), None);
    }

    #[test]
    fn downscaling_keeps_rays() {
        let camera = Camera::new(65, 48, K, identity()).unwrap().downscaled(2);
        assert_eq!((camera.width, camera.height, camera.focal, camera.principal), (32, 24, [25.0; 2], [16.0, 12.0]));
    }
}
