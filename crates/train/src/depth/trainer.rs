//! Steps of training: crops of views and windows of photographs, loss, Adam.

use super::between::{self, BetweenWeights, Surface};
use super::cases::{Crop, DepthCase, DepthCases, DepthWindow, Item};
use super::loss::loss;
use super::score::{Collected, DepthScore};
use crate::adam::{Adam, Rates, Taken};
use crate::checkpoint;
use crate::draw::{Stream, bits};
use crate::{Error, Result};
use depth_backbone::{Decoded, DepthNetwork, DepthWeights, Inputs, Recorded};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::Path;
use std::time::Instant;

/// Everything that decides what training makes of a set of views.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct DepthConfig {
    /// Steps in all.
    pub steps: usize,
    /// Crops per step; a window of photographs without measured depth takes the place of one.
    pub batch: usize,
    /// Size of a crop, blocks of 2×2 pixels.
    pub crop: (usize, usize),
    /// Weight of the difference between each of these photographs and what the others show of its surface, 0 or more.
    pub photometric: f32,
    /// Weight of the disagreement between their surfaces, 0 or more.
    pub agreement: f32,
    /// How fast weights move.
    pub rates: Rates,
    /// Seed of the weights and of everything that is drawn.
    pub seed: u64,
}

impl Default for DepthConfig {
    fn default() -> Self {
        Self {
            steps: 6000,
            batch: 8,
            crop: (96, 64),
            photometric: 5.0,
            agreement: 0.5,
            rates: Rates::default(),
            seed: 0,
        }
    }
}

/// Most crops per step: more make a step that takes hours.
const LARGEST_BATCH: usize = 1000;
/// Largest weight of a part of the loss.
const LARGEST_WEIGHT: f32 = 1000.0;

impl DepthConfig {
    /// Whether every setting is within its range.
    ///
    /// # Errors
    /// If one is not.
    pub fn check(&self) -> Result<()> {
        let refuse = |setting, found: String, expected| Err(Error::Setting { setting, found, expected });
        if !(1..=LARGEST_BATCH).contains(&self.batch) {
            return refuse("batch", self.batch.to_string(), "1 to 1000");
        }
        if self.crop.0 < 16 || self.crop.1 < 16 {
            return refuse("crop", format!("{:?}", self.crop), "two sides of at least 16 blocks");
        }
        for (setting, weight) in [("photometric", self.photometric), ("agreement", self.agreement)] {
            if !(0.0..=LARGEST_WEIGHT).contains(&weight) {
                return refuse(setting, weight.to_string(), "0 to 1000");
            }
        }
        self.rates.check()
    }
}

/// What a step did.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct DepthRecord {
    /// Its number, from 1.
    pub step: usize,
    /// Mean loss over the crops.
    pub loss: f64,
    /// Learning rate.
    pub lr: f64,
    /// Length of the gradient before it was shortened.
    pub gradient: f64,
    /// Wall time, seconds.
    pub seconds: f64,
    /// Whether the weights stayed, because loss or gradient was not finite.
    pub skipped: bool,
}

/// What a checkpoint holds beside tensors.
#[derive(Serialize, Deserialize)]
struct Progress {
    config: DepthConfig,
    data: String,
    step: usize,
    skipped: usize,
    updates: usize,
}

/// What the file is.
const KIND: &str = "depth-run";

/// A run.
pub struct DepthTrainer {
    config: DepthConfig,
    cases: DepthCases,
    weights: DepthWeights,
    adam: Adam,
    step: usize,
    skipped: usize,
}

impl DepthTrainer {
    /// A run from its beginning.
    ///
    /// # Errors
    /// If a setting is out of its range.
    pub fn new(config: DepthConfig, cases: DepthCases) -> Result<Self> {
        config.check()?;
        let weights = DepthWeights::initial(config.seed);
        let adam = Adam::new(weights.values.len());
        Ok(Self { config, cases, weights, adam, step: 0, skipped: 0 })
    }

    /// Begins with these weights instead of random ones.
    pub fn start_from(&mut self, weights: DepthWeights) {
        self.weights.values = weights.values;
    }

