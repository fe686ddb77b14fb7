//! The message of the neighbours in one block, for each kind of head.

use super::layers::{Perceptron, max, part};
use crate::{CELL_WIDTH, Config, HEAD_WIDTH, HEADS, Kind, MESSAGE, WIDTH};
use candle_core::{Result, Tensor};
use candle_nn::{Linear, Module, VarBuilder, linear, ops};

/// Whom the anchors see: `seen` each, first itself.
pub(super) struct Neighbourhood {
    pub(super) n: usize,
    pub(super) seen: usize,
    /// Index, `[n * seen]`.
    pub(super) index: Tensor,
    /// p_j - p_i, `[n, seen, 3]`.
    pub(super) relative: Tensor,
    /// The fine and the coarse cell, `[n, 2]`.
    pub(super) cells: Tensor,
}

impl Neighbourhood {
    /// Rows of those seen, `[n, width]` to `[n, seen, width]`.
    fn seen(&self, x: &Tensor) -> Result<Tensor> {
        x.index_select(&self.index, 0)?.reshape((self.n, self.seen, ()))
    }

    /// Means of rows `[n, width]` over the fine (0) or the coarse (1) cells, for each anchor.
    fn means(&self, x: &Tensor, level: usize) -> Result<Tensor> {
        let cell = self.cells.narrow(1, level, 1)?.flatten_all()?.contiguous()?;
        let sum = |x: &Tensor| x.zeros_like()?.index_add(&cell, x, 0)?.index_select(&cell, 0);
        let count = sum(&Tensor::ones((self.n, 1), x.dtype(), x.device())?)?;
        sum(&x.contiguous()?)?.broadcast_div(&count)
    }
}

/// What is computed once per anchor, whoever looks at it.
struct Prepared {
    /// What an anchor itself brings, `[n, 128]`.
    own: Tensor,
    /// What it shows to those that see it, `[n, ..]` each.
    shown: Vec<Tensor>,
}

/// One block's way of gathering. Layers of pairs are taken apart ([`part`]) into the layers of h_i, of h_j (`other`) and of p_j - p_i
/// (`position`).
#[derive(Debug)]
pub(super) enum Gather {
    Attention {
        q: Linear,
        k: Linear,
        v: Linear,
        delta: Perceptron,
        proj: Linear,
    },
    EdgeConv {
        own: Linear,
        other: Linear,
        position: Linear,
        last: Linear,
    },
    MaxPool {
        other: Linear,
        position: Linear,
        last: Linear,
        join: Linear,
    },
    Mlp {
        other: Linear,
        position: Linear,
        mix: Perceptron,
    },
    Grid {
        cell: Linear,
        join: Linear,
    },
    /// The MLP without neighbours.
    Alone {
        mix: Perceptron,
    },
}

impl Gather {
    pub(super) fn load(config: &Config, vb: &VarBuilder<'_>) -> Result<Self> {
        let square = |name: &str| linear(WIDTH, WIDTH, vb.pp(name));
        Ok(match config.kind {
            Kind::Attention => Self::Attention {
                q: square("attn.q")?,
                k: square("attn.k")?,
                v: square("attn.v")?,
                delta: Perceptron::relu([3, WIDTH, WIDTH], &vb.pp("attn.delta"))?,
                proj: square("attn.proj")?,
            },
            Kind::EdgeConv => {
                let first = linear(2 * WIDTH + 3, WIDTH, vb.pp("edge.0"))?;
                Self::EdgeConv {
                    own: part(&first, 0, WIDTH)?,
                    other: part(&first, WIDTH, WIDTH)?,
                    position: part(&first, 2 * WIDTH, 3)?,
                    last: square("edge.2")?,
                }
            }
            Kind::MaxPool => {
                let first = linear(WIDTH + 3, WIDTH, vb.pp("pool.0"))?;
                Self::MaxPool {
                    other: part(&first, 0, WIDTH)?,
                    position: part(&first, WIDTH, 3)?,
                    last: square("pool.2")?,
                    join: linear(2 * WIDTH, WIDTH, vb.pp("join"))?,
                }
            }
            Kind::Mlp => {
                let inputs = WIDTH + config.neighbours * MESSAGE;
                let mix = Perceptron::relu([inputs, WIDTH, WIDTH], &vb.pp("mix"))?;
                if config.neighbours == 0 {
                    return Ok(Self::Alone { mix });
                }
                let message = linear(WIDTH + 3, MESSAGE, vb.pp("message"))?;
                Self::Mlp { other: part(&message, 0, WIDTH)?, position: part(&message, WIDTH, 3)?, mix }
            }
            Kind::Grid => Self::Grid {
                cell: linear(WIDTH, 2 * CELL_WIDTH, vb.pp("cell"))?,
                join: linear(2 * CELL_WIDTH, WIDTH, vb.pp("join"))?,
            },
        })
    }

