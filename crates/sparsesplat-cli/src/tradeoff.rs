//! `tradeoff`: what accuracy costs in time.

mod results;

use crate::arguments::{AllocationName, Common};
use crate::failure::Outcome;
use crate::output::Outputs;
use crate::sweep::Sweeping;
use clap::Args;
use std::path::PathBuf;
use tradeoff::Extent;

/// Measure what accuracy costs in time: one method, varied along one axis at a time
///
/// The base method has the settings of the reconstruction options. These are varied: the count (1k ... 150k, one per pixel), the allocation at
/// all these counts, K, the head, looks, correction, the sampler, refinement, the size of the photographs, the depth planes, learned depth, fused surfaces, the backbone (measured depth, if the
/// scenes are simulated and the head is the closed form) and the cut-offs of the renderer. Each point has PSNR and SSIM of held-out views, seconds
/// by stage, memory, file size and frames per second. Points on the Pareto front are marked, and the knees of the curves are named.
#[derive(Debug, Args)]
#[command(after_help = crate::arguments::SEE_LONG_HELP, after_long_help = "Examples:\n  \
    sparsesplat tradeoff --quick --report tradeoff.html                takes some minutes; nothing to download\n  \
    sparsesplat tradeoff --dataset nerfstudio --root data -o sweep --markdown tradeoff.md --csv tradeoff.csv\n  \
    sparsesplat tradeoff --weights run/weights.safetensors --quick     a head of your own and the closed form\n  \
    sparsesplat tradeoff -o sweep                                      resumes after an interruption\n  \
    sparsesplat tradeoff -o sweep --shard 0/4                          every fourth window; automatic in a SLURM array\n  \
    sparsesplat tradeoff --merge sweep --report tradeoff.html          join the shards of one or several folders\n\n\
    With --output, finished points are kept as JSON lines in DIR/points-I-of-N.jsonl, with the recipe in the first line. A run with the same \
    settings on the same machine resumes there; other runs are refused. A shard only writes its lines; --merge makes the tables.\n\
    In a SLURM array SLURM_ARRAY_TASK_ID and _COUNT give the shard. In a Kubernetes Indexed Job JOB_COMPLETION_INDEX does, and the manifest \
    must set JOB_COMPLETIONS to its completions.\n\
    A window or point that fails becomes a row with its reason, and the exit code is 1.")]
pub(crate) struct Arguments {
    /// Measure fewer points, one seed, at most two windows
    #[arg(long, conflicts_with = "merge")]
    quick: bool,
    #[command(flatten)]
    files: Files,
    #[command(flatten)]
    sweeping: Sweeping,
}

/// What is written besides the table.
#[derive(Debug, Clone, Args)]
#[command(next_help_heading = "Results")]
struct Files {
    /// Write a self-contained HTML report with plots and pictures
    #[arg(long, value_name = "PATH")]
    report: Option<PathBuf>,
    /// Write the table as CSV
    #[arg(long, value_name = "PATH", hide_short_help = true)]
    csv: Option<PathBuf>,
    /// Write a Markdown document, with its plots as SVG files beside it
    #[arg(long, value_name = "PATH")]
    markdown: Option<PathBuf>,
}

pub(crate) fn run(arguments: &Arguments, common: &Common) -> Outcome {
    let files = &arguments.files;
    let outputs = Outputs::of(common)
        .with("--report", files.report.as_ref())
        .with("--csv", files.csv.as_ref())
        .with("--markdown", files.markdown.as_ref())
        .check()?;
    let extent = if arguments.quick { Extent::Quick } else { Extent::Full };
    match arguments.sweeping.run(extent, &AllocationName::all(), &outputs, common)? {
        Some(swept) => results::deliver(&swept, &arguments.files, common),
        None => Ok(()),
    }
}
