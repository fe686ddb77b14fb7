//! The loop of a sweep: windows, points, seeds; what is in the journal is not done again.

use super::SweepError;
use super::journal::{Entry, Failed, Journal};
use super::measure::{Instruments, Measured, Survey, Views, measure};
use super::pictures::Pictures;
use super::shard::Shard;
use super::sweep::Point;
use crate::render::Rendered;
use crate::{Dropped, Method, Plan, Result, Step, Window};
use gs_raster::Rasterizer;
use image_metrics::Lpips;
use sparsesplat::{Backbone, Config, Wanted, wanted};
use std::path::Path;

/// What is swept over what.
#[derive(Clone, Copy)]
pub struct Sweep<'a> {
    /// All windows, those of other shards too.
    pub plans: &'a [Plan],
    /// Which of them are this process's.
    pub shard: Shard,
    /// The points.
    pub points: &'a [Point],
    /// The seeds; a point runs with all that change anything.
    pub seeds: &'a [u64],
    /// Measures LPIPS, where there are weights for it.
    pub lpips: Option<&'a Lpips>,
}

/// What happens during a sweep.
#[derive(Debug)]
#[non_exhaustive]
pub enum Progress<'a> {
    /// A point begins.
    Point {
        /// Name of the window.
        window: &'a str,
        /// Name of the point.
        point: &'a str,
        /// Seed.
        seed: u64,
    },
    /// A step of it begins.
    Step(Step),
    /// So many points are behind, failed ones included.
    Done(usize),
    /// A point or a whole window is given up.
    Failed(&'a Failed),
}

impl Sweep<'_> {
    /// Points with their seeds times windows of this shard.
    #[must_use]
    pub fn runs(&self) -> usize {
        self.ours().count() * self.runs_of(self.points)
    }

    /// Runs of some points on one window.
    fn runs_of<'p>(&self, points: impl IntoIterator<Item = &'p Point>) -> usize {
        points.into_iter().map(|point| point.label.seeds(self.seeds).len()).sum()
    }

    fn ours(&self) -> impl Iterator<Item = (usize, &Plan)> {
        self.plans.iter().enumerate().filter(|(position, _)| self.shard.takes(*position))
    }

    /// Measures what the journal has not. A window or point that fails goes into the journal with its reason, and the sweep goes on.
    /// `scratch` is a file that scenes are written to.
    ///
    /// # Errors
    /// If the journal cannot be written, or has points of a window whose views are others now.
    ///
    /// # Panics
    /// If there are no seeds.
    pub fn run(
        &self,
        journal: &mut Journal,
        pictures: &Pictures,
        scratch: &Path,
        rasterizer: &mut Rasterizer,
        on_progress: &mut dyn FnMut(Progress<'_>),
    ) -> Result<(), SweepError> {
        assert!(!self.seeds.is_empty(), "a sweep needs at least one seed");
        let mut instruments = Instruments { rasterizer, lpips: self.lpips, scratch };
        for (position, plan) in self.ours() {
            let is_open = |point: &Point| {
                let seeds = point.label.seeds(self.seeds);
                seeds.iter().any(|&seed| !journal.has(plan.name(), seed, &point.label.point))
            };
            let open: Vec<&Point> = self.points.iter().filter(|point| is_open(point)).collect();
            if open.is_empty() {
                continue;
            }
            on_progress(Progress::Point {
                window: plan.name(),
                point: &open[0].label.point,
                seed: self.seeds[0],
            });
            on_progress(Progress::Step(Step::Load));
            let mut on_step = |step| on_progress(Progress::Step(step));
            let mut loaded = match Loaded::of(plan, open[0], &mut on_step) {
                Ok(loaded) => loaded,
                Err(error) => {
                    let failed = Failed { point: None, ..Failed::new(plan.name(), &error) };
                    give_up(journal, failed, self.runs_of(open), on_progress)?;
                    continue;
                }
            };
            journal.check_data(plan.name(), &loaded.views.data_sha256)?;
            for point in open {
                for (i, &seed) in point.label.seeds(self.seeds).iter().enumerate() {
                    if journal.has(plan.name(), seed, &point.label.point) {
                        continue;
                    }
                    on_progress(Progress::Point { window: plan.name(), point: &point.label.point, seed });
                    let mut on_step = |step| on_progress(Progress::Step(step));
                    let measured = loaded.measure(plan, point, seed, &mut instruments, &mut on_step);
                    let kept = measured.and_then(|(measured, renderings)| {
                        if i == 0 {
                            pictures.keep(position, &loaded.whole, &point.label.point, &renderings)?;
                        }
                        Ok(measured)
                    });
                    match kept {
                        Ok(measured) => {
                            journal.push(Entry::Measured(measured))?;
                            on_progress(Progress::Done(1));
                        }
                        Err(error) => {
                            let name = Some(point.label.point.clone());
                            let failed = Failed { point: name, seed, ..Failed::new(plan.name(), &error) };
                            give_up(journal, failed, 1, on_progress)?;
                        }
                    }
                }
            }
        }
        Ok(())
    }
}

