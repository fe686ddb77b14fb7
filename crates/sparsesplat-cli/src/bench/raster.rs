//! `bench raster`: the renderer on reconstructed scenes.

mod job;
mod rows;
mod scenes;

use super::bandwidth::Bandwidth;
use super::measure::{measure, pools};
use crate::arguments::{Common, Device, positive, size};
use crate::device::{self, UsedDevice};
use crate::failure::{OrFail, Outcome};
use crate::progress::{Progress, describe};
use crate::summary::{print, print_line};
use crate::{output, threads};
use clap::Args;
use evaluate::Recipe;
use gs_raster::{Gradients, Rasterizer, Style};
use gs_scene::{Camera, Gaussians};
use job::{Case, Job, Runner};
use rayon::ThreadPool;
use report_parts::count;
use rows::{MODEL, Row, row, table};
use scene_windows::{SimulatedScene, simulated_window};
use scenes::Count;
use serde::Serialize;

/// The renderer: frames per second against the number of Gaussians, and the price of each feature
///
/// The demo's six photographs are reconstructed with each count, in closed form, and the scene is rendered from a held-out view:
/// forward, and forward with gradients, on one thread and on all, and on the GPU if there is a real one. --device gpu measures the
/// GPU alone (with what it takes to bring scene and picture there and back), --device cpu the processor alone. Prices of features
/// are those at the largest count given as a number. Colours in closed form do not change with the direction: spherical
/// harmonics above degree 0 are filled with small numbers.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  sparsesplat bench raster\n  \
                        sparsesplat bench raster --counts 40k,150k --device cpu --json raster.json")]
pub(crate) struct Arguments {
    /// How many Gaussians: numbers such as 40k, and `pixels` for one per pixel of the six photographs
    #[arg(
        long,
        value_name = "N,M,...",
        value_parser = scenes::count,
        value_delimiter = ',',
        default_value = "10k,40k,100k,150k,pixels"
    )]
    counts: Vec<Count>,
    /// Size of photographs and pictures
    #[arg(long, value_name = "WxH", value_parser = size, default_value = "448x256")]
    size: (usize, usize),
    /// Timed runs of each row
    #[arg(long, value_name = "N", value_parser = positive, default_value_t = 9)]
    runs: usize,
}

const FORWARD: Case = Case { name: "forward", sh_degree: 2, change: |_| {}, gradients: false };

/// What is measured at every count.
const AT_EVERY_COUNT: [Case; 2] = [FORWARD, Case { name: "forward+backward", gradients: true, ..FORWARD }];

/// What is measured for its price; the first is what the others are compared with.
const FEATURES: [Case; 8] = [
    Case { name: "plain, SH degree 2", ..FORWARD },
    Case { name: "SH degree 0", sh_degree: 0, ..FORWARD },
    Case { name: "SH degree 1", sh_degree: 1, ..FORWARD },
    Case { name: "SH degree 3", sh_degree: 3, ..FORWARD },
    Case { name: "depth", change: |settings| settings.depth = true, ..FORWARD },
    Case { name: "antialias", change: |settings| settings.antialias = true, ..FORWARD },
    Case { name: "gradients", gradients: true, ..FORWARD },
    Case { name: "ellipsoids", change: |settings| settings.style = Style::Ellipsoids, ..FORWARD },
];

/// What `--json` writes.
#[derive(Serialize)]
struct Record<'a> {
    recipe: Recipe<Settings<'a>>,
    device: &'a UsedDevice,
    memory_bandwidth: &'a [Bandwidth],
    model: &'static str,
    rows: &'a [Row],
}

#[derive(Serialize)]
struct Settings<'a> {
    counts: &'a [Count],
    width: usize,
    height: usize,
    runs: usize,
}

