//! Image features F: those of a network, or the bank of the backbones without one.

mod bank;

use crate::{Error, Result, ViewGeometry};
use bank::Bank;
use gs_scene::{FeatureMap, View};
use std::borrow::Cow;

/// What each channel of the bank holds, in order; all are near 0..1 or -1..1.
pub const FEATURE_NAMES: [&str; 32] = [
    "red",
    "green",
    "blue",
    "red, mean of 3x3",
    "green, mean of 3x3",
    "blue, mean of 3x3",
    "red, mean of 7x7",
    "green, mean of 7x7",
    "blue, mean of 7x7",
    "red, mean of 15x15",
    "green, mean of 15x15",
    "blue, mean of 15x15",
    "luma, deviation of 3x3",
    "luma, deviation of 7x7",
    "luma, deviation of 15x15",
    "red minus mean of 7x7",
    "green minus mean of 7x7",
    "blue minus mean of 7x7",
    "luma, gradient to the right",
    "luma, gradient downwards",
    "luma, gradient to the right, of the 7x7 means",
    "luma, gradient downwards, of the 7x7 means",
    "luma, Laplacian",
    "luma, Laplacian of the 7x7 means",
    "logarithm of depth over the view's median depth",
    "relative change of depth to the right, times 10",
    "relative change of depth downwards, times 10",
    "relative deviation of inverse depth in 7x7, times 10",
    "confidence",
    "matching cost",
    "column, -1 left to 1 right",
    "row, -1 top to 1 bottom",
];

/// Image features F of one view.
#[derive(Debug, Clone, PartialEq)]
pub enum Features {
    /// As a network computed them, `[C, h, w]`.
    Map(FeatureMap),
    /// The bank of [`FEATURE_NAMES`]. It follows from the photograph and its geometry, and is computed for the pixels that need it: 128
    /// bytes each.
    Bank {
        /// Whose geometry it is of, as [`FeatureMap::schema`].
        schema: String,
        /// Matching cost at each pixel, 0..1, `[height, width]`.
        cost: Vec<f32>,
    },
}

impl Features {
    /// Number of channels.
    #[must_use]
    pub fn channels(&self) -> usize {
        match self {
            Self::Map(map) => map.channels(),
            Self::Bank { .. } => FEATURE_NAMES.len(),
        }
    }

    /// What they are, as [`FeatureMap::schema`].
    #[must_use]
    pub fn schema(&self) -> &str {
        match self {
            Self::Map(map) => map.schema(),
            Self::Bank { schema, .. } => schema,
        }
    }
}