fn give_up(
    journal: &mut Journal,
    failed: Failed,
    runs: usize,
    on_progress: &mut dyn FnMut(Progress<'_>),
) -> Result<(), SweepError> {
    on_progress(Progress::Failed(&failed));
    journal.push(Entry::Failed(failed))?;
    on_progress(Progress::Done(runs));
    Ok(())
}

impl Failed {
    fn new(window: &str, error: &crate::Error) -> Self {
        let Dropped { name, reason, .. } = Dropped::new(window, error);
        Self { window: name, point: None, seed: 0, reason }
    }
}

/// A window with what the backbone says of it, at every size that points ask for.
struct Loaded {
    whole: Window,
    /// Of the whole window, whatever size a point asks for.
    views: Views,
    smaller: Vec<(usize, Window)>,
    surveys: Vec<((usize, Backbone, Wanted), Survey)>,
}

impl Loaded {
    /// The window, and its survey for the point that comes first: without it there is none for most others.
    fn of(plan: &Plan, first: &Point, on_step: &mut dyn FnMut(Step)) -> Result<Self> {
        let whole = plan.load(true)?;
        let views = Views::of(&whole);
        let mut loaded = Self { whole, views, smaller: Vec::new(), surveys: Vec::new() };
        loaded.survey(plan, first, on_step)?;
        Ok(loaded)
    }

    /// The method of a point on this window.
    fn method(plan: &Plan, point: &Point, seed: u64) -> Method {
        let mut method = point.method.clone();
        method.predict.seed = seed;
        if let Some(refine) = &mut method.refine {
            refine.seed = seed;
        }
        method.predict.depth_range = plan.depth_range(method.predict.depth_range);
        method
    }

    /// Runs the backbone as a point has it, unless it was run; the place in the list of surveys.
    fn survey(&mut self, plan: &Plan, point: &Point, on_step: &mut dyn FnMut(Step)) -> Result<usize> {
        let Config { backbone, .. } = point.method.predict.clone();
        let key = (point.shrink, backbone, wanted(&point.method.predict)?);
        if let Some(known) = self.surveys.iter().position(|(of, _)| *of == key) {
            return Ok(known);
        }
        self.shrink(plan, point.shrink)?;
        let config = Self::method(plan, point, 0).predict;
        let survey = Survey::of(self.window(point.shrink), &config, key.2, on_step)?;
        self.surveys.push((key, survey));
        Ok(self.surveys.len() - 1)
    }

    fn window(&self, shrink: usize) -> &Window {
        self.smaller.iter().find(|(of, _)| *of == shrink).map_or(&self.whole, |(_, window)| window)
    }

    fn measure(
        &mut self,
        plan: &Plan,
        point: &Point,
        seed: u64,
        instruments: &mut Instruments<'_>,
        on_step: &mut dyn FnMut(Step),
    ) -> Result<(Measured, Vec<Rendered>)> {
        let survey = self.survey(plan, point, on_step)?;
        let method = Self::method(plan, point, seed);
        let window = self.window(point.shrink);
        let survey = &self.surveys[survey].1;
        measure(window, &self.views, survey, point, &method, instruments, on_step)
    }

    /// Loads the context views in a smaller size, unless they are there; targets stay as they are.
    fn shrink(&mut self, plan: &Plan, shrink: usize) -> Result<()> {
        let known = shrink == 1 || self.smaller.iter().any(|(known, _)| *known == shrink);
        if let Some(view) = self.whole.context.first().filter(|_| !known) {
            let size = (view.image().width() / shrink, view.image().height() / shrink);
            let mut window = plan.at_size((size.0.max(1), size.1.max(1))).load(false)?;
            window.targets.clone_from(&self.whole.targets);
            window.target_positions.clone_from(&self.whole.target_positions);
            self.smaller.push((shrink, window));
        }
        Ok(())
    }
}
