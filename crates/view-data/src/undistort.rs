//! Taking lens distortion out of a picture, so that a pinhole describes it.

use crate::{Error, Lens, Result};
use glam::DVec2;
use gs_scene::{Image, Intrinsics};
use std::path::Path;

/// The pinhole picture behind a distorted one: a window of the picture's own pixel grid, with the same focal lengths,
/// that shows nothing but what the lens saw. Of a fisheye that is the middle: directions that a pinhole of this focal
/// length puts outside the grid are left out.
#[derive(Debug)]
pub(crate) struct Undistortion {
    lens: Lens,
    left: usize,
    top: usize,
    width: usize,
    height: usize,
}

impl Undistortion {
    /// Chooses the window: from the whole grid, the border line with the largest share of pixels that the picture
    /// does not cover is taken off until all four lines are covered.
    ///
    /// A pixel is covered if it maps between the centres of the picture's outermost pixels. Covered border lines
    /// cover what they enclose, because the map is one-to-one, which [`Undistortion::apply`] checks.
    pub(crate) fn new(lens: Lens, path: &Path) -> Result<Self> {
        let Intrinsics { width, height, .. } = lens.intrinsics;
        let whole = Self { lens, left: 0, top: 0, width, height };
        if lens.model.is_pinhole() {
            return Ok(whole);
        }
        if lens.model.is_wide() && !sees_less_than_half(&lens) {
            return Err(Error::LensTooWide { path: path.to_path_buf() });
        }
        let covered = |x: usize, y: usize| {
            let source = whole.lens.distort(whole.direction(x, y));
            let inside = |v: f64, side: usize| v >= 0.5 - SLACK && v <= side as f64 - 0.5 + SLACK;
            inside(source.x, width) && inside(source.y, height)
        };
        if !covered(width / 2, height / 2) {
            return Err(Error::LensEmpty { path: path.to_path_buf() });
        }
        // Half-open window [left, right) × [top, bottom).
        let (mut left, mut top, mut right, mut bottom) = (0, 0, width, height);
        loop {
            if left >= right || top >= bottom {
                return Err(Error::LensEmpty { path: path.to_path_buf() });
            }
            let missing_in_column =
                |x| (top..bottom).filter(|&y| !covered(x, y)).count() as f64 / (bottom - top) as f64;
            let missing_in_row =
                |y| (left..right).filter(|&x| !covered(x, y)).count() as f64 / (right - left) as f64;
            let missing = [
                missing_in_column(left),
                missing_in_column(right - 1),
                missing_in_row(top),
                missing_in_row(bottom - 1),
            ];
            let worst = missing.into_iter().fold(0.0, f64::max);
            if worst == 0.0 {
                break;
            }
            match missing.into_iter().position(|share| share == worst) {
                Some(0) => left += 1,
                Some(1) => right -= 1,
                Some(2) => top += 1,
                _ => bottom -= 1,
            }
        }
        Ok(Self { lens, left, top, width: right - left, height: bottom - top })
    }

    /// The pinhole of the undistorted picture.
    pub(crate) fn intrinsics(&self) -> Intrinsics {
        self.lens.intrinsics.cropped(self.left, self.top, self.width, self.height)
    }

    /// Direction of a pixel of the whole grid.
    fn direction(&self, x: usize, y: usize) -> DVec2 {
        self.lens.intrinsics.ray(DVec2::new(x as f64 + 0.5, y as f64 + 0.5)).truncate()
    }

    /// Position in the undistorted picture to position in the distorted one, pixels.
    pub(crate) fn source(&self, position: DVec2) -> DVec2 {
        let on_grid = position + DVec2::new(self.left as f64, self.top as f64);
        if self.lens.model.is_pinhole() {
            return on_grid;
        }
        self.lens.distort(self.lens.intrinsics.ray(on_grid).truncate())
    }

    /// The undistorted picture, sampled bicubically (Catmull-Rom) and clipped to 0..1.
    pub(crate) fn apply(&self, image: Image, path: &Path) -> Result<Image> {
        if self.lens.model.is_pinhole() {
            return Ok(image);
        }
        let samples = Samples::new(&image);
        let mut data = Vec::with_capacity(self.width * self.height * 3);
        for y in self.top..self.top + self.height {
            for x in self.left..self.left + self.width {
                let source = self.lens.distort_one_to_one(self.direction(x, y));
                let source = source.ok_or_else(|| Error::LensFolds { path: path.to_path_buf(), x, y })?;
                data.extend_from_slice(&samples.catmull_rom(source));
            }
        }
        let path = || path.display().to_string();
        Image::new(self.width, self.height, data).map_err(|source| Error::View { frame: path(), source })
    }
}

