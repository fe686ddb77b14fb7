//! The cost volume on slices: how well the features of a view agree with those of its neighbours, at many depths.

use super::convolution::Maps;
use cpu_kernels::Isa;
use cpu_kernels::rows::dot;
use rayon::prelude::*;

/// Nearest a point may come to the plane of the other camera, scene units; behind it, it is put there.
const NEAREST: f64 = 1e-3;

/// Where pixels of one view lie in the map of another: a pixel (x, y) at inverse depth c appears at the first two
/// components of (turned · (x, y, 1) / c + moved), divided by the third.
#[derive(Debug, Clone, Copy)]
pub(in crate::depthsplat) struct Pairing {
    /// Number of the other view.
    pub(in crate::depthsplat) other: usize,
    pub(in crate::depthsplat) turned: [[f64; 3]; 3],
    pub(in crate::depthsplat) moved: [f64; 3],
}

impl Pairing {
    /// The ray of a pixel, turned.
    fn ray(&self, x: usize, y: usize) -> [f64; 3] {
        self.turned.map(|[a, b, c]| a * x as f64 + b * y as f64 + c)
    }

    fn on_ray(&self, ray: [f64; 3], inverse_depth: f32) -> [f64; 2] {
        let depth = 1.0 / f64::from(inverse_depth);
        let [u, v, w] = [0, 1, 2].map(|i| ray[i] * depth + self.moved[i]);
        let w = w.max(NEAREST);
        [u / w, v / w]
    }

    /// Position of a pixel in the other map, column and row as indices.
    pub(in crate::depthsplat) fn position(&self, x: usize, y: usize, inverse_depth: f32) -> [f64; 2] {
        self.on_ray(self.ray(x, y), inverse_depth)
    }
}

/// The upper left of the four pixels around a position; it may lie one outside.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Cell {
    column: i64,
    row: i64,
}

/// Cell and place within it, or `None` if all four pixels lie outside.
fn cell([u, v]: [f64; 2], width: usize, height: usize) -> Option<(Cell, f32, f32)> {
    // Tested before the conversion: positions may be huge, or NaN.
    if !(u > -1.0 && v > -1.0 && u < width as f64 && v < height as f64) {
        return None;
    }
    let (left, top) = (u.floor(), v.floor());
    Some((Cell { column: left as i64, row: top as i64 }, (u - left) as f32, (v - top) as f32))
}

/// Weights of the four pixels of a cell, row by row.
fn weights(right: f32, down: f32) -> [f32; 4] {
    let (left, up) = (1.0 - right, 1.0 - down);
    [up * left, up * right, down * left, down * right]
}

/// All that a cost volume is made of.
#[derive(Debug, Clone, Copy)]
pub(in crate::depthsplat) struct Correlation<'a> {
    pub(in crate::depthsplat) features: Maps<'a>,
    /// Per view.
    pub(in crate::depthsplat) pairings: &'a [Vec<Pairing>],
    /// Inverse depths, `[view, count]`, or `[view, pixel, count]` if each pixel has its own.
    pub(in crate::depthsplat) candidates: &'a [f32],
    /// Candidates per pixel.
    pub(in crate::depthsplat) count: usize,
}

impl<'a> Correlation<'a> {
    fn pixels(&self) -> usize {
        self.features.height * self.features.width
    }

