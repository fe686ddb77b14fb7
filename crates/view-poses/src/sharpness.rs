//! How sharp a picture is, and what it looks like in few numbers.

use image::GrayImage;

/// Long side at which pictures are compared, pixels: sensor noise is averaged out, blur that matters is not.
pub(crate) const COMPARED: u32 = 480;

/// Side of a fingerprint, cells.
const CELLS: usize = 32;

/// What a picture is compared by.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Look {
    /// Energy of the second derivatives over that of the first, 0 and above: blur lowers it whatever the picture shows.
    pub(crate) sharpness: f64,
    /// Mean grey level of each cell, 0..255.
    cells: Vec<f32>,
}

impl Look {
    pub(crate) fn of(picture: &GrayImage) -> Self {
        let (width, height) = (picture.width() as usize, picture.height() as usize);
        let pixel = |x: usize, y: usize| f64::from(picture.as_raw()[y * width + x]);
        let (mut first, mut second) = (0.0, 0.0);
        for y in 1..height.saturating_sub(1) {
            for x in 1..width.saturating_sub(1) {
                let (left, right, above, below) =
                    (pixel(x - 1, y), pixel(x + 1, y), pixel(x, y - 1), pixel(x, y + 1));
                first += (right - left).powi(2) + (below - above).powi(2);
                second += (4.0 * pixel(x, y) - left - right - above - below).powi(2);
            }
        }
        let mut cells = vec![(0.0f32, 0u32); CELLS * CELLS];
        for y in 0..height {
            for x in 0..width {
                let cell = &mut cells[y * CELLS / height * CELLS + x * CELLS / width];
                cell.0 += pixel(x, y) as f32;
                cell.1 += 1;
            }
        }
        Self {
            sharpness: if first > 0.0 { second / first } else { 0.0 },
            cells: cells.iter().map(|&(sum, count)| sum / count.max(1) as f32).collect(),
        }
    }

    /// Mean difference of two pictures' cells, grey levels.
    pub(crate) fn difference(&self, other: &Self) -> f32 {
        let sum: f32 = self.cells.iter().zip(&other.cells).map(|(a, b)| (a - b).abs()).sum();
        sum / (CELLS * CELLS) as f32
    }
}

/// Variance of the Laplacian: the sharper of two pictures of the same content has the greater one.
pub(crate) fn detail(picture: &[u8], width: usize, height: usize) -> f64 {
    let pixel = |x: usize, y: usize| f64::from(picture[y * width + x]);
    let (mut sum, mut squares, mut count) = (0.0, 0.0, 0.0);
    for y in 1..height.saturating_sub(1) {
        for x in 1..width.saturating_sub(1) {
            let value =
                4.0 * pixel(x, y) - pixel(x - 1, y) - pixel(x + 1, y) - pixel(x, y - 1) - pixel(x, y + 1);
            sum += value;
            squares += value * value;
            count += 1.0;
        }
    }
    if count > 0.0 { squares / count - (sum / count).powi(2) } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::Luma;

    fn noise(x: u32, y: u32) -> u8 {
        (x.wrapping_mul(2_654_435_761) ^ y.wrapping_mul(40_503) ^ (x * y))
            .wrapping_mul(2_246_822_519)
            .to_be_bytes()[0]
    }

    #[test]
    fn blur_lowers_the_sharpness_and_not_the_look() {
        let sharp = GrayImage::from_fn(120, 80, |x, y| Luma([noise(x / 3, y / 3)]));
        let blurred = image::imageops::blur(&sharp, 2.0);
        let [a, b] = [&sharp, &blurred].map(Look::of);
        assert!(b.sharpness < 0.5 * a.sharpness, "{} {}", b.sharpness, a.sharpness);
        assert!(detail(&blurred, 120, 80) < 0.5 * detail(&sharp, 120, 80));
        let other = Look::of(&GrayImage::from_fn(120, 80, |x, y| Luma([noise(x / 3 + 97, y / 3 + 31)])));
        assert!(a.difference(&b) < 0.7 * a.difference(&other) && a.difference(&a) == 0.0);
    }

    #[test]
    fn pictures_of_nothing_have_no_sharpness() {
        for (width, height) in [(1, 1), (2, 2), (40, 1), (7, 5)] {
            let look = Look::of(&GrayImage::from_pixel(width, height, Luma([90])));
            assert_eq!(look.sharpness, 0.0);
            assert!(look.cells.iter().all(|cell| *cell == 90.0 || *cell == 0.0));
            assert_eq!(detail(&vec![90; (width * height) as usize], width as usize, height as usize), 0.0);
        }
    }
}
