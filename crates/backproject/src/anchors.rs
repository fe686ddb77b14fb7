use crate::normals::check_size;
use crate::{Error, Result};
use glam::DVec2;
use gs_scene::{Camera, DepthMap};

/// Oriented points in the world, one per chosen pixel (the paper's anchor point cloud, section 3.2). All arrays have the
/// same length.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Anchors {
    /// Positions, world axes, scene units.
    pub positions: Vec<[f32; 3]>,
    /// Unit surface normals, world axes, towards the camera.
    pub normals: Vec<[f32; 3]>,
    /// Unit viewing directions from the camera to the point, world axes.
    pub rays: Vec<[f32; 3]>,
    /// z-depths, scene units.
    pub depths: Vec<f32>,
    /// Width of one pixel at that depth, scene units: z / √(fx fy).
    pub footprints: Vec<f32>,
    /// Index (row-major) of the pixel in its view.
    pub pixels: Vec<u32>,
    /// Index of the view.
    pub views: Vec<u32>,
}

impl Anchors {
    /// Number of anchors.
    #[must_use]
    pub fn len(&self) -> usize {
        self.positions.len()
    }

    /// Whether there are none.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.positions.is_empty()
    }

    /// Adds the anchors of another view behind these.
    pub fn append(&mut self, mut other: Self) {
        self.positions.append(&mut other.positions);
        self.normals.append(&mut other.normals);
        self.rays.append(&mut other.rays);
        self.depths.append(&mut other.depths);
        self.footprints.append(&mut other.footprints);
        self.pixels.append(&mut other.pixels);
        self.views.append(&mut other.views);
    }

    /// The anchors of all views, in the order given.
    #[must_use]
    pub fn concat(views: impl IntoIterator<Item = Self>) -> Self {
        let mut all = Self::default();
        views.into_iter().for_each(|anchors| all.append(anchors));
        all
    }
}

/// Lifts pixels into the world: the centre of each at its z-depth. Computed in f64, so that scenes far from the origin
/// lose only what rounding the position to f32 takes. `normals` are per pixel of the image (see [`crate::normals()`]).
///
/// # Errors
/// If the sizes of depth map, camera and normals differ, or a pixel lies outside the image or has no depth.
pub fn anchors(
    view: u32,
    pixels: &[u32],
    depth: &DepthMap,
    camera: &Camera,
    normals: &[[f32; 3]],
) -> Result<Anchors> {
    check_size(depth, camera)?;
    let n_pixels = depth.data().len();
    if normals.len() != n_pixels {
        return Err(Error::NormalCount { expected: n_pixels, found: normals.len() });
    }
    let intrinsics = camera.intrinsics();
    let to_world = camera.rotation().transpose();
    let position = camera.position();
    let focal = (intrinsics.fx * intrinsics.fy).sqrt();
    let n = pixels.len();
    let mut out = Anchors {
        positions: Vec::with_capacity(n),
        normals: Vec::with_capacity(n),
        rays: Vec::with_capacity(n),
        depths: Vec::with_capacity(n),
        footprints: Vec::with_capacity(n),
        pixels: pixels.to_vec(),
        views: vec![view; n],
    };
    for &pixel in pixels {
        let index = pixel as usize;
        let Some(&z) = depth.data().get(index) else {
            return Err(Error::PixelOutside { view, pixel, pixels: n_pixels });
        };
        if z <= 0.0 {
            return Err(Error::NoDepth { view, pixel });
        }
        let ray = to_world * intrinsics.ray(pixel_centre(index, depth.width()));
        out.positions.push((position + ray * f64::from(z)).as_vec3().to_array());
        out.normals.push(normals[index]);
        out.rays.push(ray.normalize().as_vec3().to_array());
        out.depths.push(z);
        out.footprints.push((f64::from(z) / focal) as f32);
    }
    Ok(out)
}

/// The centre of the top-left pixel is (0.5, 0.5).
pub(crate) fn pixel_centre(pixel: usize, width: usize) -> DVec2 {
    DVec2::new((pixel % width) as f64 + 0.5, (pixel / width) as f64 + 0.5)
}
