/// Why there are no outputs.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// An input has another length than the number of anchors and the configuration ask for.
    #[error("{what}: {found} numbers, expected {expected}")]
    Length {
        /// Which input.
        what: &'static str,
        /// Numbers that the shape asks for.
        expected: usize,
        /// Numbers given.
        found: usize,
    },
    /// A neighbour that does not exist.
    #[error("anchor {anchor} has neighbour {found}, expected an index below {n}")]
    Neighbour {
        /// Whose neighbour.
        anchor: usize,
        /// Its index.
        found: u32,
        /// Number of anchors.
        n: usize,
    },
}

/// This crate's result.
pub type Result<T> = std::result::Result<T, Error>;
