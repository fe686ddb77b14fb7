//! `train`: a head, on a frozen backbone.

use crate::arguments::{Common, Device, LpipsWeights, positive, scenes, size};
use crate::datasets::Dataset;
use crate::depth_source::DepthSource;
use crate::device::{self, UsedDevice};
use crate::failure::{Failure, OrFail, Outcome};
use crate::given::Given;
use crate::output::{self, Outputs};
use crate::progress::Progress;
use crate::ranks::on_ranks;
use crate::source::{files_of, simulated};
use crate::summary::{print_line, warn};
use crate::train_folder::{Folder, Log, lines_of};
use anyhow::Context;
use attn_head::Weights;
use clap::Args;
use evaluate::{Recipe, peak_rss_bytes};
use gs_scene::Image;
use report::training_plot;
use report_parts::Picture;
use scene_sim::Kind;
use scene_windows::{Plan, SimulatedScene};
use serde::Serialize;
use serde::de::DeserializeOwned;
use sparsesplat::Predictor;
use std::fs;
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Instant;
use train::{Cases, Config, Look, Ranks, Score, Trainer};

/// Train a head on a frozen backbone through the differentiable renderer
///
/// Windows are simulated or read; the backbone runs once for each, and --cache keeps the results. Each step draws windows, budgets, pixels and
/// views by the seed, compares renderings with photographs and updates the weights of the head. --output receives checkpoint.safetensors (for
/// --resume), weights.safetensors (for --weights of the other commands, or --corrector), log.jsonl, curve.svg and pictures of the validation.
#[derive(Debug, Args)]
#[command(after_help = crate::arguments::SEE_LONG_HELP, after_long_help = "Examples:\n  \
    sparsesplat train -o run                                       the paper's head on simulated scenes\n  \
    sparsesplat train -o run --config grid.ron                     the small head: grid.ron is (head: grid)\n  \
    sparsesplat train -o run --resume                              resumes after an interruption, bit for bit\n  \
    sparsesplat train -o run --config mlp.ron --scenes 40\n  \
    sparsesplat train -o run --config corrector.ron                a corrector: (head: grid, refined: [60, 15], batch: 1, contexts: 0)\n  \
    sparsesplat train -o mean --config none.ron --from a.safetensors --from b.safetensors\n  \
    \x20                                                              the mean of two runs; none.ron is (steps: 0), and for runs without\n  \
    \x20                                                              feedback (steps: 0, feedback: false)\n  \
    sparsesplat train -o run --dataset nerfstudio --root photographs --simulated-share 0.4\n  \
    \x20                                                              60 % of the passes see the photographs of the scenes in a folder\n\n\
    A configuration is a RON file. Settings that it leaves out have the defaults, which --print-config prints.")]
pub(crate) struct Arguments {
    /// Output folder for checkpoint, weights, log, curve and pictures
    #[arg(short, long, value_name = "DIR", required_unless_present = "print_config")]
    output: Option<PathBuf>,
    /// Training settings (RON)
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// Start from these weights instead of random ones; if given several times, from their mean
    #[arg(long, value_name = "FILE")]
    from: Vec<PathBuf>,
    /// Print all settings and stop
    #[arg(long)]
    print_config: bool,
    #[command(flatten)]
    lpips: LpipsWeights,
    #[command(flatten)]
    data: Data,
    /// Number of generated scenes for validation, seeds 500, 501, ...
    #[arg(long, value_name = "N", value_parser = scenes(1), default_value_t = 8, hide_short_help = true)]
    validation_scenes: usize,
    /// Steps between validations
    #[arg(long, value_name = "STEPS", value_parser = positive, default_value_t = 500)]
    validate_every: usize,
    /// Steps between checkpoints
    #[arg(long, value_name = "STEPS", value_parser = positive, default_value_t = SAVE_EVERY, hide_short_help = true)]
    save_every: usize,
    /// Resume from the checkpoint in --output, if there is one
    #[arg(long)]
    resume: bool,
}