    /// Goes on from a checkpoint of the same run.
    ///
    /// # Errors
    /// If it cannot be read, or is of another run.
    pub fn resume(&mut self, path: &Path) -> Result<()> {
        let n = self.weights.values.len();
        let (progress, weights, adam) =
            checkpoint::read(path, KIND, n, |progress: &Progress| progress.updates)?;
        let other = |what| Err(Error::OtherRun { path: path.to_path_buf(), what });
        if progress.config != self.config {
            return other("configuration");
        }
        if progress.data != self.cases.sha256() {
            return other("data");
        }
        (self.weights.values, self.adam) = (weights, adam);
        (self.step, self.skipped) = (progress.step, progress.skipped);
        Ok(())
    }

    /// Writes a checkpoint; a reader never sees half of it.
    ///
    /// # Errors
    /// If it cannot be written.
    pub fn save(&self, path: &Path) -> Result<()> {
        let progress = Progress {
            config: self.config.clone(),
            data: self.cases.sha256().to_owned(),
            step: self.step,
            skipped: self.skipped,
            updates: self.adam.updates,
        };
        checkpoint::write(path, KIND, &progress, &self.weights.values, &self.adam)
    }

    /// The settings.
    #[must_use]
    pub fn config(&self) -> &DepthConfig {
        &self.config
    }

    /// Steps done.
    #[must_use]
    pub fn steps(&self) -> usize {
        self.step
    }

    /// Steps that were skipped.
    #[must_use]
    pub fn skipped(&self) -> usize {
        self.skipped
    }

    /// The weights as they are.
    #[must_use]
    pub fn weights(&self) -> DepthWeights {
        let metadata = BTreeMap::from([
            ("steps".to_owned(), self.step.to_string()),
            ("data_sha256".to_owned(), self.cases.sha256().to_owned()),
        ]);
        DepthWeights { values: self.weights.values.clone(), metadata }
    }

    /// One step: a batch of crops, one update. The result does not depend on the number of threads.
    ///
    /// # Errors
    /// If the weights are not finite. A loss or gradient that is not finite is no error: the step is skipped.
    pub fn step(&mut self) -> Result<DepthRecord> {
        let begin = Instant::now();
        let network = DepthNetwork::for_training(&self.weights)?;
        let passes: Vec<(f64, Vec<f32>)> = (0..self.config.batch)
            .into_par_iter()
            .map(|item| self.pass(&network, self.step * self.config.batch + item))
            .collect();
        let share = 1.0 / self.config.batch as f32;
        let mut sum = vec![0.0_f32; self.weights.values.len()];
        let mut loss = 0.0;
        for (value, gradient) in passes {
            loss += value * f64::from(share);
            sum.iter_mut().zip(gradient).for_each(|(sum, g)| *sum += share * g);
        }
        let position = (self.step, self.config.steps);
        let Taken { lr, gradient, skipped } =
            self.adam.step(&self.config.rates, position, &mut self.weights.values, sum, loss);
        self.skipped += usize::from(skipped);
        self.step += 1;
        let seconds = begin.elapsed().as_secs_f64();
        Ok(DepthRecord { step: self.step, loss, lr, gradient, seconds, skipped })
    }

    /// Loss of the `index`-th item of the run, and its gradient by the weights.
    fn pass(&self, network: &DepthNetwork, index: usize) -> (f64, Vec<f32>) {
        match &self.cases.items[self.cases.sources.drawn(self.config.seed, index)] {
            Item::View(case) => {
                let Crop { inputs, exact } = self.crop(case, index);
                let recorded = network.record(&inputs);
                let (value, gradient) = loss(&inputs, &recorded.decoded, &exact);
                (value, network.backward(&inputs, &recorded, &gradient))
            }
            Item::Window(window) => self.window(network, window),
        }
    }

    /// The `index`-th item as a part of this view.
    fn crop(&self, case: &DepthCase, index: usize) -> Crop {
        let draw = |stream, n: usize| (bits(self.config.seed, stream, index) % n as u64) as usize;
        let (columns, rows) = case.blocks();
        let (width, height) = (self.config.crop.0.min(columns), self.config.crop.1.min(rows));
        let place = draw(Stream::Crop, (columns - width + 1) * (rows - height + 1));
        let corner = (place % (columns - width + 1), place / (columns - width + 1));
        case.crop(corner, (width, height), draw(Stream::Mirror, 2) == 1)
    }

