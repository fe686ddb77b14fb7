//! Grey pictures of 8 bits, small enough to match: what the search for corners works on.

use glam::DVec2;

/// Luma of a picture, 0..255, row-major.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Grey {
    pub(crate) width: usize,
    pub(crate) height: usize,
    pub(crate) data: Vec<u8>,
}

impl Grey {
    /// The picture's luma (BT.601, the integer rule of `gs_scene::Image::luma8`), averaged over blocks of
    /// `step` x `step` pixels; what is left over at the right and at the bottom is cut off. A position in it
    /// times `step` is the position in the picture. `rgb` holds three bytes per pixel.
    pub(crate) fn of_rgb8(width: usize, height: usize, rgb: &[u8], step: usize) -> Self {
        let (to_width, to_height) = ((width / step).max(1), (height / step).max(1));
        let (across, down) = (step.min(width), step.min(height));
        let mut data = Vec::with_capacity(to_width * to_height);
        // Luma in 16 fractional bits, so that a block is rounded once.
        let count = (across * down) as u64;
        for y in 0..to_height {
            for x in 0..to_width {
                let mut sum = 0u64;
                for row in 0..down {
                    let start = ((y * step + row) * width + x * step) * 3;
                    for p in rgb[start..start + across * 3].chunks_exact(3) {
                        sum += 19595 * u64::from(p[0]) + 38470 * u64::from(p[1]) + 7471 * u64::from(p[2]);
                    }
                }
                data.push(((sum + 32768 * count) / (65536 * count)) as u8);
            }
        }
        Self { width: to_width, height: to_height, data }
    }

    /// The value between four pixels; `None` outside the outermost pixel centres.
    pub(crate) fn sample(&self, position: DVec2) -> Option<f32> {
        let (x, y) = (position.x as f32 - 0.5, position.y as f32 - 0.5);
        let inside = x >= 0.0 && y >= 0.0 && x < (self.width - 1) as f32 && y < (self.height - 1) as f32;
        if !inside {
            return None;
        }
        let (column, row) = (x as usize, y as usize);
        let (fx, fy) = (x - column as f32, y - row as f32);
        let index = row * self.width + column;
        let [a, b] = [self.data[index], self.data[index + 1]].map(f32::from);
        let [c, d] = [self.data[index + self.width], self.data[index + self.width + 1]].map(f32::from);
        let (top, bottom) = (a + (b - a) * fx, c + (d - c) * fx);
        Some(top + (bottom - top) * fy)
    }

    /// Smoothed with the kernel (1 4 6 4 1) / 16 in both directions (a Gaussian of one pixel); the border
    /// repeats.
    pub(crate) fn smoothed(&self) -> Self {
        let (width, height) = (self.width, self.height);
        let mut rows = vec![0u16; width * height];
        for (row, out) in self.data.chunks_exact(width).zip(rows.chunks_exact_mut(width)) {
            let value = |x: isize| u16::from(row[x.clamp(0, width as isize - 1) as usize]);
            for (x, out) in (0isize..).zip(out) {
                *out = value(x - 2) + value(x + 2) + 4 * (value(x - 1) + value(x + 1)) + 6 * value(x);
            }
        }
        let mut data = Vec::with_capacity(width * height);
        for y in 0..height as isize {
            let line = |offset: isize| {
                let y = (y + offset).clamp(0, height as isize - 1) as usize;
                &rows[y * width..(y + 1) * width]
            };
            let lines = [line(-2), line(-1), line(0), line(1), line(2)];
            data.extend((0..width).map(|x| {
                let [a, b, c, d, e] = lines.map(|line| u32::from(line[x]));
                ((a + e + 4 * (b + d) + 6 * c + 128) / 256) as u8
            }));
        }
        Self { width, height, data }
    }

    /// The smoothed picture at another, smaller size. Positions scale with the sides.
    pub(crate) fn shrunk(&self, width: usize, height: usize) -> Self {
        let smooth = self.smoothed();
        let (sx, sy) = (self.width as f64 / width as f64, self.height as f64 / height as f64);
        let inner = |v: f64, side: usize| v.clamp(0.5, (side as f64 - 0.501).max(0.5));
        let mut data = Vec::with_capacity(width * height);
        for y in 0..height {
            for x in 0..width {
                let position = DVec2::new(
                    inner((x as f64 + 0.5) * sx, self.width),
                    inner((y as f64 + 0.5) * sy, self.height),
                );
                data.push(smooth.sample(position).unwrap_or(0.0).round() as u8);
            }
        }
        Self { width, height, data }
    }

