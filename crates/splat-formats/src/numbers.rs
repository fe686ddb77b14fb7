//! Numbers of a Gaussian as the formats store them, and what a Gaussian may hold.

use crate::error::Fault;
use crate::{Quantity, Rule};
use gs_scene::{Gaussians, LOG_SCALE, MEAN, OPACITY_LOGIT, QUATERNION, sigmoid};
use std::io::Read;

/// A Gaussian's numbers.
#[derive(Clone, Copy)]
pub(crate) struct Row<'a> {
    pub(crate) mean: [f32; 3],
    /// (w, x, y, z), of length 1.
    pub(crate) quaternion: [f64; 4],
    pub(crate) log_scale: [f32; 3],
    pub(crate) opacity: f32,
    /// `[(degree+1)², 3]`.
    pub(crate) sh: &'a [f32],
}

fn part<const N: usize>(row: &[f32], from: usize) -> [f32; N] {
    std::array::from_fn(|i| row[from + i])
}

/// The Gaussians, quaternions normalised and opacities activated.
pub(crate) fn rows(gaussians: &Gaussians) -> impl ExactSizeIterator<Item = Row<'_>> {
    (0..gaussians.len()).map(|i| row(gaussians, i))
}

/// One Gaussian.
pub(crate) fn row(gaussians: &Gaussians, index: usize) -> Row<'_> {
    let geometry = &gaussians.geometry()[index * Gaussians::GEOMETRY..][..Gaussians::GEOMETRY];
    let width = gaussians.sh().len() / gaussians.len().max(1);
    let quaternion = part::<4>(geometry, QUATERNION.start).map(f64::from);
    let norm = quaternion.iter().map(|q| q * q).sum::<f64>().sqrt();
    Row {
        mean: part(geometry, MEAN.start),
        quaternion: quaternion.map(|q| q / norm),
        log_scale: part(geometry, LOG_SCALE.start),
        opacity: sigmoid(geometry[OPACITY_LOGIT]),
        sh: &gaussians.sh()[index * width..][..width],
    }
}

/// Largest log-scale: its standard deviation is still a finite f32.
const LARGEST_LOG_SCALE: f32 = 88.0;

/// What every format but PLY expects of a scene. Opacities of exactly 0 and 1, and sizes of 0, are infinite logits and
/// logarithms, and can be stored.
pub(crate) fn check(gaussians: &Gaussians) -> Result<(), Rule> {
    if gaussians.is_empty() {
        return Err(Rule::Empty);
    }
    for (gaussian, row) in rows(gaussians).enumerate() {
        let wrong = |quantity, found: f32, expected| {
            Err(Rule::Value { gaussian, quantity, found: found.into(), expected })
        };
        if let Some(&found) = row.mean.iter().find(|value| !value.is_finite()) {
            return wrong(Quantity::Position, found, "a finite number");
        }
        // Zero, NaN and infinity all give NaN when they are normalised.
        if let Some(&found) = row.quaternion.iter().find(|value| !value.is_finite()) {
            return wrong(Quantity::Rotation, found as f32, "a finite quaternion that is not zero");
        }
        if let Some(&found) = row.log_scale.iter().find(|&&value| value.is_nan() || value > LARGEST_LOG_SCALE)
        {
            return wrong(Quantity::Size, found, "a logarithm of at most 88");
        }
        if row.opacity.is_nan() {
            return wrong(Quantity::Opacity, row.opacity, "a number");
        }
        if let Some(i) = row.sh.iter().position(|value| !value.is_finite()) {
            let quantity = if i < 3 { Quantity::Colour } else { Quantity::Sh };
            return wrong(quantity, row.sh[i], "a finite number");
        }
    }
    Ok(())
}

/// Gaussians of buffers that a decoder has filled row by row.
pub(crate) fn gaussians(degree: usize, geometry: Vec<f32>, sh: Vec<f32>) -> Gaussians {
    Gaussians::new(degree, geometry, sh).expect("a decoder fills both buffers by whole rows of one degree")
}

/// Reads `count` rows of `width` bytes; memory grows with what is there.
pub(crate) fn read_rows(
    reader: &mut impl Read,
    what: &'static str,
    count: u64,
    width: usize,
) -> Result<Vec<u8>, Fault> {
    let promised = u128::from(count) * width as u128;
    let mut bytes = Vec::new();
    // More than 2^64 bytes are never there.
    reader.take(u64::try_from(promised).unwrap_or(u64::MAX)).read_to_end(&mut bytes)?;
    if (bytes.len() as u128) < promised {
        let found = (bytes.len() / width) as u64;
        return Err(Rule::Truncated { what, promised: count, found }.into());
    }
    Ok(bytes)
}

