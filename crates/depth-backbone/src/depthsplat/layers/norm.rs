use super::super::kernels::{self, Activation};
use super::super::params::Params;
use super::{Engine, compose_activation, tensor, values};
use candle_core::{DType, Result, Tensor};
use candle_nn::{Module, ops};

/// Normalisation of each token over its channels.
pub(in crate::depthsplat) struct LayerNorm {
    weight: Tensor,
    bias: Tensor,
    eps: f64,
    engine: Engine,
}

impl LayerNorm {
    pub(in crate::depthsplat) fn new(p: &Params, channels: usize, eps: f64) -> Result<Self> {
        let weight = p.get("weight", &[channels])?;
        let bias = p.get("bias", &[channels])?;
        Ok(Self { weight, bias, eps, engine: p.engine() })
    }

    pub(in crate::depthsplat) fn forward(&self, x: &Tensor) -> Result<Tensor> {
        match self.engine {
            Engine::Kernels => {
                let (weight, bias) = (values(&self.weight)?, values(&self.bias)?);
                tensor(kernels::layer_norm(&values(x)?, &weight, &bias, self.eps as f32), x.shape())
            }
            // The kernel behind candle-nn's module takes the variance as a difference of squares, which loses digits.
            Engine::Composed => ops::layer_norm_slow(x, &self.weight, &self.bias, self.eps as f32),
        }
    }
}

/// Normalisation over the pixels of each image and groups of channels.
pub(in crate::depthsplat) struct GroupNorm {
    form: Form,
    groups: usize,
}

enum Form {
    /// Weight and bias.
    Kernel(Option<(Tensor, Tensor)>),
    Composed(candle_nn::GroupNorm),
}

/// Of all group and instance norms.
const EPS: f64 = 1e-5;

impl GroupNorm {
    /// With 8 groups.
    pub(in crate::depthsplat) fn new(p: &Params, channels: usize) -> Result<Self> {
        let groups = 8;
        let (weight, bias) = (p.get("weight", &[channels])?, p.get("bias", &[channels])?);
        let form = match p.engine() {
            Engine::Kernels => Form::Kernel(Some((weight, bias))),
            Engine::Composed => {
                Form::Composed(candle_nn::GroupNorm::new(weight, bias, channels, groups, EPS)?)
            }
        };
        Ok(Self { form, groups })
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
        let (_, height, width, channels) = x.dims4()?;
        let affine = match &self.form {
            Form::Kernel(affine) => affine,
            Form::Composed(norm) => {
                let y = norm.forward(&x.permute((0, 3, 1, 2))?)?.permute((0, 2, 3, 1))?.contiguous()?;
                let y = compose_activation(activation, y)?;
                return match residual {
                    Some(residual) => (y + residual)?.relu(),
                    None => Ok(y),
                };
            }
        };
        let affine = match affine {
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
    pub(in crate::depthsplat) fn new(p: &Params, channels: usize) -> Result<Self> {
        let form = match p.engine() {
            Engine::Kernels => Form::Kernel(None),
            Engine::Composed => {
                let weight = Tensor::ones(channels, DType::F32, p.device())?;
                let bias = weight.zeros_like()?;
                Form::Composed(candle_nn::GroupNorm::new(weight, bias, channels, channels, EPS)?)
            }
        };
        Ok(Self(GroupNorm { form, groups: channels }))
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
