//! A ball in front of a wall, seen by a depth camera with holes: its chosen pixels as points with normal, colour and
//! features, ten kilometres from the origin.
//! `cargo run --release -p backproject --example lift_view`

use backproject::{Settings, ViewPixels, anchors};
use glam::{DVec2, DVec3};
use gs_scene::{Camera, FeatureMap, Image, Intrinsics};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let lens = Intrinsics { fx: 300.0, fy: 300.0, cx: 160.0, cy: 120.0, width: 320, height: 240 };
    let target = DVec3::new(1e4, 2e3, 50.0);
    let camera = Camera::looking_at(lens, target - DVec3::new(0.0, 5.0, 0.0), target, DVec3::Z)?;

    let centre_of = |i: usize| DVec2::new((i % lens.width) as f64 + 0.5, (i / lens.width) as f64 + 0.5);
    let depth: Vec<f32> =
        (0..lens.width * lens.height).map(|i| seen_depth(lens.ray(centre_of(i)), i)).collect();
    let image = Image::filled(lens.width, lens.height, [0.8, 0.4, 0.2])?;
    let (columns, rows) = (lens.width / 4, lens.height / 4);
    let column = (0..columns * rows).map(|i| (i % columns) as f32);
    let row = (0..columns * rows).map(|i| (i / columns) as f32);
    let features = FeatureMap::new(2, columns, rows, column.chain(row).collect())?;

    let pixels: Vec<u32> = (0..(lens.width * lens.height) as u32).step_by(7).collect();
    let view = ViewPixels {
        camera: &camera,
        depth: &depth,
        pixels: &pixels,
        image: Some(&image),
        features: Some(&features),
    };
    let settings = Settings { far: 7.0, ..Settings::default() };
    let found = anchors(&[view], &settings)?;

    println!("{} of {} pixels, dropped {:?}", found.anchors.len(), pixels.len(), found.dropped[0]);
    let anchors = &found.anchors;
    let (mut rounded, mut shifted) = (0.0f64, 0.0f64);
    let (absolute, relative) =
        (anchors.positions_from(DVec3::ZERO), anchors.positions_from(camera.position()));
    for i in 0..anchors.len() {
        let off = |world: DVec3| {
            camera
                .project(world)
                .map_or(f64::NAN, |back| (back - centre_of(anchors.pixels[i] as usize)).length())
        };
        rounded = rounded.max(off(DVec3::from(absolute[i].map(f64::from))));
        shifted = shifted.max(off(camera.position() + DVec3::from(relative[i].map(f64::from))));
    }
    println!("back in the picture, positions are off by at most");
    println!("  {rounded:.1e} px in f32 from the origin, {shifted:.1e} px in f32 from the camera");
    let middle = anchors.pixels.iter().position(|&pixel| pixel as usize / lens.width == 120).unwrap_or(0);
    println!("one of them:");
    println!("  position  {:?}", anchors.positions[middle]);
    println!("  normal    {:?}", anchors.normals[middle]);
    println!("  ray       {:?}", anchors.rays[middle]);
    println!("  footprint {}", anchors.footprints[middle]);
    println!("  colour    {:?}", anchors.colours[middle]);
    println!("  features  {:?}", &anchors.features[middle * anchors.channels..][..anchors.channels]);
    Ok(())
}

/// z-depth of a ball of radius 1 at depth 4 in front of a wall at depth 6 that slants out of range, with holes.
fn seen_depth(ray: DVec3, i: usize) -> f32 {
    match i % 97 {
        0 => return 0.0,
        1 => return f32::NAN,
        _ => {}
    }
    // |z ray - centre| = 1
    let half = 4.0 * ray.z / ray.length_squared();
    let root = half * half - 15.0 / ray.length_squared();
    let wall = 6.0 / (1.0 - 0.4 * ray.x);
    if root > 0.0 { (half - root.sqrt()) as f32 } else { wall as f32 }
}
