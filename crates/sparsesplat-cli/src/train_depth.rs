//! `train-depth`: the network behind the plane sweep.

use crate::arguments::{Common, positive, scenes, size};
use crate::failure::{OrFail, Outcome};
use crate::output::{self, Outputs};
use crate::progress::Progress;
use crate::summary::print_line;
use crate::train::{self, VALIDATION_SEED};
use crate::train_folder::{Folder, Log};
use ::train::depth::{DepthCases, DepthConfig, DepthScore, DepthTrainer};
use clap::Args;
use depth_backbone::DepthWeights;
use evaluate::{Recipe, peak_rss_bytes};
use scene_sim::Kind;
use scene_windows::SimulatedScene;
use serde::Serialize;
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::time::Instant;

/// Train the network that improves stereo's depth
///
/// Generated scenes are ray-traced and matched once; --cache keeps the results. Each step draws crops of their views and compares the
/// network's depth with the exact one. --output receives checkpoint.safetensors (for --resume), weights.safetensors (for --depth of the
/// other commands) and log.jsonl.
#[derive(Debug, Args)]
#[command(after_help = crate::arguments::SEE_LONG_HELP, after_long_help = "Examples:\n  \
    sparsesplat train-depth -o run\n  \
    sparsesplat train-depth -o run --resume                  resumes after an interruption, bit for bit\n  \
    sparsesplat reconstruct PHOTOS --depth run/weights.safetensors -o scene.ply\n\n\
    A configuration is a RON file. Settings that it leaves out have the defaults, which --print-config prints.")]
pub(crate) struct Arguments {
    /// Output folder for checkpoint, weights and log
    #[arg(short, long, value_name = "DIR", required_unless_present = "print_config")]
    output: Option<PathBuf>,
    /// Training settings (RON)
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// Start from these weights instead of random ones
    #[arg(long, value_name = "FILE")]
    from: Option<PathBuf>,
    /// Print all settings and stop
    #[arg(long)]
    print_config: bool,
    /// Number of generated scenes
    #[arg(long, value_name = "N", value_parser = scenes(1), default_value_t = 140)]
    scenes: usize,
    /// Number of additional scenes in the wild: wider baselines, varying exposure, noise, slightly wrong poses, woods
    #[arg(long, value_name = "N", value_parser = scenes(0), default_value_t = 140)]
    wild_scenes: usize,
    /// Seed of the first scene; the scenes of `eval` start at 0 and must stay unseen
    #[arg(long, value_name = "SEED", default_value_t = 1000, hide_short_help = true)]
    first_seed: u64,
    /// Number of generated scenes for validation, seeds 500, 501, ...; half of them in the wild
    #[arg(long, value_name = "N", value_parser = scenes(1), default_value_t = 12, hide_short_help = true)]
    validation_scenes: usize,
    /// Size of the pictures
    #[arg(long, value_name = "WxH", value_parser = size, default_value = "320x208")]
    size: (usize, usize),
    /// Cache folder for views with what stereo found
    #[arg(long, value_name = "DIR", default_value = "train-cache")]
    cache: PathBuf,
    /// Steps between validations
    #[arg(long, value_name = "STEPS", value_parser = positive, default_value_t = 500)]
    validate_every: usize,
    /// Steps between checkpoints
    #[arg(long, value_name = "STEPS", value_parser = positive, default_value_t = 100, hide_short_help = true)]
    save_every: usize,
    /// Resume from the checkpoint in --output, if there is one
    #[arg(long)]
    resume: bool,
}

/// A line of the log of a validation.
#[derive(Clone, Copy, Serialize)]
struct Validation {
    step: usize,
    learned: DepthScore,
    stereo: DepthScore,
}

/// What `--json` writes.
#[derive(Serialize)]
struct Record<C> {
    recipe: Recipe<C>,
    /// Steps of the whole run, and those of them that were skipped.
    steps: usize,
    skipped: usize,
    /// Of this process.
    seconds: f64,
    views: usize,
    data_sha256: String,
    weights: PathBuf,
    validation: Option<Validation>,
    peak_rss_bytes: Option<u64>,
}

/// Generated scenes as they are, and in the wild.
fn generated(clean: Range<u64>, wild: Range<u64>) -> Vec<SimulatedScene> {
    let clean = clean.map(|seed| SimulatedScene::Generated(Kind::of_seed(seed), seed));
    clean.chain(wild.map(|seed| SimulatedScene::InTheWild(Kind::of_seed_in_the_wild(seed), seed))).collect()
}

