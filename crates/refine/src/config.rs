use crate::{Error, Result};
use gs_raster::RenderSettings;
use serde::{Deserialize, Serialize};

/// How to refine. The defaults are those of our tables; how they were found is in docs/journal/2026-11-looks.md.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Config {
    /// When to stop at the latest.
    pub stop: Stop,
    /// Views that each step renders and compares, at most all; a step's gradient is their mean. All views
    /// take turns, in an order shuffled anew for every round.
    pub views_per_step: usize,
    /// Share of the way, 0 to 1, at whose beginning views are compared at half their size, for less than half
    /// the time. Views with a side below 32 pixels are compared as they are.
    pub coarse: f32,
    /// How far a step goes.
    pub rates: Rates,
    /// Steps over which the step sizes rise evenly to their full size. The first steps know two views of all, and the sizes of few gradients;
    /// in full size they would lose what a head has gained. 0 begins at full size.
    pub warm_up: usize,
    /// What is left of the step sizes at the end, 0 to 1; they fall along half a cosine.
    pub last_rate: f32,
    /// Decay of the mean of gradients that a step follows, 0 to below 1.
    pub momentum: f32,
    /// Damping of parameters with small gradients in the first steps. Step k is the rate times g / (s + damping · t / k), where g is the mean
    /// gradient, s the size of this parameter's gradients, and t the typical size of its kind's. With 0 every parameter moves by its rate (Adam); the
    /// larger it is, the more a step is like plain gradient descent.
    pub damping: f32,
    /// Largest standard deviation of a Gaussian over its z-depth in the nearest view: 1 is 90 degrees wide. A Gaussian that
    /// is larger at the start may stay larger.
    pub largest: f32,
    /// What is made small.
    pub loss: Loss,
    /// Opacity below which a Gaussian is not drawn into a pixel while the scene is compared. Renderings of the result have 1/255, the default;
    /// more leaves out the faint rims of Gaussians, and takes less time.
    pub alpha_min: f32,
    /// Transmittance below which a pixel is done while the scene is compared. Renderings of the result have 1e-4, the default; more leaves out
    /// what hardly shows through, and takes less time.
    pub transmittance_min: f32,
    /// SH degree of the result, 0 to 3, if above that of the scene: its new coefficients start at 0.
    pub sh_degree: usize,
    /// Whether a gain and a bias per view take up what the views disagree in, if they do. For a scene in one exposure: colours that change with
    /// the direction can follow the photographs, and would be drawn away from them.
    pub exposure: bool,
    /// Whether all views are rendered before the first step, for [`Report::psnr_start`](crate::Report::psnr_start). `exposure` does so anyway.
    pub measure_start: bool,
    /// Whether a long refinement, of at least 120 steps, compares views between the photographs as well in the second half of its steps. Their
    /// pictures are the mean of what the scene showed there at the start and shows at half of the way: many steps on photographs alone
    /// make these better and the views between them worse. Not where [`Rates::pose`] moves cameras.
    pub between: bool,
    /// Whether Gaussians that have become too transparent to be drawn are dropped. No rendering changes by
    /// it.
    pub prune: bool,
    /// Stop early when twenty rounds over all views, at their full size, are on the mean not better than the twenty
    /// before by this, dB on the context views; 0 never does.
    pub smallest_gain: f64,
    /// Seed of the order of the views.
    pub seed: u64,
}

impl Default for Config {
    fn default() -> Self {
        Self {
            stop: Stop::Steps(60),
            views_per_step: 2,
            coarse: 0.0,
            rates: Rates::default(),
            warm_up: 6,
            last_rate: 0.05,
            momentum: 0.7,
            damping: 2.5,
            largest: 1.0,
            loss: Loss::default(),
            alpha_min: RenderSettings::default().alpha_min,
            transmittance_min: RenderSettings::default().transmittance_min,
            sh_degree: 0,
            exposure: true,
            measure_start: true,
            between: true,
            prune: true,
            smallest_gain: 0.02,
            seed: 0,
        }
    }
}

