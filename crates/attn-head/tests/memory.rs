//! Memory of the fused forward pass, counted by an allocator. Its own binary: nothing else may allocate meanwhile.
//! `cargo test -p attn-head --test memory -- --nocapture` prints the figures.
#![allow(unsafe_code, reason = "an allocator that counts is an unsafe trait; it only calls the system's")]

use attn_head::{Config, Inputs, Kind, WIDTH, Weights, fused};
use std::alloc::{GlobalAlloc, Layout, System};
use std::sync::atomic::{AtomicUsize, Ordering::Relaxed};

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

/// Bytes that a forward pass of `n` anchors with `k` neighbours takes at most beyond what is in use before.
fn peak(n: usize, k: usize) -> usize {
    let config = Config { kind: Kind::Attention, geometry: 9, image: 16, neighbours: k };
    let weights = Weights::initial(config, 1).expect("a valid configuration");
    let number = |i: usize| (i % 17) as f32 / 17.0 - 0.5;
    let geometry: Vec<f32> = (0..n * config.geometry).map(number).collect();
    let image: Vec<f32> = (0..n * config.image).map(number).collect();
    let neighbours: Vec<u32> = (0..n * k).map(|i| ((i / k + i % k) % n) as u32).collect();
    let relative: Vec<[f32; 3]> = (0..n * k).map(|i| [number(i), number(i + 5), number(i + 9)]).collect();
    let inputs =
        Inputs { n, k, geometry: &geometry, image: &image, neighbours: &neighbours, relative: &relative };
    let before = IN_USE.load(Relaxed);
    PEAK.store(before, Relaxed);
    let outputs = fused::forward(&config, &weights.values, &inputs);
    assert!(outputs.iter().all(|v| v.is_finite()));
    PEAK.load(Relaxed) - before
}

#[test]
fn a_forward_pass_holds_rows_of_anchors_but_none_of_pairs() {
    const N: usize = 20_000;
    // Threads, which allocate once, before anything is counted.
    peak(2_000, 20);
    let row = WIDTH * size_of::<f32>();
    let [few, many] = [4, 24].map(|k| {
        let peak = peak(N, k);
        println!("k = {k}: {:.2} rows of {WIDTH} numbers per anchor", peak as f64 / (N * row) as f64);
        peak
    });
    // Features, queries, keys and values of all anchors; pairs are made block by block.
    assert!(many <= 5 * N * row, "{many} bytes");
    // Twenty more neighbours would be twenty more rows each.
    assert!(many <= few + N * row / 4, "{few} bytes with 4 neighbours, {many} with 24");
}
