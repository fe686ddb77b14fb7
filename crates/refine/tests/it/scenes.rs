//! A small scene of Gaussians and what it looks like.

use glam::DVec3;
use gs_raster::{Rasterizer, RenderSettings, near_plane};
use gs_scene::{Camera, Gaussians, Image, Intrinsics, View, dc_from_rgb, logit};

/// Numbers 0..1 from a place in a stream.
pub(crate) struct Random(pub(crate) u64);

impl Random {
    pub(crate) fn unit(&mut self) -> f32 {
        self.0 = self.0.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
        (self.0 >> 40) as f32 / (1u64 << 24) as f32
    }

    pub(crate) fn between(&mut self, low: f32, high: f32) -> f32 {
        low + (high - low) * self.unit()
    }
}

/// Cameras on an arc around (0, 0, 4) · scale.
pub(crate) fn cameras(n: usize, (width, height): (usize, usize), scale: f64) -> Vec<Camera> {
    let focal = width as f64;
    let (cx, cy) = (width as f64 / 2.0, height as f64 / 2.0);
    let lens = Intrinsics { fx: focal, fy: focal, cx, cy, width, height };
    (0..n)
        .map(|i| {
            let angle = (i as f64 - (n as f64 - 1.0) / 2.0) * 0.15;
            let position = DVec3::new(4.0 * angle.sin(), 0.1 * i as f64, 4.0 - 4.0 * angle.cos()) * scale;
            Camera::looking_at(lens, position, DVec3::new(0.0, 0.0, 4.0) * scale, DVec3::NEG_Y).unwrap()
        })
        .collect()
}

/// A coloured, wavy wall of `side`² Gaussians around (0, 0, 4) · scale.
pub(crate) fn wall(side: usize, scale: f32) -> Gaussians {
    let mut random = Random(7);
    let mut scene = Gaussians::empty(0).unwrap();
    for i in 0..side * side {
        let (u, v) = ((i % side) as f32 / side as f32 - 0.5, (i / side) as f32 / side as f32 - 0.5);
        let depth = 4.0 + 0.2 * (9.0 * u).sin() * (7.0 * v).cos();
        let colour = [0.5 + 0.4 * (13.0 * u).sin(), 0.5 + 0.4 * (11.0 * v).cos(), random.between(0.2, 0.8)];
        let width = (2.0 / side as f32 * scale).ln();
        scene.push(
            [4.0 * u * scale, 3.0 * v * scale, depth * scale],
            [1.0, random.between(-0.2, 0.2), random.between(-0.2, 0.2), 0.0],
            [width, width - 0.3, width - 1.5],
            logit(0.85),
            &dc_from_rgb(colour),
        );
    }
    scene
}

/// The same scene, somewhat off in everything.
pub(crate) fn disturbed(scene: &Gaussians, scale: f32) -> Gaussians {
    let mut random = Random(99);
    let mut off = scene.clone();
    let (geometry, sh) = off.buffers_mut();
    for row in geometry.chunks_exact_mut(Gaussians::GEOMETRY) {
        (0..3).for_each(|i| row[i] += random.between(-0.03, 0.03) * scale);
        (3..7).for_each(|i| row[i] += random.between(-0.1, 0.1));
        (7..10).for_each(|i| row[i] += random.between(-0.2, 0.2));
        row[10] += random.between(-0.5, 0.5);
    }
    sh.iter_mut().for_each(|v| *v += random.between(-0.2, 0.2));
    off
}

/// Renderings of a scene as if they were photographs.
pub(crate) fn photographs(scene: &Gaussians, cameras: &[Camera]) -> Vec<View> {
    let mut rasterizer = Rasterizer::cpu();
    let view = |(i, camera): (usize, &Camera)| {
        let settings = RenderSettings { near: near_plane(scene, camera), ..RenderSettings::default() };
        let image: Image = rasterizer.render(scene, camera, &settings).unwrap().image;
        View::new(format!("view-{i}"), image, *camera, None).unwrap()
    };
    cameras.iter().enumerate().map(view).collect()
}
