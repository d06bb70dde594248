//! The normal equations of a bundle adjustment, and their solution.

use tcgs_core::{cross, dot};

use super::bundle::{Track, residual};
use super::camera::{PARAMETERS, RigCamera};

/// Steps of all cameras and of all points.
type Steps = (Vec<[f64; PARAMETERS]>, Vec<[f64; 3]>);

/// The normal equations around one linearisation point.
pub(super) struct System {
    /// `[8 C, 8 C]` of the cameras, and their right side.
    cameras: Vec<f64>,
    right: Vec<f64>,
    num: usize,
    tracks: Vec<Normal>,
}

/// Normal equations of one track.
struct Normal {
    /// `[3][3]` of the point, and its right side.
    point: [[f64; 3]; 3],
    right: [f64; 3],
    /// `[8][3]` of each camera that sees the point.
    mixed: Vec<(usize, [[f64; 3]; PARAMETERS])>,
}

impl System {
    pub fn new(
        cameras: &[RigCamera],
        tracks: &[Track],
        changes: &[[f64; PARAMETERS]],
        weights: &[f64; PARAMETERS],
        scale: f64,
        is_free: &[bool],
    ) -> Self {
        let num = cameras.len() * PARAMETERS;
        let mut system = Self { cameras: vec![0.0; num * num], right: vec![0.0; num], num, tracks: Vec::new() };
        for (camera, change) in changes.iter().enumerate() {
            for k in 0..PARAMETERS {
                let i = camera * PARAMETERS + k;
                system.cameras[i * num + i] += weights[k];
                system.right[i] -= weights[k] * change[k];
            }
        }
        for track in tracks {
            let mut normal = Normal { point: [[0.0; 3]; 3], right: [0.0; 3], mixed: Vec::new() };
            for &(index, pixel) in &track.seen {
                let camera = &cameras[index];
                let Some(slopes) = Slopes::new(camera, track.point) else { continue };
                let error = residual(camera, track.point, pixel);
                let weight = 1.0 / (1.0 + (error[0].powi(2) + error[1].powi(2)) / (scale * scale));
                let mut mixed = [[0.0; 3]; PARAMETERS];
                for axis in 0..2 {
                    let (a, b) = (slopes.camera[axis], slopes.point[axis]);
                    for k in 0..3 {
                        for l in 0..3 {
                            normal.point[k][l] += weight * b[k] * b[l];
                        }
                        normal.right[k] -= weight * b[k] * error[axis];
                    }
                    if !is_free[index] {
                        continue;
                    }
                    let begin = index * PARAMETERS;
                    for k in 0..PARAMETERS {
                        for l in 0..PARAMETERS {
                            system.cameras[(begin + k) * num + begin + l] += weight * a[k] * a[l];
                        }
                        for l in 0..3 {
                            mixed[k][l] += weight * a[k] * b[l];
                        }
                        system.right[begin + k] -= weight * a[k] * error[axis];
                    }
                }
                normal.mixed.push((index, mixed));
            }
            system.tracks.push(normal);
        }
        system
    }

    /// - returns: the step of each camera and point, `None` if the system cannot be solved at this damping
    pub fn solve(&self, damping: f64) -> Option<Steps> {
        let num = self.num;
        let mut matrix = self.cameras.clone();
        let mut right = self.right.clone();
        for i in 0..num {
            matrix[i * num + i] *= 1.0 + damping;
        }
        let mut inverses = Vec::with_capacity(self.tracks.len());
        for track in &self.tracks {
            let mut point = track.point;
            for (k, row) in point.iter_mut().enumerate() {
                row[k] = row[k] * (1.0 + damping) + 1e-12;
            }
            let inverse = inverse(point)?;
            for (i, (camera, mixed)) in track.mixed.iter().enumerate() {
                // Y = W V⁻¹
                let y: [[f64; 3]; PARAMETERS] =
                    std::array::from_fn(|k| std::array::from_fn(|l| (0..3).map(|m| mixed[k][m] * inverse[m][l]).sum()));
                for k in 0..PARAMETERS {
                    right[camera * PARAMETERS + k] -= dot(y[k], track.right);
                }
                for (other, of_other) in &track.mixed[i..] {
                    for k in 0..PARAMETERS {
                        for l in 0..PARAMETERS {
                            let value = dot(y[k], of_other[l]);
                            let (row, column) = (camera * PARAMETERS + k, other * PARAMETERS + l);
                            matrix[row * num + column] -= value;
                            if other != camera {
                                matrix[column * num + row] -= value;
                            }
                        }
                    }
                }
            }
            inverses.push(inverse);
        }
        let step = solve_positive(&mut matrix, right, num)?;
        let moves: Vec<[f64; PARAMETERS]> = step.as_chunks::<PARAMETERS>().0.to_vec();
        let points = self.tracks.iter().zip(&inverses).map(|(track, inverse)| {
            let mut right = track.right;
            for (camera, mixed) in &track.mixed {
                for (k, row) in mixed.iter().enumerate() {
                    for l in 0..3 {
                        right[l] -= row[l] * moves[*camera][k];
                    }
                }
            }
            inverse.map(|row| dot(row, right))
        });
        let points = points.collect();
        Some((moves, points))
    }
}

