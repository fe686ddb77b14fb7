//! `tradeoff`: what accuracy costs in time.

mod results;

use crate::arguments::{AllocationName, Common};
use crate::failure::Outcome;
use crate::output::Outputs;
use crate::sweep::Sweeping;
use clap::Args;
use evaluate::tradeoff::Extent;
use std::path::PathBuf;

/// What accuracy costs in time: one method, varied along one axis at a time
///
/// The base is what the settings of the reconstruction say. From there go the count (1k ... 150k, one per pixel), the allocation at
/// all these counts, K, the head, the sampler, refinement, the size of the photographs, the planes of the stereo, the backbone (measured depth, where the scenes
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
    /// Fewer points, one seed, at most two windows
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