pub(crate) fn run(arguments: &Arguments, common: &Common) -> Outcome {
    let config = train::read_config(arguments.config.as_deref(), DepthConfig::check)?;
    if arguments.print_config {
        print_line(&ron::ser::to_string_pretty(&config, ron::ser::PrettyConfig::default()).or_work()?);
        return Ok(());
    }
    let named = arguments.config.iter().chain(&arguments.from).map(PathBuf::as_path);
    Outputs::of(common).spare(named)?;
    let first = arguments.first_seed;
    let middle = first.saturating_add(arguments.scenes as u64);
    let last = middle.saturating_add(arguments.wild_scenes as u64);
    let held_out = VALIDATION_SEED..VALIDATION_SEED + arguments.validation_scenes as u64;
    train::keep_apart(first..last, &held_out, "validated")?;
    let output = arguments.output.as_deref().unwrap_or(Path::new("."));
    let folder = Folder::begin(output, arguments.resume)?;
    let cases = open(&generated(first..middle, middle..last), arguments)?;
    let half = held_out.start + (held_out.end - held_out.start).div_ceil(2);
    let validation = open(&generated(held_out.start..half, half..held_out.end), arguments)?;
    print_line(&format!("views      {}, sha256 {}", cases.len(), cases.sha256()));
    let (views, data_sha256) = (cases.len(), cases.sha256().to_owned());
    let mut trainer = DepthTrainer::new(config, cases).or_work()?;
    if let Some(path) = &arguments.from {
        trainer.start_from(DepthWeights::read(path).or_input()?);
    }
    let begin = Instant::now();
    let last = complete(&folder, &mut trainer, &validation, arguments)?;
    let (steps, skipped, seconds) = (trainer.steps(), trainer.skipped(), begin.elapsed().as_secs_f64());
    if let Some(path) = &common.json {
        let record = Record {
            recipe: crate::recipe(trainer.config().seed, trainer.config()),
            steps,
            skipped,
            seconds,
            views,
            data_sha256,
            weights: folder.weights(),
            validation: last,
            peak_rss_bytes: peak_rss_bytes(),
        };
        output::write_json(path, &record)?;
    }
    print_line(&format!("trained    {steps} steps, {skipped} skipped, {seconds:.0} s"));
    print_line(&format!("weights    {}", folder.weights().display()));
    Ok(())
}

/// Views of scenes, from the cache or made.
fn open(scenes: &[SimulatedScene], arguments: &Arguments) -> Outcome<DepthCases> {
    output::check_folder(&arguments.cache)?;
    let progress = Progress::new(scenes.len());
    progress.say("preparing views");
    let on_scene = &|name: &str, why: Option<&depth_backbone::Error>| {
        if let Some(why) = why {
            progress.warn(&format!("dropped {name}: {why}"));
        }
        progress.step();
    };
    DepthCases::open(scenes, arguments.size, &arguments.cache, on_scene).or_work()
}

/// A score in a line.
fn described(score: DepthScore) -> String {
    format!(
        "relative error {:.4} (median {:.4}), within 2 % {:.3}, 5 % {:.3}, at edges {:.3}; confident {:.3}, of them within 5 % {:.3}; \
         sparsification {:.4}",
        score.relative,
        score.median,
        score.within_2,
        score.within_5,
        score.edges_within_5,
        score.confident,
        score.confident_within_5,
        score.sparsification
    )
}

/// All steps that are left; the last validation.
fn complete(
    folder: &Folder,
    trainer: &mut DepthTrainer,
    validation: &DepthCases,
    arguments: &Arguments,
) -> Outcome<Option<Validation>> {
    if folder.checkpoint().exists() {
        trainer.resume(&folder.checkpoint()).or_input()?;
        print_line(&format!("resumed    after step {}", trainer.steps()));
    }
    let steps = trainer.config().steps;
    let recipe = crate::recipe(trainer.config().seed, trainer.config().clone());
    let mut log = Log::open(&folder.log(), trainer.steps(), &recipe)?;
    let progress = Progress::new(steps);
    progress.set(trainer.steps());
    let (mut loss, mut last) = (f64::NAN, None);
    let mut validate = |trainer: &DepthTrainer, loss: f64, log: &mut Log| -> Outcome {
        let [learned, stereo] = trainer.validate(validation).or_work()?;
        progress.line(&format!("step {}: loss {loss:.3}", trainer.steps()));
        for (name, score) in [("learned", learned), ("stereo", stereo)] {
            progress.line(&format!("    {name:<8}{}", described(score)));
        }
        last = Some(Validation { step: trainer.steps(), learned, stereo });
        log.write(&last)
    };
    if steps == 0 {
        validate(trainer, loss, &mut log)?;
    }
    while trainer.steps() < steps {
        let record = trainer.step().or_work()?;
        loss = if loss.is_nan() { record.loss } else { loss + 0.02 * (record.loss - loss) };
        progress.step();
        progress.say(format!(
            "loss {loss:.3}, {:.2} s per step, {} skipped",
            record.seconds,
            trainer.skipped()
        ));
        log.write(&record)?;
        let (step, done) = (trainer.steps(), trainer.steps() == steps);
        if step.is_multiple_of(arguments.validate_every) || done {
            validate(trainer, loss, &mut log)?;
        }
        if step.is_multiple_of(arguments.save_every) && !done {
            log.flush()?;
            trainer.save(&folder.checkpoint()).or_work()?;
            trainer.weights().write(folder.weights()).or_work()?;
        }
    }
    log.flush()?;
    trainer.save(&folder.checkpoint()).or_work()?;
    trainer.weights().write(folder.weights()).or_work()?;
    Ok(last)
}
