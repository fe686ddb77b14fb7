//! The multi-view transformer (`transformer`): windows of each view attend to the same windows of its neighbours.

use super::layers::{AttentionShape, Engine, LayerNorm, Linear, Part, Then, Work, attention};
use super::params::Params;
use super::taps::Taps;
use candle_core::{Device, Result, Tensor};

/// Channels of the features.
const WIDTH: usize = 128;
const LAYERS: usize = 6;
/// Windows per side.
const SPLITS: usize = 2;

/// One attention with what follows it.
struct Attention {
    q_proj: Linear,
    k_proj: Linear,
    v_proj: Linear,
    merge: Linear,
    norm1: LayerNorm,
    engine: Engine,
    work: Work,
}

impl Attention {
    fn new(p: &Params) -> Result<Self> {
        let linear = |name| Linear::without_bias(&p.pp(name), WIDTH, WIDTH);
        Ok(Self {
            q_proj: linear("q_proj")?,
            k_proj: linear("k_proj")?,
            v_proj: linear("v_proj")?,
            merge: linear("merge")?,
            norm1: LayerNorm::new(&p.pp("norm1"), WIDTH, 1e-5)?,
            engine: p.engine(),
            work: p.work().clone(),
        })
    }

    /// The message to the tokens `x` `[windows, tokens, width]` from keys and values `[windows, keys, width]`.
    fn forward(
        &self,
        x: &Tensor,
        k: &Tensor,
        v: &Tensor,
        labels: Option<(&Tensor, &Tensor)>,
    ) -> Result<Tensor> {
        let shape = AttentionShape {
            heads: 1,
            width: WIDTH,
            scale: 1.0 / (WIDTH as f64).sqrt(),
            labels,
            work: &self.work,
        };
        let q = self.q_proj.forward(x)?;
        let parts = [&q, k, v].map(|tensor| Part { of: tensor, first: 0, step: WIDTH });
        self.norm1.forward(&self.merge.forward(&attention(self.engine, shape, parts)?)?)
    }
}

struct Layer {
    self_attn: Attention,
    cross_attn: Attention,
    mlp: [Linear; 2],
    norm2: LayerNorm,
}

impl Layer {
    fn new(p: &Params) -> Result<Self> {
        let cross = p.pp("cross_attn_ffn");
        Ok(Self {
            self_attn: Attention::new(&p.pp("self_attn"))?,
            cross_attn: Attention::new(&cross)?,
            mlp: [
                Linear::without_bias(&cross.pp("mlp.0"), 2 * WIDTH, 8 * WIDTH)?,
                Linear::without_bias(&cross.pp("mlp.2"), 8 * WIDTH, WIDTH)?,
            ],
            norm2: LayerNorm::new(&cross.pp("norm2"), WIDTH, 1e-5)?,
        })
    }

    /// `x`: tokens of all windows of all views; returns them after the self-attention and after the layer.
    fn forward(&self, x: &Tensor, windows: &Windows) -> Result<(Tensor, Tensor)> {
        let (k, v) = (self.self_attn.k_proj.forward(x)?, self.self_attn.v_proj.forward(x)?);
        let labels = windows.labels.as_ref();
        let a = (x + self.self_attn.forward(x, &k, &v, labels.map(|l| (&l.queries, &l.queries)))?)?;
        // The others' keys and values come from what enters the layer, not from their own self-attention.
        let k = windows.of_neighbours(&self.cross_attn.k_proj.forward(x)?)?;
        let v = windows.of_neighbours(&self.cross_attn.v_proj.forward(x)?)?;
        let message = self.cross_attn.forward(&a, &k, &v, labels.map(|l| (&l.queries, &l.keys)))?;
        let hidden = self.mlp[0].forward_joined(&[&a, &message], Then::GELU)?;
        let y = (&a + self.norm2.forward(&self.mlp[1].forward(&hidden)?)?)?;
        Ok((a, y))
    }
}

/// Regions of a window after the shift: tokens of different regions are no neighbours in the image.
struct RegionLabels {
    /// `[4, tokens]`.
    queries: Tensor,
    /// `[4, neighbours * tokens]`.
    keys: Tensor,
}

/// How maps are cut into windows.
struct Windows {
    /// Pixel of each token, window by window.
    order: Tensor,
    /// Token of each pixel.
    inverse: Tensor,
    /// Token of each key, counted over all views.
    keys: Tensor,
    tokens: usize,
    neighbours: usize,
    labels: Option<RegionLabels>,
}

