//! Comparators: the difference between two buffers, or why they cannot be compared.

use std::fmt;

/// How far two buffers lie apart.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Deviation {
    /// Largest absolute difference.
    pub max_abs: f64,
    /// Where it is.
    pub worst: usize,
    /// Largest magnitude that was expected.
    pub largest: f64,
    /// ‖found - expected‖ / ‖expected‖ (the numerator alone where nothing but zero is expected).
    pub relative_l2: f64,
    /// Cosine of the angle between the two as vectors: 1 if both are 0, 0 if one is.
    pub cosine: f64,
}

/// Why two buffers cannot be compared, or differ where they must not.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub enum Mismatch {
    /// The buffers differ in length, or the mask does not divide it.
    Length {
        /// Length expected.
        expected: usize,
        /// Length found.
        found: usize,
    },
    /// A number is NaN or infinite, masked or not.
    NotFinite {
        /// `expected` or `found`.
        buffer: &'static str,
        /// Where.
        index: usize,
    },
    /// Every number is masked, or there is none: a comparison that could not fail.
    NothingCompared,
    /// Whole numbers differ.
    Differs {
        /// Where.
        index: usize,
        /// Number expected.
        expected: i32,
        /// Number found.
        found: i32,
    },
}

impl fmt::Display for Mismatch {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        match self {
            Self::Length { expected, found } => write!(f, "{found} numbers, expected {expected}"),
            Self::NotFinite { buffer, index } => write!(f, "{buffer} number {index} is not finite"),
            Self::NothingCompared => write!(f, "nothing to compare"),
            Self::Differs { index, expected, found } => {
                write!(f, "number {index} is {found}, expected {expected}")
            }
        }
    }
}

impl std::error::Error for Mismatch {}

/// Compares two buffers number by number, without those whose pixel is set in `masked`: entry i of the mask covers
/// the `expected.len() / masked.len()` numbers of pixel i. An empty mask covers nothing.
///
/// # Errors
/// If lengths do not fit, a number of either buffer is not finite, or nothing is left to compare.
pub fn compare(
    expected: impl IntoIterator<Item = impl Into<f64>>,
    found: impl IntoIterator<Item = impl Into<f64>>,
    masked: &[bool],
) -> Result<Deviation, Mismatch> {
    let expected: Vec<f64> = expected.into_iter().map(Into::into).collect();
    let found: Vec<f64> = found.into_iter().map(Into::into).collect();
    if found.len() != expected.len() {
        return Err(Mismatch::Length { expected: expected.len(), found: found.len() });
    }
    if !masked.is_empty() && !expected.len().is_multiple_of(masked.len()) {
        return Err(Mismatch::Length { expected: expected.len(), found: masked.len() });
    }
    for (buffer, numbers) in [("expected", &expected), ("found", &found)] {
        if let Some(index) = numbers.iter().position(|number| !number.is_finite()) {
            return Err(Mismatch::NotFinite { buffer, index });
        }
    }
    let channels = expected.len() / masked.len().max(1);
    let mut deviation = Deviation { max_abs: 0.0, worst: 0, largest: 0.0, relative_l2: 0.0, cosine: 0.0 };
    let (mut compared, mut error) = (0usize, 0.0);
    let (mut norm, mut norm_found, mut dot) = (0.0, 0.0, 0.0);
    for (index, (expected, found)) in expected.iter().zip(&found).enumerate() {
        if !masked.is_empty() && masked[index / channels] {
            continue;
        }
        let difference = (found - expected).abs();
        if difference > deviation.max_abs {
            (deviation.max_abs, deviation.worst) = (difference, index);
        }
        deviation.largest = deviation.largest.max(expected.abs());
        compared += 1;
        error += difference * difference;
        norm += expected * expected;
        norm_found += found * found;
        dot += expected * found;
    }
    if compared == 0 {
        return Err(Mismatch::NothingCompared);
    }
    deviation.relative_l2 = if norm > 0.0 { (error / norm).sqrt() } else { error.sqrt() };
    deviation.cosine = match (norm > 0.0, norm_found > 0.0) {
        // One square root each: the product of squares could underflow.
        (true, true) => dot / (norm.sqrt() * norm_found.sqrt()),
        (false, false) => 1.0,
        _ => 0.0,
    };
    Ok(deviation)
}

/// As [`compare`] without a mask, each pair of numbers divided by max(1, |expected|) first.
///
/// # Errors
/// As [`compare`].
pub fn compare_to_size(expected: &[f64], found: &[f64]) -> Result<Deviation, Mismatch> {
    let sizes = expected.iter().map(|value| value.abs().max(1.0));
    let of_found = sizes.clone().chain(std::iter::repeat(1.0));
    let scaled = |(value, size): (&f64, f64)| value / size;
    compare(expected.iter().zip(sizes).map(scaled), found.iter().zip(of_found).map(scaled), &[])
}

