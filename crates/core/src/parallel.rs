//! The one place of this crate that knows whether there are threads: feature `parallel`.

#[cfg(feature = "parallel")]
use rayon::prelude::*;

/// `f` of every item, in the order of the items.
pub(crate) fn map<T: Sync, R: Send>(items: &[T], f: impl Fn(&T) -> R + Sync + Send) -> Vec<R> {
    #[cfg(feature = "parallel")]
    return items.par_iter().map(f).collect();
    #[cfg(not(feature = "parallel"))]
    return items.iter().map(f).collect();
}

/// `f` of every pair of items at one position, in their order.
///
/// # Panics
/// If there are not as many of both.
pub(crate) fn map_pairs<A: Sync, B: Sync, R: Send>(a: &[A], b: &[B], f: impl Fn(&A, &B) -> R + Sync + Send) -> Vec<R> {
    assert_eq!(a.len(), b.len(), "items of both kinds");
    #[cfg(feature = "parallel")]
    return a.par_iter().zip(b).map(|(a, b)| f(a, b)).collect();
    #[cfg(not(feature = "parallel"))]
    return a.iter().zip(b).map(|(a, b)| f(a, b)).collect();
}
