//! The configured backbone: depth, and what else is wanted of it.

use crate::{Backbone, Config, Error, Result};
use depth_backbone::{DepthBackbone, DepthRange, GivenDepth, PlaneSweep, ViewGeometry, Wanted};
use gs_scene::View;
use std::path::Path;

/// Depth of all views by the configured backbone, and what else is wanted; and the range it lies in, scene units.
///
/// # Errors
/// If the views do not suffice for the backbone, or its weights cannot be read.
pub fn geometry(views: &[View], config: &Config, wanted: Wanted) -> Result<(Vec<ViewGeometry>, (f64, f64))> {
    let stereo = PlaneSweep { range: config.depth_range, ..PlaneSweep::default() };
    Ok(match &config.backbone {
        Backbone::GivenDepth => {
            let range = GivenDepth::depth_range(views)?;
            (GivenDepth.estimate(views, wanted)?, range)
        }
        Backbone::PlaneSweep { planes } => {
            check_parallax(views, config.depth_range)?;
            let (near, far) = stereo.depth_range(views)?;
            let sweep = PlaneSweep { range: DepthRange::Known { near, far }, planes: *planes, ..stereo };
            (sweep.estimate(views, wanted)?, (near, far))
        }
        Backbone::DepthSplat(weights) => {
            check_parallax(views, config.depth_range)?;
            let range = stereo.depth_range(views)?;
            (network(weights, |network| Ok(network.estimate_within(views, range, wanted)?))?, range)
        }
    })
}

/// What the nearest content moves by between the cameras farthest apart, pixels, below which there is nothing to match.
const LEAST_PARALLAX: f64 = 0.1;
/// Cameras nearer to each other than this part of their distance from the origin stand in one place: poses that turn in one place differ by
/// the rounding of rotation and translation.
const SAME_PLACE: f64 = 1e-9;

/// Refuses views that differ by rotation alone, of which a stated range would make a scene without meaning. One view is refused elsewhere.
fn check_parallax(views: &[View], range: DepthRange) -> Result<()> {
    let position = |view: &View| view.camera().position();
    let distances = views.iter().flat_map(|a| views.iter().map(move |b| position(a).distance(position(b))));
    let distance = distances.fold(0.0, f64::max);
    let parallax = |near: f64| {
        let focal = views.iter().map(|view| view.camera().intrinsics().fx).fold(0.0, f64::max);
        focal * distance / near
    };
    let is_one_place = match range {
        DepthRange::Known { near, .. } => parallax(near) < LEAST_PARALLAX,
        DepthRange::Estimate => {
            distance <= SAME_PLACE * views.iter().map(|view| position(view).length()).fold(0.0, f64::max)
        }
    };
    if views.len() > 1 && is_one_place {
        return Err(Error::NoParallax { views: views.len(), distance });
    }
    Ok(())
}

/// What tells results of one backbone from those of another: its name, and which weights it has, whatever their file is called.
///
/// # Errors
/// If its weights cannot be read.
pub fn identity(backbone: &Backbone) -> Result<String> {
    match backbone {
        Backbone::GivenDepth | Backbone::PlaneSweep { .. } => Ok(format!("{backbone:?}")),
        Backbone::DepthSplat(weights) => network(weights, |network| Ok(network.schema().to_owned())),
    }
}

#[cfg(feature = "depthsplat")]
fn network<T>(weights: &Path, run: impl FnOnce(&depth_backbone::DepthSplat) -> Result<T>) -> Result<T> {
    run(&*depth_backbone::DepthSplat::shared(weights)?)
}

#[cfg(not(feature = "depthsplat"))]
fn network<T>(weights: &Path, _: impl FnOnce(&Unbuilt) -> Result<T>) -> Result<T> {
    Err(Error::NoNetwork { weights: weights.display().to_string() })
}

/// Without the feature `depthsplat` there is no network: a type that has no values.
#[cfg(not(feature = "depthsplat"))]
enum Unbuilt {}

#[cfg(not(feature = "depthsplat"))]
impl Unbuilt {
    fn schema(&self) -> &str {
        match *self {}
    }

    fn estimate_within(
        &self,
        _: &[View],
        _: (f64, f64),
        _: Wanted,
    ) -> depth_backbone::Result<Vec<ViewGeometry>> {
        match *self {}
    }
}
