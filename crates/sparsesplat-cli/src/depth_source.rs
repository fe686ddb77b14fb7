//! `--backbone`, `--depth` and `--weights`: where depth and features come from.

use crate::arguments::positive;
use crate::checkpoints;
use crate::failure::{Failure, OrFail, Outcome};
use attn_head::Weights;
use clap::{Args, ValueEnum};
use depth_backbone::PlaneSweep;
use sparsesplat::{Backbone, SweepDepth};
use std::path::{Path, PathBuf};

/// Where depth and features come from, and weights.
#[derive(Debug, Clone, Args)]
#[command(next_help_heading = "Reconstruction")]
pub(crate) struct DepthSource {
    /// Source of depth and features
    #[arg(long, value_enum, default_value = "plane-sweep")]
    pub(crate) backbone: BackboneName,
    /// Depth planes of the stereo; fewer are faster [default: 128]
    #[arg(long, value_name = "N", value_parser = planes, hide_short_help = true)]
    pub(crate) depth_planes: Option<usize>,
    /// Depth of the stereo: stereo (the default), learned (improved by a small network), or a FILE of such a network's weights from train-depth
    #[arg(long, value_name = "SOURCE", value_parser = sweep_depth, hide_short_help = true)]
    pub(crate) depth: Option<SweepDepth>,
    /// Weights of a head or of DepthSplat's network, or both; the kind is read from the file
    ///
    /// A head from `train` replaces the default head. A checkpoint of DepthSplat serves --backbone depthsplat; without one, the checkpoint in the
    /// folder that `doctor` names is used.
    #[arg(long, value_name = "FILE", num_args = 1..=2)]
    pub(crate) weights: Vec<PathBuf>,
}

impl DepthSource {
    /// The files that are named.
    pub(crate) fn files(&self) -> impl Iterator<Item = &Path> {
        let network = match &self.depth {
            Some(SweepDepth::Weights(path)) => Some(path.as_path()),
            _ => None,
        };
        self.weights.iter().map(PathBuf::as_path).chain(network)
    }

    /// The backbone, and the weights of a head if they are given.
    pub(crate) fn resolve(&self) -> Outcome<(Backbone, Option<PathBuf>)> {
        let (mut heads, mut networks) = (Vec::new(), Vec::new());
        for path in &self.weights {
            if Weights::are_in(path).or_input()? { heads.push(path) } else { networks.push(path) }
        }
        for (kind, paths) in [("a head", &heads), ("a network", &networks)] {
            if let [first, second, ..] = paths[..] {
                let (first, second) = (first.display(), second.display());
                return Err(Failure::input(format!("--weights: {first} and {second} are both of {kind}")));
            }
        }
        let network = networks.first().map(|path| (*path).clone());
        #[cfg(not(feature = "candle"))]
        if self.backbone == BackboneName::DepthSplat {
            return Err(Failure::lines(crate::needs_candle("--backbone depthsplat")));
        }
        let backbone = match (self.backbone, network) {
            (BackboneName::DepthSplat, Some(network)) => Backbone::DepthSplat(network),
            (BackboneName::DepthSplat, None) => Backbone::DepthSplat(checkpoints::preferred()?),
            (_, Some(other)) => {
                let reason = match Weights::read(&other) {
                    Err(reason) => format!("{:#}", anyhow::Error::from(reason)),
                    Ok(_) => "it changed while it was read".to_owned(),
                };
                return Err(Failure::input(format!(
                    "{reason}; a network's weights need --backbone depthsplat"
                )));
            }
            (BackboneName::GivenDepth, None) => Backbone::GivenDepth,
            (BackboneName::PlaneSweep, None) => Backbone::PlaneSweep {
                planes: self.depth_planes.unwrap_or(PlaneSweep::default().planes),
                depth: self.depth.clone().unwrap_or_default(),
            },
        };
        if let (true, false) = (self.depth.is_some(), matches!(backbone, Backbone::PlaneSweep { .. })) {
            return Err(Failure::input("--depth is for the stereo of --backbone plane-sweep"));
        }
        if let (Some(planes), false) = (self.depth_planes, matches!(backbone, Backbone::PlaneSweep { .. })) {
            return Err(Failure::input(format!(
                "--depth-planes {planes} is for the stereo of --backbone plane-sweep"
            )));
        }
        Ok((backbone, heads.first().map(|path| (*path).clone())))
    }
}

/// Where depth comes from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(crate) enum BackboneName {
    /// Measured depth that comes with the data
    GivenDepth,
    /// Multi-view stereo by plane sweep
    PlaneSweep,
    /// DepthSplat's network, the paper's backbone; needs its published weights
    #[value(name = "depthsplat")]
    DepthSplat,
}

/// Whose depth is used behind the plane sweep.
fn sweep_depth(text: &str) -> Result<SweepDepth, String> {
    match text {
        "stereo" => Ok(SweepDepth::Stereo),
        "learned" => Ok(SweepDepth::Learned),
        path if Path::new(path).exists() => Ok(SweepDepth::Weights(path.into())),
        _ => Err("expected stereo, learned, or a file of weights from train-depth".to_owned()),
    }
}

fn planes(text: &str) -> Result<usize, String> {
    positive(text)
        .ok()
        .filter(|&planes| planes > 1)
        .ok_or_else(|| "expected a number of planes, 2 or more".to_owned())
}
