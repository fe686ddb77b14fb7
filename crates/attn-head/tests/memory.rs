//! Memory of the fused form, counted by an allocator. Its own binary: nothing else may allocate meanwhile.
//! `cargo test -p attn-head --test memory -- --nocapture` prints the figures.
#![allow(unsafe_code, reason = "an allocator that counts is an unsafe trait; it only calls the system's")]

use attn_head::{Config, Inputs, Kind, OUTPUTS, WIDTH, Weights, fused};
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

/// What is measured.
#[derive(Debug, Clone, Copy)]
enum Pass {
    Forward,
    Training,
}

/// Bytes that a pass of `n` anchors with `k` neighbours takes at most beyond what is in use before.
fn peak(kind: Kind, pass: Pass, n: usize, k: usize) -> usize {
    let config = Config { kind, geometry: 9, image: 16, neighbours: k };
    let weights = Weights::initial(config, 1).expect("a valid configuration");
    let number = |i: usize| (i % 17) as f32 / 17.0 - 0.5;
    let geometry: Vec<f32> = (0..n * config.geometry).map(number).collect();
    let image: Vec<f32> = (0..n * config.image).map(number).collect();
    let neighbours: Vec<u32> = (0..n * k).map(|i| ((i / k + i % k) % n) as u32).collect();
    let relative: Vec<[f32; 3]> = (0..n * k).map(|i| [number(i), number(i + 5), number(i + 9)]).collect();
    let cells: Vec<[u32; 2]> = (0..n as u32).map(|i| [i / 20, i / 300]).collect();
    let inputs = Inputs {
        n,
        k,
        geometry: &geometry,
        image: &image,
        neighbours: &neighbours,
        relative: &relative,
        cells: &cells,
    };
    let grad = vec![1.0; n * OUTPUTS];
    let before = IN_USE.load(Relaxed);
    PEAK.store(before, Relaxed);
    match pass {
        Pass::Forward => {
            let outputs = fused::forward(&config, &weights.values, &inputs);
            assert!(outputs.iter().all(|v| v.is_finite()));
        }
        Pass::Training => {
            let (_, tape) = fused::forward_recorded(&config, &weights.values, &inputs);
            let gradients = fused::backward(&config, &weights.values, &inputs, &tape, &grad);
            assert!(gradients.weights.iter().all(|v| v.is_finite()));
        }
    }
    PEAK.load(Relaxed) - before
}

const N: usize = 20_000;
const ROW: usize = WIDTH * size_of::<f32>();

/// With 4 and with 24 neighbours.
fn peaks(kind: Kind, pass: Pass) -> [usize; 2] {
    [4, 24].map(|k| {
        let peak = peak(kind, pass, N, k);
        let rows = peak as f64 / (N * ROW) as f64;
        println!("{kind:?}, {pass:?}, k = {k}: {rows:.2} rows of {WIDTH} numbers per anchor");
        peak
    })
}

/// One test, as nothing else may allocate meanwhile.
#[test]
fn passes_hold_rows_of_anchors_but_none_of_pairs() {
    for kind in Kind::ALL {
        // Threads, which allocate once, before anything is counted.
        peak(kind, Pass::Forward, 2_000, 20);
        let [few, many] = peaks(kind, Pass::Forward);
        // Features, what anchors show, and outputs; pairs are made block by block.
        assert!(many <= 5 * N * ROW, "{kind:?}: {many} bytes");
        // Twenty more neighbours would be twenty more rows each.
        assert!(many <= few + N * ROW / 4, "{kind:?}: {few} bytes with 4 neighbours, {many} with 24");
        let [few, many] = peaks(kind, Pass::Training);
        // Some numbers for each pair, but no rows; and the weights' gradients of 32 ranges.
        let ranges = 32 << 20;
        assert!(few <= 16 * N * ROW + ranges, "{kind:?}: {few} bytes");
        assert!(many <= few + 4 * N * ROW, "{kind:?}: {few} bytes with 4 neighbours, {many} with 24");
    }
}
