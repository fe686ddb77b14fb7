/// Why there are no neighbours.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A coordinate is NaN or infinite: distances to that point are not defined.
    #[error(
        "{set} {index} is ({}, {}, {}), expected finite coordinates: drop or mend it first",
        found[0], found[1], found[2]
    )]
    NotFinite {
        /// `point` or `query`.
        set: &'static str,
        /// Index of the first such point.
        index: usize,
        /// Its coordinates.
        found: [f32; 3],
    },
    /// More points than a 32-bit index can name.
    #[error("{found} points, expected at most {}: split the set", u32::MAX - 1)]
    TooMany {
        /// Points given.
        found: usize,
    },
}

/// This crate's result.
pub type Result<T> = std::result::Result<T, Error>;

/// All coordinates finite, and indices that fit 32 bits.
pub(crate) fn check(set: &'static str, points: &[[f32; 3]]) -> Result<()> {
    if points.len() >= u32::MAX as usize {
        return Err(Error::TooMany { found: points.len() });
    }
    match points.iter().position(|p| !p.iter().all(|c| c.is_finite())) {
        Some(index) => Err(Error::NotFinite { set, index, found: points[index] }),
        None => Ok(()),
    }
}
