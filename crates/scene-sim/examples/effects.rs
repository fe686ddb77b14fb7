//! What each effect costs and changes: one scene, one effect at a time beside the same picture without it, as a
//! Markdown table. Time is that of one thread, the median of the ratios of runs in turn.
//!
//! `cargo run --release -p scene-sim --example effects -- [OUT_DIR]`; with a folder, the pictures are written there.

use glam::{DVec2, DVec3};
use gs_scene::Distortion;
use scene_sim::{
    Aperture, Exposure, Finish, Lamp, Material, Mesh, MeshSource, Occlusion, Pattern, Photograph,
    Photographs, Primitive, RayCounts, Rgb, Scene, SensorNoise, Shape, Sky, Sun, Traced, Trajectory,
    photograph,
};
use std::error::Error;
use std::fmt::Write;
use std::path::Path;
use std::time::Instant;

const RUNS: usize = 5;
const SUN: Sun =
    Sun { towards: DVec3::new(-1.0, -1.2, 1.6), colour: [1.0, 0.97, 0.9], strength: 0.7, diameter: 0.0 };

fn body(name: &str, shape: Shape, centre: DVec3, pattern: Pattern) -> Primitive {
    let material = Material { pattern, mottle: 0.0, seed: 3, finish: Finish::Matte };
    Primitive { name: name.into(), shape, centre, rotation: DVec3::ZERO, material }
}

const fn plain(colour: Rgb) -> Pattern {
    Pattern::Plain { colour }
}

/// A terrace: floor, wall, picture (3), pane (4), ball (5), box, pot, hedge (8).
fn scene() -> Scene {
    let tiles = Pattern::Checker { colours: [[0.75, 0.7, 0.62], [0.55, 0.5, 0.45]], cell: 0.3 };
    let bricks = Pattern::Brick {
        brick: [0.65, 0.35, 0.25],
        mortar: [0.75, 0.73, 0.7],
        length: 0.25,
        height: 0.08,
        joint: 0.012,
    };
    let print = Pattern::Print { paper: [0.95; 3], ink: [0.15; 3], accent: [0.1, 0.3, 0.6], line: 0.05 };
    let wood = Pattern::Wood { light: [0.75, 0.55, 0.35], dark: [0.45, 0.3, 0.18], plank: 0.15 };
    let upright = |mut primitive: Primitive| {
        primitive.rotation.x = 90.0;
        primitive
    };
    let flat = |width, height| Shape::Rectangle { width, height };
    let primitives = vec![
        body("floor", flat(12.0, 12.0), DVec3::ZERO, tiles),
        body("wall", Shape::Box { size: DVec3::new(8.0, 0.3, 2.6) }, DVec3::new(0.0, 3.0, 1.3), bricks),
        body("table", Shape::Box { size: DVec3::new(1.4, 0.8, 0.06) }, DVec3::new(0.2, 1.2, 0.7), wood),
        upright(body("picture", flat(1.3, 1.0), DVec3::new(-1.2, 2.84, 1.4), print)),
        upright(body("pane", flat(1.0, 1.2), DVec3::new(1.35, 2.2, 1.1), plain([0.8, 0.95, 0.85]))),
        body("ball", Shape::Sphere { radius: 0.28 }, DVec3::new(0.1, 1.1, 1.01), plain([0.9, 0.9, 0.95])),
        body("leg", Shape::Cylinder { radius: 0.05, height: 0.67 }, DVec3::new(0.2, 1.2, 0.335), wood),
        body(
            "pot",
            Shape::Cylinder { radius: 0.25, height: 0.5 },
            DVec3::new(-1.1, 0.7, 0.25),
            plain([0.7, 0.4, 0.3]),
        ),
        body("shrub", Shape::Sphere { radius: 0.45 }, DVec3::new(-1.1, 0.7, 0.85), plain([0.25, 0.45, 0.15])),
    ];
    let sky = Sky {
        zenith: [0.35, 0.55, 0.9],
        horizon: [0.8, 0.88, 0.95],
        ground: [0.45; 3],
        light: 0.6,
        occlusion: None,
    };
    Scene { primitives, sun: Some(SUN), ..Scene::under(sky) }
}

fn photographs() -> Photographs {
    Photographs {
        width: 240,
        height: 160,
        field_of_view: 62.0,
        path: Trajectory::Through {
            places: vec![DVec3::new(-0.6, -2.2, 1.5), DVec3::new(0.6, -2.0, 1.5)],
            targets: vec![DVec3::new(-0.1, 2.0, 0.9), DVec3::new(0.2, 2.0, 0.9)],
        },
        count: 9,
        samples: 9,
        distortion: None,
        aperture: None,
        motion_blur: None,
        rolling_shutter: None,
        exposure: None,
        noise: None,
        pose_error: None,
    }
}

fn lamp(size: DVec2) -> Lamp {
    Lamp {
        name: "lamp".into(),
        centre: DVec3::new(0.3, 0.9, 2.3),
        rotation: DVec3::X * 180.0,
        size,
        colour: [1.0, 0.85, 0.6],
        strength: 1.0,
    }
}

