//! The `sparsesplat` command: photographs in, a compact set of 3D Gaussians out, and the figures that say how good
//! they are. The only place that prints.

#[cfg(feature = "candle")]
mod ablate;
mod arguments;
#[cfg(feature = "candle")]
mod bench;
mod check_data;
mod check_scene;
mod checkpoints;
mod convert;
mod datasets;
mod demo;
mod depth_source;
mod device;
mod doctor;
mod driver;
mod eval;
mod failure;
mod given;
mod memory;
mod output;
mod paper;
mod poses;
mod progress;
#[cfg(feature = "candle")]
mod ranks;
mod reconstruct;
mod render;
mod simulate;
mod source;
mod stream;
mod summary;
mod sweep;
mod tradeoff;
#[cfg(feature = "candle")]
mod train;
#[cfg(feature = "candle")]
mod train_depth;
#[cfg(feature = "candle")]
mod train_folder;
mod video;
mod view;
mod weights;

use arguments::Common;
use clap::{CommandFactory, FromArgMatches, Parser, Subcommand};
use failure::{Failure, OrFail, Outcome};
use given::Given;
use std::process::ExitCode;

/// Turn photographs into a compact set of 3D Gaussians in one pass; no GPU needed
#[derive(Debug, Parser)]
#[command(version, after_help = HELP)]
struct Cli {
    #[command(subcommand)]
    command: Command,
    #[command(flatten)]
    common: Common,
}

const HELP: &str = "\
Start here:
  sparsesplat demo                                         simulate a scene and reconstruct it; nothing to download
  sparsesplat reconstruct PHOTOS --poses -o scene.ply      reconstruct your own photographs
  sparsesplat poses PHOTOS|VIDEO -o SCENE                  estimate camera poses alone
  sparsesplat stream FRAMES --cap 200k -o map.ply          map posed frames as they come
  sparsesplat render scene.ply --cameras PHOTOS -o out     render a scene
  sparsesplat convert scene.ply scene.spz                  change the file format of a scene
  sparsesplat view scene.ply --cameras PHOTOS              write a page that shows a scene in the browser
  sparsesplat eval --dataset nerfstudio --root PHOTOS      measure on held-out views
  sparsesplat tradeoff --quick --report tradeoff.html      measure what accuracy costs in time
  sparsesplat paper main runtime                           the paper's tables with our figures beside them
  sparsesplat train -o run                                 train a head on simulated scenes or photographs
  sparsesplat check-data PHOTOS                            find mistakes in the data

Environment: SPARSESPLAT_ISA=scalar|neon|avx2|avx512 forces vector code to a narrower instruction set; `doctor` lists
the sets of this processor.

Exit codes: 0 success, 1 failure during work, 2 wrong arguments or input.";

#[derive(Debug, Subcommand)]
enum Command {
    Demo(demo::Arguments),
    Reconstruct(reconstruct::Arguments),
    Poses(poses::Arguments),
    Stream(stream::Arguments),
    Render(render::Arguments),
    Convert(convert::Arguments),
    View(view::Arguments),
    Eval(eval::Arguments),
    Tradeoff(tradeoff::Arguments),
    Paper(paper::Arguments),
    #[cfg(feature = "candle")]
    Train(train::Arguments),
    #[cfg(feature = "candle")]
    TrainDepth(train_depth::Arguments),
    #[cfg(feature = "candle")]
    Ablate(ablate::Arguments),
    Simulate(simulate::Arguments),
    CheckData(check_data::Arguments),
    Weights(weights::Arguments),
    Doctor(doctor::Arguments),
    #[cfg(feature = "candle")]
    Bench(bench::Arguments),
}

fn main() -> ExitCode {
    memory::keep_free();
    #[cfg(not(feature = "candle"))]
    if let Some(command) = std::env::args_os()
        .nth(1)
        .and_then(|word| COMPUTE_WITH_CANDLE.into_iter().find(|command| word == *command))
    {
        summary::tell(&format!("error: {}\n", needs_candle(command)));
        return ExitCode::from(2);
    }
    let command = command();
    let matches = command.clone().get_matches();
    let mut cli = Cli::from_arg_matches(&matches).unwrap_or_else(|error| error.exit());
    cli.common.given = Given::of(&command, &matches);
    match run(&cli).and_then(|()| summary::finish()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => {
            summary::tell(&format!("error: {failure}\n"));
            ExitCode::from(failure.code())
        }
    }
}

