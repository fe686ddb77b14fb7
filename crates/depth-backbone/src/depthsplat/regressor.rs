//! From a cost volume and features to inverse depth: the U-Net (`regressor`) and the head that follows (`depth_head`).

use super::layers::{
    AttentionShape, Conv, Engine, GroupNorm, Linear, Part, Then, Work, attention, join, nearest, softmax,
};
use super::params::Params;
use super::taps::Taps;
use candle_core::{D, Result, Tensor};

/// Channels of a head of the U-Net's attention.
const HEAD: usize = 32;

/// A residual block.
struct Res {
    in_norm: GroupNorm,
    in_conv: Conv,
    out_norm: GroupNorm,
    out_conv: Conv,
    skip: Option<Linear>,
}

impl Res {
    fn new(p: &Params, inputs: usize, outputs: usize) -> Result<Self> {
        Ok(Self {
            in_norm: GroupNorm::new(&p.pp("in_layers.0"), inputs)?,
            in_conv: Conv::shape(3, inputs, outputs).load(&p.pp("in_layers.2"))?,
            out_norm: GroupNorm::new(&p.pp("out_layers.0"), outputs)?,
            out_conv: Conv::shape(3, outputs, outputs).load(&p.pp("out_layers.3"))?,
            skip: if inputs == outputs {
                None
            } else {
                Some(Linear::pointwise(&p.pp("skip_connection"), inputs, outputs)?)
            },
        })
    }

    fn forward(&self, x: &Tensor) -> Result<Tensor> {
        let h = self.in_conv.forward(&self.in_norm.forward_silu(x)?)?;
        let h = self.out_norm.forward_silu(&h)?;
        match &self.skip {
            Some(skip) => self.out_conv.forward_then(&h, Then::plus(&skip.forward(x)?)),
            None => self.out_conv.forward_then(&h, Then::plus(x)),
        }
    }
}

/// Attention over the pixels of all views.
struct CrossView {
    norm: GroupNorm,
    qkv: Linear,
    proj_out: Linear,
    engine: Engine,
    work: Work,
}

impl CrossView {
    fn new(p: &Params, channels: usize) -> Result<Self> {
        Ok(Self {
            norm: GroupNorm::new(&p.pp("norm"), channels)?,
            qkv: Linear::pointwise_1d(&p.pp("qkv"), channels, 3 * channels)?,
            proj_out: Linear::pointwise_1d(&p.pp("proj_out"), channels, channels)?,
            engine: p.engine(),
            work: p.work().clone(),
        })
    }

    fn forward(&self, x: &Tensor) -> Result<Tensor> {
        let (views, height, width, channels) = x.dims4()?;
        let tokens = views * height * width;
        let qkv = self.qkv.forward(&self.norm.forward(x)?)?.reshape((1, tokens, 3 * channels))?;
        let shape = AttentionShape {
            heads: channels / HEAD,
            width: HEAD,
            scale: 1.0 / (HEAD as f64).sqrt(),
            labels: None,
            work: &self.work,
        };
        // Head by head its query, key and value.
        let parts = [0, HEAD, 2 * HEAD].map(|first| Part { of: &qkv, first, step: 3 * HEAD });
        let y = attention(self.engine, shape, parts)?.reshape(x.shape())?;
        self.proj_out.forward_then(&y, Then::plus(x))
    }
}

/// A residual block and what follows it: attention on the lowest level, a convolution at twice the resolution.
struct ResLevel {
    res: Res,
    cross_view: Option<CrossView>,
    up: Option<Conv>,
}

/// A step of the U-Net.
enum Block {
    Conv(Conv),
    Res(Box<ResLevel>),
}

impl Block {
    fn forward(&self, x: &Tensor) -> Result<Tensor> {
        match self {
            Self::Conv(conv) => conv.forward(x),
            Self::Res(level) => {
                let mut y = level.res.forward(x)?;
                if let Some(cross_view) = &level.cross_view {
                    y = cross_view.forward(&y)?;
                }
                match &level.up {
                    Some(conv) => conv.forward(&nearest(&y, 2)?),
                    None => Ok(y),
                }
            }
        }
    }
}

struct UNet {
    input_blocks: Vec<Block>,
    middle: [Res; 2],
    output_blocks: Vec<Block>,
    out_norm: GroupNorm,
    out_conv: Conv,
}

