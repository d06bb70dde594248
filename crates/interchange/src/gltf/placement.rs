//! A node's placement of its mesh: a rotation, a scale and a translation, and their effect on Gaussians.

use serde::Deserialize;
use tcgs_core::{Gaussians, MAX_SH_DEGREE, cross, dot, harmonics, length, normalize, quat_mul, rotmat_from_quat};

/// Tolerance of a matrix's columns against those of a scaled rotation, as a share of the scale: the rounding of floats.
const TOLERANCE: f64 = 1e-4;

/// A node's transform as it is in the file.
#[derive(Deserialize)]
pub struct Given {
    /// Boxed, since most nodes have none.
    matrix: Option<Box<[f64; 16]>>,
    rotation: Option<[f64; 4]>,
    scale: Option<[f64; 3]>,
    translation: Option<[f64; 3]>,
}

/// From a mesh to the scene: first the scale, then the rotation, then the translation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Placement {
    /// `w, x, y, z`, unit.
    rotation: [f64; 4],
    scale: f64,
    translation: [f64; 3],
}

impl Default for Placement {
    /// The identity.
    fn default() -> Self {
        Self { rotation: [1.0, 0.0, 0.0, 0.0], scale: 1.0, translation: [0.0; 3] }
    }
}

impl Placement {
    /// The placement of a node inside this one. The error names a shear, a reflection, or unequal scales: under unequal
    /// scales the shape of a Gaussian would depend on its rotation.
    pub fn then(&self, node: &Given) -> Result<Self, String> {
        let inner = node.placement()?;
        Ok(Self {
            rotation: normalize(quat_mul(self.rotation, inner.rotation)),
            scale: self.scale * inner.scale,
            translation: self.point(inner.translation),
        })
    }

    fn point(&self, point: [f64; 3]) -> [f64; 3] {
        let rotation = rotmat_from_quat(self.rotation);
        std::array::from_fn(|c| self.scale * dot(rotation[c], point) + self.translation[c])
    }

    /// Moves Gaussians from the mesh to the scene. The identity changes no bit.
    pub fn apply(&self, gaussians: &mut Gaussians) {
        if *self == Self::default() {
            return;
        }
        let base = gaussians.views_mut();
        for mean in base.means {
            *mean = self.point(mean.map(f64::from)).map(|x| x as f32);
        }
        for quat in base.quats {
            *quat = quat_mul(self.rotation, quat.map(f64::from)).map(|x| x as f32);
        }
        let log_scale = self.scale.ln() as f32;
        base.log_scales.as_flattened_mut().iter_mut().for_each(|scale| *scale += log_scale);
        for (l, band) in (1..).zip(gaussians.layout().harmonics()) {
            let turn = turned_harmonics(self.rotation, l);
            for sh in gaussians.values_mut(band).chunks_exact_mut(band.components()) {
                let before: Vec<f64> = sh.iter().copied().map(f64::from).collect();
                for (i, to) in sh.iter_mut().enumerate() {
                    let row = &turn[i / 3];
                    *to = (0..row.len()).map(|j| row[j] * before[3 * j + i % 3]).sum::<f64>() as f32;
                }
            }
        }
    }
}

impl Given {
    fn placement(&self) -> Result<Placement, String> {
        let (columns, translation) = match &self.matrix {
            Some(matrix) => {
                let column = |c: usize| [matrix[4 * c], matrix[4 * c + 1], matrix[4 * c + 2]];
                ([column(0), column(1), column(2)], column(3))
            }
            None => {
                let [x, y, z, w] = self.rotation.unwrap_or([0.0, 0.0, 0.0, 1.0]);
                let (rotation, scale) = (rotmat_from_quat([w, x, y, z]), self.scale.unwrap_or([1.0; 3]));
                let column = |c: usize| [0, 1, 2].map(|r| rotation[r][c] * scale[c]);
                ([column(0), column(1), column(2)], self.translation.unwrap_or([0.0; 3]))
            }
        };
        let lengths = columns.map(length);
        let scale = lengths[0];
        let axes = columns.map(normalize);
        let [a, b, c] = axes;
        let is_even = lengths.iter().all(|length| (length - scale).abs() <= TOLERANCE * scale);
        // The third axis of a rotation is across the first two.
        let is_rotation = dot(a, b).abs() <= TOLERANCE && (dot(cross(a, b), c) - 1.0).abs() <= TOLERANCE;
        if !(is_even && is_rotation && scale > 0.0 && scale.is_finite() && translation.iter().all(|x| x.is_finite())) {
            return Err("is placed by another transform, expected a rotation, one scale and a translation".into());
        }
        let rotation = std::array::from_fn(|r| std::array::from_fn(|c| axes[c][r]));
        Ok(Placement { rotation: quat_from_rotmat(rotation), scale, translation })
    }
}

/// The unit quaternion, `w, x, y, z`, of a rotation matrix: the largest of the four comes from the diagonal.
fn quat_from_rotmat(m: [[f64; 3]; 3]) -> [f64; 4] {
    let signs = [[1.0, 1.0, 1.0], [1.0, -1.0, -1.0], [-1.0, 1.0, -1.0], [-1.0, -1.0, 1.0]];
    let squares = signs.map(|[x, y, z]| 1.0 + x * m[0][0] + y * m[1][1] + z * m[2][2]);
    let largest = (0..4).max_by(|&i, &j| squares[i].total_cmp(&squares[j])).unwrap_or(0);
    let (x, y, z) = (m[2][1] - m[1][2], m[0][2] - m[2][0], m[1][0] - m[0][1]);
    let (xy, xz, yz) = (m[0][1] + m[1][0], m[0][2] + m[2][0], m[1][2] + m[2][1]);
    let square = squares[largest];
    normalize(match largest {
        0 => [square, x, y, z],
        1 => [x, square, xy, xz],
        2 => [y, xy, square, yz],
        _ => [z, xz, yz, square],
    })
}

