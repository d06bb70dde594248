//! Loops of decoding that run on several threads with the feature `parallel`, and on one thread without it. No other
//! module of decoding depends on the feature.

#[cfg(feature = "parallel")]
use rayon::prelude::*;

/// Least number of rows or items for one thread.
#[cfg(feature = "parallel")]
const MIN_LEN: usize = 1024;

/// Results of `f` for all jobs, in the order of the jobs.
pub(crate) fn map<T: Send, R: Send>(jobs: Vec<T>, f: impl Fn(T) -> R + Sync + Send) -> Vec<R> {
    #[cfg(feature = "parallel")]
    return jobs.into_par_iter().map(f).collect();
    #[cfg(not(feature = "parallel"))]
    return jobs.into_iter().map(f).collect();
}

/// Calls `f` with every row of `length` values and its index.
pub(crate) fn for_each_row<T: Send>(values: &mut [T], length: usize, f: impl Fn(usize, &mut [T]) + Sync + Send) {
    #[cfg(feature = "parallel")]
    values.par_chunks_exact_mut(length).enumerate().with_min_len(MIN_LEN).for_each(|(i, row)| f(i, row));
    #[cfg(not(feature = "parallel"))]
    values.chunks_exact_mut(length).enumerate().for_each(|(i, row)| f(i, row));
}

/// Calls `f` with every item and its index. Fails if a call fails, with the error of any failing call.
pub(crate) fn try_for_each<T: Sync, E: Send>(
    items: &[T],
    f: impl Fn(usize, &T) -> Result<(), E> + Sync + Send,
) -> Result<(), E> {
    #[cfg(feature = "parallel")]
    return items.par_iter().enumerate().with_min_len(MIN_LEN).try_for_each(|(i, item)| f(i, item));
    #[cfg(not(feature = "parallel"))]
    return items.iter().enumerate().try_for_each(|(i, item)| f(i, item));
}
