//! `bench backbone`: DepthSplat's network.

use super::cpu::OURS;
use super::measure::{Spread, measure, pools, timed};
use super::random::Random;
use super::row::{Label, Row};
use crate::arguments::{Common, positive, size};
use crate::failure::{OrFail, Outcome};
use crate::output;
use crate::progress::Progress;
use crate::summary::{print, print_line};
use candle_core::{Device, Tensor};
use clap::Args;
use depth_backbone::{DepthSplat, Scales, StageTime, Variant, Vit};
use evaluate::Recipe;
use glam::DVec3;
use gs_scene::{Camera, Image, Intrinsics, View};
use report_parts::Table;
use serde::Serialize;
use std::path::PathBuf;

/// DepthSplat's network: time by stage, FLOP/s and memory against the number of views
///
/// Without a checkpoint the weights follow a rule: they decide what is computed, not how long it takes. FLOP are counted by the
/// definition of convolutions, products and attention; a fast algorithm (Winograd's) may exceed the rate of the machine's matrix product,
/// which candle's, in f32 on all threads, stands for.
#[derive(Debug, Args)]
#[command(arg = crate::arguments::no_device(), after_help = "Examples:\n  cargo xtask bench backbone --json backbone.json\n  \
                        sparsesplat bench backbone --views 2 --layout s2_u4l8 --vit vitb\n  \
                        sparsesplat bench backbone --weights depthsplat-gs-small-....pth")]
pub(crate) struct Arguments {
    /// How many views
    #[arg(long, value_name = "N,M,...", value_parser = positive, value_delimiter = ',', default_value = "2,6")]
    views: Vec<usize>,
    /// Their size
    #[arg(long, value_name = "WxH", value_parser = size, default_value = "448x256")]
    size: (usize, usize),
    /// Scales of the cost volumes: s1_u4l4, s1_u8l8 (small, DL3DV), s2_u4l8 (base, DL3DV) or s2_u2l4
    #[arg(long, value_name = "LAYOUT", value_parser = layout, default_value = "s1_u8l8")]
    layout: Scales,
    /// Size of the vision transformer: vits, vitb or vitl
    #[arg(long, value_name = "VIT", value_parser = vit, default_value = "vits")]
    vit: Vit,
    /// Measure the network of this checkpoint instead
    #[arg(long, value_name = "FILE", conflicts_with_all = ["layout", "vit"])]
    weights: Option<PathBuf>,
    /// Timed runs of each row
    #[arg(long, value_name = "N", value_parser = positive, default_value_t = 3)]
    runs: usize,
}

/// Side of the matrices whose product says what the machine can do.
const SIDE: usize = 1024;
/// Near and far plane, scene units, as the network was trained with them on DL3DV.
const RANGE: (f64, f64) = (0.5, 200.0);
/// The row of a whole pass.
const WHOLE: &str = "whole pass";
/// The stage that is left out where features are not wanted.
const FEATURES: &str = "feature upsampler";

/// What rows say beyond those of other benches.
#[derive(Debug, Serialize)]
struct Details {
    flop: f64,
    flop_per_second: f64,
    /// Of the rate of the matrix product.
    share: f64,
}

/// What is timed.
enum Job {
    Product(Tensor, Tensor),
    Pass(Vec<View>),
}

#[derive(Serialize)]
struct Settings<'a> {
    network: String,
    weights: Option<&'a PathBuf>,
    views: &'a [usize],
    size: (usize, usize),
    runs: usize,
}

#[derive(Serialize)]
struct Record<'a> {
    recipe: Recipe<Settings<'a>>,
    rows: &'a [Row<Details>],
    /// Of candle's product of two 1024x1024 matrices.
    gemm_flop_per_second: f64,
}

fn layout(name: &str) -> Result<Scales, String> {
    let names = || Scales::ALL.map(Scales::name).join(", ");
    Scales::ALL.into_iter().find(|s| s.name() == name).ok_or_else(|| format!("expected one of {}", names()))
}

fn vit(name: &str) -> Result<Vit, String> {
    let names = || Vit::ALL.map(Vit::name).join(", ");
    Vit::ALL.into_iter().find(|v| v.name() == name).ok_or_else(|| format!("expected one of {}", names()))
}

/// A picture of waves, and cameras on a line.
fn view(i: usize, (width, height): (usize, usize)) -> Outcome<View> {
    let (w, h) = (width as f64, height as f64);
    let lens = Intrinsics { fx: 0.9 * w, fy: 0.9 * w, cx: w / 2.0, cy: h / 2.0, width, height };
    let position = DVec3::new(0.3 * i as f64, 0.02 * i as f64, 0.0);
    let camera = Camera::looking_at(lens, position, DVec3::new(0.5, 0.0, 5.0), DVec3::new(0.0, -1.0, 0.0));
    let value = |k: usize| {
        let (x, y, c) = ((k / 3 % width) as f64, (k / 3 / width) as f64, (k % 3) as f64);
        let wave = (0.11 * x + 0.7 * i as f64 + c).sin() + (0.07 * y + 0.003 * x * c).cos();
        (0.5 + 0.24 * wave) as f32
    };
    let image = Image::new(width, height, (0..width * height * 3).map(value).collect()).or_work()?;
    View::new(i.to_string(), image, camera.or_work()?, None).or_work()
}

