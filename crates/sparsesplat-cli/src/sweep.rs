//! A sweep as the command line asks for it: what `tradeoff` and `paper` have in common.

use crate::arguments::{Common, LpipsWeights, Pipeline, Range, scenes, seeds};
use crate::datasets::Dataset;
use crate::device::{self, UsedDevice};
use crate::failure::{Failure, OrFail, Outcome};
use crate::given::Given;
use crate::output;
use crate::output::Outputs;
use crate::progress::{Progress, describe};
use crate::source::{Planned, Source, files_of};
use crate::summary::print_line;
use anyhow::Context;
use clap::Args;
use evaluate::Method;
use scene_windows::{Plan, Reading};
use serde::Serialize;
use serde_json::Value;
use sparsesplat::{Allocation, Budget, Predictor};
use std::path::{Path, PathBuf};
use tempfile::TempDir;
use tradeoff::{self, Extent, Header, Journal, Pictures, Point, Shard, Shards, Summary, Sweep, points};

/// What is swept over what, and where it is kept.
#[derive(Debug, Args)]
#[command(next_help_heading = "Data")]
pub(crate) struct Sweeping {
    /// Data set, or the layout of your own data
    #[arg(long, value_enum, default_value = "simulated")]
    dataset: Dataset,
    #[command(flatten)]
    source: Source,
    /// With simulated: number of generated scenes (seeds 0, 1, ...) in addition to the demo's [default: 5; tradeoff --quick: 0]
    #[arg(long, value_name = "N", value_parser = scenes(0))]
    scenes: Option<usize>,
    /// Seeds of the sampling; points that do not depend on the seed are measured once [default: 0,1,2; tradeoff --quick: 0]
    #[arg(long, value_delimiter = ',', allow_negative_numbers = true)]
    seeds: Vec<u64>,
    /// Folder for finished points and pictures; a sweep resumes from it
    #[arg(short, long, value_name = "DIR")]
    output: Option<PathBuf>,
    /// Measure shard I of N of the windows, I from 0 [default: given by SLURM or Kubernetes, else all windows]
    #[arg(long, value_name = "I/N", requires = "output", allow_hyphen_values = true, hide_short_help = true)]
    shard: Option<Shard>,
    /// Measure nothing; join the shards in these folders
    #[arg(long, hide_short_help = true, value_name = "DIR", num_args = 1.., conflicts_with_all = ["output", "shard", "seeds", "root", "scenes"])]
    merge: Vec<PathBuf>,
    #[command(flatten)]
    lpips: LpipsWeights,
    #[command(flatten)]
    pipeline: Pipeline,
}

/// What a sweep found.
pub(crate) struct Swept {
    pub(crate) header: Header,
    pub(crate) summary: Summary,
    pub(crate) pictures: Pictures,
    /// Of the pictures, for as long as they are needed.
    _folder: Option<Folder>,
}

/// What may be said beside --merge: where the tables go, and what is no setting of the measuring.
const MERGED: &[&str] = &["merge", "tables", "report", "csv", "markdown", "json", "threads", "device"];
/// Windows that a quick sweep takes.
const QUICK_WINDOWS: usize = 2;
/// Generated scenes of a full sweep.
const SCENES: usize = 5;

