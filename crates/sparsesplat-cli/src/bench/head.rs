//! `bench head`: the heads.

use super::cpu::{self, Job, OURS, Row};
use super::measure::pools;
use super::random::Random;
use crate::arguments::{Common, gaussians as count_above_0};
use crate::failure::{OrFail, Outcome};
use crate::progress::Progress;
use crate::summary::{print, print_line};
use attn_head::plain::{Network, TensorInputs};
use attn_head::{CELL_WIDTH, Config, Inputs, Kind, MESSAGE, OUTPUTS, WIDTH, Weights, fused};
use candle_core::{DType, Device, Tensor, Var};
use clap::{Args, ValueEnum};
use report_parts::{Table, count};
use serde::Serialize;
use sparsesplat::learned::{geometry_features, image_features};

/// The heads: time, FLOP/s and memory against the number of anchors, beside the plain form on candle
///
/// Forward is what a reconstruction needs, training the pass that is recorded and its gradient by all weights. The plain form
/// (ours-naive) is ordinary operations of candle, with a row for every pair of anchor and neighbour.
/// A matrix product of candle's, in f32 on all threads, says what the machine can do.
#[derive(Debug, Args)]
#[command(arg = crate::arguments::no_device(), after_help = "Examples:\n  cargo xtask bench head --json head.json\n  \
                        sparsesplat bench head --counts 40k --runs 5\n  \
                        sparsesplat bench head --heads attention,edge-conv,max-pool,mlp,grid --counts 1k")]
pub(crate) struct Arguments {
    /// Kinds of head
    #[arg(long, value_enum, value_name = "KIND,...", value_delimiter = ',', default_value = "attention")]
    heads: Vec<Kinds>,
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
    /// Leave the training of the plain form out above so many anchors: it takes some 700 kB for each
    #[arg(long, value_name = "N", value_parser = count_above_0, default_value = "1k")]
    plain_training_up_to: usize,
    /// The rows that take minutes as well: 100k and 150k anchors, and the plain form of them all
    #[arg(long)]
    long: bool,
    /// Timed runs of each row
    #[arg(long, value_name = "N", value_parser = crate::arguments::positive, default_value_t = 3)]
    runs: usize,
}

/// [`Kind`] as an argument.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum, Serialize)]
#[serde(rename_all = "kebab-case")]
enum Kinds {
    Attention,
    EdgeConv,
    MaxPool,
    Mlp,
    Grid,
}

impl Kinds {
    fn kind(self) -> Kind {
        match self {
            Self::Attention => Kind::Attention,
            Self::EdgeConv => Kind::EdgeConv,
            Self::MaxPool => Kind::MaxPool,
            Self::Mlp => Kind::Mlp,
            Self::Grid => Kind::Grid,
        }
    }

    fn name(self) -> &'static str {
        match self {
            Self::Attention => "attention",
            Self::EdgeConv => "edge-conv",
            Self::MaxPool => "max-pool",
            Self::Mlp => "mlp",
            Self::Grid => "grid",
        }
    }
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
    heads: &'a [Kinds],
    counts: &'a [usize],
    neighbours: usize,
    plain_up_to: usize,
    plain_training_up_to: usize,
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
    cells: Vec<[u32; 2]>,
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
        // Squares of 4 and of 16 anchors a side.
        let cell =
            |i: usize, side: usize| (i - i % (ROW as usize * side) + i % ROW as usize / side * side) as u32;
        let cells = (0..n).map(|i| [cell(i, 4), cell(i, 16)]).collect();
        Self { n, k, geometry, image, neighbours, relative, cells, by_outputs }
    }

    pub(super) fn inputs(&self) -> Inputs<'_> {
        Inputs {
            n: self.n,
            k: self.k,
            geometry: &self.geometry,
            image: &self.image,
            neighbours: &self.neighbours,
            relative: &self.relative,
            cells: &self.cells,
        }
    }
}

/// FLOP of a pass in the fused form: products and sums, elementary functions left out. Training counts three times a forward pass,
/// but for the product of all pairs whose maximum is taken: its gradient is that of one row for each channel.
fn flop(config: &Config, n: usize, k: usize, training: bool) -> f64 {
    let (half, pairs, square) = (WIDTH / 2, k + 1, WIDTH * WIDTH);
    let embedding = (config.geometry + half + config.image + half) * half;
    let (message, of_maxima) = match config.kind {
        // Query, key, value and projection; W₂ by head, there and back; per pair its first layer, five products and five sums of rows.
        Kind::Attention => (6 * square + pairs * (3 + 5 + 5) * WIDTH, 0),
        Kind::EdgeConv => (2 * square + pairs * 5 * WIDTH, pairs * square),
        Kind::MaxPool => (3 * square + pairs * 4 * WIDTH, pairs * square),
        Kind::Mlp => ((WIDTH + k * 4) * MESSAGE + (WIDTH + k * MESSAGE) * WIDTH + square, 0),
        Kind::Grid => (4 * CELL_WIDTH * WIDTH, 0),
    };
    let output = square + WIDTH * OUTPUTS;
    let layers = config.kind.layers();
    let forward = embedding + output + layers * (message + 2 * config.kind.hidden() * WIDTH);
    // Two products of rows for each channel, if there are maxima.
    let of_gradient = if training && of_maxima > 0 { 2 * square } else { 0 };
    let passes = if training { 3 } else { 1 };
    2.0 * (n * (passes * forward + layers * (of_maxima + of_gradient))) as f64
}