pub(crate) fn run(arguments: &Arguments, common: &Common) -> Outcome {
    let &Arguments { views: ref counts, size, runs, ref weights, .. } = arguments;
    let network = match weights {
        Some(path) => DepthSplat::open(path).or_input()?,
        None => {
            DepthSplat::untrained(Variant { scales: arguments.layout, vit: arguments.vit }, "").or_work()?
        }
    };
    let pools = pools()?;
    let pool = pools.last().expect("there is at least one thread");
    let side = |seed: u64| {
        let mut random = Random(seed);
        let values: Vec<f32> = (0..SIDE * SIDE).map(|_| random.unit()).collect();
        Tensor::from_vec(values, (SIDE, SIDE), &Device::Cpu).or_work()
    };
    let mut jobs = vec![Job::Product(side(2)?, side(3)?)];
    for &count in counts {
        jobs.push(Job::Pass((0..count).map(|i| view(i, size)).collect::<Outcome<_>>()?));
    }
    let progress = Progress::new(runs * jobs.len());
    let mut run = |job: &Job| {
        timed(pool, || match job {
            Job::Product(a, b) => a.matmul(b).map(|_| Vec::new()).or_work(),
            Job::Pass(views) => {
                let (_, trace) = network.trace(views, &vec![RANGE; views.len()], false).or_input()?;
                Ok(trace.stages)
            }
        })
    };
    let measured = measure(&jobs, runs, &mut run, &mut |job| {
        if let Job::Pass(views) = job {
            progress.say(format!("{} views", views.len()));
        }
        progress.step();
    })?;
    drop(progress);

    let gemm = 2.0 * (SIDE as f64).powi(3) / measured[0].seconds.median;
    let mut rows = Vec::new();
    for (&n, found) in counts.iter().zip(&measured[1..]) {
        let label = |case: &str| Label {
            implementation: OURS,
            case: case.to_owned(),
            n,
            k: None,
            threads: pool.current_num_threads(),
        };
        let details = |flop: f64, seconds: f64| Details {
            flop,
            flop_per_second: flop / seconds,
            share: flop / seconds / gemm,
        };
        let all: u64 = found.found[0].iter().map(|stage| stage.operations).sum();
        let whole = details(all as f64, found.seconds.median);
        rows.push(Row::new("backbone", label(WHOLE), found, whole));
        for (place, StageTime { stage, operations, .. }) in found.found[0].iter().enumerate() {
            let seconds = Spread::of(found.found.iter().map(|stages| stages[place].seconds).collect());
            let details = details(*operations as f64, seconds.median);
            let measured =
                super::measure::Measured { seconds, found: Vec::<()>::new(), peak_rss_bytes: None };
            rows.push(Row::new("backbone", label(stage), &measured, details));
        }
    }
    print_line(&format!("{} at {}x{}\n", network.variant(), size.0, size.1));
    print(&table(&rows).to_text());
    print_line(&format!(
        "\nGFLOP by the definition, and their rate as a share of the {:.0} GFLOP/s of a matrix product; without `{FEATURES}` it is depth alone",
        gemm / 1e9
    ));
    let Some(path) = &common.json else { return Ok(()) };
    let settings = Settings {
        network: network.schema().to_owned(),
        weights: weights.as_ref(),
        views: counts,
        size,
        runs,
    };
    let recipe = crate::recipe(0, settings);
    output::write_json(path, &Record { recipe, rows: &rows, gemm_flop_per_second: gemm })
}

fn table(rows: &[Row<Details>]) -> Table {
    let head = ["views", "stage", "ms", "fastest", "slowest", "GFLOP", "GFLOP/s", "share", "peak MB"];
    let mut table = Table::new(&head, 2);
    for row in rows {
        let Details { flop, flop_per_second, share } = row.details;
        let mut cells = vec![row.n.to_string(), row.case.clone()];
        cells.extend(row.milliseconds());
        let counted = |text: String| if flop > 0.0 { text } else { "-".to_owned() };
        cells.push(counted(format!("{:.1}", flop / 1e9)));
        cells.push(counted(format!("{:.1}", flop_per_second / 1e9)));
        cells.push(counted(format!("{:.0} %", 100.0 * share)));
        cells.push(row.memory(1e6));
        table.push(cells);
    }
    table
}
