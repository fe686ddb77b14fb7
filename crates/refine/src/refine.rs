//! The loop.

use crate::adam::{Correction, Moments, update};
use crate::exposure::Exposures;
use crate::limits::{Limits, row_rates};
use crate::objective::{Objective, OfView};
use crate::schedule::{Turns, decay};
use crate::{Config, Error, Exposure, Report, Result, Step, StepRecord, Stopped};
use gs_raster::{Gradients, Rasterizer, RenderSettings};
use gs_scene::{Gaussians, View, sh_coefficients, sigmoid};
use rayon::prelude::*;
use std::time::{Duration, Instant};

/// Gaussians per parallel task of an update.
const ROWS: usize = 512;
/// A derivative beyond this, far above any that a loss of pictures has, would overflow when it is squared.
const LARGEST_GRADIENT: f32 = 1e15;
/// Rounds over all views without a gain after which there is nothing left to gain.
const PATIENCE: usize = 3;

/// Better Gaussians.
#[derive(Debug, Clone)]
pub struct Refined {
    /// The scene, in the order of the input without [`Report::pruned`].
    pub gaussians: Gaussians,
    /// What happened.
    pub report: Report,
}

/// Moves Gaussians so that they look like the photographs `views`, in a few steps of Adam on the derivatives of the rendering.
///
/// `on_step` is called after each step, outside the time that is measured. The number of Gaussians never rises. The same
/// input and seed give the same bytes on any number of threads, except with [`Stop::Seconds`](crate::Stop::Seconds). Gaussians that
/// no rendering can show (values that are not finite) stay as they are until they are pruned.
///
/// # Errors
/// If there are no views, a setting is out of its range, a view is too small for the structural term, or the scene cannot
/// be rendered or differentiated.
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
    let mut work = Work::new(gaussians, views, config, rasterizer)?;
    let mut turns = Turns::new(views.len(), config.seed);
    let mut report = Report { psnr_start: work.context_psnr(), ..Report::default() };
    let mut round = Round { best: report.psnr_start, ..Round::default() };
    while report.stopped.is_none() {
        let begin = Instant::now();
        let progress = config.stop.progress(report.steps.len(), work.spent);
        if progress >= 1.0 {
            report.stopped = Some(Stopped::Done);
            break;
        }
        let chosen: Vec<usize> = (0..config.views_per_step).map(|_| turns.next()).collect();
        let loss = work.step(&chosen, decay(progress), rasterizer)?;
        report.undone += usize::from(loss.is_none());
        round.views += chosen.len();
        if round.views >= views.len() {
            round.views %= views.len();
            if round.is_last(work.context_psnr(), config.smallest_gain) {
                report.stopped = Some(Stopped::NothingGained);
            }
        }
        work.spent += begin.elapsed();
        let record = StepRecord {
            step: report.steps.len() + 1,
            seconds: work.spent.as_secs_f64(),
            loss,
            psnr_context: work.context_psnr(),
        };
        report.steps.push(record);
        on_step(Step { record: &record, progress, gaussians: &work.gaussians, rasterizer });
    }
    let begin = Instant::now();
    let gaussians = if config.prune { prune(work.gaussians, &mut report.pruned) } else { work.gaussians };
    report.seconds = (work.spent + begin.elapsed()).as_secs_f64();
    if work.exposures.fitted {
        report.exposure = work.exposures.all();
    }
    Ok(Refined { gaussians, report })
}

/// The rounds over all views so far.
#[derive(Debug, Default)]
struct Round {
    /// Views compared in this round.
    views: usize,
    best: f64,
    without_gain: usize,
}

impl Round {
    /// A round is over: whether there is nothing left to gain.
    fn is_last(&mut self, psnr: f64, smallest_gain: f64) -> bool {
        // Written so that NaN, and a picture that cannot get better, are no gain.
        self.without_gain = if psnr > self.best + smallest_gain { 0 } else { self.without_gain + 1 };
        self.best = self.best.max(psnr);
        smallest_gain > 0.0 && self.without_gain >= PATIENCE
    }
}

struct Work<'a> {
    config: &'a Config,
    gaussians: Gaussians,
    objective: Objective<'a>,
    exposures: Exposures,
    limits: Vec<Limits>,
    geometry_moments: Moments,
    sh_moments: Moments,
    /// Newest PSNR of every view.
    psnr: Vec<f64>,
    /// Updates done.
    updates: usize,
    spent: Duration,
}

impl<'a> Work<'a> {
    fn new(
        gaussians: Gaussians,
        views: &'a [View],
        config: &'a Config,
        rasterizer: &mut Rasterizer,
    ) -> Result<Self> {
        let begin = Instant::now();
        let gaussians = with_sh_degree(gaussians, config.sh_degree);
        let mut objective = Objective::new(&gaussians, views, config.loss)?;
        let mut at_start = Vec::with_capacity(views.len());
        let mut psnr = Vec::with_capacity(views.len());
        for view in 0..views.len() {
            let (exposure, found) = objective.look(&gaussians, view, rasterizer)?;
            at_start.push(if config.exposure { exposure } else { Exposure::NONE });
            psnr.push(found);
        }
        Ok(Self {
            config,
            objective,
            exposures: Exposures::new(at_start),
            limits: Limits::of_scene(&gaussians, views),
            geometry_moments: Moments::new(gaussians.geometry().len()),
            sh_moments: Moments::new(gaussians.sh().len()),
            gaussians,
            psnr,
            updates: 0,
            spent: begin.elapsed(),
        })
    }

