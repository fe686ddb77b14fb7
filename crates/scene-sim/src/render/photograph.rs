//! Photographs of a camera that moves along a path.

use super::film::{Film, Plain};
use super::lens_rays::{LensRays, is_plain};
use super::rays::{CameraRays, Pinhole, strata};
use super::sensor::Sensor;
use super::{Picture, RayCounts, Renderer, check_samples, fold};
use crate::noise::{hash, normal};
use crate::trace::Traced;
use crate::{Error, Photographs, Result};
use glam::{DMat3, EulerRot};
use gs_scene::{Camera, Image, Lens, View};

/// A picture with what is known of it.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct Photograph {
    /// Picture, stated pose and depth. The picture is distorted as its lens is, and so is the depth: both belong to the
    /// pixels of the picture. The camera of the view has the intrinsics of the lens, without its distortion.
    pub view: View,
    /// The lens with its distortion.
    pub lens: Lens,
    /// What the linear light of red, green and blue was multiplied by; all 1 where exposure and white balance do not
    /// vary.
    pub gains: [f32; 3],
    /// Mean light of every pixel, linear, not clipped, display white = 1: before exposure, noise and encoding. Only if it
    /// was asked for.
    pub light: Option<Image>,
    /// What the picture took.
    pub rays: RayCounts,
}

/// Takes picture `index` (from 0) of the photographs of a scene. The same arguments give the same bits on any number
/// of threads; pictures differ in their random numbers.
///
/// # Errors
/// If the photographs break a rule (as [`Photographs::check`]), the distortion has no inverse at a pixel, or there is
/// no such picture.
pub fn photograph(scene: &Traced, photographs: &Photographs, index: usize, seed: u64) -> Result<Photograph> {
    take(scene, photographs, index, seed, false)
}

/// As [`photograph`], with the light of every pixel before it is recorded.
///
/// # Errors
/// As [`photograph`].
pub fn photograph_with_light(
    scene: &Traced,
    photographs: &Photographs,
    index: usize,
    seed: u64,
) -> Result<Photograph> {
    take(scene, photographs, index, seed, true)
}

fn take(
    scene: &Traced,
    photographs: &Photographs,
    index: usize,
    seed: u64,
    light: bool,
) -> Result<Photograph> {
    photographs.check()?;
    let count = photographs.count;
    if index >= count {
        return Err(Error::Picture { found: index, count });
    }
    check_samples(photographs.samples)?;
    let lens = photographs.lens();
    let camera = photographs.path.camera_at(lens.intrinsics, photographs.u(index))?;
    let seed = hash(index as u32, 0, 0x70, fold(seed));
    let sensor = Sensor::new(photographs, seed);
    let shot = Shot { scene, strata: strata(photographs.samples), seed, light };
    // Each kind of camera has its own inner loop: a plain one takes no branch for what it does not do.
    let picture = if is_plain(photographs) {
        shot.onto(&Pinhole::new(scene, &camera, photographs.samples), sensor.as_ref(), &lens)?
    } else {
        shot.onto(&LensRays::new(scene, photographs, index)?, sensor.as_ref(), &lens)?
    };
    let Picture { image, depth, linear: light, counts: rays } = picture;
    Ok(Photograph {
        view: View::new(
            format!("frame_{index:05}"),
            image,
            stated(&camera, photographs, seed)?,
            Some(depth),
        )?,
        lens,
        gains: sensor.map_or([1.0; 3], |sensor| sensor.gains().to_array()),
        light,
        rays,
    })
}

/// The pose that is stated of a picture taken by `camera`; `seed` is that of the picture.
fn stated(camera: &Camera, photographs: &Photographs, seed: u32) -> Result<Camera> {
    let Some(error) = photographs.pose_error.filter(|error| *error > 0.0) else { return Ok(*camera) };
    let angle = |axis| (error * normal(hash(axis, 0, 0x73, seed))).to_radians();
    let turn = DMat3::from_euler(EulerRot::XYZ, angle(0), angle(1), angle(2));
    Ok(Camera::new(*camera.intrinsics(), turn * camera.rotation(), turn * camera.translation())?)
}

/// What the inner loops have in common.
struct Shot<'a> {
    scene: &'a Traced,
    strata: [u32; 2],
    seed: u32,
    light: bool,
}

impl Shot<'_> {
    fn onto<R: CameraRays>(&self, rays: &R, sensor: Option<&Sensor>, lens: &Lens) -> Result<Picture> {
        match sensor {
            Some(sensor) => self.take(rays, sensor, lens),
            None => self.take(rays, &Plain, lens),
        }
    }

    fn take<R: CameraRays, F: Film>(&self, rays: &R, film: &F, lens: &Lens) -> Result<Picture> {
        let renderer = Renderer { scene: self.scene, rays, film, strata: self.strata, seed: self.seed };
        renderer.picture(lens.intrinsics.width, lens.intrinsics.height, self.light)
    }
}
