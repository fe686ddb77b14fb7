//! `cargo xtask mpi-test`: training on several ranks of MPI against one process.
//!
//! CI does not run it, because it needs OpenMPI. Runs of 50 steps on 1, 2 and 4 ranks must end with the same weights; a step that is not
//! finite on one rank must be skipped on all; a run whose rank is killed must end, and resume on another number of ranks.

use crate::run::{self, cargo};
use crate::sets::built_by;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitCode, Stdio};
use std::thread::sleep;
use std::time::{Duration, Instant, SystemTime};

const MISSING: &str = "mpi-test needs OpenMPI, its headers, and libclang, which the crate mpi is built with\n  \
    Debian and Ubuntu: apt-get install libopenmpi-dev openmpi-bin libclang-dev";

/// What is linted and built.
const PACKAGES: [&str; 6] =
    ["--package", "train", "--package", "sparsesplat-cli", "--features", "sparsesplat-cli/mpi"];

/// The test of train that is run on two ranks.
const NOT_FINITE: &str = "trainer::tests::what_is_not_finite_on_one_rank_is_skipped_on_all";

/// Four windows a step, for up to four ranks, in two shares for two.
const SETTINGS: &str = "(steps: 50, batch: 4, density: (0.02, 0.05), neighbours: 5, targets: 1, contexts: 1)";

/// By how much a weight may depend on the number of ranks.
const BOUND: f32 = 1e-6;

/// A test that takes longer hangs.
const LONGEST: Duration = Duration::from_secs(300);

/// Files lie under `target/mpi-test`.
pub(crate) fn run(root: &Path) -> ExitCode {
    run::concluded(test(root))
}

fn test(root: &Path) -> Result<(), String> {
    for program in ["mpirun", "mpicc"] {
        let found = Command::new(program).arg("--version").stdout(Stdio::null()).status();
        found.map_err(|error| format!("{program}: {error}: {MISSING}"))?;
    }
    let linted = cargo(["clippy"])
        .args(PACKAGES)
        .args(["--all-targets", "--", "-D", "warnings"])
        .current_dir(root)
        .status();
    if !linted.is_ok_and(|status| status.success()) {
        return Err("clippy fails".to_owned());
    }
    let (tests, program) = built(root)?;

    println!("== not finite on one of two ranks");
    let said = mpirun(2).arg(tests).args(["--exact", NOT_FINITE]).output().map_err(|e| e.to_string())?;
    let text = String::from_utf8_lossy(&said.stdout);
    if !said.status.success() || text.matches("1 passed").count() != 2 {
        return Err(format!("{NOT_FINITE} fails:\n{text}{}", String::from_utf8_lossy(&said.stderr)));
    }

    let folder = root.join("target/mpi-test");
    let _ = fs::remove_dir_all(folder.join("runs"));
    fs::create_dir_all(folder.join("runs")).map_err(|error| format!("{}: {error}", folder.display()))?;
    let settings = folder.join("settings.ron");
    fs::write(&settings, SETTINGS).map_err(|error| format!("{}: {error}", settings.display()))?;
    let runs = Runs { folder, program };
    for ranks in [1, 2, 4] {
        let begin = Instant::now();
        let mut run = runs.start(&format!("{ranks}"), Some(ranks), &[])?;
        ended(&mut run)?.then_some(()).ok_or(format!("a run on {ranks} ranks fails"))?;
        let difference = runs.difference("1", &format!("{ranks}"))?;
        println!(
            "== {ranks} ranks: weights differ by {difference:e}, {:.1} s",
            begin.elapsed().as_secs_f64()
        );
    }
    println!("== a rank is killed, resumed on 2, 1 and 2 ranks");
    runs.kill("resumed", Some(2), &[], "1")?;
    // Not started by mpirun.
    runs.kill("resumed", None, &["--resume"], "0")?;
    let mut run = runs.start("resumed", Some(2), &["--resume"])?;
    ended(&mut run)?.then_some(()).ok_or("the resumed run fails")?;
    println!("== resumed: weights differ by {:e}", runs.difference("1", "resumed")?);
    println!("== passed");
    Ok(())
}

/// Where runs are, and what runs them.
struct Runs {
    folder: PathBuf,
    program: PathBuf,
}

impl Runs {
    fn of(&self, name: &str) -> PathBuf {
        self.folder.join("runs").join(name)
    }

    /// Starts a run on so many ranks, or without `mpirun`; each process leaves its number in `name.pid.rank`.
    fn start(&self, name: &str, ranks: Option<usize>, more: &[&str]) -> Result<Child, String> {
        const NOTE: &str = "echo $$ > \"$0.pid.${OMPI_COMM_WORLD_RANK:-0}\"; exec \"$@\"";
        const SMALL: [&str; 14] = [
            "--scenes",
            "2",
            "--validation-scenes",
            "1",
            "--size",
            "96x64",
            "--save-every",
            "5",
            "--device",
            "cpu",
            "--threads",
            "1",
            "--config",
            "../settings.ron",
        ];
        let mut command = ranks.map_or_else(
            || Command::new("sh"),
            |ranks| {
                let mut command = mpirun(ranks);
                command.arg("sh");
                command
            },
        );
        command.args(["-c", NOTE]).arg(self.of(name)).arg(&self.program).arg("train").args(SMALL);
        command.args(["--cache", "../cache", "--output", name]).args(more);
        let child = command.current_dir(self.folder.join("runs")).stdout(Stdio::null()).spawn();
        child.map_err(|error| format!("{}: {error}", self.program.display()))
    }

