//! `cargo xtask format-test`: scene files of another program against ours, both ways.
//!
//! `@playcanvas/splat-transform` (npm) writes compressed PLY, SPZ and glTF from our PLY, and our crate reads them; our crate writes
//! compressed PLY, SPZ and .splat, and splat-transform reads them. It neither reads glTF nor writes .splat; Khronos' validator
//! looks at our glTF instead. The example `interchange` of splat-formats holds the results against the scene.

use crate::run::{self, cargo};
use std::fs;
use std::path::Path;
use std::process::{Command, ExitCode};

/// What is installed, with the versions that the bounds were found to hold for.
const PACKAGES: [&str; 2] = ["@playcanvas/splat-transform@3.7.0", "gltf-validator@2.0.0-dev.3.10"];
const TRANSFORM: &str = "node_modules/@playcanvas/splat-transform/bin/cli.mjs";
/// From which file it makes which.
const CONVERSIONS: [[&str; 2]; 7] = [
    ["ours.ply", "theirs.compressed.ply"],
    ["ours.ply", "theirs.spz"],
    ["ours.ply", "theirs.glb"],
    ["ours.ply", "from-ply.ply"],
    ["ours.compressed.ply", "from-compressed.ply"],
    ["ours.spz", "from-spz.ply"],
    ["ours.splat", "from-splat.ply"],
];
/// Prints errors and warnings; the exit code says whether there are errors. The validator does not know the extension yet, so it
/// does not know the names of its attributes; all else is checked. Issues of severity 0 are errors, of severity 1 warnings.
const VALIDATE: &str = "
const bytes = new Uint8Array(require('fs').readFileSync('ours.glb'));
require('gltf-validator').validateBytes(bytes, { maxIssues: 0 }).then(report => {
  const isName = issue => issue.code === 'MESH_PRIMITIVE_INVALID_ATTRIBUTE'
    && issue.pointer.includes('/attributes/KHR_gaussian_splatting:');
  const issues = report.issues.messages.filter(issue => issue.severity < 2 && !isName(issue));
  issues.forEach(issue => console.log('ours.glb:', issue.code, issue.pointer, issue.message));
  const errors = issues.filter(issue => issue.severity === 0).length;
  console.log('ours.glb:', errors, 'errors,', report.info.totalVertexCount, 'vertices');
  process.exit(errors ? 1 : 0);
});";

/// Needs node (18 or newer) and npm; files lie under `target/format-test`.
pub(crate) fn run(root: &Path) -> ExitCode {
    run::concluded(test(root))
}

fn test(root: &Path) -> Result<(), String> {
    let folder = root.join("target/format-test");
    // What an earlier run has left must not pass for a result.
    for [_, made] in CONVERSIONS {
        let _ = fs::remove_file(folder.join(made));
    }
    fs::create_dir_all(&folder).map_err(|error| format!("{}: {error}", folder.display()))?;
    let npm = Command::new("npm")
        .args(["install", "--no-save", "--no-audit", "--no-fund", "--prefix", "."])
        .args(PACKAGES)
        .current_dir(&folder)
        .status();
    finished("npm install", npm)?;
    let ours = |what: &str| {
        let mut command =
            cargo(["run", "--quiet", "--package", "splat-formats", "--example", "interchange", "--"]);
        finished(what, command.arg(what).arg(&folder).current_dir(root).status())
    };
    ours("write")?;
    for [from, to] in CONVERSIONS {
        let node = Command::new("node")
            .args([TRANSFORM, "--quiet", "--overwrite", "--spz-version", "3", from, to])
            .current_dir(&folder)
            .status();
        finished(&format!("splat-transform {from} {to}"), node)?;
    }
    finished("gltf-validator", Command::new("node").args(["-e", VALIDATE]).current_dir(&folder).status())?;
    ours("compare")?;
    println!("== passed: {}", PACKAGES.join(", "));
    Ok(())
}

fn finished(name: &str, status: std::io::Result<std::process::ExitStatus>) -> Result<(), String> {
    match status {
        Ok(status) if status.success() => Ok(()),
        Ok(status) => Err(format!("failed in {name} ({status})")),
        Err(error) => Err(format!("{name}: it does not start: {error}")),
    }
}
