//! `weights`: the published checkpoints of DepthSplat's network.

use crate::arguments::Common;
use crate::checkpoints::{Checkpoint, LICENCE, PUBLISHED, folder, present};
use crate::failure::{Failure, Outcome};
use crate::output;
use crate::summary::{print, print_line};
use clap::Args;
use report_parts::Table;
use serde::Serialize;
use std::path::{Path, PathBuf};

/// List the published weights of DepthSplat's network, and fetch them on request
///
/// No weights of the network are included, and none are ever fetched unasked. With --backbone depthsplat, `reconstruct`, `eval`, `train` and others
/// take a file by --weights, or the first of this list in the folder that `doctor` names.
#[derive(Debug, Args)]
#[command(arg = crate::arguments::no_device(), after_help = "Examples:\n  \
    sparsesplat weights                                      list all weights\n  \
    cargo xtask weights --fetch small-dl3dv                  fetch a checkpoint of some 150 MB from the internet")]
pub(crate) struct Arguments {
    /// Fetch the checkpoint of this name from Hugging Face (needs the feature `hf-hub`, which `cargo xtask weights` turns on)
    #[arg(long, value_name = "NAME", value_parser = checkpoint)]
    fetch: Option<Checkpoint>,
    /// Folder for the checkpoint [default: the folder that is searched for weights]
    #[arg(long, value_name = "DIR", requires = "fetch")]
    folder: Option<PathBuf>,
}

/// What `--json` writes.
#[derive(Serialize)]
struct Record {
    folder: Option<PathBuf>,
    checkpoints: Vec<Row>,
}

#[derive(Serialize)]
struct Row {
    name: &'static str,
    file: &'static str,
    trained: &'static str,
    address: String,
    present: bool,
}

fn checkpoint(name: &str) -> Result<Checkpoint, String> {
    let names = || PUBLISHED.map(|checkpoint| checkpoint.name).join(", ");
    let found = PUBLISHED.into_iter().find(|checkpoint| checkpoint.name == name);
    found.ok_or_else(|| format!("expected one of {}", names()))
}

pub(crate) fn run(arguments: &Arguments, common: &Common) -> Outcome {
    let folder = arguments.folder.clone().or_else(folder);
    if let Some(checkpoint) = arguments.fetch {
        let Some(folder) = &folder else {
            return Err(Failure::input("the system names no home folder: say where with --folder DIR"));
        };
        output::check_folder(folder)?;
        let path = fetch(checkpoint, folder)?;
        print_line(&format!("placed     {}", path.display()));
    }
    let found = folder.as_deref().map(present).unwrap_or_default();
    let is_here = |checkpoint: &Checkpoint| found.iter().any(|(found, _)| found.name == checkpoint.name);
    let mut table = Table::new(&["name", "here", "trained on", "file"], 4);
    for checkpoint in &PUBLISHED {
        let here = if is_here(checkpoint) { "yes" } else { "-" };
        table.push([checkpoint.name, here, checkpoint.trained, checkpoint.file].map(str::to_owned).to_vec());
    }
    print(&table.to_text());
    let looked = folder.as_ref().map_or("nowhere".to_owned(), |folder| folder.display().to_string());
    print_line(&format!("looked in  {looked}"));
    print_line(&format!("licences   {LICENCE}"));
    if let Some(path) = &common.json {
        let row = |checkpoint: &Checkpoint| Row {
            name: checkpoint.name,
            file: checkpoint.file,
            trained: checkpoint.trained,
            address: checkpoint.address(),
            present: is_here(checkpoint),
        };
        output::write_json(path, &Record { checkpoints: PUBLISHED.iter().map(row).collect(), folder })?;
    }
    Ok(())
}

/// Fetches a checkpoint; it is checked against the hash in its name before it takes its place.
#[cfg(feature = "hf-hub")]
fn fetch(checkpoint: Checkpoint, folder: &Path) -> Outcome<PathBuf> {
    use crate::checkpoints::REPOSITORY;
    use crate::failure::OrFail;
    use anyhow::Context;

    let place = folder.join(checkpoint.file);
    let api = hf_hub::api::sync::ApiBuilder::from_env().with_progress(true).build().or_work()?;
    let fetched = api
        .model(REPOSITORY.to_owned())
        .get(checkpoint.file)
        .with_context(|| format!("{} cannot be fetched", checkpoint.address()))
        .or_work()?;
    let sha256 = scene_windows::file_sha256(&fetched).or_work()?;
    let stem = checkpoint.file.trim_end_matches(".pth");
    if !stem.ends_with(&sha256[..8]) {
        let start = &sha256[..8];
        return Err(Failure::work(format!(
            "{}: its SHA-256 starts with {start}, its name promises another: remove it, and fetch it again",
            fetched.display()
        )));
    }
    let mut from = std::fs::File::open(&fetched).or_work()?;
    gs_scene::write_atomically(&place, |out| std::io::copy(&mut from, out).map(drop)).or_work()?;
    Ok(place)
}

#[cfg(not(feature = "hf-hub"))]
fn fetch(checkpoint: Checkpoint, folder: &Path) -> Outcome<PathBuf> {
    Err(Failure::input(format!(
        "this build fetches nothing: use `cargo xtask weights --fetch {}`, or fetch {} and place it in {}",
        checkpoint.name,
        checkpoint.address(),
        folder.display()
    )))
}
