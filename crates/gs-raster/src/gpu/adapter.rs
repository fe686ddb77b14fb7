//! The choice of the adapter.

use crate::{Error, Result};
use gs_scene::{Gaussians, sh_coefficients};
use gs_shaders::Splat;

/// Which adapters come into question.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum AdapterChoice {
    /// Only real GPUs, discrete ones first.
    #[default]
    Real,
    /// Real GPUs, and if there is none a software adapter, which is slow and serves tests.
    OrSoftware,
}

/// How to start the GPU path.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct GpuOptions {
    /// Which adapters come into question.
    pub adapter: AdapterChoice,
    /// Fill every buffer with NaN before use, so that a pass that relies on what it did not write is found out. For tests.
    pub poison: bool,
    /// The largest buffer that a pass may use, bytes, if that is to be less than what the adapter offers.
    pub largest_binding: Option<u64>,
}

/// An adapter, and what it can hold.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct AdapterDescription {
    /// Name of the adapter.
    pub name: String,
    /// `discrete GPU`, `integrated GPU`, `virtual GPU`, `software` or `unknown`.
    pub kind: &'static str,
    /// Vulkan, Metal or Dx12.
    pub backend: String,
    /// Driver and its version.
    pub driver: String,
    /// Largest buffer that a pass can use, bytes.
    pub largest_binding: u64,
    is_real: bool,
}

impl AdapterDescription {
    /// Whether `Device::Auto` may take it: a real GPU.
    #[must_use]
    pub fn is_real(&self) -> bool {
        self.is_real
    }

    /// The most Gaussians of an SH degree whose buffers the adapter can use.
    #[must_use]
    pub fn most_gaussians(&self, sh_degree: usize) -> u64 {
        let numbers = Gaussians::GEOMETRY.max(sh_coefficients(sh_degree) * 3);
        let bytes = (numbers * size_of::<f32>()).max(size_of::<Splat>());
        (self.largest_binding / bytes as u64).min(u64::from(u32::MAX))
    }
}

/// Every adapter there is, in the order in which the system names them.
#[must_use]
pub fn adapters() -> Vec<AdapterDescription> {
    enumerate().iter().map(describe).collect()
}

fn enumerate() -> Vec<wgpu::Adapter> {
    if wgpu::Instance::enabled_backend_features().is_empty() {
        return Vec::new();
    }
    let instance = wgpu::Instance::new(wgpu::InstanceDescriptor::new_without_display_handle_from_env());
    pollster::block_on(instance.enumerate_adapters(wgpu::Backends::all()))
}

/// The adapters that come into question, at least one, the best first.
pub(super) fn choose(choice: AdapterChoice) -> Result<Vec<wgpu::Adapter>> {
    let adapters = enumerate();
    let names: Vec<String> = adapters
        .iter()
        .map(|adapter| {
            let about = describe(adapter);
            format!("{} ({}, {})", about.name, about.kind, about.backend)
        })
        .collect();
    let rank = |adapter: &wgpu::Adapter| match adapter.get_info().device_type {
        wgpu::DeviceType::DiscreteGpu => Some(0),
        wgpu::DeviceType::IntegratedGpu => Some(1),
        wgpu::DeviceType::VirtualGpu => Some(2),
        wgpu::DeviceType::Other | wgpu::DeviceType::Cpu if choice == AdapterChoice::OrSoftware => Some(3),
        _ => None,
    };
    let mut ranked: Vec<_> =
        adapters.into_iter().filter_map(|adapter| Some((rank(&adapter)?, adapter))).collect();
    if ranked.is_empty() {
        let found =
            if names.is_empty() { "none at all".to_owned() } else { format!("only {}", names.join(", ")) };
        return Err(Error::NoAdapter { found });
    }
    // A stable sort: equals stay in the order in which the system names them.
    ranked.sort_by_key(|(rank, _)| *rank);
    Ok(ranked.into_iter().map(|(_, adapter)| adapter).collect())
}

/// What an adapter says of itself.
pub(super) fn describe(adapter: &wgpu::Adapter) -> AdapterDescription {
    let (info, limits) = (adapter.get_info(), adapter.limits());
    AdapterDescription {
        name: info.name,
        kind: match info.device_type {
            wgpu::DeviceType::DiscreteGpu => "discrete GPU",
            wgpu::DeviceType::IntegratedGpu => "integrated GPU",
            wgpu::DeviceType::VirtualGpu => "virtual GPU",
            wgpu::DeviceType::Cpu => "software",
            wgpu::DeviceType::Other => "unknown",
        },
        backend: format!("{:?}", info.backend),
        driver: format!("{} {}", info.driver, info.driver_info).trim().to_owned(),
        largest_binding: limits.max_storage_buffer_binding_size.min(limits.max_buffer_size),
        is_real: matches!(
            info.device_type,
            wgpu::DeviceType::DiscreteGpu | wgpu::DeviceType::IntegratedGpu | wgpu::DeviceType::VirtualGpu
        ),
    }
}
