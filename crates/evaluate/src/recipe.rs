//! The recipe of a figure: everything that is needed to repeat it.

use cpu_isa::Isa;
use serde::Serialize;
use std::collections::BTreeMap;
use std::fs;

/// The recipe at the head of every JSON file.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Recipe<C> {
    /// The command line.
    pub command: Vec<String>,
    /// Commit that the binary was built from, `unknown` where that was no checkout. Files that were changed and not committed are not
    /// told.
    pub git: String,
    /// Seed of the sampling; the first of several.
    pub seed: u64,
    /// Threads that worked.
    pub threads: usize,
    /// Instruction set that vector code ran on.
    pub isa: &'static str,
    /// The machine.
    pub machine: Machine,
    /// Every setting.
    pub config: C,
    /// Versions by name.
    pub versions: BTreeMap<&'static str, String>,
}

impl<C: Serialize> Recipe<C> {
    /// The recipe of this process, whose binary was built from the commit `git`.
    #[must_use]
    pub fn of_this_run(git: &str, seed: u64, threads: usize, config: C) -> Self {
        Self {
            command: std::env::args_os().map(|word| word.to_string_lossy().into_owned()).collect(),
            git: git.to_owned(),
            seed,
            threads,
            isa: Isa::in_use().name(),
            machine: Machine::this(),
            config,
            versions: BTreeMap::from([("sparsesplat", env!("CARGO_PKG_VERSION").to_owned())]),
        }
    }
}

/// A machine, as far as it tells.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Machine {
    /// Operating system.
    pub os: &'static str,
    /// Architecture of the processor.
    pub arch: &'static str,
    /// Model name of the processor.
    pub cpu: Option<String>,
    /// Cores that this process may use.
    pub cores: usize,
    /// Memory, bytes.
    pub memory_bytes: Option<u64>,
}

impl Machine {
    /// The machine this runs on.
    #[must_use]
    pub fn this() -> Self {
        let read = |path| fs::read_to_string(path).unwrap_or_default();
        Self {
            os: std::env::consts::OS,
            arch: std::env::consts::ARCH,
            cpu: field(&read("/proc/cpuinfo"), "model name").map(str::to_owned),
            cores: std::thread::available_parallelism().map_or(1, usize::from),
            memory_bytes: field(&read("/proc/meminfo"), "MemTotal").and_then(kibibytes),
        }
    }
}

/// Most memory that this process has held at once, bytes; none where the system does not say (it is read from
/// `/proc`).
#[must_use]
pub fn peak_rss_bytes() -> Option<u64> {
    field(&fs::read_to_string("/proc/self/status").ok()?, "VmHWM").and_then(kibibytes)
}

/// Lets the system count [`peak_rss_bytes`] anew from what this process holds now. Whether it does: where it does not know how,
/// the count goes on from the start of the process.
pub fn restart_peak_rss() -> bool {
    fs::write("/proc/self/clear_refs", "5").is_ok()
}

/// The value in a line `key : value`.
fn field<'a>(text: &'a str, key: &str) -> Option<&'a str> {
    text.lines().find_map(|line| {
        let (name, value) = line.split_once(':')?;
        (name.trim() == key).then_some(value.trim())
    })
}

/// `123 kB` to bytes.
fn kibibytes(text: &str) -> Option<u64> {
    text.strip_suffix(" kB")?.trim().parse::<u64>().ok()?.checked_mul(1024)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fields_are_found_by_their_whole_name() {
        let text = "VmHWMx:\t1 kB\nVmHWM:\t  123 kB\nmodel name\t: A : B\n";
        assert_eq!(field(text, "VmHWM").and_then(kibibytes), Some(123 * 1024));
        assert_eq!(field(text, "model name"), Some("A : B"));
        assert_eq!(field(text, "cpu"), None);
        assert_eq!(kibibytes("12 MB"), None);
    }

    #[test]
    fn a_recipe_has_the_keys_that_readers_rely_on() {
        let json = serde_json::to_value(Recipe::of_this_run("commit", 7, 2, "settings")).unwrap();
        for key in ["command", "git", "seed", "threads", "isa", "machine", "config", "versions"] {
            assert!(json.get(key).is_some(), "{key}");
        }
        assert_eq!((&json["seed"], &json["config"]), (&7.into(), &"settings".into()));
    }
}