/// The command line. How poses are estimated is short help of `poses` alone.
fn command() -> clap::Command {
    Cli::command().mut_subcommand("reconstruct", |command| {
        poses::How::NAMES.iter().fold(command, |command, name| {
            // clap names options by the fields that hold them.
            command.mut_arg(name.replace('-', "_"), |argument| argument.hide_short_help(true))
        })
    })
}

fn run(cli: &Cli) -> Outcome {
    let common = &cli.common;
    cpu_isa::Isa::requested().map_err(Failure::input)?;
    if let Some(threads) = common.threads {
        rayon::ThreadPoolBuilder::new().num_threads(threads).build_global().or_work()?;
    }
    output::Outputs::of(common).check()?;
    match &cli.command {
        Command::Demo(arguments) => demo::run(arguments, common),
        Command::Reconstruct(arguments) => reconstruct::run(arguments, common),
        Command::Poses(arguments) => poses::run(arguments, common),
        Command::Stream(arguments) => stream::run(arguments, common),
        Command::Render(arguments) => render::run(arguments, common),
        Command::Convert(arguments) => convert::run(arguments, common),
        Command::View(arguments) => view::run(arguments, common),
        Command::Eval(arguments) => eval::run(arguments, common),
        Command::Tradeoff(arguments) => tradeoff::run(arguments, common),
        Command::Paper(arguments) => paper::run(arguments, common),
        #[cfg(feature = "candle")]
        Command::Train(arguments) => train::run(arguments, common),
        #[cfg(feature = "candle")]
        Command::TrainDepth(arguments) => train_depth::run(arguments, common),
        #[cfg(feature = "candle")]
        Command::Ablate(arguments) => ablate::run(arguments, common),
        Command::Simulate(arguments) => simulate::run(arguments, common),
        Command::CheckData(arguments) => check_data::run(arguments, common),
        Command::Weights(arguments) => weights::run(arguments, common),
        Command::Doctor(arguments) => doctor::run(arguments, common),
        #[cfg(feature = "candle")]
        Command::Bench(arguments) => bench::run(arguments, common),
    }
}

/// The commands that a binary without candle lacks.
#[cfg(not(feature = "candle"))]
const COMPUTE_WITH_CANDLE: [&str; 4] = ["train", "train-depth", "ablate", "bench"];

/// What to do where a binary without candle is asked for something that computes with it.
#[cfg(not(feature = "candle"))]
fn needs_candle(what: &str) -> String {
    format!("{what} needs candle, and this binary is built without it\n  {WITH_CANDLE}")
}

/// How to get a binary with candle.
#[cfg(not(feature = "candle"))]
const WITH_CANDLE: &str = "`cargo xtask` builds each command with what it needs; `cargo build --release --package sparsesplat-cli` builds all of them";

/// What a figure is made with, for the head of a JSON file.
fn recipe<C: serde::Serialize>(seed: u64, config: C) -> evaluate::Recipe<C> {
    evaluate::Recipe::of_this_run(BUILT_FROM, seed, threads(), config)
}

/// Commit that this binary was built from, by the build script; `unknown` where that was no checkout.
const BUILT_FROM: &str = env!("SPARSESPLAT_COMMIT");

/// Threads that work.
fn threads() -> usize {
    rayon::current_num_threads()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_command_line_is_well_formed() {
        command().debug_assert();
    }

    #[test]
    fn short_help_fits_on_one_screen() {
        let mut all = command();
        all.build();
        for subcommand in all.get_subcommands_mut() {
            let help = subcommand.render_help().to_string();
            assert!(help.lines().count() <= 50, "{} lines: {help}", help.lines().count());
        }
    }
}
