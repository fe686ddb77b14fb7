use crate::{Error, Result};

/// An RGB picture: `[height, width, 3]` f32, row-major, display-referred (sRGB-encoded) values, nominally 0..1.
/// Rendered pictures may leave that range; measuring and saving clips them.
#[derive(Debug, Clone, PartialEq)]
pub struct Image {
    width: usize,
    height: usize,
    data: Vec<f32>,
}

/// At least one pixel, and few enough that an index fits 31 bits.
pub(crate) fn check_size(width: usize, height: usize) -> Result<()> {
    let pixels = width.saturating_mul(height);
    if pixels == 0 || pixels > 1 << 31 {
        return Err(Error::Size { width, height });
    }
    Ok(())
}

impl Image {
    /// An image from `height * width * 3` interleaved values.
    ///
    /// # Errors
    /// If the size is empty or the buffer does not fit it.
    pub fn new(width: usize, height: usize, data: Vec<f32>) -> Result<Self> {
        check_size(width, height)?;
        let expected = width * height * 3;
        if data.len() != expected {
            return Err(Error::Length { what: "image", expected, found: data.len() });
        }
        Ok(Self { width, height, data })
    }

    /// An image of one colour.
    ///
    /// # Errors
    /// If the size is empty.
    pub fn filled(width: usize, height: usize, rgb: [f32; 3]) -> Result<Self> {
        check_size(width, height)?;
        Ok(Self { width, height, data: rgb.repeat(width * height) })
    }

    /// An image from interleaved 8-bit values, divided by 255.
    ///
    /// # Errors
    /// If the size is empty or the buffer does not fit it.
    pub fn from_rgb8(width: usize, height: usize, bytes: &[u8]) -> Result<Self> {
        Self::new(width, height, bytes.iter().map(|&b| f32::from(b) / 255.0).collect())
    }

    /// Interleaved 8-bit values: clipped to 0..1, times 255, rounded; NaN becomes 0.
    #[must_use]
    pub fn to_rgb8(&self) -> Vec<u8> {
        let round = |v: &f32| {
            let v = v.clamp(0.0, 1.0) * 255.0;
            // As `f32::round`, which without SSE4 is a call.
            let whole = v as u8;
            whole + u8::from(v - f32::from(whole) >= 0.5)
        };
        self.data.iter().map(round).collect()
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

    /// The interleaved values, `[height, width, 3]`.
    #[must_use]
    pub fn data(&self) -> &[f32] {
        &self.data
    }

    /// The interleaved values, `[height, width, 3]`, to change in place.
    pub fn data_mut(&mut self) -> &mut [f32] {
        &mut self.data
    }

    /// The pixel in column `x`, row `y`.
    ///
    /// # Panics
    /// If it lies outside the image.
    #[inline]
    #[must_use]
    pub fn pixel(&self, x: usize, y: usize) -> [f32; 3] {
        assert!(
            x < self.width && y < self.height,
            "pixel ({x}, {y}) is outside {}x{}",
            self.width,
            self.height
        );
        let i = (y * self.width + x) * 3;
        [self.data[i], self.data[i + 1], self.data[i + 2]]
    }

    /// The values `[height, width, 3]`, without a copy.
    #[must_use]
    pub fn into_data(self) -> Vec<f32> {
        self.data
    }

    /// Luma `[height, width]`, 0.299 R + 0.587 G + 0.114 B (BT.601), in the range of the image.
    #[must_use]
    pub fn luma(&self) -> Vec<f32> {
        self.data.chunks_exact(3).map(|p| 0.299 * p[0] + 0.587 * p[1] + 0.114 * p[2]).collect()
    }

    /// 8-bit luma `[height, width]`: the channels rounded to 8 bits, then
    /// (19595 R + 38470 G + 7471 B + 32768) >> 16, the integer BT.601 rule that Pillow's mode "L" uses.
    #[must_use]
    pub fn luma8(&self) -> Vec<u8> {
        let weigh = |&[r, g, b]: &[u8; 3]| {
            let [r, g, b] = [u32::from(r), u32::from(g), u32::from(b)];
            ((19595 * r + 38470 * g + 7471 * b + 32768) >> 16) as u8
        };
        self.to_rgb8().as_chunks().0.iter().map(weigh).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_are_rounded_as_f32_rounds() {
        let near_halves = (0..255).flat_map(|i| [-1, 0, 1].map(|step| ((i as f32 + 0.5) / 255.0, step)));
        let values = near_halves.map(|(v, step)| f32::from_bits(v.to_bits().wrapping_add_signed(step)));
        let values: Vec<f32> = values.chain([-1.0, -0.0, 2.0, f32::INFINITY, f32::NAN, 1.0]).collect();
        let expected: Vec<u8> = values.iter().map(|v| (v.clamp(0.0, 1.0) * 255.0).round() as u8).collect();
        let image = Image { width: values.len() / 3, height: 1, data: values };
        assert_eq!(image.to_rgb8(), expected);
    }

    #[test]
    fn sizes_are_checked() {
        assert!(matches!(Image::new(0, 5, vec![]), Err(Error::Size { .. })));
        assert!(matches!(Image::filled(usize::MAX, 2, [0.0; 3]), Err(Error::Size { .. })));
        let short = Image::new(2, 2, vec![0.0; 11]).unwrap_err();
        assert_eq!(short.to_string(), "image holds 11 numbers, expected 12");
    }

    #[test]
    fn eight_bits_survive_the_round_trip_and_bad_values_are_defined() {
        let bytes: Vec<u8> = (0..=255).chain(0..=255).chain(0..=255).collect();
        assert_eq!(Image::from_rgb8(256, 1, &bytes).unwrap().to_rgb8(), bytes);
        let odd = Image::new(1, 1, vec![f32::NAN, f32::INFINITY, -3.0]).unwrap();
        assert_eq!(odd.to_rgb8(), [0, 255, 0]);
    }

    #[test]
    fn luma_weighs_as_bt601() {
        let image = Image::from_rgb8(3, 1, &[255, 0, 0, 0, 255, 0, 0, 0, 255]).unwrap();
        assert_eq!(image.luma8(), [76, 150, 29]);
    }
}
