use super::super::kernels::{self, Heads, Joined, Labels, Packed};
use super::super::params::Params;
use super::{Engine, Then, Work, softmax, tensor, values};
use candle_core::{D, Result, Tensor};
use candle_nn::Module;
use cpu_kernels::{Isa, Rows};

enum Form {
    /// With its bias.
    Packed(Packed, Option<Tensor>),
    Composed(candle_nn::Linear),
}

/// y = x Wᵀ + b over the last axis; also a convolution with windows of one pixel.
pub(in crate::depthsplat) struct Linear {
    form: Form,
    inputs: usize,
    outputs: usize,
    work: Work,
}

impl Linear {
    /// `weight` `[out, in]` and `bias` `[out]`.
    pub(in crate::depthsplat) fn new(p: &Params, inputs: usize, outputs: usize) -> Result<Self> {
        Self::with_bias(p, inputs, outputs, &[outputs, inputs])
    }

    /// The same without bias.
    pub(in crate::depthsplat) fn without_bias(p: &Params, inputs: usize, outputs: usize) -> Result<Self> {
        let weight = p.get("weight", &[outputs, inputs])?;
        Self::from_tensors(p, &weight, None, inputs, outputs)
    }

    /// A 1 x 1 convolution: `weight` `[out, in, 1, 1]`.
    pub(in crate::depthsplat) fn pointwise(p: &Params, inputs: usize, outputs: usize) -> Result<Self> {
        Self::with_bias(p, inputs, outputs, &[outputs, inputs, 1, 1])
    }

    /// A convolution along one axis with windows of 1: `weight` `[out, in, 1]`.
    pub(in crate::depthsplat) fn pointwise_1d(p: &Params, inputs: usize, outputs: usize) -> Result<Self> {
        Self::with_bias(p, inputs, outputs, &[outputs, inputs, 1])
    }

    fn with_bias(p: &Params, inputs: usize, outputs: usize, shape: &[usize]) -> Result<Self> {
        let weight = p.get("weight", shape)?.reshape((outputs, inputs))?;
        let bias = p.get("bias", &[outputs])?;
        Self::from_tensors(p, &weight, Some(bias), inputs, outputs)
    }

    /// From `weight` `[out, in]` and `bias`.
    pub(super) fn from_tensors(
        p: &Params,
        weight: &Tensor,
        bias: Option<Tensor>,
        inputs: usize,
        outputs: usize,
    ) -> Result<Self> {
        let form = match p.engine() {
            Engine::Kernels => {
                let rows = &values(weight)?;
                Form::Packed(Packed::transposed(Isa::in_use(), Rows::new(rows, outputs, inputs)), bias)
            }
            Engine::Composed => Form::Composed(candle_nn::Linear::new(weight.clone(), bias)),
        };
        Ok(Self { form, inputs, outputs, work: p.work().clone() })
    }

    /// `[.., in]` to `[.., out]`.
    pub(in crate::depthsplat) fn forward(&self, x: &Tensor) -> Result<Tensor> {
        self.forward_joined(&[x], Then::NOTHING)
    }

    pub(in crate::depthsplat) fn forward_then(&self, x: &Tensor, then: Then<'_>) -> Result<Tensor> {
        self.forward_joined(&[x], then)
    }

    /// Of several tensors joined along the channels.
    pub(in crate::depthsplat) fn forward_joined(&self, xs: &[&Tensor], then: Then<'_>) -> Result<Tensor> {
        let mut shape = xs[0].dims().to_vec();
        let channels: usize = xs.iter().map(|x| x.dims().last().copied().unwrap_or(0)).sum();
        assert_eq!(channels, self.inputs, "channels of a linear layer's input");
        if let Some(last) = shape.last_mut() {
            *last = self.outputs;
        }
        let rows = shape.iter().product::<usize>() / self.outputs;
        self.work.add(rows, self.inputs, self.outputs);
        match &self.form {
            Form::Packed(packed, bias) => {
                let slices = xs.iter().map(|x| values(x)).collect::<Result<Vec<_>>>()?;
                let inputs: Vec<(&[f32], usize)> =
                    slices.iter().zip(xs).map(|(v, x)| (&**v, x.dims()[x.rank() - 1])).collect();
                let y = then.on_slices(bias.as_ref(), |finish| {
                    kernels::dense(Joined { inputs: &inputs }, packed, finish)
                })?;
                tensor(y, shape)
            }
            Form::Composed(linear) => {
                then.compose(linear.forward(&Tensor::cat(xs, D::Minus1)?.contiguous()?)?)
            }
        }
    }
}

