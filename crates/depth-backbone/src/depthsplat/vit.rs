//! The vision transformer that sees each view alone (`pretrained`): DINOv2 with patches of 14 pixels.

use super::layers::{AttentionShape, Conv, Engine, LayerNorm, Linear, Part, Then, Work, attention, bilinear};
use super::params::Params;
use super::taps::Taps;
use super::variant::Vit;
use candle_core::{Device, Result, Tensor};

/// Side of a patch, pixels.
const PATCH: usize = 14;
/// Side of the grid of positions that was trained.
const GRID: usize = 37;
/// Channels of a head.
const HEAD: usize = 64;
const EPS: f64 = 1e-6;

struct Block {
    norm1: LayerNorm,
    qkv: Linear,
    proj: Linear,
    ls1: Tensor,
    norm2: LayerNorm,
    fc1: Linear,
    fc2: Linear,
    ls2: Tensor,
    engine: Engine,
    work: Work,
}

impl Block {
    fn new(p: &Params, width: usize) -> Result<Self> {
        let gamma = |name| p.pp(name).get("gamma", &[width]);
        Ok(Self {
            norm1: LayerNorm::new(&p.pp("norm1"), width, EPS)?,
            qkv: Linear::new(&p.pp("attn.qkv"), width, 3 * width)?,
            proj: Linear::new(&p.pp("attn.proj"), width, width)?,
            ls1: gamma("ls1")?,
            norm2: LayerNorm::new(&p.pp("norm2"), width, EPS)?,
            fc1: Linear::new(&p.pp("mlp.fc1"), width, 4 * width)?,
            fc2: Linear::new(&p.pp("mlp.fc2"), 4 * width, width)?,
            ls2: gamma("ls2")?,
            engine: p.engine(),
            work: p.work().clone(),
        })
    }

    fn forward(&self, x: &Tensor) -> Result<Tensor> {
        let (_, _, width) = x.dims3()?;
        let qkv = self.qkv.forward(&self.norm1.forward(x)?)?;
        let shape = AttentionShape {
            heads: width / HEAD,
            width: HEAD,
            scale: 1.0 / (HEAD as f64).sqrt(),
            labels: None,
            work: &self.work,
        };
        let parts = [0, width, 2 * width].map(|first| Part { of: &qkv, first, step: HEAD });
        let y = attention(self.engine, shape, parts)?;
        let x = self.proj.forward_then(&y, Then::plus(x).times(&self.ls1))?;
        let y = self.fc1.forward_then(&self.norm2.forward(&x)?, Then::GELU)?;
        self.fc2.forward_then(&y, Then::plus(&x).times(&self.ls2))
    }
}

pub(super) struct VisionTransformer {
    cls_token: Tensor,
    /// On the CPU.
    pos_embed: Vec<f32>,
    patch_embed: Conv,
    blocks: Vec<Block>,
    norm: LayerNorm,
    kind: Vit,
}

impl VisionTransformer {
    pub(super) fn new(p: &Params, kind: Vit) -> Result<Self> {
        let width = kind.width();
        let patch = Conv::shape(PATCH, 3, width).stride(PATCH).unpadded();
        Ok(Self {
            cls_token: p.get("cls_token", &[1, 1, width])?,
            pos_embed: p.get("pos_embed", &[1, 1 + GRID * GRID, width])?.flatten_all()?.to_vec1()?,
            patch_embed: patch.load(&p.pp("patch_embed.proj"))?,
            blocks: (0..kind.depth())
                .map(|i| Block::new(&p.pp(format!("blocks.{i}")), width))
                .collect::<Result<_>>()?,
            norm: LayerNorm::new(&p.pp("norm"), width, EPS)?,
            kind,
        })
    }

