//! - `anchors`: positions, rays, footprints, colours; order, ranges, threads
//! - `normals`: planes, steps in depth, what is too little to tell, and a plain fit as the oracle
//! - `features`: bilinear look-up against its definition
//! - `hostile`: depths and sizes that are wrong, and what is refused by name

mod anchors;
mod features;
mod hostile;
mod normals;

use backproject::{Backprojected, Settings, ViewPixels};
use glam::{DMat3, DVec2, DVec3};
use gs_scene::{Camera, Intrinsics};
use proptest::prelude::*;

/// Off-centre lens, fx ≠ fy.
const LENS: Intrinsics = Intrinsics { fx: 90.0, fy: 75.0, cx: 13.0, cy: 19.5, width: 40, height: 30 };
const PIXELS: usize = LENS.width * LENS.height;

fn camera() -> Camera {
    Camera::new(LENS, DMat3::IDENTITY, DVec3::ZERO).expect("a valid camera")
}

/// [`LENS`] at any rotation, up to 1e4 units from the origin.
fn any_camera() -> impl Strategy<Value = Camera> {
    let angles = prop::array::uniform3(-3.0..3.0f64);
    (angles, prop::array::uniform3(-1e4..1e4f64)).prop_map(|(angles, translation)| {
        let rotation = DMat3::from_euler(glam::EulerRot::XYZ, angles[0], angles[1], angles[2]);
        Camera::new(LENS, rotation, DVec3::from(translation)).expect("a valid camera")
    })
}

/// The centre of a pixel of a picture of [`LENS`].
fn centre(pixel: usize) -> DVec2 {
    DVec2::new((pixel % LENS.width) as f64 + 0.5, (pixel / LENS.width) as f64 + 0.5)
}

/// z-depth from a function of the ray (x/z, y/z, 1) through each pixel's centre.
fn depth_map(depth: impl Fn(DVec3) -> f64) -> Vec<f32> {
    (0..PIXELS).map(|i| depth(LENS.ray(centre(i))) as f32).collect()
}

fn every_pixel() -> Vec<u32> {
    (0..PIXELS as u32).collect()
}

fn view<'a>(camera: &'a Camera, depth: &'a [f32], pixels: &'a [u32]) -> ViewPixels<'a> {
    ViewPixels { camera, depth, pixels, image: None, features: None }
}

fn anchors_of(view: ViewPixels) -> Backprojected {
    backproject::anchors(&[view], &Settings::default()).expect("sizes fit")
}
