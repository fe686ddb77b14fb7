//! The differentiable chain after the head, as operations of candle: outputs to Gaussians, Gaussians to a picture. The loss of a
//! picture follows in `loss`.

use candle_core::{CpuStorage, CustomOp1, Layout, Result, Shape, Tensor, bail};
use gs_raster::{PixelGradients, Rasterizer, RenderSettings, Tape};
use gs_scene::{Camera, Gaussians, sh_coefficients};
use sparsesplat::learned::Decoder;
use std::sync::{Arc, Mutex, PoisonError};

/// SH degree of what is decoded.
const DEGREE: usize = 2;
/// Numbers per Gaussian in a tensor: 11 of geometry, 27 of SH.
const ROW: usize = Gaussians::GEOMETRY + sh_coefficients(DEGREE) * 3;

/// Numbers of a contiguous f32 tensor on the CPU.
pub(crate) fn numbers<'a>(storage: &'a CpuStorage, layout: &Layout) -> Result<&'a [f32]> {
    let CpuStorage::F32(values) = storage else { bail!("f32 is wanted") };
    match layout.contiguous_offsets() {
        Some((from, to)) => Ok(&values[from..to]),
        None => bail!("a contiguous tensor is wanted"),
    }
}

/// The numbers of a tensor.
pub(crate) fn values(tensor: &Tensor) -> Result<Vec<f32>> {
    tensor.flatten_all()?.to_vec1()
}

pub(crate) fn lock<T>(mutex: &Mutex<T>) -> std::sync::MutexGuard<'_, T> {
    // What a panicking thread left is not used again: each pass writes before it reads.
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Rows `[n, 38]` of Gaussians.
pub(crate) fn rows(gaussians: &Gaussians) -> Vec<f32> {
    let geometry = gaussians.geometry().chunks_exact(Gaussians::GEOMETRY);
    let sh = gaussians.sh().chunks_exact(ROW - Gaussians::GEOMETRY);
    geometry.zip(sh).flat_map(|(geometry, sh)| geometry.iter().chain(sh)).copied().collect()
}

/// Buffers of rows.
fn split(rows: &[f32]) -> (Vec<f32>, Vec<f32>) {
    let geometry = rows.chunks_exact(ROW).flat_map(|row| &row[..Gaussians::GEOMETRY]).copied().collect();
    let sh = rows.chunks_exact(ROW).flat_map(|row| &row[Gaussians::GEOMETRY..]).copied().collect();
    (geometry, sh)
}

/// Outputs of a head `[n, 38]` to Gaussians `[n + m, 38]` (geometry, then SH of degree 2); the last `m` are those of
/// the far shell, which no head touches.
pub(crate) struct Decode {
    pub(crate) decoder: Arc<Decoder>,
    pub(crate) shell: Arc<Gaussians>,
}

impl CustomOp1 for Decode {
    fn name(&self) -> &'static str {
        "decode"
    }

    fn cpu_fwd(&self, storage: &CpuStorage, layout: &Layout) -> Result<(CpuStorage, Shape)> {
        let mut gaussians = self.decoder.decode(numbers(storage, layout)?);
        let shell = Gaussians::clone(&self.shell).with_sh_degree(DEGREE).map_err(candle_core::Error::wrap)?;
        gaussians.append(&shell);
        Ok((CpuStorage::F32(rows(&gaussians)), (gaussians.len(), ROW).into()))
    }

    fn bwd(&self, outputs: &Tensor, _: &Tensor, by_gaussians: &Tensor) -> Result<Option<Tensor>> {
        let by_rows = values(&by_gaussians.narrow(0, 0, self.decoder.len())?)?;
        let (geometry, sh) = split(&by_rows);
        let by_outputs = self.decoder.backward(&values(outputs)?, &geometry, &sh);
        Ok(Some(Tensor::from_vec(by_outputs, outputs.shape(), outputs.device())?))
    }
}

/// Gaussians of rows `[n, 38]`.
pub(crate) fn gaussians(rows: &[f32]) -> Result<Gaussians> {
    let (geometry, sh) = split(rows);
    Gaussians::new(DEGREE, geometry, sh).map_err(candle_core::Error::wrap)
}

/// Gaussians `[n, 38]` to a picture `[height, width, 3]`.
pub(crate) struct Render {
    pub(crate) rasterizer: Arc<Mutex<Rasterizer>>,
    pub(crate) camera: Camera,
    pub(crate) settings: RenderSettings,
    /// The scene, and what the backward pass needs to know of the forward pass.
    pub(crate) tape: Mutex<Option<(Gaussians, Tape)>>,
}

impl CustomOp1 for Render {
    fn name(&self) -> &'static str {
        "render"
    }

    fn cpu_fwd(&self, storage: &CpuStorage, layout: &Layout) -> Result<(CpuStorage, Shape)> {
        let gaussians = gaussians(numbers(storage, layout)?)?;
        let camera = std::slice::from_ref(&self.camera);
        let (renderings, tape) = lock(&self.rasterizer)
            .record(&gaussians, camera, &self.settings)
            .map_err(candle_core::Error::wrap)?;
        *lock(&self.tape) = Some((gaussians, tape));
        let picture = renderings[0].image.data().to_vec();
        Ok((CpuStorage::F32(picture), (self.camera.height(), self.camera.width(), 3).into()))
    }

    fn bwd(&self, rows: &Tensor, _: &Tensor, by_picture: &Tensor) -> Result<Option<Tensor>> {
        let taken = lock(&self.tape).take();
        let Some((gaussians, tape)) = taken else { bail!("rendering has no tape: backward runs once") };
        let pixels = PixelGradients { image: values(by_picture)?.into(), alpha: None, depth: None };
        let gradients = lock(&self.rasterizer)
            .backward(&gaussians, &tape, &[pixels])
            .map_err(candle_core::Error::wrap)?;
        let by_geometry = gradients.geometry.chunks_exact(Gaussians::GEOMETRY);
        let by_sh = gradients.sh.chunks_exact(ROW - Gaussians::GEOMETRY);
        let by_rows: Vec<f32> =
            by_geometry.zip(by_sh).flat_map(|(g, s)| g.iter().chain(s)).copied().collect();
        Ok(Some(Tensor::from_vec(by_rows, rows.shape(), rows.device())?))
    }
}
