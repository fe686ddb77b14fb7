//! The corrector: a second head, which looks once at a scene after its gradient steps, those of further looks or of a refinement.
//!
//! Gradient steps follow the photographs alone. The corrector has learned from held-out views what such steps get wrong, and corrects the
//! scene as the first head corrects the closed form (docs/refine.md). The paper has neither.

use super::feedback::feedback;
use super::{LearnedHead, Parametrisation};
use crate::harmonics::DEGREE;
use crate::{Anchored, Config, Correction, Error, Exposure, ExposureGain, Result};
use attn_head::Weights;
use depth_backbone::ViewGeometry;
use gs_scene::{Gaussians, View};
use std::path::PathBuf;
use std::sync::Arc;

/// Weights for the plane sweep's features, and what reports call them; docs/training.md says how they came about.
const DEFAULT: (&[u8], &str) =
    (include_bytes!("../../weights/refined-grid-1.safetensors"), "corrector (refined-grid-1)");

/// A head with the anchors of a scene, which it corrects.
#[derive(Debug, Clone)]
pub struct Corrector {
    head: Arc<LearnedHead>,
    anchored: Anchored,
    /// The scene after the last look.
    before: Gaussians,
    /// Of the views, without features: the anchors have theirs.
    geometry: Vec<ViewGeometry>,
    /// What brings each view from the exposure of the scene into the common one.
    exposure: Vec<ExposureGain>,
}

impl Corrector {
    /// For a scene `before` any refinement, which was made of the anchors of views with this geometry.
    ///
    /// # Errors
    /// If the weights were trained on other features.
    pub(crate) fn new(
        head: Arc<LearnedHead>,
        mut anchored: Anchored,
        before: Gaussians,
        (with_features, geometry): (&[ViewGeometry], Vec<ViewGeometry>),
        exposure: Exposure,
    ) -> Result<Self> {
        head.check_features(with_features)?;
        // Neighbours by co-visibility are the first head's.
        anchored.gathered = None;
        let exposure = match exposure {
            Exposure::AsPhotographed => anchored.exposure.clone(),
            Exposure::Common => vec![ExposureGain::NONE; anchored.views.len()],
        };
        Ok(Self { head, anchored, before, geometry, exposure })
    }

    /// What reports call it.
    #[must_use]
    pub fn name(&self) -> &str {
        self.head.name()
    }

    /// The scene, refined or not, corrected; as it is if there are no anchors. `views` are those that the scene was made of, in its exposure, with their
    /// cameras after the refinement. The shell stays as it is.
    ///
    /// # Errors
    /// If colours have an SH degree above 2, or the scene cannot be rendered.
    ///
    /// # Panics
    /// If Gaussians or views are missing: pruning comes after this.
    pub fn corrected(self, refined: Gaussians, views: &[View]) -> Result<Gaussians> {
        if self.anchored.base.is_empty() {
            return Ok(refined);
        }
        if refined.sh_degree() > DEGREE {
            return Err(Error::CorrectedColours { found: refined.sh_degree() });
        }
        let scene = self.anchored.refined(&self.before, &refined, self.exposure)?;
        drop((self.before, refined));
        let feedback = feedback(&scene, views)?;
        let outputs = self.head.run(&scene.inputs(self.head.kind(), &self.geometry, &feedback))?;
        let mut corrected = scene.decoder(Parametrisation::Correction).decode(&outputs);
        corrected.append(&scene.shell);
        Ok(corrected)
    }
}

/// Where the weights of a corrector come from.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum CorrectorWeights {
    /// This crate's.
    Default,
    File(PathBuf),
}

impl CorrectorWeights {
    /// Those that the configuration asks for; the default has none for what it was not trained on.
    pub(crate) fn chosen(config: &Config) -> Option<Self> {
        match &config.correction {
            Correction::Off => None,
            Correction::Weights(path) => Some(Self::File(path.clone())),
            Correction::Default => config.has_corrector().then_some(Self::Default),
        }
    }

    /// The corrector with them.
    pub(crate) fn read(&self) -> Result<LearnedHead> {
        match self {
            Self::Default => LearnedHead::corrector(Weights::from_bytes(DEFAULT.0)?, DEFAULT.1),
            Self::File(path) => LearnedHead::corrector(Weights::read(path)?, path.display().to_string()),
        }
    }
}
