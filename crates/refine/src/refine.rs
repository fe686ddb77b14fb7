//! The loop of gradient steps.

use crate::adam::{Means, Moments, update};
use crate::between;
use crate::damping::Floors;
use crate::exposure::Exposures;
use crate::half::{half_size, low_pass};
use crate::limits::{Limits, row_rates};
use crate::objective::{Objective, Seen};
use crate::poses::Poses;
use crate::schedule::{Halves, Turns, decay, rise};
use crate::{Config, Error, Exposure, Report, Result, Step, StepRecord, Stopped};
use cpu_kernels::Isa;
use gs_raster::{Gradients, Rasterizer, RenderSettings};
use gs_scene::{Camera, Gaussians, View, sh_coefficients, sigmoid};
use rayon::prelude::*;
use std::cell::OnceCell;
use std::time::{Duration, Instant};

/// Gaussians per parallel task of an update.
const ROWS: usize = 512;
/// A derivative beyond this, far above any that a loss of pictures has, would overflow when it is squared.
const LARGEST_GRADIENT: f32 = 1e15;
/// PSNR that counts as perfect, dB.
const BEST_PSNR: f64 = 100.0;
/// Rounds over all views whose mean must be better than that of as many rounds before.
const PATIENCE: usize = 20;

/// Better Gaussians.
#[derive(Debug, Clone)]
pub struct Refined {
    /// The scene, in the order of the input without [`Report::pruned`].
    pub gaussians: Gaussians,
    /// The camera of each view: as it was given, unless [`Rates::pose`](crate::Rates::pose) is above 0.
    pub cameras: Vec<Camera>,
    /// What happened.
    pub report: Report,
}

