//! What the backward pass needs, and the backward pass.

use crate::arrays::{Side, give, read};
use crate::cameras::pose_gradient;
use crate::engine::{self, Caller, Engine, engine};
use crate::failure::OrRaise;
use crate::kept::{Kept, Numbers};
use crate::lent::lend;
use crate::rasterize::{Backgrounds, Depth, Drawn, Recording, Request};
use gs_raster::{Activated, ActivatedGradients, CameraGradient, Colors, Gradients, PixelGradients};
use gs_scene::{Gaussians, sh_coefficients};
use pyo3::exceptions::PyRuntimeError;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use rayon::prelude::*;
use std::borrow::Cow;
use std::time::Instant;

/// What `record` keeps for the backward pass.
#[pyclass(frozen, module = "sparsesplat")]
pub(crate) struct Tape {
    engine: &'static Engine,
    request: Request,
    recorded: Recorded,
    kept: Kept,
}

/// A recorded batch.
pub(crate) struct Recorded {
    /// One per run.
    tapes: Vec<gs_raster::Tape>,
    /// Alpha and expected depth of each view, where the picture holds accumulated depth.
    planes: Vec<(Vec<f32>, Vec<f32>)>,
}

/// Gradients by everything that was given to `record`.
struct Found {
    /// By the Gaussians.
    arrays: Vec<By>,
    cameras: Vec<CameraGradient>,
    /// Per run.
    backgrounds: Vec<[f64; 3]>,
    seconds: f64,
}

/// Gradients by an array.
struct By {
    name: &'static str,
    numbers: Vec<f32>,
    /// Shape of what belongs to one Gaussian.
    row: Vec<usize>,
}

impl Recorded {
    /// Draws and records; ends early if the caller is gone.
    pub(crate) fn draw(
        engine: &Engine,
        caller: &Caller,
        numbers: Numbers<'_>,
        request: &Request,
    ) -> gs_raster::Result<(Drawn, Self)> {
        let (drawn, tapes) = engine.rasterizer(request.device, |rasterizer| {
            let begin = Instant::now();
            let (mut views, mut tapes) = (Vec::new(), Vec::new());
            for run in &request.runs {
                let (drawn, tape) = match &numbers {
                    Numbers::Stored(gaussians) => rasterizer.record(gaussians, &run.cameras, &run.settings),
                    Numbers::Activated(arrays) => {
                        rasterizer.record_activated(arrays, &run.cameras, &run.settings)
                    }
                }?;
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
        Ok((drawn, Self { tapes, planes }))
    }
}

impl Tape {
    /// Pictures, and the tape of what was recorded.
    pub(crate) fn give<'py>(
        py: Python<'py>,
        engine: &'static Engine,
        request: Request,
        (drawn, recorded, kept): (Drawn, Recorded, Kept),
    ) -> PyResult<Recording<'py>> {
        let (colors, alphas, meta) = request.pictures(py, drawn)?;
        Ok((colors, alphas, meta, Self { engine, request, recorded, kept }))
    }

    /// The gradients by colours, alpha and depth of every view, run by run.
    fn pixels<'a>(&self, colors: &'a [f32], alphas: Option<&[f32]>) -> Vec<Vec<PixelGradients<'a>>> {
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
                let (opacity, expected) = &self.recorded.planes[view];
                for pixel in 0..pixels {
                    alpha[pixel] += depth[pixel] * expected[pixel];
                    depth[pixel] *= opacity[pixel];
                }
            }
            let image = match (mode.colors, channels) {
                (true, 3) => Cow::Borrowed(colors),
                (true, _) => colors.chunks_exact(channels).flat_map(|pixel| &pixel[..3]).copied().collect(),
                (false, _) => vec![0.0; pixels * 3].into(),
            };
            view += 1;
            PixelGradients { image, alpha, depth }
        };
        self.request.runs.iter().map(|run| run.cameras.iter().map(|_| next()).collect()).collect()
    }

    /// Gradients of a batch, given those by its pictures and alphas.
    fn differentiate(
        &self,
        numbers: Numbers<'_>,
        colors: &[f32],
        alphas: Option<&[f32]>,
    ) -> gs_raster::Result<Found> {
        let mut found =
            Found { arrays: Vec::new(), cameras: Vec::new(), backgrounds: Vec::new(), seconds: 0.0 };
        self.engine.rasterizer(self.request.device, |rasterizer| {
            let pixels = self.pixels(colors, alphas);
            let begin = Instant::now();
            for (tape, pixels) in self.recorded.tapes.iter().zip(&pixels) {
                match &numbers {
                    Numbers::Stored(gaussians) => {
                        let (geometry, sh) = (gaussians.geometry(), gaussians.sh());
                        let [geometry, sh] = [geometry, sh].map(|array| self.engine.buffer(array.len()));
                        let mut by = Gradients { geometry, sh, ..Gradients::default() };
                        rasterizer.backward_into(gaussians, tape, pixels, &mut by)?;
                        let arrays = by_stored(by.geometry, by.sh, gaussians.sh_degree());
                        found.add(self.engine, arrays, (by.background, by.cameras));
                    }
                    Numbers::Activated(arrays) => {
                        let mut by = self.buffers(arrays);
                        rasterizer.backward_activated_into(arrays, tape, pixels, &mut by)?;
                        let gaussians = [by.means, by.quats, by.scales, by.opacities, by.colors];
                        found.add(
                            self.engine,
                            by_arrays(gaussians, arrays.kind),
                            (by.background, by.cameras),
                        );
                    }
                }
            }
            found.seconds = begin.elapsed().as_secs_f64();
            Ok(())
        })?;
        if found.backgrounds.is_empty() {
            let zeros = |array: &[f32]| vec![0.0; array.len()];
            found.arrays = match numbers {
                Numbers::Stored(scene) => {
                    by_stored(zeros(scene.geometry()), zeros(scene.sh()), scene.sh_degree())
                }
                Numbers::Activated(arrays) => {
                    let Activated { means, quats, scales, opacities, colors, kind } = arrays;
                    by_arrays([means, quats, scales, opacities, colors].map(zeros), kind)
                }
            };
        }
        Ok(found)
    }

    /// Memory for gradients by arrays.
    fn buffers(&self, arrays: &Activated<'_>) -> ActivatedGradients {
        let Activated { means, quats, scales, opacities, colors, .. } = arrays;
        let [means, quats, scales, opacities, colors] =
            [means, quats, scales, opacities, colors].map(|array| self.engine.buffer(array.len()));
        ActivatedGradients { means, quats, scales, opacities, colors, ..ActivatedGradients::default() }
    }
}

