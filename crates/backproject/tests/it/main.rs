//! - `anchors`: positions, rays, footprints, and what is refused
//! - `normals`: planes, steps in depth, and what is too little to tell

mod anchors;
mod normals;

use glam::{DMat3, DVec3};
use gs_scene::{Camera, DepthMap, Intrinsics};
use proptest::prelude::*;

/// Off-centre lens, fx ≠ fy.
const LENS: Intrinsics = Intrinsics { fx: 90.0, fy: 75.0, cx: 13.0, cy: 19.5, width: 40, height: 30 };

/// Any rotation, up to 1e4 units from the origin.
fn any_camera() -> impl Strategy<Value = Camera> {
    let angles = prop::array::uniform3(-3.0..3.0f64);
    (angles, prop::array::uniform3(-1e4..1e4f64)).prop_map(|(angles, translation)| {
        let rotation = DMat3::from_euler(glam::EulerRot::XYZ, angles[0], angles[1], angles[2]);
        Camera::new(LENS, rotation, DVec3::from(translation)).expect("a valid camera")
    })
}

/// z-depth from a function of the ray (x/z, y/z, 1) through each pixel's centre.
fn depth_map(intrinsics: Intrinsics, depth: impl Fn(DVec3) -> f64) -> DepthMap {
    let Intrinsics { width, height, .. } = intrinsics;
    let centre = |i: usize| glam::DVec2::new((i % width) as f64 + 0.5, (i / width) as f64 + 0.5);
    let data = (0..width * height).map(|i| depth(intrinsics.ray(centre(i))) as f32).collect();
    DepthMap::new(width, height, data).expect("sizes fit")
}
