//! Streams all frames of a data set, and says how long it took and how much memory the process had at most.
//!
//! `cargo run --release -p view-data --example stream_views -- PATH [WINDOW]`

use std::path::Path;
use std::time::Instant;
use view_data::open;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut arguments = std::env::args().skip(1);
    let path = arguments.next().ok_or("usage: stream_views PATH [WINDOW]")?;
    let window = arguments.next().map_or(Ok(4), |word| word.parse())?;
    let start = Instant::now();
    let dataset = open(Path::new(&path), None)?;
    println!(
        "{} as {}: {} frames, opened in {:.2?}",
        dataset.name,
        dataset.format,
        dataset.frames.len(),
        start.elapsed()
    );
    println!("after opening: {}", peak_memory());
    let start = Instant::now();
    let (mut pixels, mut brightness) = (0, 0.0);
    for view in dataset.stream(&dataset.present(), None, window)? {
        let view = view?;
        pixels += view.image().width() * view.image().height();
        brightness += f64::from(view.image().data().iter().sum::<f32>());
    }
    let elapsed = start.elapsed();
    println!(
        "{} views, {pixels} pixels in {elapsed:.2?}, mean {:.4}",
        dataset.present().len(),
        brightness / pixels as f64 / 3.0
    );
    println!("with a window of {window}: {}", peak_memory());
    Ok(())
}

/// The most memory that the process had, as Linux tells it.
fn peak_memory() -> String {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find(|line| line.starts_with("VmHWM"));
    line.unwrap_or("peak memory is not known on this system").to_owned()
}
