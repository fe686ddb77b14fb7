//! 3 x 3 convolutions of stride 1 by Winograd's F(2 x 2, 3 x 3): tiles of four outputs cost 16 products per channel
//! instead of 36. (A. Lavin, S. Gray, "Fast algorithms for convolutional neural networks", 2016.) Of the larger tiles
//! none keeps the rounding of f32 near that of the direct sum.

use super::convolution::{Maps, Window};
use super::finish::Finish;
use cpu_kernels::pulp::{Simd, WithSimd};
use cpu_kernels::{Isa, Packed, Rows, dispatch, panel_columns};
use rayon::prelude::*;

/// Products per tile and channel.
const POINTS: usize = 16;
/// Values of the transformed inputs of a block: they stay near the second-level cache.
const BLOCK: usize = 1 << 17;

/// Whether the channel counts suit: nearly whole vectors, and enough outputs to pay for the transformation of the input.
pub(super) fn suits(inputs: usize, outputs: usize) -> bool {
    inputs.is_multiple_of(8) && outputs >= 16
}

/// Weights after the transformation G g Gᵀ: for each of 16 points a matrix `[in, out]`.
#[derive(Debug, Clone)]
pub(in crate::depthsplat) struct Transformed {
    isa: Isa,
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
        let isa = Isa::in_use();
        let point = |p: usize| {
            Packed::new(isa, inputs, outputs, |i, o| {
                let (row, column) = (G[p / 4], G[p % 4]);
                let terms = (0..9).map(|k| row[k / 3] * column[k % 3] * f64::from(value(o, i, k / 3, k % 3)));
                terms.sum::<f64>() as f32
            })
        };
        Self { isa, points: (0..POINTS).map(point).collect(), outputs }
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
    /// `[16, tiles, channels of a panel]`.
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
    let block = (BLOCK / (POINTS * x.channels)).clamp(24, 96) / 24 * 24;
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
                transform_inputs(weights.isa, x, window, tiles, scratch);
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

fn transform_inputs(isa: Isa, x: Maps<'_>, window: Window, tiles: Tiles, scratch: &mut Scratch) {
    let needed = POINTS * tiles.count * x.channels;
    if scratch.inputs.len() < needed {
        scratch.inputs.resize(needed, 0.0);
    }
    dispatch(isa, Inputs { x, window, tiles, out: &mut scratch.inputs[..needed] });
}

/// Bᵀ d B of every tile d, `[16, tiles, in]`.
struct Inputs<'a> {
    x: Maps<'a>,
    window: Window,
    tiles: Tiles,
    out: &'a mut [f32],
}

impl WithSimd for Inputs<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { x, window, tiles, out } = self;
        let zeros = vec![0.0; x.channels];
        let stride = tiles.count * x.channels;
        for t in 0..tiles.count {
            let (row, column) = tiles.place(t);
            let (top, left) = (2 * (tiles.top + row), 2 * column);
            let rows: [Option<usize>; 4] = std::array::from_fn(|v| window.source(top, v, x.height));
            let columns: [Option<usize>; 4] = std::array::from_fn(|u| window.source(left, u, x.width));
            let pixels: [&[f32]; POINTS] = std::array::from_fn(|p| match (rows[p / 4], columns[p % 4]) {
                (Some(v), Some(u)) => x.pixel(tiles.image, v, u),
                _ => zeros.as_slice(),
            });
            for c in (0..x.channels).step_by(S::F32_LANES) {
                let live = S::F32_LANES.min(x.channels - c);
                let d: [S::f32s; POINTS] = std::array::from_fn(|p| load(simd, &pixels[p][c..c + live]));
                let mut points = [simd.splat_f32s(0.0); POINTS];
                for u in 0..4 {
                    points[u] = simd.sub_f32s(d[u], d[8 + u]);
                    points[4 + u] = simd.add_f32s(d[4 + u], d[8 + u]);
                    points[8 + u] = simd.sub_f32s(d[8 + u], d[4 + u]);
                    points[12 + u] = simd.sub_f32s(d[4 + u], d[12 + u]);
                }
                for v in 0..4 {
                    let [a, b, c1, d1] = std::array::from_fn(|u| points[4 * v + u]);
                    let transformed = [
                        simd.sub_f32s(a, c1),
                        simd.add_f32s(b, c1),
                        simd.sub_f32s(c1, b),
                        simd.sub_f32s(b, d1),
                    ];
                    for (u, value) in transformed.into_iter().enumerate() {
                        let start = t * x.channels + (4 * v + u) * stride + c;
                        store(simd, &mut out[start..start + live], value);
                    }
                }
            }
        }
    }
}

