//! `train`: a head, on a frozen backbone.

use crate::arguments::{Common, positive, size};
use crate::datasets::Dataset;
use crate::device;
use crate::failure::{Failure, OrFail, Outcome};
use crate::output;
use crate::progress::Progress;
use crate::summary::print_line;
use anyhow::Context;
use clap::Args;
use evaluate::{Picture, Plan, Reading, Recipe, SimulatedScene, Windows};
use gs_scene::Image;
use scene_sim::Kind;
use serde::Serialize;
use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::time::Instant;
use train::{Cases, Config, Record, Score, Trainer};

/// Trains a head on a frozen backbone, through the differentiable renderer
///
/// Windows are rendered or read, given to the backbone once, and kept in --cache. Each step draws windows, budgets, pixels and
/// views by the seed, compares renderings with photographs and moves the head's weights. --output receives
/// checkpoint.safetensors (to go on with --resume), weights.safetensors (for --weights of the other commands), log.jsonl, curve.svg
/// and pictures of validation.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  \
    sparsesplat train -o run                                       the default head on simulated scenes\n  \
    sparsesplat train -o run --resume                              goes on after an interruption, bit for bit\n  \
    sparsesplat train -o run --config mlp.ron --scenes 40\n  \
    sparsesplat train -o run --dataset nerfstudio --root photographs --size 240x160\n\n\
    A configuration is RON; what it leaves out is as in the default, which --print-config shows.")]
pub(crate) struct Arguments {
    /// Folder for checkpoint, weights, log, curve and pictures
    #[arg(short, long, value_name = "DIR", required_unless_present = "print_config")]
    output: Option<PathBuf>,
    /// Settings of the training
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// Print the settings as they would be used, and stop
    #[arg(long)]
    print_config: bool,
    /// What to train on
    #[arg(long, value_enum, default_value = "simulated")]
    dataset: Dataset,
    /// Folder of a scene, or of several
    #[arg(long, value_name = "DIR")]
    root: Option<PathBuf>,
    /// With simulated: so many generated scenes
    #[arg(long, value_name = "N", value_parser = positive, default_value_t = 240)]
    scenes: usize,
    /// With simulated: seed of the first; those of `eval` begin at 0 and must stay unseen
    #[arg(long, value_name = "SEED", default_value_t = 1000)]
    first_seed: u64,
    /// Generated scenes to validate on, seeds 500, 501, ...
    #[arg(long, value_name = "N", value_parser = positive, default_value_t = 8)]
    validation_scenes: usize,
    /// Validate after so many steps
    #[arg(long, value_name = "STEPS", value_parser = positive, default_value_t = 500)]
    validate_every: usize,
    /// Write a checkpoint after so many steps
    #[arg(long, value_name = "STEPS", value_parser = positive, default_value_t = 50)]
    save_every: usize,
    /// Size of the pictures
    #[arg(long, value_name = "WxH", value_parser = size, default_value = "240x160")]
    size: (usize, usize),
    /// Where windows and what the backbone says of them are kept
    #[arg(long, value_name = "DIR", default_value = "train-cache")]
    cache: PathBuf,
    /// Go on from the checkpoint in --output, if there is one
    #[arg(long)]
    resume: bool,
}

/// Densities that are validated.
const DENSITIES: [f64; 2] = [0.02, 0.1];
/// First seed of the scenes to validate on.
const VALIDATION_SEED: u64 = 500;

/// A line of the log of a validation.
#[derive(Serialize)]
struct Validation {
    step: usize,
    validation: Vec<Score>,
}