    /// Four maps `[n, h / 8, w / 8, width]` of normalised images `[n, h, w, 3]`.
    pub(super) fn forward(&self, images: &Tensor, taps: &mut Taps) -> Result<Vec<Tensor>> {
        let (count, height, width, _) = images.dims4()?;
        let (rows, columns) = (height / PATCH, width / PATCH);
        let x = bilinear(images, rows * PATCH, columns * PATCH)?;
        taps.map("vit.input", &x)?;
        let channels = self.kind.width();
        let x = self.patch_embed.forward(&x)?.reshape((count, rows * columns, channels))?;
        taps.plain("vit.patch_embed", &x)?;
        let positions = resized_positions(&self.pos_embed, channels, rows, columns, images.device())?;
        let cls = self.cls_token.broadcast_as((count, 1, channels))?;
        let mut x = Tensor::cat(&[&cls.contiguous()?, &x], 1)?.broadcast_add(&positions)?;
        let mut maps = Vec::new();
        for (i, block) in self.blocks.iter().enumerate() {
            x = block.forward(&x)?;
            if i == 0 {
                taps.plain("vit.block0", &x)?;
            }
            if self.kind.tapped().contains(&i) {
                let y = self.norm.forward(&x)?.narrow(1, 1, rows * columns)?.contiguous()?;
                taps.plain(format!("vit.layer{}", maps.len()), &y)?;
                let y = bilinear(&y.reshape((count, rows, columns, channels))?, height / 8, width / 8)?;
                taps.map(format!("mono.i{}", maps.len()), &y)?;
                maps.push(y);
            }
        }
        if taps.wanted() {
            taps.plain("vit.pos_embed", &positions)?;
        }
        Ok(maps)
    }
}

/// The table of positions, `[1, 1 + rows * columns, channels]`, by bicubic interpolation of the trained grid.
fn resized_positions(
    table: &[f32],
    channels: usize,
    rows: usize,
    columns: usize,
    device: &Device,
) -> Result<Tensor> {
    let tokens = 1 + rows * columns;
    if (rows, columns) == (GRID, GRID) {
        return Tensor::from_slice(table, (1, tokens, channels), device);
    }
    let (vertical, horizontal) = (cubic_axis(rows), cubic_axis(columns));
    let (first, grid) = table.split_at(channels);
    let mut out = first.to_vec();
    for (ys, wy) in &vertical {
        // One row of the result, still 37 columns wide.
        let mut line = vec![0.0_f32; GRID * channels];
        for (&y, &w) in ys.iter().zip(wy) {
            for (sum, value) in line.iter_mut().zip(&grid[y * GRID * channels..]) {
                *sum += value * w;
            }
        }
        for (xs, wx) in &horizontal {
            for c in 0..channels {
                out.push(xs.iter().zip(wx).map(|(&x, &w)| line[x * channels + c] * w).sum());
            }
        }
    }
    Tensor::from_vec(out, (1, tokens, channels), device)
}

/// Places and weights of the four neighbours of each of `n` positions on the trained grid.
fn cubic_axis(n: usize) -> Vec<([usize; 4], [f32; 4])> {
    // DINOv2 states the scale with 0.1 added to the size, and the positions follow from that scale.
    let step = (1.0 / ((n as f64 + 0.1) / GRID as f64)) as f32;
    let position = |i: usize| {
        let coordinate = step * (i as f32 + 0.5) - 0.5;
        let first = coordinate.floor();
        let t = f64::from(coordinate - first);
        let place = |k: i64| (first as i64 + k).clamp(0, GRID as i64 - 1) as usize;
        let weights = [t + 1.0, t, 1.0 - t, 2.0 - t].map(|x| cubic(x) as f32);
        ([place(-1), place(0), place(1), place(2)], weights)
    };
    (0..n).map(position).collect()
}

/// Keys' cubic convolution kernel with a = -0.75 at a distance 0 ≤ x ≤ 2.
fn cubic(x: f64) -> f64 {
    const A: f64 = -0.75;
    if x <= 1.0 {
        ((A + 2.0) * x - (A + 3.0)) * x * x + 1.0
    } else {
        ((A * x - 5.0 * A) * x + 8.0 * A) * x - 4.0 * A
    }
}
