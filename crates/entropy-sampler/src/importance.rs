use crate::{Border, EntropyWindow, Error, Result, entropy, parallel};

/// How much each pixel of a view matters: `[height, width]` f32 in 0..1, 0 where nothing is to be seen. A weight per
/// pixel, 0..1, may further lower the probability of being chosen; weight 0 rules a pixel out.
#[derive(Debug, Clone, PartialEq)]
pub struct ImportanceMap {
    width: usize,
    height: usize,
    values: Vec<f32>,
    weights: Option<Vec<f32>>,
}

impl ImportanceMap {
    /// A map from `height * width` values, each in 0..1.
    ///
    /// # Errors
    /// If the size is empty, the buffer does not fit it, or a value is NaN or outside 0..1.
    pub fn new(width: usize, height: usize, values: Vec<f32>) -> Result<Self> {
        check_size("importance map", width, height, values.len())?;
        check_range("importance", &values)?;
        Ok(Self { width, height, values, weights: None })
    }

    /// Local entropy over its maximum, E / log2 L (paper, eq. "prob_map").
    ///
    /// # Errors
    /// As [`entropy()`].
    pub fn entropy(grey: &[u8], width: usize, height: usize, window: EntropyWindow) -> Result<Self> {
        let mut values = entropy(grey, width, height, window)?;
        let per_bit = 1.0 / (window.levels as f32).log2();
        for value in &mut values {
            *value = (*value * per_bit).min(1.0);
        }
        Ok(Self { width, height, values, weights: None })
    }

    /// Magnitude of the Laplacian, |4 g - left - right - above - below|, over its maximum, 4 · 255; the border is
    /// mirrored ([`Border::Reflect`]).
    ///
    /// # Errors
    /// If the size is empty or does not fit `grey`.
    pub fn laplacian(grey: &[u8], width: usize, height: usize) -> Result<Self> {
        check_size("grey picture", width, height, grey.len())?;
        let source = |i: isize, n: usize| Border::Reflect.source(i, n).unwrap_or(0);
        let mut values = vec![0f32; grey.len()];
        parallel::for_each_chunk(&mut values, width, |y, values| {
            let row = |dy: isize| &grey[source(y as isize + dy, height) * width..][..width];
            let (above, here, below) = (row(-1), row(0), row(1));
            for (x, value) in values.iter_mut().enumerate() {
                let [left, right] = [-1, 1].map(|dx| i32::from(here[source(x as isize + dx, width)]));
                let vertical = i32::from(above[x]) + i32::from(below[x]);
                let laplacian = 4 * i32::from(here[x]) - left - right - vertical;
                *value = laplacian.abs() as f32 / (4.0 * 255.0);
            }
        });
        Ok(Self { width, height, values, weights: None })
    }

    /// Every pixel alike: importance 1, so that tau is the share of pixels chosen.
    ///
    /// # Errors
    /// If the size is empty.
    pub fn uniform(width: usize, height: usize) -> Result<Self> {
        let pixels = width.saturating_mul(height);
        check_size("importance map", width, height, pixels)?;
        Self::new(width, height, vec![1.0; pixels])
    }

    /// The same map with a weight per pixel, 0..1, that multiplies the probability: 0 where depth is missing,
    /// a confidence, a mask.
    ///
    /// # Errors
    /// If the buffer does not fit the map, or a weight is NaN or outside 0..1.
    pub fn with_weights(self, weights: Vec<f32>) -> Result<Self> {
        check_size("weights", self.width, self.height, weights.len())?;
        check_range("weight", &weights)?;
        Ok(Self { weights: Some(weights), ..self })
    }

    /// Pixels per row.
    #[must_use]
    pub fn width(&self) -> usize {
        self.width
    }

    /// Rows.
    #[must_use]
    pub fn height(&self) -> usize {
        self.height
    }

    /// Importance, `[height, width]`, 0..1.
    #[must_use]
    pub fn values(&self) -> &[f32] {
        &self.values
    }

    /// Weights, `[height, width]`, 0..1, if there are any.
    #[must_use]
    pub fn weights(&self) -> Option<&[f32]> {
        self.weights.as_deref()
    }

    /// Number of pixels of weight above 0.
    #[must_use]
    pub fn usable(&self) -> usize {
        self.weights().map_or(self.values.len(), |weights| weights.iter().filter(|&&w| w > 0.0).count())
    }

    /// Weight of a pixel; 1 where there are none.
    pub(crate) fn weight(&self, pixel: usize) -> f64 {
        self.weights.as_ref().map_or(1.0, |weights| f64::from(weights[pixel]))
    }
}

/// At least one pixel, few enough that an index fits 31 bits, and a buffer that fits.
pub(crate) fn check_size(what: &'static str, width: usize, height: usize, found: usize) -> Result<()> {
    let expected = width.saturating_mul(height);
    if expected == 0 || expected > 1 << 31 {
        return Err(Error::Size { width, height });
    }
    if found != expected {
        return Err(Error::Length { what, expected, found });
    }
    Ok(())
}

fn check_range(what: &'static str, values: &[f32]) -> Result<()> {
    match values.iter().position(|v| !(0.0..=1.0).contains(v)) {
        Some(pixel) => Err(Error::Range { what, pixel, found: values[pixel] }),
        None => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_laplacian_is_zero_on_a_slope_and_one_on_a_lone_pixel() {
        let slope: Vec<u8> = (0..35).map(|i| 10 * (i % 7) as u8).collect();
        let map = ImportanceMap::laplacian(&slope, 7, 5).unwrap();
        assert_eq!(map.values()[8..13], [0.0; 5]);
        assert!(map.values()[7] > 0.0, "a mirrored slope has a kink at the edge");
        let mut lone = [0u8; 9];
        lone[4] = 255;
        let map = ImportanceMap::laplacian(&lone, 3, 3).unwrap();
        assert_eq!(map.values()[4], 1.0);
        assert_eq!(ImportanceMap::laplacian(&[200], 1, 1).unwrap().values(), [0.0]);
    }

    #[test]
    fn bad_values_name_their_pixel() {
        let nan = ImportanceMap::new(2, 1, vec![0.5, f32::NAN]).unwrap_err();
        assert_eq!(nan.to_string(), "importance of pixel 1 is NaN, expected a number from 0 to 1");
        let map = ImportanceMap::uniform(2, 1).unwrap();
        let high = map.clone().with_weights(vec![1.5, 0.0]).unwrap_err();
        assert_eq!(high.to_string(), "weight of pixel 0 is 1.5, expected a number from 0 to 1");
        let short = map.with_weights(vec![1.0]).unwrap_err();
        assert_eq!(short.to_string(), "weights holds 1 numbers, expected 2");
        assert!(matches!(ImportanceMap::uniform(0, 3), Err(Error::Size { .. })));
        assert!(matches!(ImportanceMap::uniform(usize::MAX, 3), Err(Error::Size { .. })));
    }
}
