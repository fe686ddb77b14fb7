//! Memory of the CPU path, counted by an allocator. Its own binary: nothing else may allocate meanwhile.
//! `cargo test -p gs-raster --test memory -- --nocapture` prints the figures.
#![allow(unsafe_code, reason = "an allocator that counts is an unsafe trait; it only calls the system's")]

use glam::{DMat3, DVec3};
use gs_raster::{PixelGradients, Rasterizer, RenderSettings};
use gs_scene::{Camera, Gaussians, Intrinsics};
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

/// Bytes that `work` takes at most beyond what is in use before.
fn peak<T>(work: impl FnOnce() -> T) -> (usize, T) {
    let before = IN_USE.load(Relaxed);
    PEAK.store(before, Relaxed);
    let result = work();
    (PEAK.load(Relaxed) - before, result)
}

/// A wall of overlapping discs of SH degree 2, all of them in the picture.
fn wall(n: usize) -> Gaussians {
    let (columns, mut scene) = (n.isqrt() * 4 / 3, Gaussians::empty(2).expect("degree 2 exists"));
    let size = (4.0 / columns as f32).ln();
    for i in 0..n {
        let (column, row) = (i % columns, i / columns);
        let x = 4.0 * (column as f32 / columns as f32 - 0.5);
        let y = 2.2 * (row as f32 / (n / columns) as f32 - 0.5);
        let z = 3.0 + 0.2 * (i * 7919 % 1000) as f32 / 1000.0;
        scene.push([x, y, z], [1.0, 0.1, 0.0, 0.1], [size, size, size - 2.0], 1.0, &[0.2; 27]);
    }
    scene
}

#[test]
fn a_forward_pass_takes_at_most_250_bytes_per_gaussian() {
    let lens = Intrinsics { fx: 300.0, fy: 300.0, cx: 224.0, cy: 128.0, width: 448, height: 256 };
    let camera = Camera::new(lens, DMat3::IDENTITY, DVec3::ZERO).expect("valid");
    let settings = RenderSettings::default();
    for n in [10_000, 40_000, 150_000, 688_128] {
        let scene = wall(n);
        // The pool's own memory is not the renderer's.
        rayon::broadcast(|_| ());
        let (forward, view) = peak(|| Rasterizer::cpu().render(&scene, &camera, &settings).expect("valid"));
        assert!(view.stats.visible * 10 >= n * 9, "{:?}", view.stats);
        let mut rasterizer = Rasterizer::cpu();
        let (record, (_, tape)) = peak(|| rasterizer.record(&scene, &[camera], &settings).expect("valid"));
        let pixels = PixelGradients { image: vec![0.5; 448 * 256 * 3].into(), alpha: None, depth: None };
        let (backward, gradients) = peak(|| rasterizer.backward(&scene, &tape, &[pixels]).expect("valid"));
        assert_eq!(gradients.geometry.len(), n * 11);
        // The picture and its alpha, which few Gaussians share at 10k, are what was asked for.
        let picture = 448 * 256 * 16;
        let working = (forward - picture) / n;
        let [forward, record, backward] = [forward, record, backward].map(|bytes| bytes / n);
        println!(
            "{n} Gaussians: {forward} bytes each forward ({working} without the picture), {record} recorded, \
             {backward} backward"
        );
        assert!(working <= 250, "{n}: {working} bytes per Gaussian without the picture");
        assert!(n < 40_000 || forward <= 250, "{n}: {forward} bytes per Gaussian with the picture");
    }
}
