//! Running cargo, and a list of steps with their times.

use std::env;
use std::ffi::OsStr;
use std::io;
use std::path::Path;
use std::process::{Command, ExitCode, ExitStatus};
use std::time::Instant;

/// One step of a list.
pub(crate) enum Step {
    /// A call of cargo: name, arguments, environment.
    Cargo(&'static str, &'static [&'static str], &'static [(&'static str, &'static str)]),
    /// A check of our own, which returns what is wrong, one line each.
    Check(&'static str, fn(&Path) -> io::Result<Vec<String>>),
}

/// The cargo that runs us.
pub(crate) fn cargo<const N: usize>(arguments: [&str; N]) -> Command {
    let mut command = Command::new(env::var_os("CARGO").as_deref().unwrap_or(OsStr::new("cargo")));
    command.args(arguments);
    if env::var_os("XDG_RUNTIME_DIR").is_none() {
        // Where nobody has a desktop, Mesa's choice of a default GPU complains of that on standard error, with every start.
        // The rasterizer chooses for itself.
        command.env("NODEVICE_SELECT", "1");
    }
    command
}

/// The exit code of a check; what is wrong is printed.
pub(crate) fn concluded(outcome: Result<(), String>) -> ExitCode {
    match outcome {
        Ok(()) => ExitCode::SUCCESS,
        Err(problem) => {
            eprintln!("error: {problem}");
            ExitCode::FAILURE
        }
    }
}

/// The exit code of a child, to be our own; 1 where it has none (a signal).
pub(crate) fn exit_code(status: io::Result<ExitStatus>) -> ExitCode {
    match status {
        Ok(status) => {
            status.code().and_then(|code| u8::try_from(code).ok()).map_or(ExitCode::FAILURE, ExitCode::from)
        }
        Err(error) => {
            eprintln!("error: cargo does not start: {error}");
            ExitCode::FAILURE
        }
    }
}

/// Runs the steps in order, stops at the first that fails, and says how long each took.
pub(crate) fn all(root: &Path, steps: &[Step]) -> ExitCode {
    let mut times = Vec::new();
    for step in steps {
        let begin = Instant::now();
        let (name, passed) = match step {
            Step::Cargo(name, arguments, environment) => {
                println!("== {name}: cargo {}", arguments.join(" "));
                let mut command = cargo([]);
                command.args(*arguments).envs(environment.iter().copied()).current_dir(root);
                (name, command.status().map(|status| status.success()))
            }
            Step::Check(name, check) => {
                println!("== {name}");
                let passed = check(root).map(|problems| {
                    problems.iter().for_each(|problem| println!("{problem}"));
                    problems.is_empty()
                });
                (name, passed)
            }
        };
        times.push(format!("{name} {:.1} s", begin.elapsed().as_secs_f64()));
        match passed {
            Ok(true) => {}
            Ok(false) => return failed(name, &times),
            Err(error) => {
                eprintln!("error: {error}");
                return failed(name, &times);
            }
        }
    }
    println!("== passed: {}", times.join(", "));
    ExitCode::SUCCESS
}

fn failed(name: &str, times: &[String]) -> ExitCode {
    eprintln!("== failed in {name}: {}", times.join(", "));
    ExitCode::FAILURE
}
