//! Which windows there are, and how each is loaded.

use crate::simulated::simulated_window;
use crate::{Result, Window};
use sparsesplat::DepthRange;

/// A window that is known by name and not yet loaded.
#[derive(Debug, Clone)]
pub struct Plan {
    name: String,
    source: Source,
}

#[derive(Debug, Clone)]
enum Source {
    Simulated { size: (usize, usize) },
}

impl Plan {
    /// The simulated demonstration.
    #[must_use]
    pub fn simulated(size: (usize, usize)) -> Self {
        Self { name: crate::simulated::NAME.to_owned(), source: Source::Simulated { size } }
    }

    /// `scene/window`.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Loads the views.
    ///
    /// # Errors
    /// If a file is missing or wrong.
    pub fn load(&self) -> Result<Window> {
        match &self.source {
            Source::Simulated { size } => simulated_window(*size),
        }
    }

    /// The depth range to use: the data set's hint where the plan is to use it, else `asked`.
    #[must_use]
    pub fn depth_range(&self, asked: DepthRange) -> DepthRange {
        match self.source {
            Source::Simulated { .. } => asked,
        }
    }
}
