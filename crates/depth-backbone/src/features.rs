//! The feature bank F of the backbones without a network: 32 channels at the picture's size, all near 0..1 or -1..1.

use crate::{Error, Result, ViewGeometry};
use gs_scene::{DepthMap, FeatureMap, View};
use rayon::prelude::*;
use std::borrow::Cow;

/// Half the windows of the local means and deviations: 3×3, 7×7 and 15×15 pixels.
const RADII: [usize; 3] = [1, 3, 7];

/// What each channel holds, in order.
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

/// Means over square windows, cut at the border: a plane `[height, width]` to the same, in `means`.
fn box_mean(plane: &[f32], width: usize, radius: usize, means: &mut [f32]) {
    let height = plane.len() / width;
    let window = |i: usize, n: usize| (i.saturating_sub(radius), (i + radius + 1).min(n));
    // Prefix sums in f64: windows at the far end lose nothing.
    let mut sums = vec![0.0_f64; width + 1];
    for (row, means) in plane.chunks_exact(width).zip(means.chunks_exact_mut(width)) {
        let mut sum = 0.0;
        for (next, value) in sums[1..].iter_mut().zip(row) {
            sum += f64::from(*value);
            *next = sum;
        }
        for (x, mean) in means.iter_mut().enumerate() {
            let (from, to) = window(x, width);
            *mean = ((sums[to] - sums[from]) / (to - from) as f64) as f32;
        }
    }
    // The same down the columns, all of a row together.
    let mut sums = vec![0.0_f64; (height + 1) * width];
    for (y, row) in means.chunks_exact(width).enumerate() {
        let (before, next) = sums[y * width..].split_at_mut(width);
        for ((next, before), mean) in next.iter_mut().zip(before).zip(row) {
            *next = *before + f64::from(*mean);
        }
    }
    for (y, row) in means.chunks_exact_mut(width).enumerate() {
        let (from, to) = window(y, height);
        let count = (to - from) as f64;
        let sums = sums[to * width..][..width].iter().zip(&sums[from * width..]);
        for (mean, (to, from)) in row.iter_mut().zip(sums) {
            *mean = ((to - from) / count) as f32;
        }
    }
}

/// Deviation in square windows.
fn box_deviation(plane: &[f32], width: usize, radius: usize, deviations: &mut [f32]) {
    let squares: Vec<f32> = plane.iter().map(|v| v * v).collect();
    let mut mean_squares = vec![0.0; plane.len()];
    box_mean(&squares, width, radius, &mut mean_squares);
    box_mean(plane, width, radius, deviations);
    for (mean, square) in deviations.iter_mut().zip(mean_squares) {
        *mean = (square - *mean * *mean).max(0.0).sqrt();
    }
}

/// Applies `stencil(left, right, up, down, centre)` with the border repeated.
fn neighbourhood(plane: &[f32], width: usize, stencil: impl Fn([f32; 4], f32) -> f32, found: &mut [f32]) {
    let last = plane.len() / width - 1;
    for (y, found) in found.chunks_exact_mut(width).enumerate() {
        let row = |y: usize| &plane[y * width..][..width];
        let (up, centre, down) = (row(y.saturating_sub(1)), row(y), row((y + 1).min(last)));
        for (x, found) in found.iter_mut().enumerate() {
            let (left, right) = (centre[x.saturating_sub(1)], centre[(x + 1).min(width - 1)]);
            *found = stencil([left, right, up[x], down[x]], centre[x]);
        }
    }
}

fn horizontal([left, right, _, _]: [f32; 4], _: f32) -> f32 {
    0.5 * (right - left)
}

fn vertical([_, _, up, down]: [f32; 4], _: f32) -> f32 {
    0.5 * (down - up)
}

fn laplacian([left, right, up, down]: [f32; 4], centre: f32) -> f32 {
    0.25 * (left + right + up + down) - centre
}

