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
        /// `first` or `second`.
        picture: &'static str,
        /// Column of the pixel.
        x: usize,
        /// Row of the pixel.
        y: usize,
    },
}

/// The result of this crate's operations.
pub type Result<T> = std::result::Result<T, Error>;
