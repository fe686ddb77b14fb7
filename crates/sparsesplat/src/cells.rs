//! The cells of a view: every pixel belongs to the sampled pixel that stands for it.
//!
//! A Gaussian replaces a patch of the photograph. The patch is found by a clustering in position, colour and
//! inverse depth (as in SLIC superpixels, with the sampled pixels as fixed seeds): cells follow edges, so their mean
//! colours do not mix both sides of an edge, and their second moments give a Gaussian its shape in the picture.

use gs_scene::Image;

/// Colour difference (Euclidean, RGB 0..1) that weighs as much as the distance of one cell width.
const COLOUR_SCALE: f32 = 0.12;
/// Relative difference of inverse depth that weighs as much as the distance of one cell width.
const DEPTH_SCALE: f32 = 0.03;
/// Assignments after the first, each with the means of the cells before it.
const ROUNDS: usize = 2;
/// Variance of a pixel's own square, pixels².
pub(crate) const PIXEL_VARIANCE: f32 = 1.0 / 12.0;

/// What one sampled pixel stands for.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(crate) struct Cell {
    /// Number of pixels.
    pub(crate) area: f32,
    /// Centroid, pixels.
    pub(crate) centre: [f32; 2],
    /// Second central moments xx, xy, yy, pixels².
    pub(crate) covariance: [f32; 3],
    /// Mean colour.
    pub(crate) colour: [f32; 3],
    /// Mean inverse depth.
    pub(crate) inverse_depth: f32,
}

/// No cell: the pixel has no depth, or no seed reaches it.
const NONE: u32 = u32::MAX;

/// The pixels of one view as points to be clustered.
struct Field<'a> {
    image: &'a Image,
    inverse_depth: &'a [f32],
}

impl Field<'_> {
    /// Cost of giving pixel (x, y) to a cell.
    fn cost(&self, x: usize, y: usize, cell: &Cell) -> f32 {
        let (dx, dy) = (x as f32 + 0.5 - cell.centre[0], y as f32 + 0.5 - cell.centre[1]);
        let width = self.image.width();
        let rgb = &self.image.data()[(y * width + x) * 3..][..3];
        let colour: f32 = (0..3).map(|c| (rgb[c] - cell.colour[c]).powi(2)).sum();
        let depth =
            (self.inverse_depth[y * width + x] - cell.inverse_depth) / (DEPTH_SCALE * cell.inverse_depth);
        (dx * dx + dy * dy) / cell.area + colour / (COLOUR_SCALE * COLOUR_SCALE) + depth * depth
    }

    /// Gives every pixel to the cheapest of its neighbours' cells and its own, in two sweeps there and back; cells
    /// spread from their seeds, so this finds nearly the cheapest of all.
    fn assign(&self, cells: &[Cell], labels: &mut [u32], cost: impl Fn(usize, usize, &Cell) -> f32) {
        let (width, height) = (self.image.width(), self.image.height());
        let mut costs = vec![f32::INFINITY; labels.len()];
        for (i, &label) in labels.iter().enumerate() {
            if label != NONE {
                costs[i] = cost(i % width, i / width, &cells[label as usize]);
            }
        }
        for sweep in 0..4 {
            let back = sweep % 2 == 1;
            for row in 0..height {
                // The way back is the way there seen in a mirror, both in rows and in columns.
                let y = if back { height - 1 - row } else { row };
                let (before, this) = match (row, back) {
                    (0, _) => (None, &mut labels[y * width..][..width]),
                    (_, false) => {
                        let (before, this) = labels.split_at_mut(y * width);
                        (Some(&before[(y - 1) * width..]), &mut this[..width])
                    }
                    (_, true) => {
                        let (this, before) = labels.split_at_mut((y + 1) * width);
                        (Some(&before[..width]), &mut this[y * width..])
                    }
                };
                for column in 0..width {
                    let mirrored = |column: usize| if back { width - 1 - column } else { column };
                    let x = mirrored(column);
                    let i = y * width + x;
                    if self.inverse_depth[i] <= 0.0 {
                        continue;
                    }
                    let (mut own_label, mut cheapest) = (this[x], costs[i]);
                    let mut tried = own_label;
                    let mut consider = |label: u32| {
                        // The same again costs the same.
                        if label == NONE || label == own_label || label == tried {
                            return;
                        }
                        tried = label;
                        let candidate = cost(x, y, &cells[label as usize]);
                        if candidate < cheapest {
                            (own_label, cheapest) = (label, candidate);
                        }
                    };
                    let (has_left, has_right) = (column > 0, column + 1 < width);
                    if has_left {
                        consider(this[mirrored(column - 1)]);
                    }
                    if let Some(before) = before {
                        if has_left {
                            consider(before[mirrored(column - 1)]);
                        }
                        consider(before[x]);
                        if has_right {
                            consider(before[mirrored(column + 1)]);
                        }
                    }
                    (this[x], costs[i]) = (own_label, cheapest);
                }
            }
        }
    }

    /// Moments of the cells that the labels make. A cell that lost all its pixels keeps its seed's.
    fn moments(&self, labels: &[u32], seeds: &[u32]) -> Vec<Cell> {
        let width = self.image.width();
        let mut sums = vec![[0.0_f64; 10]; seeds.len()];
        let position = |i: usize| ((i % width) as f64 + 0.5, (i / width) as f64 + 0.5);
        for (i, &label) in labels.iter().enumerate() {
            if label == NONE {
                continue;
            }
            // Relative to the seed, so that the central moments lose nothing.
            let ((x, y), (sx, sy)) = (position(i), position(seeds[label as usize] as usize));
            let (x, y) = (x - sx, y - sy);
            let rgb = &self.image.data()[i * 3..][..3];
            let values = [
                1.0,
                x,
                y,
                x * x,
                x * y,
                y * y,
                f64::from(rgb[0]),
                f64::from(rgb[1]),
                f64::from(rgb[2]),
                f64::from(self.inverse_depth[i]),
            ];
            for (sum, value) in sums[label as usize].iter_mut().zip(values) {
                *sum += value;
            }
        }
        sums.iter()
            .zip(seeds)
            .map(|(sum, &seed)| {
                let seed = seed as usize;
                let (sx, sy) = position(seed);
                let area = sum[0];
                if area == 0.0 {
                    return self.seed_cell(seed, 1.0);
                }
                let mean = sum.map(|s| s / area);
                Cell {
                    area: area as f32,
                    centre: [(sx + mean[1]) as f32, (sy + mean[2]) as f32],
                    covariance: [
                        (mean[3] - mean[1] * mean[1]) as f32 + PIXEL_VARIANCE,
                        (mean[4] - mean[1] * mean[2]) as f32,
                        (mean[5] - mean[2] * mean[2]) as f32 + PIXEL_VARIANCE,
                    ],
                    colour: [mean[6] as f32, mean[7] as f32, mean[8] as f32],
                    inverse_depth: mean[9] as f32,
                }
            })
            .collect()
    }

    /// A cell of the seed pixel alone.
    fn seed_cell(&self, seed: usize, area: f32) -> Cell {
        let width = self.image.width();
        let (x, y) = (seed % width, seed / width);
        Cell {
            area,
            centre: [x as f32 + 0.5, y as f32 + 0.5],
            covariance: [PIXEL_VARIANCE, 0.0, PIXEL_VARIANCE],
            colour: self.image.pixel(x, y),
            inverse_depth: self.inverse_depth[seed],
        }
    }
}

