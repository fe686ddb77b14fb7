//! `ablate`: the paper's ablations, each row trained alike.

use crate::arguments::{Common, LpipsWeights, gaussians, positive, scenes, seeds, size};
use crate::failure::{Failure, OrFail, Outcome};
use crate::progress::{Progress, describe};
use crate::source::simulated;
use crate::summary::{print, print_line, warn};
use crate::train::{Data, Run, SAVE_EVERY, config};
use crate::{device, output};
use attn_head::Kind;
use clap::{Args, ValueEnum};
use evaluate::{Event, Lpips, Method, Recipe, Runner, Spread, evaluate};
use report_parts::{Table, lpips_column, number};
use scene_windows::{Dropped, GeometryCache, Plan, Reading, Windows};
use serde::Serialize;
use sparsesplat::{Allocation, Budget, Head};
use std::path::PathBuf;
use train::{Config, Ranks, Trainer};

/// Repeat the paper's ablations: train every row alike and measure it on unseen views
///
/// Rows are trained one after the other into --output and resume after an interruption. The paper's figures stand beside ours; they come from another
/// data set and some hundred times the training, so compare the order.
#[derive(Debug, Args)]
#[command(after_help = crate::arguments::SEE_LONG_HELP, after_long_help = "Examples:\n  \
    sparsesplat ablate head -o ablation --steps 1000\n  \
    sparsesplat ablate head -o ablation --rows attention,mlp --training-seeds 0,1,2\n  \
    sparsesplat ablate neighbours -o ablation --steps 1000 --photographs data --json neighbours.json\n\n\
    Equal rows of different ablations are trained once: they share a folder in --output.")]
pub(crate) struct Arguments {
    /// Ablation to run
    #[arg(value_enum)]
    what: What,
    /// Names of the rows to run, as in the table [default: all]
    #[arg(long, value_name = "NAMES", value_delimiter = ',')]
    rows: Vec<String>,
    /// Output folder for checkpoints and weights
    #[arg(short, long, value_name = "DIR")]
    output: PathBuf,
    /// Training settings of all rows (RON)
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// Training steps per row [default: that of the settings]
    #[arg(long, value_name = "N", value_parser = positive)]
    steps: Option<usize>,
    /// Training seeds; each gets its own row
    #[arg(long, value_name = "SEEDS", value_delimiter = ',', default_value = "0")]
    training_seeds: Vec<u64>,
    /// Seeds of the sampling, for the spread
    #[arg(long, value_name = "SEEDS", value_delimiter = ',', default_value = "0,1,2")]
    seeds: Vec<u64>,
    /// Number of Gaussians at which rows are measured
    #[arg(long, value_name = "COUNT", value_parser = gaussians, default_value = "40k")]
    gaussians: usize,
    /// Number of generated scenes to measure on, seeds 0, 1, ...
    #[arg(long, value_name = "N", value_parser = scenes(1), default_value_t = 8)]
    evaluation_scenes: usize,
    /// Size of the pictures of these scenes
    #[arg(long, value_name = "WxH", value_parser = size, default_value = "480x320", hide_short_help = true)]
    evaluation_size: (usize, usize),
    /// Also measure on photographs: folder of one scene, or of several scenes
    #[arg(long, value_name = "DIR")]
    photographs: Option<PathBuf>,
    #[command(flatten)]
    lpips: LpipsWeights,
    #[command(flatten)]
    data: Data,
}

/// What is varied.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum, Serialize)]
#[serde(rename_all = "kebab-case")]
enum What {
    /// Choice of pixels: entropy, random, Laplacian
    Sampling,
    /// Number of neighbours: 0, 5, 10, 20, 30
    Neighbours,
    /// Kind of head: edge convolution, MLP, max pooling, attention
    Head,
}

/// A row: its name, how it differs, and the paper's PSNR, SSIM and LPIPS (none where its training failed).
struct Row {
    name: &'static str,
    vary: fn(&mut Config),
    paper: Option<[f64; 3]>,
}

impl What {
    fn rows(self) -> Vec<Row> {
        let row = |name, paper, vary| Row { name, vary, paper };
        match self {
            Self::Sampling => vec![
                row("entropy", Some([22.36, 0.718, 0.262]), |c| c.allocation = Allocation::Entropy),
                row("random", Some([21.50, 0.696, 0.288]), |c| c.allocation = Allocation::Random),
                row("laplacian", Some([21.95, 0.705, 0.267]), |c| c.allocation = Allocation::Laplacian),
            ],
            Self::Neighbours => vec![
                row("K=0", Some([21.53, 0.683, 0.291]), |c| c.neighbours = 0),
                row("K=5", Some([22.23, 0.713, 0.267]), |c| c.neighbours = 5),
                row("K=10", Some([22.34, 0.717, 0.264]), |c| c.neighbours = 10),
                row("K=20", Some([22.36, 0.718, 0.262]), |c| c.neighbours = 20),
                row("K=30", Some([22.38, 0.718, 0.261]), |c| c.neighbours = 30),
            ],
            Self::Head => vec![
                row("edge-conv", Some([20.78, 0.664, 0.329]), |c| c.head = Kind::EdgeConv),
                row("mlp", Some([21.47, 0.683, 0.299]), |c| c.head = Kind::Mlp),
                row("max-pool", None, |c| c.head = Kind::MaxPool),
                row("attention", Some([22.36, 0.718, 0.263]), |c| c.head = Kind::Attention),
            ],
        }
    }
}

