//! The GPU path as a whole. These tests need an adapter, a software one will do, and fail where there is none.

use gs_raster::gpu::{AdapterChoice, GpuOptions};

/// Any adapter, and NaN in every buffer before use.
pub(crate) const OPTIONS: GpuOptions = GpuOptions { adapter: AdapterChoice::OrSoftware, poison: true };