/// Training data.
#[derive(Debug, Clone, Args)]
#[command(next_help_heading = "Training data")]
pub(crate) struct Data {
    /// Data set, or the layout of your own data
    #[arg(long, value_enum, default_value = "simulated")]
    dataset: Dataset,
    /// Folder of one scene, or of several scenes
    #[arg(long, value_name = "DIR")]
    root: Option<PathBuf>,
    /// With a data set on disk: share of the passes that see simulated scenes, 0 to below 1
    #[arg(long, value_name = "SHARE", value_parser = share, default_value_t = 0.5)]
    simulated_share: f64,
    /// Number of generated scenes
    #[arg(long, value_name = "N", value_parser = scenes(1), default_value_t = 240)]
    scenes: usize,
    /// Number of additional generated scenes in the wild: wider baselines, varying exposure, noise, slightly wrong poses, woods
    #[arg(long, value_name = "N", value_parser = scenes(0), default_value_t = 0, hide_short_help = true)]
    wild_scenes: usize,
    /// Seed of the first generated scene; the scenes of `eval` start at 0 and must stay unseen
    #[arg(long, value_name = "SEED", default_value_t = 1000, hide_short_help = true)]
    first_seed: u64,
    /// Size of the pictures; photographs keep their shape and are scaled down to about as many pixels
    #[arg(long, value_name = "WxH", value_parser = size, default_value = "240x160")]
    size: (usize, usize),
    /// Cache folder for windows with their depth and features
    #[arg(long, value_name = "DIR", default_value = "train-cache")]
    pub(crate) cache: PathBuf,
    #[command(flatten)]
    pub(crate) source: DepthSource,
}

/// Steps between two checkpoints: some minutes' work at most is lost.
pub(crate) const SAVE_EVERY: usize = 50;
/// Context views of a window of photographs.
pub(crate) const VIEWS: usize = 6;
/// Densities that are validated.
const DENSITIES: [f64; 2] = [0.02, 0.1];
/// First seed of the scenes to validate on.
pub(crate) const VALIDATION_SEED: u64 = 500;

/// Windows to train on.
pub(crate) struct Sources {
    /// Of generated scenes; may be none beside photographs.
    simulated: Vec<Plan>,
    photographs: Option<Vec<Plan>>,
}

/// A line of the log of a validation.
#[derive(Serialize)]
struct Validation {
    step: usize,
    validation: Vec<Score>,
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
    windows: usize,
    data_sha256: String,
    weights: PathBuf,
    /// Of the run's last validation; none if there was none.
    validation: Option<serde_json::Value>,
    device: UsedDevice,
    peak_rss_bytes: Option<u64>,
}

pub(crate) fn run(arguments: &Arguments, common: &Common) -> Outcome {
    let config = config(arguments.config.as_deref())?;
    if arguments.print_config {
        print_line(&ron::ser::to_string_pretty(&config, ron::ser::PrettyConfig::default()).or_work()?);
        return Ok(());
    }
    on_ranks(|ranks| run_on(ranks, config, arguments, common))
}

fn run_on(ranks: &Arc<Ranks>, config: Config, arguments: &Arguments, common: &Common) -> Outcome {
    let named = arguments.config.iter().chain(&arguments.from).map(PathBuf::as_path);
    let outputs = Outputs::of(common);
    outputs.spare(named.chain(arguments.lpips.paths()).chain(arguments.data.source.files()))?;
    let folder = arguments.output.as_deref().unwrap_or(Path::new("."));
    let data = &arguments.data;
    let held_out = VALIDATION_SEED..VALIDATION_SEED + arguments.validation_scenes as u64;
    data.keep_unseen(&held_out, "validated")?;
    let sources = data.sources(&common.given)?;
    outputs
        .spare(files_of(sources.photographs.as_deref().unwrap_or_default()).iter().map(PathBuf::as_path))?;
    let mut run = Run::begin(folder, arguments.save_every, arguments.resume, ranks)?;
    let cases = ranks.first_before_others(|| data.cases(&sources, common.device))?;
    let held_out = Sources { simulated: simulated(held_out, data.size), photographs: None };
    let validation = ranks.is_first().then(|| data.cases(&held_out, common.device)).transpose()?;
    print_line(&format!("windows    {}, sha256 {}", cases.len(), cases.sha256()));
    let (windows, data_sha256) = (cases.len(), cases.sha256().to_owned());
    let rasterizer = device::rasterizer(common.device)?;
    let device = UsedDevice::of(&rasterizer);
    let mut trainer =
        Trainer::new(config, cases, rasterizer).or_work()?.on_ranks(Arc::clone(ranks)).or_input()?;
    if let Some(lpips) = arguments.lpips.read()? {
        trainer = trainer.with_lpips(lpips);
    }
    let earlier =
        arguments.from.iter().map(|path| Ok((path.display().to_string(), Weights::read(path).or_input()?)));
    trainer.start_from(&earlier.collect::<Outcome<Vec<_>>>()?).or_input()?;
    run.validation = validation.as_ref().map(|cases| (cases, arguments.validate_every));
    let begin = Instant::now();
    run.complete(&mut trainer)?;
    let (steps, skipped, seconds) = (trainer.steps(), trainer.skipped(), begin.elapsed().as_secs_f64());
    if let Some(path) = common.json.as_ref().filter(|_| ranks.is_first()) {
        let record = Record {
            recipe: crate::recipe(trainer.config().seed, trainer.config()),
            steps,
            skipped,
            seconds,
            windows,
            data_sha256,
            weights: run.weights(),
            validation: last_validation(&run.folder.log())?,
            device,
            peak_rss_bytes: peak_rss_bytes(),
        };
        output::write_json(path, &record)?;
    }
    print_line(&format!("trained    {steps} steps, {skipped} skipped, {seconds:.0} s"));
    print_line(&format!("weights    {}", run.weights().display()));
    Ok(())
}

