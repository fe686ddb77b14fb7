//! What the network behind the sweep is trained on.

use super::cases::UNKNOWN;
use depth_backbone::{Decoded, Inputs};

/// Errors below this, plane steps, weigh by their size; larger ones by its logarithm, so that gross errors, which nothing in the views
/// may resolve, do not take the gradient …
pub(super) const KNEE: f32 = 0.5;
/// … but for this share of their size.
const FLOOR: f32 = 0.05;
/// Weight of the likelihood of the expected error (Laplace), and of that of sky.
const LIKELIHOOD: f32 = 0.3;
const SKY: f32 = 0.3;

/// Mean loss over a view's pixels, and its gradient. `exact` is NaN where there is no surface, [`UNKNOWN`] where nobody knows it.
pub(crate) fn loss(inputs: &Inputs, decoded: &Decoded, exact: &[f32]) -> (f64, Decoded) {
    let (n, width) = (exact.len(), inputs.size().0);
    let share = 1.0 / n as f32;
    let mut sum = 0.0_f64;
    let mut gradient =
        Decoded { correction: vec![0.0; n], log_error: vec![0.0; n], sky: vec![0.0; decoded.sky.len()] };
    let half = width.div_ceil(2);
    let mut empty = vec![0_u8; decoded.sky.len()];
    let mut solid = empty.clone();
    for (i, &exact) in exact.iter().enumerate() {
        let block = i / width / 2 * half + i % width / 2;
        if exact.is_nan() {
            empty[block] += 1;
            continue;
        }
        if exact == UNKNOWN {
            continue;
        }
        solid[block] += 1;
        let error = inputs.stereo()[i] + decoded.correction[i] - exact;
        let size = error.abs();
        sum += f64::from((1.0 + size / KNEE).ln() + FLOOR * size);
        gradient.correction[i] = share * error.signum() * (1.0 / (KNEE + size) + FLOOR);
        // The expected error learns from the error, and not the other way round.
        let log_error = decoded.log_error[i];
        let relative = size * (-log_error).exp();
        sum += f64::from(LIKELIHOOD * (relative + log_error));
        gradient.log_error[i] = share * LIKELIHOOD * (1.0 - relative);
    }
    for (i, &logit) in decoded.sky.iter().enumerate() {
        let is_sky = match (empty[i], solid[i]) {
            (1.., 0) => 1.0,
            (0, 1..) => 0.0,
            _ => continue,
        };
        let weight = SKY * 4.0;
        let probability = 1.0 / (1.0 + (-logit).exp());
        sum += f64::from(weight * (logit.max(0.0) - logit * is_sky + (-logit.abs()).exp().ln_1p()));
        gradient.sky[i] = share * weight * (probability - is_sky);
    }
    (sum / n as f64, gradient)
}

#[cfg(test)]
mod tests {
    use super::*;
    use depth_backbone::InputParts;

    #[test]
    fn gradients_equal_finite_differences() {
        let size = (4, 2);
        let blocks = vec![0.0; 2 * Inputs::CHANNELS];
        let stereo = vec![3.0, 5.0, 7.0, 9.0, 4.0, 6.0, 8.0, 10.0];
        let inputs = Inputs::of_parts(InputParts {
            size,
            blocks,
            base: vec![3.0, 7.0],
            own: stereo,
            unit: [0.1, 0.01],
        });
        let exact = [3.2, UNKNOWN, f32::NAN, f32::NAN, 30.0, 6.4, f32::NAN, f32::NAN];
        let decoded = Decoded {
            correction: vec![0.5, -0.7, 0.1, 0.0, 1.0, -2.0, 0.3, 0.2],
            log_error: vec![0.2, -0.4, 0.0, 0.1, 1.0, 0.6, 0.0, 0.0],
            sky: vec![-0.3, 0.8],
        };
        let value = |decoded: &Decoded| loss(&inputs, decoded, &exact).0;
        let gradient = loss(&inputs, &decoded, &exact).1;
        let check = |expected: f32, change: &dyn Fn(&mut Decoded, f32)| {
            let moved = |by: f32| {
                let mut decoded = decoded.clone();
                change(&mut decoded, by);
                value(&decoded)
            };
            let found = (moved(1e-2) - moved(-1e-2)) / 2e-2;
            assert!((found - f64::from(expected)).abs() < 1e-3, "{found} {expected}");
        };
        for (i, exact) in exact.iter().enumerate() {
            // The likelihood depends on the error as well, but the error does not learn from it.
            let error = inputs.stereo()[i] + decoded.correction[i] - exact;
            let of_likelihood = LIKELIHOOD * error.signum() * (-decoded.log_error[i]).exp() / 8.0;
            let of_likelihood = if exact.is_nan() || *exact == UNKNOWN { 0.0 } else { of_likelihood };
            check(gradient.correction[i] + of_likelihood, &|d, by| d.correction[i] += by);
        }
        for i in 0..2 {
            check(gradient.sky[i], &|d, by| d.sky[i] += by);
        }
        for i in [0, 1, 4, 5] {
            check(gradient.log_error[i], &|d, by| d.log_error[i] += by);
        }
    }
}
