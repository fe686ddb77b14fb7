//! Views to what the network takes, and back.

use super::cost_volume::Bounds;
use super::layers::tensor;
use crate::{Error, Result};
use candle_core::{Device, Tensor};
use gs_scene::{Camera, DepthMap, FeatureMap, View};

/// Views padded to a size that the network can halve.
pub(super) struct Padded {
    /// `[views, h, w, 3]`.
    pub(super) images: Tensor,
    pub(super) cameras: Vec<Camera>,
    /// Size of the views.
    width: usize,
    height: usize,
}

impl Padded {
    /// Repeats the last column and row until both sides are multiples of `multiple`. What is added lies on the right
    /// and below, so that pixel positions and with them the intrinsics stay as they are.
    pub(super) fn new(views: &[View], multiple: usize, device: &Device) -> Result<Self> {
        let first = views.first().ok_or(Error::NoViews)?;
        let (width, height) = (first.image().width(), first.image().height());
        let (padded_width, padded_height) =
            (width.next_multiple_of(multiple), height.next_multiple_of(multiple));
        let mut values = Vec::with_capacity(views.len() * padded_height * padded_width * 3);
        let mut cameras = Vec::new();
        for view in views {
            let image = view.image();
            if (image.width(), image.height()) != (width, height) {
                return Err(Error::SizesDiffer {
                    view: view.name().to_owned(),
                    found: (image.width(), image.height()),
                    first: (width, height),
                });
            }
            for y in 0..padded_height {
                let row = &image.data()[y.min(height - 1) * width * 3..][..width * 3];
                values.extend_from_slice(row);
                let last = &row[(width - 1) * 3..];
                (width..padded_width).for_each(|_| values.extend_from_slice(last));
            }
            cameras.push(*view.camera());
        }
        let images = tensor(values, (views.len(), padded_height, padded_width, 3))?.to_device(device)?;
        Ok(Self { images, cameras, width, height })
    }

    /// The values of one view of `[views, h, w, channels]`, `[channels, height, width]` at the views' size.
    fn cropped(&self, maps: &Tensor, view: usize) -> Result<Vec<f32>> {
        let map = maps.get(view)?.narrow(0, 0, self.height)?.narrow(1, 0, self.width)?;
        Ok(map.permute((2, 0, 1))?.flatten_all()?.to_vec1()?)
    }

    /// Depth of one view, of which every pixel is known.
    pub(super) fn depth(&self, depth: &Tensor, view: (usize, &str)) -> Result<DepthMap> {
        let values = self.cropped(depth, view.0)?;
        if let Some(i) = values.iter().position(|v| !(v.is_finite() && *v > 0.0)) {
            let (x, y) = (i % self.width, i / self.width);
            return Err(Error::DepthNotFinite { view: view.1.to_owned(), x, y });
        }
        Ok(DepthMap::new(self.width, self.height, values)?)
    }

    /// Confidence of one view, from a map `factor` times smaller than the image.
    pub(super) fn confidence(&self, probability: &Tensor, factor: usize, view: usize) -> Result<Vec<f32>> {
        let map: Vec<Vec<f32>> = probability.get(view)?.squeeze(2)?.to_vec2()?;
        let pixel = |i: usize| map[i / self.width / factor][i % self.width / factor].clamp(0.0, 1.0);
        Ok((0..self.height * self.width).map(pixel).collect())
    }

    /// Features of one view.
    pub(super) fn features(&self, features: &Tensor, view: usize) -> Result<FeatureMap> {
        let (_, _, _, channels) = features.dims4()?;
        Ok(FeatureMap::new(channels, self.width, self.height, self.cropped(features, view)?)?)
    }
}

/// Inverse depths between a near and a far plane.
pub(super) fn bounds(near: f64, far: f64) -> Result<Bounds> {
    let (low, high) = ((1.0 / far as f32), (1.0 / near as f32));
    if near > 0.0 && near < far && far.is_finite() && low > 0.0 && high.is_finite() && low < high {
        Ok(Bounds { low, high })
    } else {
        Err(Error::Range { near, far })
    }
}
