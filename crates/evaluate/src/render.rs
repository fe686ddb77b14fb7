//! Rendering a scene the way the tables and the commands do.

use crate::Result;
use gs_raster::{Rasterizer, RenderSettings, Style, near_plane};
use gs_scene::{Camera, Gaussians, Image};

/// A rendered view.
#[derive(Debug, Clone, PartialEq)]
pub struct Rendered {
    /// Colour, clipped to 0..1.
    pub image: Image,
    /// Opacity, `[height, width]`, 0..1.
    pub alpha: Vec<f32>,
    /// Expected z-depth, scene units, `[height, width]`; 0 where there is nothing.
    pub depth: Vec<f32>,
    /// Gaussians that cannot be drawn: their stored numbers are not finite, or overflow.
    pub rejected: usize,
}

/// Renders a view over black.
///
/// # Errors
/// If the Gaussians touch more tiles than memory can hold, or the GPU that is used cannot hold the scene, or fails.
pub fn render_view(rasterizer: &mut Rasterizer, gaussians: &Gaussians, camera: &Camera) -> Result<Rendered> {
    render(rasterizer, gaussians, camera, Style::Blended)
}

/// As [`render_view`], each Gaussian drawn as a solid ellipsoid of one standard deviation.
///
/// # Errors
/// As [`render_view`].
pub fn render_ellipsoids(
    rasterizer: &mut Rasterizer,
    gaussians: &Gaussians,
    camera: &Camera,
) -> Result<Rendered> {
    render(rasterizer, gaussians, camera, Style::Ellipsoids)
}

fn render(
    rasterizer: &mut Rasterizer,
    gaussians: &Gaussians,
    camera: &Camera,
    style: Style,
) -> Result<Rendered> {
    let settings = RenderSettings { style, depth: true, ..RenderSettings::default() };
    render_as(rasterizer, gaussians, camera, settings)
}

/// Renders with settings of the caller's; the near plane is that of all pictures. Without depth its map is empty.
///
/// # Errors
/// As [`render_view`].
pub fn render_as(
    rasterizer: &mut Rasterizer,
    gaussians: &Gaussians,
    camera: &Camera,
    settings: RenderSettings,
) -> Result<Rendered> {
    let near = near_plane(gaussians, camera);
    let mut rendering = rasterizer.render(gaussians, camera, &RenderSettings { near, ..settings })?;
    for value in rendering.image.data_mut() {
        *value = value.clamp(0.0, 1.0);
    }
    let depth = rendering.depth.unwrap_or_default();
    let rejected = rendering.stats.rejected;
    Ok(Rendered { image: rendering.image, alpha: rendering.alpha, depth, rejected })
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;
    use gs_scene::{Intrinsics, dc_from_rgb, logit};

    fn camera() -> Camera {
        let lens = Intrinsics { fx: 30.0, fy: 30.0, cx: 10.0, cy: 8.0, width: 20, height: 16 };
        Camera::new(lens, glam::DMat3::IDENTITY, DVec3::ZERO).unwrap()
    }

    fn scene(depths: &[f32]) -> Gaussians {
        let mut scene = Gaussians::empty(0).unwrap();
        for &depth in depths {
            let scale = (0.3 * depth).abs().ln();
            let white = dc_from_rgb([1.5; 3]);
            scene.push([0.0, 0.0, depth], [1.0, 0.0, 0.0, 0.0], [scale; 3], logit(0.9), &white);
        }
        scene
    }

    fn on_cpu(scene: &Gaussians) -> Result<Rendered> {
        render_view(&mut Rasterizer::cpu(), scene, &camera())
    }

    #[test]
    fn scenes_of_any_scale_are_rendered() {
        assert!(on_cpu(&scene(&[1e30])).is_ok());
        assert!(on_cpu(&scene(&[1e-38])).is_ok());
    }

    #[test]
    fn colours_are_clipped_and_nothing_is_black() {
        let rendered = on_cpu(&scene(&[2.0])).unwrap();
        let largest = rendered.image.data().iter().copied().fold(0.0, f32::max);
        assert_eq!(largest, 1.0);
        assert!((rendered.depth[8 * 20 + 10] - 2.0).abs() < 1e-3);
        let empty = on_cpu(&scene(&[])).unwrap();
        assert!(empty.image.data().iter().chain(&empty.alpha).chain(&empty.depth).all(|v| *v == 0.0));
    }
}
