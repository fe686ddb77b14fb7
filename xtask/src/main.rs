//! The project's runner, without dependencies: `cargo xtask <command>`.
//!
//! The commands of users go to the `sparsesplat` binary, arguments untouched; the checks of developers run here.

mod browser;
mod consumer;
mod formats;
mod mpi;
mod python;
mod run;
mod sets;
mod test;
mod tidy;

use run::{Step, cargo};
use std::env;
use std::ffi::OsString;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

const HELP: &str = "\
Usage: cargo xtask <command> [arguments]

Commands of the product (built in release, arguments passed on; each has --help):
  demo         simulate a scene, reconstruct it, render views it never saw, write a report
  reconstruct  photographs to a 3D Gaussian scene
  poses        photographs or a video to a data set with camera poses
  stream       posed frames as they come to a map that never exceeds a cap
  render       a scene to pictures
  convert      a scene to another file format
  view         a scene to a page that shows it in the browser
  eval         the tables: PSNR, SSIM, Gaussians and time on data sets
  tradeoff     what accuracy costs in time: one method varied along one axis at a time
  paper        the paper's tables, with what is measured here beside
  train        a head, on a frozen backbone
  train-depth  the network behind `--depth learned`
  ablate       the paper's ablations, each row trained alike
  simulate     photographs of a described or generated scene, as a data set in one of the usual layouts
  check-data   what a data set is, and what is wrong with it
  weights      of DepthSplat's network: which are published, which are here; --fetch places one
  doctor       what this machine offers, and a self-test on CPU and GPU
  bench        how fast the parts are on this machine, beside peers; without a name it lists them

Checks for developers:
  test         every test (dev profile); arguments go to `cargo test`
  test --gpu   those that need a graphics adapter as well; a software one does, without any it fails
  browser-test [PAGE ...]
               reports in a real browser (Chromium): plots, pictures, sliders, console; without a page it makes them first, and
               checks the viewer: frames against gs-raster and gs-reference, controls, times
  format-test  scene files of another program (splat-transform, from npm) against ours, both ways
  poses-test   clippy and tests of poses with the engine openMVG-rs, which ci leaves out
  mpi-test     training on several processes of MPI against one; needs OpenMPI
  python-test [--torch] [ARGUMENTS OF PYTEST]
               the Python module: wheel, fresh environment, pytest, and with torch its example
  shader NAME  a shader as it is compiled; without a name it lists them
  tidy         rules that no compiler knows: file sizes, paths and commands in documents, names of crates
  ci           formatting, lints, tidy, tests with --gpu, documentation, packages, use from outside: all that must pass
";

/// Commands that belong to the `sparsesplat` binary.
const FORWARDED: [&str; 18] = [
    "demo",
    "reconstruct",
    "poses",
    "stream",
    "render",
    "convert",
    "view",
    "eval",
    "tradeoff",
    "paper",
    "train",
    "train-depth",
    "ablate",
    "simulate",
    "check-data",
    "weights",
    "doctor",
    "bench",
];

fn main() -> ExitCode {
    let root =
        Path::new(env!("CARGO_MANIFEST_DIR")).parent().expect("xtask lies one folder below the workspace");
    let mut arguments = env::args_os().skip(1);
    let command = arguments.next().unwrap_or_else(|| "--help".into());
    let rest: Vec<OsString> = arguments.collect();
    match command.to_str() {
        Some(name) if FORWARDED.contains(&name) => forward(root, name, &rest),
        Some("test") => test::run(root, &rest),
        Some("browser-test") => browser::run(root, &rest, |folder| pages(root, folder)),
        Some("format-test") => formats::run(root),
        Some("poses-test") => run::all(root, &POSES),
        Some("mpi-test") => mpi::run(root),
        Some("python-test") => python::run(root, &rest),
        Some("shader") => run::exit_code(cargo(SHADER).args(rest).current_dir(root).status()),
        Some("tidy") => run::all(root, &[TIDY]),
        Some("ci") => run::all(root, &CI),
        Some("help" | "-h" | "--help") => {
            print!("{HELP}");
            ExitCode::SUCCESS
        }
        _ => {
            eprintln!("error: no command {:?}; `cargo xtask --help` lists them", command);
            ExitCode::from(2)
        }
    }
}

