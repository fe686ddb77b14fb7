//! All tolerances of rendering: quantity, unit, bound, reason. Widening one is a commit of its own.

use crate::{Deviation, GoldenGradient};

/// Rounding of a few operations in f64 on numbers near 1, relative.
pub const ROUNDING_F64: f64 = 1e-14;

/// Midpoint rule with 4000 points on a polynomial of degree 6, absolute.
pub const QUADRATURE: f64 = 1e-5;

/// gs-reference against golden images, times max(1, |value|): the golden outputs are f64 results stored as f32, whose
/// rounding is 6e-8.
pub const REFERENCE_IMAGE: f64 = 1e-6;

/// gs-reference against golden f64 intermediates, relative to the largest: the same arithmetic in another order; the
/// golden determinant a c - b² of a needle of 180 pixels keeps ten digits.
pub const REFERENCE_INTERMEDIATE: f64 = 1e-9;

/// gs-reference against golden f64 gradients, relative to the largest: the same arithmetic in another order; sums over
/// pixels cancel to some digits.
pub const REFERENCE_GRADIENT: f64 = 1e-8;

/// gs-reference against golden f64 gradients that are 0 by symmetry, absolute: what rounding leaves of sums of about 1.
pub const REFERENCE_GRADIENT_ABSOLUTE: f64 = 1e-12;

/// gs-reference against a golden loss, relative to the sum of its terms' magnitudes.
pub const REFERENCE_LOSS: f64 = 1e-12;

/// Gradients of gs-reference against central differences (extrapolated from two steps), relative to the largest of a
/// group of columns: steps of 5e-4 leave 1e-12 after extrapolation; the rounding of a loss of about 10, 1e-15, is divided
/// by steps of 3e-5 (a pose must remain a rotation) and by gradients of 0.1.
pub const CENTRAL_DIFFERENCE: f64 = 1e-8;

/// The chain of the twins against the naive renderer, pixels, relative to the largest value (at least 1 but for depths): the
/// interfaces round to f32, a footprint's exponent of up to 8 by 5e-7.
pub const TWIN_IMAGE: f64 = 2e-6;

/// The chain of the twins against the naive renderer, gradients, relative to the largest value: the same rounding, divided by
/// 1 - alpha, which comes down to 1e-2 (1e-3 in one golden case), where it stands behind a Gaussian.
pub const TWIN_GRADIENT: f64 = 3e-5;

/// The chain of the twins against the naive renderer, gradients that are small because pixels cancel, absolute: rounding of
/// terms of about 1 by 6e-8.
pub const TWIN_GRADIENT_ABSOLUTE: f64 = 1e-6;

/// The definition of ellipsoid views against quadrics by the inverse of a covariance, relative to the largest value (at least
/// 1): standard deviations that differ by a factor of 500 cost the inverse six digits, near the rim some more are lost.
pub const QUADRIC: f64 = 1e-7;

/// The twins of the ellipsoid view against the definition, pixels, relative to the largest value (at least 1): the rounding of
/// the interfaces, divided by what the square root of the front's equation comes down to, 0.1.
pub const TWIN_ELLIPSOID: f64 = 1e-5;

/// Factor on the deviation that plain f32 has on the same case: room for another order of the same operations.
pub const F32_FACTOR: f64 = 10.0;

/// An f32 renderer on cases in which plain f32 is better than this, relative to the largest value: a few hundred
/// roundings of 6e-8 add up in a pixel.
pub const F32_LEAST: f64 = 2e-6;

/// An f32 renderer on outputs for which no deviation of plain f32 is known, relative to the largest value.
pub const F32_WITHOUT_FLOOR: f64 = 1e-5;

/// An f32 renderer on outputs that are small throughout, absolute: a transmittance near 1 is rounded by 6e-8 at every
/// Gaussian, and what is drawn there is what it lacks to 1.
pub const F32_ABSOLUTE: f64 = 5e-7;

/// Gradients with a largest value below this have the deviation of plain f32 given relative to this instead.
pub const F32_GRADIENT_LEAST: f64 = 1e-6;

/// An f32 renderer on gradients that are 0 by symmetry, relative to the terms that cancel in them: a quaternion's sums
/// eight terms that were rounded by 6e-8 four times each.
pub const F32_CANCELLING: f64 = 2e-6;

/// Golden gradients smaller than this, relative to the terms that cancel in them, are 0 by symmetry: what rounding in f64
/// leaves of it.
pub const CANCELLED: f64 = 1e-12;

/// Gradients of an f32 renderer on random scenes, relative to the magnitudes that parts of the picture add to them: 60 px
/// from the centre of a needle, the middle of its row is rounded by 4e-6 px; that is 5e-6 of its width, and with σ = 5 it
/// is ten times that in the opacity.
pub const F32_RANDOM_GRADIENT: f64 = 1e-4;

/// A pass on a GPU against its twin: centres of footprints, pixels, relative to the largest (at least 1). They are sums of two f32,
/// good to 2⁻⁴⁴; 2e4 units from the world's origin that is 1e-9 units.
pub const PASS_POSITION: f64 = 1e-8;