/// Whether two buffers of whole numbers are equal.
///
/// # Errors
/// If their lengths differ, they are empty, or a number differs.
pub fn compare_exactly(expected: &[i32], found: &[i32]) -> Result<(), Mismatch> {
    if expected.len() != found.len() {
        return Err(Mismatch::Length { expected: expected.len(), found: found.len() });
    }
    if expected.is_empty() {
        return Err(Mismatch::NothingCompared);
    }
    match expected.iter().zip(found).position(|(expected, found)| expected != found) {
        Some(index) => Err(Mismatch::Differs { index, expected: expected[index], found: found[index] }),
        None => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn deviations_are_measured_outside_the_mask() {
        let expected = [1.0, -2.0, 3.0, 4.0];
        let found = [1.0, -2.5, 9.0, 9.0];
        let deviation = compare(expected, found, &[false, true]).unwrap();
        assert_eq!((deviation.max_abs, deviation.worst, deviation.largest), (0.5, 1, 2.0));
        assert!((deviation.relative_l2 - 0.5 / 5.0f64.sqrt()).abs() < crate::tolerance::ROUNDING_F64);
        let all = compare(expected, found, &[]).unwrap();
        assert_eq!((all.max_abs, all.worst), (6.0, 2));
        assert_eq!(compare([0.0; 2], [3.0, 4.0], &[]).unwrap().relative_l2, 5.0);
    }

    #[test]
    fn cosines_tell_directions() {
        let cosine = |found: [f64; 2]| compare([3.0, 4.0], found, &[]).unwrap().cosine;
        let expected = [([6.0, 8.0], 1.0), ([-3.0, -4.0], -1.0), ([4.0, -3.0], 0.0), ([0.0, 0.0], 0.0)];
        for (found, expected) in expected {
            assert!((cosine(found) - expected).abs() < crate::tolerance::ROUNDING_F64);
        }
        assert_eq!(compare([0.0; 2], [0.0; 2], &[]).unwrap().cosine, 1.0);
        assert_eq!(compare([0.0; 2], [1.0; 2], &[]).unwrap().cosine, 0.0);
        // What is masked does not turn the vector.
        assert_eq!(compare([3.0, 4.0], [3.0, -9.0], &[false, true]).unwrap().cosine, 1.0);
    }

    #[test]
    fn large_numbers_are_compared_relative_to_themselves_small_ones_to_one() {
        let deviation = compare_to_size(&[1e4, 0.5], &[1e4 + 1.0, 0.5 + 1e-5]).unwrap();
        assert!((deviation.max_abs - 1e-4).abs() < 1e-9 && deviation.worst == 0, "{deviation:?}");
        assert_eq!(compare_to_size(&[1.0], &[]), Err(Mismatch::Length { expected: 1, found: 0 }));
        assert_eq!(compare_to_size(&[1.0], &[1.0, 2.0]), Err(Mismatch::Length { expected: 1, found: 2 }));
    }

    #[test]
    fn what_cannot_be_compared_is_refused() {
        let (none, ones) = ([0.0f64; 0], [1.0f64; 2]);
        assert_eq!(compare(ones, [1.0f64], &[]), Err(Mismatch::Length { expected: 2, found: 1 }));
        assert_eq!(compare(ones, ones, &[false; 3]), Err(Mismatch::Length { expected: 2, found: 3 }));
        assert_eq!(compare(none, none, &[]), Err(Mismatch::NothingCompared));
        assert_eq!(compare(ones, ones, &[true, true]), Err(Mismatch::NothingCompared));
        for bad in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
            let not_finite = |buffer| Err(Mismatch::NotFinite { buffer, index: 1 });
            // A mask does not hide a number that is not finite.
            assert_eq!(compare(ones, [1.0, bad], &[false, true]), not_finite("found"));
            assert_eq!(compare([1.0, bad], ones, &[]), not_finite("expected"));
        }
    }

    #[test]
    fn whole_numbers_must_be_equal() {
        assert_eq!(compare_exactly(&[1, 2], &[1, 2]), Ok(()));
        assert_eq!(compare_exactly(&[], &[]), Err(Mismatch::NothingCompared));
        assert_eq!(compare_exactly(&[1], &[]), Err(Mismatch::Length { expected: 1, found: 0 }));
        let differs = compare_exactly(&[1, 2], &[1, 3]).unwrap_err();
        assert_eq!(differs.to_string(), "number 1 is 3, expected 2");
    }
}
