use super::super::kernels::{self, Activation};
use super::super::params::Params;
use super::{Engine, compose_activation, tensor, values};
use candle_core::{D, Result, Tensor};

/// Normalisation of each token over its channels.
pub(in crate::depthsplat) struct LayerNorm {
    weight: Tensor,
    bias: Tensor,
    eps: f64,
    engine: Engine,
}

impl LayerNorm {
    pub(in crate::depthsplat) fn new(p: &Params, channels: usize, eps: f64) -> Result<Self> {
        let weight = p.get("weight", &[channels])?.to_device(p.device())?;
        let bias = p.get("bias", &[channels])?.to_device(p.device())?;
        Ok(Self { weight, bias, eps, engine: p.engine() })
    }

    pub(in crate::depthsplat) fn forward(&self, x: &Tensor) -> Result<Tensor> {
        match self.engine {
            Engine::Kernels => {
                let (weight, bias) = (values(&self.weight)?, values(&self.bias)?);
                tensor(kernels::layer_norm(&values(x)?, &weight, &bias, self.eps as f32), x.shape())
            }
            Engine::Composed => {
                let x = x.broadcast_sub(&x.mean_keepdim(D::Minus1)?)?;
                let variance = x.sqr()?.mean_keepdim(D::Minus1)?;
                let x = x.broadcast_div(&(variance + self.eps)?.sqrt()?)?;
                x.broadcast_mul(&self.weight)?.broadcast_add(&self.bias)
            }
        }
    }
}

/// Normalisation over the pixels of each image and groups of channels.
pub(in crate::depthsplat) struct GroupNorm {
    affine: Option<(Tensor, Tensor)>,
    groups: usize,
    engine: Engine,
}

/// Of all group and instance norms.
const EPS: f64 = 1e-5;

impl GroupNorm {
    /// With 8 groups.
    pub(in crate::depthsplat) fn new(p: &Params, channels: usize) -> Result<Self> {
        let weight = p.get("weight", &[channels])?.to_device(p.device())?;
        let bias = p.get("bias", &[channels])?.to_device(p.device())?;
        Ok(Self { affine: Some((weight, bias)), groups: 8, engine: p.engine() })
    }

    pub(in crate::depthsplat) fn forward(&self, x: &Tensor) -> Result<Tensor> {
        self.normalise(x, Activation::Identity, None)
    }

    pub(in crate::depthsplat) fn forward_gelu(&self, x: &Tensor) -> Result<Tensor> {
        self.normalise(x, Activation::Gelu, None)
    }

    pub(in crate::depthsplat) fn forward_silu(&self, x: &Tensor) -> Result<Tensor> {
        self.normalise(x, Activation::Silu, None)
    }

    fn normalise(&self, x: &Tensor, activation: Activation, residual: Option<&Tensor>) -> Result<Tensor> {
        let (count, height, width, channels) = x.dims4()?;
        if self.engine == Engine::Composed {
            let grouped = x.reshape((count, height * width, self.groups, channels / self.groups))?;
            let grouped = grouped.broadcast_sub(&grouped.mean_keepdim((1, 3))?)?;
            let variance = grouped.sqr()?.mean_keepdim((1, 3))?;
            let mut y = grouped.broadcast_div(&(variance + EPS)?.sqrt()?)?.reshape(x.shape())?;
            if let Some((weight, bias)) = &self.affine {
                y = y.broadcast_mul(weight)?.broadcast_add(bias)?;
            }
            y = compose_activation(activation, y)?;
            return match residual {
                Some(residual) => (y + residual)?.relu(),
                None => Ok(y),
            };
        }
        let affine = match &self.affine {
            Some((weight, bias)) => Some((values(weight)?, values(bias)?)),
            None => None,
        };
        let residual = residual.map(values).transpose()?;
        let norm = kernels::GroupNorm {
            channels,
            groups: self.groups,
            affine: affine.as_ref().map(|(weight, bias)| (&**weight, &**bias)),
            eps: EPS,
            activation,
            residual: residual.as_deref(),
        };
        tensor(norm.apply(&values(x)?, height * width), x.shape())
    }
}

/// Normalisation over the pixels of each image and channel, without parameters.
pub(in crate::depthsplat) struct InstanceNorm(GroupNorm);

impl InstanceNorm {
    pub(in crate::depthsplat) fn new(p: &Params, channels: usize) -> Self {
        Self(GroupNorm { affine: None, groups: channels, engine: p.engine() })
    }

    pub(in crate::depthsplat) fn forward(&self, x: &Tensor) -> Result<Tensor> {
        self.0.normalise(x, Activation::Identity, None)
    }

    pub(in crate::depthsplat) fn forward_relu(&self, x: &Tensor) -> Result<Tensor> {
        self.0.normalise(x, Activation::Relu, None)
    }

    /// relu(skip + relu(norm(x))).
    pub(in crate::depthsplat) fn forward_residual(&self, x: &Tensor, skip: &Tensor) -> Result<Tensor> {
        self.0.normalise(x, Activation::Relu, Some(skip))
    }
}
