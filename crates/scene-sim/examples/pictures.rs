//! Renders the demonstration's views into a folder: colour, and depth as grey (near is bright, sky is black).
//!
//! `cargo run --release -p scene-sim --example pictures -- OUT_DIR [WIDTH HEIGHT SAMPLES]`

use gs_scene::View;
use scene_sim::{Traced, demo_cameras, demo_scene, render_counted};
use std::error::Error;
use std::path::Path;
use std::time::Instant;

fn write(folder: &Path, view: &View) -> Result<(), Box<dyn Error>> {
    let (width, height) = (view.camera().width() as u32, view.camera().height() as u32);
    let path = |kind: &str| folder.join(format!("{}{kind}.png", view.name()));
    image::RgbImage::from_raw(width, height, view.image().to_rgb8())
        .ok_or("the picture has another size")?
        .save(path(""))?;
    let depths = view.depth().ok_or("the view has no depth")?.data();
    let nearest = depths.iter().copied().filter(|d| *d > 0.0).fold(f32::INFINITY, f32::min);
    let grey = depths.iter().map(|&d| if d > 0.0 { (nearest / d * 255.0) as u8 } else { 0 }).collect();
    image::GrayImage::from_raw(width, height, grey)
        .ok_or("the depth map has another size")?
        .save(path("-depth"))?;
    Ok(())
}

fn main() -> Result<(), Box<dyn Error>> {
    let mut arguments = std::env::args().skip(1);
    let folder = arguments.next().ok_or("usage: pictures OUT_DIR [WIDTH HEIGHT SAMPLES]")?;
    let numbers = arguments.map(|a| a.parse()).collect::<Result<Vec<u32>, _>>()?;
    let [width, height, samples] = numbers.try_into().unwrap_or([480, 320, 4]);
    std::fs::create_dir_all(&folder)?;
    let scene = Traced::new(&demo_scene())?;
    let (context, held_out) = demo_cameras(width as usize, height as usize)?;
    let named = context.iter().map(|c| ("context", c)).chain(held_out.iter().map(|c| ("held-out", c)));
    for (index, (kind, camera)) in named.enumerate() {
        let start = Instant::now();
        let (view, rays) = render_counted(&scene, camera, samples, format!("{kind}-{index:02}"), 0)?;
        println!(
            "{} {:.3} s, {} primary and {} shadow rays",
            view.name(),
            start.elapsed().as_secs_f64(),
            rays.primary,
            rays.shadow
        );
        write(Path::new(&folder), &view)?;
    }
    Ok(())
}
