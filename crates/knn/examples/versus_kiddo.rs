//! Whole-set search beside kiddo's, building included in both, in runs that alternate.
//! `RAYON_NUM_THREADS=2 cargo run --release -p knn --example versus_kiddo [-- [--shape S] [-n N,N...] [-k K,K...] [--rounds R]]`
//!
//! kiddo is given what is fastest for it here: of its trees the default one and the flat one with buckets of 64, for
//! the latter also queries in spatial order (whose sorting is not counted); results are dropped as they come,
//! while ours are kept. In each round the fastest of the three counts.

use kiddo::{Eytzinger, FlatVec, ImmutableKdTree, KdTree, SquaredEuclidean};
use rayon::prelude::*;
use std::hint::black_box;
use std::num::NonZero;
use std::time::Instant;

#[path = "../tests/it/sets.rs"]
mod sets;

type Flat = KdTree<f32, u32, Eytzinger, FlatVec<f32, u32, 3, 64>, 3, 64>;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut shape = "surfaces".to_owned();
    let (mut sizes, mut ks) = (vec![10_000, 40_000, 100_000, 150_000, 1_000_000], vec![20]);
    let mut rounds = 7;
    let mut arguments = std::env::args().skip(1);
    while let Some(name) = arguments.next() {
        let value = arguments.next().ok_or(format!("{name} takes a value"))?;
        let list = || value.split(',').map(str::parse).collect::<Result<Vec<usize>, _>>();
        match name.as_str() {
            "--shape" => shape = value,
            "-n" => sizes = list()?,
            "-k" => ks = list()?,
            "--rounds" => rounds = value.parse()?,
            _ => return Err(format!("unknown argument {name}").into()),
        }
    }
    if !sets::SHAPES.contains(&shape.as_str()) {
        return Err(format!("no set {shape}, there are {:?}", sets::SHAPES).into());
    }
    println!("{shape}, {} threads, {rounds} rounds, medians in milliseconds", rayon::current_num_threads());
    println!("      n   k     ours  ns/point  kiddo default  flat  in order   ratio (least..most)");
    for &n in &sizes {
        let points = sets::set(&shape, n, 1);
        let in_order = in_spatial_order(&points);
        for &k in &ks {
            compare(&points, &in_order, k, rounds)?;
        }
    }
    Ok(())
}

fn compare(
    points: &[[f32; 3]],
    in_order: &[[f32; 3]],
    k: usize,
    rounds: usize,
) -> Result<(), Box<dyn std::error::Error>> {
    // Its results hold the query itself.
    let with_itself = NonZero::new(k + 1).ok_or("k + 1 > 0")?;
    let by_default = || {
        let tree = ImmutableKdTree::new_from_slice(points).expect("finite points");
        let found = |p| tree.query(p).nearest_n::<SquaredEuclidean<f32>>(with_itself).execute().len();
        points.par_iter().map(found).sum::<usize>()
    };
    let flat = |queries: &[[f32; 3]]| {
        let tree = Flat::new_from_slice(points).expect("finite points");
        let found = |p| tree.query(p).nearest_n::<SquaredEuclidean<f32>>(with_itself).execute().len();
        queries.par_iter().map(found).sum::<usize>()
    };
    let mut times = [const { Vec::new() }; 4];
    let mut ratios = Vec::new();
    for _ in 0..rounds {
        let round = [
            milliseconds(|| knn::knn(points, k).expect("finite points").indices.len()),
            milliseconds(by_default),
            milliseconds(|| flat(points)),
            milliseconds(|| flat(in_order)),
        ];
        ratios.push(round[1].min(round[2]).min(round[3]) / round[0]);
        for (times, time) in times.iter_mut().zip(round) {
            times.push(time);
        }
    }
    let [ours, default, flat, in_order] = times.map(|mut times| median(&mut times));
    let (n, ns) = (points.len(), ours * 1e6 / points.len() as f64);
    let ratio = median(&mut ratios);
    println!(
        "{n:>7} {k:>3} {ours:>8.1} {ns:>9.0} {default:>14.1} {flat:>5.1} {in_order:>9.1} {ratio:>7.2} ({:.2}..{:.2})",
        ratios[0],
        ratios[ratios.len() - 1]
    );
    Ok(())
}

fn milliseconds(run: impl Fn() -> usize) -> f64 {
    let start = Instant::now();
    black_box(run());
    start.elapsed().as_secs_f64() * 1e3
}

/// Sorts, too.
fn median(values: &mut [f64]) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

/// Points along a Morton curve of 1024 cells an axis.
fn in_spatial_order(points: &[[f32; 3]]) -> Vec<[f32; 3]> {
    let (mut lo, mut hi) = ([f32::INFINITY; 3], [f32::NEG_INFINITY; 3]);
    for p in points {
        lo = std::array::from_fn(|a| lo[a].min(p[a]));
        hi = std::array::from_fn(|a| hi[a].max(p[a]));
    }
    let mut sorted = points.to_vec();
    sorted.sort_by_cached_key(|p| {
        (0..3).fold(0u64, |code, a| {
            let cell = ((p[a] - lo[a]) / (hi[a] - lo[a]) * 1023.0) as u64;
            (0..10).fold(code, |code, bit| code | (cell >> bit & 1) << (3 * bit + a))
        })
    });
    sorted
}
