//! Threads: rayon's, or none without the feature `rayon`. Results do not depend on it.

/// What `each` makes of `0..n`, in order. A task has a state to itself.
#[cfg(feature = "rayon")]
pub(crate) fn map<S, T: Send>(
    n: usize,
    state: impl Fn() -> S + Send + Sync,
    each: impl Fn(&mut S, usize) -> T + Send + Sync,
) -> Vec<T> {
    use rayon::prelude::*;
    (0..n).into_par_iter().map_init(state, each).collect()
}

/// What `each` makes of `0..n`, in order.
#[cfg(not(feature = "rayon"))]
pub(crate) fn map<S, T>(n: usize, state: impl Fn() -> S, each: impl Fn(&mut S, usize) -> T) -> Vec<T> {
    let mut state = state();
    (0..n).map(|i| each(&mut state, i)).collect()
}

/// `each` of the tasks exactly once.
#[cfg(feature = "rayon")]
pub(crate) fn for_each<T: Send>(tasks: Vec<T>, each: impl Fn(T) + Send + Sync) {
    use rayon::prelude::*;
    tasks.into_par_iter().for_each(each);
}

/// `each` of the tasks exactly once, in order.
#[cfg(not(feature = "rayon"))]
pub(crate) fn for_each<T>(tasks: Vec<T>, each: impl Fn(T)) {
    tasks.into_iter().for_each(each);
}
