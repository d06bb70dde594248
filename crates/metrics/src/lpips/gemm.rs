//! The matrix product of a convolution.

/// `c = a b`, or `c += a b`.
///
/// - `shape`: `[M, K, N]`
/// - `a`: `[M, K]`, a row `a_stride` values after the one before; rows may overlap
/// - `b`: `[K, N]`
/// - `c`: `[M, N]`
/// - `accumulate`: whether `c` is added to rather than overwritten
///
/// # Panics
/// If a matrix does not fit into its slice.
pub fn gemm(shape: [usize; 3], a: &[f32], a_stride: usize, b: &[f32], c: &mut [f32], accumulate: bool) {
    let [m, k, n] = shape;
    assert!(m > 0 && k > 0 && n > 0, "product of shape {shape:?}");
    assert!((m - 1) * a_stride + k <= a.len(), "a [{m}, {k}] by {a_stride} in {} values", a.len());
    assert!(k * n <= b.len() && m * n <= c.len(), "b [{k}, {n}] in {}, c [{m}, {n}] in {}", b.len(), c.len());
    let beta = if accumulate { 1.0 } else { 0.0 };
    // SAFETY: the assertions above keep every element inside its slice. Strides fit because the elements do. The rows
    // of `c`, which is written, do not overlap.
    #[allow(unsafe_code)]
    unsafe {
        matrixmultiply::sgemm(
            m,
            k,
            n,
            1.0,
            a.as_ptr(),
            a_stride as isize,
            1,
            b.as_ptr(),
            n as isize,
            1,
            beta,
            c.as_mut_ptr(),
            n as isize,
            1,
        );
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_may_overlap_and_results_may_add_up() {
        // Rows of three values, two apart.
        let a = [1.0, 2.0, 3.0, 4.0, 5.0];
        let b = [1.0, 0.0, 0.0, 1.0, 1.0, 1.0];
        let mut c = [10.0; 4];
        gemm([2, 3, 2], &a, 2, &b, &mut c, false);
        assert_eq!(c, [4.0, 5.0, 8.0, 9.0]);
        gemm([2, 3, 2], &a, 2, &b, &mut c, true);
        assert_eq!(c, [8.0, 10.0, 16.0, 18.0]);
    }

    #[test]
    #[should_panic(expected = "a [2, 3] by 3 in 5 values")]
    fn a_matrix_that_does_not_fit_panics() {
        gemm([2, 3, 2], &[0.0; 5], 3, &[0.0; 6], &mut [0.0; 4], false);
    }
}
