//! `bench head`: the attention head.

use super::cpu::{self, Job, OURS, Row};
use super::measure::pools;
use super::random::Random;
use crate::arguments::{Common, gaussians as count_above_0};
use crate::failure::{OrFail, Outcome};
use crate::progress::Progress;
use crate::summary::{print, print_line};
use attn_head::plain::{Network, TensorInputs};
use attn_head::{Config, Inputs, Kind, LAYERS, OUTPUTS, WIDTH, Weights, fused};
use candle_core::{DType, Device, Tensor};
use clap::Args;
use report_parts::{Table, count};
use serde::Serialize;
use sparsesplat::learned::{geometry_features, image_features};

/// The attention head: time, FLOP/s and memory against the number of anchors, beside the plain form on candle
///
/// Forward is what a reconstruction needs, training the pass that is recorded and its gradient by all weights. The plain form
/// (ours-naive) is ordinary operations of candle: queries, keys and values once per anchor, the perceptron of positions for every pair.
/// A matrix product of candle's, in f32 on all threads, says what the machine can do.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  cargo xtask bench head --json head.json\n  \
                        sparsesplat bench head --counts 40k --runs 5")]
pub(crate) struct Arguments {
    /// How many anchors
    #[arg(
        long,
        value_name = "N,M,...",
        value_parser = count_above_0,
        value_delimiter = ',',
        default_value = "10k,40k",
        default_value_if("long", "true", "10k,40k,100k,150k")
    )]
    counts: Vec<usize>,
    /// How many neighbours of each
    #[arg(long, value_name = "K", default_value_t = 20)]
    neighbours: usize,
    /// Leave the plain form out above so many anchors: it takes some 40 kB for each
    #[arg(
        long,
        value_name = "N",
        value_parser = count_above_0,
        default_value = "10k",
        default_value_if("long", "true", "150k")
    )]
    plain_up_to: usize,
    /// The rows that take minutes as well: 100k and 150k anchors, and the plain form of them all
    #[arg(long)]
    long: bool,
    /// Timed runs of each row
    #[arg(long, value_name = "N", value_parser = crate::arguments::positive, default_value_t = 3)]
    runs: usize,
}

/// Side of the matrices whose product says what the machine can do.
const SIDE: usize = 1024;
/// So many of them, to last as long as a pass of the head.
const PRODUCTS: usize = 16;
const PRODUCT: &str = "16 matrix products";
/// Channels of the plane sweep's features.
const CHANNELS: usize = 32;

/// FLOP of one row.
#[derive(Debug, Serialize)]
struct Rate {
    #[serde(rename = "impl")]
    implementation: &'static str,
    case: String,
    n: usize,
    flop: f64,
    flop_per_second: f64,
    /// Of candle's product, in turns with this.
    product_flop_per_second: f64,
    share: f64,
}

#[derive(Serialize)]
struct More {
    /// Of candle's product of two 1024x1024 matrices, the best median.
    gemm_flop_per_second: f64,
    rates: Vec<Rate>,
}

#[derive(Serialize)]
struct Settings<'a> {
    counts: &'a [usize],
    neighbours: usize,
    plain_up_to: usize,
    runs: usize,
}

/// Anchors on a grid, neighbours near by as those of pixels are.
pub(super) struct Scene {
    n: usize,
    k: usize,
    geometry: Vec<f32>,
    image: Vec<f32>,
    neighbours: Vec<u32>,
    relative: Vec<[f32; 3]>,
    pub(super) by_outputs: Vec<f32>,
}

impl Scene {
    pub(super) fn new(config: &Config, n: usize) -> Self {
        const ROW: i64 = 256;
        let k = config.neighbours.min(n.saturating_sub(1));
        let mut random = Random(1);
        let mut numbers = |count: usize| (0..count).map(|_| random.unit()).collect::<Vec<f32>>();
        let (geometry, image) = (numbers(n * config.geometry), numbers(n * config.image));
        let by_outputs = numbers(n * OUTPUTS);
        let relative = numbers(n * k * 3).as_chunks().0.to_vec();
        let steps = numbers(n * k * 2);
        let neighbour = |(pair, step): (usize, &[f32; 2])| {
            let [x, y] = step.map(|s| (4.0 * s) as i64);
            ((pair / k) as i64 + x + ROW * y).rem_euclid(n as i64) as u32
        };
        let neighbours = steps.as_chunks().0.iter().enumerate().map(neighbour).collect();
        Self { n, k, geometry, image, neighbours, relative, by_outputs }
    }

    pub(super) fn inputs(&self) -> Inputs<'_> {
        Inputs {
            n: self.n,
            k: self.k,
            geometry: &self.geometry,
            image: &self.image,
            neighbours: &self.neighbours,
            relative: &self.relative,
        }
    }
}

