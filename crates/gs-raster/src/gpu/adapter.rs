//! Which adapter to use.

use crate::{Error, Result};

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
}

/// The adapter that is used.
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
}

/// The best adapter of those that come into question.
pub(super) fn choose(choice: AdapterChoice) -> Result<wgpu::Adapter> {
    if wgpu::Instance::enabled_backend_features().is_empty() {
        return Err(Error::NoAdapter { found: "no graphics interface in this build".to_owned() });
    }
    let instance = wgpu::Instance::new(wgpu::InstanceDescriptor::new_without_display_handle_from_env());
    let adapters = pollster::block_on(instance.enumerate_adapters(wgpu::Backends::all()));
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
    let ranked = adapters.into_iter().filter_map(|adapter| Some((rank(&adapter)?, adapter)));
    // The first of the best: `min_by_key` keeps the order in which the system names them.
    let best = ranked.min_by_key(|(rank, _)| *rank).map(|(_, adapter)| adapter);
    best.ok_or_else(|| Error::NoAdapter {
        found: if names.is_empty() { "none at all".to_owned() } else { format!("only {}", names.join(", ")) },
    })
}

/// What an adapter says of itself.
pub(super) fn describe(adapter: &wgpu::Adapter) -> AdapterDescription {
    let info = adapter.get_info();
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
    }
}