/// A vector, of which the last values are zeros where the slice is shorter.
#[inline(always)]
fn load<S: Simd>(simd: S, values: &[f32]) -> S::f32s {
    match S::as_simd_f32s(values).0.first() {
        Some(vector) => *vector,
        None => simd.partial_load_f32s(values),
    }
}

/// Stores as many of a vector's values as the slice holds.
#[inline(always)]
fn store<S: Simd>(simd: S, values: &mut [f32], vector: S::f32s) {
    if values.len() >= S::F32_LANES {
        S::as_mut_simd_f32s(values).0[0] = vector;
    } else {
        simd.partial_store_f32s(values, vector);
    }
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
    let panel = panel_columns(weights.isa);
    let size = tiles.count * panel;
    if scratch.products.len() < POINTS * size {
        scratch.products.resize(POINTS * size, 0.0);
    }
    for p in 0..weights.outputs.div_ceil(panel) {
        for (point, matrix) in weights.points.iter().enumerate() {
            let values = &scratch.inputs[point * tiles.count * channels..][..tiles.count * channels];
            let product = &mut scratch.products[point * size..][..size];
            matrix.multiply_panel(p, Rows::new(values, tiles.count, channels), product, panel);
        }
        let first = p * panel;
        let outputs = Outputs {
            products: &scratch.products[..POINTS * size],
            tiles,
            panel,
            y: &mut *y,
            width,
            channels: weights.outputs,
            first,
            live: panel.min(weights.outputs - first),
        };
        dispatch(weights.isa, outputs);
    }
}

/// Aᵀ m A of every tile m: four outputs for each channel of a panel.
struct Outputs<'a> {
    /// `[16, tiles, panel]`.
    products: &'a [f32],
    tiles: Tiles,
    panel: usize,
    /// The band, `[rows, width, channels]`.
    y: &'a mut [f32],
    width: usize,
    channels: usize,
    /// The panel's first channel, and how many it has.
    first: usize,
    live: usize,
}

impl WithSimd for Outputs<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { products, tiles, panel, y, width, channels, first, live } = self;
        let height = y.len() / (width * channels);
        let stride = tiles.count * panel;
        for t in 0..tiles.count {
            let (row, column) = tiles.place(t);
            for c in (0..live).step_by(S::F32_LANES) {
                let m: [S::f32s; POINTS] = std::array::from_fn(|p| {
                    load(simd, &products[p * stride + t * panel + c..][..S::F32_LANES])
                });
                let upper = |u: usize| simd.add_f32s(simd.add_f32s(m[u], m[4 + u]), m[8 + u]);
                let lower = |u: usize| simd.sub_f32s(simd.sub_f32s(m[4 + u], m[8 + u]), m[12 + u]);
                let rows: [[S::f32s; 4]; 2] = [std::array::from_fn(upper), std::array::from_fn(lower)];
                for (k, [a, b, c1, d]) in rows.into_iter().enumerate() {
                    let pair =
                        [simd.add_f32s(simd.add_f32s(a, b), c1), simd.sub_f32s(simd.sub_f32s(b, c1), d)];
                    for (l, value) in pair.into_iter().enumerate() {
                        let (v, u) = (2 * row + k, 2 * column + l);
                        if v < height && u < width {
                            let start = (v * width + u) * channels + first + c;
                            store(simd, &mut y[start..start + S::F32_LANES.min(live - c)], value);
                        }
                    }
                }
            }
        }
    }
}
