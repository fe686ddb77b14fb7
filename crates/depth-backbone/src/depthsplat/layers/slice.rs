//! Tensors of the CPU as slices.

use candle_core::{CpuStorage, DType, Device, Result, Shape, Storage, StorageRef, Tensor, bail};
use std::ops::Deref;

/// The values of a contiguous f32 tensor on the CPU, row-major.
pub(in crate::depthsplat) struct Values<'a> {
    storage: StorageRef<'a>,
    start: usize,
    end: usize,
}

impl Deref for Values<'_> {
    type Target = [f32];

    fn deref(&self) -> &[f32] {
        match &*self.storage {
            Storage::Cpu(CpuStorage::F32(all)) => &all[self.start..self.end],
            _ => &[],
        }
    }
}

/// The values of a tensor.
///
/// # Errors
/// If it is not a contiguous f32 tensor on the CPU.
pub(in crate::depthsplat) fn values(tensor: &Tensor) -> Result<Values<'_>> {
    if tensor.dtype() != DType::F32 || !tensor.device().is_cpu() {
        bail!("expected an f32 tensor on the CPU, found {:?} on {:?}", tensor.dtype(), tensor.device());
    }
    let (storage, layout) = tensor.storage_and_layout();
    match layout.contiguous_offsets() {
        Some((start, end)) => Ok(Values { storage, start, end }),
        None => bail!("expected a contiguous tensor, found {layout:?}"),
    }
}

/// A tensor on the CPU.
pub(in crate::depthsplat) fn tensor(values: Vec<f32>, shape: impl Into<Shape>) -> Result<Tensor> {
    Tensor::from_vec(values, shape.into(), &Device::Cpu)
}
