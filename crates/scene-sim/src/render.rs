//! Views: antialiased colour by stratified samples, and exact depth at the pixel centres.

use crate::noise::{hash, unit};
use crate::texture::{Footprint, encode};
use crate::trace::{Met, PathRay, Surface, Traced};
use crate::{Error, Result};
use glam::{DVec2, DVec3, Vec3};
use gs_scene::{Camera, DepthMap, Image, View};
use rayon::prelude::*;
use std::ops::Add;

/// Rays that a view took, by kind. What a scene does not call for takes none.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct RayCounts {
    /// From the camera: one per colour sample, and one per pixel for the depth.
    pub primary: u64,
    /// From a lit surface towards the sun.
    pub shadow: u64,
}

impl Add for RayCounts {
    type Output = Self;
    fn add(self, other: Self) -> Self {
        Self { primary: self.primary + other.primary, shadow: self.shadow + other.shadow }
    }
}

/// Renders a view: colour as the mean of `samples_per_pixel` stratified samples (a square number is best),
/// and z-depth of the surface at each pixel's centre, 0 where there is only sky.
///
/// The same arguments give the same bits, on any number of threads.
///
/// # Errors
/// If `samples_per_pixel` is not 1 to 4096.
pub fn render_view(
    scene: &Traced,
    camera: &Camera,
    samples_per_pixel: u32,
    name: impl Into<String>,
    seed: u64,
) -> Result<View> {
    render_counted(scene, camera, samples_per_pixel, name, seed).map(|(view, _)| view)
}

/// [`render_view`] with the rays that it took.
///
/// # Errors
/// As [`render_view`].
pub fn render_counted(
    scene: &Traced,
    camera: &Camera,
    samples_per_pixel: u32,
    name: impl Into<String>,
    seed: u64,
) -> Result<(View, RayCounts)> {
    if !(1..=4096).contains(&samples_per_pixel) {
        return Err(Error::Samples { found: samples_per_pixel });
    }
    let (width, height) = (camera.width(), camera.height());
    let (mut colours, mut depths) = (vec![0.0; width * height * 3], vec![0.0; width * height]);
    let renderer = Renderer::new(scene, camera, samples_per_pixel, seed);
    let rows = colours.par_chunks_exact_mut(width * 3).zip(depths.par_chunks_exact_mut(width));
    let rays = rows
        .enumerate()
        .map(|(y, (colours, depths))| renderer.row(y, colours, depths))
        .reduce(RayCounts::default, Add::add);
    let image = Image::new(width, height, colours)?;
    let depth = DepthMap::new(width, height, depths)?;
    Ok((View::new(name, image, *camera, Some(depth))?, rays))
}

/// One view's constants.
struct Renderer<'a> {
    scene: &'a Traced,
    camera: &'a Camera,
    /// The camera centre, relative to the middle of the scene.
    origin: DVec3,
    /// Change of the ray's direction per pixel to the right and per pixel downwards.
    steps: [DVec3; 2],
    /// Columns and rows of the grid of samples in a pixel.
    strata: [u32; 2],
    seed: u32,
}

impl<'a> Renderer<'a> {
    fn new(scene: &'a Traced, camera: &'a Camera, samples: u32, seed: u64) -> Self {
        let lens = camera.intrinsics();
        let to_world = camera.rotation().transpose();
        // The grid closest to a square that holds exactly as many samples as asked for.
        let rows = (1..=samples.isqrt()).rev().find(|rows| samples.is_multiple_of(*rows)).unwrap_or(1);
        Self {
            scene,
            camera,
            origin: scene.relative(camera.position()),
            steps: [to_world.x_axis / lens.fx, to_world.y_axis / lens.fy],
            strata: [samples / rows, rows],
            seed: hash(seed as u32, (seed >> 32) as u32, 0, 0),
        }
    }

    /// The ray through a point of the image; its parameter is the z-depth.
    fn ray(&self, pixel: DVec2) -> PathRay {
        let direction = self.camera.rotation().transpose() * self.camera.intrinsics().ray(pixel);
        PathRay { origin: self.origin, direction }
    }

    fn row(&self, y: usize, colours: &mut [f32], depths: &mut [f32]) -> RayCounts {
        let mut rays = RayCounts::default();
        for (x, (colour, depth)) in colours.chunks_exact_mut(3).zip(depths).enumerate() {
            rays.primary += 1;
            let centre = self.ray(DVec2::new(x as f64 + 0.5, y as f64 + 0.5));
            *depth = self.scene.nearest(&centre).map_or(0.0, |hit| hit.t as f32);
            colour.copy_from_slice(&encode(self.pixel(x, y, &mut rays)));
        }
        rays
    }

    /// Mean light of the samples of a pixel.
    fn pixel(&self, x: usize, y: usize, rays: &mut RayCounts) -> Vec3 {
        let [columns, rows] = self.strata;
        let mut sum = Vec3::ZERO;
        for index in 0..columns * rows {
            let bits = hash(x as u32, y as u32, index, self.seed);
            let jitter = DVec2::new(unit(bits), unit(hash(bits, 1, 0, self.seed)));
            let stratum = DVec2::new(f64::from(index % columns), f64::from(index / columns));
            let within = (stratum + jitter) / DVec2::new(f64::from(columns), f64::from(rows));
            rays.primary += 1;
            let ray = self.ray(DVec2::new(x as f64, y as f64) + within);
            // Clipped per sample: a bright surface behind an edge must not outshine it (the display cannot
            // show it).
            sum += self.light(&ray, rays).min(Vec3::ONE);
        }
        sum / (columns * rows) as f32
    }

    /// The light that comes in along a camera ray.
    fn light(&self, ray: &PathRay, rays: &mut RayCounts) -> Vec3 {
        let Some(hit) = self.scene.nearest(ray) else { return self.scene.sky.background(ray.direction) };
        let surface = match self.scene.met(ray, hit) {
            Met::Surface(surface) => surface,
            // What it sheds is not simulated yet.
            Met::Lamp(_) => return Vec3::ONE,
        };
        let footprint = self.footprint(ray, hit.t, &surface);
        let reflectance = surface.texture.reflectance(&surface.canvas, &surface.point, &footprint);
        reflectance * (self.scene.sky.ambient(surface.normal) + self.sunlight(&surface, rays))
    }

    /// What a white surface reflects of the sun.
    fn sunlight(&self, surface: &Surface<'_>, rays: &mut RayCounts) -> Vec3 {
        let Some(sun) = &self.scene.sun else { return Vec3::ZERO };
        let cosine = surface.normal.dot(sun.direction);
        if cosine <= 0.0 {
            return Vec3::ZERO;
        }
        rays.shadow += 1;
        let towards = PathRay { origin: surface.departure(sun.direction), direction: sun.direction };
        if self.scene.is_blocked(&towards, f64::INFINITY) { Vec3::ZERO } else { sun.radiance * cosine as f32 }
    }

    /// The part of the surface's tangent plane that one sample covers (ray differentials), in shape axes.
    fn footprint(&self, ray: &PathRay, depth: f64, surface: &Surface<'_>) -> Footprint {
        let facing = surface.normal.dot(ray.direction);
        // Edge-on the footprint has no end; this bounds it without a visible effect.
        let facing = if facing.abs() < 1e-6 { -1e-6 } else { facing };
        let [across, down] = std::array::from_fn(|i| {
            let step = self.steps[i] / f64::from(self.strata[i]);
            surface.to_local * ((step - ray.direction * (surface.normal.dot(step) / facing)) * depth)
        });
        Footprint { across, down }
    }
}
