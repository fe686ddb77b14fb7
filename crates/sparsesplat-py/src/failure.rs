//! Errors of the crates to Python exceptions, with their messages.

use pyo3::exceptions::{PyFileNotFoundError, PyOSError, PyPermissionError, PyRuntimeError, PyValueError};
use pyo3::{PyErr, PyResult};
use std::error::Error;
use std::io;

/// Whose fault an error is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Fault {
    /// The arguments, or what lies in a file: `ValueError`.
    Input,
    /// A device, or the work: `RuntimeError`.
    Work,
}

/// Errors that know whose fault they are.
pub(crate) trait Sorted: Error + 'static {
    fn fault(&self) -> Fault;
}

impl Sorted for gs_raster::Error {
    fn fault(&self) -> Fault {
        match self {
            Self::Setting { .. }
            | Self::TooManyIntersections { .. }
            | Self::OtherScene { .. }
            | Self::Views { .. }
            | Self::PixelGradientLength { .. }
            | Self::PixelGradientNotFinite { .. }
            | Self::NotBlended
            | Self::ArrayLength { .. }
            | Self::Coefficients { .. }
            | Self::NotFinite { .. }
            | Self::Scale { .. }
            | Self::Opacity { .. }
            | Self::Quaternion { .. }
            | Self::DepthNotRendered
            | Self::Scene(_) => Fault::Input,
            _ => Fault::Work,
        }
    }
}

impl Sorted for evaluate::Error {
    fn fault(&self) -> Fault {
        match self {
            Self::Render(error) => error.fault(),
            Self::Window(error) => error.fault(),
            Self::Predict(_) | Self::Scene(_) => Fault::Input,
            _ => Fault::Work,
        }
    }
}

impl Sorted for scene_windows::Error {
    fn fault(&self) -> Fault {
        match self {
            Self::Data(_)
            | Self::Predict(_)
            | Self::Scene(_)
            | Self::Simulate(_)
            | Self::NoContext
            | Self::OnePlace { .. }
            | Self::TooFewPictures { .. }
            | Self::NoDepthHint { .. } => Fault::Input,
            _ => Fault::Work,
        }
    }
}

/// Errors that are always of the input.
macro_rules! of_the_input {
    ($($error:ty),*) => {$(
        impl Sorted for $error {
            fn fault(&self) -> Fault {
                Fault::Input
            }
        }
    )*};
}

of_the_input!(
    entropy_sampler::Error,
    gs_scene::Error,
    image_metrics::Error,
    knn::Error,
    splat_formats::Error,
    view_data::Error
);

/// `map_err` into Python.
pub(crate) trait OrRaise<T> {
    /// The value, or the exception.
    fn or_raise(self) -> PyResult<T>;
}

impl<T, E: Sorted> OrRaise<T> for Result<T, E> {
    fn or_raise(self) -> PyResult<T> {
        self.map_err(|error| exception(&error))
    }
}

/// The exception of an error: `FileNotFoundError`, `PermissionError` or `OSError` where the operating system refused, else by the
/// fault.
fn exception(error: &impl Sorted) -> PyErr {
    let mut message = error.to_string();
    let mut kind = None;
    let mut cause = error.source();
    while let Some(error) = cause {
        let text = error.to_string();
        // Some messages hold their cause already.
        if !message.contains(&text) {
            message = format!("{message}: {text}");
        }
        kind = kind.or(error.downcast_ref::<io::Error>().map(io::Error::kind));
        cause = error.source();
    }
    match (kind, error.fault()) {
        (Some(io::ErrorKind::NotFound), _) => PyFileNotFoundError::new_err(message),
        (Some(io::ErrorKind::PermissionDenied), _) => PyPermissionError::new_err(message),
        (Some(_), _) => PyOSError::new_err(message),
        (None, Fault::Input) => PyValueError::new_err(message),
        (None, Fault::Work) => PyRuntimeError::new_err(message),
    }
}
