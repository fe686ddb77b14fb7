//! The training loop, one step at a time.

use crate::adam::{Adam, Taken};
use crate::checkpoint::{self, Progress};
use crate::draw::{Stream, some};
use crate::loss::{Loss, clipped_mse};
use crate::net::Net;
use crate::ops::{Decode, Render, gaussians, lock, rows, values};
use crate::prepared::{Prepared, RefinedScenes, anchored, prepared};
use crate::{Cases, Config, Error, Ranks, Result, photographs};
use attn_head::{LAST_LAYER, Layout, OUTPUTS, Weights};
use candle_core::{Device, Tensor, Var};
use gs_raster::{Rasterizer, RenderSettings, near_plane};
use gs_scene::View;
use image_metrics::Lpips;
use serde::Serialize;
use sparsesplat::Anchored;
use sparsesplat::learned::{
    BY_DIRECTION, COVISIBLE, FEATURES, PARAMETRISATION, Parametrisation, corrector_features,
    geometry_features, image_features,
};
use std::collections::BTreeMap;
use std::path::Path;
use std::sync::{Arc, Mutex};
use std::time::Instant;

/// A training run.
pub struct Trainer {
    config: Config,
    cases: Cases,
    net: Net,
    weights: Vec<f32>,
    adam: Adam,
    /// Steps done.
    step: usize,
    skipped: usize,
    schema: String,
    lpips: Option<Lpips>,
    rasterizer: Arc<Mutex<Rasterizer>>,
    /// How views are rendered; the near plane is each view's own.
    rendering: RenderSettings,
    ranks: Arc<Ranks>,
    /// Whether the ranks are known to do the same.
    agreed: bool,
    scenes: RefinedScenes,
}

/// What a step did.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Record {
    /// Counted from 1.
    pub step: usize,
    /// Mean loss of the pictures that were compared; of a skipped step whatever it was.
    pub loss: f64,
    /// Mean PSNR of the same, dB.
    pub psnr: f64,
    /// Learning rate.
    pub lr: f64,
    /// Length of the gradient before clipping.
    pub gradient: f64,
    /// Mean number of Gaussians.
    pub gaussians: f64,
    /// Wall time, seconds.
    pub seconds: f64,
    /// Loss or gradient was not finite: nothing was changed.
    pub skipped: bool,
}

/// A head held against the closed form on held-out views, or a corrector against the scene that it corrects; means over windows.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Score {
    /// Number of Gaussians as a share of the context's pixels.
    pub density: f64,
    /// Of the head, dB.
    pub psnr: f64,
    /// Of the closed form, or of the refined scene, dB.
    pub psnr_closed_form: f64,
}

/// A held-out view, and what is made of it: pixels `[height, width, 3]`.
#[derive(Debug, Clone, Copy)]
pub struct Look<'a> {
    /// Name of its window.
    pub scene: &'a str,
    /// The view.
    pub photograph: &'a View,
    /// The head's rendering.
    pub learned: &'a [f32],
    /// The closed form's, or the refined scene's.
    pub closed_form: &'a [f32],
}

/// One pass over a window.
struct Pass {
    loss: f64,
    clipped_mse: Vec<f64>,
    gaussians: usize,
    gradient: Vec<f32>,
}

impl Trainer {
    /// A run from the beginning, with weights drawn by the seed.
    ///
    /// # Errors
    /// If a setting is out of its range, or a case cannot be read.
    pub fn new(config: Config, cases: Cases, rasterizer: Rasterizer) -> Result<Self> {
        config.check()?;
        let first = cases.read(0)?;
        let features = first.geometry.views.first().and_then(|geometry| geometry.features.as_ref());
        let (channels, schema) = features.map_or((0, ""), |map| (map.channels(), map.schema()));
        let head = attn_head::Config {
            kind: config.head,
            geometry: features_per_anchor(&config),
            image: image_features(channels),
            neighbours: config.neighbours,
        };
        let weights = Weights::initial(head, config.seed)?.values;
        Ok(Self {
            net: Net::new(head),
            adam: Adam::new(weights.len()),
            weights,
            step: 0,
            skipped: 0,
            schema: schema.to_owned(),
            lpips: None,
            rasterizer: Arc::new(Mutex::new(rasterizer)),
            rendering: RenderSettings::default(),
            ranks: Arc::new(Ranks::alone()),
            agreed: false,
            scenes: RefinedScenes::default(),
            config,
            cases,
        })
    }

