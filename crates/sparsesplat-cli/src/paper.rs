//! `paper`: the paper's tables, with what is measured here beside.

mod mapping;

use crate::arguments::{AllocationName, Common};
use crate::failure::{Failure, Outcome};
use crate::output::{self, Outputs, named};
use crate::summary::{print, print_line};
use crate::sweep::Sweeping;
use clap::{Args, ValueEnum};
use mapping::Mapping;
use serde::Serialize;
use serde_json::Value;
use std::path::PathBuf;
use tradeoff::{Comparison, Extent, PaperTable, Summary, comparison_markdown, stated};

/// Print the paper's tables with our figures beside them
///
/// Our rows are measured as in `tradeoff`: one backbone, one head; only allocation, with its factors, and count differ (merged Gaussians are not corrected). The paper's figures are those that it prints,
/// with its own data, training and machines. `ablate` repeats the paper's three ablations, whose rows must be trained.
#[derive(Debug, Args)]
#[command(after_help = crate::arguments::SEE_LONG_HELP, after_long_help = "Examples:\n  \
    sparsesplat paper main --dataset dl3dv --root benchmark --index dl3dv_index.json --size 448x256\n  \
    sparsesplat paper replica --dataset replica --root Replica --windows 5\n  \
    sparsesplat paper runtime frames primitives                        on simulated scenes\n  \
    sparsesplat paper main --dataset nerfstudio --root data -o kept --lpips-weights vgg16-397923af.pth vgg.pth\n  \
    sparsesplat paper main --merge sweep                               from the points of a finished sweep\n  \
    sparsesplat paper mapping --stream room0.json office0.json         records of `stream --evaluate --json`\n\n\
    The tables of a sweep state their views, their size, the seeds, and what was dropped and why.\n\
    A window or point that fails is named with its reason, and the exit code is 1.")]
pub(crate) struct Arguments {
    /// Tables to print
    #[arg(value_enum, required = true)]
    tables: Vec<Name>,
    /// For mapping: what `stream --evaluate --json` wrote, one file per sequence
    #[arg(long, value_name = "FILE", num_args = 1..)]
    stream: Vec<PathBuf>,
    /// Write the tables as a Markdown document
    #[arg(long, value_name = "PATH", help_heading = "Results")]
    markdown: Option<PathBuf>,
    #[command(flatten)]
    sweeping: Sweeping,
}

/// A table of the paper.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Name {
    /// Methods by count: PSNR, SSIM, LPIPS, Gaussians, seconds
    Main,
    /// One per pixel against 150k: PSNR, SSIM, LPIPS
    Replica,
    /// Time by stage, at 10k, 40k, 100k and 150k
    Runtime,
    /// Frames per second over the number of Gaussians
    Frames,
    /// Number of Gaussians, beside mapping systems
    Primitives,
    /// Photo-SLAM, MonoGS, SplaTAM and GS-ICP SLAM on Replica, as published, beside streams
    Mapping,
}

impl Name {
    /// The table that a sweep makes; none of systems that map streams.
    fn table(self) -> Option<PaperTable> {
        match self {
            Self::Main => Some(PaperTable::Main),
            Self::Replica => Some(PaperTable::Replica),
            Self::Runtime => Some(PaperTable::Runtime),
            Self::Frames => Some(PaperTable::Frames),
            Self::Primitives => Some(PaperTable::Primitives),
            Self::Mapping => None,
        }
    }
}

/// What `--json` writes.
#[derive(Serialize)]
struct Record<'a> {
    recipe: &'a Value,
    tables: &'a [Comparison],
    #[serde(flatten)]
    summary: &'a Summary,
}

/// The table of mapping systems. Nothing is measured for it.
fn mapping(arguments: &Arguments, common: &Common) -> Outcome {
    const MAPPING: [&str; 4] = ["tables", "stream", "markdown", "json"];
    common.given.refuse_all_but(&MAPPING, "`mapping` measures nothing")?;
    let mapping = Mapping::read(&arguments.stream)?;
    let table = mapping.table();
    print(&format!("{}\n\n{}\n", mapping::TITLE, table.to_text()));
    mapping.notes().iter().for_each(|note| print_line(note));
    if let Some(path) = &common.json {
        output::write_json(path, &mapping)?;
    }
    if let Some(path) = &arguments.markdown {
        let notes = mapping.notes().join("\n");
        output::write_text(path, &format!("# {}\n\n{}\n{notes}\n", mapping::TITLE, table.to_markdown()))?;
        print_line(&format!("document   {}", named(path)));
    }
    Ok(())
}

pub(crate) fn run(arguments: &Arguments, common: &Common) -> Outcome {
    let outputs = Outputs::of(common).with("--markdown", arguments.markdown.as_ref()).check()?;
    let tables: Vec<PaperTable> = arguments.tables.iter().filter_map(|name| name.table()).collect();
    if arguments.tables.contains(&Name::Mapping) {
        if !tables.is_empty() {
            return Err(Failure::input(
                "`mapping` is of streams and the other tables are of a sweep: ask for them apart",
            ));
        }
        outputs.spare(arguments.stream.iter().map(PathBuf::as_path))?;
        return mapping(arguments, common);
    }
    common.given.refuse(&["stream"], "only the table `mapping` has streams")?;
    let compares = tables.iter().any(|table| table.compares_allocations());
    let allocations = if compares { AllocationName::all() } else { Vec::new() };
    let Some(swept) = arguments.sweeping.run(Extent::Paper, &allocations, &outputs, common)? else {
        return Ok(());
    };
    let summary = &swept.summary;
    let tables: Vec<Comparison> = tables.into_iter().map(|table| Comparison::new(table, summary)).collect();
    for table in &tables {
        print(&format!("{}\n\n{}\n", table.table.title(), table.to_table().to_text()));
        for line in table.notes.iter().chain(&stated(summary)) {
            print_line(line);
        }
        print_line("");
    }
    print_line(summary.protocol);
    print_line(summary.measured_as);
    print_line(&format!("measured   on {}", swept.machine()));
    if let Some(path) = &common.json {
        output::write_json(path, &Record { recipe: &swept.header.recipe, tables: &tables, summary })?;
    }
    if let Some(path) = &arguments.markdown {
        let mut text = format!(
            "# The paper's tables with our figures beside them\n\n```sh\n{}\n```\n\nMachine: {}.\n\n{} {}\n",
            swept.command(),
            swept.machine(),
            summary.protocol,
            summary.measured_as
        );
        for table in &tables {
            let title = table.table.title();
            text += &format!("\n## {title}\n\n{}", comparison_markdown(table, summary));
        }
        output::write_text(path, &text)?;
        print_line(&format!("document   {}", named(path)));
    }
    swept.verdict()
}
