//! What the backward pass needs, and the backward pass.

use crate::arrays::{Side, give, read};
use crate::cameras::pose_gradient;
use crate::engine::{self, Caller, Engine, engine};
use crate::failure::OrRaise;
use crate::rasterize::{Backgrounds, Depth, Drawn, Request};
use gs_raster::{ActivatedGradients, Colors, Gradients, PixelGradients, PoseGradient};
use gs_scene::Gaussians;
use pyo3::exceptions::PyRuntimeError;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use rayon::prelude::*;
use std::sync::Arc;
use std::time::Instant;

/// What `record` keeps for the backward pass. Its memory is given back when the last reference goes.
#[pyclass(frozen, module = "sparsesplat")]
pub(crate) struct Tape(Arc<Recorded>);

/// A recorded batch.
pub(crate) struct Recorded {
    engine: &'static Engine,
    request: Arc<Request>,
    /// None only while it is dropped.
    gaussians: Option<Gaussians>,
    kind: Colors,
    /// One per run.
    tapes: Vec<gs_raster::Tape>,
    /// Alpha and expected depth of each view, where the picture holds accumulated depth.
    planes: Vec<(Vec<f32>, Vec<f32>)>,
}

/// Gradients by everything that was given to `record`.
struct Found {
    gaussians: ActivatedGradients,
    poses: Vec<PoseGradient>,
    /// Per run.
    backgrounds: Vec<[f64; 3]>,
    seconds: f64,
}

impl Recorded {
    /// Draws and records; ends early if the caller is gone.
    pub(crate) fn new(
        engine: &'static Engine,
        caller: &Caller,
        gaussians: Gaussians,
        kind: Colors,
        request: Arc<Request>,
    ) -> gs_raster::Result<(Drawn, Self)> {
        let (drawn, tapes) = engine.rasterizer(request.device, |rasterizer| {
            let begin = Instant::now();
            let (mut views, mut tapes) = (Vec::new(), Vec::new());
            for run in &request.runs {
                let (drawn, tape) = rasterizer.record(&gaussians, &run.cameras, &run.settings)?;
                views.extend(drawn);
                tapes.push(tape);
                caller.end_if_gone();
            }
            Ok((Drawn::new(views, rasterizer, begin), tapes))
        })?;
        let planes = match request.mode.depth {
            Some(Depth::Accumulated) => {
                let planes = drawn.views.iter();
                planes.map(|view| (view.alpha.clone(), view.depth.clone().unwrap_or_default())).collect()
            }
            _ => Vec::new(),
        };
        Ok((drawn, Self { engine, request, gaussians: Some(gaussians), kind, tapes, planes }))
    }

    fn gaussians(&self) -> &Gaussians {
        self.gaussians.as_ref().expect("it is there until it is dropped")
    }

    /// The gradients by colours, alpha and depth of every view, run by run.
    fn pixels(&self, colors: &[f32], alphas: Option<&[f32]>) -> Vec<Vec<PixelGradients>> {
        let mode = self.request.mode;
        let (width, height) = self.request.size;
        let (pixels, channels) = (width * height, mode.channels());
        let mut view = 0;
        let mut next = || {
            let colors = &colors[view * pixels * channels..][..pixels * channels];
            let mut alpha = alphas.map(|alphas| alphas[view * pixels..][..pixels].to_vec());
            let mut depth: Option<Vec<f32>> =
                mode.depth.map(|_| colors.iter().skip(channels - 1).step_by(channels).copied().collect());
            if let (Some(depth), Some(Depth::Accumulated)) = (&mut depth, mode.depth) {
                // Accumulated depth is alpha times expected depth.
                let alpha = alpha.get_or_insert_with(|| vec![0.0; pixels]);
                let (opacity, expected) = &self.planes[view];
                for at in 0..pixels {
                    alpha[at] += depth[at] * expected[at];
                    depth[at] *= opacity[at];
                }
            }
            let image = match (mode.colors, channels) {
                (true, 3) => copy(colors),
                (true, _) => colors.chunks_exact(channels).flat_map(|pixel| &pixel[..3]).copied().collect(),
                (false, _) => vec![0.0; pixels * 3],
            };
            view += 1;
            PixelGradients { image, alpha, depth }
        };
        self.request.runs.iter().map(|run| run.cameras.iter().map(|_| next()).collect()).collect()
    }

    fn backward(&self, pixels: &[Vec<PixelGradients>]) -> gs_raster::Result<Found> {
        let (gaussians, begin) = (self.gaussians(), Instant::now());
        let (mut sum, mut backgrounds): (Option<Gradients>, Vec<[f64; 3]>) = (None, Vec::new());
        self.engine.rasterizer(self.request.device, |rasterizer| {
            for (tape, pixels) in self.tapes.iter().zip(pixels) {
                let found = rasterizer.backward(gaussians, tape, pixels)?;
                backgrounds.push(found.background);
                match &mut sum {
                    None => sum = Some(found),
                    Some(sum) => add(sum, found),
                }
            }
            Ok(())
        })?;
        let seconds = begin.elapsed().as_secs_f64();
        let nothing = || Gradients {
            geometry: vec![0.0; gaussians.geometry().len()],
            sh: vec![0.0; gaussians.sh().len()],
            background: [0.0; 3],
            poses: Vec::new(),
        };
        let mut sum = sum.unwrap_or_else(nothing);
        let poses = std::mem::take(&mut sum.poses);
        let gaussians = self.engine.install(|| sum.activated(gaussians, self.kind));
        Ok(Found { gaussians, poses, backgrounds, seconds })
    }
}

