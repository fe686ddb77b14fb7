use crate::{Error, ExposureGain, Result};
use depth_backbone::{DepthRange, PlaneSweep};
use entropy_sampler::Sampler;
use gs_scene::View;
use serde::{Deserialize, Serialize};
use std::borrow::Cow;
use std::path::PathBuf;

/// Everything that decides what a [`crate::Predictor`] makes of a set of views.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Config {
    /// Where depth and features come from.
    pub backbone: Backbone,
    /// Near and far plane of the stereo sweep.
    pub depth_range: DepthRange,
    /// Which pixels become Gaussians.
    pub allocation: Allocation,
    /// How pixels are drawn from the probability map.
    pub sampler: Sampler,
    /// Factor, 0 to 1, on the probability of pixels whose depth the stereo filled in from neighbours, because no other view confirms it: a Gaussian
    /// counts for less where its place is a guess. The paper has no such factor (1). Other backbones fill nothing in.
    pub filled_weight: f32,
    /// Factor, 0 to 1, on the entropy of pixels where the picture is smooth. It applies in full where the Laplacian of the grey levels is 0, and rises
    /// linearly to 1 where its magnitude is 64 levels. The entropy of a 7x7 window is nearly the same on an edge and three pixels beside it. The paper has
    /// no such factor (1). Only for [`Allocation::Entropy`].
    pub smooth_weight: f32,
    /// Whether surfaces that several views see are joined before pixels are drawn: their depths become the mean along each ray, weighted by
    /// confidence, and a pixel's probability is divided by the number of views that see its surface ([`Geometry::fused`](crate::Geometry::fused)).
    pub fuse: bool,
    /// How many Gaussians.
    pub budget: Budget,
    /// Neighbours K that each anchor gathers.
    pub neighbours: usize,
    /// What turns anchors into Gaussians.
    pub head: Head,
    /// Looks at the views through the renderer, at least 1. The first is the feedback of the head, which makes the Gaussians in one pass; in
    /// each further one all views are rendered and the Gaussians follow the derivatives of the difference (`crates/sparsesplat/src/looks.rs`).
    pub looks: usize,
    /// Whether a far shell backs what no view covers; counted in the budget.
    pub far_shell: bool,
    /// In which exposure the scene is.
    pub exposure: Exposure,
    /// What corrects the scene after its gradient steps, those of further looks or of a refinement.
    pub correction: Correction,
    /// Whether a refinement follows the pass. The correction is then left to it ([`Prediction::corrector`](crate::Prediction::corrector)). It is not
    /// written to JSON.
    #[serde(skip)]
    pub refined_later: bool,
    /// Seed of the sampling.
    pub seed: u64,
}

impl Default for Config {
    /// 40k Gaussians by entropy from plane-sweep stereo, far shell on: the setting of our tables.
    fn default() -> Self {
        Self {
            backbone: Backbone::default(),
            depth_range: DepthRange::Estimate,
            allocation: Allocation::Entropy,
            sampler: Sampler::Fixed,
            filled_weight: 0.5,
            smooth_weight: 0.1,
            fuse: false,
            budget: Budget::Gaussians(40_000),
            neighbours: 20,
            head: Head::Default,
            looks: 4,
            far_shell: true,
            exposure: Exposure::AsPhotographed,
            correction: Correction::Default,
            refined_later: false,
            seed: 0,
        }
    }
}

impl Config {
    /// Whether each Gaussian is that of an anchor, so that a corrector can change it.
    #[must_use]
    pub fn keeps_anchors(&self) -> bool {
        self.head != Head::DepthSplat && self.allocation != Allocation::Merged
    }

    /// Whether [`Correction::Default`] corrects anything. This crate's corrector was trained on scenes of plane sweeps after gradient steps; the closed form
    /// is to have no weights.
    #[must_use]
    pub fn has_corrector(&self) -> bool {
        self.keeps_anchors()
            && matches!(self.backbone, Backbone::PlaneSweep { .. })
            && self.head != Head::ClosedForm
            && (self.looks > 1 || self.refined_later)
    }

    /// Whether the settings fit together.
    pub(crate) fn check(&self) -> Result<()> {
        match (self.budget, self.allocation) {
            (Budget::Gaussians(0), _) => return Err(Error::EmptyBudget),
            _ if self.looks == 0 => return Err(Error::NoLook),
            (Budget::Tau(tau), Allocation::Merged | Allocation::VoxelAligned) => {
                return Err(Error::NothingDrawn { tau });
            }
            _ => {}
        }
        for (pixels, found) in [("filled-in", self.filled_weight), ("smooth", self.smooth_weight)] {
            if !(0.0..=1.0).contains(&found) {
                return Err(Error::PixelWeight { pixels, found });
            }
        }
        if self.head == Head::Attention && !matches!(self.backbone, Backbone::PlaneSweep { .. }) {
            return Err(Error::AttentionBackbone);
        }
        if self.head == Head::DepthSplat && self.allocation != Allocation::PixelAligned {
            return Err(Error::OwnHeadAllocation);
        }
        if matches!(self.correction, Correction::Weights(_)) && !self.keeps_anchors() {
            return Err(Error::NothingToCorrect);
        }
        if self.head == Head::DepthSplat && self.fuse {
            return Err(Error::OwnHeadFusion);
        }
        Ok(())
    }
}

