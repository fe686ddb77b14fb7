//! Tells the compiler the commit that the binary is built from, as SPARSESPLAT_COMMIT.

use std::path::Path;
use std::process::Command;

fn main() {
    println!("cargo::rerun-if-changed=build.rs");
    let commit = of_package().or_else(of_checkout).unwrap_or_else(|| "unknown".to_owned());
    println!("cargo::rustc-env=SPARSESPLAT_COMMIT={commit}");
}

/// The commit that cargo notes in a package.
fn of_package() -> Option<String> {
    const NOTE: &str = ".cargo_vcs_info.json";
    // Asked about a file that is not there, cargo would run this script every time.
    if !Path::new(NOTE).is_file() {
        return None;
    }
    println!("cargo::rerun-if-changed={NOTE}");
    let text = std::fs::read_to_string(NOTE).ok()?;
    let (_, after) = text.split_once("\"sha1\"")?;
    let commit = after.split('"').nth(1)?;
    (commit.len() == 40 && commit.bytes().all(|digit| digit.is_ascii_hexdigit())).then(|| commit.to_owned())
}

/// The commit that is checked out, if this file is one of the checkout's and no stranger's repository lies around it.
fn of_checkout() -> Option<String> {
    git(&["ls-files", "--error-unmatch", "build.rs"])?;
    let commit = git(&["rev-parse", "HEAD"])?;
    // Whatever moves HEAD changes one of these; a ref may lie in a file of its own or in packed-refs.
    let reference = git(&["symbolic-ref", "--quiet", "HEAD"]);
    for name in ["HEAD", "packed-refs", "logs/HEAD"].into_iter().chain(reference.as_deref()) {
        if let Some(path) = git(&["rev-parse", "--git-path", name]).filter(|path| Path::new(path).is_file()) {
            println!("cargo::rerun-if-changed={path}");
        }
    }
    Some(commit)
}

/// What git says; none where there is no git, or it refuses.
fn git(arguments: &[&str]) -> Option<String> {
    let output =
        Command::new("git").args(arguments).output().ok().filter(|output| output.status.success())?;
    let text = String::from_utf8(output.stdout).ok()?;
    Some(text.trim().to_owned()).filter(|text| !text.is_empty())
}