/// Moves Gaussians so that they look like the photographs `views`, in a few steps of Adam on the derivatives
/// of the rendering.
///
/// `on_step` is called after each step, outside the time that is measured. The number of Gaussians never
/// rises. The same input and seed give the same bytes on any number of threads, except with
/// [`Stop::Seconds`](crate::Stop::Seconds). Gaussians that no rendering can show (values that are not finite)
/// stay as they are until they are pruned.
///
/// # Errors
/// If there are no views, a setting is out of its range, a view is too small for the structural term, or the
/// scene cannot be rendered or differentiated.
pub fn refine(
    gaussians: Gaussians,
    views: &[View],
    config: &Config,
    rasterizer: &mut Rasterizer,
    on_step: &mut dyn FnMut(Step<'_>),
) -> Result<Refined> {
    config.check()?;
    if views.is_empty() {
        return Err(Error::NoViews);
    }
    let begin = Instant::now();
    let half = if config.coarse > 0.0 { half_size(views) } else { None };
    // Where cameras move, the scene at the start was made for other ones.
    let with_between = config.between && config.rates.pose == 0.0 && config.stop.may_be_long();
    let in_between = if with_between { between::cameras(views) } else { Vec::new() };
    let at_start = (!in_between.is_empty()).then(|| gaussians.clone());
    let between = OnceCell::new();
    let mut work = Work::new(gaussians, views, half.as_deref(), config, rasterizer)?;
    work.spent = begin.elapsed();
    let mut turns = Turns::new(views.len(), config.seed);
    let mut report = Report { psnr_start: work.context_psnr(), ..Report::default() };
    let mut rounds = Rounds::of(views.len());
    let mut halves = Halves::new(config.stop, at_start.is_some());
    while report.stopped.is_none() {
        let begin = Instant::now();
        let progress = config.stop.progress(report.steps.len(), work.spent);
        if progress >= 1.0 {
            report.stopped = Some(Stopped::Done);
            break;
        }
        if progress >= f64::from(config.coarse) && work.leave_half_size() {
            rounds = Rounds::of(views.len());
        }
        if let Some(at_start) = &at_start
            && work.at_full_size()
            && halves.begin_second(report.steps.len(), progress)
        {
            let pictures = between::views(&in_between, [at_start, &work.gaussians], rasterizer)?;
            let between = between.get_or_init(|| pictures);
            let all: Vec<&View> = views.iter().chain(between).collect();
            turns = Turns::new(all.len(), config.seed);
            rounds = Rounds::of(all.len());
            work.begin_anew(all);
            report.between_from = Some(report.steps.len() + 1);
        }
        let at_once = config.views_per_step.min(views.len());
        let chosen: Vec<usize> = (0..at_once).map(|_| turns.next()).collect();
        let (step, way) = halves.within(report.steps.len(), progress);
        let size = halves.size() * rise(step + 1, config.warm_up) * decay(way, config.last_rate);
        let loss = work.step(&chosen, size, rasterizer)?;
        report.undone += usize::from(loss.is_none());
        work.spent += begin.elapsed();
        let over = rounds.are_over(chosen.len(), work.context_psnr(), config.smallest_gain);
        if over && work.at_full_size() && config.stop.progress(report.steps.len() + 1, work.spent) < 1.0 {
            report.stopped =
                (!halves.end_first(report.steps.len(), progress)).then_some(Stopped::NothingGained);
        }
        let record = StepRecord {
            step: report.steps.len() + 1,
            seconds: work.spent.as_secs_f64(),
            loss,
            half_size: !work.at_full_size(),
            psnr_context: work.context_psnr(),
        };
        report.steps.push(record);
        on_step(Step { record: &record, progress, gaussians: &work.gaussians, rasterizer });
    }
    let begin = Instant::now();
    let gaussians = match config.prune {
        true => {
            let (visible, pruned) = prune(work.gaussians);
            report.pruned = pruned;
            visible
        }
        false => work.gaussians,
    };
    report.seconds = (work.spent + begin.elapsed()).as_secs_f64();
    if work.exposures.fitted {
        report.exposure = work.exposures.all();
    }
    report.poses = work.poses.all();
    let cameras =
        views.iter().enumerate().map(|(view, given)| work.poses.moved(view, given.camera())).collect();
    Ok(Refined { gaussians, cameras, report })
}

/// The rounds over all views so far.
#[derive(Debug)]
struct Rounds {
    /// Views in a round.
    all: usize,
    /// Views compared in the round that is going on.
    compared: usize,
    /// PSNR at the end of each, dB.
    psnr: Vec<f64>,
}

impl Rounds {
    /// Rounds over so many views.
    fn of(all: usize) -> Self {
        Self { all, compared: 0, psnr: Vec::new() }
    }

    /// Some views were compared; whether there is nothing left to gain. A single round says little: steps are noisy.
    fn are_over(&mut self, compared: usize, psnr: f64, smallest_gain: f64) -> bool {
        self.compared += compared;
        if self.compared < self.all {
            return false;
        }
        self.compared %= self.all;
        self.psnr.push(psnr);
        let Some(before) = self.psnr.len().checked_sub(2 * PATIENCE) else { return false };
        let mean = |values: &[f64]| values.iter().sum::<f64>() / values.len() as f64;
        let (earlier, latest) = self.psnr[before..].split_at(PATIENCE);
        // Written so that NaN, and pictures that cannot get better, are no gain.
        let gains = mean(latest) > mean(earlier) + smallest_gain;
        smallest_gain > 0.0 && !gains
    }
}

struct Work<'a> {
    config: &'a Config,
    gaussians: Gaussians,
    objective: Objective<'a>,
    /// The same with views of half the size, as long as these are compared.
    coarse: Option<Objective<'a>>,
    exposures: Exposures,
    poses: Poses,
    limits: Vec<Limits>,
    geometry_moments: Moments,
    sh_moments: Moments,
    /// Memory for a step's derivatives.
    gradients: Gradients,
    /// Newest PSNR of every photograph; none yet at this size.
    psnr: Vec<Option<f64>>,
    /// Updates done.
    updates: usize,
    spent: Duration,
}

