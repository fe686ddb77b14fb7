//! `train-depth`: the network behind the plane sweep.

use crate::arguments::{Common, positive, scenes, size};
use crate::datasets::Dataset;
use crate::failure::{Failure, OrFail, Outcome};
use crate::output::{self, Outputs};
use crate::progress::Progress;
use crate::source::files_of;
use crate::summary::{print_line, warn};
use crate::train::{self, VALIDATION_SEED, generated, share};
use crate::train_folder::{Folder, Log};
use ::train::depth::{DepthCases, DepthConfig, DepthScore, DepthTrainer};
use clap::Args;
use depth_backbone::DepthWeights;
use evaluate::{Recipe, peak_rss_bytes};
use scene_windows::{Plan, Reading, SimulatedScene, Windows};
use serde::Serialize;
use std::path::{Path, PathBuf};
use std::time::Instant;

/// Train the network that improves stereo's depth
///
/// Generated scenes are ray-traced and matched once; --cache keeps the results. Each step draws crops of their views and compares the
/// network's depth with the exact one. With --dataset it sees photographs, too: measured depth is the truth where there is some; windows without
/// are compared by what their photographs, held-out ones too, show of the surfaces. --output receives checkpoint.safetensors (for --resume),
/// weights.safetensors (for --depth of the other commands) and log.jsonl.
#[derive(Debug, Args)]
#[command(arg = crate::arguments::no_device(), after_help = crate::arguments::SEE_LONG_HELP, after_long_help = "Examples:\n  \
    sparsesplat train-depth -o run\n  \
    sparsesplat train-depth -o run --resume                  resumes after an interruption, bit for bit\n  \
    sparsesplat train-depth -o run --dataset nerfstudio --root photographs --validation-root others\n  \
    \x20                                                         half of what a step draws is photographs\n  \
    sparsesplat train-depth -o score --config none.ron --from run/weights.safetensors --validation-root PHOTOS\n  \
    \x20                                                         scores weights; none.ron is (steps: 0)\n  \
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
    /// Data set to train on beside generated scenes, or the layout of your own data
    #[arg(long, value_enum, default_value = "simulated")]
    dataset: Dataset,
    /// Folder of one scene, or of several scenes, of --dataset
    #[arg(long, value_name = "DIR")]
    root: Option<PathBuf>,
    /// With a data set on disk: share of what is drawn that is of simulated scenes, 0 to below 1; a window of photographs counts as one crop
    #[arg(long, value_name = "SHARE", value_parser = share, default_value_t = 0.5)]
    simulated_share: f64,
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
    /// Folder of scenes with measured depth that are validated as well; the layout is recognised
    #[arg(long, value_name = "DIR")]
    validation_root: Option<PathBuf>,
    /// Size of the pictures; photographs keep their shape and are scaled down to about as many pixels
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
    #[serde(flatten)]
    generated: Scores,
    /// Of --validation-root.
    #[serde(skip_serializing_if = "Option::is_none")]
    photographs: Option<Scores>,
}

/// The network's depth and that of stereo alone.
#[derive(Clone, Copy, Serialize)]
struct Scores {
    learned: DepthScore,
    stereo: DepthScore,
}

