//! Further looks at the views: the Gaussians of the head are rendered into the photographs and follow the derivatives of the difference, a few
//! large steps. The CPU renders, whatever renders the result, so that a prediction does not depend on the graphics adapter.
//!
//! The paper has no such stage; ReSplat (arXiv 2510.08575) feeds errors of renderings back through a network instead. Held-out views are
//! never seen.

use crate::learned::HeadWeights;
use crate::{Anchored, Config, Error, ExposureGain, Result, Stage, Stages, ViewGeometry};
use gs_raster::Rasterizer;
use gs_scene::{Gaussians, View};
use refine::Stop;

/// The Gaussians after the looks that the configuration asks for beyond the head's; `exposure` is what brought each view into the common
/// one.
pub(crate) fn look(
    gaussians: Gaussians,
    (views, exposure): (&[View], &[ExposureGain]),
    config: &Config,
    stages: &mut Stages<'_>,
) -> Result<Gaussians> {
    if config.looks < 2 || gaussians.is_empty() {
        return Ok(gaussians);
    }
    stages.run(Stage::Looks, || {
        let into_one = differ(exposure) && config.exposure.is_fitted_by_view();
        rounds_of_steps(gaussians, &config.exposure.views(views, exposure), into_one, config.looks - 1)
    })
}

impl Anchored {
    /// Gaussians made of these anchors, in the common exposure, after `looks` looks at the views: the first is the head's, and the others change
    /// them as a prediction does. For training a head with the looks in view.
    ///
    /// # Errors
    /// If the Gaussians cannot be rendered.
    pub fn looked(&self, gaussians: Gaussians, looks: usize) -> Result<Gaussians> {
        if looks < 2 || gaussians.is_empty() {
            return Ok(gaussians);
        }
        rounds_of_steps(gaussians, &self.views, differ(&self.exposure), looks - 1)
    }
}

impl Anchored {
    /// These anchors in the scene that the default head and its looks make of them, refined by so many steps, all in the common exposure: for training
    /// a corrector. `geometry` is that of the views, with features.
    ///
    /// # Errors
    /// If the features are not those of the default head, or the scene cannot be rendered.
    pub fn predicted_and_refined(self, geometry: &[ViewGeometry], steps: usize) -> Result<Self> {
        let head = HeadWeights::Grid.read()?;
        let mut before = head.gaussians(&self, geometry, &mut Stages::new(&mut |_| {}))?;
        before.append(&self.shell.clone().with_sh_degree(before.sh_degree())?);
        let before = self.looked(before, Config::default().looks)?;
        let refined = if steps == 0 {
            before.clone()
        } else {
            let settings = refine::Config {
                stop: Stop::Steps(steps),
                exposure: differ(&self.exposure),
                prune: false,
                ..refine::Config::default()
            };
            refine::refine(before.clone(), &self.views, &settings, &mut Rasterizer::cpu(), &mut |_| {})
                .map_err(|error| Error::Looks(Box::new(error)))?
                .gaussians
        };
        let exposure = vec![ExposureGain::NONE; self.views.len()];
        self.refined(&before, &refined, exposure)
    }
}

/// Whether the photographs had more than one exposure.
fn differ(exposure: &[ExposureGain]) -> bool {
    exposure.iter().any(|&view| view != ExposureGain::NONE)
}

/// `into_one`: the views were brought into one exposure, and what is left of their differences is not the scene's.
fn rounds_of_steps(gaussians: Gaussians, views: &[View], into_one: bool, rounds: usize) -> Result<Gaussians> {
    // The order of the views is always the same: a pass that takes all pixels does not depend on a seed.
    let settings = refine::Config { exposure: into_one, ..refine::Config::rounds(rounds, views.len()) };
    let refined = refine::refine(gaussians, views, &settings, &mut Rasterizer::cpu(), &mut |_| {});
    refined.map(|refined| refined.gaussians).map_err(|error| Error::Looks(Box::new(error)))
}
