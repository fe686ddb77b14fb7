//! Near-to-far compositing of a tile's splats, eight pixels of a row at a time.
//!
//! The loops over lanes have a fixed length and no branches, so that the compiler turns them into vector
//! instructions; the function around them is compiled for several instruction sets and chosen at run time.

use super::bin::Bins;
use super::project::Splat;
use super::{Grid, TILE};
use crate::RenderSettings;
use multiversion::{multiversion, target::target_cfg_f};
use rayon::prelude::*;

/// Pixels of one step.
const LANES: usize = 8;
/// Pixels of a tile.
const PIXELS: usize = TILE * TILE;
/// Splats between two looks at whether the whole tile is done.
const DONE_INTERVAL: usize = 32;

type Lanes = [f32; LANES];

/// The pixels of a tile while splats are added, one plane per quantity, rows of [`TILE`].
#[repr(align(64))]
struct Tile {
    /// What is left of the light from behind; its sign is negative where the pixel is done.
    transmittance: [f32; PIXELS],
    rgb: [[f32; PIXELS]; 3],
    /// Σ w and Σ w z, kept only when depth is asked for.
    weight: [f32; PIXELS],
    depth: [f32; PIXELS],
}

/// Thresholds of the blending.
#[derive(Clone, Copy)]
struct Limits {
    log2_alpha_min: f32,
    alpha_max: f32,
    transmittance_min: f32,
}

/// Blends every tile into `image` `[h, w, 3]`, `alpha` `[h, w]` and `depth` (`[h, w]`, or empty if not asked for).
pub(super) fn blend(
    splats: &[Splat],
    bins: &Bins,
    grid: Grid,
    settings: &RenderSettings,
    image: &mut [f32],
    alpha: &mut [f32],
    depth: &mut [f32],
) {
    let limits = Limits {
        log2_alpha_min: settings.alpha_min.log2(),
        alpha_max: settings.alpha_max,
        transmittance_min: settings.transmittance_min,
    };
    let band = TILE * grid.width;
    let mut depth_bands: Vec<&mut [f32]> = if depth.is_empty() {
        (0..grid.rows).map(|_| <&mut [f32]>::default()).collect()
    } else {
        depth.chunks_mut(band).collect()
    };
    image
        .par_chunks_mut(band * 3)
        .zip(alpha.par_chunks_mut(band))
        .zip(&mut depth_bands)
        .enumerate()
        .for_each(|(row, ((image, alpha), depth))| {
            let tiles: Vec<Box<Tile>> = (0..grid.columns)
                .into_par_iter()
                .map_init(Vec::new, |list, column| {
                    let mut tile = Tile::new(grid, column, row);
                    let origin = [column * TILE, row * TILE];
                    bins.near_to_far(row * grid.columns + column, splats, list);
                    if depth.is_empty() {
                        blend_tile::<false>(&mut tile, list, splats, origin, limits);
                    } else {
                        blend_tile::<true>(&mut tile, list, splats, origin, limits);
                    }
                    tile
                })
                .collect();
            for (y, alpha) in alpha.chunks_exact_mut(grid.width).enumerate() {
                for (x, alpha) in alpha.iter_mut().enumerate() {
                    let (tile, pixel, at) = (&tiles[x / TILE], y * TILE + x % TILE, y * grid.width + x);
                    let transmittance = tile.transmittance[pixel].abs();
                    *alpha = 1.0 - transmittance;
                    for channel in 0..3 {
                        image[at * 3 + channel] =
                            tile.rgb[channel][pixel] + transmittance * settings.background[channel];
                    }
                    if let Some(depth) = depth.get_mut(at).filter(|_| tile.weight[pixel] > 0.0) {
                        *depth = tile.depth[pixel] / tile.weight[pixel];
                    }
                }
            }
        });
}

impl Tile {
    /// A tile before the first splat; pixels beyond the image's edge count as done.
    fn new(grid: Grid, column: usize, row: usize) -> Box<Self> {
        let mut tile = Box::new(Self {
            transmittance: [-1.0; PIXELS],
            rgb: [[0.0; PIXELS]; 3],
            weight: [0.0; PIXELS],
            depth: [0.0; PIXELS],
        });
        let width = TILE.min(grid.width - column * TILE);
        let height = TILE.min(grid.height - row * TILE);
        for row in tile.transmittance.chunks_exact_mut(TILE).take(height) {
            row[..width].fill(1.0);
        }
        tile
    }
}

/// Adds the splats whose indices are in the low halves of `list` to the tile whose top-left pixel is `origin`.
#[multiversion(targets("x86_64+avx2+fma"))]
fn blend_tile<const DEPTH: bool>(
    tile: &mut Tile,
    list: &[u64],
    splats: &[Splat],
    origin: [usize; 2],
    limits: Limits,
) {
    if cfg!(target_arch = "aarch64") || target_cfg_f!(target_feature = "fma") {
        blend_tile_with::<DEPTH, true>(tile, list, splats, origin, limits);
    } else {
        blend_tile_with::<DEPTH, false>(tile, list, splats, origin, limits);
    }
}

