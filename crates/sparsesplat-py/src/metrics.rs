//! Neighbours, entropy, PSNR and SSIM.
//!
//! These run on the caller's thread, on arrays that they borrow: other Python threads go on, Ctrl-C is heard when they are done.

use crate::arrays::{Side, give, read};
use crate::engine::engine;
use crate::failure::OrRaise;
use crate::view::any_picture;
use entropy_sampler::{Border, EntropyWindow};
use numpy::PyUntypedArrayMethods;
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

/// The exact k nearest neighbours of every point: indices uint32 [n, k] and squared distances float32 [n, k], nearest first.
#[pyfunction]
#[pyo3(signature = (points, k, queries = None))]
pub(crate) fn knn<'py>(
    py: Python<'py>,
    points: &Bound<'py, PyAny>,
    k: usize,
    queries: Option<&Bound<'py, PyAny>>,
) -> PyResult<(Bound<'py, PyAny>, Bound<'py, PyAny>)> {
    let points = read::<f32>("points", points, &[Side::Any("n"), Side::Is(3)])?;
    let queries = match queries {
        None => None,
        Some(queries) => Some(read::<f32>("queries", queries, &[Side::Any("m"), Side::Is(3)])?),
    };
    let points = points.as_slice()?.as_chunks().0;
    let queries = queries.as_ref().map(|queries| queries.as_slice()).transpose()?;
    let engine = engine(py)?;
    let neighbors = py.detach(|| {
        engine.install(|| match queries {
            None => ::knn::knn(points, k),
            Some(queries) => ::knn::query(points, queries.as_chunks().0, k),
        })
    });
    let ::knn::Neighbors { rows, k, indices, sq_distances } = neighbors.or_raise()?;
    Ok((give(py, indices, [rows, k])?, give(py, sq_distances, [rows, k])?))
}

/// Local Shannon entropy, bits, float32 [height, width].
#[pyfunction]
#[pyo3(signature = (image, window = 7, levels = 256, border = "reflect"))]
pub(crate) fn entropy<'py>(
    py: Python<'py>,
    image: &Bound<'py, PyAny>,
    window: usize,
    levels: usize,
    border: &str,
) -> PyResult<Bound<'py, PyAny>> {
    let border = match border {
        "reflect" => Border::Reflect,
        "clip" => Border::Clip,
        _ => {
            return Err(PyValueError::new_err(format!(
                "border is {border:?}, expected \"reflect\" or \"clip\""
            )));
        }
    };
    let window = EntropyWindow { size: window, levels, border };
    let is_grey = image.getattr("ndim").and_then(|ndim| ndim.extract::<usize>()).is_ok_and(|ndim| ndim == 2);
    let engine = engine(py)?;
    let (found, width, height) = if is_grey {
        let grey = read::<u8>("image", image, &[Side::Any("height"), Side::Any("width")])?;
        let (width, height, grey) = (grey.shape()[1], grey.shape()[0], grey.as_slice()?);
        let found = py.detach(|| engine.install(|| entropy_sampler::entropy(grey, width, height, window)));
        (found, width, height)
    } else {
        let image = any_picture("image", image)?;
        let (width, height) = (image.width(), image.height());
        let entropy = || entropy_sampler::entropy(&image.luma8(), width, height, window);
        (py.detach(|| engine.install(entropy)), width, height)
    };
    give(py, found.or_raise()?, [height, width])
}

/// Peak signal-to-noise ratio, decibels.
#[pyfunction]
pub(crate) fn psnr(py: Python<'_>, a: &Bound<'_, PyAny>, b: &Bound<'_, PyAny>) -> PyResult<f64> {
    let (a, b, engine) = (any_picture("a", a)?, any_picture("b", b)?, engine(py)?);
    py.detach(|| engine.install(|| image_metrics::psnr(&a, &b))).or_raise()
}

/// Structural similarity, -1 to 1.
#[pyfunction]
pub(crate) fn ssim(py: Python<'_>, a: &Bound<'_, PyAny>, b: &Bound<'_, PyAny>) -> PyResult<f64> {
    let (a, b, engine) = (any_picture("a", a)?, any_picture("b", b)?, engine(py)?);
    py.detach(|| engine.install(|| image_metrics::ssim(&a, &b))).or_raise()
}
