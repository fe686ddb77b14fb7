//! Weights and the features they work with.

use super::{HeadInputs, Parametrisation, corrector_features, geometry_features, image_features};
use crate::{Anchored, Backbone, Config, Error, Result, Stage, Stages};
use attn_head::{Head, Kind, Weights};
use depth_backbone::ViewGeometry;
use gs_scene::Gaussians;
use std::path::{Path, PathBuf};

/// Where weights say which features they were trained on.
pub const FEATURES: &str = "features";
/// Where weights say what their outputs mean; without it they are corrections.
pub const PARAMETRISATION: &str = "parametrisation";
/// Where weights say how many neighbours they were given by co-visibility; without it none.
pub const COVISIBLE: &str = "covisible";

/// Weights for the plane sweep's features, and what reports call them; docs/training.md says how they came about. The default:
const GRID: (&[u8], &str) =
    (include_bytes!("../../weights/plane-sweep-grid-1.safetensors"), "learned (plane-sweep-grid-1)");
/// The paper's attention.
const ATTENTION: (&[u8], &str) =
    (include_bytes!("../../weights/plane-sweep-2.safetensors"), "learned (plane-sweep-2)");

/// A trained head.
#[derive(Debug)]
pub struct LearnedHead {
    head: Head,
    features: String,
    /// Whether it sees what rendering the closed form says.
    feedback: bool,
    parametrisation: Parametrisation,
    covisible: usize,
    name: String,
}

impl LearnedHead {
    /// A head from weights; `name` is what reports call it.
    ///
    /// # Errors
    /// If the weights do not say which features they work with, want other geometric features than there are, or say something of their outputs
    /// or neighbours that is not known.
    pub fn new(weights: Weights, name: impl Into<String>) -> Result<Self> {
        let name = name.into();
        let found = weights.config.geometry;
        let Some(feedback) = [true, false].into_iter().find(|&feedback| geometry_features(feedback) == found)
        else {
            let [without, with] = [false, true].map(geometry_features);
            return Err(Error::GeometryFeatures { weights: name, without, with, found });
        };
        Self::checked(weights, name, feedback)
    }

    /// A corrector from weights: a head that sees a refined scene, feedback on it and how it came about, and corrects it.
    ///
    /// # Errors
    /// As [`LearnedHead::new`], or if the weights are of a head that sees the closed form.
    pub(super) fn corrector(weights: Weights, name: impl Into<String>) -> Result<Self> {
        let name = name.into();
        let (expected, found) = (corrector_features(), weights.config.geometry);
        if expected != found {
            return Err(Error::NotOfCorrector { weights: name, expected, found });
        }
        let head = Self::checked(weights, name, true)?;
        let refuse = |key, found: String| Error::CorrectorMetadata { weights: head.name.clone(), key, found };
        if head.parametrisation != Parametrisation::Correction {
            return Err(refuse(PARAMETRISATION, head.parametrisation.name().to_owned()));
        }
        if head.covisible > 0 {
            return Err(refuse(COVISIBLE, head.covisible.to_string()));
        }
        Ok(head)
    }

    fn checked(weights: Weights, name: String, feedback: bool) -> Result<Self> {
        let Some(features) = weights.metadata.get(FEATURES).cloned() else {
            return Err(Error::NoSchema { weights: name });
        };
        let refuse = |key: &'static str, found: &String| Error::Metadata {
            weights: name.clone(),
            key,
            found: found.clone(),
        };
        let parametrisation =
            weights.metadata.get(PARAMETRISATION).map_or(Ok(Parametrisation::default()), |said| {
                Parametrisation::of_name(said).ok_or_else(|| refuse(PARAMETRISATION, said))
            })?;
        let covisible = weights
            .metadata
            .get(COVISIBLE)
            .map_or(Ok(0), |said| said.parse().map_err(|_| refuse(COVISIBLE, said)))?;
        Ok(Self { head: Head::new(weights)?, features, feedback, parametrisation, covisible, name })
    }

    /// How many of an anchor's neighbours it was given by co-visibility.
    pub(crate) fn covisible(&self) -> usize {
        self.covisible
    }

    /// A head from a file.
    ///
    /// # Errors
    /// If it cannot be read, or as [`LearnedHead::new`].
    pub fn read(path: &Path) -> Result<Self> {
        Self::new(Weights::read(path)?, path.display().to_string())
    }

    /// What reports call it.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.name
    }

    /// What the head makes of the anchors, far shell excluded; `geometry` is that of the views, with features.
    pub(crate) fn gaussians(
        &self,
        anchored: &Anchored,
        geometry: &[ViewGeometry],
        stages: &mut Stages<'_>,
    ) -> Result<Gaussians> {
        let feedback = match self.feedback {
            true => stages.run(Stage::Feedback, || anchored.feedback(true))?,
            false => Vec::new(),
        };
        stages.run(Stage::Head, || {
            let inputs = anchored.inputs(self.kind(), geometry, &feedback);
            let outputs = self.outputs(&inputs, geometry)?;
            Ok(anchored.decoder(self.parametrisation).decode(&outputs))
        })
    }

    /// Outputs `[n, 38]` for anchors of views with this geometry.
    ///
    /// # Errors
    /// If the weights were trained on other features, or an input or output is not finite.
    fn outputs(&self, inputs: &HeadInputs, geometry: &[ViewGeometry]) -> Result<Vec<f32>> {
        self.check_features(geometry)?;
        self.run(inputs)
    }

    /// That the weights were trained on the features of this geometry.
    pub(super) fn check_features(&self, geometry: &[ViewGeometry]) -> Result<()> {
        let features = geometry.first().and_then(|view| view.features.as_ref());
        let (schema, channels) = features.map_or(("none", 0), |map| (map.schema(), map.channels()));
        if schema == self.features && image_features(channels) == self.head.config().image {
            return Ok(());
        }
        Err(Error::OtherFeatures {
            weights: self.name.clone(),
            expected: self.features.clone(),
            found: schema.to_owned(),
        })
    }

    /// Outputs `[n, 38]` for inputs of features that were [checked](Self::check_features).
    pub(super) fn run(&self, inputs: &HeadInputs) -> Result<Vec<f32>> {
        Ok(self.head.run(&inputs.as_inputs())?)
    }

    /// How it gathers neighbours.
    pub(super) fn kind(&self) -> Kind {
        self.head.config().kind
    }
}

