//! Integer hashing and value noise: all randomness of the crate, a pure function of place and seed.

use glam::DVec3;

/// Mixes four integers into 32 well-spread bits (a multiplicative hash and the finaliser of MurmurHash3).
pub(crate) fn hash(x: u32, y: u32, z: u32, seed: u32) -> u32 {
    finish(
        x.wrapping_mul(0x8da6_b343)
            ^ y.wrapping_mul(0xd816_3841)
            ^ z.wrapping_mul(0xcb1a_b31f)
            ^ finish(seed),
    )
}

fn finish(mut bits: u32) -> u32 {
    bits = (bits ^ (bits >> 16)).wrapping_mul(0x85eb_ca6b);
    bits = (bits ^ (bits >> 13)).wrapping_mul(0xc2b2_ae35);
    bits ^ (bits >> 16)
}

/// 32 random bits as a number in 0..1.
pub(crate) fn unit(bits: u32) -> f64 {
    f64::from(bits) * 2f64.powi(-32)
}

/// A number of the standard normal distribution from random bits (Box and Muller); within 6.8 deviations.
pub(crate) fn normal(bits: u32) -> f64 {
    let radius = (-2.0 * ((f64::from(bits) + 0.5) * 2f64.powi(-32)).ln()).sqrt();
    radius * (std::f64::consts::TAU * unit(hash(bits, 0, 0x6e, 0x6f72_6d61))).cos()
}

/// The largest integer up to `x`, as lattice index and as number. (`f64::floor` is a library call on x86-64
/// without SSE 4.1, and takes a third of the time of the noise.)
fn floor(x: f64) -> (i64, f64) {
    let truncated = x as i64;
    let index = truncated - i64::from((truncated as f64) > x);
    (index, index as f64)
}

/// The cell of a lattice that holds `x`, as hash input; far cells wrap.
pub(crate) fn cell(x: f64) -> u32 {
    floor(x).0 as u32
}

/// Value noise with lattice spacing 1: smooth, in 0..1, mean 1/2.
pub(crate) fn value(p: DVec3, seed: u32) -> f64 {
    let [(x, x0), (y, y0), (z, z0)] = p.to_array().map(floor);
    let (x, y, z) = (x as u32, y as u32, z as u32);
    let f = p - DVec3::new(x0, y0, z0);
    // Perlin's quintic fade: first and second derivatives vanish at the lattice points.
    let w = f * f * f * (f * (f * 6.0 - 15.0) + 10.0);
    let seed = finish(seed);
    let corner = |dx: u32, dy: u32, dz: u32| {
        let mixed = x.wrapping_add(dx).wrapping_mul(0x8da6_b343)
            ^ y.wrapping_add(dy).wrapping_mul(0xd816_3841)
            ^ z.wrapping_add(dz).wrapping_mul(0xcb1a_b31f);
        unit(finish(mixed ^ seed))
    };
    let mix = |a: f64, b: f64, t: f64| a + (b - a) * t;
    let row = |dy, dz| mix(corner(0, dy, dz), corner(1, dy, dz), w.x);
    let plane = |dz| mix(row(0, dz), row(1, dz), w.y);
    mix(plane(0), plane(1), w.z)
}

/// Sum of `octaves` of value noise, the first with wavelength 1, each next one with half the wavelength and
/// half the amplitude; in 0..1, mean 1/2. Octaves finer than what samples `width` apart can show fade to
/// their mean.
pub(crate) fn octaves(mut p: DVec3, octaves: u32, width: f64, seed: u32) -> f64 {
    let (mut sum, mut amplitude, mut total, mut wavelength) = (0.0, 1.0, 0.0, 1.0);
    for octave in 0..octaves {
        // Full at four samples a wavelength, gone at two (the Nyquist limit).
        let shown = (0.5 * wavelength / width - 1.0).clamp(0.0, 1.0);
        if shown > 0.0 {
            sum += amplitude * shown * (value(p, seed.wrapping_add(octave)) - 0.5);
        }
        total += amplitude;
        amplitude *= 0.5;
        wavelength *= 0.5;
        p *= 2.0;
    }
    0.5 + sum / total
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn hashed_numbers_are_spread_evenly() {
        let n = 20_000;
        let values: Vec<f64> = (0..n).map(|i| unit(hash(i % 100, i / 100, 7, 3))).collect();
        let mean = values.iter().sum::<f64>() / f64::from(n);
        let variance = values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / f64::from(n);
        assert!((mean - 0.5).abs() < 0.01, "mean {mean}");
        assert!((variance - 1.0 / 12.0).abs() < 0.003, "variance {variance}");
    }

    #[test]
    fn normal_numbers_have_the_moments_of_their_distribution() {
        let n = 100_000u32;
        let values: Vec<f64> = (0..n).map(|i| normal(hash(i % 300, i / 300, 1, 8))).collect();
        let moment = |k| values.iter().map(|v| v.powi(k)).sum::<f64>() / f64::from(n);
        // Standard errors of the means: 0.003, 0.0045, 0.012, 0.031.
        assert!(moment(1).abs() < 0.015, "mean {}", moment(1));
        assert!((moment(2) - 1.0).abs() < 0.022, "variance {}", moment(2));
        assert!(moment(3).abs() < 0.06, "skewness {}", moment(3));
        assert!((moment(4) - 3.0).abs() < 0.16, "kurtosis {}", moment(4));
        let pairs = values.windows(2).map(|w| w[0] * w[1]).sum::<f64>() / f64::from(n);
        assert!(pairs.abs() < 0.016, "neighbours go together by {pairs}");
        assert!(normal(0).is_finite() && normal(u32::MAX).is_finite());
    }

    #[test]
    fn noise_is_continuous_across_cells_and_keeps_its_range() {
        for i in -300..300 {
            let p = DVec3::new(f64::from(i) * 0.37, 1.3, f64::from(i) * -0.11);
            let v = octaves(p, 5, 1e-6, 9);
            assert!((0.0..=1.0).contains(&v), "{v}");
            let lattice = DVec3::new(f64::from(i), 0.4, 0.6);
            let step = value(lattice + DVec3::X * 1e-7, 1) - value(lattice - DVec3::X * 1e-7, 1);
            assert!(step.abs() < 1e-5, "jump of {step} at {i}");
        }
    }

    #[test]
    fn noise_too_fine_to_show_is_its_mean() {
        for i in 0..50 {
            let v = octaves(DVec3::splat(f64::from(i) * 0.31), 6, 10.0, 2);
            assert_eq!(v, 0.5);
        }
    }
}
