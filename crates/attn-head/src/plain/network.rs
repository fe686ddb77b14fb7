use super::TensorInputs;
use super::gather::{Gather, Neighbourhood};
use super::layers::{Norm, Perceptron};
use crate::{Config, Error, HEADS, Kind, Layout, OUTPUTS, Result, WIDTH};
use candle_core::{DType, Device, Tensor};
use candle_nn::{Module, VarBuilder};

/// A head as a model of candle.
#[derive(Debug)]
pub struct Network {
    config: Config,
    phi_g: Perceptron,
    phi_v: Perceptron,
    blocks: Vec<Block>,
    norm: Norm,
    out: Perceptron,
    dtype: DType,
    device: Device,
}

/// A layer that looks at neighbours.
#[derive(Debug)]
struct Block {
    norm1: Norm,
    gather: Gather,
    norm2: Norm,
    ffn: Perceptron,
}

impl Block {
    fn load(config: &Config, vb: &VarBuilder<'_>) -> candle_core::Result<Self> {
        Ok(Self {
            norm1: Norm::load(WIDTH, &vb.pp("norm1"))?,
            gather: Gather::load(config, vb)?,
            norm2: Norm::load(WIDTH, &vb.pp("norm2"))?,
            ffn: Perceptron::gelu([WIDTH, config.kind.hidden(), WIDTH], &vb.pp("ffn"))?,
        })
    }
}

/// All maps between the layers of a head.
#[derive(Debug, Clone)]
pub struct Trace {
    /// f0 = \[phi_g(g); phi_v(v)\], `[n, 128]`.
    pub embedding: Tensor,
    /// Features after each block, `[n, 128]`.
    pub blocks: Vec<Tensor>,
    /// Weights of the attention in each block, `[n, k + 1, 4]`, the anchor itself first; none in the other heads.
    pub alphas: Vec<Tensor>,
    /// The outputs, `[n, 38]`.
    pub out: Tensor,
}

impl Network {
    /// A head with the given numbers: `[len]`, in the order of [`Layout`], such as
    /// [`Weights::to_tensor`](crate::Weights::to_tensor) gives. Where it is a `Var`, the outputs can be differentiated
    /// by it.
    ///
    /// # Errors
    /// If there are more or fewer numbers than the configuration asks for, or it is out of its ranges.
    pub fn new(config: Config, values: &Tensor) -> Result<Self> {
        config.check()?;
        let layout = Layout::new(&config);
        if values.dims() != [layout.len] {
            let found = values.dims().to_vec();
            return Err(Error::Shape { what: "weights", expected: vec![layout.len], found });
        }
        let views = layout.parameters.into_iter().map(|p| {
            let view = values.narrow(0, p.offset, p.len())?.reshape(p.shape)?;
            Ok((p.name, view))
        });
        let views = views.collect::<Result<_>>()?;
        Self::load(config, &VarBuilder::from_tensors(views, values.dtype(), values.device()))
    }

    /// A head with the parameters of a builder, whose names and shapes are those of [`Layout`]: from the tensors of a weights file,
    /// or the variables of a `VarMap`.
    ///
    /// # Errors
    /// If a parameter is missing or has another shape, or the configuration is out of its ranges.
    pub fn load(config: Config, vb: &VarBuilder<'_>) -> Result<Self> {
        config.check()?;
        let half = WIDTH / 2;
        let block = |layer| Block::load(&config, &vb.pp("blocks").pp(layer));
        Ok(Self {
            config,
            phi_g: Perceptron::relu([config.geometry, half, half], &vb.pp("phi_g"))?,
            phi_v: Perceptron::relu([config.image, half, half], &vb.pp("phi_v"))?,
            blocks: (0..config.kind.layers()).map(block).collect::<candle_core::Result<_>>()?,
            norm: Norm::load(WIDTH, &vb.pp("norm"))?,
            out: Perceptron::gelu([WIDTH, WIDTH, OUTPUTS], &vb.pp("out"))?,
            dtype: vb.dtype(),
            device: vb.device().clone(),
        })
    }

    /// Shape of the head.
    #[must_use]
    pub fn config(&self) -> &Config {
        &self.config
    }

    /// The outputs, `[n, 38]`.
    ///
    /// # Errors
    /// If the inputs do not fit, naming which, and candle's.
    pub fn forward(&self, inputs: &TensorInputs) -> Result<Tensor> {
        Ok(self.trace(inputs)?.out)
    }

    /// The outputs and what lies between.
    ///
    /// # Errors
    /// As [`Network::forward`].
    pub fn trace(&self, inputs: &TensorInputs) -> Result<Trace> {
        let (n, k) = inputs.check(&self.config)?;
        if n == 0 {
            return self.trace_of_nothing(k);
        }
        let embedded = [self.phi_g.forward(&inputs.geometry)?, self.phi_v.forward(&inputs.image)?];
        let embedding = Tensor::cat(&embedded, 1)?;
        let (mut blocks, mut alphas) = (Vec::new(), Vec::new());
        let hood = neighbourhood(inputs, n, k)?;
        let mut x = embedding.clone();
        for Block { norm1, gather, norm2, ffn } in &self.blocks {
            let (learnt, alpha) = gather.forward(&norm1.forward(&x)?, &hood)?;
            let y = (x + learnt)?;
            x = (&y + ffn.forward(&norm2.forward(&y)?)?)?;
            blocks.push(x.clone());
            alphas.extend(alpha);
        }
        let out = self.out.forward(&self.norm.forward(&x)?)?;
        Ok(Trace { embedding, blocks, alphas, out })
    }

    /// No anchors: not every operation of candle takes an empty tensor.
    fn trace_of_nothing(&self, k: usize) -> Result<Trace> {
        let zeros = |shape: &[usize]| Tensor::zeros(shape, self.dtype, &self.device);
        let features = zeros(&[0, WIDTH])?;
        let alphas = match self.config.kind {
            Kind::Attention => vec![zeros(&[0, k + 1, HEADS])?; self.blocks.len()],
            _ => Vec::new(),
        };
        let blocks = vec![features.clone(); self.blocks.len()];
        Ok(Trace { embedding: features, blocks, alphas, out: zeros(&[0, OUTPUTS])? })
    }
}

/// The anchors with themselves and their neighbours.
fn neighbourhood(inputs: &TensorInputs, n: usize, k: usize) -> Result<Neighbourhood> {
    let device = inputs.neighbours.device();
    let itself = Tensor::arange(0, n as u32, device)?.unsqueeze(1)?;
    let zero = Tensor::zeros((n, 1, 3), inputs.geometry.dtype(), device)?;
    let (index, relative) = if k == 0 {
        (itself, zero)
    } else {
        (Tensor::cat(&[&itself, &inputs.neighbours], 1)?, Tensor::cat(&[&zero, &inputs.relative], 1)?)
    };
    Ok(Neighbourhood { n, seen: k + 1, index: index.flatten_all()?, relative, cells: inputs.cells.clone() })
}
