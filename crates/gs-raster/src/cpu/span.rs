//! The tiles that an ellipse touches.

use super::project::Splat;
use super::{Grid, TILE};

/// Neighbouring tiles in one row.
#[derive(Debug, Clone, Copy)]
pub(super) struct Span {
    pub(super) start: u32,
    pub(super) end: u32,
}

/// The tiles of a splat.
#[derive(Debug, Clone, Copy)]
pub(super) enum Tiles {
    /// Neighbours in one row: most splats are smaller than a tile.
    One(Span),
    /// Spans of the splat's chunk.
    Several { first: u32, count: u32 },
}

impl Tiles {
    pub(super) const NONE: Self = Self::Several { first: 0, count: 0 };
}

/// First and last row and column of the image that a splat's ellipse may touch.
#[derive(Debug, Clone, Copy)]
pub(super) struct Bounds {
    pub(super) rows: [u32; 2],
    pub(super) columns: [u32; 2],
}

impl Bounds {
    /// Calls `visit` with the tiles in which a pixel centre may lie inside the ellipse of `splat`, which ends where log₂ of
    /// alpha is `limit`.
    #[inline(always)]
    pub(super) fn for_each_span(self, splat: &Splat, grid: Grid, limit: f32, mut visit: impl FnMut(Span)) {
        let [[top, bottom], [left, right]] =
            [self.rows, self.columns].map(|ends| ends.map(|end| end / TILE as u32));
        let columns = grid.columns as u32;
        // In one row or column of tiles the ellipse touches all that its bounding box does.
        if top == bottom || left == right {
            for row in top..=bottom {
                visit(Span { start: row * columns + left, end: row * columns + right + 1 });
            }
        } else {
            inner_spans(splat, [top, bottom], grid, limit, visit);
        }
    }
}

/// Within a row of tiles the ellipse reaches farthest right at dy = `lean` if that is in the row, else at the edge
/// nearest to it; farthest left likewise at dy = -`lean`.
#[inline(always)]
fn inner_spans(splat: &Splat, [top, bottom]: [u32; 2], grid: Grid, limit: f32, mut visit: impl FnMut(Span)) {
    let [x, y] = splat.mean;
    // Along its rows and columns, falloff and opacity multiply to alpha_min at the ends of the ellipse.
    let levels = splat.log2_opacity - limit;
    let [across, half_height] = splat.falloff.map(|falloff| (-levels / falloff).sqrt());
    let lean = splat.shear * half_height * (half_height / splat.half_width);
    for row in top as usize..=bottom as usize {
        let top = ((row * TILE) as f64 + 0.5 - y) as f32;
        let (low, high) = (top.max(-half_height), (top + (TILE - 1) as f32).min(half_height));
        let reach = |dy: f32| {
            let relative = dy / half_height;
            (splat.shear * dy, across * (1.0 - relative * relative).max(0.0).sqrt())
        };
        let (middle_left, half_left) = reach((-lean).max(low).min(high));
        let (middle_right, half_right) = reach(lean.max(low).min(high));
        if let Some((left, right)) = pixels(x, middle_left - half_left, middle_right + half_right, grid.width)
        {
            let (start, end) = (row * grid.columns + left / TILE, row * grid.columns + right / TILE + 1);
            visit(Span { start: start as u32, end: end as u32 });
        }
    }
}

/// First and last pixel of `0..size` whose centre lies between `middle + low` and `middle + high`.
#[inline(always)]
fn pixels(middle: f64, low: f32, high: f32, size: usize) -> Option<(usize, usize)> {
    let first = (middle + f64::from(low) - 0.5).ceil().max(0.0);
    let last = (middle + f64::from(high) - 0.5).floor().min((size - 1) as f64);
    // In the range of i32: casts to it are single instructions.
    (first <= last).then_some((first as i32 as usize, last as i32 as usize))
}
