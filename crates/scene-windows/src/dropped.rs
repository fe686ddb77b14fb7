//! What is left out, with its reason.

use serde::{Deserialize, Serialize};

/// A window that gave no figures.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Dropped {
    /// `scene/window`, or the folder that could not be read.
    pub name: String,
    /// Why.
    pub reason: String,
    /// Whether something failed. An index that leaves a scene out by itself is no failure.
    pub failed: bool,
}

impl Dropped {
    /// A window or folder that was given up, with the error and its causes as the reason.
    #[must_use]
    pub fn new(name: &str, error: &dyn std::error::Error) -> Self {
        let causes = std::iter::successors(Some(error), |error| error.source());
        let reason = causes.map(ToString::to_string).collect::<Vec<_>>().join(": ");
        Self { name: name.to_owned(), reason, failed: true }
    }
}