    /// From the normalised features h of all anchors, `[n, 128]`.
    fn prepare(&self, h: &Tensor) -> Result<Prepared> {
        Ok(match self {
            Self::Attention { q, k, v, .. } => {
                Prepared { own: q.forward(h)?, shown: vec![k.forward(h)?, v.forward(h)?] }
            }
            Self::EdgeConv { own: anchor, other, .. } => {
                // The layer of h_j - h_i is that of h_j less that of h_i.
                let other = other.forward(h)?;
                Prepared { own: (anchor.forward(h)? - &other)?, shown: vec![other] }
            }
            Self::MaxPool { other, .. } | Self::Mlp { other, .. } => {
                Prepared { own: h.clone(), shown: vec![other.forward(h)?] }
            }
            Self::Grid { cell, .. } => Prepared { own: cell.forward(h)?, shown: Vec::new() },
            Self::Alone { .. } => Prepared { own: h.clone(), shown: Vec::new() },
        })
    }

    /// What the anchors learn from their normalised features h, `[n, 128]`, and for the attention with which weights,
    /// `[n, seen, heads]`.
    pub(super) fn forward(&self, h: &Tensor, hood: &Neighbourhood) -> Result<(Tensor, Option<Tensor>)> {
        let Prepared { own: anchors, shown } = self.prepare(h)?;
        let shown = shown.iter().map(|x| hood.seen(x)).collect::<Result<Vec<_>>>()?;
        let pairs = |position: &Linear| &shown[0] + position.forward(&hood.relative)?;
        let learnt = match self {
            Self::Attention { delta, proj, .. } => {
                let delta = delta.forward(&hood.relative)?;
                let (o, alpha) = attend(&anchors, &shown[0], &shown[1], &delta)?;
                return Ok((proj.forward(&o)?, Some(alpha)));
            }
            Self::EdgeConv { position, last, .. } => {
                let hidden = pairs(position)?.broadcast_add(&anchors.unsqueeze(1)?)?.relu()?;
                max(&last.forward(&hidden)?)?
            }
            Self::MaxPool { position, last, join, .. } => {
                let pooled = max(&last.forward(&pairs(position)?.relu()?)?)?;
                join.forward(&Tensor::cat(&[anchors, pooled], 1)?)?
            }
            Self::Mlp { position, mix, .. } => {
                // The anchor itself sends no message.
                let messages = pairs(position)?.narrow(1, 1, hood.seen - 1)?.flatten_from(1)?;
                mix.forward(&Tensor::cat(&[anchors, messages], 1)?)?
            }
            Self::Grid { join, .. } => {
                let means = |level| hood.means(&anchors.narrow(1, level * CELL_WIDTH, CELL_WIDTH)?, level);
                join.forward(&Tensor::cat(&[means(0)?, means(1)?], 1)?)?
            }
            Self::Alone { mix } => mix.forward(&anchors)?,
        };
        Ok((learnt, None))
    }
}

/// Attention with one weight per pair and attention head: q `[n, 128]`, k, v and delta `[n, seen, 128]`.
fn attend(q: &Tensor, k: &Tensor, v: &Tensor, delta: &Tensor) -> Result<(Tensor, Tensor)> {
    let (anchors, seen, _) = k.dims3()?;
    let by_head = (anchors, seen, HEADS, HEAD_WIDTH);
    let q = q.unsqueeze(1)?;
    let products = (delta - k)?.broadcast_add(&q)?.broadcast_mul(&q)?.reshape(by_head)?;
    let alpha = ops::softmax(&(products.sum(3)? / (HEAD_WIDTH as f64).sqrt())?, 1)?;
    let values = (v + delta)?.reshape(by_head)?;
    let o = values.broadcast_mul(&alpha.unsqueeze(3)?)?.sum(1)?;
    Ok((o.flatten_from(1)?, alpha))
}