/// How the coefficients of degree `l` turn: `∫ Y_li(R d) Y_lj(d)` over the sphere, `[2 l + 1][2 l + 1]`.
///
/// Four nodes of Gauss and Legendre along z and eight meridians are exact for polynomials of degree 7; these have 6.
fn turned_harmonics(rotation: [f64; 4], l: usize) -> Vec<Vec<f64>> {
    debug_assert!(l <= MAX_SH_DEGREE);
    let rotation = rotmat_from_quat(rotation);
    let count = 2 * l + 1;
    let mut turn = vec![vec![0.0; count]; count];
    for sign in [-1.0, 1.0] {
        let node = (3.0_f64 / 7.0 + sign * 2.0 / 7.0 * 1.2_f64.sqrt()).sqrt();
        let weight = (18.0 - sign * 30.0_f64.sqrt()) / 36.0 * (std::f64::consts::PI / 4.0);
        for z in [node, -node] {
            for meridian in 0..8 {
                let (sin, cos) = (f64::from(meridian) * std::f64::consts::PI / 4.0).sin_cos();
                let ring = (1.0 - z * z).sqrt();
                let direction = [ring * cos, ring * sin, z];
                let before = harmonics(direction);
                let after = harmonics(rotation.map(|row| dot(row, direction)));
                for (i, row) in turn.iter_mut().enumerate() {
                    for (j, entry) in row.iter_mut().enumerate() {
                        *entry += weight * after[l * l + i] * before[l * l + j];
                    }
                }
            }
        }
    }
    turn
}

#[cfg(test)]
mod tests {
    use tcgs_core::{Layout, color_in_direction};

    use super::*;

    #[test]
    fn a_scene_seen_from_within_looks_as_before() {
        let mut gaussians = Gaussians::zeros_of(&Layout::with_harmonics(3), 1);
        gaussians.means_mut()[0] = [1.0, 2.0, 3.0];
        gaussians.quats_mut()[0] = [0.3, -0.5, 0.7, 0.2];
        for band in gaussians.layout().harmonics() {
            gaussians.values_mut(band).iter_mut().enumerate().for_each(|(i, x)| *x = (i as f32 * 1.3).sin());
        }
        let coefficients = |gaussians: &Gaussians| -> Vec<[f32; 3]> {
            let bands = gaussians.layout().harmonics();
            bands.iter().flat_map(|&band| gaussians.values(band).as_chunks().0.to_vec()).collect()
        };
        let given = |rotation, scale| Given { matrix: None, rotation, scale, translation: Some([0.5, 0.0, -1.0]) };
        for quat in [[0.0, 0.0, 0.0, 1.0], [0.5, -0.5, 0.1, 0.7], [1.0, 0.0, 0.0, 0.0], [0.1, 0.2, 0.97, 0.0]] {
            let placement = Placement::default().then(&given(Some(quat), Some([2.0; 3]))).unwrap();
            let rotation = rotmat_from_quat([quat[3], quat[0], quat[1], quat[2]]);
            let mut placed = gaussians.clone();
            placement.apply(&mut placed);
            let expected = [0.5, 0.0, -1.0].iter().zip(rotation).map(|(t, row)| t + 2.0 * dot(row, [1.0, 2.0, 3.0]));
            for (found, expected) in placed.means()[0].iter().zip(expected) {
                assert!((f64::from(*found) - expected).abs() < 1e-6);
            }
            assert!((placed.log_scales()[0][1] - 2.0_f32.ln()).abs() < 1e-6);
            let (before, after) = (
                rotmat_from_quat(gaussians.quats()[0].map(f64::from)),
                rotmat_from_quat(placed.quats()[0].map(f64::from)),
            );
            for r in 0..3 {
                for c in 0..3 {
                    let expected: f64 = (0..3).map(|k| rotation[r][k] * before[k][c]).sum();
                    assert!((after[r][c] - expected).abs() < 1e-6);
                }
            }
            for direction in [[0.6, 0.0, 0.8], [-0.36, 0.48, 0.8], [0.0, -0.6, -0.8]] {
                let there = rotation.map(|row| dot(row, direction) as f32);
                let seen = color_in_direction([5.0; 3], &coefficients(&gaussians), direction.map(|x| x as f32));
                let seen_there = color_in_direction([5.0; 3], &coefficients(&placed), there);
                assert!((0..3).all(|c| (seen[c] - seen_there[c]).abs() < 1e-5), "{seen:?} {seen_there:?}");
            }
        }
        let mut same = gaussians.clone();
        Placement::default().apply(&mut same);
        assert_eq!(same, gaussians);
        for scale in [[1.0, 1.0, 2.0], [-1.0, 1.0, 1.0], [0.0; 3], [f64::NAN; 3]] {
            assert!(Placement::default().then(&given(None, Some(scale))).is_err(), "{scale:?}");
        }
    }
}
