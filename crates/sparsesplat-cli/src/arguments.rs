//! Arguments that several commands share, and how their values are read.

use crate::depth_source::{BackboneName, DepthSource};
use crate::failure::{Failure, OrFail, Outcome};
use crate::given::Given;
use clap::builder::RangedU64ValueParser;
use clap::{Args, ValueEnum};
use evaluate::{Lpips, Method};
use refine::{Rates, Stop};
use sparsesplat::{Allocation, Budget, Config, Correction, DepthRange, Exposure, Head, Sampler};
use std::path::{Path, PathBuf};

/// End of the short help (`-h`) of commands with many options.
pub(crate) const SEE_LONG_HELP: &str = "Examples and all options: --help";

/// What every command takes.
#[derive(Debug, Clone, Args)]
#[command(next_help_heading = "Common options")]
pub(crate) struct Common {
    /// Write the result as JSON, with everything that is needed to repeat it
    #[arg(long, value_name = "PATH", global = true)]
    pub(crate) json: Option<PathBuf>,
    /// Number of threads [default: one per core]
    #[arg(long, value_name = "N", value_parser = threads, global = true)]
    pub(crate) threads: Option<usize>,
    /// Device that renders
    #[arg(long, value_enum, default_value = "auto", global = true)]
    pub(crate) device: Device,
    /// What the user typed.
    #[arg(skip)]
    pub(crate) given: Given,
}

/// `--device` of a command that renders nothing: it is not offered, and refused if given.
pub(crate) fn no_device() -> clap::Arg {
    let refuse = |_: &str| -> Result<String, String> { Err("this command renders nothing".to_owned()) };
    clap::Arg::new("device").long("device").hide(true).value_parser(refuse)
}

/// Device that renders.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(crate) enum Device {
    /// A GPU if it is real hardware and passes the self-test, else the CPU
    Auto,
    /// A GPU, or a software adapter if there is no GPU
    Gpu,
    /// The CPU
    Cpu,
}

/// Settings of the pipeline.
#[derive(Debug, Clone, Args)]
#[command(next_help_heading = "Reconstruction")]
pub(crate) struct Pipeline {
    /// Number of Gaussians, far shell included: 40000, 40k or 1.5M
    #[arg(long, value_name = "COUNT", value_parser = gaussians, default_value = "40k", conflicts_with = "tau")]
    pub(crate) gaussians: usize,
    /// Sampling parameter instead of a count: probability per pixel = tau x entropy / 8 bits, times --smooth-weight and --filled-weight; the far shell comes on top
    #[arg(long, value_parser = tau, allow_hyphen_values = true, hide_short_help = true)]
    pub(crate) tau: Option<f64>,
    /// Choice of the pixels that become Gaussians
    #[arg(long, value_enum, default_value = "entropy", hide_short_help = true)]
    pub(crate) allocation: AllocationName,
    /// Drawing of pixels: fixed gives the exact count, bernoulli (the paper's) varies around it
    #[arg(long, value_enum, default_value = "fixed", hide_short_help = true)]
    pub(crate) sampler: SamplerName,
    /// Factor on the probability of pixels whose depth no other view confirms, 0 to 1; the paper has no such factor (1)
    #[arg(long, value_name = "WEIGHT", value_parser = weight, default_value_t = Config::default().filled_weight, hide_short_help = true)]
    pub(crate) filled_weight: f32,
    /// Factor on the entropy of pixels where the picture is smooth, 0 to 1; the paper has no such factor (1)
    #[arg(long, value_name = "WEIGHT", value_parser = weight, default_value_t = Config::default().smooth_weight, hide_short_help = true)]
    pub(crate) smooth_weight: f32,
    /// Join surfaces that several views see: one depth for all of them, and as many Gaussians as if one saw them
    #[arg(long, value_name = "on|off", value_parser = on_off, default_value = "off", action = clap::ArgAction::Set, hide_short_help = true)]
    pub(crate) fuse: bool,
    /// Head, which makes the Gaussians
    #[arg(long, value_enum, default_value = "default")]
    pub(crate) head: HeadName,
    #[command(flatten)]
    pub(crate) source: DepthSource,
    /// Fill what no view covers with a far shell of large Gaussians
    #[arg(long, value_name = "on|off", value_parser = on_off, default_value = "on", action = clap::ArgAction::Set, hide_short_help = true)]
    pub(crate) far_shell: bool,
    /// Exposure of the scene if the photographs differ in exposure
    #[arg(long, value_enum, default_value = "as-photographed", hide_short_help = true)]
    pub(crate) exposure: ExposureName,
    /// Depth range of the stereo: estimate (from the views), hint (of the data set), or NEAR,FAR in scene units
    #[arg(long, value_name = "RANGE", value_parser = range, default_value = "estimate", hide_short_help = true)]
    pub(crate) depth_range: Range,
    /// Looks at the photographs: 1 is the head alone; each further look renders all of them and takes a few gradient steps
    #[arg(long, value_name = "N", value_parser = positive, default_value_t = Config::default().looks)]
    pub(crate) looks: usize,
    /// What corrects the scene at the end: default (a small trained head; none with --looks 1 alone, the closed form, merged pixels or another backbone), off, or a file with weights
    #[arg(long, value_name = "CORRECTOR", value_parser = correction, default_value = "default", hide_short_help = true)]
    pub(crate) corrector: Correction,
    /// Neighbours of each anchor
    #[arg(long, value_name = "K", value_parser = positive, default_value_t = 20, hide_short_help = true)]
    pub(crate) neighbours: usize,
    /// Gradient steps on the photographs after the looks (try 60, then 240)
    #[arg(
        long,
        value_name = "STEPS",
        help_heading = "Refinement",
        conflicts_with = "refine_seconds",
        allow_negative_numbers = true
    )]
    pub(crate) refine: Option<usize>,
    /// Seconds of refinement, instead of a number of steps
    #[arg(
        long,
        value_name = "S",
        value_parser = seconds,
        help_heading = "Refinement",
        allow_negative_numbers = true,
        hide_short_help = true
    )]
    pub(crate) refine_seconds: Option<f64>,
    /// With refinement: change poses and focal lengths of the photographs too, for those that are estimates
    #[arg(long, help_heading = "Refinement", hide_short_help = true)]
    pub(crate) refine_poses: bool,
}

