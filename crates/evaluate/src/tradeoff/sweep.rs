//! The points of a sweep: a base method, varied along one axis at a time.

use crate::Method;
use refine::Stop;
use serde::{Deserialize, Serialize};
use sparsesplat::{Allocation, Backbone, Budget, Config, Head, Sampler};

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
    /// How pixels are drawn.
    Sampler,
    /// Steps on the photographs after the pass.
    Refinement,
    /// Size of the photographs that the pass is given; targets keep theirs.
    Resolution,
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
            Self::Sampler => "sampler",
            Self::Refinement => "refinement",
            Self::Resolution => "resolution",
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
    /// Whether it is what the other axes start from.
    pub base: bool,
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
}

impl Extent {
    fn budgets(self) -> &'static [usize] {
        match self {
            Self::Quick => &[2_000, 10_000, 40_000, 150_000],
            Self::Full => &[1_000, 2_000, 5_000, 10_000, 20_000, 40_000, 80_000, 150_000],
        }
    }

    fn neighbours(self) -> &'static [usize] {
        match self {
            Self::Quick => &[5, 20],
            Self::Full => &[0, 5, 10, 20, 30],
        }
    }

    fn refinement(self) -> &'static [usize] {
        match self {
            Self::Quick => &[10],
            Self::Full => &[15, 60],
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
        }
    }
}

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
    let mut budgets = extent.budgets().to_vec();
    if base_budget > 0 && !budgets.contains(&base_budget) {
        budgets.push(base_budget);
        budgets.sort_unstable();
    }
    let ours = name_of(config.allocation);
    for &n in &budgets {
        let name = format!("{ours}-{}", short(n));
        all.add(Axis::Budget, &name, n == base_budget, |point| {
            point.method.predict.budget = Budget::Gaussians(n);
        });
    }
    all.add(Axis::Budget, &name_of(Allocation::PixelAligned), false, |point| {
        point.method.predict.allocation = Allocation::PixelAligned;
    });
    let rivals = |of: &&Allocation| **of != config.allocation && **of != Allocation::PixelAligned;
    for &allocation in allocations.iter().filter(rivals) {
        for &n in &budgets {
            all.add(Axis::Allocation, &format!("{}-{}", name_of(allocation), short(n)), false, |point| {
                point.method.predict.allocation = allocation;
                point.method.predict.budget = Budget::Gaussians(n);
            });
        }
    }
    for &k in extent.neighbours().iter().filter(|&&k| k != config.neighbours) {
        all.vary(Axis::Neighbours, &format!("K={k}"), |config| config.neighbours = k);
    }
    if learned {
        for &n in &budgets {
            all.add(Axis::Head, &format!("closed-form-{}", short(n)), false, |point| {
                point.method.predict.head = Head::ClosedForm;
                point.method.predict.budget = Budget::Gaussians(n);
            });
        }
    }
    let (sampler, name) = match config.sampler {
        Sampler::Fixed => (Sampler::Bernoulli, "bernoulli"),
        Sampler::Bernoulli => (Sampler::Fixed, "fixed"),
    };
    all.vary(Axis::Sampler, name, |config| config.sampler = sampler);
    if base.refine.is_none() {
        for &steps in extent.refinement() {
            all.add(Axis::Refinement, &format!("refine-{steps}"), false, |point| {
                let stop = Stop::Steps(steps);
                point.method.refine = Some(refine::Config { stop, ..refine::Config::default() });
            });
        }
    }
    all.add(Axis::Resolution, "half-size", false, |point| point.shrink = 2);
    // Learned heads work with the features of their backbone, and measured depth has none.
    if measured_depth && !learned && config.backbone != Backbone::GivenDepth {
        all.vary(Axis::Backbone, "given-depth", |config| config.backbone = Backbone::GivenDepth);
    }
    for &(name, cuts) in extent.cuts() {
        all.add(Axis::Renderer, &name.replace(' ', "-"), false, |point| point.cuts = cuts);
    }
    all.all
}

/// Points as they are collected.
struct Points<'a> {
    base: &'a Method,
    all: Vec<Point>,
}

impl Points<'_> {
    fn add(&mut self, axis: Axis, name: &str, base: bool, change: impl FnOnce(&mut Point)) {
        let label = Label { point: name.to_owned(), axis, allocation: String::new(), base };
        let mut point = Point { label, method: self.base.clone(), cuts: Cuts::default(), shrink: 1 };
        change(&mut point);
        point.label.allocation = name_of(point.method.predict.allocation);
        self.all.push(point);
    }

    fn vary(&mut self, axis: Axis, name: &str, change: impl FnOnce(&mut Config)) {
        self.add(axis, name, false, |point| change(&mut point.method.predict));
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
mod tests {
    use super::*;

    fn swept(base: &Method, extent: Extent) -> Vec<Point> {
        let allocations =
            [Allocation::Entropy, Allocation::Laplacian, Allocation::Random, Allocation::PixelAligned];
        points(base, &allocations, extent, false, true)
    }

    #[test]
    fn points_have_names_of_their_own_and_one_is_the_base() {
        for extent in [Extent::Quick, Extent::Full] {
            let all = swept(&Method::feed_forward(Config::default()), extent);
            let mut names: Vec<&str> = all.iter().map(|point| point.label.point.as_str()).collect();
            let plain = |c: char| c.is_ascii_alphanumeric() || "-=.".contains(c);
            assert!(names.iter().all(|name| name.chars().all(plain)), "{names:?}");
            assert_eq!(all.iter().filter(|point| point.label.base).count(), 1);
            names.sort_unstable();
            assert!(names.windows(2).all(|pair| pair[0] != pair[1]), "{names:?}");
        }
    }

    #[test]
    fn every_point_but_those_of_other_budgets_differs_from_the_base_in_one_setting() {
        let base = Method::feed_forward(Config::default());
        for point in swept(&base, Extent::Full) {
            if matches!(point.label.axis, Axis::Budget | Axis::Allocation) {
                continue;
            }
            let json = |method: &Method| serde_json::to_value(method).unwrap();
            let (a, b) = (json(&base), json(&point.method));
            let changed = a.as_object().unwrap().iter().filter(|(key, value)| b[key.as_str()] != **value);
            let changed =
                changed.count() + usize::from(point.cuts != Cuts::default()) + usize::from(point.shrink != 1);
            assert_eq!(changed, 1, "{}", point.label.point);
        }
    }

    #[test]
    fn a_budget_of_ones_own_joins_the_others_and_what_is_there_is_not_added_twice() {
        let config = Config { budget: Budget::Gaussians(1_500), neighbours: 5, ..Config::default() };
        let refine = Some(refine::Config::default());
        let base = Method { refine, ..Method::feed_forward(config) };
        let all = swept(&base, Extent::Quick);
        let named = |name: &str| all.iter().find(|point| point.label.point == name);
        assert!(named("entropy-1500").unwrap().label.base && named("random-1500").is_some());
        assert!(named("K=5").is_none() && named("K=20").is_some() && named("refine-10").is_none());
        let learned = points(&base, &[], Extent::Quick, true, false);
        assert!(learned.iter().any(|point| point.method.predict.head == Head::ClosedForm));
        assert!(learned.iter().all(|point| point.label.axis != Axis::Backbone));
    }

    #[test]
    fn the_usual_cut_offs_are_the_renderers() {
        assert_eq!(Cuts::default(), Cuts { alpha_min: 1.0 / 255.0, transmittance_min: 1e-4 });
    }
}
