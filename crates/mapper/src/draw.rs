//! New Gaussians of the pixels that the map does not show.

use crate::map::mean;
use crate::{Config, Error, Result};
use depth_backbone::ViewGeometry;
use entropy_sampler::{EntropyWindow, ImportanceMap, Probability};
use gs_scene::{Camera, DepthMap, Gaussians, LOG_SCALE, View};
use sparsesplat::{Backbone, Budget, Exposure, Geometry, Head, Predictor};

/// Open pixels per Gaussian at the most: walls of one colour have no entropy, and are to be shown too.
const PIXELS: usize = 400;
/// z-depth of the backdrop over the farthest that was measured: in front of that it would hide what lies there.
const BEHIND: f64 = 1.6;
/// Largest standard deviation of a Gaussian over its z-depth. Along a wall that is seen at a grazing angle a larger one reaches to where the
/// camera goes next, and stands before what is there.
pub(crate) const LARGEST: f64 = 0.1;
/// Confidence of the backdrop: below that of anything measured.
const UNMEASURED: f32 = 0.1;

/// The closed form of pixels that are drawn by entropy where `open` is true, `most` at the most.
///
/// Pixels are closed by taking away their confidence: neither are they drawn, nor does a drawn pixel stand for them.
pub(crate) fn draw(
    view: &View,
    mut geometry: ViewGeometry,
    range: (f64, f64),
    open: &[bool],
    config: &Config,
    most: usize,
) -> Result<Gaussians> {
    let failed = |source: sparsesplat::Error| Error::Predict { frame: view.name().to_owned(), source };
    for (confidence, _) in geometry.confidence.iter_mut().zip(open).filter(|(_, open)| !**open) {
        *confidence = 0.0;
    }
    let depths = geometry.depth.data().iter().zip(&geometry.confidence);
    let weights: Vec<f32> =
        depths.map(|(&depth, &confidence)| f32::from(u8::from(depth > 0.0 && confidence > 0.0))).collect();
    let usable = weights.iter().filter(|weight| **weight > 0.0).count();
    if usable == 0 || most == 0 {
        return Ok(Gaussians::empty(0)?);
    }
    let (width, height) = (view.image().width(), view.image().height());
    let expected = || {
        let map = ImportanceMap::entropy(&view.image().luma8(), width, height, EntropyWindow::default())?;
        Ok::<_, entropy_sampler::Error>(
            Probability::from_tau(config.tau)?.expected(&[map.with_weights(weights)?]),
        )
    };
    let expected = expected().map_err(|source| failed(source.into()))?.round() as usize;
    let count = expected.max(usable.div_ceil(PIXELS)).min(most);
    let pass = sparsesplat::Config {
        backbone: Backbone::GivenDepth,
        budget: Budget::Gaussians(count),
        // `expected` counts by the entropy alone.
        smooth_weight: 1.0,
        head: Head::ClosedForm,
        looks: 1,
        far_shell: false,
        exposure: Exposure::Common,
        seed: config.seed,
        ..sparsesplat::Config::default()
    };
    let geometry = Geometry { views: vec![geometry], depth_range: range, shared_by: Vec::new() };
    let predicted = Predictor::new(pass)
        .and_then(|predictor| predictor.predict_from(std::slice::from_ref(view), &geometry, &mut |_| {}));
    let mut gaussians = predicted.map_err(failed)?.gaussians;
    limit_scales(&mut gaussians, view.camera());
    Ok(gaussians)
}

/// Makes Gaussians narrower that are larger than [`LARGEST`] in the camera that they come from.
fn limit_scales(gaussians: &mut Gaussians, camera: &Camera) {
    for row in gaussians.buffers_mut().0.chunks_exact_mut(Gaussians::GEOMETRY) {
        let z = camera.to_camera(mean(row)).z;
        // Far from the origin, where f32 has gaps, what is near may lie in the camera's plane or behind it.
        if z > 0.0 {
            let most = (LARGEST * z).ln() as f32;
            row[LOG_SCALE].iter_mut().for_each(|scale| *scale = scale.min(most));
        }
    }
}

/// A backdrop for open pixels without depth, behind all that the keyframe measured: what lies there is too far, too near or too dark to
/// be measured. What later keyframes measure in front of it hides it.
pub(crate) fn backdrop(
    view: &View,
    geometry: &ViewGeometry,
    range: (f64, f64),
    open: &[bool],
    config: &Config,
    most: usize,
) -> Result<Gaussians> {
    let (width, height) = (geometry.depth.width(), geometry.depth.height());
    let depth = vec![(range.1 * BEHIND) as f32; width * height];
    let confidence: Vec<f32> =
        geometry.depth.data().iter().map(|&depth| if depth > 0.0 { 0.0 } else { UNMEASURED }).collect();
    let depth = DepthMap::new(width, height, depth)?;
    let flat = ViewGeometry { depth, confidence, features: None, gaussians: None };
    draw(view, flat, range, open, config, most)
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::{DMat3, DVec3};
    use gs_scene::Intrinsics;

    #[test]
    fn none_is_wider_than_a_tenth_of_its_depth_and_what_lies_behind_stays() {
        let lens = Intrinsics { fx: 30.0, fy: 30.0, cx: 10.0, cy: 8.0, width: 20, height: 16 };
        let camera = Camera::new(lens, DMat3::IDENTITY, DVec3::ZERO).unwrap();
        let depths = [2.0, 0.0, -1.0, f32::NAN, 1e4];
        let mut gaussians = Gaussians::empty(0).unwrap();
        for z in depths {
            gaussians.push([0.0, 0.0, z], [1.0, 0.0, 0.0, 0.0], [3.0, -9.0, 3.0], 0.0, &[0.0; 3]);
        }
        limit_scales(&mut gaussians, &camera);
        let widths: Vec<f32> =
            gaussians.geometry().chunks_exact(Gaussians::GEOMETRY).map(|row| row[LOG_SCALE.start]).collect();
        assert_eq!(widths, [0.2f32.ln(), 3.0, 3.0, 3.0, 3.0]);
        assert!(
            gaussians
                .geometry()
                .chunks_exact(Gaussians::GEOMETRY)
                .all(|row| row[LOG_SCALE.start + 1] == -9.0)
        );
        limit_scales(&mut Gaussians::empty(0).unwrap(), &camera);
    }
}