impl UNet {
    fn new(p: &Params, channels: usize, levels: usize) -> Result<Self> {
        let conv = |p: Params| Conv::shape(3, channels, channels).load(&p);
        let mut input_blocks = vec![Block::Conv(conv(p.pp("input_blocks.0.0"))?)];
        for level in 0..levels {
            let p = |k: usize| p.pp(format!("input_blocks.{k}"));
            if level > 0 {
                let down = p(2 * level).pp("0.op");
                input_blocks.push(Block::Conv(Conv::shape(3, channels, channels).stride(2).load(&down)?));
            }
            let p = p(2 * level + 1);
            let lowest = level + 1 == levels;
            let cross_view = if lowest { Some(CrossView::new(&p.pp(1), channels)?) } else { None };
            let res = Res::new(&p.pp(0), channels, channels)?;
            input_blocks.push(Block::Res(Box::new(ResLevel { res, cross_view, up: None })));
        }
        let mut output_blocks = Vec::new();
        for k in 0..2 * levels {
            let p = p.pp(format!("output_blocks.{k}"));
            let lowest = k < 2;
            let cross_view = if lowest { Some(CrossView::new(&p.pp(1), channels)?) } else { None };
            let up = if k % 2 == 1 && k + 1 < 2 * levels {
                Some(conv(p.pp(if lowest { 2 } else { 1 }).pp("conv"))?)
            } else {
                None
            };
            let res = Res::new(&p.pp(0), 2 * channels, channels)?;
            output_blocks.push(Block::Res(Box::new(ResLevel { res, cross_view, up })));
        }
        Ok(Self {
            input_blocks,
            middle: [
                Res::new(&p.pp("middle_block.0"), channels, channels)?,
                Res::new(&p.pp("middle_block.2"), channels, channels)?,
            ],
            output_blocks,
            out_norm: GroupNorm::new(&p.pp("out.0"), channels)?,
            out_conv: conv(p.pp("out.2"))?,
        })
    }

    fn forward(&self, x: &Tensor, scale: usize, taps: &mut Taps) -> Result<Tensor> {
        let mut kept = Vec::new();
        let mut h = x.clone();
        for (k, block) in self.input_blocks.iter().enumerate() {
            h = block.forward(&h)?;
            taps.map(format!("unet.s{scale}.in{k}"), &h)?;
            kept.push(h.clone());
        }
        h = self.middle[1].forward(&self.middle[0].forward(&h)?)?;
        taps.map(format!("unet.s{scale}.mid"), &h)?;
        for (k, (block, skip)) in self.output_blocks.iter().zip(kept.into_iter().rev()).enumerate() {
            h = block.forward(&join(&[&h, &skip])?)?;
            taps.map(format!("unet.s{scale}.out{k}"), &h)?;
        }
        let h = self.out_conv.forward(&self.out_norm.forward_silu(&h)?)?;
        taps.map(format!("unet.s{scale}.unet"), &h)?;
        Ok(h)
    }
}

/// Regressor and depth head of a scale.
pub(super) struct Regressor {
    conv_in: Conv,
    norm_in: GroupNorm,
    unet: UNet,
    conv_out: Conv,
    residual: Linear,
    head: [Conv; 2],
    scale: usize,
    engine: Engine,
}

impl Regressor {
    /// `p`: the depth predictor. `inputs`: channels of cost volume and features; `candidates`: of inverse depth.
    pub(super) fn new(p: &Params, scale: usize, inputs: usize, candidates: usize) -> Result<Self> {
        let channels = 128 >> scale;
        let regressor = p.pp(format!("regressor.{scale}"));
        let head = p.pp(format!("depth_head.{scale}"));
        Ok(Self {
            conv_in: Conv::shape(3, inputs, channels).load(&regressor.pp(0))?,
            norm_in: GroupNorm::new(&regressor.pp(1), channels)?,
            unet: UNet::new(&regressor.pp(3), channels, 3 + scale)?,
            conv_out: Conv::shape(3, channels, channels).load(&regressor.pp(4))?,
            residual: Linear::pointwise(&p.pp(format!("regressor_residual.{scale}")), inputs, channels)?,
            head: [
                Conv::shape(3, channels, 2 * channels).replicate().load(&head.pp(0))?,
                Conv::shape(3, 2 * channels, candidates).replicate().load(&head.pp(2))?,
            ],
            scale,
            engine: p.engine(),
        })
    }

    /// Probability of each candidate, `[n, h, w, candidates]`, from the joined cost volume and features.
    pub(super) fn forward(&self, x: &Tensor, taps: &mut Taps) -> Result<Tensor> {
        let s = self.scale;
        let stem = self.norm_in.forward_gelu(&self.conv_in.forward(x)?)?;
        taps.map(format!("unet.s{s}.stem"), &stem)?;
        let y = self.unet.forward(&stem, s, taps)?;
        if taps.wanted() {
            taps.map(format!("reg.s{s}.main"), &self.conv_out.forward(&y)?)?;
        }
        let y = self.conv_out.forward_then(&y, Then::plus(&self.residual.forward(x)?))?;
        taps.map(format!("reg.s{s}.sum"), &y)?;
        let logits = self.head[1].forward(&self.head[0].forward_then(&y, Then::GELU)?)?;
        taps.map(format!("depth.s{s}.logits"), &logits)?;
        let probability = softmax(self.engine, &logits)?;
        taps.map(format!("depth.s{s}.prob"), &probability)?;
        Ok(probability)
    }
}

/// Mean of the candidates by their probability, `[n, h, w, 1]`.
pub(super) fn expectation(probability: &Tensor, candidates: &Tensor) -> Result<Tensor> {
    probability.broadcast_mul(candidates)?.sum_keepdim(D::Minus1)
}