    /// Mean over the views of the newest PSNR of each.
    fn context_psnr(&self) -> f64 {
        self.psnr.iter().sum::<f64>() / self.psnr.len() as f64
    }

    /// One step on some views: the mean of their losses, or `None` if a loss or a derivative was not finite and the scene
    /// was left as it was.
    fn step(&mut self, chosen: &[usize], factor: f32, rasterizer: &mut Rasterizer) -> Result<Option<f64>> {
        let weight = 1.0 / chosen.len() as f32;
        let mut sum: Option<Gradients> = None;
        let mut loss = 0.0;
        for &view in chosen {
            let exposure = self.exposures.of(view);
            let found = self.objective.differentiate(&self.gaussians, view, exposure, weight, rasterizer)?;
            let Some(OfView { compared, gradients }) = found else { return Ok(None) };
            self.psnr[view] = compared.psnr;
            loss += compared.loss * f64::from(weight);
            self.exposures.draw(view, compared.fit);
            match &mut sum {
                None => sum = Some(gradients),
                Some(sum) => {
                    add(&mut sum.geometry, &gradients.geometry);
                    add(&mut sum.sh, &gradients.sh);
                }
            }
        }
        let Some(gradients) = sum else { return Ok(None) };
        if !(is_sound(&gradients.geometry) && is_sound(&gradients.sh)) {
            return Ok(None);
        }
        self.updates += 1;
        self.update(&gradients, factor);
        Ok(Some(loss))
    }

    fn update(&mut self, gradients: &Gradients, factor: f32) {
        const WIDTH: usize = Gaussians::GEOMETRY;
        let rates = &self.config.rates;
        let correction = Correction::of_step(self.updates);
        let per_gaussian = sh_coefficients(self.gaussians.sh_degree()) * 3;
        let (geometry, sh) = self.gaussians.buffers_mut();

        let of_geometry = geometry
            .par_chunks_mut(ROWS * WIDTH)
            .zip(gradients.geometry.par_chunks(ROWS * WIDTH))
            .zip(self.geometry_moments.first.par_chunks_mut(ROWS * WIDTH))
            .zip(self.geometry_moments.second.par_chunks_mut(ROWS * WIDTH))
            .zip(self.limits.par_chunks(ROWS));
        of_geometry.for_each(|((((values, gradients), first), second), limits)| {
            let mut steps = vec![0f32; values.len()];
            for (row, limits) in steps.chunks_exact_mut(WIDTH).zip(limits) {
                row_rates(rates, factor, limits.footprint, row);
            }
            update(values, gradients, first, second, &steps, correction);
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
        let of_sh = sh
            .par_chunks_mut(ROWS * per_gaussian)
            .zip(gradients.sh.par_chunks(ROWS * per_gaussian))
            .zip(self.sh_moments.first.par_chunks_mut(ROWS * per_gaussian))
            .zip(self.sh_moments.second.par_chunks_mut(ROWS * per_gaussian));
        of_sh.for_each(|(((values, gradients), first), second)| {
            update(values, gradients, first, second, &steps, correction);
        });
    }
}

fn add(sum: &mut [f32], more: &[f32]) {
    sum.par_iter_mut().with_min_len(1 << 14).zip(more).for_each(|(sum, more)| *sum += more);
}

/// Whether Adam can take these derivatives; NaN fails the comparison.
fn is_sound(gradients: &[f32]) -> bool {
    gradients.par_chunks(1 << 14).all(|chunk| chunk.iter().all(|g| g.abs() <= LARGEST_GRADIENT))
}

/// The scene with coefficients up to `degree`, the new ones 0.
fn with_sh_degree(gaussians: Gaussians, degree: usize) -> Gaussians {
    if degree <= gaussians.sh_degree() {
        return gaussians;
    }
    let (from, to) = (sh_coefficients(gaussians.sh_degree()) * 3, sh_coefficients(degree) * 3);
    let mut sh = vec![0f32; gaussians.len() * to];
    for (new, old) in sh.chunks_exact_mut(to).zip(gaussians.sh().chunks_exact(from)) {
        new[..from].copy_from_slice(old);
    }
    Gaussians::new(degree, gaussians.geometry().to_vec(), sh).expect("degree checked, lengths as computed")
}

/// The scene without what cannot be seen in any view: too transparent to be drawn, or not finite.
fn prune(gaussians: Gaussians, pruned: &mut Vec<u32>) -> Gaussians {
    let threshold = RenderSettings::default().alpha_min;
    let visible =
        |row: &[f32]| row.iter().all(|v| v.is_finite()) && sigmoid(row[gs_scene::OPACITY_LOGIT]) >= threshold;
    let rows = (0..).zip(gaussians.geometry().chunks_exact(Gaussians::GEOMETRY));
    pruned.extend(rows.filter(|(_, row)| !visible(row)).map(|(i, _): (u32, _)| i));
    if pruned.is_empty() {
        return gaussians;
    }
    let keep = |values: &[f32], width: usize| -> Vec<f32> {
        let mut next = pruned.iter().copied().peekable();
        let rows = (0u32..).zip(values.chunks_exact(width));
        rows.filter(|(i, _)| next.next_if_eq(i).is_none()).flat_map(|(_, row)| row.iter().copied()).collect()
    };
    let degree = gaussians.sh_degree();
    let geometry = keep(gaussians.geometry(), Gaussians::GEOMETRY);
    let sh = keep(gaussians.sh(), sh_coefficients(degree) * 3);
    Gaussians::new(degree, geometry, sh).expect("as many rows in both")
}
