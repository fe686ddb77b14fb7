//! `rasterize` and `record`: activated arrays and matrices in, pictures out.

use crate::arrays::{Side, give, read};
use crate::cameras::Cameras;
use crate::engine::{self, Caller, Engine, engine};
use crate::failure::OrRaise;
use crate::kept::{Kept, Numbers, fingerprint};
use crate::settings::without_sh_degree;
use crate::tape::{Recorded, Tape};
use gs_raster::{Activated, Colors, Device, Rasterizer, RenderSettings, Rendering};
use gs_scene::Camera;
use numpy::{PyArrayDyn, PyReadonlyArrayDyn, PyUntypedArrayMethods};
use pyo3::exceptions::{PyTypeError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use rayon::prelude::*;
use std::time::Instant;

/// Colours, alphas, meta.
pub(crate) type Pictures<'py> = (Bound<'py, PyAny>, Bound<'py, PyAny>, Bound<'py, PyDict>);
/// Colours, alphas, meta, tape.
pub(crate) type Recording<'py> = (Bound<'py, PyAny>, Bound<'py, PyAny>, Bound<'py, PyDict>, Tape);

/// Pictures of Gaussians: colours [C, height, width, X], alphas [C, height, width, 1], and a dict that says what was drawn.
#[pyfunction]
#[pyo3(
    signature = (means, quats, scales, opacities, colors, viewmats, Ks, width, height, **settings),
    text_signature = "(means, quats, scales, opacities, colors, viewmats, Ks, width, height, *, near_plane=0.01, \
                      far_plane=1e10, eps2d=0.3, sh_degree=None, backgrounds=None, render_mode='RGB', \
                      rasterize_mode='classic', device='auto', alpha_min=0.00392156862745098, alpha_max=0.99, \
                      transmittance_min=1e-4, compensation_min=0.005)"
)]
#[expect(non_snake_case, reason = "the name of the argument")]
#[expect(clippy::too_many_arguments, reason = "those of gsplat")]
pub(crate) fn rasterize<'py>(
    py: Python<'py>,
    means: &Bound<'py, PyAny>,
    quats: &Bound<'py, PyAny>,
    scales: &Bound<'py, PyAny>,
    opacities: &Bound<'py, PyAny>,
    colors: &Bound<'py, PyAny>,
    viewmats: &Bound<'py, PyAny>,
    Ks: &Bound<'py, PyAny>,
    width: usize,
    height: usize,
    settings: Option<&Bound<'py, PyDict>>,
) -> PyResult<Pictures<'py>> {
    let (sh_degree, settings) = without_sh_degree(settings)?;
    let cameras = Cameras::read(viewmats, Ks, width, height)?;
    let request = Request::read("rasterize", cameras, (width, height), settings.as_ref(), None)?;
    let arrays = Arrays::read(means, quats, scales, opacities, colors, sh_degree)?;
    let (arrays, engine) = (arrays.activated()?, engine(py)?);
    let drawn = engine::run_borrowing(py, request.is_one_piece(), |caller| {
        request.render(engine, caller, |rasterizer, cameras, settings| {
            rasterizer.render_activated(&arrays, cameras, settings)
        })
    })?;
    request.pictures(py, drawn.or_raise()?)
}

