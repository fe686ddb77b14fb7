// Opacity of a Gaussian in a pixel: the one place that decides what is drawn. Users bind `frame`.

// A footprint seen from a tile, so that f32 keeps positions within it.
struct Local {
    shape: Shape,
    rgb: vec3f,
    depth: f32,
}

// The part that decides alpha: most pixels of a tile need no more.
struct Shape {
    // From the centre of the row in which the tile's top-left corner lies to that corner, and from the centre to it downwards.
    offset: vec2f,
    falloff: vec2f,
    shear: f32,
    log2_opacity: f32,
}

struct Alpha {
    // 0 where the Gaussian is not drawn.
    value: f32,
    drawn: bool,
    // Whether it is cut at alpha_max.
    saturated: bool,
    // Offset of the pixel from the centre, (e, dy) with e = dx - shear dy.
    offset: vec2f,
}

fn local_to(splat: Splat, origin: vec2f) -> Local {
    let dx = add(vec2f(origin.x, 0.0), -vec2f(splat.mean.x, splat.mean_low.x));
    let dy = add(vec2f(origin.y, 0.0), -vec2f(splat.mean.y, splat.mean_low.y));
    let lean = multiply(vec2f(splat.shear, splat.shear_low), dy);
    return Local(
        Shape(vec2f(add(dx, -lean).x, dy.x), splat.falloff, splat.shear, splat.log2_opacity),
        vec3f(splat.red, splat.green, splat.blue),
        splat.depth,
    );
}

// In the pixel whose centre lies at `place` from the tile's top-left corner.
fn alpha_at(shape: Shape, place: vec2f, log2_alpha_min: f32) -> Alpha {
    var alpha: Alpha;
    alpha.offset = shape.offset + vec2f(place.x - shape.shear * place.y, place.y);
    let falloff = shape.falloff * alpha.offset * alpha.offset;
    let log2_alpha = shape.log2_opacity + falloff.x + falloff.y;
    alpha.drawn = log2_alpha >= log2_alpha_min;
    if alpha.drawn {
        let unlimited = exp2(log2_alpha);
        alpha.saturated = unlimited > frame.alpha_max;
        alpha.value = min(unlimited, frame.alpha_max);
    }
    return alpha;
}