impl<'a> Work<'a> {
    fn new(
        gaussians: Gaussians,
        views: &'a [View],
        half: Option<&'a [View]>,
        config: &'a Config,
        rasterizer: &mut Rasterizer,
    ) -> Result<Self> {
        let gaussians = gaussians.with_sh_degree(config.sh_degree).expect("degree checked");
        let whole = RenderSettings::default().eps2d;
        let objective = Objective::new(&gaussians, views.iter().collect(), config, whole);
        let coarse = half.map(|half| Objective::new(&gaussians, half.iter().collect(), config, low_pass()));
        let mut at_start = vec![Exposure::NONE; views.len()];
        let mut psnr = vec![None; views.len()];
        if config.exposure || config.measure_start {
            for (view, (at_start, psnr)) in at_start.iter_mut().zip(&mut psnr).enumerate() {
                let (exposure, found) = objective.look(&gaussians, view, rasterizer)?;
                *psnr = Some(found);
                if config.exposure {
                    *at_start = exposure;
                }
            }
        }
        Ok(Self {
            config,
            objective,
            coarse,
            exposures: Exposures::new(at_start),
            poses: Poses::new(&gaussians, views, config.rates.pose),
            limits: Limits::of_scene(&gaussians, views, config.largest),
            geometry_moments: Moments::new(gaussians.geometry().len()),
            sh_moments: Moments::new(gaussians.sh().len()),
            gaussians,
            gradients: Gradients::default(),
            psnr,
            updates: 0,
            spent: Duration::ZERO,
        })
    }

    fn at_full_size(&self) -> bool {
        self.coarse.is_none()
    }

    /// From now on views are compared as they are; whether they were not so far. Their PSNR at half size says
    /// nothing of it.
    fn leave_half_size(&mut self) -> bool {
        let left = self.coarse.take().is_some();
        if left {
            self.psnr.fill(None);
        }
        left
    }

    /// From now on these views are compared, of which the first are those so far. Nothing is known of the derivatives of the others, so the
    /// optimiser begins anew.
    fn begin_anew(&mut self, views: Vec<&'a View>) {
        self.objective = Objective::new(&self.gaussians, views, self.config, self.objective.low_pass());
        self.geometry_moments = Moments::new(self.gaussians.geometry().len());
        self.sh_moments = Moments::new(self.gaussians.sh().len());
        self.updates = 0;
    }

    /// Mean over the photographs of the newest PSNR of each at this size. One that cannot be better, or cannot be
    /// compared, must not hide the others.
    fn context_psnr(&self) -> f64 {
        let known = self.psnr.iter().flatten().filter(|psnr| !psnr.is_nan());
        let (sum, n) = known.fold((0.0, 0.0), |(sum, n), psnr| (sum + psnr.min(BEST_PSNR), n + 1.0));
        sum / n
    }

    /// One step on some views: the mean of their losses, or `None` if a loss or a derivative was not finite;
    /// all is then as it was.
    fn step(&mut self, chosen: &[usize], factor: f32, rasterizer: &mut Rasterizer) -> Result<Option<f64>> {
        let objective = self.coarse.as_mut().unwrap_or(&mut self.objective);
        let seen = |&view: &usize| {
            let camera = self.poses.moved(view, objective.camera(view));
            Seen { view, camera, exposure: self.exposures.of(view) }
        };
        let seen: Vec<Seen> = chosen.iter().map(seen).collect();
        let into = (rasterizer, &mut self.gradients);
        let Some(compared) = objective.differentiate(&self.gaussians, &seen, into)? else { return Ok(None) };
        if !(is_sound(&self.gradients.geometry) && is_sound(&self.gradients.sh)) {
            return Ok(None);
        }
        for (seen, compared) in seen.iter().zip(&compared) {
            // Views between the photographs have neither a PSNR that counts nor an exposure.
            if let Some(psnr) = self.psnr.get_mut(seen.view) {
                *psnr = Some(compared.psnr);
                self.exposures.draw(seen.view, compared.fit);
            }
        }
        self.updates += 1;
        let gradients = std::mem::take(&mut self.gradients);
        self.update(&gradients, factor);
        let by_cameras = seen.iter().zip(&gradients.cameras);
        let by_cameras: Vec<_> =
            by_cameras.map(|(seen, gradient)| (seen.view, seen.camera, *gradient)).collect();
        self.poses.update(&by_cameras, factor);
        self.gradients = gradients;
        let losses: f64 = compared.iter().map(|compared| compared.loss).sum();
        Ok(Some(losses / compared.len() as f64))
    }

