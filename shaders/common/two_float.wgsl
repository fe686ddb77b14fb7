// Numbers as unevaluated sums of two f32, high and low, good to about 2^-44: for positions and footprints, whose errors would
// otherwise be those of f32 at the size of the whole world or of a whole needle. Error-free transformations of Dekker (1971)
// and Knuth; they need additions that are not reordered, which the self-test at start-up makes sure of.

// Scalars are (high, low); vectors are these.
struct Two3 {
    high: vec3f,
    low: vec3f,
}

fn two_sum(a: f32, b: f32) -> vec2f {
    let sum = a + b;
    let b_seen = sum - a;
    return vec2f(sum, (a - (sum - b_seen)) + (b - b_seen));
}

// Of which |a| ≥ |b|.
fn quick_two_sum(a: f32, b: f32) -> vec2f {
    let sum = a + b;
    return vec2f(sum, b - (sum - a));
}

// The upper half of the significant bits: products of halves are exact.
fn upper_half(a: f32) -> f32 {
    return bitcast<f32>(bitcast<u32>(a) & 0xfffff000u);
}

fn two_product(a: f32, b: f32) -> vec2f {
    let product = a * b;
    let a_high = upper_half(a);
    let b_high = upper_half(b);
    let a_low = a - a_high;
    let b_low = b - b_high;
    return vec2f(product, ((a_high * b_high - product) + a_high * b_low + a_low * b_high) + a_low * b_low);
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
    let quotient = a.x / b.x;
    let rest = add(a, -multiply(vec2f(quotient, 0.0), b));
    return quick_two_sum(quotient, rest.x / b.x);
}

fn add3(a: Two3, b: Two3) -> Two3 {
    let sum = a.high + b.high;
    let b_seen = sum - a.high;
    let error = (a.high - (sum - b_seen)) + (b.high - b_seen) + (a.low + b.low);
    let high = sum + error;
    return Two3(high, error - (high - sum));
}

fn scale3(a: Two3, s: vec2f) -> Two3 {
    let x = multiply(vec2f(a.high.x, a.low.x), s);
    let y = multiply(vec2f(a.high.y, a.low.y), s);
    let z = multiply(vec2f(a.high.z, a.low.z), s);
    return Two3(vec3f(x.x, y.x, z.x), vec3f(x.y, y.y, z.y));
}

fn dot3(a: Two3, b: Two3) -> vec2f {
    let x = multiply(vec2f(a.high.x, a.low.x), vec2f(b.high.x, b.low.x));
    let y = multiply(vec2f(a.high.y, a.low.y), vec2f(b.high.y, b.low.y));
    let z = multiply(vec2f(a.high.z, a.low.z), vec2f(b.high.z, b.low.z));
    return add(add(x, y), z);
}
