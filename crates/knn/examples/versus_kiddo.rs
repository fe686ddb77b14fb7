//! Whole-set search beside kiddo's immutable k-d tree, building included in both, on surface-like points; rayon over
//! kiddo's queries.
//! `RAYON_NUM_THREADS=2 cargo run --release -p knn --example versus_kiddo`

use kiddo::{ImmutableKdTree, SquaredEuclidean};
use rayon::prelude::*;
use std::num::NonZero;
use std::time::Instant;

#[path = "../tests/it/sets.rs"]
#[expect(dead_code, reason = "only the generator of random numbers is used here")]
mod sets;

const K: usize = 20;
const REPEATS: usize = 7;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    println!("K = {K}, {} threads, best of {REPEATS}, milliseconds", rayon::current_num_threads());
    println!("{:>8} {:>8} {:>8} {:>8} {:>10}", "points", "ours", "kiddo", "ratio", "ns/point");
    for n in [10_000, 40_000, 150_000] {
        let points = surfaces(n);
        let ours = best(|| knn::knn(&points, K).expect("finite points").indices.len());
        let kiddo = best(|| {
            let tree = ImmutableKdTree::new_from_slice(&points).expect("finite points");
            let k = NonZero::new(K + 1).expect("K + 1 > 0");
            points
                .par_iter()
                .map(|p| tree.query(p).nearest_n::<SquaredEuclidean<f32>>(k).execute().len())
                .sum::<usize>()
        });
        let ns = ours * 1e6 / n as f64;
        println!("{n:>8} {ours:>8.1} {kiddo:>8.1} {:>8.2} {ns:>10.0}", kiddo / ours);
    }
    Ok(())
}

/// Shortest wall time, milliseconds.
fn best(mut run: impl FnMut() -> usize) -> f64 {
    (0..REPEATS)
        .map(|_| {
            let start = Instant::now();
            std::hint::black_box(run());
            start.elapsed().as_secs_f64() * 1e3
        })
        .fold(f64::INFINITY, f64::min)
}

/// Rough walls, floor and spheres, as anchors from depth maps lie.
fn surfaces(n: usize) -> Vec<[f32; 3]> {
    let mut random = sets::Random(1);
    (0..n)
        .map(|i| {
            let (a, b, noise) = (random.unit(), random.unit(), 2e-3 * random.unit());
            match i % 4 {
                0 => [4.0 * a, 1.0 + noise, 4.0 * b],
                1 => [4.0 * a, b, 4.0 + noise],
                2 => [-4.0 + noise, a, 4.0 * b],
                _ => {
                    let (s, c) = (std::f32::consts::PI * a).sin_cos();
                    let (r, ring) = (0.5 + noise, (1.0 - b * b).sqrt());
                    [r * ring * c, r * b, 2.0 + r * ring * s]
                }
            }
        })
        .collect()
}
