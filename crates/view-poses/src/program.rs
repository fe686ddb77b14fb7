//! Running other people's programs.

use crate::{Error, Result};
use std::ffi::OsString;
use std::path::Path;
use std::process::{Command, Stdio};

/// Whether a program is on the PATH.
pub(crate) fn is_there(program: &str) -> bool {
    let paths = std::env::var_os("PATH").unwrap_or_default();
    std::env::split_paths(&paths).any(|folder| {
        let file = folder.join(program);
        file.is_file() || file.with_extension("exe").is_file()
    })
}

/// Runs a program to its end, without a window system, and returns what it wrote.
pub(crate) fn run(program: &Path, arguments: &[OsString], work: &Path) -> Result<String> {
    let begin = |source| Error::File { action: "run", path: program.to_path_buf(), source };
    // Through a file: a pipe that nobody empties would stop the program.
    let log = work.join("log.txt");
    let file = std::fs::File::create(&log).map_err(begin)?;
    let status = Command::new(program)
        .args(arguments)
        .env("QT_QPA_PLATFORM", "offscreen")
        .stdin(Stdio::null())
        .stdout(file.try_clone().map_err(begin)?)
        .stderr(file)
        .status()
        .map_err(begin)?;
    let said = String::from_utf8_lossy(&std::fs::read(&log).map_err(begin)?).into_owned();
    if status.success() {
        return Ok(said);
    }
    let step = arguments.first().map(|step| step.to_string_lossy().into_owned()).unwrap_or_default();
    let program = program.display().to_string();
    Err(Error::Program { program, step, status, said: last_lines(&said) })
}

/// The last lines of a log, in one line.
pub(crate) fn last_lines(log: &str) -> String {
    const LINES: usize = 3;
    let lines: Vec<&str> = log.lines().map(str::trim).filter(|line| !line.is_empty()).collect();
    lines[lines.len().saturating_sub(LINES)..].join(" | ")
}
