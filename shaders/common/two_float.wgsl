// Numbers as unevaluated sums of two f32, high and low, good to about 2^-44: for positions and footprints, whose errors would
// otherwise be those of f32 at the size of the whole world or of a whole needle. Error-free transformations of Dekker (1971)
// and Knuth. Users bind `frame`.

// Scalars are (high, low); vectors are these.
struct Two3 {
    high: vec3f,
    low: vec3f,
}

// The number as it was rounded. A compiler may take (a + b) - a for b, which is what these transformations must not have; that
// frame.zero is 0 it cannot know.
fn rounded(x: f32) -> f32 {
    return bitcast<f32>(bitcast<u32>(x) ^ frame.zero);
}

fn two_sum(a: f32, b: f32) -> vec2f {
    let sum = rounded(a + b);
    let b_seen = rounded(sum - a);
    let a_seen = rounded(sum - b_seen);
    return vec2f(sum, rounded(a - a_seen) + rounded(b - b_seen));
}

// Of which |a| ≥ |b|.
fn quick_two_sum(a: f32, b: f32) -> vec2f {
    let sum = rounded(a + b);
    return vec2f(sum, b - rounded(sum - a));
}

// The upper half of the significant bits: products of halves are exact.
fn upper_half(a: f32) -> f32 {
    return bitcast<f32>(bitcast<u32>(a) & 0xfffff000u);
}

fn two_product(a: f32, b: f32) -> vec2f {
    let product = rounded(a * b);
    let a_high = upper_half(a);
    let b_high = upper_half(b);
    let a_low = rounded(a - a_high);
    let b_low = rounded(b - b_high);
    let error = rounded(a_high * b_high - product);
    return vec2f(product, ((error + a_high * b_low) + a_low * b_high) + a_low * b_low);
}

fn add(a: vec2f, b: vec2f) -> vec2f {
    let sum = two_sum(a.x, b.x);
    return quick_two_sum(sum.x, sum.y + (a.y + b.y));
}

fn multiply(a: vec2f, b: vec2f) -> vec2f {
    let product = two_product(a.x, b.x);
    return quick_two_sum(product.x, product.y + (a.x * b.y + a.y * b.x));
}

fn divide(a: vec2f, b: vec2f) -> vec2f {
    let quotient = rounded(a.x / b.x);
    let rest = add(a, -multiply(vec2f(quotient, 0.0), b));
    return quick_two_sum(quotient, rest.x / b.x);
}

fn two3(x: vec2f, y: vec2f, z: vec2f) -> Two3 {
    return Two3(vec3f(x.x, y.x, z.x), vec3f(x.y, y.y, z.y));
}

fn entry(a: Two3, i: u32) -> vec2f {
    return vec2f(a.high[i], a.low[i]);
}

fn add3(a: Two3, b: Two3) -> Two3 {
    return two3(add(entry(a, 0u), entry(b, 0u)), add(entry(a, 1u), entry(b, 1u)), add(entry(a, 2u), entry(b, 2u)));
}

fn scale3(a: Two3, s: vec2f) -> Two3 {
    return two3(multiply(entry(a, 0u), s), multiply(entry(a, 1u), s), multiply(entry(a, 2u), s));
}

fn dot3(a: Two3, b: Two3) -> vec2f {
    let x = multiply(entry(a, 0u), entry(b, 0u));
    let y = multiply(entry(a, 1u), entry(b, 1u));
    let z = multiply(entry(a, 2u), entry(b, 2u));
    return add(add(x, y), z);
}