/// The weights of LPIPS.
#[derive(Debug, Clone, Args)]
pub(crate) struct LpipsWeights {
    /// Weights of LPIPS, to measure it, or to train with it
    ///
    /// The files are torchvision's VGG16 (the papers' network), AlexNet or SqueezeNet 1.1, and the linear layers of the metric, as published (.pth)
    /// or as safetensors: two files, or one with both. `eval`, `tradeoff`, `paper` and `ablate` then measure LPIPS; in the loss of `train` it replaces
    /// 1 - SSIM.
    #[arg(long = "lpips-weights", value_name = "FILE", num_args = 1..=2, hide_short_help = true)]
    files: Vec<PathBuf>,
}

impl LpipsWeights {
    /// The files that are named.
    pub(crate) fn files(&self) -> &[PathBuf] {
        &self.files
    }

    /// The same as paths.
    pub(crate) fn paths(&self) -> impl Iterator<Item = &Path> {
        self.files.iter().map(PathBuf::as_path)
    }

    /// LPIPS, where weights are given.
    pub(crate) fn read(&self) -> Outcome<Option<Lpips>> {
        (!self.files.is_empty()).then(|| Lpips::read(&self.files)).transpose().or_input()
    }
}

/// `--depth-range` as given.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Range {
    /// From the views.
    Estimate,
    /// From the data set.
    Hint,
    /// Stated.
    Known(f64, f64),
}

/// Which pixels become Gaussians.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(crate) enum AllocationName {
    /// Pixels of high local entropy (the paper's)
    Entropy,
    /// Pixels of a large Laplacian
    Laplacian,
    /// Random pixels
    Random,
    /// Every pixel; the count is not used
    PixelAligned,
    /// Every pixel, merged down to the count afterwards (as GGN and Long-LRM do)
    Merged,
    /// Averages over voxels of a size that gives the count (as AnySplat and VolSplat do)
    VoxelAligned,
}

/// How pixels are drawn.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(crate) enum SamplerName {
    /// Exact count, evenly spread
    Fixed,
    /// Independent draws
    Bernoulli,
    /// Exact count along a curve that fills the picture: with --allocation random as many in every cell of 2x2 usable pixels
    Systematic,
}