/// Builds the binary in sight of the caller, then runs it without a word of cargo's around its own.
fn forward(root: &Path, command: &str, arguments: &[OsString]) -> ExitCode {
    const BINARY: [&str; 4] = ["--release", "--package", "sparsesplat-cli", "--manifest-path"];
    let manifest = root.join("Cargo.toml");
    let features = features_of(command, arguments);
    match cargo(["build"]).args(BINARY).arg(&manifest).args(&features).status() {
        Ok(built) if built.success() => {
            // The folder of the caller stays the current one, so that relative paths mean what they say.
            let mut run = cargo(["run", "--quiet"]);
            run.args(BINARY).arg(&manifest).args(&features).arg("--").arg(command).args(arguments);
            run::exit_code(run.status())
        }
        failed => run::exit_code(failed),
    }
}

/// What is compiled for a command: candle and all that computes with it, the engine of poses, and the crates that are measured against only
/// where they are asked for.
fn features_of(command: &str, arguments: &[OsString]) -> Vec<&'static str> {
    let any =
        |rule: &dyn Fn(&str) -> bool| arguments.iter().any(|argument| rule(&argument.to_string_lossy()));
    let said = |flag: &str| any(&|argument| argument.split('=').next() == Some(flag));
    let names = |part: &str| any(&|argument| argument.contains(part));
    let mut words = Vec::new();
    // The second is the word of a backbone, of a head, and of the files with their weights.
    if !matches!(command, "train" | "train-depth" | "ablate" | "bench") && !names("depthsplat") {
        words.push("--no-default-features");
    }
    match command {
        "bench" => words.extend(["--features", "peers"]),
        "weights" if said("--fetch") => words.extend(["--features", "hf-hub"]),
        "poses" => words.extend(["--features", OPENMVG, ANY_RUST]),
        "reconstruct" if said("--poses") => words.extend(["--features", OPENMVG, ANY_RUST]),
        _ => {}
    }
    words
}

/// One page of each kind, of pictures small enough to be made in seconds.
fn pages(root: &Path, folder: &Path) -> Option<Vec<PathBuf>> {
    const SMALL: [&str; 6] = ["--size", "120x80", "--gaussians", "2k", "--device", "cpu"];
    let kinds: [(&str, &[&str]); 2] = [("tradeoff", &["--quick"]), ("eval", &["--dataset", "simulated"])];
    let mut pages = Vec::new();
    for (command, more) in kinds {
        let page = folder.join(format!("{command}.html"));
        let words = more.iter().chain(&SMALL).map(OsString::from);
        let words: Vec<OsString> = words.chain(["--report".into(), page.clone().into()]).collect();
        if forward(root, command, &words) != ExitCode::SUCCESS {
            return None;
        }
        pages.push(page);
    }
    Some(pages)
}

const SHADER: [&str; 7] = ["run", "--quiet", "--package", "gs-shaders", "--example", "shader", "--"];

const TIDY: Step = Step::Check("tidy", tidy::check);

/// What `ci` says of a change must not depend on luck: property tests draw the same cases each time. `cargo xtask test`
/// draws new ones.
const SAME_CASES: [(&str, &str); 1] = [("PROPTEST_RNG_SEED", "20251")];

/// What is off by default: kiddo to be measured against, and fetching weights. The engine of poses has [`POSES`], because it and what it needs
/// take as long to compile as a quarter of all the rest.
const EXTRAS: &str = "sparsesplat-cli/peers,sparsesplat-cli/hf-hub";

/// The feature of the engine of poses.
const OPENMVG: &str = "sparsesplat-cli/openmvg";

/// The engine openMVG-rs declares Rust 1.97 and builds with the workspace's: cargo wants this flag wherever its feature is on.
const ANY_RUST: &str = "--ignore-rust-version";

/// What is built to be tested: not the examples, each of which would be linked. Clippy checks them.
const TARGETS: [&str; 3] = ["--lib", "--bins", "--tests"];

/// What `ci` leaves out of the estimation of poses: everything with the engine openMVG-rs.
const POSES: [Step; 2] = [
    Step::Cargo(
        "clippy with openmvg",
        &[
            "clippy",
            "--package",
            "view-poses",
            "--package",
            "sparsesplat-cli",
            "--features",
            OPENMVG,
            ANY_RUST,
            "--all-targets",
            "--",
            "-D",
            "warnings",
        ],
        &[],
    ),
    // Both at once: one by one, cargo would compile what they share twice.
    Step::Cargo(
        "test with openmvg",
        &["test", "--package", "view-poses", "--package", "sparsesplat-cli", "--features", OPENMVG, ANY_RUST],
        &SAME_CASES,
    ),
];

