//! The pass: views to Gaussians, with weights that are read once.

use crate::anchored::anchor;
use crate::as_photographed::exposed_as;
use crate::backbone::{self, Networks};
use crate::learned::{Corrector, CorrectorWeights, HeadWeights, LearnedHead};
use crate::looks::look;
use crate::merge::merge;
use crate::{
    Allocation, Budget, Config, Geometry, Head, NetworkDevice, Prediction, Result, Stage, Stages, own_head,
};
use depth_backbone::{ViewGeometry, Wanted};
use gs_scene::View;
use std::sync::Arc;

/// A configuration that was checked, with its weights in memory.
///
/// One of them serves any number of scenes, from several threads too. Another configuration on the same weights is
/// [`with_config`](Self::with_config).
#[derive(Debug, Clone)]
pub struct Predictor {
    config: Config,
    device: NetworkDevice,
    networks: Networks,
    /// None is the closed form, or the backbone's own head.
    head: Option<(HeadWeights, Arc<LearnedHead>)>,
    /// What corrects the scene at the end, if that is asked for.
    corrector: Option<(CorrectorWeights, Arc<LearnedHead>)>,
}

impl Predictor {
    /// Checks the configuration and reads its weights; networks run on the CPU.
    ///
    /// # Errors
    /// If settings contradict each other, or weights cannot be read.
    pub fn new(config: Config) -> Result<Self> {
        Self::on(config, NetworkDevice::Cpu)
    }

    /// The same, with networks on `device`.
    ///
    /// # Errors
    /// As [`Predictor::new`], or if there is no such device.
    pub fn on(config: Config, device: NetworkDevice) -> Result<Self> {
        Self { config: Config::default(), device, networks: Networks::default(), head: None, corrector: None }
            .with_config(config)
    }

    /// Another configuration; weights that this one has read are not read again.
    ///
    /// # Errors
    /// As [`Predictor::new`].
    pub fn with_config(&self, config: Config) -> Result<Self> {
        config.check()?;
        let networks = self.networks.of(&config.backbone, self.device)?;
        let head = known(HeadWeights::chosen(&config), &self.head, HeadWeights::read)?;
        let corrector = known(CorrectorWeights::chosen(&config), &self.corrector, CorrectorWeights::read)?;
        Ok(Self { config, device: self.device, networks, head, corrector })
    }

    /// The configuration.
    #[must_use]
    pub fn config(&self) -> &Config {
        &self.config
    }

    /// Whether the Gaussians are made by a head with weights for the backbone's features.
    #[must_use]
    pub fn has_learned_head(&self) -> bool {
        self.head.is_some()
    }

    /// What head and corrector need of the backbone.
    #[must_use]
    pub fn wanted(&self) -> Wanted {
        match (&self.config.head, &self.head, &self.corrector) {
            (Head::DepthSplat, ..) => Wanted::DepthAndGaussians,
            (_, None, None) => Wanted::Depth,
            _ => Wanted::DepthAndFeatures,
        }
    }

    /// What tells results of this backbone from those of another: its name, and which weights it has, whatever their file is called.
    #[must_use]
    pub fn backbone_identity(&self) -> String {
        backbone::identity(&self.config.backbone, &self.networks)
    }

    /// The backbone alone: depth of all views, and what else the head needs.
    ///
    /// # Errors
    /// If the views do not suffice for the backbone.
    pub fn geometry(&self, views: &[View]) -> Result<Geometry> {
        self.geometry_with(views, self.wanted())
    }

    /// The backbone alone, with more or less than the head needs.
    ///
    /// # Errors
    /// As [`Predictor::geometry`].
    pub fn geometry_with(&self, views: &[View], wanted: Wanted) -> Result<Geometry> {
        backbone::geometry(views, &self.config, &self.networks, wanted)
    }

    /// The pass: views to Gaussians. `on_stage` is called as each stage begins (for progress bars).
    ///
    /// # Errors
    /// If the views do not suffice (see [`crate::Error`]).
    pub fn predict(&self, views: &[View], on_stage: &mut dyn FnMut(Stage)) -> Result<Prediction> {
        let mut stages = Stages::new(on_stage);
        let mut geometry = stages.run(Stage::Backbone, || self.geometry(views))?;
        let mut prediction = self.finish(views, &geometry, stages)?;
        // They are large, and nobody needs them any more.
        geometry.views.iter_mut().for_each(|view| (view.features, view.gaussians) = (None, None));
        prediction.geometry = geometry.views;
        Ok(prediction)
    }

