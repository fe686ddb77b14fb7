//! Rows on unseen views. What was measured is kept beside the weights: a run that was interrupted does not measure it again, nor does the one that
//! collects the rows of shards.

use super::Arguments;
use super::compare::ByWindow;
use crate::arguments::{Common, seeds};
use crate::failure::{Failure, OrFail, Outcome};
use crate::progress::{Progress, describe};
use crate::{device, output};
use anyhow::Context;
use evaluate::{Event, Lpips, Method, Runner, Spread, evaluate};
use scene_windows::{Dropped, GeometryCache, Plan, file_sha256};
use serde::{Deserialize, Serialize};
use sparsesplat::{Budget, Correction, Head};
use std::path::Path;
use train::Config;

/// Figures of one head on one set of windows.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct Scores {
    /// What they depend on.
    key: Key,
    pub(super) gaussians: f64,
    pub(super) psnr: f64,
    pub(super) ssim: f64,
    pub(super) lpips: Option<f64>,
    /// Over the sampling seeds, of the means.
    pub(super) spread: Option<Spread>,
    pub(super) psnr_by_window: ByWindow,
}

/// What figures depend on. Changes of the program that were not committed are not seen.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
struct Key {
    /// The commit that the program was built from.
    program: String,
    /// SHA-256 of the weights; none for the closed form.
    weights: Option<String>,
    scenes: String,
    config: String,
    seeds: Vec<u64>,
    /// SHA-256 of each file of the backbone's weights and of LPIPS.
    files: Vec<String>,
    device: Option<String>,
}

/// What is measured on.
pub(super) struct Set {
    /// `simulated` or `photographs`.
    pub(super) name: &'static str,
    /// What decides which windows they are: size, number of scenes, contents of files.
    pub(super) description: String,
    pub(super) plans: Vec<Plan>,
}

/// How heads are measured.
pub(super) struct Measure<'a> {
    pub(super) arguments: &'a Arguments,
    pub(super) common: &'a Common,
    pub(super) lpips: Option<&'a Lpips>,
}

impl Measure<'_> {
    /// The head with the anchors of `training` on a set; figures that are in `file` already, of the same head and windows, are read.
    /// Windows that were dropped join `dropped` under the name of the row, and figures without them are not kept.
    pub(super) fn scores(
        &self,
        head: &Head,
        training: &Config,
        set: &Set,
        (row, file): (&str, &Path),
        dropped: &mut Vec<Dropped>,
    ) -> Outcome<Scores> {
        let (backbone, _) = self.arguments.data.source.resolve()?;
        let config = sparsesplat::Config {
            backbone,
            head: head.clone(),
            neighbours: training.neighbours,
            allocation: training.allocation,
            sampler: training.sampler,
            // As the rows were trained: rules are compared as the paper has them.
            smooth_weight: 1.0,
            budget: Budget::Gaussians(self.arguments.gaussians),
            // Heads are compared, not what comes after them.
            looks: 1,
            correction: Correction::Off,
            ..sparsesplat::Config::default()
        };
        let hash = |path: &Path| {
            file_sha256(path).with_context(|| format!("{}: cannot read", path.display())).or_work()
        };
        let weights = match head {
            Head::Weights(path) => Some(hash(path)?),
            _ => None,
        };
        let mut rasterizer = device::rasterizer(self.common.device)?;
        let arguments = self.arguments;
        let seeds = seeds(&self.arguments.seeds);
        // The weights are named by what is in them, wherever the folder lies.
        let named = sparsesplat::Config { head: Head::Default, ..config.clone() };
        let key = Key {
            program: crate::recipe(0, ()).git,
            weights,
            scenes: set.description.clone(),
            config: serde_json::to_string(&named).or_work()?,
            seeds: seeds.clone(),
            files: arguments
                .data
                .source
                .files()
                .chain(arguments.lpips.paths())
                .map(hash)
                .collect::<Outcome<_>>()?,
            device: rasterizer.adapter().map(|adapter| adapter.name.clone()),
        };
        let is_known = key.program != UNKNOWN;
        if let Some(kept) = read(file).filter(|kept| is_known && kept.key == key) {
            return Ok(kept);
        }
        let cache = Some(GeometryCache { folder: self.arguments.data.cache.clone() });
        let method = Method { cache, ..Method::feed_forward(config) };
        let runner = Runner::on(method, device::of_networks(self.common.device)).map_err(Failure::sorted)?;
        let progress = Progress::new(set.plans.len() * seeds.len());
        let mut running = String::new();
        let found =
            evaluate(&set.plans, &runner, &seeds, self.lpips, &mut rasterizer, &mut |event| match event {
                Event::Run { name, seed } => running = format!("{name} (seed {seed})"),
                Event::Step(step) => progress.say(format!("{running}: {}", describe(step))),
                Event::Done { .. } => progress.step(),
                Event::Dropped(dropped) => {
                    progress.warn(&format!("dropped {}: {}", dropped.name, dropped.reason));
                }
                _ => {}
            });
        let figures = &found.mean.figures;
        let scores = Scores {
            key,
            gaussians: figures.gaussians,
            psnr: figures.psnr_held_out,
            ssim: figures.ssim_held_out,
            lpips: figures.lpips_held_out,
            spread: found.mean.spread,
            psnr_by_window: found
                .windows
                .iter()
                .map(|window| (window.name.clone(), window.figures.psnr_held_out))
                .collect(),
        };
        if found.dropped.is_empty() {
            output::write_json(file, &scores)?;
        }
        let head_name = match head {
            Head::ClosedForm => "closed form",
            _ => "trained head",
        };
        dropped.extend(found.dropped.into_iter().map(|lost| {
            let name = format!("{} of {row}, {head_name}", lost.name);
            Dropped { name, ..lost }
        }));
        Ok(scores)
    }
}

/// What the recipe says of a program that was built outside a checkout.
const UNKNOWN: &str = "unknown";

/// What is in a file of figures; none if it is not there or is of another version.
fn read(file: &Path) -> Option<Scores> {
    serde_json::from_slice(&std::fs::read(file).ok()?).ok()
}