#[inline(always)]
fn blend_tile_with<const DEPTH: bool, const FMA: bool>(
    tile: &mut Tile,
    list: &[u64],
    splats: &[Splat],
    origin: [usize; 2],
    limits: Limits,
) {
    let centres: [f32; TILE] = std::array::from_fn(|i| i as f32 + 0.5);
    for (count, &key) in list.iter().enumerate() {
        if count % DONE_INTERVAL == DONE_INTERVAL - 1 && tile.transmittance.iter().all(|&t| t <= 0.0) {
            return;
        }
        let splat = &splats[key as u32 as usize];
        // Relative to the tile, f32 keeps the position to a millionth of a pixel in images of any size.
        let x = (splat.mean[0] - origin[0] as f64) as f32;
        let y = (splat.mean[1] - origin[1] as f64) as f32;
        let first = (y - splat.extent[1] - 0.5).ceil().max(0.0) as usize;
        let last = (y + splat.extent[1] - 0.5).floor().min((TILE - 1) as f32);
        // Whether the ellipse reaches the left and the right half of the tile; finer tests cost more than they save.
        let first_step = if x - splat.extent[0] <= centres[LANES - 1] { 0 } else { 1 };
        let last_step = if x + splat.extent[0] >= centres[LANES] { 2 } else { 1 };
        let last = if last >= 0.0 { last as usize + 1 } else { 0 };
        for row in first..last {
            let dy = centres[row] - y;
            // The row's middle, and what the distance of the row takes from every pixel in it.
            let (middle, constant) = (x + splat.shear * dy, splat.falloff[1] * dy * dy + splat.log2_opacity);
            for step in first_step..last_step {
                let start = step * LANES;
                let at = row * TILE + start;
                let mut weight = [0.0; LANES];
                {
                    let transmittance = lanes(&mut tile.transmittance, at);
                    for lane in 0..LANES {
                        let dx = centres[start + lane] - middle;
                        let log2_alpha = mul_add::<FMA>(splat.falloff[0] * dx, dx, constant);
                        let alpha = exp2::<FMA>(log2_alpha).min(limits.alpha_max);
                        let before = transmittance[lane];
                        let drawn = (log2_alpha >= limits.log2_alpha_min) & (before > 0.0);
                        let last = before * (1.0 - alpha) < limits.transmittance_min;
                        weight[lane] = if drawn & !last { before * alpha } else { 0.0 };
                        // A product, because the compiler turns a choice into a masked store, which is slow.
                        let factor = if last { -1.0 } else { 1.0 - alpha };
                        transmittance[lane] = before * if drawn { factor } else { 1.0 };
                    }
                }
                for (channel, &colour) in tile.rgb.iter_mut().zip(&splat.rgb) {
                    accumulate::<FMA>(lanes(channel, at), &weight, colour);
                }
                if DEPTH {
                    accumulate::<FMA>(lanes(&mut tile.weight, at), &weight, 1.0);
                    accumulate::<FMA>(lanes(&mut tile.depth, at), &weight, splat.depth);
                }
            }
        }
    }
}

#[inline(always)]
fn lanes(plane: &mut [f32; PIXELS], at: usize) -> &mut Lanes {
    let slice = &mut plane[at..at + LANES];
    slice.try_into().expect("a slice of LANES numbers")
}

#[inline(always)]
fn accumulate<const FMA: bool>(sum: &mut Lanes, weight: &Lanes, value: f32) {
    for (sum, weight) in sum.iter_mut().zip(weight) {
        *sum = mul_add::<FMA>(*weight, value, *sum);
    }
}

/// a b + c, fused where the instruction set can (elsewhere a fused one would be a library call).
#[inline(always)]
fn mul_add<const FMA: bool>(a: f32, b: f32, c: f32) -> f32 {
    if FMA { a.mul_add(b, c) } else { a * b + c }
}

/// 2^x for -126 ≤ x ≤ 1, relative error below 3e-7: a minimax polynomial on [-½, ½] times a power of two made in the
/// exponent bits. Beyond that range some number, which the caller masks out.
#[inline(always)]
fn exp2<const FMA: bool>(x: f32) -> f32 {
    // Adding 1.5 · 2²³ rounds to the nearest integer and leaves it in the low bits.
    const ROUND: f32 = 12_582_912.0;
    const P: [f32; 6] = [1.0, 0.693_146_94, 0.240_221_2, 0.055_507_13, 0.009_675_542, 0.001_327_647_3];
    let rounded = x + ROUND;
    let f = x - (rounded - ROUND);
    let mut p = P[5];
    p = mul_add::<FMA>(p, f, P[4]);
    p = mul_add::<FMA>(p, f, P[3]);
    p = mul_add::<FMA>(p, f, P[2]);
    p = mul_add::<FMA>(p, f, P[1]);
    p = mul_add::<FMA>(p, f, P[0]);
    f32::from_bits(p.to_bits().wrapping_add(rounded.to_bits() << 23))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn exp2_keeps_its_error_bound() {
        for i in 0..=1_000_000 {
            let x = -126.0 + 127.0 * (i as f32 / 1e6);
            let expected = f64::from(x).exp2();
            for found in [exp2::<false>(x), exp2::<true>(x)] {
                let error = (f64::from(found) / expected - 1.0).abs();
                assert!(error < 3e-7, "2^{x}: {found}, relative error {error:e}");
            }
        }
    }
}