/// Cheap checks first, so that a slip of the pen is told early.
const CI: [Step; 14] = [
    Step::Cargo("fmt", &["fmt", "--all", "--check"], &[]),
    TIDY,
    Step::Cargo(
        "clippy",
        &["clippy", "--workspace", "--features", EXTRAS, "--all-targets", "--", "-D", "warnings"],
        &[],
    ),
    // Without candle, and so without the crates that cannot do without it: `cargo xtask demo` builds the binary so. `poses-test` checks it with
    // the default features.
    Step::Cargo(
        "clippy without default features",
        &[
            "clippy",
            "--workspace",
            "--exclude",
            "train",
            "--no-default-features",
            "--all-targets",
            "--",
            "-D",
            "warnings",
        ],
        &[],
    ),
    Step::Cargo(
        "clippy without the GPU path",
        &[
            "clippy",
            "--package",
            "gs-raster",
            "--no-default-features",
            "--all-targets",
            "--",
            "-D",
            "warnings",
        ],
        &[],
    ),
    Step::Cargo(
        "test",
        &["xtask", "test", "--gpu", "--features", EXTRAS, TARGETS[0], TARGETS[1], TARGETS[2]],
        &SAME_CASES,
    ),
    Step::Cargo("test of the documentation", &["test", "--workspace", "--features", EXTRAS, "--doc"], &[]),
    Step::Check("instruction sets", sets::check),
    Step::Check("speed under every set", sets::guard),
    Step::Cargo(
        "test without rayon and serde",
        &[
            "test",
            "--package",
            "knn",
            "--package",
            "entropy-sampler",
            "--package",
            "covisibility",
            "--no-default-features",
        ],
        &SAME_CASES,
    ),
    // With the features of the first clippy, which has checked what it needs.
    Step::Cargo(
        "doc",
        &["doc", "--workspace", "--no-deps", "--features", EXTRAS],
        &[("RUSTDOCFLAGS", "-Dwarnings")],
    ),
    // A working copy with changes has packages, too.
    Step::Cargo(
        "package",
        &[
            "package",
            "--allow-dirty",
            "--no-verify",
            "--package",
            "gs-scene",
            "--package",
            "cpu-isa",
            "--package",
            "cpu-kernels",
            "--package",
            "knn",
            "--package",
            "entropy-sampler",
            "--package",
            "backproject",
            "--package",
            "covisibility",
        ],
        &[],
    ),
    // The one that is meant to be used alone is compiled from its package, too, and with it what it depends on.
    Step::Cargo(
        "package that compiles",
        &["package", "--allow-dirty", "--package", "cpu-isa", "--package", "knn"],
        &[],
    ),
    Step::Check("use from outside", consumer::check),
];

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn commands_are_built_with_what_they_ask_for() {
        for (line, expected) in [
            ("demo", "--no-default-features"),
            ("train -o run", ""),
            ("bench knn", "--features peers"),
            ("eval --backbone depthsplat", ""),
            ("train-depth -o run", ""),
            ("ablate head", ""),
            ("doctor", "--no-default-features"),
            ("weights", "--no-default-features"),
            ("reconstruct photos--poses", "--no-default-features"),
            (
                "poses photos",
                "--no-default-features --features sparsesplat-cli/openmvg --ignore-rust-version",
            ),
            ("weights --fetch small", "--no-default-features --features hf-hub"),
            ("reconstruct photos -o scene.ply", "--no-default-features"),
            (
                "reconstruct photos --poses -o scene.ply",
                "--no-default-features --features sparsesplat-cli/openmvg --ignore-rust-version",
            ),
            (
                "reconstruct photos --poses --backbone=depthsplat",
                "--features sparsesplat-cli/openmvg --ignore-rust-version",
            ),
        ] {
            let mut words = line.split(' ');
            let command = words.next().unwrap();
            let features = features_of(command, &words.map(OsString::from).collect::<Vec<_>>());
            assert_eq!(features.join(" "), expected, "{line}");
        }
    }
}
