//! Numpy arrays in and out.

use numpy::ndarray::IntoDimension;
use numpy::{
    Element, PyArray1, PyArrayDescrMethods, PyArrayDyn, PyArrayMethods, PyReadonlyArrayDyn, PyUntypedArray,
    PyUntypedArrayMethods,
};
use pyo3::exceptions::{PyTypeError, PyValueError};
use pyo3::prelude::*;

/// A side of a shape: a number, or one that is read off under this letter.
#[derive(Debug, Clone, Copy)]
pub(crate) enum Side {
    Is(usize),
    Any(&'static str),
}

use Side::{Any, Is};

/// The numpy array `value`, with dtype `T`, this shape and C-contiguous; otherwise an exception that names the argument.
///
/// # Errors
/// `TypeError` for another type or dtype, `ValueError` for another shape or layout.
pub(crate) fn read<'py, T: Element>(
    name: &str,
    value: &Bound<'py, PyAny>,
    shape: &[Side],
) -> PyResult<PyReadonlyArrayDyn<'py, T>> {
    let expected = numpy::dtype::<T>(value.py());
    let Ok(untyped) = value.cast::<PyUntypedArray>() else {
        let found = value.get_type().name()?;
        return Err(PyTypeError::new_err(format!(
            "{name}: expected a numpy array of {expected}, found {found}"
        )));
    };
    if !untyped.dtype().is_equiv_to(&expected) {
        let found = untyped.dtype();
        return Err(PyTypeError::new_err(format!(
            "{name}: expected dtype {expected}, found {found}: convert it, in numpy by .astype(numpy.{expected})"
        )));
    }
    let fits = |(side, &found): (&Side, &usize)| match *side {
        Is(expected) => expected == found,
        Any(_) => true,
    };
    if untyped.ndim() != shape.len() || !shape.iter().zip(untyped.shape()).all(fits) {
        let sides: Vec<String> = shape
            .iter()
            .map(|side| match side {
                Is(number) => number.to_string(),
                Any(letter) => (*letter).to_owned(),
            })
            .collect();
        return Err(PyValueError::new_err(format!(
            "{name}: expected shape [{}], found {:?}",
            sides.join(", "),
            untyped.shape()
        )));
    }
    // A slice is had of Fortran's order, too: whether it is C's is asked of the array.
    if !untyped.is_c_contiguous() || !untyped.is_aligned() {
        return Err(PyValueError::new_err(format!(
            "{name}: not C-contiguous: make it so, by numpy.ascontiguousarray({name})"
        )));
    }
    value.cast::<PyArrayDyn<T>>()?.try_readonly().map_err(|error| {
        PyValueError::new_err(format!("{name}: cannot be read while another call writes it: {error}"))
    })
}

/// As [`read`], for an argument that may be float32 or float64.
pub(crate) fn read_f64(name: &str, value: &Bound<'_, PyAny>, shape: &[Side]) -> PyResult<(Vec<f64>, bool)> {
    let is_double = value
        .cast::<PyUntypedArray>()
        .is_ok_and(|untyped| untyped.dtype().is_equiv_to(&numpy::dtype::<f64>(value.py())));
    if is_double {
        Ok((read::<f64>(name, value, shape)?.as_slice()?.to_vec(), true))
    } else {
        let single = read::<f32>(name, value, shape)?;
        Ok((single.as_slice()?.iter().map(|&number| f64::from(number)).collect(), false))
    }
}

/// An array that takes `data` over, without a copy.
pub(crate) fn give<T: Element>(
    py: Python<'_>,
    data: Vec<T>,
    shape: impl IntoDimension,
) -> PyResult<Bound<'_, PyAny>> {
    Ok(PyArray1::from_vec(py, data).reshape(shape)?.into_any())
}
