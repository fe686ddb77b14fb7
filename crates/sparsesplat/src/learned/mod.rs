//! The learned head: its inputs for each anchor, and the decoding of its outputs.

mod corrector;
mod decode;
mod feedback;
mod grid;
mod head;
mod history;
mod inputs;
mod parametrisation;
mod rotate_sh;
mod support;

pub use corrector::Corrector;
pub(crate) use corrector::CorrectorWeights;
pub use decode::{BOUNDS, BY_DIRECTION, Decoder};
pub(crate) use head::HeadWeights;
pub use head::{COVISIBLE, FEATURES, LearnedHead, PARAMETRISATION};
pub(crate) use history::History;
pub use inputs::{HeadInputs, corrector_features, geometry_features, image_features};
pub use parametrisation::Parametrisation;

use crate::{Anchored, Result};
use attn_head::Kind;
use depth_backbone::ViewGeometry;

impl Anchored {
    /// What rendering the closed form (of a refined scene its Gaussians) into the views says of each anchor: `[n, 24]`, or nothing where it is not `wanted`.
    ///
    /// # Errors
    /// If the closed form cannot be rendered.
    pub fn feedback(&self, wanted: bool) -> Result<Vec<f32>> {
        if wanted { feedback::feedback(self, &self.views) } else { Ok(Vec::new()) }
    }

    /// What a head of a kind sees of these anchors; `geometry` is what they were made from, with features. `feedback` is
    /// [`feedback`](Self::feedback), which is empty for a head that does without.
    #[must_use]
    pub fn inputs(&self, kind: Kind, geometry: &[ViewGeometry], feedback: &[f32]) -> HeadInputs {
        HeadInputs::new(self, &self.views, geometry, feedback, kind)
    }

    /// What turns a head's outputs for these anchors into Gaussians.
    #[must_use]
    pub fn decoder(&self, parametrisation: Parametrisation) -> Decoder {
        let cameras: Vec<_> = self.views.iter().map(|view| *view.camera()).collect();
        let (spacing, views) = (self.spacing.clone(), self.anchors.views.clone());
        match parametrisation {
            Parametrisation::Correction => Decoder::new(self.base.clone(), spacing, views, &cameras),
            Parametrisation::Paper => {
                Decoder::of_grey_balls(&self.anchors.positions, spacing, views, &cameras)
            }
        }
    }
}
