//! Loops over independent tasks: on rayon's threads with the feature `rayon`, one after the other without it. The results
//! are the same.

/// What `task` gives for 0, 1, … `n` - 1, in this order.
#[cfg(feature = "rayon")]
pub(crate) fn map<T: Send>(n: usize, task: impl Fn(usize) -> T + Sync + Send) -> Vec<T> {
    use rayon::prelude::*;
    (0..n).into_par_iter().map(task).collect()
}

#[cfg(not(feature = "rayon"))]
pub(crate) fn map<T>(n: usize, task: impl Fn(usize) -> T) -> Vec<T> {
    (0..n).map(task).collect()
}

/// `task` on each run of `size` elements, and on what is left at the end, with the index of the run.
#[cfg(feature = "rayon")]
pub(crate) fn for_each_chunk<T: Send>(
    data: &mut [T],
    size: usize,
    task: impl Fn(usize, &mut [T]) + Sync + Send,
) {
    use rayon::prelude::*;
    data.par_chunks_mut(size).enumerate().for_each(|(i, chunk)| task(i, chunk));
}

#[cfg(not(feature = "rayon"))]
pub(crate) fn for_each_chunk<T>(data: &mut [T], size: usize, task: impl Fn(usize, &mut [T])) {
    data.chunks_mut(size).enumerate().for_each(|(i, chunk)| task(i, chunk));
}
