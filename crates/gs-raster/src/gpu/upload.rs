//! A scene on the GPU.

use super::context::Gpu;
use super::pool::Pooled;
use crate::{Error, Result};
use gs_scene::{Gaussians, sh_coefficients};
use gs_shaders::{Features, Splat};

/// The buffers of a scene.
#[derive(Debug)]
pub(super) struct Upload {
    pub(super) geometry: Pooled,
    pub(super) sh: Pooled,
    pub(super) n: u32,
    pub(super) sh_degree: u32,
}

impl Gpu {
    pub(super) fn upload(&self, gaussians: &Gaussians) -> Result<Upload> {
        let bytes = |numbers: usize| (numbers * size_of::<f32>()) as u64;
        self.check_size("geometry", bytes(gaussians.geometry().len()))?;
        self.check_size("SH coefficients", bytes(gaussians.sh().len()))?;
        self.check_size("footprints", (gaussians.len() * size_of::<Splat>()) as u64)?;
        let n = u32::try_from(gaussians.len()).map_err(|_| Error::TooLargeForGpu {
            what: "index",
            bytes: gaussians.len() as u64,
            limit: u64::from(u32::MAX),
        })?;
        let sh_degree = gaussians.sh_degree();
        assert_eq!(
            gaussians.sh().len(),
            gaussians.len() * sh_coefficients(sh_degree) * 3,
            "a scene's buffers fit"
        );
        Ok(Upload {
            geometry: self.pool.storage(gaussians.geometry()),
            sh: self.pool.storage(gaussians.sh()),
            n,
            sh_degree: sh_degree as u32,
        })
    }
}

impl Upload {
    pub(super) fn features(&self, antialias: bool, depth: bool) -> Features {
        Features { sh_degree: self.sh_degree, antialias, depth }
    }
}
