//! The tiles that a footprint touches, shared by the passes `project` and `bin`.

use crate::frame::join;
use gs_shaders::{Frame, LEVEL_SLACK, REACH_SLACK, Splat, TILE};
use std::ops::Range;

/// The ellipse outside which alpha is below `alpha_min`.
pub(crate) struct Ellipse {
    pub(crate) mean: [f64; 2],
    /// Half width and half height, pixels.
    pub(crate) extent: [f64; 2],
    shear: f64,
    /// Half width of the row through the centre.
    half_width: f64,
}

pub(crate) fn ellipse_of(splat: &Splat, log2_alpha_min: f64) -> Ellipse {
    let level = f64::from(splat.log2_opacity) - log2_alpha_min + f64::from(LEVEL_SLACK);
    let reach = |falloff: f32| (level / f64::from(-falloff)).max(0.0).sqrt();
    let (half_width, height) = (reach(splat.falloff[0]), reach(splat.falloff[1]));
    let [shear] = join([splat.shear], [splat.shear_low]);
    Ellipse {
        mean: join(splat.mean, splat.mean_low),
        extent: [half_width.hypot(shear * height), height],
        shear,
        half_width,
    }
}

/// Tiles along an axis of whose pixel centres some may lie in middle + [low, high].
fn tiles_between(middle: f64, low: f64, high: f64, size: u32) -> Range<u32> {
    let slack = f64::from(REACH_SLACK) * (middle.abs() + low.abs().max(high.abs()));
    let first = (middle + low - slack - 0.5).ceil().max(0.0);
    let last = (middle + high + slack - 0.5).floor().min(f64::from(size) - 1.0);
    if first <= last { first as u32 / TILE..last as u32 / TILE + 1 } else { 0..0 }
}

/// Rows of tiles that the ellipse touches.
pub(crate) fn tile_rows(ellipse: &Ellipse, frame: &Frame) -> Range<u32> {
    tiles_between(ellipse.mean[1], -ellipse.extent[1], ellipse.extent[1], frame.size[1])
}

/// Columns of tiles that it touches in a row of tiles. Within the row it reaches farthest right at dy = lean if that is in the
/// row, else at the edge nearest to it; farthest left likewise at dy = -lean.
pub(crate) fn tile_columns(ellipse: &Ellipse, row: u32, frame: &Frame) -> Range<u32> {
    let [width, height] = ellipse.extent;
    let top = f64::from(row * TILE) + 0.5 - ellipse.mean[1];
    let low = top.max(-height);
    let high = (top + f64::from(TILE - 1)).min(height);
    let lean = if width > 0.0 { ellipse.shear * height * (height / width) } else { 0.0 };
    let left = (-lean).max(low).min(high);
    let right = lean.max(low).min(high);
    let reach_left = ellipse.shear * left - row_half_width(ellipse, left);
    let reach_right = ellipse.shear * right + row_half_width(ellipse, right);
    tiles_between(ellipse.mean[0], reach_left, reach_right, frame.size[0])
}

fn row_half_width(ellipse: &Ellipse, dy: f64) -> f64 {
    let height = ellipse.extent[1];
    let relative = if height > 0.0 { dy / height } else { 0.0 };
    ellipse.half_width * (1.0 - relative * relative).max(0.0).sqrt()
}