    /// Begins with the weights of an earlier run instead of drawn ones; with those of several with their mean, which is of use where
    /// one run began with what another had made. Of what they add to colours by direction [`Config::keep_direction`] is kept. `runs` are
    /// names, for errors, and weights; none changes nothing. Those of a run that saw no feedback ignore it.
    ///
    /// # Errors
    /// If one is of a head of another shape, or was trained on other features.
    pub fn start_from(&mut self, runs: &[(String, Weights)]) -> Result<()> {
        let config = self.net.config();
        let mut begun = Vec::with_capacity(runs.len());
        for (name, weights) in runs {
            let said =
                |metadata: &BTreeMap<String, String>, key| metadata.get(key).cloned().unwrap_or_default();
            let same = attn_head::Config { geometry: config.geometry, ..weights.config } == config
                && [FEATURES, PARAMETRISATION, COVISIBLE]
                    .iter()
                    .all(|key| said(&self.metadata(), *key) == said(&weights.metadata, *key));
            let known = [config.geometry, geometry_features(true), geometry_features(false)];
            let found = weights.config.geometry;
            let known = known.contains(&found) && found <= config.geometry;
            if !same || !known {
                return Err(Error::OtherHead {
                    weights: name.clone(),
                    expected: format!("{config:?}, {:?}", self.metadata()),
                    found: format!("{:?}, {:?}", weights.config, weights.metadata),
                });
            }
            begun.push(weights.widened(config.geometry)?.values);
        }
        if !begun.is_empty() {
            for (i, weight) in self.weights.iter_mut().enumerate() {
                let sum: f64 = begun.iter().map(|values| f64::from(values[i])).sum();
                *weight = (sum / begun.len() as f64) as f32;
            }
            for parameter in Layout::new(&config).parameters {
                if parameter.name.starts_with(LAST_LAYER) {
                    let row = parameter.len() / OUTPUTS;
                    let [begin, end] =
                        [BY_DIRECTION.start, BY_DIRECTION.end].map(|output| parameter.offset + output * row);
                    self.weights[begin..end]
                        .iter_mut()
                        .for_each(|weight| *weight *= self.config.keep_direction);
                }
            }
        }
        Ok(())
    }

    /// Takes LPIPS for the structural term of the loss, as the paper does, instead of 1 - SSIM.
    #[must_use]
    pub fn with_lpips(self, lpips: Lpips) -> Self {
        Self { lpips: Some(lpips), ..self }
    }

    /// Shares the windows of each step out among processes. All of them make the same trainer, call [`Trainer::step`] equally often, and
    /// have the same weights after each step; up to rounding of sums in f64 these are those of one process.
    ///
    /// # Errors
    /// If there are more ranks than windows per step.
    pub fn on_ranks(self, ranks: Arc<Ranks>) -> Result<Self> {
        let batch = self.config.batch;
        if ranks.count() > batch {
            return Err(Error::IdleRanks { ranks: ranks.count(), batch });
        }
        Ok(Self { ranks, agreed: false, ..self })
    }

    fn structure(&self) -> String {
        self.lpips
            .as_ref()
            .map_or("1 - SSIM".to_owned(), |lpips| format!("LPIPS ({})", lpips.network().name()))
    }

    fn device(&self) -> String {
        lock(&self.rasterizer).adapter().map_or_else(|| "CPU".to_owned(), |adapter| adapter.name.clone())
    }

    /// Goes on where a checkpoint was written.
    ///
    /// # Errors
    /// If it cannot be read, or is of a run with another configuration, other data, another structural term or another device to
    /// render on.
    pub fn resume(&mut self, path: &Path) -> Result<()> {
        let (progress, weights, adam) =
            checkpoint::read(path, checkpoint::KIND, self.weights.len(), |progress: &Progress| {
                progress.updates
            })?;
        let other = |what| Err(Error::OtherRun { path: path.to_path_buf(), what });
        if progress.config != self.config {
            return other("configuration");
        }
        if progress.data != self.cases.sha256() {
            return other("data");
        }
        if progress.structure != self.structure() {
            return other("structural term of the loss");
        }
        if progress.device != self.device() {
            return other("device to render on");
        }
        (self.weights, self.adam) = (weights, adam);
        (self.step, self.skipped) = (progress.step, progress.skipped);
        self.agreed = false;
        Ok(())
    }

    /// Writes a checkpoint; a reader never sees half of it.
    ///
    /// # Errors
    /// If it cannot be written.
    pub fn save(&self, path: &Path) -> Result<()> {
        checkpoint::write(path, checkpoint::KIND, &self.progress(), &self.weights, &self.adam)
    }

    fn progress(&self) -> Progress {
        Progress {
            config: self.config.clone(),
            data: self.cases.sha256().to_owned(),
            structure: self.structure(),
            device: self.device(),
            step: self.step,
            skipped: self.skipped,
            updates: self.adam.updates,
        }
    }

