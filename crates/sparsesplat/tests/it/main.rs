//! What a user of the crate may rely on.

// clippy.toml allows it in test functions; these helpers serve nothing else.
#![allow(clippy::unwrap_used)]

/// What corrects a refined scene.
mod corrector;
/// How many Gaussians, and where they come from.
mod counts;
/// Photographs of different exposure.
mod exposure;
/// Input that is wrong or extreme: an error that names it, or a defined result.
mod hostile;
/// What must and what must not change the result.
mod invariance;
/// Further looks at the views.
mod looks;
/// What the head gathers.
mod neighbours;
/// Held-out views of a simulated scene.
mod quality;

use gs_raster::{Rasterizer, RenderSettings};
use gs_scene::{Camera, Gaussians, Image, LOG_SCALE, MEAN, OPACITY_LOGIT, QUATERNION, View, sigmoid};
use scene_sim::{Traced, demo_cameras, demo_scene, render_view};
use sparsesplat::{
    Backbone, Budget, Config, DepthRange, Exposure, ExposureGain, Prediction, Predictor, Result, Stage,
};
use std::sync::LazyLock;

const WIDTH: usize = 160;
const HEIGHT: usize = 107;

/// Four neighbouring views of the demonstration courtyard, and the three held-out views between them, with exact depth.
static COURTYARD: LazyLock<(Vec<View>, Vec<View>)> = LazyLock::new(|| {
    let scene = Traced::new(&demo_scene()).unwrap();
    let (context, targets) = demo_cameras(WIDTH, HEIGHT).unwrap();
    (photograph(&scene, &context[1..5]), photograph(&scene, &targets[1..4]))
});

fn photograph(scene: &Traced, cameras: &[Camera]) -> Vec<View> {
    let name = |i: usize| format!("photograph {i}");
    cameras.iter().enumerate().map(|(i, camera)| render_view(scene, camera, 4, name(i), 0).unwrap()).collect()
}

/// Exact depth: fast, and nothing but the crate under test decides. One look: the head alone.
fn given_depth(gaussians: usize) -> Config {
    let budget = Budget::Gaussians(gaussians);
    Config { backbone: Backbone::GivenDepth, budget, looks: 1, ..Config::default() }
}

/// Stereo in the courtyard's range. One look: the head alone.
fn plane_sweep(gaussians: usize) -> Config {
    let depth_range = DepthRange::Known { near: 3.0, far: 10.0 };
    Config { budget: Budget::Gaussians(gaussians), depth_range, looks: 1, ..Config::default() }
}

fn predict(views: &[View], config: &Config) -> Result<Prediction> {
    Predictor::new(config.clone())?.predict(views, &mut |_| {})
}

fn run(views: &[View], config: &Config) -> Prediction {
    let prediction = predict(views, config).unwrap();
    check_prediction(views, &prediction, config);
    prediction
}

/// The promises that hold for every prediction: counts that add up, and Gaussians that a renderer can draw.
fn check_prediction(views: &[View], prediction: &Prediction, config: &Config) {
    let counts = &prediction.counts;
    assert_eq!(counts.total, prediction.gaussians.len());
    assert_eq!(counts.per_view.len(), views.len());
    assert_eq!(counts.per_view.iter().sum::<usize>() + counts.shell, counts.total);
    assert_eq!((prediction.geometry.len(), prediction.exposure.len()), (views.len(), views.len()));
    let closed_form = prediction.head == "closed-form";
    let differ = prediction.exposure.iter().any(|&view| view != ExposureGain::NONE);
    let coloured_by_direction = !closed_form || config.exposure == Exposure::AsPhotographed && differ;
    assert_eq!(prediction.gaussians.sh_degree(), if coloured_by_direction { 2 } else { 0 });
    check_gaussians(&prediction.gaussians, closed_form);
    let s = &prediction.seconds;
    for seconds in Stage::ALL.map(|stage| s[stage]) {
        assert!(seconds.is_finite() && seconds >= 0.0, "{s:?}");
    }
}

/// Rotations of the closed form are of unit length; a learned head may leave half of that.
fn check_gaussians(gaussians: &Gaussians, unit: bool) {
    assert!(gaussians.sh().iter().all(|v| v.is_finite()));
    for (i, row) in gaussians.geometry().chunks_exact(Gaussians::GEOMETRY).enumerate() {
        assert!(row.iter().all(|v| v.is_finite()), "Gaussian {i}: {row:?}");
        let norm: f32 = row[QUATERNION].iter().map(|v| v * v).sum();
        let sound = if unit { (norm - 1.0).abs() < 1e-4 } else { norm >= 0.24 };
        assert!(sound, "Gaussian {i}: quaternion of square norm {norm}");
        let opacity = sigmoid(row[OPACITY_LOGIT]);
        assert!(opacity > 0.0 && opacity < 1.0, "Gaussian {i}: opacity {opacity}");
        assert!(row[LOG_SCALE].iter().all(|v| v.exp() > 0.0 && v.exp().is_finite()), "Gaussian {i}: {row:?}");
    }
}

fn positions(gaussians: &Gaussians) -> Vec<[f32; 3]> {
    gaussians.geometry().chunks_exact(Gaussians::GEOMETRY).map(|row| row[MEAN].try_into().unwrap()).collect()
}

/// The prediction as the camera of a view sees it.
fn draw(prediction: &Prediction, view: &View) -> Image {
    let settings =
        RenderSettings { near: 0.1 * prediction.depth_range.0 as f32, ..RenderSettings::default() };
    let drawn = Rasterizer::cpu().render(&prediction.gaussians, view.camera(), &settings).unwrap();
    assert_eq!(drawn.stats.rejected, 0);
    drawn.image
}

/// Mean PSNR, decibels, of the prediction drawn from the targets' cameras.
fn psnr(prediction: &Prediction, targets: &[View]) -> f64 {
    let of = |target: &View| image_metrics::psnr(&draw(prediction, target), target.image()).unwrap();
    targets.iter().map(of).sum::<f64>() / targets.len() as f64
}
