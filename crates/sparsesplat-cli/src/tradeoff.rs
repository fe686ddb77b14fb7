//! `tradeoff`: what accuracy costs in time.

mod results;

use crate::arguments::{AllocationName, Common, Pipeline, Range};
use crate::datasets::Dataset;
use crate::device::{self, UsedDevice};
use crate::failure::{Failure, OrFail, Outcome};
use crate::progress::{Progress, describe};
use crate::source::{Planned, Source};
use crate::summary::print_line;
use crate::{output, threads};
use anyhow::Context;
use clap::{Args, ValueEnum};
use evaluate::tradeoff::{
    self, Extent, Header, Journal, Pictures, Point, Shard, Shards, Summary, Sweep, points,
};
use evaluate::{Method, Plan, Reading, Recipe};
use results::Results;
use serde::Serialize;
use sparsesplat::{Allocation, Budget, Wanted};
use std::path::{Path, PathBuf};

/// What accuracy costs in time: one method, varied along one axis at a time
///
/// The base is what the settings of the reconstruction say. From there go the count (1k ... 150k, one per pixel), the allocation at
/// all these counts, K, the head, the sampler, refinement, the size of the photographs, the backbone (measured depth, where the scenes
/// are simulated and the head is the closed form) and the renderer's cut-offs. Each point has PSNR and SSIM of held-out views, seconds by stage, memory, the size of the
/// file, and frames per second; the points that nothing beats are marked, and where more stops being worth its price is said.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  \
    sparsesplat tradeoff --quick --report tradeoff.html                some minutes, nothing to download\n  \
    sparsesplat tradeoff --dataset nerfstudio --root data -o sweep --markdown tradeoff.md --csv tradeoff.csv\n  \
    sparsesplat tradeoff --weights run/weights.safetensors --quick     a learned head, the closed form beside it\n  \
    sparsesplat tradeoff -o sweep                                      goes on after an interruption\n  \
    sparsesplat tradeoff -o sweep --shard 0/4                          every fourth window; in a SLURM array by itself\n  \
    sparsesplat tradeoff --merge sweep --report tradeoff.html          the shards in a folder (or several) as one\n\n\
    With --output, finished points are kept as JSON lines in DIR/points-I-of-N.jsonl, the recipe in the first line; a run with the same \
    settings on the same machine goes on there, another is refused. A shard writes its lines only: tables come with --merge.\n\
    In a SLURM array SLURM_ARRAY_TASK_ID and _COUNT give the shard; in a Kubernetes Indexed Job JOB_COMPLETION_INDEX does, and the manifest \
    has to set JOB_COMPLETIONS to its completions.\n\
    A window or point that fails is a row with its reason, and the exit code is 1.")]
pub(crate) struct Arguments {
    /// The data set, or the layout of your own
    #[arg(long, value_enum, default_value = "simulated")]
    dataset: Dataset,
    #[command(flatten)]
    source: Source,
    /// With simulated: so many generated scenes (seeds 0, 1, ...) beside the scene of the demo [default: 5, with --quick 0]
    #[arg(long, value_name = "N")]
    scenes: Option<u64>,
    /// Fewer points, one seed, at most two windows
    #[arg(long)]
    quick: bool,
    /// Seeds of the sampling; with several there is a spread [default: 0,1,2, with --quick 0]
    #[arg(long, value_delimiter = ',')]
    seeds: Vec<u64>,
    /// Keep finished points and their pictures in this folder, and go on there
    #[arg(short, long, value_name = "DIR")]
    output: Option<PathBuf>,
    /// Of N parts of the windows the I-th, from 0 [default: as SLURM or Kubernetes says, else all]
    #[arg(long, value_name = "I/N", requires = "output", allow_hyphen_values = true)]
    shard: Option<Shard>,
    /// Measure nothing: join the shards in these folders
    #[arg(long, value_name = "DIR", num_args = 1.., conflicts_with_all = ["output", "shard", "quick", "seeds", "root", "scenes"])]
    merge: Vec<PathBuf>,
    #[command(flatten)]
    files: Files,
    #[command(flatten)]
    pipeline: Pipeline,
}

/// What is written besides the table.
#[derive(Debug, Clone, Args)]
#[command(next_help_heading = "Results")]
struct Files {
    /// Also write a page with plots and pictures: one file, nothing to fetch
    #[arg(long, value_name = "PATH")]
    report: Option<PathBuf>,
    /// Also write the table as CSV
    #[arg(long, value_name = "PATH")]
    csv: Option<PathBuf>,
    /// Also write a document, and its plots as SVG beside it
    #[arg(long, value_name = "PATH")]
    markdown: Option<PathBuf>,
}

/// Windows that a quick sweep takes.
const QUICK_WINDOWS: usize = 2;
/// Generated scenes of a full sweep.
const SCENES: u64 = 5;

