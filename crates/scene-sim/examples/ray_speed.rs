//! Rays per second on a landscape of 100 000 triangles with a few things on it.
//!
//! ```sh
//! cargo run --release -p scene-sim --example ray_speed
//! ```

use glam::DVec3;
use rayon::prelude::*;
use scene_sim::{Finish, Material, Mesh, MeshSource, Pattern, Primitive, Scene, Shape, Sky, Traced};
use std::time::Instant;

const WIDTH: usize = 1024;
const HEIGHT: usize = 768;
/// Cells along a side of the landscape; two triangles each.
const CELLS: usize = 224;

fn height(x: f64, y: f64) -> f64 {
    0.5 * (0.9 * x).sin() * (0.7 * y).cos()
        + 0.1 * (5.3 * x + 1.0).sin() * (4.1 * y).sin()
        + 0.02 * (31.0 * x * y).sin()
}

fn scene() -> Scene {
    let at = |k: usize| 20.0 * k as f64 / CELLS as f64 - 10.0;
    let grid = || (0..=CELLS).flat_map(|j| (0..=CELLS).map(move |i| (at(i), at(j))));
    let row = (CELLS + 1) as u32;
    let faces = (0..CELLS as u32).flat_map(|j| (0..CELLS as u32).map(move |i| j * row + i));
    let material = Material {
        pattern: Pattern::Plain { colour: [0.5; 3] },
        mottle: 0.0,
        seed: 0,
        finish: Finish::Matte,
    };
    let land = Mesh {
        name: "land".into(),
        source: MeshSource::Inline {
            vertices: grid().map(|(x, y)| DVec3::new(x, y, height(x, y))).collect(),
            faces: faces.map(|k| vec![k, k + 1, k + row + 1, k + row]).collect(),
            colours: Vec::new(),
        },
        centre: DVec3::ZERO,
        rotation: DVec3::ZERO,
        scale: 1.0,
        material: material.clone(),
    };
    let things = (0..60).map(|k| {
        let (x, y) = (at(k * 37 % CELLS), at(k * 101 % CELLS));
        let shape = match k % 3 {
            0 => Shape::Sphere { radius: 0.4 },
            1 => Shape::Box { size: DVec3::new(0.5, 0.7, 0.9) },
            _ => Shape::Cylinder { radius: 0.2, height: 1.5 },
        };
        Primitive {
            name: format!("thing {k}"),
            shape,
            centre: DVec3::new(x, y, height(x, y) + 0.4),
            rotation: DVec3::new(0.0, 10.0, 7.0 * k as f64),
            material: material.clone(),
        }
    });
    let sky = Sky { zenith: [0.5; 3], horizon: [0.5; 3], ground: [0.5; 3], light: 1.0, occlusion: None };
    Scene { primitives: things.collect(), meshes: vec![land], ..Scene::under(sky) }
}

/// A unit vector from an index, evenly spread over the sphere (golden angle).
fn direction(index: usize) -> DVec3 {
    let z = 1.0 - 2.0 * ((index as f64 * 0.754_877_666_246_692_7).fract());
    let (sine, cosine) = (index as f64 * 2.399_963_229_728_653).sin_cos();
    let r = (1.0 - z * z).sqrt();
    DVec3::new(r * cosine, r * sine, z)
}

/// Best of five, in million rays per second, and how many of them hit.
fn measure(
    threads: usize,
    ray: impl Fn(usize) -> bool + Sync,
) -> Result<(f64, usize), rayon::ThreadPoolBuildError> {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build()?;
    let count = WIDTH * HEIGHT;
    let run = || {
        let start = Instant::now();
        let hits =
            pool.install(|| (0..count).into_par_iter().with_min_len(4 * WIDTH).filter(|&i| ray(i)).count());
        (count as f64 / start.elapsed().as_secs_f64() / 1e6, hits)
    };
    Ok((0..5).map(|_| run()).fold((0.0, 0), |best, next| if next.0 > best.0 { next } else { best }))
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let scene = scene();
    let start = Instant::now();
    let traced = Traced::new(&scene)?;
    println!("{} triangles, ready after {:.2} s", 2 * CELLS * CELLS, start.elapsed().as_secs_f64());
    let eye = DVec3::new(-8.0, -9.0, 5.0);
    let [forward, right] = [DVec3::new(8.0, 9.0, -5.0).normalize(), DVec3::new(9.0, -8.0, 0.0).normalize()];
    let down = forward.cross(right);
    let primary = |i: usize| {
        let (x, y) = ((i % WIDTH) as f64 / WIDTH as f64 - 0.5, (i / WIDTH) as f64 / WIDTH as f64 - 0.375);
        forward + right * (1.2 * x) + down * (1.2 * y)
    };
    let starts: Vec<DVec3> = (0..WIDTH * HEIGHT)
        .map(|i| eye + primary(i) * (traced.distance(eye, primary(i)).unwrap_or(1.0) * (1.0 - 1e-9)))
        .collect();
    let sun = DVec3::new(30.0, -20.0, 40.0);
    for threads in [1, 2] {
        let line = |name, (rate, hits): (f64, usize)| {
            println!(
                "{threads} threads: {rate:5.2} million {name} rays/s, {:.0} % hit",
                hits as f64 / (WIDTH * HEIGHT) as f64 * 100.0
            );
        };
        line("primary", measure(threads, |i| traced.distance(eye, primary(i)).is_some())?);
        line("shadow", measure(threads, |i| traced.is_shadowed(starts[i], sun))?);
        line("incoherent", measure(threads, |i| traced.distance(starts[i], direction(i)).is_some())?);
    }
    Ok(())
}
