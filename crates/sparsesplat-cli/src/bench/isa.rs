//! `bench isa`: vector code under every instruction set of the machine.

use super::head::Scene;
use super::random::Random;
use crate::arguments::{Common, positive};
use crate::failure::{Failure, OrFail, Outcome};
use crate::output;
use crate::progress::Progress;
use crate::summary::{print, print_line};
use attn_head::{Config, Kind, Weights, fused};
use candle_core::{Device, Tensor};
use clap::Args;
use cpu_isa::{Isa, VARIABLE};
use cpu_kernels::{Activation, LayerNorm, Packed, Rows, multiply, multiply_transposed, rows};
use depth_backbone::{DepthBackbone, DepthRange, DepthSplat, PlaneSweep, Scales, Variant, Vit, Wanted};
use entropy_sampler::{EntropyWindow, entropy};
use evaluate::Recipe;
use glam::DVec3;
use gs_raster::{PixelGradients, Rasterizer, RenderSettings};
use gs_scene::{Camera, Gaussians, Intrinsics, View};
use report_parts::Table;
use scene_windows::{SimulatedScene, simulated_window};
use serde::Serialize;
use sparsesplat::learned::{geometry_features, image_features};
use std::collections::BTreeMap;
use std::process::Command;
use std::time::{Duration, Instant};

/// Vector code under every instruction set of this machine, on one thread; fails where one is slower than it should be
///
/// Each set runs in processes of its own, in turns, and of each row the fastest run counts. Three rules are checked: a vector path is at
/// least 1.5 times as fast as its scalar twin; the matrix product runs at half the rate of the crate gemm or more; AVX-512 takes
/// no longer than AVX2 (half as long again is allowed, for noise). Where a rule is broken, rounds are added before it counts.
#[derive(Debug, Args)]
#[command(
    arg = crate::arguments::no_device(),
    after_help = "Examples:\n  sparsesplat bench isa\n  sparsesplat bench isa --rounds 5 --json isa.json"
)]
pub(crate) struct Arguments {
    /// Times that each set has its turn
    #[arg(long, value_name = "N", value_parser = positive, default_value_t = 2)]
    rounds: usize,
    /// Measure the set in use, and print seconds by path
    #[arg(long, hide = true)]
    child: bool,
}

/// A vector path is to be so many times as fast as its scalar twin.
const LEAST_SPEEDUP: f64 = 1.5;
/// Our product is to have so much of the rate of the crate gemm.
const LEAST_OF_GEMM: f64 = 0.5;
/// AVX-512 may take so many times as long as AVX2: paths that are the same code under both differ by up to 1.3 on a busy machine, a cliff
/// is more than 2.
const SLACK: f64 = 1.5;
/// Rounds that are added at most where a rule is broken.
const MORE_ROUNDS: usize = 6;
/// Timed runs of each path and round; fewer of calls that take long.
const RUNS: usize = 5;
const RUNS_OF_LONG: usize = 2;
/// A call that takes longer than this is long.
const LONG: Duration = Duration::from_millis(50);
/// A timed run takes at least so long, of as many calls as that needs.
const LEAST_TIME: Duration = Duration::from_millis(4);
/// Rows of the product that is held against gemm's, and its other sides.
const PRODUCT: [usize; 3] = [384, 384, 512];

/// The paths that rules speak of by name.
const OURS: &str = "product 384x384x512";
const GEMM: &str = "crate gemm, 384x384x512";

/// Least seconds of a call, by path.
type Seconds = BTreeMap<String, f64>;

pub(crate) fn run(arguments: &Arguments, common: &Common) -> Outcome {
    if arguments.child {
        // On the one thread of the pool: from another, each parallel loop would be handed over, which takes as long as some of these paths.
        let seconds = rayon::scope(|_| measure())?;
        print_line(&serde_json::to_string(&seconds).or_work()?);
        return Ok(());
    }
    let sets = Isa::available();
    let mut found: Vec<Seconds> = vec![Seconds::new(); sets.len()];
    let progress = Progress::new(arguments.rounds * sets.len());
    let mut problems = Vec::new();
    for round in 0..arguments.rounds + MORE_ROUNDS {
        for (isa, found) in sets.iter().zip(&mut found) {
            progress.say(format!("{isa}, round {}", round + 1));
            for (path, seconds) in child(*isa)? {
                let least = found.entry(path).or_insert(seconds);
                *least = least.min(seconds);
            }
            progress.step();
        }
        problems = broken(&sets, &found);
        if round + 1 >= arguments.rounds && problems.is_empty() {
            break;
        }
    }
    drop(progress);
    print(&table(&sets, &found).to_text());
    print_line("\nms of the fastest call on one thread, and how many times faster than scalar");
    if let Some(path) = &common.json {
        let sets = sets.iter().zip(&found).map(|(isa, seconds)| (isa.name(), seconds)).collect();
        let recipe = crate::recipe(0, arguments.rounds);
        output::write_json(path, &Record { recipe, seconds: sets, broken: &problems })?;
    }
    if problems.is_empty() { Ok(()) } else { Err(Failure::work(problems.join("\n  "))) }
}