/// The cells of the sampled pixels `seeds` (indices into the picture; each must have an inverse depth above 0).
/// Pixels whose inverse depth is 0 belong to none.
pub(crate) fn cells(image: &Image, inverse_depth: &[f32], seeds: &[u32]) -> Vec<Cell> {
    let field = Field { image, inverse_depth };
    let mut labels = vec![NONE; inverse_depth.len()];
    for (label, &seed) in seeds.iter().enumerate() {
        labels[seed as usize] = label as u32;
    }
    let mut cells: Vec<Cell> = seeds.iter().map(|&seed| field.seed_cell(seed as usize, 1.0)).collect();
    // First by distance alone, which tells how wide each cell is.
    field.assign(&cells, &mut labels, |x, y, cell| {
        (x as f32 + 0.5 - cell.centre[0]).powi(2) + (y as f32 + 0.5 - cell.centre[1]).powi(2)
    });
    for round in 0..ROUNDS {
        let moments = field.moments(&labels, seeds);
        if round == 0 {
            // Positions and colours of the seeds, widths of the cells: means over cells that cross edges mislead.
            for (cell, moment) in cells.iter_mut().zip(moments) {
                cell.area = moment.area;
            }
        } else {
            cells = moments;
        }
        field.assign(&cells, &mut labels, |x, y, cell| field.cost(x, y, cell));
    }
    field.moments(&labels, seeds)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cells_stop_at_an_edge_and_share_out_every_pixel() {
        let (width, height) = (40, 20);
        let bright = |i: usize| i % width >= 17;
        let data = (0..width * height).flat_map(|i| [if bright(i) { 0.9 } else { 0.1 }; 3]).collect();
        let image = Image::new(width, height, data).unwrap();
        let seeds: Vec<u32> = [5, 15, 25, 35].into_iter().map(|x| 10 * 40 + x).collect();
        let cells = cells(&image, &vec![1.0; width * height], &seeds);
        assert_eq!(cells.iter().map(|c| c.area).sum::<f32>(), (width * height) as f32);
        for (cell, expected) in cells.iter().zip([0.1, 0.1, 0.9, 0.9]) {
            assert!((cell.colour[0] - expected).abs() < 0.03, "{cell:?}");
            assert!(cell.covariance[2] > cell.covariance[0], "tall cells in a tall strip: {cell:?}");
        }
    }

    #[test]
    fn one_seed_takes_all_that_has_depth() {
        let image = Image::filled(5, 4, [0.3; 3]).unwrap();
        let mut depth = vec![1.0; 20];
        depth[19] = 0.0;
        let cells = cells(&image, &depth, &[0]);
        assert_eq!(cells[0].area, 19.0);
        assert!(super::cells(&image, &depth, &[]).is_empty());
    }

    #[test]
    fn a_seed_on_every_pixel_is_a_cell_of_one_pixel() {
        let image = Image::filled(6, 3, [0.3; 3]).unwrap();
        let seeds: Vec<u32> = (0..18).collect();
        for (i, cell) in cells(&image, &[0.5; 18], &seeds).iter().enumerate() {
            assert_eq!((cell.area, cell.covariance), (1.0, [PIXEL_VARIANCE, 0.0, PIXEL_VARIANCE]));
            assert_eq!(cell.centre, [(i % 6) as f32 + 0.5, (i / 6) as f32 + 0.5]);
        }
    }
}
