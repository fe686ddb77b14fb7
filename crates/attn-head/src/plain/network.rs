use super::TensorInputs;
use super::blocks::{Gather, Neighbourhood};
use super::ops::Parameters;
use crate::{Config, Error, LAYERS, OUTPUTS, Result, WIDTH};
use candle_core::Tensor;

/// A head in candle's operations.
#[derive(Debug)]
pub struct Network {
    config: Config,
    /// All of them, `[len]`.
    values: Tensor,
    parameters: Parameters,
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
    /// A head with the given numbers: `[len]`, in the order of [`Layout`](crate::Layout), such as
    /// [`Weights::to_tensor`](crate::Weights::to_tensor) gives. Where it is a `Var`, the outputs can be differentiated
    /// by it, and setting it changes this network.
    ///
    /// # Errors
    /// If there are more or fewer numbers than the configuration asks for, or it is out of its ranges.
    pub fn new(config: Config, values: &Tensor) -> Result<Self> {
        config.check()?;
        let expected = crate::Layout::new(&config).len;
        if values.dims() != [expected] {
            let found = values.dims().to_vec();
            return Err(Error::Shape { what: "weights", expected: vec![expected], found });
        }
        let parameters = Parameters::new(&config, values)?;
        Ok(Self { config, values: values.clone(), parameters })
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
        self.trace_in_chunks(inputs, usize::MAX)
    }

    /// The same, holding the features of no more than `anchors * (k + 1)` pairs at a time, if nothing is differentiated.
    pub(crate) fn trace_in_chunks(&self, inputs: &TensorInputs, anchors: usize) -> Result<Trace> {
        let (n, k) = inputs.check(&self.config)?;
        if n == 0 {
            return self.trace_of_nothing(k);
        }
        let p = &self.parameters;
        let embedded = [p.relu_mlp("phi_g", &inputs.geometry)?, p.relu_mlp("phi_v", &inputs.image)?];
        let embedding = Tensor::cat(&embedded, 1)?;
        let (mut blocks, mut alphas) = (Vec::new(), Vec::new());
        let mut x = embedding.clone();
        for layer in 0..LAYERS {
            let block = format!("blocks.{layer}");
            let gather = Gather { kind: self.config.kind, parameters: p, block: block.clone() };
            let prepared = gather.prepare(&p.norm(&format!("{block}.norm1"), &x)?)?;
            let (mut updated, mut weights) = (Vec::new(), Vec::new());
            for start in (0..n).step_by(anchors) {
                let hood = neighbourhood(inputs, start, anchors.min(n - start), k)?;
                let (learnt, alpha) = gather.gather(&prepared, &hood)?;
                let y = (hood.own(&x)? + learnt)?;
                let ffn = p.gelu_mlp(&format!("{block}.ffn"), &p.norm(&format!("{block}.norm2"), &y)?)?;
                updated.push((y + ffn)?);
                weights.extend(alpha);
            }
            x = Tensor::cat(&updated, 0)?;
            blocks.push(x.clone());
            if !weights.is_empty() {
                alphas.push(Tensor::cat(&weights, 0)?);
            }
        }
        let out = p.gelu_mlp("out", &p.norm("norm", &x)?)?;
        Ok(Trace { embedding, blocks, alphas, out })
    }

    /// No anchors: not every operation of candle takes an empty tensor.
    fn trace_of_nothing(&self, k: usize) -> Result<Trace> {
        let zeros = |shape: &[usize]| Tensor::zeros(shape, self.values.dtype(), self.values.device());
        let features = zeros(&[0, WIDTH])?;
        let alphas = match self.config.kind {
            crate::Kind::Attention => vec![zeros(&[0, k + 1, crate::HEADS])?; LAYERS],
            _ => Vec::new(),
        };
        let blocks = vec![features.clone(); LAYERS];
        Ok(Trace { embedding: features, blocks, alphas, out: zeros(&[0, OUTPUTS])? })
    }
}

/// The anchors `start..start + len` with themselves and their neighbours.
fn neighbourhood(inputs: &TensorInputs, start: usize, len: usize, k: usize) -> Result<Neighbourhood> {
    let device = inputs.neighbours.device();
    let itself = Tensor::arange(start as u32, (start + len) as u32, device)?.unsqueeze(1)?;
    let zero = Tensor::zeros((len, 1, 3), inputs.geometry.dtype(), device)?;
    let (index, relative) = if k == 0 {
        (itself, zero)
    } else {
        let neighbours = inputs.neighbours.narrow(0, start, len)?;
        let relative = inputs.relative.narrow(0, start, len)?;
        (Tensor::cat(&[itself, neighbours], 1)?, Tensor::cat(&[zero, relative], 1)?)
    };
    Ok(Neighbourhood { anchors: start..start + len, seen: k + 1, index: index.flatten_all()?, relative })
}
