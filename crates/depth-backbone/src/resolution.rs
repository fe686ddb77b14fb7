//! Views at a fraction of their size, and surfaces brought back to the full one.

use crate::Result;
use crate::texture::Texture;
use gs_scene::{Image, View};
use rayon::prelude::*;

/// A view at 1/`factor` of its size, by averaging blocks. What is left over on the right and below is cropped.
pub(crate) fn reduced(view: &View, factor: usize) -> Result<View> {
    let image = view.image();
    let (width, height) = ((image.width() / factor).max(1), (image.height() / factor).max(1));
    let (block_x, block_y) = (factor.min(image.width()), factor.min(image.height()));
    let mut data = vec![0.0; width * height * 3];
    for (y, row) in data.chunks_exact_mut(width * 3).enumerate() {
        for source in image.data().chunks_exact(image.width() * 3).skip(y * factor).take(block_y) {
            for (sum, block) in row.chunks_exact_mut(3).zip(source.chunks_exact(block_x * 3)) {
                for pixel in block.chunks_exact(3) {
                    sum.iter_mut().zip(pixel).for_each(|(sum, value)| *sum += value);
                }
            }
        }
        row.iter_mut().for_each(|sum| *sum /= (block_x * block_y) as f32);
    }
    let lens = *view.camera().intrinsics();
    let lens = lens.cropped(0, 0, width * block_x, height * block_y).resized(width, height);
    let camera = view.camera().with_intrinsics(lens)?;
    Ok(View::new(view.name(), Image::new(width, height, data)?, camera, None)?)
}

/// How much less a coarse pixel is like a fine one, in luma levels per coarse pixel between their centres.
const DISTANCE_LEVELS: f32 = 20.0;

/// A surface, found on a picture of 1/`factor` of the size, at the full size: each pixel takes the value of the one of the nine
/// coarse pixels around it that is nearest in luma and place. Edges of the surface come to lie on those of the picture.
pub(crate) fn enlarged(surface: &[f32], coarse: &Texture, fine: &Texture, factor: usize) -> Vec<f32> {
    let mut out = vec![0.0; fine.width * fine.height];
    let scale = 1.0 / factor as f32;
    out.par_chunks_mut(fine.width).enumerate().for_each(|(y, out)| {
        let row = (y / factor).min(coarse.height - 1);
        let rows = row.saturating_sub(1)..(row + 2).min(coarse.height);
        for (x, out) in out.iter_mut().enumerate() {
            let column = (x / factor).min(coarse.width - 1);
            let columns = column.saturating_sub(1)..(column + 2).min(coarse.width);
            let luma = fine.values[y * fine.width + x];
            // The centre, in coarse pixels.
            let (u, v) = ((x as f32 + 0.5) * scale - 0.5, (y as f32 + 0.5) * scale - 0.5);
            let mut least = f32::INFINITY;
            for row in rows.clone() {
                for column in columns.clone() {
                    let i = row * coarse.width + column;
                    let (du, dv) = (column as f32 - u, row as f32 - v);
                    let distance = (du * du + dv * dv).sqrt();
                    let difference = (coarse.values[i] - luma).abs() + DISTANCE_LEVELS * distance;
                    if difference < least {
                        least = difference;
                        *out = surface[i];
                    }
                }
            }
        }
    });
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::{DMat3, DVec3};
    use gs_scene::{Camera, Intrinsics};

    fn view(width: usize, height: usize, value: impl Fn(usize, usize) -> f32) -> View {
        let lens = Intrinsics { fx: 9.0, fy: 9.0, cx: 3.0, cy: 2.0, width, height };
        let camera = Camera::new(lens, DMat3::IDENTITY, DVec3::ZERO).unwrap();
        let data = (0..width * height).flat_map(|i| [value(i % width, i / width); 3]).collect();
        View::new("v", Image::new(width, height, data).unwrap(), camera, None).unwrap()
    }

    #[test]
    fn blocks_are_averaged_and_what_is_left_over_is_cropped() {
        let half = reduced(&view(5, 4, |x, y| (x + 10 * y) as f32), 2).unwrap();
        assert_eq!((half.image().width(), half.image().height()), (2, 2));
        let red: Vec<f32> = half.image().data().iter().step_by(3).copied().collect();
        assert_eq!(red, [5.5, 7.5, 25.5, 27.5]);
        let lens = half.camera().intrinsics();
        assert_eq!((lens.fx, lens.cx, lens.width), (4.5, 1.5, 2));
        // Nothing is left of a picture that is smaller than a block, but one pixel.
        assert_eq!(reduced(&view(1, 3, |_, y| y as f32), 4).unwrap().image().data()[0], 1.0);
    }

    #[test]
    fn edges_of_a_surface_come_to_lie_on_those_of_the_picture() {
        // Dark up to column 4, bright from column 5 on: coarse pixel 2 has half of each and takes the depth of the bright side.
        let picture = view(10, 6, |x, _| if x < 5 { 0.1 } else { 0.9 });
        let (fine, coarse) =
            (Texture::new(picture.image()), Texture::new(reduced(&picture, 2).unwrap().image()));
        let surface: Vec<f32> = (0..15).map(|i| if i % 5 < 2 { 1.0 } else { 3.0 }).collect();
        let found = enlarged(&surface, &coarse, &fine, 2);
        for (i, found) in found.iter().enumerate() {
            assert_eq!(*found, if i % 10 < 5 { 1.0 } else { 3.0 }, "pixel {i}");
        }
    }

    #[test]
    fn a_picture_that_is_no_larger_keeps_its_surface() {
        let texture = Texture::new(view(1, 2, |_, y| y as f32).image());
        assert_eq!(enlarged(&[4.0, 5.0], &texture, &texture, 1), [4.0, 5.0]);
    }
}
