//! The scalar that elementwise maths is generic over.

/// A real number: `f32` where it runs, `f64` where it is differentiated.
pub trait Real: num_traits::Float + num_traits::float::TotalOrder + Send + Sync + std::fmt::Debug + 'static {
    /// The nearest value to a literal.
    ///
    /// ```
    /// use tcgs_core::Real;
    /// assert_eq!(<f32 as Real>::of(0.5), 0.5_f32);
    /// ```
    fn of(value: f64) -> Self;
}

impl Real for f32 {
    #[inline(always)]
    fn of(value: f64) -> Self {
        value as f32
    }
}

impl Real for f64 {
    #[inline(always)]
    fn of(value: f64) -> Self {
        value
    }
}