/// The ball as a mesh, with its own colours.
fn coloured_ball() -> Mesh {
    let (rows, columns) = (24u32, 48u32);
    let (mut vertices, mut colours, mut faces) = (Vec::new(), Vec::new(), Vec::new());
    for row in 0..=rows {
        for column in 0..=columns {
            let (up, turn) = (f64::from(row) / f64::from(rows), f64::from(column) / f64::from(columns));
            let (angle, turn) = (up * std::f64::consts::PI, turn * std::f64::consts::TAU);
            vertices.push(DVec3::new(angle.sin() * turn.cos(), angle.sin() * turn.sin(), -angle.cos()));
            let wave = (0.5 + 0.5 * (3.0 * turn).cos()) as f32;
            colours.push([wave, up as f32, 1.0 - wave]);
            if row < rows && column < columns {
                let corner = row * (columns + 1) + column;
                faces.push(vec![corner, corner + 1, corner + columns + 2, corner + columns + 1]);
            }
        }
    }
    let material = Material { pattern: Pattern::VertexColours, mottle: 0.0, seed: 0, finish: Finish::Matte };
    Mesh {
        name: "ball".into(),
        source: MeshSource::Inline { vertices, faces, colours },
        centre: DVec3::new(0.1, 1.1, 1.01),
        rotation: DVec3::ZERO,
        scale: 0.28,
        material,
    }
}

type Change = fn(&mut Scene, &mut Photographs);

/// Name, the picture without the effect, and what the effect adds to it.
const EFFECTS: [(&str, Change, Change); 19] = [
    ("hard sun", |s, _| s.sun = None, |s, _| s.sun = Some(SUN)),
    ("soft sun, 3 degrees", |_, _| (), |s, _| s.sun = Some(Sun { diameter: 3.0, ..SUN })),
    ("point lamp", |s, _| s.sun = None, |s, _| s.lamps = vec![lamp(DVec2::ZERO)]),
    ("lamp of 0.8 x 0.4 m", |s, _| s.sun = None, |s, _| s.lamps = vec![lamp(DVec2::new(0.8, 0.4))]),
    ("occlusion, 4 rays, 1 m", |_, _| (), |s, _| s.sky.occlusion = Some(Occlusion { reach: 1.0, rays: 4 })),
    (
        "mirror on the wall",
        |_, _| (),
        |s, _| {
            s.primitives[3].material.pattern = plain([0.9; 3]);
            s.primitives[3].material.finish = Finish::Mirror;
        },
    ),
    ("pane of glass", |_, _| (), |s, _| s.primitives[4].material.finish = Finish::Glass { index: 1.5 }),
    ("ball of glass", |_, _| (), |s, _| s.primitives[5].material.finish = Finish::Glass { index: 1.5 }),
    ("ball that mirrors", |_, _| (), |s, _| s.primitives[5].material.finish = Finish::Mirror),
    ("baked wall", |_, _| (), |s, _| s.primitives[1].material.finish = Finish::Baked),
    (
        "leaves with holes",
        |_, _| (),
        |s, _| {
            s.primitives[8].material.pattern = Pattern::Foliage {
                dark: [0.12, 0.25, 0.08],
                light: [0.45, 0.65, 0.25],
                leaf: 0.09,
                cover: 0.7,
            };
        },
    ),
    (
        "mesh of 2208 triangles with vertex colours",
        |s, _| drop(s.primitives.remove(5)),
        |s, _| {
            s.meshes = vec![coloured_ball()];
        },
    ),
    (
        "distortion of the lens",
        |_, _| (),
        |_, p| {
            p.distortion = Some(Distortion { k1: -0.25, k2: 0.06, k3: 0.0, p1: 0.001, p2: -0.001 });
        },
    ),
    ("aperture of 6 cm", |_, _| (), |_, p| p.aperture = Some(Aperture { diameter: 0.06, focus: 3.3 })),
    ("motion blur, half the interval", |_, _| (), |_, p| p.motion_blur = Some(0.5)),
    ("rolling shutter", |_, _| (), |_, p| p.rolling_shutter = Some(1.0)),
    (
        "exposure, 0.5 stops",
        |_, _| (),
        |_, p| {
            p.exposure = Some(Exposure { stops: 0.5, white_balance: 0.2 });
        },
    ),
    (
        "sensor noise, 1000 electrons",
        |_, _| (),
        |_, p| {
            p.noise = Some(SensorNoise { full_well: 1000.0, read: 8.0 });
        },
    ),
    (
        "all of the above that go together",
        |_, _| (),
        |s, p| {
            let mirror = s.primitives[3].clone();
            for (_, _, effect) in EFFECTS.iter().take(18) {
                effect(s, p);
            }
            s.primitives[5].material.finish = Finish::Glass { index: 1.5 };
            s.primitives[3].centre = mirror.centre;
            s.meshes.clear();
        },
    ),
];

