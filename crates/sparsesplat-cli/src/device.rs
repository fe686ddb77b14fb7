//! What pictures are rendered on.

use crate::arguments::Device;
use crate::driver;
use crate::failure::{Failure, Outcome};
use crate::summary::warn;
use gs_raster::gpu::AdapterDescription;
use gs_raster::{Error, Rasterizer};
use serde::Serialize;
use sparsesplat::NetworkDevice;
use std::fmt::{self, Display};

/// A rasterizer, to serve the whole command. A GPU that is there and cannot be used is told on standard error; that there
/// is none is nobody's fault.
pub(crate) fn rasterizer(device: Device) -> Outcome<Rasterizer> {
    let choice = match device {
        Device::Auto => gs_raster::Device::Auto,
        Device::Gpu => gs_raster::Device::Gpu,
        Device::Cpu => gs_raster::Device::Cpu,
    };
    let rasterizer = driver::quietly(|| Rasterizer::new(choice)).map_err(|error| match error {
        // A GPU was asked for where there is none.
        Error::NoAdapter { .. } => Failure::Input(error.into()),
        _ => Failure::Work(error.into()),
    })?;
    if let Some(error) = rasterizer.fallback().filter(|error| !matches!(error, Error::NoAdapter { .. })) {
        warn(&format!("rendering on the CPU: {}", with_causes(error)));
    }
    Ok(rasterizer)
}

/// Where networks are computed: a build for CUDA or Metal is for GPUs, unless `--device cpu` is said.
pub(crate) fn of_networks(device: Device) -> NetworkDevice {
    match device {
        Device::Auto | Device::Gpu if cfg!(feature = "cuda") => NetworkDevice::Cuda,
        Device::Auto | Device::Gpu if cfg!(feature = "metal") => NetworkDevice::Metal,
        Device::Auto | Device::Gpu | Device::Cpu => NetworkDevice::Cpu,
    }
}

/// What the pictures were rendered on, as `"device"` in JSON.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(crate) struct UsedDevice {
    /// Name of the adapter, or `cpu`.
    name: String,
    /// `cpu`, or what kind of adapter it is.
    kind: &'static str,
    /// Graphics interface of an adapter.
    backend: Option<String>,
    /// Driver of an adapter, and its version.
    driver: Option<String>,
    /// Why `auto` took the CPU.
    fallback: Option<String>,
}

impl UsedDevice {
    /// What a rasterizer renders on.
    pub(crate) fn of(rasterizer: &Rasterizer) -> Self {
        let fallback = rasterizer.fallback().map(with_causes);
        match rasterizer.adapter() {
            Some(AdapterDescription { name, kind, backend, driver, .. }) => Self {
                name: name.clone(),
                kind,
                backend: Some(backend.clone()),
                driver: Some(driver.clone()),
                fallback,
            },
            None => Self { name: "cpu".to_owned(), kind: "cpu", backend: None, driver: None, fallback },
        }
    }

    /// The line of a command's summary.
    pub(crate) fn line(&self) -> String {
        format!("rendered   on {self}")
    }
}

impl Display for UsedDevice {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match (&self.backend, &self.driver) {
            (Some(backend), Some(driver)) => write!(f, "{} ({}, {backend}, {driver})", self.name, self.kind),
            _ => write!(f, "the CPU"),
        }
    }
}

/// An error with its causes, on one line.
pub(crate) fn with_causes(error: &Error) -> String {
    let mut text = error.to_string();
    let mut cause = std::error::Error::source(error);
    while let Some(error) = cause {
        text = format!("{text}: {error}");
        cause = error.source();
    }
    text.replace('\n', " ")
}
