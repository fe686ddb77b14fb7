//! The index of a window, and its derivative.

use super::vector::Vector;

/// Stabilising constants (K₁ L)² and (K₂ L)² for values of range L = 1.
const C1: f64 = 0.01 * 0.01;
const C2: f64 = 0.03 * 0.03;
/// Population to sample covariance for the 121 pixels of the window.
const SAMPLE: f64 = 121.0 / 120.0;

/// Local means of windows: of d = a - b - offset, of d², and of d (b - shift). With offset and shift near the means of
/// a - b and of b, little is lost where variances are taken from them.
pub(super) type Moments<V> = [V; 3];

/// What the index needs to know of b in a window: the mean of b - shift, and twice the sample variance plus C₂.
/// From the moments of b - shift in place of d.
#[inline(always)]
pub(super) fn mean_and_contrast<V: Vector>([mean, square, _]: Moments<V>) -> (V, V) {
    let variance = (square - mean * mean).max(V::splat(0.0));
    (mean, variance.mul_add(V::splat(2.0 * SAMPLE), V::splat(C2)))
}

/// 1 - SSIM of windows, and its derivative by each of the moments.
///
/// With v and c the sample variance of d and covariance of d and b, μ and σ² mean and sample variance, δ = μ_a - μ_b:
/// 1 - (2 μ_a μ_b + C₁) / A = δ² / A for A = μ_a² + μ_b² + C₁, and 1 - (2 cov(a, b) + C₂) / B = v / B for
/// B = σ_a² + σ_b² + C₂ = 2 σ_b² + C₂ + 2 c + v. Nothing of this cancels where a is near b, which is where an
/// optimisation ends, and the variance of b comes ready.
#[inline(always)]
pub(super) fn loss<V: Vector>(
    [m, q, r]: Moments<V>,
    (mean, contrast): (V, V),
    shift: V,
    offset: V,
) -> (V, Moments<V>) {
    let one = V::splat(1.0);
    let sample = V::splat(SAMPLE);
    let v = (sample * (q - m * m)).max(V::splat(0.0));
    let c = sample * (r - mean * m);
    let delta = m + offset;
    let mean_b = mean + shift;
    let mean_a = mean_b + delta;
    let inverse_a = one / mean_a.mul_add(mean_a, mean_b.mul_add(mean_b, V::splat(C1)));
    // Rounding may take more from B than C₂; but v, which is at most 2 σ_a² + 2 σ_b², bounds it.
    let b = (contrast + (c + c) + v).max(v.mul_add(V::splat(0.5), V::splat(C2)));
    let inverse_b = one / b;
    let (luminance, structure) = (delta * delta * inverse_a, v * inverse_b);
    let (similar, alike) = (one - luminance, one - structure);
    let loss = structure.mul_add(similar, luminance);

    // v enters B as well: d(v / B) = (1 - v / B) / B dv - 2 v / B² dc.
    let outer = sample * similar * inverse_b;
    let by_q = outer * alike;
    let by_minus_r = outer * (structure + structure);
    let half_by_delta = delta * alike * (one - mean_a * delta * inverse_a) * inverse_a;
    let half_by_m = half_by_delta - m * by_q;
    let by_m = mean.mul_add(by_minus_r, half_by_m + half_by_m);
    (loss, [by_m, by_q, V::splat(0.0) - by_minus_r])
}
