//! Memory of a search, counted by an allocator. Its own binary: nothing else may allocate meanwhile.
//! `cargo test -p knn --test memory -- --nocapture` prints the figures.
#![allow(unsafe_code, reason = "an allocator that counts is an unsafe trait; it only calls the system's")]

use std::alloc::{GlobalAlloc, Layout, System};
use std::sync::atomic::{AtomicUsize, Ordering::Relaxed};

#[allow(dead_code, reason = "one set of many is used")]
#[path = "it/sets.rs"]
mod sets;

/// Bytes in use, and the most that were since the last reset.
static IN_USE: AtomicUsize = AtomicUsize::new(0);
static PEAK: AtomicUsize = AtomicUsize::new(0);

struct Counting;

#[global_allocator]
static COUNTING: Counting = Counting;

fn grown(by: usize) {
    PEAK.fetch_max(IN_USE.fetch_add(by, Relaxed) + by, Relaxed);
}

// SAFETY: every call goes to the system's allocator with the same arguments; counting touches no memory of theirs.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        grown(layout.size());
        // SAFETY: as the caller promises.
        unsafe { System.alloc(layout) }
    }

    unsafe fn alloc_zeroed(&self, layout: Layout) -> *mut u8 {
        grown(layout.size());
        // SAFETY: as the caller promises.
        unsafe { System.alloc_zeroed(layout) }
    }

    unsafe fn dealloc(&self, memory: *mut u8, layout: Layout) {
        IN_USE.fetch_sub(layout.size(), Relaxed);
        // SAFETY: as the caller promises.
        unsafe { System.dealloc(memory, layout) }
    }
}

/// Bytes that `work` takes at most beyond what is in use before, and those it returns.
fn peak<T>(work: impl FnOnce() -> T) -> (usize, usize) {
    let before = IN_USE.load(Relaxed);
    PEAK.store(before, Relaxed);
    let result = work();
    let kept = IN_USE.load(Relaxed) - before;
    drop(result);
    (PEAK.load(Relaxed) - before, kept)
}

#[test]
fn a_search_takes_at_most_40_bytes_per_point_beyond_the_result() {
    const N: usize = 200_000;
    let (points, queries) = (sets::set("surfaces", N, 1), sets::set("surfaces", N, 2));
    // Threads, which allocate once, before anything is counted.
    knn::knn(&points[..20_000], 20).expect("finite points");
    for k in [1, 20, 64] {
        let (peak, kept) = peak(|| knn::knn(&points, k).expect("finite points"));
        assert_eq!(kept, N * k * 8, "k = {k}: 8 bytes per neighbour");
        println!("knn, k = {k}: {:.1} bytes per point beyond the result", (peak - kept) as f64 / N as f64);
        // Trees are built before room is made for the result, of which there is little where k is small.
        assert!(peak <= kept + 40 * N, "k = {k}: {peak} bytes, {kept} of them the result");
    }
    let (peak, kept) = peak(|| knn::query(&points, &queries, 20).expect("finite points"));
    println!("query, k = 20: {:.1} bytes per point beyond the result", (peak - kept) as f64 / N as f64);
    assert!(peak <= kept + 2 * 40 * N, "{peak} bytes, {kept} of them the result");
}
