//! Renders the demonstration's views, or those of a varied scene, into a folder: colour, and depth as grey (near is
//! bright, sky is black).
//!
//! `cargo run --release -p scene-sim --example pictures -- OUT_DIR [SEED] [WIDTH HEIGHT SAMPLES]`; SEED is a number, or
//! `demo`.

use gs_scene::{Camera, View};
use scene_sim::{Traced, demo_cameras, demo_scene, render_counted, varied_cameras, varied_scene};
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
    let folder = arguments.next().ok_or("usage: pictures OUT_DIR [SEED] [WIDTH HEIGHT SAMPLES]")?;
    let seed = arguments.next().filter(|seed| seed != "demo").map(|seed| seed.parse()).transpose()?;
    let numbers = arguments.map(|a| a.parse()).collect::<Result<Vec<u32>, _>>()?;
    let [width, height, samples] = match numbers[..] {
        [] => [480, 320, 4],
        [width, height, samples] => [width, height, samples],
        _ => return Err("WIDTH, HEIGHT and SAMPLES come together".into()),
    };
    std::fs::create_dir_all(&folder)?;
    let size = (width as usize, height as usize);
    let (scene, named): (_, Vec<(String, Camera)>) = match seed {
        Some(seed) => {
            let cameras = varied_cameras(seed, size.0, size.1, 3)?;
            let named = cameras.into_iter().enumerate().map(|(i, c)| (format!("{seed}-{i}"), c));
            (varied_scene(seed), named.collect())
        }
        None => {
            let (context, held_out) = demo_cameras(size.0, size.1)?;
            let context = context.into_iter().enumerate().map(|(i, c)| (format!("context-{i}"), c));
            let held_out = held_out.into_iter().enumerate().map(|(i, c)| (format!("held-out-{i}"), c));
            (demo_scene(), context.chain(held_out).collect())
        }
    };
    let scene = Traced::new(&scene)?;
    for (name, camera) in named {
        let start = Instant::now();
        let (view, rays) = render_counted(&scene, &camera, samples, name, 0)?;
        let seconds = start.elapsed().as_secs_f64();
        println!("{} {seconds:.3} s, {} primary and {} shadow rays", view.name(), rays.primary, rays.shadow);
        write(Path::new(&folder), &view)?;
    }
    Ok(())
}
