//! `ablate`: the paper's ablations, each row trained alike.

mod compare;
mod measure;
mod rows;

use crate::arguments::{Common, LpipsWeights, gaussians, positive, scenes, seeds, size};
use crate::failure::{Failure, OrFail, Outcome};
use crate::source::{files_of, simulated};
use crate::summary::{print, print_line, warn};
use crate::train::{Data, Run, SAVE_EVERY, config};
use crate::{device, output};
use anyhow::Context;
use attn_head::Kind;
use clap::{Args, ValueEnum};
use compare::{ByWindow, Difference, Verdict, differences};
use evaluate::{Recipe, Spread};
use measure::{Measure, Scores, Set};
use report_parts::{Table, lpips_column, number};
use rows::{FAILED_IN_PAPER, Row, What, folder_of};
use scene_windows::{Dropped, Plan, Reading, Windows, file_sha256, sha256_of};
use serde::Serialize;
use sparsesplat::learned::Parametrisation;
use sparsesplat::{Allocation, Head, Sampler};
use std::path::PathBuf;
use tradeoff::Shard;
use train::{Config, Ranks, Trainer};

/// Repeat the paper's ablations: train every row alike and measure it on unseen views
///
/// Rows are trained one after the other into --output and resume after an interruption; --shard shares them out among processes or machines. If the
/// paper's method is among the rows, the others are compared with it on the same windows: their differences with 95 % intervals over scenes and training
/// seeds (at least two), and whether the two can be told apart. All rows of a run estimate together what a training seed changes, as if it changed each as
/// much. The intervals are of single rows: of twenty rows that are alike, one is told apart by chance.
/// The paper's figures stand beside ours; they come from another data set and some hundred times the training, so compare the order.
#[derive(Debug, Args)]
#[command(after_help = crate::arguments::SEE_LONG_HELP, after_long_help = "Examples:\n  \
    sparsesplat ablate head -o ablation --steps 1000\n  \
    sparsesplat ablate head -o ablation --rows attention,mlp --training-seeds 0,1,2\n  \
    sparsesplat ablate neighbours -o ablation --steps 1000 --photographs data --json neighbours.json\n  \
    sparsesplat ablate sampling -o ablation --shard 1/4                          the second of four processes; without --shard, when all\n  \
    \x20                                                                            are done, the whole table\n\n\
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
    #[arg(long, value_name = "FILE", hide_short_help = true)]
    config: Option<PathBuf>,
    /// Training steps per row [default: that of the settings]
    #[arg(long, value_name = "N", value_parser = positive)]
    steps: Option<usize>,
    /// What the outputs of the heads mean [default: that of the settings]
    #[arg(long, value_enum, hide_short_help = true)]
    parametrisation: Option<ParametrisationName>,
    /// Only the rows of one of N processes, I from 0
    #[arg(
        long,
        value_name = "I/N",
        default_value = "0/1",
        hide_default_value = true,
        hide_short_help = true
    )]
    shard: Shard,
    /// Training seeds; each gets its own row
    #[arg(long, value_name = "SEEDS", value_delimiter = ',', default_value = "0")]
    training_seeds: Vec<u64>,
    /// Seeds of the sampling, for the spread
    #[arg(
        long,
        value_name = "SEEDS",
        value_delimiter = ',',
        default_value = "0,1,2",
        hide_short_help = true
    )]
    seeds: Vec<u64>,
    /// Number of Gaussians at which rows are measured
    #[arg(long, value_name = "COUNT", value_parser = gaussians, default_value = "40k")]
    gaussians: usize,
    /// Number of generated scenes to measure on, seeds 0, 1, ...
    #[arg(long, value_name = "N", value_parser = scenes(1), default_value_t = 8, hide_short_help = true)]
    evaluation_scenes: usize,
    /// Size of the pictures of these scenes; photographs keep their shape and are scaled down to about as many pixels
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

/// What `--parametrisation` takes.
#[derive(Debug, Clone, Copy, ValueEnum)]
enum ParametrisationName {
    /// Changes of the closed form
    Correction,
    /// All attributes, as in the paper
    Paper,
}