/// Exposure of the scene when the photographs differ.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(crate) enum ExposureName {
    /// Keep the exposure of the photographs, and blend between them as the viewpoint moves
    AsPhotographed,
    /// One exposure from everywhere, the mean of the photographs
    Common,
}

/// Head, which makes the Gaussians.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(crate) enum HeadName {
    /// The trained grid head; the closed form for a backbone that it was not trained for
    Default,
    /// The paper's head, trained for --backbone plane-sweep: six times the arithmetic of the default
    Attention,
    /// Formula without weights
    ClosedForm,
    /// DepthSplat's own head; needs --backbone depthsplat and --allocation pixel-aligned
    #[value(name = "depthsplat")]
    DepthSplat,
}

impl AllocationName {
    /// What it stands for.
    fn allocation(self) -> Allocation {
        match self {
            Self::Entropy => Allocation::Entropy,
            Self::Laplacian => Allocation::Laplacian,
            Self::Random => Allocation::Random,
            Self::PixelAligned => Allocation::PixelAligned,
            Self::Merged => Allocation::Merged,
            Self::VoxelAligned => Allocation::VoxelAligned,
        }
    }

    /// Every allocation there is.
    pub(crate) fn all() -> Vec<Allocation> {
        Self::value_variants().iter().map(|name| name.allocation()).collect()
    }
}

/// Step size of cameras where they are moved, pixels.
const POSE_RATE: f32 = 0.1;
/// Share of the steps on pictures of half the size where cameras are moved: a pixel there is two.
const POSE_COARSE: f32 = 0.5;

impl Pipeline {
    /// Photographs to Gaussians, refinement included.
    pub(crate) fn method(&self, seed: u64, given: &Given) -> Outcome<Method> {
        self.refuse_without_effect(given)?;
        let stop = match (self.refine, self.refine_seconds) {
            (Some(steps), _) => Some(Stop::Steps(steps)),
            (None, Some(seconds)) => Some(Stop::Seconds(seconds)),
            (None, None) => None,
        };
        if stop.is_none() {
            given.refuse(&["refine-poses"], "cameras are moved by refinement: give --refine STEPS")?;
        }
        let pose = if self.refine_poses { POSE_RATE } else { 0.0 };
        let rates = Rates { pose, ..Rates::default() };
        let coarse = if self.refine_poses { POSE_COARSE } else { 0.0 };
        let predict = self.config(seed)?;
        let method = match stop {
            None => Method::feed_forward(predict),
            Some(stop) => {
                let refine = refine::Config { stop, seed, rates, coarse, ..refine::Config::default() };
                Method::refined(predict, refine)
            }
        };
        if self.corrector == Correction::Default && !method.pass().has_corrector() {
            given.refuse(
                &["corrector"],
                "the default one needs --backbone plane-sweep, a head with weights, an --allocation other than merged, and several --looks or --refine",
            )?;
        }
        Ok(method)
    }

    /// The files that are named.
    pub(crate) fn files(&self) -> impl Iterator<Item = &Path> {
        self.source.files().chain(self.corrector_file().map(PathBuf::as_path))
    }

    /// The weights of the corrector, if they are in a file.
    pub(crate) fn corrector_file(&self) -> Option<&PathBuf> {
        match &self.corrector {
            Correction::Weights(path) => Some(path),
            Correction::Off | Correction::Default => None,
        }
    }

