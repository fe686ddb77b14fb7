//! Scenes: stored Gaussians that are rendered, written and read without changing a bit.

use crate::arrays::{Side, give, read};
use crate::cameras::Cameras;
use crate::engine::{self, engine};
use crate::failure::OrRaise;
use crate::kept::{Kept, Numbers};
use crate::rasterize::{Arrays, Pictures, Recording, Request};
use crate::reconstruct::Report;
use crate::tape::{Recorded, Tape};
use gs_raster::near_plane;
use gs_scene::{Gaussians, LOG_SCALE, MEAN, OPACITY_LOGIT, QUATERNION, sh_coefficients};
use numpy::PyUntypedArrayMethods;
use pyo3::exceptions::{PyUserWarning, PyValueError};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use splat_formats::{read_scene, write_scene};
use std::ffi::CString;
use std::path::PathBuf;
use std::sync::Arc;

/// A set of 3D Gaussians in the stored parametrisation.
#[pyclass(frozen, module = "sparsesplat")]
pub(crate) struct Scene {
    gaussians: Arc<Gaussians>,
    /// How it came about, if it was reconstructed here.
    report: Option<Report>,
}

impl Scene {
    pub(crate) fn new(gaussians: Gaussians, report: Option<Report>) -> Self {
        Self { gaussians: Arc::new(gaussians), report }
    }

    fn column(&self, columns: std::ops::Range<usize>) -> Vec<f32> {
        let rows = self.gaussians.geometry().chunks_exact(Gaussians::GEOMETRY);
        rows.flat_map(|row| row[columns.clone()].iter().copied()).collect()
    }

    /// What is asked for; the near plane follows the scene if none is given.
    fn request(
        &self,
        function: &str,
        [viewmats, ks]: [&Bound<'_, PyAny>; 2],
        (width, height): (usize, usize),
        settings: Option<&Bound<'_, PyDict>>,
    ) -> PyResult<Request> {
        let cameras = Cameras::read(viewmats, ks, width, height)?;
        let near = |camera: &_| near_plane(&self.gaussians, camera);
        Request::read(function, cameras, (width, height), settings, Some(&near))
    }
}

#[pymethods]
impl Scene {
    /// A scene of the arrays that rasterize takes.
    #[new]
    #[pyo3(signature = (means, quats, scales, opacities, colors, sh_degree = None))]
    fn of_arrays(
        py: Python<'_>,
        means: &Bound<'_, PyAny>,
        quats: &Bound<'_, PyAny>,
        scales: &Bound<'_, PyAny>,
        opacities: &Bound<'_, PyAny>,
        colors: &Bound<'_, PyAny>,
        sh_degree: Option<usize>,
    ) -> PyResult<Self> {
        let arrays = Arrays::read(means, quats, scales, opacities, colors, sh_degree)?;
        let (arrays, engine) = (arrays.activated()?, engine(py)?);
        Ok(Self::new(py.detach(|| engine.install(|| arrays.store())).or_raise()?, None))
    }

    /// A scene of what is stored: geometry float32 [N, 11], sh float32 [N, (degree+1)², 3].
    #[staticmethod]
    fn from_stored(geometry: &Bound<'_, PyAny>, sh: &Bound<'_, PyAny>) -> PyResult<Self> {
        let geometry = read::<f32>("geometry", geometry, &[Side::Any("N"), Side::Is(Gaussians::GEOMETRY)])?;
        let shape = [Side::Is(geometry.shape()[0]), Side::Any("K"), Side::Is(3)];
        let sh = read::<f32>("sh", sh, &shape)?;
        let found = sh.shape()[1];
        let Some(degree) = (0..=3).find(|&degree| sh_coefficients(degree) == found) else {
            return Err(PyValueError::new_err(format!(
                "sh: {found} SH coefficients per Gaussian, expected 1, 4, 9 or 16"
            )));
        };
        let buffers = (geometry.as_slice()?.to_vec(), sh.as_slice()?.to_vec());
        Ok(Self::new(Gaussians::new(degree, buffers.0, buffers.1).or_raise()?, None))
    }

    /// The Gaussians as arrays: means, quats, scales, opacities, sh. New arrays with every look.
    #[getter]
    fn gaussians<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let n = self.gaussians.len();
        let (scales, opacities) = activate(&self.gaussians);
        let arrays = (
            give(py, self.column(MEAN), [n, 3])?,
            give(py, self.column(QUATERNION), [n, 4])?,
            give(py, scales, [n, 3])?,
            give(py, opacities, [n])?,
            self.sh(py)?,
        );
        py.import("sparsesplat")?.getattr("Gaussians")?.call1(arrays)
    }