impl Drop for Recorded {
    fn drop(&mut self) {
        // The child of a fork has an engine of its own.
        if self.engine.process() == std::process::id()
            && let Some(gaussians) = self.gaussians.take()
        {
            self.engine.recycle(gaussians);
        }
    }
}

/// A copy that all threads write.
fn copy(numbers: &[f32]) -> Vec<f32> {
    const CHUNK: usize = 1 << 14;
    let mut copy = vec![0.0; numbers.len()];
    let chunks = copy.par_chunks_mut(CHUNK).zip(numbers.par_chunks(CHUNK));
    chunks.for_each(|(copy, numbers)| copy.copy_from_slice(numbers));
    copy
}

/// Adds gradients of further views.
fn add(sum: &mut Gradients, found: Gradients) {
    for (sum, found) in [(&mut sum.geometry, found.geometry), (&mut sum.sh, found.sh)] {
        sum.iter_mut().zip(found).for_each(|(sum, found)| *sum += found);
    }
    sum.poses.extend(found.poses);
}

impl Tape {
    pub(crate) fn new(recorded: Recorded) -> Self {
        Self(Arc::new(recorded))
    }
}

#[pymethods]
impl Tape {
    /// Gradients of a loss by what was given to record, given those by the pictures.
    #[pyo3(signature = (v_colors, v_alphas = None))]
    fn backward<'py>(
        &self,
        py: Python<'py>,
        v_colors: &Bound<'py, PyAny>,
        v_alphas: Option<&Bound<'py, PyAny>>,
    ) -> PyResult<Bound<'py, PyDict>> {
        let recorded = &*self.0;
        if engine(py)?.process() != recorded.engine.process() {
            return Err(PyRuntimeError::new_err(
                "this tape was recorded by the parent of this process, record again after the fork",
            ));
        }
        let (width, height) = recorded.request.size;
        let count = recorded.request.runs.iter().map(|run| run.cameras.len()).sum();
        let shape = |channels| [Side::Is(count), Side::Is(height), Side::Is(width), Side::Is(channels)];
        let v_colors = read::<f32>("v_colors", v_colors, &shape(recorded.request.mode.channels()))?;
        let v_alphas = v_alphas.map(|array| read::<f32>("v_alphas", array, &shape(1))).transpose()?;
        let alphas = v_alphas.as_ref().map(|array| array.as_slice()).transpose()?;
        let colors = v_colors.as_slice()?;
        let found = engine::run_borrowing(py, |_| {
            let pixels = recorded.engine.install(|| recorded.pixels(colors, alphas));
            recorded.backward(&pixels)
        })?;
        recorded.gradients(py, found.or_raise()?)
    }
}

impl Recorded {
    fn gradients<'py>(&self, py: Python<'py>, found: Found) -> PyResult<Bound<'py, PyDict>> {
        let n = self.gaussians().len();
        let ActivatedGradients { means, quats, scales, opacities, colors } = found.gaussians;
        let dict = PyDict::new(py);
        dict.set_item("means", give(py, means, [n, 3])?)?;
        dict.set_item("quats", give(py, quats, [n, 4])?)?;
        dict.set_item("scales", give(py, scales, [n, 3])?)?;
        dict.set_item("opacities", give(py, opacities, [n])?)?;
        let colors = match self.kind {
            Colors::Rgb => give(py, colors, [n, 3])?,
            Colors::Sh { per_gaussian, .. } => give(py, colors, [n, per_gaussian, 3])?,
        };
        dict.set_item("colors", colors)?;
        let poses: Vec<f64> = found.poses.iter().flat_map(pose_gradient).collect();
        let shape = [found.poses.len(), 4, 4];
        let poses = if self.request.is_double {
            give(py, poses, shape)?
        } else {
            give(py, poses.iter().map(|&number| number as f32).collect(), shape)?
        };
        dict.set_item("viewmats", poses)?;
        let by_run: Vec<f32> = found.backgrounds.iter().flatten().map(|&number| number as f32).collect();
        let backgrounds = match self.request.backgrounds {
            Backgrounds::None => None,
            Backgrounds::One => Some(give(py, sum_of_rows(&found.backgrounds), [3])?),
            Backgrounds::PerCamera => Some(give(py, by_run, [found.backgrounds.len(), 3])?),
        };
        dict.set_item("backgrounds", backgrounds)?;
        dict.set_item("seconds", found.seconds)?;
        Ok(dict)
    }
}

/// Gradients by one colour that serves every run.
fn sum_of_rows(rows: &[[f64; 3]]) -> Vec<f32> {
    (0..3).map(|channel| rows.iter().map(|row| row[channel]).sum::<f64>() as f32).collect()
}
