//! Timed runs, taken in turns so that a machine that slows down slows all rows alike.

use crate::failure::{OrFail, Outcome};
use gs_raster::{PixelGradients, Rasterizer, RenderSettings, RenderStats};
use gs_scene::{Camera, Gaussians};
use rayon::ThreadPool;
use std::time::{Duration, Instant};

/// Cores that had nothing to do take as long to work at their full speed.
const WARM_UP: Duration = Duration::from_millis(60);

/// What runs: a rasterizer, and the threads that it may use.
pub(super) struct Runner<'a> {
    /// `cpu`, or the name of the adapter.
    pub(super) device: String,
    pub(super) rasterizer: Rasterizer,
    pub(super) pool: &'a ThreadPool,
}

/// What is asked for.
#[derive(Debug, Clone, Copy)]
pub(super) struct Case {
    pub(super) name: &'static str,
    pub(super) sh_degree: usize,
    /// What differs from the defaults.
    pub(super) change: fn(&mut RenderSettings),
    /// Whether the backward pass runs as well.
    pub(super) gradients: bool,
}

impl Case {
    pub(super) fn settings(&self) -> RenderSettings {
        let mut settings = RenderSettings::default();
        (self.change)(&mut settings);
        settings
    }
}

/// One row to be measured.
pub(super) struct Job<'a> {
    /// Which of the runners.
    pub(super) runner: usize,
    pub(super) case: Case,
    pub(super) scene: &'a Gaussians,
}

/// What a job took.
#[derive(Debug)]
pub(super) struct Measured {
    pub(super) median: f64,
    pub(super) fastest: f64,
    pub(super) slowest: f64,
    /// Median of what the GPU itself took for the forward pass, without bringing the scene there; none on the CPU.
    pub(super) gpu: Option<f64>,
    pub(super) stats: RenderStats,
    /// Most memory that the process held while the job ran first.
    pub(super) peak_rss_bytes: Option<u64>,
}

/// Measures every job `runs` times: round by round, each job in its turn, each timed run after others that are
/// not timed, so that it finds caches and cores as a series of frames would.
pub(super) fn measure(
    runners: &mut [Runner<'_>],
    jobs: &[Job<'_>],
    camera: &Camera,
    runs: usize,
    on_run: &mut dyn FnMut(&Job<'_>),
) -> Outcome<Vec<Measured>> {
    let mut seconds: Vec<Vec<f64>> = vec![Vec::with_capacity(runs); jobs.len()];
    let mut gpu_seconds = seconds.clone();
    let mut first = Vec::with_capacity(jobs.len());
    for round in 0..runs {
        for (job, (seconds, gpu_seconds)) in jobs.iter().zip(seconds.iter_mut().zip(&mut gpu_seconds)) {
            on_run(job);
            let runner = &mut runners[job.runner];
            if round == 0 {
                restart_peak();
            }
            let warm_up = Instant::now();
            let (stats, _) = run(runner, job, camera)?;
            if round == 0 {
                first.push((stats, evaluate::peak_rss_bytes()));
            }
            while warm_up.elapsed() < WARM_UP {
                run(runner, job, camera)?;
            }
            let (stats, taken) = run(runner, job, camera)?;
            seconds.push(taken);
            gpu_seconds.push(stats.seconds.gpu);
        }
    }
    let rows = first.into_iter().zip(seconds.into_iter().zip(gpu_seconds));
    let measured = rows.map(|((stats, peak_rss_bytes), (mut seconds, mut gpu_seconds))| {
        seconds.sort_by(f64::total_cmp);
        gpu_seconds.sort_by(f64::total_cmp);
        Measured {
            median: seconds[runs / 2],
            fastest: seconds[0],
            slowest: seconds[runs - 1],
            gpu: Some(gpu_seconds[runs / 2]).filter(|seconds| *seconds > 0.0),
            stats,
            peak_rss_bytes,
        }
    });
    Ok(measured.collect())
}

/// One run: what was drawn, and the seconds it took.
fn run(runner: &mut Runner<'_>, job: &Job<'_>, camera: &Camera) -> Outcome<(RenderStats, f64)> {
    let settings = job.case.settings();
    let pixels = job.case.gradients.then(|| pixel_gradients(camera));
    let Runner { rasterizer, pool, .. } = runner;
    pool.install(|| {
        let begin = Instant::now();
        let stats = match pixels {
            None => rasterizer.render(job.scene, camera, &settings).or_work()?.stats,
            Some(pixels) => {
                let cameras = std::slice::from_ref(camera);
                let (views, tape) = rasterizer.record(job.scene, cameras, &settings).or_work()?;
                rasterizer.backward(job.scene, &tape, &[pixels]).or_work()?;
                views[0].stats
            }
        };
        Ok((stats, begin.elapsed().as_secs_f64()))
    })
}

/// Some gradient by every colour; its value changes no time.
fn pixel_gradients(camera: &Camera) -> PixelGradients {
    let image = (0..camera.width() * camera.height() * 3).map(|i| ((i % 7) as f32 - 3.0) / 3.0).collect();
    PixelGradients { image, alpha: None, depth: None }
}

/// Lets the system count anew the most memory that this process holds. Where it does not know how, the count goes on from
/// the start of the process.
fn restart_peak() {
    let _ = std::fs::write("/proc/self/clear_refs", "5");
}
