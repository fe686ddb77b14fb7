use crate::map::BYTES;
use crate::{Error, Result};
use serde::{Deserialize, Serialize};

/// How a map is made.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Config {
    /// Most Gaussians that the map ever holds.
    pub cap: usize,
    /// Most bytes that the map ever holds, [`BYTES`] per Gaussian; none for no limit but `cap`.
    pub bytes: Option<usize>,
    /// Where depth comes from.
    pub depth: Depth,
    /// The paper's tau: P = clip(tau · E / log₂ L, 0, 1) of a pixel that the map does not show yet.
    pub tau: f64,
    /// Keyframes that stereo matches with each other, 2 to 8.
    pub window: usize,
    /// Keyframes whose pictures are kept, for stereo and refinement, `window` to 64.
    pub kept: usize,
    /// Gradient steps per keyframe, 0 to 5.
    pub refine: usize,
    /// Seed of the sampling.
    pub seed: u64,
}

/// Where depth comes from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Depth {
    /// Measured depth that comes with every frame.
    Measured,
    /// Plane-sweep stereo of a keyframe with earlier ones.
    Stereo,
}

impl Default for Config {
    fn default() -> Self {
        Self {
            cap: 200_000,
            bytes: None,
            depth: Depth::Measured,
            tau: 0.2,
            window: 5,
            kept: 12,
            refine: 3,
            seed: 0,
        }
    }
}

impl Config {
    /// Whether every setting lies in its range; the comparisons are written so that NaN fails them.
    pub(crate) fn check(&self) -> Result<()> {
        let rules = [
            ("cap", self.cap as f64, (1..=1 << 28).contains(&self.cap), "1 to 2^28"),
            (
                "bytes",
                self.bytes.unwrap_or(BYTES) as f64,
                self.bytes.is_none_or(|bytes| bytes >= BYTES),
                "at least those of one Gaussian",
            ),
            ("tau", self.tau, self.tau > 0.0 && self.tau.is_finite(), "a finite number above 0"),
            ("window", self.window as f64, (2..=8).contains(&self.window), "2 to 8"),
            ("kept", self.kept as f64, (self.window..=64).contains(&self.kept), "window to 64"),
            ("refine", self.refine as f64, self.refine <= 5, "0 to 5"),
        ];
        match rules.into_iter().find(|(_, _, holds, _)| !holds) {
            Some((name, found, _, expected)) => Err(Error::Setting { name, found, expected }),
            None => Ok(()),
        }
    }

    /// Most Gaussians by both limits.
    pub(crate) fn most(&self) -> usize {
        self.cap.min(self.bytes.map_or(usize::MAX, |bytes| bytes / BYTES))
    }
}
