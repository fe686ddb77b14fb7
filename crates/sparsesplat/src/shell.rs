//! The far shell: large Gaussians behind everything, for what no view covers (borders, disocclusions, sky).

use depth_backbone::FAR_MARGIN;
use glam::{DMat3, DQuat, DVec2};
use gs_scene::{Gaussians, Image, View, dc_from_rgb, logit};

/// Share of the budget that the shell may take.
const SHARE: f64 = 0.15;
/// Smallest cell, pixels.
const SMALLEST_CELL: f64 = 20.0;
/// The grid goes beyond the picture by this part of its size, on every side.
const PADDING: f64 = 0.35;
/// Standard deviation over cell size.
const SPREAD: f64 = 0.6;
const OPACITY: f32 = 0.9;
/// z-depth of the shell over the farthest that stereo finds: in front of that it would hide what lies there (at the far
/// end of the range, herzjesu loses 1.1 dB).
const BEHIND: f64 = 1.28;

/// Cells along an axis of `length` pixels.
fn cells_along(length: usize, cell: f64) -> usize {
    ((length as f64 * (1.0 + 2.0 * PADDING)) / cell).ceil().max(1.0) as usize
}

fn count(views: &[View], cell: f64) -> usize {
    let cells =
        |view: &View| cells_along(view.image().width(), cell) * cells_along(view.image().height(), cell);
    views.iter().map(cells).sum()
}

/// Cell size, pixels, for which the shell of all views takes at most its share of `budget` Gaussians.
fn cell_size(views: &[View], budget: usize) -> Option<f64> {
    let limit = (budget as f64 * SHARE) as usize;
    let mut cell = SMALLEST_CELL;
    while count(views, cell) > limit {
        cell *= 1.02;
        if cell > 1e5 {
            return None;
        }
    }
    Some(cell)
}

/// Mean colour of the square of `cell` pixels around (x, y), of the picture repeated beyond its border.
fn mean_colour(image: &Image, x: f64, y: f64, cell: f64) -> [f32; 3] {
    let span = |centre: f64, length: usize| {
        let last = length as f64 - 1.0;
        let from = (centre - cell / 2.0).round().clamp(0.0, last) as usize;
        let to = (centre + cell / 2.0).round().clamp(0.0, last) as usize;
        from..=to
    };
    let (mut sum, mut n) = ([0.0_f64; 3], 0.0);
    for y in span(y, image.height()) {
        for x in span(x, image.width()) {
            let rgb = image.pixel(x, y);
            (0..3).for_each(|c| sum[c] += f64::from(rgb[c]));
            n += 1.0;
        }
    }
    sum.map(|s| (s / n) as f32)
}

/// The shell of all views behind z-depth `far`, of at most its share of `budget`; none if not even one cell per view fits.
pub(crate) fn shell(views: &[View], far: f64, budget: usize) -> gs_scene::Result<Gaussians> {
    let mut shell = Gaussians::empty(0)?;
    let Some(cell) = cell_size(views, budget) else { return Ok(shell) };
    for view in views {
        let (camera, image) = (view.camera(), view.image());
        let lens = camera.intrinsics();
        let (columns, rows) = (cells_along(image.width(), cell), cells_along(image.height(), cell));
        let depth = far * FAR_MARGIN * BEHIND;
        let axes: DMat3 = camera.rotation().transpose();
        let rotation = DQuat::from_mat3(&axes).normalize();
        let scale = |focal: f64| (SPREAD * cell * depth / focal) as f32;
        let thin = scale(lens.fx) * 0.05;
        for row in 0..rows {
            for column in 0..columns {
                // The grid is centred on the picture.
                let place = |i: usize, n: usize, length: usize| {
                    length as f64 / 2.0 + (i as f64 + 0.5 - n as f64 / 2.0) * cell
                };
                let pixel =
                    DVec2::new(place(column, columns, image.width()), place(row, rows, image.height()));
                let colour = mean_colour(image, pixel.x, pixel.y, cell);
                shell.push(
                    camera.unproject(pixel, depth).as_vec3().to_array(),
                    [rotation.w as f32, rotation.x as f32, rotation.y as f32, rotation.z as f32],
                    [scale(lens.fx).ln(), scale(lens.fy).ln(), thin.ln()],
                    logit(OPACITY),
                    &dc_from_rgb(colour),
                );
            }
        }
    }
    Ok(shell)
}
