//! Vector code under every instruction set of the machine: its tests, and whether a set is slower than it should be.

use crate::run::cargo;
use std::io;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::Mutex;
use std::thread;

/// Crates with vector code, by their folders.
const CRATES: [&str; 9] = [
    "attn-head",
    "backproject",
    "cpu-kernels",
    "depth-backbone",
    "entropy-sampler",
    "gs-raster",
    "image-metrics",
    "knn",
    "refine",
];

/// The environment variable that forces the set.
const VARIABLE: &str = "SPARSESPLAT_ISA";

/// The folder of the binary's crate, which is that of `bench isa`.
const BINARY: &str = "sparsesplat-cli";

/// Runs the tests of [`CRATES`] under every set but the widest, under which all tests ran before. Returns one line for each failure.
pub(crate) fn check(root: &Path) -> io::Result<Vec<String>> {
    let sets =
        said(cargo(["run", "--quiet", "--package", "cpu-isa", "--example", "sets"]).current_dir(root))?;
    let sets: Vec<&str> = sets.lines().collect();
    let built = all_built(root)?;
    let with_vectors: Vec<&Built> =
        built.iter().filter(|built| built.is_test && has_vectors(&built.folder)).collect();
    // Several at once: many end with one slow test on one thread.
    let mut left =
        sets.iter().rev().skip(1).flat_map(|set| with_vectors.iter().map(move |built| (*set, *built)));
    let left = Mutex::new(&mut left);
    let next = || left.lock().expect("no worker panics").next();
    let work = || {
        let mut problems = Vec::new();
        while let Some((set, built)) = next() {
            problems.extend(tested(set, built)?);
        }
        Ok(problems)
    };
    thread::scope(|scope| {
        let workers = thread::available_parallelism().map_or(1, usize::from);
        let workers: Vec<_> = (0..workers).map(|_| scope.spawn(work)).collect();
        let found = workers.into_iter().map(|worker| worker.join().expect("no worker panics"));
        found.collect::<io::Result<Vec<_>>>().map(|problems| problems.concat())
    })
}

/// Runs a test under a set; what fails.
fn tested(set: &str, Built { folder, executable, .. }: &Built) -> io::Result<Option<String>> {
    let mut tests = Command::new(executable);
    tests.current_dir(folder).env(VARIABLE, set).envs(crate::SAME_CASES).arg("--quiet");
    let output = tests.stderr(Stdio::inherit()).output()?;
    let said = String::from_utf8_lossy(&output.stdout);
    println!("     Ran {} under {set}\n{said}", executable.display());
    let problem = format!("{}: tests fail under {VARIABLE}={set}", folder.display());
    Ok(Some(problem).filter(|_| !output.status.success()))
}

/// Times every vector path under every set by `bench isa`, whose rules are ratios within one run: no other machine matters.
pub(crate) fn guard(root: &Path) -> io::Result<Vec<String>> {
    let built = all_built(root)?;
    let binary = built.iter().find(|built| !built.is_test && built.folder.ends_with(BINARY));
    let binary = binary.ok_or_else(|| io::Error::other(format!("cargo builds no binary of {BINARY}")))?;
    let status = Command::new(&binary.executable).args(["bench", "isa", "--rounds", "1"]).status()?;
    Ok(if status.success() { Vec::new() } else { vec!["an instruction set is too slow, see above".into()] })
}

/// What the step before built, selected in the same words: nothing is compiled anew.
fn all_built(root: &Path) -> io::Result<Vec<Built>> {
    let selection = ["test", "--workspace", "--features", crate::EXTRAS];
    Ok(said(
        cargo(selection)
            .args(crate::TARGETS)
            .args(["--no-run", "--message-format", "json"])
            .current_dir(root),
    )?
    .lines()
    .filter_map(built_by)
    .collect())
}

/// An executable, and the folder of its crate.
#[derive(Debug, PartialEq)]
pub(crate) struct Built {
    pub(crate) folder: PathBuf,
    pub(crate) executable: PathBuf,
    pub(crate) is_test: bool,
}

/// The test or the binary that a line of cargo's JSON names. Examples are built as well, but are neither.
pub(crate) fn built_by(line: &str) -> Option<Built> {
    let text = |key: &str| {
        let (_, rest) = line.split_once(&format!("\"{key}\":\""))?;
        Some(rest.split_once('"')?.0)
    };
    // Backslashes of Windows are doubled.
    let path = |key: &str| Some(PathBuf::from(text(key)?.replace("\\\\", "\\")));
    // The profile says whether it is a test; a target has a key of that name, too, which says whether it may be one.
    let (_, profile) = line.split_once("\"profile\":")?;
    let is_test = profile.split_once('}')?.0.contains("\"test\":true");
    let folder = path("manifest_path")?.parent()?.to_owned();
    let is_binary = line.contains(r#""kind":["bin"]"#);
    Some(Built { folder, executable: path("executable")?, is_test }).filter(|_| is_test || is_binary)
}

fn has_vectors(folder: &Path) -> bool {
    folder.file_name().is_some_and(|name| CRATES.iter().any(|with| name == *with))
}

/// What a command prints.
fn said(command: &mut Command) -> io::Result<String> {
    let output = command.stderr(Stdio::inherit()).output()?;
    if !output.status.success() {
        return Err(io::Error::other(format!("{command:?} fails")));
    }
    String::from_utf8(output.stdout).map_err(io::Error::other)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn executables_are_found_in_what_cargo_says() {
        let line = |kind: &str, test: bool, name: &str| {
            format!(
                r#"{{"reason":"compiler-artifact","manifest_path":"/w/crates/knn/Cargo.toml","target":{{"kind":["{kind}"],"test":true}},"profile":{{"opt_level":"2","test":{test}}},"executable":"/t/{name}"}}"#
            )
        };
        let found = built_by(&line("test", true, "it-5f")).unwrap();
        let executable = "/t/it-5f".into();
        assert_eq!(found, Built { folder: "/w/crates/knn".into(), executable, is_test: true });
        assert!(!built_by(&line("bin", false, "program")).unwrap().is_test);
        assert_eq!(built_by(&line("example", false, "examples/check_case")), None);
        assert!(has_vectors(&found.folder) && !has_vectors(Path::new("/w/crates/train")));
        let none =
            r#"{"manifest_path":"/w/crates/knn/Cargo.toml","profile":{"test":true},"executable":null}"#;
        assert_eq!(built_by(none), None);
    }
}
