//! Rows: what every bench says of each thing that it measured.

use super::measure::Measured;
use serde::Serialize;

/// One row of the JSON file.
#[derive(Debug, Serialize)]
pub(super) struct Row<D> {
    pub(super) bench: &'static str,
    /// `ours`, `ours-naive`, or the name of a peer.
    #[serde(rename = "impl")]
    pub(super) implementation: &'static str,
    pub(super) case: String,
    /// How many things were worked on.
    pub(super) n: usize,
    /// Neighbours of each, where that is a word.
    pub(super) k: Option<usize>,
    pub(super) threads: usize,
    /// Median.
    pub(super) seconds: f64,
    pub(super) seconds_min: f64,
    pub(super) seconds_max: f64,
    pub(super) peak_rss_bytes: Option<u64>,
    /// What this bench says beyond the others.
    #[serde(flatten)]
    pub(super) details: D,
}

/// What was measured, before it was.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Label {
    pub(super) implementation: &'static str,
    pub(super) case: String,
    pub(super) n: usize,
    pub(super) k: Option<usize>,
    pub(super) threads: usize,
}

impl<D> Row<D> {
    pub(super) fn new<T>(bench: &'static str, label: Label, found: &Measured<T>, details: D) -> Self {
        let Label { implementation, case, n, k, threads } = label;
        Self {
            bench,
            implementation,
            case,
            n,
            k,
            threads,
            seconds: found.seconds.median,
            seconds_min: found.seconds.least,
            seconds_max: found.seconds.most,
            peak_rss_bytes: found.peak_rss_bytes,
            details,
        }
    }

    /// Median, fastest and slowest in milliseconds, as a table shows them.
    pub(super) fn milliseconds(&self) -> [String; 3] {
        [self.seconds, self.seconds_min, self.seconds_max].map(|seconds| format!("{:.2}", seconds * 1e3))
    }

    /// The memory, as a table shows it, in a unit of so many bytes.
    pub(super) fn memory(&self, unit: f64) -> String {
        self.peak_rss_bytes.map_or("-".to_owned(), |bytes| format!("{:.2}", bytes as f64 / unit))
    }
}
