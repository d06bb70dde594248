//! Real spherical harmonics of degrees 0 to 3, and colours that depend on the direction of view.
//!
//! What lives here: the functions of one direction, and the colour of one Gaussian. What does not: the columns that
//! hold the coefficients ([`Layout::with_harmonics`](crate::Layout::with_harmonics)), and the colours of a whole
//! timestep ([`Drawable`](crate::Drawable)).

use crate::{Real, dot};

/// Highest degree of the harmonics: that of 3D Gaussian splatting.
pub const MAX_SH_DEGREE: usize = 3;

/// Value of the harmonic of degree 0 in every direction: `1 / (2 √π)`.
pub const HARMONIC_0: f64 = 0.282_094_791_773_878_14;

// The factors of the harmonics, without their signs.
const C1: f64 = 0.488_602_511_902_919_9; // √(3 / 4π)
const C20: f64 = 0.315_391_565_252_520_05; // ¼ √(5 / π)
const C21: f64 = 1.092_548_430_592_079_2; // ½ √(15 / π)
const C22: f64 = 0.546_274_215_296_039_6; // ¼ √(15 / π)
const C30: f64 = 0.373_176_332_590_115_4; // ¼ √(7 / π)
const C31: f64 = 0.457_045_799_464_465_8; // ¼ √(21 / 2π)
const C32: f64 = 1.445_305_721_320_277; // ¼ √(105 / π)
const C33: f64 = 0.590_043_589_926_643_5; // ¼ √(35 / 2π)

/// The harmonics of degrees 0 to 3 in a direction.
///
/// - `direction`: `[3]`, `x, y, z` in the world, unit. Zero gives [`HARMONIC_0`], then zeros: those of higher degree
///   are homogeneous polynomials.
/// - returns: `Y_lm` in the order of `l`, then `m` from `-l` to `l`
///
/// Orthonormal on the sphere. The signs are those of 3D Gaussian splatting (Kerbl et al. 2023) and gsplat: with the
/// phase `(-1)^m` of Condon and Shortley, `sin(|m| φ)` for `m < 0` and `cos(m φ)` for `m > 0`. Sloan, "Stupid Spherical
/// Harmonics (SH) Tricks", 2008, appendix A2.
///
/// ```
/// let up = tcgs_core::harmonics([0.0, 0.0, 1.0_f64]);
/// assert!((up[2] - (3.0 / (4.0 * std::f64::consts::PI)).sqrt()).abs() < 1e-15);
/// assert_eq!((up[1], up[3]), (0.0, 0.0));
/// ```
#[inline]
pub fn harmonics<R: Real>(direction: [R; 3]) -> [R; 16] {
    let [x, y, z] = direction;
    let (xx, yy, zz) = (x * x, y * y, z * z);
    let of = R::of;
    let (two, three, four) = (of(2.0), of(3.0), of(4.0));
    let (c1, c20, c21, c22) = (of(C1), of(C20), of(C21), of(C22));
    let (c30, c31, c32, c33) = (of(C30), of(C31), of(C32), of(C33));
    [
        of(HARMONIC_0),
        -c1 * y,
        c1 * z,
        -c1 * x,
        c21 * x * y,
        -c21 * y * z,
        c20 * (two * zz - xx - yy),
        -c21 * x * z,
        c22 * (xx - yy),
        -c33 * y * (three * xx - yy),
        two * c32 * x * y * z,
        -c31 * y * (four * zz - xx - yy),
        c30 * z * (two * zz - three * xx - three * yy),
        -c31 * x * (four * zz - xx - yy),
        c32 * z * (xx - yy),
        -c33 * x * (xx - three * yy),
    ]
}

