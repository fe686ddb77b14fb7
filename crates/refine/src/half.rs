//! Views at half their size, for the first part of the steps.

use gs_raster::RenderSettings;
use gs_scene::{Camera, Image, Intrinsics, View};

/// Smallest side of a view that is halved, pixels.
const SMALLEST: usize = 32;

/// Variance of the renderer's low-pass filter in pixels of half-size views: as wide as in whole ones.
pub(crate) fn low_pass() -> f32 {
    0.25 * RenderSettings::default().eps2d
}

/// All views at half their size, each pixel the mean of four; a last odd row or column is left out. `None` if
/// one of them is too small for that.
pub(crate) fn half_size(views: &[View]) -> Option<Vec<View>> {
    views.iter().all(|view| view.image().width().min(view.image().height()) >= SMALLEST).then(|| {
        let half = |view: &View| {
            let (width, height) = (view.image().width() / 2, view.image().height() / 2);
            let Intrinsics { fx, fy, cx, cy, .. } = *view.camera().intrinsics();
            let [fx, fy, cx, cy] = [fx, fy, cx, cy].map(|length| 0.5 * length);
            let lens = Intrinsics { fx, fy, cx, cy, width, height };
            let camera: Camera = view.camera().with_intrinsics(lens).expect("half of a valid lens");
            let image =
                Image::new(width, height, means(view.image())).expect("as many numbers as the size has");
            View::new(view.name(), image, camera, None).expect("of one size")
        };
        views.iter().map(half).collect()
    })
}

/// Means over squares of 2 × 2 pixels, `[height / 2, width / 2, 3]`.
fn means(image: &Image) -> Vec<f32> {
    let row = image.width() * 3;
    let rows = image.data().chunks_exact(2 * row);
    rows.flat_map(|pair| {
        let (upper, lower) = pair.split_at(row);
        let squares = upper.chunks_exact(6).zip(lower.chunks_exact(6));
        squares.flat_map(|(a, b)| [0, 1, 2].map(|c| 0.25 * ((a[c] + a[c + 3]) + (b[c] + b[c + 3]))))
    })
    .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scenes::{cameras, photographs, wall};
    use gs_raster::Rasterizer;

    #[test]
    fn a_rendering_at_half_size_is_the_half_of_a_rendering() {
        let scene = wall(10, 1.0);
        for size in [(64, 48), (65, 49)] {
            let views = photographs(&scene, &cameras(1, size, 1.0));
            let half = &half_size(&views).unwrap()[0];
            assert_eq!((half.image().width(), half.image().height()), (32, 24));
            let settings = RenderSettings { eps2d: low_pass(), near: 0.08, ..RenderSettings::default() };
            let rendered = Rasterizer::cpu().render(&scene, half.camera(), &settings).unwrap().image;
            let psnr = image_metrics::psnr(&rendered, half.image()).unwrap();
            assert!(psnr > 40.0, "{psnr} dB");
        }
    }

    #[test]
    fn small_views_are_not_halved() {
        let views = photographs(&wall(2, 1.0), &cameras(1, (64, 31), 1.0));
        assert!(half_size(&views).is_none());
    }
}
