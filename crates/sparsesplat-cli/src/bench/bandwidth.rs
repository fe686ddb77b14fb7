//! How fast this machine's memory is: what a figure of bytes per second is to be held against.

use rayon::ThreadPool;
use rayon::prelude::*;
use serde::Serialize;
use std::hint::black_box;
use std::time::Instant;

/// Numbers per array: 128 MiB, more than caches hold.
const N: usize = 32 << 20;
/// Numbers that one task takes.
const CHUNK: usize = 1 << 18;
/// Runs, of which the fastest counts.
const RUNS: usize = 5;

/// Bytes per second with a number of threads.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub(super) struct Bandwidth {
    threads: usize,
    bytes_per_second: f64,
}

impl Bandwidth {
    /// Measures `a[i] = b[i] + s c[i]` (the triad of the STREAM benchmark) on arrays of f32: three numbers moved for each
    /// element. That caches fetch `a` before they overwrite it is not counted.
    pub(super) fn measure(pools: &[ThreadPool]) -> Vec<Self> {
        let (mut a, b, c) = (vec![0.0f32; N], vec![1.0f32; N], vec![2.0f32; N]);
        let mut fastest = |pool: &ThreadPool| {
            pool.install(|| {
                (0..RUNS)
                    .map(|_| {
                        let begin = Instant::now();
                        triad(&mut a, &b, &c);
                        black_box(&a);
                        begin.elapsed().as_secs_f64()
                    })
                    .fold(f64::INFINITY, f64::min)
            })
        };
        pools
            .iter()
            .map(|pool| Self {
                threads: pool.current_num_threads(),
                bytes_per_second: (3 * N * size_of::<f32>()) as f64 / fastest(pool),
            })
            .collect()
    }

    /// The line of the summary.
    pub(super) fn line(all: &[Self]) -> String {
        let each: Vec<String> = all
            .iter()
            .map(|found| {
                let threads = if found.threads == 1 { "thread" } else { "threads" };
                format!("{:.1} GB/s on {} {threads}", found.bytes_per_second / 1e9, found.threads)
            })
            .collect();
        format!("memory     triad: {}", each.join(", "))
    }
}

fn triad(a: &mut [f32], b: &[f32], c: &[f32]) {
    let factor = black_box(3.0);
    a.par_chunks_mut(CHUNK).zip(b.par_chunks(CHUNK)).zip(c.par_chunks(CHUNK)).for_each(|((a, b), c)| {
        for ((a, b), c) in a.iter_mut().zip(b).zip(c) {
            *a = b + factor * c;
        }
    });
}