/// A pass on a GPU against its twin: numbers that few roundings made, relative. WGSL lets exp be off by 3 + 2 |x| units of the
/// last place: at the logarithm of a scale of -10 by 1.4e-6, which counts twice in a variance.
pub const PASS_NUMBER: f64 = 1e-5;

/// A pass on a GPU against its twin: pixels, relative to the largest (at least 1 but for depths). exp2 may be off by 20 units of
/// the last place where a Gaussian ends.
pub const PASS_PIXEL: f64 = 1e-5;

/// A pass on a GPU against its twin: colours of ellipsoids, relative to the largest. Near the rim the front rises by the root of a
/// difference, which makes 1e-3 of a rounding.
pub const PASS_ELLIPSOID: f64 = 1e-3;

/// A pass on a GPU against its twin: derivatives, relative to the largest of a kind. What stands behind a Gaussian is divided by
/// 1 - alpha, which comes down to 1e-2, at each.
pub const PASS_GRADIENT: f64 = 1e-4;

/// An f32 renderer on ellipsoid views, relative to the largest value (at least 1): what TWIN_ELLIPSOID has for one rounding, for
/// those of the projection and of the front.
pub const F32_ELLIPSOID: f64 = 5e-5;

/// Distance of a decision from its threshold, relative, below which f32 may decide otherwise.
pub const AMBIGUOUS: f64 = 5e-4;

/// The same in ellipsoid views. There it is the depth and the turn of a front that f32 loses near the rim, where both change with
/// the square root of the distance from it.
pub const AMBIGUOUS_ELLIPSOID: f64 = 1e-2;

/// Bound on the largest deviation of an f32 renderer, given the deviation of plain f32 on the same output if known.
#[must_use]
pub fn f32_bound(deviation: &Deviation, floor: Option<f64>) -> f64 {
    let bound = match floor {
        Some(floor) => (F32_FACTOR * floor).max(F32_LEAST * deviation.largest),
        None => F32_WITHOUT_FLOOR * deviation.largest,
    };
    bound.max(F32_ABSOLUTE)
}

/// Bound on the largest deviation of an f32 renderer from a golden gradient.
#[must_use]
pub fn f32_gradient_bound(deviation: &Deviation, golden: &GoldenGradient) -> f64 {
    let largest = deviation.largest;
    match golden.f32_floor {
        _ if largest < CANCELLED * golden.cancelling => F32_CANCELLING * golden.cancelling,
        Some(floor) => (F32_FACTOR * floor).max(F32_LEAST) * largest.max(F32_GRADIENT_LEAST),
        None => F32_WITHOUT_FLOOR * largest,
    }
}

/// Bound on the largest deviation of the chain of the twins from the naive renderer in a gradient.
#[must_use]
pub fn twin_gradient_bound(deviation: &Deviation) -> f64 {
    TWIN_GRADIENT * deviation.largest + TWIN_GRADIENT_ABSOLUTE
}

/// Bound on the largest deviation of a pass on a GPU from its twin in a derivative; that rounding in f64 makes something of one
/// that is 0 by symmetry is granted.
#[must_use]
pub fn pass_gradient_bound(deviation: &Deviation) -> f64 {
    PASS_GRADIENT * deviation.largest + ROUNDING_F64
}

/// Bound on the largest deviation of gs-reference from a golden gradient.
#[must_use]
pub fn reference_gradient_bound(deviation: &Deviation) -> f64 {
    REFERENCE_GRADIENT * deviation.largest + REFERENCE_GRADIENT_ABSOLUTE
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Variable;

    #[test]
    fn gradient_bounds_follow_the_floor_of_plain_f32() {
        let bound = |largest: f64, f32_floor: Option<f64>, cancelling: f64| {
            let deviation = Deviation { max_abs: 0.0, worst: 0, largest, relative_l2: 0.0, cosine: 1.0 };
            let golden =
                GoldenGradient { variable: Variable::Quaternions, values: vec![], f32_floor, cancelling };
            f32_gradient_bound(&deviation, &golden)
        };
        assert_eq!(bound(8.0, Some(1e-3), 0.0), 10.0 * 1e-3 * 8.0);
        assert_eq!(bound(8.0, Some(1e-7), 0.0), F32_LEAST * 8.0);
        assert_eq!(bound(8.0, None, 0.0), F32_WITHOUT_FLOOR * 8.0);
        assert_eq!(bound(8.0, None, 0.5), F32_WITHOUT_FLOOR * 8.0);
        assert_eq!(bound(1e-9, Some(1e-2), 0.0), 10.0 * 1e-2 * F32_GRADIENT_LEAST);
        // By symmetry 0.
        assert_eq!(bound(1e-17, Some(1e-2), 0.5), F32_CANCELLING * 0.5);
        assert_eq!(bound(1e-17, None, 0.5), F32_CANCELLING * 0.5);
        assert_eq!(bound(0.0, None, 0.0), 0.0);
    }
}