/// The bank of one view: the channels of [`FEATURE_NAMES`], `[32, height, width]`. `cost` is the matching cost per
/// pixel, 0..1. Where depth is missing its channels are 0.
pub(crate) fn bank(view: &View, depth: &DepthMap, confidence: &[f32], cost: &[f32]) -> Result<FeatureMap> {
    let (width, height) = (depth.width(), depth.height());
    let luma = view.image().luma();
    for (what, found) in [("confidence", confidence.len()), ("matching cost", cost.len())] {
        if found != luma.len() {
            return Err(gs_scene::Error::Length { what, expected: luma.len(), found }.into());
        }
    }
    let mut smooth_luma = vec![0.0; luma.len()];
    box_mean(&luma, width, RADII[1], &mut smooth_luma);

    let mut known: Vec<f32> = depth.data().iter().copied().filter(|&d| d > 0.0).collect();
    let middle = known.len() / 2;
    let median = if known.is_empty() { 1.0 } else { *known.select_nth_unstable_by(middle, f32::total_cmp).1 };
    let relative: Vec<f32> = depth.data().iter().map(|&d| if d > 0.0 { median / d } else { 0.0 }).collect();
    let log_depth = |d: f32| if d > 0.0 { (d / median).ln() } else { 0.0 };
    let centred = |i: usize, n: usize| (2 * i + 1) as f32 / n as f32 - 1.0;

    // Every channel is written to its place.
    let pixels = luma.len();
    let mut data = vec![0.0; FEATURE_NAMES.len() * pixels];
    let (colour, rest) = data.split_at_mut(3 * pixels);
    let (means, rest) = rest.split_at_mut(3 * RADII.len() * pixels);
    for (channel, plane) in colour.chunks_exact_mut(pixels).enumerate() {
        let values = view.image().data().iter().skip(channel).step_by(3);
        plane.iter_mut().zip(values).for_each(|(plane, value)| *plane = *value);
    }
    let of_radii = means.par_chunks_exact_mut(3 * pixels).zip(RADII);
    of_radii.for_each(|(means, radius)| {
        let channels = means.par_chunks_exact_mut(pixels).zip(colour.par_chunks_exact(pixels));
        channels.for_each(|(mean, channel)| box_mean(channel, width, radius, mean));
    });
    let mut rest = rest.chunks_exact_mut(pixels);
    let mut next = || rest.next().expect("a channel for each name");
    RADII.into_iter().for_each(|radius| box_deviation(&luma, width, radius, next()));
    let means_of_seven = means[3 * pixels..].chunks_exact(pixels);
    for (channel, mean) in colour.chunks_exact(pixels).zip(means_of_seven) {
        let values = channel.iter().zip(mean);
        next().iter_mut().zip(values).for_each(|(plane, (value, mean))| *plane = value - mean);
    }
    neighbourhood(&luma, width, horizontal, next());
    neighbourhood(&luma, width, vertical, next());
    neighbourhood(&smooth_luma, width, horizontal, next());
    neighbourhood(&smooth_luma, width, vertical, next());
    neighbourhood(&luma, width, laplacian, next());
    neighbourhood(&smooth_luma, width, laplacian, next());
    let logarithm = next();
    logarithm.iter_mut().zip(depth.data()).for_each(|(plane, depth)| *plane = log_depth(*depth));
    neighbourhood(logarithm, width, |around, centre| 10.0 * horizontal(around, centre), next());
    neighbourhood(logarithm, width, |around, centre| 10.0 * vertical(around, centre), next());
    let deviation = next();
    box_deviation(&relative, width, RADII[1], deviation);
    deviation.iter_mut().for_each(|value| *value *= 10.0);
    next().copy_from_slice(confidence);
    next().copy_from_slice(cost);
    next().iter_mut().enumerate().for_each(|(i, value)| *value = centred(i % width, width));
    next().iter_mut().enumerate().for_each(|(i, value)| *value = centred(i / width, height));
    Ok(FeatureMap::new(FEATURE_NAMES.len(), width, height, data)?)
}

