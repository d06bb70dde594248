//! Pinhole cameras.

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

/// Why numbers do not make a camera.
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
        /// What stands there.
        value: f64,
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
}

/// How far `R Rᵀ` may be from the identity: calibrations are stored with a few decimals.
const ROTATION_TOLERANCE: f64 = 1e-3;

impl Camera {
    /// Checks and builds a camera.
    ///
    /// - `intrinsics`: `[3][3]` row-major, pixels
    /// - `camera_from_world`: `[4][4]` row-major
    ///
    /// # Errors
    /// [`CameraError`] if a number is not finite, the rotation is not one, or the intrinsics are not
    /// those of a pinhole.
    pub fn new(
        width: usize,
        height: usize,
        intrinsics: [[f64; 3]; 3],
        camera_from_world: [[f64; 4]; 4],
    ) -> Result<Self, CameraError> {
        if width == 0 || height == 0 {
            return Err(CameraError::NoPixels(width, height));
        }
        check_finite("k", intrinsics.as_flattened(), 3)?;
        check_finite("w2c", camera_from_world.as_flattened(), 4)?;
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
        let cross = |a: [f64; 3], b: [f64; 3]| {
            [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
        };
        let z = crate::normalize(std::array::from_fn(|i| target[i] - center[i]));
        let x = crate::normalize(cross(z, up));
        let y = cross(z, x);
        let row = |axis: [f64; 3]| [axis[0], axis[1], axis[2], -crate::dot(axis, center)];
        Self {
            width,
            height,
            focal: [focal_px; 2],
            principal: [width as f64 / 2.0, height as f64 / 2.0],
            camera_from_world: [row(x), row(y), row(z), [0.0, 0.0, 0.0, 1.0]],
        }
    }
}

fn check_finite(matrix: &'static str, values: &[f64], columns: usize) -> Result<(), CameraError> {
    match values.iter().position(|v| !v.is_finite()) {
        Some(i) => Err(CameraError::NotFinite { matrix, row: i / columns, column: i % columns, value: values[i] }),
        None => Ok(()),
    }
}

fn check_rotation(m: &[[f64; 4]; 4]) -> Result<(), CameraError> {
    if m[3] != [0.0, 0.0, 0.0, 1.0] {
        return Err(CameraError::NotRotation(format!("the last row is {:?}, expected [0, 0, 0, 1]", m[3])));
    }
    let row = |i: usize| [m[i][0], m[i][1], m[i][2]];
    for i in 0..3 {
        for j in i..3 {
            let found = crate::dot(row(i), row(j));
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
        assert!(matches!(Camera::new(0, 48, K, identity()), Err(CameraError::NoPixels(0, 48))));
    }

    #[test]
    fn downscaling_keeps_rays() {
        let camera = Camera::new(65, 48, K, identity()).unwrap().downscaled(2);
        assert_eq!((camera.width, camera.height, camera.focal, camera.principal), (32, 24, [25.0; 2], [16.0, 12.0]));
    }
}
