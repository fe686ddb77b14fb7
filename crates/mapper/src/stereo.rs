//! Depth of a keyframe by stereo with earlier ones.

use crate::covisibility::Footprint;
use crate::keyframes::Keyframe;
use crate::look::Look;
use crate::{Config, Result, Waiting};
use depth_backbone::{DepthBackbone, DepthRange, PlaneSweep, ViewGeometry, Wanted};
use gs_scene::View;

/// Planes of the sweep.
const PLANES: usize = 96;
/// Least share of a frame's content that a source must show.
const OVERLAP: f64 = 0.3;
/// Distance of two cameras over the median depth: below the first there is no parallax, from the second on more is no better.
const BASELINE: [f64; 2] = [0.01, 0.1];
/// Share of the picture that the map must show for its depths to tell the range.
const KNOWN: f64 = 0.5;
/// The map's range is widened by this on both sides: what is new may lie beyond.
const MARGIN: f64 = 1.7;

/// Geometry of a view with the range that was searched; or why there is none.
pub(crate) type Found = std::result::Result<(ViewGeometry, (f64, f64)), Waiting>;

/// Places in `kept` of the keyframes to match a frame with, best first.
fn sources(footprint: &Footprint, kept: &[Keyframe], most: usize) -> Vec<usize> {
    let Some(median) = footprint.median() else { return Vec::new() };
    let whole = footprint.clone().filled(median);
    let here = footprint.camera.position();
    let score = |keyframe: &Keyframe| {
        let overlap = whole.share_in(keyframe.camera());
        let baseline = keyframe.camera().position().distance(here) / median;
        let turned = keyframe.camera().forward().dot(footprint.camera.forward());
        let is_of_use = overlap >= OVERLAP && baseline >= BASELINE[0] && turned > 0.5;
        is_of_use.then(|| overlap * (baseline / BASELINE[1]).min(1.0))
    };
    let mut scored: Vec<(f64, usize)> =
        kept.iter().enumerate().filter_map(|(i, keyframe)| Some((score(keyframe)?, i))).collect();
    scored.sort_by(|a, b| b.0.total_cmp(&a.0).then(b.1.cmp(&a.1)));
    scored.into_iter().take(most).map(|(_, i)| i).collect()
}

/// Depth of a frame, from its own picture and those of kept keyframes.
pub(crate) fn depth(view: &View, look: &Look, kept: &[Keyframe], config: &Config) -> Result<Found> {
    let sources = sources(&look.footprint, kept, config.window - 1);
    if sources.is_empty() {
        return Ok(Err(Waiting::NoParallax));
    }
    let mut views = vec![view.clone()];
    for i in sources {
        views.push(kept[i].view()?);
    }
    let range = match look.depths.len() {
        0 => DepthRange::Estimate,
        _ if 1.0 - look.seen.thin < KNOWN => DepthRange::Estimate,
        n => {
            let quantile = |part: f64| f64::from(look.depths[((n - 1) as f64 * part).round() as usize]);
            DepthRange::Known { near: quantile(0.005) / MARGIN, far: quantile(0.995) * MARGIN }
        }
    };
    Ok(sweep(&views, range).map(|(mut all, range)| (all.swap_remove(0), range)))
}

/// Depth of all views, and the range that was searched.
pub(crate) fn sweep(
    views: &[View],
    range: DepthRange,
) -> std::result::Result<(Vec<ViewGeometry>, (f64, f64)), Waiting> {
    let stereo = PlaneSweep { range, planes: PLANES, ..PlaneSweep::default() };
    let (near, far) = stereo.depth_range(views).map_err(|_| Waiting::NoRange)?;
    let known = PlaneSweep { range: DepthRange::Known { near, far }, ..stereo };
    let all = known.estimate(views, Wanted::Depth).map_err(|_| Waiting::NoRange)?;
    Ok((all, (near, far)))
}