/// What `--json` writes.
#[derive(Serialize)]
struct Record<'a> {
    recipe: Recipe<usize>,
    /// By instruction set and path.
    seconds: BTreeMap<&'static str, &'a Seconds>,
    /// Rules that do not hold.
    broken: &'a [String],
}

/// Measures an instruction set in a process of its own.
fn child(isa: Isa) -> Outcome<Seconds> {
    let mut command = Command::new(std::env::current_exe().or_work()?);
    command.args(["--threads", "1", "bench", "isa", "--child"]);
    // Candle's products take their threads from here.
    command.env(VARIABLE, isa.name()).env("RAYON_NUM_THREADS", "1");
    let output = command.output().or_work()?;
    if !output.status.success() {
        let said = String::from_utf8_lossy(&output.stderr);
        return Err(Failure::work(format!("measuring {isa}: {}", said.trim())));
    }
    serde_json::from_slice(&output.stdout).or_work()
}

/// Rules that do not hold.
fn broken(sets: &[Isa], found: &[Seconds]) -> Vec<String> {
    let mut problems = Vec::new();
    let timing = |set: Isa| sets.iter().position(|&isa| isa == set).map(|place| &found[place]);
    for (isa, seconds) in sets.iter().zip(found).filter(|(isa, _)| **isa > Isa::Scalar) {
        for (path, taken) in seconds.iter().filter(|(path, _)| *path != GEMM) {
            let times = timing(Isa::Scalar).map_or(f64::INFINITY, |scalar| scalar[path] / taken);
            if times < LEAST_SPEEDUP {
                problems.push(format!(
                    "{path}: {isa} is {times:.2} times as fast as scalar, {LEAST_SPEEDUP} expected"
                ));
            }
        }
        let share = seconds[GEMM] / seconds[OURS];
        if share < LEAST_OF_GEMM {
            problems.push(format!(
                "{OURS}: {isa} has {share:.2} of the rate of {GEMM}, {LEAST_OF_GEMM} expected"
            ));
        }
    }
    if let (Some(narrow), Some(wide)) = (timing(Isa::Avx2), timing(Isa::Avx512)) {
        for (path, taken) in wide.iter().filter(|(path, _)| *path != GEMM) {
            let times = taken / narrow[path];
            if times > SLACK {
                problems.push(format!("{path}: avx512 takes {times:.2} times as long as avx2"));
            }
        }
    }
    problems
}

fn table(sets: &[Isa], found: &[Seconds]) -> Table {
    let mut head = vec!["path"];
    for isa in sets {
        head.push(isa.name());
        if *isa > Isa::Scalar {
            head.push("times");
        }
    }
    let mut table = Table::new(&head, 1);
    for path in found[0].keys() {
        let mut cells = vec![path.clone()];
        for (isa, seconds) in sets.iter().zip(found) {
            cells.push(format!("{:.3}", seconds[path] * 1e3));
            if *isa > Isa::Scalar {
                cells.push(format!("{:.2}", found[0][path] / seconds[path]));
            }
        }
        table.push(cells);
    }
    table
}

/// Seconds of every path on the set in use.
fn measure() -> Outcome<Seconds> {
    let mut seconds = Seconds::new();
    kernels(&mut seconds)?;
    networks(&mut seconds)?;
    pictures(&mut seconds)?;
    projection(&mut seconds)?;
    Ok(seconds)
}

/// Adds the least seconds of a call.
fn time(seconds: &mut Seconds, path: &str, mut work: impl FnMut() -> Outcome) -> Outcome {
    let begin = Instant::now();
    work()?;
    let once = begin.elapsed();
    let calls = (LEAST_TIME.as_secs_f64() / once.as_secs_f64().max(1e-9)).ceil().clamp(1.0, 1e5);
    let mut least = f64::INFINITY;
    for _ in 0..if once > LONG { RUNS_OF_LONG } else { RUNS } {
        let begin = Instant::now();
        for _ in 0..calls as usize {
            work()?;
        }
        least = least.min(begin.elapsed().as_secs_f64() / calls);
    }
    seconds.insert(path.to_owned(), least);
    Ok(())
}