/// A row as measured on one set of scenes.
#[derive(Serialize)]
struct Measured {
    row: &'static str,
    training_seed: u64,
    scenes: &'static str,
    head: Kind,
    parametrisation: Parametrisation,
    neighbours: usize,
    covisible: usize,
    allocation: Allocation,
    sampler: Sampler,
    steps: usize,
    steps_skipped: usize,
    gaussians: f64,
    psnr_held_out: f64,
    ssim_held_out: f64,
    lpips_held_out: Option<f64>,
    spread: Option<Spread>,
    psnr_closed_form: f64,
    psnr_by_window: ByWindow,
    psnr_paper: Option<f64>,
    ssim_paper: Option<f64>,
    lpips_paper: Option<f64>,
}

/// A row against the paper's method, on one set of scenes.
#[derive(Serialize)]
struct Compared {
    row: &'static str,
    reference: &'static str,
    scenes: &'static str,
    #[serde(flatten)]
    difference: Difference,
    psnr_difference_paper: Option<f64>,
    /// Whether our difference confirms the paper's ([`compare::of_paper`]): `confirmed`, `contradicted`, `cannot be told`, or `-` where the paper has none.
    claim_of_paper: &'static str,
}

/// What `--json` writes.
#[derive(Serialize)]
struct Record<'a, C> {
    recipe: &'a Recipe<C>,
    protocol: &'static str,
    /// The network of LPIPS; the paper's is VGG16.
    lpips_network: Option<&'static str>,
    rows: &'a [Measured],
    compared: &'a [Compared],
    dropped: &'a [Dropped],
}

/// The settings in the recipe.
#[derive(Serialize)]
struct Settings<'a> {
    what: What,
    training: &'a Config,
    seeds: &'a [u64],
    gaussians: usize,
    shard: Shard,
    data_sha256: &'a str,
}

pub(crate) fn run(arguments: &Arguments, common: &Common) -> Outcome {
    let wanted = arguments.what.wanted(&arguments.rows)?;
    let mut base = config(arguments.config.as_deref())?;
    base.steps = arguments.steps.unwrap_or(base.steps);
    if let Some(name) = arguments.parametrisation {
        base.parametrisation = match name {
            ParametrisationName::Correction => Parametrisation::Correction,
            ParametrisationName::Paper => Parametrisation::Paper,
        };
    }
    if base.looks != 1 {
        return Err(Failure::input(
            "the settings have looks, but heads are compared, not what comes after them: leave looks out",
        ));
    }
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
    let cases = arguments.data.cases(&arguments.data.sources(&common.given)?, common.device)?;
    let mut dropped = Vec::new();
    let sets = sets(arguments, &mut dropped)?;
    let measure = Measure { arguments, common, lpips: lpips.as_ref() };
    let mut rows = Vec::new();
    let training_seeds = seeds(&arguments.training_seeds);
    let all = training_seeds.iter().flat_map(|&seed| wanted.iter().map(move |row| (row, seed)));
    let all = all.map(|(row, seed)| {
        let mut config = Config { seed, ..base.clone() };
        (row.vary)(&mut config);
        // Before the first is trained.
        config.check().or_input()?;
        Ok((row, config))
    });
    let all: Vec<(&Row, Config)> = all.collect::<Outcome<_>>()?;
    let ours = all.into_iter().enumerate().filter(|(place, _)| arguments.shard.takes(*place));
    for (row, config) in ours.map(|(_, one)| one) {
        let folder = arguments.output.join(folder_of(&config));
        let run = Run::begin(&folder, SAVE_EVERY, true, &Ranks::alone())?;
        print_line(&format!("training   {} (seed {}), {} steps", row.name, config.seed, config.steps));
        let mut trainer =
            Trainer::new(config.clone(), cases.clone(), device::rasterizer(common.device)?).or_work()?;
        run.complete(&mut trainer)?;
        let weights = Head::Weights(run.weights());
        for set in &sets {
            let file = folder.join(format!("{}.json", set.name));
            let learned = measure.scores(&weights, &config, set, (row.name, &file), &mut dropped)?;
            let file =
                arguments.output.join(format!("closed-form-{}-{}.json", anchors_of(&config), set.name));
            let closed = measure.scores(&Head::ClosedForm, &config, set, (row.name, &file), &mut dropped)?;
            rows.push(measured(row, &config, trainer.skipped(), set.name, (learned, &closed)));
        }
    }
    let compared = compared(arguments.what, &rows);
    print(&table(&rows, lpips_network).to_text());
    print_line("");
    match &compared[..] {
        [] => print_line(&format!(
            "compared   nothing: the row {} and another are not among these rows",
            arguments.what.reference()
        )),
        all => print(&table_of_differences(all).to_text()),
    }
    let seeds = seeds(&arguments.seeds);
    let settings = Settings {
        what: arguments.what,
        training: &base,
        seeds: &seeds,
        gaussians: arguments.gaussians,
        shard: arguments.shard,
        data_sha256: cases.sha256(),
    };
    let recipe = crate::recipe(base.seed, settings);
    if let Some(path) = &common.json {
        let (protocol, rows, compared) = (evaluate::PROTOCOL, &rows[..], &compared[..]);
        let record = Record { recipe: &recipe, protocol, lpips_network, rows, compared, dropped: &dropped };
        output::write_json(path, &record)?;
    }
    match dropped.iter().filter(|dropped| dropped.failed).count() {
        0 => Ok(()),
        n => Err(Failure::work(format!(
            "{n} windows were dropped and are not in the means: rows that lack different ones do not compare"
        ))),
    }
}

