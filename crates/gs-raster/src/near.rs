//! A near plane that follows the scale of the scene.

use crate::RenderSettings;
use glam::DVec3;
use gs_scene::{Camera, Gaussians};

/// The near plane as a share of the scene's distance.
pub const NEAR_SHARE: f64 = 0.02;
/// Gaussians whose median depth is taken, at most: a median of some thousand is as good as one of all.
pub const NEAR_SAMPLE: usize = 4096;

/// Near plane for a camera, scene units: a share of the median z-depth of the Gaussians in front of it. It depends on the
/// scene and the camera alone, so that a scene that was written and read renders as before.
#[must_use]
pub fn near_plane(gaussians: &Gaussians, camera: &Camera) -> f32 {
    let step = gaussians.len().div_ceil(NEAR_SAMPLE).max(1);
    let mut depths: Vec<f64> = gaussians
        .geometry()
        .chunks_exact(Gaussians::GEOMETRY)
        .step_by(step)
        .map(|row| camera.to_camera(DVec3::new(row[0].into(), row[1].into(), row[2].into())).z)
        .filter(|depth| depth.is_finite() && *depth > 0.0)
        .collect();
    if depths.is_empty() {
        return RenderSettings::default().near;
    }
    let middle = depths.len() / 2;
    let median = *depths.select_nth_unstable_by(middle, f64::total_cmp).1;
    // Of a scene at the edge of what f32 holds, the product may underflow or overflow.
    ((median * NEAR_SHARE) as f32).clamp(f32::MIN_POSITIVE, RenderSettings::default().far * 0.5)
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DMat3;
    use gs_scene::Intrinsics;

    #[test]
    fn it_is_a_share_of_the_median_depth_in_front() {
        let lens = Intrinsics { fx: 30.0, fy: 30.0, cx: 10.0, cy: 8.0, width: 20, height: 16 };
        let camera = Camera::new(lens, DMat3::IDENTITY, DVec3::ZERO).unwrap();
        let near = |depths: &[f32]| {
            let mut scene = Gaussians::empty(0).unwrap();
            for &depth in depths {
                scene.push([0.0, 0.0, depth], [1.0, 0.0, 0.0, 0.0], [0.0; 3], 0.0, &[0.0; 3]);
            }
            near_plane(&scene, &camera)
        };
        assert_eq!(near(&[100.0]), 2.0);
        assert_eq!(near(&[-5.0, f32::NAN, 1.0]), 0.02);
        assert_eq!(near(&[-5.0]), 0.01);
        assert_eq!(near(&[]), 0.01);
        assert_eq!(near(&[1e-38]), f32::MIN_POSITIVE);
        assert!(near(&[f32::MAX]).is_finite());
    }
}
