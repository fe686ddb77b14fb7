//! Threads: rayon's, or none without the feature `rayon`. Results do not depend on it.

/// Both, at the same time if that is possible.
#[cfg(feature = "rayon")]
pub(crate) fn join(a: impl FnOnce() + Send, b: impl FnOnce() + Send) {
    rayon::join(a, b);
}

/// Both.
#[cfg(not(feature = "rayon"))]
pub(crate) fn join(a: impl FnOnce(), b: impl FnOnce()) {
    a();
    b();
}

/// `each` of `0..n` exactly once, `at_least` of them in a task, which has a state to itself.
#[cfg(feature = "rayon")]
pub(crate) fn for_each<S>(
    n: usize,
    at_least: usize,
    state: impl Fn() -> S + Send + Sync,
    each: impl Fn(&mut S, usize) + Send + Sync,
) {
    use rayon::prelude::*;
    (0..n).into_par_iter().with_min_len(at_least).for_each_init(state, each);
}

/// `each` of `0..n` exactly once, in order.
#[cfg(not(feature = "rayon"))]
pub(crate) fn for_each<S>(n: usize, _at_least: usize, state: impl Fn() -> S, each: impl Fn(&mut S, usize)) {
    let mut state = state();
    for i in 0..n {
        each(&mut state, i);
    }
}
