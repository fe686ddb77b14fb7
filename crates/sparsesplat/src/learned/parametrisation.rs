use serde::{Deserialize, Serialize};

/// What the outputs of a head mean.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Parametrisation {
    /// Changes of the closed-form Gaussian, which has the colour, size and place of its anchor.
    #[default]
    Correction,
    /// All attributes, as in the paper: changes of a grey, half transparent ball at the anchor that is the same for all anchors, but for its
    /// unit of length, the anchor's spacing.
    Paper,
}

impl Parametrisation {
    /// Its name in the metadata of weights.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Correction => "correction",
            Self::Paper => "paper",
        }
    }

    /// The parametrisation of that name.
    #[must_use]
    pub fn of_name(name: &str) -> Option<Self> {
        [Self::Correction, Self::Paper].into_iter().find(|one| one.name() == name)
    }
}