/// Time that this thread spent computing, seconds: other programs do not count. Wall time where the system does not
/// tell.
fn clock(start: Instant) -> f64 {
    let stat = std::fs::read_to_string("/proc/thread-self/schedstat").unwrap_or_default();
    let nanoseconds = stat.split(' ').next().and_then(|word| word.parse::<f64>().ok());
    nanoseconds.map_or_else(|| start.elapsed().as_secs_f64(), |ns| ns * 1e-9)
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

struct Setting {
    scene: Traced,
    photographs: Photographs,
}

impl Setting {
    fn new(changes: &[Change]) -> Result<Self, Box<dyn Error>> {
        let (mut scene, mut photographs) = (scene(), photographs());
        changes.iter().for_each(|change| change(&mut scene, &mut photographs));
        Ok(Self { scene: Traced::new(&scene)?, photographs })
    }

    fn take(&self) -> scene_sim::Result<(Photograph, f64)> {
        let wall = Instant::now();
        let start = clock(wall);
        let taken = photograph(&self.scene, &self.photographs, 4, 0)?;
        Ok((taken, clock(wall) - start))
    }
}

fn save(folder: &Path, name: &str, photograph: &Photograph) -> Result<(), Box<dyn Error>> {
    let image = photograph.view.image();
    let (width, height) = (image.width() as u32, image.height() as u32);
    let name: String = name.chars().map(|c| if c.is_alphanumeric() { c } else { '-' }).collect();
    let picture =
        image::RgbImage::from_raw(width, height, image.to_rgb8()).ok_or("the picture has another size")?;
    Ok(picture.save(folder.join(format!("{name}.png")))?)
}

fn difference(a: &Photograph, b: &Photograph) -> (f64, f64) {
    let (a, b) = (a.view.image().data(), b.view.image().data());
    let mean =
        |f: fn(f64) -> f64| a.iter().zip(b).map(|(a, b)| f(f64::from(a - b))).sum::<f64>() / a.len() as f64;
    (mean(f64::abs), -10.0 * mean(|d| d * d).log10())
}

/// Rays and draws per pixel, by kind, those that are not 0.
fn per_pixel(counts: &RayCounts, pixels: f64) -> String {
    let kinds = [
        ("sun", counts.shadow),
        ("lamp", counts.lamp_shadow),
        ("occlusion", counts.occlusion),
        ("mirror", counts.mirror),
        ("reflected", counts.reflection),
        ("refracted", counts.refraction),
        ("distorted", counts.distorted),
        ("lens points", counts.lens_points),
        ("moments", counts.moments),
        ("row poses", counts.row_poses),
        ("gains", counts.gains),
        ("noise", counts.noise),
    ];
    let mut text = String::new();
    for (name, count) in kinds.into_iter().filter(|(_, count)| *count > 0) {
        let separator = if text.is_empty() { "" } else { ", " };
        let _ = write!(text, "{separator}{name} {:.3}", count as f64 / pixels);
    }
    text
}

fn run(folder: Option<&Path>) -> Result<(), Box<dyn Error>> {
    println!(
        "| effect | time with / without | ns per pixel more | per pixel, beside 9 + 1 camera rays | mean difference | PSNR, dB |"
    );
    println!("|---|---|---|---|---|---|");
    for (name, base, effect) in EFFECTS {
        let (without, with) = (Setting::new(&[base])?, Setting::new(&[base, effect])?);
        let (mut ratios, mut prices) = (Vec::new(), Vec::new());
        let (before, after) = (without.take()?.0, with.take()?.0);
        let pixels = before.view.depth().map_or(1, |depth| depth.data().len()) as f64;
        for _ in 0..RUNS {
            let (without, with) = (without.take()?.1, with.take()?.1);
            ratios.push(with / without);
            prices.push((with - without) / pixels * 1e9);
        }
        let (mean, psnr) = difference(&before, &after);
        let counts = per_pixel(&after.rays, pixels);
        let (ratio, price) = (median(ratios), median(prices));
        println!("| {name} | {ratio:.2} | {price:.0} | {counts} | {mean:.4} | {psnr:.1} |");
        if let Some(folder) = folder {
            save(folder, name, &after)?;
        }
    }
    let plain = Setting::new(&[])?;
    let (taken, _) = plain.take()?;
    let seconds = median((0..RUNS).map(|_| plain.take().map(|taken| taken.1)).collect::<Result<_, _>>()?);
    let rays = taken.rays.rays() as f64;
    println!("\nWith the hard sun alone: {:.2} million rays per second and thread.", rays / seconds / 1e6);
    if let Some(folder) = folder {
        save(folder, "plain", &taken)?;
    }
    Ok(())
}

fn main() -> Result<(), Box<dyn Error>> {
    let folder = std::env::args().nth(1);
    let folder = folder.as_deref().map(Path::new);
    if let Some(folder) = folder {
        std::fs::create_dir_all(folder)?;
    }
    // Rendered in the thread whose time is read.
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build()?;
    pool.install(|| run(folder).map_err(|error| error.to_string()))?;
    Ok(())
}
