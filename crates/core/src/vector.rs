//! Vectors of any number of dimensions.
//!
//! The order of the operations is fixed: the bytes of files and the losses of a training depend on the last bit.

use crate::Real;

/// Inner product.
///
/// - `a`, `b`: `[D]`
/// - returns: `Σ a_i b_i`
#[inline(always)]
pub fn dot<R: Real, const D: usize>(a: [R; D], b: [R; D]) -> R {
    let mut sum = R::zero();
    for i in 0..D {
        sum = sum + a[i] * b[i];
    }
    sum
}

/// Cross product.
///
/// ```
/// assert_eq!(tcgs_core::cross([1.0_f32, 0.0, 0.0], [0.0, 1.0, 0.0]), [0.0, 0.0, 1.0]);
/// ```
#[inline(always)]
pub fn cross<R: Real>(a: [R; 3], b: [R; 3]) -> [R; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

/// `a - b`.
#[inline(always)]
pub fn sub<R: Real, const D: usize>(a: [R; D], b: [R; D]) -> [R; D] {
    std::array::from_fn(|i| a[i] - b[i])
}

/// `a + factor b`.
#[inline(always)]
pub fn add_scaled<R: Real, const D: usize>(a: [R; D], factor: R, b: [R; D]) -> [R; D] {
    std::array::from_fn(|i| a[i] + factor * b[i])
}

/// Mean of vectors, such as the centroid of points; zero if there are none.
///
/// ```
/// assert_eq!(tcgs_core::mean_vector([[0.0, 6.0], [4.0, 0.0]]), [2.0, 3.0]);
/// assert_eq!(tcgs_core::mean_vector([[0.0_f32; 3]; 0]), [0.0; 3]);
/// ```
pub fn mean_vector<R: Real, const D: usize>(vectors: impl IntoIterator<Item = [R; D]>) -> [R; D] {
    let (mut sum, mut count) = ([R::zero(); D], R::zero());
    for vector in vectors {
        (sum, count) = (add_scaled(sum, R::one(), vector), count + R::one());
    }
    sum.map(|x| x / count.max(R::one()))
}

/// Euclidean norm.
#[inline(always)]
pub fn length<R: Real, const D: usize>(v: [R; D]) -> R {
    dot(v, v).sqrt()
}

/// Distance of two points.
///
/// ```
/// assert_eq!(tcgs_core::distance([1.0, 0.0, 7.0], [1.0, 3.0, 3.0]), 5.0);
/// ```
#[inline(always)]
pub fn distance<R: Real, const D: usize>(a: [R; D], b: [R; D]) -> R {
    squared_distance(a, b).sqrt()
}

/// Square of the [`distance`] of two points.
#[inline(always)]
pub fn squared_distance<R: Real, const D: usize>(a: [R; D], b: [R; D]) -> R {
    let offset = sub(a, b);
    dot(offset, offset)
}

/// Unit vector along `v`; a vector of length zero is returned as it is.
///
/// - `v`: `[D]`
/// - returns: `v / ‖v‖`
///
/// ```
/// assert_eq!(tcgs_core::normalize([0.0_f32, 2.0, 0.0, 0.0]), [0.0, 1.0, 0.0, 0.0]);
/// ```
#[inline(always)]
pub fn normalize<R: Real, const D: usize>(v: [R; D]) -> [R; D] {
    let length = length(v);
    if length > R::zero() { v.map(|x| x / length) } else { v }
}

/// VJP of [`normalize`]: the incoming gradient's part across `v`, divided by `‖v‖`.
///
/// - `v`: `[D]`, as given to `normalize`
/// - `v_unit`: `∂L/∂(v/‖v‖)`
/// - returns: `∂L/∂v`; zero where `v` has no length
#[inline(always)]
pub fn normalize_vjp<R: Real, const D: usize>(v: [R; D], v_unit: [R; D]) -> [R; D] {
    let length = length(v);
    if length > R::zero() {
        let unit = v.map(|x| x / length);
        let along = dot(unit, v_unit);
        std::array::from_fn(|i| (v_unit[i] - unit[i] * along) / length)
    } else {
        [R::zero(); D]
    }
}
