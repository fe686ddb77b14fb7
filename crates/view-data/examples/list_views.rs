//! Prints the frames of a data set, what a selection of views looks like, and how long reading takes.
//!
//! `cargo run --release -p view-data --example list_views -- PATH [VIEWS]`

use std::path::Path;
use std::time::Instant;
use view_data::{Frame, SceneDepth, estimate_scene_depth, open, read_index, select_views};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut arguments = std::env::args().skip(1);
    let path = arguments.next().ok_or("usage: list_views PATH [VIEWS]")?;
    let n = arguments.next().map_or(Ok(6), |n| n.parse())?;

    let start = Instant::now();
    let dataset = open(Path::new(&path), None)?;
    println!("{}: {} frames, opened in {:.1?}", dataset.name, dataset.frames.len(), start.elapsed());
    let cameras = dataset.cameras()?;
    for (position, Frame { name, lens, depth, .. }) in dataset.frames.iter().enumerate() {
        let i = lens.intrinsics;
        println!(
            "{position:4} {name}: {}x{}, focal {:.2} {:.2}, centre {:.2} {:.2}, {}, {}, at {:.3}",
            i.width,
            i.height,
            i.fx,
            i.fy,
            i.cx,
            i.cy,
            if lens.model.is_pinhole() { "no distortion" } else { "distorted" },
            if depth.is_some() { "with depth" } else { "no depth" },
            cameras[position].position(),
        );
    }

    let estimate = estimate_scene_depth(&cameras);
    println!("scene depth stated: {:?}", dataset.depth_percentiles);
    println!("scene depth from poses: {estimate:?}");
    let stated = dataset.depth_percentiles.map(SceneDepth::from);
    for (source, depth) in [("stated", stated), ("poses", estimate)] {
        let Some(depth) = depth else { continue };
        let start = Instant::now();
        let selection = select_views(&cameras, n, depth);
        println!("{n} views by {source} depth in {:.1?}: {selection:?}", start.elapsed());
    }

    let index = dataset.root.join("evaluation_index.json");
    if index.is_file() {
        let index = read_index(&index)?;
        for window in index.windows_of(&dataset)? {
            let start = Instant::now();
            let views = dataset.load_views(&window.context, None)?;
            println!("{}: {} context views loaded in {:.1?}", window.key, views.len(), start.elapsed());
        }
    }
    let all = dataset.present();
    let start = Instant::now();
    let views = dataset.load_views(&all, None)?;
    let (first, elapsed) = (views[0].camera().intrinsics(), start.elapsed());
    println!("all {} views loaded in {elapsed:.1?}; the first is {first:?}", views.len());
    Ok(())
}
