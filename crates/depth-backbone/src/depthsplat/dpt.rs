//! The head that brings maps of all depths to full resolution (DPT): `upsampler` for depth, `feature_upsampler` for
//! features.

use super::cnn::CnnFeatures;
use super::layers::{Conv, ConvTranspose, Linear, Then, bilinear, relu};
use super::params::Params;
use super::taps::Taps;
use super::variant::{Scales, Variant};
use candle_core::{Result, Tensor};

/// Two convolutions around which the input is added.
struct ResidualConv {
    conv1: Conv,
    conv2: Conv,
}

impl ResidualConv {
    fn new(p: &Params, width: usize) -> Result<Self> {
        let conv = |name| Conv::shape(3, width, width).load(&p.pp(name));
        Ok(Self { conv1: conv("conv1")?, conv2: conv("conv2")? })
    }

    fn forward(&self, x: &Tensor) -> Result<Tensor> {
        let y = self.conv1.forward_then(&relu(x)?, Then::RELU)?;
        self.conv2.forward_then(&y, Then::plus(x))
    }
}

struct Fusion {
    /// Absent in the coarsest one.
    unit1: Option<ResidualConv>,
    unit2: ResidualConv,
    out_conv: Linear,
}

impl Fusion {
    fn new(p: &Params, width: usize, coarsest: bool) -> Result<Self> {
        let unit1 = if coarsest { None } else { Some(ResidualConv::new(&p.pp("resConfUnit1"), width)?) };
        let unit2 = ResidualConv::new(&p.pp("resConfUnit2"), width)?;
        Ok(Self { unit1, unit2, out_conv: Linear::pointwise(&p.pp("out_conv"), width, width)? })
    }

    /// Joins `coarser` with the map `x`, and resizes to `size`.
    fn forward(&self, coarser: Option<Tensor>, x: &Tensor, size: (usize, usize)) -> Result<Tensor> {
        let y = match (coarser, &self.unit1) {
            (Some(coarser), Some(unit1)) => (coarser + unit1.forward(x)?)?,
            _ => x.clone(),
        };
        let y = bilinear(&self.unit2.forward(&y)?, size.0, size.1)?;
        self.out_conv.forward(&y)
    }
}

/// Maps of one view that the head joins.
pub(super) struct DptInputs<'a> {
    /// Four maps of the ViT at 1/8.
    pub(super) mono: &'a [Tensor],
    pub(super) cnn: &'a CnnFeatures,
    /// Multi-view features of each scale.
    pub(super) mv: &'a [Tensor],
    /// Inverse depth of the last scale, in the head for depth.
    pub(super) inverse_depth: Option<&'a Tensor>,
}

pub(super) struct Dpt {
    projects: Vec<Linear>,
    resize: (ConvTranspose, ConvTranspose, Conv),
    joints: Vec<Linear>,
    layer_rn: Vec<Conv>,
    fusions: Vec<Fusion>,
    scales: Scales,
    /// For the taps.
    name: &'static str,
}

impl Dpt {
    pub(super) fn new(
        p: &Params,
        variant: Variant,
        width: usize,
        with_depth: bool,
        name: &'static str,
    ) -> Result<Self> {
        let channels = variant.vit.dpt_channels();
        let joints = variant.joint_channels(with_depth);
        let scratch = p.pp("scratch");
        let project =
            |i: usize| Linear::pointwise(&p.pp(format!("projects.{i}")), variant.vit.width(), channels[i]);
        let joint =
            |i: usize| Linear::pointwise(&p.pp(format!("concat_projects.{i}")), joints[i], channels[i]);
        let rn = |i: usize| {
            let conv = Conv::shape(3, channels[i], width).without_bias();
            conv.load(&scratch.pp(format!("layer{}_rn", i + 1)))
        };
        let fusion = |i: usize| Fusion::new(&scratch.pp(format!("refinenet{}", i + 1)), width, i == 3);
        Ok(Self {
            projects: (0..4).map(project).collect::<Result<_>>()?,
            resize: (
                ConvTranspose::new(&p.pp("resize_layers.0"), channels[0], channels[0], 4)?,
                ConvTranspose::new(&p.pp("resize_layers.1"), channels[1], channels[1], 2)?,
                Conv::shape(3, channels[3], channels[3]).stride(2).load(&p.pp("resize_layers.3"))?,
            ),
            joints: (0..3).map(joint).collect::<Result<_>>()?,
            layer_rn: (0..4).map(rn).collect::<Result<_>>()?,
            fusions: (0..4).map(fusion).collect::<Result<_>>()?,
            scales: variant.scales,
            name,
        })
    }

