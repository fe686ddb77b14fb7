//! 3 x 3 convolutions of stride 1 by Winograd's F(2 x 2, 3 x 3): tiles of four outputs cost 16 products per channel
//! instead of 36. (A. Lavin, S. Gray, "Fast algorithms for convolutional neural networks", 2016.) Of the larger tiles
//! none keeps the rounding of f32 near that of the direct sum.

use super::convolution::{Maps, Window};
use super::finish::Finish;
use super::gemm::{PANEL, Packed, Rows, panel_product};
use multiversion::multiversion;
use rayon::prelude::*;

/// Products per tile and channel.
const POINTS: usize = 16;
/// Channels transformed at a time.
const LANES: usize = 8;
/// Values of the transformed inputs of a block: they stay near the second-level cache.
const BLOCK: usize = 1 << 17;

/// Whether the channel counts suit: whole vectors, and enough outputs to pay for the transformation of the input.
pub(super) fn suits(inputs: usize, outputs: usize) -> bool {
    inputs.is_multiple_of(LANES) && outputs >= PANEL
}

/// Weights after the transformation G g Gᵀ: for each of 16 points a matrix `[in, out]`.
#[derive(Debug, Clone)]
pub(in crate::depthsplat) struct Transformed {
    points: Vec<Packed>,
    outputs: usize,
}

impl Transformed {
    /// From weights value(out, in, y, x).
    pub(super) fn new(
        inputs: usize,
        outputs: usize,
        value: impl Fn(usize, usize, usize, usize) -> f32,
    ) -> Self {
        const G: [[f64; 3]; 4] = [[1.0, 0.0, 0.0], [0.5, 0.5, 0.5], [0.5, -0.5, 0.5], [0.0, 0.0, 1.0]];
        let point = |p: usize| {
            Packed::new(inputs, outputs, |i, o| {
                let (row, column) = (G[p / 4], G[p % 4]);
                let terms = (0..9).map(|k| row[k / 3] * column[k % 3] * f64::from(value(o, i, k / 3, k % 3)));
                terms.sum::<f64>() as f32
            })
        };
        Self { points: (0..POINTS).map(point).collect(), outputs }
    }

    /// Output channels.
    pub(super) fn outputs(&self) -> usize {
        self.outputs
    }
}

/// Buffers of a task.
#[derive(Default)]
struct Scratch {
    /// `[16, tiles, in]`.
    inputs: Vec<f32>,
    /// `[16, tiles, 16 channels]`.
    products: Vec<f32>,
}

/// The convolution of every image into `y`, `[count, height, width, out]`.
pub(super) fn convolve(
    x: Maps<'_>,
    window: Window,
    weights: &Transformed,
    finish: &Finish<'_>,
    y: &mut [f32],
) {
    let outputs = weights.outputs;
    let (tile_rows, tile_columns) = (x.height.div_ceil(2), x.width.div_ceil(2));
    let block = (BLOCK / (POINTS * x.channels)).clamp(12, 96) / 12 * 12;
    // Rows of tiles per task: as many as fill a block, if the rows are short.
    let band = (block / tile_columns).clamp(1, tile_rows);
    let row = x.width * outputs;
    y.par_chunks_mut(x.height * row).enumerate().for_each(|(image, y)| {
        y.par_chunks_mut(2 * band * row).enumerate().for_each_init(Scratch::default, |scratch, (b, y)| {
            let tiles = y.len().div_ceil(2 * row) * tile_columns;
            for first in (0..tiles).step_by(block) {
                let tiles = Tiles {
                    image,
                    top: b * band,
                    first,
                    count: block.min(tiles - first),
                    columns: tile_columns,
                };
                transform_inputs(x, window, tiles, scratch);
                products(x.channels, weights, tiles, scratch, y, x.width);
            }
            finish.apply(y, outputs, (image * x.height + 2 * b * band) * row);
        });
    });
}

/// Some tiles of a band, row by row.
#[derive(Clone, Copy)]
struct Tiles {
    image: usize,
    /// The band's first row of tiles.
    top: usize,
    /// First tile, counted from the band's first.
    first: usize,
    count: usize,
    /// Tiles per row.
    columns: usize,
}

impl Tiles {
    /// Row (within the band) and column of a tile.
    fn place(&self, t: usize) -> (usize, usize) {
        ((self.first + t) / self.columns, (self.first + t) % self.columns)
    }
}