/// Which part of a token's vector: value c of head h lies at `first + h * step + c`.
#[derive(Debug, Clone, Copy)]
pub(in crate::depthsplat) struct Part<'a> {
    /// `[groups, tokens, channels]`.
    pub(in crate::depthsplat) of: &'a Tensor,
    pub(in crate::depthsplat) first: usize,
    pub(in crate::depthsplat) step: usize,
}

impl Part<'_> {
    /// `[groups, tokens, width]` of one head.
    fn head(&self, head: usize, width: usize) -> Result<Tensor> {
        self.of.narrow(D::Minus1, self.first + head * self.step, width)?.contiguous()
    }
}

/// Heads, their width, the factor of the scores.
#[derive(Debug, Clone, Copy)]
pub(in crate::depthsplat) struct AttentionShape<'a> {
    pub(in crate::depthsplat) heads: usize,
    pub(in crate::depthsplat) width: usize,
    pub(in crate::depthsplat) scale: f64,
    /// Labels of queries and keys, `[sets, tokens]` each, group g using set g modulo their number: where they differ,
    /// 100 is taken off the score.
    pub(in crate::depthsplat) labels: Option<(&'a Tensor, &'a Tensor)>,
    pub(in crate::depthsplat) work: &'a Work,
}

/// softmax(scale q kᵀ + mask) v, `[groups, queries, heads * width]`.
pub(in crate::depthsplat) fn attention(
    engine: Engine,
    shape: AttentionShape<'_>,
    [q, k, v]: [Part<'_>; 3],
) -> Result<Tensor> {
    let (groups, queries, _) = q.of.dims3()?;
    let (_, keys, _) = k.of.dims3()?;
    let AttentionShape { heads, width, scale, .. } = shape;
    shape.work.add(groups * queries * heads, 2 * width, keys);
    if engine == Engine::Composed {
        return compose_attention(shape, [q, k, v]);
    }
    let [q_values, k_values, v_values] = [values(q.of)?, values(k.of)?, values(v.of)?];
    let operand = |part: Part<'_>, values| -> Result<Heads<'_>> {
        Ok(Heads { values, stride: part.of.dim(D::Minus1)?, first: part.first, step: part.step })
    };
    let labels =
        shape.labels.map(|(q, k)| Ok::<_, candle_core::Error>((values(q)?, values(k)?))).transpose()?;
    let y = kernels::attend(&kernels::Attention {
        q: operand(q, &q_values)?,
        k: operand(k, &k_values)?,
        v: operand(v, &v_values)?,
        groups,
        queries,
        keys,
        heads,
        width,
        scale: scale as f32,
        labels: labels.as_ref().map(|(queries, keys)| Labels { queries, keys }),
    });
    tensor(y, (groups, queries, heads * width))
}

fn compose_attention(shape: AttentionShape<'_>, [q, k, v]: [Part<'_>; 3]) -> Result<Tensor> {
    let groups = q.of.dim(0)?;
    let mask = match shape.labels {
        None => None,
        Some((q, k)) => {
            let sets = q.dim(0)?;
            let apart = q.unsqueeze(2)?.broadcast_ne(&k.unsqueeze(1)?)?.to_dtype(q.dtype())?;
            let mask = (apart * -100.0)?;
            Some(Tensor::cat(&vec![mask; groups / sets], 0)?)
        }
    };
    let mut heads = Vec::new();
    for head in 0..shape.heads {
        let [q, k, v] = [q, k, v].map(|part| part.head(head, shape.width));
        let mut scores = (q?.matmul(&k?.transpose(1, 2)?.contiguous()?)? * shape.scale)?;
        if let Some(mask) = &mask {
            scores = (scores + mask)?;
        }
        heads.push(softmax(Engine::Composed, &scores)?.matmul(&v?)?);
    }
    Tensor::cat(&heads, D::Minus1)
}