/// A run in its folder, and how often it looks up.
pub(crate) struct Run<'a> {
    folder: Folder,
    /// Held-out windows, and the steps between two looks at them.
    validation: Option<(&'a Cases, usize)>,
    save_every: usize,
}

impl Run<'_> {
    /// Takes a folder, as [`Folder::begin`] does, for the first rank, which is the only one that writes there.
    pub(crate) fn begin(folder: &Path, save_every: usize, resume: bool, ranks: &Ranks) -> Outcome<Self> {
        let folder =
            if ranks.is_first() { Folder::begin(folder, resume)? } else { Folder::of_another(folder) };
        Ok(Self { folder, validation: None, save_every })
    }

    /// The weights.
    pub(crate) fn weights(&self) -> PathBuf {
        self.folder.weights()
    }

    /// All steps that are left. The first rank writes and validates, while the others wait for its part of the next step.
    pub(crate) fn complete(&self, trainer: &mut Trainer) -> Outcome {
        let checkpoint = self.folder.checkpoint();
        let begun = checkpoint.exists();
        if begun {
            trainer.resume(&checkpoint).or_input()?;
            print_line(&format!("resumed    after step {}", trainer.steps()));
        }
        let config = trainer.config().clone();
        if !self.folder.is_ours() {
            while trainer.steps() < config.steps {
                trainer.step().or_work()?;
            }
            return Ok(());
        }
        let recipe = crate::recipe(config.seed, config.clone());
        let mut log = Log::open(&self.folder.log(), trainer.steps(), &recipe)?;
        let progress = Progress::new(config.steps);
        progress.set(trainer.steps());
        let (mut psnr, mut loss) = (f64::NAN, f64::NAN);
        if config.steps == 0 && !begun {
            self.validate(trainer, &mut log, &progress)?;
        }
        while trainer.steps() < config.steps {
            let record = trainer.step().or_work()?;
            let mean = |mean: f64, new: f64| if mean.is_nan() { new } else { mean + 0.02 * (new - mean) };
            (psnr, loss) = (mean(psnr, record.psnr), mean(loss, record.loss));
            progress.step();
            progress.say(format!(
                "loss {loss:.4}, {psnr:.2} dB, {:.2} s per step, {} skipped",
                record.seconds,
                trainer.skipped()
            ));
            log.write(&record)?;
            let (step, done) = (trainer.steps(), trainer.steps() == config.steps);
            if self.validation.is_some_and(|(_, every)| step.is_multiple_of(every) || done) {
                self.validate(trainer, &mut log, &progress)?;
            }
            if step.is_multiple_of(self.save_every) && !done {
                self.keep(trainer, &mut log)?;
            }
        }
        // Also where nothing was left to do: what was broken off may have left a checkpoint and the weights of an earlier step.
        self.keep(trainer, &mut log)
    }

    /// Holds the head as it is against the closed form (a corrector against the refined scenes) on the held-out windows, if there are any.
    fn validate(&self, trainer: &Trainer, log: &mut Log, progress: &Progress) -> Outcome {
        let Some((cases, _)) = self.validation else { return Ok(()) };
        let step = trainer.steps();
        let scores = validate(trainer, cases, self.folder.path())?;
        let line = scores.iter().map(|score| {
            let Score { density, psnr, psnr_closed_form } = score;
            format!("{density}: {psnr:.2} dB ({:+.2})", psnr - psnr_closed_form)
        });
        let line = line.collect::<Vec<_>>().join(", ");
        progress.line(&format!("step {step}: held-out at density {line}"));
        log.write(&Validation { step, validation: scores })
    }

    fn keep(&self, trainer: &Trainer, log: &mut Log) -> Outcome {
        log.flush()?;
        trainer.save(&self.folder.checkpoint()).or_work()?;
        trainer.weights().write(self.weights()).or_work()?;
        output::write_text(&self.folder.path().join("curve.svg"), &curve(&self.folder.log())?)
    }
}