/// FLOP of a forward pass, in the fused form: products and sums, elementary functions left out.
fn flop(config: &Config, n: usize, k: usize) -> f64 {
    let (half, pairs) = (WIDTH / 2, k + 1);
    let embedding = (config.geometry + half + config.image + half) * half;
    let dense = 4 * WIDTH * WIDTH + 2 * WIDTH * 4 * WIDTH;
    // W₂ by head, there and back; per pair its first layer, five products and five sums of rows.
    let attention = 2 * WIDTH * WIDTH + pairs * (3 + 5 + 5) * WIDTH;
    let output = WIDTH * WIDTH + WIDTH * OUTPUTS;
    2.0 * (n * (embedding + LAYERS * (dense + attention) + output)) as f64
}

pub(crate) fn run(arguments: &Arguments, common: &Common) -> Outcome {
    let &Arguments { ref counts, neighbours, plain_up_to, runs, .. } = arguments;
    let pools = pools()?;
    let pool = pools.last().expect("there is at least one thread");
    let config = Config {
        kind: Kind::Attention,
        geometry: geometry_features(true),
        image: image_features(CHANNELS),
        neighbours,
    };
    let weights = Weights::recipe(config, "bench").or_work()?;
    let device = Device::Cpu;
    let network = Network::new(config, &weights.to_tensor(DType::F32, &device).or_work()?).or_work()?;
    let progress = Progress::new(4 * runs * counts.len());

    let side = |seed: u64| {
        let mut random = Random(seed);
        let values: Vec<f32> = (0..SIDE * SIDE).map(|_| random.unit()).collect();
        Tensor::from_vec(values, (SIDE, SIDE), &device).or_work()
    };
    let (a, b) = (side(2)?, side(3)?);
    let (mut rows, mut rates, mut gemm) = (Vec::new(), Vec::new(), 0.0_f64);
    for &n in counts {
        progress.say(format!("making {} anchors", count(n as f64)));
        let scene = Scene::new(&config, n);
        let inputs = scene.inputs();
        let forward = || {
            drop(fused::forward(&config, &weights.values, &inputs));
            Ok(())
        };
        let training = || {
            let (_, tape) = fused::forward_recorded(&config, &weights.values, &inputs);
            drop(fused::backward(&config, &weights.values, &inputs, &tape, &scene.by_outputs));
            Ok(())
        };
        let plain = || {
            let tensors = TensorInputs::new(&config, &inputs, DType::F32, &Device::Cpu).or_work()?;
            network.forward(&tensors).map(drop).or_work()
        };
        let size = (n, Some(scene.k));
        // The speed of a machine changes within minutes: the product that a share is of runs in turns with what is measured.
        let product = || (0..PRODUCTS).try_for_each(|_| a.matmul(&b).map(drop)).or_work();
        let mut jobs = vec![
            Job::new("candle", PRODUCT, (SIDE, None), pool, product),
            Job::new(OURS, "forward", size, pool, forward),
            Job::new(OURS, "training", size, pool, training),
        ];
        if n <= plain_up_to {
            jobs.push(Job::new("ours-naive", "forward", size, pool, plain));
        }
        let found = cpu::rows("head", &jobs, runs, &progress)?;
        let beside = PRODUCTS as f64 * 2.0 * (SIDE as f64).powi(3) / found[0].seconds;
        rates.extend(found.iter().skip(1).map(|row| rate(row, &config, beside)));
        gemm = gemm.max(beside);
        rows.extend(found);
    }
    drop(progress);

    print(&cpu::table(&rows, "anchors").to_text());
    print_line(
        "\nGFLOP/s, and the share of those of a matrix product in the same minute; of training three times a forward pass is counted:\n",
    );
    print(&rates_table(&rates).to_text());
    let settings = Settings { counts, neighbours, plain_up_to, runs };
    cpu::write(common, settings, &rows, More { gemm_flop_per_second: gemm, rates })
}

fn rate(row: &Row, config: &Config, product: f64) -> Rate {
    let passes = if row.case == "training" { 3.0 } else { 1.0 };
    let flop = passes * flop(config, row.n, row.k.unwrap_or(0));
    let flop_per_second = flop / row.seconds;
    Rate {
        implementation: row.implementation,
        case: row.case.clone(),
        n: row.n,
        flop,
        flop_per_second,
        product_flop_per_second: product,
        share: flop_per_second / product,
    }
}

fn rates_table(rates: &[Rate]) -> Table {
    let mut table = Table::new(&["case", "impl", "anchors", "GFLOP", "GFLOP/s", "product's", "share"], 2);
    for rate in rates {
        table.push(vec![
            rate.case.clone(),
            rate.implementation.to_owned(),
            count(rate.n as f64),
            format!("{:.1}", rate.flop / 1e9),
            format!("{:.1}", rate.flop_per_second / 1e9),
            format!("{:.1}", rate.product_flop_per_second / 1e9),
            format!("{:.0} %", 100.0 * rate.share),
        ]);
    }
    table
}
