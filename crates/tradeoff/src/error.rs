use std::path::PathBuf;

/// Why a sweep cannot begin, go on or be merged.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum SweepError {
    /// A file that cannot be read or written.
    #[error("{}: cannot {action}", path.display())]
    Io {
        /// What was tried.
        action: &'static str,
        /// The file or folder.
        path: PathBuf,
        /// Why not.
        #[source]
        source: std::io::Error,
    },
    /// A file without a first line that says what was measured.
    #[error("{}: the first line is not the recipe of a sweep: remove the file, or give another folder", path.display())]
    NoHeader {
        /// The file.
        path: PathBuf,
    },
    /// Points of another sweep.
    #[error(
        "{}: measured by another recipe: {key} is {found} there and {expected} here: give another folder, or remove the file to \
         measure anew", path.display()
    )]
    OtherRecipe {
        /// The file.
        path: PathBuf,
        /// Where the recipes differ, as `config.seeds`.
        key: String,
        /// What this sweep says, JSON.
        expected: String,
        /// What the file says, JSON.
        found: String,
    },
    /// Another process measures the same shard.
    #[error("{}: another process is measuring this shard in this folder: let it finish, or give another folder", path.display())]
    Busy {
        /// The lock.
        path: PathBuf,
    },
    /// A line that is no measured point.
    #[error("{}:{line}: {rule}", path.display())]
    Line {
        /// The file.
        path: PathBuf,
        /// The line, from 1.
        line: usize,
        /// What is expected there.
        rule: String,
    },
    /// A shard that is no shard.
    #[error("shard {text:?}: expected I/N with I from 0 to N-1, such as 0/4")]
    Shard {
        /// What was given.
        text: String,
    },
    /// Variables of a cluster's scheduler that say too little, or nothing that can be used.
    #[error("{variable}={value:?}: {rule}; or name the shard yourself, I/N, where 0/1 is all")]
    Scheduler {
        /// The variable.
        variable: &'static str,
        /// Its value.
        value: String,
        /// What is expected.
        rule: &'static str,
    },
    /// Nothing to merge.
    #[error("{}: no points-I-of-N.jsonl there: expected the folder of a sweep", path.display())]
    NoJournal {
        /// The folder.
        path: PathBuf,
    },
    /// The same shard twice.
    #[error("{} and {} are both shard {shard}: give one of them", a.display(), b.display())]
    Twice {
        /// One file.
        a: PathBuf,
        /// The other.
        b: PathBuf,
        /// The shard, `I/N`.
        shard: String,
    },
    /// Shards that are not there, or not done.
    #[error("the sweep is not complete: {}", missing.join("; "))]
    Missing {
        /// What is missing, one entry each.
        missing: Vec<String>,
    },
}
