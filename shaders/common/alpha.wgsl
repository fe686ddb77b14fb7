// Opacity of a Gaussian in a pixel: the one place that decides what is drawn. Users bind `frame`.

struct Alpha {
    value: f32,
    drawn: bool,
    // Whether it is cut at alpha_max.
    saturated: bool,
    // Offset of the pixel from the centre, (e, dy) with e = dx - shear dy.
    offset: vec2f,
}

fn alpha_at(splat: Splat, centre: vec2f, log2_alpha_min: f32) -> Alpha {
    var alpha: Alpha;
    let d = centre - splat.mean;
    alpha.offset = vec2f(d.x - splat.shear * d.y, d.y);
    let falloff = splat.falloff * alpha.offset * alpha.offset;
    let log2_alpha = splat.log2_opacity + falloff.x + falloff.y;
    let unlimited = exp2(log2_alpha);
    alpha.drawn = log2_alpha >= log2_alpha_min;
    alpha.saturated = unlimited > frame.alpha_max;
    alpha.value = min(unlimited, frame.alpha_max);
    return alpha;
}
