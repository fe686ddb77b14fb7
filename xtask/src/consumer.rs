//! Whether somebody else's project can take one of our crates alone, and what comes with it.

use crate::run::cargo;
use std::io;
use std::path::Path;

/// A project of its own that depends on knn.
const FOLDER: &str = "consumers/knn-alone";

/// knn, cpu-isa, rayon and thiserror, and what the last two need.
const ALLOWED: [&str; 14] = [
    "knn",
    "cpu-isa",
    "rayon",
    "rayon-core",
    "crossbeam-deque",
    "crossbeam-epoch",
    "crossbeam-utils",
    "either",
    "thiserror",
    "thiserror-impl",
    "proc-macro2",
    "quote",
    "syn",
    "unicode-ident",
];

/// Looks for what knn brings along on any platform, then builds and runs the project with the versions that the workspace
/// has locked; what is wrong, one line each.
pub(crate) fn check(root: &Path) -> io::Result<Vec<String>> {
    let tree = ["tree", "--package", "knn", "--edges", "normal,build", "--target", "all", "--prefix", "none"];
    let tree = cargo(tree).current_dir(root).output()?;
    if !tree.status.success() {
        return Err(io::Error::other(format!("`cargo tree`: {}", String::from_utf8_lossy(&tree.stderr))));
    }
    let mut problems: Vec<String> = intruders(&String::from_utf8_lossy(&tree.stdout))
        .map(|name| format!("crates/knn brings {name} along; only cpu-isa, rayon, thiserror and what these need are allowed"))
        .collect();
    // One lock file for both: cargo takes from it what the project needs, and leaves out the rest.
    std::fs::copy(root.join("Cargo.lock"), root.join(FOLDER).join("Cargo.lock"))?;
    // Its folder is the current one, for its own configuration of cargo.
    let run = cargo(["run", "--quiet"]).current_dir(root.join(FOLDER)).status()?;
    if !run.success() {
        problems.push(format!("{FOLDER}: `cargo run` fails there"));
    }
    Ok(problems)
}

/// Packages that are not allowed, of lines that begin with a name. A package that was shown before is shown again as a name.
fn intruders(tree: &str) -> impl Iterator<Item = &str> {
    let names = tree.lines().filter_map(|line| line.split_whitespace().next());
    names.filter(|name| !ALLOWED.contains(name))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_not_allowed_is_named() {
        let tree = "knn v0.1.0 (/a/crates/knn)\nrayon v1.11.0\nwgpu v30.0.0\nrayon v1.11.0 (*)\n";
        assert_eq!(intruders(tree).collect::<Vec<_>>(), ["wgpu"]);
    }
}