pub(crate) fn run(arguments: &Arguments, common: &Common) -> Outcome {
    let config = config(arguments.config.as_deref())?;
    if arguments.print_config {
        print_line(&ron::ser::to_string_pretty(&config, ron::ser::PrettyConfig::default()).or_work()?);
        return Ok(());
    }
    let folder = arguments.output.as_deref().unwrap_or(Path::new("."));
    output::check_folder(folder)?;
    output::check_folder(&arguments.cache)?;
    let predict = sparsesplat::Config::default();
    let plans = plans(arguments)?;
    let validation = simulated(VALIDATION_SEED, arguments.validation_scenes, arguments.size);
    let cases = |plans: &[Plan]| {
        let progress = Progress::new(plans.len());
        progress.say("preparing windows");
        Cases::open(plans, &predict, &arguments.cache, &mut |_, _| progress.step()).or_work()
    };
    let (cases, validation) = (cases(&plans)?, cases(&validation)?);
    print_line(&format!("windows    {}, sha256 {}", cases.len(), cases.sha256()));

    let rasterizer = device::rasterizer(common.device)?;
    let steps = config.steps;
    let recipe = Recipe::of_this_run(config.seed, crate::threads(), config.clone());
    let mut trainer = Trainer::new(config, cases, rasterizer).or_work()?;
    let checkpoint = folder.join("checkpoint.safetensors");
    let log = folder.join("log.jsonl");
    if arguments.resume && checkpoint.exists() {
        trainer.resume(&checkpoint).or_input()?;
        print_line(&format!("resumed    after step {}", trainer.steps()));
    }
    let mut log = Log::open(&log, trainer.steps(), &recipe)?;
    let progress = Progress::new(steps);
    progress.set(trainer.steps());
    let begin = Instant::now();
    let (mut psnr, mut loss) = (f64::NAN, f64::NAN);
    while trainer.steps() < steps {
        let record = trainer.step().or_work()?;
        let mean = |mean: f64, new: f64| if mean.is_nan() { new } else { mean + 0.02 * (new - mean) };
        (psnr, loss) = (mean(psnr, record.psnr), mean(loss, record.loss));
        progress.step();
        progress.say(format!(
            "loss {loss:.4}, {psnr:.2} dB, {:.2} s per step, {} skipped",
            record.seconds,
            trainer.skipped()
        ));
        log.step(&record)?;
        let done = trainer.steps() == steps;
        if trainer.steps().is_multiple_of(arguments.validate_every) || done {
            let scores = validate(&trainer, &validation, folder)?;
            let line = scores.iter().map(|score| {
                let Score { density, psnr, psnr_closed_form } = score;
                format!("{density}: {psnr:.2} dB ({:+.2})", psnr - psnr_closed_form)
            });
            progress.line(&format!("step {}: held-out at density {}", trainer.steps(), line.collect::<Vec<_>>().join(", ")));
            log.write(&Validation { step: trainer.steps(), validation: scores })?;
        }
        if trainer.steps().is_multiple_of(arguments.save_every) || done {
            log.flush()?;
            trainer.save(&checkpoint).or_work()?;
            trainer.weights().write(&folder.join("weights.safetensors")).or_work()?;
        }
    }
    drop(progress);
    print_line(&format!("trained    {} steps, {} skipped, {:.0} s", trainer.steps(), trainer.skipped(), begin.elapsed().as_secs_f64()));
    print_line(&format!("weights    {}", folder.join("weights.safetensors").display()));
    Ok(())
}

fn config(path: Option<&Path>) -> Outcome<Config> {
    let Some(path) = path else { return Ok(Config::default()) };
    let text = fs::read_to_string(path).with_context(|| format!("{}: cannot read", path.display())).or_input()?;
    let options = ron::Options::default().with_default_extension(ron::extensions::Extensions::IMPLICIT_SOME);
    options.from_str(&text).with_context(|| path.display().to_string()).or_input()
}

fn simulated(first: u64, count: usize, size: (usize, usize)) -> Vec<Plan> {
    let of = |seed| Plan::simulated(SimulatedScene::Generated(Kind::of_seed(seed), seed), size);
    (first..first + count as u64).map(of).collect()
}

