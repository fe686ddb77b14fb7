//! `convert`: a scene to another file format.

use crate::arguments::Common;
use crate::failure::{OrFail, Outcome};
use crate::output::{self, Outputs, named};
use crate::summary::print_line;
use clap::{Args, ValueEnum};
use evaluate::Recipe;
use serde::Serialize;
use splat_formats::{Encoder, HalfTurn, Similarity, half_turn};
use std::fs;
use std::path::PathBuf;
use view_poses::Levelling;

/// Change the file format of a scene
///
/// Reads and writes PLY, compressed PLY (PlayCanvas, SuperSplat), SPZ (Niantic; versions 1 to 3 are read, 3 is written), .splat (antimatter15) and
/// binary glTF with KHR_gaussian_splatting. The format of IN is recognised by its content, the format of OUT is its extension. What the format of OUT
/// does not keep is listed before it is written.
///
///   .ply             every bit; 4 bytes a number
///
///   .compressed.ply  about 16 bytes and 1 for each further SH coefficient; positions 11, 10, 11 bits within 256 neighbours; another order
///
///   .spz             about 20 bytes and 1 for each further SH coefficient, then compressed; positions 24 bits, all others 8 to 10
///
///   .splat           32 bytes; exact positions and sizes, colours 8 bits; no view-dependent colour
///
///   .glb             4 bytes a number; all but the last bits
///
/// Axes are converted: SPZ has y up and z backward, glTF x left and y up; the others have the axes of the data. Programs that do not follow this (such as
/// splat-transform and SuperSplat with SPZ) show or write the scene upside down: --half-turn x mends it.
#[derive(Debug, Args)]
#[command(arg = crate::arguments::no_device(), after_help = "Examples:\n  \
    sparsesplat convert scene.ply scene.spz                          an eighth of the size\n  \
    sparsesplat convert scene.ply scene.glb                          for glTF viewers\n  \
    sparsesplat convert download.splat scene.ply                     to edit or render\n  \
    sparsesplat convert scene.ply scene.spz --half-turn x            SPZ for SuperSplat, which expects PLY's axes in it\n  \
    sparsesplat convert scene.ply colmap.ply --undo-levelling scene-poses   in COLMAP's or openMVG's own world")]
pub(crate) struct Arguments {
    /// Scene to read
    #[arg(value_name = "IN")]
    input: PathBuf,
    /// Scene to write: .ply, .compressed.ply, .spz, .splat or .glb
    #[arg(value_name = "OUT")]
    output: PathBuf,
    /// Turn the scene by 180 degrees about an axis through the origin, without rounding
    #[arg(long, value_name = "AXIS")]
    half_turn: Option<Axis>,
    /// Take the scene back to the world of the engine that estimated the poses; FILE is the poses.json that `poses` wrote, or its folder
    #[arg(long, value_name = "FILE", conflicts_with = "half_turn")]
    undo_levelling: Option<PathBuf>,
}

/// An axis of the data.
#[derive(Debug, Clone, Copy, ValueEnum)]
enum Axis {
    /// Swaps up and down, and forward and backward
    X,
    /// Swaps left and right, and forward and backward
    Y,
    /// Swaps left and right, and up and down
    Z,
}

/// What `--json` writes.
#[derive(Serialize)]
struct Record {
    recipe: Recipe<()>,
    read: &'static str,
    written: &'static str,
    gaussians: usize,
    sh_degree: usize,
    /// What the file that was read says besides, or has and is not read.
    remarks: Vec<String>,
    /// What the written format does not keep.
    losses: Vec<String>,
}

pub(crate) fn run(arguments: &Arguments, common: &Common) -> Outcome {
    let outputs = Outputs::of(common).with("OUT", Some(&arguments.output)).check()?;
    outputs.spare([arguments.input.as_path()])?;
    let format = output::scene_format(&arguments.output)?;
    let mut scene = output::read_scene(&arguments.input)?;
    if let Some(axis) = arguments.half_turn {
        let axis = match axis {
            Axis::X => HalfTurn::X,
            Axis::Y => HalfTurn::Y,
            Axis::Z => HalfTurn::Z,
        };
        half_turn(&mut scene.gaussians, axis);
    }
    if let Some(record) = &arguments.undo_levelling {
        let (rotation, scale, translation) = Levelling::read(record).or_input()?.undone();
        Similarity { rotation, scale, translation }.apply(&mut scene.gaussians);
    }
    let gaussians = &scene.gaussians;
    print_line(&format!(
        "read       {}: {}, {} Gaussians, SH degree {}",
        arguments.input.display(),
        scene.format,
        gaussians.len(),
        gaussians.sh_degree()
    ));
    // A scene that the format cannot hold is the caller's.
    let losses =
        Encoder::new(gaussians, format).or_input()?.losses().iter().map(ToString::to_string).collect();
    output::write_scene(&arguments.output, format, gaussians, |loss| {
        print_line(&format!("loses      {loss}"));
    })?;
    let bytes = fs::metadata(&arguments.output).ok().filter(fs::Metadata::is_file).map(|file| file.len());
    let bytes = bytes.map(|bytes| format!(", {bytes} bytes")).unwrap_or_default();
    print_line(&format!("written    {}: {format}{bytes}", named(&arguments.output)));
    if let Some(path) = &common.json {
        let record = Record {
            recipe: crate::recipe(0, ()),
            read: scene.format.extension(),
            written: format.extension(),
            gaussians: gaussians.len(),
            sh_degree: gaussians.sh_degree(),
            remarks: scene.remarks.iter().map(ToString::to_string).collect(),
            losses,
        };
        output::write_json(path, &record)?;
    }
    Ok(())
}