/// Whether the borders of a picture, at the height and width of the principal point, look forward. Its corners may not:
/// circles of fisheye lenses end before them.
fn sees_less_than_half(lens: &Lens) -> bool {
    let Intrinsics { width, height, cx, cy, .. } = lens.intrinsics;
    let (width, height) = (width as f64, height as f64);
    let middles = [(0.5, cy), (width - 0.5, cy), (cx, 0.5), (cx, height - 0.5)];
    middles.into_iter().all(|(x, y)| lens.undistort(DVec2::new(x, y)).is_some())
}

/// What rounding may move a pixel that lies exactly on the outermost centres.
const SLACK: f64 = 1e-9;

/// A picture to take samples of.
struct Samples<'a> {
    width: usize,
    height: usize,
    pixels: &'a [[f32; 3]],
}

impl<'a> Samples<'a> {
    fn new(image: &'a Image) -> Self {
        Self { width: image.width(), height: image.height(), pixels: image.data().as_chunks::<3>().0 }
    }

    /// The picture at a pixel position inside it, from 4×4 pixels; beyond the border the outermost ones repeat.
    fn catmull_rom(&self, position: DVec2) -> [f32; 3] {
        // Truncation instead of `floor`, which is a function call on plain x86-64; the same for what is inside.
        let (x, y) = ((position.x - 0.5) as isize, (position.y - 0.5) as isize);
        let wx = weights((position.x - 0.5 - x as f64) as f32);
        let wy = weights((position.y - 0.5 - y as f64) as f32);
        let tap =
            |base: isize, offset: isize, side: usize| (base + offset).clamp(0, side as isize - 1) as usize;
        let columns = [-1, 0, 1, 2].map(|offset| tap(x, offset, self.width));
        let mut sum = [0.0; 3];
        for (offset, wy) in (-1..).zip(wy) {
            let row = &self.pixels[tap(y, offset, self.height) * self.width..][..self.width];
            for (column, wx) in columns.into_iter().zip(wx) {
                let weight = wx * wy;
                for (sum, value) in sum.iter_mut().zip(row[column]) {
                    *sum += weight * value;
                }
            }
        }
        sum.map(|value: f32| value.clamp(0.0, 1.0))
    }
}

/// Catmull-Rom weights of the four samples at -1, 0, 1, 2 for a position `t` in 0..1; they sum to 1.
fn weights(t: f32) -> [f32; 4] {
    let (t2, t3) = (t * t, t * t * t);
    [
        0.5 * (-t3 + 2.0 * t2 - t),
        0.5 * (3.0 * t3 - 5.0 * t2 + 2.0),
        0.5 * (-3.0 * t3 + 4.0 * t2 + t),
        0.5 * (t3 - t2),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_kernel_interpolates_and_reproduces_ramps() {
        let ramp = (0..8 * 6).flat_map(|i| {
            let (x, y) = ((i % 8) as f32, (i / 8) as f32);
            [x / 10.0, y / 10.0, 0.05 * x + 0.02 * y]
        });
        let image = Image::new(8, 6, ramp.collect()).unwrap();
        let samples = Samples::new(&image);
        for (x, y) in [(2.5, 2.5), (3.1, 2.9), (5.25, 3.5)] {
            let [r, g, b] = samples.catmull_rom(DVec2::new(x, y));
            let (px, py) = (x as f32 - 0.5, y as f32 - 0.5);
            for (found, expected) in [(r, px / 10.0), (g, py / 10.0), (b, 0.05 * px + 0.02 * py)] {
                assert!((found - expected).abs() < 1e-6, "{found} {expected}");
            }
        }
        // At the outermost centres the pixel itself; a hair outside, which rounding may do, the same.
        for corner in [DVec2::splat(0.5), DVec2::splat(0.5 - 1e-9)] {
            let found = samples.catmull_rom(corner);
            assert!(found.iter().zip(image.pixel(0, 0)).all(|(a, b)| (a - b).abs() < 1e-6), "{found:?}");
        }
    }
}