/// Where the weights of a head come from.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum HeadWeights {
    /// This crate's, for the plane sweep's features: means over grids.
    Grid,
    /// This crate's, for the plane sweep's features: the paper's attention.
    Attention,
    File(PathBuf),
}

impl HeadWeights {
    /// Those that the configuration asks for; none for the closed form and for the backbone's own head.
    pub(crate) fn chosen(config: &Config) -> Option<Self> {
        match (&config.head, &config.backbone) {
            (crate::Head::Weights(path), _) => Some(Self::File(path.clone())),
            (crate::Head::Attention, _) => Some(Self::Attention),
            (crate::Head::Default, Backbone::PlaneSweep { .. }) => Some(Self::Grid),
            (crate::Head::Default, Backbone::GivenDepth | Backbone::DepthSplat(_))
            | (crate::Head::ClosedForm | crate::Head::DepthSplat, _) => None,
        }
    }

    /// The head with them.
    pub(crate) fn read(&self) -> Result<LearnedHead> {
        let (bytes, name) = match self {
            Self::Grid => GRID,
            Self::Attention => ATTENTION,
            Self::File(path) => return LearnedHead::read(path),
        };
        LearnedHead::new(Weights::from_bytes(bytes)?, name)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use attn_head::{Config, Kind};
    use std::collections::BTreeMap;

    fn weights(geometry: usize, features: Option<&str>) -> Weights {
        let config = Config { kind: Kind::Attention, geometry, image: image_features(0), neighbours: 2 };
        let features = features.map(|name| (FEATURES.to_owned(), name.to_owned()));
        Weights { metadata: BTreeMap::from_iter(features), ..Weights::initial(config, 0).unwrap() }
    }

    #[test]
    fn weights_that_do_not_belong_here_are_refused_by_name() {
        let refused = |weights| LearnedHead::new(weights, "w").unwrap_err();
        assert!(matches!(refused(weights(geometry_features(true), None)), Error::NoSchema { .. }));
        for key in [PARAMETRISATION, COVISIBLE] {
            let mut unknown = weights(geometry_features(true), Some("none"));
            unknown.metadata.insert(key.to_owned(), "some".to_owned());
            let error = refused(unknown);
            assert!(matches!(&error, Error::Metadata { key: found, .. } if *found == key), "{error}");
        }
        let error = refused(weights(3, Some("none")));
        assert!(matches!(error, Error::GeometryFeatures { found: 3, .. }), "{error}");
    }

    #[test]
    fn heads_and_correctors_do_not_stand_in_for_each_other() {
        let corrector = || weights(corrector_features(), Some("none"));
        assert!(LearnedHead::corrector(corrector(), "w").is_ok());
        let error = LearnedHead::new(corrector(), "w").unwrap_err();
        assert!(matches!(error, Error::GeometryFeatures { .. }), "{error}");
        for feedback in [true, false] {
            let head = weights(geometry_features(feedback), Some("none"));
            let error = LearnedHead::corrector(head, "w").unwrap_err();
            assert!(matches!(error, Error::NotOfCorrector { .. }), "{error}");
        }
        assert!(matches!(
            LearnedHead::corrector(weights(corrector_features(), None), "w"),
            Err(Error::NoSchema { .. })
        ));
        for (key, value) in [(PARAMETRISATION, Parametrisation::Paper.name()), (COVISIBLE, "3")] {
            let mut other = corrector();
            other.metadata.insert(key.to_owned(), value.to_owned());
            let error = LearnedHead::corrector(other, "w").unwrap_err();
            assert!(
                matches!(&error, Error::CorrectorMetadata { key: found, .. } if *found == key),
                "{error}"
            );
        }
    }

    #[test]
    fn features_of_another_backbone_are_refused_and_no_anchors_have_no_outputs() {
        let other = LearnedHead::new(weights(geometry_features(true), Some("other")), "w").unwrap();
        let error = other.outputs(&HeadInputs::default(), &[]).unwrap_err();
        assert!(matches!(&error, Error::OtherFeatures { expected, .. } if expected == "other"), "{error}");
        let same = LearnedHead::new(weights(geometry_features(false), Some("none")), "w").unwrap();
        assert!(same.outputs(&HeadInputs::default(), &[]).unwrap().is_empty());
    }
}