pub(crate) fn run(arguments: &Arguments, common: &Common) -> Outcome {
    let (width, height) = arguments.size;
    let rasterizer = device::rasterizer(common.device)?;
    let device = UsedDevice::of(&rasterizer);
    let pools = pools()?;
    let mut runners = runners(&pools, common.device, rasterizer);
    let every: Vec<usize> = (0..runners.len()).collect();
    // Of the processor's runners only the one with all threads.
    let widest: Vec<usize> =
        every.iter().copied().filter(|&i| runners[i].pool.current_num_threads() == threads()).collect();
    let at_every_count = every.len() * AT_EVERY_COUNT.len() * arguments.counts.len();
    let progress = Progress::new(arguments.runs * (at_every_count + widest.len() * FEATURES.len()));

    progress.say("measuring the memory");
    let bandwidth = Bandwidth::measure(&pools);
    progress.say("ray-tracing the photographs");
    let window = simulated_window(SimulatedScene::Courtyard, arguments.size).or_input()?;
    let camera = *window.targets[window.targets.len() / 2].camera();

    let mut on_run = |job: &Job<'_>| {
        progress.say(format!("{} Gaussians, {}", count(job.scene.len() as f64), job.case.name));
        progress.step();
    };
    let (mut rows, mut prices) = (Vec::new(), Vec::new());
    for (place, &wanted) in arguments.counts.iter().enumerate() {
        let scene = scenes::reconstruct(&window, wanted, &mut |step| progress.say(describe(step)))?;
        let mut group = Group { scene: &scene, camera, runs: arguments.runs, on_run: &mut on_run };
        rows.extend(group.rows(&mut runners, &every, &AT_EVERY_COUNT, false)?);
        if place == place_of_prices(&arguments.counts) {
            prices = group.rows(&mut runners, &widest, &FEATURES, true)?;
        }
    }
    drop(progress);

    print_line(&Bandwidth::line(&bandwidth));
    print_line(&format!("picture    {width}x{height}, SH degree 2, medians of {} runs", arguments.runs));
    print_line("");
    print(&table(&rows).to_text());
    print_line("");
    print(&table(&prices).to_text());
    if let Some(path) = &common.json {
        rows.append(&mut prices);
        let settings = Settings { counts: &arguments.counts, width, height, runs: arguments.runs };
        let recipe = crate::recipe(0, settings);
        let record =
            Record { recipe, device: &device, memory_bandwidth: &bandwidth, model: MODEL, rows: &rows };
        output::write_json(path, &record)?;
    }
    Ok(())
}

/// The processor on each pool unless only the GPU is asked for, then the GPU if there is one to render on.
fn runners(pools: &[ThreadPool], device: Device, rasterizer: Rasterizer) -> Vec<Runner<'_>> {
    let mut runners = Vec::new();
    if device != Device::Gpu {
        let cpu = |pool| Runner {
            device: "cpu".to_owned(),
            rasterizer: Rasterizer::cpu(),
            pool,
            gradients: Gradients::default(),
        };
        runners.extend(pools.iter().map(cpu));
    }
    if let Some(name) = rasterizer.adapter().map(|about| about.name.clone()) {
        runners.extend(pools.last().map(|pool| Runner {
            device: name,
            rasterizer,
            pool,
            gradients: Gradients::default(),
        }));
    }
    runners
}

/// Prices are those at the largest count that is a number; without one, at the first.
fn place_of_prices(counts: &[Count]) -> usize {
    let number = |&place: &usize| match counts[place] {
        Count::Gaussians(n) => n,
        Count::Pixels => 0,
    };
    // `max_by_key` keeps the last of equals: from the back, the first.
    (0..counts.len()).rev().max_by_key(number).unwrap_or(0)
}

/// Rows that are measured together.
struct Group<'a> {
    scene: &'a Gaussians,
    camera: Camera,
    runs: usize,
    on_run: &'a mut dyn FnMut(&Job<'_>),
}

impl Group<'_> {
    /// A row for each case on each of the runners `which`; with `priced`, compared with the first case on the same runner.
    fn rows(
        &mut self,
        runners: &mut [Runner<'_>],
        which: &[usize],
        cases: &[Case],
        priced: bool,
    ) -> Outcome<Vec<Row>> {
        let needed = |degree: &usize| cases.iter().any(|case| case.sh_degree == *degree);
        let by_degree: Vec<Option<Gaussians>> = (0..=3)
            .map(|degree| needed(&degree).then(|| scenes::with_sh_degree(self.scene, degree)).transpose())
            .collect::<Outcome<_>>()?;
        let mut jobs = Vec::new();
        for &runner in which {
            for &case in cases {
                let scene = by_degree[case.sh_degree].as_ref().expect("every degree that a case has is made");
                jobs.push(Job { runner, case, scene });
            }
        }
        let mut run = |job: &Job<'_>| job.run(&mut runners[job.runner], &self.camera);
        let measured = measure(&jobs, self.runs, &mut run, self.on_run)?;
        let row = |(place, job): (usize, &Job<'_>)| {
            let first = place - place % cases.len();
            let plain = priced.then(|| measured[first].seconds.median);
            row(job, &runners[job.runner], &self.camera, &measured[place], plain)
        };
        Ok(jobs.iter().enumerate().map(row).collect())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn prices_are_those_of_the_largest_number() {
        let [few, many] = [Count::Gaussians(10), Count::Gaussians(20)];
        assert_eq!(place_of_prices(&[few, many, Count::Pixels]), 1);
        assert_eq!(place_of_prices(&[Count::Pixels, many, many, few]), 1);
        assert_eq!(place_of_prices(&[Count::Pixels, Count::Pixels]), 0);
    }
}
