//! Numpy arrays on memory of the engine, which is used again when the last array on it goes: PyTorch holds the gradients of a step until
//! the next one, and memory that is given back to the system in between has to be made anew.

#![allow(
    unsafe_code,
    reason = "numpy does not know who owns an array's memory but by the object that it keeps alive"
)]

use crate::engine::Engine;
use numpy::PyArray;
use numpy::ndarray::{ArrayViewMut, IntoDimension, ShapeError};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

/// What an array on lent memory keeps alive.
#[pyclass(module = "sparsesplat")]
struct Lent {
    numbers: Vec<f32>,
    engine: &'static Engine,
}

impl Drop for Lent {
    fn drop(&mut self) {
        self.engine.recycle([std::mem::take(&mut self.numbers)]);
    }
}

/// An array of this shape on `numbers`, without a copy; their memory goes back to the engine afterwards.
pub(crate) fn lend<'py>(
    py: Python<'py>,
    engine: &'static Engine,
    numbers: Vec<f32>,
    shape: impl IntoDimension,
) -> PyResult<Bound<'py, PyAny>> {
    let owner = Bound::new(py, Lent { numbers, engine })?;
    let mut lent = owner.borrow_mut();
    let wrong = |error: ShapeError| PyValueError::new_err(format!("an array of another length: {error}"));
    let view = ArrayViewMut::from_shape(shape.into_dimension(), &mut lent.numbers[..]).map_err(wrong)?;
    // SAFETY: the array keeps `owner` alive, which keeps its numbers where they are until it is dropped. `Lent` has neither constructor nor
    // method, so that no code borrows or replaces them before that, though Python sees it as the array's base; this borrow ends here.
    let array = unsafe { PyArray::borrow_from_array(&view, owner.clone().into_any()) };
    drop(lent);
    Ok(array.into_any())
}
