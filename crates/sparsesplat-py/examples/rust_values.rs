//! Writes what the Rust API says of a small scene, for the tests of the Python module to compare with, to the bit.
//!
//! `rust_values FOLDER`: arrays as raw little-endian float32 (poses float64), one file each, and `values.json`.

use evaluate::{Method, Runner};
use gs_raster::{Activated, Colors, PixelGradients, Rasterizer, RenderSettings, near_plane};
use gs_scene::{Gaussians, SH_C0, View, sigmoid, write_ply};
use scene_windows::{SimulatedScene, simulated_window};
use serde_json::json;
use sparsesplat::{Budget, Config};
use std::error::Error;
use std::fs;
use std::path::Path;

const SIZE: (usize, usize) = (120, 80);

fn main() -> Result<(), Box<dyn Error>> {
    let folder = std::env::args_os().nth(1).ok_or("usage: rust_values FOLDER")?;
    let folder = Path::new(&folder);
    fs::create_dir_all(folder)?;
    let window = simulated_window(SimulatedScene::Courtyard, SIZE)?;

    // The pass.
    let config = Config { budget: Budget::Gaussians(2_000), ..Config::default() };
    let runner = Runner::new(Method::feed_forward(config))?;
    let outcome = runner.reconstruct(&window, &mut Rasterizer::cpu(), &mut |_| {})?;
    let predicted = outcome.prediction.gaussians;
    write_ply(&folder.join("predicted.ply"), &predicted)?;

    // The same scene with every coefficient of degree 2 in use, as arrays of activated numbers.
    let lifted = lift(&predicted)?;
    let row = Gaussians::GEOMETRY;
    let columns = |geometry: &[f32], from: usize, to: usize| -> Vec<f32> {
        geometry.chunks_exact(row).flat_map(|row| row[from..to].to_vec()).collect()
    };
    let (means, quats) = (columns(lifted.geometry(), 0, 3), columns(lifted.geometry(), 3, 7));
    let scales: Vec<f32> = columns(lifted.geometry(), 7, 10).into_iter().map(f32::exp).collect();
    let opacities: Vec<f32> = columns(lifted.geometry(), 10, 11).into_iter().map(sigmoid).collect();
    write(folder, "means", &means)?;
    write(folder, "quats", &quats)?;
    write(folder, "scales", &scales)?;
    write(folder, "opacities", &opacities)?;
    write(folder, "sh", lifted.sh())?;
    let kind = Colors::Sh { degree: 2, per_gaussian: 9 };
    let arrays = Activated {
        means: &means,
        quats: &quats,
        scales: &scales,
        opacities: &opacities,
        colors: lifted.sh(),
        kind,
    };

    // Pictures and gradients.
    let cameras: Vec<_> = window.targets[..2].iter().map(|view| *view.camera()).collect();
    let settings = RenderSettings { depth: true, background: [0.1, 0.2, 0.3], ..RenderSettings::default() };
    let mut rasterizer = Rasterizer::cpu();
    let (views, tape) = rasterizer.record_activated(&arrays, &cameras, &settings)?;
    let pixels = SIZE.0 * SIZE.1;
    let weight = |place: usize| ((place * 7 % 11) as f32 - 5.0) / 5.0;
    let weights =
        |view: usize, channels: usize| (0..pixels * channels).map(|i| weight(i + view)).collect::<Vec<_>>();
    let gradients: Vec<PixelGradients> = (0..cameras.len())
        .map(|view| PixelGradients {
            image: weights(view, 3).into(),
            alpha: Some(weights(view, 1)),
            depth: Some(weights(view, 1)),
        })
        .collect();
    let by = rasterizer.backward_activated(&arrays, &tape, &gradients)?;
    let join = |plane: &dyn Fn(&gs_raster::Rendering) -> Vec<f32>| -> Vec<f32> {
        views.iter().flat_map(plane).collect()
    };
    write(folder, "image", &join(&|view| view.image.data().to_vec()))?;
    write(folder, "alpha", &join(&|view| view.alpha.clone()))?;
    write(folder, "depth", &join(&|view| view.depth.clone().unwrap_or_default()))?;
    write(folder, "by_means", &by.means)?;
    write(folder, "by_quats", &by.quats)?;
    write(folder, "by_scales", &by.scales)?;
    write(folder, "by_opacities", &by.opacities)?;
    write(folder, "by_sh", &by.colors)?;
    let background: Vec<f32> = by.background.iter().map(|&number| number as f32).collect();
    write(folder, "by_background", &background)?;

    // A picture of the stored scene as the commands draw it, and of colours instead of SH.
    let camera = cameras[0];
    let near = near_plane(&predicted, &camera);
    let view =
        rasterizer.render(&predicted, &camera, &RenderSettings { near, ..RenderSettings::default() })?;
    write(folder, "predicted_image", view.image.data())?;
    let constant =
        predicted.sh().chunks_exact(predicted.sh().len() / predicted.len()).flat_map(|sh| &sh[..3]);
    let rgb: Vec<f32> = constant.map(|dc| 0.5 + SH_C0 * dc).collect();
    write(folder, "rgb", &rgb)?;
    let coloured = Activated { colors: &rgb, kind: Colors::Rgb, ..arrays };
    let views = rasterizer.render_activated(&coloured, &[camera], &RenderSettings::default())?;
    write(folder, "rgb_image", views[0].image.data())?;

    // Metrics.
    let points: Vec<[f32; 3]> = means.as_chunks().0.to_vec();
    let neighbours = knn::knn(&points, 8)?;
    write(folder, "sq_distances", &neighbours.sq_distances)?;
    let (a, b) = (window.context[0].image(), window.context[1].image());
    let bits =
        entropy_sampler::entropy(&a.luma8(), SIZE.0, SIZE.1, entropy_sampler::EntropyWindow::default())?;
    write(folder, "entropy", &bits)?;
    let poses: Vec<Vec<f64>> = by
        .cameras
        .iter()
        .map(|pose| {
            (0..3)
                .flat_map(|r| {
                    let row = pose.rotation.row(r);
                    [row.x, row.y, row.z, pose.translation[r]]
                })
                .collect()
        })
        .collect();
    let values = json!({
        "size": SIZE,
        "poses": poses,
        "neighbours": neighbours.indices,
        "psnr": image_metrics::psnr(a, b)?,
        "ssim": image_metrics::ssim(a, b)?,
        "counts": outcome.figures.counts,
        "names": window.context.iter().map(View::name).collect::<Vec<_>>(),
    });
    fs::write(folder.join("values.json"), values.to_string())?;
    Ok(())
}

/// The Gaussians with SH coefficients up to degree 2 that depend on their place alone.
fn lift(scene: &Gaussians) -> Result<Gaussians, gs_scene::Error> {
    let mut lifted = scene.clone().with_sh_degree(2)?;
    let (_, sh) = lifted.buffers_mut();
    for (place, value) in sh.iter_mut().enumerate().filter(|(place, _)| place % 27 >= 3) {
        *value += ((place * 13 % 17) as f32 - 8.0) / 200.0;
    }
    Ok(lifted)
}

fn write(folder: &Path, name: &str, numbers: &[f32]) -> std::io::Result<()> {
    let bytes: Vec<u8> = numbers.iter().flat_map(|number| number.to_le_bytes()).collect();
    fs::write(folder.join(format!("{name}.f32")), bytes)
}
