//! Corners and their descriptors: upright histograms of gradients on an image pyramid. No pose is used.

use super::grey::Grey;
use glam::DVec2;
use std::f32::consts::TAU;

/// A corner of a picture, with the look of its surroundings.
#[derive(Debug, Clone)]
pub(crate) struct Feature {
    /// Pixels of the largest level.
    pub(crate) position: DVec2,
    /// Level of the pyramid on which it was found.
    pub(crate) level: usize,
    /// Column and row of its pixel on that level.
    pub(crate) pixel: (usize, usize),
    pub(crate) descriptor: Descriptor,
}

/// Directions of the gradient in 4 x 4 cells of 4 pixels, 8 bins each, of length [`LENGTH`]. Whole numbers,
/// because their dot products are exact and fast.
pub(crate) type Descriptor = [i16; 128];

/// Length of a descriptor; 128 products of its entries fit an `i32`.
pub(crate) const LENGTH: f32 = 4096.0;

/// A picture at several sizes with the corners of all of them.
#[derive(Debug, Clone)]
pub(crate) struct Features {
    /// The largest first.
    pub(crate) levels: Vec<Grey>,
    pub(crate) found: Vec<Feature>,
}

impl Features {
    /// About `count` corners or fewer, spread over the picture. Deterministic.
    pub(crate) fn new(picture: Grey, count: usize) -> Self {
        let levels = pyramid(picture);
        let area = |level: &Grey| (level.width * level.height) as f64;
        let total: f64 = levels.iter().map(area).sum();
        let mut found = Vec::new();
        for (index, level) in levels.iter().enumerate() {
            let wanted = (count as f64 * area(level) / total).ceil() as usize;
            let scale = DVec2::new(
                levels[0].width as f64 / level.width as f64,
                levels[0].height as f64 / level.height as f64,
            );
            let gradients = Gradients::new(level);
            for (x, y) in gradients.corners(wanted) {
                let position = DVec2::new(x as f64 + 0.5, y as f64 + 0.5) * scale;
                let Some(descriptor) = gradients.describe(x, y) else { continue };
                found.push(Feature { position, level: index, pixel: (x, y), descriptor });
            }
        }
        Self { levels, found }
    }

    /// Pixels of the largest level per pixel of a level.
    pub(crate) fn scale(&self, level: usize) -> DVec2 {
        let (largest, level) = (&self.levels[0], &self.levels[level]);
        DVec2::new(largest.width as f64 / level.width as f64, largest.height as f64 / level.height as f64)
    }
}

/// The picture and smaller ones, each 1/sqrt 2 of the one before, down to [`MIN_SIDE`].
fn pyramid(picture: Grey) -> Vec<Grey> {
    let (width, height) = (picture.width, picture.height);
    let mut levels = vec![picture];
    for step in 1..MAX_LEVELS {
        let factor = 0.5f64.powf(step as f64 / 2.0);
        let side = |side: usize| (side as f64 * factor).round() as usize;
        if side(width).min(side(height)) < MIN_SIDE {
            break;
        }
        let smaller = levels[step - 1].shrunk(side(width), side(height));
        levels.push(smaller);
    }
    levels
}

const MAX_LEVELS: usize = 5;
const MIN_SIDE: usize = 48;
/// Pixels on each side of a corner that its descriptor looks at, those for the gradient included.
const REACH: usize = 11;
/// Corners are spread over cells of about this side, pixels.
const CELL: usize = 32;
/// Smallest eigenvalue of the mean squared gradient, in grey levels per pixel squared: under it is noise.
const MIN_CORNER: f32 = 4.0;

/// Derivatives of a smoothed picture.
struct Gradients {
    width: usize,
    height: usize,
    dx: Vec<f32>,
    dy: Vec<f32>,
}

impl Gradients {
    fn new(picture: &Grey) -> Self {
        let smooth = picture.smoothed();
        let (width, height) = (smooth.width, smooth.height);
        let (mut dx, mut dy) = (vec![0.0; width * height], vec![0.0; width * height]);
        let value = |i: usize| f32::from(smooth.data[i]);
        for y in 1..height.saturating_sub(1) {
            for x in 1..width.saturating_sub(1) {
                let i = y * width + x;
                dx[i] = 0.5 * (value(i + 1) - value(i - 1));
                dy[i] = 0.5 * (value(i + width) - value(i - width));
            }
        }
        Self { width, height, dx, dy }
    }