/// What rows are measured on.
fn sets(arguments: &Arguments, dropped: &mut Vec<Dropped>) -> Outcome<Vec<Set>> {
    let (scenes, size) = (arguments.evaluation_scenes, arguments.evaluation_size);
    let mut sets = vec![Set {
        name: "simulated",
        description: format!("{scenes} scenes of {}x{}", size.0, size.1),
        plans: simulated(0..scenes as u64, size),
    }];
    if let Some(root) = &arguments.photographs {
        let reading = Reading { format: None, size: None, depth_hint: true };
        let (plans, unread) = Plan::below(root, Windows { views: 6, along: None, index: true }, reading)
            .map_err(Failure::sorted)?;
        for unread in &unread {
            warn(&format!("dropped {}: {}", unread.name, unread.reason));
        }
        dropped.extend(unread);
        let plans =
            plans.iter().map(|plan| plan.of_about(size.0 * size.1)).collect::<scene_windows::Result<_>>();
        let plans: Vec<Plan> = plans.map_err(Failure::sorted)?;
        let hashes = files_of(&plans)
            .iter()
            .map(|file| {
                file_sha256(file).with_context(|| format!("{}: cannot read", file.display())).or_input()
            })
            .collect::<Outcome<Vec<_>>>()?;
        let files = sha256_of(hashes.iter().map(String::as_str));
        let description = format!("photographs of about {}x{}, files {files}", size.0, size.1);
        sets.push(Set { name: "photographs", description, plans });
    }
    for set in &mut sets {
        set.plans = set.plans.drain(..).map(Plan::kept_in_memory).collect();
    }
    Ok(sets)
}

/// What decides the anchors of a row, as a part of a file's name.
fn anchors_of(config: &Config) -> String {
    let closed = Config { head: Kind::Attention, covisible: 0, seed: 0, ..config.clone() };
    folder_of(&Config { parametrisation: Parametrisation::Correction, ..closed })
}

fn measured(
    row: &Row,
    config: &Config,
    steps_skipped: usize,
    scenes: &'static str,
    (learned, closed): (Scores, &Scores),
) -> Measured {
    Measured {
        row: row.name,
        training_seed: config.seed,
        scenes,
        head: config.head,
        parametrisation: config.parametrisation,
        neighbours: config.neighbours,
        covisible: config.covisible,
        allocation: config.allocation,
        sampler: config.sampler,
        steps: config.steps,
        steps_skipped,
        gaussians: learned.gaussians,
        psnr_held_out: learned.psnr,
        ssim_held_out: learned.ssim,
        lpips_held_out: learned.lpips,
        spread: learned.spread,
        psnr_closed_form: closed.psnr,
        psnr_by_window: learned.psnr_by_window,
        psnr_paper: row.paper.map(|[psnr, _, _]| psnr),
        ssim_paper: row.paper.map(|[_, ssim, _]| ssim),
        lpips_paper: row.paper.map(|[_, _, lpips]| lpips),
    }
}

