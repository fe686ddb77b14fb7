//! Seconds of LPIPS and its gradient with weights by a rule:
//! `cargo run --release -p image-metrics --features lpips --example time_lpips -- [WIDTH HEIGHT]`.

#[path = "../tests/it/recipe.rs"]
#[expect(dead_code, reason = "of a module that is shared with tests")]
mod recipe;

use gs_scene::Image;
use std::time::Instant;

fn main() -> gs_scene::Result<()> {
    let sizes: Vec<usize> = std::env::args().skip(1).filter_map(|word| word.parse().ok()).collect();
    let (width, height) = if let [width, height] = sizes[..] { (width, height) } else { (256, 192) };
    let picture = |seed: usize| {
        let data = (0..width * height * 3).map(|i| ((i * i + seed * i) % 997) as f32 / 997.0).collect();
        Image::new(width, height, data)
    };
    let (a, b) = (picture(3)?, picture(8)?);
    println!("{width}x{height}, {} threads, median of 7", rayon::current_num_threads());
    for network in recipe::NETWORKS {
        let lpips = recipe::lpips(network);
        let target = lpips.target(&b).expect("a target");
        let distance = median(|| drop(target.distance(a.data())));
        let both = median(|| drop(target.distance_and_gradient(a.data())));
        println!("{network:8} distance {distance:.3} s, with gradient {both:.3} s");
    }
    Ok(())
}

fn median(mut run: impl FnMut()) -> f64 {
    let mut seconds: Vec<f64> = (0..7)
        .map(|_| {
            let start = Instant::now();
            run();
            start.elapsed().as_secs_f64()
        })
        .collect();
    seconds.sort_by(f64::total_cmp);
    seconds[3]
}
