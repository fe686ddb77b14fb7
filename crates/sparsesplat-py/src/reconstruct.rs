//! The pass: views, or a data set on disk, to a scene.

use crate::engine::{self, Progress, engine};
use crate::failure::OrRaise;
use crate::scene::Scene;
use crate::view::View;
use evaluate::{Method, Outcome, Runner, Step};
use gs_raster::Rasterizer;
use pyo3::exceptions::{PyTypeError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use refine::Stop;
use scene_windows::{Plan, Reading, SIMULATED_SIZE, SimulatedScene, Window, simulated_window};
use serde::Deserialize;
use serde::de::value::{Error as Unknown, StrDeserializer};
use sparsesplat::{Backbone, Budget, Config, Correction, DepthRange, Head, Prediction};
use std::path::PathBuf;
use view_data::Format;

/// How a scene came about.
#[derive(Debug, Clone)]
pub(crate) struct Report {
    outcome: evaluate::WindowFigures,
    head: String,
    views: Vec<String>,
    /// What the data set lists and does not use, and why.
    dropped: Vec<(String, String)>,
}

impl Report {
    /// Wall time by stage.
    pub(crate) fn seconds<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let seconds = &self.outcome.figures.seconds;
        let dict = PyDict::new(py);
        // Nothing is written or rendered here.
        let stages = seconds.by_name().filter(|(stage, _)| !matches!(*stage, "poses" | "write" | "render"));
        for (stage, seconds) in stages.chain([("total", seconds.total)]) {
            dict.set_item(stage, seconds)?;
        }
        Ok(dict)
    }

    /// Everything.
    pub(crate) fn to_dict<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let figures = &self.outcome;
        let dict = PyDict::new(py);
        dict.set_item("views", &self.views)?;
        dict.set_item("dropped", &self.dropped)?;
        dict.set_item("head", &self.head)?;
        dict.set_item("gaussians", figures.counts.total)?;
        dict.set_item("per_view", &figures.counts.per_view)?;
        dict.set_item("shell", figures.counts.shell)?;
        dict.set_item("tau", figures.tau)?;
        dict.set_item("depth_range", figures.depth_range)?;
        let exposure: Vec<(f32, f32)> = figures.exposure.iter().map(|view| (view.gain, view.bias)).collect();
        dict.set_item("exposure", exposure)?;
        let steps = figures.refinement.as_ref().map(|refinement| refinement.report.steps.len());
        dict.set_item("refine_steps", steps.unwrap_or(0))?;
        dict.set_item("corrector", figures.corrected_by.as_ref())?;
        dict.set_item("seconds", self.seconds(py)?)?;
        Ok(dict)
    }
}

/// Where views come from.
enum Source {
    Views(Vec<gs_scene::View>),
    Path { path: PathBuf, views: usize, reading: Reading },
}

/// One pass: posed photographs to a scene.
#[pyfunction]
#[pyo3(signature = (
    source, gaussians = 40_000, *, tau = None, views = 6, size = None, format = None, backbone = "plane-sweep",
    depth_planes = None, depth_range = None, allocation = "entropy", sampler = "fixed", filled_weight = None, smooth_weight = None, fuse = false, head = "default",
    weights = None, looks = None, far_shell = true, exposure = "as-photographed", neighbours = 20, refine = 0, corrector = None, seed = 0, device = "auto", progress = None
))]
#[expect(clippy::too_many_arguments, reason = "those of the command, by name")]
pub(crate) fn reconstruct(
    py: Python<'_>,
    source: &Bound<'_, PyAny>,
    gaussians: usize,
    tau: Option<f64>,
    views: usize,
    size: Option<(usize, usize)>,
    format: Option<&str>,
    backbone: &str,
    depth_planes: Option<usize>,
    depth_range: Option<&Bound<'_, PyAny>>,
    allocation: &str,
    sampler: &str,
    filled_weight: Option<f32>,
    smooth_weight: Option<f32>,
    fuse: bool,
    head: &str,
    weights: Option<PathBuf>,
    looks: Option<usize>,
    far_shell: bool,
    exposure: &str,
    neighbours: usize,
    refine: usize,
    corrector: Option<PathBuf>,
    seed: u64,
    device: &str,
    progress: Option<&Bound<'_, PyAny>>,
) -> PyResult<Scene> {
    let format = format.map(str::parse::<Format>).transpose().or_raise()?;
    let (depth_hint, range) = range(depth_range)?;
    let source = read_source(source, views, Reading { format, size, depth_hint })?;
    let correction = match corrector {
        None => Correction::Default,
        Some(path) if path.as_os_str() == "default" => Correction::Default,
        Some(path) if path.as_os_str() == "off" => Correction::Off,
        Some(path) => Correction::Weights(path),
    };
    let config = Config {
        backbone: read_backbone(backbone, depth_planes)?,
        depth_range: range,
        allocation: one_of("allocation", allocation)?,
        sampler: one_of("sampler", sampler)?,
        filled_weight: filled_weight.unwrap_or(Config::default().filled_weight),
        smooth_weight: smooth_weight.unwrap_or(Config::default().smooth_weight),
        fuse,
        budget: tau.map_or(Budget::Gaussians(gaussians), Budget::Tau),
        neighbours,
        head: match weights {
            Some(weights) => Head::Weights(weights),
            None => one_of("head", head)?,
        },
        looks: looks.unwrap_or(Config::default().looks),
        far_shell,
        exposure: one_of("exposure", exposure)?,
        correction,
        refined_later: false,
        seed,
    };
    let method = match refine {
        0 => Method::feed_forward(config),
        steps => {
            let refine = refine::Config { stop: Stop::Steps(steps), seed, ..refine::Config::default() };
            Method::refined(config, refine)
        }
    };
    let device = engine::device(device)?;
    // Threads of its own: a call that was left may go on for a while, and nobody should wait for it.
    let pool = engine::pool()?;
    let scene = engine::run(py, progress, move |caller| {
        pool.install(|| {
            let mut on_step = |step| caller.tell(told(step));
            let mut method = method;
            let (window, dropped) = source.load(&mut method, &mut on_step)?;
            // Nobody waits for a GPU that has nothing to do.
            let mut rasterizer = match method.refine {
                Some(_) => Rasterizer::new(device)?,
                None => Rasterizer::cpu(),
            };
            let outcome = Runner::new(method)?.reconstruct(&window, &mut rasterizer, &mut on_step)?;
            let views = window.context.iter().map(|view| view.name().to_owned()).collect();
            let Outcome { figures, prediction, .. } = outcome;
            let Prediction { gaussians, head, .. } = prediction;
            let report = Report { outcome: figures, head, views, dropped };
            Ok::<_, evaluate::Error>(Scene::new(gaussians, Some(report)))
        })
    })?;
    scene.or_raise()
}

