//! Small random scenes and cameras.

use glam::{DMat3, DVec3, EulerRot};
use gs_raster::{Gradients, PixelGradients, Rasterizer, RenderSettings, Rendering, Result};
use gs_scene::{Camera, Gaussians, Intrinsics};
use proptest::prelude::*;

/// Sizes around multiples of the tile, fx ≠ fy, principal point anywhere in the image.
pub(crate) fn camera() -> impl Strategy<Value = Camera> {
    let size = prop_oneof![1usize..40, Just(15), Just(16), Just(17), Just(32), Just(33)];
    let pose = (prop::array::uniform3(-0.3..0.3f64), prop::array::uniform3(-0.5..0.5f64));
    (size.clone(), size, 0.6..2.0f64, 0.8..1.25f64, prop::array::uniform2(0.0..1.0f64), pose).prop_map(
        |(width, height, zoom, aspect, centre, (angles, offset))| {
            let focal = zoom * width.max(height) as f64;
            let intrinsics = Intrinsics {
                fx: focal,
                fy: focal * aspect,
                cx: centre[0] * width as f64,
                cy: centre[1] * height as f64,
                width,
                height,
            };
            let rotation = DMat3::from_euler(EulerRot::XYZ, angles[0], angles[1], angles[2]);
            Camera::new(intrinsics, rotation, DVec3::from(offset)).expect("valid")
        },
    )
}

/// Up to `n` Gaussians in front of and around the camera; depths differ by more than rounding.
pub(crate) fn gaussians(n: usize) -> impl Strategy<Value = Gaussians> {
    (0usize..4, 0..=n).prop_flat_map(|(degree, n)| {
        let k = gs_scene::sh_coefficients(degree) * 3;
        let row = (
            prop::array::uniform2(-2.0..2.0f32),
            prop::array::uniform4(-1.0..1.0f32),
            prop::array::uniform3(-5.0..0.5f32),
            -6.0..8.0f32,
            prop::collection::vec(-0.8..0.8f32, k),
        );
        prop::collection::vec(row, n).prop_map(move |rows| {
            let mut scene = Gaussians::empty(degree).expect("valid");
            let count = rows.len();
            for (i, ([x, y], quaternion, log_scale, logit, sh)) in rows.into_iter().enumerate() {
                // Far apart in z, in scrambled order, some behind the camera.
                let z = -0.5 + 5.0 * ((i * 7919) % count) as f32 / count as f32;
                scene.push([x, y, z], quaternion, log_scale, logit, &sh);
            }
            scene
        })
    })
}

/// One view on the CPU.
pub(crate) fn render(scene: &Gaussians, camera: &Camera, settings: &RenderSettings) -> Result<Rendering> {
    Rasterizer::cpu().render(scene, camera, settings)
}

/// The gradients of one view on the CPU.
pub(crate) fn backward(
    scene: &Gaussians,
    camera: &Camera,
    settings: &RenderSettings,
    pixels: &PixelGradients,
) -> Gradients {
    let mut rasterizer = Rasterizer::cpu();
    let (_, tape) = rasterizer.record(scene, &[*camera], settings).expect("valid");
    rasterizer.backward(scene, &tape, std::slice::from_ref(pixels)).expect("valid")
}
