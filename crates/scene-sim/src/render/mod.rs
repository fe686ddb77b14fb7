//! Views: antialiased colour by stratified samples, and exact depth at the pixel centres.

mod beam;
mod counts;
mod draws;
mod film;
mod lens_rays;
mod optics;
mod photograph;
mod rays;
mod sensor;
mod shade;

pub use counts::RayCounts;
pub use photograph::{Photograph, photograph, photograph_with_light};

use crate::noise::{hash, unit};
use crate::trace::Traced;
use crate::{Error, Result};
use draws::Draws;
use film::{Film, Plain};
use glam::{DVec2, Vec3};
use gs_scene::{Camera, DepthMap, Image, View};
use rayon::prelude::*;
use rays::{CameraRays, Pinhole, strata};
use std::ops::Add;

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

/// [`render_view`] with what it took.
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
    check_samples(samples_per_pixel)?;
    let rays = Pinhole::new(scene, camera, samples_per_pixel);
    let renderer =
        Renderer { scene, rays: &rays, film: &Plain, strata: strata(samples_per_pixel), seed: fold(seed) };
    let Picture { image, depth, counts, .. } = renderer.picture(camera.width(), camera.height(), false)?;
    Ok((View::new(name, image, *camera, Some(depth))?, counts))
}

/// At most this many samples per pixel are of use.
fn check_samples(found: u32) -> Result<()> {
    if (1..=4096).contains(&found) { Ok(()) } else { Err(Error::Samples { found }) }
}

/// A seed as hash input.
fn fold(seed: u64) -> u32 {
    hash(seed as u32, (seed >> 32) as u32, 0, 0)
}

/// One picture's constants.
struct Renderer<'a, R, F> {
    scene: &'a Traced,
    rays: &'a R,
    film: &'a F,
    /// Columns and rows of the grid of samples in a pixel.
    strata: [u32; 2],
    seed: u32,
}

struct Picture {
    image: Image,
    depth: DepthMap,
    /// Mean light of the pixels before it is recorded, where asked for.
    linear: Option<Image>,
    counts: RayCounts,
}

impl<R: CameraRays, F: Film> Renderer<'_, R, F> {
    fn picture(&self, width: usize, height: usize, keep_linear: bool) -> Result<Picture> {
        let (mut colours, mut depths) = (vec![0.0; width * height * 3], vec![0.0; width * height]);
        let mut linear = vec![0.0; if keep_linear { colours.len() } else { 0 }];
        let mut linear_rows: Vec<&mut [f32]> = linear.chunks_exact_mut(width * 3).collect();
        linear_rows.resize_with(height, Default::default);
        let rows = colours.par_chunks_exact_mut(width * 3).zip(depths.par_chunks_exact_mut(width));
        let counts = rows
            .zip(linear_rows)
            .enumerate()
            .map(|(y, ((colours, depths), linear))| self.row(y, colours, depths, linear))
            .reduce(RayCounts::default, Add::add);
        let linear = keep_linear.then(|| Image::new(width, height, linear)).transpose()?;
        Ok(Picture {
            image: Image::new(width, height, colours)?,
            depth: DepthMap::new(width, height, depths)?,
            linear,
            counts: counts + self.rays.prepared(),
        })
    }

    fn row(&self, y: usize, colours: &mut [f32], depths: &mut [f32], linear: &mut [f32]) -> RayCounts {
        let mut counts = RayCounts { depth: depths.len() as u64, ..RayCounts::default() };
        for (x, (colour, depth)) in colours.chunks_exact_mut(3).zip(depths).enumerate() {
            *depth = self.scene.nearest(&self.rays.depth(x, y)).map_or(0.0, |hit| hit.t as f32);
            let (recorded, light) = self.pixel(x, y, &mut counts);
            colour.copy_from_slice(&self.film.develop(x, y, recorded, &mut counts));
            if let Some(linear) = linear.get_mut(3 * x..3 * x + 3) {
                linear.copy_from_slice(&light.to_array());
            }
        }
        counts
    }

    /// Means over the samples of a pixel: of what is recorded, and of the light.
    fn pixel(&self, x: usize, y: usize, counts: &mut RayCounts) -> (Vec3, Vec3) {
        let [columns, rows] = self.strata;
        let count = columns * rows;
        let (mut recorded, mut sum) = (Vec3::ZERO, Vec3::ZERO);
        for index in 0..count {
            let bits = hash(x as u32, y as u32, index, self.seed);
            let jitter = DVec2::new(unit(bits), unit(hash(bits, 1, 0, self.seed)));
            let stratum = DVec2::new(f64::from(index % columns), f64::from(index / columns));
            let within = (stratum + jitter) / DVec2::new(f64::from(columns), f64::from(rows));
            let draws = Draws { pixel: [x as u32, y as u32], index, strata: self.strata, seed: self.seed };
            counts.primary += 1;
            let beam = self.rays.colour([x, y], within, &draws, counts);
            let light = shade::light(self.scene, &beam, draws, counts);
            recorded += self.film.expose(light);
            sum += light;
        }
        (recorded / count as f32, sum / count as f32)
    }
}
