use crate::image::check_size;
use crate::{Error, Result};

/// z-depth per pixel: `[height, width]` f32 in scene units, along the camera's z axis (not along the ray).
/// 0 marks a pixel without a measurement; what is not finite or negative becomes 0 when the map is made.
#[derive(Debug, Clone, PartialEq)]
pub struct DepthMap {
    width: usize,
    height: usize,
    data: Vec<f32>,
}

impl DepthMap {
    /// A depth map from `height * width` values.
    ///
    /// # Errors
    /// If the size is empty or the buffer does not fit it.
    pub fn new(width: usize, height: usize, mut data: Vec<f32>) -> Result<Self> {
        check_size(width, height)?;
        if data.len() != width * height {
            return Err(Error::Length { what: "depth map", expected: width * height, found: data.len() });
        }
        for depth in &mut data {
            if !(depth.is_finite() && *depth > 0.0) {
                *depth = 0.0;
            }
        }
        Ok(Self { width, height, data })
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

    /// The depths, `[height, width]`; 0 = no measurement.
    #[must_use]
    pub fn data(&self) -> &[f32] {
        &self.data
    }

    /// Share of pixels with a measurement, 0..1.
    #[must_use]
    pub fn coverage(&self) -> f64 {
        self.data.iter().filter(|&&d| d > 0.0).count() as f64 / self.data.len() as f64
    }
}

/// Features per pixel: `[channels, height, width]` f32; may be coarser than the image it describes.
#[derive(Debug, Clone, PartialEq)]
pub struct FeatureMap {
    channels: usize,
    width: usize,
    height: usize,
    data: Vec<f32>,
    schema: String,
}

impl FeatureMap {
    /// A feature map from `channels * height * width` values.
    ///
    /// # Errors
    /// If the size is empty or the buffer does not fit it.
    pub fn new(channels: usize, width: usize, height: usize, data: Vec<f32>) -> Result<Self> {
        check_size(width, height)?;
        let expected = channels * width * height;
        if data.len() != expected {
            return Err(Error::Length { what: "feature map", expected, found: data.len() });
        }
        Ok(Self { channels, width, height, data, schema: String::new() })
    }

    /// The same map under the name of its schema: what its channels hold, and which code or weights made them. A head
    /// works with features of the schema that it was trained on.
    #[must_use]
    pub fn with_schema(self, schema: impl Into<String>) -> Self {
        Self { schema: schema.into(), ..self }
    }

    /// Name of the schema; empty if it was not said.
    #[must_use]
    pub fn schema(&self) -> &str {
        &self.schema
    }

    /// Number of channels.
    #[must_use]
    pub fn channels(&self) -> usize {
        self.channels
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

    /// The features, `[channels, height, width]`.
    #[must_use]
    pub fn data(&self) -> &[f32] {
        &self.data
    }

    /// One channel, `[height, width]`.
    ///
    /// # Panics
    /// If there is no such channel.
    #[must_use]
    pub fn channel(&self, channel: usize) -> &[f32] {
        let plane = self.width * self.height;
        &self.data[channel * plane..(channel + 1) * plane]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_no_depth_becomes_zero() {
        let map = DepthMap::new(5, 1, vec![1.5, f32::NAN, f32::INFINITY, -2.0, 0.0]).unwrap();
        assert_eq!(map.data(), [1.5, 0.0, 0.0, 0.0, 0.0]);
        assert!((map.coverage() - 0.2).abs() < 1e-12);
        assert!(DepthMap::new(2, 2, vec![1.0]).is_err());
    }

    #[test]
    fn channels_are_planes() {
        let map = FeatureMap::new(2, 2, 1, vec![1.0, 2.0, 3.0, 4.0]).unwrap();
        assert_eq!(map.channel(1), [3.0, 4.0]);
        assert!(FeatureMap::new(2, 2, 2, vec![0.0; 7]).is_err());
    }
}
