//! `bench knn`: nearest neighbours of whole point sets.

#[cfg(feature = "peers")]
mod peer;

use super::cpu::{self, Job, OURS, Row};
use super::measure::pools;
use super::random::Random;
use crate::arguments::{Common, gaussians as count_above_0, positive};
use crate::failure::{OrFail, Outcome};
use crate::progress::Progress;
use crate::summary::{print, print_line};
use clap::{Args, ValueEnum};
use report_parts::{Table, count};
use serde::Serialize;

/// Nearest neighbours of whole point sets: time and memory against their size, beside kiddo
///
/// The K nearest of every point of a set, on all threads, with all it takes: a tree is built in every run. kiddo runs where it is built in
/// (cargo feature `peers`, as in `cargo xtask bench knn`), set up as is fastest for it here: its flat tree with buckets of 64 points, queries
/// on all threads, in spatial order; that the order has to be found first is not counted, and its results are dropped as they come, where
/// ours are kept.
#[derive(Debug, Args)]
#[command(arg = crate::arguments::no_device(), after_help = "Examples:\n  cargo xtask bench knn --json knn.json\n  \
                        sparsesplat bench knn --counts 150k --neighbours 20 --case surfaces --runs 9")]
pub(crate) struct Arguments {
    /// How many points
    #[arg(
        long,
        value_name = "N,M,...",
        value_parser = count_above_0,
        value_delimiter = ',',
        default_value = "10k,40k,100k,150k,1M"
    )]
    counts: Vec<usize>,
    /// How many neighbours of each
    #[arg(long, value_name = "K,L,...", value_parser = positive, value_delimiter = ',', default_value = "5,10,20,30")]
    neighbours: Vec<usize>,
    /// How the points lie
    #[arg(long, value_enum, value_delimiter = ',', default_value = "surfaces,uniform")]
    case: Vec<Case>,
    /// Timed runs of each row
    #[arg(long, value_name = "N", value_parser = positive, default_value_t = 5)]
    runs: usize,
}

/// How points lie.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum, Serialize)]
#[serde(rename_all = "kebab-case")]
enum Case {
    /// On a floor, two walls and a ball, all a little rough, as pixels with depth do
    Surfaces,
    /// Anywhere in a cube
    Uniform,
}

impl Case {
    fn name(self) -> &'static str {
        match self {
            Self::Surfaces => "surfaces",
            Self::Uniform => "uniform",
        }
    }

    fn points(self, n: usize) -> Vec<[f32; 3]> {
        let mut random = Random(1);
        let mut point = |i: usize| {
            let [a, b, c] = std::array::from_fn(|_| random.unit());
            match self {
                Self::Uniform => [a, b, c],
                Self::Surfaces => on_a_surface(i, a, b, 2e-3 * c),
            }
        };
        (0..n).map(&mut point).collect()
    }
}

/// A place (a, b) in -1..1 on one of four surfaces, off it by `rough`.
fn on_a_surface(i: usize, a: f32, b: f32, rough: f32) -> [f32; 3] {
    match i % 4 {
        0 => [4.0 * a, 1.0 + rough, 4.0 * b],
        1 => [4.0 * a, b, 4.0 + rough],
        2 => [-4.0 + rough, a, 4.0 * b],
        _ => {
            let (sin, cos) = (std::f32::consts::PI * a).sin_cos();
            let (radius, ring) = (0.5 + rough, (1.0 - b * b).sqrt());
            [radius * ring * cos, radius * b, 2.0 + radius * ring * sin]
        }
    }
}

/// How time per point grows with the set.
#[derive(Debug, Serialize)]
struct Growth {
    #[serde(rename = "impl")]
    implementation: &'static str,
    case: String,
    k: Option<usize>,
    smallest_n: usize,
    largest_n: usize,
    /// Time per point of the largest set over that of the smallest.
    times: f64,
}

#[derive(Serialize)]
struct More {
    growth: Vec<Growth>,
}

#[derive(Serialize)]
struct Settings<'a> {
    counts: &'a [usize],
    neighbours: &'a [usize],
    cases: &'a [Case],
    runs: usize,
}

pub(crate) fn run(arguments: &Arguments, common: &Common) -> Outcome {
    let Arguments { counts, neighbours, case: cases, runs } = arguments;
    let pools = pools()?;
    let pool = pools.last().expect("there is at least one thread");
    let implementations = 1 + usize::from(cfg!(feature = "peers"));
    let progress = Progress::new(runs * cases.len() * counts.len() * neighbours.len() * implementations);
    let mut rows = Vec::new();
    for &case in cases {
        for &n in counts {
            progress.say(format!("making {} points", count(n as f64)));
            let points = case.points(n);
            #[cfg(feature = "peers")]
            let in_order = peer::in_spatial_order(&points);
            for &k in neighbours {
                let size = (n, Some(k));
                let ours = || knn::knn(&points, k).map(drop).or_work();
                let jobs = [
                    Job::new(OURS, case.name(), size, pool, ours),
                    #[cfg(feature = "peers")]
                    Job::new("kiddo", case.name(), size, pool, || peer::search(&points, &in_order, k)),
                ];
                rows.extend(cpu::rows("knn", &jobs, *runs, &progress)?);
            }
        }
    }
    drop(progress);

    let growth = growth(&rows);
    print(&cpu::table(&rows, "points").to_text());
    if !growth.is_empty() {
        print_line("\nTime per point, of the largest set over that of the smallest:\n");
        print(&growth_table(&growth).to_text());
    }
    if !cfg!(feature = "peers") {
        print_line(
            "\nkiddo is not built in. With it: `cargo xtask bench knn`, or build with the cargo feature `peers`.",
        );
    }
    let settings = Settings { counts, neighbours, cases, runs: *runs };
    cpu::write(common, settings, &rows, More { growth })
}

/// Of every implementation, case and k that has sets of several sizes.
fn growth(rows: &[Row]) -> Vec<Growth> {
    let same = |a: &Row, b: &Row| (a.implementation, &a.case, a.k) == (b.implementation, &b.case, b.k);
    let mut growth = Vec::new();
    for (place, row) in rows.iter().enumerate() {
        if rows[..place].iter().any(|earlier| same(earlier, row)) {
            continue;
        }
        let alike = || rows.iter().filter(|other| same(other, row));
        let (Some(smallest), Some(largest)) =
            (alike().min_by_key(|row| row.n), alike().max_by_key(|row| row.n))
        else {
            continue;
        };
        if smallest.n < largest.n {
            growth.push(Growth {
                implementation: row.implementation,
                case: row.case.clone(),
                k: row.k,
                smallest_n: smallest.n,
                largest_n: largest.n,
                times: largest.details.seconds_each / smallest.details.seconds_each,
            });
        }
    }
    growth
}

fn growth_table(growth: &[Growth]) -> Table {
    let mut table = Table::new(&["case", "impl", "k", "from", "to", "times"], 2);
    for found in growth {
        table.push(vec![
            found.case.clone(),
            found.implementation.to_owned(),
            found.k.map_or(String::new(), |k| k.to_string()),
            count(found.smallest_n as f64),
            count(found.largest_n as f64),
            format!("{:.2}", found.times),
        ]);
    }
    table
}