/// VJP of [`harmonics`].
///
/// - `direction`: as given to `harmonics`
/// - `v_values`: `∂L/∂Y_lm`, in the order of `harmonics`
/// - returns: `∂L/∂direction`, without the constraint of unit length
#[inline]
pub fn harmonics_vjp<R: Real>(direction: [R; 3], v_values: &[R; 16]) -> [R; 3] {
    let [x, y, z] = direction;
    let (xx, yy, zz) = (x * x, y * y, z * z);
    let of = R::of;
    let (two, three, four, six, eight) = (of(2.0), of(3.0), of(4.0), of(6.0), of(8.0));
    let (c1, c20, c21, c22) = (of(C1), of(C20), of(C21), of(C22));
    let (c30, c31, c32, c33) = (of(C30), of(C31), of(C32), of(C33));
    let v = v_values;
    let degree_1 = [-c1 * v[3], -c1 * v[1], c1 * v[2]];
    let degree_2 = [
        c21 * (y * v[4] - z * v[7]) + two * x * (c22 * v[8] - c20 * v[6]),
        c21 * (x * v[4] - z * v[5]) - two * y * (c22 * v[8] + c20 * v[6]),
        four * c20 * z * v[6] - c21 * (y * v[5] + x * v[7]),
    ];
    let degree_3 = [
        two * c32 * z * (y * v[10] + x * v[14]) + two * c31 * x * y * v[11]
            - six * (c33 * x * y * v[9] + c30 * x * z * v[12])
            - c31 * (four * zz - three * xx - yy) * v[13]
            - three * c33 * (xx - yy) * v[15],
        two * c32 * z * (x * v[10] - y * v[14])
            + two * c31 * x * y * v[13]
            + six * (c33 * x * y * v[15] - c30 * y * z * v[12])
            - c31 * (four * zz - xx - three * yy) * v[11]
            - three * c33 * (xx - yy) * v[9],
        c32 * (two * x * y * v[10] + (xx - yy) * v[14]) - eight * c31 * z * (y * v[11] + x * v[13])
            + three * c30 * (two * zz - xx - yy) * v[12],
    ];
    std::array::from_fn(|axis| degree_1[axis] + degree_2[axis] + degree_3[axis])
}

/// Colour of a Gaussian with harmonics as seen in a direction: `max(0, color + Σ Y_lm(direction) sh_lm)`.
/// - `color`: `[3]`, sRGB, the contribution of the harmonic of degree 0 plus ½
/// - `sh`: `[K, 3]` coefficients of the degrees from 1 on, in the order of [`harmonics`]; `K` is 3, 8 or 15
/// - `sh`: `[K, 3]` coefficients of the degrees from 1 on, in the order of [`harmonics`]; `K` is 3, 8 or 15
/// - `direction`: `[3]`, from the camera to the centre of the Gaussian, unit, world
///
/// Kerbl et al. 2023 clamp at 0 likewise; colours above 1 stay.
///
/// # Panics
/// If `sh` has more than 15 rows.
pub fn color_in_direction<R: Real>(color: [R; 3], sh: &[[R; 3]], direction: [R; 3]) -> [R; 3] {
    sum_in_direction(color, sh, &harmonics(direction)).map(|x| x.max(R::zero()))
}

/// VJP of [`color_in_direction`]: clamped channels pass no gradient.
///
/// - `color`, `sh`, `direction`: as given to `color_in_direction`
/// - `v_seen`: `∂L/∂` the colour that it returned
/// - returns: `(v_sum, v_direction)`. `v_sum` is `∂L/∂color`, and `Y_lm(direction) v_sum` is `∂L/∂sh_lm`;
///   `v_direction` is without the constraint of unit length
///
/// # Panics
/// As `color_in_direction`.
pub fn color_in_direction_vjp<R: Real>(
    color: [R; 3],
    sh: &[[R; 3]],
    direction: [R; 3],
    v_seen: [R; 3],
) -> ([R; 3], [R; 3]) {
    let sum = sum_in_direction(color, sh, &harmonics(direction));
    let v_sum = std::array::from_fn(|c| if sum[c] > R::zero() { v_seen[c] } else { R::zero() });
    let mut v_values = [R::zero(); 16];
    for (v_value, &sh) in v_values[1..].iter_mut().zip(sh) {
        *v_value = dot(sh, v_sum);
    }
    (v_sum, harmonics_vjp(direction, &v_values))
}

/// `color + Σ Y_lm sh_lm`.
///
/// - `values`: of [`harmonics`]
fn sum_in_direction<R: Real>(color: [R; 3], sh: &[[R; 3]], values: &[R; 16]) -> [R; 3] {
    let values = &values[1..];
    assert!(sh.len() <= values.len(), "{} coefficients a channel, expected at most {}", sh.len(), values.len());
    let mut sum = color;
    for (value, sh) in values.iter().zip(sh) {
        for channel in 0..3 {
            sum[channel] = sum[channel] + *value * sh[channel];
        }
    }
    sum
}

#[cfg(test)]
mod tests {
    use std::f64::consts::PI;

    use super::*;
    use crate::normalize;

