//! Vector code under every instruction set of the machine: the tests of the crates that have some, and how fast it is.

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

/// Runs the tests of [`CRATES`] under every set but the widest, under which all tests ran before; then `bench isa`, which fails
/// where vector code is slower than it should be. What is wrong, one line each.
pub(crate) fn check(root: &Path) -> io::Result<Vec<String>> {
    let sets =
        said(cargo(["run", "--quiet", "--package", "cpu-isa", "--example", "sets"]).current_dir(root))?;
    let sets: Vec<&str> = sets.lines().collect();
    // Selected as all tests are: nothing is compiled anew.
    let build = ["test", "--workspace", "--features", crate::EXTRAS, "--no-run", "--message-format", "json"];
    let built = said(cargo(build).current_dir(root))?;
    let built: Vec<Built> = built.lines().filter_map(built_by).collect();
    let mut problems = Vec::new();
    for set in sets.iter().rev().skip(1) {
        for Built { folder, executable } in built.iter().filter(|built| has_vectors(&built.folder)) {
            let mut tests = Command::new(executable);
            tests.current_dir(folder).env(VARIABLE, set).envs(crate::SAME_CASES).arg("--quiet");
            if !tests.status()?.success() {
                problems.push(format!("{}: tests fail under {VARIABLE}={set}", folder.display()));
            }
        }
    }
    let Some(binary) =
        built.iter().find(|built| built.executable.file_stem() == Some("sparsesplat".as_ref()))
    else {
        problems.push("cargo did not say where it put the binary sparsesplat".to_owned());
        return Ok(problems);
    };
    if !Command::new(&binary.executable).args(["bench", "isa"]).status()?.success() {
        problems.push("`sparsesplat bench isa`: vector code is slower than it should be".to_owned());
    }
    Ok(problems)
}

/// An executable, and the folder of its crate.
#[derive(Debug, PartialEq)]
struct Built {
    folder: PathBuf,
    executable: PathBuf,
}

/// What a line of cargo's JSON says was built, if it is something that can be run.
fn built_by(line: &str) -> Option<Built> {
    let path = |key: &str| {
        let (_, rest) = line.split_once(&format!("\"{key}\":\""))?;
        let (path, _) = rest.split_once('"')?;
        // Backslashes of Windows are doubled.
        Some(PathBuf::from(path.replace("\\\\", "\\")))
    };
    let executable = path("executable")?;
    Some(Built { folder: path("manifest_path")?.parent()?.to_owned(), executable })
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
        let line = r#"{"reason":"compiler-artifact","manifest_path":"/w/crates/knn/Cargo.toml","executable":"/t/debug/deps/it-5f"}"#;
        let found = built_by(line).unwrap();
        assert_eq!(found, Built { folder: "/w/crates/knn".into(), executable: "/t/debug/deps/it-5f".into() });
        assert!(has_vectors(&found.folder) && !has_vectors(Path::new("/w/crates/train")));
        assert_eq!(built_by(r#"{"manifest_path":"/w/crates/knn/Cargo.toml","executable":null}"#), None);
    }
}