impl Data {
    /// Windows with what the backbone says of them, from the cache or made.
    pub(crate) fn cases(&self, sources: &Sources, device: Device) -> Outcome<Cases> {
        output::check_folder(&self.cache)?;
        let Sources { simulated, photographs } = sources;
        let progress = Progress::new(simulated.len() + photographs.as_ref().map_or(0, Vec::len));
        progress.say("preparing windows");
        let (backbone, head) = self.source.resolve()?;
        if let Some(head) = head {
            let head = head.display();
            return Err(Failure::input(format!("--weights {head} is of a head: begin with it by --from")));
        }
        let config = sparsesplat::Config { backbone, ..sparsesplat::Config::default() };
        let predictor = Predictor::on(config, device::of_networks(device)).or_input()?;
        let on_case = &mut |name: &str, why: Option<&scene_windows::Error>| {
            if let Some(why) = why {
                progress.warn(&format!("dropped {name}: {why}"));
            }
            progress.step();
        };
        let mut open = |plans: &[Plan]| Cases::open(plans, &predictor, &self.cache, on_case).or_work();
        let Some(photographs) = photographs else { return open(simulated) };
        let photographs = open(photographs)?;
        let share = self.simulated_share;
        if share > 0.0 { Ok(photographs.mixed_with(open(simulated)?, share)) } else { Ok(photographs) }
    }

    /// Seeds of the generated scenes to train on: of those as they are, and of those in the wild.
    fn seeds(&self) -> [Range<u64>; 2] {
        let wild = self.first_seed.saturating_add(self.scenes as u64);
        [self.first_seed..wild, wild..wild.saturating_add(self.wild_scenes as u64)]
    }

    /// Whether generated scenes are trained on.
    fn simulates(&self) -> bool {
        self.dataset == Dataset::Simulated || self.simulated_share > 0.0
    }

    /// Refuses to train on generated scenes that something else is to be measured on.
    pub(crate) fn keep_unseen(&self, held_out: &Range<u64>, done: &str) -> Outcome {
        let [clean, wild] = self.seeds();
        let ours = clean.start..wild.end;
        if self.simulates() { keep_apart(ours, held_out, done) } else { Ok(()) }
    }

    /// The windows that are asked for.
    pub(crate) fn sources(&self, given: &Given) -> Outcome<Sources> {
        if self.dataset == Dataset::Simulated || !self.simulates() {
            self.dataset.refuse_without_effect(given)?;
        }
        let [clean, wild] = self.seeds();
        let scenes = if self.simulates() { generated(clean, wild) } else { Vec::new() };
        let simulated = scenes.into_iter().map(|scene| Plan::simulated(scene, self.size)).collect();
        let photographs = (self.dataset != Dataset::Simulated)
            .then(|| photographs(self.dataset, self.root.as_deref(), self.size))
            .transpose()?;
        Ok(Sources { simulated, photographs })
    }
}

/// Generated scenes as they are, and in the wild.
pub(crate) fn generated(clean: Range<u64>, wild: Range<u64>) -> Vec<SimulatedScene> {
    let clean = clean.map(|seed| SimulatedScene::Generated(Kind::of_seed(seed), seed));
    clean.chain(wild.map(|seed| SimulatedScene::InTheWild(Kind::of_seed_in_the_wild(seed), seed))).collect()
}

/// A share of something that leaves room for the rest.
pub(crate) fn share(text: &str) -> Result<f64, String> {
    let share = text.parse().ok().filter(|share| (0.0..1.0).contains(share));
    share.ok_or_else(|| "expected a number from 0 to below 1".to_owned())
}