    fn update(&mut self, gradients: &Gradients, factor: f32) {
        const WIDTH: usize = Gaussians::GEOMETRY;
        let isa = Isa::in_use();
        let rates = &self.config.rates;
        let means = Means::of_step(self.updates, self.config.momentum);
        let moments = (&self.geometry_moments, &self.sh_moments);
        // Running means say more with every step.
        let damping = self.config.damping / self.updates as f32;
        let floors = Floors::new(damping, gradients, moments, &self.limits, means);
        let per_gaussian = sh_coefficients(self.gaussians.sh_degree()) * 3;
        let (geometry, sh) = self.gaussians.buffers_mut();

        let of_geometry = geometry
            .par_chunks_mut(ROWS * WIDTH)
            .zip(gradients.geometry.par_chunks(ROWS * WIDTH))
            .zip(self.geometry_moments.first.par_chunks_mut(ROWS * WIDTH))
            .zip(self.geometry_moments.second.par_chunks_mut(ROWS * WIDTH))
            .zip(self.limits.par_chunks(ROWS));
        of_geometry.for_each(|((((values, gradients), first), second), limits)| {
            let (mut steps, mut least) = (vec![0f32; values.len()], vec![0f32; values.len()]);
            let rows = steps.chunks_exact_mut(WIDTH).zip(least.chunks_exact_mut(WIDTH));
            for ((step, least), limits) in rows.zip(limits) {
                row_rates(rates, factor, limits.footprint, step);
                floors.fill(limits.footprint, least);
            }
            update(isa, values, gradients, (first, second), (&steps, &least), means);
            let moved = values.chunks_exact_mut(WIDTH).zip(second.chunks_exact(WIDTH)).zip(limits);
            for ((row, second), limits) in moved {
                if second.iter().any(|s| *s > 0.0) {
                    limits.apply(row);
                }
            }
        });

        let mut steps = vec![factor * rates.sh; ROWS * per_gaussian];
        for of_gaussian in steps.chunks_exact_mut(per_gaussian) {
            of_gaussian[..3].fill(factor * rates.colour);
        }
        let least = vec![floors.colour; ROWS * per_gaussian];
        let of_sh = sh
            .par_chunks_mut(ROWS * per_gaussian)
            .zip(gradients.sh.par_chunks(ROWS * per_gaussian))
            .zip(self.sh_moments.first.par_chunks_mut(ROWS * per_gaussian))
            .zip(self.sh_moments.second.par_chunks_mut(ROWS * per_gaussian));
        of_sh.for_each(|(((values, gradients), first), second)| {
            update(isa, values, gradients, (first, second), (&steps, &least), means);
        });
    }
}

/// Whether Adam can take these derivatives; NaN fails the comparison.
fn is_sound(gradients: &[f32]) -> bool {
    gradients.par_chunks(1 << 14).all(|chunk| chunk.iter().all(|g| g.abs() <= LARGEST_GRADIENT))
}

/// The scene without what cannot be seen in any view: too transparent to be drawn, or not finite; and which of its Gaussians these were, ascending.
#[must_use]
pub fn prune(mut gaussians: Gaussians) -> (Gaussians, Vec<u32>) {
    let threshold = RenderSettings::default().alpha_min;
    let visible = |row: &[f32], sh: &[f32]| {
        row.iter().chain(sh).all(|v| v.is_finite()) && sigmoid(row[gs_scene::OPACITY_LOGIT]) >= threshold
    };
    let per_gaussian = sh_coefficients(gaussians.sh_degree()) * 3;
    let rows = gaussians.geometry().chunks_exact(Gaussians::GEOMETRY);
    let rows = (0u32..).zip(rows.zip(gaussians.sh().chunks_exact(per_gaussian)));
    let pruned: Vec<u32> = rows.filter(|(_, (row, sh))| !visible(row, sh)).map(|(i, _)| i).collect();
    let mut next = pruned.iter().peekable();
    gaussians.retain(|i| next.next_if(|&&pruned| pruned as usize == i).is_none());
    (gaussians, pruned)
}