/// Where depth and features come from.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Backbone {
    /// Measured depth that comes with the data.
    GivenDepth,
    /// Multi-view stereo.
    PlaneSweep {
        /// Number of planes, evenly spaced in inverse depth.
        planes: usize,
        /// What follows the sweep.
        depth: SweepDepth,
    },
    /// DepthSplat's network with the weights in a file (feature `depthsplat`): the paper's backbone.
    DepthSplat(PathBuf),
}

/// Whose depth is used: that of the plane sweep, or a network's that improves it.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum SweepDepth {
    /// As the sweep and the check between the views leave it.
    #[default]
    Stereo,
    /// Improved by the network with this crate's weights.
    Learned,
    /// Improved by the network with the weights in a file.
    Weights(PathBuf),
}

impl Backbone {
    /// Stereo of so many planes, with the default of what follows it.
    #[must_use]
    pub fn plane_sweep(planes: usize) -> Self {
        Self::PlaneSweep { planes, depth: SweepDepth::default() }
    }
}

impl Default for Backbone {
    /// Stereo, which needs nothing but photographs.
    fn default() -> Self {
        Self::plane_sweep(PlaneSweep::default().planes)
    }
}

/// Which pixels become Gaussians (the paper's sampling ablation), or how their number is brought down otherwise (the
/// baselines of the paper's comparison).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Allocation {
    /// Local Shannon entropy (paper, section 3.2).
    Entropy,
    /// Magnitude of the Laplacian.
    Laplacian,
    /// Every pixel alike.
    Random,
    /// Every pixel: one Gaussian each; the budget is not used.
    PixelAligned,
    /// Every pixel; the Gaussians are then merged down to the budget, which must be a count (post-processing as in GGN
    /// and Long-LRM).
    Merged,
    /// Every pixel; those that share a voxel become one Gaussian. The size of a voxel is solved for the budget, which must
    /// be a count (as in AnySplat and VolSplat).
    VoxelAligned,
}

impl Allocation {
    /// Whether all pixels are lifted into space, instead of those that a sampler chose; no seed changes anything then.
    #[must_use]
    pub fn takes_all(self) -> bool {
        match self {
            Self::Entropy | Self::Laplacian | Self::Random => false,
            Self::PixelAligned | Self::Merged | Self::VoxelAligned => true,
        }
    }
}

/// In which exposure a scene is whose photographs differ in theirs; where they agree there is no difference.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Exposure {
    /// In theirs: colours depend on where they are seen from, by SH of degree 2, and go over from the exposure of one photograph to that
    /// of the next.
    AsPhotographed,
    /// In one, the mean of theirs, from everywhere.
    Common,
}

impl Exposure {
    /// Whether steps after the head fit a gain and a bias to each view. Views that were brought into one exposure still differ a little, and
    /// that is not the scene's. As photographed, colours by direction follow the exposures, and a fit would draw them back to one.
    #[must_use]
    pub fn is_fitted_by_view(self) -> bool {
        self == Self::Common
    }

    /// The photographs in the exposure of the scene; `exposure` is what brings each into the common one.
    #[must_use]
    pub fn views<'a>(self, views: &'a [View], exposure: &[ExposureGain]) -> Cow<'a, [View]> {
        let mut views = Cow::Borrowed(views);
        if self == Self::Common && exposure.iter().any(|&view| view != ExposureGain::NONE) {
            views.to_mut().iter_mut().zip(exposure).for_each(|(view, exposure)| exposure.apply(view));
        }
        views
    }
}

/// What corrects a scene after its last look or its refinement ([`Corrector`](crate::learned::Corrector)).
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Correction {
    /// Nothing.
    Off,
    /// This crate's corrector where [`Config::has_corrector`]; else nothing.
    Default,
    /// A corrector with weights from a file.
    Weights(PathBuf),
}

/// How many Gaussians.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Budget {
    /// Total count, far shell included; tau, the size of a voxel, or how much is merged, is solved for it.
    Gaussians(usize),
    /// The paper's knob: P = clip(tau · E / log2 L, 0, 1), with the factors of the configuration; the far shell comes on top.
    Tau(f64),
}

/// What turns anchors into Gaussians.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Head {
    /// The default weights of the backbone; the closed form where it has none.
    Default,
    /// The paper's geo-aware attention with weights for the plane sweep's features, so only with [`Backbone::PlaneSweep`].
    Attention,
    /// A head with weights from a file.
    Weights(PathBuf),
    /// Scale, rotation, colour and opacity from the local neighbourhood by formula; no weights.
    ClosedForm,
    /// DepthSplat's own head, from the weights of its backbone: one Gaussian of every pixel, so only with
    /// [`Allocation::PixelAligned`]. The paper's main rival.
    DepthSplat,
}
