//! The first keyframes of stereo: frames that wait until there are views from different places.

use crate::covisibility::{Footprint, POINTS};
use crate::keyframes::Keyframe;
use crate::stereo::sweep;
use crate::{Result, Waiting};
use depth_backbone::{DepthRange, PlaneSweep, ViewGeometry};
use gs_scene::{Camera, View};

/// Frames that wait at the most; of more the first goes.
const WAITING: usize = 4;
/// Views from which the first map is made.
const ENOUGH: usize = 3;
/// Distance of two first keyframes over the depth of what they see.
const BASELINE: f64 = 0.04;
/// Cameras nearer to each other than this part of their distance from the origin stand in one place.
const SAME_PLACE: f64 = 1e-9;

/// What the first keyframes show.
pub(crate) type First = (Vec<View>, Vec<ViewGeometry>, (f64, f64));

/// Adds a frame to those that wait, if it is of use; gives depth of all of them once they are enough.
pub(crate) fn wait(view: &View, waiting: &mut Vec<Keyframe>) -> Result<std::result::Result<First, Waiting>> {
    let blank = |camera: &Camera| Footprint { camera: *camera, depths: vec![0.0; POINTS] };
    let camera = view.camera();
    if let Some(last) = waiting.last() {
        let distance = last.camera().position().distance(camera.position());
        if distance <= SAME_PLACE * camera.position().length() {
            return Ok(Err(Waiting::FirstKeyframes));
        }
        // Depth tells how far is far enough, and two views tell depth, as far as they do.
        let pair = [last.view()?, view.clone()];
        let Ok((near, far)) = PlaneSweep::default().depth_range(&pair) else {
            return Ok(Err(Waiting::NoRange));
        };
        let depth = 2.0 / (1.0 / near + 1.0 / far);
        if distance < BASELINE * depth {
            return Ok(Err(Waiting::FirstKeyframes));
        }
    }
    if waiting.len() == WAITING {
        waiting.remove(0);
    }
    waiting.push(Keyframe::new(view, blank(camera)));
    if waiting.len() < ENOUGH {
        return Ok(Err(Waiting::FirstKeyframes));
    }
    let views: Vec<View> = waiting.iter().map(Keyframe::view).collect::<Result<_>>()?;
    Ok(sweep(&views, DepthRange::Estimate).map(|(geometry, range)| {
        waiting.clear();
        (views, geometry, range)
    }))
}