    /// That all ranks are at the same step of the same run.
    fn agree(&mut self) -> Result<()> {
        let state = checkpoint::digest(&self.progress(), &self.weights, &self.adam);
        self.agreed = self.ranks.agree(state);
        if self.agreed { Ok(()) } else { Err(Error::RanksDiffer) }
    }

    /// The settings.
    #[must_use]
    pub fn config(&self) -> &Config {
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

    /// The head as it is.
    #[must_use]
    pub fn weights(&self) -> Weights {
        Weights { config: self.net.config(), values: self.weights.clone(), metadata: self.metadata() }
    }

    /// Metadata of the weights: what their user must know.
    fn metadata(&self) -> BTreeMap<String, String> {
        let mut all = BTreeMap::from([(FEATURES.to_owned(), self.schema.clone())]);
        if self.config.parametrisation != Parametrisation::default() {
            all.insert(PARAMETRISATION.to_owned(), self.config.parametrisation.name().to_owned());
        }
        if self.config.covisible > 0 {
            all.insert(COVISIBLE.to_owned(), self.config.covisible.to_string());
        }
        all
    }

    /// One step: passes over a batch of windows, one update.
    ///
    /// # Errors
    /// If a case cannot be read, or a stage fails. On several ranks the others then wait for this one until it calls [`Ranks::abort`].
    /// Before the first step, if the ranks differ in what they are to do. A loss or gradient that is not finite is no error: the step is
    /// skipped, on all ranks.
    pub fn step(&mut self) -> Result<Record> {
        let begin = Instant::now();
        if !self.agreed {
            self.agree()?;
        }
        let (numbers, batch) = (self.weights.len(), self.config.batch);
        // The gradient, then loss, Gaussians, PSNR and pictures. Sums of numbers of f32 in f64 are exact, unless they differ by eight orders
        // of magnitude: it makes no difference how the passes are shared out.
        let mut sums = vec![0.0f64; numbers + 4];
        for item in (self.ranks.rank()..batch).step_by(self.ranks.count()) {
            let pass = self.pass(self.step * batch + item)?;
            let psnr = pass.clipped_mse.iter().map(|mse| decibel(*mse)).sum();
            let figures = [pass.loss, pass.gaussians as f64, psnr, pass.clipped_mse.len() as f64];
            let all = pass.gradient.iter().map(|g| f64::from(*g)).chain(figures);
            sums.iter_mut().zip(all).for_each(|(sum, value)| *sum += value);
        }
        self.ranks.sum(&mut sums);
        let mean = |sum: f64| sum / batch as f64;
        let (loss, gaussians, psnr) =
            (mean(sums[numbers]), mean(sums[numbers + 1]), sums[numbers + 2] / sums[numbers + 3]);
        let gradients = sums[..numbers].iter().map(|sum| mean(*sum) as f32).collect();
        let position = (self.step, self.config.steps);
        let Taken { lr, gradient, skipped } =
            self.adam.step(&self.config.rates, position, &mut self.weights, gradients, loss);
        self.skipped += usize::from(skipped);
        self.step += 1;
        let seconds = begin.elapsed().as_secs_f64();
        Ok(Record { step: self.step, loss, psnr, lr, gradient, gaussians, seconds, skipped })
    }

    /// Loss and gradient of the `index`-th pass of the run.
    fn pass(&self, index: usize) -> Result<Pass> {
        let seed = self.config.seed;
        let prepared = prepared(&self.config, &self.cases, &self.scenes, index)?;
        let Prepared { case, anchored } = &*prepared;
        let targets = some(seed, Stream::Target, index, case.targets.len(), self.config.targets);
        let contexts = some(seed, Stream::Context, index, case.context.len(), self.config.contexts);
        let held_out = targets.iter().map(|&i| (&case.targets[i], case.photographs));
        let views: Vec<(&View, bool)> =
            held_out.chain(contexts.iter().map(|&i| (&anchored.views[i], false))).collect();

        let weights = Var::from_slice(&self.weights, self.weights.len(), &Device::Cpu)?;
        let feedback = anchored.feedback(self.config.feedback)?;
        let outputs =
            self.net.outputs(&weights, anchored.inputs(self.config.head, &case.geometry.views, &feedback))?;
        let by_direction = outputs.narrow(1, BY_DIRECTION.start, BY_DIRECTION.len())?;
        let share = f64::from(self.config.direction) / by_direction.elem_count().max(1) as f64;
        let by_direction = (by_direction.sqr()?.sum_all()? * share)?;
        let decode = Decode {
            decoder: Arc::new(anchored.decoder(self.config.parametrisation)),
            shell: Arc::new(anchored.shell.clone()),
        };
        let made = self.looked(anchored, outputs.apply_op1(decode)?)?;
        let mut total: Option<Tensor> = None;
        let mut mse = Vec::new();
        for &(view, unknown) in &views {
            let render = Render {
                rasterizer: Arc::clone(&self.rasterizer),
                camera: *view.camera(),
                settings: self.settings(anchored, view),
                tape: Mutex::default(),
            };
            let picture = made.apply_op1(render)?;
            let rendering = values(&picture)?;
            let comparable = unknown
                .then(|| photographs::comparable(view, &rendering, &anchored.views, &case.geometry.views));
            let view = comparable.as_ref().unwrap_or(view);
            mse.push(clipped_mse(&rendering, view));
            let loss = Loss::new(view, self.config.lambda, self.lpips.as_ref())?.of(&picture)?;
            total = Some(match total {
                None => loss,
                Some(total) => (total + loss)?,
            });
        }
        let Some(total) = total else { return Err(Error::NoTargets { window: case.name.clone() }) };
        let loss = ((total / views.len() as f64)? + by_direction)?;
        let value = f64::from(loss.to_scalar::<f32>()?);
        let gradient = if value.is_finite() {
            match loss.backward()?.get(&weights) {
                Some(gradient) => values(gradient)?,
                None => vec![0.0; self.weights.len()],
            }
        } else {
            vec![f32::NAN; self.weights.len()]
        };
        Ok(Pass { loss: value, clipped_mse: mse, gaussians: anchored.counts.total, gradient })
    }

    /// Rows of Gaussians after the looks that the configuration asks for. What these change is a constant to the gradient.
    fn looked(&self, anchored: &Anchored, made: Tensor) -> Result<Tensor> {
        if self.config.looks < 2 {
            return Ok(made);
        }
        let before = values(&made)?;
        let looked = rows(&anchored.looked(gaussians(&before)?, self.config.looks)?);
        let change = looked.iter().zip(&before).map(|(after, before)| after - before).collect();
        Ok((&made + Tensor::from_vec(change, made.shape(), made.device())?)?)
    }

    /// Held-out PSNR of the head and of the closed form, after the looks of the configuration, on the targets of `cases`, at one density; `look` is given each
    /// target with what head and closed form make of it.
    ///
    /// # Errors
    /// As [`Trainer::step`].
    pub fn validate(&self, cases: &Cases, density: f64, look: &mut dyn FnMut(Look<'_>)) -> Result<Score> {
        let mut sums = [0.0; 2];
        for index in 0..cases.len() {
            let case = cases.read(index)?;
            let mut anchored = anchored(&self.config, &case, density, self.config.seed)?;
            if let Some(&steps) = self.config.refined.first() {
                anchored = anchored.predicted_and_refined(&case.geometry.views, steps)?;
            }
            let weights = Tensor::from_slice(&self.weights, self.weights.len(), &Device::Cpu)?;
            let feedback = anchored.feedback(self.config.feedback)?;
            let outputs = values(
                &self
                    .net
                    .outputs(&weights, anchored.inputs(self.config.head, &case.geometry.views, &feedback))?,
            )?;
            let mut learned = anchored.decoder(self.config.parametrisation).decode(&outputs);
            learned.append(&anchored.shell.clone().with_sh_degree(learned.sh_degree())?);
            let mut closed = anchored.base.clone();
            closed.append(&anchored.shell);
            let [learned, closed] = [learned, closed].map(|scene| anchored.looked(scene, self.config.looks));
            let (learned, closed) = (learned?, closed?);
            for view in &case.targets {
                let mut pictures = [Vec::new(), Vec::new()];
                for ((scene, sum), picture) in
                    [&learned, &closed].into_iter().zip(&mut sums).zip(&mut pictures)
                {
                    let rendering = lock(&self.rasterizer).render(
                        scene,
                        view.camera(),
                        &self.settings(&anchored, view),
                    )?;
                    let mse = clipped_mse(rendering.image.data(), view);
                    *sum += decibel(mse) / (case.targets.len() * cases.len()) as f64;
                    *picture = rendering.image.data().to_vec();
                }
                let [learned, closed_form] = &pictures;
                look(Look { scene: &case.name, photograph: view, learned, closed_form });
            }
        }
        Ok(Score { density, psnr: sums[0], psnr_closed_form: sums[1] })
    }

    /// The near plane is that of the closed form: it must not move under the optimiser.
    fn settings(&self, anchored: &Anchored, view: &View) -> RenderSettings {
        RenderSettings { near: near_plane(&anchored.base, view.camera()), ..self.rendering }
    }
}

/// Geometric features per anchor of what a run trains.
fn features_per_anchor(config: &Config) -> usize {
    if config.refined.is_empty() { geometry_features(config.feedback) } else { corrector_features() }
}

fn decibel(mse: f64) -> f64 {
    -10.0 * mse.log10()
}

#[cfg(test)]
#[path = "trainer_tests.rs"]
mod tests;