/// The passes of one kind of head.
struct Bench {
    config: Config,
    weights: Weights,
    network: Network,
}

impl Bench {
    fn new(head: Kinds, neighbours: usize) -> Outcome<Self> {
        let config = Config {
            kind: head.kind(),
            geometry: geometry_features(true),
            image: image_features(CHANNELS),
            neighbours,
        };
        let weights = Weights::recipe(config, "bench").or_work()?;
        let values = weights.to_tensor(DType::F32, &Device::Cpu).or_work()?;
        Ok(Self { network: Network::new(config, &values).or_work()?, config, weights })
    }

    fn forward(&self, scene: &Scene) -> Outcome {
        drop(fused::forward(&self.config, &self.weights.values, &scene.inputs()));
        Ok(())
    }

    fn training(&self, scene: &Scene) -> Outcome {
        let (config, weights, inputs) = (&self.config, &self.weights.values, &scene.inputs());
        let (_, tape) = fused::forward_recorded(config, weights, inputs);
        drop(fused::backward(config, weights, inputs, &tape, &scene.by_outputs));
        Ok(())
    }

    fn plain(&self, scene: &Scene) -> Outcome {
        self.network.forward(&self.tensors(scene)?).map(drop).or_work()
    }

    fn plain_training(&self, scene: &Scene) -> Outcome {
        let values = self.weights.to_tensor(DType::F32, &Device::Cpu).or_work()?;
        let values = Var::from_tensor(&values).or_work()?;
        let out = Network::new(self.config, &values).or_work()?.forward(&self.tensors(scene)?).or_work()?;
        let by_outputs = Tensor::from_slice(&scene.by_outputs, out.shape(), &Device::Cpu).or_work()?;
        let loss = (out * by_outputs).and_then(|products| products.sum_all()).or_work()?;
        loss.backward().map(drop).or_work()
    }

    fn tensors(&self, scene: &Scene) -> Outcome<TensorInputs> {
        TensorInputs::new(&self.config, &scene.inputs(), DType::F32, &Device::Cpu).or_work()
    }
}

pub(crate) fn run(arguments: &Arguments, common: &Common) -> Outcome {
    let &Arguments { ref heads, ref counts, neighbours, plain_up_to, plain_training_up_to, runs, .. } =
        arguments;
    let pools = pools()?;
    let pool = pools.last().expect("there is at least one thread");
    let progress = Progress::new(5 * runs * heads.len() * counts.len());

    let side = |seed: u64| {
        let mut random = Random(seed);
        let values: Vec<f32> = (0..SIDE * SIDE).map(|_| random.unit()).collect();
        Tensor::from_vec(values, (SIDE, SIDE), &Device::Cpu).or_work()
    };
    let (a, b) = (side(2)?, side(3)?);
    // The speed of a machine changes within minutes: the product that a share is of runs in turns with what is measured.
    let product = || (0..PRODUCTS).try_for_each(|_| a.matmul(&b).map(drop)).or_work();
    let (mut rows, mut rates, mut gemm) = (Vec::new(), Vec::new(), 0.0_f64);
    for (head, &n) in heads.iter().flat_map(|head| counts.iter().map(move |n| (head, n))) {
        progress.say(format!("making {} anchors", count(n as f64)));
        // The MLP takes no other number of neighbours than it is made for.
        let bench = &Bench::new(*head, neighbours.min(n - 1))?;
        let scene = &Scene::new(&bench.config, n);
        let (forward, training) = (format!("forward, {}", head.name()), format!("training, {}", head.name()));
        let size = (n, Some(scene.k));
        let mut jobs = vec![
            Job::new("candle", PRODUCT, (SIDE, None), pool, product),
            Job::new(OURS, &*forward, size, pool, || bench.forward(scene)),
            Job::new(OURS, &*training, size, pool, || bench.training(scene)),
        ];
        if n <= plain_up_to {
            jobs.push(Job::new("ours-naive", forward, size, pool, || bench.plain(scene)));
        }
        if n <= plain_training_up_to {
            jobs.push(Job::new("ours-naive", training, size, pool, || bench.plain_training(scene)));
        }
        let found = cpu::rows("head", &jobs, runs, &progress)?;
        let beside = PRODUCTS as f64 * 2.0 * (SIDE as f64).powi(3) / found[0].seconds;
        rates.extend(found.iter().skip(1).map(|row| rate(row, &bench.config, beside)));
        gemm = gemm.max(beside);
        rows.extend(found);
    }
    drop(progress);

    print(&cpu::table(&rows, "anchors").to_text());
    print_line(
        "\nGFLOP/s, and the share of those of a matrix product in the same minute. Training counts three times a forward pass, \
         but once the products of pairs whose maximum is taken:\n",
    );
    print(&rates_table(&rates).to_text());
    let settings = Settings { heads, counts, neighbours, plain_up_to, plain_training_up_to, runs };
    cpu::write(common, settings, &rows, More { gemm_flop_per_second: gemm, rates })
}

fn rate(row: &Row, config: &Config, product: f64) -> Rate {
    let flop = flop(config, row.n, row.k.unwrap_or(0), row.case.starts_with("training"));
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
