//! `bench`: how fast the parts are on this machine.

mod backbone;
mod backproject;
mod bandwidth;
mod cpu;
mod entropy;
mod head;
mod isa;
mod knn;
mod measure;
mod random;
mod raster;
mod row;

use crate::arguments::Common;
use crate::failure::Outcome;
use crate::summary::print_line;
use clap::{Args, CommandFactory, Parser, Subcommand};

/// Measure the speed of single stages on this machine; without a name, list the benchmarks
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  sparsesplat bench raster\n  \
                        sparsesplat bench knn --counts 40k,150k --json knn.json")]
pub(crate) struct Arguments {
    #[command(subcommand)]
    which: Option<Which>,
}

#[derive(Debug, Subcommand)]
enum Which {
    Knn(knn::Arguments),
    Entropy(entropy::Arguments),
    Backproject(backproject::Arguments),
    Head(head::Arguments),
    Backbone(backbone::Arguments),
    Raster(raster::Arguments),
    Isa(isa::Arguments),
}

pub(crate) fn run(arguments: &Arguments, common: &Common) -> Outcome {
    match &arguments.which {
        Some(Which::Knn(arguments)) => knn::run(arguments, common),
        Some(Which::Entropy(arguments)) => entropy::run(arguments, common),
        Some(Which::Backproject(arguments)) => backproject::run(arguments, common),
        Some(Which::Backbone(arguments)) => backbone::run(arguments, common),
        Some(Which::Head(arguments)) => head::run(arguments, common),
        Some(Which::Raster(arguments)) => raster::run(arguments, common),
        Some(Which::Isa(arguments)) => isa::run(arguments, common),
        None => {
            list();
            Ok(())
        }
    }
}

/// What can be measured, with the first line of its help.
fn list() {
    #[derive(Parser)]
    struct Alone {
        #[command(flatten)]
        arguments: Arguments,
    }
    for command in Alone::command().get_subcommands() {
        let about = command.get_about().map(ToString::to_string).unwrap_or_default();
        print_line(&format!("{:<12} {about}", command.get_name()));
    }
}