    /// `[n, h, w, width]` at the size of the image.
    pub(super) fn forward(&self, inputs: &DptInputs<'_>, taps: &mut Taps) -> Result<Tensor> {
        let project = |i: usize| self.projects[i].forward(&inputs.mono[i]);
        let l1 = self.resize.0.forward_then(&project(0)?, Then::NOTHING)?;
        let l2 = self.resize.1.forward_then(&project(1)?, Then::NOTHING)?;
        let l3 = project(2)?;
        let l4 = self.resize.2.forward(&project(3)?)?;
        let CnnFeatures { high, mid, low } = inputs.cnn;
        let mv = inputs.mv;
        let (coarse, fine) = (&mv[0], &mv[mv.len() - 1]);
        let mut joined: [Vec<&Tensor>; 3] = match self.scales {
            Scales::Eighth => [vec![high, &l1], vec![mid, &l2], vec![low, &l3, coarse]],
            Scales::Quarter => [vec![high, mid, &l1], vec![low, &l2, coarse], vec![&l3]],
            Scales::EighthQuarter => [vec![high, &l1], vec![mid, &l2, fine], vec![low, &l3, coarse]],
            Scales::QuarterHalf => [vec![high, mid, fine, &l1], vec![low, &l2, coarse], vec![&l3]],
        };
        if let Some(z) = inputs.inverse_depth {
            match self.scales {
                Scales::Eighth => joined[2].push(z),
                Scales::Quarter | Scales::EighthQuarter => joined[1].push(z),
                Scales::QuarterHalf => joined[0].insert(3, z),
            }
        }
        let mut maps = Vec::new();
        for (i, (joint, parts)) in self.joints.iter().zip(&joined).enumerate() {
            let map = joint.forward_joined(parts, Then::NOTHING)?;
            taps.map(format!("{}.layer{}", self.name, i + 1), &map)?;
            maps.push(map);
        }
        taps.map(format!("{}.layer4", self.name), &l4)?;
        maps.push(l4);
        let maps =
            maps.iter().zip(&self.layer_rn).map(|(map, rn)| rn.forward(map)).collect::<Result<Vec<_>>>()?;
        let mut y = None;
        for i in (0..4).rev() {
            let (_, height, width, _) = maps[i.max(1) - 1].dims4()?;
            let size = if i == 0 { (2 * height, 2 * width) } else { (height, width) };
            let path = self.fusions[i].forward(y, &maps[i], size)?;
            taps.map(format!("{}.path{}", self.name, i + 1), &path)?;
            y = Some(path);
        }
        y.ok_or_else(|| candle_core::Error::Msg("a DPT head without levels".to_owned()))
    }
}

/// What the head for depth ends with: a residual of inverse depth.
pub(super) struct DepthResidual([Conv; 2], Linear);

impl DepthResidual {
    /// `p`: the upsampler.
    pub(super) fn new(p: &Params, width: usize) -> Result<Self> {
        let p = p.pp("scratch.output_conv");
        let first = Conv::shape(3, width, width / 2).replicate().load(&p.pp(0))?;
        let second = Conv::shape(3, width / 2, 16).replicate().load(&p.pp(2))?;
        Ok(Self([first, second], Linear::pointwise(&p.pp(4), 16, 1)?))
    }

    /// `[n, h, w, width]` to `[n, h, w, 1]`.
    pub(super) fn forward(&self, x: &Tensor) -> Result<Tensor> {
        let y = self.0[0].forward_then(x, Then::GELU)?;
        self.1.forward(&self.0[1].forward_then(&y, Then::GELU)?)
    }
}