fn plans(arguments: &Arguments) -> Outcome<Vec<Plan>> {
    if arguments.dataset == Dataset::Simulated {
        return Ok(simulated(arguments.first_seed, arguments.scenes, arguments.size));
    }
    let Some(root) = &arguments.root else {
        let explanation = arguments.dataset.explanation();
        return Err(Failure::lines(format!("--dataset needs --root DIR\n{explanation}")));
    };
    let reading =
        Reading { format: arguments.dataset.format(root), size: Some(arguments.size), depth_hint: false };
    let (plans, dropped) =
        Plan::below(root, Windows { views: 6, along: None }, reading).map_err(Failure::sorted)?;
    for dropped in dropped {
        eprintln!("warning: dropped {}: {}", dropped.name, dropped.reason);
    }
    Ok(plans)
}

/// Scores at all densities; pictures at the first: photograph, head and closed form, one row per scene.
fn validate(trainer: &Trainer, cases: &Cases, folder: &Path) -> Outcome<Vec<Score>> {
    let mut rows: Vec<(String, Image)> = Vec::new();
    let mut scores = Vec::new();
    for density in DENSITIES {
        let mut look = |scene: &str, view: &gs_scene::View, pictures: [&[f32]; 2]| {
            if density == DENSITIES[0] && rows.last().is_none_or(|(name, _)| name != scene) {
                rows.push((scene.to_owned(), side_by_side(view.image(), pictures)));
            }
        };
        scores.push(trainer.validate(cases, density, &mut look).or_work()?);
    }
    let width = rows.first().map_or(0, |(_, image)| image.width());
    let data: Vec<f32> = rows
        .iter()
        .filter(|(_, image)| image.width() == width)
        .flat_map(|(_, image)| image.data().iter().map(|value| value.clamp(0.0, 1.0)))
        .collect();
    let picture = Image::new(width, data.len() / 3 / width.max(1), data).or_work()?;
    let path = folder.join(format!("validation/step-{:06}.png", trainer.steps()));
    Picture::of_image(&picture).save(&path).or_work()?;
    Ok(scores)
}

fn side_by_side(photograph: &Image, pictures: [&[f32]; 2]) -> Image {
    let (width, height) = (photograph.width(), photograph.height());
    let row = |y: usize| {
        [photograph.data(), pictures[0], pictures[1]].into_iter().flat_map(move |data| &data[y * width * 3..][..width * 3])
    };
    let data = (0..height).flat_map(row).copied().collect();
    Image::new(3 * width, height, data).expect("three pictures of one size")
}

/// The log: a recipe, then a line per step and validation.
struct Log(fs::File, PathBuf);

impl Log {
    /// Opens the log of a run that has done `steps`; lines of later steps, which a killed run may have left, go.
    fn open(path: &Path, steps: usize, recipe: &impl Serialize) -> Outcome<Self> {
        let kept = if steps == 0 { None } else { fs::read_to_string(path).ok() };
        let text = match kept {
            Some(text) => {
                let step = |line: &str| {
                    let value = serde_json::from_str::<serde_json::Value>(line).ok()?;
                    Some(value.get("step").and_then(serde_json::Value::as_u64).unwrap_or(0) as usize)
                };
                let lines = text.lines().filter(|line| step(line).is_some_and(|step| step <= steps));
                lines.map(|line| format!("{line}\n")).collect()
            }
            None => serde_json::to_string(&serde_json::json!({ "recipe": recipe })).or_work()? + "\n",
        };
        output::write_text(path, &text)?;
        let cannot = || format!("{}: cannot write", path.display());
        let file = fs::OpenOptions::new().append(true).open(path).with_context(cannot).or_work()?;
        Ok(Self(file, path.to_path_buf()))
    }

    fn step(&mut self, record: &Record) -> Outcome {
        self.write(record)
    }

    fn write(&mut self, value: &impl Serialize) -> Outcome {
        let line = serde_json::to_string(value).or_work()? + "\n";
        self.0.write_all(line.as_bytes()).with_context(|| format!("{}: cannot write", self.1.display())).or_work()
    }

    fn flush(&mut self) -> Outcome {
        self.0.sync_data().with_context(|| format!("{}: cannot write", self.1.display())).or_work()
    }
}