impl Arguments {
    /// The rows that are asked for.
    fn wanted(&self) -> Outcome<Vec<Row>> {
        let mut rows = self.what.rows();
        let names: Vec<&str> = rows.iter().map(|row| row.name).collect();
        if let Some(unknown) = self.rows.iter().find(|asked| !names.contains(&asked.as_str())) {
            let names = names.join(", ");
            return Err(Failure::input(format!("--rows: there is no {unknown}, but {names}")));
        }
        rows.retain(|row| self.rows.is_empty() || self.rows.iter().any(|asked| asked == row.name));
        Ok(rows)
    }
}

/// A row as measured on one set of scenes.
#[derive(Serialize)]
struct Measured {
    row: String,
    training_seed: u64,
    scenes: &'static str,
    head: Kind,
    neighbours: usize,
    allocation: Allocation,
    steps: usize,
    steps_skipped: usize,
    gaussians: f64,
    psnr_held_out: f64,
    ssim_held_out: f64,
    lpips_held_out: Option<f64>,
    spread: Option<Spread>,
    psnr_closed_form: f64,
    psnr_paper: Option<f64>,
    ssim_paper: Option<f64>,
    lpips_paper: Option<f64>,
}

/// What `--json` writes.
#[derive(Serialize)]
struct Record<'a, C> {
    recipe: &'a Recipe<C>,
    protocol: &'static str,
    /// The network of LPIPS; the paper's is VGG16.
    lpips_network: Option<&'static str>,
    rows: &'a [Measured],
    dropped: &'a [Dropped],
}

/// The settings in the recipe.
#[derive(Serialize)]
struct Settings<'a> {
    what: What,
    training: &'a Config,
    seeds: &'a [u64],
    gaussians: usize,
    data_sha256: &'a str,
}

pub(crate) fn run(arguments: &Arguments, common: &Common) -> Outcome {
    let wanted = arguments.wanted()?;
    let mut base = config(arguments.config.as_deref())?;
    base.steps = arguments.steps.unwrap_or(base.steps);
    if base.steps == 0 {
        return Err(Failure::input(
            "the settings say steps: 0, and heads that were not trained do not compare: give --steps N",
        ));
    }
    output::check_folder(&arguments.output)?;
    let lpips = arguments.lpips.read()?;
    let lpips_network = lpips.as_ref().map(|lpips| lpips.network().name());
    let held_out = 0..arguments.evaluation_scenes as u64;
    arguments.data.keep_unseen(&held_out, "measured")?;
    let cases = arguments.data.cases(&arguments.data.sources(&common.given)?)?;
    let mut sets = vec![("simulated", simulated(held_out, arguments.evaluation_size))];
    let mut dropped = Vec::new();
    if let Some(root) = &arguments.photographs {
        let reading = Reading { format: None, size: None, depth_hint: true };
        let (plans, unread) = Plan::below(root, Windows { views: 6, along: None, index: true }, reading)
            .map_err(Failure::sorted)?;
        sets.push(("photographs", plans));
        for unread in &unread {
            warn(&format!("dropped {}: {}", unread.name, unread.reason));
        }
        dropped.extend(unread);
    }
    for (_, plans) in &mut sets {
        *plans = plans.drain(..).map(Plan::kept_in_memory).collect();
    }
    let mut rows = Vec::new();
    for row in wanted {
        for seed in seeds(&arguments.training_seeds) {
            let mut config = Config { seed, ..base.clone() };
            (row.vary)(&mut config);
            let head = serde_json::to_value(config.head).or_work()?;
            let allocation = serde_json::to_value(config.allocation).or_work()?;
            let name = format!("{}-{}-k{}-seed{seed}", text(&head), text(&allocation), config.neighbours);
            let folder = arguments.output.join(name);
            let run = Run::begin(&folder, SAVE_EVERY, true, &Ranks::alone())?;
            print_line(&format!("training   {} (seed {seed}), {} steps", row.name, config.steps));
            let mut trainer =
                Trainer::new(config.clone(), cases.clone(), device::rasterizer(common.device)?).or_work()?;
            run.complete(&mut trainer)?;
            let trained = Trained { row: &row, config, skipped: trainer.skipped(), weights: run.weights() };
            for (scenes, plans) in &sets {
                rows.push(trained.measure(scenes, plans, arguments, lpips.as_ref(), common, &mut dropped)?);
            }
        }
    }
    print(&table(&rows, lpips_network).to_text());
    let settings = Settings {
        what: arguments.what,
        training: &base,
        seeds: &seeds(&arguments.seeds),
        gaussians: arguments.gaussians,
        data_sha256: cases.sha256(),
    };
    let recipe = crate::recipe(base.seed, settings);
    if let Some(path) = &common.json {
        let protocol = evaluate::PROTOCOL;
        let record = Record { recipe: &recipe, protocol, lpips_network, rows: &rows, dropped: &dropped };
        output::write_json(path, &record)?;
    }
    match dropped.iter().filter(|dropped| dropped.failed).count() {
        0 => Ok(()),
        n => Err(Failure::work(format!(
            "{n} windows were dropped and are not in the means: rows that lack different ones do not compare"
        ))),
    }
}