/// Derivatives of a pixel by its camera and its point, by central differences.
pub(super) struct Slopes {
    pub camera: [[f64; PARAMETERS]; 2],
    pub point: [[f64; 3]; 2],
}

impl Slopes {
    pub fn new(camera: &RigCamera, point: [f64; 3]) -> Option<Self> {
        let depth = camera.camera_point(point)[2];
        if depth <= 0.0 {
            return None;
        }
        let mut slopes = Self { camera: [[0.0; PARAMETERS]; 2], point: [[0.0; 3]; 2] };
        for k in 0..PARAMETERS {
            let step = if (3..6).contains(&k) { 1e-6 * depth } else { 1e-6 };
            let at = |step: f64| {
                let mut change = [0.0; PARAMETERS];
                change[k] = step;
                camera.moved(&change).project(point)
            };
            let (ahead, back) = (at(step)?, at(-step)?);
            for axis in 0..2 {
                slopes.camera[axis][k] = (ahead[axis] - back[axis]) / (2.0 * step);
            }
        }
        for k in 0..3 {
            let step = 1e-6 * depth;
            let at = |step: f64| {
                let mut moved = point;
                moved[k] += step;
                camera.project(moved)
            };
            let (ahead, back) = (at(step)?, at(-step)?);
            for axis in 0..2 {
                slopes.point[axis][k] = (ahead[axis] - back[axis]) / (2.0 * step);
            }
        }
        Some(slopes)
    }
}

/// Inverse of a symmetric matrix; `None` if it is singular.
pub(super) fn inverse(m: [[f64; 3]; 3]) -> Option<[[f64; 3]; 3]> {
    let columns = [cross(m[1], m[2]), cross(m[2], m[0]), cross(m[0], m[1])];
    let determinant = dot(m[0], columns[0]);
    let largest = m[0][0] * m[1][1] * m[2][2];
    if !determinant.is_finite() || determinant.abs() <= 1e-14 * largest.abs() {
        return None;
    }
    Some(std::array::from_fn(|i| std::array::from_fn(|j| columns[j][i] / determinant)))
}

/// Solves `matrix x = right` of a positive definite matrix by Cholesky's decomposition, in place.
pub(super) fn solve_positive(matrix: &mut [f64], mut right: Vec<f64>, num: usize) -> Option<Vec<f64>> {
    for j in 0..num {
        for k in 0..j {
            let factor = matrix[j * num + k];
            if factor != 0.0 {
                for i in j..num {
                    matrix[i * num + j] -= matrix[i * num + k] * factor;
                }
            }
        }
        let pivot = matrix[j * num + j];
        if !(pivot.is_finite() && pivot > 0.0) {
            return None;
        }
        let root = pivot.sqrt();
        for i in j..num {
            matrix[i * num + j] /= root;
        }
    }
    for i in 0..num {
        let sum: f64 = (0..i).map(|k| matrix[i * num + k] * right[k]).sum();
        right[i] = (right[i] - sum) / matrix[i * num + i];
    }
    for i in (0..num).rev() {
        let sum: f64 = (i + 1..num).map(|k| matrix[k * num + i] * right[k]).sum();
        right[i] = (right[i] - sum) / matrix[i * num + i];
    }
    Some(right)
}
