//! What the benches of stages on the processor share: jobs beside a reference, rows by the piece, their table.

use super::measure::{Measured, measure, timed};
use super::row::{self, Label};
use crate::arguments::Common;
use crate::failure::Outcome;
use crate::output;
use crate::progress::Progress;
use evaluate::Recipe;
use rayon::ThreadPool;
use report_parts::{Table, count};
use serde::Serialize;

/// What other implementations are compared with.
pub(super) const OURS: &str = "ours";

/// One row to be measured.
pub(super) struct Job<'a> {
    /// `threads` are those of the pool.
    label: Label,
    pool: &'a ThreadPool,
    work: Box<dyn Fn() -> Outcome + Sync + 'a>,
}

impl<'a> Job<'a> {
    /// Work on `n` things (at least one), for `k` neighbours each where that is a word.
    pub(super) fn new(
        implementation: &'static str,
        case: impl Into<String>,
        (n, k): (usize, Option<usize>),
        pool: &'a ThreadPool,
        work: impl Fn() -> Outcome + Sync + 'a,
    ) -> Self {
        let threads = pool.current_num_threads();
        Self { label: Label { implementation, case: case.into(), n, k, threads }, pool, work: Box::new(work) }
    }
}

/// A row of these benches.
pub(super) type Row = row::Row<Details>;

/// What they say beyond the rows of other benches.
#[derive(Debug, Serialize)]
pub(super) struct Details {
    /// Median for each of the `n`.
    pub(super) seconds_each: f64,
    /// Of another implementation: median over ours; else none.
    times_ours: Option<f64>,
}

/// Measures jobs together, and compares those of one case, size and number of threads.
pub(super) fn rows(
    bench: &'static str,
    jobs: &[Job<'_>],
    runs: usize,
    progress: &Progress,
) -> Outcome<Vec<Row>> {
    let mut run = |job: &Job<'_>| timed(job.pool, &job.work);
    let mut on_run = |job: &Job<'_>| {
        let Label { implementation, case, n, .. } = &job.label;
        progress.say(format!("{implementation}, {case}, {}", count(*n as f64)));
        progress.step();
    };
    let measured = measure(jobs, runs, &mut run, &mut on_run)?;
    let row = |(job, found): (&Job<'_>, &Measured<()>)| {
        let seconds = found.seconds.median;
        let reference = Label { implementation: OURS, ..job.label.clone() };
        let ours = jobs.iter().position(|other| other.label == reference && job.label != reference);
        let details = Details {
            seconds_each: seconds / job.label.n as f64,
            times_ours: ours.map(|place| seconds / measured[place].seconds.median),
        };
        Row::new(bench, job.label.clone(), found, details)
    };
    Ok(jobs.iter().zip(&measured).map(row).collect())
}

/// The rows for people; `things` are what was worked on.
pub(super) fn table(rows: &[Row], things: &str) -> Table {
    let neighbours = rows.iter().any(|row| row.k.is_some());
    let mut head = vec!["case", "impl", "threads", things];
    head.extend(neighbours.then_some("k"));
    head.extend(["ms", "fastest", "slowest", "ns each", "times ours", "peak MB"]);
    let mut table = Table::new(&head, 2);
    for row in rows {
        let mut cells = vec![
            row.case.clone(),
            row.implementation.to_owned(),
            row.threads.to_string(),
            count(row.n as f64),
        ];
        cells.extend(neighbours.then(|| row.k.map_or(String::new(), |k| k.to_string())));
        cells.extend(row.milliseconds());
        cells.push(format!("{:.1}", row.details.seconds_each * 1e9));
        cells.push(row.details.times_ours.map_or(String::new(), |times| format!("{times:.2}")));
        cells.push(row.memory(1e6));
        table.push(cells);
    }
    table
}

/// What `--json` writes.
#[derive(Serialize)]
struct Record<'a, S: Serialize, M: Serialize> {
    recipe: Recipe<S>,
    rows: &'a [Row],
    #[serde(flatten)]
    more: M,
}

/// Writes rows, and `more` keys (none: `()`), if asked for; `settings` are what it takes to repeat them.
pub(super) fn write(
    common: &Common,
    settings: impl Serialize,
    rows: &[Row],
    more: impl Serialize,
) -> Outcome {
    let Some(path) = &common.json else {
        return Ok(());
    };
    output::write_json(path, &Record { recipe: crate::recipe(0, settings), rows, more })
}
