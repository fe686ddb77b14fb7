//! Renders generated scenes into a folder: a colour picture and, beside it, its depth from near (yellow) to far (violet).
//!
//! `cargo run --release -p scene-sim --example gallery -- OUT_DIR [KIND SEED [FRAME]]`; without KIND it writes the pictures
//! of docs/gallery.md.

use gs_scene::View;
use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use scene_sim::{Kind, Traced, generate, lens, render_view};
use std::error::Error;
use std::fs::File;
use std::io::BufWriter;
use std::path::Path;
use std::time::Instant;

/// What docs/gallery.md shows: kind, seed, index of the picture.
const SHOWN: [(Kind, u64, usize); 9] = [
    (Kind::Room, 5, 5),
    (Kind::Room, 3, 5),
    (Kind::Desk, 2, 5),
    (Kind::Desk, 1, 5),
    (Kind::Facade, 4, 5),
    (Kind::Facade, 2, 5),
    (Kind::Garden, 5, 5),
    (Kind::Garden, 1, 5),
    (Kind::Wood, 1, 5),
];

/// Width and height of one of the two pictures of a pair.
const SIZE: (usize, usize) = (420, 280);

fn kind(name: &str) -> Result<Kind, Box<dyn Error>> {
    let same = |kind: &&Kind| format!("{kind:?}").eq_ignore_ascii_case(name);
    let kind = Kind::ALL.iter().find(same).copied();
    Ok(kind.ok_or_else(|| format!("there is no kind {name}; there are {:?}", Kind::ALL))?)
}

/// Near to far as yellow, orange, magenta, violet, black: light to dark, so that it reads without colour too.
fn colour(share: f32) -> [u8; 3] {
    const STOPS: [[f32; 3]; 6] = [
        [252.0, 240.0, 150.0],
        [252.0, 172.0, 66.0],
        [229.0, 92.0, 78.0],
        [158.0, 48.0, 110.0],
        [82.0, 24.0, 124.0],
        [20.0, 12.0, 54.0],
    ];
    let at = share.clamp(0.0, 1.0) * 5.0;
    let index = (at as usize).min(4);
    std::array::from_fn(|c| {
        (STOPS[index][c] + (STOPS[index + 1][c] - STOPS[index][c]) * (at - index as f32)) as u8
    })
}

/// Colour and depth side by side. Depth is spread by its logarithm between its extreme hundredths; sky is white.
fn side_by_side(view: &View) -> Result<image::RgbImage, Box<dyn Error>> {
    let (width, height) = (view.camera().width(), view.camera().height());
    let depth = view.depth().ok_or("the view has no depth")?;
    let mut sorted: Vec<f32> = depth.data().iter().copied().filter(|d| *d > 0.0).collect();
    sorted.sort_by(f32::total_cmp);
    let place = |share: f64| sorted.get((share * sorted.len() as f64) as usize).map_or(1.0, |d| d.ln());
    let (near, far) = (place(0.01), place(0.99));
    // 64 levels: noise below them is not worth its bytes.
    let rgb: Vec<u8> = view.image().to_rgb8().into_iter().map(|v| (v & 0xfc) | (v >> 6)).collect();
    let mut picture = image::RgbImage::new(2 * width as u32, height as u32);
    for (k, &d) in depth.data().iter().enumerate() {
        let (x, y) = ((k % width) as u32, (k / width) as u32);
        picture.put_pixel(x, y, image::Rgb([rgb[3 * k], rgb[3 * k + 1], rgb[3 * k + 2]]));
        let shown = if d > 0.0 { colour((d.ln() - near) / (far - near).max(1e-6)) } else { [255; 3] };
        picture.put_pixel(x + width as u32, y, image::Rgb(shown));
    }
    Ok(picture)
}

fn write(folder: &Path, kind: Kind, seed: u64, frame: usize) -> Result<(), Box<dyn Error>> {
    let start = Instant::now();
    let scene = generate(kind, seed);
    let generated = start.elapsed();
    let traced = Traced::new(&scene)?;
    let photographs = scene.photographs.as_ref().ok_or("the scene brings no camera")?;
    let cameras =
        photographs.path.cameras(lens(SIZE.0, SIZE.1, photographs.field_of_view), photographs.count)?;
    let camera = cameras.get(frame).ok_or_else(|| format!("there are {} pictures", cameras.len()))?;
    let name = format!("{}-{seed}", format!("{kind:?}").to_lowercase());
    let start = Instant::now();
    let view = render_view(&traced, camera, 16, name, 0)?;
    println!(
        "{}: {} primitives, {} meshes, {} lamps in {:.1} ms; picture in {:.2} s",
        view.name(),
        scene.primitives.len(),
        scene.meshes.len(),
        scene.lamps.len(),
        1e3 * generated.as_secs_f64(),
        start.elapsed().as_secs_f64()
    );
    let file = BufWriter::new(File::create(folder.join(format!("{}.png", view.name())))?);
    let encoder = PngEncoder::new_with_quality(file, CompressionType::Best, FilterType::Adaptive);
    side_by_side(&view)?.write_with_encoder(encoder)?;
    Ok(())
}

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let folder = Path::new(arguments.first().ok_or("usage: gallery OUT_DIR [KIND SEED [FRAME]]")?);
    std::fs::create_dir_all(folder)?;
    match &arguments[1..] {
        [] => SHOWN.iter().try_for_each(|&(kind, seed, frame)| write(folder, kind, seed, frame)),
        [name, seed] => write(folder, kind(name)?, seed.parse()?, 5),
        [name, seed, frame] => write(folder, kind(name)?, seed.parse()?, frame.parse()?),
        _ => Err("KIND comes with SEED and perhaps FRAME".into()),
    }
}
