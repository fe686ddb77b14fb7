//! The depth network as a whole (`depth_predictor`), and the heads for features and Gaussians.

use super::cnn::{Cnn, CnnFeatures};
use super::cost_volume::{self, Bounds};
use super::dpt::{DepthResidual, Dpt, DptInputs};
use super::gaussian_head::{GaussianHead, HeadInputs, PixelGaussian};
use super::layers::{Conv, ConvTranspose, Then, Work, bilinear, join, nearest};
use super::params::Params;
use super::regressor::{Regressor, expectation};
use super::taps::Taps;
use super::transformer::Transformer;
use super::variant::Variant;
use super::vit::VisionTransformer;
use candle_core::{D, Device, Result, Tensor};
use gs_scene::Camera;
use std::time::Instant;

/// Maps of a second scale, at twice the resolution.
struct Finer {
    up: ConvTranspose,
    conv: Conv,
}

impl Finer {
    fn new(p: &Params, inputs: usize, outputs: usize) -> Result<Self> {
        Ok(Self {
            up: ConvTranspose::new(&p.pp("stages.1.0"), inputs, outputs, 2)?,
            conv: Conv::shape(3, outputs, outputs).load(&p.pp("stages.1.2"))?,
        })
    }

    fn forward(&self, x: &Tensor) -> Result<Tensor> {
        self.conv.forward(&self.up.forward_then(x, Then::GELU)?)
    }
}

/// Views of one size, a multiple of [`super::Scales::multiple`].
pub(super) struct NetworkInputs<'a> {
    /// `[views, h, w, 3]`, 0..1, on the network's device.
    pub(super) images: &'a Tensor,
    pub(super) cameras: &'a [Camera],
    pub(super) bounds: &'a [Bounds],
}

/// What the network finds out.
pub(super) struct NetworkOutputs {
    /// z-depth `[views, h, w, 1]`.
    pub(super) depth: Tensor,
    /// Largest probability of a candidate, `[views, h / u, w / u, 1]` with u the upsampling factor.
    pub(super) match_probability: Tensor,
    /// `[views, h, w, channels]`, if wanted.
    pub(super) features: Option<Tensor>,
}

pub(super) struct Network {
    variant: Variant,
    backbone: Cnn,
    transformer: Transformer,
    pretrained: VisionTransformer,
    mv_pyramid: Option<Finer>,
    mono_pyramid: Option<Finer>,
    regressors: Vec<Regressor>,
    upsampler: Dpt,
    depth_residual: DepthResidual,
    /// Not in checkpoints of depth alone.
    heads: Option<(Dpt, GaussianHead)>,
    device: Device,
    work: Work,
}

impl Network {
    /// `p`: names as in the GS checkpoints, without `encoder.`.
    pub(super) fn new(p: &Params, variant: Variant, with_heads: bool) -> Result<Self> {
        let root = p;
        let p = p.pp("depth_predictor");
        let (scales, vit) = (variant.scales, variant.vit);
        let two = scales.count() == 2;
        let finer =
            |name, width| if two { Finer::new(&p.pp(name), width, width / 2).map(Some) } else { Ok(None) };
        let regressor = |s: usize| {
            let candidates = cost_volume::candidates(s);
            let inputs = candidates + [128, 96][s] + (128 >> s) + (vit.width() >> s);
            Regressor::new(&p, s, inputs, candidates)
        };
        let upsampler = p.pp("upsampler");
        Ok(Self {
            variant,
            backbone: Cnn::new(&p.pp("backbone"), scales.lowest())?,
            transformer: Transformer::new(&p.pp("transformer"))?,
            pretrained: VisionTransformer::new(&p.pp("pretrained"), vit)?,
            mv_pyramid: finer("mv_pyramid", 128)?,
            mono_pyramid: finer("mono_pyramid", vit.width())?,
            regressors: (0..scales.count()).map(regressor).collect::<Result<_>>()?,
            upsampler: Dpt::new(&upsampler, variant, vit.dpt_width(), true, "dpt")?,
            depth_residual: DepthResidual::new(&upsampler, vit.dpt_width())?,
            heads: if with_heads {
                let width = 2 * vit.dpt_width();
                let upsampler = Dpt::new(&root.pp("feature_upsampler"), variant, width, false, "fdpt")?;
                Some((upsampler, GaussianHead::new(root, variant)?))
            } else {
                None
            },
            device: root.device().clone(),
            work: root.work().clone(),
        })
    }

