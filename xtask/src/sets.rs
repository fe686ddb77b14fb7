//! Tests of the crates with vector code under every instruction set of the machine.

use crate::run::cargo;
use std::io;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

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

/// Runs the tests of [`CRATES`] under every set but the widest, under which all tests ran before. Returns one line for each failure.
pub(crate) fn check(root: &Path) -> io::Result<Vec<String>> {
    let sets =
        said(cargo(["run", "--quiet", "--package", "cpu-isa", "--example", "sets"]).current_dir(root))?;
    let sets: Vec<&str> = sets.lines().collect();
    // Selected as all tests are: nothing is compiled anew.
    let build = [
        "test",
        "--workspace",
        "--features",
        crate::EXTRAS,
        crate::ANY_RUST,
        "--no-run",
        "--message-format",
        "json",
    ];
    let built = said(cargo(build).current_dir(root))?;
    let built: Vec<Built> = built.lines().filter_map(built_by).collect();
    let mut problems = Vec::new();
    for set in sets.iter().rev().skip(1) {
        for Built { folder, executable } in built.iter().filter(|built| has_vectors(&built.folder)) {
            println!("     Running {} under {set}", executable.display());
            let mut tests = Command::new(executable);
            tests.current_dir(folder).env(VARIABLE, set).envs(crate::SAME_CASES).arg("--quiet");
            if !tests.status()?.success() {
                problems.push(format!("{}: tests fail under {VARIABLE}={set}", folder.display()));
            }
        }
    }
    Ok(problems)
}

/// An executable, and the folder of its crate.
#[derive(Debug, PartialEq)]
struct Built {
    folder: PathBuf,
    executable: PathBuf,
}

/// The test executable that a line of cargo's JSON names. Examples and binaries are built as well, but are no tests.
fn built_by(line: &str) -> Option<Built> {
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
    Some(Built { folder, executable: path("executable")? }).filter(|_| is_test)
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
        let line = |test: bool, name: &str| {
            format!(
                r#"{{"reason":"compiler-artifact","manifest_path":"/w/crates/knn/Cargo.toml","target":{{"test":true}},"profile":{{"opt_level":"2","test":{test}}},"executable":"/t/{name}"}}"#
            )
        };
        let found = built_by(&line(true, "it-5f")).unwrap();
        assert_eq!(found, Built { folder: "/w/crates/knn".into(), executable: "/t/it-5f".into() });
        assert_eq!(built_by(&line(false, "examples/check_case")), None);
        assert!(has_vectors(&found.folder) && !has_vectors(Path::new("/w/crates/train")));
        let none =
            r#"{"manifest_path":"/w/crates/knn/Cargo.toml","profile":{"test":true},"executable":null}"#;
        assert_eq!(built_by(none), None);
    }
}