/// As rasterize, and a tape, whose method backward gives the gradients. The tape has no copy of the arrays: backward reads them again, and
/// they must hold the same numbers then.
#[pyfunction]
#[pyo3(
    signature = (means, quats, scales, opacities, colors, viewmats, Ks, width, height, **settings),
    text_signature = "(means, quats, scales, opacities, colors, viewmats, Ks, width, height, *, near_plane=0.01, \
                      far_plane=1e10, eps2d=0.3, sh_degree=None, backgrounds=None, render_mode='RGB', \
                      rasterize_mode='classic', device='auto', alpha_min=0.00392156862745098, alpha_max=0.99, \
                      transmittance_min=1e-4, compensation_min=0.005)"
)]
#[expect(non_snake_case, reason = "the name of the argument")]
#[expect(clippy::too_many_arguments, reason = "those of gsplat")]
pub(crate) fn record<'py>(
    py: Python<'py>,
    means: &Bound<'py, PyAny>,
    quats: &Bound<'py, PyAny>,
    scales: &Bound<'py, PyAny>,
    opacities: &Bound<'py, PyAny>,
    colors: &Bound<'py, PyAny>,
    viewmats: &Bound<'py, PyAny>,
    Ks: &Bound<'py, PyAny>,
    width: usize,
    height: usize,
    settings: Option<&Bound<'py, PyDict>>,
) -> PyResult<Recording<'py>> {
    let (sh_degree, settings) = without_sh_degree(settings)?;
    let cameras = Cameras::read(viewmats, Ks, width, height)?;
    let request = Request::read("record", cameras, (width, height), settings.as_ref(), None)?;
    let arrays = Arrays::read(means, quats, scales, opacities, colors, sh_degree)?;
    let (activated, engine) = (arrays.activated()?, engine(py)?);
    // Before the drawing: another thread of Python may change the arrays meanwhile.
    let drawn_from = fingerprint(&activated);
    let recorded = engine::run_borrowing(py, request.is_one_piece(), |caller| {
        Recorded::draw(engine, caller, Numbers::Activated(activated), &request)
    })?;
    let (drawn, recorded) = recorded.or_raise()?;
    let kept = Kept::InPlace(arrays.unbind(), drawn_from);
    Tape::give(py, engine, request, (drawn, recorded, kept))
}

/// What `device` stands for on this machine: the name of the adapter, or "cpu"; and why "auto" took the CPU.
#[pyfunction]
#[pyo3(signature = (device = "auto"))]
pub(crate) fn device(py: Python<'_>, device: &str) -> PyResult<(String, Option<String>)> {
    let (device, engine) = (engine::device(device)?, engine(py)?);
    engine::run(py, None, move |_| engine.rasterizer(device, |rasterizer| Ok(describe(rasterizer))))?
        .or_raise()
}

/// Activated Gaussians as numpy arrays.
pub(crate) struct Arrays<'py> {
    means: PyReadonlyArrayDyn<'py, f32>,
    quats: PyReadonlyArrayDyn<'py, f32>,
    scales: PyReadonlyArrayDyn<'py, f32>,
    opacities: PyReadonlyArrayDyn<'py, f32>,
    colors: PyReadonlyArrayDyn<'py, f32>,
    kind: Colors,
}

impl<'py> Arrays<'py> {
    /// # Errors
    /// `TypeError` or `ValueError` for arrays of another dtype, shape or layout.
    pub(crate) fn read(
        means: &Bound<'py, PyAny>,
        quats: &Bound<'py, PyAny>,
        scales: &Bound<'py, PyAny>,
        opacities: &Bound<'py, PyAny>,
        colors: &Bound<'py, PyAny>,
        sh_degree: Option<usize>,
    ) -> PyResult<Self> {
        let means = read::<f32>("means", means, &[Side::Any("N"), Side::Is(3)])?;
        let n = means.shape()[0];
        let quats = read::<f32>("quats", quats, &[Side::Is(n), Side::Is(4)])?;
        let scales = read::<f32>("scales", scales, &[Side::Is(n), Side::Is(3)])?;
        let opacities = read::<f32>("opacities", opacities, &[Side::Is(n)])?;
        let (colors, kind) = match sh_degree {
            None => (read::<f32>("colors", colors, &[Side::Is(n), Side::Is(3)])?, Colors::Rgb),
            Some(degree) => {
                let sh = read::<f32>("colors", colors, &[Side::Is(n), Side::Any("K"), Side::Is(3)])?;
                let per_gaussian = sh.shape()[1];
                // A degree that there is not is an error of the renderer.
                if degree <= 3 && per_gaussian < gs_scene::sh_coefficients(degree) {
                    return Err(PyValueError::new_err(format!(
                        "colors: {per_gaussian} SH coefficients per Gaussian, sh_degree {degree} needs {}",
                        gs_scene::sh_coefficients(degree)
                    )));
                }
                (sh, Colors::Sh { degree, per_gaussian })
            }
        };
        Ok(Self { means, quats, scales, opacities, colors, kind })
    }

