//! Operations without parameters.

use super::super::kernels::{self, Maps};
use super::{Engine, tensor, values};
use candle_core::{D, Result, Tensor};

/// Calls `f` with the maps of a tensor `[n, h, w, c]`.
fn on_maps(x: &Tensor, f: impl FnOnce(Maps<'_>) -> Vec<f32>) -> Result<Vec<f32>> {
    let (_, height, width, channels) = x.dims4()?;
    let values = values(x)?;
    Ok(f(Maps { values: &values, height, width, channels }))
}

/// Bilinear resize of `[n, h, w, c]` that maps corners to corners.
pub(in crate::depthsplat) fn bilinear(x: &Tensor, height: usize, width: usize) -> Result<Tensor> {
    let (count, old_height, old_width, channels) = x.dims4()?;
    if (old_height, old_width) == (height, width) {
        return Ok(x.clone());
    }
    match Engine::for_device(x.device()) {
        Engine::Kernels => {
            let y = on_maps(x, |maps| kernels::bilinear(maps, height, width))?;
            tensor(y, (count, height, width, channels))
        }
        Engine::Composed => {
            let x = x.permute((0, 3, 1, 2))?.contiguous()?.upsample_bilinear2d(height, width, true)?;
            x.permute((0, 2, 3, 1))?.contiguous()
        }
    }
}

/// Every pixel of `[n, h, w, c]` `factor` x `factor` times.
pub(in crate::depthsplat) fn nearest(x: &Tensor, factor: usize) -> Result<Tensor> {
    let (count, height, width, channels) = x.dims4()?;
    let shape = (count, height * factor, width * factor, channels);
    match Engine::for_device(x.device()) {
        Engine::Kernels => tensor(on_maps(x, |maps| kernels::nearest(maps, factor))?, shape),
        Engine::Composed => x
            .reshape((count, height, 1, width, 1, channels))?
            .broadcast_as((count, height, factor, width, factor, channels))?
            .contiguous()?
            .reshape(shape),
    }
}

/// `[n, h, w, factor · factor · c]` to `[n, factor h, factor w, c]`.
pub(in crate::depthsplat) fn upscaled(x: &Tensor, factor: usize) -> Result<Tensor> {
    let (count, height, width, all) = x.dims4()?;
    let channels = all / (factor * factor);
    let shape = (count, height * factor, width * factor, channels);
    match Engine::for_device(x.device()) {
        Engine::Kernels => tensor(on_maps(x, |maps| kernels::spread(maps, factor))?, shape),
        Engine::Composed => {
            let x = x.reshape((count, height, width, factor, factor, channels))?;
            x.permute([0, 1, 3, 2, 4, 5])?.contiguous()?.reshape(shape)
        }
    }
}

/// Several tensors joined along the channels.
pub(in crate::depthsplat) fn join(xs: &[&Tensor]) -> Result<Tensor> {
    Tensor::cat(xs, D::Minus1)?.contiguous()
}

/// max(x, 0).
pub(in crate::depthsplat) fn relu(x: &Tensor) -> Result<Tensor> {
    x.relu()
}

/// softmax over the last axis.
pub(in crate::depthsplat) fn softmax(engine: Engine, x: &Tensor) -> Result<Tensor> {
    match engine {
        Engine::Kernels => {
            let mut y = values(x)?.to_vec();
            kernels::softmax_rows(&mut y, x.dim(D::Minus1)?);
            tensor(y, x.shape())
        }
        Engine::Composed => candle_nn::ops::softmax_last_dim(x),
    }
}