    /// Local maxima of the smaller eigenvalue of the structure tensor, about `wanted` of them, the strongest
    /// of every cell.
    fn corners(&self, wanted: usize) -> Vec<(usize, usize)> {
        let (width, height) = (self.width, self.height);
        if width.min(height) <= 2 * REACH + 1 {
            return Vec::new();
        }
        let response = self.response();
        let (columns, rows) = (width.div_ceil(CELL), height.div_ceil(CELL));
        let mut cells: Vec<Vec<(f32, usize, usize)>> = vec![Vec::new(); columns * rows];
        for y in REACH..height - REACH {
            for x in REACH..width - REACH {
                let here = response[y * width + x];
                if here < MIN_CORNER {
                    continue;
                }
                // Of equal neighbours the first in reading order is the maximum.
                let is_peak = (y - 2..=y + 2).all(|row| {
                    (x - 2..=x + 2).all(|column| {
                        let other = response[row * width + column];
                        other < here || (other == here && (row, column) >= (y, x))
                    })
                });
                if is_peak {
                    cells[y / CELL * columns + x / CELL].push((here, y, x));
                }
            }
        }
        let per_cell = wanted.div_ceil(columns * rows) + 1;
        let mut chosen: Vec<(f32, usize, usize)> = Vec::new();
        for cell in &mut cells {
            cell.sort_unstable_by(|a, b| b.0.total_cmp(&a.0).then((a.1, a.2).cmp(&(b.1, b.2))));
            // Poor cells leave room for rich ones, but not for all that these have.
            chosen.extend(cell.iter().take(2 * per_cell));
        }
        chosen.sort_unstable_by(|a, b| b.0.total_cmp(&a.0).then((a.1, a.2).cmp(&(b.1, b.2))));
        chosen.truncate(wanted);
        chosen.into_iter().map(|(_, y, x)| (x, y)).collect()
    }

    /// Smaller eigenvalue of the mean of the squared gradient under the kernel (1 4 6 4 1)².
    fn response(&self) -> Vec<f32> {
        let product = |a: &[f32], b: &[f32]| -> Vec<f32> {
            let squared: Vec<f32> = a.iter().zip(b).map(|(a, b)| a * b).collect();
            self.smooth(&squared)
        };
        let (xx, xy, yy) =
            (product(&self.dx, &self.dx), product(&self.dx, &self.dy), product(&self.dy, &self.dy));
        let smaller = |((a, b), c): ((&f32, &f32), &f32)| {
            let (mean, half) = (0.5 * (a + c), 0.5 * (a - c));
            mean - (half * half + b * b).sqrt()
        };
        xx.iter().zip(&xy).zip(&yy).map(smaller).collect()
    }

    fn smooth(&self, values: &[f32]) -> Vec<f32> {
        let (width, height) = (self.width, self.height);
        let mut rows = vec![0.0; values.len()];
        for y in 0..height {
            let (from, to) = (&values[y * width..(y + 1) * width], &mut rows[y * width..(y + 1) * width]);
            for x in 2..width - 2 {
                to[x] =
                    (from[x - 2] + from[x + 2] + 4.0 * (from[x - 1] + from[x + 1]) + 6.0 * from[x]) / 16.0;
            }
        }
        let mut out = vec![0.0; values.len()];
        for y in 2..height - 2 {
            for x in 0..width {
                let value = |offset: usize| rows[(y + offset - 2) * width + x];
                out[y * width + x] =
                    (value(0) + value(4) + 4.0 * (value(1) + value(3)) + 6.0 * value(2)) / 16.0;
            }
        }
        out
    }

