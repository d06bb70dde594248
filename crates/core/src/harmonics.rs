//! Real spherical harmonics of degrees 0 to 3, and colours that depend on the direction of view.
//!
//! What lives here: the functions of one direction, and the colour of one Gaussian. What does not: the columns that hold
//! the coefficients ([`Layout::with_harmonics`](crate::Layout::with_harmonics)), and the colours of a whole timestep
//! ([`Drawable`](crate::Drawable)).

use crate::Real;

/// Highest degree of the harmonics: that of 3D Gaussian splatting.
pub const MAX_SH_DEGREE: usize = 3;

/// Value of the harmonic of degree 0 in every direction: `1 / (2 √π)`.
pub const HARMONIC_0: f64 = 0.282_094_791_773_878_14;

/// The harmonics of degrees 0 to 3 in a direction.
///
/// - `direction`: `[3]`, `x, y, z` in the world, unit. Zero gives [`HARMONIC_0`], then zeros: those of higher degree are
///   homogeneous polynomials.
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
    let c1 = of(0.488_602_511_902_919_9); // √(3 / 4π)
    let c20 = of(0.315_391_565_252_520_05); // ¼ √(5 / π)
    let c21 = of(1.092_548_430_592_079_2); // ½ √(15 / π)
    let c22 = of(0.546_274_215_296_039_6); // ¼ √(15 / π)
    let c30 = of(0.373_176_332_590_115_4); // ¼ √(7 / π)
    let c31 = of(0.457_045_799_464_465_8); // ¼ √(21 / 2π)
    let c32 = of(1.445_305_721_320_277); // ¼ √(105 / π)
    let c33 = of(0.590_043_589_926_643_5); // ¼ √(35 / 2π)
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

/// Colour of a Gaussian with harmonics as seen in a direction: `max(0, color + Σ Y_lm(direction) sh_lm)`.
///
/// - `color`: `[3]`, sRGB, what the harmonic of degree 0 gives and half a unit
/// - `sh`: `[K, 3]` coefficients of the degrees from 1 on, in the order of [`harmonics`]; `K` is 3, 8 or 15
/// - `direction`: `[3]`, from the camera to the centre of the Gaussian, unit, world
///
/// Kerbl et al. 2023 clamp at 0 likewise; colours above 1 stay.
///
/// # Panics
/// If `sh` has more than 15 rows.
pub fn color_in_direction<R: Real>(color: [R; 3], sh: &[[R; 3]], direction: [R; 3]) -> [R; 3] {
    let values = &harmonics(direction)[1..];
    assert!(sh.len() <= values.len(), "{} coefficients a channel, expected at most {}", sh.len(), values.len());
    let mut sum = color;
    for (value, sh) in values.iter().zip(sh) {
        for channel in 0..3 {
            sum[channel] = sum[channel] + *value * sh[channel];
        }
    }
    sum.map(|x| x.max(R::zero()))
}

#[cfg(test)]
mod tests {
    use std::f64::consts::PI;

    use super::*;
    use crate::dot;

    fn unit(v: [f64; 3]) -> [f64; 3] {
        let length = dot(v, v).sqrt();
        v.map(|x| x / length)
    }

    fn some_directions() -> Vec<[f64; 3]> {
        let axes = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, 0.0, -1.0]];
        let others = [[1.0, 2.0, 3.0], [-2.0, 0.5, -1.0], [0.3, -0.4, 0.5], [-1.0, -1.0, 0.1]];
        axes.into_iter().chain(others).map(unit).collect()
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
        // Gauss and Legendre's four nodes along z and 8 meridians: exact for polynomials of degree 7, and products of two
        // harmonics have degree 6.
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
            let found = harmonics(unit(direction));
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
}
