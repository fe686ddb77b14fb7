//! Colour ramps: monotone in lightness and evenly spaced in the Oklab colour space, so that they read the same in grey
//! and for colour-blind eyes.

use std::sync::LazyLock;

/// 256 colours from low to high.
pub type Ramp = [[u8; 3]; 256];

/// Depth: far is dark violet, near is light yellow.
pub static DEPTH: LazyLock<Ramp> = LazyLock::new(|| ramp((0.22, 300.0), (0.93, 105.0), 0.15));

/// Errors: none is near black, large is light yellow, by way of red.
pub static ERROR: LazyLock<Ramp> = LazyLock::new(|| ramp((0.12, -20.0), (0.95, 100.0), 0.19));

/// The colour of `value` (0..1, clamped; NaN is 0).
pub fn colour(ramp: &Ramp, value: f32) -> [u8; 3] {
    ramp[(value.clamp(0.0, 1.0) * 255.0).round() as usize]
}

/// The colour as CSS writes it.
pub fn hex(rgb: [u8; 3]) -> String {
    format!("#{:02x}{:02x}{:02x}", rgb[0], rgb[1], rgb[2])
}

/// Lightness and hue (degrees) run linearly from `low` to `high`; the chroma is `chroma`, or what sRGB has of it.
fn ramp(low: (f64, f64), high: (f64, f64), chroma: f64) -> Ramp {
    std::array::from_fn(|i| {
        let t = i as f64 / 255.0;
        let lightness = low.0 + t * (high.0 - low.0);
        let hue = (low.1 + t * (high.1 - low.1)).to_radians();
        let (mut inside, mut outside) = (0.0, chroma);
        for _ in 0..20 {
            let middle = (inside + outside) / 2.0;
            match srgb(lightness, middle, hue) {
                Some(_) => inside = middle,
                None => outside = middle,
            }
        }
        let rgb = srgb(lightness, inside, hue).unwrap_or([lightness; 3]);
        rgb.map(|c| (c * 255.0).round() as u8)
    })
}

/// Oklch to sRGB in 0..1, `None` outside the gamut (B. Ottosson, "A perceptual color space for image processing", 2020).
fn srgb(lightness: f64, chroma: f64, hue: f64) -> Option<[f64; 3]> {
    let (a, b) = (chroma * hue.cos(), chroma * hue.sin());
    let l = (lightness + 0.396_337_777_4 * a + 0.215_803_757_3 * b).powi(3);
    let m = (lightness - 0.105_561_345_8 * a - 0.063_854_172_8 * b).powi(3);
    let s = (lightness - 0.089_484_177_5 * a - 1.291_485_548_0 * b).powi(3);
    let linear = [
        4.076_741_662_1 * l - 3.307_711_591_3 * m + 0.230_969_929_2 * s,
        -1.268_438_004_6 * l + 2.609_757_401_1 * m - 0.341_319_396_5 * s,
        -0.004_196_086_3 * l - 0.703_418_614_7 * m + 1.707_614_701_0 * s,
    ];
    linear.iter().all(|c| (-1e-6..=1.0 + 1e-6).contains(c)).then(|| {
        linear.map(|c| {
            let c = c.clamp(0.0, 1.0);
            if c <= 0.003_130_8 { 12.92 * c } else { 1.055 * c.powf(1.0 / 2.4) - 0.055 }
        })
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ramps_get_lighter_all_the_way() {
        for ramp in [&*DEPTH, &*ERROR] {
            let luma =
                |c: &[u8; 3]| 0.2126 * f64::from(c[0]) + 0.7152 * f64::from(c[1]) + 0.0722 * f64::from(c[2]);
            assert!(ramp.windows(2).all(|pair| luma(&pair[1]) > luma(&pair[0]) - 0.8), "{ramp:?}");
            assert!(luma(&ramp[255]) - luma(&ramp[0]) > 190.0);
        }
    }

    #[test]
    fn values_outside_the_range_have_the_colour_of_its_ends() {
        assert_eq!(colour(&DEPTH, -3.0), DEPTH[0]);
        assert_eq!(colour(&DEPTH, f32::NAN), DEPTH[0]);
        assert_eq!(colour(&DEPTH, f32::INFINITY), DEPTH[255]);
    }

    #[test]
    fn white_and_grey_are_where_oklab_puts_them() {
        assert!(srgb(1.0, 0.0, 0.0).unwrap().iter().all(|c| (c - 1.0).abs() < 1e-3));
        assert!(srgb(0.5, 0.3, 1.0).is_none());
    }
}
