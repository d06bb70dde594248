//! Quaternions (`w, x, y, z`) and their rotation matrices, each beside its vector-Jacobian product.

use crate::{Real, length, normalize, normalize_vjp};

/// Hamilton product `a ⊗ b`: rotate by `b`, then by `a`.
///
/// - `a`, `b`: `[4]`, `w, x, y, z`
#[inline(always)]
pub fn quat_mul<R: Real>(a: [R; 4], b: [R; 4]) -> [R; 4] {
    let [aw, ax, ay, az] = a;
    let [bw, bx, by, bz] = b;
    [
        aw * bw - ax * bx - ay * by - az * bz,
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
    ]
}

/// VJP of [`quat_mul`]: gradients to `a` and `b`.
///
/// The product is bilinear and norms multiply, so each gradient is the incoming one times the
/// other factor's conjugate.
#[inline(always)]
pub fn quat_mul_vjp<R: Real>(a: [R; 4], b: [R; 4], v_product: [R; 4]) -> ([R; 4], [R; 4]) {
    (quat_mul(v_product, quat_conjugate(b)), quat_mul(quat_conjugate(a), v_product))
}

/// Conjugate; the inverse of a unit quaternion.
#[inline(always)]
pub fn quat_conjugate<R: Real>(q: [R; 4]) -> [R; 4] {
    [q[0], -q[1], -q[2], -q[3]]
}

/// Rotation matrix of a unit quaternion.
///
/// - `quat`: `[4]`, `w, x, y, z`, unit length (not normalised here)
/// - returns: `[3][3]` row-major, `world_from_local`
///
/// Kerbl et al. 2023, §4 (`R` in `Σ = R S Sᵀ Rᵀ`).
#[inline(always)]
pub fn rotmat_from_unit_quat<R: Real>(quat: [R; 4]) -> [[R; 3]; 3] {
    let [w, x, y, z] = quat;
    let (one, two) = (R::one(), R::of(2.0));
    [
        [one - two * (y * y + z * z), two * (x * y - w * z), two * (x * z + w * y)],
        [two * (x * y + w * z), one - two * (x * x + z * z), two * (y * z - w * x)],
        [two * (x * z - w * y), two * (y * z + w * x), one - two * (x * x + y * y)],
    ]
}

/// VJP of [`rotmat_from_unit_quat`], without the constraint of unit length.
///
/// - `v_rotmat`: `∂L/∂R`
/// - returns: `∂L/∂quat`
#[inline(always)]
pub fn rotmat_from_unit_quat_vjp<R: Real>(quat: [R; 4], v_rotmat: [[R; 3]; 3]) -> [R; 4] {
    let [w, x, y, z] = quat;
    let v = v_rotmat;
    let two = R::of(2.0);
    let xx = v[0][0] + v[1][1] + v[2][2];
    [
        two * (x * (v[2][1] - v[1][2]) + y * (v[0][2] - v[2][0]) + z * (v[1][0] - v[0][1])),
        two * (y * (v[0][1] + v[1][0]) + z * (v[0][2] + v[2][0]) + w * (v[2][1] - v[1][2]) - two * x * (xx - v[0][0])),
        two * (x * (v[0][1] + v[1][0]) + z * (v[1][2] + v[2][1]) + w * (v[0][2] - v[2][0]) - two * y * (xx - v[1][1])),
        two * (x * (v[0][2] + v[2][0]) + y * (v[1][2] + v[2][1]) + w * (v[1][0] - v[0][1]) - two * z * (xx - v[2][2])),
    ]
}

/// Rotation matrix of a quaternion; normalises first.
///
/// - `quat`: `[4]`, order `w, x, y, z`, any non-zero length
/// - returns: `[3][3]` row-major, `world_from_local`
///
/// Kerbl et al. 2023, §4 (`R` in `Σ = R S Sᵀ Rᵀ`).
///
/// ```
/// let r = tcgs_core::rotmat_from_quat([1.0_f64, 0.0, 0.0, 1.0]); // a quarter turn about z
/// assert!((r[1][0] - 1.0).abs() < 1e-12);
/// ```
#[inline(always)]
pub fn rotmat_from_quat<R: Real>(quat: [R; 4]) -> [[R; 3]; 3] {
    rotmat_from_unit_quat(normalize(quat))
}

