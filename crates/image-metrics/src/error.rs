/// Why two pictures cannot be compared.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// The pictures differ in size.
    #[error(
        "the first picture is {expected_width}x{expected_height}, the second {found_width}x{found_height}, expected equal sizes"
    )]
    SizeMismatch {
        /// Width of the first picture.
        expected_width: usize,
        /// Height of the first picture.
        expected_height: usize,
        /// Width of the second.
        found_width: usize,
        /// Height of the second.
        found_height: usize,
    },
    /// A picture is smaller than the window of the measure.
    #[error("the pictures are {width}x{height}, expected at least {minimum}x{minimum}")]
    TooSmall {
        /// Pixels per row.
        width: usize,
        /// Rows.
        height: usize,
        /// Side of the window, pixels.
        minimum: usize,
    },
    /// A picture holds a NaN or an infinity.
    #[error("the {picture} picture is not finite in column {x}, row {y}")]
    NotFinite {
        /// `first`, `second`, `fitted` or `target`.
        picture: &'static str,
        /// Column of the pixel.
        x: usize,
        /// Row of the pixel.
        y: usize,
    },
    /// A value is too large to be compared in f32.
    #[error("the {picture} picture is beyond ±{limit} in column {x}, row {y}")]
    OutOfRange {
        /// `fitted` or `target`.
        picture: &'static str,
        /// Column of the pixel.
        x: usize,
        /// Row of the pixel.
        y: usize,
        /// Largest magnitude.
        limit: u32,
    },
    /// A slice does not fit the size of the picture.
    #[error(
        "the {picture} picture has {found} values, expected {expected} for {width}x{height} in three channels"
    )]
    Length {
        /// `first`, `second`, `fitted` or `target`.
        picture: &'static str,
        /// Pixels per row.
        width: usize,
        /// Rows.
        height: usize,
        /// Values of such a picture.
        expected: usize,
        /// Length of the slice.
        found: usize,
    },
    /// A gradient does not fit its picture.
    #[error("the gradient has {found} values, expected {expected}, as many as the picture")]
    GradientLength {
        /// Values of the picture.
        expected: usize,
        /// Length of the slice.
        found: usize,
    },
}

/// The result of this crate's operations.
pub type Result<T> = std::result::Result<T, Error>;
