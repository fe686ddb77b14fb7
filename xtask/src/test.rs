//! `cargo xtask test`: every test, and with `--gpu` those that need a graphics adapter as well.

use crate::run::{cargo, exit_code};
use std::ffi::OsString;
use std::path::Path;
use std::process::ExitCode;

/// A case of golden data that is rendered before the GPU tests: it says on which adapter, or why there is none.
const FIRST_CASE: &str = "fixtures/gs-raster/a_single.safetensors";

const NO_ADAPTER: &str = "\
error: the GPU tests did not run: they need a graphics adapter that passes the case above
  A software adapter does. Debian and Ubuntu: apt-get install mesa-vulkan-drivers libvulkan1
  `cargo xtask test` without --gpu runs the tests that need none.";

/// Runs the tests; arguments but `--gpu` go to `cargo test`.
pub(crate) fn run(root: &Path, arguments: &[OsString]) -> ExitCode {
    let (gpu, arguments) = arguments_of_cargo(arguments);
    if gpu {
        // Selected as the tests are, or else cargo would build the dependencies anew with other features.
        let selection = match arguments.iter().any(is_whole) {
            true => features(&arguments),
            false => vec!["--package".into(), "gs-raster".into()],
        };
        let mut case = cargo(["run", "--quiet", "--example", "check_case"]);
        case.args(selection).args(["--", "--device", "gpu", FIRST_CASE]).current_dir(root);
        if !case.status().is_ok_and(|status| status.success()) {
            eprintln!("{NO_ADAPTER}");
            return ExitCode::FAILURE;
        }
    }
    exit_code(cargo(["test"]).args(arguments).current_dir(root).status())
}

/// Whether the GPU tests are asked for, and what `cargo test` is given. Tests that need a GPU are ignored by default: they
/// have `#[ignore = "gpu"]`, and nothing else may be ignored.
fn arguments_of_cargo(arguments: &[OsString]) -> (bool, Vec<OsString>) {
    let end = arguments.iter().position(|word| word == "--").unwrap_or(arguments.len());
    let (ours, tests) = arguments.split_at(end);
    let gpu = ours.iter().any(|word| word == "--gpu");
    let mut words: Vec<OsString> = ours.iter().filter(|word| *word != "--gpu").cloned().collect();
    // With --workspace cargo would overlook the packages that are named.
    let named = |word: &OsString| {
        word.to_str().is_some_and(|word| word.starts_with("-p") || word.starts_with("--package"))
    };
    if !words.iter().any(|word| named(word) || is_whole(word)) {
        words.insert(0, "--workspace".into());
    }
    words.extend(tests.iter().cloned());
    if gpu {
        if tests.is_empty() {
            words.push("--".into());
        }
        words.push("--include-ignored".into());
    }
    (gpu, words)
}

/// Those of cargo's words that choose features.
fn features(arguments: &[OsString]) -> Vec<OsString> {
    let mut words = Vec::new();
    let mut rest = arguments.iter().take_while(|word| *word != "--");
    while let Some(word) = rest.next() {
        match word.to_str() {
            Some("--features" | "-F") => {
                words.push(word.clone());
                words.extend(rest.next().cloned());
            }
            Some("--all-features" | "--no-default-features" | "--ignore-rust-version") => {
                words.push(word.clone());
            }
            Some(text) if text.starts_with("--features=") => words.push(word.clone()),
            _ => {}
        }
    }
    words
}

/// Whether a word of cargo's selects every package.
fn is_whole(word: &OsString) -> bool {
    word == "--workspace" || word == "--all"
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gpu_tests_are_included_when_asked_for() {
        for (given, expected) in [
            ("", "--workspace"),
            ("--gpu", "--workspace -- --include-ignored"),
            ("--workspace", "--workspace"),
            ("--lib --workspace --gpu", "--lib --workspace -- --include-ignored"),
            ("--features sparsesplat-cli/peers", "--workspace --features sparsesplat-cli/peers"),
            ("-p knn tree", "-p knn tree"),
            (
                "--package=gs-raster --gpu -- --nocapture",
                "--package=gs-raster -- --nocapture --include-ignored",
            ),
            ("-- --gpu", "--workspace -- --gpu"),
        ] {
            let words: Vec<OsString> = given.split_whitespace().map(OsString::from).collect();
            let (gpu, found) = arguments_of_cargo(&words);
            assert_eq!(found.join(" ".as_ref()), expected, "{given}");
            let chosen = features(&found).join(" ".as_ref());
            assert_eq!(chosen, if given.starts_with("--features") { given } else { "" }, "{given}");
            assert_eq!(gpu, expected.contains("--include-ignored"), "{given}");
        }
    }
}