impl Windows {
    fn new(size: (usize, usize), neighbours: &[Vec<usize>], shifted: bool, device: &Device) -> Result<Self> {
        let (height, width) = size;
        let (wh, ww) = (height / SPLITS, width / SPLITS);
        let tokens = wh * ww;
        let (down, right) = if shifted { (wh / 2, ww / 2) } else { (0, 0) };
        let label = |i: usize, n: usize, window: usize, shift: usize| {
            if i < n - window {
                0
            } else if i < n - shift {
                1
            } else {
                2
            }
        };
        let (mut order, mut regions) = (Vec::new(), Vec::new());
        for i in 0..SPLITS * SPLITS * tokens {
            let (window, token) = (i / tokens, i % tokens);
            let (row, column) = (window / SPLITS * wh + token / ww, window % SPLITS * ww + token % ww);
            order.push(((row + down) % height * width + (column + right) % width) as u32);
            regions.push((3 * label(row, height, wh, down) + label(column, width, ww, right)) as f32);
        }
        let mut inverse = vec![0; order.len()];
        for (token, &pixel) in order.iter().enumerate() {
            inverse[pixel as usize] = token as u32;
        }
        let count = neighbours.first().map_or(0, Vec::len);
        let mut keys = Vec::new();
        for others in neighbours {
            for i in 0..SPLITS * SPLITS * tokens {
                keys.extend(others.iter().map(|&other| (other * order.len() + i) as u32));
            }
        }
        let labels = if shifted {
            // Keys lie position by position, the neighbours of a position side by side; yet the network was trained with
            // the labels of whole neighbours one after the other. With one neighbour it is the same.
            let all: Vec<f32> =
                regions.chunks_exact(tokens).flat_map(|window| window.repeat(count)).collect();
            let (sets, keys) = (SPLITS * SPLITS, tokens * count);
            Some(RegionLabels {
                queries: Tensor::from_vec(regions, (sets, tokens), device)?,
                keys: Tensor::from_vec(all, (sets, keys), device)?,
            })
        } else {
            None
        };
        let index = |values: Vec<u32>| {
            let n = values.len();
            Tensor::from_vec(values, n, device)
        };
        let (order, inverse, keys) = (index(order)?, index(inverse)?, index(keys)?);
        Ok(Self { order, inverse, keys, tokens, neighbours: count, labels })
    }

    /// `[views, pixels, width]` to `[views * 4, tokens, width]`.
    fn cut(&self, x: &Tensor) -> Result<Tensor> {
        x.index_select(&self.order, 1)?.reshape(((), self.tokens, WIDTH))
    }

    /// Undoes [`Self::cut`].
    fn joined(&self, x: &Tensor) -> Result<Tensor> {
        x.reshape(((), SPLITS * SPLITS * self.tokens, WIDTH))?.index_select(&self.inverse, 1)
    }

    /// The tokens of every view's neighbours, `[views * 4, tokens * neighbours, width]`.
    fn of_neighbours(&self, x: &Tensor) -> Result<Tensor> {
        let all = x.reshape(((), WIDTH))?.index_select(&self.keys, 0)?;
        all.reshape(((), self.tokens * self.neighbours, WIDTH))
    }
}

/// Sines and cosines of the place in the window, `[height * width, 128]`: half of the channels for the row, half for the
/// column.
fn position_code(height: usize, width: usize, device: &Device) -> Result<Tensor> {
    let half = WIDTH / 2;
    let code = |place: usize, size: usize, k: usize| {
        // In f32, as where the network was trained.
        let angle = (place + 1) as f32 / (size as f32 + 1e-6) * 2.0 * std::f32::consts::PI;
        let angle = angle / 10_000_f32.powf((2 * (k / 2)) as f32 / half as f32);
        if k.is_multiple_of(2) { angle.sin() } else { angle.cos() }
    };
    let (wh, ww) = (height / SPLITS, width / SPLITS);
    let value = |i: usize| {
        let (row, column, k) = (i / WIDTH / width % wh, i / WIDTH % width % ww, i % WIDTH);
        if k < half { code(row, wh, k) } else { code(column, ww, k - half) }
    };
    let values: Vec<f32> = (0..height * width * WIDTH).map(value).collect();
    Tensor::from_vec(values, (height * width, WIDTH), device)
}

pub(super) struct Transformer {
    layers: Vec<Layer>,
}

impl Transformer {
    pub(super) fn new(p: &Params) -> Result<Self> {
        let layers = (0..LAYERS).map(|l| Layer::new(&p.pp(format!("layers.{l}")))).collect::<Result<_>>()?;
        Ok(Self { layers })
    }

    /// Features `[views, h, w, 128]` that know of those of their `neighbours`, of which every view has as many.
    pub(super) fn forward(&self, low: &Tensor, neighbours: &[Vec<usize>], taps: &mut Taps) -> Result<Tensor> {
        let (views, height, width, _) = low.dims4()?;
        let device = low.device();
        let windows = [false, true].map(|s| Windows::new((height, width), neighbours, s, device));
        let [plain, shifted] = windows;
        let windows = [plain?, shifted?];
        let code = position_code(height, width, device)?;
        let mut x = low.reshape((views, height * width, WIDTH))?.broadcast_add(&code)?;
        taps.map("mv.input", &x.reshape(low.shape())?)?;
        for (l, layer) in self.layers.iter().enumerate() {
            let windows = &windows[l % 2];
            let (a, y) = layer.forward(&windows.cut(&x)?, windows)?;
            if taps.wanted() {
                taps.plain(format!("mv.layer{l}.self"), &windows.joined(&a)?)?;
            }
            x = windows.joined(&y)?;
            taps.plain(format!("mv.layer{l}"), &x)?;
        }
        x.reshape(low.shape())
    }
}
