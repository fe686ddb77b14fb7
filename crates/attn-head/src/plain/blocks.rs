//! The message of the neighbours in one block, for each kind of head.

use super::ops::{Parameters, max, project, softmax};
use crate::{HEAD_WIDTH, HEADS, Kind, MESSAGE, Result, WIDTH};
use candle_core::Tensor;
use std::ops::Range;

/// The anchors of one chunk, and whom they see: `seen` each, first itself.
pub(super) struct Neighbourhood {
    pub(super) anchors: Range<usize>,
    pub(super) seen: usize,
    /// Index, `[anchors * seen]`.
    pub(super) index: Tensor,
    /// p_j - p_i, `[anchors, seen, 3]`.
    pub(super) relative: Tensor,
}

impl Neighbourhood {
    fn len(&self) -> usize {
        self.anchors.len()
    }

    /// Rows of the chunk's anchors, `[n, ..]` to `[anchors, ..]`.
    pub(super) fn own(&self, x: &Tensor) -> Result<Tensor> {
        Ok(x.narrow(0, self.anchors.start, self.len())?)
    }

    /// Rows of those seen, `[n, width]` to `[anchors, seen, width]`.
    fn seen(&self, x: &Tensor) -> Result<Tensor> {
        Ok(x.index_select(&self.index, 0)?.reshape((self.len(), self.seen, ()))?)
    }
}

/// What is computed once per anchor, whoever looks at it.
pub(super) struct Prepared {
    /// What an anchor itself brings, `[n, 128]`.
    own: Tensor,
    /// What it shows to those that see it, `[n, ..]` each.
    shown: Vec<Tensor>,
}

/// One block's way of gathering.
pub(super) struct Gather<'a> {
    pub(super) kind: Kind,
    pub(super) parameters: &'a Parameters,
    /// `blocks.0`.
    pub(super) block: String,
}

impl Gather<'_> {
    fn name(&self, part: &str) -> String {
        format!("{}.{part}", self.block)
    }

    /// The columns of a linear layer's weight that belong to part of its input.
    fn columns(&self, part: &str, start: usize, len: usize) -> Result<Tensor> {
        let weight = self.parameters.get(&self.name(&format!("{part}.weight")));
        Ok(weight.narrow(1, start, len)?.contiguous()?)
    }

    /// From the normalised features h of all anchors, `[n, 128]`. Linear layers of pairs are taken apart into what
    /// depends on i, on j, and on p_j - p_i, since the first two are the same for all pairs of an anchor.
    pub(super) fn prepare(&self, h: &Tensor) -> Result<Prepared> {
        let linear = |part: &str| self.parameters.linear(&self.name(part), h);
        let bias = |part: &str| self.parameters.get(&self.name(&format!("{part}.bias")));
        // The part of a pair's linear layer that begins with h_j and ends with p_j - p_i.
        let of_neighbour = |part: &str| -> Result<Tensor> {
            Ok(project(h, &self.columns(part, 0, WIDTH)?)?.broadcast_add(bias(part))?)
        };
        Ok(match self.kind {
            Kind::Attention => {
                Prepared { own: linear("attn.q")?, shown: vec![linear("attn.k")?, linear("attn.v")?] }
            }
            Kind::EdgeConv => {
                // A h_i + B (h_j - h_i) = (A - B) h_i + B h_j.
                let (a, b) = (self.columns("edge.0", 0, WIDTH)?, self.columns("edge.0", WIDTH, WIDTH)?);
                let own = project(h, &(a - &b)?)?.broadcast_add(bias("edge.0"))?;
                Prepared { own, shown: vec![project(h, &b)?] }
            }
            Kind::MaxPool => Prepared { own: h.clone(), shown: vec![of_neighbour("pool.0")?] },
            Kind::Mlp if self.has_messages() => {
                Prepared { own: h.clone(), shown: vec![of_neighbour("message")?] }
            }
            Kind::Mlp => Prepared { own: h.clone(), shown: Vec::new() },
        })
    }

    /// An MLP without neighbours has no layer for them.
    fn has_messages(&self) -> bool {
        self.parameters.has(&self.name("message.weight"))
    }

    /// What the anchors of a chunk learn, `[anchors, 128]`, and for the attention with which weights,
    /// `[anchors, seen, heads]`.
    pub(super) fn gather(
        &self,
        prepared: &Prepared,
        hood: &Neighbourhood,
    ) -> Result<(Tensor, Option<Tensor>)> {
        let own = hood.own(&prepared.own)?;
        let shown = prepared.shown.iter().map(|x| hood.seen(x)).collect::<Result<Vec<_>>>()?;
        let linear = |part: &str, x: &Tensor| self.parameters.linear(&self.name(part), x);
        let position = |part: &str, start| project(&hood.relative, &self.columns(part, start, 3)?);
        let learnt = match (self.kind, shown.as_slice()) {
            (Kind::Attention, [k, v]) => {
                let (o, alpha) = self.attend(&own, k, v, hood)?;
                return Ok((linear("attn.proj", &o)?, Some(alpha)));
            }
            (Kind::EdgeConv, [other]) => {
                let hidden = (other + position("edge.0", 2 * WIDTH)?)?.broadcast_add(&own.unsqueeze(1)?)?;
                max(&linear("edge.2", &hidden.relu()?)?)?
            }
            (Kind::MaxPool, [other]) => {
                let hidden = (other + position("pool.0", WIDTH)?)?.relu()?;
                linear("join", &Tensor::cat(&[own, max(&linear("pool.2", &hidden)?)?], 1)?)?
            }
            (Kind::Mlp, [other]) => {
                let neighbours = hood.seen - 1;
                let messages = (other + position("message", WIDTH)?)?.narrow(1, 1, neighbours)?;
                let messages = messages.reshape((hood.len(), neighbours * MESSAGE))?;
                self.parameters.relu_mlp(&self.name("mix"), &Tensor::cat(&[own, messages], 1)?)?
            }
            _ => self.parameters.relu_mlp(&self.name("mix"), &own)?,
        };
        Ok((learnt, None))
    }

    /// Attention with one weight per pair and attention head.
    fn attend(&self, q: &Tensor, k: &Tensor, v: &Tensor, hood: &Neighbourhood) -> Result<(Tensor, Tensor)> {
        let by_head = (hood.len(), hood.seen, HEADS, HEAD_WIDTH);
        let delta = self.parameters.relu_mlp(&self.name("attn.delta"), &hood.relative)?;
        let q = q.unsqueeze(1)?;
        let difference = (&delta - k)?.broadcast_add(&q)?;
        let products = difference.broadcast_mul(&q)?.reshape(by_head)?;
        let alpha = softmax(&(products.sum(3)? / (HEAD_WIDTH as f64).sqrt())?)?;
        let values = (v + delta)?.reshape(by_head)?;
        let o = values.broadcast_mul(&alpha.unsqueeze(3)?)?.sum(1)?;
        Ok((o.reshape((hood.len(), WIDTH))?, alpha))
    }
}