/// Windows of photographs to train on, pictures of about so many pixels as a size has.
pub(crate) fn photographs(
    dataset: Dataset,
    root: Option<&Path>,
    (width, height): (usize, usize),
) -> Outcome<Vec<Plan>> {
    let Some(root) = root else {
        let explanation = dataset.explanation();
        return Err(Failure::lines(format!("--dataset needs --root DIR\n{explanation}")));
    };
    let format = dataset.format(root);
    let (plans, dropped) =
        Plan::around_frames(root, VIEWS, width * height, format).map_err(Failure::sorted)?;
    for dropped in dropped {
        warn(&format!("dropped {}: {}", dropped.name, dropped.reason));
    }
    Ok(plans)
}

/// Refuses seeds of scenes to train on among which are some of scenes that something else is done on.
pub(crate) fn keep_apart(ours: Range<u64>, held_out: &Range<u64>, done: &str) -> Outcome {
    if ours.start < held_out.end && held_out.start < ours.end {
        return Err(Failure::input(format!(
            "scenes of the seeds {} to {} are trained on and those of {} to {} {done} on: --first-seed and the number of scenes \
             keep them apart",
            ours.start,
            ours.end - 1,
            held_out.start,
            held_out.end - 1
        )));
    }
    Ok(())
}

/// Settings of a head's training from a file.
pub(crate) fn config(path: Option<&Path>) -> Outcome<Config> {
    read_config(path, Config::check)
}

/// Settings from a file, checked; what it leaves out is as in the default.
pub(crate) fn read_config<C: DeserializeOwned + Default>(
    path: Option<&Path>,
    check: impl Fn(&C) -> train::Result<()>,
) -> Outcome<C> {
    let Some(path) = path else { return Ok(C::default()) };
    let named = || path.display().to_string();
    let text =
        fs::read_to_string(path).with_context(|| format!("{}: cannot read", path.display())).or_input()?;
    let options = ron::Options::default().with_default_extension(ron::extensions::Extensions::IMPLICIT_SOME);
    let config: C = options.from_str(&text).with_context(named).or_input()?;
    check(&config).with_context(named).or_input()?;
    Ok(config)
}

/// The scores of the last validation in a log.
fn last_validation(log: &Path) -> Outcome<Option<serde_json::Value>> {
    let mut lines = lines_of(log)?;
    let last = lines.iter_mut().rev().find_map(|line| line.get_mut("validation"));
    Ok(last.map(serde_json::Value::take))
}

/// Scores at all densities; pictures at the first: photograph, head and closed form, one row per scene.
fn validate(trainer: &Trainer, cases: &Cases, folder: &Path) -> Outcome<Vec<Score>> {
    let mut rows: Vec<(String, Image)> = Vec::new();
    let mut scores = Vec::new();
    for density in DENSITIES {
        let mut look = |look: Look| {
            if density == DENSITIES[0] && rows.last().is_none_or(|(name, _)| name != look.scene) {
                rows.push((look.scene.to_owned(), side_by_side(look)));
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

fn side_by_side(look: Look) -> Image {
    let photograph = look.photograph.image();
    let (width, height) = (photograph.width(), photograph.height());
    let row = |y: usize| {
        let pictures = [photograph.data(), look.learned, look.closed_form];
        pictures.into_iter().flat_map(move |data| &data[y * width * 3..][..width * 3])
    };
    let data = (0..height).flat_map(row).copied().collect();
    Image::new(3 * width, height, data).expect("three pictures of one size")
}

/// What a log holds so far, as a plot.
fn curve(log: &Path) -> Outcome<String> {
    let lines = lines_of(log)?;
    let number = |value: &serde_json::Value, key: &str| value.get(key).and_then(serde_json::Value::as_f64);
    let steps = lines.iter().filter_map(|line| Some((number(line, "step")?, number(line, "loss")?)));
    let mut curves = vec![];
    for density in DENSITIES {
        let gain = |line: &serde_json::Value| {
            let scores = line.get("validation")?.as_array()?;
            let score = scores.iter().find(|score| number(score, "density") == Some(density))?;
            Some((number(line, "step")?, number(score, "psnr")? - number(score, "psnr_closed_form")?))
        };
        curves.push((format!("density {density}"), lines.iter().filter_map(gain).collect()));
    }
    Ok(training_plot(&steps.collect::<Vec<_>>(), &curves))
}
