//! From the matrices and vectors of a calibration to a camera, with the checks that all formats need.

use tcgs_core::{MAX_COORDINATE, MAX_INTRINSIC, cross, dot};

use super::CalibratedCamera;

/// How far `R Rᵀ` may be from the identity: calibrations are stored with a few decimals.
const ROTATION_TOLERANCE: f64 = 1e-3;
/// Largest skew that counts as rounding, as a share of the focal length.
const SKEW_TOLERANCE: f64 = 1e-4;

/// The numbers of one camera in the conventions of OpenCV.
pub(super) struct OpenCvCamera {
    pub names: Vec<String>,
    pub size: Option<(usize, usize)>,
    /// `[3][3]` row-major, pixels; the centre of the first pixel is `(0, 0)`.
    pub matrix: [[f64; 3]; 3],
    /// In OpenCV's order; 0, 4, 5 or 8 numbers.
    pub distortion: Vec<f64>,
    /// `[3][3]` row-major, `camera_from_world`
    pub rotation: [[f64; 3]; 3],
    pub translation: [f64; 3],
}

impl OpenCvCamera {
    /// Checks the numbers, and moves the origin of pixels from the centre of the first pixel to its corner.
    ///
    /// - returns: the camera, or the fault as words to follow the camera's name
    pub fn checked(self) -> Result<CalibratedCamera, String> {
        let [[fx, skew, cx], [zero, fy, cy], bottom] = self.matrix;
        if self.matrix.as_flattened().iter().any(|x| !x.is_finite()) {
            return Err(format!("its matrix is {:?}, expected finite numbers", self.matrix));
        }
        if let Some(large) = self.matrix.as_flattened().iter().find(|x| x.abs() > MAX_INTRINSIC) {
            return Err(format!("its matrix has {large:e}, expected {MAX_INTRINSIC:e} or less in magnitude"));
        }
        if fx <= 0.0 || fy <= 0.0 {
            return Err(format!("has the focal lengths {fx} and {fy}, expected more than 0"));
        }
        if skew.abs() > SKEW_TOLERANCE * fx || zero != 0.0 || bottom != [0.0, 0.0, 1.0] {
            return Err(format!("its matrix is {:?}, expected [[fx, 0, cx], [0, fy, cy], [0, 0, 1]]", self.matrix));
        }
        Ok(CalibratedCamera {
            names: self.names,
            size: self.size,
            angle_x: None,
            focal: [fx, fy],
            principal: [cx + 0.5, cy + 0.5],
            distortion: distortion(&self.distortion)?,
            camera_from_world: rigid(self.rotation, self.translation)?,
        })
    }
}

/// Distortion of OpenCV, with zeros for the coefficients that a shorter list leaves out.
pub(super) fn distortion(coefficients: &[f64]) -> Result<[f64; 8], String> {
    if coefficients.iter().any(|k| !k.is_finite()) {
        return Err(format!("its distortion is {coefficients:?}, expected finite numbers"));
    }
    // Thin-prism and tilted-sensor coefficients follow; most files that have room for them hold zeros.
    let (known, others) = coefficients.split_at(coefficients.len().min(8));
    if ![0, 4, 5, 8, 12, 14].contains(&coefficients.len()) || others.iter().any(|&k| k != 0.0) {
        let found = coefficients.len();
        return Err(format!("has {found} distortion coefficients, expected 4, 5 or 8: k1 k2 p1 p2 k3 k4 k5 k6"));
    }
    Ok(std::array::from_fn(|i| known.get(i).copied().unwrap_or(0.0)))
}

/// A rigid transform `[3][4]`.
///
/// - returns: the transform, or what is wrong; the message names left-handed axes, a usual mistake
pub(super) fn rigid(rotation: [[f64; 3]; 3], translation: [f64; 3]) -> Result<[[f64; 4]; 3], String> {
    if rotation.as_flattened().iter().chain(&translation).any(|x| !x.is_finite()) {
        return Err(format!("its pose is {rotation:?}, {translation:?}, expected finite numbers"));
    }
    if let Some(far) = translation.iter().find(|x| x.abs() > MAX_COORDINATE) {
        return Err(format!("its translation has {far:e}, expected {MAX_COORDINATE:e} or less in magnitude"));
    }
    for i in 0..3 {
        for j in 0..3 {
            if (dot(rotation[i], rotation[j]) - f64::from(u8::from(i == j))).abs() > ROTATION_TOLERANCE {
                return Err(format!("its rotation is {rotation:?}, expected rows of length 1 at right angles"));
            }
        }
    }
    let [a, b, c] = rotation;
    if dot(cross(a, b), c) < 0.0 {
        return Err("its rotation has the determinant -1, expected 1: the axes are left-handed".into());
    }
    Ok(std::array::from_fn(|i| [rotation[i][0], rotation[i][1], rotation[i][2], translation[i]]))
}

/// The inverse transform.
pub(super) fn inverse(transform: [[f64; 4]; 3]) -> [[f64; 4]; 3] {
    std::array::from_fn(|i| {
        let row: [f64; 3] = std::array::from_fn(|j| transform[j][i]);
        [row[0], row[1], row[2], -dot(row, std::array::from_fn(|j| transform[j][3]))]
    })
}

/// A pixel size as a file has it: whole and positive, though some programs write it with a point.
pub(super) fn side(value: f64) -> Option<usize> {
    (value.fract() == 0.0 && (1.0..=crate::lens::MAX_SIDE as f64).contains(&value)).then_some(value as usize)
}