/// Gradients by the arrays of [`Gaussians`].
fn by_stored(geometry: Vec<f32>, sh: Vec<f32>, degree: usize) -> Vec<By> {
    vec![
        By { name: "geometry", numbers: geometry, row: vec![Gaussians::GEOMETRY] },
        By { name: "sh", numbers: sh, row: vec![sh_coefficients(degree), 3] },
    ]
}

/// Gradients by the arrays that `record` takes.
fn by_arrays([means, quats, scales, opacities, colors]: [Vec<f32>; 5], kind: Colors) -> Vec<By> {
    let color = match kind {
        Colors::Rgb => vec![3],
        Colors::Sh { per_gaussian, .. } => vec![per_gaussian, 3],
    };
    vec![
        By { name: "means", numbers: means, row: vec![3] },
        By { name: "quats", numbers: quats, row: vec![4] },
        By { name: "scales", numbers: scales, row: vec![3] },
        By { name: "opacities", numbers: opacities, row: vec![] },
        By { name: "colors", numbers: colors, row: color },
    ]
}

impl Found {
    /// Adds the gradients of a run, whose memory goes back to the engine.
    fn add(
        &mut self,
        engine: &Engine,
        arrays: Vec<By>,
        (background, cameras): ([f64; 3], Vec<CameraGradient>),
    ) {
        if self.arrays.is_empty() {
            self.arrays = arrays;
        } else {
            for (sum, found) in self.arrays.iter_mut().zip(arrays) {
                sum.numbers.par_iter_mut().zip(&found.numbers).for_each(|(sum, found)| *sum += found);
                engine.recycle([found.numbers]);
            }
        }
        self.backgrounds.push(background);
        self.cameras.extend(cameras);
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
        if engine(py)?.process() != self.engine.process() {
            return Err(PyRuntimeError::new_err(
                "this tape was recorded by the parent of this process, record again after the fork",
            ));
        }
        let (width, height) = self.request.size;
        let count = self.request.runs.iter().map(|run| run.cameras.len()).sum();
        let shape = |channels| [Side::Is(count), Side::Is(height), Side::Is(width), Side::Is(channels)];
        let v_colors = read::<f32>("v_colors", v_colors, &shape(self.request.mode.channels()))?;
        let v_alphas = v_alphas.map(|array| read::<f32>("v_alphas", array, &shape(1))).transpose()?;
        let alphas = v_alphas.as_ref().map(|array| array.as_slice()).transpose()?;
        let colors = v_colors.as_slice()?;
        let held = self.kept.hold(py)?;
        let numbers = held.numbers()?;
        let found = engine::run_borrowing(py, true, |_| self.differentiate(numbers, colors, alphas))?;
        self.gradients(py, numbers.len(), found.or_raise()?)
    }
}

impl Tape {
    fn gradients<'py>(&self, py: Python<'py>, n: usize, found: Found) -> PyResult<Bound<'py, PyDict>> {
        let dict = PyDict::new(py);
        for By { name, numbers, row } in found.arrays {
            dict.set_item(name, lend(py, self.engine, numbers, [vec![n], row].concat())?)?;
        }
        let poses: Vec<f64> = found.cameras.iter().flat_map(pose_gradient).collect();
        let shape = [found.cameras.len(), 4, 4];
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
