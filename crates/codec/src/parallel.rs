//! The one place that knows whether there are threads.

/// Results of `f` for all jobs, in their order.
#[cfg(feature = "parallel")]
pub(crate) fn map<T: Send, R: Send>(jobs: Vec<T>, f: impl Fn(T) -> R + Sync + Send) -> Vec<R> {
    use rayon::prelude::*;
    jobs.into_par_iter().map(f).collect()
}

/// Results of `f` for all jobs, in their order.
#[cfg(not(feature = "parallel"))]
pub(crate) fn map<T, R>(jobs: Vec<T>, f: impl Fn(T) -> R) -> Vec<R> {
    jobs.into_iter().map(f).collect()
}
