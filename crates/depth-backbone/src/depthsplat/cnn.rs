//! The convolutional features (`backbone`).

use super::layers::{Conv, InstanceNorm};
use super::params::Params;
use candle_core::{Result, Tensor};

struct Block {
    conv1: Conv,
    conv2: Conv,
    norm: InstanceNorm,
    downsample: Option<Conv>,
}

impl Block {
    fn new(p: &Params, inputs: usize, outputs: usize, stride: usize) -> Result<Self> {
        let conv1 = Conv::shape(3, inputs, outputs).stride(stride).without_bias().load(&p.pp("conv1"))?;
        let conv2 = Conv::shape(3, outputs, outputs).without_bias().load(&p.pp("conv2"))?;
        let downsample = if inputs == outputs && stride == 1 {
            None
        } else {
            Some(Conv::shape(1, inputs, outputs).stride(stride).load(&p.pp("downsample.0"))?)
        };
        Ok(Self { conv1, conv2, norm: InstanceNorm::new(p, outputs)?, downsample })
    }

    fn forward(&self, x: &Tensor) -> Result<Tensor> {
        let y = self.norm.forward_relu(&self.conv1.forward(x)?)?;
        let y = self.conv2.forward(&y)?;
        match &self.downsample {
            Some(conv) => self.norm.forward_residual(&y, &self.norm.forward(&conv.forward(x)?)?),
            None => self.norm.forward_residual(&y, x),
        }
    }
}

/// Features of a view at three depths of the network.
pub(super) struct CnnFeatures {
    /// 64 channels at 1/2.
    pub(super) high: Tensor,
    /// 96 channels at 1/4 or 1/2.
    pub(super) mid: Tensor,
    /// 128 channels at 1/8 or 1/4.
    pub(super) low: Tensor,
}

pub(super) struct Cnn {
    conv1: Conv,
    norm1: InstanceNorm,
    layers: [[Block; 2]; 3],
    conv2: Conv,
}

impl Cnn {
    /// `lowest`: image size over that of the coarsest map, 4 or 8.
    pub(super) fn new(p: &Params, lowest: usize) -> Result<Self> {
        let conv1 = Conv::shape(7, 3, 64).stride(2).without_bias().load(&p.pp("conv1"))?;
        let layer = |k: usize, inputs: usize, outputs: usize, stride: usize| -> Result<[Block; 2]> {
            Ok([
                Block::new(&p.pp(format!("layer{k}.0")), inputs, outputs, stride)?,
                Block::new(&p.pp(format!("layer{k}.1")), outputs, outputs, 1)?,
            ])
        };
        let layers =
            [layer(1, 64, 64, 1)?, layer(2, 64, 96, if lowest == 8 { 2 } else { 1 })?, layer(3, 96, 128, 2)?];
        let conv2 = Conv::shape(1, 128, 128).load(&p.pp("conv2"))?;
        Ok(Self { conv1, norm1: InstanceNorm::new(p, 64)?, layers, conv2 })
    }

    /// Of normalised images `[n, h, w, 3]`.
    pub(super) fn forward(&self, x: &Tensor) -> Result<CnnFeatures> {
        let layer = |k: usize, x: &Tensor| self.layers[k][1].forward(&self.layers[k][0].forward(x)?);
        let x = self.norm1.forward_relu(&self.conv1.forward(x)?)?;
        let high = layer(0, &x)?;
        let mid = layer(1, &high)?;
        let low = self.conv2.forward(&layer(2, &mid)?)?;
        Ok(CnnFeatures { high, mid, low })
    }
}
