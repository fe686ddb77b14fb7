/// Why there is no map or no sample.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A picture without pixels, or with more than an index can name.
    #[error("size is {width}x{height}, expected at least one pixel and at most 2^31")]
    Size {
        /// Pixels per row.
        width: usize,
        /// Rows.
        height: usize,
    },
    /// A buffer does not fit the size.
    #[error("{what} holds {found} numbers, expected {expected}")]
    Length {
        /// Which buffer.
        what: &'static str,
        /// Numbers needed by the size.
        expected: usize,
        /// Numbers given.
        found: usize,
    },
    /// An importance or a weight outside 0..1.
    #[error("{what} of pixel {pixel} is {found}, expected a number from 0 to 1")]
    Range {
        /// `importance` or `weight`.
        what: &'static str,
        /// Index of the first such pixel.
        pixel: usize,
        /// Its value.
        found: f32,
    },
    /// A window without a middle.
    #[error(
        "entropy window is {found} pixels wide, expected an odd number from 1 to {}",
        crate::EntropyWindow::MAX_SIZE
    )]
    WindowSize {
        /// The size given.
        found: usize,
    },
    /// A number of grey levels that 8 bits cannot hold.
    #[error("{found} grey levels, expected 2 to 256")]
    Levels {
        /// The number given.
        found: usize,
    },
    /// No maps at all.
    #[error("no importance maps, expected one per view")]
    NoMaps,
    /// Every pixel of every view has weight 0.
    #[error("every pixel has weight 0: there is nothing to sample")]
    NoUsablePixel,
    /// A budget of nothing.
    #[error("budget is 0 pixels, expected at least 1")]
    EmptyBudget,
    /// Budgets per view that do not fit the views.
    #[error("{found} counts, expected one for each of {expected} maps")]
    Counts {
        /// The number of maps.
        expected: usize,
        /// The number of counts.
        found: usize,
    },
    /// An expected count that is no count.
    #[error("expected count is {found}, it must be a finite number above 0")]
    ExpectedCount {
        /// The count given.
        found: f64,
    },
    /// A tau that is no factor.
    #[error("tau is {found}, expected a finite number above 0")]
    Tau {
        /// The value given.
        found: f64,
    },
}

/// This crate's result.
pub type Result<T> = std::result::Result<T, Error>;
