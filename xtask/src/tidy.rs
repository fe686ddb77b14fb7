//! Rules that no compiler knows.

use std::path::{Component, Path, PathBuf};
use std::process::Command;
use std::{fs, io};

/// Largest file that may be checked in, bytes.
const LARGEST_FILE: u64 = 1 << 20;

/// The same in the folder of the default weights.
const LARGEST_WEIGHTS: u64 = 10 << 20;

/// Where they lie.
const WEIGHTS: &str = "crates/sparsesplat/weights";

/// Longest source file, lines: a longer one is two.
const LONGEST_SOURCE: usize = 500;

/// Longest shader, lines.
const LONGEST_SHADER: usize = 300;

/// Names that say nothing of what a crate does.
const CATCH_ALL: [&str; 6] = ["utils", "util", "common", "core", "misc", "helpers"];

/// What is wrong with the files of the checkout, one line each.
pub(crate) fn check(root: &Path) -> io::Result<Vec<String>> {
    let mut problems = Vec::new();
    for file in files(root)? {
        let path = root.join(&file);
        // A file that was removed and not yet committed is still listed.
        let Ok(metadata) = fs::metadata(&path) else {
            continue;
        };
        let name = file.display();
        let largest = if file.starts_with(WEIGHTS) { LARGEST_WEIGHTS } else { LARGEST_FILE };
        if metadata.len() > largest {
            problems.push(format!("{name}: {} bytes, at most {largest} are allowed", metadata.len()));
            continue;
        }
        match file.extension().and_then(|extension| extension.to_str()) {
            Some(kind @ ("rs" | "wgsl")) => {
                let longest = if kind == "rs" { LONGEST_SOURCE } else { LONGEST_SHADER };
                let lines = fs::read_to_string(&path)?.lines().count();
                if lines > longest {
                    problems.push(format!("{name}: {lines} lines, at most {longest} are allowed"));
                }
            }
            Some("md") => {
                let text = fs::read_to_string(&path)?;
                let folder = file.parent().unwrap_or(Path::new(""));
                for found in dead_paths(&text, |path| resolves(root, folder, path)) {
                    problems.push(format!("{name}: `{found}` does not exist"));
                }
                for found in unknown_commands(&text, crate::HELP) {
                    problems.push(format!("{name}: there is no command `cargo xtask {found}`"));
                }
            }
            _ => {}
        }
    }
    for folder in fs::read_dir(root.join("crates"))? {
        let name = folder?.file_name();
        if CATCH_ALL.iter().any(|catch_all| name.to_string_lossy().split('-').any(|word| word == *catch_all))
        {
            problems.push(format!("crates/{}: name a crate after what it does", name.to_string_lossy()));
        }
    }
    Ok(problems)
}

/// Every file that is checked in or could be, relative to the root.
fn files(root: &Path) -> io::Result<Vec<PathBuf>> {
    let list = Command::new("git")
        .args(["ls-files", "-z", "--cached", "--others", "--exclude-standard"])
        .current_dir(root)
        .output()?;
    if !list.status.success() {
        return Err(io::Error::other("tidy needs a git checkout: `git ls-files` failed"));
    }
    let names = String::from_utf8_lossy(&list.stdout);
    Ok(names.split_terminator('\0').map(PathBuf::from).collect())
}

/// The paths in backticks for which `resolves` is false. A path is a word with a slash and nothing that a pattern, a
/// placeholder or a command line would have.
fn dead_paths(text: &str, resolves: impl Fn(&str) -> bool) -> Vec<String> {
    let prose: Vec<&str> = text.split("```").step_by(2).collect();
    let mut dead = Vec::new();
    for line in prose.iter().flat_map(|part| part.lines()) {
        for word in line.split('`').skip(1).step_by(2) {
            let plain = |c: char| c.is_ascii_alphanumeric() || "/._-".contains(c);
            if word.contains('/') && word.chars().all(plain) && is_ours(word) && !resolves(word) {
                dead.push(word.to_owned());
            }
        }
    }
    dead
}

/// The commands of `cargo xtask` in a text that begin no line of `help`.
fn unknown_commands(text: &str, help: &str) -> Vec<String> {
    let is_name = |c: char| c.is_alphanumeric() || "-_".contains(c);
    let listed: Vec<&str> =
        help.lines().filter_map(|line| line.strip_prefix("  ")?.split(' ').next()).collect();
    let named =
        text.split("cargo xtask ").skip(1).map(|rest| rest.split(|c| !is_name(c)).next().unwrap_or_default());
    named
        .filter(|name| name.starts_with(|c: char| c.is_ascii_lowercase()) && !listed.contains(name))
        .map(str::to_owned)
        .collect()
}

/// Whether a path begins with a folder of this repository or of one of its crates (and not with `out`, or a scene's
/// name).
fn is_ours(path: &str) -> bool {
    const FOLDERS: [&str; 12] = [
        "consumers",
        "crates",
        "docs",
        "fixtures",
        "shaders",
        "xtask",
        ".ci",
        ".cargo",
        "src",
        "tests",
        "benches",
        "examples",
    ];
    path.split('/').find(|part| !matches!(*part, "." | "..")).is_some_and(|first| FOLDERS.contains(&first))
}

/// A path may be meant from the root or from the folder of the document.
fn resolves(root: &Path, folder: &Path, path: &str) -> bool {
    let stays_inside = Path::new(path).components().all(|part| part != Component::ParentDir);
    (stays_inside && root.join(path).exists()) || root.join(folder).join(path).exists()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_paths_of_the_repository_are_looked_up() {
        let text = "`crates/a` and `crates/gone.rs`, `out/demo/`, `fox/0`, `cargo xtask a/b`, `crates/*`\n\
                    ```\n`crates/in-code`\n```\n`../docs/gone.md`";
        let dead = dead_paths(text, |path| path == "crates/a");
        assert_eq!(dead, ["crates/gone.rs", "../docs/gone.md"]);
    }

    #[test]
    fn commands_that_the_help_does_not_list_are_found() {
        let text = "`cargo xtask train-depth -o out`, cargo xtask --help, `cargo xtask <command>` and\n    cargo xtask trian\n`cargo xtask train_depth`";
        assert_eq!(unknown_commands(text, crate::HELP), ["trian", "train_depth"]);
        let forwarded = crate::FORWARDED.map(|name| format!("cargo xtask {name}")).join(" ");
        assert!(unknown_commands(&forwarded, crate::HELP).is_empty(), "the help lists every command");
    }

    #[test]
    fn a_path_resolves_from_the_root_or_from_its_document() {
        let root = Path::new(env!("CARGO_MANIFEST_DIR")).parent().unwrap();
        assert!(resolves(root, Path::new("xtask"), "src/main.rs"));
        assert!(resolves(root, Path::new("docs"), "xtask/src/main.rs"));
        assert!(!resolves(root, Path::new("docs"), "src/main.rs"));
    }
}