/// VJP of [`rotmat_from_quat`].
#[inline(always)]
pub fn rotmat_from_quat_vjp<R: Real>(quat: [R; 4], v_rotmat: [[R; 3]; 3]) -> [R; 4] {
    normalize_vjp(quat, rotmat_from_unit_quat_vjp(normalize(quat), v_rotmat))
}

/// Rotation matrix of a rotation vector (Rodrigues).
///
/// - `vector`: the axis, as long as the angle in radians
/// - returns: `[3][3]` row-major
///
/// ```
/// let r = tcgs_core::rotmat_from_vector([0.0, 0.0, std::f64::consts::FRAC_PI_2]); // a quarter turn about z
/// assert!((r[1][0] - 1.0).abs() < 1e-12);
/// ```
pub fn rotmat_from_vector(vector: [f64; 3]) -> [[f64; 3]; 3] {
    let angle = length(vector);
    // sin(a / 2) / a, which is 1 / 2 where there is no turn.
    let share = if angle < 1e-12 { 0.5 } else { (0.5 * angle).sin() / angle };
    let [x, y, z] = vector.map(|v| share * v);
    rotmat_from_quat([(0.5 * angle).cos(), x, y, z])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dot;

    const Q: [f64; 4] = [0.9, -0.4, 0.3, 0.7];
    const P: [f64; 4] = [-0.2, 0.8, 0.5, -0.6];

    fn assert_gradient(x: [f64; 4], gradient: [f64; 4], f: impl Fn([f64; 4]) -> f64) {
        for i in 0..4 {
            let h = 1e-5;
            let at = |d: f64| {
                let mut moved = x;
                moved[i] += d;
                f(moved)
            };
            let difference = (at(h) - at(-h)) / (2.0 * h);
            assert!((difference - gradient[i]).abs() < 1e-8, "{i}: {difference} against {}", gradient[i]);
        }
    }

    const V: [[f64; 3]; 3] = [[0.3, -1.2, 0.5], [0.9, 0.1, -0.4], [-0.7, 0.6, 1.1]];

    fn weigh(r: [[f64; 3]; 3]) -> f64 {
        (0..3).map(|i| dot(r[i], V[i])).sum()
    }

    #[test]
    fn rotation_matrices_are_rotations() {
        let r = rotmat_from_quat(Q);
        for i in 0..3 {
            for j in 0..3 {
                let expected = if i == j { 1.0 } else { 0.0 };
                assert!((dot(r[i], r[j]) - expected).abs() < 1e-12);
            }
        }
        assert_eq!(rotmat_from_quat([2.0, 0.0, 0.0, 0.0]), [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]);
    }

    #[test]
    fn vjps_match_central_differences() {
        assert_gradient(Q, rotmat_from_quat_vjp(Q, V), |q| weigh(rotmat_from_quat(q)));
        assert_gradient(Q, rotmat_from_unit_quat_vjp(Q, V), |q| weigh(rotmat_from_unit_quat(q)));
        assert_gradient(Q, normalize_vjp(Q, P), |q| dot(normalize(q), P));
        let v = [0.3, -0.1, 0.8, 0.2];
        let (v_q, v_p) = quat_mul_vjp(Q, P, v);
        assert_gradient(Q, v_q, |q| dot(quat_mul(q, P), v));
        assert_gradient(P, v_p, |p| dot(quat_mul(Q, p), v));
    }

    #[test]
    fn a_product_rotates_by_the_right_factor_first() {
        let (a, b) = (normalize(Q), normalize(P));
        let (ra, rb, rab) = (rotmat_from_quat(a), rotmat_from_quat(b), rotmat_from_quat(quat_mul(a, b)));
        for i in 0..3 {
            for j in 0..3 {
                let product: f64 = (0..3).map(|k| ra[i][k] * rb[k][j]).sum();
                assert!((product - rab[i][j]).abs() < 1e-12);
            }
        }
    }
}
