//! Lifts pixels to points, in f64.

use glam::{DMat3, DVec2, DVec3};
use gs_scene::{Camera, Intrinsics};

/// Anchors that are computed together.
pub(crate) const CHUNK: usize = 256;

/// Column and row of a pixel; its centre is half a pixel further.
#[derive(Clone, Copy, Default)]
pub(crate) struct Place {
    pub(crate) x: u32,
    pub(crate) y: u32,
}

/// Splits row-major indices into columns and rows.
pub(crate) fn split(pixels: &[u32], width: usize, out: &mut [Place]) {
    let width = width as u32;
    for (&pixel, place) in pixels.iter().zip(out) {
        *place = Place { x: pixel % width, y: pixel / width };
    }
}

/// A camera's way from pixels into the world.
pub(crate) struct Lift {
    lens: Intrinsics,
    /// Inverse, not transpose, of the rotation: a camera's may be off orthonormal by 1e-4, which 1e4 units from the
    /// origin is one unit.
    to_world: DMat3,
    centre: DVec3,
    focal: f64,
}

/// Where a chunk's lifted pixels go, one entry each.
pub(crate) struct Lifted<'a> {
    pub(crate) positions: &'a mut [[f64; 3]],
    pub(crate) rays: &'a mut [[f32; 3]],
    pub(crate) footprints: &'a mut [f32],
}

impl Lift {
    pub(crate) fn new(camera: &Camera) -> Self {
        let lens = *camera.intrinsics();
        let to_world = camera.rotation().inverse();
        let centre = -(to_world * camera.translation());
        Self { lens, to_world, centre, focal: (lens.fx * lens.fy).sqrt() }
    }

    /// Whether every pixel at every depth gives finite numbers: rays are linear in the pixel, so that the corners
    /// bound them.
    pub(crate) fn is_finite(&self) -> bool {
        let (right, bottom) = (self.lens.width as f64, self.lens.height as f64);
        let corners = [(0.0, 0.0), (right, 0.0), (0.0, bottom), (right, bottom)];
        self.focal > 0.0
            && self.focal.is_finite()
            && corners.into_iter().all(|(x, y)| {
                let ray = self.to_world * self.lens.ray(DVec2::new(x, y));
                (self.centre + ray * f64::from(f32::MAX)).is_finite() && ray.length_squared().is_finite()
            })
    }
}

/// Lifts pixels at their z-depths.
#[inline(always)]
pub(crate) fn lift(lift: &Lift, places: &[Place], depths: &[f32], out: Lifted) {
    let out = out.positions.iter_mut().zip(out.rays).zip(out.footprints);
    for ((place, &z), ((position, unit), footprint)) in places.iter().zip(depths).zip(out) {
        let ray =
            lift.to_world * lift.lens.ray(DVec2::new(f64::from(place.x) + 0.5, f64::from(place.y) + 0.5));
        *position = (lift.centre + ray * f64::from(z)).to_array();
        *unit = ray.normalize().as_vec3().to_array();
        // A lens of less than a pixel could take the largest depths beyond f32.
        *footprint = ((f64::from(z) / lift.focal) as f32).min(f32::MAX);
    }
}