    pub(super) fn variant(&self) -> Variant {
        self.variant
    }

    pub(super) fn device(&self) -> &Device {
        &self.device
    }

    /// Whether there are weights for features and Gaussians.
    pub(super) fn has_heads(&self) -> bool {
        self.heads.is_some()
    }

    /// Runs a stage and notes its time.
    fn timed<T>(
        &self,
        taps: &mut Taps,
        stage: &'static str,
        run: impl FnOnce(&mut Taps) -> Result<T>,
    ) -> Result<T> {
        let (start, before) = (Instant::now(), self.work.total());
        let result = run(taps)?;
        taps.time(stage, start, self.work.total() - before);
        Ok(result)
    }

    /// Depth and, if wanted and the weights are there, features of all views.
    pub(super) fn forward(
        &self,
        inputs: &NetworkInputs<'_>,
        with_features: bool,
        taps: &mut Taps,
    ) -> Result<NetworkOutputs> {
        let (_, height, width, _) = inputs.images.dims4()?;
        let images = normalised(inputs.images)?;
        let neighbours = cost_volume::neighbours(inputs.cameras);
        let cnn = self.timed(taps, "cnn", |taps| self.cnn(&images, taps))?;
        let low = joined_views(&cnn, |c| &c.low)?;
        let mv = self.timed(taps, "transformer", |taps| self.transformer.forward(&low, &neighbours, taps))?;
        let intermediate = self.timed(taps, "vit", |taps| self.pretrained.forward(&images, taps))?;
        let (mv, mono) = self.timed(taps, "pyramids", |_| self.pyramids(&mv, &intermediate[3]))?;
        let mut inverse_depth = None;
        let mut match_probability = None;
        for (s, regressor) in self.regressors.iter().enumerate() {
            taps.map(format!("mv.s{s}"), &mv[s])?;
            taps.map(format!("mono.s{s}"), &mono[s])?;
            let factor = self.variant.scales.upsampling() << (self.regressors.len() - 1 - s);
            let (cost, candidates) = self.timed(taps, "cost volume", |taps| {
                let candidates = match &inverse_depth {
                    None => cost_volume::uniform_candidates(inputs.bounds)?,
                    Some(coarse) => {
                        let coarse = bilinear(coarse, height / factor, width / factor)?;
                        cost_volume::refined_candidates(&coarse.to_device(&Device::Cpu)?, inputs.bounds, s)?
                    }
                };
                taps.map(format!("warp.s{s}.candidates"), &candidates)?;
                let scale = (factor, s);
                let cost =
                    cost_volume::cost_volume(&mv[s], inputs.cameras, &neighbours, &candidates, scale, taps)?;
                taps.map(format!("cost.s{s}"), &cost)?;
                Ok((cost.to_device(&self.device)?, candidates.to_device(&self.device)?))
            })?;
            let probability = self.timed(taps, "regressor", |taps| {
                let cnn_features = match s {
                    0 => low.clone(),
                    _ => joined_views(&cnn, |c| &c.mid)?,
                };
                regressor.forward(&join(&[&cost, &cnn_features, &mv[s], &mono[s]])?, taps)
            })?;
            let z = expectation(&probability, &candidates)?;
            taps.map(format!("depth.s{s}.inv"), &z)?;
            inverse_depth = Some(z);
            match_probability = Some(probability.max_keepdim(D::Minus1)?);
        }
        let (Some(coarse), Some(match_probability)) = (inverse_depth, match_probability) else {
            return Err(candle_core::Error::Msg("a network without scales".to_owned()));
        };
        // View by view from here on: the maps are large.
        let (mut depths, mut features) = (Vec::new(), Vec::new());
        for (view, cnn) in cnn.iter().enumerate() {
            let one = |x: &Tensor| x.narrow(0, view, 1)?.contiguous();
            let mono = intermediate.iter().map(one).collect::<Result<Vec<_>>>()?;
            let mv = mv.iter().map(one).collect::<Result<Vec<_>>>()?;
            let z = one(&coarse)?;
            let mut dpt_inputs = DptInputs { mono: &mono, cnn, mv: &mv, inverse_depth: Some(&z) };
            depths.push(self.timed(taps, "upsampler", |taps| {
                let residual = self.depth_residual.forward(&self.upsampler.forward(&dpt_inputs, taps)?)?;
                taps.map("dpt.residual", &residual)?;
                let Bounds { low, high } = inputs.bounds[view];
                (bilinear(&z, height, width)? + residual)?.clamp(low, high)?.recip()
            })?);
            if let (true, Some((head, _))) = (with_features, &self.heads) {
                dpt_inputs.inverse_depth = None;
                features.push(self.timed(taps, "feature upsampler", |taps| head.forward(&dpt_inputs, taps))?);
            }
        }
        let depth = Tensor::cat(&depths, 0)?;
        let features = if features.is_empty() { None } else { Some(Tensor::cat(&features, 0)?) };
        Ok(NetworkOutputs { depth, match_probability, features })
    }