impl Sweeping {
    /// Measures what is not measured yet, or joins what is. None where this process was one of several shards: it keeps its lines, and
    /// joining makes the tables.
    pub(crate) fn run(
        &self,
        extent: Extent,
        allocations: &[Allocation],
        outputs: &Outputs,
        common: &Common,
    ) -> Outcome<Option<Swept>> {
        if !self.merge.is_empty() {
            common.given.refuse_all_but(MERGED, "--merge measures nothing")?;
            let Shards { header, entries } = Shards::read(&self.merge).or_input()?;
            let summary = Summary::new(&header, &entries);
            let pictures = Pictures::below(&self.merge);
            return Ok(Some(Swept { header, summary, pictures, _folder: None }));
        }
        let shard = self.shard()?;
        let depth_hint = self.pipeline.depth_range == Range::Hint;
        let scenes = self.scenes.unwrap_or(if extent == Extent::Quick { 0 } else { SCENES });
        let mut planned = self.source.plan(self.dataset, scenes, depth_hint, &common.given)?;
        if extent == Extent::Quick {
            planned.plans.truncate(QUICK_WINDOWS);
        }
        let Planned { plans, dropped, reading } = planned;
        outputs.spare(files_of(&plans).iter().map(PathBuf::as_path))?;
        outputs.spare(self.source.files().chain(self.pipeline.files()).chain(self.lpips.paths()))?;
        let seeds = self.seeds(extent);
        let points = self.points(extent, allocations, seeds[0], &common.given)?;
        let lpips = self.lpips.read()?;
        let mut rasterizer = device::rasterizer(common.device)?;
        let settings = Settings {
            dataset: self.dataset,
            windows: plans.iter().map(WindowChoice::of).collect(),
            reading,
            seeds: &seeds,
            points: &points,
            weights_sha256: hash_of(
                self.pipeline.source.weights.iter().chain(self.pipeline.corrector_file()),
            )?,
            lpips_sha256: hash_of(self.lpips.files())?,
            device: UsedDevice::of(&rasterizer),
            build: if cfg!(debug_assertions) { "development" } else { "release" },
            binary_sha256: hash_of(&[std::env::current_exe().or_work()?])?.concat(),
        };
        let recipe = crate::recipe(seeds[0], settings);
        let header = Header {
            recipe: serde_json::to_value(&recipe).or_work()?,
            shard,
            windows: plans.iter().map(|plan| plan.name().to_owned()).collect(),
            points: points.iter().map(|point| point.label.clone()).collect(),
            seeds: seeds.clone(),
            lpips_network: lpips.as_ref().map(|lpips| lpips.network().name().to_owned()),
            dropped,
        };
        let folder = Folder::new(self.output.as_deref())?;
        let mut journal = Journal::open(&folder.path, &header).or_input()?;
        let sweep = Sweep {
            plans: &plans,
            shard,
            points: &points,
            seeds: &seeds,
            network_device: device::of_networks(common.device),
            lpips: lpips.as_ref(),
        };
        let progress = Progress::new(sweep.runs());
        if journal.measured() > 0 {
            progress.line(&format!(
                "resumed    {} of {} points are measured",
                journal.measured(),
                sweep.runs()
            ));
            progress.set(journal.measured());
        }
        for dropped in &header.dropped {
            progress.warn(&format!("dropped {}: {}", dropped.name, dropped.reason));
        }
        let pictures = Pictures::below(std::slice::from_ref(&folder.path));
        let scratch = folder.path.join(format!("scratch-{}-of-{}.tmp.ply", shard.index, shard.count));
        let mut running = String::new();
        let swept = sweep.run(&mut journal, &pictures, &scratch, &mut rasterizer, &mut |event| match event {
            tradeoff::Progress::Point { window, point, seed } => {
                running = format!("{window} {point} (seed {seed})");
            }
            tradeoff::Progress::Step(step) => progress.say(format!("{running}: {}", describe(step))),
            tradeoff::Progress::Done(runs) => (0..runs).for_each(|_| progress.step()),
            tradeoff::Progress::Failed(failed) => {
                let point = failed.point.as_ref().map_or(String::new(), |point| format!(" {point}"));
                progress.warn(&format!("dropped {}{point}: {}", failed.window, failed.reason));
            }
            _ => {}
        });
        // Whatever became of the sweep, nobody wants it.
        let _ = std::fs::remove_file(&scratch);
        drop(progress);
        swept.or_work()?;
        let summary = Summary::new(&header, journal.entries());
        if shard.count > 1 {
            let ours =
                header.windows.iter().enumerate().filter(|(position, _)| shard.takes(*position)).count();
            print_line(&format!(
                "shard      {shard}: {ours} of {} windows, {} points",
                header.windows.len(),
                journal.measured()
            ));
            print_line("           --merge DIR makes the tables when all shards are done");
            return match journal.measured() == sweep.runs() {
                true => Ok(None),
                false => Err(Failure::work("windows or points failed and are rows with their reason")),
            };
        }
        Ok(Some(Swept { header, summary, pictures, _folder: Some(folder) }))
    }

    fn seeds(&self, extent: Extent) -> Vec<u64> {
        let usual: &[u64] = if extent == Extent::Quick { &[0] } else { &[0, 1, 2] };
        seeds(if self.seeds.is_empty() { usual } else { &self.seeds })
    }

    fn shard(&self) -> Outcome<Shard> {
        if let Some(shard) = self.shard {
            return Ok(shard);
        }
        let of_environment = Shard::of_environment(|name| std::env::var(name).ok()).or_input()?;
        match of_environment {
            Some(shard) if shard.count > 1 && self.output.is_none() => Err(Failure::input(format!(
                "the scheduler says that this is shard {shard}: --output DIR says where its points are kept (--shard 0/1 takes all windows)"
            ))),
            found => Ok(found.unwrap_or(Shard::WHOLE)),
        }
    }

