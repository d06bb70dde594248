//! The only module of this crate that depends on threads: feature `parallel`.

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

/// Fewest rows that one task handles.
#[cfg(feature = "parallel")]
const CHUNK: usize = 1 << 10;

/// `f` of every row of a flat array and its index.
///
/// - `values`: `[rows * components]`
pub(crate) fn for_each_row(values: &mut [f32], components: usize, f: impl Fn(usize, &mut [f32]) + Sync + Send) {
    #[cfg(feature = "parallel")]
    values.par_chunks_exact_mut(components).with_min_len(CHUNK).enumerate().for_each(|(i, row)| f(i, row));
    #[cfg(not(feature = "parallel"))]
    values.chunks_exact_mut(components).enumerate().for_each(|(i, row)| f(i, row));
}
