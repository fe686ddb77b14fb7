//! The depth range of a scene that nobody has told: a small sweep over nearly all depths, of which only well-textured
//! matches that several views confirm are believed.

use crate::cost::surface_costs;
use crate::plane_sweep::{Matched, sweep, witnesses};
use crate::range::Planes;
use crate::resolution::reduced;
use crate::{Error, Result, consistency, sources};
use cpu_kernels::Isa;
use gs_scene::{Camera, View};
use rayon::prelude::*;

/// The pictures are reduced until no side is longer than this in the two passes, pixels.
const LONGEST_SIDES: [usize; 2] = [100, 200];
/// Planes of the passes.
const PLANES: [usize; 2] = [96, 128];
/// Largest disparity searched by the first pass, in units of the longer picture side.
const LARGEST_DISPARITY: f64 = 1.5;
/// Smallest disparity told from infinity, pixels of the reduced picture.
const SMALLEST_DISPARITY: f64 = 0.1;
/// Cameras nearer to each other than this part of their distance from the origin stand in one place.
const SAME_PLACE: f64 = 1e-9;
/// Standard deviation of the luma (8-bit levels) in a window that is textured enough.
const TEXTURED: f32 = 6.0;
/// Matching cost of a believed match.
const GOOD_COST: f32 = 0.25;
/// Views that must confirm a match.
const CONFIRMATIONS: u8 = 2;
/// Matches below which nothing is concluded.
const ENOUGH: usize = 50;
/// Part of the matches that is nearer than near, and farther than far.
const TAIL: f64 = 0.005;
/// The second pass searches this much beyond the tails of the first, as a factor of inverse depth.
const WIDER: f64 = 1.6;

/// Near and far end of what the views see, z-depths in scene units: all but half a percent at either end.
pub(crate) fn depth_range(views: &[View]) -> Result<(f64, f64)> {
    let small = no_longer_than(LONGEST_SIDES[0], views)?;
    let cameras: Vec<Camera> = small.iter().map(|view| *view.camera()).collect();
    let neighbours = neighbours(&cameras);
    let (smallest, largest) = disparity_per_inverse_depth(&cameras, &neighbours)?;
    let side = small.iter().map(|view| view.image().width().max(view.image().height())).max().unwrap_or(1);
    let wide = Planes::between(
        SMALLEST_DISPARITY / largest,
        (LARGEST_DISPARITY * side as f64 / smallest).max(2.0 * SMALLEST_DISPARITY / largest),
        PLANES[0],
    );
    let (far, near) = confirmed(&small, &neighbours, &wide)?;
    let limits = (wide.inverse_depth_at(0.0), wide.inverse_depth_at(1.0));
    let (far, near) = ((far / WIDER).max(limits.0), (near * WIDER).min(limits.1));
    let narrow = Planes::between(far, near, PLANES[1]);
    let small = no_longer_than(LONGEST_SIDES[1], views)?;
    let (far, near) = confirmed(&small, &sources::choose(&cameras, &narrow, 4), &narrow)?;
    Ok((1.0 / near, 1.0 / far))
}

/// The views, reduced until no side is longer than this.
fn no_longer_than(side: usize, views: &[View]) -> Result<Vec<View>> {
    let small = |view: &View| {
        let longest = view.image().width().max(view.image().height());
        reduced(view, longest.div_ceil(side))
    };
    views.par_iter().map(small).collect()
}

/// For each camera up to four others that look the same way (within 60 degrees), nearest first.
fn neighbours(cameras: &[Camera]) -> Vec<Vec<usize>> {
    let neighbourhood = |i: usize| {
        let distance = |j: usize| cameras[i].position().distance(cameras[j].position());
        // Poses that turn in one place differ by the rounding of R and t.
        let apart = |j: usize| distance(j) > SAME_PLACE * cameras[i].translation().length();
        let mut others: Vec<usize> = (0..cameras.len())
            .filter(|&j| {
                j != i
                    && distance(j) > 0.0
                    && apart(j)
                    && cameras[i].forward().dot(cameras[j].forward()) > 0.5
            })
            .collect();
        others.sort_by(|&a, &b| distance(a).total_cmp(&distance(b)).then(a.cmp(&b)));
        others.truncate(4);
        others
    };
    (0..cameras.len()).map(neighbourhood).collect()
}

/// Smallest (over the views, of their nearest neighbour) and largest focal length times baseline: pixels of disparity
/// per unit of inverse depth.
fn disparity_per_inverse_depth(cameras: &[Camera], neighbours: &[Vec<usize>]) -> Result<(f64, f64)> {
    let (mut smallest, mut largest) = (f64::INFINITY, 0.0_f64);
    for (camera, others) in cameras.iter().zip(neighbours) {
        let per_inverse_depth =
            |&other: &usize| camera.intrinsics().fx * camera.position().distance(cameras[other].position());
        if let Some(nearest) = others.first() {
            smallest = smallest.min(per_inverse_depth(nearest));
        }
        largest = others.iter().map(per_inverse_depth).fold(largest, f64::max);
    }
    if largest == 0.0 {
        return Err(Error::RangeUnknown { reason: "no two cameras stand apart and look the same way" });
    }
    Ok((smallest, largest))
}

/// Inverse depths of the far and near tail of the matches that the views confirm to each other.
fn confirmed(views: &[View], sources: &[Vec<usize>], planes: &Planes) -> Result<(f64, f64)> {
    let matched = Matched::all(views, sources);
    let inverse_depths: Vec<Vec<f32>> =
        matched.par_iter().map(|view| sweep(view, &matched, planes)).collect();
    let isa = Isa::in_use();
    let needed = CONFIRMATIONS.min(views.len().saturating_sub(1).try_into().unwrap_or(u8::MAX));
    let believed = |i: usize| -> Vec<f32> {
        let view = &matched[i];
        let inverse_depth = &inverse_depths[i];
        let agreed = consistency::agree(
            view.view,
            inverse_depth,
            &witnesses(i, &matched, &inverse_depths, planes),
            planes,
        );
        let costs =
            surface_costs(isa, view.reference(), &view.sources(&matched), inverse_depth, planes.ends());
        (0..inverse_depth.len())
            .filter(|&p| {
                agreed[p].0 >= needed && costs[p] < GOOD_COST && view.statistics.deviation(p) > TEXTURED
            })
            .map(|p| inverse_depth[p])
            .collect()
    };
    let mut all: Vec<f32> = (0..views.len()).into_par_iter().flat_map_iter(believed).collect();
    if all.len() < ENOUGH {
        return Err(Error::RangeUnknown { reason: "too few matches that several views confirm" });
    }
    all.sort_by(f32::total_cmp);
    let quantile = |part: f64| f64::from(all[((all.len() - 1) as f64 * part).round() as usize]);
    Ok((quantile(TAIL), quantile(1.0 - TAIL).max(quantile(TAIL) * 1.05)))
}