fn text(value: &serde_json::Value) -> &str {
    value.as_str().unwrap_or("unnamed")
}

/// A row after its training.
struct Trained<'a> {
    row: &'a Row,
    config: Config,
    skipped: usize,
    weights: PathBuf,
}

impl Trained<'_> {
    fn measure(
        &self,
        scenes: &'static str,
        plans: &[Plan],
        arguments: &Arguments,
        lpips: Option<&Lpips>,
        common: &Common,
        dropped: &mut Vec<Dropped>,
    ) -> Outcome<Measured> {
        let (backbone, _) = arguments.data.source.resolve()?;
        let with = |head: Head| sparsesplat::Config {
            backbone: backbone.clone(),
            head,
            neighbours: self.config.neighbours,
            allocation: self.config.allocation,
            budget: Budget::Gaussians(arguments.gaussians),
            // Heads are compared, not what comes after them.
            looks: 1,
            ..sparsesplat::Config::default()
        };
        let seeds = seeds(&arguments.seeds);
        let mut rasterizer = device::rasterizer(common.device)?;
        let progress = Progress::new(2 * plans.len() * seeds.len());
        let mut figures = |head: Head, name: &str| {
            let cache = Some(GeometryCache { folder: arguments.data.cache.clone() });
            let method = Method { cache, ..Method::feed_forward(with(head)) };
            let runner = Runner::on(method, device::of_networks(common.device)).map_err(Failure::sorted)?;
            let mut running = String::new();
            let mut found =
                evaluate(plans, &runner, &seeds, lpips, &mut rasterizer, &mut |event| match event {
                    Event::Run { name, seed } => running = format!("{}: {name} (seed {seed})", self.row.name),
                    Event::Step(step) => progress.say(format!("{running}: {}", describe(step))),
                    Event::Done { .. } => progress.step(),
                    Event::Dropped(dropped) => {
                        progress.warn(&format!("dropped {}: {}", dropped.name, dropped.reason));
                    }
                    _ => {}
                });
            for lost in found.dropped.drain(..) {
                let name = format!("{} of {}, {name}", lost.name, self.row.name);
                dropped.push(Dropped { name, ..lost });
            }
            Ok::<_, Failure>(found.mean)
        };
        let learned = figures(Head::Weights(self.weights.clone()), "trained head")?;
        let closed = figures(Head::ClosedForm, "closed form")?;
        Ok(Measured {
            row: self.row.name.to_owned(),
            training_seed: self.config.seed,
            scenes,
            head: self.config.head,
            neighbours: self.config.neighbours,
            allocation: self.config.allocation,
            steps: self.config.steps,
            steps_skipped: self.skipped,
            gaussians: learned.figures.gaussians,
            psnr_held_out: learned.figures.psnr_held_out,
            ssim_held_out: learned.figures.ssim_held_out,
            lpips_held_out: learned.figures.lpips_held_out,
            spread: learned.spread,
            psnr_closed_form: closed.figures.psnr_held_out,
            psnr_paper: self.row.paper.map(|[psnr, _, _]| psnr),
            ssim_paper: self.row.paper.map(|[_, ssim, _]| ssim),
            lpips_paper: self.row.paper.map(|[_, _, lpips]| lpips),
        })
    }
}

fn table(rows: &[Measured], lpips_network: Option<&str>) -> Table {
    let lpips = lpips_column(lpips_network);
    let head = [
        "row",
        "seed",
        "scenes",
        "PSNR",
        "spread",
        "SSIM",
        &lpips,
        "closed form",
        "skipped",
        "paper PSNR",
        "paper SSIM",
        "paper LPIPS (vgg)",
    ];
    let mut table = Table::new(&head, 3);
    for row in rows {
        let or_fail = |value: Option<f64>, digits: usize| {
            value.map_or_else(|| "fail".to_owned(), |value| format!("{value:.digits$}"))
        };
        table.push(vec![
            row.row.clone(),
            row.training_seed.to_string(),
            row.scenes.to_owned(),
            number(row.psnr_held_out, 2),
            number(row.spread.as_ref().map_or(f64::NAN, |spread| spread.psnr_held_out), 3),
            number(row.ssim_held_out, 3),
            number(row.lpips_held_out.unwrap_or(f64::NAN), 3),
            number(row.psnr_closed_form, 2),
            row.steps_skipped.to_string(),
            or_fail(row.psnr_paper, 2),
            or_fail(row.ssim_paper, 3),
            or_fail(row.lpips_paper, 3),
        ]);
    }
    table
}
