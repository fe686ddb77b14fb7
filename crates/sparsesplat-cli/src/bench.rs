//! `bench`: how fast the parts are on this machine.

mod bandwidth;
mod measure;
mod raster;
mod rows;
mod scenes;

use crate::arguments::Common;
use crate::failure::Outcome;
use crate::summary::print_line;
use clap::{Args, CommandFactory, Parser, Subcommand};

/// How fast the parts are on this machine; without a name it lists what there is
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  sparsesplat bench raster\n  \
                        sparsesplat bench raster --counts 40k,150k --device cpu --json raster.json")]
pub(crate) struct Arguments {
    #[command(subcommand)]
    which: Option<Which>,
}

#[derive(Debug, Subcommand)]
enum Which {
    Raster(raster::Arguments),
}

pub(crate) fn run(arguments: &Arguments, common: &Common) -> Outcome {
    match &arguments.which {
        Some(Which::Raster(arguments)) => raster::run(arguments, common),
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
        print_line(&format!("{:<10} {about}", command.get_name()));
    }
}
