//! Held-out photographs as a rendering can be compared with them. Nobody knows their exposure, and some of what they show no context view
//! does: a head cannot be told by that.

use depth_backbone::ViewGeometry;
use glam::DVec2;
use gs_scene::{Camera, View};

/// A pixel is seen by a context view if a pixel of its surface falls this near, pixels along rows and columns: between the pixels of a view
/// that is a little farther off there are gaps.
const REACH: usize = 2;
/// Smallest and largest change of a photograph's exposure.
const GAINS: [f64; 2] = [0.75, 1.0 / 0.75];

/// The photograph in the exposure of its rendering, and equal to it where none of the `context` views sees anything; `geometry` is theirs.
pub(crate) fn comparable(
    photograph: &View,
    rendering: &[f32],
    context: &[View],
    geometry: &[ViewGeometry],
) -> View {
    let seen = seen(photograph.camera(), context, geometry);
    let mut comparable = photograph.clone();
    let pixels = comparable.image_mut().data_mut().as_chunks_mut::<3>().0;
    let renderings = rendering.as_chunks::<3>().0;
    for channel in 0..3 {
        let (mut shown, mut rendered) = (0.0, 0.0);
        for ((pixel, rendering), _) in pixels.iter().zip(renderings).zip(&seen).filter(|(_, seen)| **seen) {
            shown += f64::from(pixel[channel]);
            rendered += f64::from(rendering[channel]);
        }
        let gain = rendered / shown;
        let gain = if gain.is_finite() { gain.clamp(GAINS[0], GAINS[1]) as f32 } else { 1.0 };
        for ((pixel, rendering), seen) in pixels.iter_mut().zip(renderings).zip(&seen) {
            pixel[channel] = if *seen { gain * pixel[channel] } else { rendering[channel] };
        }
    }
    comparable
}

/// The pixels of a camera on which a surface of the context views falls.
fn seen(camera: &Camera, context: &[View], geometry: &[ViewGeometry]) -> Vec<bool> {
    let (width, height) = (camera.width(), camera.height());
    let mut seen = vec![false; width * height];
    for (view, geometry) in context.iter().zip(geometry) {
        let depths = geometry.depth.data().iter().enumerate().filter(|(_, depth)| **depth > 0.0);
        for (pixel, &depth) in depths {
            let (x, y) = (pixel % geometry.depth.width(), pixel / geometry.depth.width());
            let point = view.camera().unproject(DVec2::new(x as f64 + 0.5, y as f64 + 0.5), f64::from(depth));
            let Some(position) = camera.project(point).filter(|&position| camera.contains(position)) else {
                continue;
            };
            let (x, y) = (position.x as usize, position.y as usize);
            for row in y.saturating_sub(REACH)..(y + REACH + 1).min(height) {
                seen[row * width..][x.saturating_sub(REACH)..(x + REACH + 1).min(width)].fill(true);
            }
        }
    }
    seen
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;
    use gs_scene::{DepthMap, Image, Intrinsics};

    const LENS: Intrinsics = Intrinsics { fx: 20.0, fy: 20.0, cx: 10.0, cy: 8.0, width: 20, height: 16 };

    /// A view of a wall at a depth of 4, half a unit wide per pixel column.
    fn view(x: f64, value: f32) -> View {
        let camera =
            Camera::looking_at(LENS, DVec3::new(x, 0.0, 0.0), DVec3::new(x, 4.0, 0.0), DVec3::Z).unwrap();
        View::new("v", Image::new(20, 16, vec![value; 20 * 16 * 3]).unwrap(), camera, None).unwrap()
    }

    fn wall(depth: f32) -> ViewGeometry {
        let depth = DepthMap::new(20, 16, vec![depth; 20 * 16]).unwrap();
        ViewGeometry { depth, confidence: vec![1.0; 20 * 16], features: None, gaussians: None }
    }

    #[test]
    fn what_no_context_view_sees_is_not_compared() {
        // A pixel is 0.2 wide at the wall: ten columns of the photograph lie beside what the context sees.
        let context = [view(0.0, 0.5)];
        let rendering = vec![0.25; 20 * 16 * 3];
        let found = comparable(&view(2.0, 0.5), &rendering, &context, &[wall(4.0)]);
        let row: Vec<f32> = found.image().data().chunks_exact(3).take(20).map(|rgb| rgb[0]).collect();
        // The gain is at its bound; ten columns are seen, and two by reach.
        assert!(row[..12].iter().all(|value| (value - 0.375).abs() < 1e-6), "{row:?}");
        assert!(row[12..].iter().all(|value| *value == 0.25), "{row:?}");
    }

    #[test]
    fn exposure_of_a_channel_is_that_of_the_rendering() {
        let context = [view(0.0, 0.5), view(0.4, 0.5)];
        let mut photograph = view(0.2, 0.5);
        photograph.image_mut().data_mut().as_chunks_mut::<3>().0.iter_mut().for_each(|rgb| rgb[1] = 0.45);
        let mut rendering = vec![0.5; 20 * 16 * 3];
        rendering[0] = 0.6;
        let found = comparable(&photograph, &rendering, &context, &[wall(4.0), wall(4.0)]);
        for rgb in found.image().data().chunks_exact(3) {
            assert!((rgb[0] - 0.5).abs() < 1e-3 && (rgb[1] - 0.5).abs() < 1e-6, "{rgb:?}");
        }
    }

    #[test]
    fn hard_photographs_stay_finite() {
        for (value, rendered, depth) in
            [(0.0, 0.0, 4.0), (0.0, 0.5, 4.0), (0.5, f32::NAN, 4.0), (0.5, 0.5, 0.0), (1.0, 0.0, 1e30)]
        {
            let found = comparable(&view(0.1, value), &[rendered; 960], &[view(0.0, 0.5)], &[wall(depth)]);
            let finite = found.image().data().iter().all(|value| value.is_finite());
            assert!(finite || rendered.is_nan(), "{value} {rendered} {depth}");
        }
    }
}
