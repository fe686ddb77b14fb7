//! The points of a sweep: a base method, varied along one axis at a time.

use evaluate::Method;
use refine::Stop;
use serde::{Deserialize, Serialize};
use sparsesplat::{Allocation, Backbone, Budget, Config, Correction, Head, Sampler, SweepDepth};

/// What is varied.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Axis {
    /// How many Gaussians, by the base allocation; and one per pixel.
    Budget,
    /// Which pixels become Gaussians, at several budgets.
    Allocation,
    /// Neighbours K of each anchor.
    Neighbours,
    /// What turns anchors into Gaussians.
    Head,
    /// How often the pass looks at the photographs through the renderer.
    Looks,
    /// Whether a second head corrects the scene at the end.
    Correction,
    /// How pixels are drawn.
    Sampler,
    /// Steps on the photographs, after the looks.
    Refinement,
    /// Size of the photographs that the pass is given; targets keep theirs.
    Resolution,
    /// Planes of the stereo.
    DepthPlanes,
    /// Depth of the stereo, as it is or improved by the small network.
    Depth,
    /// Whether surfaces that several views see are joined.
    Fusion,
    /// Where depth comes from: measured depth, which a real camera does not bring along.
    Backbone,
    /// Where the renderer stops looking.
    Renderer,
}

impl Axis {
    /// Whether its points are rivals in what the pass costs: not if they see more than photographs, or differ in rendering alone.
    #[must_use]
    pub fn competes(self) -> bool {
        !matches!(self, Self::Backbone | Self::Renderer)
    }

    /// As tables call it.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Budget => "budget",
            Self::Allocation => "allocation",
            Self::Neighbours => "neighbours",
            Self::Head => "head",
            Self::Looks => "looks",
            Self::Correction => "correction",
            Self::Sampler => "sampler",
            Self::Refinement => "refinement",
            Self::Resolution => "resolution",
            Self::DepthPlanes => "depth planes",
            Self::Depth => "depth",
            Self::Fusion => "fusion",
            Self::Backbone => "backbone",
            Self::Renderer => "renderer",
        }
    }
}

/// Cut-offs of the renderer.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Cuts {
    /// Below this opacity in a pixel a Gaussian is not drawn there.
    pub alpha_min: f32,
    /// A pixel is done when its transmittance would fall below this.
    pub transmittance_min: f32,
}

impl Default for Cuts {
    fn default() -> Self {
        let gs_raster::RenderSettings { alpha_min, transmittance_min, .. } =
            gs_raster::RenderSettings::default();
        Self { alpha_min, transmittance_min }
    }
}

/// What tables and plots know of a point.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Label {
    /// Tells it from the others, fit for a file name: `entropy-40k`.
    pub point: String,
    /// What is varied.
    pub axis: Axis,
    /// Which pixels become Gaussians, as `--allocation` calls it.
    pub allocation: String,
    /// The count that is asked for; none where there is one per pixel.
    pub count: Option<usize>,
    /// Whether the seed changes anything: without, one seed is measured.
    pub draws: bool,
    /// Whether it is what the other axes start from.
    pub base: bool,
}

impl Label {
    /// Whether it is a point of quality over the number of Gaussians: by an allocation, with the base's head or another.
    #[must_use]
    pub fn is_of_counts(&self) -> bool {
        matches!(self.axis, Axis::Budget | Axis::Allocation | Axis::Head)
    }

    /// The curve over the count that the point belongs to.
    #[must_use]
    pub fn curve(&self) -> Option<String> {
        self.count.filter(|_| self.is_of_counts()).map(|_| match self.axis {
            // Points of another head are called by it and the count: `closed-form-40k`.
            Axis::Head => {
                let head = self.point.rsplit_once('-').map_or("", |(head, _)| head);
                format!("{}, {}", self.allocation, head.replace('-', " "))
            }
            _ => self.allocation.clone(),
        })
    }

    /// Those of a sweep's seeds that the point is measured with.
    #[must_use]
    pub fn seeds<'a>(&self, all: &'a [u64]) -> &'a [u64] {
        if self.draws { all } else { &all[..all.len().min(1)] }
    }
}

