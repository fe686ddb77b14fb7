/// What can be wrong with a request to render.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A setting lies outside its range.
    #[error("render setting {name} is {found}, expected {expected}")]
    Setting {
        /// Field of [`RenderSettings`](crate::RenderSettings).
        name: &'static str,
        /// The value given.
        found: f32,
        /// The range.
        expected: &'static str,
    },
    /// The lists of Gaussians per tile would not fit into memory.
    #[error(
        "the Gaussians touch {found} tiles in all, more than {limit}: render fewer or smaller Gaussians, \
         or a smaller image"
    )]
    TooManyIntersections {
        /// Pairs of a Gaussian and a tile that it touches.
        found: u64,
        /// The most that are accepted.
        limit: u64,
    },
    /// The picture could not be made.
    #[error(transparent)]
    Scene(#[from] gs_scene::Error),
}

/// The result of this crate's operations.
pub type Result<T> = std::result::Result<T, Error>;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn messages_say_what_was_expected() {
        let setting = Error::Setting { name: "near", found: -1.0, expected: "a finite number of at least 0" };
        assert_eq!(setting.to_string(), "render setting near is -1, expected a finite number of at least 0");
        let many = Error::TooManyIntersections { found: 5, limit: 4 };
        assert_eq!(
            many.to_string(),
            "the Gaussians touch 5 tiles in all, more than 4: render fewer or smaller Gaussians, or a smaller image"
        );
    }
}