    /// Candidates of a pixel.
    pub(in crate::depthsplat) fn candidates_of(&self, view: usize, pixel: usize) -> &'a [f32] {
        let views = self.pairings.len();
        let row =
            if self.candidates.len() == views * self.count { view } else { view * self.pixels() + pixel };
        &self.candidates[row * self.count..][..self.count]
    }

    fn around(&self, view: usize, cell: Cell) -> [Option<&'a [f32]>; 4] {
        let pixel = |row: i64, column: i64| {
            let row = usize::try_from(row).ok().filter(|&row| row < self.features.height)?;
            let column = usize::try_from(column).ok().filter(|&column| column < self.features.width)?;
            Some(self.features.pixel(view, row, column))
        };
        let Cell { column, row } = cell;
        [pixel(row, column), pixel(row, column + 1), pixel(row + 1, column), pixel(row + 1, column + 1)]
    }

    /// Mean over the neighbours of (f · f') / sqrt(channels), `[view, row, column, candidate]`.
    pub(in crate::depthsplat) fn volume(&self) -> Vec<f32> {
        let row = self.features.width * self.count;
        let mut out = vec![0.0; self.pairings.len() * self.pixels() * self.count];
        out.par_chunks_mut(row).enumerate().for_each(|(i, out)| {
            let (view, y) = (i / self.features.height, i % self.features.height);
            for (x, out) in out.chunks_exact_mut(self.count).enumerate() {
                self.pixel(view, x, y, out);
            }
        });
        out
    }

    fn pixel(&self, view: usize, x: usize, y: usize, out: &mut [f32]) {
        let isa = Isa::in_use();
        let mine = self.features.pixel(view, y, x);
        let candidates = self.candidates_of(view, y * self.features.width + x);
        let pairings = &self.pairings[view];
        let factor = 1.0 / (mine.len() as f32).sqrt() / pairings.len() as f32;
        for pairing in pairings {
            let ray = pairing.ray(x, y);
            // Along the ray neighbouring candidates mostly fall into the same cell.
            let mut last = (None, [0.0; 4]);
            for (&candidate, out) in candidates.iter().zip(&mut *out) {
                let position = pairing.on_ray(ray, candidate);
                let Some((corner, right, down)) = cell(position, self.features.width, self.features.height)
                else {
                    continue;
                };
                if last.0 != Some(corner) {
                    let products = self.around(pairing.other, corner).map(|other| match other {
                        Some(other) => dot(isa, mine, other),
                        None => 0.0,
                    });
                    last = (Some(corner), products);
                }
                let weights = weights(right, down);
                let sum: f32 = last.1.iter().zip(weights).map(|(product, weight)| product * weight).sum();
                *out += sum * factor;
            }
        }
    }

    /// The other view's features at a position, interpolated, as they enter the volume.
    pub(in crate::depthsplat) fn warped(&self, view: usize, position: [f64; 2]) -> Vec<f32> {
        let mut out = vec![0.0; self.features.channels];
        if let Some((corner, right, down)) = cell(position, self.features.width, self.features.height) {
            for (pixel, weight) in self.around(view, corner).into_iter().zip(weights(right, down)) {
                for (out, value) in out.iter_mut().zip(pixel.unwrap_or(&[])) {
                    *out += weight * value;
                }
            }
        }
        out
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The volume by the definition: features interpolated with zeros outside, then multiplied.
    #[test]
    fn the_volume_is_the_product_with_warped_features() {
        let (views, height, width, channels, count) = (3, 5, 7, 20, 9);
        let values: Vec<f32> =
            (0..views * height * width * channels).map(|i| (i as f32 * 0.37).sin()).collect();
        let features = Maps { values: &values, height, width, channels };
        let pairings: Vec<Vec<Pairing>> = (0..views)
            .map(|i| {
                let other = |j: usize| Pairing {
                    other: j,
                    turned: [[1.0, 0.02, -0.4], [-0.03, 0.98, 0.2], [0.001 * i as f64, -0.002, 1.0]],
                    moved: [1.1 * (j as f64 - i as f64), -0.3 * j as f64, 0.4 * i as f64 - 0.5],
                };
                (0..views).filter(|&j| j != i).map(other).collect()
            })
            .collect();
        let all_candidates: Vec<f32> =
            (0..views * height * width * count).map(|i| 0.1 + (i % 23) as f32 * 0.2).collect();
        for candidates in [&all_candidates[..views * count], &all_candidates] {
            let correlation = Correlation { features, pairings: &pairings, candidates, count };
            let volume = correlation.volume();
            let mut outside = 0;
            for (i, &found) in volume.iter().enumerate() {
                let (k, x, y) = (i % count, i / count % width, i / count / width % height);
                let view = i / count / width / height;
                let c = correlation.candidates_of(view, y * width + x)[k];
                let mut sum = 0.0;
                for pairing in &pairings[view] {
                    let position = pairing.position(x, y, c);
                    let warped = correlation.warped(pairing.other, position);
                    outside += usize::from(warped.iter().all(|&v| v == 0.0));
                    let products = warped.iter().zip(features.pixel(view, y, x));
                    sum += products.map(|(a, b)| f64::from(*a) * f64::from(*b)).sum::<f64>();
                }
                let expected = sum / (channels as f64).sqrt() / 2.0;
                assert!((f64::from(found) - expected).abs() < 1e-5, "{i}: {found}, not {expected}");
            }
            assert!(outside > 0 && outside < 2 * volume.len());
        }
    }

    #[test]
    fn positions_that_are_none_give_zeros() {
        let values = [1.0; 12];
        let features = Maps { values: &values, height: 2, width: 3, channels: 2 };
        let correlation = Correlation { features, pairings: &[], candidates: &[], count: 1 };
        for position in [[1e300, 0.0], [-1.0, 0.0], [0.0, 2.0], [f64::NAN, 0.0], [0.0, f64::NEG_INFINITY]] {
            assert_eq!(correlation.warped(0, position), [0.0; 2]);
        }
        assert_eq!(correlation.warped(0, [-0.5, 1.0]), [0.5; 2]);
        assert_eq!(correlation.warped(0, [2.0, 1.5]), [0.5; 2]);
    }
}