/// One point of a sweep.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Point {
    /// What tables call it.
    #[serde(flatten)]
    pub label: Label,
    /// Photographs to Gaussians; the seed is set by the sweep.
    pub method: Method,
    /// How its pictures are rendered.
    pub cuts: Cuts,
    /// Photographs are given to the pass this many times smaller in width and height.
    pub shrink: usize,
}

/// How long a sweep may take.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Extent {
    /// Some minutes: fewer points.
    Quick,
    /// All points.
    Full,
    /// What the paper's tables are made of: its counts, by every allocation.
    Paper,
}

impl Extent {
    fn budgets(self) -> &'static [usize] {
        match self {
            Self::Quick => &[2_000, 10_000, 40_000, 150_000],
            Self::Full => &[1_000, 2_000, 5_000, 10_000, 20_000, 40_000, 100_000, 150_000],
            Self::Paper => &PAPER_COUNTS,
        }
    }

    /// Counts of an allocation that is compared with the base's, beside the base's own. Merging makes one Gaussian per pixel first, at
    /// every count.
    fn rival_budgets(self, allocation: Allocation) -> &'static [usize] {
        match (self, allocation) {
            (Self::Quick, Allocation::Merged) => &[],
            (Self::Full, Allocation::Merged) => &PAPER_COUNTS,
            (Self::Quick, _) => &[2_000, 10_000],
            _ => self.budgets(),
        }
    }

    fn neighbours(self) -> &'static [usize] {
        match self {
            Self::Quick => &[5, 20],
            Self::Full => &[0, 5, 10, 20, 30],
            Self::Paper => &[],
        }
    }

    fn looks(self) -> &'static [usize] {
        match self {
            Self::Quick => &[1],
            Self::Full => &[1, 2, 3, 4, 5],
            Self::Paper => &[],
        }
    }

    fn refinement(self) -> &'static [usize] {
        match self {
            Self::Quick => &[10],
            Self::Full => &[15, 60, 240],
            Self::Paper => &[],
        }
    }

    /// The steps that are measured without a correction too.
    fn uncorrected(self) -> Option<usize> {
        (self == Self::Full).then_some(60)
    }

    fn planes(self) -> &'static [usize] {
        match self {
            Self::Quick => &[32],
            Self::Full => &[16, 32, 64, 256],
            Self::Paper => &[],
        }
    }

    fn cuts(self) -> &'static [(&'static str, Cuts)] {
        const USUAL: Cuts = Cuts { alpha_min: 1.0 / 255.0, transmittance_min: 1e-4 };
        const ALL: [(&str, Cuts); 4] = [
            ("alpha 4 of 255", Cuts { alpha_min: 4.0 / 255.0, ..USUAL }),
            ("transmittance 0.01", Cuts { transmittance_min: 0.01, ..USUAL }),
            ("alpha 16 of 255", Cuts { alpha_min: 16.0 / 255.0, ..USUAL }),
            ("transmittance 0.1", Cuts { transmittance_min: 0.1, ..USUAL }),
        ];
        match self {
            Self::Quick => &ALL[..2],
            Self::Full => &ALL,
            Self::Paper => &[],
        }
    }
}

/// The counts of the paper's tables.
pub(super) const PAPER_COUNTS: [usize; 4] = [10_000, 40_000, 100_000, 150_000];

