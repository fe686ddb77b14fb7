//! The fused form as an operation of candle.

use super::{Tape, backward, forward, forward_recorded};
use crate::{Config, Inputs, Layout, OUTPUTS};
use candle_core::{CpuStorage, CustomOp3, Layout as Strides, Result, Shape, Tensor, bail};
use std::sync::{Arc, Mutex, PoisonError};

/// Who sees whom: what of [`Inputs`] has no gradient.
#[derive(Debug, Clone)]
pub struct Neighbourhood {
    /// Neighbours per anchor.
    pub k: usize,
    /// As [`Inputs::neighbours`].
    pub neighbours: Arc<[u32]>,
    /// As [`Inputs::relative`].
    pub relative: Arc<[[f32; 3]]>,
    /// As [`Inputs::cells`].
    pub cells: Arc<[[u32; 2]]>,
}

/// Outputs `[n, 38]` from `weights` `[Layout::len]`, `geometry` `[n, config.geometry]` and `image`
/// `[n, config.image]`, which are contiguous tensors of f32 on the CPU. Has gradients by all three; what they need of
/// the forward pass is kept until the result is dropped, and not at all if none of the three is a variable or
/// follows from one.
///
/// # Errors
/// If a tensor is of another type, shape or device, or strided; if [`Inputs::check`] fails.
pub fn apply(
    config: &Config,
    weights: &Tensor,
    geometry: &Tensor,
    image: &Tensor,
    neighbourhood: &Neighbourhood,
) -> Result<Tensor> {
    let n = geometry.dims2()?.0;
    let shapes = [
        ("weights", weights, vec![Layout::new(config).len]),
        ("geometry", geometry, vec![n, config.geometry]),
        ("image", image, vec![n, config.image]),
    ];
    for (name, tensor, shape) in shapes {
        if tensor.dims() != shape {
            bail!("{name}: shape {:?}, expected {shape:?}", tensor.dims());
        }
        if !tensor.device().is_cpu() {
            bail!("{name}: on {:?}, expected the CPU", tensor.device().location());
        }
    }
    let op = Op { config: *config, n, neighbourhood: neighbourhood.clone(), tape: Mutex::new(None) };
    if [weights, geometry, image].into_iter().any(Tensor::track_op) {
        weights.apply_op3(geometry, image, op)
    } else {
        weights.apply_op3_no_bwd(geometry, image, &Unrecorded(op))
    }
}

#[derive(Debug)]
struct Op {
    config: Config,
    n: usize,
    neighbourhood: Neighbourhood,
    tape: Mutex<Option<Tape>>,
}

impl Op {
    fn inputs<'a>(&'a self, geometry: &'a [f32], image: &'a [f32]) -> Result<Inputs<'a>> {
        let Neighbourhood { k, neighbours, relative, cells } = &self.neighbourhood;
        let inputs = Inputs { n: self.n, k: *k, geometry, image, neighbours, relative, cells };
        inputs.check(&self.config).map_err(candle_core::Error::wrap)?;
        Ok(inputs)
    }

    fn shape(&self) -> Shape {
        (self.n, OUTPUTS).into()
    }
}

/// A tensor's numbers.
fn values<'a>(name: &str, storage: &'a CpuStorage, strides: &Strides) -> Result<&'a [f32]> {
    match (storage, strides.contiguous_offsets()) {
        (CpuStorage::F32(values), Some((start, end))) => Ok(&values[start..end]),
        (CpuStorage::F32(_), None) => bail!("{name}: strided, expected a contiguous tensor"),
        (other, _) => bail!("{name}: {:?}, expected F32", candle_core::backend::BackendStorage::dtype(other)),
    }
}

impl CustomOp3 for Op {
    fn name(&self) -> &'static str {
        "attn-head"
    }

    fn cpu_fwd(
        &self,
        weights: &CpuStorage,
        weights_strides: &Strides,
        geometry: &CpuStorage,
        geometry_strides: &Strides,
        image: &CpuStorage,
        image_strides: &Strides,
    ) -> Result<(CpuStorage, Shape)> {
        let weights = values("weights", weights, weights_strides)?;
        let geometry = values("geometry", geometry, geometry_strides)?;
        let inputs = self.inputs(geometry, values("image", image, image_strides)?)?;
        let (out, tape) = forward_recorded(&self.config, weights, &inputs);
        *self.tape.lock().unwrap_or_else(PoisonError::into_inner) = Some(tape);
        Ok((CpuStorage::F32(out), self.shape()))
    }

    fn bwd(
        &self,
        weights: &Tensor,
        geometry: &Tensor,
        image: &Tensor,
        _: &Tensor,
        grad: &Tensor,
    ) -> Result<(Option<Tensor>, Option<Tensor>, Option<Tensor>)> {
        let numbers = |tensor: &Tensor| tensor.flatten_all()?.to_vec1::<f32>();
        let (geometry_values, image_values) = (numbers(geometry)?, numbers(image)?);
        let inputs = self.inputs(&geometry_values, &image_values)?;
        let tape = self.tape.lock().unwrap_or_else(PoisonError::into_inner);
        let Some(tape) = tape.as_ref() else { bail!("gradient of attn-head before its outputs") };
        let gradients = backward(&self.config, &numbers(weights)?, &inputs, tape, &numbers(grad)?);
        let like = |values, tensor: &Tensor| Tensor::from_vec(values, tensor.shape(), tensor.device());
        Ok((
            Some(like(gradients.weights, weights)?),
            Some(like(gradients.geometry, geometry)?),
            Some(like(gradients.image, image)?),
        ))
    }
}

/// The same without a tape.
#[derive(Debug)]
struct Unrecorded(Op);

impl CustomOp3 for Unrecorded {
    fn name(&self) -> &'static str {
        self.0.name()
    }

    fn cpu_fwd(
        &self,
        weights: &CpuStorage,
        weights_strides: &Strides,
        geometry: &CpuStorage,
        geometry_strides: &Strides,
        image: &CpuStorage,
        image_strides: &Strides,
    ) -> Result<(CpuStorage, Shape)> {
        let weights = values("weights", weights, weights_strides)?;
        let geometry = values("geometry", geometry, geometry_strides)?;
        let inputs = self.0.inputs(geometry, values("image", image, image_strides)?)?;
        Ok((CpuStorage::F32(forward(&self.0.config, weights, &inputs)), self.0.shape()))
    }
}