    /// Mean value, 0..1.
    pub(crate) fn mean(&self) -> f64 {
        let sum: u64 = self.data.iter().map(|&value| u64::from(value)).sum();
        sum as f64 / (255.0 * self.data.len() as f64)
    }

    /// Variance of the Laplacian, in grey levels squared: the usual measure of how sharp a picture is; 0 for
    /// a picture of fewer than 3 x 3 pixels.
    pub(crate) fn sharpness(&self) -> f64 {
        let width = self.width;
        if width < 3 || self.height < 3 {
            return 0.0;
        }
        let (mut sum, mut squares) = (0i64, 0i64);
        for y in 1..self.height - 1 {
            let row = |y: usize| &self.data[y * width..(y + 1) * width];
            let (above, here, below) = (row(y - 1), row(y), row(y + 1));
            for x in 1..width - 1 {
                let v = |value: u8| i64::from(value);
                let laplacian = v(above[x]) + v(below[x]) + v(here[x - 1]) + v(here[x + 1]) - 4 * v(here[x]);
                sum += laplacian;
                squares += laplacian * laplacian;
            }
        }
        let count = ((width - 2) * (self.height - 2)) as f64;
        (squares as f64 / count - (sum as f64 / count).powi(2)).max(0.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ramp(width: usize, height: usize) -> Grey {
        let data = (0..width * height).map(|i| (10 + i % width * 3 + i / width * 2) as u8).collect();
        Grey { width, height, data }
    }

    #[test]
    fn blocks_keep_positions_and_the_rule_of_luma() {
        let rgb: Vec<u8> = (0..7 * 5 * 3).map(|i| (i * 37 % 251) as u8).collect();
        let image = gs_scene::Image::from_rgb8(7, 5, &rgb).unwrap();
        assert_eq!(Grey::of_rgb8(7, 5, &rgb, 1).data, image.luma8());
        let halved = Grey::of_rgb8(7, 5, &rgb, 2);
        assert_eq!((halved.width, halved.height), (3, 2));
        let mean = [(2, 2), (3, 2), (2, 3), (3, 3)].map(|(x, y)| f64::from(image.luma8()[y * 7 + x]));
        assert!((f64::from(halved.data[3 + 1]) - mean.iter().sum::<f64>() / 4.0).abs() <= 1.0);
        assert_eq!(Grey::of_rgb8(2, 1, &[255; 6], 4), Grey { width: 1, height: 1, data: vec![255] });
    }

    #[test]
    fn ramps_are_sampled_smoothed_and_shrunk_exactly() {
        let ramp = ramp(40, 30);
        let expected = |x: f64, y: f64| 10.0 + 3.0 * (x - 0.5) + 2.0 * (y - 0.5);
        let found = ramp.sample(DVec2::new(7.25, 9.75)).unwrap();
        assert!((f64::from(found) - expected(7.25, 9.75)).abs() < 1e-4);
        for outside in [DVec2::new(0.4, 5.0), DVec2::new(5.0, 29.6), DVec2::splat(f64::NAN)] {
            assert_eq!(ramp.sample(outside), None);
        }
        let half = ramp.shrunk(20, 15);
        for (x, y) in [(5, 5), (12, 9)] {
            let position = (f64::from(x) * 2.0 + 1.0, f64::from(y) * 2.0 + 1.0);
            let found = f64::from(half.data[y as usize * 20 + x as usize]);
            assert!((found - expected(position.0, position.1)).abs() <= 1.0, "{found}");
        }
        assert!(ramp.sharpness() < 1e-9, "a ramp has no second derivative");
    }

    #[test]
    fn sharpness_falls_with_blur_and_tiny_pictures_have_none() {
        let data = (0..64 * 64).map(|i| if (i / 3 + i / 64 / 3) % 2 == 0 { 30 } else { 220 }).collect();
        let sharp = Grey { width: 64, height: 64, data };
        assert!(sharp.smoothed().sharpness() < 0.3 * sharp.sharpness());
        let tiny = Grey { width: 1, height: 1, data: vec![7] };
        assert_eq!((tiny.sharpness(), tiny.smoothed()), (0.0, tiny.clone()));
    }
}
