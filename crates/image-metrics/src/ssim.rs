use crate::check::comparable;
use crate::{Error, Result};
use gs_scene::Image;
use multiversion::multiversion;
use rayon::prelude::*;

/// Side of the window of [`ssim`], pixels; smaller pictures have no structural similarity.
pub const SSIM_WINDOW: usize = 11;
/// Standard deviation of the Gaussian window, pixels (Wang et al. 2004, section III.C).
const SIGMA: f64 = 1.5;
/// Stabilising constants (K₁ L)² and (K₂ L)² for values of range L = 1.
const C1: f64 = 0.01 * 0.01;
const C2: f64 = 0.03 * 0.03;
/// Population to sample covariance for the 121 pixels of the window.
const SAMPLE: f64 = 121.0 / 120.0;
/// Local means that the index is made of: a, b, a², b², a b.
const MOMENTS: usize = 5;

/// Structural similarity (Wang et al. 2004) as scikit-image computes it with `gaussian_weights=True, win_size=11,
/// data_range=1` and default settings otherwise: Gaussian window of 11 × 11 and σ = 1.5, sample covariance, mean over the
/// channels and over the pixels whose window lies inside the picture. Equal pictures give 1.
///
/// Values are taken as they are; a caller who measures renderings clips them first.
///
/// # Errors
/// If the sizes differ, a side is below [`SSIM_WINDOW`], or a value is not finite.
pub fn ssim(a: &Image, b: &Image) -> Result<f64> {
    comparable(a, b)?;
    let (width, height) = (a.width(), a.height());
    if width.min(height) < SSIM_WINDOW {
        return Err(Error::TooSmall { width, height, minimum: SSIM_WINDOW });
    }
    let taps = taps();
    let row = width * 3;
    // Rows are summed in their order, so that the result does not depend on the number of threads.
    let rows: Vec<f64> = (0..=height - SSIM_WINDOW)
        .into_par_iter()
        .map_init(
            || vec![0.0; MOMENTS * row],
            |scratch, y| {
                let window = y * row..(y + SSIM_WINDOW) * row;
                row_sum(&a.data()[window.clone()], &b.data()[window], &taps, scratch)
            },
        )
        .collect();
    let pixels = (width - SSIM_WINDOW + 1) * (height - SSIM_WINDOW + 1);
    Ok(rows.iter().sum::<f64>() / (pixels * 3) as f64)
}

/// The weights of the window along one axis; they sum to 1.
fn taps() -> [f64; SSIM_WINDOW] {
    let centre = (SSIM_WINDOW / 2) as f64;
    let raw: [f64; SSIM_WINDOW] =
        std::array::from_fn(|i| (-0.5 * ((i as f64 - centre) / SIGMA).powi(2)).exp());
    let sum: f64 = raw.iter().sum();
    raw.map(|tap| tap / sum)
}

/// Sum of the index over one row of windows; `a` and `b` are the eleven rows of pixels, channels interleaved.
#[multiversion(targets("x86_64+avx2+fma", "aarch64+neon"))]
fn row_sum(a: &[f32], b: &[f32], taps: &[f64; SSIM_WINDOW], scratch: &mut [f64]) -> f64 {
    let row = a.len() / SSIM_WINDOW;
    scratch.fill(0.0);
    {
        let (mean_a, rest) = scratch.split_at_mut(row);
        let (mean_b, rest) = rest.split_at_mut(row);
        let (square_a, rest) = rest.split_at_mut(row);
        let (square_b, product) = rest.split_at_mut(row);
        for ((&tap, a), b) in taps.iter().zip(a.chunks_exact(row)).zip(b.chunks_exact(row)) {
            for x in 0..row {
                let (a, b) = (f64::from(a[x]), f64::from(b[x]));
                mean_a[x] += tap * a;
                mean_b[x] += tap * b;
                square_a[x] += tap * (a * a);
                square_b[x] += tap * (b * b);
                product[x] += tap * (a * b);
            }
        }
    }
    // Along the row, in blocks that stay in registers; the same channel of the next pixel is three numbers on.
    const BLOCK: usize = 8;
    let windows = row - 3 * (SSIM_WINDOW - 1);
    let mut sum = [0.0; BLOCK];
    for start in (0..windows).step_by(BLOCK) {
        let count = BLOCK.min(windows - start);
        let mut moments = [[0.0; BLOCK]; MOMENTS];
        for (moment, plane) in moments.iter_mut().zip(scratch.chunks_exact(row)) {
            for (k, &tap) in taps.iter().enumerate() {
                let values = &plane[start + 3 * k..start + 3 * k + count];
                for (moment, value) in moment.iter_mut().zip(values) {
                    *moment += tap * value;
                }
            }
        }
        for (lane, sum) in sum.iter_mut().enumerate().take(count) {
            let [a, b, aa, bb, ab] = moments.map(|moment| moment[lane]);
            let (variances, covariance) = (SAMPLE * (aa - a * a + (bb - b * b)), SAMPLE * (ab - a * b));
            *sum += (2.0 * a * b + C1) * (2.0 * covariance + C2) / ((a * a + b * b + C1) * (variances + C2));
        }
    }
    sum.iter().sum()
}
