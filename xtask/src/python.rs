//! `cargo xtask python-test`: the wheel built and installed as a user would, its tests, its example.
//!
//! Environments lie under `target/python-test`: `tools` has maturin, `fresh` is made anew with every run, `torch` is kept, because
//! PyTorch takes gigabytes.

use crate::run::{self, cargo};
use std::env;
use std::ffi::{OsStr, OsString};
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, ExitCode};
use std::time::Instant;

/// Variable that names the interpreter.
const VARIABLE: &str = "PYTHON";
const CRATE: &str = "crates/sparsesplat-py";

/// Builds the wheel, installs it in a fresh environment, and runs pytest and the example there. `--torch` installs PyTorch too,
/// which the example and some tests need; where the interpreter has it already, that one is used.
pub(crate) fn run(root: &Path, arguments: &[OsString]) -> ExitCode {
    let (torch, pytest): (Vec<&OsString>, Vec<&OsString>) =
        arguments.iter().partition(|argument| *argument == "--torch");
    run::concluded(test(root, !torch.is_empty(), &pytest))
}

fn test(root: &Path, install_torch: bool, pytest: &[&OsString]) -> Result<(), String> {
    let folder = root.join("target/python-test");
    fs::create_dir_all(&folder).map_err(|error| format!("{}: {error}", folder.display()))?;
    let interpreter = env::var_os(VARIABLE).unwrap_or_else(|| "python3".into());
    let mut steps = Steps { folder: &folder, times: Vec::new() };

    let tools = folder.join("tools");
    if !program(&tools, "maturin").exists() {
        steps.run("tools", Command::new(&interpreter).args(["-m", "venv"]).arg(&tools))?;
        steps.run("tools", pip(&tools).args(["install", "--quiet", "maturin>=1.9.4,<2"]))?;
    }
    let values = folder.join("rust-values");
    steps.run(
        "Rust's values",
        cargo([
            "run",
            "--quiet",
            "--release",
            "--package",
            "sparsesplat-py",
            "--example",
            "rust_values",
            "--",
        ])
        .arg(&values)
        .current_dir(root),
    )?;
    let wheels = folder.join("wheels");
    let _ = fs::remove_dir_all(&wheels);
    steps.run(
        "wheel",
        Command::new(program(&tools, "maturin"))
            .args(["build", "--release", "--quiet", "--manifest-path"])
            .arg(root.join(CRATE).join("Cargo.toml"))
            .arg("--out")
            .arg(&wheels),
    )?;
    let wheel = only_file(&wheels)?;

    // What a virtual environment has, an environment that is made by its interpreter does not see.
    let look = "import sys, torch; sys.exit(sys.prefix != sys.base_prefix)";
    let has_torch = Command::new(&interpreter).args(["-c", look]).output();
    let has_torch = has_torch.is_ok_and(|output| output.status.success());
    let home = folder.join(if install_torch { "torch" } else { "fresh" });
    if !(install_torch && program(&home, "python").exists()) {
        let mut make = Command::new(&interpreter);
        make.args(["-m", "venv", "--clear"]).args(has_torch.then_some("--system-site-packages"));
        steps.run("environment", make.arg(&home))?;
    }
    if install_torch {
        steps.run("torch", pip(&home).args(["install", "--quiet", "torch"]))?;
    }
    // Of the same version as what may be installed, so it would be left as it is.
    steps.run(
        "install",
        pip(&home).args(["install", "--quiet", "--force-reinstall", "--no-deps"]).arg(&wheel),
    )?;
    steps.run("install", pip(&home).args(["install", "--quiet", "pytest"]).arg(&wheel))?;

    let python = program(&home, "python");
    steps.run(
        "pytest",
        Command::new(&python)
            .args(["-m", "pytest", "-p", "no:cacheprovider"])
            .arg(root.join(CRATE).join("tests"))
            .args(pytest)
            .env("SPARSESPLAT_RUST_VALUES", &values),
    )?;
    if install_torch || has_torch {
        steps.run("example", Command::new(&python).arg(root.join(CRATE).join("examples/fit.py")))?;
    } else {
        println!("== no torch: its tests and the example were not run; --torch installs it");
    }
    let bytes = fs::metadata(&wheel).map_or(0, |metadata| metadata.len());
    println!("== passed: {}", steps.times.join(", "));
    println!("== {}: {:.1} MB", wheel.display(), bytes as f64 / 1e6);
    Ok(())
}

/// Commands one after the other, with their times.
struct Steps<'a> {
    /// Where they run: a folder from which no source is imported.
    folder: &'a Path,
    times: Vec<String>,
}

impl Steps<'_> {
    fn run(&mut self, name: &str, command: &mut Command) -> Result<(), String> {
        if command.get_current_dir().is_none() {
            command.current_dir(self.folder);
        }
        let words = [command.get_program()].into_iter().chain(command.get_args()).map(OsStr::to_string_lossy);
        println!("== {name}: {}", words.collect::<Vec<_>>().join(" "));
        let begin = Instant::now();
        let status = command.status().map_err(|error| format!("{name}: it does not start: {error}"))?;
        self.times.push(format!("{name} {:.1} s", begin.elapsed().as_secs_f64()));
        if status.success() { Ok(()) } else { Err(format!("failed in {name} ({status})")) }
    }
}

/// A program of a virtual environment.
fn program(environment: &Path, name: &str) -> PathBuf {
    let folder = environment.join(if cfg!(windows) { "Scripts" } else { "bin" });
    folder.join(format!("{name}{}", env::consts::EXE_SUFFIX))
}

fn pip(environment: &Path) -> Command {
    let mut command = Command::new(program(environment, "python"));
    command.args(["-m", "pip", "--disable-pip-version-check"]);
    command
}

fn only_file(folder: &Path) -> Result<PathBuf, String> {
    let entries = fs::read_dir(folder).map_err(|error| format!("{}: {error}", folder.display()))?;
    let files: Vec<PathBuf> = entries.flatten().map(|entry| entry.path()).collect();
    match &files[..] {
        [file] => Ok(file.clone()),
        _ => Err(format!("{}: expected one wheel, found {}", folder.display(), files.len())),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_step_that_fails_ends_the_list_and_its_name_is_told() {
        let folder = env::temp_dir();
        let mut steps = Steps { folder: &folder, times: Vec::new() };
        let missing = steps.run("first", &mut Command::new("no such program")).unwrap_err();
        assert!(missing.starts_with("first: "), "{missing}");
        let failed = steps.run("second", cargo(["--no-such-argument"]).current_dir(&folder)).unwrap_err();
        assert!(failed.starts_with("failed in second"), "{failed}");
        assert!(steps.run("third", &mut cargo(["--version"])).is_ok());
        assert_eq!(steps.times.len(), 2);
    }
}