/// Products and functions of rows.
fn kernels(seconds: &mut Seconds) -> Outcome {
    let isa = Isa::in_use();
    let mut random = Random(7);
    let mut numbers = |count: usize| (0..count).map(|_| random.unit()).collect::<Vec<f32>>();
    let [count, depth, columns] = PRODUCT;
    let (a, b) = (numbers(count * depth), numbers(depth * columns));
    let mut c = vec![0.0; count * columns];
    let packed = Packed::rows(isa, Rows::new(&b, depth, columns));
    time(seconds, OURS, || {
        multiply(Rows::new(&a, count, depth), &packed, &mut c, columns, false);
        Ok(())
    })?;
    let tensor = |values: &[f32], shape| Tensor::from_slice(values, shape, &Device::Cpu).or_work();
    let (ta, tb) = (tensor(&a, (count, depth))?, tensor(&b, (depth, columns))?);
    time(seconds, GEMM, || ta.matmul(&tb).map(drop).or_work())?;
    let mut sums = vec![0.0; 128 * 512];
    time(seconds, "product of columns 128x48x512", || {
        let (a, b) = (Rows::new(&a[..48 * 128], 48, 128), Rows::new(&b[..48 * 512], 48, 512));
        multiply_transposed(isa, a, b, &mut sums, 512);
        Ok(())
    })?;
    let mut values = numbers(1 << 14);
    time(seconds, "GELU", || {
        Activation::Gelu.apply(isa, &mut values);
        Ok(())
    })?;
    let x = numbers(128 * 128);
    time(seconds, "exponentials of a row", || {
        values[..1024].copy_from_slice(&x[..1024]);
        rows::exponentials(isa, &mut values[..1024], 1.0, None);
        Ok(())
    })?;
    let norm = LayerNorm { weight: &x[..128], bias: &x[128..256], epsilon: 1e-5 };
    time(seconds, "layer norm", || {
        norm.apply(isa, &x, &mut values);
        Ok(())
    })
}

/// The heads (max pooling has the kernels of edge convolution, the MLP has none of its own), and DepthSplat's network.
fn networks(seconds: &mut Seconds) -> Outcome {
    head(seconds, Kind::Attention, ["head, forward", "head, gradient"])?;
    head(seconds, Kind::Grid, ["grid head, forward", "grid head, gradient"])?;
    head(seconds, Kind::EdgeConv, ["edge convolution, forward", "edge convolution, gradient"])?;
    let variant = Variant { scales: Scales::ALL[0], vit: Vit::ALL[0] };
    let network = DepthSplat::untrained(variant, "").or_work()?;
    let views = views((112, 64), 2)?;
    time(seconds, "DepthSplat's network", || {
        network.trace(&views, &[(0.5, 200.0); 2], false).map(drop).or_work()
    })
}