    /// The arrays for later.
    pub(crate) fn unbind(&self) -> Unbound {
        let Self { means, quats, scales, opacities, colors, kind } = self;
        let arrays = [means, quats, scales, opacities, colors].map(|array| (**array).clone().unbind());
        let sh_degree = match *kind {
            Colors::Rgb => None,
            Colors::Sh { degree, .. } => Some(degree),
        };
        Unbound { arrays, sh_degree }
    }

    /// The arrays in place.
    pub(crate) fn activated(&self) -> PyResult<Activated<'_>> {
        Ok(Activated {
            means: self.means.as_slice()?,
            quats: self.quats.as_slice()?,
            scales: self.scales.as_slice()?,
            opacities: self.opacities.as_slice()?,
            colors: self.colors.as_slice()?,
            kind: self.kind,
        })
    }
}

/// [`Arrays`] that outlive a call.
pub(crate) struct Unbound {
    /// Means, quaternions, scales, opacities, colours.
    arrays: [Py<PyArrayDyn<f32>>; 5],
    sh_degree: Option<usize>,
}

impl Unbound {
    /// The arrays as they are now.
    ///
    /// # Errors
    /// As [`Arrays::read`].
    pub(crate) fn bind<'py>(&self, py: Python<'py>) -> PyResult<Arrays<'py>> {
        let [means, quats, scales, opacities, colors] =
            self.arrays.each_ref().map(|array| array.bind(py).as_any());
        Arrays::read(means, quats, scales, opacities, colors, self.sh_degree)
    }
}

/// What a picture consists of: gsplat's `render_mode`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Mode {
    /// Whether there are colours.
    pub(crate) colors: bool,
    /// Whether there is depth, in the last channel.
    pub(crate) depth: Option<Depth>,
}

/// Depth of a pixel, scene units; w are the shares of the Gaussians in it, z their z-depths.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Depth {
    /// Σ w z.
    Accumulated,
    /// Σ w z / Σ w, 0 where nothing is drawn.
    Expected,
}

impl Mode {
    fn of(name: &str) -> PyResult<Self> {
        let (colors, depth) = match name {
            "RGB" => (true, None),
            "D" => (false, Some(Depth::Accumulated)),
            "ED" => (false, Some(Depth::Expected)),
            "RGB+D" => (true, Some(Depth::Accumulated)),
            "RGB+ED" => (true, Some(Depth::Expected)),
            _ => {
                return Err(PyValueError::new_err(format!(
                    "render_mode is {name:?}, expected \"RGB\", \"D\", \"ED\", \"RGB+D\" or \"RGB+ED\""
                )));
            }
        };
        Ok(Self { colors, depth })
    }

    /// Numbers per pixel.
    pub(crate) fn channels(self) -> usize {
        3 * usize::from(self.colors) + usize::from(self.depth.is_some())
    }
}

/// Cameras that are rendered with the same settings.
#[derive(Debug, Clone)]
pub(crate) struct Run {
    pub(crate) cameras: Vec<Camera>,
    pub(crate) settings: RenderSettings,
}

/// Cameras that are drawn in one go: a GPU is given the scene once for them.
pub(crate) const TOGETHER: usize = 4;

/// What is asked for.
#[derive(Debug)]
pub(crate) struct Request {
    pub(crate) runs: Vec<Run>,
    pub(crate) mode: Mode,
    pub(crate) device: Device,
    /// Width and height, pixels.
    pub(crate) size: (usize, usize),
    /// Whether the matrices of the cameras were float64.
    pub(crate) is_double: bool,
    /// What the backgrounds were.
    pub(crate) backgrounds: Backgrounds,
}

/// The shape of `backgrounds`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Backgrounds {
    None,
    /// `[3]`: one for all.
    One,
    /// `[C, 3]`.
    PerCamera,
}

/// A batch as it was drawn.
pub(crate) struct Drawn {
    pub(crate) views: Vec<Rendering>,
    device: (String, Option<String>),
    /// Seconds in the renderer.
    seconds: f64,
}