/// Views that are not trained on.
struct HeldOut {
    generated: DepthCases,
    photographs: Option<DepthCases>,
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

pub(crate) fn run(arguments: &Arguments, common: &Common) -> Outcome {
    let config = train::read_config(arguments.config.as_deref(), DepthConfig::check)?;
    if arguments.print_config {
        print_line(&ron::ser::to_string_pretty(&config, ron::ser::PrettyConfig::default()).or_work()?);
        return Ok(());
    }
    let named = arguments.config.iter().chain(&arguments.from).map(PathBuf::as_path);
    let outputs = &Outputs::of(common);
    outputs.spare(named)?;
    let first = arguments.first_seed;
    let middle = first.saturating_add(arguments.scenes as u64);
    let last = middle.saturating_add(arguments.wild_scenes as u64);
    let held_out = VALIDATION_SEED..VALIDATION_SEED + arguments.validation_scenes as u64;
    let simulates = arguments.dataset == Dataset::Simulated || arguments.simulated_share > 0.0;
    if simulates {
        train::keep_apart(first..last, &held_out, "validated")?;
    }
    let output = arguments.output.as_deref().unwrap_or(Path::new("."));
    if arguments.dataset == Dataset::Simulated || !simulates {
        arguments.dataset.refuse_without_effect(&common.given)?;
    }
    // What is there to be read comes first: ray tracing takes minutes.
    let read = (arguments.dataset != Dataset::Simulated)
        .then(|| train::photographs(arguments.dataset, arguments.root.as_deref(), arguments.size))
        .transpose()?;
    let held_out_read =
        arguments.validation_root.as_deref().map(|root| validated(root, arguments.size)).transpose()?;
    let folder = Folder::begin(output, arguments.resume)?;
    let read = read
        .map(|plans| {
            let open = |told: &OnItem| DepthCases::of_photographs(&plans, &arguments.cache, told);
            open_photographs(&plans, arguments, outputs, open)
        })
        .transpose()?;
    let photographs = held_out_read
        .map(|plans| {
            let open = |told: &OnItem| DepthCases::measured(&plans, &arguments.cache, told);
            open_photographs(&plans, arguments, outputs, open)
        })
        .transpose()?;
    let simulated =
        if simulates { Some(open(&generated(first..middle, middle..last), arguments)?) } else { None };
    let cases = match (read, simulated) {
        (Some(read), Some(simulated)) => read.mixed_with(simulated, arguments.simulated_share),
        (one, other) => one.or(other).expect("scenes are simulated where no photographs are read"),
    };
    let half = held_out.start + (held_out.end - held_out.start).div_ceil(2);
    let generated = open(&generated(held_out.start..half, half..held_out.end), arguments)?;
    let validation = HeldOut { generated, photographs };
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

/// Views of generated scenes, from the cache or made.
fn open(scenes: &[SimulatedScene], arguments: &Arguments) -> Outcome<DepthCases> {
    opened(scenes.len(), arguments, |on_scene| {
        DepthCases::open(scenes, arguments.size, &arguments.cache, on_scene)
    })
}

/// Is told the name of each scene or window when it is there, or why it is left out.
type OnItem<'a> = dyn Fn(&str, Option<&depth_backbone::Error>) + Sync + 'a;

/// What `open` makes of so many scenes or windows, in sight of the user.
fn opened(
    count: usize,
    arguments: &Arguments,
    open: impl FnOnce(&OnItem) -> ::train::Result<DepthCases>,
) -> Outcome<DepthCases> {
    output::check_folder(&arguments.cache)?;
    let progress = Progress::new(count);
    progress.say("preparing views");
    open(&|name, why| {
        if let Some(why) = why {
            progress.warn(&format!("dropped {name}: {why}"));
        }
        progress.step();
    })
    .or_work()
}

/// The windows of the scenes in a folder that evaluations take, pictures of about so many pixels as a size has.
fn validated(root: &Path, (width, height): (usize, usize)) -> Outcome<Vec<Plan>> {
    let windows = Windows { views: train::VIEWS, along: None, index: true };
    let (plans, dropped) = Plan::below(root, windows, Reading::default()).map_err(Failure::sorted)?;
    for dropped in dropped {
        warn(&format!("dropped {}: {}", dropped.name, dropped.reason));
    }
    plans.iter().map(|plan| plan.of_about(width * height).map_err(Failure::sorted)).collect()
}

/// Views of windows of photographs, from the cache or made.
fn open_photographs(
    plans: &[Plan],
    arguments: &Arguments,
    outputs: &Outputs,
    open: impl FnOnce(&OnItem) -> ::train::Result<DepthCases>,
) -> Outcome<DepthCases> {
    outputs.spare(files_of(plans).iter().map(PathBuf::as_path))?;
    opened(plans.len(), arguments, open)
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
    validation: &HeldOut,
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
        progress.line(&format!("step {}: loss {loss:.3}", trainer.steps()));
        let scores = |cases: &DepthCases, prefix: &str| -> Outcome<Scores> {
            let [learned, stereo] = trainer.validate(cases).or_work()?;
            for (name, score) in [("learned", learned), ("stereo", stereo)] {
                progress.line(&format!("    {prefix}{name:<8}{}", described(score)));
            }
            Ok(Scores { learned, stereo })
        };
        let generated = scores(&validation.generated, "")?;
        let photographs = validation.photographs.as_ref();
        let photographs = photographs.map(|cases| scores(cases, "photographs, ")).transpose()?;
        last = Some(Validation { step: trainer.steps(), generated, photographs });
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
