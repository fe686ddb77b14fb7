//! Settings by name, as a call gives them.

use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::PyDict;

/// `sh_degree`, which belongs to the Gaussians, and a copy of the settings without it.
pub(crate) fn without_sh_degree<'py>(
    settings: Option<&Bound<'py, PyDict>>,
) -> PyResult<(Option<usize>, Option<Bound<'py, PyDict>>)> {
    let settings = settings.map(|settings| settings.copy()).transpose()?;
    let degree = match take(settings.as_ref(), "sh_degree")? {
        None => None,
        Some(value) => value.extract().map_err(|_| {
            PyValueError::new_err(format!(
                "sh_degree is {value}, expected None or a whole number from 0 to 3"
            ))
        })?,
    };
    Ok((degree, settings))
}

/// A setting, which is removed from the others.
fn take<'py>(settings: Option<&Bound<'py, PyDict>>, name: &str) -> PyResult<Option<Bound<'py, PyAny>>> {
    let Some(settings) = settings else { return Ok(None) };
    let value = settings.get_item(name)?;
    if value.is_some() {
        settings.del_item(name)?;
    }
    Ok(value)
}