/// When to stop at the latest.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Stop {
    /// After so many steps.
    Steps(usize),
    /// When this much wall time is over, seconds. The number of steps, and with it the result, then depends
    /// on the machine; the report says how many they were.
    Seconds(f64),
}

/// Step sizes at the start.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Rates {
    /// Of means, in widths of a pixel at the Gaussian's depth in the view that is nearest to it: the same
    /// whatever the scale of the scene, and for near and far alike.
    pub mean: f32,
    /// Of unit quaternions; half an angle, radians.
    pub rotation: f32,
    /// Of the logarithms of the scales.
    pub scale: f32,
    /// Of the logits of the opacities.
    pub opacity: f32,
    /// Of the colours: SH coefficients of degree 0.
    pub colour: f32,
    /// Of the SH coefficients of higher degrees.
    pub sh: f32,
    /// Of the cameras and their focal lengths, pixels; 0 leaves them as they are. For poses that are estimates.
    pub pose: f32,
}

impl Default for Rates {
    fn default() -> Self {
        Self { mean: 0.7, rotation: 0.07, scale: 0.15, opacity: 0.15, colour: 0.02, sh: 0.002, pose: 0.0 }
    }
}

/// What is made small: (1 - `dssim`) · colour term + `dssim` · (1 - SSIM), mean over pixels and channels.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Loss {
    /// How colours are compared.
    pub colour: ColourTerm,
    /// Share of the structural term, 0 to 1. Views smaller than its window, 11 × 11 pixels, are compared by colours alone.
    pub dssim: f32,
}

impl Default for Loss {
    fn default() -> Self {
        Self { colour: ColourTerm::Mse, dssim: 0.06 }
    }
}

/// How colours are compared.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum ColourTerm {
    /// Mean of the squared differences: what PSNR is made of.
    Mse,
    /// Mean of the absolute differences.
    L1,
}

impl Config {
    /// A few large steps: `rounds` rounds over so many views, for a scene that comes from a head. No Gaussian is dropped, so that a budget stays
    /// exact. How the settings were found is in docs/journal/2026-11-looks.md.
    #[must_use]
    pub fn rounds(rounds: usize, views: usize) -> Self {
        const VIEWS_PER_STEP: usize = 2;
        // With more rounds a step that went too far is taken back, so the first may be bolder; and the last have to settle.
        let of_one = |value: f64| (value / rounds.max(1) as f64) as f32;
        Self {
            stop: Stop::Steps(rounds.saturating_mul(views.div_ceil(VIEWS_PER_STEP))),
            views_per_step: VIEWS_PER_STEP,
            rates: Rates {
                mean: 0.41,
                rotation: 0.043,
                scale: 0.29,
                opacity: 0.6,
                colour: 0.035,
                sh: 0.008,
                ..Rates::default()
            },
            warm_up: 0,
            damping: of_one(1.8),
            last_rate: of_one(0.45),
            momentum: 0.4,
            loss: Loss { dssim: 0.08, ..Loss::default() },
            // What renderings have besides costs a tenth of the time and gains nothing that could be measured.
            alpha_min: 2.0 / 255.0,
            transmittance_min: 3e-4,
            measure_start: false,
            between: false,
            prune: false,
            smallest_gain: 0.0,
            ..Self::default()
        }
    }