    /// Refuses settings that the others leave without an effect.
    fn refuse_without_effect(&self, given: &Given) -> Outcome {
        match self.allocation {
            AllocationName::Entropy | AllocationName::Laplacian | AllocationName::Random => {}
            AllocationName::PixelAligned => given.refuse(
                &["gaussians", "tau", "sampler", "filled-weight"],
                "--allocation pixel-aligned makes one Gaussian of every pixel",
            )?,
            AllocationName::Merged | AllocationName::VoxelAligned => given.refuse(
                &["tau", "sampler", "filled-weight"],
                "this --allocation draws no pixels; --gaussians COUNT says how many Gaussians are left",
            )?,
        }
        if self.allocation != AllocationName::Entropy {
            given.refuse(&["smooth-weight"], "it lowers the probabilities of --allocation entropy")?;
        }
        if self.source.backbone == BackboneName::GivenDepth && matches!(self.depth_range, Range::Known(..)) {
            given.refuse(&["depth-range"], "--backbone given-depth takes the range of the measured depth")?;
        }
        if self.source.backbone != BackboneName::PlaneSweep {
            given.refuse(&["filled-weight"], "only the stereo of --backbone plane-sweep fills depth in")?;
        }
        if self.head == HeadName::DepthSplat {
            given.refuse(&["neighbours"], "--head depthsplat looks at no neighbours")?;
            given.refuse(&["fuse"], "--head depthsplat makes the Gaussians from the depth of its network")?;
        }
        Ok(())
    }

    /// The pass. `Hint` is left as `Estimate` here: only the data set can resolve it.
    fn config(&self, seed: u64) -> Outcome<Config> {
        let (backbone, weights) = self.source.resolve()?;
        Ok(Config {
            backbone,
            depth_range: match self.depth_range {
                Range::Estimate | Range::Hint => DepthRange::Estimate,
                Range::Known(near, far) => DepthRange::Known { near, far },
            },
            allocation: self.allocation.allocation(),
            sampler: match self.sampler {
                SamplerName::Fixed => Sampler::Fixed,
                SamplerName::Bernoulli => Sampler::Bernoulli,
                SamplerName::Systematic => Sampler::Systematic,
            },
            filled_weight: self.filled_weight,
            smooth_weight: self.smooth_weight,
            fuse: self.fuse,
            budget: self.tau.map_or(Budget::Gaussians(self.gaussians), Budget::Tau),
            neighbours: self.neighbours,
            head: match (weights, self.head) {
                (Some(weights), HeadName::Default) => Head::Weights(weights),
                (Some(weights), _) => {
                    let weights = weights.display();
                    return Err(Failure::input(format!(
                        "--weights {weights} is of a head: leave --head out"
                    )));
                }
                (None, HeadName::Default) => Head::Default,
                (None, HeadName::Attention) => Head::Attention,
                (None, HeadName::ClosedForm) => Head::ClosedForm,
                (None, HeadName::DepthSplat) => Head::DepthSplat,
            },
            looks: self.looks,
            far_shell: self.far_shell,
            exposure: match self.exposure {
                ExposureName::AsPhotographed => Exposure::AsPhotographed,
                ExposureName::Common => Exposure::Common,
            },
            correction: self.corrector.clone(),
            refined_later: false,
            seed,
        })
    }
}

/// `--corrector`.
#[expect(clippy::unnecessary_wraps, reason = "clap wants a result")]
fn correction(text: &str) -> Result<Correction, String> {
    Ok(match text {
        "default" => Correction::Default,
        "off" => Correction::Off,
        path => Correction::Weights(path.into()),
    })
}

/// A factor of a probability.
fn weight(text: &str) -> Result<f32, String> {
    let weight = text.parse().ok().filter(|weight| (0.0..=1.0).contains(weight));
    weight.ok_or_else(|| "expected a number from 0 to 1".to_owned())
}

/// A count above 0: `40000`, `40k`, `1.5M`.
pub(crate) fn gaussians(text: &str) -> Result<usize, String> {
    let (digits, factor) = match text.as_bytes().last() {
        Some(b'k' | b'K') => (&text[..text.len() - 1], 1e3),
        Some(b'm' | b'M') => (&text[..text.len() - 1], 1e6),
        _ => (text, 1.0),
    };
    let count = digits.parse::<f64>().map_or(f64::NAN, |number| (number * factor).round());
    if (1.0..=1e9).contains(&count) {
        Ok(count as usize)
    } else {
        Err("expected a count from 1 to 1000M, such as 40000, 40k or 1.5M".to_owned())
    }
}

/// A whole number above 0.
pub(crate) fn positive(text: &str) -> Result<usize, String> {
    text.parse().ok().filter(|&number| number > 0).ok_or_else(|| "expected a whole number above 0".to_owned())
}

