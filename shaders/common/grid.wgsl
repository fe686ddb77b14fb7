// Which tiles a footprint touches: the one place that decides it.

override TILE: u32;

// Added to the level of the ellipse that bounds a footprint, in units of log2 of alpha: far above the rounding of the
// rasterizer, which decides by alpha itself, and too small to cost anything.
const LEVEL_SLACK: f32 = 1e-3;

// Added to the reach of an ellipse, relative to the numbers that it is the difference of.
const REACH_SLACK: f32 = 1e-6;

// The ellipse outside which alpha is below alpha_min.
struct Ellipse {
    mean: vec2f,
    // Half width and half height, pixels.
    extent: vec2f,
    shear: f32,
    // Half width of the row through the centre.
    half_width: f32,
}

fn ellipse_of(splat: Splat, log2_alpha_min: f32) -> Ellipse {
    let level = splat.log2_opacity - log2_alpha_min + LEVEL_SLACK;
    let half_width = sqrt(max(level / -splat.falloff.x, 0.0));
    let height = sqrt(max(level / -splat.falloff.y, 0.0));
    let lean = splat.shear * height;
    return Ellipse(splat.mean, vec2f(sqrt(half_width * half_width + lean * lean), height), splat.shear, half_width);
}

// First tile and the one after the last along an axis of whose pixel centres some may lie in middle + [low, high].
fn tiles_between(middle: f32, low: f32, high: f32, size: u32) -> vec2u {
    // What the sums may be rounded by: nothing of note, but for needles that reach into the image from far away.
    let slack = REACH_SLACK * (abs(middle) + max(abs(low), abs(high)));
    let first = max(ceil(middle + low - slack - 0.5), 0.0);
    let last = min(floor(middle + high + slack - 0.5), f32(size) - 1.0);
    if !(first <= last) {
        return vec2u(0u, 0u);
    }
    return vec2u(u32(first) / TILE, u32(last) / TILE + 1u);
}

// Rows of tiles that the ellipse touches.
fn tile_rows(ellipse: Ellipse, frame: Frame) -> vec2u {
    return tiles_between(ellipse.mean.y, -ellipse.extent.y, ellipse.extent.y, frame.size.y);
}

// Columns of tiles that it touches in a row of tiles. Within the row it reaches farthest right at dy = lean if that is in the
// row, else at the edge nearest to it; farthest left likewise at dy = -lean.
fn tile_columns(ellipse: Ellipse, row: u32, frame: Frame) -> vec2u {
    let top = f32(row * TILE) + 0.5 - ellipse.mean.y;
    let low = max(top, -ellipse.extent.y);
    let high = min(top + f32(TILE - 1u), ellipse.extent.y);
    // An ellipse without extent has no lean; the division must not make a NaN of it.
    let lean = ellipse.shear * ellipse.extent.y * (ellipse.extent.y / max(ellipse.extent.x, 1e-30));
    let left = min(max(-lean, low), high);
    let right = min(max(lean, low), high);
    let reach_left = ellipse.shear * left - row_half_width(ellipse, left);
    let reach_right = ellipse.shear * right + row_half_width(ellipse, right);
    return tiles_between(ellipse.mean.x, reach_left, reach_right, frame.size.x);
}

fn row_half_width(ellipse: Ellipse, dy: f32) -> f32 {
    let relative = dy / max(ellipse.extent.y, 1e-30);
    return ellipse.half_width * sqrt(max(1.0 - relative * relative, 0.0));
}