impl Request {
    /// Reads the settings, named as gsplat's where they are its. Without a near plane, `near` gives one per camera.
    ///
    /// # Errors
    /// For settings that there are not, and for values that are none.
    pub(crate) fn read(
        function: &str,
        cameras: Cameras,
        size: (usize, usize),
        settings: Option<&Bound<'_, PyDict>>,
        near: Option<&dyn Fn(&Camera) -> f32>,
    ) -> PyResult<Self> {
        let mut shared = RenderSettings::default();
        let mut mode = Mode { colors: true, depth: None };
        let mut device = Device::Auto;
        let (mut backgrounds, mut colours) = (Backgrounds::None, Vec::new());
        let mut near = near;
        for (key, value) in settings.into_iter().flatten() {
            let name: String = key.extract()?;
            let number = |place: &mut f32| -> PyResult<()> {
                *place = value
                    .extract()
                    .map_err(|_| PyTypeError::new_err(format!("{name} is {value:?}, expected a number")))?;
                Ok(())
            };
            match name.as_str() {
                "near_plane" if near.is_some() && value.is_none() => {}
                "near_plane" => {
                    near = None;
                    number(&mut shared.near)?;
                }
                "far_plane" => number(&mut shared.far)?,
                "eps2d" => number(&mut shared.eps2d)?,
                "alpha_min" => number(&mut shared.alpha_min)?,
                "alpha_max" => number(&mut shared.alpha_max)?,
                "transmittance_min" => number(&mut shared.transmittance_min)?,
                "compensation_min" => number(&mut shared.compensation_min)?,
                "render_mode" => mode = Mode::of(&text(&name, &value)?)?,
                "device" => device = engine::device(&text(&name, &value)?)?,
                "rasterize_mode" => {
                    shared.antialias = match text(&name, &value)?.as_str() {
                        "classic" => false,
                        "antialiased" => true,
                        other => {
                            return Err(PyValueError::new_err(format!(
                                "rasterize_mode is {other:?}, expected \"classic\" or \"antialiased\""
                            )));
                        }
                    };
                }
                "backgrounds" if value.is_none() => {}
                "backgrounds" => {
                    let is_one =
                        value.getattr("ndim").and_then(|ndim| ndim.extract::<usize>()).is_ok_and(|n| n == 1);
                    let per_camera = [Side::Is(cameras.all.len()), Side::Is(3)];
                    let (kind, shape) = match is_one {
                        true => (Backgrounds::One, &per_camera[1..]),
                        false => (Backgrounds::PerCamera, &per_camera[..]),
                    };
                    backgrounds = kind;
                    colours = read::<f32>("backgrounds", &value, shape)?.as_slice()?.to_vec();
                }
                _ => {
                    return Err(PyTypeError::new_err(format!(
                        "{function}() got an unexpected keyword argument '{name}'"
                    )));
                }
            }
        }
        shared.depth = mode.depth.is_some();
        if backgrounds == Backgrounds::One {
            shared.background = [colours[0], colours[1], colours[2]];
        }
        let one_run = backgrounds != Backgrounds::PerCamera && near.is_none();
        let runs = if one_run {
            vec![Run { cameras: cameras.all, settings: shared }]
        } else {
            let run = |(index, camera): (usize, Camera)| {
                let mut settings = shared;
                if let Some(colour) =
                    colours.get(3 * index..3 * index + 3).filter(|_| backgrounds == Backgrounds::PerCamera)
                {
                    settings.background = [colour[0], colour[1], colour[2]];
                }
                if let Some(near) = near {
                    settings.near = near(&camera);
                }
                Run { cameras: vec![camera], settings }
            };
            cameras.all.into_iter().enumerate().map(run).collect()
        };
        Ok(Self { runs, mode, device, size, is_double: cameras.is_double, backgrounds })
    }

    /// Whether all cameras are drawn at once: between them nobody could stop.
    fn is_one_piece(&self) -> bool {
        match &self.runs[..] {
            [] => true,
            [run] => run.cameras.len() <= TOGETHER,
            _ => false,
        }
    }

    /// Draws every camera by `draw`; ends early if the caller is gone.
    pub(crate) fn render(
        &self,
        engine: &Engine,
        caller: &Caller,
        draw: impl Fn(&mut Rasterizer, &[Camera], &RenderSettings) -> gs_raster::Result<Vec<Rendering>>
        + Send
        + Sync,
    ) -> gs_raster::Result<Drawn> {
        engine.rasterizer(self.device, |rasterizer| {
            let begin = Instant::now();
            let mut views = Vec::new();
            for run in &self.runs {
                let mut rest = &run.cameras[..];
                // Of no cameras, too: what is wrong with the Gaussians is found by drawing them.
                loop {
                    let (cameras, after) = rest.split_at(rest.len().min(TOGETHER));
                    views.extend(draw(rasterizer, cameras, &run.settings)?);
                    caller.end_if_gone();
                    rest = after;
                    if rest.is_empty() {
                        break;
                    }
                }
            }
            Ok(Drawn::new(views, rasterizer, begin))
        })
    }