/// Image features F of one view.
#[derive(Debug, Clone, PartialEq)]
pub enum Features {
    /// As a network computed them, `[C, h, w]`.
    Map(FeatureMap),
    /// The bank of [`FEATURE_NAMES`]. It follows from the photograph and its geometry, and is computed where it is needed: 128 bytes
    /// per pixel are held no longer than that.
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
                let (image, depth) = (view.image(), &self.depth);
                if (image.width(), image.height()) != (depth.width(), depth.height()) {
                    // A view's picture and depth have one size: the error names both.
                    View::new(view.name(), view.image().clone(), *view.camera(), Some(self.depth.clone()))?;
                }
                let map = bank(view, &self.depth, &self.confidence, cost)?;
                Ok(Some(Cow::Owned(map.with_schema(schema.clone()))))
            }
        }
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
    use gs_scene::{Camera, Image, Intrinsics};
    use proptest::prelude::*;

    fn view(width: usize, height: usize, data: Vec<f32>) -> View {
        let lens = Intrinsics { fx: 9.0, fy: 9.0, cx: 3.0, cy: 2.0, width, height };
        let camera = Camera::new(lens, DMat3::IDENTITY, DVec3::ZERO).unwrap();
        View::new("v", Image::new(width, height, data).unwrap(), camera, None).unwrap()
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(32))]
        #[test]
        fn box_mean_equals_the_plain_sum(width in 1usize..12, height in 1usize..9, radius in 0usize..6, seed: u32) {
            let plane: Vec<f32> =
                (0..width * height).map(|i| (seed.wrapping_mul(2_654_435_761).wrapping_add(i as u32 * 977) >> 8) as f32 / 1e7).collect();
            let mut means = vec![f32::NAN; plane.len()];
            box_mean(&plane, width, radius, &mut means);
            for (i, mean) in means.iter().enumerate() {
                let (x, y) = (i % width, i / width);
                let inside: Vec<f32> = (0..plane.len())
                    .filter(|j| (j % width).abs_diff(x) <= radius && (j / width).abs_diff(y) <= radius)
                    .map(|j| plane[j])
                    .collect();
                prop_assert!((mean - inside.iter().sum::<f32>() / inside.len() as f32).abs() < 1e-5);
            }
        }
    }

    #[test]
    fn a_flat_picture_at_one_depth_has_no_contrast() {
        let map = bank(
            &view(6, 4, vec![0.4; 72]),
            &DepthMap::new(6, 4, vec![2.0; 24]).unwrap(),
            &[1.0; 24],
            &[0.3; 24],
        )
        .unwrap();
        assert_eq!(map.channels(), FEATURE_NAMES.len());
        for (channel, name) in FEATURE_NAMES.iter().enumerate().skip(12).take(16) {
            assert!(map.channel(channel).iter().all(|v| v.abs() < 2e-3), "{name}");
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
        let features = Some(Features::Bank { schema: "s".to_owned(), cost: vec![0.3; 24] });
        let geometry = ViewGeometry { depth, confidence, features, gaussians: None };
        let of = |view: &View| geometry.feature_map(view).unwrap().unwrap().into_owned();
        let (dark, bright) = (view(6, 4, data(0.5)), view(6, 4, data(1.0)));
        let expected = bank(&dark, &geometry.depth, &geometry.confidence, &[0.3; 24]).unwrap();
        assert_eq!(of(&dark), expected.with_schema("s"));
        assert_ne!(of(&dark).data(), of(&bright).data());
        assert_eq!(geometry.features.as_ref().map(|f| (f.channels(), f.schema())), Some((32, "s")));
        assert!(geometry.feature_map(&view(4, 6, data(1.0))).is_err());
        let short = ViewGeometry { confidence: vec![1.0; 23], ..geometry.clone() };
        assert!(short.feature_map(&bright).unwrap_err().to_string().contains("confidence"));
        geometry.follows_colours().unwrap();

        let network = of(&dark).with_schema("a network's");
        let geometry = ViewGeometry { features: Some(Features::Map(network.clone())), ..geometry };
        assert_eq!(geometry.feature_map(&bright).unwrap().as_deref(), Some(&network));
        let error = geometry.follows_colours().unwrap_err();
        assert!(matches!(&error, Error::NetworkFeatures { schema } if schema == "a network's"), "{error}");
        let without = ViewGeometry { features: None, ..geometry };
        assert!(without.feature_map(&bright).unwrap().is_none());
        without.follows_colours().unwrap();
    }

    #[test]
    fn a_ramp_has_its_slope_and_missing_depth_is_finite() {
        let data = (0..24).flat_map(|i| [(i % 6) as f32 * 0.1; 3]).collect();
        let map =
            bank(&view(6, 4, data), &DepthMap::new(6, 4, vec![0.0; 24]).unwrap(), &[0.0; 24], &[1.0; 24])
                .unwrap();
        assert!((map.channel(18)[8] - 0.1).abs() < 1e-6);
        assert!(map.data().iter().all(|v| v.is_finite()));
        assert!((map.channel(30)[0] + 5.0 / 6.0).abs() < 1e-6);
    }
}