/// The points of a sweep from `base`, which has a count as its budget. `allocations` are compared with each other at several
/// budgets; one that is pixel-aligned has none and is one point. `learned` says whether the base's head is, `measured_depth` whether
/// the views have depth.
#[must_use]
pub fn points(
    base: &Method,
    allocations: &[Allocation],
    extent: Extent,
    learned: bool,
    measured_depth: bool,
) -> Vec<Point> {
    let mut all = Points { base, all: Vec::new() };
    let config = &base.predict;
    let base_budget = if let Budget::Gaussians(n) = config.budget { n } else { 0 };
    let with_base = |budgets: &[usize]| {
        let mut budgets = budgets.to_vec();
        if base_budget > 0 && !budgets.contains(&base_budget) {
            budgets.push(base_budget);
            budgets.sort_unstable();
        }
        budgets
    };
    let budgets = with_base(extent.budgets());
    let ours = config.allocation;
    for &n in &budgets {
        all.count(Axis::Budget, &name_of(ours), ours, n, |_| {});
    }
    all.add(Axis::Budget, &name_of(Allocation::PixelAligned), |point| {
        point.method.predict.allocation = Allocation::PixelAligned;
    });
    let is_rival = |other: &&Allocation| **other != ours && **other != Allocation::PixelAligned;
    for &allocation in allocations.iter().filter(is_rival) {
        for n in with_base(extent.rival_budgets(allocation)) {
            all.count(Axis::Allocation, &name_of(allocation), allocation, n, |_| {});
        }
    }
    if extent == Extent::Paper {
        return all.all;
    }
    for &k in extent.neighbours().iter().filter(|&&k| k != config.neighbours) {
        all.vary(Axis::Neighbours, &format!("K={k}"), |config| config.neighbours = k);
    }
    if learned {
        let closed_form = |config: &mut Config| config.head = Head::ClosedForm;
        for &n in &budgets {
            all.count(Axis::Head, "closed-form", ours, n, closed_form);
        }
        let base_is_grid =
            config.head == Head::Default && matches!(config.backbone, Backbone::PlaneSweep { .. });
        for &n in budgets.iter().filter(|_| base_is_grid) {
            all.count(Axis::Head, "attention", ours, n, |config| config.head = Head::Attention);
        }
        all.vary(Axis::Head, &format!("closed-form-{}", name_of(Allocation::PixelAligned)), |config| {
            config.allocation = Allocation::PixelAligned;
            closed_form(config);
        });
    }
    if matches!(config.backbone, Backbone::DepthSplat(_)) {
        all.vary(Axis::Head, &format!("depthsplat-{}", name_of(Allocation::PixelAligned)), |config| {
            (config.allocation, config.head) = (Allocation::PixelAligned, Head::DepthSplat);
        });
    }
    for &looks in extent.looks().iter().filter(|&&looks| looks != config.looks) {
        all.vary(Axis::Looks, &format!("looks-{looks}"), |config| config.looks = looks);
    }
    if corrects(&base.pass()) {
        all.vary(Axis::Correction, "uncorrected", |config| config.correction = Correction::Off);
    }
    let (sampler, name) = match config.sampler {
        Sampler::Fixed => (Sampler::Bernoulli, "bernoulli"),
        Sampler::Bernoulli | Sampler::Systematic => (Sampler::Fixed, "fixed"),
    };
    all.vary(Axis::Sampler, name, |config| config.sampler = sampler);
    let stereo = matches!(config.backbone, Backbone::PlaneSweep { .. });
    let weight = if config.filled_weight == 1.0 { Config::default().filled_weight } else { 1.0 };
    if stereo {
        all.vary(Axis::Sampler, &format!("filled-weight={weight}"), |config| config.filled_weight = weight);
    }
    if config.allocation == Allocation::Entropy {
        let weight = if config.smooth_weight == 1.0 { Config::default().smooth_weight } else { 1.0 };
        all.vary(Axis::Sampler, &format!("smooth-weight={weight}"), |config| config.smooth_weight = weight);
    }
    if base.refine.is_none() {
        for &steps in extent.refinement() {
            let refine = refine::Config { stop: Stop::Steps(steps), ..refine::Config::default() };
            let refined = Method::refined(config.clone(), refine);
            let uncorrected = (extent.uncorrected() == Some(steps) && corrects(&refined.pass())).then(|| {
                let mut method = refined.clone();
                method.predict.correction = Correction::Off;
                method
            });
            all.add(Axis::Refinement, &format!("refine-{steps}"), |point| point.method = refined);
            if let Some(method) = uncorrected {
                all.add(Axis::Refinement, &format!("refine-{steps}-uncorrected"), |point| {
                    point.method = method;
                });
            }
        }
    }
    all.add(Axis::Resolution, "half-size", |point| point.shrink = 2);
    if let Backbone::PlaneSweep { planes: usual, depth } = &config.backbone {
        for &planes in extent.planes().iter().filter(|&planes| planes != usual) {
            let backbone = Backbone::PlaneSweep { planes, depth: depth.clone() };
            all.vary(Axis::DepthPlanes, &format!("planes={planes}"), |config| config.backbone = backbone);
        }
        let (other, name) = match depth {
            SweepDepth::Stereo => (SweepDepth::Learned, "learned-depth"),
            SweepDepth::Learned | SweepDepth::Weights(_) => (SweepDepth::Stereo, "stereo-depth"),
        };
        let backbone = Backbone::PlaneSweep { planes: *usual, depth: other };
        all.vary(Axis::Depth, name, |config| config.backbone = backbone);
    }
    if config.head != Head::DepthSplat {
        let name = if config.fuse { "no-fuse" } else { "fuse" };
        all.vary(Axis::Fusion, name, |config| config.fuse = !config.fuse);
    }
    // Learned heads work with the features of their backbone, and measured depth has none.
    if measured_depth && !learned && config.backbone != Backbone::GivenDepth {
        all.vary(Axis::Backbone, "given-depth", |config| config.backbone = Backbone::GivenDepth);
    }
    for &(name, cuts) in extent.cuts() {
        all.add(Axis::Renderer, &name.replace(' ', "-"), |point| point.cuts = cuts);
    }
    all.all
}