/// A number of threads: some more than the cores, so that results can be compared, but not so many that starting them takes longer
/// than the work.
fn threads(text: &str) -> Result<usize, String> {
    let most = std::thread::available_parallelism().map_or(1, usize::from).saturating_mul(4).max(64);
    let threads = positive(text)?;
    if threads <= most { Ok(threads) } else { Err(format!("expected at most {most} on this machine")) }
}

/// A number of generated scenes, at least so many.
pub(crate) fn scenes(least: u64) -> RangedU64ValueParser<usize> {
    RangedU64ValueParser::new().range(least..=100_000)
}

/// Seeds, each once.
pub(crate) fn seeds(all: &[u64]) -> Vec<u64> {
    let mut seeds = Vec::new();
    for &seed in all {
        if !seeds.contains(&seed) {
            seeds.push(seed);
        }
    }
    seeds
}

fn tau(text: &str) -> Result<f64, String> {
    let tau = text.parse().unwrap_or(f64::NAN);
    if tau > 0.0 && tau < f64::INFINITY {
        Ok(tau)
    } else {
        Err("expected a finite number above 0".to_owned())
    }
}

fn seconds(text: &str) -> Result<f64, String> {
    let seconds = text.parse().unwrap_or(f64::NAN);
    if (0.0..1e6).contains(&seconds) {
        Ok(seconds)
    } else {
        Err("expected a number of seconds, such as 3 or 0.5".to_owned())
    }
}

fn on_off(text: &str) -> Result<bool, String> {
    match text {
        "on" => Ok(true),
        "off" => Ok(false),
        _ => Err("expected on or off".to_owned()),
    }
}

fn range(text: &str) -> Result<Range, String> {
    match text {
        "estimate" => return Ok(Range::Estimate),
        "hint" => return Ok(Range::Hint),
        _ => {}
    }
    let numbers: Option<Vec<f64>> = text.split(',').map(|number| number.trim().parse().ok()).collect();
    match numbers.as_deref() {
        Some(&[near, far]) if 0.0 < near && near < far && far < f64::INFINITY => Ok(Range::Known(near, far)),
        _ => Err("expected estimate, hint, or two depths NEAR,FAR with 0 < NEAR < FAR".to_owned()),
    }
}

/// `WxH` in pixels.
pub(crate) fn size(text: &str) -> Result<(usize, usize), String> {
    let sides = text.split_once(['x', 'X']).and_then(|(w, h)| Some((w.parse().ok()?, h.parse().ok()?)));
    sides
        .filter(|&(w, h)| (1..=16384).contains(&w) && (1..=16384).contains(&h))
        .ok_or_else(|| "expected WIDTHxHEIGHT in pixels, 1 to 16384 each, such as 480x320".to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn counts_have_suffixes() {
        assert_eq!(gaussians("40000"), Ok(40_000));
        assert_eq!(gaussians("40k"), Ok(40_000));
        assert_eq!(gaussians("1.5M"), Ok(1_500_000));
        assert_eq!(gaussians("0.5k"), Ok(500));
        for bad in ["0", "", "k", "-4k", "0.2", "nan", "inf", "1e300", "40 k", "4ö"] {
            assert!(gaussians(bad).is_err(), "{bad}");
        }
    }

    #[test]
    fn ranges_are_words_or_two_depths() {
        assert_eq!(range("estimate"), Ok(Range::Estimate));
        assert_eq!(range("hint"), Ok(Range::Hint));
        assert_eq!(range("0.5,10"), Ok(Range::Known(0.5, 10.0)));
        for bad in ["", "1", "1,2,3", "2,1", "0,1", "-1,1", "1,inf", "nan,1", "1,nan", "1,1"] {
            assert!(range(bad).is_err(), "{bad}");
        }
    }

    #[test]
    fn other_values_name_their_rule() {
        assert_eq!(size("480x320"), Ok((480, 320)));
        for bad in ["480", "0x3", "3x0", "ax3", "99999x2", "x"] {
            assert!(size(bad).is_err(), "{bad}");
        }
        assert!(on_off("On").is_err() && tau("0").is_err() && tau("inf").is_err() && tau("nan").is_err());
        assert!(seconds("nan").is_err() && seconds("-1").is_err() && seconds("2.5") == Ok(2.5));
        assert!(positive("0").is_err() && positive("-1").is_err() && positive("3") == Ok(3));
    }
}