fn transform_inputs(x: Maps<'_>, window: Window, tiles: Tiles, scratch: &mut Scratch) {
    let needed = POINTS * tiles.count * x.channels;
    if scratch.inputs.len() < needed {
        scratch.inputs.resize(needed, 0.0);
    }
    let zeros = vec![0.0; x.channels];
    for t in 0..tiles.count {
        let (row, column) = tiles.place(t);
        let (top, left) = (2 * (tiles.top + row), 2 * column);
        let rows: [Option<usize>; 4] = std::array::from_fn(|v| window.source(top, v, x.height));
        let columns: [Option<usize>; 4] = std::array::from_fn(|u| window.source(left, u, x.width));
        let pixels: [&[f32]; POINTS] = std::array::from_fn(|p| match (rows[p / 4], columns[p % 4]) {
            (Some(v), Some(u)) => x.pixel(tiles.image, v, u),
            _ => zeros.as_slice(),
        });
        transform_tile(&pixels, &mut scratch.inputs, t * x.channels, tiles.count * x.channels);
    }
}

/// Bᵀ d B of one tile: point p goes to `out[offset + p * stride..]`.
#[multiversion(targets("x86_64+avx2+fma"))]
fn transform_tile(pixels: &[&[f32]; POINTS], out: &mut [f32], offset: usize, stride: usize) {
    let channels = pixels[0].len();
    for c in (0..channels).step_by(LANES) {
        let d: [[f32; LANES]; POINTS] = std::array::from_fn(|p| lanes(pixels[p], c));
        let mut rows = [[0.0; LANES]; POINTS];
        for u in 0..4 {
            for l in 0..LANES {
                rows[u][l] = d[u][l] - d[8 + u][l];
                rows[4 + u][l] = d[4 + u][l] + d[8 + u][l];
                rows[8 + u][l] = d[8 + u][l] - d[4 + u][l];
                rows[12 + u][l] = d[4 + u][l] - d[12 + u][l];
            }
        }
        for v in 0..4 {
            let [a, b, c1, d1] = [rows[4 * v], rows[4 * v + 1], rows[4 * v + 2], rows[4 * v + 3]];
            let mut store = |u: usize, values: [f32; LANES]| {
                out[offset + (4 * v + u) * stride + c..][..LANES].copy_from_slice(&values);
            };
            store(0, std::array::from_fn(|l| a[l] - c1[l]));
            store(1, std::array::from_fn(|l| b[l] + c1[l]));
            store(2, std::array::from_fn(|l| c1[l] - b[l]));
            store(3, std::array::from_fn(|l| b[l] - d1[l]));
        }
    }
}

#[inline(always)]
fn lanes(values: &[f32], c: usize) -> [f32; LANES] {
    let mut out = [0.0; LANES];
    out.copy_from_slice(&values[c..c + LANES]);
    out
}

/// Multiplies the transformed inputs of the tiles by all weights, and writes the outputs into the band `y`.
fn products(
    channels: usize,
    weights: &Transformed,
    tiles: Tiles,
    scratch: &mut Scratch,
    y: &mut [f32],
    width: usize,
) {
    let size = tiles.count * PANEL;
    if scratch.products.len() < POINTS * size {
        scratch.products.resize(POINTS * size, 0.0);
    }
    let outputs = weights.outputs;
    let height = y.len() / (width * outputs);
    for p in 0..outputs.div_ceil(PANEL) {
        for (point, matrix) in weights.points.iter().enumerate() {
            let rows = Rows {
                values: &scratch.inputs[point * tiles.count * channels..][..tiles.count * channels],
                stride: channels,
                count: tiles.count,
            };
            let product = &mut scratch.products[point * size..][..size];
            panel_product(rows, matrix.panel(p), product, PANEL, PANEL, false);
        }
        let live = PANEL.min(outputs - p * PANEL);
        for t in 0..tiles.count {
            let (row, column) = tiles.place(t);
            let tile = output_tile(&scratch.products[t * PANEL..], size);
            for (k, values) in tile.iter().enumerate() {
                let (v, u) = (2 * row + k / 2, 2 * column + k % 2);
                if v < height && u < width {
                    y[(v * width + u) * outputs + p * PANEL..][..live].copy_from_slice(&values[..live]);
                }
            }
        }
    }
}

/// Aᵀ m A of one tile, whose points lie `stride` apart: four outputs, row by row.
#[multiversion(targets("x86_64+avx2+fma"))]
fn output_tile(products: &[f32], stride: usize) -> [[f32; PANEL]; 4] {
    let mut out = [[0.0; PANEL]; 4];
    let m: [&[f32; PANEL]; POINTS] =
        std::array::from_fn(|p| products[p * stride..].first_chunk().unwrap_or(&[0.0; PANEL]));
    for l in 0..PANEL {
        let rows = |u: usize| (m[u][l] + m[4 + u][l] + m[8 + u][l], m[4 + u][l] - m[8 + u][l] - m[12 + u][l]);
        let (a, b, c, d) = (rows(0), rows(1), rows(2), rows(3));
        out[0][l] = a.0 + b.0 + c.0;
        out[1][l] = b.0 - c.0 - d.0;
        out[2][l] = a.1 + b.1 + c.1;
        out[3][l] = b.1 - c.1 - d.1;
    }
    out
}
