//! Without the feature `learned` there is no learned head: a type that has no values.

use crate::{Anchored, Config, Error, Head, Result, StageSeconds};
use depth_backbone::ViewGeometry;
use gs_scene::Gaussians;

pub(crate) enum LearnedHead {}

impl LearnedHead {
    pub(crate) fn chosen(config: &Config) -> Result<Option<Self>> {
        match &config.head {
            Head::ClosedForm | Head::Default | Head::DepthSplat => Ok(None),
            Head::Weights(path) => Err(Error::NotBuilt { weights: path.display().to_string() }),
        }
    }

    pub(crate) fn name(&self) -> &str {
        match *self {}
    }

    pub(crate) fn gaussians(
        &self,
        _: &Anchored,
        _: &[ViewGeometry],
        _: &mut StageSeconds,
    ) -> Result<Gaussians> {
        match *self {}
    }
}
