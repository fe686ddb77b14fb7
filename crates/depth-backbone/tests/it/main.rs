//! What a user of the crate may rely on.

// clippy.toml allows it in test functions; these helpers serve nothing else.
#![allow(clippy::unwrap_used)]

/// Stereo against the exact depth of simulated scenes.
mod accuracy;
/// DepthSplat's network.
#[cfg(feature = "depthsplat")]
mod depthsplat;
/// Measured depth.
mod given_depth;
/// Input that is wrong, empty or useless: an error that names it, or a defined result.
mod hostile;
/// What must not change the result: scale, offset and number of threads.
mod invariance;
mod learned;

use depth_backbone::{DepthBackbone, DepthRange, PlaneSweep, ViewGeometry, Wanted};
use glam::{DMat3, DVec3};
use gs_scene::{Camera, DepthMap, Image, Intrinsics, View};
use scene_sim::{Traced, demo_cameras, demo_scene, render_view, varied_cameras, varied_scene};
use std::sync::LazyLock;

/// Six views of the demonstration courtyard with exact depth, 160×107 pixels.
static COURTYARD: LazyLock<Vec<View>> = LazyLock::new(|| {
    let scene = Traced::new(&demo_scene()).unwrap();
    photograph(&scene, &demo_cameras(160, 107).unwrap().0)
});

/// Four views of a random room with exact depth, 160×107 pixels.
static ROOM: LazyLock<Vec<View>> = LazyLock::new(|| {
    let scene = Traced::new(&varied_scene(5)).unwrap();
    photograph(&scene, &varied_cameras(5, 160, 107, 4).unwrap())
});

fn photograph(scene: &Traced, cameras: &[Camera]) -> Vec<View> {
    let name = |i: usize| format!("photograph {i}");
    cameras.iter().enumerate().map(|(i, camera)| render_view(scene, camera, 4, name(i), 0).unwrap()).collect()
}

/// Smallest and largest exact depth but one percent at either end.
fn true_range(views: &[View]) -> (f64, f64) {
    let mut all: Vec<f32> =
        views.iter().flat_map(|view| view.depth().unwrap().data()).copied().filter(|&d| d > 0.0).collect();
    all.sort_by(f32::total_cmp);
    (f64::from(all[all.len() / 100]), f64::from(all[all.len() * 99 / 100]))
}

fn known(views: &[View]) -> PlaneSweep {
    let (near, far) = true_range(views);
    sweep(DepthRange::Known { near, far })
}

fn sweep(range: DepthRange) -> PlaneSweep {
    PlaneSweep { range, ..PlaneSweep::default() }
}

fn depths(sweep: &PlaneSweep, views: &[View]) -> Vec<ViewGeometry> {
    let geometry = sweep.estimate(views, Wanted::Depth).unwrap();
    check_geometry(views, &geometry);
    geometry
}

/// The promises that hold for any views: sizes, confidence in 0..1, and a depth wherever there is confidence.
fn check_geometry(views: &[View], geometry: &[ViewGeometry]) {
    assert_eq!(geometry.len(), views.len());
    for (view, geometry) in views.iter().zip(geometry) {
        let size = (view.camera().width(), view.camera().height());
        assert_eq!((geometry.depth.width(), geometry.depth.height()), size, "{}", view.name());
        assert_eq!(geometry.confidence.len(), size.0 * size.1, "{}", view.name());
        for (i, (&depth, &confidence)) in geometry.depth.data().iter().zip(&geometry.confidence).enumerate() {
            assert!((0.0..=1.0).contains(&confidence), "{} pixel {i}: confidence {confidence}", view.name());
            assert!(
                depth.is_finite() && (depth > 0.0 || confidence == 0.0),
                "{} pixel {i}: depth {depth}",
                view.name()
            );
        }
        if let Some(features) = geometry.feature_map(view).unwrap() {
            assert_eq!((features.width(), features.height()), size, "{}", view.name());
        }
    }
}

const LENS: Intrinsics = Intrinsics { fx: 40.0, fy: 40.0, cx: 20.0, cy: 15.0, width: 40, height: 30 };

/// A camera that looks along z from `x`.
fn camera_at(x: f64) -> Camera {
    Camera::new(LENS, DMat3::IDENTITY, DVec3::new(-x, 0.0, 0.0)).unwrap()
}

/// A view of one colour.
fn flat(name: &str, camera: Camera, grey: f32) -> View {
    let image = Image::filled(camera.width(), camera.height(), [grey; 3]).unwrap();
    View::new(name, image, camera, None).unwrap()
}

fn with_depth(view: &View, depth: Option<Vec<f32>>) -> View {
    let depth = depth.map(|data| DepthMap::new(view.camera().width(), view.camera().height(), data).unwrap());
    View::new(view.name(), view.image().clone(), *view.camera(), depth).unwrap()
}