    /// Loss of a window, and its gradient by the weights.
    fn window(&self, network: &DepthNetwork, window: &DepthWindow) -> (f64, Vec<f32>) {
        let passes: Vec<_> = window
            .cases
            .par_iter()
            .map(|case| {
                let Crop { inputs, .. } = case.whole();
                let recorded = network.record(&inputs);
                (inputs, recorded)
            })
            .collect();
        let step = window.step();
        let surface = |((inputs, recorded), view): (&(Inputs, Recorded), _)| {
            let decoded = &recorded.decoded;
            let corrected = inputs.stereo().iter().zip(&decoded.correction).map(|(own, by)| own + by);
            let (joined, confidence) = joined(inputs, decoded);
            let predicted = corrected.map(|steps| 1.0 / inputs.depth_of(steps)).collect();
            let stereo = by_stereo(inputs).map(|(w, _)| w).collect();
            Surface { view, predicted, stereo, joined, confidence }
        };
        let surfaces: Vec<Surface> = passes.iter().zip(&window.context).map(surface).collect();
        let weights =
            BetweenWeights { photometric: self.config.photometric, agreement: self.config.agreement };
        let (value, by_inverse_depth) = between::loss(&surfaces, &window.held_out, step, weights);
        let gradients: Vec<Vec<f32>> = passes
            .par_iter()
            .zip(by_inverse_depth)
            .map(|((inputs, recorded), by_inverse_depth)| {
                let gradient = by_correction(inputs, &recorded.decoded, &by_inverse_depth, step);
                network.backward(inputs, recorded, &gradient)
            })
            .collect();
        let mut sum = vec![0.0; self.weights.values.len()];
        for gradient in gradients {
            sum.iter_mut().zip(gradient).for_each(|(sum, g)| *sum += g);
        }
        (value, sum)
    }

    /// How good the depth of these views is with the network, and by stereo alone.
    ///
    /// # Errors
    /// If the weights are not finite.
    pub fn validate(&self, cases: &DepthCases) -> Result<[DepthScore; 2]> {
        score(&DepthNetwork::new(&self.weights)?, cases)
    }
}

/// Inverse depth and confidence by stereo.
fn by_stereo(inputs: &Inputs) -> impl Iterator<Item = (f32, f32)> {
    let inverse_depths = inputs.stereo().iter().map(|&steps| 1.0 / inputs.depth_of(steps));
    inverse_depths.zip(inputs.stereo_confidence())
}

/// Inverse depth and confidence, the network's where stereo confirms nothing.
fn joined(inputs: &Inputs, decoded: &Decoded) -> (Vec<f32>, Vec<f32>) {
    inputs.join(decoded, by_stereo(inputs))
}

/// The gradient of what the outputs mean, from that of the inverse depth. Beyond the far end, where there are no inverse depths, nothing pushes
/// farther.
fn by_correction(inputs: &Inputs, decoded: &Decoded, by_inverse_depth: &[f32], step: f32) -> Decoded {
    let steps = inputs.stereo().iter().zip(&decoded.correction).map(|(own, by)| own + by);
    let slope = |(steps, by): (f32, &f32)| if steps <= 0.0 && *by > 0.0 { 0.0 } else { step * by };
    Decoded {
        correction: steps.zip(by_inverse_depth).map(slope).collect(),
        log_error: vec![0.0; by_inverse_depth.len()],
        sky: vec![0.0; decoded.sky.len()],
    }
}

/// How good the depth of these views is with a network, and by stereo alone.
fn score(network: &DepthNetwork, cases: &DepthCases) -> Result<[DepthScore; 2]> {
    let found: Vec<_> = cases
        .views()
        .par_iter()
        .map(|case| {
            let whole = case.whole();
            let (exact, inputs) = (whole.exact_depth(), &whole.inputs);
            let decoded = network.run(inputs);
            let depth = |inverse: Vec<f32>| inverse.into_iter().map(|w| 1.0 / w).collect::<Vec<f32>>();
            let learned = joined(inputs, &decoded);
            let stereo: (Vec<f32>, Vec<f32>) = by_stereo(inputs).unzip();
            (exact, inputs.size().0, (depth(learned.0), learned.1), (depth(stereo.0), stereo.1))
        })
        .collect();
    let [mut learned, mut stereo] = [Collected::default(), Collected::default()];
    for (exact, width, by_network, by_stereo) in found {
        learned.add(&exact, &by_network.0, &by_network.1, width);
        stereo.add(&exact, &by_stereo.0, &by_stereo.1, width);
    }
    Ok([learned.score(), stereo.score()])
}

#[cfg(test)]
#[path = "trainer_tests.rs"]
mod tests;