    /// The pass from a known [`geometry`](Self::geometry) on, for configurations that differ in what comes after the backbone; its stage
    /// took 0 s, or as long as the fusion of surfaces. `geometry` must hold what is [`wanted`](Self::wanted).
    ///
    /// # Errors
    /// As [`Predictor::predict`].
    pub fn predict_from(
        &self,
        views: &[View],
        geometry: &Geometry,
        on_stage: &mut dyn FnMut(Stage),
    ) -> Result<Prediction> {
        let mut prediction = self.finish(views, geometry, Stages::new(on_stage))?;
        prediction.geometry = geometry.views.iter().map(plain).collect();
        Ok(prediction)
    }

    /// All stages after the backbone; the prediction's geometry is left empty.
    fn finish(&self, views: &[View], geometry: &Geometry, mut stages: Stages<'_>) -> Result<Prediction> {
        let config = &self.config;
        if config.head == Head::DepthSplat {
            return own_head::finish(views, geometry, config, stages);
        }
        let fused;
        let geometry = if config.fuse {
            fused = stages.run(Stage::Backbone, || geometry.fused(views))?;
            &fused
        } else {
            geometry
        };
        let head = self.head.as_ref().map(|(_, head)| head);
        let covisible = head.map_or(0, |head| head.covisible());
        let anchored = anchor(views, geometry, config, covisible, &mut stages)?;
        let made = match head {
            Some(head) => head.gaussians(&anchored, &geometry.views, &mut stages)?,
            None => anchored.base.clone(),
        };
        let (exposure, tau) = (anchored.exposure.clone(), anchored.tau);
        let mut counts = anchored.counts.clone();
        let gaussians = stages.run(Stage::Decode, || {
            let (mut gaussians, shell) = (made, &anchored.shell);
            if let (Allocation::Merged, Budget::Gaussians(total)) = (config.allocation, config.budget) {
                let merged = merge(gaussians, &anchored.spacing, total - shell.len())?;
                counts = counts.without(&merged.absorbed);
                gaussians = merged.gaussians;
            }
            gaussians.append(&shell.clone().with_sh_degree(gaussians.sh_degree())?);
            exposed_as(config.exposure, gaussians, views, &exposure)
        })?;
        let mut gaussians = look(gaussians, (views, &exposure), config, &mut stages)?;
        let (mut corrector, mut corrected_by) = (None, None);
        if let Some((_, head)) = &self.corrector {
            let head = Arc::clone(head);
            let geometry = (&*geometry.views, geometry.views.iter().map(plain).collect());
            let of_scene = Corrector::new(head, anchored, gaussians.clone(), geometry, config.exposure)?;
            if config.refined_later {
                corrector = Some(of_scene);
            } else {
                corrected_by = Some(of_scene.name().to_owned());
                let exposed = config.exposure.views(views, &exposure);
                gaussians = stages.run(Stage::Correction, || of_scene.corrected(gaussians, &exposed))?;
            }
        }
        let head = head.map_or(CLOSED_FORM, |head| head.name()).to_owned();
        let (depth_range, seconds) = (geometry.depth_range, stages.seconds());
        Ok(Prediction {
            gaussians,
            head,
            counts,
            tau,
            geometry: Vec::new(),
            exposure,
            corrected_by,
            corrector,
            depth_range,
            seconds,
        })
    }
}

/// Depth and confidence alone.
fn plain(view: &ViewGeometry) -> ViewGeometry {
    ViewGeometry {
        depth: view.depth.clone(),
        confidence: view.confidence.clone(),
        features: None,
        gaussians: None,
    }
}

/// The head with the chosen weights, which are only read if it is not `known` already.
fn known<W: PartialEq>(
    chosen: Option<W>,
    known: &Option<(W, Arc<LearnedHead>)>,
    read: impl Fn(&W) -> Result<LearnedHead>,
) -> Result<Option<(W, Arc<LearnedHead>)>> {
    let Some(weights) = chosen else { return Ok(None) };
    let head = match known {
        Some((read, head)) if weights == *read => Arc::clone(head),
        _ => Arc::new(read(&weights)?),
    };
    Ok(Some((weights, head)))
}

/// The closed-form head, as reports call it.
const CLOSED_FORM: &str = "closed-form";