/// Every row against the paper's method, if that is among them, over the training seeds that both have.
fn compared(what: What, rows: &[Measured]) -> Vec<Compared> {
    let reference = what.reference();
    let mut names = in_order(rows.iter().map(|row| row.row));
    names.retain(|name| *name != reference);
    let mut all = Vec::new();
    for scenes in in_order(rows.iter().map(|row| row.scenes)) {
        let psnrs = |name: &str, seed: u64| {
            rows.iter()
                .find(|row| row.row == name && row.scenes == scenes && row.training_seed == seed)
                .map(|found| &found.psnr_by_window)
        };
        let pairs = |name: &&str| {
            let seeds = rows.iter().map(|row| row.training_seed);
            seeds.filter_map(|seed| Some((seed, [psnrs(name, seed)?, psnrs(reference, seed)?]))).collect()
        };
        let found = differences(&names.iter().map(pairs).collect::<Vec<_>>());
        for (&row, difference) in names.iter().zip(found) {
            let Some(difference) = difference else { continue };
            let in_paper = what.difference_in_paper(row);
            all.push(Compared {
                row,
                reference,
                scenes,
                claim_of_paper: compare::of_paper(&difference, in_paper),
                psnr_difference_paper: in_paper,
                difference,
            });
        }
    }
    all
}

/// Each name once.
fn in_order(names: impl Iterator<Item = &'static str>) -> Vec<&'static str> {
    let mut found = Vec::new();
    for name in names {
        if !found.contains(&name) {
            found.push(name);
        }
    }
    found
}

fn table_of_differences(all: &[Compared]) -> Table {
    let reference = all.first().map_or("", |one| one.reference);
    let head = [
        "row",
        "scenes",
        &format!("PSNR less {reference}'s"),
        "95 % interval",
        "by training seed",
        "can be told apart",
        "the paper's difference",
        "the paper's claim",
    ];
    let mut table = Table::new(&head, 2);
    for one in all {
        let d = &one.difference;
        let signed = |value: f64| format!("{value:+.2}");
        table.push(vec![
            one.row.to_owned(),
            format!("{} {}", d.scene_count, one.scenes),
            signed(d.mean),
            d.interval
                .map_or("-".to_owned(), |half| format!("{:+.2} to {:+.2}", d.mean - half, d.mean + half)),
            d.by_training_seed.values().map(|&d| signed(d)).collect::<Vec<_>>().join(", "),
            match (d.verdict, d.interval) {
                (_, None) => "one training seed or scene cannot tell",
                (Verdict::Better, _) => "yes, better",
                (Verdict::Worse, _) => "yes, worse",
                (Verdict::CannotBeTold, _) => "no",
            }
            .to_owned(),
            one.psnr_difference_paper.map_or("-".to_owned(), signed),
            one.claim_of_paper.to_owned(),
        ]);
    }
    table
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
        let none = if row.row == FAILED_IN_PAPER { "fail" } else { "-" };
        let of_paper = |value: Option<f64>, digits: usize| {
            value.map_or_else(|| none.to_owned(), |value| format!("{value:.digits$}"))
        };
        table.push(vec![
            row.row.to_owned(),
            row.training_seed.to_string(),
            row.scenes.to_owned(),
            number(row.psnr_held_out, 2),
            number(row.spread.map_or(f64::NAN, |spread| spread.psnr_held_out), 3),
            number(row.ssim_held_out, 3),
            number(row.lpips_held_out.unwrap_or(f64::NAN), 3),
            number(row.psnr_closed_form, 2),
            row.steps_skipped.to_string(),
            of_paper(row.psnr_paper, 2),
            of_paper(row.ssim_paper, 3),
            of_paper(row.lpips_paper, 3),
        ]);
    }
    table
}