/// Whether a corrector changes the scene.
fn corrects(config: &Config) -> bool {
    match config.correction {
        Correction::Off => false,
        Correction::Default => config.has_corrector(),
        Correction::Weights(_) => config.keeps_anchors(),
    }
}

/// Points as they are collected.
struct Points<'a> {
    base: &'a Method,
    all: Vec<Point>,
}

impl Points<'_> {
    fn add(&mut self, axis: Axis, name: &str, change: impl FnOnce(&mut Point)) {
        let label = Label {
            point: name.to_owned(),
            axis,
            allocation: String::new(),
            count: None,
            draws: true,
            base: false,
        };
        let mut point = Point { label, method: self.base.clone(), cuts: Cuts::default(), shrink: 1 };
        change(&mut point);
        let (predict, base) = (&mut point.method.predict, &self.base.predict);
        // Weights of a corrector that fit the base may not fit this.
        if matches!(predict.correction, Correction::Weights(_))
            && !predict.has_corrector()
            && (!predict.keeps_anchors() || predict.backbone != base.backbone)
        {
            predict.correction = Correction::Off;
        }
        let Method { predict, refine, .. } = &point.method;
        point.label.allocation = name_of(predict.allocation);
        point.label.count = match predict.budget {
            Budget::Gaussians(n) if predict.allocation != Allocation::PixelAligned => Some(n),
            _ => None,
        };
        point.label.draws = !predict.allocation.takes_all() || refine.is_some();
        point.label.base = axis == Axis::Budget && *predict == self.base.predict;
        self.all.push(point);
    }

    fn vary(&mut self, axis: Axis, name: &str, change: impl FnOnce(&mut Config)) {
        self.add(axis, name, |point| change(&mut point.method.predict));
    }

    /// A point of the curve `family`: `n` Gaussians by an allocation, and what else is different.
    fn count(
        &mut self,
        axis: Axis,
        family: &str,
        allocation: Allocation,
        n: usize,
        change: impl FnOnce(&mut Config),
    ) {
        self.vary(axis, &format!("{family}-{}", short(n)), |config| {
            config.allocation = allocation;
            config.budget = Budget::Gaussians(n);
            change(config);
        });
    }
}

/// An allocation as `--allocation` calls it.
fn name_of(allocation: Allocation) -> String {
    let name = serde_json::to_value(allocation).ok();
    name.as_ref().and_then(serde_json::Value::as_str).unwrap_or("other").to_owned()
}

/// `40000` as `40k`.
fn short(count: usize) -> String {
    if count.is_multiple_of(1000) { format!("{}k", count / 1000) } else { count.to_string() }
}

#[cfg(test)]
#[path = "sweep_tests.rs"]
mod tests;
