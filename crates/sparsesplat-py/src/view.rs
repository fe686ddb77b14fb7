//! Posed photographs.

use crate::arrays::{Side, give, read, read_f64};
use crate::cameras::{camera, lens, pose};
use crate::failure::OrRaise;
use gs_scene::{DepthMap, Image};
use numpy::PyUntypedArrayMethods;
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

/// A posed photograph.
#[pyclass(frozen, module = "sparsesplat")]
pub(crate) struct View(pub(crate) gs_scene::View);

#[pymethods]
impl View {
    #[new]
    #[pyo3(signature = (image, viewmat, K, depth = None, name = "view"))]
    #[expect(non_snake_case, reason = "the name of the argument")]
    fn new(
        image: &Bound<'_, PyAny>,
        viewmat: &Bound<'_, PyAny>,
        K: &Bound<'_, PyAny>,
        depth: Option<&Bound<'_, PyAny>>,
        name: &str,
    ) -> PyResult<Self> {
        let image = picture("image", image)?;
        let (width, height) = (image.width(), image.height());
        let (pose, _) = read_f64("viewmat", viewmat, &[Side::Is(4), Side::Is(4)])?;
        let (lens, _) = read_f64("K", K, &[Side::Is(3), Side::Is(3)])?;
        let camera = camera(&pose, &lens, width, height)?;
        let depth = match depth {
            None => None,
            Some(depth) => {
                let depth = read::<f32>("depth", depth, &[Side::Is(height), Side::Is(width)])?;
                Some(DepthMap::new(width, height, depth.as_slice()?.to_vec()).or_raise()?)
            }
        };
        Ok(Self(gs_scene::View::new(name, image, camera, depth).or_raise()?))
    }

    /// Colours, float32 [height, width, 3], 0 to 1.
    #[getter]
    fn image<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let image = self.0.image();
        give(py, image.data().to_vec(), [image.height(), image.width(), 3])
    }

    /// World-to-camera matrix, float64 [4, 4].
    #[getter]
    fn viewmat<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        give(py, pose(self.0.camera()), [4, 4])
    }

    /// Intrinsics, float64 [3, 3], pixels.
    #[getter]
    #[pyo3(name = "K")]
    fn intrinsics<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        give(py, lens(self.0.camera()), [3, 3])
    }

    /// Measured z-depth, float32 [height, width], 0 where there is none; or None.
    #[getter]
    fn depth<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyAny>>> {
        let array = |depth: &DepthMap| give(py, depth.data().to_vec(), [depth.height(), depth.width()]);
        self.0.depth().map(array).transpose()
    }

    /// Its name.
    #[getter]
    fn name(&self) -> &str {
        self.0.name()
    }

    /// Pixels per row.
    #[getter]
    fn width(&self) -> usize {
        self.0.camera().width()
    }

    /// Rows.
    #[getter]
    fn height(&self) -> usize {
        self.0.camera().height()
    }

    fn __repr__(&self) -> String {
        format!("View({:?}, {}x{})", self.name(), self.width(), self.height())
    }
}

/// A picture: uint8 `[height, width, 3]`, or float32 in 0..1.
///
/// # Errors
/// For another dtype, shape or layout, a float that is not finite, or one outside 0..1.
pub(crate) fn picture(name: &str, value: &Bound<'_, PyAny>) -> PyResult<Image> {
    let image = any_picture(name, value)?;
    if let Some(found) = image.data().iter().find(|value| !(0.0..=1.0).contains(*value)) {
        return Err(PyValueError::new_err(format!(
            "{name}: holds {found}, expected float32 from 0 to 1, or uint8"
        )));
    }
    Ok(image)
}

/// As [`picture`], with whatever floats.
pub(crate) fn any_picture(name: &str, value: &Bound<'_, PyAny>) -> PyResult<Image> {
    let shape = [Side::Any("height"), Side::Any("width"), Side::Is(3)];
    if is_bytes(value) {
        let bytes = read::<u8>(name, value, &shape)?;
        return Image::from_rgb8(bytes.shape()[1], bytes.shape()[0], bytes.as_slice()?).or_raise();
    }
    let floats = read::<f32>(name, value, &shape)?;
    Image::new(floats.shape()[1], floats.shape()[0], floats.as_slice()?.to_vec()).or_raise()
}

/// Whether this is an array of uint8.
pub(crate) fn is_bytes(value: &Bound<'_, PyAny>) -> bool {
    use numpy::PyArrayDescrMethods;
    let untyped = value.cast::<numpy::PyUntypedArray>();
    untyped.is_ok_and(|untyped| untyped.dtype().is_equiv_to(&numpy::dtype::<u8>(value.py())))
}