    /// Whether every setting lies in its range; the comparisons are written so that NaN fails them.
    pub(crate) fn check(&self) -> Result<()> {
        let Rates { mean, rotation, scale, opacity, colour, sh, pose } = self.rates;
        let rates = [
            ("rates.mean", mean),
            ("rates.rotation", rotation),
            ("rates.scale", scale),
            ("rates.opacity", opacity),
            ("rates.colour", colour),
            ("rates.sh", sh),
            ("rates.pose", pose),
        ];
        let rates = rates.map(|(name, rate)| {
            (name, f64::from(rate), (0.0..=1e3).contains(&rate), "a number from 0 to 1000")
        });
        let seconds = match self.stop {
            Stop::Steps(_) => 0.0,
            Stop::Seconds(seconds) => seconds,
        };
        let rules = [
            (
                "stop.seconds",
                seconds,
                (0.0..f64::INFINITY).contains(&seconds),
                "a finite number of at least 0",
            ),
            ("views_per_step", self.views_per_step as f64, self.views_per_step > 0, "at least 1"),
            (
                "alpha_min",
                f64::from(self.alpha_min),
                (1e-6..0.1).contains(&self.alpha_min),
                "a number from 1e-6 to below 0.1",
            ),
            (
                "transmittance_min",
                f64::from(self.transmittance_min),
                (1e-6..0.1).contains(&self.transmittance_min),
                "a number from 1e-6 to below 0.1",
            ),
            ("coarse", f64::from(self.coarse), (0.0..=1.0).contains(&self.coarse), "a number from 0 to 1"),
            (
                "last_rate",
                f64::from(self.last_rate),
                (0.0..=1.0).contains(&self.last_rate),
                "a number from 0 to 1",
            ),
            (
                "momentum",
                f64::from(self.momentum),
                (0.0..1.0).contains(&self.momentum),
                "a number from 0 to below 1",
            ),
            (
                "damping",
                f64::from(self.damping),
                (0.0..=1e6).contains(&self.damping),
                "a number from 0 to a million",
            ),
            (
                "largest",
                f64::from(self.largest),
                self.largest > 0.0 && self.largest <= 1e3,
                "above 0, at most 1000",
            ),
            ("sh_degree", self.sh_degree as f64, self.sh_degree <= 3, "0 to 3"),
            ("smallest_gain", self.smallest_gain, self.smallest_gain >= 0.0, "a number of at least 0"),
            (
                "loss.dssim",
                f64::from(self.loss.dssim),
                (0.0..=1.0).contains(&self.loss.dssim),
                "a number from 0 to 1",
            ),
        ];
        for (name, found, in_range, expected) in rules.into_iter().chain(rates) {
            if !in_range {
                return Err(Error::Setting { name, found, expected });
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_defaults_are_valid_and_every_range_is_checked() {
        let good = Config::default();
        assert!(good.check().is_ok());
        let bad = [
            ("stop.seconds", Config { stop: Stop::Seconds(f64::NAN), ..good }),
            ("stop.seconds", Config { stop: Stop::Seconds(-1.0), ..good }),
            ("stop.seconds", Config { stop: Stop::Seconds(f64::INFINITY), ..good }),
            ("views_per_step", Config { views_per_step: 0, ..good }),
            ("coarse", Config { coarse: f32::NAN, ..good }),
            ("last_rate", Config { last_rate: 1.5, ..good }),
            ("momentum", Config { momentum: 1.0, ..good }),
            ("damping", Config { damping: f32::NAN, ..good }),
            ("largest", Config { largest: 0.0, ..good }),
            ("largest", Config { largest: f32::NAN, ..good }),
            ("sh_degree", Config { sh_degree: 4, ..good }),
            ("smallest_gain", Config { smallest_gain: f64::NAN, ..good }),
            ("loss.dssim", Config { loss: Loss { dssim: 1.5, ..good.loss }, ..good }),
            ("rates.mean", Config { rates: Rates { mean: f32::NAN, ..good.rates }, ..good }),
            ("rates.pose", Config { rates: Rates { pose: f32::INFINITY, ..good.rates }, ..good }),
            ("rates.sh", Config { rates: Rates { sh: -1.0, ..good.rates }, ..good }),
        ];
        for (expected, config) in bad {
            match config.check() {
                Err(Error::Setting { name, .. }) => assert_eq!(name, expected),
                other => panic!("{expected}: {other:?}"),
            }
        }
    }
}
