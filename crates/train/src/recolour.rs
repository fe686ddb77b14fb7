//! Augmentation by other colours. Generated scenes have warm and even light; photographs are neutral in the mean, and reach from nearly black to nearly
//! white. A head that has seen one kind of light only learns its mean and contrast.

use crate::draw::{Stream, bits, unit};
use crate::{Case, Result};
use gs_scene::View;
use sparsesplat::ViewGeometry;

/// Contrast: factor of the logits about their mean.
const CONTRAST: [f64; 2] = [0.8, 1.8];
/// Brightness: added to all logits.
const BRIGHTNESS: [f64; 2] = [-0.7, 1.1];
/// Largest cast of a channel: added to its logits.
const CAST: f64 = 0.35;
/// Colours nearer to 0 or 1 than half a step of 8 bits count as that near: their logits would be infinite.
const NEAREST: f64 = 1.0 / 512.0;
/// Orders of the channels.
const ORDERS: [[usize; 3]; 6] = [[0, 1, 2], [0, 2, 1], [1, 0, 2], [1, 2, 0], [2, 0, 1], [2, 1, 0]];

/// Colours to other colours: one curve per channel, steep in the middle as that of a camera, so that what was between 0 and 1 stays there.
struct Recolouring {
    order: [usize; 3],
    slope: f64,
    offsets: [f64; 3],
}

fn logit(value: f32) -> f64 {
    let value = f64::from(value).clamp(NEAREST, 1.0 - NEAREST);
    (value / (1.0 - value)).ln()
}

impl Recolouring {
    fn drawn(views: &[View], seed: u64) -> Self {
        let draw = |what, [low, high]: [f64; 2]| low + (high - low) * unit(seed, Stream::Colours, what);
        let slope = draw(0, CONTRAST.map(f64::ln)).exp();
        let pixels: usize = views.iter().map(|view| view.image().data().len()).sum();
        let sum: f64 = views.iter().flat_map(|view| view.image().data()).map(|&v| logit(v)).sum();
        let offset = (1.0 - slope) * sum / pixels as f64 + draw(1, BRIGHTNESS);
        Self {
            order: ORDERS[(bits(seed, Stream::Colours, 2) % 6) as usize],
            slope,
            offsets: std::array::from_fn(|channel| offset + draw(3 + channel, [-CAST, CAST])),
        }
    }

    fn of(&self, rgb: [f32; 3]) -> [f32; 3] {
        std::array::from_fn(|channel| {
            let logit = self.slope * logit(rgb[self.order[channel]]) + self.offsets[channel];
            (1.0 / (1.0 + (-logit).exp())) as f32
        })
    }

    fn apply(&self, view: &mut View) {
        for rgb in view.image_mut().data_mut().as_chunks_mut::<3>().0 {
            *rgb = self.of(*rgb);
        }
    }
}

/// A share of the windows in other colours, all views of one in the same; their features follow.
pub(crate) fn recoloured(mut case: Case, share: f64, seed: u64) -> Result<Case> {
    if unit(seed, Stream::Colours, 6) >= share {
        return Ok(case);
    }
    let recolouring = Recolouring::drawn(&case.context, seed);
    case.geometry
        .views
        .iter()
        .try_for_each(ViewGeometry::follows_colours)
        .map_err(sparsesplat::Error::from)?;
    case.context.iter_mut().chain(&mut case.targets).for_each(|view| recolouring.apply(view));
    Ok(case)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Error;
    use glam::{DMat3, DVec3};
    use gs_scene::{Camera, Image, Intrinsics};
    use sparsesplat::{Backbone, Config, Features, Predictor, Wanted};

    fn view(x: f64, data: Vec<f32>) -> View {
        let lens = Intrinsics { fx: 9.0, fy: 9.0, cx: 4.0, cy: 3.0, width: 8, height: 6 };
        let camera = Camera::new(lens, DMat3::IDENTITY, DVec3::new(x, 0.0, 0.0)).unwrap();
        let depth = gs_scene::DepthMap::new(8, 6, vec![2.0; 48]).unwrap();
        View::new("v", Image::new(8, 6, data).unwrap(), camera, Some(depth)).unwrap()
    }

    /// Two context views and a held-out one, all with the same picture: from black to white.
    fn case() -> Case {
        let picture = |x| view(x, (0..144).map(|i| (i * 37 % 144) as f32 / 143.0).collect());
        let context = vec![picture(0.0), picture(0.1)];
        let config = Config { backbone: Backbone::GivenDepth, ..Config::default() };
        let predictor = Predictor::new(config).unwrap();
        let geometry = predictor.geometry_with(&context, Wanted::DepthAndFeatures).unwrap();
        Case { name: "c".to_owned(), context, targets: vec![picture(0.2)], geometry, photographs: false }
    }

    #[test]
    fn a_share_of_the_windows_changes_and_all_views_of_one_change_alike() {
        let before = case();
        let mut changed = 0;
        for seed in 0..200 {
            let after = recoloured(case(), 0.3, seed).unwrap();
            let colours = after.context[0].image().data();
            changed += usize::from(colours != before.context[0].image().data());
            assert_eq!(colours, after.context[1].image().data());
            assert_eq!(colours, after.targets[0].image().data());
            let red: Vec<f32> = colours.iter().step_by(3).copied().collect();
            let features = after.geometry.views[1].feature_map(&after.context[1]).unwrap().unwrap();
            assert_eq!(features.channel(0), red);
            let again = recoloured(case(), 0.3, seed).unwrap();
            assert_eq!(colours, again.context[0].image().data());
        }
        assert!((40..80).contains(&changed), "{changed}");
        let same = recoloured(case(), 0.0, 3).unwrap();
        assert_eq!(same.targets[0].image().data(), before.targets[0].image().data());
    }

    #[test]
    fn what_changes_nothing_changes_nothing() {
        let identity = Recolouring { order: [0, 1, 2], slope: 1.0, offsets: [0.0; 3] };
        for rgb in [[0.01, 0.5, 0.99], [0.3, 0.7, 0.004]] {
            let after = identity.of(rgb);
            assert!(rgb.iter().zip(after).all(|(a, b)| (a - b).abs() < 1e-6), "{rgb:?} {after:?}");
        }
    }

    #[test]
    fn features_of_a_network_are_refused() {
        let mut case = case();
        for (geometry, view) in case.geometry.views.iter_mut().zip(&case.context) {
            let map = geometry.feature_map(view).unwrap().unwrap().into_owned();
            geometry.features = Some(Features::Map(map));
        }
        assert!(matches!(recoloured(case, 1.0, 0), Err(Error::Predict(_))));
    }

    #[test]
    fn curves_rise_and_stay_between_black_and_white() {
        let context = case().context;
        for seed in 0..200 {
            let recolouring = Recolouring::drawn(&context, seed);
            let curves: Vec<[f32; 3]> = (0..=255).map(|i| recolouring.of([i as f32 / 255.0; 3])).collect();
            for (low, high) in curves.iter().zip(&curves[1..]) {
                assert!(
                    (0..3).all(|c| 0.0 < low[c] && low[c] < high[c] && high[c] < 1.0),
                    "{low:?} {high:?}"
                );
            }
        }
    }
}
