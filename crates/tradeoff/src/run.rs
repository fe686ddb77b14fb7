//! The loop of a sweep: windows, points, seeds; it skips measurements that are in the journal.

use super::SweepError;
use super::journal::{Entry, Failed, Journal};
use super::measure::{Instruments, Measured, Survey, Views, measure};
use super::pictures::Pictures;
use super::shard::Shard;
use super::sweep::Point;
use evaluate::{Method, Rendered, Result, Step};
use gs_raster::Rasterizer;
use image_metrics::Lpips;
use scene_windows::{Dropped, Plan, Window};
use sparsesplat::{Backbone, NetworkDevice, Predictor, Wanted};
use std::error::Error;
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
    /// Where the networks of backbones run.
    pub network_device: NetworkDevice,
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
        self.ours().count() * self.points.iter().map(|point| self.seeds_of(point).count()).sum::<usize>()
    }

    /// The seeds that change anything about a point.
    fn seeds_of(&self, point: &Point) -> impl Iterator<Item = u64> {
        point.label.seeds(self.seeds).iter().copied()
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
        let mut predictors = Predictors { device: self.network_device, last: None };
        for (position, plan) in self.ours() {
            let all =
                self.points.iter().flat_map(|point| self.seeds_of(point).map(move |seed| (point, seed)));
            let open = all.filter(|(point, seed)| !journal.has(plan.name(), *seed, &point.label.point));
            let open: Vec<(&Point, u64)> = open.collect();
            let (Some(base), Some((point, seed))) = (self.points.first(), open.first()) else { continue };
            on_progress(Progress::Point { window: plan.name(), point: &point.label.point, seed: *seed });
            on_progress(Progress::Step(Step::Load));
            let mut on_step = |step| on_progress(Progress::Step(step));
            let mut loaded = match Loaded::of(plan, base, &mut predictors, &mut on_step) {
                Ok(loaded) => loaded,
                Err(error) => {
                    let failed = Failed { point: None, ..Failed::new(plan.name(), &error) };
                    give_up(journal, failed, open.len(), on_progress)?;
                    continue;
                }
            };
            journal.check_data(plan.name(), &loaded.views.data_sha256)?;
            for (point, seed) in open {
                on_progress(Progress::Point { window: plan.name(), point: &point.label.point, seed });
                let mut on_step = |step| on_progress(Progress::Step(step));
                let measured =
                    loaded.measure(plan, point, seed, &mut predictors, &mut instruments, &mut on_step);
                let kept = measured.map_err(Box::<dyn Error>::from).and_then(|(measured, renderings)| {
                    if self.seeds_of(point).next() == Some(seed) {
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
                        let failed = Failed { point: name, seed, ..Failed::new(plan.name(), &*error) };
                        give_up(journal, failed, 1, on_progress)?;
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
    fn new(window: &str, error: &dyn Error) -> Self {
        let Dropped { name, reason, .. } = Dropped::new(window, error);
        Self { window: name, point: None, seed: 0, reason }
    }
}

/// Makes the predictors of all points; weights are read once.
struct Predictors {
    device: NetworkDevice,
    last: Option<Predictor>,
}

impl Predictors {
    fn with(&mut self, method: &Method) -> Result<Predictor> {
        let config = method.pass();
        let predictor = match &self.last {
            Some(last) => last.with_config(config)?,
            None => Predictor::on(config, self.device)?,
        };
        self.last = Some(predictor.clone());
        Ok(predictor)
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
    /// The window, and its survey for the base, whatever points are open: without it there is none for most others.
    fn of(
        plan: &Plan,
        base: &Point,
        predictors: &mut Predictors,
        on_step: &mut dyn FnMut(Step),
    ) -> Result<Self> {
        let whole = plan.load(true)?;
        let views = Views::of(&whole);
        let mut loaded = Self { whole, views, smaller: Vec::new(), surveys: Vec::new() };
        let predictor = predictors.with(&base.method.on(plan, 0))?;
        loaded.survey(plan, base, &predictor, on_step)?;
        Ok(loaded)
    }

    /// Runs the backbone as a point has it, unless it was run; the place in the list of surveys.
    fn survey(
        &mut self,
        plan: &Plan,
        point: &Point,
        predictor: &Predictor,
        on_step: &mut dyn FnMut(Step),
    ) -> Result<usize> {
        let key = (point.shrink, predictor.config().backbone.clone(), predictor.wanted());
        if let Some(known) = self.surveys.iter().position(|(other, _)| *other == key) {
            return Ok(known);
        }
        self.shrink(plan, point.shrink)?;
        let survey = Survey::of(self.window(point.shrink), predictor, on_step)?;
        self.surveys.push((key, survey));
        Ok(self.surveys.len() - 1)
    }

    fn window(&self, shrink: usize) -> &Window {
        self.smaller.iter().find(|(factor, _)| *factor == shrink).map_or(&self.whole, |(_, window)| window)
    }

    fn measure(
        &mut self,
        plan: &Plan,
        point: &Point,
        seed: u64,
        predictors: &mut Predictors,
        instruments: &mut Instruments<'_>,
        on_step: &mut dyn FnMut(Step),
    ) -> Result<(Measured, Vec<Rendered>)> {
        let method = point.method.on(plan, seed);
        let predictor = predictors.with(&method)?;
        let survey = self.survey(plan, point, &predictor, on_step)?;
        let window = self.window(point.shrink);
        let survey = &self.surveys[survey].1;
        measure(window, &self.views, survey, point, &method, &predictor, instruments, on_step)
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Axis;
    use crate::journal::tests::header;
    use crate::{Cuts, Label, journal_name};
    use scene_windows::SimulatedScene;

    fn point(name: &str, backbone: Backbone) -> Point {
        let label = Label {
            point: name.to_owned(),
            axis: Axis::Budget,
            allocation: "entropy".to_owned(),
            count: Some(200),
            draws: true,
            base: name == "first",
        };
        let budget = sparsesplat::Budget::Gaussians(200);
        let predict = sparsesplat::Config {
            backbone,
            budget,
            head: sparsesplat::Head::ClosedForm,
            ..sparsesplat::Config::default()
        };
        Point { label, method: Method::feed_forward(predict), cuts: Cuts::default(), shrink: 1 }
    }

    #[test]
    fn a_point_that_fails_takes_no_other_with_it_when_the_sweep_is_resumed() {
        let folder = tempfile::tempdir().unwrap();
        let nowhere = Backbone::DepthSplat(folder.path().join("nowhere.pth"));
        let points = [
            point("first", Backbone::GivenDepth),
            point("broken", nowhere),
            point("last", Backbone::GivenDepth),
        ];
        let plans = [Plan::simulated(SimulatedScene::Courtyard, (48, 32))];
        let labels: Vec<Label> = points.iter().map(|point| point.label.clone()).collect();
        let header = header(&[plans[0].name()], &labels, &[0, 1]);
        let sweep = Sweep {
            plans: &plans,
            shard: Shard::WHOLE,
            points: &points,
            seeds: &[0, 1],
            network_device: NetworkDevice::Cpu,
            lpips: None,
        };
        let pictures = Pictures::below(&[folder.path().to_path_buf()]);
        // Points of failures, and how many runs are said to be behind.
        let run =
            || {
                let mut journal = Journal::open(folder.path(), &header).unwrap();
                let (mut failed, mut done) = (Vec::new(), journal.measured());
                let scratch = folder.path().join("scratch.ply");
                sweep
                    .run(&mut journal, &pictures, &scratch, &mut Rasterizer::cpu(), &mut |progress| {
                        match progress {
                            Progress::Failed(failure) => {
                                failed.push(failure.point.clone().unwrap_or_default());
                            }
                            Progress::Done(runs) => done += runs,
                            _ => {}
                        }
                    })
                    .unwrap();
                (failed, done, journal.measured())
            };
        let of_all = (vec!["broken".to_owned(); 2], sweep.runs(), 4);
        assert_eq!(run(), of_all);
        // Killed before the last point: what is open begins with the one that fails.
        let path = folder.path().join(journal_name(Shard::WHOLE));
        let text = std::fs::read_to_string(&path).unwrap();
        let is_kept = |(i, line): &(usize, &str)| *i == 0 || !line.contains("\"point\":\"last\",");
        let kept: Vec<&str> = text.lines().enumerate().filter(is_kept).map(|(_, line)| line).collect();
        assert!(kept.len() < text.lines().count());
        std::fs::write(&path, kept.join("\n") + "\n").unwrap();
        assert_eq!(run(), of_all);
    }
}