    /// The points that the base leads to.
    fn points(
        &self,
        extent: Extent,
        allocations: &[Allocation],
        seed: u64,
        given: &Given,
    ) -> Outcome<Vec<Point>> {
        let base: Method = self.pipeline.method(seed, given)?;
        if matches!(base.predict.budget, Budget::Tau(_)) {
            return Err(Failure::input(
                "a sweep varies the count: --gaussians says the base's, --tau is not taken",
            ));
        }
        if base.predict.allocation == Allocation::PixelAligned {
            return Err(Failure::input(
                "a sweep varies the count, and pixel-aligned has none: it is one of the points, --allocation takes another",
            ));
        }
        let learned = Predictor::new(base.predict.clone()).or_input()?.has_learned_head();
        Ok(points(&base, allocations, extent, learned, self.dataset == Dataset::Simulated))
    }
}

/// A word as a shell takes it.
fn quoted(word: &str) -> String {
    let is_plain = |letter: char| letter.is_alphanumeric() || "-_./,:=@%+".contains(letter);
    if !word.is_empty() && word.chars().all(is_plain) {
        word.to_owned()
    } else {
        format!("'{}'", word.replace('\'', r"'\''"))
    }
}

/// What tells files of weights from others of the same name.
fn hash_of<'a>(files: impl IntoIterator<Item = &'a PathBuf>) -> Outcome<Vec<String>> {
    let hash = |path: &PathBuf| {
        let cannot = || format!("{}: cannot read", path.display());
        scene_windows::file_sha256(path).with_context(cannot).or_input()
    };
    files.into_iter().map(hash).collect()
}

impl Swept {
    /// A failure of some part of the sweep is the command's.
    pub(crate) fn verdict(&self) -> Outcome {
        match self.summary.failures() {
            0 => Ok(()),
            n => Err(Failure::work(format!(
                "{n} windows, scenes or points have no figures: they are named with the reason"
            ))),
        }
    }

    /// On what it was measured, in words.
    pub(crate) fn machine(&self) -> String {
        let recipe = &self.header.recipe;
        let text = |value: &Value| value.as_str().map_or_else(|| "unknown".to_owned(), str::to_owned);
        let machine = &recipe["machine"];
        let device = &recipe["config"]["device"];
        let rendered = match device["kind"].as_str() {
            Some("cpu") | None => "the CPU".to_owned(),
            Some(kind) => format!("{} ({kind}, {})", text(&device["name"]), text(&device["driver"])),
        };
        format!(
            "{}, {} threads, {}, {}; rendered on {rendered}; {} build",
            text(&machine["cpu"]),
            recipe["threads"],
            text(&machine["os"]),
            text(&machine["arch"]),
            text(&recipe["config"]["build"])
        )
    }

    /// The command as somebody else would type it.
    pub(crate) fn command(&self) -> String {
        let arguments = self.header.recipe["command"].as_array().map_or(&[][..], Vec::as_slice);
        let words = arguments.iter().skip(1).filter_map(Value::as_str).map(quoted);
        format!("cargo xtask {}", words.collect::<Vec<_>>().join(" "))
    }
}

/// The settings in the recipe.
#[derive(Serialize)]
struct Settings<'a> {
    dataset: Dataset,
    windows: Vec<WindowChoice<'a>>,
    reading: Reading,
    seeds: &'a [u64],
    points: &'a [Point],
    weights_sha256: Vec<String>,
    lpips_sha256: Vec<String>,
    device: UsedDevice,
    /// How the binary was compiled.
    build: &'static str,
    /// The binary itself: a commit does not tell two builds of changed files apart.
    binary_sha256: String,
}

/// A window by its name and its frames.
#[derive(Serialize)]
struct WindowChoice<'a> {
    name: &'a str,
    #[serde(flatten)]
    choice: Option<&'a scene_windows::Choice>,
}

impl<'a> WindowChoice<'a> {
    fn of(plan: &'a Plan) -> Self {
        Self { name: plan.name(), choice: plan.choice() }
    }
}

/// Where points are kept: a folder of the user's, or one that goes when the command is done.
struct Folder {
    path: PathBuf,
    _temporary: Option<TempDir>,
}

impl Folder {
    fn new(output: Option<&Path>) -> Outcome<Self> {
        if let Some(path) = output {
            output::check_folder(path)?;
            return Ok(Self { path: path.to_path_buf(), _temporary: None });
        }
        let temporary = tempfile::tempdir().context("cannot make a temporary folder").or_work()?;
        Ok(Self { path: temporary.path().to_path_buf(), _temporary: Some(temporary) })
    }
}

#[cfg(test)]
mod tests {
    use super::quoted;

    #[test]
    fn words_are_quoted_where_a_shell_would_break_them() {
        let words = [
            ("--seeds", "--seeds"),
            ("0,1", "0,1"),
            ("", "''"),
            ("my data", "'my data'"),
            ("a'b", r"'a'\''b'"),
        ];
        for (word, expected) in words {
            assert_eq!(quoted(word), expected);
        }
    }
}