/// A share of 1 as a whole number up to `most`, rounded to the nearest; what is out of range is clipped.
pub(crate) fn unorm(share: f64, most: u32) -> u32 {
    (share * f64::from(most)).round().clamp(0.0, f64::from(most)) as u32
}

/// The same as a byte.
pub(crate) fn byte(share: f64) -> u8 {
    unorm(share, 255) as u8
}

/// The logit of an opacity that is one of `steps` + 1 equal steps from 0 to 1. The first and last step are half as wide as
/// the others, and stand for their middle, so the logit is finite.
pub(crate) fn step_logit(step: u32, steps: u32) -> f32 {
    let most = f64::from(steps);
    let share = f64::from(step).clamp(0.25, most - 0.25) / most;
    (share / (1.0 - share)).ln() as f32
}

/// The logit of an opacity that is stored as f32: finite for 0 and 1, too, which rounding may have made.
pub(crate) fn logit(opacity: f32) -> f32 {
    // 1 - 2⁻²⁶ is the middle between 1 and the last number that is rounded to it.
    let share = f64::from(opacity).clamp(f64::from(f32::MIN_POSITIVE), 1.0 - 2_f64.powi(-26));
    (share / (1.0 - share)).ln() as f32
}

/// The logarithm of a size that is stored as f32: finite for 0, too, which the renderer could not draw otherwise.
pub(crate) fn log_size(size: f32) -> f32 {
    size.max(f32::MIN_POSITIVE).ln()
}

/// A colour channel of the constant SH coefficient, as f64.
pub(crate) fn colour(dc: f32) -> f64 {
    0.5 + f64::from(gs_scene::SH_C0) * f64::from(dc)
}

/// The constant SH coefficient of a colour channel.
pub(crate) fn dc(colour: f64) -> f32 {
    ((colour - 0.5) / f64::from(gs_scene::SH_C0)) as f32
}

/// The index of the component of largest magnitude, the first of equal ones, and the other three with the sign that makes it positive.
pub(crate) fn smallest_three(quaternion: [f64; 4]) -> (usize, [f64; 3]) {
    let mut largest = 0;
    for i in 1..4 {
        if quaternion[i].abs() > quaternion[largest].abs() {
            largest = i;
        }
    }
    let sign = if quaternion[largest] < 0.0 { -1.0 } else { 1.0 };
    let mut others = (0..4).filter(|&i| i != largest);
    (largest, std::array::from_fn(|_| sign * quaternion[others.next().unwrap_or(largest)]))
}

/// The quaternion of an index and the three other components. Three that are too long for a quaternion of length 1 leave 0.
pub(crate) fn from_smallest_three(largest: usize, others: [f64; 3]) -> [f32; 4] {
    let rest = (1.0 - others.iter().map(|q| q * q).sum::<f64>()).max(0.0).sqrt();
    let mut others = others.into_iter();
    std::array::from_fn(|i| if i == largest { rest } else { others.next().unwrap_or(rest) } as f32)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ends_of_an_opacity_are_finite_and_keep_their_step() {
        for step in 0..=255 {
            let logit = step_logit(step, 255);
            assert!(logit.is_finite());
            assert_eq!(u32::from(byte(sigmoid(logit).into())), step);
        }
        assert!(logit(0.0).is_finite() && logit(1.0).is_finite());
        assert_eq!((sigmoid(logit(1.0)), log_size(0.0).exp()), (1.0, 0.0_f32.max(log_size(0.0).exp())));
    }

    #[test]
    fn the_largest_component_is_found_again() {
        for largest in 0..4 {
            let mut quaternion = [0.1, -0.2, 0.3, 0.05];
            quaternion[largest] = -0.9;
            let norm = quaternion.iter().map(|q: &f64| q * q).sum::<f64>().sqrt();
            let quaternion = quaternion.map(|q| q / norm);
            let (found, others) = smallest_three(quaternion);
            assert_eq!(found, largest);
            let back = from_smallest_three(found, others);
            assert!(back.iter().zip(quaternion).all(|(a, b)| (f64::from(*a) + b).abs() < 1e-6), "{back:?}");
        }
    }
}
