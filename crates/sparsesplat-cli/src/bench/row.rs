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

    /// Median, fastest, slowest and memory, as a table shows them; `decimals` of a millisecond.
    pub(super) fn cells(&self, decimals: usize) -> [String; 4] {
        let milliseconds = |seconds: f64| format!("{:.decimals$}", seconds * 1e3);
        let gigabytes = |bytes| format!("{:.2}", bytes as f64 / 1e9);
        [
            milliseconds(self.seconds),
            milliseconds(self.seconds_min),
            milliseconds(self.seconds_max),
            self.peak_rss_bytes.map_or("-".to_owned(), gigabytes),
        ]
    }
}