pub(crate) fn run(arguments: &Arguments, common: &Common) -> Outcome {
    for path in arguments.files.all() {
        output::check_file(path)?;
    }
    if !arguments.merge.is_empty() {
        let Shards { header, entries } = Shards::read(&arguments.merge).or_input()?;
        let summary = Summary::new(&header, &entries);
        let pictures = Pictures::below(&arguments.merge);
        return Results { header: &header, summary: &summary, pictures: &pictures }
            .deliver(&arguments.files, common);
    }
    let shard = arguments.shard()?;
    let depth_hint = arguments.pipeline.depth_range == Range::Hint;
    let scenes = arguments.scenes.unwrap_or(if arguments.quick { 0 } else { SCENES });
    let mut planned = arguments.source.plan(arguments.dataset, scenes, depth_hint)?;
    if arguments.quick {
        planned.plans.truncate(QUICK_WINDOWS);
    }
    let Planned { plans, dropped, reading } = planned;
    let seeds = arguments.seeds();
    let points = arguments.points(seeds[0])?;
    let mut rasterizer = device::rasterizer(common.device)?;
    let settings = Settings {
        dataset: arguments.dataset,
        windows: plans.iter().map(WindowChoice::of).collect(),
        reading,
        seeds: &seeds,
        points: &points,
        weights_sha256: arguments.weights_sha256()?,
        device: UsedDevice::of(&rasterizer),
        build: if cfg!(debug_assertions) { "development" } else { "release" },
    };
    let recipe = Recipe::of_this_run(seeds[0], threads(), settings);
    let header = Header {
        recipe: serde_json::to_value(&recipe).or_work()?,
        shard,
        windows: plans.iter().map(|plan| plan.name().to_owned()).collect(),
        points: points.iter().map(|point| point.label.clone()).collect(),
        seeds: seeds.clone(),
        dropped,
    };
    let folder = Folder::new(arguments.output.as_deref())?;
    let mut journal = Journal::open(&folder.path, &header).or_input()?;
    let sweep = Sweep { plans: &plans, shard, points: &points, seeds: &seeds };
    let progress = Progress::new(sweep.runs());
    if journal.measured() > 0 {
        progress.line(&format!("resumed    {} of {} points are measured", journal.measured(), sweep.runs()));
        progress.set(journal.measured());
    }
    for dropped in &header.dropped {
        progress.warn(&format!("dropped {}: {}", dropped.name, dropped.reason));
    }
    let pictures = Pictures::below(std::slice::from_ref(&folder.path));
    let scratch = folder.path.join(format!("scratch-{}.tmp.ply", shard.index));
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
        let ours = header.windows.iter().enumerate().filter(|(position, _)| shard.takes(*position)).count();
        print_line(&format!(
            "shard      {shard}: {ours} of {} windows, {} points",
            header.windows.len(),
            journal.measured()
        ));
        print_line("           --merge DIR makes the tables when all shards are done");
        return match journal.measured() == sweep.runs() {
            true => Ok(()),
            false => Err(Failure::work("windows or points failed and are rows with their reason")),
        };
    }
    Results { header: &header, summary: &summary, pictures: &pictures }.deliver(&arguments.files, common)
}

impl Arguments {
    fn seeds(&self) -> Vec<u64> {
        let mut seeds = Vec::new();
        let usual: &[u64] = if self.quick { &[0] } else { &[0, 1, 2] };
        for &seed in if self.seeds.is_empty() { usual } else { &self.seeds } {
            if !seeds.contains(&seed) {
                seeds.push(seed);
            }
        }
        seeds
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

    /// What tells the weights from others of the same name.
    fn weights_sha256(&self) -> Outcome<Vec<String>> {
        let of = |path: &PathBuf| {
            let cannot = || format!("{}: cannot read", path.display());
            evaluate::file_sha256(path).with_context(cannot).or_input()
        };
        self.pipeline.source.weights.iter().map(of).collect()
    }

    /// The points that the base leads to.
    fn points(&self, seed: u64) -> Outcome<Vec<Point>> {
        let base: Method = self.pipeline.method(seed)?;
        if matches!(base.predict.budget, Budget::Tau(_)) {
            return Err(Failure::input(
                "tradeoff sweeps the count: --gaussians says the base's, --tau is not taken",
            ));
        }
        if base.predict.allocation == Allocation::PixelAligned {
            return Err(Failure::input(
                "tradeoff sweeps the count, and pixel-aligned has none: it is one of the points, --allocation takes another",
            ));
        }
        let allocations: Vec<Allocation> =
            AllocationName::value_variants().iter().map(|&name| name.into()).collect();
        let extent = if self.quick { Extent::Quick } else { Extent::Full };
        let learned = sparsesplat::wanted(&base.predict).or_input()? == Wanted::DepthAndFeatures;
        Ok(points(&base, &allocations, extent, learned, self.dataset == Dataset::Simulated))
    }
}

impl Files {
    fn all(&self) -> impl Iterator<Item = &PathBuf> {
        [&self.report, &self.csv, &self.markdown].into_iter().flatten()
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
    device: UsedDevice,
    /// How the binary was compiled.
    build: &'static str,
}

/// A window by its name and its frames.
#[derive(Serialize)]
struct WindowChoice<'a> {
    name: &'a str,
    #[serde(flatten)]
    choice: Option<&'a evaluate::Choice>,
}

impl<'a> WindowChoice<'a> {
    fn of(plan: &'a Plan) -> Self {
        Self { name: plan.name(), choice: plan.choice() }
    }
}

/// Where points are kept: a folder of the user's, or one that goes when the command is done.
struct Folder {
    path: PathBuf,
    is_ours: bool,
}

impl Folder {
    fn new(output: Option<&Path>) -> Outcome<Self> {
        let path = match output {
            Some(path) => path.to_path_buf(),
            None => std::env::temp_dir().join(format!("sparsesplat-tradeoff-{}", std::process::id())),
        };
        output::check_folder(&path)?;
        Ok(Self { path, is_ours: output.is_none() })
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        if self.is_ours {
            // A folder of the system's for what is temporary: what is left there does no harm.
            let _ = std::fs::remove_dir_all(&self.path);
        }
    }
}