    /// The look of the 16 x 16 pixels around a corner; `None` where there is no gradient at all.
    fn describe(&self, x: usize, y: usize) -> Option<Descriptor> {
        let mut histogram = [0.0f32; 128];
        for row in 0..18usize {
            for column in 0..18usize {
                let i = (y + row - 9) * self.width + x + column - 9;
                let (dx, dy) = (self.dx[i], self.dy[i]);
                let strength = (dx * dx + dy * dy).sqrt();
                // Distance from the corner, pixels.
                let (rx, ry) = (column as f32 - 9.0, row as f32 - 9.0);
                let weight = strength * (-(rx * rx + ry * ry) / 128.0).exp();
                // Every sample goes to the two nearest cells and bins along each axis.
                let (cx, cy) = ((rx + 8.0) / 4.0 - 0.5, (ry + 8.0) / 4.0 - 0.5);
                let bin = (dy.atan2(dx) / TAU + 1.0) * 8.0;
                let (x0, y0, b0) = (cx.floor(), cy.floor(), bin.floor());
                for (cell_y, wy) in [(y0, 1.0 - (cy - y0)), (y0 + 1.0, cy - y0)] {
                    for (cell_x, wx) in [(x0, 1.0 - (cx - x0)), (x0 + 1.0, cx - x0)] {
                        if !(0.0..4.0).contains(&cell_y) || !(0.0..4.0).contains(&cell_x) {
                            continue;
                        }
                        let cell = (cell_y as usize * 4 + cell_x as usize) * 8;
                        let fraction = bin - b0;
                        histogram[cell + b0 as usize % 8] += weight * wx * wy * (1.0 - fraction);
                        histogram[cell + (b0 as usize + 1) % 8] += weight * wx * wy * fraction;
                    }
                }
            }
        }
        // One strong edge must not drown the rest.
        let clipped = normalised(&histogram)?.map(|value| value.min(0.2));
        Some(normalised(&clipped)?.map(|value| (value * LENGTH).round() as i16))
    }
}

fn normalised(values: &[f32; 128]) -> Option<[f32; 128]> {
    let length = values.iter().map(|v| v * v).sum::<f32>().sqrt();
    (length > 0.0).then(|| values.map(|v| v / length))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Rectangles of several greys: corners at known places.
    fn blocks(width: usize, height: usize) -> Grey {
        let value = |x: usize, y: usize| ((x / 24 * 7 + y / 24 * 5) * 53 % 200 + 20) as u8;
        Grey { width, height, data: (0..width * height).map(|i| value(i % width, i / width)).collect() }
    }

    #[test]
    fn corners_are_found_at_corners_and_none_in_flat_pictures() {
        let features = Features::new(blocks(240, 192), 400);
        let first: Vec<_> = features.found.iter().filter(|f| f.level == 0).collect();
        assert!(first.len() > 20, "{}", first.len());
        for feature in first {
            let off = |v: f64| (v / 24.0 - (v / 24.0).round()).abs() * 24.0;
            assert!(off(feature.position.x) < 3.0 && off(feature.position.y) < 3.0, "{}", feature.position);
        }
        for flat in [0u8, 255] {
            let flat = Grey { width: 240, height: 192, data: vec![flat; 240 * 192] };
            assert!(Features::new(flat, 400).found.is_empty());
        }
        for (width, height) in [(1, 1), (5, 300), (24, 24), (48, 23)] {
            let tiny = Grey { width, height, data: vec![9; width * height] };
            assert!(Features::new(tiny, 400).found.is_empty());
        }
    }

    #[test]
    fn descriptors_have_their_length_and_ignore_contrast() {
        let picture = blocks(240, 192);
        let dim = Grey { data: picture.data.iter().map(|v| v / 2 + 60).collect(), ..picture.clone() };
        let (a, b) = (Features::new(picture, 200), Features::new(dim, 200));
        let mut compared = 0;
        for feature in &a.found {
            let length = feature.descriptor.iter().map(|v| f32::from(*v).powi(2)).sum::<f32>().sqrt();
            assert!((length / LENGTH - 1.0).abs() < 0.01, "{length}");
            let twin =
                b.found.iter().find(|other| (other.level, other.pixel) == (feature.level, feature.pixel));
            let Some(twin) = twin else { continue };
            let dot: f32 = feature
                .descriptor
                .iter()
                .zip(&twin.descriptor)
                .map(|(a, b)| f32::from(*a) * f32::from(*b))
                .sum();
            assert!(dot / LENGTH.powi(2) > 0.97, "{dot}");
            compared += 1;
        }
        assert!(compared > 20, "{compared}");
    }
}