    /// What is stored of the geometry, float32 [N, 11]: mean, quaternion (w, x, y, z), ln scale, logit of the opacity. A copy.
    #[getter]
    fn geometry<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        give(py, self.gaussians.geometry().to_vec(), [self.gaussians.len(), Gaussians::GEOMETRY])
    }

    /// SH coefficients, float32 [N, (degree+1)², 3]. A copy.
    #[getter]
    fn sh<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let coefficients = sh_coefficients(self.gaussians.sh_degree());
        give(py, self.gaussians.sh().to_vec(), [self.gaussians.len(), coefficients, 3])
    }

    /// SH degree, 0 to 3.
    #[getter]
    fn sh_degree(&self) -> usize {
        self.gaussians.sh_degree()
    }

    /// How the scene was reconstructed; None for one that was read or put together.
    #[getter]
    fn report<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyDict>>> {
        self.report.as_ref().map(|report| report.to_dict(py)).transpose()
    }

    /// Wall time of each stage of the reconstruction, seconds; None for a scene that was read or put together.
    #[getter]
    fn seconds<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyDict>>> {
        self.report.as_ref().map(|report| report.seconds(py)).transpose()
    }

    /// Pictures of the scene, as those of rasterize. The near plane follows the scene if none is given.
    #[pyo3(
        signature = (viewmats, Ks, width, height, **settings),
        text_signature = "($self, viewmats, Ks, width, height, *, near_plane=None, far_plane=1e10, eps2d=0.3, \
                          backgrounds=None, render_mode='RGB', rasterize_mode='classic', device='auto', alpha_min=0.00392156862745098, \
                          alpha_max=0.99, transmittance_min=1e-4, compensation_min=0.005)"
    )]
    #[expect(non_snake_case, reason = "the name of the argument")]
    fn render<'py>(
        &self,
        py: Python<'py>,
        viewmats: &Bound<'py, PyAny>,
        Ks: &Bound<'py, PyAny>,
        width: usize,
        height: usize,
        settings: Option<&Bound<'py, PyDict>>,
    ) -> PyResult<Pictures<'py>> {
        let request = self.request("render", [viewmats, Ks], (width, height), settings)?;
        let (engine, gaussians) = (engine(py)?, Arc::clone(&self.gaussians));
        let (drawn, request) = engine::run(py, None, move |caller| {
            let drawn = request.render(engine, caller, |rasterizer, cameras, settings| {
                rasterizer.render_views(&gaussians, cameras, settings)
            });
            (drawn, request)
        })?;
        request.pictures(py, drawn.or_raise()?)
    }

    /// As render, and a tape, whose method backward gives the gradients by geometry and sh.
    #[pyo3(
        signature = (viewmats, Ks, width, height, **settings),
        text_signature = "($self, viewmats, Ks, width, height, *, near_plane=None, far_plane=1e10, eps2d=0.3, \
                          backgrounds=None, render_mode='RGB', rasterize_mode='classic', device='auto', alpha_min=0.00392156862745098, \
                          alpha_max=0.99, transmittance_min=1e-4, compensation_min=0.005)"
    )]
    #[expect(non_snake_case, reason = "the name of the argument")]
    fn record<'py>(
        &self,
        py: Python<'py>,
        viewmats: &Bound<'py, PyAny>,
        Ks: &Bound<'py, PyAny>,
        width: usize,
        height: usize,
        settings: Option<&Bound<'py, PyDict>>,
    ) -> PyResult<Recording<'py>> {
        let request = self.request("record", [viewmats, Ks], (width, height), settings)?;
        let (engine, gaussians) = (engine(py)?, Arc::clone(&self.gaussians));
        let (recorded, request) = engine::run(py, None, move |caller| {
            let recorded = Recorded::draw(engine, caller, Numbers::Stored(&gaussians), &request);
            (recorded, request)
        })?;
        let (drawn, recorded) = recorded.or_raise()?;
        Tape::give(py, engine, request, (drawn, recorded, Kept::Stored(Arc::clone(&self.gaussians))))
    }

    /// Writes the scene in the format that the extension says: .ply, .compressed.ply, .spz, .splat or .glb. The file appears whole or not
    /// at all. Returns what the format does not keep, in words; of a PLY nothing.
    fn save(&self, py: Python<'_>, path: PathBuf) -> PyResult<Vec<String>> {
        let gaussians = &*self.gaussians;
        let losses = py.detach(move || write_scene(&path, gaussians)).or_raise()?;
        Ok(losses.iter().map(ToString::to_string).collect())
    }

    fn __len__(&self) -> usize {
        self.gaussians.len()
    }

    fn __repr__(&self) -> String {
        format!("Scene({} Gaussians, SH degree {})", self.gaussians.len(), self.gaussians.sh_degree())
    }
}

/// Reads a scene from a PLY file in the layout of 3D Gaussian splatting, or from any other file that [`Scene::save`] writes; the format is
/// recognised by its first bytes. What is in the file and not read is a `UserWarning`.
#[pyfunction]
pub(crate) fn load_ply(py: Python<'_>, path: PathBuf) -> PyResult<Scene> {
    let (read, path) = py.detach(move || (read_scene(&path), path));
    let read = read.or_raise()?;
    for remark in &read.remarks {
        let text = CString::new(format!("{}: {remark}", path.display()))?;
        PyErr::warn(py, &py.get_type::<PyUserWarning>(), &text, 1)?;
    }
    Ok(Scene::new(read.gaussians, None))
}

/// Standard deviations `[N, 3]` and opacities `[N]` of stored Gaussians.
fn activate(stored: &Gaussians) -> (Vec<f32>, Vec<f32>) {
    let rows = || stored.geometry().chunks_exact(Gaussians::GEOMETRY);
    let scales = rows().flat_map(|row| row[LOG_SCALE].iter().map(|log| log.exp())).collect();
    let opacities = rows().map(|row| gs_scene::sigmoid(row[OPACITY_LOGIT])).collect();
    (scales, opacities)
}