    fn some_directions() -> Vec<[f64; 3]> {
        let axes = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, 0.0, -1.0]];
        let others = [[1.0, 2.0, 3.0], [-2.0, 0.5, -1.0], [0.3, -0.4, 0.5], [-1.0, -1.0, 0.1]];
        axes.into_iter().chain(others).map(normalize).collect()
    }

    /// Legendre polynomial `P_l^m`, `0 <= m <= l`, with the phase of Condon and Shortley, by its recurrence.
    fn legendre(l: usize, m: usize, x: f64) -> f64 {
        let sin = (1.0 - x * x).sqrt();
        let mut diagonal = 1.0;
        for i in 1..=m {
            diagonal *= -((2 * i - 1) as f64) * sin;
        }
        let (mut before, mut value) = (0.0, diagonal);
        for i in m + 1..=l {
            let next = ((2 * i - 1) as f64 * x * value - (i + m - 1) as f64 * before) / (i - m) as f64;
            (before, value) = (value, next);
        }
        value
    }

    fn factorial(n: usize) -> f64 {
        (1..=n).map(|i| i as f64).product()
    }

    /// `Y_lm` from its definition, in spherical coordinates.
    fn by_definition(l: usize, m: i32, [x, y, z]: [f64; 3]) -> f64 {
        let order = m.unsigned_abs() as usize;
        let scale = ((2 * l + 1) as f64 / (4.0 * PI) * factorial(l - order) / factorial(l + order)).sqrt();
        let (phi, p) = (order as f64 * y.atan2(x), legendre(l, order, z));
        match m.signum() {
            0 => scale * p,
            1 => 2.0_f64.sqrt() * scale * phi.cos() * p,
            _ => 2.0_f64.sqrt() * scale * phi.sin() * p,
        }
    }

    #[test]
    fn they_are_those_of_the_definition() {
        for direction in some_directions() {
            let found = harmonics(direction);
            let mut index = 0;
            for l in 0..=MAX_SH_DEGREE {
                for m in -(l as i32)..=l as i32 {
                    let expected = by_definition(l, m, direction);
                    assert!((found[index] - expected).abs() < 1e-14, "l {l}, m {m}, {direction:?}: {found:?}");
                    index += 1;
                }
            }
            assert_eq!(index, 16);
        }
    }

    #[test]
    fn they_are_orthonormal_on_the_sphere() {
        // Gauss and Legendre's four nodes along z and 8 meridians: exact for polynomials of degree 7, and products of
        // two harmonics have degree 6.
        let nodes = [-1.0, 1.0].map(|sign| (3.0_f64 / 7.0 + sign * 2.0 / 7.0 * 1.2_f64.sqrt()).sqrt());
        let weights = [1.0, -1.0].map(|sign| (18.0 + sign * 30.0_f64.sqrt()) / 36.0);
        let mut gram = [[0.0; 16]; 16];
        for (node, weight) in nodes.into_iter().zip(weights) {
            for z in [node, -node] {
                for meridian in 0..8 {
                    let (sin, cos) = (f64::from(meridian) * PI / 4.0 + 0.1).sin_cos();
                    let ring = (1.0 - z * z).sqrt();
                    let values = harmonics([ring * cos, ring * sin, z]);
                    for i in 0..16 {
                        for j in 0..16 {
                            gram[i][j] += weight * (2.0 * PI / 8.0) * values[i] * values[j];
                        }
                    }
                }
            }
        }
        for (i, row) in gram.iter().enumerate() {
            for (j, product) in row.iter().enumerate() {
                let expected = if i == j { 1.0 } else { 0.0 };
                assert!((product - expected).abs() < 1e-13, "{i}, {j}: {product}");
            }
        }
    }

    #[test]
    fn each_degree_depends_on_the_angle_between_directions_alone() {
        // The addition theorem: Σ_m Y_lm(a) Y_lm(b) = (2 l + 1) / 4π P_l(a · b). No rotation of both changes it.
        for a in some_directions() {
            for b in some_directions() {
                let (of_a, of_b) = (harmonics(a), harmonics(b));
                for l in 0..=MAX_SH_DEGREE {
                    let of_degree = l * l..(l + 1) * (l + 1);
                    let sum: f64 = of_degree.map(|i| of_a[i] * of_b[i]).sum();
                    let expected = (2 * l + 1) as f64 / (4.0 * PI) * legendre(l, 0, dot(a, b).clamp(-1.0, 1.0));
                    assert!((sum - expected).abs() < 1e-13, "l {l}, {a:?}, {b:?}: {sum}");
                }
            }
        }
    }

    /// Values that `_eval_sh_bases_fast` of gsplat 1.5.3 (`cuda/_torch_impl.py`) gives in double precision, in the
    /// directions of (1, 2, 3), (-2, 0.5, -1) and (0.3, -0.4, 0.5), rounded to twelve digits.
    #[rustfmt::skip]
    const OF_GSPLAT: [([f64; 3], [f64; 16]); 3] = [
        ([1.0, 2.0, 3.0], [
            0.282094791774, -0.261169028265, 0.391753542398, -0.130584514133,
            0.156078347227, -0.468235041682, 0.292863596306, -0.234117520841, -0.117058760421,
            0.0225279689466, 0.331092173163, -0.540952781035, 0.0641157236359, -0.270476390518, -0.248319129872,
            0.123903829206,
        ]),
        ([-2.0, 0.5, -1.0], [
            0.282094791774, -0.106621809311, -0.213243618623, 0.426487237246,
            -0.20810446297, 0.104052231485, -0.13516781368, -0.41620892594, 0.390195868069,
            -0.288172817382, 0.24029833543, 0.00474931286192, 0.333490603362, -0.0189972514477, -0.450559378932,
            0.318829500083,
        ]),
        ([0.3, -0.4, 0.5], [
            0.282094791774, 0.276395319577, 0.345494149471, -0.207296489683,
            -0.262211623342, 0.437019372237, 0.157695782626, -0.327764529178, -0.0764783901414,
            0.0734313929594, -0.490553028688, 0.387816220937, -0.131937757676, -0.290862165703, -0.143077966701,
            0.19526074946,
        ]),
    ];

    #[test]
    fn they_are_those_of_gsplat() {
        for (direction, expected) in OF_GSPLAT {
            let found = harmonics(normalize(direction));
            for (i, (found, expected)) in found.into_iter().zip(expected).enumerate() {
                assert!((found - expected).abs() < 1e-12, "{direction:?}, {i}: {found} against {expected}");
            }
        }
    }

    #[test]
    fn a_colour_is_its_coefficients_by_hand_and_never_below_zero() {
        let mut sh = [[0.0; 3]; 3];
        sh[1] = [0.2, 0.0, -2.0]; // Y_10 = √(3/4π) z
        sh[2] = [0.0, 0.3, 0.0]; // Y_11 = -√(3/4π) x
        let y = (3.0 / (4.0 * PI)).sqrt();
        let near = |found: [f64; 3], expected: [f64; 3]| {
            assert!((0..3).all(|c| (found[c] - expected[c]).abs() < 1e-15), "{found:?} {expected:?}");
        };
        near(color_in_direction([0.5; 3], &sh, [0.0, 0.0, 1.0]), [0.5 + 0.2 * y, 0.5, 0.0]);
        near(color_in_direction([0.5; 3], &sh, [0.0, 0.0, -1.0]), [0.5 - 0.2 * y, 0.5, 0.5 + 2.0 * y]);
        near(color_in_direction([0.5; 3], &sh, [1.0, 0.0, 0.0]), [0.5, 0.5 - 0.3 * y, 0.5]);
        near(color_in_direction([0.5; 3], &sh, [0.0; 3]), [0.5; 3]);
        near(color_in_direction([-0.1, 0.2, 1.5], &[], [0.0, 0.0, 1.0]), [0.0, 0.2, 1.5]);
    }

    #[test]
    fn backward_matches_central_differences() {
        let h = 1e-6;
        for direction in some_directions() {
            for index in 0..16 {
                let mut v_values = [0.0; 16];
                v_values[index] = 1.0;
                let gradient = harmonics_vjp(direction, &v_values);
                for axis in 0..3 {
                    let at = |by: f64| {
                        let mut moved = direction;
                        moved[axis] += by;
                        harmonics(moved)[index]
                    };
                    let difference = (at(h) - at(-h)) / (2.0 * h);
                    assert!((gradient[axis] - difference).abs() < 1e-8, "{index}, {axis}, {direction:?}");
                }
            }
        }

        // A colour: green is clamped here.
        let direction = normalize([0.3, -0.4, 0.5]);
        let sh: Vec<[f64; 3]> = (0..15).map(|i| [0, 1, 2].map(|c| 0.2 * (f64::from(3 * i + c) + 0.5).sin())).collect();
        let (color, v_seen) = ([0.5, -3.0, 0.7], [0.3, -0.8, 1.1]);
        let loss = |color, sh: &[[f64; 3]], direction| dot(color_in_direction(color, sh, direction), v_seen);
        let (v_sum, v_direction) = color_in_direction_vjp(color, &sh, direction, v_seen);
        assert_eq!(v_sum, [0.3, 0.0, 1.1]);
        for axis in 0..3 {
            let at = |by: f64| {
                let mut moved = direction;
                moved[axis] += by;
                loss(color, &sh, moved)
            };
            assert!((v_direction[axis] - (at(h) - at(-h)) / (2.0 * h)).abs() < 1e-8, "direction {axis}");
        }
        let values = harmonics(direction);
        for (index, channel) in (0..15).flat_map(|i| [0, 1, 2].map(|c| (i, c))) {
            let at = |by: f64| {
                let mut moved = sh.clone();
                moved[index][channel] += by;
                loss(color, &moved, direction)
            };
            let difference = (at(h) - at(-h)) / (2.0 * h);
            assert!((values[index + 1] * v_sum[channel] - difference).abs() < 1e-8, "{index}, {channel}");
        }
    }
}
