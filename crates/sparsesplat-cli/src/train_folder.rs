//! The folder of a run: checkpoint, weights and log.

use crate::failure::{Failure, OrFail, Outcome};
use crate::output;
use anyhow::Context;
use gs_scene::lock_file;
use serde::Serialize;
use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};

/// Where a run keeps its files.
pub(crate) struct Folder {
    path: PathBuf,
    /// Keeps other processes out of the folder; with the process that writes there.
    lock: Option<fs::File>,
}

impl Folder {
    /// Takes a folder, which is made, for this process alone. A run that is there already is gone on with only if that is wanted.
    pub(crate) fn begin(path: &Path, resume: bool) -> Outcome<Self> {
        output::check_folder(path)?;
        let file = path.join("run.lock");
        let lock = lock_file(&file).with_context(|| format!("{}: cannot lock", file.display())).or_work()?;
        let Some(lock) = lock else {
            return Err(Failure::input(format!(
                "{}: another process is training in this folder: let it finish, or give another folder",
                path.display()
            )));
        };
        let folder = Self { path: path.to_owned(), lock: Some(lock) };
        let checkpoint = folder.checkpoint();
        if !resume && checkpoint.exists() {
            return Err(Failure::input(format!(
                "{}: a run is there already: --resume goes on with it, another --output begins anew",
                checkpoint.display()
            )));
        }
        Ok(folder)
    }

    /// A folder that another process of this run has taken.
    pub(crate) fn of_another(path: &Path) -> Self {
        Self { path: path.to_owned(), lock: None }
    }

    /// Whether this process has taken it.
    pub(crate) fn is_ours(&self) -> bool {
        self.lock.is_some()
    }

    /// The folder itself.
    pub(crate) fn path(&self) -> &Path {
        &self.path
    }

    /// The weights.
    pub(crate) fn weights(&self) -> PathBuf {
        self.path.join("weights.safetensors")
    }

    pub(crate) fn log(&self) -> PathBuf {
        self.path.join("log.jsonl")
    }

    pub(crate) fn checkpoint(&self) -> PathBuf {
        self.path.join("checkpoint.safetensors")
    }
}

/// The lines of a log.
pub(crate) fn lines_of(path: &Path) -> Outcome<Vec<serde_json::Value>> {
    let text =
        fs::read_to_string(path).with_context(|| format!("{}: cannot read", path.display())).or_work()?;
    text.lines().map(serde_json::from_str).collect::<Result<_, _>>().or_work()
}

/// The log: a recipe, then a line per step and validation.
pub(crate) struct Log(fs::File, PathBuf);

impl Log {
    /// Opens the log of a run that has done `steps`; lines of later steps, which a killed run may have left, go.
    pub(crate) fn open(path: &Path, steps: usize, recipe: &impl Serialize) -> Outcome<Self> {
        let kept = if steps == 0 { None } else { fs::read_to_string(path).ok() };
        let text = match kept {
            Some(text) => {
                let step = |line: &str| {
                    let value = serde_json::from_str::<serde_json::Value>(line).ok()?;
                    Some(value.get("step").and_then(serde_json::Value::as_u64).unwrap_or(0) as usize)
                };
                let lines = text.lines().filter(|line| step(line).is_some_and(|step| step <= steps));
                lines.map(|line| format!("{line}\n")).collect()
            }
            None => serde_json::to_string(&serde_json::json!({ "recipe": recipe })).or_work()? + "\n",
        };
        output::write_text(path, &text)?;
        let cannot = || format!("{}: cannot write", path.display());
        let file = fs::OpenOptions::new().append(true).open(path).with_context(cannot).or_work()?;
        Ok(Self(file, path.to_path_buf()))
    }

    pub(crate) fn write(&mut self, value: &impl Serialize) -> Outcome {
        let line = serde_json::to_string(value).or_work()? + "\n";
        self.0
            .write_all(line.as_bytes())
            .with_context(|| format!("{}: cannot write", self.1.display()))
            .or_work()
    }

    pub(crate) fn flush(&mut self) -> Outcome {
        self.0.sync_data().with_context(|| format!("{}: cannot write", self.1.display())).or_work()
    }
}