// Python shows a default only if it is a literal.
const _: () = assert!(SIMULATED_SIZE.0 == 480 && SIMULATED_SIZE.1 == 320);

/// Photographs of a simulated courtyard, with exact depth: context views, and the held-out views between them.
#[pyfunction]
#[pyo3(signature = (width = 480, height = 320))]
pub(crate) fn simulated_views(
    py: Python<'_>,
    width: usize,
    height: usize,
) -> PyResult<(Vec<View>, Vec<View>)> {
    let engine = engine(py)?;
    let window = engine::run(py, None, move |_| {
        engine.install(|| simulated_window(SimulatedScene::Courtyard, (width, height)))
    })?;
    let Window { context, targets, .. } = window.or_raise()?;
    Ok((context.into_iter().map(View).collect(), targets.into_iter().map(View).collect()))
}

impl Source {
    /// The window, and what the data set does not use of what it lists.
    fn load(
        self,
        method: &mut Method,
        on_step: &mut dyn FnMut(Step),
    ) -> scene_windows::Result<(Window, Vec<(String, String)>)> {
        match self {
            Self::Views(context) => {
                let context_positions = (0..context.len()).collect();
                let window = Window {
                    name: "views".to_owned(),
                    context,
                    targets: Vec::new(),
                    context_positions,
                    target_positions: Vec::new(),
                    load_seconds: 0.0,
                };
                Ok((window, Vec::new()))
            }
            Self::Path { path, views, reading } => {
                on_step(Step::Load);
                let mut plan = Plan::selection(&path, views, reading)?;
                method.predict.depth_range = plan.depth_range(method.predict.depth_range);
                let window = plan.load_what_is_whole(false)?;
                let dropped = plan.ledger().iter().map(|entry| (entry.key.clone(), entry.reason.clone()));
                Ok((window, dropped.collect()))
            }
        }
    }
}

fn read_source(source: &Bound<'_, PyAny>, views: usize, reading: Reading) -> PyResult<Source> {
    if let Ok(path) = source.extract::<PathBuf>() {
        return Ok(Source::Path { path, views, reading });
    }
    let wrong =
        || PyTypeError::new_err("source: expected the path of a data set, or a sequence of sparsesplat.View");
    let given: Vec<PyRef<'_, View>> = source.extract().map_err(|_| wrong())?;
    if reading != Reading::default() {
        return Err(PyValueError::new_err("size, format and depth_range=\"hint\" are for data sets on disk"));
    }
    Ok(Source::Views(given.iter().map(|view| view.0.clone()).collect()))
}

/// Whether the data set is to say the depth range; the range.
fn range(given: Option<&Bound<'_, PyAny>>) -> PyResult<(bool, DepthRange)> {
    let Some(given) = given else { return Ok((false, DepthRange::Estimate)) };
    if given.extract::<String>().is_ok_and(|word| word == "hint") {
        return Ok((true, DepthRange::Estimate));
    }
    let (near, far) = given.extract::<(f64, f64)>().map_err(|_| {
        PyValueError::new_err(format!("depth_range is {given:?}, expected None, \"hint\" or (near, far)"))
    })?;
    Ok((false, DepthRange::Known { near, far }))
}

fn read_backbone(name: &str, planes: Option<usize>) -> PyResult<Backbone> {
    match (name, planes) {
        ("plane-sweep", None) => Ok(Backbone::default()),
        ("plane-sweep", Some(planes)) => Ok(Backbone::plane_sweep(planes)),
        ("given-depth", None) => Ok(Backbone::GivenDepth),
        ("given-depth", Some(_)) => {
            Err(PyValueError::new_err("depth_planes is for backbone=\"plane-sweep\""))
        }
        _ => Err(PyValueError::new_err(format!(
            "backbone is {name:?}, expected \"plane-sweep\" or \"given-depth\" (DepthSplat's network is not part of this \
             package: use the command `sparsesplat reconstruct --backbone depthsplat`)"
        ))),
    }
}

/// A value of an enum by the name that it has in every recipe.
fn one_of<'de, T: Deserialize<'de>>(argument: &str, name: &'de str) -> PyResult<T> {
    T::deserialize(StrDeserializer::<Unknown>::new(name))
        .map_err(|error| PyValueError::new_err(format!("{argument}: {error}")))
}

/// What is told of a step.
fn told(step: Step) -> Progress {
    let (stage, share) = match step {
        Step::Load => ("load", 0.0),
        Step::Predict(stage) => (stage.name(), 0.0),
        Step::Refine { progress, .. } => ("refine", progress),
        _ => ("render", 0.0),
    };
    Progress { stage, share }
}