    /// Calls `each` with the number of every view and its Gaussians, one per pixel; not without weights for them or without
    /// features.
    pub(super) fn gaussians(
        &self,
        inputs: &NetworkInputs<'_>,
        outputs: &NetworkOutputs,
        taps: &mut Taps,
        each: &mut dyn FnMut(usize, &[PixelGaussian]),
    ) -> Result<()> {
        if let (Some((_, head)), Some(features)) = (&self.heads, &outputs.features) {
            for (view, camera) in inputs.cameras.iter().enumerate() {
                let one = |x: &Tensor| x.narrow(0, view, 1)?.contiguous();
                let probability = one(&outputs.match_probability)?;
                let x = HeadInputs {
                    image: &one(inputs.images)?,
                    depth: &one(&outputs.depth)?,
                    match_probability: &nearest(&probability, self.variant.scales.upsampling())?,
                    features: &one(features)?,
                };
                each(view, &self.timed(taps, "gaussian head", |taps| head.forward(&x, camera, taps))?);
            }
        }
        Ok(())
    }

    /// View by view: the maps are large.
    fn cnn(&self, images: &Tensor, taps: &mut Taps) -> Result<Vec<CnnFeatures>> {
        let mut all = Vec::new();
        for view in 0..images.dim(0)? {
            let features = self.backbone.forward(&images.narrow(0, view, 1)?.contiguous()?)?;
            taps.map("cnn.high", &features.high)?;
            taps.map("cnn.mid", &features.mid)?;
            taps.map("cnn.low", &features.low)?;
            all.push(features);
        }
        Ok(all)
    }

    /// Multi-view and single-view features of each scale.
    fn pyramids(&self, mv: &Tensor, last: &Tensor) -> Result<(Vec<Tensor>, Vec<Tensor>)> {
        let (_, height, width, _) = mv.dims4()?;
        let mono = bilinear(last, height, width)?;
        let scales = |x: Tensor, finer: &Option<Finer>| match finer {
            Some(finer) => Ok::<_, candle_core::Error>(vec![x.clone(), finer.forward(&x)?]),
            None => Ok(vec![x]),
        };
        Ok((scales(mv.clone(), &self.mv_pyramid)?, scales(mono, &self.mono_pyramid)?))
    }
}

/// One map of every view.
fn joined_views(cnn: &[CnnFeatures], map: impl Fn(&CnnFeatures) -> &Tensor) -> Result<Tensor> {
    let maps: Vec<&Tensor> = cnn.iter().map(map).collect();
    Tensor::cat(&maps, 0)
}

/// Mean 0 and deviation 1 over the pictures of ImageNet, per channel.
fn normalised(images: &Tensor) -> Result<Tensor> {
    let mean = Tensor::new(&[0.485_f32, 0.456, 0.406], images.device())?;
    let deviation = Tensor::new(&[0.229_f32, 0.224, 0.225], images.device())?;
    images.broadcast_sub(&mean)?.broadcast_div(&deviation)
}