impl ViewGeometry {
    /// The features of `view`, which is the view that this geometry was found in, as a map `[C, h, w]`; none if none were wanted.
    ///
    /// # Errors
    /// If the view has another size.
    pub fn feature_map(&self, view: &View) -> Result<Option<Cow<'_, FeatureMap>>> {
        match &self.features {
            None => Ok(None),
            Some(Features::Map(map)) => Ok(Some(Cow::Borrowed(map))),
            Some(Features::Bank { schema, cost }) => {
                let bank = self.bank(view, cost)?;
                let (width, height) = (self.depth.width(), self.depth.height());
                let pixels: Vec<u32> = (0..(width * height) as u32).collect();
                let rows = bank.at(&pixels);
                let channel =
                    |channel: usize| rows.iter().skip(channel).step_by(FEATURE_NAMES.len()).copied();
                let data = (0..FEATURE_NAMES.len()).flat_map(channel).collect();
                let map = FeatureMap::new(FEATURE_NAMES.len(), width, height, data)?;
                Ok(Some(Cow::Owned(map.with_schema(schema.clone()))))
            }
        }
    }

    /// The bank of `view` at some pixels (row-major indices), `[pixels, FEATURE_NAMES]`; none if the features are a network's, or none were
    /// wanted.
    ///
    /// # Errors
    /// If the view has another size.
    ///
    /// # Panics
    /// If a pixel lies outside.
    pub fn bank_at(&self, view: &View, pixels: &[u32]) -> Result<Option<Vec<f32>>> {
        match &self.features {
            None | Some(Features::Map(_)) => Ok(None),
            Some(Features::Bank { cost, .. }) => Ok(Some(self.bank(view, cost)?.at(pixels))),
        }
    }

    fn bank<'a>(&'a self, view: &'a View, cost: &'a [f32]) -> Result<Bank<'a>> {
        let (image, depth) = (view.image(), &self.depth);
        if (image.width(), image.height()) != (depth.width(), depth.height()) {
            // A view's picture and depth have one size: the error names both.
            View::new(view.name(), view.image().clone(), *view.camera(), Some(self.depth.clone()))?;
        }
        Bank::new(view, &self.depth, &self.confidence, cost)
    }

    /// That the features follow the view's colours: those of a network would have to be asked for again.
    ///
    /// # Errors
    /// If the features are a network's.
    pub fn follows_colours(&self) -> Result<()> {
        match &self.features {
            Some(Features::Map(map)) => Err(Error::NetworkFeatures { schema: map.schema().to_owned() }),
            Some(Features::Bank { .. }) | None => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::{DMat3, DVec3};
    use gs_scene::{Camera, DepthMap, Image, Intrinsics};

    fn view(width: usize, height: usize, data: Vec<f32>) -> View {
        let lens = Intrinsics { fx: 9.0, fy: 9.0, cx: 3.0, cy: 2.0, width, height };
        let camera = Camera::new(lens, DMat3::IDENTITY, DVec3::ZERO).unwrap();
        View::new("v", Image::new(width, height, data).unwrap(), camera, None).unwrap()
    }

    fn geometry(depth: DepthMap, confidence: &[f32], cost: f32) -> ViewGeometry {
        let features = Some(Features::Bank { schema: "s".to_owned(), cost: vec![cost; confidence.len()] });
        ViewGeometry { depth, confidence: confidence.to_vec(), features, gaussians: None }
    }

    #[test]
    fn a_flat_picture_at_one_depth_has_no_contrast() {
        let geometry = geometry(DepthMap::new(6, 4, vec![2.0; 24]).unwrap(), &[1.0; 24], 0.3);
        let view = view(6, 4, vec![0.4; 72]);
        let map = geometry.feature_map(&view).unwrap().unwrap();
        assert_eq!(map.channels(), FEATURE_NAMES.len());
        for (channel, name) in FEATURE_NAMES.iter().enumerate().skip(12).take(16) {
            assert!(map.channel(channel).iter().all(|v| v.abs() < 1e-5), "{name}");
        }
        assert!(map.channel(4).iter().all(|v| (v - 0.4).abs() < 1e-6));
        assert_eq!((map.channel(28)[0], map.channel(29)[0]), (1.0, 0.3));
        assert_eq!((FEATURE_NAMES[28], FEATURE_NAMES[29]), ("confidence", "matching cost"));
    }

    #[test]
    fn a_bank_is_computed_of_the_view_that_is_shown_and_a_networks_map_is_its_own() {
        let data = |gain: f32| (0..72).map(|i| gain * (i as f32 * 0.7).sin().abs()).collect();
        let depth = DepthMap::new(6, 4, (1..25).map(|i| i as f32).collect()).unwrap();
        let confidence: Vec<f32> = (0..24).map(|i| i as f32 / 24.0).collect();
        let geometry = geometry(depth, &confidence, 0.3);
        let feature_map = |view: &View| geometry.feature_map(view).unwrap().unwrap().into_owned();
        let (dark, bright) = (view(6, 4, data(0.5)), view(6, 4, data(1.0)));
        let some = [17, 3, 3, 20];
        let found = geometry.bank_at(&dark, &some).unwrap().unwrap();
        let dense = feature_map(&dark);
        let expected = some.iter().flat_map(|&pixel| (0..32).map(move |channel| (channel, pixel as usize)));
        assert!(found.iter().eq(expected.map(|(channel, pixel)| &dense.channel(channel)[pixel])));
        assert_ne!(feature_map(&dark).data(), feature_map(&bright).data());
        assert_eq!(geometry.features.as_ref().map(|f| (f.channels(), f.schema())), Some((32, "s")));
        assert!(geometry.feature_map(&view(4, 6, data(1.0))).is_err());
        let short = ViewGeometry { confidence: vec![1.0; 23], ..geometry.clone() };
        assert!(short.feature_map(&bright).unwrap_err().to_string().contains("confidence"));
        geometry.follows_colours().unwrap();

        let network = feature_map(&dark).with_schema("a network's");
        let geometry = ViewGeometry { features: Some(Features::Map(network.clone())), ..geometry };
        assert_eq!(geometry.feature_map(&bright).unwrap().as_deref(), Some(&network));
        assert!(geometry.bank_at(&bright, &some).unwrap().is_none());
        let error = geometry.follows_colours().unwrap_err();
        assert!(matches!(&error, Error::NetworkFeatures { schema } if schema == "a network's"), "{error}");
        let without = ViewGeometry { features: None, ..geometry };
        assert!(without.feature_map(&bright).unwrap().is_none());
        without.follows_colours().unwrap();
    }

    #[test]
    fn a_ramp_has_its_slope_and_missing_depth_is_finite() {
        let data = (0..24).flat_map(|i| [(i % 6) as f32 * 0.1; 3]).collect();
        let geometry = geometry(DepthMap::new(6, 4, vec![0.0; 24]).unwrap(), &[0.0; 24], 1.0);
        let view = view(6, 4, data);
        let map = geometry.feature_map(&view).unwrap().unwrap();
        assert!((map.channel(18)[8] - 0.1).abs() < 1e-6);
        assert!(map.data().iter().all(|v| v.is_finite()));
        assert!((map.channel(30)[0] + 5.0 / 6.0).abs() < 1e-6);
    }
}