    /// Kills one rank of a run as soon as the run has written a checkpoint; the others must end, too.
    fn kill(&self, name: &str, ranks: Option<usize>, more: &[&str], rank: &str) -> Result<(), String> {
        let checkpoint = self.of(name).join("checkpoint.safetensors");
        let written = || -> Option<SystemTime> { fs::metadata(&checkpoint).ok()?.modified().ok() };
        let before = written();
        let mut run = self.start(name, ranks, more)?;
        let begin = Instant::now();
        while written() == before {
            if begin.elapsed() > LONGEST || run.try_wait().is_ok_and(|status| status.is_some()) {
                return Err(format!("{}: no checkpoint before the run ended", checkpoint.display()));
            }
            sleep(Duration::from_millis(20));
        }
        let pid = format!("{}.pid.{rank}", self.of(name).display());
        let pid = fs::read_to_string(&pid).map_err(|error| format!("{pid}: {error}"))?;
        let killed = Command::new("kill").args(["-9", pid.trim()]).status();
        killed.map_err(|error| format!("kill: {error}"))?;
        if ended(&mut run)? { Err("a run whose rank was killed claims success".to_owned()) } else { Ok(()) }
    }

    /// The largest difference between two runs' weights, if it is within the bound.
    fn difference(&self, one: &str, other: &str) -> Result<f32, String> {
        let [one, other] = [self.weights(one)?, self.weights(other)?];
        if one.is_empty() || one.len() != other.len() {
            return Err(format!("{} and {} weights", one.len(), other.len()));
        }
        let differences = one.iter().zip(&other).map(|(a, b)| (a - b).abs());
        // `f32::max` would drop a NaN.
        let largest = differences.fold(0.0, |most: f32, d| if d <= most { most } else { d });
        if largest <= BOUND {
            Ok(largest)
        } else {
            Err(format!("weights differ by {largest:e}, at most {BOUND:e} is allowed"))
        }
    }

    /// The numbers of a file of weights: what comes after the header, whose length stands first.
    fn weights(&self, name: &str) -> Result<Vec<f32>, String> {
        let path = self.of(name).join("weights.safetensors");
        let bytes = fs::read(&path).map_err(|error| format!("{}: {error}", path.display()))?;
        let header = bytes.first_chunk().map_or(0, |length| u64::from_le_bytes(*length)) as usize;
        let numbers = bytes.get(8 + header..).unwrap_or_default();
        Ok(numbers.as_chunks().0.iter().map(|bytes| f32::from_le_bytes(*bytes)).collect())
    }
}

/// `mpirun` for some ranks, also on fewer cores, and as root, as whom containers run tests.
fn mpirun(ranks: usize) -> Command {
    let mut command = Command::new("mpirun");
    command.args(["-n", &ranks.to_string(), "--oversubscribe"]);
    command.envs([("OMPI_ALLOW_RUN_AS_ROOT", "1"), ("OMPI_ALLOW_RUN_AS_ROOT_CONFIRM", "1")]);
    command
}

/// Waits for the end of a run; whether it succeeded.
fn ended(run: &mut Child) -> Result<bool, String> {
    let begin = Instant::now();
    loop {
        match run.try_wait() {
            Ok(Some(status)) => return Ok(status.success()),
            Ok(None) if begin.elapsed() < LONGEST => sleep(Duration::from_millis(20)),
            Ok(None) => {
                let _ = run.kill();
                return Err("a run hangs".to_owned());
            }
            Err(error) => return Err(error.to_string()),
        }
    }
}

/// The tests of train, and the program.
fn built(root: &Path) -> Result<(PathBuf, PathBuf), String> {
    let mut build = cargo(["test"]);
    build.args(PACKAGES).args(["--lib", "--test", "it", "--no-run", "--message-format", "json"]);
    let output = build.current_dir(root).stderr(Stdio::inherit()).output();
    let output = output.map_err(|error| format!("cargo does not start: {error}"))?;
    let said = String::from_utf8_lossy(&output.stdout);
    let executable = |package: &str, is_test| {
        let mut all = said.lines().filter_map(built_by);
        let built = all.find(|built| built.folder.ends_with(package) && built.is_test == is_test);
        built.map(|built| built.executable).ok_or_else(|| format!("cargo builds no {package}"))
    };
    Ok((executable("train", true)?, executable("sparsesplat-cli", false)?))
}