    /// What was drawn, as arrays, and the dict that tells of it.
    pub(crate) fn pictures<'py>(&self, py: Python<'py>, drawn: Drawn) -> PyResult<Pictures<'py>> {
        let (count, (width, height)) = (drawn.views.len(), self.size);
        let meta = PyDict::new(py);
        meta.set_item("width", width)?;
        meta.set_item("height", height)?;
        meta.set_item("n_cameras", count)?;
        let stats = || drawn.views.iter().map(|view| view.stats);
        meta.set_item("visible", stats().map(|stats| stats.visible).collect::<Vec<_>>())?;
        meta.set_item("rejected", stats().map(|stats| stats.rejected).collect::<Vec<_>>())?;
        meta.set_item("intersections", stats().map(|stats| stats.intersections).collect::<Vec<_>>())?;
        meta.set_item("device", &drawn.device.0)?;
        meta.set_item("fallback", &drawn.device.1)?;
        meta.set_item("seconds", drawn.seconds)?;
        let (mode, engine) = (self.mode, engine(py)?);
        let (colors, alphas) = match <[Rendering; 1]>::try_from(drawn.views) {
            // Nothing is copied.
            Ok([view]) if mode.depth.is_none() => (view.image.into_data(), view.alpha),
            Ok(view) => py.detach(|| engine.install(|| assemble(&view, mode))),
            Err(views) => py.detach(|| engine.install(|| assemble(&views, mode))),
        };
        let colors = give(py, colors, [count, height, width, mode.channels()])?;
        Ok((colors, give(py, alphas, [count, height, width, 1])?, meta))
    }
}

impl Drawn {
    pub(crate) fn new(views: Vec<Rendering>, rasterizer: &Rasterizer, begin: Instant) -> Self {
        let seconds = begin.elapsed().as_secs_f64();
        Self { views, device: describe(rasterizer), seconds }
    }
}

/// The pictures and the opacities of all views, one after the other.
fn assemble(views: &[Rendering], mode: Mode) -> (Vec<f32>, Vec<f32>) {
    let pixels = views.first().map_or(0, |view| view.alpha.len());
    let (channels, row) = (mode.channels(), 1 << 12);
    let mut colors = vec![0.0; views.len() * pixels * channels];
    for (view, out) in views.iter().zip(colors.chunks_exact_mut((pixels * channels).max(1))) {
        let depth = view.depth.as_deref().unwrap_or_default();
        out.par_chunks_mut(row * channels).enumerate().for_each(|(chunk, out)| {
            for (pixel, out) in (chunk * row..).zip(out.chunks_exact_mut(channels)) {
                if mode.colors {
                    out[..3].copy_from_slice(&view.image.data()[3 * pixel..][..3]);
                }
                match mode.depth {
                    None => {}
                    Some(Depth::Expected) => out[channels - 1] = depth[pixel],
                    Some(Depth::Accumulated) => out[channels - 1] = depth[pixel] * view.alpha[pixel],
                }
            }
        });
    }
    let alphas = views.iter().flat_map(|view| &view.alpha).copied().collect();
    (colors, alphas)
}

/// A string.
fn text(name: &str, value: &Bound<'_, PyAny>) -> PyResult<String> {
    value.extract().map_err(|_| PyTypeError::new_err(format!("{name} is {value:?}, expected a string")))
}

/// Name of the device, and why it is not a GPU where "auto" was asked for.
fn describe(rasterizer: &Rasterizer) -> (String, Option<String>) {
    #[cfg(feature = "gpu")]
    let name = rasterizer.adapter().map_or_else(|| "cpu".to_owned(), |adapter| adapter.name.clone());
    #[cfg(not(feature = "gpu"))]
    let name = "cpu".to_owned();
    (name, rasterizer.fallback().map(ToString::to_string))
}
