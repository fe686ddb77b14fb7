//! Support of an anchor by the other views: it lies on the surface that they see, in front of it, or behind it.

use depth_backbone::ViewGeometry;
use glam::DVec3;
use gs_scene::View;

/// Relative difference of depths up to which an anchor lies on what another view sees.
const SAME_DEPTH: f64 = 0.02;

/// Shares of the other views, 0..1.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(super) struct Support {
    /// The view has this surface.
    pub(super) agree: f32,
    /// The view sees through the anchor to something farther.
    pub(super) front: f32,
    /// The view sees something nearer.
    pub(super) behind: f32,
    /// Mean absolute difference of colour where views agree, 0..1.
    pub(super) colour: f32,
}

/// Support of a point of view `home` with colour `rgb`. Pixels of the other views without a confirmed depth say nothing.
pub(super) fn support(
    point: DVec3,
    rgb: [f32; 3],
    home: usize,
    views: &[View],
    geometry: &[ViewGeometry],
) -> Support {
    let mut support = Support::default();
    for (view, geometry) in views.iter().zip(geometry).enumerate().filter(|(i, _)| *i != home).map(|(_, v)| v)
    {
        let camera = view.camera();
        let Some(pixel) = camera.project(point).filter(|&pixel| camera.contains(pixel)) else { continue };
        let (x, y) = (pixel.x as usize, pixel.y as usize);
        let i = y * camera.width() + x;
        if !geometry.is_confirmed(i) {
            continue;
        }
        let (there, here) = (f64::from(geometry.depth.data()[i]), camera.to_camera(point).z);
        if (here - there).abs() <= SAME_DEPTH * here {
            support.agree += 1.0;
            let seen = view.image().pixel(x, y);
            support.colour += (0..3).map(|c| (seen[c] - rgb[c]).abs()).sum::<f32>() / 3.0;
        } else if here < there {
            support.front += 1.0;
        } else {
            support.behind += 1.0;
        }
    }
    if support.agree > 0.0 {
        support.colour /= support.agree;
    }
    let others = (views.len() - 1).max(1) as f32;
    support.agree /= others;
    support.front /= others;
    support.behind /= others;
    support
}
