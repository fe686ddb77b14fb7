//! The Gaussian window along one axis.

use super::vector::Vector;
use super::{SIGMA, SSIM_WINDOW};

/// Rows that one pass down the columns makes: so many sums, six weights and a value are the registers of AVX2.
pub(super) const ROWS: usize = 8;
/// Rows that it reads.
pub(super) const SPAN: usize = ROWS + SSIM_WINDOW - 1;
/// Values of a row that go through a pass together: three maps of [`SPAN`] rows in f32 fit the first cache, and places
/// in them are constants to the compiler.
pub(super) const STRIP: usize = 96;
/// The same channel of the next pixel is three values on.
pub(super) const CHANNELS: usize = 3;
/// Values from the first to the last of a window's row.
pub(super) const REACH: usize = CHANNELS * (SSIM_WINDOW - 1);

/// The weights of the window along one axis; they sum to 1 and are symmetric, which makes the filter its own adjoint.
#[inline(always)]
pub(super) fn taps<V: Vector>() -> [V; SSIM_WINDOW] {
    let centre = (SSIM_WINDOW / 2) as f64;
    let raw: [f64; SSIM_WINDOW] =
        std::array::from_fn(|i| (-0.5 * ((i as f64 - centre) / SIGMA).powi(2)).exp());
    let sum: f64 = raw.iter().sum();
    let mut taps = [V::splat(0.0); SSIM_WINDOW];
    for i in 0..SSIM_WINDOW {
        taps[i] = V::splat(raw[i] / sum);
    }
    taps
}

/// Down the columns of a strip.
#[inline(always)]
pub(super) fn vertical<V: Vector>(
    taps: &[V; SSIM_WINDOW],
    rows: &[[V::Real; STRIP]; SPAN],
    filtered: &mut [&mut [V::Real; STRIP]; ROWS],
) {
    for block in 0..STRIP / V::LANES {
        let start = block * V::LANES;
        let mut sums = [V::splat(0.0); ROWS];
        // Written out, for which the compiler would find the loop too long: the sums are to be registers.
        add::<V, 0>(&mut sums, rows, taps, start);
        add::<V, 1>(&mut sums, rows, taps, start);
        add::<V, 2>(&mut sums, rows, taps, start);
        add::<V, 3>(&mut sums, rows, taps, start);
        add::<V, 4>(&mut sums, rows, taps, start);
        add::<V, 5>(&mut sums, rows, taps, start);
        add::<V, 6>(&mut sums, rows, taps, start);
        add::<V, 7>(&mut sums, rows, taps, start);
        add::<V, 8>(&mut sums, rows, taps, start);
        add::<V, 9>(&mut sums, rows, taps, start);
        add::<V, 10>(&mut sums, rows, taps, start);
        add::<V, 11>(&mut sums, rows, taps, start);
        add::<V, 12>(&mut sums, rows, taps, start);
        add::<V, 13>(&mut sums, rows, taps, start);
        add::<V, 14>(&mut sums, rows, taps, start);
        add::<V, 15>(&mut sums, rows, taps, start);
        add::<V, 16>(&mut sums, rows, taps, start);
        add::<V, 17>(&mut sums, rows, taps, start);
        for row in 0..ROWS {
            sums[row].store(filtered[row], start);
        }
    }
}

/// Adds row `I` to those of the filtered rows that it reaches.
#[inline(always)]
fn add<V: Vector, const I: usize>(
    sums: &mut [V; ROWS],
    rows: &[[V::Real; STRIP]; SPAN],
    taps: &[V; SSIM_WINDOW],
    start: usize,
) {
    let value = V::load(&rows[I], start);
    for row in (I + 1).saturating_sub(SSIM_WINDOW)..(I + 1).min(ROWS) {
        sums[row] = value.mul_add(taps[I - row], sums[row]);
    }
}

/// Along the row: three filtered maps from place `start` on.
#[inline(always)]
pub(super) fn horizontal<V: Vector>(taps: &[V; SSIM_WINDOW], maps: [&[V::Real]; 3], start: usize) -> [V; 3] {
    let end = start + REACH + V::LANES;
    let maps = [&maps[0][start..end], &maps[1][start..end], &maps[2][start..end]];
    let mut sums = [V::splat(0.0); 3];
    for (k, &tap) in taps.iter().enumerate() {
        for map in 0..3 {
            sums[map] = V::load(maps[map], CHANNELS * k).mul_add(tap, sums[map]);
        }
    }
    sums
}