fn head(seconds: &mut Seconds, kind: Kind, [forward, gradient]: [&'static str; 2]) -> Outcome {
    let config =
        Config { kind, geometry: geometry_features(true), image: image_features(32), neighbours: 20 };
    let weights = Weights::recipe(config, "bench").or_work()?;
    let scene = Scene::new(&config, 960);
    let inputs = scene.inputs();
    time(seconds, forward, || {
        drop(fused::forward(&config, &weights.values, &inputs));
        Ok(())
    })?;
    let (_, tape) = fused::forward_recorded(&config, &weights.values, &inputs);
    time(seconds, gradient, || {
        drop(fused::backward(&config, &weights.values, &inputs, &tape, &scene.by_outputs));
        Ok(())
    })
}

/// The first context views of a simulated scene.
fn views(size: (usize, usize), count: usize) -> Outcome<Vec<View>> {
    let mut views = simulated_window(SimulatedScene::Courtyard, size).or_work()?.context;
    views.truncate(count);
    Ok(views)
}

/// What works on pictures and points.
fn pictures(seconds: &mut Seconds) -> Outcome {
    let views = views((128, 80), 3)?;
    let grey: Vec<u8> = views[0].image().luma8();
    time(seconds, "entropy", || entropy(&grey, 128, 80, EntropyWindow::default()).map(drop).or_work())?;
    time(seconds, "SSIM", || image_metrics::ssim(views[0].image(), views[1].image()).map(drop).or_work())?;
    let stereo = PlaneSweep { range: DepthRange::Known { near: 2.0, far: 12.0 }, ..PlaneSweep::default() };
    time(seconds, "plane-sweep stereo", || {
        stereo.estimate(&views, Wanted::DepthAndFeatures).map(drop).or_work()
    })?;
    let mut random = Random(3);
    let points: Vec<[f32; 3]> = (0..4000).map(|_| std::array::from_fn(|_| random.unit())).collect();
    time(seconds, "nearest neighbours", || knn::knn(&points, 20).map(drop).or_work())?;

    let (width, height) = (192, 128);
    let lens = Intrinsics { fx: 150.0, fy: 150.0, cx: 96.0, cy: 64.0, width, height };
    let camera = Camera::looking_at(lens, DVec3::new(0.0, 0.0, -3.0), DVec3::ZERO, DVec3::NEG_Y).or_work()?;
    let mut scene = Gaussians::empty(2).or_work()?;
    for point in &points {
        let sh: Vec<f32> = (0..27).map(|_| 0.3 * random.unit()).collect();
        scene.push(*point, [1.0, 0.1, 0.2, 0.3], [-3.2, -3.0, -3.4], 0.5, &sh);
    }
    let (mut rasterizer, settings) = (Rasterizer::cpu(), RenderSettings::default());
    let cameras = [camera];
    time(seconds, "rendering", || rasterizer.render(&scene, &camera, &settings).map(drop).or_work())?;
    let (renderings, tape) = rasterizer.record(&scene, &cameras, &settings).or_work()?;
    let image = renderings[0].image.data().to_vec();
    let pixels = [PixelGradients { image: image.into(), alpha: None, depth: None }];
    time(seconds, "rendering, gradient", || rasterizer.backward(&scene, &tape, &pixels).map(drop).or_work())
}

/// The projection of Gaussians, in scenes of which hardly anything is blended.
fn projection(seconds: &mut Seconds) -> Outcome {
    let lens = Intrinsics { fx: 100.0, fy: 100.0, cx: 32.0, cy: 32.0, width: 64, height: 64 };
    let camera = Camera::looking_at(lens, DVec3::ZERO, DVec3::Z, DVec3::NEG_Y).or_work()?;
    let mut random = Random(4);
    let (mut beside, mut behind) = (Gaussians::empty(2).or_work()?, Gaussians::empty(2).or_work()?);
    // A wall so opaque that blending ends within it. What is behind it is projected back, with gradients of 0.
    for _ in 0..3 {
        behind.push([0.0, 0.0, 1.0], [1.0, 0.0, 0.0, 0.0], [1.0; 3], 9.0, &[0.0; 27]);
    }
    for _ in 0..4000 {
        let sh: [f32; 27] = std::array::from_fn(|_| 0.5 * random.unit());
        let rotation = [1.0, 0.01 * random.unit(), 0.01, 0.01 * random.unit()];
        // Upright needles left of the image. The balls around them reach into it, so their shapes and colours are computed; the needles
        // themselves do not, so nothing follows.
        let mean = [-0.9 + 0.1 * random.unit(), 0.3 * random.unit(), 2.0];
        beside.push(mean, rotation, [-5.0, -1.5, -5.0], 3.0, &sh);
        let mean = [0.6 * random.unit(), 0.6 * random.unit(), 2.5 + 0.5 * random.unit()];
        behind.push(mean, rotation, [-5.0, -4.5, -5.2], 0.5, &sh);
    }
    let (mut rasterizer, settings) = (Rasterizer::cpu(), RenderSettings::default());
    time(seconds, "projection", || rasterizer.render(&beside, &camera, &settings).map(drop).or_work())?;
    let (renderings, tape) = rasterizer.record(&behind, &[camera], &settings).or_work()?;
    let image = renderings[0].image.data().to_vec();
    let pixels = [PixelGradients { image: image.into(), alpha: None, depth: None }];
    time(seconds, "projection, gradient", || rasterizer.backward(&behind, &tape, &pixels).map(drop).or_work())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(product: f64, gelu: f64) -> Seconds {
        Seconds::from([(OURS.to_owned(), product), (GEMM.to_owned(), 1.0), ("GELU".to_owned(), gelu)])
    }

    #[test]
    fn a_cliff_is_named() {
        let sets = [Isa::Scalar, Isa::Avx2, Isa::Avx512];
        assert_eq!(broken(&sets, &[of(8.0, 8.0), of(1.1, 1.0), of(0.9, 1.0)]), [""; 0]);
        // What today's rule is for: AVX-512 that gathers and scatters.
        let problems = broken(&sets, &[of(8.0, 8.0), of(1.1, 1.0), of(20.0, 1.0)]);
        assert_eq!(problems.len(), 3, "{problems:?}");
        assert!(problems[0].contains("avx512 is 0.40 times as fast as scalar"), "{problems:?}");
        assert!(problems[1].contains("0.05 of the rate of crate gemm"), "{problems:?}");
        assert!(problems[2].contains("avx512 takes 18.18 times as long as avx2"), "{problems:?}");
        assert_eq!(broken(&sets[..2], &[of(8.0, 1.4), of(1.1, 1.0)]).len(), 1);
    }
}
