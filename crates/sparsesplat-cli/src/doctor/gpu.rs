//! The adapters of this machine, and whether the shaders compute what they should.

use crate::arguments::Device;
use crate::device::with_causes;
use crate::driver;
use gs_raster::gpu::{self, AdapterChoice, AdapterDescription, GpuOptions};
use gs_raster::{Error, Rasterizer};
use report_parts::count;
use serde::Serialize;

/// What was found.
#[derive(Debug, Serialize)]
pub(super) struct Gpus {
    adapters: Vec<Adapter>,
    shaders: Shaders,
}

/// An adapter, and what it can hold.
#[derive(Debug, Serialize)]
struct Adapter {
    name: String,
    kind: &'static str,
    backend: String,
    driver: String,
    largest_binding_bytes: u64,
    /// The most Gaussians that fit, by SH degree from 0 to 3.
    most_gaussians: [u64; 4],
}

/// The self-test of the shaders on the best adapter.
#[derive(Debug, Serialize)]
struct Shaders {
    result: Verdict,
    /// The adapter that passed.
    adapter: Option<String>,
    /// Why there is no pass.
    reason: Option<String>,
    /// By how much an output is off, relative to its largest value.
    error: Option<f32>,
    /// By how much it may be off.
    allowed: Option<f32>,
    /// Whether this is about a real GPU, not about a software adapter.
    real: bool,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
enum Verdict {
    Passed,
    Failed,
    NotTested,
}

/// Looks for adapters and tests the best one; with the CPU asked for, no driver is woken.
pub(super) fn examine(device: Device) -> Gpus {
    if device == Device::Cpu {
        let shaders =
            Shaders::without_pass(Verdict::NotTested, false, "--device cpu was asked for".to_owned());
        return Gpus { adapters: Vec::new(), shaders };
    }
    let options = GpuOptions { adapter: AdapterChoice::OrSoftware, ..GpuOptions::default() };
    let (found, started) = driver::quietly(|| (gpu::adapters(), Rasterizer::gpu(&options)));
    let real = found.iter().any(AdapterDescription::is_real);
    let shaders = Shaders::of(&started, real);
    Gpus { adapters: found.into_iter().map(Adapter::from).collect(), shaders }
}

impl From<AdapterDescription> for Adapter {
    fn from(about: AdapterDescription) -> Self {
        let most_gaussians = [0, 1, 2, 3].map(|degree| about.most_gaussians(degree));
        let AdapterDescription {
            name, kind, backend, driver, largest_binding: largest_binding_bytes, ..
        } = about;
        Self { name, kind, backend, driver, largest_binding_bytes, most_gaussians }
    }
}

impl Shaders {
    fn of(started: &Result<Rasterizer, Error>, real: bool) -> Self {
        match started {
            Ok(rasterizer) => Self {
                result: Verdict::Passed,
                adapter: rasterizer.adapter().map(|about| about.name.clone()),
                reason: None,
                error: None,
                allowed: None,
                real,
            },
            Err(error @ Error::NoAdapter { .. }) => {
                Self::without_pass(Verdict::NotTested, false, error.to_string())
            }
            Err(error) => {
                let (off, allowed) = match error {
                    &Error::SelfTest { found, allowed, .. } => (Some(found), Some(allowed)),
                    _ => (None, None),
                };
                Self { error: off, allowed, ..Self::without_pass(Verdict::Failed, real, with_causes(error)) }
            }
        }
    }

    fn without_pass(result: Verdict, real: bool, reason: String) -> Self {
        Self { result, adapter: None, reason: Some(reason), error: None, allowed: None, real }
    }
}

impl Gpus {
    /// The adapter that `--device auto` renders on; none is the CPU.
    pub(super) fn automatic(&self) -> Option<&str> {
        self.shaders.adapter.as_deref().filter(|_| self.shaders.real)
    }

    /// Whether a real GPU does not do what it should. A software adapter serves tests: it takes nothing from a user.
    pub(super) fn failed(&self) -> bool {
        self.shaders.real && self.shaders.result == Verdict::Failed
    }

    /// Lines for people.
    pub(super) fn lines(&self) -> Vec<String> {
        let mut lines: Vec<String> = self
            .adapters
            .iter()
            .map(|adapter| {
                format!(
                    "adapter    {} ({}, {}, {}), buffers up to {:.2} GB: {} Gaussians of SH degree 0, {} of degree 3",
                    adapter.name,
                    adapter.kind,
                    adapter.backend,
                    adapter.driver,
                    adapter.largest_binding_bytes as f64 / 1e9,
                    count(adapter.most_gaussians[0] as f64),
                    count(adapter.most_gaussians[3] as f64),
                )
            })
            .collect();
        let Shaders { result, adapter, reason, .. } = &self.shaders;
        let reason = reason.as_deref().unwrap_or_default();
        lines.push(match result {
            Verdict::Passed => {
                format!("shaders    passed on {}", adapter.as_deref().unwrap_or("the adapter"))
            }
            Verdict::Failed => format!("shaders    FAILED: {reason}"),
            Verdict::NotTested => format!("shaders    not tested: {reason}"),
        });
        lines.push(format!(
            "renders    on {} unless --device says otherwise",
            self.automatic().unwrap_or("the CPU")
        ));
        lines
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn absence_is_no_failure_and_a_wrong_gpu_is() {
        let none = Shaders::of(&Err(Error::NoAdapter { found: "none at all".to_owned() }), false);
        let wrong = || {
            Err(Error::SelfTest { adapter: "Card".to_owned(), output: "image", found: 0.25, allowed: 1e-5 })
        };
        let gpus = |shaders| Gpus { adapters: Vec::new(), shaders };
        let none = gpus(none);
        assert!(!none.failed() && none.automatic().is_none());
        assert!(none.lines().concat().contains("not tested: no GPU"), "{:?}", none.lines());
        let real = gpus(Shaders::of(&wrong(), true));
        assert!(real.failed() && real.automatic().is_none());
        assert_eq!((real.shaders.error, real.shaders.allowed), (Some(0.25), Some(1e-5)));
        assert!(real.lines().concat().contains("FAILED: the adapter Card fails the self-test"));
        assert!(!gpus(Shaders::of(&wrong(), false)).failed(), "a software adapter");
    }

    #[test]
    fn with_the_cpu_asked_for_no_adapter_is_looked_at() {
        let gpus = examine(Device::Cpu);
        assert!(gpus.adapters.is_empty() && !gpus.failed());
        assert_eq!(gpus.shaders.result, Verdict::NotTested);
    }
}
